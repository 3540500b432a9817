"""Reads a bag that is whole, and says in one line what is wrong with one that is not."""

import struct
import zlib
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import IO, Any, Self

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile, McapError
from mcap.reader import SeekingReader
from mcap.records import Attachment, Channel, Footer, Metadata, Schema
from mcap.stream_reader import CRCValidationError, StreamReader
from mcap.summary import Summary
from mcap.writer import MCAP0_MAGIC

from config.errors import BrokenRecording
from msgs_adapters.topics import Topic, message_class
from recordings.bag_writer import UNFINISHED_SUFFIX
from recordings.rosbag2_metadata import METADATA_FILE, parse_qos, read_file_name

_CUT_SHORT = "was cut short: it has no end"
_FOOTER_BYTES = 1 + 8 + 8 + 8 + 4
_MAX_CHUNK_BYTES = 1 << 30
# What the parsers raise on bytes that make no sense.
_DAMAGE = (
    McapError,
    zstandard.ZstdError,
    struct.error,
    ValueError,
    LookupError,
    ArithmeticError,
    MemoryError,
)


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
    """An open recording: a rosbag2 directory or the MCAP file itself.

    Summary and index are checked when it is opened, each chunk when it is read, the whole file by `verify`.
    Memory holds one chunk at a time, and those that overlap it in time.

    Attributes:
        topics: by absolute name, in the order in which they were added.
        start_ns: log time of the first message [ns]; 0 when there is none.
        end_ns: log time of the last message [ns].

    Raises:
        BrokenRecording: it is no recording, is empty, was cut short or is damaged.
    """

    def __init__(self, path: Path) -> None:
        self.path = _mcap_file(Path(path))
        with self._reading():
            self._stream: IO[bytes] = self.path.open("rb")
        try:
            with self._reading():
                self._size = _check_ends(self.path, self._stream)
                _check_summary_crc(self._stream, self._size)
                self._stream.seek(0)
                self._reader = SeekingReader(self._stream, validate_crcs=True, record_size_limit=self._size)
                self._summary = self._checked_summary()
                self.topics: Mapping[str, RecordedTopic] = {
                    channel.topic: _recorded_topic(channel, self._summary)
                    for channel in self._summary.channels.values()
                }
        except BrokenRecording:
            self._stream.close()
            raise
        statistics = self._summary.statistics
        self.start_ns = statistics.message_start_time if statistics else 0
        self.end_ns = statistics.message_end_time if statistics else 0

    @property
    def message_count(self) -> int:
        """Messages of all topics."""
        return sum(topic.message_count for topic in self.topics.values())

    @property
    def attachment_names(self) -> list[str]:
        """Names of the attached files, in order."""
        return [index.name for index in self._summary.attachment_indexes]

    @property
    def metadata_names(self) -> list[str]:
        """Names of the metadata records, in order."""
        return [index.name for index in self._summary.metadata_indexes]

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
        return self._iterate(names, start_ns, end_ns)

    def attachment(self, name: str) -> bytes:
        """The attached file of that name; the last one if there are several.

        Raises:
            BrokenRecording: there is none, or it is damaged.
        """
        for index in reversed(self._summary.attachment_indexes):
            if index.name == name:
                with self._reading():
                    record = self._record_at(index.offset, index.length)
                    if not isinstance(record, Attachment) or record.name != name:
                        raise ValueError("the index points elsewhere")
                    return bytes(record.data)
        raise BrokenRecording("attachment", name, self._lacks(self.attachment_names))

    def metadata(self, name: str) -> dict[str, str]:
        """The metadata record of that name; the last one if there are several.

        Raises:
            BrokenRecording: there is none, or it is damaged.
        """
        for index in reversed(self._summary.metadata_indexes):
            if index.name == name:
                with self._reading():
                    record = self._record_at(index.offset, index.length)
                    if not isinstance(record, Metadata) or record.name != name:
                        raise ValueError("the index points elsewhere")
                    return dict(record.metadata)
        raise BrokenRecording("metadata", name, self._lacks(self.metadata_names))

    def verify(self) -> None:
        """Reads the whole file once and compares every checksum in it.

        Raises:
            BrokenRecording: something is damaged.
        """
        with self._reading():
            self._stream.seek(0)
            for _ in StreamReader(self._stream, validate_crcs=True, record_size_limit=self._size).records:
                pass

    def close(self) -> None:
        """Closes the file."""
        self._stream.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _iterate(self, names: list[str], start_ns: int | None, end_ns: int | None) -> Iterator[BagMessage]:
        # An own reader and stream position a call: two iterations may run side by side.
        with self._reading(), self.path.open("rb") as stream:
            reader = SeekingReader(stream, validate_crcs=True, record_size_limit=self._size)
            for _, channel, message in reader.iter_messages(
                names, starting_at=start_ns, ending_before=end_ns
            ):
                yield BagMessage(
                    channel.topic,
                    self.topics[channel.topic].topic.type_name,
                    message.data,
                    message.log_time,
                    message.publish_time,
                    message.sequence,
                )

    def _checked_summary(self) -> Summary:
        summary = self._reader.get_summary()
        if summary is None or summary.statistics is None:
            raise BrokenRecording("bag", str(self.path), "has no index")
        if len(summary.chunk_indexes) != summary.statistics.chunk_count:
            raise BrokenRecording("bag", str(self.path), "its index does not list every chunk")
        for chunk in summary.chunk_indexes:
            if chunk.uncompressed_size > _MAX_CHUNK_BYTES:
                limit = f"a chunk must not be larger than {_MAX_CHUNK_BYTES} bytes"
                raise BrokenRecording("bag.chunk", chunk.uncompressed_size, limit)
        return summary

    def _record_at(self, offset: int, length: int) -> Attachment | Metadata | object:
        """The record at an offset; an attachment's own checksum is compared, a metadata record has none."""
        self._stream.seek(offset)
        raw = self._stream.read(length)
        if raw and raw[0] == 0x09 and zlib.crc32(raw[9:-4]) != int.from_bytes(raw[-4:], "little") != 0:
            raise ValueError("its checksum does not match")
        self._stream.seek(offset)
        return next(StreamReader(self._stream, skip_magic=True, record_size_limit=self._size).records)

    def _lacks(self, names: Iterable[str]) -> str:
        return f"{self.path.name} has no such; it has: {', '.join(names) or 'none'}"

    @contextmanager
    def _reading(self) -> Iterator[None]:
        """Turns whatever a damaged file makes the parsers raise into one line."""
        try:
            yield
        except EndOfFile:
            raise BrokenRecording("bag", str(self.path), _CUT_SHORT) from None
        except CRCValidationError:
            raise BrokenRecording("bag", str(self.path), "is damaged: a checksum does not match") from None
        except OSError as error:
            raise BrokenRecording("bag", str(self.path), f"cannot be read: {error.strerror}") from None
        except _DAMAGE as error:
            raise BrokenRecording("bag", str(self.path), f"is damaged: {error}") from None


