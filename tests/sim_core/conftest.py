"""What the tests of the physics and the judge share: small loads, written as a scene file has them."""

from collections.abc import Callable
from typing import Any

import pytest

from config.scene import Scene
from config.scene_file import resolve_scene, validate_scene

DECK_M = 0.144


def _box(
    name: str, *, x: float = 0.0, y: float = 0.0, bottom: float = DECK_M, **other: Any
) -> dict[str, Any]:
    size = other.pop("size", (0.4, 0.3, 0.25))
    return {
        "id": name,
        "size_m": size,
        "mass_kg": other.pop("mass", 10.0),
        "position_m": (x, y, bottom + size[2] / 2.0),
        **other,
    }


def _scene(*packages: dict[str, Any], base: Any = None, **parts: Any) -> Scene:
    sled = parts.pop("sled", {"profile": "eumos", "level_g": 0.5})
    scene = validate_scene({"name": "load", "load": {"packages": packages}, "sled": sled, **parts})
    return resolve_scene(scene, base)


# Session-wide, so that hypothesis may use them in every example.
@pytest.fixture(scope="session")
def box() -> Callable[..., dict[str, Any]]:
    """A package by name, centre x and y, height of its bottom, ``size`` and ``mass``; on an EUR deck by default."""
    return _box


@pytest.fixture(scope="session")
def make_scene() -> Callable[..., Scene]:
    """A resolved scene of packages, on an EUR pallet at 0.5 g unless other parts are given."""
    return _scene
