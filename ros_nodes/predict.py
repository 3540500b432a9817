"""``pallet-twin predict``: pass or fail of a recording, guessed from its video alone."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ros_nodes import output
from ros_nodes.evaluate import model_in
from ros_nodes.train import require_torch

if TYPE_CHECKING:
    from classifier.prediction import Prediction


def predict(
    bag: Annotated[
        Path, typer.Argument(metavar="BAG", help="A bag directory or an .mcap file with pictures.")
    ],
    model: Annotated[
        Path,
        typer.Option(metavar="MODEL", help="Folder of a trained model or of its training, or a shipped one."),
    ] = Path("compact"),
    as_json: Annotated[
        bool, typer.Option("--json", help="Print the result as one JSON object on standard output.")
    ] = False,
) -> None:
    """Guess from a recording's pictures alone whether the test passed, and say how early that was clear.

    A classifier's guess: `pallet-twin judge BAG` judges by the poses, `pallet-twin measure BAG` measures.

    Example: `pallet-twin predict runs/eur_camera/bag`, with a model of your own `--model runs/paper-compact-scheme`.
    """
    require_torch("predict")
    from classifier.prediction import predict_bag
    from classifier.running import read_judge

    judge, _ = read_judge(model_in(model))
    with output.counter("pictures", quiet=as_json) as count:
        found = predict_bag(bag, judge, on_picture=count)
    output.show_lines(_lines(found), found.entry(), as_json=as_json)


def _lines(found: "Prediction") -> list[str]:
    from classifier.prediction import SURE

    sure = f"not sure at the end: below {100.0 * SURE:.0f} %"
    if found.sure_from_s is not None:
        sure = f"sure ({100.0 * SURE:.0f} %) from {found.sure_from_s:.2f} s on"
    frames = ", ".join(
        f"{frame.picture} at {frame.time_s:.2f} s ({100.0 * frame.attention:.0f} %)" for frame in found.frames
    )
    return [
        f"guess   {found.verdict}, {found.told}",
        f"success {100.0 * found.success_probability:.1f} %, a pass from {100.0 * found.threshold:.1f} % on",
        f"early   the same answer from {found.settled_from_s:.2f} s of {found.duration_s:.2f} s on, {sure}",
        f"frames  {frames} of the attention; largest change in {found.largest_change}",
        f"seen    {found.pictures} pictures; {found.remark}",
    ]
