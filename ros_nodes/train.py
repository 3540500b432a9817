"""``pallet-twin train``: learns pass and fail from a campaign's videos, and shows how far it is."""

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn

from config.errors import RefusedInput
from ros_nodes import output

if TYPE_CHECKING:
    from classifier.configuration import NetworkConfig
    from classifier.training import Epoch, Trained, TrainingConfig


def require_torch(command: str) -> None:
    """Refuses a command that needs what the extra ``classifier`` brings, where it is not installed."""
    if find_spec("torch") is None:
        raise RefusedInput(command, "torch", "is not installed: pip install 'pallet-twin[classifier]'")


def train(
    campaign: Annotated[
        Path, typer.Argument(metavar="FOLDER", help="Of a campaign; pallet-twin campaign makes one.")
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR", help="Folder of the training; gone on with. Default: FOLDER-PRESET-SPLIT."
        ),
    ] = None,
    preset: Annotated[
        Literal["compact", "paper"],
        typer.Option(
            help="compact: learns on two cores within the hour; paper: ResNet-50 at 224 px, wants a GPU."
        ),
    ] = "compact",
    split: Annotated[
        Literal["scheme", "random"],
        typer.Option(
            help="scheme: the test part has palletising schemes of its own; random: as the paper does."
        ),
    ] = "scheme",
    seed: Annotated[
        int | None,
        typer.Option(min=0, help="Of first weights, order and augmentation. Same seed, same weights."),
    ] = None,
    epochs: Annotated[int | None, typer.Option(min=1, help="At most so many.")] = None,
    set_: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="KEY=VALUE",
            help="Override a setting, e.g. training.batch=4 or network.size_px=96. May be repeated.",
        ),
    ] = None,
    weights: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="ImageNet weights for the backbone, a .pth as torchvision's."),
    ] = None,
    cache: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder of prepared clips. Default: FOLDER/clips.")
    ] = None,
    workers: Annotated[
        int | None,
        typer.Option(
            min=1, max=1024, help="Processes that prepare clips. Default: as many as there are cores."
        ),
    ] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print the result as one JSON object on standard output.")
    ] = False,
) -> None:
    """Train a network that tells pass from fail by the video alone, on the bags of a campaign.

    A fifth of the tests is kept for `pallet-twin evaluate`, a tenth says which epoch's network is kept and, for paper,
    when to stop: after ten epochs without a lower loss. DIR/model is the best network so far, DIR/curves.png shows the
    way there, DIR/run.json says what made it.

    End it at any moment: the same command goes on after the last whole epoch, to the same weights. Several GPUs or
    processes: `torchrun --nproc-per-node 4 --no-python pallet-twin train FOLDER`; --set training.batch is for each.

    Examples: `pallet-twin train runs/paper`, `pallet-twin train runs/paper --split random --seed 1 --out runs/r1`.
    """
    require_torch("train")
    network, training = settings(preset, set_ or (), seed=seed, epochs=epochs)
    from classifier.training import train as learn

    folder = out if out is not None else campaign.with_name(f"{campaign.resolve().name}-{preset}-{split}")
    first = os.environ.get("RANK", "0") == "0"
    quiet = as_json or not first
    with _bar(training, quiet=quiet) as bar:
        trained = learn(
            campaign,
            folder,
            network=network,
            training=training,
            split=split,
            weights=weights,
            cache=cache,
            workers=workers if workers is not None else len(os.sched_getaffinity(0)),
            on_clip=bar.clip if bar is not None else None,
            on_step=bar.step if bar is not None else None,
            on_epoch=bar.epoch if bar is not None else None,
        )
    if first:
        output.show_lines(*_told(trained, folder), as_json=as_json)


