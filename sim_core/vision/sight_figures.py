"""The figures of what the camera measurement is worth and what the camera costs, as SVG."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from sim_core.camera.cost import DRAWN, CameraCost, CostRow
from sim_core.report_figures import (
    BAD,
    BANDS,
    FAINT,
    GRID,
    HALO,
    INK,
    PAPER,
    WIDTH_IN,
    drawing_settings,
    svg_text,
)
from sim_core.vision.sweep import BARS_MM, DEVIATION_EDGES, LOOKS, Look, SightRow

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis

LOOK_WORDS: dict[Look, str] = {
    "markers": "with AprilTags",
    "bare": "cartons as they are",
    "film": "behind film",
}
INTERVAL_MS = 1000.0 / 30.0
"""Between two pictures of the sweep's camera [ms]."""
_COLOURS: dict[Look, str] = {"markers": BANDS[1], "bare": BANDS[3], "film": BANDS[4]}
_MARKS: dict[Look, str] = {"markers": "o", "bare": "s", "film": "^"}
_DASHED: Any = (0, (4, 2))
_SIDES = {"left": 0.065, "right": 0.985, "wspace": 0.08}


def level_figure(rows: Sequence[SightRow]) -> str:
    """Error of a test (y) against the sled's level (x), a panel a look: RMS, largest, and what the RMS may be."""
    from matplotlib.figure import Figure

    with drawing_settings():
        figure = Figure(figsize=(WIDTH_IN, 3.3))
        panels = figure.subplots(1, 3, sharey=True, gridspec_kw={**_SIDES, "top": 0.93, "bottom": 0.14})
        for axes, look in zip(panels, LOOKS, strict=True):
            own = sorted((row for row in rows if row.look == look), key=lambda row: (row.level_g, row.rms_mm))
            levels = _side_by_side([row.level_g for row in own])
            axes.vlines(
                levels,
                [row.rms_mm for row in own],
                [row.largest_mm for row in own],
                color=GRID,
                linewidth=1.0,
            )
            style = {"linestyle": "none", "marker": _MARKS[look], "color": _COLOURS[look], "markersize": 4.5}
            axes.plot(levels, [row.rms_mm for row in own], **style)
            largest = {**style, "markersize": 3.5, "fillstyle": "none", "markeredgewidth": 0.8}
            axes.plot(levels, [row.largest_mm for row in own], **largest)
            axes.axhline(BARS_MM[look], color=BAD, linewidth=1.0, linestyle=_DASHED)
            axes.text(
                0.985, BARS_MM[look], f"RMS at most {BARS_MM[look]:g} mm", color=BAD, ha="right", va="bottom",
                transform=axes.get_yaxis_transform(), zorder=1.0,
            )  # fmt: skip
            axes.set_yscale("log")
            axes.set_xlim(0.26, 0.84)
            axes.set_xlabel("level [g]")
            axes.set_title(LOOK_WORDS[look])
            axes.grid(True, color=GRID, linewidth=0.5)
        _plain(panels[0].yaxis)
        panels[0].set_ylabel("error of a component [mm]")
        return svg_text(figure, "Error of a test against the sled's level, by look", "sight-level")


def rms_figure(rows: Sequence[SightRow]) -> str:
    """How many of a look's tests (y) have an RMS error of at most so much (x), with what it may be."""
    from matplotlib.figure import Figure

    with drawing_settings():
        figure = Figure(figsize=(WIDTH_IN, 2.9))
        axes = figure.subplots(1, 1, gridspec_kw={"left": 0.065, "right": 0.985, "top": 0.96, "bottom": 0.16})
        for look in LOOKS:
            found = np.sort([row.rms_mm for row in rows if row.look == look])
            if not len(found):
                continue
            share = 100.0 * np.arange(1, len(found) + 1) / len(found)
            over = int((found > BARS_MM[look]).sum())
            label = f"{LOOK_WORDS[look]}: {over} of {len(found)} over {BARS_MM[look]:g} mm"
            axes.plot(
                found, share, drawstyle="steps-post", color=_COLOURS[look], marker=_MARKS[look],
                markersize=4.0, linewidth=1.2, label=label,
            )  # fmt: skip
            axes.axvline(BARS_MM[look], color=_COLOURS[look], linewidth=1.0, linestyle=_DASHED)
        axes.set_xscale("log")
        low, high = axes.get_xlim()
        axes.set_xlim(min(low, 0.1), max(high, 8.0))
        axes.set_ylim(0.0, 104.0)
        _plain(axes.xaxis)
        axes.grid(True, color=GRID, linewidth=0.5)
        axes.set_xlabel("RMS error of a test [mm]; dashed: what it may be")
        axes.set_ylabel("tests [%]")
        axes.legend(loc="lower right", framealpha=0.85)
        return svg_text(figure, "Share of the tests against their RMS error, by look", "sight-rms")


