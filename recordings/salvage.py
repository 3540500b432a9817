"""Reads what is whole in a damaged MCAP file, and says which bytes are not."""

import mmap
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO

from mcap.opcode import Opcode
from mcap.writer import MCAP0_MAGIC

from recordings.mcap_records import (
    CHUNK_HEAD,
    HEAD,
    DamagedRecord,
    RawRecord,
    chunk_content,
    is_magic,
    record_at,
    require_sense,
)

_LAST_OPCODE = 0x0F
# Where a search for the next record may end: what stands inside a chunk too could be a piece of a broken one.
_LANDMARK = re.compile(rb"[\x02\x06-\x0f][\s\S]{5}\0\0\0")


@dataclass(frozen=True)
class Damage:
    """Bytes of a file that are no records.

    Attributes:
        file: the file.
        offset: where they begin [bytes].
        size: how many there are.
        reason: what is wrong with them.
        is_end: nothing comes behind them.
        span_ns: log times of the first and last message there [ns], where a chunk's head still says them.
    """

    file: Path
    offset: int
    size: int
    reason: str
    is_end: bool
    span_ns: tuple[int, int] | None


def salvage(path: Path) -> Iterator[tuple[RawRecord, bytes] | Damage]:
    """Every record of a file that is whole, a chunk with its content, and what is between them.

    Chunks and attachments are held against their checksums; a record whose length makes no sense is followed
    by a search for the next one that does.

    Raises:
        OSError: the file cannot be read.
    """
    size = path.stat().st_size
    if size == 0:
        return
    with path.open("rb") as stream, mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as content:
        offset = len(MCAP0_MAGIC) if content[: len(MCAP0_MAGIC)] == MCAP0_MAGIC else 0
        while offset < size:
            end: int | None = None
            try:
                record = record_at(stream, offset, size)
                end = record.end
                yield record, _checked(record)
            except DamagedRecord as error:
                if end is None or not _is_head(content, end):
                    end = _next_record(stream, content, offset + 1)
                span_ns = _span_ns(content, offset)
                yield Damage(path, offset, end - offset, str(error), end == size, span_ns)
            else:
                if record.opcode == Opcode.FOOTER and is_magic(stream, end):
                    return
                # A file that is cut exactly between two records has no end either.
                if end == size:
                    yield Damage(path, size, 0, "it has no end", True, None)
            offset = end


def _checked(record: RawRecord) -> bytes:
    """A chunk's content, nothing for other records."""
    if record.opcode == Opcode.CHUNK:
        return chunk_content(record)
    require_sense(record)
    return b""


def _is_head(content: mmap.mmap, offset: int) -> bool:
    """Whether a record, or the end of the file, may begin at an offset."""
    rest = len(content) - offset
    if rest <= len(MCAP0_MAGIC):
        return rest == 0 or bool(content[offset:] == MCAP0_MAGIC)
    if rest < HEAD.size:
        return False
    opcode, length = HEAD.unpack_from(content, offset)
    return bool(1 <= opcode <= _LAST_OPCODE and length <= rest - HEAD.size)


def _next_record(stream: IO[bytes], content: mmap.mmap, start: int) -> int:
    """Where the next whole record begins, or the file ends."""
    while (found := _LANDMARK.search(content, start)) is not None:
        start = found.start()
        if _is_head(content, start):
            try:
                record = record_at(stream, start, len(content))
                _checked(record)
                if record.opcode == Opcode.CHUNK or _is_head(content, record.end):
                    return start
            except DamagedRecord:
                pass
        start += 1
    return len(content)


def _span_ns(content: mmap.mmap, offset: int) -> tuple[int, int] | None:
    if content[offset] != Opcode.CHUNK or offset + HEAD.size + CHUNK_HEAD.size > len(content):
        return None
    start_ns, end_ns, *_ = CHUNK_HEAD.unpack_from(content, offset + HEAD.size)
    return (start_ns, end_ns) if start_ns <= end_ns else None
