"""Tests of a campaign that are worth a look, in short lists."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from recordings.campaigns.labels import Label
from recordings.campaigns.one_test import Cost
from sim_core.report import FAR_BEYOND

LIST_LENGTH = 5
"""Rows of each list of outliers."""


@dataclass(frozen=True)
class Outlier:
    """A test that is worth a look.

    Attributes:
        kind: why, see ``OUTLIER_WORDS``.
        number: of its draw.
        verdict: of the test.
        told: the figure that makes it one.
        bag: its bag, relative to the campaign's folder.
    """

    kind: str
    number: int
    verdict: str
    told: str
    bag: str


OUTLIER_WORDS = {
    "near_limit": "Closest to a limit",
    "error": "Largest error estimate",
    "penetration": "Deepest contact",
    "residual": "Most energy from nowhere",
    "ended": "Ended by a monitor",
    "estimate_decides": "The error estimate changes the verdict",
    "slowest": "Slowest",
}


def limit_mm(label: Label, rule: str) -> float:
    """A rule's limit for a test [mm]; 0 where it has none."""
    if rule not in label.worst_mm or rule not in label.margin_mm:
        return 0.0
    return max(0.0, label.worst_mm[rule] + label.margin_mm[rule])


def closest_limit(label: Label) -> tuple[str, float] | None:
    """The rule that decides a test, and its margin as a share of its limit: below 0 where it is broken."""
    shares = [
        (label.margin_mm[rule] / limit, rule) for rule in label.margin_mm if (limit := limit_mm(label, rule))
    ]
    return min(shares)[::-1] if shares else None


def slowest(labels: Sequence[Label], costs: Mapping[int, Cost]) -> tuple[Outlier, ...]:
    """The tests that took longest."""
    timed = sorted(
        (label for label in labels if label.number in costs), key=_by(lambda t: costs[t.number].wall_s)
    )
    return tuple(
        _outlier(
            "slowest",
            label,
            f"{costs[label.number].wall_s:.1f} s, of which {costs[label.number].estimate_s:.1f} s for the error"
            f" estimate; {label.packages} packages",
        )
        for label in timed[:LIST_LENGTH]
    )


def _by(value: Callable[[Label], float]) -> Callable[[Label], tuple[float, int]]:
    """Sorts the largest first, and the lower number first among equals."""
    return lambda label: (-value(label), label.number)


def outlier_lists(labels: Sequence[Label]) -> dict[str, list[Outlier]]:
    """All tests in the order of each kind but ``slowest``, the most striking first."""
    whole = [label for label in labels if label.ended_by is None]
    near = {label.number: found for label in whole if (found := closest_limit(label)) is not None}
    close = sorted((t for t in whole if t.number in near), key=_by(lambda t: -abs(near[t.number][1])))
    errors = {label.number: error for label in whole if (error := _largest_error(label)) is not None}
    unsure = sorted((t for t in whole if t.number in errors), key=_by(lambda t: errors[t.number][0]))
    return {
        "near_limit": [_outlier("near_limit", t, _margin_words(t, near[t.number][0])) for t in close],
        "error": [_outlier("error", t, _margin_words(t, errors[t.number][1])) for t in unsure],
        "penetration": [
            _outlier("penetration", t, f"{millimetres(t.penetration_mm)} mm")
            for t in sorted(labels, key=_by(lambda t: t.penetration_mm))
        ],
        "residual": [
            _outlier("residual", t, f"{100.0 * t.energy_residual:.2g} % of the energy put in")
            for t in sorted(labels, key=_by(lambda t: t.energy_residual))
        ],
        "ended": [_outlier("ended", t, t.ended_by or "") for t in labels if t.ended_by is not None],
        "estimate_decides": [
            _outlier("estimate_decides", t, f"{t.judged} by the poses alone, {t.verdict} with the estimate")
            for t in whole
            if t.judged != t.verdict
        ],
    }


def _largest_error(label: Label) -> tuple[float, str] | None:
    """A test's largest error estimate [mm] with its rule; a rule that is broken beyond all doubt has no use for one."""
    errors = [
        (error, rule)
        for rule, error in label.error_mm.items()
        if (limit := limit_mm(label, rule))
        and (label.worst_mm[rule] <= FAR_BEYOND * limit or label.worst_mm[rule] - error <= limit)
    ]
    return max(errors, default=None)


def _margin_words(label: Label, rule: str) -> str:
    error = f" ± {millimetres(label.error_mm[rule])}" if rule in label.error_mm else ""
    worst, limit = millimetres(label.worst_mm[rule]), millimetres(limit_mm(label, rule))
    return f"{rule.replace('_', ' ')} {worst}{error} mm, limit {limit} mm"


def millimetres(value: float) -> str:
    """A length [mm] with as many digits as mean something."""
    return f"{value:.0f}" if abs(value) >= 100.0 else f"{value:.1f}" if abs(value) >= 1.0 else f"{value:.2g}"


def _outlier(kind: str, label: Label, told: str) -> Outlier:
    return Outlier(kind, label.number, label.verdict, told, f"tests/{label.number:05d}/bag")
