"""Input that must be refused before the first step, by field, value and limit."""

import copy
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from config.scene import Scene
from config.scene_file import resolve_scene, validate_scene
from sim_core.stress.loads import CARTON, Raw, box, scene_of, trapezoid
from sim_core.stress.model import Judgement, StressRow, Trial

_GOOD: Raw = {
    "name": "input",
    "load": {"packages": [box("a", CARTON, 10.0)]},
    "pallet": None,
    "sled": trapezoid(0.3, hold_s=0.3),
}


def _with(change: Callable[[Raw], object], engine: str) -> list[Scene]:
    raw = copy.deepcopy(_GOOD)
    raw["solver"] = {"engine": engine}
    change(raw)
    return [resolve_scene(validate_scene(raw), Path())]


def _accepted(trials: Sequence[Trial]) -> Judgement:
    return Judgement(False, f"accepted; peak {1e3 * trials[0].peak_m():.4g} mm")


def _set(*path: Any, to: Any) -> Callable[[Raw], object]:
    def change(raw: Raw) -> None:
        node: Any = raw
        for key in path[:-1]:
            node = node[key]
        node[path[-1]] = to

    return change


_PACKAGE = ("load", "packages", 0)
_BAD: dict[str, tuple[str, Callable[[Raw], object]]] = {
    "nan_mass": ("a mass that is not a number", _set(*_PACKAGE, "mass_kg", to=math.nan)),
    "inf_size": ("an infinite edge", _set(*_PACKAGE, "size_m", 0, to=math.inf)),
    "nan_position": ("a position that is not a number", _set(*_PACKAGE, "position_m", 2, to=math.nan)),
    "inf_yaw": ("an infinite yaw", _set(*_PACKAGE, "yaw_deg", to=math.inf)),
    "negative_mass": ("a negative mass", _set(*_PACKAGE, "mass_kg", to=-10.0)),
    "zero_mass": ("a mass of zero", _set(*_PACKAGE, "mass_kg", to=0.0)),
    "zero_size": ("a box without a height", _set(*_PACKAGE, "size_m", 2, to=0.0)),
    "negative_size": ("a negative edge", _set(*_PACKAGE, "size_m", 0, to=-0.4)),
    "text_size": ("an edge in words", _set(*_PACKAGE, "size_m", 0, to="0.4 m")),
    "mm_for_m": ("sizes in millimetres", _set(*_PACKAGE, "size_m", to=[400.0, 300.0, 250.0])),
    "mm_position": ("a position in millimetres", _set(*_PACKAGE, "position_m", to=[600.0, 400.0, 125.0])),
    "missing_mass": ("a package without a mass", lambda raw: raw["load"]["packages"][0].pop("mass_kg")),
    "missing_sled": ("a scene without a sled", lambda raw: raw.pop("sled")),
    "unknown_key": ("a key that nobody knows", _set("levle_g", to=0.5)),
    "nan_level": ("an acceleration that is not a number", _set("sled", "acceleration_mps2", 1, to=math.nan)),
    "inf_time": ("an infinite time", _set("sled", "times_s", 3, to=math.inf)),
    "falling_times": ("times that fall", _set("sled", "times_s", to=[0.0, 0.3, 0.2, 0.4])),
    "1e6_level": ("an acceleration of 1e6 m/s²", _set("sled", "acceleration_mps2", 1, to=1.0e6)),
    "nan_tension": ("a tension that is not a number", _set("force_fields", to={"tension": math.nan})),
    "nan_friction": (
        "a friction that is not a number",
        _set("surfaces", to={"pairs": [{"between": ["cardboard", "sled"], "friction": math.nan}]}),
    ),
    "negative_friction": (
        "a negative friction",
        _set("surfaces", to={"pairs": [{"between": ["cardboard", "sled"], "friction": -0.3}]}),
    ),
    "not_a_load": ("a load that is a list", lambda raw: raw.update(load=[1, 2, 3])),
}


def _row(name: str) -> StressRow:
    title, change = _BAD[name]
    return StressRow(
        id=f"input_{name}",
        group="Input",
        title=title,
        expected="refused before the first step, by field, value and limit",
        scenes=lambda engine: _with(change, engine),
        judge=_accepted,
        may=("refused",),
        engines=("bullet",),
        quick=True,
    )


def _centimetres(engine: str) -> list[Scene]:
    # 9 mm taken for 9 m passes the limit of 10 m: only a warning can tell.
    size = (9.0, 8.0, 5.0)
    return [scene_of("slip_of_units", [box("a", size, 2.0)], trapezoid(0.3, hold_s=0.3), engine=engine)]


def _warned(trials: Sequence[Trial]) -> Judgement:
    told = [f for f in trials[0].finished.findings if f.severity == "warning"]
    return Judgement(bool(told), "; ".join(f"{f.check}: {f.limit}" for f in told) or "no warning")


INPUT_ROWS: tuple[StressRow, ...] = (
    *(_row(name) for name in _BAD),
    StressRow(
        "input_small_mm_for_m", "Input", "a box of 9 mm x 8 mm x 5 mm given as metres",
        "a warning asks for the unit: 10 m is the limit, so it cannot be refused",
        _centimetres, _warned, engines=("bullet",), quick=True,
    ),
)  # fmt: skip
"""The rows of this file."""