def settings(
    preset: str, overrides: Sequence[str], *, seed: int | None, epochs: int | None
) -> "tuple[NetworkConfig, TrainingConfig]":
    """Network and training of a preset, with some values changed.

    Args:
        preset: ``compact`` or ``paper``.
        overrides: ``network.key=value`` and ``training.key=value`` texts.
        seed: in the place of the preset's.
        epochs: in the place of the preset's.

    Raises:
        RefusedInput: an override cannot be used.
    """
    from classifier.configuration import preset as network_preset
    from classifier.training_config import training_preset
    from config.scene_file import apply_override

    raw: dict[str, Any] = {"network": {}, "training": {}}
    for override in overrides:
        if override.partition("=")[0].partition(".")[0] not in raw:
            raise RefusedInput("--set", override, "must be network.KEY=VALUE or training.KEY=VALUE")
        apply_override(raw, override)
    for part, given in raw.items():
        if not isinstance(given, dict):
            raise RefusedInput("--set", f"{part}={given}", f"must be {part}.KEY=VALUE")
    for key, value in (("seed", seed), ("epochs", epochs)):
        if value is not None:
            raw["training"][key] = value
    return network_preset(preset, **raw["network"]), training_preset(preset, **raw["training"])


class _TrainingBar:
    """Shows how many clips are prepared, then each epoch as a line, and how far the one on the way is."""

    def __init__(self, bar: Progress, epochs: int) -> None:
        self._bar, self._epochs = bar, epochs
        self._task = bar.add_task("training", total=None, told="")

    def clip(self, done: int, total: int, _: object) -> None:
        """See ``classifier.clips.OnClip``."""
        self._bar.update(
            self._task, description="clips prepared", completed=done, total=total, told=f"{done} of {total}"
        )

    def step(self, number: int, share: float, loss: float) -> None:
        """See ``classifier.training.OnStep``."""
        self._bar.update(
            self._task, description=f"epoch {number}", completed=share, total=1.0, told=f"loss {loss:.3f}"
        )

    def epoch(self, epoch: "Epoch") -> None:
        """See ``classifier.training.OnEpoch``."""
        told = epoch_line(epoch, self._epochs)
        self._bar.console.print(
            told, style="bold" if epoch.is_best else None, highlight=False, soft_wrap=True
        )


@contextmanager
def _bar(training: "TrainingConfig", *, quiet: bool) -> Iterator[_TrainingBar | None]:
    if quiet:
        yield None
        return
    with Progress(
        TextColumn("{task.description}"), BarColumn(), TextColumn("{task.fields[told]}"),
        console=Console(stderr=True), transient=True,
    ) as bar:  # fmt: skip
        yield _TrainingBar(bar, training.epochs)


def epoch_line(epoch: "Epoch", epochs: int) -> str:
    """An epoch in one line: losses, accuracy, speed and time left."""
    minutes, seconds = divmod(round(epoch.left_s), 60)
    return (
        f"epoch {epoch.number:3} of {epochs}: loss {epoch.train_loss:.4f}, validation {epoch.validation_loss:.4f}"
        f" and {100.0 * epoch.validation_accuracy:5.1f} % right{', best' if epoch.is_best else ''};"
        f" {epoch.frames_hz:.0f} frames/s, {100.0 * epoch.compute_share:.0f} % computing,"
        f" at most {minutes} min {seconds:02d} s left"
    )


def _told(trained: "Trained", out: Path) -> tuple[list[str], dict[str, Any]]:
    """A finished training as lines, and for JSON."""
    best = trained.best
    train, validation, test = trained.counts
    lines = [
        f"tests   {train} trained on, {validation} to validate, {test} kept for pallet-twin evaluate",
        f"best    epoch {best.number} of {len(trained.epochs)}: validation loss {best.validation_loss:.4f},"
        f" {100.0 * best.validation_accuracy:.1f} % right",
        f"model   {trained.model}",
        f"curves  {out / 'curves.png'}",
    ]
    entry = {
        "model": str(trained.model),
        "run": str(out / "run.json"),
        "tests": dict(zip(("train", "validation", "test"), trained.counts, strict=True)),
        "best": asdict(best),
        "epochs": len(trained.epochs),
    }
    return lines, entry
