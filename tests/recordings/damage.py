"""Damages recordings in every way that disks, copies and people do, from a seed; and a reader's account of one."""

import random
import struct
from collections.abc import Iterator
from pathlib import Path

from config.errors import BrokenRecording, RefusedInput
from recordings.bag_reader import BagMessage, BagReader
from recordings.rescue import Recovery, recover_bag

KINDS = ("flip", "flips", "cut", "zeros", "lost", "twice", "noise", "swap", "lengths")


def damaged(content: bytes, seed: int) -> tuple[str, bytes]:
    """The kind of damage and the bytes with it."""
    random_ = random.Random(seed)
    kind, data = KINDS[seed % len(KINDS)], bytearray(content)
    at = random_.randrange(len(data))
    size = min(random_.choice((1, 7, 64, 512, 4096)), len(data) - at)
    if kind == "flip":
        data[at] ^= 1 << random_.randrange(8)
    elif kind == "flips":
        for _ in range(random_.randrange(2, 20)):
            data[random_.randrange(len(data))] ^= 1 << random_.randrange(8)
    elif kind == "cut":
        del data[at:]
    elif kind == "zeros":
        data[at : at + size] = bytes(size)
    elif kind == "lost":
        del data[at : at + size]
    elif kind == "twice":
        data[at:at] = data[at : at + size]
    elif kind == "noise":
        data[at : at + size] = random_.randbytes(size)
    elif kind == "swap":
        other = random_.randrange(len(data) - size + 1)
        data[at : at + size], data[other : other + size] = data[other : other + size], data[at : at + size]
    else:
        # A number made huge, or negative where it is signed.
        data[at : at + 8] = struct.pack("<Q", random_.choice((2**63, 2**64 - 1, 2**40, 2**31, 2**32 - 1)))
    return kind, bytes(data)


def without_checksums(content: bytes) -> bytes:
    """The same file as a recorder writes it that computes none: damage reaches the parsers behind them."""
    data, at = bytearray(content), 8
    while at < len(data) - 8:
        opcode, length = struct.unpack_from("<BQ", data, at)
        if opcode == 0x06:
            data[at + 33 : at + 37] = bytes(4)
        elif opcode in (0x02, 0x09, 0x0F):
            data[at + 5 + length : at + 9 + length] = bytes(4)
        at += 9 + length
    return bytes(data)


def read(path: Path) -> list[BagMessage]:
    """Every message, and all else looked at."""
    with BagReader(path) as bag:
        messages = list(bag.messages())
        for name in bag.attachment_names:
            bag.attachment(name)
        for name in bag.metadata_names:
            bag.metadata(name)
        for name in bag.topics:
            bag.receive_times(name)
        return messages


def hurt(folder: Path, content: bytes, seeds: range) -> Iterator[tuple[str, Path, bytes]]:
    """A file for each seed, with the kind of its damage."""
    for seed in seeds:
        kind, data = damaged(content, seed)
        path = folder / f"{seed}.mcap"
        path.write_bytes(data)
        yield kind, path, data
        path.unlink()


def account(path: Path) -> list[BagMessage] | str:
    """What the reader gives, or the one line in which it refuses."""
    try:
        return read(path)
    except BrokenRecording as error:
        return str(error)


def recovered(path: Path, out: Path) -> Recovery | None:
    """What can be recovered, or None where nothing can."""
    try:
        return recover_bag(path, out)
    except RefusedInput as error:
        assert isinstance(error, BrokenRecording), error
        return None
