"""What of a scene can be fitted: friction of a pair of surfaces, force fields, film; with bounds and usual steps."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from config.errors import RefusedInput
from config.scene import Scene
from config.scene_file import friction_table, validate_scene

FRICTION = "friction"


@dataclass(frozen=True)
class _Usual:
    lower: float
    upper: float
    step: float
    is_scale: bool


# A scale is fitted by its logarithm, and its step is a share.
_USUAL = {
    FRICTION: _Usual(0.05, 1.0, 0.01, False),
    "force_fields.tension": _Usual(0.02, 50.0, 0.05, True),
    "force_fields.height_spread_m": _Usual(0.05, 5.0, 0.05, True),
    "force_fields.distance_m": _Usual(0.01, 0.5, 0.05, True),
    "force_fields.falloff": _Usual(0.5, 6.0, 0.1, False),
    "wrap.wrap_force_n": _Usual(1.0, 200.0, 0.05, True),
    "wrap.pre_stretch": _Usual(0.2, 3.5, 0.05, True),
    "wrap.relaxation": _Usual(0.0, 0.9, 0.05, False),
    "wrap.friction": _Usual(0.05, 1.5, 0.03, False),
    "wrap.turns": _Usual(0.5, 30.0, 0.05, True),
}
FITTED_KEYS = ("friction:A/B", *(key for key in _USUAL if key != FRICTION))
"""What may be named; A and B are surfaces."""


@dataclass(frozen=True)
class Parameter:
    """A value of a scene that is fitted.

    Attributes:
        key: ``friction:A/B``, or a dotted path into the scene.
        lower: least value looked at.
        upper: greatest value looked at.
        step: over which derivatives are taken, in the fit's own measure.
        is_scale: fitted by its logarithm.
    """

    key: str
    lower: float
    upper: float
    step: float
    is_scale: bool = False

    @property
    def bounds(self) -> tuple[float, float]:
        """Both bounds in the fit's own measure."""
        return self.fit_value(self.lower), self.fit_value(self.upper)

    def fit_value(self, value: float) -> float:
        """A value in the fit's own measure, brought into the bounds."""
        held = min(max(value, self.lower), self.upper)
        return math.log(held) if self.is_scale else held

    def value(self, x: float) -> float:
        """What a number of the fit stands for."""
        return math.exp(x) if self.is_scale else x

    def applied(self, scene: Scene, value: float) -> Scene:
        """The scene with this value.

        Raises:
            RefusedInput: the scene refuses it.
        """
        raw = scene.model_dump()
        if self.surfaces is not None:
            pairs = [pair for pair in raw["surfaces"]["pairs"] if set(pair["between"]) != set(self.surfaces)]
            raw["surfaces"] = {"pairs": [*pairs, {"between": self.surfaces, "friction": value}]}
        else:
            part, name = self.key.split(".")
            if raw[part] is None:
                raise RefusedInput(self.key, "missing", f"the scene has no {part}")
            raw[part][name] = value
        return validate_scene(raw)

    def read(self, scene: Scene) -> float | None:
        """The scene's own value; None where it leaves it to others, or has turns by height."""
        if self.surfaces is not None:
            for pair in scene.surfaces.pairs:
                if set(pair.between) == set(self.surfaces):
                    return pair.friction
            return friction_table(scene).get(frozenset(self.surfaces))
        part, name = self.key.split(".")
        value: Any = getattr(getattr(scene, part), name, None)
        return float(value) if isinstance(value, int | float) else None

    @property
    def surfaces(self) -> tuple[str, str] | None:
        """The two surfaces of a friction, or None."""
        kind, _, names = self.key.partition(":")
        if kind != FRICTION:
            return None
        one, _, other = names.partition("/")
        return one, other


def parameter_of(text: str, scene: Scene) -> Parameter:
    """The parameter that a text names: a key, with its own bounds where it says so, as in ``KEY=0.2..0.6``.

    Raises:
        RefusedInput: no such parameter, or it is not in the scene; bounds that are none.
    """
    key, equals, span = text.partition("=")
    kind, _, names = key.partition(":")
    usual = _USUAL.get(kind if kind == FRICTION else key)
    if usual is None or (kind == FRICTION) != bool(names):
        raise RefusedInput("--fit", key, f"must be one of {', '.join(FITTED_KEYS)}")
    lower, upper = _bounds(text, span) if equals else (usual.lower, usual.upper)
    parameter = Parameter(key, lower, upper, usual.step, usual.is_scale)
    if kind == FRICTION:
        _require_surfaces(parameter, scene)
    elif getattr(scene, key.split(".")[0]) is None:
        raise RefusedInput("--fit", key, f"the scene has no {key.split('.')[0]}")
    elif (not usual.is_scale and lower < usual.lower - 1.0e-12) or (usual.is_scale and lower <= 0.0):
        raise RefusedInput("--fit", text, f"bounds must not begin below {usual.lower:g}")
    return parameter


def usual_parameters(scene: Scene) -> list[Parameter]:
    """What is fitted where nobody says: film where there is one, else T and σ_h, else the load's own frictions.

    Args:
        scene: a resolved scene.

    Raises:
        RefusedInput: the scene has nothing of it.
    """
    if scene.is_held_by_film:
        return [parameter_of("wrap.wrap_force_n", scene)]
    if scene.force_fields is not None:
        return [parameter_of(f"force_fields.{name}", scene) for name in ("tension", "height_spread_m")]
    return [parameter_of(f"{FRICTION}:{one}/{other}", scene) for one, other in _touching(scene)]


def _touching(scene: Scene) -> Sequence[tuple[str, str]]:
    """Pairs of surfaces that rest on each other, in order of height."""
    from sim_core.integrity import supports

    pallet = scene.pallet_box
    grounds = {-1: pallet.surface if pallet is not None else "sled", -2: "sled"}
    found: dict[frozenset[str], tuple[str, str]] = {}
    for support in supports(scene):
        above = scene.packages[support.package].surface
        below = grounds.get(support.below) or scene.packages[support.below].surface
        found.setdefault(frozenset((above, below)), (below, above))
    if not found:
        raise RefusedInput("--fit", "nothing", "the scene has no package that rests on anything")
    return list(found.values())


def _bounds(text: str, span: str) -> tuple[float, float]:
    low, dots, high = span.partition("..")
    try:
        lower, upper = float(low), float(high)
    except ValueError:
        lower = upper = math.nan
    if not dots or not (math.isfinite(lower) and math.isfinite(upper) and lower < upper):
        raise RefusedInput("--fit", text, "must be KEY or KEY=LOWER..UPPER")
    return lower, upper


def _require_surfaces(parameter: Parameter, scene: Scene) -> None:
    assert parameter.surfaces is not None
    pallet = scene.pallet_box
    there = {package.surface for package in scene.packages} | {
        pallet.surface if pallet is not None else "sled"
    }
    for name in parameter.surfaces:
        if name not in there:
            raise RefusedInput(
                "--fit", parameter.key, f"no surface '{name}' here; there are: {', '.join(sorted(there))}"
            )