def _mcap_file(path: Path) -> Path:
    """The MCAP file that a user means by a directory or a file."""
    try:
        path.stat()
    except FileNotFoundError:
        raise BrokenRecording("bag", str(path), "does not exist") from None
    except OSError as error:
        raise BrokenRecording("bag", str(path), error.strerror or "cannot be read") from None
    if (path / METADATA_FILE).is_file():
        path = path / read_file_name(path / METADATA_FILE)
    if not path.exists():
        raise BrokenRecording("bag", str(path), "does not exist")
    if path.is_dir():
        unfinished = sorted(path.glob(f"*{UNFINISHED_SUFFIX}"))
        files = sorted(path.glob("*.mcap"))
        if len(files) == 1:
            return files[0]
        if unfinished:
            return _mcap_file(unfinished[0])
        raise BrokenRecording("bag", str(path), "is no recording: it holds no metadata.yaml and no one .mcap")
    if path.name.endswith(UNFINISHED_SUFFIX):
        raise BrokenRecording("bag", str(path), "was cut short: its writer did not finish it")
    return path


def _check_ends(path: Path, stream: IO[bytes]) -> int:
    """File size [bytes], once both ends look like those of an MCAP file."""
    size = stream.seek(0, 2)
    stream.seek(0)
    if size == 0:
        raise BrokenRecording("bag", str(path), "is empty")
    start = stream.read(len(MCAP0_MAGIC))
    if start != MCAP0_MAGIC[: len(start)]:
        raise BrokenRecording("bag", str(path), "is not an MCAP file")
    if size < 2 * len(MCAP0_MAGIC) + _FOOTER_BYTES:
        raise BrokenRecording("bag", str(path), _CUT_SHORT)
    stream.seek(-len(MCAP0_MAGIC), 2)
    if stream.read() != MCAP0_MAGIC:
        raise BrokenRecording("bag", str(path), _CUT_SHORT)
    return size


def _check_summary_crc(stream: IO[bytes], size: int) -> None:
    """Compares the summary's checksum, which the mcap library does not do for seekable files."""
    footer_start = size - len(MCAP0_MAGIC) - _FOOTER_BYTES
    stream.seek(footer_start + 9)
    footer = Footer.read(ReadDataStream(stream))
    if not footer.summary_crc or not footer.summary_start:
        return
    if footer.summary_start > footer_start:
        raise ValueError("its summary stands behind its end")
    stream.seek(footer.summary_start)
    # The checksum covers the footer too, except for itself.
    covered = stream.read(footer_start + _FOOTER_BYTES - 4 - footer.summary_start)
    if zlib.crc32(covered) != footer.summary_crc:
        raise ValueError("the checksum of its summary does not match")


def _recorded_topic(channel: Channel, summary: Summary) -> RecordedTopic:
    schema: Schema = summary.schemas[channel.schema_id]
    statistics = summary.statistics
    count = statistics.channel_message_counts.get(channel.id, 0) if statistics else 0
    qos = parse_qos(channel.metadata.get("offered_qos_profiles", ""))
    return RecordedTopic(
        Topic(channel.topic, schema.name, qos), channel.metadata.get("topic_type_hash", ""), count
    )
