"""Reads a bag that is whole, and says in one line what is wrong with one that is not."""

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from config.errors import BrokenRecording
from msgs_adapters.topics import Topic, message_class
from recordings.bag_writer import CONTINUED_RECORD, UNFINISHED_SUFFIX
from recordings.mcap_source import McapSource
from recordings.receive_times import RECEIVE_TIMES_RECORD, receive_times_of
from recordings.rosbag2_metadata import METADATA_FILE, parse_qos, read_file_names


@dataclass(frozen=True)
class RecordedTopic:
    """A topic of a recording.

    Attributes:
        topic: absolute name, type and offered QoS.
        type_hash: RIHS01 hash as recorded, empty where the recorder did not write it.
        message_count: how many messages it has.
    """

    topic: Topic
    type_hash: str
    message_count: int


@dataclass(frozen=True)
class BagMessage:
    """One message, unparsed.

    Attributes:
        topic_name: absolute name.
        type_name: such as ``sensor_msgs/msg/Imu``.
        payload: CDR bytes.
        log_time_ns: reception on the bag's clock [ns].
        publish_time_ns: the source's time [ns].
        sequence: running number in the topic, where the recorder wrote one.
    """

    topic_name: str
    type_name: str
    payload: bytes
    log_time_ns: int
    publish_time_ns: int
    sequence: int

    def decode(self) -> Any:
        """The ROS message.

        Raises:
            RefusedInput: the message type is not installed; ``tf2_msgs`` is not.
            BrokenRecording: the bytes are no such message.
        """
        from rclpy.serialization import deserialize_message

        try:
            return deserialize_message(self.payload, message_class(self.type_name))
        # rclpy's binding raises its own RMWError and, for text that is not UTF-8, UnicodeDecodeError.
        except (RuntimeError, ValueError, MemoryError):
            raise BrokenRecording(
                self.topic_name, self.payload[:16].hex(), f"is no {self.type_name}"
            ) from None


class BagReader:
    """An open recording: a rosbag2 directory, or one MCAP file of it.

    Summary and index are checked when it is opened, each chunk when it is read, the whole recording by
    `verify`. Memory holds one chunk at a time, and those that overlap it in time.

    A directory of several files reads as one recording: what a file repeats of the one before it, so that it
    stands on its own, is there once.

    Attributes:
        path: the file, or the directory of several.
        topics: by absolute name, in the order in which they were added.
        start_ns: log time of the first message [ns]; 0 when there is none.
        end_ns: log time of the last message [ns].

    Raises:
        BrokenRecording: it is no recording, is empty, was cut short or is damaged.
    """

    def __init__(self, path: Path) -> None:
        files = mcap_files(Path(path))
        self.path = files[0] if len(files) == 1 else Path(path)
        self._parts: list[McapSource] = []
        self._repeated: list[Mapping[str, int]] = []
        try:
            for file in files:
                part = McapSource(file)
                self._parts.append(part)
                self._repeated.append(_repeated(part) if len(self._parts) > 1 else {})
            self.topics: Mapping[str, RecordedTopic] = self._all_topics()
        except BrokenRecording:
            self.close()
            raise
        filled = [part.statistics for part in self._parts if part.statistics.message_count]
        self.start_ns = min((statistics.message_start_time for statistics in filled), default=0)
        self.end_ns = max((statistics.message_end_time for statistics in filled), default=0)

    @property
    def message_count(self) -> int:
        """Messages of all topics."""
        return sum(topic.message_count for topic in self.topics.values())

    @property
    def attachment_names(self) -> list[str]:
        """Names of the attached files, in order."""
        return [index.name for part in self._parts for index in part.summary.attachment_indexes]

    @property
    def metadata_names(self) -> list[str]:
        """Names of the metadata records, each once, in order; the times of reception aside."""
        names = dict.fromkeys(index.name for part in self._parts for index in part.summary.metadata_indexes)
        return [name for name in names if name != RECEIVE_TIMES_RECORD]

    def messages(
        self,
        topic_names: Iterable[str] | None = None,
        *,
        start_ns: int | None = None,
        end_ns: int | None = None,
    ) -> Iterator[BagMessage]:
        """Messages in log-time order; those of equal time in the order in which they were written.

        Args:
            topic_names: absolute names; all topics by default.
            start_ns: nothing logged before this [ns].
            end_ns: nothing logged at or after this [ns].

        Raises:
            BrokenRecording: the recording has no such topic, or a chunk is damaged.
        """
        names = list(self.topics if topic_names is None else topic_names)
        for name in names:
            if name not in self.topics:
                raise BrokenRecording("topic", name, self._lacks(self.topics))
        return self._iterate(frozenset(names), start_ns, end_ns)

    def attachment(self, name: str) -> bytes:
        """The attached file of that name; the last one if there are several.

        Raises:
            BrokenRecording: there is none, or it is damaged.
        """
        for part in reversed(self._parts):
            for index in reversed(part.summary.attachment_indexes):
                if index.name == name:
                    return part.attachment(index.offset, name)
        raise BrokenRecording("attachment", name, self._lacks(self.attachment_names))

    def metadata(self, name: str) -> dict[str, str]:
        """The metadata record of that name; the last one if there are several.

        Raises:
            BrokenRecording: there is none, or it is damaged.
        """
        for part in reversed(self._parts):
            for index in reversed(part.summary.metadata_indexes):
                if index.name == name:
                    return part.metadata(index.offset, name)
        raise BrokenRecording("metadata", name, self._lacks(self.metadata_names))

    def receive_times(self, topic_name: str) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """When a topic's messages reached the recorder, on the wall clock.

        Returns:
            Sequence numbers, as `BagMessage.sequence` has them, and receptions [ns since 1970, in whole µs],
            each of shape (n,); empty where the recorder kept none, as in a test without a graph.

        Raises:
            BrokenRecording: the recording has no such topic, or they are damaged.
        """
        if topic_name not in self.topics:
            raise BrokenRecording("topic", topic_name, self._lacks(self.topics))
        records = (
            part.metadata(index.offset, RECEIVE_TIMES_RECORD)
            for part in self._parts
            for index in part.summary.metadata_indexes
            if index.name == RECEIVE_TIMES_RECORD
        )
        return receive_times_of(records, topic_name)

    def verify(self) -> None:
        """Reads the whole recording once, and compares every checksum and every count in it.

        Raises:
            BrokenRecording: something is damaged.
        """
        for part in self._parts:
            part.verify()

    def close(self) -> None:
        """Closes the files."""
        for part in self._parts:
            part.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _iterate(
        self, names: frozenset[str], start_ns: int | None, end_ns: int | None
    ) -> Iterator[BagMessage]:
        types = {name: recorded.topic.type_name for name, recorded in self.topics.items()}
        for part, repeated in zip(self._parts, self._repeated, strict=True):
            for name, message in part.messages(names, start_ns, end_ns):
                if name in repeated and message.sequence <= repeated[name]:
                    continue
                yield BagMessage(
                    name, types[name], message.payload, message.log_ns, message.publish_ns, message.sequence
                )

    def _all_topics(self) -> dict[str, RecordedTopic]:
        topics: dict[str, RecordedTopic] = {}
        for part, repeated in zip(self._parts, self._repeated, strict=True):
            for channel in part.channels.values():
                found = _recorded_topic(part, channel.id)
                count = found.message_count - (channel.topic in repeated and found.message_count > 0)
                known = topics.get(channel.topic)
                if known is None:
                    topics[channel.topic] = replace(found, message_count=count)
                elif known.topic.type_name != found.topic.type_name:
                    limit = f"is of type {known.topic.type_name} and of type {found.topic.type_name}"
                    raise BrokenRecording("topic", channel.topic, limit)
                else:
                    # A topic of several publishers can have several channels, a long recording several files.
                    topics[channel.topic] = replace(known, message_count=known.message_count + count)
        return topics

    def _lacks(self, names: Iterable[str]) -> str:
        return f"{self.path.name} has no such; it has: {', '.join(names) or 'none'}"


