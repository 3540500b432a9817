"""From a campaign file to the scenes of its tests: what is drawn, and what is refused."""

import copy
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import qmc

from config.campaign import Campaign, CampaignLoad, Layout, Range, Restraint, Values
from config.errors import RefusedInput
from config.readers import choose_pallet, read_pattern
from config.scene import Scene
from config.scene_file import resolve_scene, set_value, validate_scene
from config.shipped import PATTERNS
from sim_core.integrity import require_integrity

LEAST_LAYERS = 4
"""Where a campaign doesn't say how many layers to take, it takes these or more."""
_CHUNK = 1024
Factors = dict[str, Any]


@dataclass(frozen=True)
class Draft:
    """One test that could be run.

    Attributes:
        number: of the draw; the same number is the same test, whatever else was drawn.
        factors: what was drawn, by column: ``scheme``, ``layers``, ``layout``, ``restraint``, ``mass_factor``,
            ``friction A/B`` and scene keys.
        scene: resolved and checked.
    """

    number: int
    factors: Factors
    scene: Scene


@dataclass(frozen=True)
class RefusedDraft:
    """A draw that makes no test: its number, what was drawn and the one line that says why not."""

    number: int
    factors: Factors
    reason: str


@dataclass(frozen=True)
class _Choice:
    """What a test is made of, before it is a scene."""

    load: CampaignLoad
    layers: int
    layout: Layout
    restraint: Restraint | None
    keys: Mapping[str, Any]
    friction: Mapping[str, float]
    mass_factor: float


