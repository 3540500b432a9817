"""The scene: one test in full, as typed models that refuse what they don't know."""

import hashlib
import math
from typing import Annotated, Any, Literal, Self

from pydantic import Discriminator, Field, Tag, model_validator

from config.bench import ImuSource
from config.camera import Camera
from config.materials import material_library
from config.package import EdgeLength, Finite, Package, Point3
from config.part import Part
from config.wrap import FilmProperties, Wrap, default_spacing_m, film_properties, film_span

MAXIMUM_PACKAGES = 2000
DEFAULT_TIME_STEP_S = 1.0 / 480.0
DEFAULT_ITERATIONS, WRAPPED_ITERATIONS = 40, 100
"""Where a film presses packages on each other Bullet comes to rest with 100 iterations, and never with 40."""

Fraction = Annotated[float, Field(gt=0.0, le=1.0, allow_inf_nan=False)]


class PatternSource(Part):
    """Where a resolved load came from."""

    file: str = Field(description="the palletising file's name")
    format: Literal["stackbuilder", "nist", "pally"]
    sha256: str
    pallet_number: int
    notes: tuple[str, ...] = ()


class PackagesLoad(Part):
    """A load given package by package."""

    packages: tuple[Package, ...] = Field(default=(), max_length=MAXIMUM_PACKAGES)
    source: PatternSource | None = Field(default=None, description="the palletising file behind the packages")

    @model_validator(mode="after")
    def _ids_are_unique(self) -> Self:
        seen: set[str] = set()
        for package in self.packages:
            if package.id in seen or package.id == "pallet":
                raise ValueError(f"package id '{package.id}' must be unique, and 'pallet' is taken")
            seen.add(package.id)
        return self


class FileLoad(Part):
    """A load taken from a palletising file."""

    file: str = Field(min_length=1, description="path, relative to the scene file")
    pallet_number: int | None = Field(default=None, ge=0, description="needed where the file holds several")
    layers: int | None = Field(default=None, ge=1, le=100, description="keep this many layers, from below")
    rotate_layers: tuple[int, ...] = Field(default=(), description="layers turned by 180 degrees")
    mirror_layers: tuple[int, ...] = Field(default=(), description="layers mirrored, y to -y")
    surface: str = Field(default="cardboard", description="surface of the packages")
    interlayer_surface: str = Field(default="anti_slip", description="surface of interlayer sheets")
    clearance_m: float = Field(
        default=0.001,
        ge=0.0,
        le=0.02,
        description="gap modelled between neighbours that touch in the file [m]: half of it is taken off each side",
    )


def _load_kind(value: Any) -> str:
    keys = value if isinstance(value, dict) else getattr(value, "__dict__", {})
    return "file" if "file" in keys else "packages"


Load = Annotated[
    Annotated[PackagesLoad, Tag("packages")] | Annotated[FileLoad, Tag("file")], Discriminator(_load_kind)
]


class StandardPallet(Part):
    """A pallet kind of the material library."""

    kind: Literal["epal1"]
    fixed: bool = Field(default=True, description="blocked on the sled, as on the bench")


class CustomPallet(Part):
    """A pallet of any size."""

    kind: Literal["custom"] = "custom"
    size_m: tuple[EdgeLength, EdgeLength, EdgeLength]
    mass_kg: float = Field(gt=0.0, le=500.0)
    surface: str = "wood"
    fixed: bool = Field(default=True, description="blocked on the sled, as on the bench")


class FilePallet(Part):
    """The pallet that the palletising file describes."""

    kind: Literal["file"]
    height_m: float = Field(default=0.144, gt=0.0, le=1.0, description="where the file doesn't say [m]")
    mass_kg: float = Field(default=25.0, gt=0.0, le=500.0)
    surface: str = "wood"
    fixed: bool = Field(default=True, description="blocked on the sled, as on the bench")


def _pallet_kind(value: Any) -> str:
    kind = value.get("kind", "custom") if isinstance(value, dict) else getattr(value, "kind", "custom")
    return kind if kind in ("epal1", "file", "custom") else "epal1"


Pallet = Annotated[
    Annotated[StandardPallet, Tag("epal1")]
    | Annotated[CustomPallet, Tag("custom")]
    | Annotated[FilePallet, Tag("file")],
    Discriminator(_pallet_kind),
]


class SurfacePair(Part):
    """Coulomb friction of one pair of surfaces."""

    between: tuple[str, str]
    friction: float = Field(ge=0.0, le=10.0)


