"""The report's views: the load from the side and from above, at the worst moment and at the end."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from config.scene import Scene
from sim_core.frames import Array
from sim_core.geometry import box_corners
from sim_core.report_figures import (
    BAD,
    GRID,
    HALO,
    INK,
    PALLET,
    PAPER,
    SLED,
    STOP,
    WIDTH_IN,
    Report,
    drawing_settings,
    svg_text,
    travel_direction,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_FACES = np.array([[0, 2, 6, 4], [1, 5, 7, 3], [0, 4, 5, 1], [2, 3, 7, 6], [0, 1, 3, 2], [4, 6, 7, 5]])
"""Corners of each face of a box, counter-clockwise seen from outside: −x, +x, −y, +y, −z, +z."""
_LARGEST_REACH_M = 6.0
"""How far beyond the settled load a view reaches; what flew farther is counted in the caption."""


@dataclass(frozen=True)
class Drawing:
    """A figure: its SVG text, and how many packages lie outside of it."""

    svg: str
    outside_count: int = 0


@dataclass(frozen=True)
class PosedLoad:
    """The load at one moment, turned so that x runs along the travel and y to its left.

    Attributes:
        time_s: time since the first frame [s].
        corners: corners of pallet (row 0) and packages [m], shape [n + 1, 8, 3].
        moved_mm: displacement of each corner from the settled load [mm], shape [n + 1, 8].
    """

    time_s: float
    corners: Array
    moved_mm: Array

    def worst_corner(self) -> tuple[int, int]:
        """Row and corner of the largest displacement."""
        row, corner = divmod(int(np.argmax(self.moved_mm)), 8)
        return row, corner


def posed_loads(report: Report, scene: Scene) -> dict[str, PosedLoad]:
    """The report's moments by name (``settled``, ``worst``, ``end``), in the axes of the travel."""
    pallet = scene.pallet_box
    sizes = [pallet.size_m if pallet is not None else (0.0, 0.0, 0.0)] + [p.size_m for p in scene.packages]
    x, y = travel_direction(report, scene)
    turn = np.array([[x, -y, 0.0], [y, x, 0.0], [0.0, 0.0, 1.0]])
    loads: dict[str, PosedLoad] = {}
    settled: Array | None = None
    for moment in report["moments"]:
        positions, orientations = np.array(moment["positions_m"]), np.array(moment["orientations_xyzw"])
        corners: Array = box_corners(positions, orientations, 0.5 * np.array(sizes)) @ turn
        settled = corners if settled is None else settled
        moved_mm = 1000.0 * np.linalg.norm(corners - settled, axis=2)
        loads[moment["name"]] = PosedLoad(moment["time_s"], corners, moved_mm)
    return loads


def views_figure(report: Report, scene: Scene, label: str) -> Drawing:
    """The load from the side and from above, at the worst moment and at the end.

    Args:
        report: a report with moments.
        scene: its scene.
        label: text alternative, already safe to stand in HTML.
    """
    from matplotlib.figure import Figure

    loads = posed_loads(report, scene)
    low, high = _extent(loads)
    panels = _panels(low, high)
    largest_mm = max(float(load.moved_mm.max()) for load in loads.values())
    width, height = WIDTH_IN, max(panel.bottom + panel.height for panel in panels) + 0.3
    with drawing_settings():
        figure = Figure(figsize=(width, height))
        for panel in panels:
            load = loads[panel.moment]
            axes = figure.add_axes(
                (panel.left / width, panel.bottom / height, panel.width / width, panel.height / height),
                xlim=(low[0], high[0]),
                ylim=(low[1], high[1]) if panel.from_above else (low[2], high[2]),
            )
            _draw_view(axes, loads["settled"], load, scene, largest_mm, from_above=panel.from_above)
            moment = "worst moment" if panel.moment == "worst" else "end of the test"
            axes.set_title(
                f"From {'above' if panel.from_above else 'the side'}: {moment}, {load.time_s:.2f} s"
            )
            axes.tick_params(labelleft=panel.has_height_axis)
            if panel.has_height_axis:
                axes.set_ylabel("to the left [m]" if panel.from_above else "height [m]")
            if panel.from_above:
                axes.set_xlabel("along the travel [m]")
        if scene.packages and largest_mm > 0.01:
            _draw_scale(figure, report, largest_mm, (width - 0.72, 0.5, 0.16, height - 0.8))
        return Drawing(svg_text(figure, label, "views"), _outside_count(loads, low, high))


@dataclass(frozen=True)
class _Panel:
    """One view's place in the figure [in], and what it shows."""

    moment: str
    from_above: bool
    has_height_axis: bool
    left: float
    bottom: float
    width: float
    height: float


