"""The page of a model's evaluation: figures of merit, what it is better than, and where it is wrong."""

from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import Any

from classifier.breakdowns import NO_RULE, Group, Looks
from classifier.evaluation import BARS, MOST_LOST, PAPER, Evaluation, SplitName, SplitResult
from classifier.evaluation_figures import (
    curves_figure,
    early_figure,
    groups_figure,
    looks_figure,
    reliability_figure,
    robustness_figure,
)
from classifier.metrics import FIGURES, Figure
from classifier.prediction import GUESS
from sim_core.accuracy.figures import standalone_svg
from sim_core.accuracy.page import table
from sim_core.report_style import STYLE

WORDS = {
    "accuracy": "accuracy", "precision": "precision", "recall": "recall", "f1": "F1", "loss": "loss (cross-entropy)",
    "roc_area": "area under ROC", "pr_area": "area under PR", "calibration_error": "expected calibration error",
}  # fmt: skip
SPLIT_WORDS: dict[SplitName, str] = {
    "group_held_out": "schemes never seen", "random_split": "random split, as in the paper",
}  # fmt: skip

_ABOVE = "the model's accuracy above it"
_RELIABILITY = (
    "Each dot is a tenth of the probabilities, with the number of its tests and the 95 % interval (Wilson's). On the"
    " dashed line a probability means what it says."
)
_EARLY = (
    "Crop, frames and critical frame are chosen from the pictures so far: it is what a live answer would be. Grey:"
    " 95 % interval over all tests."
)


def write_evaluation_page(out: Path, found: Evaluation) -> Path:
    """Writes ``evaluation.html``, and each figure as an SVG file of its own; the same evaluation, the same bytes.

    Args:
        out: an existing folder.
        found: the evaluation.

    Returns:
        The page's path.
    """
    drawn = evaluation_figures(found)
    for name, svg in drawn.items():
        (out / f"{name}.svg").write_text(standalone_svg(svg), encoding="utf-8")
    path = out / "evaluation.html"
    scratch = path.with_name(path.name + ".part")
    scratch.write_text(evaluation_page(found, drawn), encoding="utf-8")
    scratch.replace(path)
    return path


def evaluation_figures(found: Evaluation) -> dict[str, str]:
    """The figures as SVG by name."""
    main = found.main
    judged, called = main.judged, main.called
    wrong = float(called[~judged.success].mean()) if not judged.success.all() else float("nan")
    merit = [main.figures[name].value for name in ("recall", "precision")]
    here = [wrong, *(float("nan") if value is None else value for value in merit)]
    drawn = {
        "curves": curves_figure(found.roc, found.pr, float(judged.success.mean()), here),
        "reliability": reliability_figure(found.reliability),
        "first_rule": groups_figure(
            found.first_rules, "Right calls by the rule that failed first", "evaluation-rule"
        ),
        "margin": groups_figure(
            found.margins, "Right calls by the distance to the limit", "evaluation-margin"
        ),
        "early": early_figure(found.early),
        "attention": looks_figure(found.looks),
    }
    if found.robustness:
        drawn["robustness"] = robustness_figure(found.robustness, MOST_LOST)
    return drawn