class Surfaces(Part):
    """Friction of surface pairs; pairs not named here come from the material library."""

    pairs: tuple[SurfacePair, ...] = ()

    @model_validator(mode="after")
    def _pairs_stand_once(self) -> Self:
        seen: set[frozenset[str]] = set()
        for pair in self.pairs:
            if frozenset(pair.between) in seen:
                raise ValueError(f"{' on '.join(pair.between)} stands twice")
            seen.add(frozenset(pair.between))
        return self


Direction = Literal["+x", "-x", "+y", "-y"] | Annotated[float, Field(ge=-360.0, le=360.0)]


def direction_vector(direction: str | float) -> tuple[float, float]:
    """Unit vector (x, y) of a direction: an axis name, or degrees from +x towards +y."""
    named = {"+x": (1.0, 0.0), "-x": (-1.0, 0.0), "+y": (0.0, 1.0), "-y": (0.0, -1.0)}
    if isinstance(direction, str):
        return named[direction]
    quarter_turns, rest = divmod(direction, 90.0)
    if rest == 0.0:
        return list(named.values())[(0, 2, 1, 3)[int(quarter_turns) % 4]]
    angle = math.radians(direction)
    return math.cos(angle), math.sin(angle)


class EumosSled(Part):
    """The EUMOS 40509 profile: rise to the level, plateau, fall, constant deceleration to rest."""

    profile: Literal["eumos"] = "eumos"
    level_g: float = Field(ge=0.0, le=2.0, description="plateau acceleration [g]")
    rise_s: float = Field(default=0.05, ge=0.0, le=0.05, description="from rest to the level [s]")
    plateau_s: float = Field(
        default=0.5, ge=0.3, le=5.0, description="at the level; the standard asks for 0.3 s [s]"
    )
    deceleration_g: float = Field(
        default=0.2, gt=0.0, le=2.0, description="constant deceleration to rest [g]"
    )
    fall_s: float = Field(default=0.05, ge=0.0, le=0.5, description="from the level to the deceleration [s]")
    lead_s: float = Field(default=0.1, ge=0.0, le=10.0, description="standstill before the rise [s]")
    direction: Direction = "+x"


class TableSled(Part):
    """Acceleration given point by point, linear between the points and zero outside them."""

    profile: Literal["table"]
    times_s: tuple[Finite, ...] = Field(min_length=2, max_length=100_000)
    acceleration_mps2: tuple[Finite, ...] = Field(min_length=2, max_length=100_000)
    lead_s: float = Field(default=0.0, ge=0.0, le=10.0, description="standstill before the table [s]")
    direction: Direction = "+x"

    @model_validator(mode="after")
    def _table_is_a_function(self) -> Self:
        if len(self.times_s) != len(self.acceleration_mps2):
            raise ValueError(
                f"times_s has {len(self.times_s)} points and acceleration_mps2 {len(self.acceleration_mps2)}"
            )
        if self.times_s[0] < 0.0 or any(b < a for a, b in zip(self.times_s, self.times_s[1:], strict=False)):
            raise ValueError("times_s must start at 0 or later and never fall")
        if max(map(abs, self.acceleration_mps2)) > 1000.0:
            raise ValueError("acceleration_mps2 must stay within 1000 m/s² (about 100 g)")
        if self.times_s[-1] > 60.0:
            raise ValueError("times_s must end by 60 s")
        return self


class RecordedSled(Part):
    """The samples of an earlier recording, each a mean acceleration over its interval."""

    profile: Literal["recorded"]
    bag: str = Field(default="", description="bag to take the samples from, relative to the scene file")
    topic: str = Field(
        default="",
        description="its topic, sled/acceleration of a twin or any Imu; by default the former, else the only Imu",
    )
    direction: Direction = Field(default="+x", description="of the travel, where an accelerometer saw it")
    samples_mps2: tuple[Point3, ...] = Field(default=(), max_length=1_000_000)
    level_mps2: float | None = Field(
        default=None, ge=0.0, description="what counts as peak acceleration; None: that of the samples [m/s²]"
    )
    source: ImuSource | None = Field(
        default=None, description="what was found in the accelerometer's readings behind the samples"
    )


Sled = Annotated[EumosSled | TableSled | RecordedSled, Field(discriminator="profile")]


