"""Reads one whole MCAP file by its index, and says at which byte it is damaged."""

import struct
import zlib
from bisect import bisect_left
from collections import Counter
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile
from mcap.opcode import Opcode
from mcap.reader import NonSeekingReader, SeekingReader
from mcap.records import Attachment, Channel, ChunkIndex, Footer, Metadata, Schema, Statistics
from mcap.summary import Summary
from mcap.writer import MCAP0_MAGIC

from config.errors import BrokenRecording
from recordings.mcap_records import (
    DAMAGE,
    HEAD,
    MOST_CHUNK_BYTES,
    DamagedRecord,
    RawMessage,
    RawRecord,
    chunk_content,
    chunk_span,
    is_magic,
    parsed,
    record_at,
    records_of_chunk,
)

FOOTER_BYTES = HEAD.size + 8 + 8 + 4
_CUT_SHORT = "was cut short: it has no end"
_DATA_END = struct.Struct("<I")


class McapSource:
    """One MCAP file, open for reading; its summary is checked when it is opened, each chunk when it is read.

    Attributes:
        path: the file.
        size: its size [bytes].
        summary: its schemas, channels and indexes.
        statistics: its counts and its first and last log time.

    Raises:
        BrokenRecording: it is no MCAP file, is empty, was cut short, has no index or is damaged.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        with reading(path):
            self._stream: IO[bytes] = path.open("rb")
        try:
            with reading(path, self._stream):
                self.size, self._summary_start = _checked_ends(path, self._stream)
                self._stream.seek(0)
                reader = SeekingReader(self._stream, validate_crcs=True, record_size_limit=self.size)
                self.summary = _checked_summary(path, reader.get_summary())
        except BrokenRecording:
            self._stream.close()
            raise
        statistics = self.summary.statistics
        assert statistics is not None
        self.statistics: Statistics = statistics

    @property
    def channels(self) -> Mapping[int, Channel]:
        """The file's channels by id."""
        channels: Mapping[int, Channel] = self.summary.channels
        return channels

    def schema_of(self, channel: Channel) -> Schema:
        """A channel's schema."""
        return self.summary.schemas[channel.schema_id]

    def messages(
        self, names: Collection[str], start_ns: int | None, end_ns: int | None
    ) -> Iterator[tuple[str, RawMessage]]:
        """Topic and message in log-time order, those of equal time in the order of the file.

        Memory holds one chunk, and those that overlap it in time.

        Args:
            names: topics.
            start_ns: nothing logged before this [ns].
            end_ns: nothing logged at or after this [ns].

        Raises:
            BrokenRecording: a chunk is damaged.
        """
        wanted = {key: channel.topic for key, channel in self.channels.items() if channel.topic in names}
        earliest, latest = start_ns if start_ns is not None else 0, end_ns if end_ns is not None else 1 << 64
        # An own stream position a call: two iterations may run side by side.
        with reading(self.path), self.path.open("rb") as stream, reading(self.path, stream):
            if not self.summary.chunk_indexes:
                yield from self._unchunked(stream, names, start_ns, end_ns)
                return
            chunks = sorted(self._chunks_with(wanted, earliest, latest), key=_place)
            held: list[tuple[tuple[int, int, int], RawMessage]] = []
            for number, chunk in enumerate(chunks):
                held += [
                    ((message.log_ns, chunk.chunk_start_offset, index), message)
                    for index, message in enumerate(self._messages_in(stream, chunk))
                    if message.channel in wanted and earliest <= message.log_ns < latest
                ]
                held.sort(key=lambda entry: entry[0])
                done = len(held)
                if number + 1 < len(chunks):
                    done = bisect_left(held, (*_place(chunks[number + 1]), -1), key=lambda entry: entry[0])
                for _, message in held[:done]:
                    yield wanted[message.channel], message
                del held[:done]

    def attachment(self, offset: int, name: str) -> bytes:
        """The attached file at an offset.

        Raises:
            BrokenRecording: it is damaged, or another one stands there.
        """
        with reading(self.path, self._stream):
            found = parsed(record_at(self._stream, offset, self.size), Attachment)
            if found.name != name:
                raise DamagedRecord(offset, "the index points elsewhere")
            return bytes(found.data)

    def metadata(self, offset: int, name: str) -> dict[str, str]:
        """The metadata record at an offset.

        Raises:
            BrokenRecording: it is damaged, or another one stands there.
        """
        with reading(self.path, self._stream):
            found = parsed(record_at(self._stream, offset, self.size), Metadata)
            if found.name != name:
                raise DamagedRecord(offset, "the index points elsewhere")
            return dict(found.metadata)

    def verify(self) -> None:
        """Reads the whole file once, and compares every checksum and every count in it.

        Raises:
            BrokenRecording: something is damaged.
        """
        counts: Counter[int] = Counter()
        with reading(self.path, self._stream):
            offset, crc = len(MCAP0_MAGIC), zlib.crc32(MCAP0_MAGIC)
            while True:
                record = record_at(self._stream, offset, self._summary_start)
                if record.opcode == Opcode.DATA_END:
                    break
                if record.opcode == Opcode.CHUNK:
                    for found in records_of_chunk(chunk_content(record), offset):
                        if isinstance(found, RawMessage):
                            counts[found.channel] += 1
                elif record.opcode == Opcode.MESSAGE:
                    counts[int.from_bytes(record.body[:2], "little")] += 1
                elif record.opcode == Opcode.ATTACHMENT:
                    parsed(record, Attachment)
                elif record.opcode == Opcode.METADATA:
                    parsed(record, Metadata)
                crc = zlib.crc32(record.body, zlib.crc32(HEAD.pack(record.opcode, len(record.body)), crc))
                offset = record.end
            (expected,) = _DATA_END.unpack_from(record.body)
            if record.end != self._summary_start:
                raise DamagedRecord(offset, "the data do not end where the index begins")
            if expected and expected != crc:
                raise DamagedRecord(offset, "the checksum of all data does not match")
            if counts != Counter(self.statistics.channel_message_counts):
                raise DamagedRecord(offset, "it does not hold the messages that its index counts")

    def close(self) -> None:
        """Closes the file."""
        self._stream.close()

    def _chunks_with(self, wanted: Collection[int], earliest: int, latest: int) -> Iterator[ChunkIndex]:
        for chunk in self.summary.chunk_indexes:
            channels = chunk.message_index_offsets
            if chunk.message_end_time < earliest or chunk.message_start_time >= latest:
                continue
            # Without a message index nobody knows what a chunk holds.
            if not channels or any(channel in wanted for channel in channels):
                yield chunk

    def _messages_in(self, stream: IO[bytes], chunk: ChunkIndex) -> Iterator[RawMessage]:
        offset = chunk.chunk_start_offset
        record = record_at(stream, offset, self.size)
        if record.opcode != Opcode.CHUNK or len(record.body) + HEAD.size != chunk.chunk_length:
            raise DamagedRecord(offset, "the index points to no chunk")
        if chunk_span(record) != (chunk.message_start_time, chunk.message_end_time):
            raise DamagedRecord(offset, "a chunk and its index contradict each other")
        for found in records_of_chunk(chunk_content(record), offset):
            if isinstance(found, RawMessage):
                if found.channel not in self.channels:
                    raise DamagedRecord(offset, f"channel {found.channel} is not in the index")
                yield found

    def _unchunked(
        self, stream: IO[bytes], names: Collection[str], start_ns: int | None, end_ns: int | None
    ) -> Iterator[tuple[str, RawMessage]]:
        """Other recorders may write without chunks, and then without an index of messages."""
        stream.seek(0)
        reader = NonSeekingReader(stream)
        for _, channel, message in reader.iter_messages(names, starting_at=start_ns, ending_before=end_ns):
            yield (
                channel.topic,
                RawMessage(
                    channel.id, message.sequence, message.log_time, message.publish_time, message.data
                ),
            )