def evaluation_page(found: Evaluation, drawn: dict[str, str]) -> str:
    """The page as HTML that needs no other file; see ``write_evaluation_page``."""
    sections = [
        _section("What it is worth", table(merit_rows(found.results)) + _small(_merit_words(found))),
        _section("Against plain baselines", _baselines(found)),
        _section(
            "Curves and calibration",
            _figure(drawn["curves"], "The dot is the model's threshold. Dashed: who knows nothing.")
            + _figure(drawn["reliability"], _RELIABILITY),
        ),
        _section(
            "Where it is wrong",
            "<h3>By the rule that was broken first</h3>"
            + table(group_rows(found.first_rules, "first broken rule"))
            + _figure(drawn["first_rule"], f"“{NO_RULE}”: tests that passed. Bars: 95 % intervals.")
            + "<h3>By the distance to the limit</h3>"
            + table(group_rows(found.margins, "distance to the limit"))
            + _figure(
                drawn["margin"], "Of the rule that is worst beside its limit, as a share of the limit."
            ),
        ),
        _section("How early it is right", _figure(drawn["early"], _EARLY)),
        _section("What it looks at", _figure(drawn["attention"], _looks_words(found.looks))),
        _section("Under other conditions", _robustness(found, drawn)),
        _footer(found),
    ]
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8"><title>Evaluation</title>'
        f'<meta name="viewport" content="width=device-width, initial-scale=1"><style>{STYLE}</style></head>'
        f"<body><main>{_header(found)}{''.join(sections)}</main></body></html>\n"
    )


def merit_rows(results: Sequence[SplitResult]) -> list[dict[str, Any]]:
    """Figures of merit of each split beside the paper's and beside what they are held to."""
    rows: list[dict[str, Any]] = []
    for name in FIGURES:
        row: dict[str, Any] = {"figure": WORDS[name]}
        for result in results:
            told = result.figures[name]
            words = SPLIT_WORDS[result.name]
            row[f"{words}: {len(result.judged.success)} tests"] = shown(told, name)
            if result.name == "group_held_out":
                ends = Figure(told.value, told.low_by_scheme, told.high_by_scheme)
                row["interval over schemes"] = _ends(ends, name)
                row["at least"] = _number(BARS[name], name) if name in BARS else None
        row["paper"] = _number(PAPER[name], name) if name in PAPER else None
        rows.append(row)
    return rows


def group_rows(groups: Sequence[Group], what: str) -> list[dict[str, Any]]:
    """Groups of tests as a table shows them."""
    return [
        {
            what: group.name.replace("_", " "),
            "tests": group.called_pass + group.called_fail,
            "called a pass": group.called_pass,
            "called a fail": group.called_fail,
            "right": f"{100.0 * group.right:.1f} %",
            "95 %": f"{100.0 * group.low:.0f}–{100.0 * group.high:.0f}",
        }
        for group in groups
    ]


def shown(told: Figure, name: str) -> str:
    """A figure with its interval as a table shows it."""
    return "undefined" if told.value is None else f"{_number(told.value, name)} ({_ends(told, name)})"


def unmet(result: SplitResult) -> list[str]:
    """Figures of merit that are below what the model is held to, or not better than the paper's."""
    found = []
    for name, bar in (BARS if result.name == "group_held_out" else PAPER).items():
        value = result.figures[name].value
        falls_short = value is None or (
            value < bar
            if result.name == "group_held_out"
            else (value >= bar if name == "loss" else value <= bar)
        )
        if falls_short:
            found.append(WORDS[name])
    return found


def _header(found: Evaluation) -> str:
    main = found.main
    short = unmet(main)
    state, badge = ("fail", "SHORT") if short else ("pass", "MET")
    accuracy = main.figures["accuracy"]
    held = f"Short of what it is held to: {', '.join(short)}." if short else "All that it is held to is met."
    return (
        f'<header class="{state}"><p class="kicker">pallet-twin evaluate</p><h1>Pass or fail from video alone</h1>'
        f"<p>A network watched the test's pictures and nothing else. What it says is {escape(GUESS)}. The positive"
        " class is success (pass): precision is the share of called passes that did pass, recall the share of passes"
        " that were called one.</p>"
        f'<div class="verdict"><span class="badge">{badge}</span><p>{shown(accuracy, "accuracy")} of'
        f" {len(main.judged.success)} tests are called what they are ({escape(SPLIT_WORDS[main.name])})."
        f" {escape(held)}</p></div></header>"
    )


