"""The rating's figures as SVG: the load in space before and after a test, and level against film."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from config.scene import Scene
from sim_core.frames import Array
from sim_core.report import Report
from sim_core.report_figures import (
    BAD,
    BANDS,
    GRID,
    INK,
    PALLET,
    PAPER,
    WIDTH_IN,
    drawing_settings,
    svg_text,
)
from sim_core.report_views import PosedLoad, posed_loads

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_FACES = np.array([[1, 3, 7, 5], [0, 1, 5, 4], [4, 5, 7, 6], [0, 4, 6, 2], [2, 6, 7, 3], [0, 2, 3, 1]])
"""Corners of a box's faces, counter-clockwise seen from outside: +x, −y, +z, −x, +y, −z."""
_VIEW = np.array([1.0, -1.0, 0.8]) / np.linalg.norm([1.0, -1.0, 0.8])
"""Towards the viewer, in the axes of the travel: from front right and above."""
_SHADES = np.array([0.84, 0.68, 1.0])
"""Brightness of faces that look along the travel, across it and up."""


@dataclass(frozen=True)
class RatedPoint:
    """One variant in the plot.

    Attributes:
        number: its rank, written beside it.
        film_g: mass of its film [g].
        largest_g: the largest level that passed [g]; 0 for none.
        is_best: no other variant passes as much with less film.
    """

    number: int
    film_g: float
    largest_g: float
    is_best: bool


def space_figure(report: Report, scene: Scene, label: str) -> str:
    """The load in space, before the test and after it, seen from front right and above.

    Args:
        report: of a level, with its moments.
        scene: its scene.
        label: text alternative, already safe to stand in HTML.
    """
    from matplotlib.figure import Figure

    loads = posed_loads(report, scene)
    shown = [(loads["settled"], "before: settled"), (loads["end"], f"after: {loads['end'].time_s:.2f} s")]
    every = np.concatenate([_projected(load.corners).reshape(-1, 2) for load, _ in shown])
    # What flew far away must not make the load a dot.
    still = _projected(loads["settled"].corners).reshape(-1, 2)
    low = np.maximum(every.min(axis=0), still.min(axis=0) - 2.0) - 0.06
    high = np.minimum(every.max(axis=0), still.max(axis=0) + 2.0) + 0.06
    wide, tall = high - low
    each_in = 0.5 * WIDTH_IN - 0.1
    scale = min(each_in / wide, 4.6 / tall)
    height_in = float(tall * scale) + 0.35
    with drawing_settings():
        figure = Figure(figsize=(WIDTH_IN, height_in))
        for column, (load, title) in enumerate(shown):
            axes = figure.add_axes(
                ((0.1 + column * (each_in + 0.05)) / WIDTH_IN, 0.02, each_in / WIDTH_IN, 1.0 - 0.33 / height_in),
                xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal", anchor="C",
            )  # fmt: skip
            axes.set_axis_off()
            axes.set_title(title)
            _draw_load(axes, load, scene, _full_scale_mm(report))
        return svg_text(figure, label, "space")


def _projected(corners: Array) -> Array:
    """Corners on the plane of the picture, to the right and up [m], shape [..., 2]."""
    right = np.cross([0.0, 0.0, 1.0], _VIEW)
    right /= np.linalg.norm(right)
    plane: Array = np.stack([right, np.cross(_VIEW, right)], axis=1)
    return np.asarray(corners @ plane)


def _full_scale_mm(report: Report) -> float:
    limits = [rule["limit_mm"] for rule in report["rules"] if rule["rule"] == "elastic" and rule["limit_mm"]]
    return float(limits[0]) if limits else 100.0


def _draw_load(axes: "Axes", load: PosedLoad, scene: Scene, full_mm: float) -> None:
    from matplotlib import colormaps
    from matplotlib.collections import PolyCollection

    first = 0 if scene.pallet_box is not None else 1
    # The darkest third would hide the edges between packages.
    colours = colormaps["cividis"](0.33 + 0.67 * np.clip(load.moved_mm.max(axis=1) / full_mm, 0.0, 1.0))
    polygons, fills = [], []
    for row in _far_to_near(load.corners[first:]):
        corners = load.corners[first + row]
        faces = corners[_FACES]
        normals = np.cross(faces[:, 1] - faces[:, 0], faces[:, 3] - faces[:, 0])
        facing = normals @ _VIEW
        for number in np.flatnonzero(facing > 1.0e-9):
            shade = float(_SHADES[np.abs(normals[number]).argmax()])
            polygons.append(_projected(faces[number]))
            fills.append(PALLET if first + row == 0 else tuple(shade * colours[first + row][:3]))
    if polygons:
        axes.add_collection(PolyCollection(polygons, facecolors=fills, edgecolors=PAPER, linewidths=0.5))


