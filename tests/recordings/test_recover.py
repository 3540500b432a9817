"""Recordings that were cut, killed or damaged are made whole again, and what is missing is said."""

import random
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from rosbags.highlevel import AnyReader

from config.errors import BrokenRecording, RefusedInput
from config.scene_file import find_scene, read_scene, scene_from_json
from msgs_adapters.cdr import serialize
from msgs_adapters.convert import to_string
from msgs_adapters.topics import CLOCK, EUMOS_REPORT, SCENE, QosSpec
from recordings.bag_reader import BagMessage, BagReader
from recordings.bag_writer import BagWriter
from recordings.rescue import recover_bag, rescue_bag
from recordings.stamp_gaps import StampGaps
from tests.recordings.damage import read
from tests.recordings.killed_recorder import holes, kill_recorder
from tests.recordings.rerun_tools import rerun

FRAME_NS = 10**9 // 240


def messages_in_other_tools(bag: Path, home: Path) -> int:
    """How many messages rosbags reads; rerun finds no fault in any file."""
    for file in bag.glob("*.mcap"):
        report = rerun(home, "mcap", "check", "--full", str(file))
        # Of each cloud rerun makes a chunk, and calls them unordered among themselves.
        lines = [line.split() for line in report.splitlines() if " /" in line and "/wrap/strain" not in line]
        assert all(line[0] == "ok" for line in lines), report
    with AnyReader([bag]) as reader:
        return sum(1 for _ in reader.messages())


def fields(message: BagMessage) -> tuple[str, bytes, int, int, int]:
    return (
        message.topic_name,
        message.payload,
        message.log_time_ns,
        message.publish_time_ns,
        message.sequence,
    )


def test_a_recorder_killed_at_any_moment_loses_less_than_a_second(tmp_path: Path) -> None:
    for kill in kill_recorder(tmp_path, count=3, seed=5, longest_s=1.5):
        assert kill.recovery.is_cut
        assert kill.lost_s < 1.0
        assert not any(holes(kill.bag).values())
        assert kill.recovery.missing == {}
        assert messages_in_other_tools(kill.bag, tmp_path) == kill.recovery.message_count
        if kill.recovery.message_count:
            assert kill.recovery.scene == "restored"
        assert sorted(path.suffix for path in kill.bag.iterdir()) == [".mcap", ".yaml"]


def test_a_whole_recording_is_left_alone(sample_bag: Path, sample_records: list[object]) -> None:
    before = {path.name: (path.read_bytes(), path.stat().st_mtime_ns) for path in sample_bag.iterdir()}
    recovery = recover_bag(sample_bag)
    assert recovery.was_whole and recovery.message_count == len(sample_records)
    assert recovery.lines() == [
        f"{sample_bag} is whole: 723 messages of 15 topics, 0.246 s; nothing was changed"
    ]
    assert {
        path.name: (path.read_bytes(), path.stat().st_mtime_ns) for path in sample_bag.iterdir()
    } == before


@pytest.mark.parametrize("keep", [0.05, 0.4, 0.9])
def test_a_cut_file_keeps_every_whole_chunk(
    tmp_path: Path, sample_bag: Path, mcap_bytes: bytes, keep: float
) -> None:
    part = tmp_path / "bag" / "bag_0.mcap.part"
    part.parent.mkdir()
    (part.parent / "my notes.txt").write_text("mine")
    part.write_bytes(mcap_bytes[: int(keep * len(mcap_bytes))])
    recovery = recover_bag(part.parent)
    whole = [fields(message) for message in read(sample_bag)]
    kept = [fields(message) for message in read(part.parent)]
    assert kept == whole[: len(kept)] and len(kept) == recovery.message_count
    (end,) = recovery.damages
    assert end.is_end and end.offset + end.size == int(keep * len(mcap_bytes))
    assert recovery.missing == {} and not recovery.originals
    # A chunk of the sample has a few messages of each topic.
    assert (recovery.end_ns - recovery.start_ns) / 1e9 > keep * 0.246 - 0.05 or keep < 0.1
    assert (part.parent / "my notes.txt").read_text() == "mine" and not part.exists()
    assert messages_in_other_tools(part.parent, tmp_path) == len(kept)


