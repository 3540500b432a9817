"""rerun as a user runs it, and what a recording that it converted draws."""

import os
import subprocess
import sys
from pathlib import Path

from rerun.chunk import RrdReader


def rerun(tmp_path: Path, *arguments: str) -> str:
    # A home of its own: rerun keeps settings there, and sends nothing in the first session of a home.
    command = [str(Path(sys.executable).with_name("rerun")), *arguments]
    environment = {**os.environ, "HOME": str(tmp_path), "XDG_CONFIG_HOME": str(tmp_path), "NO_COLOR": "1"}
    run = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=60)
    assert run.returncode == 0, run.stderr
    return run.stdout


def drawn(recording: Path) -> tuple[dict[str, list[float]], dict[str, tuple[str, list[float]]]]:
    """Half sizes by frame, and by child frame its parent and its x in time."""
    sizes: dict[str, list[float]] = {}
    frames: dict[str, str] = {}
    transforms: dict[str, tuple[str, list[float]]] = {}
    for chunk in RrdReader(recording).stream().to_chunks():
        batch = chunk.to_record_batch()
        # Python's datetime, which pyarrow would make of the time columns, holds no nanoseconds.
        columns = {name: batch.column(name).to_pylist() for name in batch.schema.names if ":" in name}
        for size in columns.get("Boxes3D:half_sizes", ()):
            sizes[chunk.entity_path] = size[0]
        for frame in columns.get("CoordinateFrame:frame", ()):
            frames[chunk.entity_path] = frame[0]
        moves = ("Transform3D:child_frame", "Transform3D:parent_frame", "Transform3D:translation")
        for child, parent, translation in zip(*(columns.get(name, ()) for name in moves), strict=True):
            transforms.setdefault(child[0], (parent[0], []))[1].append(translation[0][0])
    return {frames[path]: size for path, size in sizes.items()}, transforms
