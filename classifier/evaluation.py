"""What a trained model is worth on tests that it never saw: figures, breakdowns, robustness, page and model card."""

import hashlib
import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np

from classifier.baselines import Baseline, Baselines, judged_baselines
from classifier.breakdowns import Early, Group, Looks, by_first_rule, by_margin, early, early_logits, looks
from classifier.checkpoint import NETWORK, TOLD, WEIGHTS, write_text
from classifier.clips import ClipCache
from classifier.examples import Example, Split, read_examples
from classifier.frames import PreparedClip
from classifier.metrics import (
    POSITIVE,
    Figure,
    ReliabilityBin,
    Truth,
    figures,
    gain,
    logit,
    pr_curve,
    reliability,
    roc_curve,
    scores,
)
from classifier.robustness import CONDITIONS, Condition, Robustness, measure_robustness, sampled
from classifier.rows import Rows
from classifier.running import Judge, read_judge
from config.errors import RefusedInput
from sim_core.frames import Array

FORMAT = 1
"""Version of ``metrics.json``; raise it when a key or its meaning changes."""
PAPER = {"accuracy": 0.9266, "precision": 0.8636, "recall": 0.95, "f1": 0.9048, "loss": 0.2296}
"""Of arXiv 2508.13989, on a random split of its own; the loss is that of its validation."""
BARS = {"accuracy": 0.95, "recall": 0.95, "f1": 0.93}
"""That a model is held to where no scheme of the tests was seen in training."""
MOST_LOST = 0.03
"""Of the accuracy, where camera, light, print or JPEG are others."""

SplitName = Literal["group_held_out", "random_split"]
SPLIT_NAMES: dict[str, SplitName] = {"scheme": "group_held_out", "random": "random_split"}
OnProgress = Callable[[int, int, object], None]


@dataclass(frozen=True, eq=False)
class JudgedTests:
    """Tests beside what a model says of them.

    Attributes:
        examples: the tests.
        success: whether each passed, shape [n].
        logits: of success, divided by the temperature, shape [n].
        attention: of each test's frames.
        clips: of each test.
    """

    examples: Sequence[Example]
    success: Truth
    logits: Array
    attention: Sequence[Array]
    clips: Sequence[PreparedClip]


@dataclass(frozen=True, eq=False)
class SplitResult:
    """What one model is worth on its own test tests.

    Attributes:
        name: how its tests were parted.
        judge: the model.
        told: what is told of it.
        model_key: digest of it.
        figures: of merit.
        uncalibrated: loss and calibration error without the temperature.
        judged: the tests.
    """

    name: SplitName
    judge: Judge
    told: dict[str, Any]
    model_key: str
    figures: dict[str, Figure]
    uncalibrated: dict[str, float]
    judged: JudgedTests

    @property
    def called(self) -> Truth:
        """Which tests are called a pass, shape [n]."""
        return np.asarray(self.judged.logits >= self.edge)

    @property
    def edge(self) -> float:
        """Logit of success from which a test is called a pass."""
        return float(logit(np.array(self.judge.success_threshold)))

    def entry(self) -> dict[str, Any]:
        """The figures for ``metrics.json``."""

        def ends(low: str, high: str) -> dict[str, Any]:
            return {name: [getattr(told, low), getattr(told, high)] for name, told in self.figures.items()}

        judged = self.judged
        by_scheme = {"intervals_by_scheme": ends("low_by_scheme", "high_by_scheme")}
        return {
            **{name: told.value for name, told in self.figures.items()},
            "tests": len(judged.success),
            "passes": int(judged.success.sum()),
            "schemes": len({example.scheme for example in judged.examples}),
            "intervals": ends("low", "high"),
            **(by_scheme if self.name == "group_held_out" else {}),
            "threshold": self.judge.success_threshold,
            "temperature": self.judge.temperature,
            "uncalibrated": self.uncalibrated,
            "model": self.model_key,
        }


@dataclass(frozen=True)
class Rival:
    """A plain baseline on the same tests.

    Attributes:
        name: of it.
        words: what it does.
        figures: of merit.
        gain: accuracy of the model above it, test by test.
        remark: on what it had to do without, or nothing.
    """

    name: str
    words: str
    figures: dict[str, Figure]
    gain: Figure
    remark: str = ""