def _panels(low: Array, high: Array) -> list[_Panel]:
    """Four views at one scale: two by two, or one below the other where the load spread far along the travel.

    Widens the extent along the travel in place, so that every panel is filled.
    """
    left, gap, bar, between = 0.6, 0.3, 1.0, 0.55
    span = high - low
    is_spread = bool(span[0] > 2.0 * max(span[1], span[2]))
    room = WIDTH_IN - left - bar
    wide = room if is_spread else 0.5 * (room - gap)
    scale = min(wide / span[0], 4.4 / span[2], 3.4 / span[1])
    spare = 0.5 * (wide / scale - span[0])
    low[0], high[0] = low[0] - spare, high[0] + spare
    side, top = float(span[2] * scale), float(span[1] * scale)
    if not is_spread:
        second, above = left + wide + gap, 0.5 + top + between
        return [
            _Panel("worst", False, True, left, above, wide, side),
            _Panel("end", False, False, second, above, wide, side),
            _Panel("worst", True, True, left, 0.5, wide, top),
            _Panel("end", True, False, second, 0.5, wide, top),
        ]
    panels, bottom = [], 0.5
    for moment, from_above in (("end", True), ("end", False), ("worst", True), ("worst", False)):
        panels.append(_Panel(moment, from_above, True, left, bottom, wide, top if from_above else side))
        bottom += panels[-1].height + (between if from_above else 0.8)
    return panels[::-1]


def _draw_view(
    axes: "Axes", settled: PosedLoad, load: PosedLoad, scene: Scene, largest_mm: float, *, from_above: bool
) -> None:
    from matplotlib.collections import PolyCollection

    axes.set_aspect("equal")
    axes.grid(True, color=GRID, linewidth=0.4)
    axes.set_axisbelow(True)
    if not from_above:
        axes.axhspan(-0.05, 0.0, facecolor=SLED, linewidth=0.0)
        axes.axhline(0.0, color=INK, linewidth=0.8)
    rows, polygons = _visible_faces(load.corners, from_above=from_above)
    is_package = rows > 0
    if scene.pallet_box is not None:
        axes.add_collection(
            PolyCollection(list(polygons[~is_package]), facecolors=PALLET, edgecolors=INK, linewidths=0.6)
        )
    rows, polygons = rows[is_package], polygons[is_package]
    colours = _colours(load.moved_mm.max(axis=1)[rows], largest_mm)
    axes.add_collection(PolyCollection(list(polygons), facecolors=colours, edgecolors=PAPER, linewidths=0.5))
    ghost_rows, ghosts = _visible_faces(settled.corners, from_above=from_above, least_facing=0.1)
    ghosts = np.unique(np.round(ghosts[ghost_rows > 0], 3), axis=0)
    axes.add_collection(
        PolyCollection(
            list(ghosts), facecolors="none", edgecolors=INK, linewidths=0.6, linestyles=[(0, (3, 2))]
        )
    )
    _draw_figures(axes, load, rows, polygons, largest_mm, from_above=from_above)
    _mark_worst(axes, settled, load, from_above=from_above)
    axes.annotate("", (0.98, 0.05), (0.86, 0.05), xycoords="axes fraction",
                  arrowprops={"arrowstyle": "-|>", "color": STOP, "linewidth": 1.2})  # fmt: skip
    axes.annotate("travel", (0.85, 0.05), xycoords="axes fraction", ha="right", va="center", color=STOP)


def _visible_faces(
    corners: Array, *, from_above: bool, least_facing: float = 1.0e-6
) -> tuple[NDArray[np.intp], Array]:
    """Faces that face the viewer, far ones first: their rows, shape [m], and outlines, shape [m, 4, 2].

    Seen from the right of the travel (travel to the right, up is up), or from above (left is up).
    """
    faces = corners[:, _FACES]
    normals = np.cross(faces[:, :, 1] - faces[:, :, 0], faces[:, :, 3] - faces[:, :, 0])
    lengths = np.maximum(np.linalg.norm(normals, axis=2), 1.0e-12)
    towards, depths = (normals[:, :, 2], faces[..., 2]) if from_above else (-normals[:, :, 1], -faces[..., 1])
    rows, numbers = np.nonzero(towards > least_facing * lengths)
    # A package goes in front as a whole: by its nearest point, then its own faces by their middle.
    order = np.lexsort((depths[rows, numbers].mean(axis=1), depths.max(axis=(1, 2))[rows]))
    shown = faces[rows, numbers][order]
    return rows[order], shown[:, :, [0, 1]] if from_above else shown[:, :, [0, 2]]


