"""``pallet-twin evaluate``: what a trained classifier is worth on tests that it never saw."""

import os
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from config.errors import RefusedInput
from config.scene import Scene
from ros_nodes import output
from ros_nodes.train import require_torch

if TYPE_CHECKING:
    from classifier.evaluation import Evaluation


def evaluate(
    model: Annotated[
        Path, typer.Argument(metavar="MODEL", help="Folder of a trained model, or of its training.")
    ],
    campaign: Annotated[
        Path, typer.Argument(metavar="CAMPAIGN", help="Folder of the campaign that it was trained on.")
    ],
    out: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Folder of the results; gone on with. Default: MODEL-evaluation."),
    ] = None,
    random_split: Annotated[
        Path | None,
        typer.Option(
            "--random-split",
            metavar="MODEL",
            help="A second model, trained on a random split, to stand beside the paper's figures.",
        ),
    ] = None,
    redrawn: Annotated[
        int,
        typer.Option(
            min=0, help="Tests to judge under each other camera, light, print and JPEG; 0 leaves it out."
        ),
    ] = 60,
    baselines: Annotated[
        Literal["plain", "all", "none"],
        typer.Option(
            help="plain: majority, logistic regressions, and what perfect sight of the packages that face the camera"
            " would come to; all: a network without time too, which trains as long as the model did."
        ),
    ] = "plain",
    cache: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder of prepared clips. Default: CAMPAIGN/clips.")
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Of resampling and of what is drawn anew.")] = 0,
    workers: Annotated[
        int | None,
        typer.Option(min=1, max=1024, help="Processes that draw. Default: as many as there are cores."),
    ] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print the result as one JSON object on standard output.")
    ] = False,
) -> None:
    """Judge the tests that a model was not trained on: accuracy, calibration, breakdowns, robustness, baselines.

    DIR/metrics.json has every figure with its 95 % interval, DIR/evaluation.html shows them, DIR/model_card.md says
    what the model is for. The positive class is success (pass). End it at any moment: the same command goes on.

    Example: `pallet-twin evaluate runs/paper-compact-scheme runs/paper --random-split runs/paper-compact-random`.
    """
    require_torch("evaluate")
    from classifier.evaluation import evaluate as judge

    folder = out if out is not None else model.with_name(f"{model.resolve().name}-evaluation")
    with output.counter("evaluation", quiet=as_json) as count:
        found = judge(
            model_in(model),
            campaign,
            folder,
            random_split=model_in(random_split) if random_split is not None else None,
            cache=cache,
            redrawn=redrawn,
            baselines=baselines,
            seed=seed,
            workers=workers if workers is not None else len(os.sched_getaffinity(0)),
            on_progress=count,
        )
    entry: dict[str, Any] = {**found.entry(), "page": str(folder / "evaluation.html")}
    output.show_lines(_lines(found, folder), entry, as_json=as_json)


def model_in(folder: Path) -> Path:
    """The folder of a model, or that inside the folder of its training, or that of a shipped one by its name."""
    inside = folder / "model"
    if inside.is_dir():
        return inside
    shipped = Path(str(files("classifier"))) / "models" / folder
    return shipped if not folder.exists() and len(folder.parts) == 1 and shipped.is_dir() else folder


def require_model(folder: Path, scene: Scene) -> Path:
    """The folder of a model that can watch a scene's camera.

    Raises:
        RefusedInput: there is no camera, no torch or no model.
    """
    if scene.camera is None:
        raise RefusedInput("--classify", str(folder), "needs a camera in the scene")
    require_torch("--classify")
    found = model_in(folder)
    if not (found / "network.json").is_file():
        raise RefusedInput("--classify", str(folder), "must be the folder of a trained model, or compact")
    return found


def _lines(found: "Evaluation", out: Path) -> list[str]:
    from classifier.evaluation_page import SPLIT_WORDS, WORDS, shown

    lines = []
    for result in found.results:
        lines.append(f"{SPLIT_WORDS[result.name]}: {len(result.judged.success)} tests")
        lines += [f"  {WORDS[name]:27} {shown(told, name)}" for name, told in result.figures.items()]
    for rival in found.rivals:
        lines.append(f"{rival.name:29} accuracy {shown(rival.figures['accuracy'], 'accuracy')}")
    for row in found.robustness:
        lines.append(f"{row.condition:29} accuracy {shown(row.accuracy, 'accuracy')} on {row.tests} tests")
    return [*lines, f"page    {out / 'evaluation.html'}", f"table   {out / 'metrics.json'}"]