@dataclass(frozen=True, eq=False)
class Evaluation:
    """All that is told of a model; ``main`` is the one that the breakdowns are of."""

    main: SplitResult
    results: Sequence[SplitResult]
    reliability: Sequence[ReliabilityBin]
    roc: tuple[Array, Array]
    pr: tuple[Array, Array]
    first_rules: Sequence[Group]
    margins: Sequence[Group]
    early: Sequence[Early]
    looks: Looks
    robustness: Sequence[Robustness]
    rivals: Sequence[Rival] = field(default_factory=tuple)

    def entry(self) -> dict[str, Any]:
        """The content of ``metrics.json``."""
        return {
            "format": FORMAT,
            "positive": POSITIVE,
            **{result.name: result.entry() for result in self.results},
            "paper": PAPER,
            "breakdowns_of": self.main.name,
            "baselines": [asdict(rival) for rival in self.rivals],
            "reliability": [asdict(row) for row in self.reliability],
            "first_rule": [asdict(row) for row in self.first_rules],
            "margin": [asdict(row) for row in self.margins],
            "early": [asdict(row) for row in self.early],
            "attention": {"on_critical_frame": self.looks.on_critical, "if_even": self.looks.even},
            "robustness": [row.entry() for row in self.robustness],
        }


def evaluate(
    model: Path,
    campaign: Path,
    out: Path,
    *,
    random_split: Path | None = None,
    cache: Path | None = None,
    redrawn: int = 60,
    conditions: Sequence[Condition] = CONDITIONS,
    baselines: Baselines = "plain",
    seed: int = 0,
    workers: int = 1,
    on_progress: OnProgress | None = None,
) -> Evaluation:
    """Judges the tests that a model was not trained on, and writes what that says.

    ``metrics.json``, ``evaluation.html`` with its figures beside it as SVG, and ``model_card.md``. What takes long is
    kept in ``out/rows`` and goes on where it ended.

    Args:
        model: folder of a trained model.
        campaign: folder of the campaign that it was trained on.
        out: folder of the results, made where it is missing.
        random_split: folder of a second model, trained on a random split, to compare with the paper.
        cache: folder of prepared clips; by default, ``clips`` in the campaign's folder.
        redrawn: tests that are judged under each other condition; 0: none.
        conditions: that they are judged under.
        baselines: that are fitted and told beside it, see ``judged_baselines``.
        seed: of resampling, of the sample and of what is drawn anew.
        workers: processes that prepare clips and draw.
        on_progress: told how much is done, of how much, and what was.

    Raises:
        RefusedInput: model, campaign or folder cannot be used, or the campaign is not the model's.
        BrokenRecording: a bag is damaged.
    """
    folders = [model, *([random_split] if random_split is not None else [])]
    models = [(read_judge(folder), model_digest(folder)) for folder in folders]
    examples = read_examples(campaign)
    parts = [split_of(told, examples) for (_, told), _ in models]
    kinds = [name for name, _ in parts]
    if random_split is not None and kinds != ["group_held_out", "random_split"]:
        raise RefusedInput(
            "--random-split", str(random_split), "must be a model of a random split beside one by scheme"
        )
    out.mkdir(parents=True, exist_ok=True)
    clips_at = cache if cache is not None else campaign / "clips"
    results = []
    for ((judge, told), key), (kind, split) in zip(models, parts, strict=True):
        clips = ClipCache(clips_at, judge.model.config)
        tests = [examples[index] for index in split.test]
        clips.prepare(tests, workers=workers, on_progress=on_progress)
        results.append(_judged(kind, judge, told, key, judge_tests(tests, judge, clips), seed=seed))
    main, split = results[0], parts[0][1]
    judged = main.judged
    told_early = _early(main, out, on_progress)
    robust = _robustness(main, out, redrawn, conditions, seed, workers, on_progress)
    said = judged_baselines(
        examples,
        split,
        main.judge.model.config,
        main.told,
        clips_at,
        out / "rows",
        which=baselines,
        workers=workers,
        on_progress=on_progress,
    )
    found = Evaluation(
        main=main,
        results=results,
        reliability=reliability(judged.success, judged.logits),
        roc=roc_curve(judged.success, judged.logits),
        pr=pr_curve(judged.success, judged.logits),
        first_rules=by_first_rule(judged.examples, main.called),
        margins=by_margin(judged.examples, main.called),
        early=told_early,
        looks=looks(judged.success, judged.attention, judged.clips),
        robustness=robust,
        rivals=[_rival(baseline, main, seed) for baseline in said],
    )
    _write(out, found)
    return found


