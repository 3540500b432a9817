"""The material library: surfaces, friction of surface pairs and pallet kinds, each with its source."""

import json
from functools import cache
from importlib.resources import files

from pydantic import BaseModel, ConfigDict, Field


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


class MaterialLibrary(BaseModel):
    """Everything in ``materials.json``."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    surfaces: dict[str, str]
    pairs: tuple[LibraryPair, ...]
    pallets: dict[str, PalletKind]

    def pair(self, first: str, second: str) -> LibraryPair | None:
        """The library's entry for two surfaces in either order, or None."""
        wanted = {first, second}
        return next((pair for pair in self.pairs if set(pair.between) == wanted), None)


@cache
def material_library() -> MaterialLibrary:
    """The shipped library, read once a process."""
    text = files("config").joinpath("materials.json").read_text(encoding="utf-8")
    return MaterialLibrary.model_validate(json.loads(text))
