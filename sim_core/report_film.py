"""The report's drawing of the film: cut open and laid flat, coloured by what it went through."""

from dataclasses import dataclass
from itertools import groupby
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from config.scene import Scene
from config.wrap import FilmLaw
from sim_core.frames import Array
from sim_core.geometry import box_corners
from sim_core.report_figures import (
    BAD,
    FAINT,
    HALO,
    INK,
    PAPER,
    STOP,
    WIDTH_IN,
    Report,
    drawing_settings,
    svg_text,
    travel_direction,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.path import Path

_OUTWARDS = {"−y": (0.0, -1.0), "+x": (1.0, 0.0), "+y": (0.0, 1.0), "−x": (-1.0, 0.0)}
"""The sides of a load, counter-clockwise from above, and their outward directions."""
_SHADES = 64
_LEAST_SPAN = 0.1
"""The scale of colours spans at least this share of its upper end: less is not worth a contrast."""
_ROUNDED = 1.5e-5
_LARGEST_MISFIT = 0.05
"""A load whose outline differs from its bounding rectangle by more than this has no packages drawn on its film."""


@dataclass(frozen=True)
class FilmSide:
    """A side of the load on the unrolled film: its name, such as ``+x``, and where it begins and ends [m]."""

    name: str
    start_m: float
    end_m: float


@dataclass(frozen=True, eq=False)
class FilmMap:
    """The unrolled film of a report, an element a row.

    Attributes:
        corners: way around the load, counter-clockwise from above, and height above the sled [m], shape [m, 3, 2].
        peaks: largest strain in any direction of the whole test, shape [m].
        torn_s: when the element tore, or -1 [s], shape [m].
        sides: the load's sides from the cut on; the one that the cut divides stands at both ends.
        worst: row of the largest strain.
        first_torn: row of the element that tore first, or None.
    """

    corners: Array
    peaks: Array
    torn_s: Array
    sides: tuple[FilmSide, ...]
    worst: int
    first_torn: int | None

    @property
    def is_torn(self) -> NDArray[np.bool_]:
        """Which elements tore, shape [m]."""
        torn: NDArray[np.bool_] = self.torn_s >= 0.0
        return torn

    def middle(self, row: int) -> tuple[float, float]:
        """Way around and height of an element's middle [m]."""
        around, height = self.corners[row].mean(axis=0).tolist()
        return around, height

    def place(self, row: int) -> tuple[str, float]:
        """The side that an element lies on, and its height above the sled as laid [m]."""
        around, height = self.middle(row)
        return next((side.name for side in self.sides if around <= side.end_m), self.sides[-1].name), height


def film_map(report: Report) -> FilmMap | None:
    """The unrolled film of a report, or None where it has none."""
    film = report.get("film")
    if film is None or not film["peak_strain"]:
        return None
    corners = np.array(film["corners_m"]).reshape(-1, 3, 2)
    peaks, torn_s = np.array(film["peak_strain"]), np.array(film["torn_s"])
    first_torn = None
    if torn_s.max() >= 0.0:
        is_first = torn_s == torn_s[torn_s >= 0.0].min()
        first_torn = int(np.where(is_first, peaks, -1.0).argmax())
    middles, worst = np.array(film["middles_m"]), int(peaks.argmax())
    if "wrap" in report:
        # Strains are rounded in a report: of those that are alike, the one that was meant.
        distances = np.linalg.norm(middles - report["wrap"]["peak_position_m"], axis=1)
        worst = int(np.where(peaks >= peaks[worst] - _ROUNDED, distances, np.inf).argmin())
    return FilmMap(corners, peaks, torn_s, _sides(corners, middles), worst, first_torn)


def _sides(corners: Array, middles: Array) -> tuple[FilmSide, ...]:
    """Sides by where the film is: in the bounding rectangle's own measure, the nearest of its four sides."""
    starts, ends = corners[:, :, 0].min(axis=1), corners[:, :, 0].max(axis=1)
    columns, column_of = np.unique(starts, return_inverse=True)
    places = np.array([np.median(middles[column_of == k, :2], axis=0) for k in range(len(columns))])
    low, high = places.min(axis=0), places.max(axis=0)
    squared = (places - 0.5 * (low + high)) / np.maximum(high - low, 1.0e-6)
    names = list(_OUTWARDS)
    nearest = (squared @ np.array(list(_OUTWARDS.values())).T).argmax(axis=1)
    sides = []
    for number, group in groupby(range(len(columns)), key=lambda k: nearest[k]):
        own = list(group)
        end = float(columns[own[-1] + 1]) if own[-1] + 1 < len(columns) else float(ends.max())
        sides.append(FilmSide(names[number], float(columns[own[0]]), end))
    return tuple(sides)


def percent(strain: float) -> str:
    """A strain in percent, to three figures."""
    value = 100.0 * strain
    return f"{value:.0f} %" if value >= 99.95 else f"{value:.3g} %"


def yield_strain(law: FilmLaw) -> float:
    """Strain at which a film begins to give way for good, from the film without tension; infinite for paper."""
    return law.yield_force_npm / law.stiffness_npm


def film_figure(report: Report, scene: Scene, film: FilmMap, label: str) -> str:
    """The film laid flat as seen from outside, every element coloured by its largest strain of the whole test.

    Args:
        report: a report with the film.
        scene: its scene.
        film: the report's film.
        label: text alternative, already safe to stand in HTML.
    """
    from matplotlib.figure import Figure

    outlines, top = boxes_behind(report, scene, film)
    top = max(top, float(film.corners[:, :, 1].max()))
    length = float(film.corners[:, :, 0].max())
    left, right, below, above, bar = 0.6, 0.15, 1.32, 0.3, 0.16
    width = WIDTH_IN - left - right
    tall = float(np.clip(width * top / length, 1.2, 5.0))
    height = below + tall + above
    with drawing_settings():
        figure = Figure(figsize=(WIDTH_IN, height))
        axes = figure.add_axes(
            (left / WIDTH_IN, below / height, width / WIDTH_IN, tall / height),
            xlim=(0.0, length), ylim=(0.0, top),
        )  # fmt: skip
        bar_axes = figure.add_axes((left / WIDTH_IN, 0.42 / height, width / WIDTH_IN, bar / height))
        scale = _scale_of(film, scene)
        _draw_film(axes, film, scale)
        _draw_outlines(axes, outlines)
        _draw_holes(axes, film)
        _name_sides(axes, report, scene, film)
        _mark_places(axes, report, film)
        axes.set_ylabel("height [m]")
        axes.set_xlabel("way around the load [m]")
        _draw_scale(bar_axes, scene, scale)
        return svg_text(figure, label, "film")


@dataclass(frozen=True)
class _Scale:
    """Strains from low to high and their colours: in proportion, or by the root where a few places stand out."""

    low: float
    high: float
    exponent: float

    def edges(self) -> Array:
        """Strains at which one shade ends and the next begins, shape [shades + 1]."""
        shares: Array = np.linspace(0.0, 1.0, _SHADES + 1) ** (1.0 / self.exponent)
        return self.low + (self.high - self.low) * shares

    def shades(self, strains: Array) -> NDArray[np.int64]:
        """Number of each strain's shade, shape of the strains."""
        return np.clip(np.searchsorted(self.edges(), strains, side="right") - 1, 0, _SHADES - 1)


def _scale_of(film: FilmMap, scene: Scene) -> _Scale:
    """What is whole, and the film as laid, fill the scale; where there are holes, it goes on to what tears."""
    laid = scene.film.strain if scene.film is not None else float(film.peaks.min())
    low = min(laid, float(film.peaks.min()))
    high = float(np.where(film.is_torn, laid, film.peaks).max())
    if film.first_torn is not None and scene.film is not None:
        high = max(high, scene.film.around.break_strain)
    high = max(high, low + _LEAST_SPAN * high, 1.0e-6)
    return _Scale(low, high, 0.5 if high > 2.0 * low else 1.0)


def _colours() -> Array:
    """Cividis, which reads alike with every kind of colour vision and in grey; shape [shades, 4]."""
    from matplotlib import colormaps

    return np.asarray(colormaps["cividis"]((np.arange(_SHADES) + 0.5) / _SHADES))


def _draw_film(axes: "Axes", film: FilmMap, scale: _Scale) -> None:
    from matplotlib.patches import PathPatch

    shades = scale.shades(film.peaks)
    for shade, colour in enumerate(_colours()):
        # The thin edge in its own colour closes the seams that neighbours would leave.
        rows = (shades == shade) & ~film.is_torn
        if rows.any():
            path = _path(film.corners[rows])
            axes.add_patch(PathPatch(path, facecolor=colour, edgecolor=colour, linewidth=0.5))


def _path(triangles: Array) -> "Path":
    """All triangles as one path; shape [m, 3, 2]."""
    from matplotlib.path import Path as ClosedPath

    closed = np.concatenate([triangles, triangles[:, :1]], axis=1).reshape(-1, 2)
    codes = np.tile(
        [ClosedPath.MOVETO, ClosedPath.LINETO, ClosedPath.LINETO, ClosedPath.CLOSEPOLY], len(triangles)
    )
    return ClosedPath(closed, codes)


def _draw_holes(axes: "Axes", film: FilmMap) -> None:
    """Torn elements: no film, hatched, with a line around each hole."""
    from matplotlib.collections import LineCollection
    from matplotlib.patches import PathPatch

    torn = film.corners[film.is_torn]
    if not len(torn):
        return
    path = _path(torn)
    axes.add_patch(PathPatch(path, facecolor=PAPER, edgecolor="none", zorder=2.5))
    (left, right), (low, high) = axes.get_xlim(), axes.get_ylim()
    offsets = np.arange(left - high, right - low, 0.025)
    hatch = LineCollection(
        [((low + k, low), (high + k, high)) for k in offsets], colors=BAD, linewidths=0.7, zorder=2.6
    )
    axes.add_collection(hatch, autolim=False)
    hatch.set_clip_path(path, axes.transData)
    edges = np.round(torn[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2, 2), 4)
    # The same edge of two elements, whichever way around, is inside a hole.
    is_turned = (edges[:, 0, 0] > edges[:, 1, 0]) | (
        (edges[:, 0, 0] == edges[:, 1, 0]) & (edges[:, 0, 1] > edges[:, 1, 1])
    )
    edges[is_turned] = edges[is_turned, ::-1]
    found, counts = np.unique(edges.reshape(-1, 4), axis=0, return_counts=True)
    axes.add_collection(
        LineCollection(list(found[counts == 1].reshape(-1, 2, 2)), colors=BAD, linewidths=1.4, zorder=2.7),
        autolim=False,
    )


def boxes_behind(report: Report, scene: Scene, film: FilmMap) -> tuple[Array, float]:
    """What the film lies on, as it stood when settled: rectangles on the unrolled film, and the load's top [m].

    Returns:
        Left, lower, right and upper edge of each box that can be seen from a side [m], shape [k, 4]; none where the
        load isn't much of a rectangle. And the height of the load above the sled.
    """
    nothing = np.zeros((0, 4))
    if not report["moments"]:
        return nothing, 0.0
    settled, pallet = report["moments"][0], scene.pallet_box
    sizes = [pallet.size_m if pallet is not None else (0.0, 0.0, 0.0)] + [p.size_m for p in scene.packages]
    corners = box_corners(
        np.array(settled["positions_m"]), np.array(settled["orientations_xyzw"]), 0.5 * np.array(sizes)
    )
    solid = [pallet is not None] + [package.kind == "package" for package in scene.packages]
    lows, highs = corners.min(axis=1)[solid], corners.max(axis=1)[solid]
    top = float(highs[:, 2].max())
    middles = 0.5 * (lows + highs)
    # The load's bounding rectangle at the middle of each box.
    beside = (lows[:, 2] < middles[:, 2, None]) & (middles[:, 2, None] < highs[:, 2])
    near = np.where(beside[:, :, None], lows[None, :, :2], np.inf).min(axis=1)
    far = np.where(beside[:, :, None], highs[None, :, :2], -np.inf).max(axis=1)
    around = 2.0 * float((far - near).sum(axis=1).mean())
    length = float(film.corners[:, :, 0].max())
    if abs(around - length) > _LARGEST_MISFIT * length:
        return nothing, top
    found = []
    for name, (x, y) in _OUTWARDS.items():
        extent = _side_extent(film, name)
        if extent is None:
            continue
        across = 0 if x else 1
        depths = middles[:, across] * (x + y) + 0.5 * (highs - lows)[:, across]
        along, sign = 1 - across, x - y
        first, last = (near, far) if sign > 0.0 else (-far, -near)
        edges = np.sort(np.stack([sign * lows[:, along], sign * highs[:, along]], axis=1), axis=1)
        shares = (edges - first[:, [along]]) / (last - first)[:, [along]]
        flat = extent[0] + (extent[1] - extent[0]) * shares
        rectangles = np.column_stack([flat[:, 0], lows[:, 2], flat[:, 1], highs[:, 2]])
        centres = 0.5 * (rectangles[:, :2] + rectangles[:, 2:])[:, None]
        inside = (rectangles[:, :2] - 1.0e-3 <= centres) & (centres <= rectangles[:, 2:] + 1.0e-3)
        is_hidden = (inside.all(axis=2) & (depths > depths[:, None] + 1.0e-3)).any(axis=1)
        found += [rectangles[~is_hidden]]
        if extent[1] > length:
            found += [rectangles[~is_hidden] - [length, 0.0, length, 0.0]]
    return np.concatenate([nothing, *found]), top


def _side_extent(film: FilmMap, name: str) -> tuple[float, float] | None:
    """Where a side begins and ends on the unrolled film [m]; one that is cut ends beyond the film's end."""
    own = [side for side in film.sides if side.name == name]
    is_cut = len(own) == 2 and own[0] is film.sides[0] and own[1] is film.sides[-1]
    if is_cut:
        return own[1].start_m, own[1].end_m + own[0].end_m
    return (own[0].start_m, own[0].end_m) if len(own) == 1 else None


def _draw_outlines(axes: "Axes", outlines: Array) -> None:
    from matplotlib.collections import PolyCollection

    polygons = list(outlines[:, [0, 1, 2, 1, 2, 3, 0, 3]].reshape(-1, 4, 2))
    # In grey where there is no film, in white on it.
    for colour, alpha, order in ((FAINT, 0.6, 0.5), ("#ffffff", 0.4, 2.0)):
        axes.add_collection(
            PolyCollection(
                polygons, facecolors="none", edgecolors=colour, linewidths=0.6, alpha=alpha, zorder=order
            ),
            autolim=False,
        )


def _name_sides(axes: "Axes", report: Report, scene: Scene, film: FilmMap) -> None:
    x, y = travel_direction(report, scene)
    length = film.corners[:, :, 0].max()
    for side in film.sides:
        if side.start_m > 0.0:
            axes.axvline(side.start_m, color=PAPER, linewidth=2.0, zorder=3.0)
            axes.axvline(side.start_m, color=INK, linewidth=0.9, linestyle=(0, (5, 3)), zorder=3.1)
        if side.end_m - side.start_m < 0.06 * length:
            continue
        outwards = _OUTWARDS[side.name]
        along = x * outwards[0] + y * outwards[1]
        across = x * outwards[1] - y * outwards[0]
        words = [("front", along), ("rear", -along), ("left", across), ("right", -across)]
        view = next((word for word, cosine in words if cosine > 0.99), None)
        axes.annotate(
            f"{side.name} side" + (f", {view}" if view else ""), (0.5 * (side.start_m + side.end_m), 1.0),
            (0, 5), xycoords=("data", "axes fraction"), textcoords="offset points", ha="center",
            fontsize=8.5,
        )  # fmt: skip


def _mark_places(axes: "Axes", report: Report, film: FilmMap) -> None:
    """Ring and cross where the largest strain was, a triangle where the film tore first, with their times."""
    found = report.get("wrap")
    when = f" at {found['peak_time_s']:.2f} s" if found is not None else ""
    worst, right, top = film.middle(film.worst), axes.get_xlim()[1], axes.get_ylim()[1]
    sign = 1 if worst[1] < 0.5 * top else -1
    _say(axes, worst, f"{percent(film.peaks[film.worst])}{when}", right, 12 * sign)
    for size, edge in ((3.2, PAPER), (1.6, BAD)):
        axes.plot(*worst, marker="o", markersize=9, markerfacecolor="none", markeredgecolor=edge,
                  markeredgewidth=size, zorder=5.0)  # fmt: skip
    axes.plot(*worst, marker="+", markersize=6, color=BAD, markeredgewidth=1.2, zorder=5.0)
    if film.first_torn is None:
        return
    tear = film.middle(film.first_torn)
    # Two marks side by side would write over each other: the second one's words stand farther off.
    is_near = abs(worst[0] - tear[0]) < 0.25 * right and abs(worst[1] - tear[1]) < 0.25 * top
    sign = (sign if is_near else 1 if tear[1] < 0.5 * top else -1) * (28 if is_near else 12)
    _say(axes, tear, f"tore first: {film.torn_s[film.first_torn]:.2f} s", right, sign)
    axes.plot(*tear, marker="v", markersize=7, color=BAD, markeredgecolor=PAPER, zorder=5.0)


def _say(axes: "Axes", place: tuple[float, float], words: str, right: float, lift: int) -> None:
    is_left = place[0] < 0.5 * right
    axes.annotate(
        words, place, (10 if is_left else -10, lift), textcoords="offset points", color=BAD, fontweight="bold",
        ha="left" if is_left else "right", va="bottom" if lift > 0 else "top", bbox=HALO, zorder=6.0,
    )  # fmt: skip


def _draw_scale(axes: "Axes", scene: Scene, scale: _Scale) -> None:
    steps, colours = 100.0 * scale.edges(), _colours()
    axes.bar(steps[:-1], 1.0, np.diff(steps), align="edge", color=colours, edgecolor=colours, linewidth=0.4)
    axes.set_xlim(steps[0], steps[-1])
    axes.set_ylim(0.0, 1.0)
    axes.set_yticks([])
    axes.spines["left"].set_visible(False)
    axes.set_xlabel("largest strain of the whole test, from the film without tension [%]")
    layer = scene.film
    if layer is None:
        return
    law = layer.around
    marks = [("as laid", layer.strain, STOP), ("yields", yield_strain(law), INK),
             ("tears", law.break_strain, BAD)]  # fmt: skip
    for words, strain, colour in marks:
        if not scale.low <= strain <= scale.high:
            continue
        axes.plot([100.0 * strain] * 2, [-0.1, 1.35], color=colour, linewidth=1.6, clip_on=False)
        is_left = strain < 0.5 * (scale.low + scale.high)
        axes.annotate(
            f"{words} {percent(strain)}", (100.0 * strain, 1.35), (3 if is_left else -3, 0),
            textcoords="offset points", ha="left" if is_left else "right", va="bottom", color=colour,
            annotation_clip=False,
        )  # fmt: skip
