"""The material library: surfaces, friction of surface pairs, pallet kinds and films, each with its source."""

import json
from functools import cache
from importlib.resources import files
from typing import Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator


class PalletKind(BaseModel):
    """A standard pallet: outer size [m], mass [kg], deck surface, safe load [kg], source."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    size_m: tuple[float, float, float]
    mass_kg: float
    surface: str
    safe_load_kg: float
    source: str


class LibraryPair(BaseModel):
    """Static friction of one pair of surfaces, with where the figure comes from."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    between: tuple[str, str]
    friction: float = Field(ge=0.0)
    source: str


class FilmKind(BaseModel):
    """A wrapping film or paper; ``config/wrap.py`` says how the figures are read.

    MD is the machine direction of the film on its roll, TD across it. Yield and break are those of the film on
    the roll, on its unstretched section; the moduli are those of the film as it lies around the load.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    described: str = Field(min_length=1, description="what it is, in some words")
    surface: str = Field(description="its surface, for friction")
    look: Literal["clear_film", "milky_film", "kraft"] = Field(description="how it is drawn")
    around: Literal["MD", "TD"] = Field(description="which direction runs around the load")
    gauge_m: float = Field(gt=0.0, le=1.0e-3, description="thickness on the roll [m]")
    density_kgpm3: float = Field(gt=0.0, description="density [kg/m³]")
    modulus_md_pa: float = Field(gt=0.0, description="secant modulus as laid, MD [Pa]")
    modulus_td_pa: float = Field(gt=0.0, description="secant modulus as laid, TD [Pa]")
    poisson: float = Field(ge=0.0, description="contraction in TD for a stretch in MD")
    yield_strain: float | None = Field(default=None, gt=0.0, description="absent: it doesn't yield")
    yield_stress_pa: float | None = Field(default=None, gt=0.0, description="yield stress [Pa]")
    break_stress_pa: float | None = Field(default=None, gt=0.0, description="only where it yields [Pa]")
    break_strain_md: float = Field(gt=0.0)
    break_strain_td: float = Field(gt=0.0)
    pre_stretch: float = Field(ge=0.0, description="usual elongation by the machine that stays, 2 is 200 %")
    wrap_force_n: float = Field(ge=0.0, description="usual tension of one layer of 500 mm when laid [N]")
    relaxation: float = Field(ge=0.0, le=1.0, description="share of the wrap force lost before the test")
    sources: dict[str, str] = Field(description="source of each figure, by its name")

    @model_validator(mode="after")
    def _figures_fit(self) -> Self:
        words = {"described", "surface", "look", "around", "sources"}
        figures = {name for name, value in self if name not in words and value is not None}
        if figures != set(self.sources):
            raise ValueError(f"figures and sources differ: {', '.join(sorted(figures ^ set(self.sources)))}")
        if len({self.yield_strain is None, self.yield_stress_pa is None, self.break_stress_pa is None}) > 1:
            raise ValueError("yield strain, yield stress and break stress stand together or not at all")
        if self.poisson**2 * self.modulus_td_pa >= self.modulus_md_pa:
            raise ValueError("poisson² must be less than modulus_md_pa / modulus_td_pa")
        return self

    @property
    def modulus_around_pa(self) -> float:
        """Modulus around the load [Pa]."""
        return self.modulus_md_pa if self.around == "MD" else self.modulus_td_pa

    @property
    def modulus_up_pa(self) -> float:
        """Modulus up its side [Pa]."""
        return self.modulus_td_pa if self.around == "MD" else self.modulus_md_pa

    @property
    def break_strain_around(self) -> float:
        """Break strain on the roll of the direction that runs around the load."""
        return self.break_strain_md if self.around == "MD" else self.break_strain_td

    @property
    def break_strain_up(self) -> float:
        """Break strain on the roll of the direction that runs up the load's side."""
        return self.break_strain_td if self.around == "MD" else self.break_strain_md


class MaterialLibrary(BaseModel):
    """Everything in ``materials.json``."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    surfaces: dict[str, str]
    pairs: tuple[LibraryPair, ...]
    pallets: dict[str, PalletKind]
    films: dict[str, FilmKind]

    @model_validator(mode="before")
    @classmethod
    def _spread_likeness(cls, raw: Any) -> Any:
        """A film that is ``like`` one above it says only what differs."""
        films: dict[str, dict[str, Any]] = {}
        for name, entry in raw["films"].items():
            own = dict(entry)
            model = films[own.pop("like")] if "like" in own else {}
            films[name] = {**model, **own, "sources": {**model.get("sources", {}), **own.get("sources", {})}}
        return {**raw, "films": films}

    def pair(self, first: str, second: str) -> LibraryPair | None:
        """The library's entry for two surfaces in either order, or None."""
        wanted = {first, second}
        return next((pair for pair in self.pairs if set(pair.between) == wanted), None)


@cache
def material_library() -> MaterialLibrary:
    """The shipped library, read once a process."""
    text = files("config").joinpath("materials.json").read_text(encoding="utf-8")
    return MaterialLibrary.model_validate(json.loads(text))