class ForceFields(Part):
    """Four perimeter force fields, one a side, that press the packages inwards.

    After arXiv 2508.13989: strength T/4 · Σm · a, spread over the height by σ_h, at a distance
    from the load's perimeter, with a falloff. See ``sim_core/force_fields.py`` for the formula.
    """

    tension: float = Field(default=1.0, ge=0.0, le=1.0e9, description="T, dimensionless")
    height_spread_m: float = Field(default=0.6, gt=0.0, le=100.0, description="σ_h [m]")
    distance_m: float = Field(
        default=0.05, ge=0.005, le=5.0, description="d, from perimeter to field plane [m]"
    )
    falloff: float = Field(default=2.0, gt=0.0, le=6.0, description="exponent of the falloff with distance")


class Accelerometer(Part):
    """The sled's accelerometer: rate, white noise and bias."""

    rate_hz: int = Field(default=1000, ge=10, le=10_000)
    noise_mps2: float = Field(
        default=0.05, ge=0.0, le=10.0, description="standard deviation of a reading [m/s²]"
    )
    bias_mps2: Point3 = (0.0, 0.0, 0.0)


class Limits(Part):
    """EUMOS 40509 limits; fractions are of the load unit's height above the sled."""

    permanent_fraction: Fraction = Field(default=0.05, description="(i) permanent, any part")
    base_permanent_m: float = Field(default=0.04, gt=0.0, description="(ii) permanent, on the pallet [m]")
    base_height_m: float = Field(
        default=0.20, gt=0.0, description="(ii) how far up 'on the pallet' reaches [m]"
    )
    elastic_fraction: Fraction = Field(default=0.10, description="(iii) elastic peak, any part")
    layer_fraction: Fraction | None = Field(
        default=None, description="layer against layer, some laboratories only (0.02); unverified"
    )