def test_a_damaged_chunk_costs_its_messages_and_no_others(
    tmp_path: Path, sample_bag: Path, mcap_bytes: bytes
) -> None:
    bag = tmp_path / "sample"
    shutil.copytree(sample_bag, bag)
    with (sample_bag / "sample_0.mcap").open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    chunk = summary.chunk_indexes[10]
    damaged = bytearray(mcap_bytes)
    damaged[chunk.chunk_start_offset + 100] ^= 1
    (bag / "sample_0.mcap").write_bytes(damaged)
    with pytest.raises(BrokenRecording, match=f"is damaged at byte {chunk.chunk_start_offset}: "):
        read(bag)
    recovery = recover_bag(bag)
    (damage,) = recovery.damages
    assert (damage.offset, damage.size) == (chunk.chunk_start_offset, chunk.chunk_length)
    assert damage.span_ns == (chunk.message_start_time, chunk.message_end_time)
    whole, kept = read(sample_bag), read(bag)
    lost = [message for message in whole if fields(message) not in set(map(fields, kept))]
    assert len(lost) == len(whole) - len(kept) > 5
    for name, count in recovery.missing.items():
        assert count == sum(message.topic_name == name for message in lost)
    assert sum(recovery.missing.values()) == len(lost)
    (original,) = recovery.originals
    assert original.name == "sample_0.mcap.broken" and original.read_bytes() == bytes(damaged)
    assert recovery.scene == "whole"
    with BagReader(bag) as reader:
        told = reader.metadata("pallet-twin recovery")
    assert {name: int(told[f"missing {name}"]) for name in recovery.missing} == recovery.missing


def test_a_file_alone_is_copied_beside_itself(tmp_path: Path, mcap_bytes: bytes) -> None:
    file = tmp_path / "x_0.mcap"
    # The first chunk, with the names of all topics, is gone; the summary still has them.
    file.write_bytes(mcap_bytes[:60] + bytes(400) + mcap_bytes[460:])
    recovery = recover_bag(file)
    assert recovery.bag == tmp_path / "x_0-recovered"
    assert file.exists() and len(read(recovery.bag)) == recovery.message_count > 700
    again = recover_bag(file, tmp_path / "elsewhere")
    assert again.counts == recovery.counts
    with pytest.raises(RefusedInput, match="not empty"):
        recover_bag(file, tmp_path / "elsewhere")


def test_the_scene_is_made_again_from_its_message(tmp_path: Path) -> None:
    scene = read_scene(find_scene("block_slip"), [])
    writer = BagWriter(tmp_path / "bag")
    name = writer.add_topic(SCENE)
    writer.write(name, serialize(to_string(scene.to_json())), log_time_ns=5)
    writer.flush()
    # What a process that is killed leaves: the file as it is, and nobody who holds it.
    writer._file.close()
    assert rescue_bag(tmp_path / "bag") == 1
    with BagReader(tmp_path / "bag") as reader:
        assert scene_from_json(reader.attachment("scene.json").decode()) == scene


def test_what_cannot_be_recovered_is_said(tmp_path: Path, mcap_bytes: bytes) -> None:
    with pytest.raises(BrokenRecording, match="does not exist"):
        recover_bag(tmp_path / "nothing")
    with pytest.raises(BrokenRecording, match=r"holds no \.mcap"):
        recover_bag(tmp_path)
    with pytest.raises(BrokenRecording, match="holds no unfinished"):
        rescue_bag(tmp_path)
    noise = tmp_path / "bag"
    noise.mkdir()
    (noise / "bag_0.mcap").write_bytes(bytes(range(256)) * 50)
    with pytest.raises(BrokenRecording, match="no message that can be read"):
        recover_bag(noise)
    assert [path.name for path in noise.iterdir()] == ["bag_0.mcap"]
    with (
        BagWriter(tmp_path / "live"),
        pytest.raises(RefusedInput, match="is being recorded right now"),
    ):
        recover_bag(tmp_path / "live")


@pytest.mark.parametrize("compression", list(CompressionType))
@pytest.mark.parametrize("is_cut", [False, True])
def test_another_recorders_bag_is_read_and_recovered(
    tmp_path: Path, compression: CompressionType, is_cut: bool
) -> None:
    """A type that is not installed, log times out of order, numbers that do not count."""
    file = tmp_path / "their_bag_3.mcap"
    with file.open("wb") as stream:
        writer = Writer(stream, chunk_size=2000, compression=compression)
        writer.start("ros2", "another recorder")
        schema = writer.register_schema("their_msgs/msg/Door", "ros2msg", b"float64 angle\n")
        channel = writer.register_channel("/door", "cdr", schema, {"offered_qos_profiles": ""})
        times = [index * 10**6 - (index % 3) * 5 * 10**6 + 10**9 for index in range(500)]
        for index, time_ns in enumerate(times):
            writer.add_message(channel, time_ns, index.to_bytes(4, "little") * 9, time_ns, 7)
        if not is_cut:
            writer.finish()
    expected = sorted(range(500), key=lambda index: times[index])
    if not is_cut:
        assert [int.from_bytes(m.payload[:4], "little") for m in read(file)] == expected
    recovery = recover_bag(file)
    found = read(recovery.bag)
    kept = [index for index in expected if index < len(found)]
    assert [int.from_bytes(m.payload[:4], "little") for m in found] == kept
    assert [m.log_time_ns for m in found] == [times[index] for index in kept]
    assert (len(found) == 500) is not is_cut and len(found) > 450
    with BagReader(recovery.bag) as reader:
        assert reader.topics["/door"].topic.type_name == "their_msgs/msg/Door"
        assert reader.topics["/door"].topic.qos == QosSpec()