def deviation_figure(rows: Sequence[SightRow]) -> str:
    """Histogram of errors divided by their stated standard uncertainty, a panel a look, beside the normal law."""
    from matplotlib.figure import Figure

    width = float(np.diff(DEVIATION_EDGES)[0])
    middles = 0.5 * (DEVIATION_EDGES[1:] + DEVIATION_EDGES[:-1])
    ways = np.linspace(DEVIATION_EDGES[0], DEVIATION_EDGES[-1], 201)
    with drawing_settings():
        figure = Figure(figsize=(WIDTH_IN, 2.9))
        panels = figure.subplots(1, 3, sharey=True, gridspec_kw={**_SIDES, "top": 0.92, "bottom": 0.16})
        for axes, look in zip(panels, LOOKS, strict=True):
            counts = np.array([row.deviations for row in rows if row.look == look], dtype=float).sum(axis=0)
            axes.set_title(LOOK_WORDS[look])
            axes.set_xlabel("error / stated uncertainty")
            axes.grid(True, color=GRID, linewidth=0.5)
            for edge in (-1.96, 1.96):
                axes.axvline(edge, color=FAINT, linewidth=0.8, linestyle=(0, (2, 2)))
            axes.plot(
                ways, 100.0 * width * np.exp(-0.5 * ways**2) / np.sqrt(2.0 * np.pi), color=INK, linewidth=1.0
            )
            if not np.ndim(counts):
                continue
            total = float(counts.sum())
            axes.bar(
                middles, 100.0 * counts[1:-1] / total, width=width, color=_COLOURS[look], edgecolor=PAPER,
                linewidth=0.3, alpha=0.75,
            )  # fmt: skip
            beyond = 100.0 * (counts[0] + counts[-1]) / total
            axes.text(
                0.98, 0.96, f"beyond ±5: {beyond:.2f} %\nof {total:.0f} errors", ha="right", va="top",
                transform=axes.transAxes, bbox=HALO, fontsize=7.0,
            )  # fmt: skip
        panels[0].set_ylabel("errors in a bin [%]")
        return svg_text(figure, "Errors divided by their stated uncertainty, by look", "sight-deviation")


def taking_figure(rows: Sequence[SightRow]) -> str:
    """Time that a picture takes to measure, a test a mark: median, and up to the 95th percentile."""
    from matplotlib.figure import Figure

    with drawing_settings():
        figure = Figure(figsize=(WIDTH_IN, 2.7))
        axes = figure.subplots(1, 1, gridspec_kw={"left": 0.065, "right": 0.985, "top": 0.96, "bottom": 0.13})
        place, middles = 0.0, []
        for look in LOOKS:
            own = sorted((row for row in rows if row.look == look), key=lambda row: row.take_ms)
            places = place + np.arange(len(own))
            axes.vlines(
                places, [row.take_ms for row in own], [row.slowest_ms for row in own], color=_COLOURS[look],
                linewidth=1.0,
            )  # fmt: skip
            axes.plot(
                places, [row.take_ms for row in own], linestyle="none", marker=_MARKS[look],
                color=_COLOURS[look], markersize=4.0,
            )  # fmt: skip
            middles.append(place + 0.5 * max(0, len(own) - 1))
            place += max(1, len(own)) + 1.5
        axes.axhline(INTERVAL_MS, color=FAINT, linewidth=1.0, linestyle=_DASHED)
        axes.text(
            0.005, INTERVAL_MS, "30 pictures a second", color=FAINT, ha="left", va="bottom",
            transform=axes.get_yaxis_transform(), zorder=1.0,
        )  # fmt: skip
        axes.set_xlim(-1.5, place - 1.0)
        axes.set_ylim(bottom=0.0)
        axes.set_xticks(middles, [LOOK_WORDS[look] for look in LOOKS])
        axes.tick_params(axis="x", length=0)
        axes.grid(True, axis="y", color=GRID, linewidth=0.5)
        axes.set_ylabel("to measure a picture [ms]")
        return svg_text(figure, "Time that a picture takes to measure, by look", "sight-taking")


