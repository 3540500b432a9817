"""Writes a rosbag2 directory with one MCAP file; a crash loses little, and equal input gives equal bytes."""

import os
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Self

from mcap.writer import CompressionType, Writer

from config.errors import RefusedInput
from msgs_adapters.topics import TWIN_NAMESPACE, Topic
from recordings.rosbag2_metadata import (
    TopicSummary,
    bag_information,
    information_text,
    qos_text,
    write_metadata,
)
from recordings.schemas import message_definition

UNFINISHED_SUFFIX = ".part"
PROFILE = "ros2"
LIBRARY = "pallet-twin"
ROSBAG2_RECORD = "rosbag2"


class BagWriter:
    """An open recording; a context manager that finishes it, after an exception too.

    The file is called ``<name>_0.mcap.part`` until it is whole. Log times rise monotonically; nothing in the
    file comes from the wall clock unless the caller passes it.

    Args:
        directory: the bag; made here, with its parents. It may exist when it is empty.
        chunk_bytes: a chunk is closed when it is larger, before compression.
        chunk_period_s: a chunk is also closed, and handed to the operating system, after so much log time
            [s]: a process that is killed loses no more than that.

    Raises:
        RefusedInput: the directory exists and is not empty, or cannot be made.
    """

    def __init__(
        self, directory: Path, *, chunk_bytes: int = 256 * 1024, chunk_period_s: float = 0.25
    ) -> None:
        self._directory = _empty_directory(directory)
        self._file_name = f"{self._directory.name}_0.mcap"
        self._part = self._directory / (self._file_name + UNFINISHED_SUFFIX)
        self._stream = self._part.open("xb")
        self._writer = Writer(
            self._stream, chunk_size=chunk_bytes, compression=CompressionType.ZSTD, enable_data_crcs=True
        )
        self._writer.start(PROFILE, LIBRARY)
        self._chunk_period_ns = round(chunk_period_s * 1e9)
        self._chunk_start_ns = 0
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}
        self._topics: dict[str, TopicSummary] = {}
        self._counts: dict[str, int] = {}
        self._start_ns: int | None = None
        self._end_ns = 0
        self._closed = False

    @property
    def path(self) -> Path:
        """The MCAP file, as it is called once it is finished."""
        return self._directory / self._file_name

    @property
    def message_counts(self) -> Mapping[str, int]:
        """Messages written so far, by absolute topic name."""
        return self._counts

    def add_topic(self, topic: Topic, *, namespace: str = TWIN_NAMESPACE) -> str:
        """Opens a channel and returns the absolute name that `write` takes; adding one twice does nothing.

        Raises:
            RefusedInput: the message type is not installed, or the name stands for another type already.
        """
        name = topic.absolute_name(namespace)
        if name in self._topics:
            if self._topics[name].type_name != topic.type_name:
                limit = f"{name} is of type {self._topics[name].type_name} already"
                raise RefusedInput("type", topic.type_name, limit)
            return name
        definition = message_definition(topic.type_name)
        if topic.type_name not in self._schemas:
            self._schemas[topic.type_name] = self._writer.register_schema(
                topic.type_name, "ros2msg", definition.text.encode()
            )
        self._channels[name] = self._writer.register_channel(
            name,
            "cdr",
            self._schemas[topic.type_name],
            {"offered_qos_profiles": qos_text(topic.qos), "topic_type_hash": definition.type_hash},
        )
        self._topics[name] = TopicSummary(name, topic.type_name, definition.type_hash, topic.qos, 0)
        self._counts[name] = 0
        return name

    def write(
        self, topic_name: str, payload: bytes, *, log_time_ns: int, publish_time_ns: int | None = None
    ) -> None:
        """Appends one message.

        Args:
            topic_name: absolute, as `add_topic` returned it.
            payload: CDR bytes of the message.
            log_time_ns: reception on the bag's clock [ns]; never before the message written last.
            publish_time_ns: the source's time [ns]; the log time where it is not known.

        Raises:
            RefusedInput: an unknown topic, or time runs backwards.
        """
        channel = self._channels.get(topic_name)
        if channel is None:
            raise RefusedInput("topic", topic_name, "must be added to the bag first")
        if log_time_ns < self._end_ns:
            raise RefusedInput("log_time_ns", log_time_ns, f"must not be before {self._end_ns}")
        if self._start_ns is None:
            self._start_ns = self._chunk_start_ns = log_time_ns
        if log_time_ns - self._chunk_start_ns >= self._chunk_period_ns:
            self.flush()
            self._chunk_start_ns = log_time_ns
        published_ns = log_time_ns if publish_time_ns is None else publish_time_ns
        self._writer.add_message(channel, log_time_ns, payload, published_ns, self._counts[topic_name])
        self._counts[topic_name] += 1
        self._end_ns = log_time_ns

    def flush(self) -> None:
        """Closes the chunk in progress; what was written until now survives the process."""
        self._writer.flush()  # type: ignore[no-untyped-call]

    def attach(self, name: str, media_type: str, data: bytes, *, log_time_ns: int | None = None) -> None:
        """Adds a file, such as the scene or the report, at a log time [ns]: by default the last message's."""
        time_ns = self._end_ns if log_time_ns is None else log_time_ns
        self._writer.add_attachment(time_ns, time_ns, name, media_type, data)

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Adds a record of names and texts; the name ``rosbag2`` is taken.

        Raises:
            RefusedInput: that name.
        """
        if name == ROSBAG2_RECORD:
            raise RefusedInput("metadata", name, "is rosbag2's own record")
        self._writer.add_metadata(name, dict(values))

    def close(self) -> None:
        """Writes index and summary, gives the file its name and writes metadata.yaml; does nothing twice."""
        if self._closed:
            return
        self._closed = True
        topics = [replace(topic, message_count=self._counts[name]) for name, topic in self._topics.items()]
        information = bag_information(self._file_name, topics, self._start_ns or 0, self._end_ns)
        with self._stream:
            self._writer.add_metadata(ROSBAG2_RECORD, {"serialized_metadata": information_text(information)})
            self._writer.finish()  # type: ignore[no-untyped-call]
            self._stream.flush()
            os.fsync(self._stream.fileno())
        self._part.replace(self.path)
        write_metadata(self._directory, information)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if error is None:
            self.close()
        else:
            # The error under way says more than one about closing; the .part file stays then.
            with suppress(OSError):
                self.close()


def _empty_directory(directory: Path) -> Path:
    directory = directory.resolve()
    try:
        directory.mkdir(parents=True, exist_ok=True)
        occupied = any(directory.iterdir())
    except OSError as error:
        raise RefusedInput("bag", str(directory), f"cannot be made: {error.strerror}") from None
    if occupied:
        raise RefusedInput("bag", str(directory), "exists and is not empty: nothing is overwritten")
    return directory