@contextmanager
def reading(path: Path, stream: IO[bytes] | None = None) -> Iterator[None]:
    """Turns whatever a damaged file makes the parsers raise into one line with the byte they stood at."""
    try:
        yield
    except BrokenRecording:
        raise
    except DamagedRecord as error:
        raise BrokenRecording("bag", str(path), f"is damaged at byte {error.offset}: {error}") from None
    except EndOfFile:
        raise BrokenRecording("bag", str(path), _CUT_SHORT) from None
    except OSError as error:
        raise BrokenRecording("bag", str(path), f"cannot be read: {error.strerror}") from None
    except DAMAGE as error:
        at = f" at byte {stream.tell()}" if stream is not None and not stream.closed else ""
        raise BrokenRecording("bag", str(path), f"is damaged{at}: {error}") from None


def _place(chunk: ChunkIndex) -> tuple[int, int]:
    return chunk.message_start_time, chunk.chunk_start_offset


def _checked_ends(path: Path, stream: IO[bytes]) -> tuple[int, int]:
    """File size and where the summary begins [bytes], once both ends and the summary's checksum are right."""
    size = stream.seek(0, 2)
    stream.seek(0)
    if size == 0:
        raise BrokenRecording("bag", str(path), "is empty")
    start = stream.read(len(MCAP0_MAGIC))
    if start != MCAP0_MAGIC[: len(start)]:
        raise BrokenRecording("bag", str(path), "is not an MCAP file")
    footer_start = size - len(MCAP0_MAGIC) - FOOTER_BYTES
    if footer_start < len(MCAP0_MAGIC) or not is_magic(stream, size - len(MCAP0_MAGIC)):
        raise BrokenRecording("bag", str(path), f"{_CUT_SHORT} at byte {size}")
    # The mcap library does not compare the summary's checksum of seekable files.
    stream.seek(footer_start + HEAD.size)
    footer = Footer.read(ReadDataStream(stream))
    if not footer.summary_start:
        return size, footer_start
    if not len(MCAP0_MAGIC) <= footer.summary_start <= footer_start:
        raise DamagedRecord(footer_start, "its summary stands behind its end")
    stream.seek(footer.summary_start)
    # The checksum covers the footer too, except for itself.
    covered = stream.read(footer_start + FOOTER_BYTES - 4 - footer.summary_start)
    if footer.summary_crc and zlib.crc32(covered) != footer.summary_crc:
        raise DamagedRecord(footer.summary_start, "the checksum of its summary does not match")
    return size, footer.summary_start


def _checked_summary(path: Path, summary: Summary | None) -> Summary:
    if summary is None or summary.statistics is None:
        raise BrokenRecording("bag", str(path), "has no index")
    if len(summary.chunk_indexes) != summary.statistics.chunk_count:
        raise BrokenRecording("bag", str(path), "its index does not list every chunk")
    for channel in summary.channels.values():
        if channel.schema_id not in summary.schemas:
            raise BrokenRecording("bag", str(path), f"its index lacks the type of {channel.topic}")
    for chunk in summary.chunk_indexes:
        if chunk.uncompressed_size > MOST_CHUNK_BYTES:
            limit = f"a chunk must not be larger than {MOST_CHUNK_BYTES} bytes"
            raise BrokenRecording("bag.chunk", chunk.uncompressed_size, limit)
    return summary


__all__ = ["FOOTER_BYTES", "McapSource", "RawRecord", "reading"]