def cost_figure(cost: CameraCost) -> str:
    """Time that a picture takes to be drawn, by size and by what is in it: median, 5th to 95th percentile."""
    from matplotlib.figure import Figure

    sizes = list(dict.fromkeys((row.width_px, row.height_px) for row in cost.rows))
    colours = dict(zip(DRAWN, (BANDS[1], BANDS[3], BANDS[4]), strict=True))
    with drawing_settings():
        figure = Figure(figsize=(WIDTH_IN, 0.75 + 0.85 * len(sizes)))
        height_in = figure.get_figheight()
        box = {"left": 0.1, "right": 0.985, "top": 1.0 - 0.3 / height_in, "bottom": 0.42 / height_in}
        axes = figure.subplots(1, 1, gridspec_kw=box)
        for number, size in enumerate(sizes):
            own = [row for row in cost.rows if (row.width_px, row.height_px) == size]
            for row in own:
                _draw_cost(axes, row, number + 0.27 * (DRAWN.index(row.drawn) - 1), colours[row.drawn])
        axes.set_yticks(range(len(sizes)), [f"{width} × {height}" for width, height in sizes])
        axes.set_ylim(len(sizes) - 0.45, -0.55)
        axes.set_xlim(0.0, 1.15 * 1000.0 * max(max(row.high_s, row.bar_s or 0.0) for row in cost.rows))
        axes.tick_params(axis="y", length=0)
        axes.grid(True, axis="x", color=GRID, linewidth=0.5)
        axes.set_axisbelow(True)
        axes.set_xlabel("to draw a picture [ms]")
        for drawn, colour in colours.items():
            axes.barh([0.0], [0.0], color=colour, label=drawn)
        figure.legend(loc="upper right", ncols=3, frameon=False, borderaxespad=0.1)
        return svg_text(figure, "Time that a picture takes to be drawn, by size and content", "sight-cost")


def _draw_cost(axes: "Axes", row: CostRow, place: float, colour: str) -> None:
    low, median, high = (1000.0 * value for value in (row.low_s, row.median_s, row.high_s))
    axes.barh(place, median, height=0.24, color=colour)
    axes.errorbar(
        median,
        place,
        xerr=[[median - low], [high - median]],
        fmt="none",
        ecolor=INK,
        elinewidth=0.8,
        capsize=2.0,
    )
    words, end = f"{median:.0f}", high
    if row.bar_s is not None:
        bar_ms = 1000.0 * row.bar_s
        axes.vlines(bar_ms, place - 0.14, place + 0.14, color=BAD, linewidth=1.6)
        words, end = f"{median:.0f}, at most {bar_ms:g}", max(high, bar_ms)
    axes.annotate(
        words, (end, place), (4, 0), textcoords="offset points", va="center", fontsize=7.0, color=INK
    )


def _side_by_side(levels: Sequence[float]) -> list[float]:
    """Places of sorted levels, those that are equal drawn apart."""
    found: list[float] = []
    for number, level in enumerate(levels):
        rank, many = number - levels.index(level), levels.count(level)
        found.append(level + 0.008 * (rank - 0.5 * (many - 1)))
    return found


def _plain(axis: "Axis") -> None:
    """Logarithmic ticks as plain numbers at 1, 2 and 5."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())
