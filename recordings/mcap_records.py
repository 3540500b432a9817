"""Reads the records of an MCAP file one by one, sceptically: each error names the byte where it was found."""

import struct
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from io import BytesIO
from typing import IO, TypeVar

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    ChunkIndex,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
)
from mcap.writer import MCAP0_MAGIC

MOST_CHUNK_BYTES = 1 << 30
"""A chunk that says it is larger, decompressed, is refused: it would fill the memory."""
HEAD = struct.Struct("<BQ")
CHUNK_HEAD = struct.Struct("<QQQII")
_MESSAGE = struct.Struct("<HIQQ")
_PARSERS: dict[int, Callable[[ReadDataStream], McapRecord]] = {
    Opcode.HEADER: Header.read,
    Opcode.SCHEMA: Schema.read,
    Opcode.CHANNEL: Channel.read,
    Opcode.ATTACHMENT: Attachment.read,
    Opcode.METADATA: Metadata.read,
    Opcode.STATISTICS: Statistics.read,
    Opcode.CHUNK_INDEX: ChunkIndex.read,
    Opcode.ATTACHMENT_INDEX: AttachmentIndex.read,
    Opcode.METADATA_INDEX: MetadataIndex.read,
}
_SIZES: dict[int, int] = {Opcode.FOOTER: 20, Opcode.DATA_END: 4, Opcode.SUMMARY_OFFSET: 17}
_FIRST_PRIVATE_OPCODE = 0x80
# What the parsers raise on bytes that make no sense.
DAMAGE = (
    McapError,
    zstandard.ZstdError,
    struct.error,
    ValueError,
    LookupError,
    ArithmeticError,
    MemoryError,
    # lz4 reports everything with it.
    RuntimeError,
)
Parsed = TypeVar("Parsed", bound=McapRecord)


class DamagedRecord(ValueError):
    """Bytes that are not what their place in the file says.

    Attributes:
        offset: where in the file they stand [bytes].
        is_cut: the file ends there.
    """

    def __init__(self, offset: int, reason: str, *, is_cut: bool = False) -> None:
        super().__init__(reason)
        self.offset = offset
        self.is_cut = is_cut


@dataclass(frozen=True)
class RawRecord:
    """A record of a file: its first byte, its kind, what stands in it."""

    offset: int
    opcode: int
    body: bytes

    @property
    def end(self) -> int:
        """The byte behind it."""
        return self.offset + HEAD.size + len(self.body)


@dataclass(frozen=True)
class RawMessage:
    """A message of a chunk, unparsed; times in ns."""

    channel: int
    sequence: int
    log_ns: int
    publish_ns: int
    payload: bytes


def record_at(stream: IO[bytes], offset: int, size: int) -> RawRecord:
    """The record at an offset of a file of ``size`` bytes.

    Raises:
        DamagedRecord: the file ends in it, or before it.
    """
    stream.seek(offset)
    head = stream.read(HEAD.size)
    if len(head) < HEAD.size:
        raise DamagedRecord(offset, "ends in a record", is_cut=True)
    opcode, length = HEAD.unpack(head)
    if length > size - offset - HEAD.size:
        raise DamagedRecord(offset, "ends in a record, or its length is damaged", is_cut=True)
    body = stream.read(length)
    if len(body) < length:
        raise DamagedRecord(offset, "ends in a record", is_cut=True)
    return RawRecord(offset, opcode, body)


def parsed(record: RawRecord, kind: type[Parsed]) -> Parsed:
    """What a record says that is neither message nor chunk.

    Raises:
        DamagedRecord: it is of another kind, or makes no sense.
    """
    return _parsed(record.opcode, record.body, record.offset, kind)


def _parsed(opcode: int, body: bytes, offset: int, kind: type[Parsed]) -> Parsed:
    if opcode == Opcode.ATTACHMENT and zlib.crc32(body[:-4]) != int.from_bytes(body[-4:], "little") != 0:
        raise DamagedRecord(offset, "the checksum of an attachment does not match")
    stream = _ExactStream(body)
    try:
        value = _PARSERS[opcode](stream)
    except DAMAGE:
        raise DamagedRecord(offset, f"a record of kind {opcode} makes no sense") from None
    if not isinstance(value, kind):
        raise DamagedRecord(offset, f"a {kind.__name__} should stand there")
    return value


def chunk_span(record: RawRecord) -> tuple[int, int]:
    """Log times of a chunk's first and last message [ns], as its head says."""
    try:
        start_ns, end_ns, *_ = CHUNK_HEAD.unpack_from(record.body)
    except struct.error:
        raise DamagedRecord(record.offset, "a chunk is too short") from None
    return start_ns, end_ns


