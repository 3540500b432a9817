"""A campaign file: which tests are to be made, drawn from ranges, spread over a grid, or listed one by one."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import Discriminator, Field, Tag, ValidationError, model_validator

from config.part import Part
from config.scene_file import apply_override, read_json, refusal

Scalar = bool | int | float | str | None | list[Any] | dict[str, Any]
Number = float | tuple[float, ...]

LAYOUTS = ("as_filed", "turned", "mirrored", "random")
Layout = Literal["as_filed", "turned", "mirrored", "random"]


class Range(Part):
    """Numbers between two ends; vectors component by component."""

    low: Number = Field(alias="from")
    high: Number = Field(alias="to")
    scale: Literal["linear", "log"] = "linear"
    whole: bool = Field(default=False, description="whole numbers only, both ends included")
    digits: int = Field(default=4, ge=1, le=15, description="significant digits that are kept")

    @model_validator(mode="after")
    def _ends_fit(self) -> Self:
        if isinstance(self.low, tuple) != isinstance(self.high, tuple) or (
            isinstance(self.low, tuple) and isinstance(self.high, tuple) and len(self.low) != len(self.high)
        ):
            raise ValueError("from and to must both be numbers, or vectors of one length")
        ends = list(zip(_components(self.low), _components(self.high), strict=True))
        if any(low > high for low, high in ends):
            raise ValueError(f"from {self.low} must be at most to {self.high}")
        if self.scale == "log" and any(low <= 0.0 for low, _ in ends):
            raise ValueError(f"from {self.low} must be above 0 on a log scale")
        return self

    @property
    def dimension(self) -> int:
        """How many draws it takes."""
        return len(_components(self.low))

    def at(self, shares: Sequence[float]) -> Any:
        """The value so far up the range.

        Args:
            shares: one for each component, each in [0, 1).
        """
        found = [
            self._one(low, high, share)
            for low, high, share in zip(_components(self.low), _components(self.high), shares, strict=True)
        ]
        return found if isinstance(self.low, tuple) else found[0]

    def _one(self, low: float, high: float, share: float) -> float | int:
        if self.whole:
            return int(low) + min(int(share * (int(high) - int(low) + 1)), int(high) - int(low))
        value = (
            math.exp(math.log(low) + share * (math.log(high) - math.log(low)))
            if self.scale == "log"
            else low + share * (high - low)
        )
        return min(max(float(f"{value:.{self.digits}g}"), low), high)


Values = Annotated[
    Annotated[Range, Tag("range")] | Annotated[tuple[Scalar, ...], Field(min_length=1), Tag("list")],
    Discriminator(lambda value: "range" if isinstance(value, (dict, Range)) else "list"),
]
"""A list to choose from, or a range."""


class CampaignLoad(Part):
    """One palletising file, and how many of its layers are taken."""

    file: str = Field(min_length=1, description="shipped pattern, or path relative to the campaign file")
    scheme: str = Field(default="", description="name of its scheme in tables; absent: the file's")
    layers: tuple[int, int] | None = Field(
        default=None, description="fewest and most layers; absent: from 4 (or all, if fewer) to all"
    )
    pallet_number: int | None = Field(default=None, ge=0, description="needed where the file holds several")
    weight: float = Field(default=1.0, gt=0.0, le=1000.0, description="how often, beside the others")

    @property
    def scheme_name(self) -> str:
        """What tables call it."""
        return self.scheme or Path(self.file).name.split(".")[0]


class Restraint(Part):
    """One way to hold the load: scene keys with values to choose from."""

    name: str = Field(min_length=1, max_length=40)
    weight: float = Field(default=1.0, gt=0.0, le=1000.0)
    vary: dict[str, Values] = Field(default_factory=dict, description="scene keys such as wrap.turns.middle")


class Balance(Part):
    """Chooses tests so that about so many of them pass. What any test comes to is not touched."""

    success_share: float = Field(default=1.0 / 3.0, gt=0.0, lt=1.0)
    round: int = Field(
        default=100, ge=8, le=10_000, description="tests after which the next are chosen by what came out"
    )


class Campaign(Part):
    """Thousands of tests in one file.

    ``random`` draws ``tests`` of them; ``grid`` makes every combination of the lists; ``list`` makes ``cases``.
    """

    name: str = Field(min_length=1, max_length=80, pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]*$")
    description: str = ""
    mode: Literal["random", "grid", "list"] = "random"
    tests: int | None = Field(default=None, ge=1, le=1_000_000, description="how many are drawn")
    method: Literal["sobol", "latin_hypercube"] = "sobol"
    seed: int = Field(default=0, ge=0, le=2**32 - 1)
    scene: dict[str, Any] = Field(description="what all tests share: a scene without its load")
    loads: tuple[CampaignLoad, ...] = Field(min_length=1, max_length=1000)
    layouts: tuple[Layout, ...] = Field(
        default=("as_filed",),
        min_length=1,
        description="every second layer turned or mirrored, or each layer by chance",
    )
    vary: dict[str, Values] = Field(
        default_factory=dict, description="scene keys, such as sled.level_g, with values to choose from"
    )
    friction: dict[str, Values] = Field(
        default_factory=dict, description="of surface pairs, such as cardboard/wood"
    )
    mass_factor: Values | None = Field(default=None, description="of all packages' masses")
    restraints: tuple[Restraint, ...] = Field(default=(), max_length=100)
    cases: tuple[dict[str, Scalar], ...] = Field(
        default=(), max_length=1_000_000, description="of a list: each case's load, layers, layout and keys"
    )
    balance: Balance | None = None
    estimate: bool = Field(default=True, description="each test is run a second time for its error estimate")
    video: Literal["pictures", "recipe"] = Field(
        default="pictures",
        description="pictures in the bags, or poses alone, from which render draws the same ones",
    )
    disk_gb: float = Field(default=50.0, gt=0.0, le=1.0e6, description="most that the bags may take [GB]")

    @model_validator(mode="after")
    def _mode_has_what_it_needs(self) -> Self:
        if self.mode == "random" and self.tests is None:
            raise ValueError("tests must say how many are drawn")
        if self.mode != "random" and self.tests is not None:
            raise ValueError(f"tests must be absent: a {self.mode} says itself how many there are")
        if self.mode != "random" and self.balance is not None:
            raise ValueError(f"balance must be absent: a {self.mode} leaves nothing to choose")
        if (self.mode == "list") != bool(self.cases):
            raise ValueError("cases must hold the tests of a list, and of nothing else")
        if self.mode == "grid":
            for name, values in self.all_values():
                if isinstance(values, Range):
                    raise ValueError(f"{name} must be a list: a grid has no ranges")
            if "random" in self.layouts:
                raise ValueError("layouts must not hold random: a grid leaves nothing to chance")
        return self

    @model_validator(mode="after")
    def _names_stand_once(self) -> Self:
        for what, names in (
            ("loads", [load.scheme_name + "|" + load.file for load in self.loads]),
            ("restraints", [restraint.name for restraint in self.restraints]),
        ):
            twice = next((name for name in names if names.count(name) > 1), None)
            if twice is not None:
                raise ValueError(f"{what}: {twice.split('|')[0]} stands twice")
        for pair in self.friction:
            if len(pair.split("/")) != 2 or not all(pair.split("/")):
                raise ValueError(f"friction.{pair} must be two surfaces, such as cardboard/wood")
        return self

    def all_values(self) -> list[tuple[str, Values]]:
        """Every list and range with the place where it stands."""
        own = [(f"vary.{key}", values) for key, values in self.vary.items()]
        own += [(f"friction.{pair}", values) for pair, values in self.friction.items()]
        own += [("mass_factor", self.mass_factor)] if self.mass_factor is not None else []
        for restraint in self.restraints:
            own += [(f"restraints.{restraint.name}.{key}", values) for key, values in restraint.vary.items()]
        return own

    def to_json(self) -> str:
        """The campaign as compact JSON, the same bytes for the same campaign."""
        return self.model_dump_json(by_alias=True)


def _components(number: Number) -> tuple[float, ...]:
    return number if isinstance(number, tuple) else (number,)


def read_campaign(path: Path, overrides: Sequence[str] = ()) -> Campaign:
    """Reads a campaign file.

    Args:
        path: campaign JSON.
        overrides: ``key=value`` texts, as given to ``--set``.

    Raises:
        RefusedInput: the first value that cannot be used, by field, value and limit.
    """
    raw = read_json(path, "campaign")
    for override in overrides:
        apply_override(raw, override)
    return campaign_from_raw(raw)


def campaign_from_raw(raw: object) -> Campaign:
    """Builds the campaign model.

    Raises:
        RefusedInput: the first value that breaks the schema.
    """
    try:
        return Campaign.model_validate(raw)
    except ValidationError as error:
        raise refusal(error, "campaign") from None
