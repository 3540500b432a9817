"""Wrapped loads without a closed form: one that converges and two on which chance decides, and the cases of them."""

from collections.abc import Mapping
from functools import cache
from typing import Literal

from config.scene_file import find_scene, read_scene
from sim_core.accuracy.cases import Case, Quantity, RawScene, RunScene, cartons_scene
from sim_core.work_precision import AUTO_TOLERANCE_MM

Load = Literal["cartons", "interlocked", "mixed sizes"]

SHIPPED: Mapping[Load, str] = {"interlocked": "eur_interlocked", "mixed sizes": "mixed_sizes"}
FRICTIONS = {
    "pairs": [
        {"between": ["cardboard", "cardboard"], "friction": 0.6},
        {"between": ["cardboard", "wood"], "friction": 0.45},
    ]
}
"""One interface slides. Where all are equal all reach their limit at once, and no engine converges."""
WRAP = {"material": "stretch_film_20", "turns": {"bottom": 4, "middle": 2, "top": 3}}
LEVEL_G = 0.5
ON_CHANCE: tuple[Load, ...] = ("mixed sizes",)
"""Cases whose error is chance: they say which settings run at all, not how good those are."""


@cache
def _shipped_load(load: Load) -> RawScene:
    raw = read_scene(find_scene(SHIPPED[load])).model_dump(mode="json")
    return {**raw["load"]}


def wrapped_scene(load: Load = "cartons") -> RawScene:
    """A load on an EUR pallet in stretch film at 0.5 g: it slides on the pallet as a block until the film holds it.

    Args:
        load: 40 cartons in columns with gaps of 1 mm, or the load of a shipped scene.
    """
    base = cartons_scene(level_g=LEVEL_G)
    if load != "cartons":
        base["load"] = _shipped_load(load)
    return {**base, "name": case_name(load).replace(" ", "_"), "surfaces": FRICTIONS, "wrap": WRAP}


def case_name(load: Load) -> str:
    """The name of a wrapped load's case."""
    return f"wrapped {load}"


def wrapped_case(load: Load, reference_mm: float) -> Case:
    """A wrapped load as a case of the sweep over engines, steps and iterations, at the film's own defaults.

    Args:
        load: the load.
        reference_mm: its peak displacement from a run with a fine step and film tolerance on the same mesh [mm].
    """
    scene = wrapped_scene(load)

    def measure(run: RunScene) -> Mapping[str, float]:
        return {"peak": run(scene, None).peak_mm()}

    return Case(
        case_name(load), f"{load} in stretch film at 0.5 g slide on the pallet as a block until it holds them",
        "wrapped", scene, (Quantity("peak", reference_mm, "self-refined", "mm", AUTO_TOLERANCE_MM),), measure,
        is_smooth=load not in ON_CHANCE,
    )  # fmt: skip
