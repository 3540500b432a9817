"""The integrity check before a test: whether a load can stand on its pallet at all."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations_with_replacement
from typing import Literal

import numpy as np

from config.errors import RefusedInput
from config.materials import material_library
from config.package import Package
from config.scene import Scene, StandardPallet
from config.scene_file import friction_table
from config.wrap import Wrap, film_span, layers_at
from sim_core.frames import Array
from sim_core.geometry import clip_convex, footprint, height_span, overlap_depth, polygon_area
from sim_core.sled import build_profile

OVERLAP_LIMIT_M = 1.0e-3
TOUCH_M = 2.0e-3
"""Faces this close count as touching: clearance and a palletising file's rounding to whole millimetres."""
OVERHANG_LIMIT_M = 0.05
DENSITY_RANGE = (5.0, 8000.0)
"""Plausible density of a package [kg/m³]: lighter than foam chips or heavier than steel is a slip of units."""
EDGE_RANGE_M = (0.005, 3.0)
SUPPORT_SHARE = 0.5
PLATFORM_HALF_M = 50.0
"""The sled's platform is modelled 200 m wide, so that nothing slides off it."""


@dataclass(frozen=True)
class Finding:
    """One thing that the check found.

    Attributes:
        severity: ``error`` refuses the test, ``warning`` and ``note`` only tell.
        check: name of the check, such as ``overlap``.
        subject: the package or packages concerned.
        value: measured value with its unit.
        limit: what would be accepted, or what follows.
    """

    severity: Literal["error", "warning", "note"]
    check: str
    subject: str
    value: str
    limit: str


@dataclass(frozen=True)
class Support:
    """One package standing on something: indices into the scene's packages, -1 the pallet, -2 the sled."""

    package: int
    below: int
    area_m2: float
    patch: Array


def supports(scene: Scene) -> list[Support]:
    """What every package stands on at the start: faces within 2 mm in height that overlap in plan."""
    packages = scene.packages
    found: list[Support] = []
    spans = np.array([height_span(package) for package in packages]).reshape(-1, 2)
    outlines = [footprint(package) for package in packages]
    lows = np.array([outline.min(axis=0) for outline in outlines]).reshape(-1, 2)
    highs = np.array([outline.max(axis=0) for outline in outlines]).reshape(-1, 2)
    pallet = scene.pallet_box
    for i, outline in enumerate(outlines):
        meets = (lows < highs[i]).all(axis=1) & (highs > lows[i]).all(axis=1)
        near = np.flatnonzero(meets & (np.abs(spans[i, 0] - spans[:, 1]) <= TOUCH_M))
        grounds = [(int(j), outlines[int(j)]) for j in near if int(j) != i]
        if pallet is not None and abs(spans[i, 0] - pallet.size_m[2]) <= TOUCH_M:
            half = 0.5 * np.array(pallet.size_m[:2])
            grounds.append((-1, np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * half))
        if abs(spans[i, 0]) <= TOUCH_M:
            found.append(Support(i, -2, polygon_area(outline), outline))
        for below, ground in grounds:
            patch = clip_convex(outline, ground)
            if len(patch) >= 3 and polygon_area(patch) > 1.0e-8:
                found.append(Support(i, below, polygon_area(patch), patch))
    return found


def check_integrity(scene: Scene) -> list[Finding]:
    """Everything that is wrong or remarkable about a resolved scene's load, errors first.

    Raises:
        RefusedInput: the sled's profile cannot be built, so there is nothing to test the load with; or the scene's
            camera has no picture.
    """
    build_profile(scene)
    findings = [
        *_overlaps(scene),
        *_pallet_bounds(scene),
        *_supports(scene),
        *_plausibility(scene),
        *_missing_friction(scene),
        *_wrap(scene),
        *_camera(scene),
    ]
    order = {"error": 0, "warning": 1, "note": 2}
    return sorted(findings, key=lambda finding: order[finding.severity])


def require_integrity(scene: Scene) -> list[Finding]:
    """The findings of a load that can be tested.

    Raises:
        RefusedInput: the first error, naming packages, value and limit.
    """
    findings = check_integrity(scene)
    errors = [finding for finding in findings if finding.severity == "error"]
    if errors:
        first = errors[0]
        more = f" ({len(errors) - 1} more)" if len(errors) > 1 else ""
        raise RefusedInput(f"{first.check} of {first.subject}", first.value, first.limit + more)
    return findings