def split_of(told: dict[str, Any], examples: Sequence[Example]) -> tuple[SplitName, Split]:
    """A model's own split, as places in the examples.

    Raises:
        RefusedInput: none is told, or a test of it is not among the examples.
    """
    split = told.get("split")
    if not isinstance(split, dict) or split.get("kind") not in SPLIT_NAMES:
        raise RefusedInput("model.split", split, f"must be of the kind {' or '.join(SPLIT_NAMES)}")
    place = {example.number: index for index, example in enumerate(examples)}
    parts = []
    for part in ("train", "validation", "test"):
        numbers = split.get(part)
        if not isinstance(numbers, list):
            raise RefusedInput(f"model.split.{part}", numbers, "must be numbers of tests")
        missing = [number for number in numbers if number not in place]
        if missing:
            raise RefusedInput(
                "campaign",
                f"test {missing[0]}",
                "was the model's and is not in this folder: name the one it was trained on",
            )
        parts.append(tuple(sorted(place[number] for number in numbers)))
    if not parts[2]:
        raise RefusedInput("model.split.test", 0, "must be at least one test")
    return SPLIT_NAMES[split["kind"]], Split(*parts)


def judge_tests(examples: Sequence[Example], judge: Judge, clips: ClipCache) -> JudgedTests:
    """Judges tests by their whole clips.

    Raises:
        BrokenRecording: a bag is damaged.
    """
    found = [judge.judge(clips.clip(example)) for example in examples]
    return JudgedTests(
        examples,
        np.array([example.success for example in examples], dtype=bool),
        np.array([answer.logit for answer in found]),
        [answer.attention for answer in found],
        [answer.clip for answer in found],
    )


def model_digest(folder: Path) -> str:
    """What tells a model apart: its weights, its network, and what is told of it."""
    digest = hashlib.sha256()
    for name in (WEIGHTS, NETWORK, TOLD):
        digest.update((folder / name).read_bytes())
    return digest.hexdigest()[:16]


def _judged(
    name: SplitName, judge: Judge, told: dict[str, Any], key: str, judged: JudgedTests, *, seed: int
) -> SplitResult:
    raw = scores(judged.success, judge.temperature * judged.logits)
    return SplitResult(
        name, judge, told, key, _figures(judged, judged.logits, judge.success_threshold, name, seed),
        {what: raw[what] for what in ("loss", "calibration_error")}, judged,
    )  # fmt: skip


def _figures(
    judged: JudgedTests, logits: Array, threshold: float, name: SplitName, seed: int
) -> dict[str, Figure]:
    schemes = [example.scheme for example in judged.examples] if name == "group_held_out" else None
    return figures(judged.success, logits, schemes=schemes, threshold=threshold, seed=seed)


def _rival(baseline: Baseline, main: SplitResult, seed: int) -> Rival:
    judged = main.judged
    return Rival(
        baseline.name,
        baseline.words,
        _figures(judged, baseline.logits, 0.5, main.name, seed),
        gain(judged.success, judged.logits - main.edge, baseline.logits, seed=seed),
        baseline.remark,
    )


def _early(main: SplitResult, out: Path, on_progress: OnProgress | None) -> list[Early]:
    tell = _counting(len(main.judged.examples), "early answers", on_progress)
    logits = early_logits(
        main.judged.examples,
        main.judge,
        Rows(out / "rows" / "early.jsonl"),
        model_key=main.model_key,
        on_row=tell,
    )
    return early(main.judged.success, logits, edge=main.edge)


def _robustness(
    main: SplitResult,
    out: Path,
    redrawn: int,
    conditions: Sequence[Condition],
    seed: int,
    workers: int,
    on_progress: OnProgress | None,
) -> list[Robustness]:
    places = sampled(main.judged.examples, redrawn, seed=seed)
    if not places:
        return []
    return measure_robustness(
        [main.judged.examples[place] for place in places],
        main.judged.logits[places],
        main.judge,
        Rows(out / "rows" / "robustness.jsonl"),
        model_key=main.model_key,
        conditions=conditions,
        seed=seed,
        workers=workers,
        on_row=_counting(len(places) * len(conditions), "drawn anew", on_progress),
    )


def _counting(total: int, what: str, on_progress: OnProgress | None) -> Callable[[], None]:
    done = 0

    def tell() -> None:
        nonlocal done
        done += 1
        if on_progress is not None:
            on_progress(done, total, what)

    return tell


def _write(out: Path, found: Evaluation) -> None:
    from classifier.evaluation_page import write_evaluation_page
    from classifier.model_card import model_card

    write_text(out / "metrics.json", json.dumps(found.entry(), indent=1, allow_nan=False))
    write_text(out / "model_card.md", model_card(found))
    write_evaluation_page(out, found)
