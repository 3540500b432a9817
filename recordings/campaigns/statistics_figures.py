"""The figures of a campaign's statistics as SVG; their size does not grow with the number of tests.

Names that a user gave stand in no figure: legends with such names are the page's, by ``colour``.
"""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from recordings.campaigns.labels import RULES, Label
from recordings.campaigns.one_test import Cost
from recordings.campaigns.statistics import height_share
from recordings.campaigns.statistics_groups import Group
from recordings.campaigns.statistics_outliers import limit_mm
from recordings.campaigns.statistics_rates import rate_of
from sim_core.frames import Array
from sim_core.report_figures import BAD, BANDS, GRID, INK, WIDTH_IN, drawing_settings, svg_text

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MOST_CURVES = len(BANDS)
STATES = ("pass", "unresolved", "fail")
_STATE_COLOURS = {"pass": BANDS[1], "unresolved": BANDS[3], "fail": BAD}
_CELLS = 36
_MARKS = "os^Dv<"


def colour(place: int) -> str:
    """CSS colour of the curve or part with this place."""
    return f"var(--band{place % len(BANDS)})"


def level_figure(labels: Sequence[Label], level: Group, restraint: Group) -> str:
    """Share of passes (y) against the level (x), a curve a restraint, with 95 % intervals."""
    from matplotlib.figure import Figure

    with drawing_settings():
        figure = Figure(figsize=(WIDTH_IN, 3.0))
        axes = figure.subplots(1, 1, gridspec_kw={"left": 0.065, "right": 0.985, "top": 0.96, "bottom": 0.15})
        kinds = restraint.sorted_tests(labels)[:MOST_CURVES]
        for place, (_, tests) in enumerate(kinds):
            rates = [rate_of("", value, own) for value, own in level.sorted_tests(tests)]
            known = [rate for rate in rates if rate.rate is not None]
            # Side by side, so that intervals do not hide one another.
            xs = [level.values.index(rate.value) + 0.09 * (place - 0.5 * (len(kinds) - 1)) for rate in known]
            ys = np.array([[rate.rate, rate.low, rate.high] for rate in known], dtype=float).reshape(-1, 3)
            axes.errorbar(
                xs, 100.0 * ys[:, 0], yerr=100.0 * np.maximum(0.0, [ys[:, 0] - ys[:, 1], ys[:, 2] - ys[:, 0]]),
                color=BANDS[place], marker=_MARKS[place], markersize=4.5, linewidth=1.2, elinewidth=0.8,
                capsize=2.0,
            )  # fmt: skip
        axes.set_xticks(range(len(level.values)), level.values)
        axes.set_xlim(-0.5, len(level.values) - 0.5)
        axes.set_ylim(-3.0, 103.0)
        axes.grid(True, color=GRID, linewidth=0.5)
        axes.set_xlabel("level [g]")
        axes.set_ylabel("tests that pass [%]")
        return svg_text(figure, "Share of tests that pass against the level, by restraint", "campaign-level")


def place_figure(labels: Sequence[Label]) -> str:
    """Fails by height and by time of the first broken rule, a colour a rule."""
    from matplotlib.figure import Figure

    fails = [label for label in labels if label.success is False and label.first_rule in RULES]
    heights = [
        [share for t in fails if t.first_rule == rule and (share := height_share(t)) is not None]
        for rule in RULES
    ]
    times = [
        [t.first_time_s for t in fails if t.first_rule == rule and t.first_time_s is not None]
        for rule in RULES
    ]
    last = max((time_s for own in times for time_s in own), default=1.0)
    names = [rule.replace("_", " ") for rule in RULES]
    with drawing_settings():
        figure = Figure(figsize=(WIDTH_IN, 3.0))
        box = {"left": 0.065, "right": 0.985, "top": 0.86, "bottom": 0.15, "wspace": 0.18}
        where, when = figure.subplots(1, 2, gridspec_kw=box)
        where.hist(
            [[100.0 * min(1.0, share) for share in own] for own in heights], bins=np.linspace(0.0, 100.0, 11),
            stacked=True, orientation="horizontal", color=BANDS[: len(RULES)], label=names, rwidth=0.92,
        )  # fmt: skip
        when.hist(
            times,
            bins=np.linspace(0.0, 1.02 * last, 21),
            stacked=True,
            color=BANDS[: len(RULES)],
            rwidth=0.92,
        )
        where.set_xlabel("tests")
        where.set_ylabel("height of the place [% of the load's]")
        when.set_xlabel("time of the first broken rule, from the first frame [s]")
        when.set_ylabel("tests")
        for axes in (where, when):
            axes.grid(True, color=GRID, linewidth=0.5)
            axes.set_axisbelow(True)
        _whole_ticks(where, "x")
        _whole_ticks(when, "y")
        figure.legend(*where.get_legend_handles_labels(), loc="upper left", ncols=4, frameon=False)
        return svg_text(figure, "Where and when tests that fail break their first rule", "campaign-place")