def mcap_files(path: Path) -> list[Path]:
    """The whole MCAP files that a user means by a directory or a file, in order.

    Raises:
        BrokenRecording: there is none, or the recording has not been finished.
    """
    try:
        path.stat()
    except FileNotFoundError:
        raise BrokenRecording("bag", str(path), "does not exist") from None
    except (OSError, ValueError) as error:
        raise BrokenRecording("bag", str(path), getattr(error, "strerror", "") or "cannot be read") from None
    if not path.is_dir():
        if path.name.endswith(UNFINISHED_SUFFIX):
            raise BrokenRecording("bag", str(path), "was cut short: its writer did not finish it")
        return [path]
    if (path / METADATA_FILE).is_file():
        files = [path / name for name in read_file_names(path / METADATA_FILE)]
        for file in files:
            if not file.is_file():
                raise BrokenRecording("bag", str(file), "does not exist")
        return files
    unfinished = sorted(path.glob(f"*{UNFINISHED_SUFFIX}"))
    if unfinished:
        return mcap_files(unfinished[0])
    files = sorted(path.glob("*.mcap"), key=file_number)
    # Files of one recording are numbered; others do not belong together.
    if len(files) == 1 or (files and len({file.name.rpartition("_")[0] for file in files}) == 1):
        return files
    raise BrokenRecording("bag", str(path), "is no recording: it holds no metadata.yaml and no one .mcap")


def file_number(path: Path) -> tuple[int, str]:
    """Sorts the files of a recording: ``bag_10.mcap`` after ``bag_9.mcap``."""
    number = re.search(r"_(\d+)\.mcap", path.name)
    return (int(number[1]) if number else -1), path.name


def _repeated(part: McapSource) -> Mapping[str, int]:
    for index in part.summary.metadata_indexes:
        if index.name == CONTINUED_RECORD:
            values = part.metadata(index.offset, CONTINUED_RECORD)
            return {name: int(value) for name, value in values.items() if value.isdecimal()}
    return {}


def _recorded_topic(part: McapSource, channel_id: int) -> RecordedTopic:
    channel = part.channels[channel_id]
    qos = parse_qos(channel.metadata.get("offered_qos_profiles", ""))
    return RecordedTopic(
        Topic(channel.topic, part.schema_of(channel).name, qos),
        channel.metadata.get("topic_type_hash", ""),
        part.statistics.channel_message_counts.get(channel_id, 0),
    )
