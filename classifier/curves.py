"""How a training went, as a picture: losses, validation accuracy and speed over the epochs."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from matplotlib.figure import Figure
from matplotlib.style import context

if TYPE_CHECKING:
    from classifier.learner import Epoch

_BLUE, _ORANGE, _GREY = "#1f5fa8", "#d1700a", "#8a8f98"


def write_curves(path: Path, epochs: "Sequence[Epoch]") -> None:
    """Draws the curves of all epochs so far, whole or not at all.

    Args:
        path: a ``.png``.
        epochs: from the first on.
    """
    numbers = [epoch.number for epoch in epochs]
    best = max(epoch.number for epoch in epochs if epoch.is_best)
    with context("default"):
        figure = Figure(figsize=(9.0, 3.0), dpi=110, layout="constrained")
        loss, accuracy, speed = figure.subplots(1, 3)
        style = {"marker": ".", "markersize": 4.0, "linewidth": 1.2}
        loss.plot(numbers, [epoch.train_loss for epoch in epochs], color=_BLUE, label="training", **style)
        loss.plot(
            numbers, [epoch.validation_loss for epoch in epochs], color=_ORANGE, label="validation", **style
        )
        loss.set_ylabel("weighted cross-entropy")
        loss.set_ylim(bottom=0.0)
        accuracy.plot(
            numbers, [100.0 * epoch.validation_accuracy for epoch in epochs], color=_ORANGE, **style
        )
        accuracy.set_ylabel("validation accuracy [%]")
        speed.plot(numbers, [epoch.frames_hz for epoch in epochs], color=_BLUE, **style)
        speed.set_ylabel("frames a second")
        speed.set_ylim(bottom=0.0)
        for axes in (loss, accuracy, speed):
            axes.axvline(best, color=_GREY, linewidth=0.8, linestyle="--", label="best")
            axes.set_xlabel("epoch")
            axes.spines[["top", "right"]].set_visible(False)
        loss.legend(frameon=False, fontsize=8)
        scratch = path.with_name(path.name + ".part")
        figure.savefig(scratch, format="png")
    scratch.replace(path)
