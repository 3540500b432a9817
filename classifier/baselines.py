"""Plain judges that a sceptic would ask for, on the same tests: majority, regressions, a network without time.

Each learns from the training part, chooses what it has to choose on the validation part, and says a logit of success
for every test of the test part. Perfect sight is beside them as a bound.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import ValidationError

from classifier.clips import ClipCache
from classifier.configuration import NetworkConfig
from classifier.displacement import measured_features
from classifier.examples import Example, Split
from classifier.frames import PreparedClip
from classifier.logistic import chosen_logistic, prior_logit
from classifier.metrics import Truth
from classifier.perfect_sight import FEATURES, sighted_features
from classifier.robustness import sampled
from classifier.rows import Rows
from classifier.training_config import TrainingConfig
from config.errors import RefusedInput
from sim_core.frames import Array

OnProgress = Callable[[int, int, object], None]
Baselines = Literal["none", "plain", "all"]
THIRDS = 3
MOST_MEASURED = 300
"""Tests that the regression on displacement learns its two dozen weights from: each takes seconds to measure."""


@dataclass(frozen=True, eq=False)
class Baseline:
    """A baseline's judgement.

    Attributes:
        name: of it.
        words: what it does.
        logits: of success of the test part's tests, shape [n].
        remark: on what it had to do without, or nothing.
    """

    name: str
    words: str
    logits: Array
    remark: str = ""


def judged_baselines(
    examples: Sequence[Example],
    split: Split,
    config: NetworkConfig,
    told: dict[str, Any],
    clips_at: Path,
    out: Path,
    *,
    which: Baselines = "plain",
    workers: int = 1,
    on_progress: OnProgress | None = None,
) -> list[Baseline]:
    """Fits baselines and has them judge the test part.

    Args:
        examples: all tests.
        split: the model's.
        config: of the model.
        told: of the model; its training is that of the network without time.
        clips_at: folder of prepared clips; measured displacement is kept there, too.
        out: folder for what is on the way.
        which: ``plain``: majority and regressions; ``all``: the network without time as well, which takes as long to
            train as the model.
        workers: processes that prepare clips and measure.
        on_progress: told how much is done, of how much, and what.

    Raises:
        RefusedInput: the training part is empty, or the model does not say how it was trained.
        BrokenRecording: a bag is damaged.
    """
    if which == "none":
        return []
    if not split.train:
        raise RefusedInput("model.split.train", 0, "must be at least one test")
    clips = ClipCache(clips_at, config)
    used = [examples[index] for part in (split.train, split.validation, split.test) for index in part]
    clips.prepare(used, workers=workers, on_progress=on_progress)
    success = np.array([example.success for example in examples], dtype=bool)
    found = [_majority(success, split)]
    changed = _by_change(examples, success, split, clips)
    found += [changed, _by_displacement(examples, success, split, changed, clips_at, workers, on_progress)]
    found.append(_by_perfect_sight(examples, success, split, clips_at, workers, on_progress))
    if which == "all":
        found.append(_without_time(examples, split, config, told, clips, out, on_progress))
    return found


def change_features(clip: PreparedClip) -> list[float]:
    """Logarithms of how much the load's picture changed: at most, at the end, and on the mean of each third."""
    parts = np.array_split(clip.change, THIRDS)
    values = [clip.change.max(), clip.change[-1], *(part.mean() if len(part) else 0.0 for part in parts)]
    return [*np.log(np.array(values) + 0.1).tolist(), float(clip.followed)]


def _majority(success: Truth, split: Split) -> Baseline:
    prior = prior_logit(success[list(split.train)])
    return Baseline(
        "majority",
        "says what most tests do, with their share as its probability",
        np.full(len(split.test), prior),
    )


def _by_change(examples: Sequence[Example], success: Truth, split: Split, clips: ClipCache) -> Baseline:
    features = np.full((len(examples), THIRDS + 3), np.nan)
    for part in (split.train, split.validation, split.test):
        for index in part:
            features[index] = change_features(clips.clip(examples[index]))
    logits, _ = _regressed(features, success, split)
    return Baseline(
        "regression on change",
        "logistic, on how much the picture of the load changed: peak, end, each third",
        logits,
    )


