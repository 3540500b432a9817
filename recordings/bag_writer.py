"""Writes a rosbag2 directory of MCAP files; a crash loses little, and equal input gives equal bytes."""

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from types import TracebackType
from typing import Self

from config.errors import RefusedInput
from msgs_adapters.topics import TWIN_NAMESPACE, Topic
from recordings.mcap_file import McapFile
from recordings.receive_times import BATCH_LIMIT, RECEIVE_TIMES_RECORD, ReceiveTimes
from recordings.rosbag2_metadata import (
    FileSummary,
    TopicSummary,
    bag_information,
    information_text,
    qos_text,
    write_metadata,
)
from recordings.schemas import MessageDefinition, message_definition

UNFINISHED_SUFFIX = ".part"
PROFILE = "ros2"
LIBRARY = "pallet-twin"
ROSBAG2_RECORD = "rosbag2"
CONTINUED_RECORD = "pallet-twin continued"
"""At the start of each file after the first: the sequence of each latched message that stands there again."""
_RECEIVE_PERIOD_NS = 500_000_000


@dataclass(frozen=True)
class _Latched:
    """The last message of a latched topic, as it opens the next file."""

    payload: bytes
    publish_time_ns: int
    sequence: int


class BagWriter:
    """An open recording; a context manager that finishes it, after an exception too.

    A file is called ``<name>_0.mcap.part`` until it is whole. Log times rise monotonically; nothing in the
    file comes from the wall clock unless the caller passes it. After a write failed, on a full disk, the end
    of what was written is given back so that scene, index and metadata.yaml still fit: the bag can be closed
    and read.

    Args:
        directory: the bag; made here, with its parents. It may exist when it is empty.
        chunk_bytes: a chunk is closed when it is larger, before compression.
        chunk_period_s: a chunk is also closed, and handed to the operating system, after so much log time
            [s]: a process that is killed loses no more than that.
        split_bytes: a file is followed by another before its records take more than this; None for one file.
        split_s: a file is followed by another after so much log time [s]. Files after the first begin with
            the last message of each latched topic, so that they stand on their own; read as one bag, such
            a message is there once.
        in_order: refuse log times that run backwards; False to copy what another recorder wrote.

    Raises:
        RefusedInput: the directory exists and is not empty, or cannot be made or written.
    """

    def __init__(
        self,
        directory: Path,
        *,
        chunk_bytes: int = 256 * 1024,
        chunk_period_s: float = 0.25,
        split_bytes: int | None = None,
        split_s: float | None = None,
        in_order: bool = True,
    ) -> None:
        for name, size in (("split_bytes", split_bytes), ("split_s", split_s)):
            if size is not None and not size > 0:
                raise RefusedInput(name, size, "must be greater than 0")
        self._directory = _empty_directory(directory)
        self._chunk_bytes = chunk_bytes
        self._chunk_period_ns = round(chunk_period_s * 1e9)
        self._split_bytes = split_bytes
        self._split_ns = None if split_s is None else round(split_s * 1e9)
        self._in_order = in_order
        self._topics: dict[str, TopicSummary] = {}
        self._definitions: dict[str, MessageDefinition] = {}
        self._counts: dict[str, int] = {}
        self._latched: dict[str, _Latched] = {}
        self._files: list[FileSummary] = []
        self._receive_times = ReceiveTimes()
        self._batch_start_ns = 0
        self._chunk_start_ns: int | None = None
        self._file_start_ns: int | None = None
        self._end_ns = 0
        self._is_open = self._is_cut = self._closed = False
        try:
            self._use(self._new_file())
        except OSError as error:
            limit = f"cannot be written: {error.strerror}"
            raise RefusedInput("bag", str(self._directory), limit) from None

    @property
    def path(self) -> Path:
        """The first MCAP file, as it is called once it is finished."""
        return self._directory / f"{self._directory.name}_0.mcap"

    @property
    def message_counts(self) -> Mapping[str, int]:
        """Messages written so far, by absolute topic name."""
        return self._counts

    def add_topic(
        self, topic: Topic, *, namespace: str = TWIN_NAMESPACE, definition: MessageDefinition | None = None
    ) -> str:
        """Opens a channel and returns the absolute name that `write` takes; adding one twice does nothing.

        Args:
            topic: name, type and the QoS that its publisher offers.
            namespace: of a relative name.
            definition: what another recording says about the type; by default what is installed.

        Raises:
            RefusedInput: the message type is not installed, or the name stands for another type already.
        """
        name = topic.absolute_name(namespace)
        if name in self._topics:
            if self._topics[name].type_name != topic.type_name:
                limit = f"{name} is of type {self._topics[name].type_name} already"
                raise RefusedInput("type", topic.type_name, limit)
            return name
        definition = definition or message_definition(topic.type_name)
        self._definitions.setdefault(topic.type_name, definition)
        self._topics[name] = TopicSummary(name, topic.type_name, definition.type_hash, topic.qos, 0)
        self._counts[name] = 0
        self._open_channel(name)
        return name

    def write(
        self,
        topic_name: str,
        payload: bytes,
        *,
        log_time_ns: int,
        publish_time_ns: int | None = None,
        receive_time_ns: int | None = None,
        sequence: int | None = None,
    ) -> None:
        """Appends one message.

        Args:
            topic_name: absolute, as `add_topic` returned it.
            payload: CDR bytes of the message.
            log_time_ns: reception on the bag's clock [ns]; never before the message written last.
            publish_time_ns: the source's time [ns]; the log time where it is not known.
            receive_time_ns: reception on the wall clock [ns since 1970], where it is worth keeping.
            sequence: running number in the topic; by default it counts on.

        Raises:
            RefusedInput: an unknown topic, or time runs backwards.
            OSError: the disk is full, or the file is gone; `close` still works then.
        """
        if topic_name not in self._channels:
            raise RefusedInput("topic", topic_name, "must be added to the bag first")
        if log_time_ns < self._end_ns and self._in_order:
            raise RefusedInput("log_time_ns", log_time_ns, f"must not be before {self._end_ns}")
        if self._chunk_start_ns is None:
            self._chunk_start_ns = log_time_ns
        published_ns = log_time_ns if publish_time_ns is None else publish_time_ns
        number = self._counts[topic_name] if sequence is None else sequence
        try:
            if self._is_split_due(log_time_ns, len(payload)):
                self._start_next_file(log_time_ns)
            elif log_time_ns - self._chunk_start_ns >= self._chunk_period_ns:
                self.flush()
            if self._file_start_ns is None:
                self._file_start_ns = log_time_ns
            if self._file.is_chunk_empty:
                self._chunk_start_ns = log_time_ns
            self._file.add_message(self._channels[topic_name], number, log_time_ns, published_ns, payload)
        except OSError as error:
            self._give_back(error)
            raise
        self._counts[topic_name] += 1
        self._end_ns = max(log_time_ns, self._end_ns)
        if self._splits and self._topics[topic_name].qos.durability == "transient_local":
            self._latched[topic_name] = _Latched(payload, published_ns, number)
        if receive_time_ns is not None:
            self._note_reception(topic_name, number, receive_time_ns)

    def flush(self) -> None:
        """Closes the chunk in progress; what was written until now survives the process.

        Raises:
            OSError: the disk is full, or the file is gone; `close` still works then.
        """
        try:
            self._file.close_chunk()
        except OSError as error:
            self._give_back(error)
            raise

    def attach(self, name: str, media_type: str, data: bytes, *, log_time_ns: int | None = None) -> None:
        """Adds a file, such as the scene or the report, at a log time [ns]: by default the last message's."""
        time_ns = self._end_ns if log_time_ns is None else log_time_ns
        self._file.attach(name, media_type, data, log_ns=time_ns, create_ns=time_ns)

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Adds a record of names and texts; the name ``rosbag2`` is taken.

        Raises:
            RefusedInput: that name.
        """
        if name == ROSBAG2_RECORD:
            raise RefusedInput("metadata", name, "is rosbag2's own record")
        self._file.add_metadata(name, values)

    def close(self) -> None:
        """Writes index and summary, gives the file its name and writes metadata.yaml; does nothing twice.

        Raises:
            OSError: the disk is full: the bag is whole and lacks its last messages. Or not even that could be
                written, or the file is gone: what there is stays, with its suffix ``.part``.
        """
        if self._closed:
            return
        self._closed = True
        try:
            error = self._finish_file()
        finally:
            self._file.close()
        write_metadata(self._directory, bag_information(self._files, list(self._topics.values())))
        # Whoever writes has heard of a full disk already, unless it filled up only now.
        if error is not None and not self._is_cut:
            raise error

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

    @property
    def _splits(self) -> bool:
        return self._split_bytes is not None or self._split_ns is not None

    def _is_split_due(self, log_time_ns: int, size: int) -> bool:
        if self._file_start_ns is None:
            return False
        is_large = self._split_bytes is not None and self._file.size + size > self._split_bytes
        return is_large or (
            self._split_ns is not None and log_time_ns - self._file_start_ns >= self._split_ns
        )

    def _new_file(self) -> McapFile:
        name = f"{self._directory.name}_{len(self._files) + self._is_open}.mcap{UNFINISHED_SUFFIX}"
        return McapFile(self._directory / name, PROFILE, LIBRARY, chunk_bytes=self._chunk_bytes)

    def _use(self, file: McapFile) -> None:
        self._file, self._is_open = file, True
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}
        for topic_name in self._topics:
            self._open_channel(topic_name)

    def _give_back(self, error: OSError) -> None:
        self._is_cut = True
        self._file.make_room(error)

    def _open_channel(self, name: str) -> None:
        topic = self._topics[name]
        if topic.type_name not in self._schemas:
            definition = self._definitions[topic.type_name]
            self._schemas[topic.type_name] = self._file.add_schema(
                topic.type_name, definition.encoding, definition.text.encode()
            )
        metadata = {"offered_qos_profiles": qos_text(topic.qos), "topic_type_hash": topic.type_hash}
        self._channels[name] = self._file.add_channel(name, "cdr", self._schemas[topic.type_name], metadata)

    def _start_next_file(self, log_time_ns: int) -> None:
        # The new one first: where it cannot be made, the present one still takes scene and metadata.
        file = self._new_file()
        try:
            error = self._finish_file()
            if error is not None:
                raise error
        except OSError:
            file.close()
            file.path.unlink(missing_ok=True)
            raise
        self._file.close()
        self._use(file)
        self._file_start_ns = self._chunk_start_ns = log_time_ns
        repeated = {name: str(latched.sequence) for name, latched in self._latched.items()}
        self._file.add_metadata(CONTINUED_RECORD, repeated)
        for name, latched in self._latched.items():
            self._file.add_message(
                self._channels[name], latched.sequence, log_time_ns, latched.publish_time_ns, latched.payload
            )

    def _finish_file(self) -> OSError | None:
        """Gives the file its end and its name.

        Returns:
            Why the last of it had to be given back, where the disk was full.
        """
        if not self._is_open:
            return None
        given_back = None
        for is_last in (False, False, True):
            try:
                self._write_receive_times()
                self._file.close_chunk()
                counts = [self._file.counts.get(channel, 0) for channel in self._channels.values()]
                topics = [
                    replace(topic, message_count=count)
                    for topic, count in zip(self._topics.values(), counts, strict=True)
                ]
                path = self._file.path.with_suffix("")
                summary = FileSummary(path.name, *self._file.span_ns, sum(counts))
                text = information_text(bag_information([summary], topics))
                self._file.add_metadata(ROSBAG2_RECORD, {"serialized_metadata": text})
                self._file.finish()
                break
            except OSError as error:
                # A disk that others fill on and on must not cost the whole recording.
                if is_last or not self._file.make_room(error):
                    raise
                given_back = error
        self._file.path.replace(path)
        self._is_open = False
        self._files.append(summary)
        for topic in topics:
            count = self._topics[topic.name].message_count + topic.message_count
            self._topics[topic.name] = replace(topic, message_count=count)
        return given_back

    def _note_reception(self, topic_name: str, sequence: int, receive_time_ns: int) -> None:
        if not len(self._receive_times):
            self._batch_start_ns = receive_time_ns
        self._receive_times.add(topic_name, sequence, receive_time_ns)
        age_ns = abs(receive_time_ns - self._batch_start_ns)
        if age_ns >= _RECEIVE_PERIOD_NS or len(self._receive_times) >= BATCH_LIMIT:
            try:
                self._write_receive_times()
            except OSError as error:
                self._give_back(error)
                raise

    def _write_receive_times(self) -> None:
        if len(self._receive_times):
            self._file.add_metadata(RECEIVE_TIMES_RECORD, self._receive_times.take())


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