class Sampling(Part):
    """How often the sled is sampled and poses are published."""

    samples_hz: int = Field(default=960, ge=60, le=8000, description="sled samples")
    poses_hz: int = Field(default=240, ge=1, le=8000, description="pose frames")
    film_hz: int = Field(
        default=30, ge=1, le=8000, description="frames of the film, of a wrapped load, about"
    )

    @model_validator(mode="after")
    def _frames_fall_on_samples(self) -> Self:
        if self.samples_hz % self.poses_hz:
            raise ValueError(f"samples_hz {self.samples_hz} must be a multiple of poses_hz {self.poses_hz}")
        return self

    @property
    def frames_a_film_frame(self) -> int:
        """Every so many pose frames there is one of the film."""
        return max(1, self.poses_hz // self.film_hz)


class Solver(Part):
    """Engine and accuracy: a tolerance that the step is made to keep, or explicit settings."""

    engine: Literal["bullet", "mujoco", "auto"] = Field(
        default="bullet",
        description="auto: the cheapest installed one that the work-precision table shows inside the tolerance",
    )
    tolerance_mm: float | None = Field(
        default=None,
        ge=0.05,
        le=1000.0,
        description="largest error estimate wanted: the step is halved until it is kept, three times at most",
    )
    time_step_s: float | None = Field(
        default=None, ge=1.0e-5, le=0.02, description="explicit: then a tolerance doesn't change it"
    )
    iterations: int | None = Field(
        default=None,
        ge=1,
        le=10_000,
        description="of the contact solver; MuJoCo's may take 100 on a wrapped load",
    )

    @model_validator(mode="after")
    def _auto_chooses_all(self) -> Self:
        if self.engine == "auto" and (self.time_step_s is not None or self.iterations is not None):
            raise ValueError("engine auto chooses step and iterations: name an engine, or leave them out")
        return self


class Scene(Part):
    """One EUMOS test: load, pallet, surfaces, sled, limits and, where needed, the optional parts."""

    name: str = Field(min_length=1, max_length=80, pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]*$")
    description: str = ""
    load: Load
    pallet: Pallet | None = StandardPallet(kind="epal1")
    surfaces: Surfaces = Surfaces()
    sled: Sled
    force_fields: ForceFields | None = None
    wrap: Wrap | None = Field(default=None, description="film around load and pallet; absent: none")
    accelerometer: Accelerometer | None = None
    camera: Camera | None = Field(default=None, description="the bench's camera; absent: no picture is drawn")
    limits: Limits = Limits()
    sampling: Sampling = Sampling()
    solver: Solver = Solver()
    seed: int = Field(default=0, ge=0, le=2**32 - 1)

    @model_validator(mode="after")
    def _step_fits_the_samples(self) -> Self:
        self.steps_and_samples()
        return self

    @model_validator(mode="after")
    def _pictures_fall_on_frames(self) -> Self:
        if self.camera is not None and self.sampling.poses_hz % self.camera.rate_hz:
            raise ValueError(
                f"camera.rate_hz {self.camera.rate_hz} must divide sampling.poses_hz {self.sampling.poses_hz}"
            )
        return self

    def steps_and_samples(self) -> tuple[int, int]:
        """How many physics steps go into how many sled samples: one of the two is 1.

        Raises:
            ValueError: the step is neither a whole number of samples nor a whole fraction of one,
                or pose frames would fall between steps.
        """
        step_s = self.solver.time_step_s or DEFAULT_TIME_STEP_S
        step_rate, sample_rate = 1.0 / step_s, self.sampling.samples_hz
        many, few = max(step_rate, sample_rate), min(step_rate, sample_rate)
        ratio = round(many / few)
        if abs(many / few - ratio) > 1.0e-6:
            raise ValueError(
                f"solver.time_step_s {step_s:.6g} must be a whole number of sled samples of 1/{sample_rate} s,"
                " or a whole fraction of one"
            )
        steps, samples = (ratio, 1) if step_rate >= sample_rate else (1, ratio)
        if (sample_rate // self.sampling.poses_hz) % samples:
            raise ValueError(
                f"solver.time_step_s {step_s:.6g} must fit a whole number of times into"
                f" the pose interval of 1/{self.sampling.poses_hz} s"
            )
        return steps, samples

    @property
    def time_step_s(self) -> float:
        """The physics step in use [s]."""
        steps, samples = self.steps_and_samples()
        return samples / (steps * self.sampling.samples_hz)

    @property
    def is_held_by_film(self) -> bool:
        """Whether there is film that pulls on the load, and doesn't only follow it."""
        return self.wrap is not None and self.wrap.is_wound and self.wrap.coupling == "two_way"

    @property
    def iterations(self) -> int:
        """The solver iterations in use."""
        default = (
            WRAPPED_ITERATIONS
            if self.is_held_by_film and self.solver.engine == "bullet"
            else DEFAULT_ITERATIONS
        )
        return self.solver.iterations or default

    @property
    def packages(self) -> tuple[Package, ...]:
        """The placed packages of a resolved scene.

        Raises:
            TypeError: the load still stands in a palletising file; call ``resolve_scene`` first.
        """
        if isinstance(self.load, FileLoad):
            raise TypeError("the scene's load is not resolved yet")
        return self.load.packages

    @property
    def pallet_box(self) -> CustomPallet | None:
        """The pallet as a box with size, mass and surface, or None when packages stand on the sled.

        Raises:
            TypeError: the pallet is still described by a palletising file.
        """
        if isinstance(self.pallet, StandardPallet):
            kind = material_library().pallets[self.pallet.kind]
            return CustomPallet(
                size_m=kind.size_m, mass_kg=kind.mass_kg, surface=kind.surface, fixed=self.pallet.fixed
            )
        if isinstance(self.pallet, FilePallet):
            raise TypeError("the scene's pallet is not resolved yet")
        return self.pallet

    @property
    def film(self) -> FilmProperties | None:
        """One layer of the wrap's film, or None where there is no wrap, no turn of it, or nothing to wrap.

        Raises:
            TypeError: the load still stands in a palletising file.
        """
        if self.wrap is None or not self.wrap.is_wound or not self.packages:
            return None
        named = {frozenset(pair.between): pair.friction for pair in self.surfaces.pairs}
        return film_properties(self.wrap, named=named)

    @property
    def film_spacing_m(self) -> float:
        """Spacing of the film's mesh in use, where there is film [m].

        Raises:
            TypeError: the load still stands in a palletising file.
        """
        assert self.wrap is not None
        if self.wrap.spacing_m is not None:
            return self.wrap.spacing_m
        deck = self.pallet_box.size_m[2] if self.pallet_box is not None else 0.0
        top = max((p.position_m[2] + 0.5 * p.size_m[2] for p in self.packages), default=deck)
        lower, upper = film_span(self.wrap, deck_m=deck, top_m=top)
        return default_spacing_m(upper - lower)

    def to_json(self) -> str:
        """The scene as compact JSON, the same bytes for the same scene."""
        return self.model_dump_json(exclude_none=False)

    @property
    def sha256(self) -> str:
        """Digest of the scene's JSON."""
        return hashlib.sha256(self.to_json().encode()).hexdigest()
