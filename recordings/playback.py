"""What of a recording is played: which topics, under which names, and their messages in order."""

import json
import re
from collections.abc import Generator, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from pathlib import Path
from types import TracebackType
from typing import NamedTuple, Self

from config.errors import RefusedInput
from msgs_adapters.cdr import serialize
from msgs_adapters.stamps import to_clock
from msgs_adapters.topics import (
    ALL_TOPICS,
    CLOCK,
    EUMOS_REPORT,
    PACKAGES_POSES,
    SCENE,
    TWIN_NAMESPACE,
    Topic,
    message_class,
)
from recordings.bag_reader import BagReader, RecordedTopic
from recordings.judge_bag import scene_of_bag
from recordings.schemas import message_definition
from recordings.test_bag import SCENE_ATTACHMENT
from sim_core.sled import stop_sample

LARGEST_DEPTH = 10_000
"""A deeper queue of a recording from elsewhere is played with this one."""
_TOPIC_NAME = re.compile(r"(/[A-Za-z_][A-Za-z0-9_]*)+")


class PlayedMessage(NamedTuple):
    """One message to send: its topic as it is sent, its log time on the bag's clock [ns], its CDR bytes."""

    topic: Topic
    log_time_ns: int
    payload: bytes


@dataclass(frozen=True)
class Selection:
    """Which topics of a recording are played, and under which names.

    Attributes:
        sent: the topic as it is sent, by the absolute name as recorded.
        left_out: why a topic that was asked for cannot be played, by its recorded name.
        namespace: the one in which the twin's topics are sent.
    """

    sent: Mapping[str, Topic]
    left_out: Mapping[str, str]
    namespace: str

    def recorded(self, topic: Topic) -> str | None:
        """The recorded name of what is sent as one of the twin's topics, or None when nothing is."""
        wanted = topic.absolute_name(self.namespace)
        return next((name for name, sent in self.sent.items() if sent.name == wanted), None)


def select_topics(
    reader: BagReader, *, topics: Sequence[str] = (), leave_out: Sequence[str] = (), namespace: str = ""
) -> Selection:
    """Chooses what is played and moves it to another namespace; what cannot be played is named with its reason.

    Args:
        reader: an open recording.
        topics: names or patterns with ``*``, absolute or the end of a name; all when empty. ``/clock`` always is.
        leave_out: the same for topics that are not played.
        namespace: where the recorded namespace's topics go, as ``TO`` or ``FROM:=TO``; empty: they stay.

    Raises:
        RefusedInput: a name that fits nothing, an unclear or impossible namespace, or nothing is left to play.
    """
    for pattern in topics:
        if not any(_fits(name, [pattern]) for name in reader.topics):
            limit = f"fits no topic of the bag; it has {', '.join(reader.topics) or 'none'}"
            raise RefusedInput("topics", pattern, limit)
    source, target = _move(namespace, _namespaces(reader.topics))
    sent: dict[str, Topic] = {}
    left_out: dict[str, str] = {}
    for name, recorded in reader.topics.items():
        is_chosen = not topics or name == CLOCK.name or _fits(name, topics)
        if not is_chosen or _fits(name, leave_out):
            continue
        reason = _why_unplayable(recorded)
        if reason is not None:
            left_out[name] = reason
            continue
        moved = _moved(name, source, target)
        if any(topic.name == moved for topic in sent.values()):
            raise RefusedInput("namespace", namespace, f"two recorded topics would become {moved}")
        qos = replace(recorded.topic.qos, depth=min(recorded.topic.qos.depth, LARGEST_DEPTH))
        sent[name] = replace(recorded.topic, name=moved, qos=qos)
    if not any(reader.topics[name].message_count for name in sent):
        raise RefusedInput(
            "bag", str(reader.path), "holds no message that can be played and was not left out"
        )
    return Selection(sent, left_out, target or "/")


def _fits(name: str, patterns: Iterable[str]) -> bool:
    return any(fnmatchcase(name, p if p.startswith("/") else f"*/{p}") for p in patterns)


def _namespaces(names: Iterable[str]) -> list[str]:
    """The namespaces in which a recording has topics of a bench, in order; the root is an empty text."""
    relative = [topic.name for topic in ALL_TOPICS if not topic.name.startswith("/")]
    found = {name[: -len(end) - 1] for name in names for end in relative if name.endswith(f"/{end}")}
    return sorted(found)


def _move(namespace: str, recorded: Sequence[str]) -> tuple[str, str]:
    """From which namespace to which topics are moved; the same twice when they stay."""
    source, arrow, target = namespace.rpartition(":=")
    source, target = source.rstrip("/"), target.rstrip("/")
    if not arrow:
        if len(recorded) > 1 and namespace:
            limit = f"say which of {', '.join(recorded)} moves, as FROM:=TO"
            raise RefusedInput("namespace", namespace, limit)
        source = recorded[0] if recorded else TWIN_NAMESPACE
        target = target if namespace else source
    elif source not in recorded:
        raise RefusedInput(
            "namespace", source, f"is none of the bag's: {', '.join(recorded) or 'it has none'}"
        )
    if target and not _TOPIC_NAME.fullmatch(target):
        raise RefusedInput("namespace", target, "must be such as /twin or /bench/left")
    return source, target


def _moved(name: str, source: str, target: str) -> str:
    is_global = any(topic.name == name for topic in ALL_TOPICS)
    return name if is_global or not name.startswith(f"{source}/") else target + name.removeprefix(source)


