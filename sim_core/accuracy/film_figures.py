"""The film's figures as SVG: error against time for each of its knobs, and the strip over Newton steps."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from sim_core.accuracy.figures import finish
from sim_core.accuracy.film import FLOOR_MM, FilmFindings, Knob
from sim_core.accuracy.film_strip import BAR, StripPoint
from sim_core.report_figures import BAD, BANDS, INK, WIDTH_IN, drawing_settings, svg_text

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_MARKS = ("o", "s")
_LEAST_STRIP_ERROR = 1.0e-9


def knobs_figure(findings: FilmFindings, allowed_mm: float) -> str:
    """Error (x) against processor time (y), a panel a knob, the value beside each point and the default ringed."""
    from matplotlib.figure import Figure

    panels: dict[str, list[Knob]] = {}
    for knob in findings.knobs:
        panels.setdefault(knob.name.split(",")[0], []).append(knob)
    with drawing_settings():
        figure = Figure(figsize=(WIDTH_IN, 3.5))
        drawn = figure.subplots(
            1, len(panels), squeeze=False,
            gridspec_kw={"left": 0.065, "right": 0.985, "top": 0.92, "bottom": 0.15, "wspace": 0.24},
        )  # fmt: skip
        for axes, (name, knobs) in zip(drawn.flat, panels.items(), strict=True):
            for number, knob in enumerate(knobs):
                _draw_knob(axes, knob, number)
            axes.axvline(allowed_mm, color=BAD, linewidth=1.0, linestyle=(0, (4, 2)))
            finish(axes, "error of the peak [mm]", "processor time [s]")
            axes.set_title(name if len(knobs) > 1 else f"{name}: {_order(knobs[0])}")
            if len(knobs) > 1:
                axes.legend(frameon=False, fontsize=7.0, loc="upper left", bbox_to_anchor=(0.0, 1.0))
        return svg_text(figure, "Error against time for mesh, tolerance and step of the film", "film-knobs")


def strip_figure(points: Sequence[StripPoint]) -> str:
    """Error of a pulled strip's elongation over Newton steps, a line a stiffness."""
    from matplotlib.figure import Figure

    with drawing_settings():
        figure = Figure(figsize=(WIDTH_IN, 3.4))
        axes = figure.subplots(1, 1, gridspec_kw={"left": 0.075, "right": 0.985, "top": 0.97, "bottom": 0.14})
        for number, stiffness in enumerate(sorted({point.stiffness_npm for point in points})):
            own = [point for point in points if point.stiffness_npm == stiffness]
            axes.plot(
                [point.steps for point in own], [max(point.error, _LEAST_STRIP_ERROR) for point in own],
                color=BANDS[number % len(BANDS)], marker=_MARKS[number % 2], markersize=4, linewidth=1.2,
                label=f"E·t = {stiffness / 1000.0:g} kN/m",
            )  # fmt: skip
        axes.axhline(BAR, color=BAD, linewidth=1.0, linestyle=(0, (4, 2)))
        finish(axes, "Newton steps", "error of the elongation")
        axes.set_xscale("linear")
        axes.legend(frameon=False)
        return svg_text(figure, "Error of a pulled strip's elongation over Newton steps", "film-strip")


def _order(knob: Knob) -> str:
    return f"order {knob.order[0]:.1f}" if knob.order is not None and knob.has_order else "no order"


def _draw_knob(axes: "Axes", knob: Knob, number: int) -> None:
    points = [(max(error, FLOOR_MM), row.cpu_s, value) for value, error, row in knob.points]
    colour = BANDS[1 + 3 * number]
    label = f"{knob.name.split(', ')[1] if ', ' in knob.name else 'fine film'}: {_order(knob)}"
    axes.plot(
        [error for error, _, _ in points], [cpu for _, cpu, _ in points], color=colour, marker=_MARKS[number],
        markersize=4, linewidth=1.2, label=label,
    )  # fmt: skip
    for error, cpu, value in points:
        text = f"1/{1.0 / value:.0f}" if knob.unit == "s" else f"{value:g}"
        axes.annotate(text, (error, cpu), (4, 3), textcoords="offset points", fontsize=6.5, color=INK)
        if abs(value - knob.default) < 1.0e-9:
            axes.plot(
                [error], [cpu], marker="o", markersize=10, fillstyle="none", color=colour, linestyle="none"
            )
