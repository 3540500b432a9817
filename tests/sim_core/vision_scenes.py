"""A small load for the tests of the measurement."""

from typing import Any

from config.scene import Scene
from config.scene_file import validate_scene


def stack_scene(*, level_g: float = 0.6, friction: float = 0.4, **camera: Any) -> Scene:
    """Six cartons on a pallet, two wide and three high, that slide and tilt at 0.6 g; 960 by 540 pixels."""
    size = (0.4, 0.3, 0.25)
    packages = [
        {
            "id": f"{column}{layer}",
            "size_m": size,
            "mass_kg": 8,
            "position_m": [x, -0.25, 0.27 + 0.251 * layer],
        }
        for column, x in (("a", -0.205), ("b", 0.205))
        for layer in range(3)
    ]
    return validate_scene(
        {
            "name": "stack",
            "load": {"packages": packages},
            "surfaces": {
                "pairs": [
                    {"between": ["cardboard", "cardboard"], "friction": friction},
                    {"between": ["cardboard", "wood"], "friction": friction},
                ]
            },
            "sled": {"profile": "eumos", "level_g": level_g, "plateau_s": 0.3, "deceleration_g": 0.5},
            "solver": {"engine": "mujoco"},
            "camera": {"width_px": 960, "height_px": 540, **camera},
        }
    )
