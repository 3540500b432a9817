"""Writes one MCAP file in whole records: whatever ends it, disk full too, what was written stays readable."""

import errno
import fcntl
import os
import struct
import zlib
from collections import deque
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from mcap.writer import MCAP0_MAGIC

COMPRESSION_LEVEL = 1
"""zstd: 1 GB/s on a noisy 1080p picture where 3 gives 0.2 GB/s, and small messages grow by 2 % only (measured)."""
ROOM_BYTES = 128 * 1024
"""What is given back when the disk is full: room for index, scene, report and metadata.yaml."""

_HEAD = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<BQHIQQ")
_CHUNK = struct.Struct("<BQQQQII")
_MESSAGE_INDEX = struct.Struct("<BQHI")
_MESSAGE_FIELDS_BYTES = 22
_FULL = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}
_SUMMARY_OPCODES = {
    "chunks": Opcode.CHUNK_INDEX,
    "attachments": Opcode.ATTACHMENT_INDEX,
    "metadata": Opcode.METADATA_INDEX,
}


@dataclass(frozen=True)
class _Whole:
    """What the file is as a whole up to a byte.

    Attributes:
        end: that byte.
        crc: CRC-32 of all before it.
        indexes: how many index records there are, and how many bytes they take, by kind.
        counts: messages by channel.
        start_ns: log time of the first message [ns], None without any.
        end_ns: log time of the last message [ns].
    """

    end: int
    crc: int
    indexes: Mapping[str, tuple[int, int]]
    counts: Mapping[int, int]
    start_ns: int | None = None
    end_ns: int = 0