def _merit_words(found: Evaluation) -> str:
    raw = found.main.uncalibrated
    return (
        "In brackets: 95 % bootstrap intervals over tests; over schemes where they are told, which are the honest ones"
        " for layouts that were never seen. The paper gives no intervals, and its loss is that of its validation tests."
        f" Loss and calibration are told after temperature scaling, T = {found.main.judge.temperature:.2f}, fitted on"
        f" validation tests; before it they were {raw['loss']:.4f} and {raw['calibration_error']:.3f}."
    )


def _baselines(found: Evaluation) -> str:
    if not found.rivals:
        return "<p>Left out of this run.</p>"
    rows: list[dict[str, Any]] = [
        {
            "judge": "this model",
            "what it does": "watches the video",
            **_rival_figures(found.main.figures),
            _ABOVE: None,
        }
    ]
    for rival in found.rivals:
        words = "; ".join(part for part in (rival.words, rival.remark) if part)
        told = _rival_figures(rival.figures)
        rows.append({"judge": rival.name, "what it does": words, **told, _ABOVE: _points(rival.gain)})
    return table(rows) + _small("On the same tests; points with 95 % intervals, test by test.")


def _rival_figures(told: dict[str, Figure]) -> dict[str, str]:
    return {WORDS[name]: shown(told[name], name) for name in ("accuracy", "recall", "f1", "loss", "roc_area")}


def _robustness(found: Evaluation, drawn: dict[str, str]) -> str:
    if not found.robustness:
        return "<p>Left out of this run.</p>"
    rows = [
        {
            "condition": row.condition,
            "what is changed": row.words,
            "tests": row.tests,
            "as recorded": shown(row.recorded, "accuracy"),
            "changed": shown(row.accuracy, "accuracy"),
            "change": _points(row.change),
            "called otherwise": row.changed_verdicts,
            "sled lost": row.lost_sled,
            "not drawn": row.refused,
        }
        for row in found.robustness
    ]
    caption = f"A sample of the test tests, each condition alone. At most {100.0 * MOST_LOST:.0f} points may be lost."
    return table(rows) + _figure(drawn["robustness"], caption)


def _looks_words(looks: Looks) -> str:
    return (
        f"Means over tests. The frame of the largest change has {100.0 * looks.on_critical:.1f} % of the attention;"
        f" were all frames looked at alike, it would have {100.0 * looks.even:.1f} %."
    )


def _footer(found: Evaluation) -> str:
    bags = found.main.told.get("bags", {})
    split = found.main.told.get("split", {})
    return (
        f"<footer><h2>Made from</h2><p>Model {escape(found.main.model_key)}, campaign"
        f" {escape(str(bags.get('campaign', '')))} with {escape(str(bags.get('count', 'unknown')))} settled tests:"
        f" {len(split.get('train', []))} to learn from, {len(split.get('validation', []))} for validation,"
        f" {len(split.get('test', []))} judged here. <code>metrics.json</code> has every figure.</p></footer>"
    )


def _number(value: float, name: str) -> str:
    if name == "loss":
        return f"{value:.4f}"
    return f"{100.0 * value:.2f} %" if name in ("accuracy", "precision", "recall") else f"{value:.3f}"


def _ends(told: Figure, name: str) -> str:
    if told.low is None or told.high is None:
        return ""
    return f"{_number(told.low, name).removesuffix(' %')}–{_number(told.high, name).removesuffix(' %')}"


def _points(told: Figure) -> str:
    if told.value is None or told.low is None or told.high is None:
        return "undefined"
    return f"{100.0 * told.value:+.1f} ({100.0 * told.low:+.1f} to {100.0 * told.high:+.1f})"


def _figure(svg: str, caption: str) -> str:
    return f"<figure>{svg}<figcaption>{escape(caption)}</figcaption></figure>"


def _small(words: str) -> str:
    return f'<p class="small">{escape(words)}</p>'


def _section(title: str, content: str) -> str:
    return f"<section><h2>{escape(title)}</h2>{content}</section>"
