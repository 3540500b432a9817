"""The model card: what a model is, what it is for and not for, what it was made from, and how good it is."""

from typing import Any

import numpy as np

from classifier.configuration import Mode
from classifier.evaluation import MOST_LOST, Evaluation
from classifier.evaluation_page import SPLIT_WORDS, WORDS, shown, unmet
from classifier.metrics import FIGURES
from classifier.network import parameter_count
from classifier.prediction import GUESS

_LOOKS_AT: dict[Mode, str] = {
    "rgb": "whole pictures in colour",
    "change": "a grey crop that rides on the sled, and its change",
    "motion": "the load's grey, and by optical flow how far each part of it has moved on the sled",
}


def model_card(found: Evaluation) -> str:
    """The card as Markdown."""
    return "\n".join(
        [
            "# Model card: pass or fail from video",
            "",
            *_what(found),
            *_made_from(found),
            *_worth(found),
            *_limits(found),
        ]
    ).rstrip()


def _what(found: Evaluation) -> list[str]:
    judge = found.main.judge
    config = judge.model.config
    frames = "all" if config.frames is None else str(config.frames)
    looks_at = _LOOKS_AT[config.mode]
    return [
        "## What it is",
        "",
        f"A network of {parameter_count(judge.model):,} weights that says from a test's pictures alone how likely it"
        f" passed: {config.backbone} of width {config.base_width} at {config.size_px} px on {frames} frames"
        f" ({looks_at}), LSTM of {config.lstm_units} units both ways, attention, and the frame of the largest change"
        " a second time (topology of arXiv 2508.13989). The positive class is success (pass). A test is called a pass"
        f" from a probability of {judge.success_threshold:.3f} on; logits are divided by {judge.temperature:.3f}.",
        "",
        f"What it says is {GUESS}. Use it to sort recordings and as a live hint; do not use it to approve a load"
        " unit, nor on another bench or camera without an evaluation there.",
        "",
    ]


def _made_from(found: Evaluation) -> list[str]:
    told = found.main.told
    bags, split = told.get("bags", {}), told.get("split", {})
    schemes = len({example.scheme for example in found.main.judged.examples})
    counts = [len(split.get(part, [])) for part in ("train", "validation", "test")]
    return [
        "## What it was made from",
        "",
        f"- Campaign `{bags.get('campaign', 'unknown')}` of simulated tests, {bags.get('count', 'unknown')} of them"
        f" settled: {counts[0]} to learn from, {counts[1]} for validation, {counts[2]} to judge. Unresolved tests are"
        " left out.",
        f"- Split: {SPLIT_WORDS[found.main.name]}, seed {split.get('seed', 'unknown')}; {schemes} schemes are judged.",
        f"- Digests: model `{found.main.model_key}`, labels `{str(bags.get('sha256', 'unknown'))[:16]}`, code"
        f" `{str(told.get('code', 'unknown'))[:16]}`.",
        "- Frames, their crop and the critical one come from the pictures; nothing of a label reaches the input.",
        *_guidance(told),
        "",
    ]


def _guidance(told: dict[str, Any]) -> list[str]:
    training, lines = told.get("training", {}), []
    if training.get("guidance"):
        lines.append(
            "- While it learned, what it sees in each frame was held, with weight"
            f" {training['guidance']:g}, against how far the simulated load truly stood from its place. That part is"
            " not kept."
        )
    if training.get("margins"):
        lines.append(
            "- What its verdict is taken from was held, with weight"
            f" {training['margins']:g}, against each rule's distance to its limit. That part is not kept either."
        )
    if training.get("stretch"):
        lines.append(
            "- Clips were shown as if everything had moved up to"
            f" {np.exp(training['stretch']):.2f} times as far, or as little, with the verdict that follows."
        )
    return lines


def _worth(found: Evaluation) -> list[str]:
    head = " | ".join(
        SPLIT_WORDS[result.name] + f", {len(result.judged.success)} tests" for result in found.results
    )
    lines = ["## What it is worth", "", f"| | {head} |", "|---|" + "---|" * len(found.results)]
    lines += [
        f"| {WORDS[name]} | {' | '.join(shown(result.figures[name], name) for result in found.results)} |"
        for name in FIGURES
    ]
    lines += [
        "",
        "In brackets: 95 % bootstrap intervals over tests. `evaluation.html` has intervals over schemes too.",
    ]
    for result in found.results:
        short = unmet(result)
        if short:
            lines.append(f"Short of what it is held to ({SPLIT_WORDS[result.name]}): {', '.join(short)}.")
    for rival in found.rivals:
        lines.append(f"Beside it, {rival.name}: accuracy {shown(rival.figures['accuracy'], 'accuracy')}.")
    return [*lines, ""]


def _limits(found: Evaluation) -> list[str]:
    lines = ["## What is known of its limits", ""]
    worst = min(found.margins, key=lambda group: group.right, default=None)
    if worst is not None:
        lines.append(
            f"- Worst at a distance to the limit of {worst.name}: {100.0 * worst.right:.0f} % right."
        )
    for row in found.robustness:
        if row.change.value is not None:
            verdict = "within" if row.change.value >= -MOST_LOST else "MORE than"
            lines.append(
                f"- {row.condition} ({row.words}): {100.0 * row.change.value:+.1f} points on {row.tests} tests,"
                f" {verdict} the {100.0 * MOST_LOST:.0f} that may be lost."
            )
    lines += [
        "- Every picture is drawn from a simulation; none of a real camera is among them.",
        "- Packages behind others, and what moves towards the camera, are not seen.",
        "",
    ]
    return lines