def margin_figure(labels: Sequence[Label], rules: Sequence[str]) -> str:
    """Tests by their worst displacement as a share of the limit, a panel a rule, coloured by the rule's state."""
    from matplotlib.figure import Figure

    edges = np.linspace(0.0, 250.0, 26)
    with drawing_settings():
        figure = Figure(figsize=(WIDTH_IN, 2.8))
        box = {"left": 0.065, "right": 0.985, "top": 0.82, "bottom": 0.17, "wspace": 0.22}
        panels = figure.subplots(1, len(rules), gridspec_kw=box, squeeze=False)[0]
        for axes, rule in zip(panels, rules, strict=True):
            own = [(label, limit) for label in labels if (limit := limit_mm(label, rule))]
            shares = [
                [
                    min(249.0, 100.0 * t.worst_mm[rule] / limit)
                    for t, limit in own
                    if t.states.get(rule) == state
                ]
                for state in STATES
            ]
            axes.hist(
                shares,
                bins=edges,
                stacked=True,
                color=[_STATE_COLOURS[state] for state in STATES],
                label=STATES,
            )
            axes.axvline(100.0, color=INK, linewidth=1.0, linestyle=(0, (4, 2)))
            axes.set_title(rule.replace("_", " "))
            axes.set_xlim(0.0, 250.0)
            axes.set_xticks([0, 50, 100, 150, 200, 245], ["0", "50", "100", "150", "200", "more"])
            axes.set_xlabel("of the limit [%]")
            axes.grid(True, color=GRID, linewidth=0.5)
            axes.set_axisbelow(True)
            _whole_ticks(axes, "y")
        panels[0].set_ylabel("tests")
        figure.legend(*panels[0].get_legend_handles_labels(), loc="upper right", ncols=3, frameon=False)
        return svg_text(figure, "Worst displacement as a share of the limit, by rule", "campaign-margin")


def error_figure(labels: Sequence[Label], rules: Sequence[str]) -> str:
    """Error estimate (y) against distance from the limit (x), a panel a rule: above the line nothing is settled."""
    from matplotlib.figure import Figure

    with drawing_settings():
        figure = Figure(figsize=(WIDTH_IN, 3.2))
        box = {"left": 0.065, "right": 0.985, "top": 0.84, "bottom": 0.14, "wspace": 0.08}
        panels = figure.subplots(1, len(rules), sharex=True, sharey=True, gridspec_kw=box, squeeze=False)[0]
        for axes, rule in zip(panels, rules, strict=True):
            own = [label for label in labels if rule in label.error_mm and rule in label.margin_mm]
            margins = np.array([abs(label.margin_mm[rule]) for label in own])
            errors = np.array([label.error_mm[rule] for label in own])
            for state in STATES:
                chosen = np.array([label.states.get(rule) == state for label in own], dtype=bool)
                _binned_marks(
                    axes, margins[chosen], errors[chosen], _STATE_COLOURS[state], _MARKS[STATES.index(state)]
                )
            axes.set_xscale("log")
            axes.set_yscale("log")
            axes.axline((1.0, 1.0), (10.0, 10.0), color=INK, linewidth=1.0, linestyle=(0, (4, 2)))
            axes.set_title(rule.replace("_", " "))
            axes.set_xlabel("distance from the limit [mm]")
            axes.grid(True, color=GRID, linewidth=0.5)
            _plain(axes)
        panels[0].set_ylabel("error estimate [mm]")
        for state in STATES:
            panels[-1].plot(
                [],
                [],
                linestyle="none",
                marker=_MARKS[STATES.index(state)],
                color=_STATE_COLOURS[state],
                label=state,
            )
        figure.legend(*panels[-1].get_legend_handles_labels(), loc="upper right", ncols=3, frameon=False)
        return svg_text(figure, "Error estimate against distance from the limit, by rule", "campaign-error")