def deepest_overlaps(packages: tuple[Package, ...]) -> list[tuple[float, Package, Package]]:
    """All pairs of packages that overlap, deepest first: depth [m] and the two."""
    outlines = [footprint(package) for package in packages]
    spans = np.array([height_span(package) for package in packages]).reshape(-1, 2)
    lows = np.column_stack([np.array([o.min(axis=0) for o in outlines]).reshape(-1, 2), spans[:, :1]])
    highs = np.column_stack([np.array([o.max(axis=0) for o in outlines]).reshape(-1, 2), spans[:, 1:]])
    found = []
    for i in range(len(packages)):
        meets = (lows[i + 1 :] < highs[i]).all(axis=1) & (highs[i + 1 :] > lows[i]).all(axis=1)
        for j in np.flatnonzero(meets) + i + 1:
            depth = overlap_depth(packages[i], packages[int(j)])
            if depth > 1.0e-9:
                found.append((depth, packages[i], packages[int(j)]))
    return sorted(found, key=lambda entry: -entry[0])


def _overlaps(scene: Scene) -> list[Finding]:
    found: list[Finding] = []
    pairs = deepest_overlaps((*_pallet_as_package(scene), *scene.packages))
    for depth, first, second in pairs:
        if depth > OVERLAP_LIMIT_M:
            found.append(
                Finding("error", "overlap", f"{first.id} and {second.id}", f"{1000.0 * depth:.2f} mm",
                        f"at most {1000.0 * OVERLAP_LIMIT_M:.0f} mm")
            )  # fmt: skip
    small = [depth for depth, _, _ in pairs if depth <= OVERLAP_LIMIT_M]
    if small:
        found.append(
            Finding("note", "overlap", f"{len(small)} pairs", f"up to {1000.0 * max(small):.2f} mm",
                    "pushed apart while the load settles")
        )  # fmt: skip
    return found


def _pallet_as_package(scene: Scene) -> tuple[Package, ...]:
    pallet = scene.pallet_box
    if pallet is None:
        return ()
    middle = (0.0, 0.0, pallet.size_m[2] / 2.0)
    return (Package(id="pallet", size_m=pallet.size_m, mass_kg=pallet.mass_kg, position_m=middle),)


def _supports(scene: Scene) -> list[Finding]:
    found: list[Finding] = []
    standing = supports(scene)
    for index, package in enumerate(scene.packages):
        own = [support for support in standing if support.package == index]
        if not own:
            gap = _gap_below(scene, index)
            found.append(
                Finding("error", "support", package.id, f"{1000.0 * gap:.1f} mm above what is below it",
                        f"must stand on something within {1000.0 * TOUCH_M:.0f} mm")
            )  # fmt: skip
            continue
        if package.kind == "interlayer" and any(support.below == -2 for support in own):
            found.append(
                Finding("error", "support", package.id, "lies on the sled itself",
                        "a sheet must lie on the pallet or on packages")
            )  # fmt: skip
        outside = _outside_support(package, own)
        if outside > 0.0:
            found.append(
                Finding("error", "support", package.id, f"centre {1000.0 * outside:.1f} mm outside its support",
                        "must stand by itself")
            )  # fmt: skip
        share = sum(support.area_m2 for support in own) / polygon_area(footprint(package))
        if share < SUPPORT_SHARE and outside <= 0.0:
            found.append(
                Finding("warning", "support", package.id, f"{100.0 * share:.0f} % of its base rests on something",
                        f"usually at least {100.0 * SUPPORT_SHARE:.0f} %")
            )  # fmt: skip
    return found


def _gap_below(scene: Scene, index: int) -> float:
    package = scene.packages[index]
    bottom, outline = height_span(package)[0], footprint(package)
    tops = [0.0]
    pallet = scene.pallet_box
    if pallet is not None:
        half = 0.5 * np.array(pallet.size_m[:2])
        if len(clip_convex(outline, np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * half)) >= 3:
            tops.append(pallet.size_m[2])
    for j, other in enumerate(scene.packages):
        top = height_span(other)[1]
        if j != index and top <= bottom + TOUCH_M and len(clip_convex(outline, footprint(other))) >= 3:
            tops.append(top)
    return bottom - max(tops)


def _outside_support(package: Package, own: list[Support]) -> float:
    """How far the centre of mass lies outside the convex hull of the support patches [m], 0 if inside."""
    points = np.concatenate([support.patch for support in own])
    centre = np.array(package.position_m[:2])
    hull = _convex_hull(points)
    edges = np.roll(hull, -1, axis=0) - hull
    lengths = np.hypot(edges[:, 0], edges[:, 1])
    offset = centre - hull
    outside = -(edges[:, 0] * offset[:, 1] - edges[:, 1] * offset[:, 0]) / np.maximum(lengths, 1.0e-12)
    return max(0.0, float(outside.max()))


