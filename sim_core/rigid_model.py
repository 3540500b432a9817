"""What an engine builds from a scene: the rigid boxes, and the friction wherever two of them meet.

An interlayer sheet weighs a thousandth of what stands on it. As a body of its own it costs a contact
solver everything (0.6 kg under 320 kg never comes to rest in Bullet, at any step tried), and its inertia
means nothing. So a sheet is modelled as what it does: an interface between the packages below and above,
with the smaller of the two frictions of its faces, as for a massless sheet that slips on its weaker side.
The packages below carry its thickness; its pose is the mean of theirs. In side contacts, packages that
touch a sheet take its friction too.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from config.package import Package
from config.scene import Scene
from config.scene_file import friction_table
from sim_core.frames import Array
from sim_core.integrity import Support, supports

PALLET, SLED = -1, -2
"""What a package can stand on besides packages, as in ``integrity.Support``."""


@dataclass(frozen=True)
class RigidBox:
    """One rigid box.

    Attributes:
        name: the package's id, or ``pallet``.
        size_m: edge lengths [m].
        mass_kg: mass [kg]; 0 for one that never moves.
        position_m: centre in frame ``sled`` [m].
        yaw_deg: turn about z [deg].
        face: friction class of its faces.
        sheet_m: thickness of the sheets that it carries on top [m].
    """

    name: str
    size_m: tuple[float, float, float]
    mass_kg: float
    position_m: tuple[float, float, float]
    yaw_deg: float
    face: str
    sheet_m: float = 0.0


@dataclass(frozen=True)
class Sheet:
    """An interlayer: its row among all poses, its place, and the rows of the bodies that carry it."""

    row: int
    position_m: Array
    carriers: tuple[int, ...]


@dataclass(frozen=True)
class RigidModel:
    """The bodies of a scene.

    Attributes:
        boxes: a box for each row of the poses; None for sheets, and for row 0 where there is no pallet.
        sheets: the interlayers.
        friction: wanted friction by pair of faces.
        touching: pairs of faces that carry weight at the start.
    """

    boxes: tuple[RigidBox | None, ...]
    sheets: tuple[Sheet, ...]
    friction: Mapping[frozenset[str], float]
    touching: frozenset[frozenset[str]]


def build_rigid_model(scene: Scene) -> RigidModel:
    """Bodies, sheets and friction of a resolved scene."""
    standing = supports(scene)
    faces = _faces(scene, standing)
    boxes: list[RigidBox | None] = [_pallet_box(scene)]
    for package, face in zip(scene.packages, faces, strict=True):
        boxes.append(None if package.kind == "interlayer" else _box(package, face))
    sheets = _sheets(scene, standing)
    for sheet in sheets:
        lying = scene.packages[sheet.row - 1]
        top = lying.position_m[2] + lying.size_m[2] / 2.0
        for row in sheet.carriers:
            carrier = boxes[row]
            if carrier is not None:
                own_top = carrier.position_m[2] + carrier.size_m[2] / 2.0
                boxes[row] = replace(carrier, sheet_m=max(carrier.sheet_m, round(top - own_top, 9)))
    friction, touching = _friction(scene, standing, faces)
    return RigidModel(tuple(boxes), sheets, friction, frozenset(touching))


def with_sheets(model: RigidModel, values: Array, *, at_rest: Array | None = None) -> Array:
    """Fills the sheets' rows of a per-row array with what their carriers do on average.

    Args:
        model: the bodies.
        values: a vector a row, shape [n, 3]; changed in place.
        at_rest: the same at the start; then a sheet's row is its own start plus the carriers' mean change.
    """
    for sheet in model.sheets:
        rows = list(sheet.carriers)
        if at_rest is None:
            values[sheet.row] = values[rows].mean(axis=0)
        else:
            values[sheet.row] = sheet.position_m + (values[rows] - at_rest[rows]).mean(axis=0)
    return values


def _box(package: Package, face: str) -> RigidBox:
    return RigidBox(package.id, package.size_m, package.mass_kg, package.position_m, package.yaw_deg, face)


def _pallet_box(scene: Scene) -> RigidBox | None:
    pallet = scene.pallet_box
    if pallet is None:
        return None
    mass = 0.0 if pallet.fixed else pallet.mass_kg
    return RigidBox("pallet", pallet.size_m, mass, (0.0, 0.0, pallet.size_m[2] / 2.0), 0.0, pallet.surface)


def _faces(scene: Scene, standing: list[Support]) -> list[str]:
    """A friction class a package: its surface, and which sheets it touches below and above."""
    below: dict[int, str] = {}
    above: dict[int, str] = {}
    for support in standing:
        if support.below >= 0 and scene.packages[support.below].kind == "interlayer":
            below[support.package] = scene.packages[support.below].surface
        if scene.packages[support.package].kind == "interlayer" and support.below >= 0:
            above[support.below] = scene.packages[support.package].surface
    names = []
    for index, package in enumerate(scene.packages):
        sheets = [
            f"{side} {found[index]}" for side, found in (("on", below), ("under", above)) if index in found
        ]
        names.append(" ".join([package.surface, *sheets]))
    return names


def _sheets(scene: Scene, standing: list[Support]) -> tuple[Sheet, ...]:
    """Carriers are the bodies below; where sheets lie on sheets, those below the lowest one."""
    below: dict[int, list[int]] = {}
    for support in standing:
        below.setdefault(support.package, []).append(support.below)

    def carriers(index: int) -> list[int]:
        rows: list[int] = []
        for ground in below.get(index, []):
            if ground >= 0 and scene.packages[ground].kind == "interlayer":
                rows += carriers(ground)
            else:
                rows.append(max(ground, PALLET) + 1)
        return rows

    return tuple(
        Sheet(index + 1, np.array(package.position_m), tuple(sorted(set(carriers(index)))) or (0,))
        for index, package in enumerate(scene.packages)
        if package.kind == "interlayer"
    )


def _friction(
    scene: Scene, standing: list[Support], faces: list[str]
) -> tuple[dict[frozenset[str], float], set[frozenset[str]]]:
    table = friction_table(scene)
    surface_of = {face: package.surface for face, package in zip(faces, scene.packages, strict=True)}
    pallet = scene.pallet_box
    grounds = {"sled"} | ({pallet.surface} if pallet is not None else set())
    bodies = sorted({face for face, p in zip(faces, scene.packages, strict=True) if p.kind == "package"})
    wanted: dict[frozenset[str], float] = {}
    for first in bodies:
        for second in [*bodies, *grounds]:
            known = table.get(frozenset((surface_of[first], surface_of.get(second, second))))
            if known is not None:
                wanted[frozenset((first, second))] = known
    if pallet is not None and not pallet.fixed:
        known = table.get(frozenset((pallet.surface, "sled")))
        if known is not None:
            wanted[frozenset((pallet.surface, "sled"))] = known
    touching: set[frozenset[str]] = set()
    if pallet is not None and not pallet.fixed:
        touching.add(frozenset((pallet.surface, "sled")))
    for support in standing:
        if scene.packages[support.package].kind == "interlayer":
            continue
        upper = faces[support.package]
        for lower, friction in _interfaces(scene, standing, faces, support.below, table, surface_of[upper]):
            pair = frozenset((upper, lower))
            if friction is not None:
                # One class can meet another both with and without a sheet between: the weaker counts.
                wanted[pair] = min(friction, wanted[pair]) if pair in touching else friction
            touching.add(pair)
    return wanted, touching


def _interfaces(
    scene: Scene,
    standing: list[Support],
    faces: list[str],
    below: int,
    table: Mapping[frozenset[str], float],
    upper_surface: str,
) -> list[tuple[str, float | None]]:
    """The bodies' faces that a package stands on, through sheets, each with the weakest friction on the way."""
    pallet = scene.pallet_box
    if below == SLED or (below == PALLET and pallet is not None):
        surface = "sled" if below == SLED or pallet is None else pallet.surface
        return [(surface, table.get(frozenset((upper_surface, surface))))]
    lower = scene.packages[below]
    friction = table.get(frozenset((upper_surface, lower.surface)))
    if lower.kind == "package":
        return [(faces[below], friction)]
    found = []
    for support in standing:
        if support.package == below:
            for face, deeper in _interfaces(scene, standing, faces, support.below, table, lower.surface):
                known = [value for value in (friction, deeper) if value is not None]
                found.append((face, min(known) if known else None))
    return found
