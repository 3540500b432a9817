"""Damage of every kind, from seeds: the reader gives the intact messages or one line with the byte; never else.

``python -m tests.recordings.test_fuzz_bags FIRST LAST`` tries other seeds.
"""

import shutil
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import pytest

from config.errors import BrokenRecording
from recordings.bag_reader import BagMessage, BagReader
from tests.recordings.conftest import write_sample_bag
from tests.recordings.damage import KINDS, account, hurt, read, recovered, without_checksums

CASES = 500
SLOWEST_S = 5.0


def read_damaged(folder: Path, content: bytes, whole: list[BagMessage], seeds: range) -> Counter[str]:
    """How often damage was refused, by kind; every other reading gives what was written."""
    refused: Counter[str] = Counter()
    for kind, path, _ in hurt(folder, content, seeds):
        began_s = time.monotonic()
        found = account(path)
        assert time.monotonic() - began_s < SLOWEST_S, (kind, path.name)
        if isinstance(found, str):
            assert "byte" in found or "not an MCAP file" in found or "is empty" in found, found
            assert "\n" not in found
            refused[kind] += 1
        else:
            assert found == whole, (kind, path.name)
    return refused


def recover_damaged(folder: Path, content: bytes, whole: list[BagMessage], seeds: range) -> float:
    """The share of all messages that is recovered; none of them is another than was written."""
    kept = 0
    for kind, path, _ in hurt(folder, content, seeds):
        recovery = recovered(path, folder / "out")
        if recovery is None:
            continue
        with BagReader(folder / "out") as bag:
            bag.verify()
            messages = list(bag.messages())
        shutil.rmtree(folder / "out")
        assert len(messages) == recovery.message_count
        # Names that no checksum covers may be wrong, and that is said.
        if not recovery.unchecked_names:
            following = iter(whole)
            assert all(message in following for message in messages), (kind, path.name)
        kept += len(messages)
    return kept / len(whole) / len(seeds)


def read_unprotected(folder: Path, content: bytes, seeds: range) -> None:
    """Damage that no checksum hides reaches every parser: still messages or one line, in bounded time."""
    for kind, path, _ in hurt(folder, without_checksums(content), seeds):
        began_s = time.monotonic()
        found = account(path)
        assert time.monotonic() - began_s < SLOWEST_S, (kind, path.name)
        assert not isinstance(found, str) or "\n" not in found


def test_damage_is_refused_with_its_place_or_does_no_harm(
    tmp_path: Path, sample_bag: Path, mcap_bytes: bytes
) -> None:
    refused = read_damaged(tmp_path, mcap_bytes, read(sample_bag), range(CASES))
    assert set(refused) == set(KINDS)
    assert sum(refused.values()) > 0.9 * CASES


def test_what_is_recovered_from_damage_was_written(
    tmp_path: Path, sample_bag: Path, mcap_bytes: bytes
) -> None:
    # Many of them cut the file anywhere, or hit its first chunk, which names the topics.
    assert recover_damaged(tmp_path, mcap_bytes, read(sample_bag), range(40)) > 0.8


def test_a_file_without_checksums_cannot_crash_the_reader(tmp_path: Path, mcap_bytes: bytes) -> None:
    read_unprotected(tmp_path, mcap_bytes, range(1000, 1000 + CASES // 2))


def test_verify_finds_what_reading_does_not_look_at(tmp_path: Path, mcap_bytes: bytes) -> None:
    for kind, path, data in hurt(tmp_path, mcap_bytes, range(2000, 2060)):
        if data == mcap_bytes:
            continue
        with pytest.raises(BrokenRecording), BagReader(path) as bag:
            bag.verify()
            pytest.fail(f"{kind} {path.name} was not found")


def main(first: int, last: int) -> None:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        bag = write_sample_bag(folder / "sample")
        content, whole = (bag / "sample_0.mcap").read_bytes(), read(bag)
        refused = read_damaged(folder, content, whole, range(first, last))
        read_unprotected(folder, content, range(first, last))
        share = recover_damaged(folder, content, whole, range(first, last))
        sys.stdout.write(f"refused {dict(refused)}\nrecovered {share:.1%}\n")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:3]))