def _convex_hull(points: Array) -> Array:
    """Convex hull, counter-clockwise, shape [n, 2] (Andrew's monotone chain)."""
    ordered = sorted(map(tuple, np.round(points, 9).tolist()))

    def chain(sequence: list[tuple[float, ...]]) -> list[tuple[float, ...]]:
        hull: list[tuple[float, ...]] = []
        for point in sequence:
            while len(hull) >= 2 and (hull[-1][0] - hull[-2][0]) * (point[1] - hull[-2][1]) <= (
                hull[-1][1] - hull[-2][1]
            ) * (point[0] - hull[-2][0]):
                hull.pop()
            hull.append(point)
        return hull

    return np.array(chain(ordered)[:-1] + chain(ordered[::-1])[:-1])


def _pallet_bounds(scene: Scene) -> list[Finding]:
    pallet = scene.pallet_box
    found: list[Finding] = []
    if pallet is None:
        for package in scene.packages:
            beyond = float(np.abs(package.position_m[:2]).max()) - PLATFORM_HALF_M
            if beyond > 0.0:
                found.append(
                    Finding("error", "position", package.id, f"centre {beyond:.2f} m off the sled",
                            f"must stand within {PLATFORM_HALF_M:g} m of the sled's middle")
                )  # fmt: skip
        return found
    half = 0.5 * np.array(pallet.size_m[:2])
    worst, who = 0.0, ""
    for package in scene.packages:
        outline = footprint(package)
        if (np.abs(np.array(package.position_m[:2])) > half).any():
            beyond = float((np.abs(np.array(package.position_m[:2])) - half).max())
            found.append(
                Finding("error", "position", package.id, f"centre {1000.0 * beyond:.1f} mm off the pallet",
                        f"must stand within the pallet's {pallet.size_m[0]:g} m x {pallet.size_m[1]:g} m")
            )  # fmt: skip
            continue
        overhang = float((np.abs(outline) - half).max())
        if overhang > worst:
            worst, who = overhang, package.id
    if worst > 1.0e-6:
        severity: Literal["warning", "note"] = "warning" if worst > OVERHANG_LIMIT_M else "note"
        found.append(
            Finding(severity, "overhang", who, f"{1000.0 * worst:.1f} mm beyond the pallet's edge",
                    f"usually at most {1000.0 * OVERHANG_LIMIT_M:.0f} mm")
        )  # fmt: skip
    return found


def _plausibility(scene: Scene) -> list[Finding]:
    found: list[Finding] = []
    for package in scene.packages:
        density = package.mass_kg / max(float(np.prod(package.size_m)), 1.0e-30)
        if not DENSITY_RANGE[0] <= density <= DENSITY_RANGE[1]:
            found.append(
                Finding("warning", "density", package.id, f"{density:.3g} kg/m³",
                        f"usually {DENSITY_RANGE[0]:g} to {DENSITY_RANGE[1]:g}; are mass and size in kg and m?")
            )  # fmt: skip
        smallest, largest = min(package.size_m), max(package.size_m)
        if package.kind == "package" and not (smallest >= EDGE_RANGE_M[0] and largest <= EDGE_RANGE_M[1]):
            found.append(
                Finding("warning", "size", package.id, " x ".join(f"{edge:g}" for edge in package.size_m) + " m",
                        f"edges usually {EDGE_RANGE_M[0]:g} m to {EDGE_RANGE_M[1]:g} m; are they in metres?")
            )  # fmt: skip
    total = sum(package.mass_kg for package in scene.packages)
    if isinstance(scene.pallet, StandardPallet):
        safe = material_library().pallets[scene.pallet.kind].safe_load_kg
        if total > safe:
            found.append(
                Finding(
                    "warning", "mass", "the load", f"{total:g} kg", f"the pallet's safe load is {safe:g} kg"
                )
            )
    return found


def _missing_friction(scene: Scene) -> list[Finding]:
    touching = {_surface_pair(scene, support) for support in supports(scene)}
    missing = sorted(tuple(sorted(pair)) for pair in touching - set(friction_table(scene)))
    surfaces = sorted({package.surface for package in scene.packages if package.kind == "package"})
    unnamed = [
        (first, second)
        for first, second in combinations_with_replacement(surfaces, 2)
        if frozenset((first, second)) not in friction_table(scene) and (first, second) not in missing
    ]
    found = [
        Finding("error", "friction", f"{pair[0]} on {pair[-1]}", "missing", "add the pair to surfaces.pairs")
        for pair in missing
    ]
    if unnamed:
        pairs = ", ".join(f"{first} on {second}" for first, second in unnamed[:5])
        found.append(
            Finding("warning", "friction", pairs + (" and more" if len(unnamed) > 5 else ""), "not named",
                    "these don't touch at the start; should they meet, the engine's own guess holds")
        )  # fmt: skip
    return found


