"""Checks a scene, a palletising file or a bag, whichever a file turns out to be."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from config.errors import RefusedInput
from config.scene import Scene
from recordings.recorded_sled import load_scene
from sim_core.integrity import Finding, check_integrity, deepest_overlaps

BAG_MAGIC = b"\x89MCAP0\r\n"


def check_file(name: str, overrides: Sequence[str]) -> tuple[list[Finding], dict[str, Any]]:
    """What is wrong with a file, and what is in it.

    Args:
        name: path, or the name of a shipped scene.
        overrides: ``key=value`` texts for a scene.

    Raises:
        RefusedInput: the file cannot be read at all.
    """
    path = Path(name)
    try:
        is_bag = path.is_dir() or _is_mcap(path)
    except OSError as error:
        raise RefusedInput("file", name, error.strerror or "cannot be read") from None
    if is_bag:
        return _check_bag(path)
    scene = load_scene(name, overrides)
    return check_integrity(scene), _facts(scene)


def _is_mcap(path: Path) -> bool:
    if path.suffix in (".mcap", ".part"):
        return True
    if not path.is_file():
        return False
    with path.open("rb") as stream:
        return stream.read(len(BAG_MAGIC)) == BAG_MAGIC


def _facts(scene: Scene) -> dict[str, Any]:
    overlaps = deepest_overlaps(scene.packages)
    return {
        "name": scene.name,
        "package_count": len(scene.packages),
        "mass_kg": sum(package.mass_kg for package in scene.packages),
        "height_m": max((p.position_m[2] + p.size_m[2] / 2.0 for p in scene.packages), default=0.0),
        "deepest_overlap_mm": 1000.0 * overlaps[0][0] if overlaps else 0.0,
        "scene_sha256": scene.sha256,
        "notes": list(source.notes) if (source := getattr(scene.load, "source", None)) is not None else [],
        "packages": [package.model_dump() for package in scene.packages],
    }


def _check_bag(path: Path) -> tuple[list[Finding], dict[str, Any]]:
    from recordings.bag_reader import BagReader

    with BagReader(path) as reader:
        reader.verify()
        findings = [
            Finding("warning", "recording", key.removeprefix("missing "), f"{value} messages missing", "none")
            for name in reader.metadata_names
            for key, value in reader.metadata(name).items()
            if key.startswith("missing ")
        ]
        return findings, {
            "bag": str(reader.path),
            "messages": reader.message_count,
            "duration_s": (reader.end_ns - reader.start_ns) / 1.0e9,
            "attachments": ", ".join(reader.attachment_names) or "none",
            **{name: topic.message_count for name, topic in reader.topics.items()},
        }
