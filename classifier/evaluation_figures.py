"""The figures of a model's evaluation as SVG: curves, calibration, earliness, attention, breakdowns, robustness."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from classifier.breakdowns import Early, Group, Looks
from classifier.metrics import ReliabilityBin
from classifier.robustness import Robustness
from sim_core.frames import Array
from sim_core.report_figures import BAD, BANDS, FAINT, GRID, INK, WIDTH_IN, drawing_settings, svg_text

if TYPE_CHECKING:
    from matplotlib.axes import Axes

PASS, FAIL = BANDS[1], BANDS[4]
_DASHED: Any = (0, (4, 2))
_BOX = {"left": 0.065, "right": 0.985, "top": 0.93, "bottom": 0.16}


def curves_figure(
    roc: tuple[Array, Array], pr: tuple[Array, Array], share: float, here: Sequence[float]
) -> str:
    """ROC and precision-recall curves.

    Args:
        roc: see ``metrics.roc_curve``.
        pr: see ``metrics.pr_curve``.
        share: of passes among the tests, the precision of who calls all a pass.
        here: false-pass rate, recall and precision at the model's threshold; NaN where undefined.
    """
    from matplotlib.figure import Figure

    with drawing_settings():
        figure = Figure(figsize=(WIDTH_IN, 3.4))
        left, right = figure.subplots(1, 2, gridspec_kw={**_BOX, "wspace": 0.2, "bottom": 0.13})
        left.plot([0.0, 1.0], [0.0, 1.0], color=FAINT, linewidth=0.8, linestyle=_DASHED)
        left.plot(*roc, color=PASS, linewidth=1.4)
        left.plot(here[0], here[1], "o", color=INK, markersize=5.0)
        left.set_xlabel("fails called a pass")
        left.set_ylabel("passes called a pass (recall)")
        right.axhline(share, color=FAINT, linewidth=0.8, linestyle=_DASHED)
        right.plot(*pr, color=PASS, linewidth=1.4, drawstyle="steps-pre")
        right.plot(here[1], here[2], "o", color=INK, markersize=5.0)
        right.set_xlabel("recall")
        right.set_ylabel("precision")
        for axes in (left, right):
            _unit(axes)
        return svg_text(figure, "ROC curve, and precision against recall", "evaluation-curves")


def reliability_figure(bins: Sequence[ReliabilityBin]) -> str:
    """Share of passes (y) against the probability of success that was told (x), with intervals and counts."""
    from matplotlib.figure import Figure

    with drawing_settings():
        figure = Figure(figsize=(WIDTH_IN, 3.0))
        axes = figure.subplots(1, 1, gridspec_kw=_BOX)
        axes.plot([0.0, 1.0], [0.0, 1.0], color=FAINT, linewidth=0.8, linestyle=_DASHED)
        told, share = (np.array([getattr(row, name) for row in bins]) for name in ("told", "share"))
        low, high = (np.array([getattr(row, name) for row in bins]) for name in ("share_low", "share_high"))
        off = np.maximum(0.0, np.array([share - low, high - share]))
        axes.errorbar(told, share, yerr=off, fmt="o", color=PASS, ecolor=GRID, elinewidth=1.2, markersize=5.0)
        for row in bins:
            axes.annotate(
                f"{row.tests}",
                (row.told, row.share),
                (6, -3),
                textcoords="offset points",
                color=FAINT,
                fontsize=7.0,
            )
        _unit(axes)
        axes.set_xlabel("told probability of success")
        axes.set_ylabel("share that passed")
        return svg_text(
            figure, "Share of passes against the told probability of success", "evaluation-reliability"
        )


def early_figure(rows: Sequence[Early]) -> str:
    """Accuracy (y) against the share of the video that was seen (x), over all tests, passes and fails."""
    from matplotlib.figure import Figure

    with drawing_settings():
        figure = Figure(figsize=(WIDTH_IN, 2.9))
        axes = figure.subplots(1, 1, gridspec_kw=_BOX)
        share = [100.0 * row.share for row in rows]
        axes.fill_between(
            share, [row.low for row in rows], [row.high for row in rows], color=GRID, linewidth=0.0
        )
        for name, words, style in (
            ("accuracy", "all tests", {"color": INK, "marker": "o"}),
            ("pass_right", "passes", {"color": PASS, "marker": "s"}),
            ("fail_right", "fails", {"color": FAIL, "marker": "^"}),
            ("final", "as the last answer", {"color": FAINT, "linestyle": _DASHED}),
        ):  # fmt: skip
            values = [getattr(row, name) for row in rows]
            axes.plot(
                share,
                [np.nan if v is None else v for v in values],
                label=words,
                linewidth=1.3,
                markersize=4.0,
                **style,
            )
        axes.set_ylim(0.0, 1.03)
        axes.set_xlim(5.0, 102.0)
        axes.grid(True, color=GRID, linewidth=0.5)
        axes.set_xlabel("share of the pictures seen [%]")
        axes.set_ylabel("called what they are")
        axes.legend(loc="lower right", framealpha=0.85)
        return svg_text(figure, "Accuracy against the share of the video that was seen", "evaluation-early")


def looks_figure(looks: Looks) -> str:
    """Mean attention and mean change against the first picture over the video, of passes and of fails."""
    from matplotlib.figure import Figure

    with drawing_settings():
        figure = Figure(figsize=(WIDTH_IN, 2.9))
        panels = figure.subplots(1, 2, sharey=True, gridspec_kw={**_BOX, "wspace": 0.06})
        for axes, row, words in zip(panels, (0, 1), ("passes", "fails"), strict=True):
            scale = len(looks.time)
            axes.axhline(1.0, color=FAINT, linewidth=0.8, linestyle=_DASHED)
            axes.plot(
                100.0 * looks.time,
                scale * looks.change[row],
                color=BANDS[3],
                linewidth=1.3,
                label="change of the load",
            )
            axes.plot(
                100.0 * looks.time, scale * looks.attention[row], color=PASS, linewidth=1.6, label="attention"
            )
            axes.set_title(words)
            axes.set_xlim(0.0, 100.0)
            axes.set_ylim(bottom=0.0)
            axes.grid(True, color=GRID, linewidth=0.5)
            axes.set_xlabel("of the video [%]")
        panels[0].set_ylabel("times its mean")
        panels[0].legend(loc="upper left", framealpha=0.85)
        return svg_text(figure, "Attention and change of the load over the video", "evaluation-looks")


def groups_figure(rows: Sequence[Group], words: str, salt: str) -> str:
    """Share that was called what it is, with its interval, a group a line."""
    from matplotlib.figure import Figure

    with drawing_settings():
        height = 0.65 + 0.3 * len(rows)
        figure = Figure(figsize=(WIDTH_IN, height))
        axes = figure.subplots(
            1, 1, gridspec_kw={"left": 0.19, "right": 0.93, "top": 0.97, "bottom": 0.45 / height}
        )
        for place, row in enumerate(rows):
            axes.hlines(place, 100.0 * row.low, 100.0 * row.high, color=GRID, linewidth=4.0)
            axes.plot(100.0 * row.right, place, "o", color=PASS, markersize=5.0)
            axes.text(
                102.0,
                place,
                f"of {row.called_pass + row.called_fail}",
                va="center",
                color=FAINT,
                clip_on=False,
            )
        axes.set_yticks(range(len(rows)), [row.name.replace("_", " ") for row in rows])
        axes.set_ylim(len(rows) - 0.5, -0.5)
        axes.set_xlim(0.0, 101.0)
        axes.grid(True, axis="x", color=GRID, linewidth=0.5)
        axes.set_xlabel("called what they are [%]")
        return svg_text(figure, words, salt)


def robustness_figure(rows: Sequence[Robustness], most_lost: float) -> str:
    """Change of the accuracy under each condition, with its interval, and what may be lost."""
    from matplotlib.figure import Figure

    with drawing_settings():
        height = 0.65 + 0.34 * max(1, len(rows))
        figure = Figure(figsize=(WIDTH_IN, height))
        axes = figure.subplots(
            1, 1, gridspec_kw={"left": 0.16, "right": 0.98, "top": 0.97, "bottom": 0.45 / height}
        )
        axes.axvline(0.0, color=FAINT, linewidth=0.8)
        axes.axvline(-100.0 * most_lost, color=BAD, linewidth=1.0, linestyle=_DASHED)
        for place, row in enumerate(rows):
            if row.change.value is None:
                continue
            if row.change.low is not None and row.change.high is not None:
                axes.hlines(place, 100.0 * row.change.low, 100.0 * row.change.high, color=GRID, linewidth=4.0)
            axes.plot(100.0 * row.change.value, place, "o", color=PASS, markersize=5.0)
        axes.set_yticks(range(len(rows)), [row.condition for row in rows])
        axes.set_ylim(len(rows) - 0.5, -0.5)
        axes.grid(True, axis="x", color=GRID, linewidth=0.5)
        axes.set_xlabel("change of the accuracy [points]; dashed: what may be lost")
        return svg_text(figure, "Change of the accuracy under other conditions", "evaluation-robustness")


def _unit(axes: "Axes") -> None:
    axes.set_xlim(-0.02, 1.02)
    axes.set_ylim(-0.02, 1.04)
    axes.grid(True, color=GRID, linewidth=0.5)