def _why_unplayable(recorded: RecordedTopic) -> str | None:
    topic = recorded.topic
    if not _TOPIC_NAME.fullmatch(topic.name):
        return "is no ROS topic name"
    try:
        message_class(topic.type_name)
        installed = message_definition(topic.type_name).type_hash
    except RefusedInput:
        return f"{topic.type_name} is not installed"
    if recorded.type_hash and recorded.type_hash != installed:
        return f"{topic.type_name} was recorded with another definition than the installed one"
    return None


def why_incomplete(reader: BagReader, selection: Selection) -> str | None:
    """Why the poses of a recording are not a whole test, in words, or None when they are.

    A recorded report says it: ``judgement`` calls a test unresolved only when it was ended early. Without one,
    poses have to reach the sled's stop.
    """
    poses, report = selection.recorded(PACKAGES_POSES), None
    for name in reader.topics:
        if poses is not None and name == poses.removesuffix(PACKAGES_POSES.name) + EUMOS_REPORT.name:
            report = next(reader.messages([name]), None)
    if report is not None:
        try:
            verdict = json.loads(report.decode().data)["verdict"]
        except (ValueError, LookupError, TypeError):
            verdict = "unreadable"
        return "the recorded test was ended early" if verdict == "unresolved" else None
    has_scene = SCENE_ATTACHMENT in reader.attachment_names or selection.recorded(SCENE) is not None
    if poses is None or not has_scene:
        return None
    scene = scene_of_bag(reader)
    end_s = (reader.topics[poses].message_count - 1) / scene.sampling.poses_hz
    stop_s = stop_sample(scene) / scene.sampling.samples_hz
    return (
        f"the recording ends at {end_s:.3f} s, the sled stops at {stop_s:.3f} s" if end_s < stop_s else None
    )


def latched_messages(reader: BagReader, selection: Selection, start_ns: int) -> list[PlayedMessage]:
    """The newest message of each latched topic logged at or before the start: what a late joiner would have got."""
    latched = [name for name, topic in selection.sent.items() if topic.qos.durability == "transient_local"]
    newest: dict[str, PlayedMessage] = {}
    for message in reader.messages(latched, end_ns=start_ns + 1) if latched else ():
        topic = selection.sent[message.topic_name]
        newest[message.topic_name] = PlayedMessage(topic, message.log_time_ns, message.payload)
    return sorted(newest.values(), key=lambda message: message.log_time_ns)


def stream_messages(
    reader: BagReader, selection: Selection, start_ns: int, *, clock_hz: float = 0.0
) -> Generator[PlayedMessage, None, None]:
    """Every other message from the start on, in log-time order.

    Args:
        reader: the recording.
        selection: what is played.
        start_ns: log time of the start [ns].
        clock_hz: ticks of a ``/clock`` that is made a second of the bag's time [Hz]; 0: none is made.

    Raises:
        BrokenRecording: a chunk is damaged; what stands before it has been given.
    """
    tick = 0
    for message in reader.messages(list(selection.sent), start_ns=start_ns):
        topic = selection.sent[message.topic_name]
        if topic.qos.durability == "transient_local" and message.log_time_ns <= start_ns:
            continue
        while clock_hz and (due_ns := start_ns + round(tick / clock_hz * 1e9)) <= message.log_time_ns:
            yield PlayedMessage(CLOCK, due_ns, serialize(to_clock(due_ns)))
            tick += 1
        yield PlayedMessage(topic, message.log_time_ns, message.payload)


class Playback:
    """An open recording and what of it is played; a context manager.

    Args:
        path: the bag.
        topics: see `select_topics`, as the next two.
        leave_out: names or patterns.
        namespace: ``TO`` or ``FROM:=TO``.
        start_s: log time of the start after the recording's first message [s].
        clock_hz: ticks a second of the bag's time of a ``/clock`` for a recording without one [Hz]; 0: none.

    Attributes:
        reader: the recording.
        selection: its topics.
        start_ns: log time of the start [ns].
        makes_clock: whether ``/clock`` is made here.

    Raises:
        RefusedInput: see `select_topics`, or the start is not inside the recording.
        BrokenRecording: the bag is damaged.
    """

    def __init__(
        self,
        path: Path,
        *,
        topics: Sequence[str] = (),
        leave_out: Sequence[str] = (),
        namespace: str = "",
        start_s: float = 0.0,
        clock_hz: float = 0.0,
    ) -> None:
        self.reader = BagReader(path)
        self._leave_out = leave_out
        try:
            self.selection = select_topics(
                self.reader, topics=topics, leave_out=leave_out, namespace=namespace
            )
            if not 0.0 <= start_s <= self.duration_s:
                limit = f"must be from 0 to {self.duration_s:.3f} s, the recording's end"
                raise RefusedInput("start", start_s, limit)
        except RefusedInput:
            self.close()
            raise
        self.start_ns = self.reader.start_ns + round(start_s * 1e9)
        has_clock = CLOCK.name in self.reader.topics
        self.makes_clock = clock_hz > 0 and not has_clock and not _fits(CLOCK.name, leave_out)
        self._clock_hz = clock_hz if self.makes_clock else 0.0

    def is_left_out(self, topic: Topic) -> bool:
        """Whether nobody wants one of the bench's topics to be sent."""
        return _fits(topic.absolute_name(self.selection.namespace), self._leave_out)

    @property
    def duration_s(self) -> float:
        """From the first message to the last [s]."""
        return (self.reader.end_ns - self.reader.start_ns) * 1e-9

    def opening(self) -> list[PlayedMessage]:
        """See `latched_messages`."""
        return latched_messages(self.reader, self.selection, self.start_ns)

    def stream(self) -> Generator[PlayedMessage, None, None]:
        """See `stream_messages`."""
        return stream_messages(self.reader, self.selection, self.start_ns, clock_hz=self._clock_hz)

    def close(self) -> None:
        """Closes the recording."""
        self.reader.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