def _far_to_near(corners: Array) -> list[int]:
    """Boxes in an order in which none hides one that comes later, by the axes that separate them.

    Args:
        corners: shape [n, 8, 3].
    """
    low, high = corners.min(axis=1), corners.max(axis=1)
    slack, signs = 1.0e-4, np.sign(_VIEW)
    near_low, near_high = np.where(signs > 0.0, low, -high), np.where(signs > 0.0, high, -low)
    # Behind: wholly on the far side of a plane that separates the two; both ways means that neither hides the other.
    behind = (near_high[:, None] <= near_low[None] + slack).any(axis=2)
    np.fill_diagonal(behind, False)
    hides = behind & ~behind.T
    waits = hides.sum(axis=0)
    depth = corners.mean(axis=1) @ _VIEW
    order: list[int] = []
    left = np.ones(len(corners), dtype=bool)
    while left.any():
        free = np.flatnonzero(left & (waits == 0))
        rows = free if len(free) else np.flatnonzero(left)
        row = int(rows[depth[rows].argmin()])
        order.append(row)
        left[row] = False
        waits = waits - hides[row]
    return order


def rating_figure(points: Sequence[RatedPoint], certified_g: float, label: str) -> str:
    """The largest level that passed against the mass of film, a point a variant.

    Args:
        points: the variants whose film is known.
        certified_g: where certificates begin [g].
        label: text alternative, already safe to stand in HTML.
    """
    from matplotlib.figure import Figure

    with drawing_settings():
        figure = Figure(figsize=(WIDTH_IN, 4.2))
        axes = figure.add_axes((0.075, 0.12, 0.805, 0.83))
        axes.grid(True, color=GRID, linewidth=0.5)
        axes.set_axisbelow(True)
        axes.axhline(certified_g, color=BAD, linewidth=1.0, linestyle=(0, (6, 3)))
        best = sorted((point for point in points if point.is_best), key=lambda point: point.film_g)
        right_g = 1.08 * max((point.film_g for point in points), default=0.0) or 1.0
        if best:
            axes.step([*(point.film_g for point in best), right_g],
                      [*(point.largest_g for point in best), best[-1].largest_g],
                      where="post", color=BANDS[1], linewidth=1.2, alpha=0.6)  # fmt: skip
        for point in points:
            axes.plot(
                point.film_g, point.largest_g, marker="o", markersize=7, linestyle="none", color=BANDS[1],
                markerfacecolor=BANDS[1] if point.is_best else PAPER, markeredgewidth=1.2, zorder=3.0,
            )  # fmt: skip
        _number_points(axes, points)
        top_g = max([certified_g, *(point.largest_g for point in points)])
        axes.set_xlim(-0.03 * right_g, right_g)
        axes.set_ylim(-0.06 * top_g, 1.15 * top_g)
        axes.annotate(f"certificates\nbegin at {certified_g:g} g", (1.0, certified_g), (5, 0),
                      xycoords=("axes fraction", "data"), textcoords="offset points", va="center",
                      color=BAD, annotation_clip=False)  # fmt: skip
        axes.set_xlabel("film around the load [g]")
        axes.set_ylabel("largest level passed [g]")
        return svg_text(figure, label, "rating")


def _number_points(axes: "Axes", points: Sequence[RatedPoint]) -> None:
    """Writes the ranks beside the points; those that share a place share a label."""
    places: dict[tuple[float, float], list[int]] = {}
    for point in points:
        places.setdefault((round(point.film_g, 1), point.largest_g), []).append(point.number)
    for place, numbers in places.items():
        shown = ", ".join(str(number) for number in sorted(set(numbers))[:4])
        axes.annotate(shown, place, (0, 8), textcoords="offset points", ha="center", va="bottom", color=INK)
