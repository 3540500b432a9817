"""Building blocks of the stress scenes: boxes, piles and sled profiles as raw scene parts."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from config.scene import Scene
from config.scene_file import resolve_scene, validate_scene
from sim_core.frames import GRAVITY

Raw = dict[str, Any]
Size = tuple[float, float, float]

CARTON: Size = (0.4, 0.3, 0.25)
FLAT: Size = (0.6, 0.4, 0.1)
"""Too flat to tip below 4 g."""


def box(
    name: str,
    size_m: Size,
    mass_kg: float,
    *,
    x: float = 0.0,
    y: float = 0.0,
    base_m: float = 0.0,
    **more: Any,
) -> Raw:
    """A package by the height of its base [m]."""
    return {
        "id": name,
        "size_m": list(size_m),
        "mass_kg": mass_kg,
        "position_m": [x, y, base_m + size_m[2] / 2.0],
        **more,
    }


def column(sizes_m: Sequence[Size], masses_kg: Sequence[float]) -> list[Raw]:
    """Boxes on top of each other, bottom first."""
    boxes, base = [], 0.0
    for number, (size, mass) in enumerate(zip(sizes_m, masses_kg, strict=True), start=1):
        boxes.append(box(f"box_{number}", size, mass, base_m=base))
        base += size[2]
    return boxes


def block_of(counts: tuple[int, int, int], size_m: Size, mass_kg: float, *, gap_m: float) -> list[Raw]:
    """A block of like boxes in columns, with gaps between the columns."""
    return [
        box(
            f"{k + 1}-{j + 1}-{i + 1}", size_m, mass_kg,
            x=(i - (counts[0] - 1) / 2.0) * (size_m[0] + gap_m),
            y=(j - (counts[1] - 1) / 2.0) * (size_m[1] + gap_m),
            base_m=k * size_m[2], layer=k + 1,
        )
        for k in range(counts[2])
        for j in range(counts[1])
        for i in range(counts[0])
    ]  # fmt: skip


def trapezoid(level_g: float, *, rise_s: float = 0.05, hold_s: float = 0.5, direction: Any = "+x") -> Raw:
    """0 -> level -> 0, then the sled coasts."""
    a, end = level_g * GRAVITY, 2.0 * rise_s + hold_s
    return {
        "profile": "table",
        "times_s": [0.0, rise_s, rise_s + hold_s, end],
        "acceleration_mps2": [0.0, a, a, 0.0],
        "direction": direction,
    }


def still(duration_s: float) -> Raw:
    """A sled that stands for a while."""
    return {"profile": "table", "times_s": [0.0, duration_s], "acceleration_mps2": [0.0, 0.0]}


def scene_of(
    name: str,
    boxes: Sequence[Raw],
    sled: Raw,
    *,
    engine: str,
    friction: float = 0.5,
    pairs: Mapping[tuple[str, str], float] | None = None,
    solver: Raw | None = None,
    **parts: Any,
) -> Scene:
    """A resolved scene of boxes that stand on the sled itself.

    Args:
        name: the scene's name.
        boxes: packages as raw parts.
        sled: the profile as a raw part.
        engine: rigid engine.
        friction: of packages on the sled and on each other.
        pairs: friction by pair of surfaces, in place of ``friction``.
        solver: further solver settings.
        parts: further parts of the scene, as they are.

    Raises:
        RefusedInput: the scene's own checks refuse it.
    """
    table = pairs or {("cardboard", "sled"): friction, ("cardboard", "cardboard"): friction}
    raw = {
        "name": name,
        "load": {"packages": list(boxes)},
        "pallet": None,
        "surfaces": {"pairs": [{"between": list(pair), "friction": value} for pair, value in table.items()]},
        "sled": sled,
        "solver": {"engine": engine, **(solver or {})},
        **parts,
    }
    return resolve_scene(validate_scene(raw), Path())
