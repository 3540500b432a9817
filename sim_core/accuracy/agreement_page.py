"""What the rows of the engines' grid say: rule by rule, in sum, as a figure and as a table."""

import csv
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from math import ceil
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

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

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from sim_core.accuracy.agreement import Row

Outcome = Literal["agree", "inside the estimate", "disagree"]

ENGINES = ("bullet", "mujoco")
LEAST_SHARE = 0.97
"""Of the verdicts outside the error estimates, this share must agree."""
NEAR = 3.0
"""A displacement within this factor of its limit is near it: the verdicts that are not plain from afar."""
COLLAPSE_MM = 500.0
"""A load that moves further has collapsed: its path is chaotic, and only its verdict counts."""
MAPS_A_ROW = 4
RULES = {
    "elastic": "elastic peak, any part",
    "permanent": "permanent, any part",
    "permanent_on_pallet": "permanent, on the pallet",
}
LEAST_PERCENT = 0.1
"""Smaller displacements are drawn here: a logarithm has no zero."""

# Colour and words, from harmless to grave.
_LOOKS = {
    "pass": (BANDS[1], "both engines: pass"),
    "fail": (BAD, "both engines: fail"),
    "open": (BANDS[3], "a rule differs, inside the error estimate"),
    "differ": (INK, "a rule differs outside the error estimates"),
}


@dataclass(frozen=True)
class Compared:
    """One rule of one scene on both engines.

    Attributes:
        first: the row of one engine.
        second: that of the other.
        rule: the rule's name.
    """

    first: "Row"
    second: "Row"
    rule: str

    @property
    def is_settled(self) -> bool:
        """Whether the rule's limit lies outside both error estimates."""
        return self.first.is_settled(self.rule) and self.second.is_settled(self.rule)

    @property
    def outcome(self) -> Outcome:
        """Equal states agree; others are inside the estimate where the product would say ``unresolved``."""
        if self.first.states.get(self.rule) == self.second.states.get(self.rule):
            return "agree"
        return "disagree" if self.is_settled else "inside the estimate"

    @property
    def is_near(self) -> bool:
        """Whether the worst displacement of one of the two is within ``NEAR`` times of the limit, either way."""
        return any(
            1.0 / NEAR <= row.worst_mm[self.rule] / row.limit_mm[self.rule] <= NEAR
            for row in (self.first, self.second)
            if self.rule in row.worst_mm
        )

    @property
    def is_covered(self) -> bool | None:
        """Whether both estimates together cover the difference; None without estimates or in a collapse."""
        worst = [row.worst_mm.get(self.rule) for row in (self.first, self.second)]
        errors = [row.error_mm.get(self.rule) for row in (self.first, self.second)]
        if None in worst or None in errors or max(w or 0.0 for w in worst) > COLLAPSE_MM:
            return None
        return abs((worst[0] or 0.0) - (worst[1] or 0.0)) <= sum(e or 0.0 for e in errors)

    def in_numbers(self) -> dict[str, Any]:
        """Both engines' state, worst displacement and estimate."""
        return {
            "scene": self.first.scene,
            "rule": self.rule,
            **{
                row.engine: {
                    "state": row.states.get(self.rule),
                    "worst_mm": row.worst_mm.get(self.rule),
                    "limit_mm": row.limit_mm.get(self.rule),
                    "error_mm": row.error_mm.get(self.rule),
                    "problem": row.problem or row.ended_by,
                    "unmet_friction": row.unmet_friction,
                }
                for row in (self.first, self.second)
            },
        }


def compare(rows: Sequence["Row"]) -> list[Compared]:
    """Every rule of every scene that both engines have a row of."""
    by_scene: dict[str, dict[str, Row]] = {}
    for row in rows:
        by_scene.setdefault(row.scene, {})[row.engine] = row
    pairs = [(pair[ENGINES[0]], pair[ENGINES[1]]) for pair in by_scene.values() if len(pair) == len(ENGINES)]
    return [
        Compared(first, second, rule) for first, second in pairs for rule in {**first.states, **second.states}
    ]


