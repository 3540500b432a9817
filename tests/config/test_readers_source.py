"""Files that are no usable text, XML or JSON are refused in one line; content alone decides the format."""

import hashlib
import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from config.errors import RefusedInput
from config.readers import read_pattern

Refuse = Callable[[str | bytes], RefusedInput]


PATTERNS = Path(__file__).parents[2] / "config" / "patterns"
GOOD_NIST = (PATTERNS / "eur_columns.nist.xml").read_text(encoding="utf-8")
ENTITY_BOMB = (
    '<?xml version="1.0"?><!DOCTYPE l [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;">]>'
    "<Response>&b;</Response>"
)
EXTERNAL = '<!DOCTYPE r [<!ENTITY x SYSTEM "file:///etc/passwd">]><Response>&x;</Response>'
EXTERNAL_DTD = '<!DOCTYPE Response SYSTEM "http://example.invalid/a.dtd"><Response/>'


@pytest.mark.parametrize(
    ("content", "field", "said"),
    [
        ("", "file", "XML or JSON"),
        ("x,y,z\n1,2,3", "file", "XML or JSON"),
        (b"\xff\xfe<\x00a\x00", "file", "UTF-8"),
        (b"<Response>\xe9</Response>", "file", "UTF-8"),
        (GOOD_NIST[: len(GOOD_NIST) // 2], "XML", "not well-formed"),
        ("<Response>\x00</Response>", "XML", "not well-formed"),
        (ENTITY_BOMB, "XML", "no document type, entities"),
        (EXTERNAL, "XML", "no document type, entities"),
        (EXTERNAL_DTD, "XML", "no document type, entities"),
        ("<Pallet/>", "XML root", "orderDocument"),
        ("<orderDocument xmlns='http://elsewhere'/>", "XML root", "StackBuilder"),
        ("<Response>" + "<a>" * 100_000 + "</a>" * 100_000 + "</Response>", "XML", "at most 32"),
    ],
)
def test_unusable_text_and_xml(refuse: Refuse, content: str | bytes, field: str, said: str) -> None:
    error = refuse(content)
    assert error.field == field
    assert said in str(error)


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    for path, said in [(tmp_path / "none.xml", "no such file"), (tmp_path, "directory")]:
        with pytest.raises(RefusedInput, match=said):
            read_pattern(path)
    huge = tmp_path / "huge.xml"
    with huge.open("wb") as file:
        os.truncate(file.fileno(), 64 * 1024 * 1024 + 1)
    start = time.perf_counter()
    with pytest.raises(RefusedInput, match="at most 67108864 bytes"):
        read_pattern(huge)
    assert time.perf_counter() - start < 0.1  # refused by its size, unread


def test_absurd_tag_count_is_refused_before_parsing(refuse: Refuse) -> None:
    start = time.perf_counter()
    assert "at most 2000000" in str(refuse("<Response>" + "<a/>" * 2_000_000 + "</Response>"))
    assert time.perf_counter() - start < 2.0


def test_format_is_chosen_by_content_and_bytes_are_hashed(tmp_path: Path) -> None:
    shipped = {
        "nist": "eur_columns.nist.xml",
        "stackbuilder": "eur_columns.stackbuilder.xml",
        "pally": "eur_columns.pally.json",
    }
    for expected, name in shipped.items():
        path = tmp_path / "misleading.csv"
        # A byte-order mark, as Windows programs write it, changes the hash but not what is read.
        path.write_bytes(b"\xef\xbb\xbf" + (PATTERNS / name).read_bytes())
        file = read_pattern(path)
        assert file.format == expected
        assert file.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()


def test_importing_the_readers_loads_no_xml_library() -> None:
    code = (
        "import sys, config.readers; print(sorted({'xmlschema', 'defusedxml', 'numpy'} & set(sys.modules)))"
    )
    root = Path(__file__).parents[2]
    done = subprocess.run([sys.executable, "-c", code], cwd=root, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