class McapFile:
    """An MCAP file that is being written.

    Every record goes to the operating system at once and whole, or not at all: a process that is killed
    leaves complete chunks, and so does a disk that is full.

    Args:
        path: made here; must not exist.
        profile: the header's.
        library: the header's.
        chunk_bytes: a chunk is closed when it is larger, before compression.

    Attributes:
        path: the file.

    Raises:
        OSError: the file cannot be made.
    """

    def __init__(self, path: Path, profile: str, library: str, *, chunk_bytes: int) -> None:
        self.path = path
        self._file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o666)
        # Held as long as the process lives, so that nobody repairs what is being recorded.
        with suppress(OSError):
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        self._chunk_bytes = chunk_bytes
        self._finished = False
        self._compressor = zstandard.ZstdCompressor(level=COMPRESSION_LEVEL)
        self._schemas: list[Schema] = []
        self._channels: list[Channel] = []
        self._index_bytes: dict[str, bytearray] = {kind: bytearray() for kind in _SUMMARY_OPCODES}
        self._whole = _Whole(0, 0, dict.fromkeys(_SUMMARY_OPCODES, (0, 0)), {})
        self._earlier: deque[_Whole] = deque(maxlen=512)
        self._pending: list[bytes] = []
        self._pending_bytes = 0
        self._entries: dict[int, list[int]] = {}
        try:
            self._append(MCAP0_MAGIC + _encoded(Header(profile, library)), self._whole)
        except OSError:
            self.close()
            path.unlink(missing_ok=True)
            raise

    @property
    def size(self) -> int:
        """Bytes written, and those of the chunk in progress before compression."""
        return self._whole.end + self._pending_bytes

    @property
    def is_chunk_empty(self) -> bool:
        """Whether the next message begins a chunk."""
        return not self._entries

    @property
    def counts(self) -> Mapping[int, int]:
        """Messages by channel, those in the chunk in progress aside."""
        return self._whole.counts

    @property
    def span_ns(self) -> tuple[int, int]:
        """Log times of the first and the last message on the disk [ns]; zeros without any."""
        return self._whole.start_ns or 0, self._whole.end_ns

    def add_schema(self, name: str, encoding: str, data: bytes) -> int:
        """Adds a schema and returns its id."""
        number = len(self._schemas) + 1
        schema = Schema(id=number, data=data, encoding=encoding, name=name)
        self._schemas.append(schema)
        self._hold(_encoded(schema))
        return number

    def add_channel(self, topic: str, encoding: str, schema: int, metadata: Mapping[str, str]) -> int:
        """Adds a channel and returns its id."""
        number = len(self._channels) + 1
        channel = Channel(number, topic, encoding, dict(metadata), schema)
        self._channels.append(channel)
        self._hold(_encoded(channel))
        return number

    def add_message(self, channel: int, sequence: int, log_ns: int, publish_ns: int, payload: bytes) -> None:
        """Adds a message to the chunk in progress, and closes that once it is large enough.

        Raises:
            OSError: the chunk could not be written; it is lost, and the file whole up to it.
        """
        length = _MESSAGE_FIELDS_BYTES + len(payload)
        entries = self._entries.setdefault(channel, [])
        entries += (log_ns, self._pending_bytes)
        self._hold(_MESSAGE.pack(Opcode.MESSAGE, length, channel, sequence & 0xFFFFFFFF, log_ns, publish_ns))
        self._hold(payload)
        if self._pending_bytes > self._chunk_bytes:
            self.close_chunk()

    def close_chunk(self) -> None:
        """Hands the chunk in progress to the operating system.

        Raises:
            OSError: it could not be written; it is lost, and the file whole up to it.
        """
        if os.fstat(self._file).st_nlink == 0:
            raise OSError(errno.ENOENT, "the file was deleted while it was recorded")
        if not self._entries:
            return
        content, entries = b"".join(self._pending), self._entries
        self._pending, self._pending_bytes, self._entries = [], 0, {}
        # Messages may stand in any order of time where another recorder's are copied.
        start_ns = min(min(times[::2]) for times in entries.values())
        end_ns = max(max(times[::2]) for times in entries.values())
        packed = self._compressor.compress(content)
        head = _CHUNK.pack(
            Opcode.CHUNK, 44 + len(packed), start_ns, end_ns, len(content), zlib.crc32(content), 4
        )
        chunk = b"".join((head, b"zstd", len(packed).to_bytes(8, "little"), packed))
        whole, offsets, indexes = self._whole, {}, []
        behind = whole.end + len(chunk)
        for channel, times in entries.items():
            offsets[channel] = behind
            size = 8 * len(times)
            indexes.append(_MESSAGE_INDEX.pack(Opcode.MESSAGE_INDEX, 6 + size, channel, size))
            indexes.append(struct.pack(f"<{len(times)}Q", *times))
            behind += 15 + size
        index = ChunkIndex(
            chunk_length=len(chunk),
            chunk_start_offset=whole.end,
            compression="zstd",
            compressed_size=len(packed),
            message_end_time=end_ns,
            message_index_length=behind - whole.end - len(chunk),
            message_index_offsets=offsets,
            message_start_time=start_ns,
            uncompressed_size=len(content),
        )
        counts = dict(whole.counts)
        for channel, times in entries.items():
            counts[channel] = counts.get(channel, 0) + len(times) // 2
        first_ns = start_ns if whole.start_ns is None else min(whole.start_ns, start_ns)
        after = replace(whole, counts=counts, start_ns=first_ns, end_ns=max(whole.end_ns, end_ns))
        self._append(b"".join((chunk, *indexes)), after, "chunks", index)

    def attach(self, name: str, media_type: str, data: bytes, *, log_ns: int, create_ns: int) -> None:
        """Adds a file, behind the chunk in progress.

        Raises:
            OSError: it could not be written, and the file is whole up to it.
        """
        self.close_chunk()
        record = _encoded(Attachment(create_ns, log_ns, name, media_type, data))
        offset, size = self._whole.end, len(data)
        index = AttachmentIndex(offset, len(record), log_ns, create_ns, size, name, media_type)
        self._append(record, self._whole, "attachments", index)

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Adds a record of names and texts, behind the chunk in progress.

        Raises:
            OSError: it could not be written, and the file is whole up to it.
        """
        self.close_chunk()
        record = _encoded(Metadata(name, dict(values)))
        index = MetadataIndex(self._whole.end, len(record), name)
        self._append(record, self._whole, "metadata", index)

    def make_room(self, error: OSError) -> bool:
        """Takes the last records away again where a write failed for lack of space, so that an index fits.

        Returns:
            False where the error is another one, or nothing is left to take.
        """
        if self._finished or error.errno not in _FULL:
            return False
        before = self._whole.end
        wanted = before - ROOM_BYTES - len(self._summary())
        while self._earlier and self._whole.end > wanted:
            self._whole = self._earlier.pop()
        for kind, (_, size) in self._whole.indexes.items():
            del self._index_bytes[kind][size:]
        os.ftruncate(self._file, self._whole.end)
        return self._whole.end < before

    def finish(self) -> None:
        """Writes the chunk in progress, summary and end, and sees them onto the disk.

        Raises:
            OSError: they could not be written, and the file is whole up to them.
        """
        self.close_chunk()
        self._append(_encoded(DataEnd(self._whole.crc)) + self._summary(), self._whole)
        os.fsync(self._file)
        self._finished = True

    def close(self) -> None:
        """Closes the file as it is; does nothing twice."""
        if self._file >= 0:
            os.close(self._file)
            self._file = -1

    def _hold(self, part: bytes) -> None:
        self._pending.append(part)
        self._pending_bytes += len(part)

    def _append(self, data: bytes, after: _Whole, kind: str = "", index: McapRecord | None = None) -> None:
        """Writes data that make the file whole again, or takes them back."""
        if self._finished:
            raise OSError(errno.EROFS, "the file has its end already")
        before, rest = self._whole, memoryview(data)
        try:
            while rest:
                rest = rest[os.pwrite(self._file, rest, before.end + len(data) - len(rest)) :]
        except OSError:
            os.ftruncate(self._file, before.end)
            raise
        if index is not None:
            self._index_bytes[kind] += _encoded(index)
            count = (after.indexes[kind][0] + 1, len(self._index_bytes[kind]))
            after = replace(after, indexes={**after.indexes, kind: count})
        if before.end:
            self._earlier.append(before)
        self._whole = replace(after, end=before.end + len(data), crc=zlib.crc32(data, before.crc))

    def _summary(self) -> bytes:
        """Everything behind the end of the data, where that will be written next."""
        start, whole = self._whole.end + len(_encoded(DataEnd(0))), self._whole
        statistics = Statistics(
            attachment_count=whole.indexes["attachments"][0],
            channel_count=len(self._channels),
            channel_message_counts=dict(whole.counts),
            chunk_count=whole.indexes["chunks"][0],
            message_count=sum(whole.counts.values()),
            message_end_time=whole.end_ns,
            message_start_time=whole.start_ns or 0,
            metadata_count=whole.indexes["metadata"][0],
            schema_count=len(self._schemas),
        )
        groups = [
            (Opcode.SCHEMA, b"".join(map(_encoded, self._schemas))),
            (Opcode.CHANNEL, b"".join(map(_encoded, self._channels))),
            (Opcode.STATISTICS, _encoded(statistics)),
            *((opcode, bytes(self._index_bytes[kind])) for kind, opcode in _SUMMARY_OPCODES.items()),
        ]
        summary, offsets = bytearray(), bytearray()
        for opcode, group in groups:
            if group:
                offsets += _encoded(SummaryOffset(opcode, start + len(summary), len(group)))
            summary += group
        offsets_start = start + len(summary)
        summary += offsets
        footer = _HEAD.pack(Opcode.FOOTER, 20) + struct.pack("<QQ", start, offsets_start)
        crc = zlib.crc32(footer, zlib.crc32(summary))
        return b"".join((summary, _encoded(Footer(start, offsets_start, crc)), MCAP0_MAGIC))


def is_being_written(path: Path) -> bool:
    """Whether an ``McapFile`` of a living process stands behind a path."""
    with path.open("rb") as stream:
        try:
            fcntl.flock(stream, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except OSError as error:
            # Some file systems know no locks: then nobody knows.
            return error.errno == errno.EWOULDBLOCK
    return False


def _encoded(record: McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    return bytes(builder.end())