def summary(rows: Sequence["Row"]) -> dict[str, Any]:
    """How the comparison came out, in numbers.

    ``share`` counts only verdicts whose limit lies outside both error estimates (``outside``): states that
    are equal, but inside an estimate, don't speak for the engines, since the product calls them unresolved.
    ``near_limit`` is the part of them that is not plain from afar, and ``displacements`` tells how far the
    estimates themselves are to be trusted: how many of the displacements differ by less than both together.
    """
    compared = compare(rows)
    outcomes = [entry.outcome for entry in compared]
    outside = [entry.outcome for entry in compared if entry.is_settled]
    near = [entry.outcome for entry in compared if entry.is_settled and entry.is_near]
    covered = [entry.is_covered for entry in compared if entry.is_covered is not None]
    share = outside.count("agree") / len(outside) if outside else None
    pairs = {entry.first.scene: {entry.first.verdict, entry.second.verdict} for entry in compared}
    verdicts = list(pairs.values())
    return {
        "scenes": len(pairs),
        "verdicts": len(compared),
        "agreeing": outcomes.count("agree"),
        "inside_the_estimate": outcomes.count("inside the estimate"),
        "disagreeing": outcomes.count("disagree"),
        "outside": len(outside),
        "outside_agreeing": outside.count("agree"),
        "share": share,
        "least_share": LEAST_SHARE,
        "is_met": share is not None and share >= LEAST_SHARE,
        "near_limit": len(near),
        "near_limit_agreeing": near.count("agree"),
        "displacements": len(covered),
        "displacements_within_estimates": sum(covered),
        "both_pass": verdicts.count({"pass"}),
        "both_fail": verdicts.count({"fail"}),
        "pass_against_fail": verdicts.count({"pass", "fail"}),
        "unresolved": sum("unresolved" in verdict for verdict in verdicts),
        "rows_without_estimate": sum(row.problem is not None for row in rows),
        "rows_ended_early": sum(row.ended_by is not None for row in rows),
        "wall_s": sum(row.wall_s + row.companion_wall_s for row in rows),
        "disagreements": [entry.in_numbers() for entry in compared if entry.outcome == "disagree"],
    }


def agreement_figure(rows: Sequence["Row"], summed: Mapping[str, Any]) -> str:
    """A map of level and friction for each layout, and under them the worst displacements of both engines.

    Args:
        rows: the grid's rows.
        summed: their summary.
    """
    from matplotlib.figure import Figure
    from matplotlib.patches import Patch

    compared = compare(rows)
    names = list(dict.fromkeys(row.layout for row in rows))
    map_rows = ceil(len(names) / MAPS_A_ROW)
    with drawing_settings():
        figure = Figure(figsize=(WIDTH_IN, 1.05 + 1.75 * map_rows + 3.6))
        maps, clouds = figure.subfigures(2, 1, height_ratios=[0.75 + 1.75 * map_rows, 3.6], squeeze=False)[
            :, 0
        ]
        panels = maps.subplots(
            map_rows, MAPS_A_ROW, squeeze=False,
            gridspec_kw={"left": 0.07, "right": 0.98, "top": 1.0 - 0.95 / (0.75 + 1.75 * map_rows),
                         "bottom": 0.1, "wspace": 0.17, "hspace": 0.62},
        )  # fmt: skip
        for axes, name in zip(panels.flat, names, strict=False):
            _draw_map(axes, [entry for entry in compared if entry.first.layout == name], name)
        for axes in panels[:, 0]:
            axes.set_ylabel("friction", labelpad=2.0)
        for axes in panels.flat[len(names) :]:
            axes.set_axis_off()
        maps.suptitle(_headline(summed), x=0.07, ha="left", fontsize=10.0, color=INK)
        maps.legend(
            handles=[Patch(facecolor=colour, label=words) for colour, words in _LOOKS.values()],
            loc="upper left", bbox_to_anchor=(0.06, 1.0 - 0.27 / (0.75 + 1.75 * map_rows)), ncols=4, frameon=False,
            columnspacing=1.4, handlelength=1.2, borderpad=0.2,
        )  # fmt: skip
        cloud_panels = clouds.subplots(
            1, 3, gridspec_kw={"left": 0.07, "right": 0.98, "top": 0.9, "bottom": 0.14, "wspace": 0.26}
        )
        for axes, (rule, title) in zip(cloud_panels, RULES.items(), strict=True):
            _draw_cloud(axes, [entry for entry in compared if entry.rule == rule], title)
        cloud_panels[0].set_ylabel(f"{ENGINES[1]}: % of the limit")
        cloud_panels[0].text(0.13, 1.1e4, "only one\nengine passes", color=INK, va="top", fontsize=7.0)
        return svg_text(figure, "Verdicts and displacements of both engines over the grid", "agreement")


def write_table(rows: Sequence["Row"], path: Path) -> None:
    """Writes the rows as CSV, whole or not at all: a column for every rule's state, displacement and estimate."""
    flat = []
    for row in rows:
        entry: dict[str, Any] = {}
        for name, value in asdict(row).items():
            if isinstance(value, Mapping):
                entry |= {f"{name}_{rule}": number for rule, number in value.items()}
            elif name == "unmet_friction":
                entry[name] = json.dumps(value)
            elif name != "key":
                entry[name] = value
        flat.append(entry)
    columns = list(dict.fromkeys(name for entry in flat for name in entry))
    scratch = path.with_name(path.name + ".part")
    with scratch.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, columns, restval="")
        writer.writeheader()
        writer.writerows(flat)
    scratch.replace(path)


