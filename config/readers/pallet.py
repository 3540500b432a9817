"""One pallet as a palletising file describes it, before it becomes part of a scene."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from config.errors import RefusedInput
from config.package import Package

PACKAGE_LIMIT = 5000
PALLET_EDGE_LIMIT_M = 10.0
EMPTY_PACK_LIST = "the pack list holds no package"


@dataclass(frozen=True)
class PatternPallet:
    """A pallet's load as its file has it.

    Positions of `packages` are centres in metres, relative to the pallet's centre in x and y and to the top
    of its deck in z; x runs along the pallet's length, y along its width, z up.

    Attributes:
        number: the pallet's number in the file, 1 where the format has no numbers.
        name: the pallet's or the order's name.
        size_m: the pallet's length along x and width along y [m].
        deck_height_m: height of the pallet itself [m], where the file says it.
        max_height_m: greatest height of a load on this pallet [m], where the file says it.
        max_mass_kg: greatest mass of a load on this pallet [kg], where the file says it.
        packages: packages and interlayers; `layer` counts the package layers from 1 upwards.
        notes: what a user should know about how the file was read.
    """

    number: int
    name: str
    size_m: tuple[float, float]
    deck_height_m: float | None
    max_height_m: float | None
    max_mass_kg: float | None
    packages: tuple[Package, ...]
    notes: tuple[str, ...] = ()


class Bounds(NamedTuple):
    """The axis-aligned box around a package, in the frame of its position [m]."""

    x_min: float
    x_max: float
    y_min: float
    y_max: float
    z_min: float
    z_max: float

    def overlap(self, other: "Bounds") -> float:
        """Depth by which two boxes interpenetrate [m]; zero or negative when they do not."""
        return min(self.footprint_overlap(other), _shared(self[4:6], other[4:6]))

    def footprint_overlap(self, other: "Bounds") -> float:
        """The smaller edge of what two boxes share seen from above [m]; not positive when nothing."""
        return min(_shared(self[0:2], other[0:2]), _shared(self[2:4], other[2:4]))


def bounds(package: Package) -> Bounds:
    """The axis-aligned box around a package [m], exact for quarter turns."""
    length, width, height = package.size_m
    turns, rest = divmod(package.yaw_deg, 90.0)
    if rest == 0.0:
        along_x, along_y = (width, length) if turns % 2 else (length, width)
    else:
        cosine = abs(math.cos(math.radians(package.yaw_deg)))
        sine = abs(math.sin(math.radians(package.yaw_deg)))
        along_x, along_y = length * cosine + width * sine, length * sine + width * cosine
    x, y, z = package.position_m
    return Bounds(
        x - along_x / 2, x + along_x / 2, y - along_y / 2, y + along_y / 2, z - height / 2, z + height / 2
    )


def place(
    field: str,
    *,
    id: str,
    size_m: tuple[float, float, float],
    mass_kg: float,
    position_m: tuple[float, float, float],
    yaw_deg: float = 0.0,
    interlayer: bool = False,
) -> Package:
    """Build a package from figures of a file, lengths rounded to a nanometre and mass to a microgram.

    Args:
        field: where the figures stand in the file, for the refusal.
        id: name, unique within the load.
        size_m: edge lengths as the package stands [m].
        mass_kg: mass [kg].
        position_m: centre in the pallet's frame [m].
        yaw_deg: turn about z [deg].
        interlayer: whether it is a sheet between layers; its surface is then ``anti_slip``.

    Raises:
        RefusedInput: a figure that no package can have.
    """
    if not all(math.isfinite(value) for value in (*size_m, *position_m, mass_kg)):
        raise RefusedInput(field, (size_m, position_m, mass_kg), "finite figures")
    try:
        return Package(
            id=id,
            size_m=_rounded(size_m),
            mass_kg=round(mass_kg, 9),
            position_m=_rounded(position_m),
            yaw_deg=yaw_deg % 360.0,
            surface="anti_slip" if interlayer else "cardboard",
            kind="interlayer" if interlayer else "package",
        )
    except ValueError as error:
        raise refusal_of(error, lambda where: f"{field}: {where}") from None


def refusal_of(error: ValueError, field_of: Callable[[str], str]) -> RefusedInput:
    """The first complaint of a pydantic model as a refusal, its place written like ``layers[2].name``."""
    details = getattr(error, "errors", None)
    if details is None:
        return RefusedInput(field_of(""), "value", str(error))
    first = details(include_url=False)[0]
    where = ""
    for step in first["loc"]:
        where += f"[{step}]" if isinstance(step, int) else f".{step}" if where else str(step)
    return RefusedInput(field_of(where), first["input"], first["msg"])


def check_pallet_size(field: str, size_m: tuple[float, float]) -> None:
    """Refuse a pallet that no sled carries.

    Raises:
        RefusedInput: an edge that is not positive, or above 10 m.
    """
    if not all(0.0 < edge <= PALLET_EDGE_LIMIT_M for edge in size_m):
        raise RefusedInput(field, size_m, f"pallet edges above 0 and at most {PALLET_EDGE_LIMIT_M:g} m")


def check_package_count(field: str, count: int) -> None:
    """Refuse a count above `PACKAGE_LIMIT`, interlayers included, before anything is built from it.

    Raises:
        RefusedInput: more packages than one pallet can sensibly hold.
    """
    if count > PACKAGE_LIMIT:
        raise RefusedInput(field, f"{count} packages", f"at most {PACKAGE_LIMIT} on one pallet")


def count_note(count: int, singular: str, plural: str) -> tuple[str, ...]:
    """A note about so many packages, or none when there are none."""
    return () if count == 0 else (f"1 package {singular}" if count == 1 else f"{count} packages {plural}",)


def _rounded(values: Sequence[float]) -> tuple[float, float, float]:
    # Adding zero turns -0.0 into 0.0, so that equal loads compare and print alike.
    x, y, z = (round(value, 9) + 0.0 for value in values)
    return x, y, z


def _shared(first: Sequence[float], second: Sequence[float]) -> float:
    return min(first[1], second[1]) - max(first[0], second[0])