def numerics_figure(labels: Sequence[Label], limit_residual: float) -> str:
    """Share of the tests (y) with at most so deep a contact, and with at most so much energy from nowhere (x)."""
    from matplotlib.figure import Figure

    engines = sorted({label.engine for label in labels})
    with drawing_settings():
        figure = Figure(figsize=(WIDTH_IN, 2.6))
        box = {"left": 0.065, "right": 0.985, "top": 0.9, "bottom": 0.18, "wspace": 0.1}
        panels = figure.subplots(1, 2, sharey=True, gridspec_kw=box)
        for axes, what, factor, floor in zip(
            panels, ("penetration_mm", "energy_residual"), (1.0, 100.0), (0.01, 0.001), strict=True
        ):
            for place, engine in enumerate(engines):
                values = [
                    max(floor, factor * getattr(label, what)) for label in labels if label.engine == engine
                ]
                shares = np.linspace(0.0, 1.0, min(200, len(values)))
                axes.plot(
                    np.quantile(values, shares), 100.0 * shares, color=BANDS[1 + 3 * (place % 2)], linewidth=1.4,
                    linestyle=("solid", (0, (5, 2)))[place % 2], label=engine,
                )  # fmt: skip
            axes.set_xscale("log")
            axes.grid(True, color=GRID, linewidth=0.5)
            axes.set_ylim(0.0, 104.0)
            _plain(axes, "x")
        panels[1].axvline(100.0 * limit_residual, color=BAD, linewidth=1.0, linestyle=(0, (4, 2)))
        panels[0].set_xlabel("deepest contact of a test [mm]")
        panels[1].set_xlabel("energy from nowhere [% of what was put in]")
        panels[0].set_ylabel("tests [%]")
        panels[0].legend(loc="lower right", framealpha=0.85)
        return svg_text(figure, "Deepest contacts and energy residuals of the tests", "campaign-numerics")


def cost_figure(labels: Sequence[Label], costs: Mapping[int, Cost], restraint: Group | None) -> str:
    """Wall time of a test (y) against its packages (x), a colour a restraint."""
    from matplotlib.figure import Figure

    own = [label for label in labels if label.number in costs]
    kinds = restraint.sorted_tests(own)[:MOST_CURVES] if restraint is not None else [("", own)]
    with drawing_settings():
        figure = Figure(figsize=(WIDTH_IN, 3.0))
        axes = figure.subplots(1, 1, gridspec_kw={"left": 0.065, "right": 0.985, "top": 0.96, "bottom": 0.15})
        for place, (_, tests) in enumerate(kinds):
            packages = np.array([float(label.packages) for label in tests])
            walls = np.array([costs[label.number].wall_s for label in tests])
            _binned_marks(axes, packages, walls, BANDS[place], _MARKS[place])
        axes.set_xlim(left=0.0)
        axes.set_yscale("log")
        _plain(axes, "y")
        axes.grid(True, color=GRID, linewidth=0.5)
        axes.set_xlabel("packages")
        axes.set_ylabel("wall time of a test [s]")
        return svg_text(figure, "Wall time of a test against its packages", "campaign-cost")


def _binned_marks(axes: "Axes", xs: Array, ys: Array, colour_: str, mark: str) -> None:
    """A mark a cell of a logarithmic grid, its area as the number of tests in it."""
    inside = (xs > 0.0) & (ys > 0.0)
    if not inside.any():
        return
    points = np.log(np.stack([xs[inside], ys[inside]], axis=1))
    low, high = points.min(axis=0), points.max(axis=0)
    cell = np.where(high > low, (high - low) / _CELLS, 1.0)
    cells, place, counts = np.unique(
        np.floor((points - low) / cell).astype(int), axis=0, return_inverse=True, return_counts=True
    )
    middles = np.zeros((len(cells), 2))
    np.add.at(middles, place.ravel(), points)
    middles = np.exp(middles / counts[:, None])
    axes.scatter(
        middles[:, 0],
        middles[:, 1],
        s=14.0 * np.sqrt(counts),
        color=colour_,
        marker=mark,
        alpha=0.65,
        linewidths=0.0,
    )


def _plain(axes: "Axes", which: str = "xy") -> None:
    """Powers of ten as plain numbers, with marks at 2 and 5 where there are few of them."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    for name, axis, (low, high) in (("x", axes.xaxis, axes.get_xlim()), ("y", axes.yaxis, axes.get_ylim())):
        if name in which:
            axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if high < 200.0 * low else (1.0,)))
            axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
            axis.set_minor_formatter(NullFormatter())


def _whole_ticks(axes: "Axes", which: str) -> None:
    from matplotlib.ticker import MaxNLocator

    (axes.xaxis if which == "x" else axes.yaxis).set_major_locator(
        MaxNLocator(nbins=6, integer=True, min_n_ticks=1)
    )