def _by_displacement(
    examples: Sequence[Example],
    success: Truth,
    split: Split,
    fallback: Baseline,
    clips_at: Path,
    workers: int,
    on_progress: OnProgress | None,
) -> Baseline:
    """Where displacement cannot be measured, the regression on change answers."""
    learned = [split.train[place] for place in sampled(split.train, MOST_MEASURED, seed=0)]
    used = [*learned, *split.validation, *split.test]
    tell = _counting(len(used), "displacement measured", on_progress)
    rows = Rows(clips_at / "displacement.jsonl")
    found, refused = measured_features(
        [examples[index] for index in used], rows, workers=workers, on_row=tell
    )
    features = np.full((len(examples), found.shape[1]), np.nan)
    features[used] = found
    logits, is_measured = _regressed(features, success, split)
    missing = int((~is_measured).sum())
    remark = ""
    if missing:
        why = next((reason for reason in reversed(refused) if reason is not None), "too few to learn from")
        remark = f"{missing} of {len(logits)} tests could not be measured ({why}): the regression on change answers"
    return Baseline(
        "regression on displacement",
        "logistic, on displacement measured from the same pictures: rules and height bands as shares of their limits;"
        f" learned from {len(learned)} tests",
        np.where(is_measured, logits, fallback.logits),
        remark,
    )


def _by_perfect_sight(
    examples: Sequence[Example],
    success: Truth,
    split: Split,
    clips_at: Path,
    workers: int,
    on_progress: OnProgress | None,
) -> Baseline:
    """No judge of pictures: the truth about what the camera faces, as a bound on those that only measure."""
    used = [index for part in (split.train, split.validation, split.test) for index in part]
    tell = _counting(len(used), "true movement of what is faced", on_progress)
    features = np.full((len(examples), len(FEATURES)), np.nan)
    rows = Rows(clips_at / "perfect_sight.jsonl")
    features[used] = sighted_features([examples[index] for index in used], rows, workers=workers, on_row=tell)
    logits, _ = _regressed(features, success, split)
    return Baseline(
        "perfect sight",
        "not from pictures: logistic, on the true movement across the line of sight of the packages that face the"
        " camera; a bound for whoever measures without error and does not guess what is behind",
        logits,
    )


def _counting(total: int, what: str, on_progress: OnProgress | None) -> Callable[[], None]:
    """What tells, each time that it is called, of one more that is done."""
    done = count(1)

    def tell() -> None:
        number = next(done)
        if on_progress is not None:
            on_progress(number, total, what)

    return tell


def _regressed(features: Array, success: Truth, split: Split) -> tuple[Array, Truth]:
    """Logits of the test part and which of them stand on features; NaN marks a test without any."""
    known = np.asarray(np.isfinite(features).all(axis=1))
    train, validation, test = (
        np.array(part, dtype=np.intp) for part in (split.train, split.validation, split.test)
    )
    learned, chosen = train[known[train]], validation[known[validation]]
    logits = np.full(len(test), prior_logit(success[train]))
    if len(learned) < 2 or success[learned].all() or not success[learned].any():
        return logits, np.zeros(len(test), dtype=bool)
    fit = chosen_logistic((features[learned], success[learned]), (features[chosen], success[chosen]))
    is_known = known[test]
    logits[is_known] = fit.logits(features[test[is_known]])
    return logits, is_known


def _without_time(
    examples: Sequence[Example],
    split: Split,
    config: NetworkConfig,
    told: dict[str, Any],
    clips: ClipCache,
    out: Path,
    on_progress: OnProgress | None,
) -> Baseline:
    from classifier.mean_pooling import MeanPooling, pooled_logits
    from classifier.network import parameter_count

    try:
        training = TrainingConfig.model_validate(told["training"])
    except (KeyError, ValidationError):
        raise RefusedInput(
            "model.training", told.get("training"), "must say how the model was trained"
        ) from None

    def tell(done: int, total: int) -> None:
        if on_progress is not None:
            on_progress(done, total, "epochs without time")

    out.mkdir(parents=True, exist_ok=True)
    train, validation, test = (
        [examples[index] for index in part] for part in (split.train, split.validation, split.test)
    )
    logits = pooled_logits(
        (train, validation, test), config, training, clips, out / "mean_pooling.pt", on_epoch=tell
    )
    weights = parameter_count(MeanPooling(config))
    words = f"the same frames and training, {weights:,} weights: features averaged, neither order nor critical frame"
    return Baseline("network without time", words, logits)
