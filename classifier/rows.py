"""Rows of results on disk by key: what is there is not computed again, a line that was cut short is."""

import json
from pathlib import Path
from typing import Any

Row = dict[str, Any]


class Rows:
    """A file of JSON lines, each with the ``key`` of its row.

    Args:
        path: made with the first row.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._rows: dict[str, Row] = {}
        if not path.is_file():
            return
        whole = path.read_bytes().rpartition(b"\n")[0]
        for line in whole.splitlines():
            try:
                row = json.loads(line)
                self._rows[row.pop("key")] = row
            except (ValueError, KeyError, AttributeError):
                continue
        if path.stat().st_size > len(whole) + 1:
            path.write_bytes(whole + b"\n" if whole else b"")

    def __contains__(self, key: str) -> bool:
        return key in self._rows

    def __getitem__(self, key: str) -> Row:
        return self._rows[key]

    def add(self, key: str, row: Row) -> None:
        """Takes a row and has it on disk."""
        self._path.parent.mkdir(parents=True, exist_ok=True)
        with self._path.open("a", encoding="utf-8") as file:
            file.write(json.dumps({"key": key, **row}, allow_nan=False) + "\n")
        self._rows[key] = row