def chunk_content(record: RawRecord) -> bytes:
    """A chunk's records, decompressed, with their checksum compared.

    Raises:
        DamagedRecord: the chunk is damaged.
    """
    body, offset = record.body, record.offset
    try:
        _, _, size, crc, name_size = CHUNK_HEAD.unpack_from(body)
        start = CHUNK_HEAD.size + name_size + 8
        compression = body[CHUNK_HEAD.size : start - 8].decode()
        (packed_size,) = struct.unpack_from("<Q", body, start - 8)
        if packed_size != len(body) - start:
            raise DamagedRecord(offset, "the lengths of a chunk contradict each other")
        if size > MOST_CHUNK_BYTES:
            raise DamagedRecord(offset, f"a chunk must not be larger than {MOST_CHUNK_BYTES} bytes")
        content = _decompressed(body[start:], compression, size)
    except DamagedRecord:
        raise
    except DAMAGE as error:
        raise DamagedRecord(offset, f"a chunk cannot be decompressed: {error}") from None
    if len(content) != size:
        raise DamagedRecord(offset, "a chunk is not as large as it says")
    if crc and zlib.crc32(content) != crc:
        raise DamagedRecord(offset, "the checksum of a chunk does not match")
    return content


def _decompressed(data: bytes, compression: str, size: int) -> bytes:
    """Never more than ``size`` bytes and a few, whatever the data say."""
    if compression == "zstd":
        if zstandard.frame_content_size(data) > size:
            raise ValueError("it holds more than it says")
        return zstandard.ZstdDecompressor().decompress(data, max_output_size=max(size, 1))
    if compression == "lz4":
        # Other recorders' only; the twin writes zstd.
        import lz4.frame  # type: ignore[import-untyped]

        return bytes(lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=size + 1))
    if compression:
        raise ValueError(f"its compression {compression!r} is not known")
    return data


def records_of_chunk(content: bytes, offset: int) -> Iterator[RawMessage | Schema | Channel]:
    """Messages, schemas and channels of a chunk in order.

    Args:
        content: as `chunk_content` gives it.
        offset: where the chunk stands in the file, for errors.

    Raises:
        DamagedRecord: what stands there makes no sense.
    """
    at, end = 0, len(content)
    while at < end:
        start = at + HEAD.size
        if start > end:
            raise DamagedRecord(offset, "a chunk ends in a record")
        opcode, length = HEAD.unpack_from(content, at)
        at = start + length
        if at > end:
            raise DamagedRecord(offset, "a chunk ends in a record")
        if opcode == Opcode.MESSAGE:
            if length < _MESSAGE.size:
                raise DamagedRecord(offset, "a message is too short")
            channel, sequence, log_ns, publish_ns = _MESSAGE.unpack_from(content, start)
            yield RawMessage(channel, sequence, log_ns, publish_ns, content[start + _MESSAGE.size : at])
        elif opcode == Opcode.SCHEMA:
            yield _parsed(opcode, content[start:at], offset, Schema)
        elif opcode == Opcode.CHANNEL:
            yield _parsed(opcode, content[start:at], offset, Channel)


def index_entries(record: RawRecord) -> tuple[int, int]:
    """The channel of a message index and how many messages it lists.

    Raises:
        DamagedRecord: its lengths contradict each other.
    """
    if len(record.body) < 6:
        raise DamagedRecord(record.offset, "a message index is too short")
    channel, size = struct.unpack_from("<HI", record.body)
    if size % 16 or len(record.body) != 6 + size:
        raise DamagedRecord(record.offset, "the lengths of a message index contradict each other")
    return channel, size // 16


def require_sense(record: RawRecord) -> None:
    """Looks into any record but a chunk and a message.

    Raises:
        DamagedRecord: it makes no sense, or is of a kind that MCAP does not know.
    """
    if record.opcode == Opcode.MESSAGE_INDEX:
        index_entries(record)
    elif record.opcode in _PARSERS:
        parsed(record, McapRecord)
    elif record.opcode in _SIZES:
        if len(record.body) != _SIZES[record.opcode]:
            raise DamagedRecord(record.offset, f"a record of kind {record.opcode} has another size")
    elif record.opcode != Opcode.MESSAGE and record.opcode < _FIRST_PRIVATE_OPCODE:
        raise DamagedRecord(record.offset, "no record stands there")


def is_magic(stream: IO[bytes], offset: int) -> bool:
    """Whether the mark of an MCAP file stands at an offset."""
    stream.seek(offset)
    return bool(stream.read(len(MCAP0_MAGIC)) == MCAP0_MAGIC)


class _ExactStream(ReadDataStream):  # type: ignore[misc]
    """The library's stream gives less than it was asked for at the end; this one raises."""

    def __init__(self, data: bytes) -> None:
        super().__init__(BytesIO(data))

    def read(self, length: int) -> bytes:
        data = super().read(length)
        if len(data) != length:
            raise ValueError("too short")
        return bytes(data)
