"""Shares of tests that pass, with their intervals, and how quantities are spread."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from recordings.campaigns.labels import Label

NORMAL_95 = 1.959963984540054
"""Standard deviations to either side that hold 95 % of a normal law."""


@dataclass(frozen=True)
class Rate:
    """How many tests of one kind passed.

    Attributes:
        group: what the tests are told apart by, such as ``sled.level_g``.
        value: what these ones have in common.
        tests: how many there are.
        passes: how many passed.
        fails: how many failed.
        unresolved: how many settle nothing; they are in no rate.
        rate: passes among passes and fails, or None without either.
        low: lower end of its 95 % Wilson interval.
        high: upper end.
        weighted_rate: the rate over the campaign's own ranges.
        weighted_low: lower end of its interval, see ``weighted_share``.
        weighted_high: upper end.
    """

    group: str
    value: str
    tests: int
    passes: int
    fails: int
    unresolved: int
    rate: float | None
    low: float | None
    high: float | None
    weighted_rate: float | None
    weighted_low: float | None
    weighted_high: float | None


@dataclass(frozen=True)
class Spread:
    """How a quantity is spread over tests: count, 5th, 50th and 95th percentile, and the largest."""

    tests: int
    low: float
    median: float
    high: float
    largest: float


def wilson(passes: float, tests: float) -> tuple[float, float]:
    """The 95 % interval of a share (Wilson, J. Am. Stat. Assoc. 22, 1927, 209-212).

    Args:
        passes: how many, or an equivalent number.
        tests: of how many, above 0.
    """
    share, z = passes / tests, NORMAL_95
    widened = 1.0 + z * z / tests
    middle = (share + 0.5 * z * z / tests) / widened
    half = z * math.sqrt(share * (1.0 - share) / tests + 0.25 * z * z / tests**2) / widened
    # At either end the closed form is exact; rounding is not.
    return (0.0 if passes <= 0.0 else max(0.0, middle - half)), (
        1.0 if passes >= tests else min(1.0, middle + half)
    )


def weighted_share(successes: Sequence[bool], weights: Sequence[float]) -> tuple[float, float, float]:
    """A share over weighted tests with its 95 % interval.

    The share is the ratio p = Σw·y / Σw; its variance Σw²(y − p)² / (Σw)² (Cochran, Sampling Techniques, section 6.3)
    is that of p(1 − p)/n tests of equal weight, and with that n the interval is Wilson's. Where all came out
    alike, n is (Σw)² / Σw².

    Args:
        successes: at least one.
        weights: above 0.

    Returns:
        Share, lower and upper end.
    """
    came, weight = np.array(successes, dtype=float), np.array(weights, dtype=float)
    share = float(weight @ came / weight.sum())
    variance = float(weight**2 @ (came - share) ** 2 / weight.sum() ** 2)
    likeness = float(weight.sum() ** 2 / (weight**2).sum())
    if len(set(successes)) == 1:
        return float(came[0]), *wilson(came[0] * likeness, likeness)
    equivalent = share * (1.0 - share) / variance
    return share, *wilson(share * equivalent, equivalent)


def rate_of(group: str, value: str, labels: Sequence[Label]) -> Rate:
    """How many of some tests passed."""
    settled = [(label.success, label.weight) for label in labels if label.success is not None]
    passes = sum(success for success, _ in settled)
    plain = (passes / len(settled), *wilson(passes, len(settled))) if settled else (None, None, None)
    weighted = weighted_share(*zip(*settled, strict=True)) if settled else (None, None, None)
    return Rate(
        group,
        value,
        len(labels),
        passes,
        len(settled) - passes,
        len(labels) - len(settled),
        *plain,
        *weighted,
    )


def spread(values: Iterable[float]) -> Spread | None:
    """Percentiles of some values; None without any."""
    found = np.array(list(values), dtype=float)
    if not len(found):
        return None
    low, median, high = (float(value) for value in np.quantile(found, (0.05, 0.5, 0.95)))
    return Spread(len(found), low, median, high, float(found.max()))
