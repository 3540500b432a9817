"""What of a recording is played, in which order and when; without ROS running."""

import threading
import time
from collections.abc import Callable, Generator, Iterator
from contextlib import ExitStack
from dataclasses import replace
from itertools import groupby
from pathlib import Path

import pytest

from config.errors import BrokenRecording, RefusedInput
from config.scene_file import find_scene, read_scene
from msgs_adapters import topics
from msgs_adapters.cdr import serialize
from msgs_adapters.convert import to_string
from recordings.bag_reader import BagReader
from recordings.bag_writer import BagWriter
from recordings.paced_sender import PacedSender, PlaybackClock, ReadAhead, TimingErrors
from recordings.playback import Playback, PlayedMessage, select_topics, why_incomplete
from recordings.test_bag import attach_scene
from tests.recordings.conftest import EPOCH_NS, FRAME_COUNT, PERIOD_NS, pose_frame

TOPIC = topics.PACKAGES_POSES
MS = 10**6
Opened = Callable[..., Playback]


def numbered(times_ns: list[int], topic: topics.Topic = TOPIC) -> Generator[PlayedMessage, None, None]:
    yield from (PlayedMessage(topic, at, b"%d" % number) for number, at in enumerate(times_ns))


@pytest.fixture
def opened() -> Iterator[Opened]:
    """Opens recordings, and closes them after the test."""
    with ExitStack() as stack:
        yield lambda *arguments, **choice: stack.enter_context(Playback(*arguments, **choice))


def test_everything_is_played_in_order_but_what_is_not_installed(
    opened: Opened, sample_bag: Path, sample_records: list
) -> None:
    playback = opened(sample_bag)
    assert list(playback.selection.left_out) == ["/tf"]
    assert "not installed" in playback.selection.left_out["/tf"]
    played = [*playback.opening(), *playback.stream()]
    assert [(m.topic.name, m.payload, m.log_time_ns) for m in played] == [
        record for record in sample_records if record[0] != "/tf"
    ]
    recorded = playback.reader.topics
    assert all(topic == recorded[name].topic for name, topic in playback.selection.sent.items())
    assert not playback.makes_clock


def test_latched_messages_from_before_the_start_come_first(opened: Opened, sample_bag: Path) -> None:
    playback = opened(sample_bag, start_s=20 * PERIOD_NS / 1e9)
    assert [message.topic.name for message in playback.opening()] == [
        "/twin/scene",
        "/twin/robot_description",
    ]
    stream = list(playback.stream())
    assert {message.log_time_ns for message in stream} == {
        EPOCH_NS + index * PERIOD_NS for index in range(20, FRAME_COUNT)
    }
    # The report is latched too, but is said at its own time.
    assert stream[-1].topic.name == "/twin/eumos/report"


@pytest.mark.parametrize(
    ("namespace", "expected"),
    [
        ("", "/twin/packages/poses"),
        ("/machine", "/machine/packages/poses"),
        ("/twin:=/bench/left", "/bench/left/packages/poses"),
        ("/", "/packages/poses"),
    ],
)
def test_namespace_moves_and_global_topics_stay(sample_bag: Path, namespace: str, expected: str) -> None:
    with BagReader(sample_bag) as reader:
        sent = select_topics(reader, namespace=namespace).sent
    assert sent["/twin/packages/poses"].name == expected
    assert sent["/clock"].name == "/clock" and sent["/diagnostics"].name == "/diagnostics"


def test_topics_are_chosen_and_left_out(sample_bag: Path) -> None:
    with BagReader(sample_bag) as reader:
        some = select_topics(reader, topics=["packages/*", "/twin/scene"], leave_out=["markers"])
        assert set(some.sent) == {"/clock", "/twin/packages/poses", "/twin/scene"}
        rest = select_topics(reader, leave_out=["eumos/*", "/clock"])
        assert not {"/clock", "/twin/eumos/status", "/twin/eumos/report"} & set(rest.sent)