def _draw_figures(
    axes: "Axes",
    load: PosedLoad,
    rows: NDArray[np.intp],
    polygons: Array,
    largest_mm: float,
    *,
    from_above: bool,
) -> None:
    """Writes its displacement [mm] on every package that is large enough and not covered."""
    lows, highs = polygons.min(axis=1).reshape(-1, 2), polygons.max(axis=1).reshape(-1, 2)
    panel_in = axes.get_position().width * WIDTH_IN
    metre_in = panel_in / float(np.ptp(axes.get_xlim()))
    areas = np.prod(highs - lows, axis=1)
    for row in sorted({int(row) for row in rows}):
        own = np.flatnonzero(rows == row)
        k = int(own[np.argmax(areas[own])])
        centre = 0.5 * (lows[k] + highs[k])
        in_front = np.flatnonzero((rows != row) & (np.arange(len(rows)) > k))
        is_covered = bool(((lows[in_front] < centre) & (centre < highs[in_front])).all(axis=1).any())
        wide, tall = highs[k] - lows[k]
        if is_covered or wide * metre_in < 0.27 or tall * metre_in < 0.14:
            continue
        moved = float(load.moved_mm[row].max())
        colour = "#ffffff" if moved < 0.55 * largest_mm else "#111111"
        figure = f"{moved:.0f}" if moved >= 9.95 else f"{moved:.1f}"
        axes.text(
            centre[0], centre[1], figure, ha="center", va="center", color=colour, fontsize=7, clip_on=True
        )


def _mark_worst(axes: "Axes", settled: PosedLoad, load: PosedLoad, *, from_above: bool) -> None:
    row, corner = load.worst_corner()
    moved = float(load.moved_mm[row, corner])
    if moved < 0.05:
        return
    plane = [0, 1] if from_above else [0, 2]
    place, origin = load.corners[row, corner][plane], settled.corners[row, corner][plane]
    axes.plot(*zip(origin, place, strict=True), color=BAD, linewidth=1.2)
    axes.plot(
        *place, marker="o", markersize=9, markerfacecolor="none", markeredgecolor=PAPER, markeredgewidth=3.2
    )
    axes.plot(
        *place, marker="o", markersize=9, markerfacecolor="none", markeredgecolor=BAD, markeredgewidth=1.6
    )
    axes.plot(*place, marker="+", markersize=6, color=BAD, markeredgewidth=1.2)
    middle = 0.5 * sum(axes.get_xlim())
    axes.annotate(
        f"{moved:.1f} mm", place, (9 if place[0] < middle else -9, 9), textcoords="offset points", color=BAD,
        ha="left" if place[0] < middle else "right", va="bottom", fontweight="bold", annotation_clip=True,
        bbox=HALO,
    )  # fmt: skip


def _draw_scale(
    figure: "Figure", report: Report, largest_mm: float, place: tuple[float, float, float, float]
) -> None:
    width, height = figure.get_size_inches()
    left, bottom, wide, tall = place
    top = max(largest_mm, 1.0e-3)
    axes = figure.add_axes(
        (left / width, bottom / height, wide / width, tall / height), xlim=(0.0, 1.0), ylim=(0.0, top)
    )
    steps = np.linspace(0.0, top, 49)
    colours = _colours(0.5 * (steps[1:] + steps[:-1]), top)
    axes.bar(0.5, np.diff(steps), 1.0, steps[:-1], color=colours, edgecolor=colours, linewidth=0.4)
    axes.set_xticks([])
    axes.yaxis.tick_right()
    axes.yaxis.set_label_position("right")
    axes.set_ylabel("displacement [mm]")
    for rule in report["rules"]:
        if (
            rule["rule"] in ("elastic", "permanent")
            and rule["limit_mm"] is not None
            and rule["limit_mm"] < top
        ):
            axes.axhline(
                rule["limit_mm"],
                color=BAD,
                linewidth=2.0,
                linestyle="solid" if rule["rule"] == "elastic" else (0, (2, 1)),
            )


def _colours(values_mm: Array, largest_mm: float) -> Array:
    """Cividis, which reads alike with every kind of colour vision and in grey; shape [n, 4]."""
    from matplotlib import colormaps

    colours: Array = np.asarray(colormaps["cividis"](np.clip(values_mm / max(largest_mm, 1.0e-3), 0.0, 1.0)))
    return colours.reshape(-1, 4)


def _extent(loads: dict[str, PosedLoad]) -> tuple[Array, Array]:
    """Lowest and highest corner to be shown [m], shape [3] each."""
    every = np.concatenate([load.corners.reshape(-1, 3) for load in loads.values()])
    still = loads["settled"].corners.reshape(-1, 3)
    low = np.maximum(every.min(axis=0), still.min(axis=0) - _LARGEST_REACH_M) - 0.12
    high = np.minimum(every.max(axis=0), still.max(axis=0) + _LARGEST_REACH_M) + 0.12
    middle, half = 0.5 * (low + high), np.maximum(0.5 * (high - low), 0.3)
    low, high = middle - half, middle + half
    # Room for the sled and the arrow of the travel.
    low[2] = min(low[2], -0.12 - 0.06 * float(high[2]))
    return low, high


def _outside_count(loads: dict[str, PosedLoad], low: Array, high: Array) -> int:
    """Packages that have no corner inside the shown extent at the end."""
    corners = loads["end"].corners[1:]
    if not len(corners):
        return 0
    shortfall = np.maximum(low - corners, corners - high).max(axis=2)
    return int((shortfall.min(axis=1) > 0.0).sum())