def split_sample(directory: Path, **limits: float) -> list[int]:
    """A recording of 3 s in several files; the numbers of its clock messages."""
    with BagWriter(directory, **limits) as writer:  # type: ignore[arg-type]
        scene, clock, report = (writer.add_topic(topic) for topic in (SCENE, CLOCK, EUMOS_REPORT))
        writer.write(scene, serialize(to_string("the scene")), log_time_ns=0)
        for index in range(720):
            payload = bytes((0, 1, 0, 0)) + index.to_bytes(8, "little")
            writer.write(clock, payload, log_time_ns=index * FRAME_NS, receive_time_ns=10**18 + index * 10**6)
        writer.write(report, serialize(to_string("the report")), log_time_ns=720 * FRAME_NS)
    return list(range(720))


def parts_of(bag: Path) -> Iterator[Path]:
    return iter(sorted(bag.glob("*.mcap")))


def test_a_split_recording_reads_as_one_and_each_file_stands_alone(tmp_path: Path) -> None:
    bag = tmp_path / "bag"
    numbers = split_sample(bag, split_s=1.0)
    assert [path.name for path in parts_of(bag)] == ["bag_0.mcap", "bag_1.mcap", "bag_2.mcap"]
    with BagReader(bag) as reader:
        reader.verify()
        assert reader.path == bag
        counts = {name: topic.message_count for name, topic in reader.topics.items()}
        assert counts == {"/twin/scene": 1, "/clock": 720, "/twin/eumos/report": 1}
        messages = list(reader.messages())
        assert len(messages) == reader.message_count == 722
        clock = [message for message in messages if message.topic_name == "/clock"]
        assert [int.from_bytes(message.payload[4:], "little") for message in clock] == numbers
        assert [message.sequence for message in clock] == numbers
        assert [message.log_time_ns for message in messages] == sorted(m.log_time_ns for m in messages)
        later = reader.messages(["/clock", "/twin/scene"], start_ns=500 * FRAME_NS)
        assert [message.topic_name for message in later] == ["/clock"] * 220
        sequences, times_ns = reader.receive_times("/clock")
        assert sequences.tolist() == numbers
        assert times_ns.tolist() == [10**18 + index * 10**6 for index in numbers]
    for part in parts_of(bag):
        with BagReader(part) as reader:
            assert next(reader.messages()).decode().data == "the scene"
    # Other tools read each file for itself, the repeated scene too, and agree with metadata.yaml.
    assert messages_in_other_tools(bag, tmp_path) == 722 + 2
    with AnyReader([bag]) as other:
        assert other.message_count == 722 + 2


def test_a_split_by_size_keeps_to_it(tmp_path: Path) -> None:
    bag = tmp_path / "bag"
    with BagWriter(bag, split_bytes=200_000, chunk_bytes=20_000) as writer:
        name = writer.add_topic(SCENE)
        for index in range(300):
            writer.write(name, random.Random(index).randbytes(4000), log_time_ns=index * 10**7)
    with BagReader(bag) as reader:
        assert reader.message_count == 300
    assert len(list(parts_of(bag))) > 1
    assert max(path.stat().st_size for path in parts_of(bag)) < 210_000
    with pytest.raises(RefusedInput, match="split_s = 0"):
        BagWriter(tmp_path / "none", split_s=0)


def test_a_split_recording_is_recovered_as_one(tmp_path: Path) -> None:
    bag = tmp_path / "bag"
    split_sample(bag, split_s=1.0)
    (bag / "metadata.yaml").unlink()
    last = bag / "bag_2.mcap"
    last.rename(bag / "bag_2.mcap.part")
    second = bag / "bag_1.mcap"
    content = bytearray(second.read_bytes())
    content[len(content) // 3] ^= 1
    second.write_bytes(content)
    with pytest.raises(BrokenRecording, match="cut short"):
        BagReader(bag)
    recovery = recover_bag(bag)
    assert 0 < recovery.missing["/clock"] < 200
    assert recovery.counts["/clock"] + recovery.missing["/clock"] == 720
    assert recovery.counts["/twin/scene"] == recovery.counts["/twin/eumos/report"] == 1
    assert [path.name for path in recovery.originals] == ["bag_1.mcap.broken"]
    assert len(read(bag)) == recovery.message_count


@pytest.mark.parametrize(
    ("stamps", "missing"),
    [
        (list(range(0, 1000, 10)), 0),
        ([*range(0, 500, 10), *range(530, 1000, 10)], 3),
        ([0, 10, 20, 30, 60, 70, 80], 2),
        ([0, 0, 0, 10, 10, 30, 30, 30, 90], 0),
        ([0, 3, 20, 21, 50, 80, 81, 99], 0),
        # A node that started anew.
        ([*range(0, 500, 10), *range(0, 500, 10)], 0),
        ([7], 0),
        ([], 0),
    ],
)
def test_holes_in_stamps(stamps: list[int], missing: int) -> None:
    gaps = StampGaps()
    for stamp in stamps:
        gaps.add(stamp * 10**6)
    assert gaps.missing == missing
