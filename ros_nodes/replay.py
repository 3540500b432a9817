"""Plays a recording into a graph of its own and, where asked, has it judged or drawn again and compared."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from config.errors import RefusedInput
from msgs_adapters.topics import (
    CAMERA_COMPRESSED,
    CAMERA_IMAGE,
    CAMERA_INFO,
    CAMERA_PROGRESS,
    EUMOS_REPORT,
    EUMOS_STATUS,
    PACKAGES_POSES,
    PHYSICS_PROGRESS,
    SCENE,
    SLED_ODOMETRY,
    WRAP_STRAIN,
    Topic,
)
from recordings.bag_reader import BagReader
from recordings.judge_bag import scene_of_bag
from recordings.playback import Playback, Selection
from ros_nodes.readers import readers_text
from ros_nodes.replay_graph import Compared, Comparison, OnPlayed, ReplayGraph, ReplayPlan
from ros_nodes.supervisor import SILENCE_LIMIT_WRAPPED_S, configure_middleware

JUDGED = ("eumos/*",)
DRAWN = ("camera/*", "vision/*")


@dataclass(frozen=True)
class Replayed:
    """A recording that was played.

    Attributes:
        bag: the recording.
        namespace: where the bench's topics were sent.
        messages: sent, of all passes.
        passes: whole passes.
        duration_s: of one pass on the bag's clock [s].
        wall_s: wall time [s].
        cpu_share: the player's processor time by wall time.
        timing_ms: message timing error, wall time of sending after due time, as p50, p99 and max [ms]; None where
            it was played as fast as acknowledged.
        topics: messages sent by absolute topic name.
        left_out: why a topic could not be played, by its recorded name.
        not_acknowledged: topics with a reader that did not acknowledge in time.
        compared: what was made anew, beside what was recorded.
        report_json: the report that the validator gave, or None.
    """

    bag: Path
    namespace: str
    messages: int
    passes: int
    duration_s: float
    wall_s: float
    cpu_share: float
    timing_ms: Mapping[str, float] | None
    topics: Mapping[str, int]
    left_out: Mapping[str, str]
    not_acknowledged: Sequence[str]
    compared: Sequence[Compared] = ()
    report_json: str | None = None


def replay(
    bag: Path,
    *,
    rate: float | None = 1.0,
    start_s: float = 0.0,
    loop: int = 1,
    namespace: str = "",
    topics: Sequence[str] = (),
    leave_out: Sequence[str] = (),
    judge: bool = False,
    pictures: bool = False,
    guests: int = 0,
    paused: bool = False,
    discovery: Literal["localhost", "subnet"] = "localhost",
    on_progress: OnPlayed | None = None,
) -> Replayed:
    """Plays a recording to its end.

    Args:
        bag: the recording.
        rate: seconds of the bag a second, 0.01 to 1000, or None: as fast as its readers acknowledge.
        start_s: where it begins, after the first message [s].
        loop: how often it is played; 0: until it is interrupted.
        namespace: where the recorded namespace's topics go, ``TO`` or ``FROM:=TO``; empty: they stay.
        topics: names or patterns of what is played; all when empty.
        leave_out: names or patterns of what is not.
        judge: a validator judges it anew; the recorded ``eumos/*`` is compared, not played.
        pictures: a camera draws it anew; the recorded ``camera/*`` is compared, not played.
        guests: readers from outside that each stream must have before the first message.
        paused: begins halted.
        discovery: who may see the nodes.
        on_progress: called with time played, duration [s] and messages sent.

    Raises:
        RefusedInput: the bag or an option cannot be used, or another twin runs in this ROS domain.
        BrokenRecording: the bag is damaged; nothing beyond the damage was sent.
        NodeDied: a node ended before the recording did.
    """
    _check_options(rate, start_s, loop, judge=judge, pictures=pictures)
    left = (*leave_out, *(JUDGED if judge else ()), *(DRAWN if pictures else ()))
    with Playback(bag, topics=topics, leave_out=left, namespace=namespace, start_s=start_s) as playback:
        graph = _graph(playback.reader, playback.selection, judge=judge, pictures=pictures, guests=guests)
        player: dict[str, object] = {
            "bag": str(bag.resolve()), "rate": float(rate or 0.0), "start_s": float(start_s), "passes": loop,
            "namespace": namespace, "topics": ",".join(topics), "leave_out": ",".join(left), "paused": paused,
            "readers": readers_text(graph.player_readers), "answers": ",".join(graph.answers),
        }  # fmt: skip
        configure_middleware(discovery)
        running = ReplayGraph(graph, player, playback.selection.namespace, playback.duration_s, on_progress)
        summary = running.run()
    return Replayed(
        bag=bag,
        namespace=playback.selection.namespace,
        duration_s=playback.duration_s,
        compared=[comparison.result() for comparison in graph.comparisons],
        report_json=running.report_json,
        **summary,
    )


def _check_options(rate: float | None, start_s: float, loop: int, *, judge: bool, pictures: bool) -> None:
    from ros_nodes.player_node import FASTEST, SLOWEST

    if rate is not None and not SLOWEST <= rate <= FASTEST:
        raise RefusedInput("--rate", rate, f"must be from {SLOWEST} to {FASTEST:.0f}")
    if not 0 <= loop <= 10**9:
        raise RefusedInput("--loop", loop, "must be from 0, without end, to 1000000000")
    for option, is_set in (("--judge", judge), ("--pictures", pictures)):
        if is_set and (start_s or loop != 1):
            raise RefusedInput(option, "with --start or --loop", "needs the whole recording, played once")


def _graph(
    reader: BagReader, selection: Selection, *, judge: bool, pictures: bool, guests: int
) -> ReplayPlan:
    graph = ReplayPlan()
    if guests:
        for name, topic in selection.sent.items():
            if topic.qos.durability == "volatile" and reader.topics[name].message_count:
                graph.player_readers[topic.name] = guests
    if not judge and not pictures:
        return graph
    scene = scene_of_bag(reader)
    film = [WRAP_STRAIN] if scene.film is not None else []
    if film:
        graph.silence_limit_s = SILENCE_LIMIT_WRAPPED_S
    if pictures and scene.camera is None:
        raise RefusedInput("--pictures", str(reader.path), "its scene has no camera")
    for option, is_set, extra in (("--judge", judge, []), ("--pictures", pictures, [SLED_ODOMETRY])):
        for topic in (SCENE, PACKAGES_POSES, *film, *extra) if is_set else ():
            recorded = selection.recorded(topic)
            if recorded is None or not reader.topics[recorded].message_count:
                raise RefusedInput(
                    option, str(reader.path), f"needs {topic.name}, of which nothing is played"
                )
            name = topic.absolute_name(selection.namespace)
            graph.player_readers[name] = graph.player_readers.get(name, 0) + 1
        if is_set and not any(name.endswith(f"/{PHYSICS_PROGRESS.name}") for name in reader.topics):
            name = PHYSICS_PROGRESS.absolute_name(selection.namespace)
            graph.player_readers[name] = graph.player_readers.get(name, 0) + 1
    if judge:
        graph.nodes["validator_node"] = {
            "readers": readers_text({EUMOS_STATUS.name: 2, EUMOS_REPORT.name: 1})
        }
        graph.answers.append(EUMOS_STATUS.name)
        made = [EUMOS_STATUS, EUMOS_REPORT]
        graph.comparisons += [Comparison(t, reader, _recorded(reader, selection, t)) for t in made]
    if pictures:
        assert scene.camera is not None
        image = CAMERA_IMAGE if scene.camera.record == "raw" else CAMERA_COMPRESSED
        said = {CAMERA_INFO.name: 2, image.name: 1, CAMERA_PROGRESS.name: 1}
        graph.nodes["camera_node"] = {"readers": readers_text(said)}
        graph.answers.append(CAMERA_INFO.name)
        made = [CAMERA_INFO, image]
        graph.comparisons += [Comparison(t, reader, _recorded(reader, selection, t)) for t in made]
    return graph


def _recorded(reader: BagReader, selection: Selection, topic: Topic) -> str | None:
    """A topic's name in the bag, beside the recorded poses."""
    poses = selection.recorded(PACKAGES_POSES)
    assert poses is not None
    name = poses.removesuffix(PACKAGES_POSES.name) + topic.name
    return name if name in reader.topics else None


def replay_lines(replayed: Replayed) -> Iterator[str]:
    """What the command line says about a recording that was played."""
    from ros_nodes.player_node import played_words

    yield f"{replayed.bag}: {played_words(vars(replayed))}"
    for name, why in replayed.left_out.items():
        yield f"not played: {name}: {why}"
    for compared in replayed.compared:
        if compared.is_equal:
            yield f"{compared.topic}: {compared.count} messages, byte for byte as recorded"
        elif not compared.recorded:
            yield f"{compared.topic}: {compared.count} messages; the recording has none to compare"
        else:
            first = f", the first is number {compared.first_different}" if compared.different else ""
            yield (
                f"{compared.topic}: {compared.count} messages, recorded {compared.recorded},"
                f" different {compared.different}{first}"
            )