def look_of(compared: Sequence[Compared]) -> str:
    """How some rules of one scene are drawn: as their worst, from ``pass`` to ``differ``."""
    outcomes = {entry.outcome for entry in compared}
    if "disagree" in outcomes:
        return "differ"
    if "inside the estimate" in outcomes:
        return "open"
    return "fail" if any(entry.first.states.get(entry.rule) == "fail" for entry in compared) else "pass"


def _headline(summed: Mapping[str, Any]) -> str:
    if summed["share"] is None:
        return "No verdict outside the error estimates"
    return (
        f"{summed['outside_agreeing']} of {summed['outside']} verdicts outside the error estimates agree"
        f" ({100.0 * summed['share']:.1f} %) in {summed['scenes']} scenes;"
        f" near the limit {summed['near_limit_agreeing']} of {summed['near_limit']}"
    )


def _draw_map(axes: "Axes", compared: Sequence[Compared], name: str) -> None:
    from matplotlib.patches import Rectangle

    levels = sorted({entry.first.level_g for entry in compared})
    frictions = sorted({entry.first.friction for entry in compared})
    for level_g in levels:
        for friction in frictions:
            scene = [e for e in compared if e.first.level_g == level_g and e.first.friction == friction]
            if not scene:
                continue
            colour = _LOOKS[look_of(scene)][0]
            x, y = levels.index(level_g), frictions.index(friction)
            axes.add_patch(Rectangle((x - 0.47, y - 0.45), 0.94, 0.9, facecolor=colour, edgecolor="none"))
            axes.text(x, y, _cell_words(scene), ha="center", va="center", color=PAPER, fontsize=7.0)
    axes.set_xlim(-0.5, max(len(levels), 5) - 0.5)
    axes.set_ylim(-0.5, max(len(frictions), 1) - 0.5)
    axes.set_xticks(range(len(levels)), [f"{level_g:g}" for level_g in levels])
    axes.set_yticks(range(len(frictions)), [f"{friction:g}" for friction in frictions])
    axes.tick_params(length=0)
    for side in ("left", "bottom"):
        axes.spines[side].set_visible(False)
    axes.set_title(name)
    axes.set_xlabel("level [g]", labelpad=1.0)


def _cell_words(scene: Sequence[Compared]) -> str:
    """What both engines say of the load as a whole, and how many rules they differ in."""
    failed = {
        "fail" if "fail" in row.states.values() else "pass" for row in (scene[0].first, scene[0].second)
    }
    word = failed.pop() if len(failed) == 1 else "differ"
    differing = sum(entry.outcome != "agree" for entry in scene)
    return f"{word}\n{differing} rule{'s' if differing > 1 else ''}" if differing else word


def _draw_cloud(axes: "Axes", compared: Sequence[Compared], title: str) -> None:
    """Worst displacement on one engine against that on the other, in per cent of the limit."""
    from matplotlib.ticker import FuncFormatter

    top = 2.0e4
    axes.set_xscale("log")
    axes.set_yscale("log")
    # Where one engine passes and the other fails.
    axes.fill_between([LEAST_PERCENT, 100.0], 100.0, top, color=GRID, linewidth=0.0, zorder=0)
    axes.fill_between([100.0, top], LEAST_PERCENT, 100.0, color=GRID, linewidth=0.0, zorder=0)
    axes.plot([LEAST_PERCENT, top], [LEAST_PERCENT, top], color=FAINT, linewidth=0.7, linestyle=(0, (3, 2)))
    axes.axvline(100.0, color=BAD, linewidth=0.9)
    axes.axhline(100.0, color=BAD, linewidth=0.9)
    for entry in compared:
        values, bars = [], []
        for row in (entry.first, entry.second):
            worst, limit = row.worst_mm.get(entry.rule), row.limit_mm.get(entry.rule)
            if worst is None or limit is None:
                break
            percent, error = 100.0 * worst / limit, 100.0 * row.error_mm.get(entry.rule, 0.0) / limit
            values.append(max(percent, LEAST_PERCENT))
            low, high = (max(percent - error, LEAST_PERCENT), max(percent + error, LEAST_PERCENT))
            bars.append(([values[-1] - low], [high - values[-1]]))
        if len(values) < 2:
            continue
        colour = _LOOKS[look_of([entry])][0]
        axes.errorbar(
            values[0], values[1], xerr=bars[0], yerr=bars[1], fmt="o", markersize=3.6, color=colour,
            elinewidth=0.5, markeredgecolor=PAPER, markeredgewidth=0.4,
        )  # fmt: skip
    axes.set_xlim(LEAST_PERCENT, top)
    axes.set_ylim(LEAST_PERCENT, top)
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axis.set_ticks([0.1, 1.0, 10.0, 100.0, 1000.0, 10000.0])
        axis.set_minor_locator(_none())
    axes.text(0.13, 115.0, "limit", color=BAD, va="bottom", bbox=HALO)
    axes.set_title(title)
    axes.set_xlabel(f"{ENGINES[0]}: % of the limit")


def _none() -> Any:
    from matplotlib.ticker import NullLocator

    return NullLocator()