@pytest.mark.parametrize(
    ("field", "choice"),
    [
        ("topics", {"topics": ["packages/pose"]}),
        ("namespace", {"namespace": "/machine:=/twin"}),
        ("namespace", {"namespace": "no name"}),
        ("bag", {"leave_out": ["*"]}),
        ("start", {"start_s": 5.0}),
        ("start", {"start_s": float("nan")}),
    ],
)
def test_choices_that_fit_nothing_are_refused(sample_bag: Path, field: str, choice: dict) -> None:
    with pytest.raises(RefusedInput) as refusal:
        Playback(sample_bag, **choice)
    assert refusal.value.field == field


def test_clock_is_made_for_a_bag_without_one_only(opened: Opened, sample_bag: Path, tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag") as bag:
        name = bag.add_topic(topics.SCENE)
        for second in range(3):
            bag.write(name, serialize(to_string(str(second))), log_time_ns=EPOCH_NS + second * 10**9)
    made = opened(tmp_path / "bag", clock_hz=10.0)
    ticks = [message.log_time_ns for message in made.stream() if message.topic is topics.CLOCK]
    assert made.makes_clock
    assert ticks == [EPOCH_NS + tick * 10**8 for tick in range(21)]
    # Recorded, or left out by its name: none is made.
    assert not opened(sample_bag, clock_hz=10.0).makes_clock
    assert not opened(tmp_path / "bag", clock_hz=10.0, leave_out=["/clock"]).makes_clock


def test_nothing_is_given_beyond_a_damage(
    opened: Opened, sample_bag: Path, sample_records: list, tmp_path: Path
) -> None:
    from mcap.reader import make_reader

    data = bytearray((sample_bag / "sample_0.mcap").read_bytes())
    with (sample_bag / "sample_0.mcap").open("rb") as stream:
        chunks = make_reader(stream).get_summary().chunk_indexes
    hurt = chunks[len(chunks) // 2]
    data[hurt.chunk_start_offset + hurt.chunk_length // 2] ^= 0xFF
    (tmp_path / "broken.mcap").write_bytes(data)
    playback, taken = opened(tmp_path / "broken.mcap"), []
    with pytest.raises(BrokenRecording, match="damaged"):
        for message in ReadAhead(playback.stream()):
            taken.append((message.topic.name, message.payload, message.log_time_ns))
    wanted = [r for r in sample_records if r[0] not in ("/tf", "/twin/scene", "/twin/robot_description")]
    assert 0 < len(taken) < len(wanted)
    assert taken == wanted[: len(taken)]


@pytest.mark.parametrize(("frames", "report", "expected"), [
    (300, None, None),
    (100, None, "the recording ends at 0.412 s"),
    (300, '{"verdict": "unresolved"}', "ended early"),
    (100, '{"verdict": "fail"}', None),
])  # fmt: skip
def test_part_of_a_test_is_told_from_a_whole_one(
    opened: Opened, tmp_path: Path, frames: int, report: str | None, expected: str | None
) -> None:
    scene = read_scene(find_scene("block_slip"))
    with BagWriter(tmp_path / "bag") as bag:
        poses, told = bag.add_topic(TOPIC), bag.add_topic(topics.EUMOS_REPORT)
        from msgs_adapters.pose_payloads import pose_array_payload

        for index in range(frames):
            frame = pose_frame(index)
            bag.write(poses, pose_array_payload(frame), log_time_ns=frame.stamp_ns)
        if report is not None:
            bag.write(told, serialize(to_string(report)), log_time_ns=frame.stamp_ns)
        attach_scene(bag, scene)
    playback = opened(tmp_path / "bag")
    why = why_incomplete(playback.reader, playback.selection)
    assert why is None if expected is None else expected in (why or "")


def test_reading_ahead_is_bounded() -> None:
    given = []

    def source() -> Generator[PlayedMessage, None, None]:
        for message in numbered(list(range(100))):
            given.append(message)
            yield message

    ahead = ReadAhead(source(), messages=8)
    first = next(ahead)
    time.sleep(0.05)
    assert len(given) <= 8 + 2
    assert [first, *ahead] == list(numbered(list(range(100))))
    large = ReadAhead((PlayedMessage(TOPIC, at, bytes(1000)) for at in range(50)), size_bytes=3000)
    assert len(list(large)) == 50
    unread = ReadAhead(numbered(list(range(100))), messages=8)
    unread.close()
    assert not unread._thread.is_alive()


def test_clock_maps_log_time_at_a_rate_with_halts() -> None:
    clock = PlaybackClock(rate=2.0)
    clock.start(1000 * MS, 50.0)
    assert clock.due_s(1500 * MS) == 50.25
    clock.halt(50.1)
    clock.halt(55.0)
    clock.go_on(60.0)
    assert clock.due_s(1500 * MS) == pytest.approx(60.15)
    clock.halt(60.0)
    clock.advance(1400 * MS)
    clock.advance(1300 * MS)
    clock.go_on(70.0)
    assert clock.due_s(1500 * MS) == pytest.approx(70.05)


def test_quantiles_of_timing_errors_are_within_two_percent() -> None:
    timing = TimingErrors()
    for index in range(1, 1001):
        timing.add(index * 1e-5)
    assert timing.max_s == 0.01
    for share in (0.5, 0.99):
        assert share * 0.01 <= timing.quantile_s(share) <= share * 0.01 * 1.021
    timing.add(1e9)
    assert timing.quantile_s(1.0) <= timing.max_s == 1e9
    assert TimingErrors().quantile_s(0.5) == 0.0


def sender(times_ns: list[int], **options: object) -> tuple[PacedSender, list[tuple[float, bytes]]]:
    """A sender of numbered messages, and what it sent at which wall time."""
    sent: list[tuple[float, bytes]] = []
    opening = [PlayedMessage(replace(TOPIC, name="/scene"), 0, b"scene")]
    paced = PacedSender(
        opening, lambda: numbered(times_ns),
        lambda message, _: sent.append((time.monotonic(), message.payload)), start_ns=0, **options,
    )  # fmt: skip
    return paced, sent


@pytest.mark.parametrize("rate", [0.5, 1.0, 10.0])
def test_messages_leave_at_the_rate(rate: float) -> None:
    paced, sent = sender([number * 2 * MS for number in range(50)], rate=rate)
    began = time.monotonic()
    paced.run()
    assert [payload for _, payload in sent] == [b"%d" % number for number in range(50)]
    for number, (at_s, _) in enumerate(sent):
        # Never early; how late depends on who else uses the machine.
        assert at_s - began >= number * 0.002 / rate
    assert paced.timing.count == 50 and paced.passes == 1
    assert paced.timing.quantile_s(0.5) < 0.01


def test_passes_begin_with_the_latched_messages_again() -> None:
    paced, sent = sender([0, MS], rate=None, passes=3)
    paced.send_opening()
    paced.run()
    assert [payload for _, payload in sent] == [b"scene", b"0", b"1"] * 3
    assert paced.sent == 9 and paced.timing.count == 0


@pytest.mark.parametrize("step", [None, TOPIC])
def test_halted_sender_goes_step_by_step_and_on(step: topics.Topic | None) -> None:
    times_ns = [0, 0, 5 * MS, 10 * MS, 10 * MS, 10 * MS, 50 * MS]
    paced, sent = sender(times_ns, rate=1.0, step=step, halted=True)
    thread = threading.Thread(target=paced.run)
    thread.start()
    time.sleep(0.05)
    assert sent == []
    for _, group in groupby(times_ns[:-1]):
        before = len(sent)
        done, words = paced.step()
        assert done and words.startswith(f"{len(list(group))} messages")
        assert len(sent) == before + int(words.split()[0])
    began = time.monotonic()
    paced.go_on()
    thread.join()
    # From the step's 10 ms to the last message's 50 ms.
    assert sent[-1][0] - began >= 0.04 and len(sent) == len(times_ns)
    assert paced.step() == (False, "the recording is over")


def test_sender_begins_again_and_stops_at_once() -> None:
    paced, sent = sender([0, 3600 * 10**9], rate=1.0)
    thread = threading.Thread(target=paced.run)
    thread.start()
    for count in (1, 3, 5):
        while len(sent) < count:
            time.sleep(0.001)
        paced.restart()
    while len(sent) < 7:
        time.sleep(0.001)
    assert "halted at 0" in paced.halt() and paced.step()[0] is True
    paced.stop()
    thread.join(1.0)
    assert not thread.is_alive()
    assert [payload for _, payload in sent][:7] == [b"0", b"scene", b"0", b"scene", b"0", b"scene", b"0"]
