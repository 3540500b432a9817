"""Segments that nobody uses are removed, and no others."""

import mmap
import os
from pathlib import Path

from ros_nodes.shared_memory import remove_orphans


def test_only_what_nobody_uses_goes(tmp_path: Path) -> None:
    for name in (
        "fastrtps_a",
        "fastrtps_a_el",
        "fastrtps_b",
        "fastrtps_b_el",
        "fastrtps_c",
        "sem.fastrtps_c_mutex",
    ):
        (tmp_path / name).write_bytes(b"x" * 64)
        os.utime(tmp_path / name, (1.0, 1.0))
    (tmp_path / "fastrtps_new").write_bytes(b"x")
    (tmp_path / "another").write_bytes(b"x")
    with (tmp_path / "fastrtps_a_el").open("rb"), (tmp_path / "fastrtps_b").open("rb") as stream:
        mapped = mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ)
        assert remove_orphans(tmp_path) == ["fastrtps_c", "sem.fastrtps_c_mutex"]
        mapped.close()
    assert remove_orphans(tmp_path) == ["fastrtps_a", "fastrtps_a_el", "fastrtps_b", "fastrtps_b_el"]
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["another", "fastrtps_new"]


def test_no_folder_is_no_error(tmp_path: Path) -> None:
    assert remove_orphans(tmp_path / "none") == []