def _surface_pair(scene: Scene, support: Support) -> frozenset[str]:
    pallet = scene.pallet_box
    if support.below == -1 and pallet is not None:
        other = pallet.surface
    else:
        other = "sled" if support.below < 0 else scene.packages[support.below].surface
    return frozenset((scene.packages[support.package].surface, other))


def _wrap(scene: Scene) -> Iterator[Finding]:
    wrap, film, pallet = scene.wrap, scene.film, scene.pallet_box
    if wrap is None or not wrap.is_wound:
        return
    if film is None:
        yield Finding("warning", "wrap", "the empty pallet", wrap.material, "nothing to wrap: it is left out")
        return
    if wrap.coupling == "one_way" and scene.force_fields is None:
        yield Finding(
            "warning", "wrap", "wrap.coupling", "one_way", "without force_fields nothing holds the load"
        )
    if wrap.coupling == "two_way" and scene.force_fields is not None:
        yield Finding(
            "warning", "wrap", "wrap.coupling", "two_way", "force_fields hold the load as well: twice"
        )
    packages = [package for package in scene.packages if package.kind == "package"]
    surfaces = {package.surface for package in packages}
    if pallet is not None and wrap.pallet_overlap_m > 0.0:
        surfaces.add(pallet.surface)
    for surface in sorted(surfaces - set(film.friction)):
        limit = "set wrap.friction, or add the pair to surfaces.pairs"
        yield Finding("error", "friction", f"{wrap.material} on {surface}", "missing", limit)
    smallest = min((package.size_m[2] for package in packages), default=math.inf)
    if wrap.spacing_m is not None and wrap.spacing_m > smallest:
        limit = f"the lowest package is {smallest:g} m high: the mesh may miss it"
        yield Finding("warning", "wrap", "wrap.spacing_m", f"{wrap.spacing_m:g} m", limit)
    yield from _wrap_edges(scene, wrap, packages)


def _camera(scene: Scene) -> Iterator[Finding]:
    if scene.camera is not None:
        from sim_core.camera.in_view import camera_findings

        yield from camera_findings(scene)


def _wrap_edges(scene: Scene, wrap: Wrap, packages: list[Package]) -> Iterator[Finding]:
    """Where the film reaches, from the pallet to the top of the load."""
    deck = 0.0 if scene.pallet_box is None else scene.pallet_box.size_m[2]
    top = max(height_span(package)[1] for package in scene.packages)
    lower, upper = film_span(wrap, deck_m=deck, top_m=top)
    free = [package.id for package in packages if height_span(package)[0] >= upper - TOUCH_M]
    if free:
        who = free[0] + (f" and {len(free) - 1} more" if len(free) > 1 else "")
        yield Finding("warning", "wrap", who, f"above the film's edge at {upper:g} m", "isn't wrapped")
    elif upper < top - TOUCH_M:
        yield Finding(
            "note", "wrap", "wrap.height_m", f"{wrap.height_m:g} m", f"{top - upper:g} m of the load above it"
        )
    if scene.pallet_box is None:
        yield Finding(
            "note", "wrap", "the load", "has no pallet", "the film ends at the sled and holds nothing to it"
        )
    elif wrap.pallet_overlap_m == 0.0:
        yield Finding(
            "note", "wrap", "wrap.pallet_overlap_m", "0 m", "the film doesn't hold the load to the pallet"
        )
    elif wrap.pallet_overlap_m > deck:
        limit = f"the pallet is {deck:g} m high: the film ends at the sled"
        yield Finding("note", "wrap", "wrap.pallet_overlap_m", f"{wrap.pallet_overlap_m:g} m", limit)
    if wrap.top_overlap_m > 0.0:
        limit = "the fold over the top isn't simulated: it holds nothing down"
        yield Finding("warning", "wrap", "wrap.top_overlap_m", f"{wrap.top_overlap_m:g} m", limit)
    if scene.film is not None and scene.film.tension_npm == 0.0:
        limit = "no pull is left: the film holds only what has moved"
        yield Finding("warning", "wrap", "wrap.relaxation", "all of the wrap force", limit)
    heights = lower + (upper - lower) * (np.arange(200) + 0.5) / 200.0
    bare = [z for z in heights.tolist() if layers_at(wrap, upper - lower, z - lower) == 0.0]
    if bare:
        value = f"no film between {bare[0]:.2f} m and {bare[-1]:.2f} m"
        yield Finding("warning", "wrap", "wrap.turns", value, "turns.middle lays film between the ends")
