"""How much film a wrap takes: its layers times the way around the load, from the wrap as it is laid."""

from collections.abc import Sequence

import numpy as np

from config.scene import Scene
from config.wrap import film_span, layers_at
from sim_core.frames import Array
from sim_core.geometry import footprint


def film_mass_kg(scene: Scene) -> float | None:
    """Mass of the film around a load [kg].

    m = ρ·t · ( ∫ n(z)·U(z) dz + o·n(top)·U(top) )

    with ρ·t the mass of a square metre of one layer as laid (ρ·t0/(1 + pre-stretch)), n the layers at a height, U the
    way around the convex hull of what stands there, and o what is folded over the top. For turns at the foot or the
    head the integral is turns · web width · U, and a pass takes (H − w)/p of them, H the film's height, w the web's
    width and p its rise a turn. The elastic rest of the stretch, a few percent less mass, is left out.

    Args:
        scene: a resolved scene.

    Returns:
        None where force fields stand in for a wrap that the scene doesn't name; 0 without any.
    """
    wrap, layer = scene.wrap, scene.film
    if wrap is None or layer is None:
        return None if scene.force_fields is not None else 0.0
    deck = scene.pallet_box.size_m[2] if scene.pallet_box is not None else 0.0
    spans, outlines = _solids(scene)
    lower, upper = film_span(wrap, deck_m=deck, top_m=float(spans[:, 1].max()))
    height = upper - lower
    if height <= 0.0:
        return 0.0
    web = min(wrap.web_width_m, height)
    # Layers are a straight line in each interval between these, and the way around is constant.
    borders = np.concatenate([spans.ravel(), [lower, lower + web, upper - web, upper]])
    borders = np.unique(borders[(borders >= lower) & (borders <= upper)])
    middles, rises = 0.5 * (borders[1:] + borders[:-1]), np.diff(borders)
    area = sum(
        rise * layers_at(wrap, height, z - lower) * _way_around(spans, outlines, z)
        for z, rise in zip(middles.tolist(), rises.tolist(), strict=True)
    )
    fold = wrap.top_overlap_m * layers_at(wrap, height, height) * _way_around(spans, outlines, upper)
    return float(layer.mass_kgpm2 * (area + fold))


def _solids(scene: Scene) -> tuple[Array, list[Array]]:
    """Bottom and top [m], shape [n, 2], and outlines [m], shape [4, 2] each, of all that a film lies on."""
    spans, outlines = [], []
    box = scene.pallet_box
    if box is not None:
        spans.append((0.0, box.size_m[2]))
        outlines.append(0.5 * np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * np.array(box.size_m[:2]))
    for package in scene.packages:
        if package.kind == "package":
            z, half = package.position_m[2], 0.5 * package.size_m[2]
            spans.append((z - half, z + half))
            outlines.append(footprint(package))
    return np.array(spans), outlines


def _way_around(spans: Array, outlines: Sequence[Array], z: float) -> float:
    """Length of the convex hull of the boxes at a height, or at the nearest height that has any [m]."""
    from scipy.spatial import ConvexHull

    apart = np.maximum(np.maximum(spans[:, 0] - z, z - spans[:, 1]), 0.0)
    points = np.concatenate([outlines[row] for row in np.flatnonzero(apart <= apart.min() + 1.0e-9).tolist()])
    # In the plane a hull's "area" is its circumference.
    return float(ConvexHull(points).area)