class Drafts:
    """The tests of a campaign by their numbers.

    Args:
        campaign: the campaign.
        base: folder that its palletising files are looked for in, before the shipped ones.

    Raises:
        RefusedInput: none of its palletising files can be used, or a case names a load that is not there.

    Attributes:
        bad_loads: palletising files that cannot be used, each with the reason.
        count: how many draws there are at most, or None where there is no end.
    """

    def __init__(self, campaign: Campaign, base: Path) -> None:
        self.campaign = campaign
        self.bad_loads: dict[str, str] = {}
        self._read = cache(read_pattern)
        self._paths: dict[str, Path] = {}
        self._layers: dict[str, tuple[int, int]] = {}
        for load in campaign.loads:
            try:
                self._paths[load.file] = _find(load.file, base)
                self._layers[load.file] = self._layers_of(load)
            except RefusedInput as error:
                self.bad_loads[load.file] = f"{load.file}: {error}"
        if len(self.bad_loads) == len(campaign.loads):
            raise RefusedInput("loads", f"{len(campaign.loads)} files", next(iter(self.bad_loads.values())))
        self._points: list[np.ndarray[Any, Any]] = []
        self._sampler: qmc.QMCEngine | None = None
        self._listed = list(self._combinations()) if campaign.mode != "random" else []
        self.count = len(self._listed) if campaign.mode != "random" else None

    def factors(self, number: int) -> Factors:
        """What is drawn for a number from 0."""
        return self._factors(self._choice(number))

    def draft(self, number: int) -> Draft | RefusedDraft:
        """The test of a number from 0."""
        choice = self._choice(number)
        factors = self._factors(choice)
        bad = self.bad_loads.get(choice.load.file)
        if bad is not None:
            return RefusedDraft(number, factors, bad)
        try:
            return self._made(number, choice, factors)
        except RefusedInput as error:
            return RefusedDraft(number, factors, str(error))

    def _made(self, number: int, choice: _Choice, factors: Factors) -> Draft:
        try:
            scene = self._scene(number, choice)
        except RefusedInput as error:
            # In mixed loads a layer that is moved can leave the next one without support.
            if choice.layout == "as_filed" or error.field not in ("rotate_layers", "mirror_layers"):
                raise
            choice = _Choice(**{**vars(choice), "layout": "as_filed"})
            scene, factors = self._scene(number, choice), self._factors(choice)
        require_integrity(scene)
        return Draft(number, factors, scene)

    def _scene(self, number: int, choice: _Choice) -> Scene:
        campaign = self.campaign
        raw = copy.deepcopy(campaign.scene)
        raw["name"] = f"{campaign.name}-{number:05d}"
        rotated, mirrored = self._moved_layers(number, choice)
        raw["load"] = {
            **raw.get("load", {}),
            "file": str(self._paths[choice.load.file]),
            "pallet_number": choice.load.pallet_number,
            "layers": choice.layers,
            "rotate_layers": rotated,
            "mirror_layers": mirrored,
        }
        raw.setdefault("seed", (campaign.seed + number) % 2**32)
        for key, value in choice.keys.items():
            set_value(raw, key, copy.deepcopy(value), source="vary")
        if choice.friction:
            surfaces = raw.setdefault("surfaces", {})
            named = {frozenset(pair.split("/")): pair for pair in choice.friction}
            kept = [pair for pair in surfaces.get("pairs", []) if frozenset(pair["between"]) not in named]
            drawn = [{"between": pair.split("/"), "friction": mu} for pair, mu in choice.friction.items()]
            surfaces["pairs"] = kept + drawn
        scene = resolve_scene(validate_scene(raw), Path(), read=self._read)
        return _heavier(scene, choice.mass_factor) if choice.mass_factor != 1.0 else scene

    def _moved_layers(self, number: int, choice: _Choice) -> tuple[list[int], list[int]]:
        second = list(range(2, choice.layers + 1, 2))
        if choice.layout == "turned":
            return second, []
        if choice.layout == "mirrored":
            return [], second
        if choice.layout == "random":
            chance = np.random.default_rng((self.campaign.seed, number)).integers(0, 4, choice.layers)
            turned = [k + 1 for k, way in enumerate(chance) if way & 1]
            return turned, [k + 1 for k, way in enumerate(chance) if way & 2]
        return [], []

    def _factors(self, choice: _Choice) -> Factors:
        return {
            "scheme": choice.load.scheme_name,
            "layers": choice.layers,
            "layout": choice.layout,
            "restraint": choice.restraint.name if choice.restraint is not None else "",
            "mass_factor": choice.mass_factor,
            **{f"friction {pair}": mu for pair, mu in choice.friction.items()},
            **choice.keys,
        }

    def _layers_of(self, load: CampaignLoad) -> tuple[int, int]:
        pallet = choose_pallet(self._read(self._paths[load.file]), load.pallet_number)
        most = max((p.layer or 0 for p in pallet.packages if p.kind == "package"), default=0)
        fewest, wanted = load.layers if load.layers is not None else (min(LEAST_LAYERS, most), most)
        if not 1 <= fewest <= wanted <= most:
            raise RefusedInput(
                f"loads.{load.file}.layers", [fewest, wanted], f"within 1 to {most}, its layers"
            )
        return fewest, wanted

    def _choice(self, number: int) -> _Choice:
        return self._listed[number] if self.campaign.mode != "random" else self._drawn(number)

    def _drawn(self, number: int) -> _Choice:
        campaign = self.campaign
        shares = iter(self._point(number))
        load = _weighted(campaign.loads, next(shares))
        fewest, most = self._layers.get(load.file, (0, 0))
        layers = fewest + min(int(next(shares) * (most - fewest + 1)), most - fewest)
        layout = _picked(campaign.layouts, next(shares))
        keys = {key: _value(values, shares) for key, values in campaign.vary.items()}
        friction = {pair: float(_value(values, shares)) for pair, values in campaign.friction.items()}
        mass = float(_value(campaign.mass_factor, shares)) if campaign.mass_factor is not None else 1.0
        restraint = _weighted(campaign.restraints, next(shares)) if campaign.restraints else None
        for other in campaign.restraints:
            # Each restraint has dimensions of its own: what one draws is not what another would have drawn.
            drawn = {key: _value(values, shares) for key, values in other.vary.items()}
            keys |= drawn if other is restraint else {}
        return _Choice(load, layers, layout, restraint, keys, friction, mass)

    def _point(self, number: int) -> "np.ndarray[Any, Any]":
        if self._sampler is None:
            self._sampler = self._new_sampler()
        while number >= _CHUNK * len(self._points):
            self._points.append(self._sampler.random(_CHUNK))
        point: np.ndarray[Any, Any] = self._points[number // _CHUNK][number % _CHUNK]
        return point

    def _new_sampler(self) -> qmc.QMCEngine:
        campaign = self.campaign
        dimensions = 4 + sum(
            values.dimension if isinstance(values, Range) else 1 for _, values in campaign.all_values()
        )
        rng = np.random.default_rng(campaign.seed)
        if campaign.method == "sobol":
            return qmc.Sobol(dimensions, scramble=True, rng=rng)
        return qmc.LatinHypercube(dimensions, rng=rng)

    def _combinations(self) -> Iterator[_Choice]:
        campaign = self.campaign
        if campaign.mode == "list":
            yield from (self._case(index, dict(case)) for index, case in enumerate(campaign.cases))
            return
        for load in campaign.loads:
            fewest, most = self._layers.get(load.file, (0, 0))
            for layers, layout in product(range(fewest, most + 1), campaign.layouts):
                for restraint in campaign.restraints or (None,):
                    own = restraint.vary if restraint is not None else {}
                    for keys in _every({**campaign.vary, **own}):
                        for friction in _every(campaign.friction):
                            for mass in campaign.mass_factor or (1.0,):
                                yield _Choice(load, layers, layout, restraint, keys, friction, float(mass))  # type: ignore[arg-type]

    def _case(self, index: int, case: Factors) -> _Choice:
        campaign = self.campaign
        named = {load.scheme_name: load for load in campaign.loads}
        wanted = case.pop("load", campaign.loads[0].scheme_name)
        restraints = {restraint.name: restraint for restraint in campaign.restraints}
        held = case.pop("restraint", None)
        for what, name, known in (("load", wanted, named), ("restraint", held, restraints)):
            if name is not None and name not in known:
                raise RefusedInput(f"cases.{index}.{what}", name, f"one of {', '.join(known)}")
        load = named[wanted]
        layers = case.pop("layers", self._layers.get(load.file, (0, 0))[1])
        layout = case.pop("layout", campaign.layouts[0])
        mass = float(case.pop("mass_factor", 1.0))
        friction = {
            key.removeprefix("friction "): float(case.pop(key))
            for key in list(case)
            if key.startswith("friction ")
        }
        return _Choice(load, layers, layout, restraints.get(held) if held else None, case, friction, mass)


def flat(factors: Factors) -> dict[str, bool | int | float | str | None]:
    """Factors as a table holds them: what is no scalar becomes JSON."""
    return {
        key: value
        if value is None or isinstance(value, (bool, int, float, str))
        else json.dumps(value, separators=(",", ":"))
        for key, value in factors.items()
    }


def _find(file: str, base: Path) -> Path:
    return base / file if (base / file).is_file() else PATTERNS.find(file)


def _weighted(options: "tuple[Any, ...]", share: float) -> Any:
    sums = np.cumsum([option.weight for option in options])
    return options[min(int(np.searchsorted(sums, share * sums[-1], side="right")), len(options) - 1)]


def _picked(options: "tuple[Any, ...]", share: float) -> Any:
    return options[min(int(share * len(options)), len(options) - 1)]


def _value(values: Values, shares: "Iterator[float]") -> Any:
    if isinstance(values, Range):
        return values.at([next(shares) for _ in range(values.dimension)])
    return _picked(values, next(shares))


def _every(lists: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    return (dict(zip(lists, values, strict=True)) for values in product(*lists.values()))


def _heavier(scene: Scene, factor: float) -> Scene:
    packages = tuple(
        package.model_copy(update={"mass_kg": float(f"{factor * package.mass_kg:.6g}")})
        for package in scene.packages
    )
    return validate_scene(
        {
            **scene.model_dump(),
            "load": {**scene.load.model_dump(), "packages": [p.model_dump() for p in packages]},
        }
    )
