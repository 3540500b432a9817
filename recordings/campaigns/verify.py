"""Holds a campaign's labels against its bags, and a sample of them against runs at half the step."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from config.errors import BrokenRecording, PalletTwinError
from config.scene import Scene
from recordings.campaigns.labels import Label
from recordings.campaigns.one_test import bag_digest
from recordings.campaigns.store import read_labels, test_folder
from recordings.judge_bag import judge_bag
from sim_core.judge import verdict_of
from sim_core.report import judgement
from sim_core.run import run_test

SAMPLE_SEED = 40_509


@dataclass(frozen=True)
class Mismatch:
    """A label that something else contradicts: number of the draw, what it says, and what was found."""

    number: int
    label: str
    found: str


@dataclass(frozen=True)
class Verified:
    """What was held against what.

    Attributes:
        bags: labels that were compared with their bags.
        damaged: bags whose bytes are not those of the label.
        rejudged: labels whose bag gives another verdict or another first failure.
        finer: tests that were run again at half the step.
        finer_unresolved: of those, how many had an unresolved label, which any answer fits.
        disagreeing: of the others, those that came out otherwise.
    """

    bags: int
    damaged: list[Mismatch]
    rejudged: list[Mismatch]
    finer: int
    finer_unresolved: int
    disagreeing: list[Mismatch]

    @property
    def holds(self) -> bool:
        """Whether nothing contradicts a label."""
        return not self.damaged and not self.rejudged and not self.disagreeing


def verify_campaign(
    out: Path, *, share: float = 0.01, on_progress: Callable[[int, int, object], None] | None = None
) -> Verified:
    """Judges every bag again, and runs a sample of the tests at half their step.

    Args:
        out: a campaign's folder.
        share: of the tests that are run again; 0 for none, and at least one for anything else.
        on_progress: called with tests done, how many there are, and the last one's number.

    Raises:
        RefusedInput: there is no campaign, or no finished test.
        BrokenRecording: a label row is damaged.
    """
    labels = read_labels(out)
    sample = _sample(labels, share)
    total, done = len(labels) + len(sample), 0
    damaged: list[Mismatch] = []
    rejudged: list[Mismatch] = []
    disagreeing: list[Mismatch] = []

    def tell(number: int) -> None:
        nonlocal done
        done += 1
        if on_progress is not None:
            on_progress(done, total, number)

    for label in labels:
        bag = test_folder(out, label.number) / "bag"
        found = bag_digest({path.name: path.read_bytes() for path in bag.iterdir()})
        if found != label.bag_sha256:
            damaged.append(Mismatch(label.number, label.bag_sha256, found))
        else:
            told = _told_by_bag(bag, label)
            if told != _told_by_label(label):
                rejudged.append(Mismatch(label.number, _told_by_label(label), told))
        tell(label.number)
    for label in sample:
        verdict = _finer_verdict(test_folder(out, label.number) / "bag")
        if label.success is not None and verdict != label.verdict:
            disagreeing.append(Mismatch(label.number, label.verdict, verdict))
        tell(label.number)
    return Verified(
        bags=len(labels),
        damaged=damaged,
        rejudged=rejudged,
        finer=len(sample),
        finer_unresolved=sum(label.success is None for label in sample),
        disagreeing=disagreeing,
    )


def _sample(labels: Sequence[Label], share: float) -> list[Label]:
    if share <= 0.0:
        return []
    count = min(len(labels), max(1, round(share * len(labels))))
    chosen = np.random.default_rng(SAMPLE_SEED).choice(len(labels), count, replace=False)
    return [labels[place] for place in sorted(chosen.tolist())]


def _told_by_label(label: Label) -> str:
    return (
        f"{label.judged} {label.verdict} {label.first_rule} {label.first_package} {label.scene_sha256[:12]}"
    )


def _told_by_bag(bag: Path, label: Label) -> str:
    """The same, from scene and poses in the bag and the error estimate in the label."""
    try:
        scene, judge = judge_bag(bag)
    except PalletTwinError as error:
        # A load that never came to rest has a bag without a frame, and nothing to judge.
        return _told_by_label(label) if label.ended_by is not None and not label.states else str(error)
    judged = judgement(scene, judge, is_complete=label.ended_by is None)
    first = judge.first_failure()
    states = set()
    for rule in judge.rules():
        error_mm = label.error_mm.get(rule.rule)
        is_open = error_mm is not None and rule.margin_mm is not None and abs(rule.margin_mm) <= error_mm
        states.add("unresolved" if is_open else rule.state)
    verdict = "fail" if "fail" in states else "unresolved" if "unresolved" in states else "pass"
    if label.ended_by is not None:
        verdict = judged["verdict"]
    elif label.estimate_problem is not None and not label.error_mm:
        # Without an estimate only a plain failure in two runs settles a test; the bag has one of them.
        verdict = label.verdict if label.verdict == "unresolved" else verdict_of(judge.rules())
    broken, package = (first.rule, first.package) if first is not None else (None, None)
    return f"{judged['verdict']} {verdict} {broken} {package} {scene.sha256[:12]}"


def _finer_verdict(bag: Path) -> str:
    from recordings.bag_reader import BagReader
    from recordings.judge_bag import scene_of_bag

    with BagReader(bag) as reader:
        scene = scene_of_bag(reader)
    try:
        finer = _at_half_step(scene)
    except ValueError as error:
        raise BrokenRecording("bag", str(bag), f"cannot be run at half its step: {error}") from None
    result = run_test(finer)
    return "unresolved" if result.ended_by is not None else result.judge.verdict()


def _at_half_step(scene: Scene) -> Scene:
    solver = scene.solver.model_copy(
        update={"time_step_s": 0.5 * scene.time_step_s, "iterations": 2 * scene.iterations}
    )
    finer = scene.model_copy(update={"solver": solver, "camera": None})
    finer.steps_and_samples()
    return finer
