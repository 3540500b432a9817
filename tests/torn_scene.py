"""A wrapped load whose film tears."""

from typing import Any

# One turn of paper around two boxes that slide on their pallet, which tears it at the deck.
TORN: dict[str, Any] = {
    "name": "torn",
    "load": {
        "packages": [
            {"id": name, "size_m": [0.5, 0.5, 0.25], "mass_kg": 60.0, "position_m": [0.0, 0.0, height]}
            for name, height in (("low", 0.269), ("high", 0.519))
        ]
    },
    "pallet": {"size_m": [0.6, 0.6, 0.144], "mass_kg": 10.0, "surface": "wood"},
    "surfaces": {
        "pairs": [
            {"between": ["cardboard", "cardboard"], "friction": 0.6},
            {"between": ["cardboard", "wood"], "friction": 0.2},
        ]
    },
    "sled": {"profile": "eumos", "level_g": 0.8, "plateau_s": 0.3},
    "solver": {"engine": "mujoco"},
    "wrap": {"material": "kraft_80", "turns": 0.3, "spacing_m": 0.2},
}
