"""What is wound around a load: the film, how a machine lays it, and what one layer of it does in figures.

How stretch film is read. The machine draws the film from the roll to n = 1 + pre_stretch times its length, which
stays: the film yields. It then lays it around the load at the wrap force, and part of that is lost by
relaxation before the test. What the load feels is a film with these figures, for one layer and a metre of width:

    thickness         t   = t0 / n                  the width is held between close rollers
    stiffness         E·t                           E of the drawn film, around the load or up its side
    tension           T   = F/0.5 m · (1 − r)       F the wrap force of 500 mm of web, r the relaxation
    elastic strain    ε   = T / (E·t)               what is left of the stretch, from the tension-free film
    drawing force     F_y = s(pre_stretch) · t0     the film gives way again where the machine had stopped

s is the stress on the unstretched section, a straight line from the yield point to the break point of the film
on the roll. It gives 13 MPa at 200 %, inside the 10 to 20 MPa that a patent on pre-stretched film claims for
200 to 300 % (trea.com, "Outer wrapping film"). Past F_y the film follows that line to its end: it breaks at the
stress σ_b on the unstretched section, which is at the strain F_y/(E·t) + (ε_b − pre_stretch)/n. Across the
drawing direction it keeps yield and break of the film on the roll, at thickness t. A film without a yield point,
such as paper, is straight up to its break and cannot be pre-stretched.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal

from pydantic import Discriminator, Field, Tag, ValidationInfo, field_validator, model_validator

from config.errors import RefusedInput
from config.materials import FilmKind, material_library
from config.part import Part

FORCE_WIDTH_M = 0.5
"""Wrap forces are those of this width of one layer: the common web."""

DEFAULT_SPACING_M, LEAST_SPACING_M, LEAST_ROWS = 0.1, 0.02, 8

TurnCount = Annotated[float, Field(ge=0.0, le=200.0, strict=True)]


class Turns(Part):
    """The turns of a machine program: some at the foot, passes from end to end, some at the head."""

    bottom: TurnCount = Field(default=0.0, description="full turns with the web at the lower edge")
    middle: TurnCount = Field(
        default=0.0, description="passes of the web from one end to the other, each 1/(1 - overlap) layers"
    )
    top: TurnCount = Field(default=0.0, description="full turns with the web at the upper edge")

    @model_validator(mode="before")
    @classmethod
    def _say_something(cls, raw: Any) -> Any:
        if raw == {}:
            raise ValueError("must be a number of layers, or name bottom, middle or top")
        return raw


def _turns_kind(value: Any) -> str:
    # Tags with a bracket don't show in the path of a refusal.
    return "[by height]" if isinstance(value, (dict, Turns)) else "[everywhere]"


class Wrap(Part):
    """Film around the load. Nothing but the film and its turns has to be said."""

    material: str = Field(description="a film of the material library, such as stretch_film_20")
    turns: Annotated[
        Annotated[TurnCount, Tag("[everywhere]")] | Annotated[Turns, Tag("[by height]")],
        Discriminator(_turns_kind),
    ] = Field(description="layers everywhere, or a machine's turns by height; 0 is no wrap")
    overlap: float = Field(
        default=0.5,
        ge=0.0,
        le=0.95,
        strict=True,
        description="share of the web that lies on the turn before, while it passes up or down",
    )
    web_width_m: float = Field(default=0.5, ge=0.05, le=3.0, strict=True, description="width of the roll [m]")
    pre_stretch: float | None = Field(
        default=None,
        ge=0.0,
        strict=True,
        description="elongation by the machine that stays, 2 is 200 %; else the film's usual one",
    )
    wrap_force_n: float | None = Field(
        default=None,
        ge=0.0,
        strict=True,
        description="tension of one layer of 500 mm when it is laid [N]; else the film's usual one",
    )
    relaxation: float | None = Field(
        default=None,
        ge=0.0,
        le=1.0,
        strict=True,
        description="share of the wrap force lost before the test; else the film's usual one",
    )
    height_m: float | None = Field(
        default=None,
        gt=0.0,
        le=10.0,
        strict=True,
        description="upper edge above the pallet's deck (or the sled) [m]; else the top of the load",
    )
    pallet_overlap_m: float = Field(
        default=0.1,
        ge=0.0,
        le=1.0,
        strict=True,
        description="how far the film goes down over the pallet [m]; 0: it doesn't hold the pallet",
    )
    top_overlap_m: float = Field(
        default=0.0,
        ge=0.0,
        le=2.0,
        strict=True,
        description="how far it is folded over the top of the load [m]; the fold holds nothing down",
    )
    coupling: Literal["two_way", "one_way"] = Field(
        default="two_way",
        description="one_way: the film follows the load and is watched, but does not hold it",
    )
    friction: float | None = Field(
        default=None,
        ge=0.0,
        le=10.0,
        strict=True,
        description="of the film on all that it touches; else from surfaces.pairs and the material library",
    )
    spacing_m: float | None = Field(
        default=None,
        ge=0.005,
        le=1.0,
        strict=True,
        description="spacing of the film's mesh [m]; else chosen by the tolerance",
    )
    tear: bool = Field(default=True, strict=True, description="the film tears beyond its break strain")

    @field_validator("material")
    @classmethod
    def _film_is_known(cls, material: str) -> str:
        films = material_library().films
        if material not in films:
            raise ValueError(f"unknown film; known: {', '.join(sorted(films))}")
        return material

    @field_validator("pre_stretch")
    @classmethod
    def _film_bears_the_pre_stretch(cls, pre_stretch: float | None, info: ValidationInfo) -> float | None:
        name = info.data.get("material")
        if pre_stretch is None or name is None:
            return pre_stretch
        kind = material_library().films[name]
        if kind.yield_stress_pa is None and pre_stretch > 0.0:
            raise ValueError(f"must be 0: {name} does not yield")
        if pre_stretch >= kind.break_strain_around:
            percent = "; is it given in percent?" if pre_stretch >= 10.0 else ""
            raise ValueError(
                f"must be less than {kind.break_strain_around:g}, the break strain of {name}{percent}"
            )
        return pre_stretch

    @field_validator("wrap_force_n")
    @classmethod
    def _film_bears_the_force(cls, force: float | None, info: ValidationInfo) -> float | None:
        # A pre_stretch that was refused is not in the data; one that was left out is, as None.
        if force is None or info.data.get("material") is None or "pre_stretch" not in info.data:
            return force
        kind = material_library().films[info.data["material"]]
        stretched = kind.pre_stretch if info.data["pre_stretch"] is None else info.data["pre_stretch"]
        law = _law_around(kind, stretched)
        most = FORCE_WIDTH_M * min(law.yield_force_npm, law.break_force_npm)
        if force > most:
            what = "breaks" if math.isinf(law.yield_force_npm) else "is drawn further"
            raise ValueError(f"must be at most {most:.4g} N, where 500 mm of {kind.described} {what}")
        return force

    @property
    def is_wound(self) -> bool:
        """Whether there is any film at all."""
        turns = self.turns
        return (turns.bottom + turns.middle + turns.top if isinstance(turns, Turns) else turns) > 0.0


@dataclass(frozen=True)
class FilmLaw:
    """Force against strain of one layer in one direction, for a metre of width, from the tension-free film.

    Straight with ``stiffness`` up to ``yield_force``, then straight with ``hardening`` times it, up to the break.

    Attributes:
        stiffness_npm: E·t [N/m].
        yield_force_npm: where the film begins to be drawn [N/m], infinite for a film that doesn't yield.
        hardening: slope after the yield over the slope before, 0 to 1.
        break_strain: strain at which the film tears.
    """

    stiffness_npm: float
    yield_force_npm: float
    hardening: float
    break_strain: float

    @property
    def break_force_npm(self) -> float:
        """Force at the break strain [N/m]."""
        elastic = self.stiffness_npm * self.break_strain
        if elastic <= self.yield_force_npm:
            return elastic
        return self.yield_force_npm + self.hardening * (elastic - self.yield_force_npm)


@dataclass(frozen=True)
class FilmProperties:
    """One layer of the film as it lies around the load, in SI units; see the module for the formulas.

    Direction 1 runs around the load, direction 2 up its side.

    Attributes:
        material: name in the library.
        thickness_m: of one layer as laid [m].
        around: law around the load.
        up: law up its side.
        poisson: ν12, contraction up for a stretch around; ν21 = ν12 · E2/E1.
        shear_npm: G·t [N/m].
        tension_npm: around the load, left after relaxation [N/m].
        mass_kgpm2: mass of one layer [kg/m²].
        friction: Coulomb friction of the film by the surface that it lies on.
        look: how it is drawn.
    """

    material: str
    thickness_m: float
    around: FilmLaw
    up: FilmLaw
    poisson: float
    shear_npm: float
    tension_npm: float
    mass_kgpm2: float
    friction: Mapping[str, float]
    look: str

    @property
    def strain(self) -> float:
        """Elastic strain around the load that is left after relaxation, from the tension-free film."""
        return self.tension_npm / self.around.stiffness_npm

    def friction_on(self, surface: str) -> float:
        """Friction of the film on a surface.

        Raises:
            RefusedInput: neither scene nor library names the pair.
        """
        if surface not in self.friction:
            raise RefusedInput("wrap.friction", f"{self.material} on {surface}", "is not known: set it")
        return self.friction[surface]


def film_properties(wrap: Wrap, *, named: Mapping[frozenset[str], float] | None = None) -> FilmProperties:
    """One layer of a wrap's film in figures.

    The shear modulus is Huber's estimate G = √(E1·E2) / (2·(1 + √(ν12·ν21))) for an orthotropic sheet; for
    paper, with √(ν12·ν21) = 0.293, it is the known G = 0.387·√(E1·E2) (Baum, Brennan, Habeger 1981).

    Args:
        wrap: the wrap; its overrides come before the library.
        named: friction of pairs of surfaces that comes before the library's, keyed by the pair.
    """
    library = material_library()
    kind = library.films[wrap.material]
    pre_stretch = kind.pre_stretch if wrap.pre_stretch is None else wrap.pre_stretch
    force = kind.wrap_force_n if wrap.wrap_force_n is None else wrap.wrap_force_n
    relaxation = kind.relaxation if wrap.relaxation is None else wrap.relaxation
    thickness = kind.gauge_m / (1.0 + pre_stretch)
    one, two = kind.modulus_around_pa, kind.modulus_up_pa
    poisson = kind.poisson if kind.around == "MD" else kind.poisson * one / two
    shear = math.sqrt(one * two) / (2.0 * (1.0 + poisson * math.sqrt(two / one)))
    known = {frozenset(pair.between): pair.friction for pair in library.pairs} | dict(named or {})
    friction = {
        surface: known[frozenset((kind.surface, surface))] if wrap.friction is None else wrap.friction
        for surface in sorted({*library.surfaces, *(name for pair in known for name in pair)})
        if wrap.friction is not None or frozenset((kind.surface, surface)) in known
    }
    return FilmProperties(
        material=wrap.material,
        thickness_m=thickness,
        around=_law_around(kind, pre_stretch),
        up=_law(kind, two, kind.break_strain_up, thickness=thickness, drawn=0.0),
        poisson=poisson,
        shear_npm=shear * thickness,
        tension_npm=force / FORCE_WIDTH_M * (1.0 - relaxation),
        mass_kgpm2=kind.density_kgpm3 * thickness,
        friction=friction,
        look=kind.look,
    )


def _law_around(kind: FilmKind, pre_stretch: float) -> FilmLaw:
    thickness = kind.gauge_m / (1.0 + pre_stretch)
    return _law(
        kind, kind.modulus_around_pa, kind.break_strain_around, thickness=thickness, drawn=pre_stretch
    )


def _law(kind: FilmKind, modulus: float, break_strain: float, *, thickness: float, drawn: float) -> FilmLaw:
    """The law of one direction of a film that was drawn in it by so much: the line from yield to break goes on."""
    stiffness = modulus * thickness
    if kind.yield_stress_pa is None or kind.yield_strain is None or kind.break_stress_pa is None:
        return FilmLaw(stiffness, math.inf, 1.0, break_strain)
    slope = (kind.break_stress_pa - kind.yield_stress_pa) / (break_strain - kind.yield_strain)
    drawn_on = max(drawn, kind.yield_strain)
    drawing_stress = kind.yield_stress_pa + slope * (drawn_on - kind.yield_strain)
    # Forces act on the section before drawing, strains count from the length after it: once n each.
    ratio = 1.0 + drawn
    yield_force = drawing_stress * thickness * ratio
    left = yield_force / stiffness + (break_strain - drawn_on) / ratio
    return FilmLaw(stiffness, yield_force, slope * ratio**2 / modulus, left)


def film_span(wrap: Wrap, *, deck_m: float, top_m: float) -> tuple[float, float]:
    """Heights of the film's lower and upper edge above the sled [m].

    Args:
        wrap: the wrap.
        deck_m: height of the pallet's deck, 0 where there is none [m].
        top_m: height of the load's top [m]; no film stands above it.
    """
    upper = top_m if wrap.height_m is None else min(top_m, deck_m + wrap.height_m)
    return max(0.0, deck_m - wrap.pallet_overlap_m), upper


def default_spacing_m(height_m: float) -> float:
    """Spacing of the mesh of a film of some height [m]: 0.1 m, and for a low load eight rows of it."""
    return min(DEFAULT_SPACING_M, max(LEAST_SPACING_M, height_m / LEAST_ROWS))


def layers_at(wrap: Wrap, height_m: float, z: float) -> float:
    """Layers of film at a height, the mean around the load.

    Turns given as one number lie everywhere. Turns given by height lie as a machine lays them, with a web of
    width w and H the height of the film: the bottom turns cover 0 to w, the top turns H − w to H, and in
    each pass the web rises by p = w·(1 − overlap) a turn, so that a height meets

        (min(z, H − w) − max(z − w, 0)) / p

    turns: 1/(1 − overlap) layers, fewer within a web of either end. A pass goes around once at least
    (p ≤ H − w), and where the web covers all, it is one turn.

    Args:
        wrap: the wrap.
        height_m: from the film's lower edge to its upper edge [m].
        z: above the film's lower edge [m]; outside 0 to height_m there is no film.
    """
    if not 0.0 <= z <= height_m:
        return 0.0
    turns = wrap.turns
    if not isinstance(turns, Turns):
        return turns
    web = min(wrap.web_width_m, height_m)
    travel = height_m - web
    rise = min(web * (1.0 - wrap.overlap), travel)
    met = (min(z, travel) - max(z - web, 0.0)) / rise if rise > 0.0 else 1.0
    at_ends = turns.bottom * (z <= web) + turns.top * (z >= travel)
    return at_ends + turns.middle * max(met, 0.0)
