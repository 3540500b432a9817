"""The accuracy page's figures as SVG: error against wall time and against step, and growth with the load."""

import re
from collections.abc import Sequence
from math import ceil
from typing import TYPE_CHECKING, Any

import numpy as np

from sim_core.accuracy.fronts import GrowthPoint, Order, growth_exponents
from sim_core.accuracy.sweep import Row
from sim_core.report_figures import BAD, BANDS, FAINT, GRID, HALO, INK, WIDTH_IN, drawing_settings, svg_text
from sim_core.report_style import STYLE

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_MARKS = {"bullet": "o", "mujoco": "s"}
_LEAST_ERROR = 1.0e-5
"""Smaller errors are drawn here: a logarithm has no zero."""


def work_precision_figure(rows: Sequence[Row], cases: Sequence[str]) -> str:
    """Error (x) against wall time for each simulated second (y), a panel a case and a line a setting family.

    Failed settings are listed in a hatched band at the right edge of their panel.
    """
    from matplotlib.figure import Figure

    with drawing_settings():
        height_in = 2.6 * ceil(len(cases) / 2) + 0.6
        figure = Figure(figsize=(WIDTH_IN, height_in))
        top, bottom = 1.0 - 0.7 / height_in, 0.5 / height_in
        panels = figure.subplots(
            ceil(len(cases) / 2), 2, squeeze=False,
            gridspec_kw={"left": 0.07, "right": 0.98, "top": top, "bottom": bottom, "wspace": 0.2, "hspace": 0.42},
        )  # fmt: skip
        families = _families(rows)
        for axes, case in zip(panels.flat, cases, strict=False):
            _draw_work(axes, [row for row in rows if row.case == case], case, families)
        for axes in panels.flat[len(cases) :]:
            axes.set_axis_off()
        handles = {
            h.get_label(): h for axes in panels.flat for h in axes.get_lines() if h.get_label()[0] != "_"
        }
        figure.legend(handles.values(), handles.keys(), loc="upper center", ncols=7, frameon=False)
        return svg_text(figure, "Error against wall time, by case and setting", "work-precision")


def order_figure(rows: Sequence[Row], cases: Sequence[str], orders: Sequence[Order]) -> str:
    """Error against step, a panel a case, with the fitted order of each setting family."""
    from matplotlib.figure import Figure

    with drawing_settings():
        figure = Figure(figsize=(WIDTH_IN, 2.6 * ceil(len(cases) / 2) + 0.4))
        panels = figure.subplots(
            ceil(len(cases) / 2), 2, squeeze=False,
            gridspec_kw={"left": 0.07, "right": 0.98, "top": 0.96, "bottom": 0.08, "wspace": 0.2, "hspace": 0.42},
        )  # fmt: skip
        families = _families(rows)
        for axes, case in zip(panels.flat, cases, strict=False):
            _draw_orders(axes, [row for row in rows if row.case == case], case, families, orders)
        for axes in panels.flat[len(cases) :]:
            axes.set_axis_off()
        return svg_text(figure, "Error against step with fitted orders", "order")


def growth_figure(points: Sequence[GrowthPoint]) -> str:
    """Real-time factor against packages, and time a step against contacts, by engine."""
    from matplotlib.figure import Figure

    with drawing_settings():
        figure = Figure(figsize=(WIDTH_IN, 3.2))
        speed, cost = figure.subplots(
            1, 2, gridspec_kw={"left": 0.07, "right": 0.98, "top": 0.95, "bottom": 0.15, "wspace": 0.2}
        )
        exponents = growth_exponents(points)
        for colour, engine in zip((BANDS[1], BANDS[4]), sorted({p.engine for p in points}), strict=False):
            own = [p for p in points if p.engine == engine]
            style = {"color": colour, "marker": _MARKS[engine], "markersize": 4, "linewidth": 1.2}
            speed.plot([p.packages for p in own], [p.real_time_factor for p in own], label=engine, **style)
            name = f"{engine}: ∝ contacts^{exponents[engine]:.2f}" if engine in exponents else engine
            cost.plot([p.contacts for p in own], [p.step_ms for p in own], label=name, **style)
        speed.axhline(1.0, color=FAINT, linewidth=0.8, linestyle=(0, (3, 2)))
        finish(speed, "packages", "real-time factor")
        finish(cost, "contacts", "wall time a step [ms]")
        for axes in (speed, cost):
            axes.legend(frameon=False)
        return svg_text(figure, "Real-time factor and time a step against the size of the load", "growth")


def standalone_svg(svg: str) -> str:
    """A figure as a file of its own: with its name space, and with the page's colours in light and dark."""
    light, dark = (
        "".join(re.findall(r"--(?:ink|faint|grid|bad|stop|pallet|sled|paper|band\d):#[0-9a-f]+;?", block))
        for block in re.findall(r":root\{(.*?)\}", STYLE, flags=re.DOTALL)[:2]
    )
    light, dark = (re.sub(r"(#[0-9a-f]+)(?=--)", r"\1;", block) for block in (light, dark))
    style = (
        f"<style>svg{{{light};background:var(--paper)}}"
        f"@media (prefers-color-scheme:dark){{svg{{{dark}}}}}"
        'svg text{font-family:"DejaVu Sans",Verdana,Arial,sans-serif}</style>'
    )
    opened = svg.index(">") + 1
    head = svg[:opened].replace("<svg ", '<svg xmlns="http://www.w3.org/2000/svg" ')
    return head + style + svg[opened:] + "\n"


