"""What judgements of tests are worth beside the truth; the positive class is success (pass), as in the seed paper.

A judgement is a logit of success: positive says pass. A precision of 0.9 thus says that 90 % of the tests called a
pass did pass, a recall of 0.9 that 90 % of the passes were called one.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from config.errors import RefusedInput
from recordings.campaigns.statistics_rates import wilson
from sim_core.frames import Array

FIGURES = (
    "accuracy", "precision", "recall", "f1", "loss", "roc_area", "pr_area", "calibration_error",
)  # fmt: skip
"""In the order in which they are told."""
POSITIVE = "success"
BINS = 10
"""Of the reliability curve, equally wide."""
RESAMPLES = 2000
COLDEST, HOTTEST = 0.2, 10.0
"""Temperatures beyond mean that the validation tests are separated, or that nothing was learnt: neither is a fit."""

Truth = NDArray[np.bool_]


@dataclass(frozen=True)
class Figure:
    """A figure of merit with its 95 % interval; all None where it is undefined (no pass was called, one class only).

    Attributes:
        value: over all tests.
        low: of the interval, over resampled tests.
        high: of it.
        low_by_scheme: of the interval over resampled palletising schemes, where they are told apart.
        high_by_scheme: of it.
    """

    value: float | None
    low: float | None
    high: float | None
    low_by_scheme: float | None = None
    high_by_scheme: float | None = None


@dataclass(frozen=True)
class ReliabilityBin:
    """Tests that were given about the same probability of success.

    Attributes:
        low: of the bin.
        high: of the bin.
        tests: in it.
        told: mean probability that they were given.
        share: of them that passed.
        share_low: of its 95 % interval (Wilson's).
        share_high: of it.
    """

    low: float
    high: float
    tests: int
    told: float
    share: float
    share_low: float
    share_high: float


def probability(logits: Array) -> Array:
    """Logits as probabilities, 1 / (1 + exp(-z)), without overflow."""
    return np.asarray(0.5 * (1.0 + np.tanh(0.5 * np.asarray(logits, dtype=float))))


def logit(probabilities: Array) -> Array:
    """The other way round; 0 and 1 are not met."""
    return np.asarray(np.log(probabilities) - np.log1p(-np.asarray(probabilities)))


def scores(success: Truth, logits: Array, *, threshold: float = 0.5) -> dict[str, float]:
    """All figures of merit by name; NaN where one is undefined.

    Args:
        success: whether each test passed, shape [n].
        logits: of success, shape [n].
        threshold: probability of success from which a test is called a pass.

    Raises:
        RefusedInput: there is no test, or the shapes differ.
    """
    told = _scores(success, logits, np.ones((1, len(success))), threshold)
    return {name: float(values[0]) for name, values in told.items()}


def figures(
    success: Truth,
    logits: Array,
    *,
    schemes: Sequence[str] | None = None,
    threshold: float = 0.5,
    seed: int = 0,
    resamples: int = RESAMPLES,
) -> dict[str, Figure]:
    """All figures of merit with bootstrap intervals (percentiles; Efron, Ann. Stat. 7, 1979, 1-26).

    Args:
        success: whether each test passed, shape [n].
        logits: of success, shape [n].
        schemes: palletising scheme of each test; then intervals over schemes are told too, which are the honest
            ones for layouts that were never seen, as tests of one scheme resemble each other.
        threshold: probability of success from which a test is called a pass.
        seed: of the resampling.
        resamples: how many.

    Raises:
        RefusedInput: there is no test, or the shapes differ.
    """
    value = scores(success, logits, threshold=threshold)
    by_test = _scores(success, logits, _test_weights(len(success), seed, resamples), threshold)
    weights = _scheme_weights(schemes, seed, resamples) if schemes is not None else None
    by_scheme = _scores(success, logits, weights, threshold) if weights is not None else None
    nothing = None, None
    return {
        name: Figure(
            None if np.isnan(value[name]) else value[name],
            *(_interval(by_test[name]) if not np.isnan(value[name]) else nothing),
            *(_interval(by_scheme[name]) if by_scheme is not None else nothing),
        )
        for name in FIGURES
    }


def gain(
    success: Truth,
    logits: Array,
    other: Array,
    *,
    name: str = "accuracy",
    threshold: float = 0.5,
    seed: int = 0,
    resamples: int = RESAMPLES,
) -> Figure:
    """By how much one judge is better than another on the same tests, with its interval over the same resamples.

    Args:
        success: whether each test passed, shape [n].
        logits: of the one judge, shape [n].
        other: of the other, shape [n].
        name: of the figure.
        threshold: of both.
        seed: of the resampling.
        resamples: how many.
    """
    weights = np.vstack((np.ones(len(success)), _test_weights(len(success), seed, resamples)))
    found = (
        _scores(success, logits, weights, threshold)[name] - _scores(success, other, weights, threshold)[name]
    )
    return Figure(None if np.isnan(found[0]) else float(found[0]), *_interval(found[1:]))


def reliability(success: Truth, logits: Array, *, bins: int = BINS) -> list[ReliabilityBin]:
    """How often tests pass that were given a probability of success, by bins of it; empty bins are left out."""
    told = probability(logits)
    place = _bin_of(told, bins)
    found = []
    for number in np.unique(place).tolist():
        inside = place == number
        count, passes = int(inside.sum()), int(success[inside].sum())
        found.append(
            ReliabilityBin(
                number / bins, (number + 1) / bins, count, float(told[inside].mean()), passes / count,
                *wilson(passes, count),
            )
        )  # fmt: skip
    return found


def fitted_temperature(success: Truth, logits: Array) -> float:
    """The temperature T whose logits / T have the least binary cross-entropy (Guo et al., ICML 2017).

    Fit it on validation tests, never on those that are told. It lies between ``COLDEST`` and ``HOTTEST``; 1 where the
    tests are all of one class.

    Args:
        success: whether each test passed, shape [n].
        logits: of success, shape [n].
    """
    if success.all() or not success.any():
        return 1.0
    # Convex in 1 / T, and one-humped in its logarithm.
    found = minimize_scalar(
        lambda log_t: float(_cross_entropy(success, logits / np.exp(log_t)).mean()),
        bounds=(np.log(COLDEST), np.log(HOTTEST)),
        method="bounded",
        options={"xatol": 1.0e-6},
    )
    return float(np.exp(found.x))


def roc_curve(success: Truth, logits: Array) -> tuple[Array, Array]:
    """Share of fails called a pass, and of passes called one, over all thresholds, each from 0 to 1."""
    passed, failed = _by_level(success, logits)
    return (
        np.concatenate(([0.0], failed.cumsum() / max(1.0, failed.sum()))),
        np.concatenate(([0.0], passed.cumsum() / max(1.0, passed.sum()))),
    )


def pr_curve(success: Truth, logits: Array) -> tuple[Array, Array]:
    """Recall and precision over all thresholds, from the strictest on."""
    passed, failed = _by_level(success, logits)
    right = passed.cumsum()
    return right / max(1.0, passed.sum()), right / (right + failed.cumsum())


def _by_level(success: Truth, logits: Array) -> tuple[Array, Array]:
    """Passes and fails at each distinct logit, from the highest down."""
    level = np.unique(-np.asarray(logits), return_inverse=True)[1]
    passed, failed = (np.bincount(level, weights=kind.astype(float)) for kind in (success, ~success))
    return np.asarray(passed, dtype=float), np.asarray(failed, dtype=float)


def _scores(success: Truth, logits: Array, weights: Array, threshold: float) -> dict[str, Array]:
    """All figures, each of shape [m], for weights of the tests, shape [m, n]."""
    logits = np.asarray(logits, dtype=float)
    if not len(success) or logits.shape != success.shape:
        raise RefusedInput(
            "tests", logits.shape, f"must be as many logits as tests, {success.shape}, and one at least"
        )
    called = probability(logits) >= threshold
    total = weights.sum(axis=1)
    right_pass, wrong_pass, wrong_fail, right = (
        weights @ kind.astype(float)
        for kind in (called & success, called & ~success, ~called & success, called == success)
    )
    return {
        "accuracy": right / total,
        "precision": _ratio(right_pass, right_pass + wrong_pass),
        "recall": _ratio(right_pass, right_pass + wrong_fail),
        "f1": _ratio(2.0 * right_pass, 2.0 * right_pass + wrong_pass + wrong_fail),
        "loss": weights @ _cross_entropy(success, logits) / total,
        **_areas(success, logits, weights),
        "calibration_error": _calibration_error(success, logits, weights),
    }


def _cross_entropy(success: Truth, logits: Array) -> Array:
    """-log of the probability that was given to what came true, log(1 + exp(-z)) for a pass."""
    return np.asarray(np.logaddexp(0.0, np.where(success, -logits, logits)))


def _areas(success: Truth, logits: Array, weights: Array) -> dict[str, Array]:
    """Areas under the ROC curve (trapezoids: ties count half) and the PR curve (steps: average precision)."""
    order = np.argsort(-logits, kind="stable")
    begins = np.flatnonzero(np.diff(-logits[order], prepend=-np.inf))
    passed, failed = (
        np.add.reduceat(weights[:, order] * kind[order], begins, axis=1) for kind in (success, ~success)
    )
    passes, fails = passed.sum(axis=1), failed.sum(axis=1)
    below = fails[:, None] - failed.cumsum(axis=1)
    right = passed.cumsum(axis=1)
    precision = _ratio(right, right + failed.cumsum(axis=1), undefined=0.0)
    return {
        "roc_area": _ratio((passed * (below + 0.5 * failed)).sum(axis=1), passes * fails),
        "pr_area": _ratio((passed * precision).sum(axis=1), passes),
    }


def _calibration_error(success: Truth, logits: Array, weights: Array) -> Array:
    """Mean distance between told probability and share of passes over the bins of the reliability curve."""
    told = probability(logits)
    member = np.eye(BINS)[_bin_of(told, BINS)]
    off = weights @ (member * (told - success)[:, None])
    return np.asarray(np.abs(off).sum(axis=1) / weights.sum(axis=1))


def _bin_of(told: Array, bins: int) -> NDArray[np.intp]:
    return np.minimum((told * bins).astype(np.intp), bins - 1)


def _ratio(over: Array, under: Array, *, undefined: float = np.nan) -> Array:
    return np.asarray(np.divide(over, under, out=np.full(np.shape(over), undefined), where=under > 0.0))


def _test_weights(tests: int, seed: int, resamples: int) -> Array:
    """How often each test is drawn, shape [resamples, tests]."""
    draws = np.random.default_rng([seed, 0]).multinomial(tests, np.full(tests, 1.0 / tests), size=resamples)
    return draws.astype(float)


def _scheme_weights(schemes: Sequence[str], seed: int, resamples: int) -> Array:
    """The same where whole schemes are drawn."""
    place = np.unique(np.asarray(schemes), return_inverse=True)[1]
    count = int(place.max()) + 1
    draws = np.random.default_rng([seed, 1]).multinomial(count, np.full(count, 1.0 / count), size=resamples)
    return draws[:, place].astype(float)


def _interval(found: Array) -> tuple[float, float] | tuple[None, None]:
    """The middle 95 % of what is defined."""
    defined = found[np.isfinite(found)]
    if not len(defined):
        return None, None
    low, high = np.percentile(defined, [2.5, 97.5])
    return float(low), float(high)