Family = tuple[str, str, Any]


def _families(rows: Sequence[Row]) -> dict[str, Family]:
    """Colour, marker and line of each setting family; those of few cases come last, and take colours again, dashed."""
    cases = {(row.engine, row.iterations): set[str]() for row in rows}
    for row in rows:
        cases[row.engine, row.iterations].add(row.case)
    most = max((len(found) for found in cases.values()), default=0)
    names = sorted(cases, key=lambda name: (2 * len(cases[name]) < most, name))
    return {
        f"{engine} × {iterations}": (
            BANDS[i % len(BANDS)], _MARKS[engine], "solid" if i < len(BANDS) else (0, (3, 1.5)),
        )
        for i, (engine, iterations) in enumerate(names)
    }  # fmt: skip


def _draw_work(axes: "Axes", rows: Sequence[Row], case: str, families: dict[str, Family]) -> None:
    from matplotlib.patches import Rectangle

    done = [row for row in rows if row.error is not None and row.real_time_factor]
    for family, (colour, mark, line) in families.items():
        own = sorted((row for row in done if row.setting.family == family), key=lambda row: row.rate_hz)
        if not own:
            continue
        errors = [max(row.error or 0.0, _LEAST_ERROR) for row in own]
        costs = [1.0 / (row.real_time_factor or 1.0) for row in own]
        axes.plot(
            errors,
            costs,
            color=colour,
            marker=mark,
            linestyle=line,
            markersize=4,
            linewidth=1.2,
            label=family,
        )
        for row, error, cost in ((own[0], errors[0], costs[0]), (own[-1], errors[-1], costs[-1])):
            axes.annotate(
                f"1/{row.rate_hz}", (error, cost), (3, 3), textcoords="offset points", fontsize=6.5, color=INK
            )
    units = {q.unit for row in done for q in row.quantities}
    unit = "relative" if units == {"g"} else "mm"
    bar = min((q.bar for row in done for q in row.quantities), default=None)
    if bar is not None:
        axes.axvline(bar, color=BAD, linewidth=1.0, linestyle=(0, (4, 2)))
    finish(axes, f"largest error [{unit}]", "wall s per simulated s")
    axes.set_title(case)
    failed = [row for row in rows if row.failed]
    if failed:
        left, right = axes.get_xlim()
        axes.set_xlim(left, right * (right / left) ** 0.3)
        axes.add_patch(
            Rectangle(
                (0.77, 0.0),
                0.23,
                1.0,
                transform=axes.transAxes,
                facecolor="none",
                edgecolor=GRID,
                hatch="////",
            )
        )
        names = "\n".join(row.setting.words for row in failed[:6])
        more = f"\nand {len(failed) - 6} more" if len(failed) > 6 else ""
        axes.text(
            0.99, 0.97, f"failed:\n{names}{more}", transform=axes.transAxes, ha="right", va="top",
            fontsize=6.0, color=BAD, bbox=HALO,
        )  # fmt: skip


def _draw_orders(
    axes: "Axes",
    rows: Sequence[Row],
    case: str,
    families: dict[str, Family],
    orders: Sequence[Order],
) -> None:
    for family, (colour, mark, line) in families.items():
        own = sorted(
            (1.0 / row.rate_hz, max(row.error, _LEAST_ERROR))
            for row in rows
            if row.setting.family == family and row.error is not None
        )
        if not own:
            continue
        fitted = next((o for o in orders if o.case == case and o.family == family), None)
        name = family + (f": order {fitted.order:.2f}" if fitted is not None else "")
        steps, errors = np.array(own).T
        axes.plot(
            steps, errors, color=colour, marker=mark, linestyle=line, markersize=4, linewidth=1.2, label=name
        )
    finish(axes, "step [s]", "largest error [mm]")
    axes.set_title(case)
    axes.legend(frameon=False, fontsize=6.5)


def finish(axes: "Axes", x: str, y: str) -> None:
    """Logarithmic axes with plain numbers, a grid and labels."""
    from matplotlib.ticker import FuncFormatter, NullFormatter

    axes.set_xscale("log")
    axes.set_yscale("log")
    for axis in (axes.xaxis, axes.yaxis):
        low, high = axis.get_view_interval()
        plain = FuncFormatter(lambda value, _: f"{value:g}")
        axis.set_major_formatter(plain)
        # Less than a decade may hold no major tick at all.
        axis.set_minor_formatter(plain if high / low < 12.0 else NullFormatter())
        axis.set_tick_params(which="minor", labelsize=6.0)
    axes.grid(True, color=GRID, linewidth=0.5)
    axes.set_xlabel(x)
    axes.set_ylabel(y)
