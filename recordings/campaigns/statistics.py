"""What a campaign's tests came to: rates, first failures, margins and their errors, numerics and outliers.

All of it follows from the labels and the campaign alone, so that the same labels give the same
numbers. A balanced campaign chose its tests by what was expected of them; a test's weight says how many draws it stands
for, and weighted figures hold for the campaign's own ranges.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from config.campaign import Campaign
from recordings.campaigns.labels import RULES, Label
from recordings.campaigns.statistics_groups import Group, campaign_groups
from recordings.campaigns.statistics_outliers import (
    LIST_LENGTH,
    Outlier,
    closest_limit,
    limit_mm,
    outlier_lists,
)
from recordings.campaigns.statistics_rates import Rate, Spread, rate_of, spread

NEAR = 0.1
"""A test is near a limit whose distance is at most this share of it."""
OTHER_RULE = "other"
"""A fail for which the label holds no first rule."""


@dataclass(frozen=True)
class FirstRule:
    """How often one rule is broken first, among the fails of one kind.

    Attributes:
        group: see ``Rate``.
        value: see ``Rate``.
        rule: its name.
        fails: of how many it is the first.
        share: of the kind's fails.
        weighted_share: the same over the campaign's own ranges.
    """

    group: str
    value: str
    rule: str
    fails: int
    share: float
    weighted_share: float


@dataclass(frozen=True)
class Place:
    """Where and when tests that fail by one rule do so.

    Attributes:
        rule: the first broken one.
        height_share: of the load's height, from the sled's top.
        time_s: since the first frame [s].
        places: kinds of places (``package``, ``pallet``, ``film``) with their counts.
        packages: the most frequent packages as (scheme, package, fails).
    """

    rule: str
    height_share: Spread | None
    time_s: Spread | None
    places: tuple[tuple[str, int], ...]
    packages: tuple[tuple[str, str, int], ...]


@dataclass(frozen=True)
class RuleMargins:
    """How close tests come to one rule's limit. Tests that a monitor ended are left out.

    Attributes:
        rule: its name.
        share: worst displacement as a share of the limit.
        error_mm: error estimates [mm], or None without any.
        near: tests within ``NEAR`` of the limit.
        inside_error: tests whose margin is no larger than their error estimate.
    """

    rule: str
    share: Spread
    error_mm: Spread | None
    near: int
    inside_error: int


@dataclass(frozen=True)
class Numerics:
    """What the solver left behind, by engine.

    Attributes:
        engine: its name.
        penetration_mm: deepest contacts [mm].
        energy_residual: shares of energy from nowhere.
        time_step_s: steps [s].
        ended: tests that a monitor ended.
        without_estimate: whole tests without an error estimate.
    """

    engine: str
    penetration_mm: Spread
    energy_residual: Spread
    time_step_s: Spread
    ended: int
    without_estimate: int


@dataclass(frozen=True)
class Statistics:
    """All that follows from the labels.

    Attributes:
        groups: what tests are told apart by; the first one holds all of them.
        rates: by group and value, in the groups' order.
        first_rules: of fails, for all, levels and restraints.
        places: where and when, by first rule.
        margins: by rule.
        numerics: by engine.
        outliers: short lists, see ``OUTLIER_WORDS``; ``outlier_counts`` says how many there are of a kind.
        outlier_counts: of the kinds that are either there or not.
        near: tests whose closest limit is within ``NEAR``.
    """

    groups: tuple[Group, ...]
    rates: tuple[Rate, ...]
    first_rules: tuple[FirstRule, ...]
    places: tuple[Place, ...]
    margins: tuple[RuleMargins, ...]
    numerics: tuple[Numerics, ...]
    outliers: tuple[Outlier, ...]
    outlier_counts: Mapping[str, int]
    near: int

    @property
    def overall(self) -> Rate:
        """The rate of all tests."""
        return self.rates[0]


def campaign_statistics(labels: Sequence[Label], campaign: Campaign) -> Statistics:
    """The statistics of a campaign's tests.

    Args:
        labels: at least one.
        campaign: theirs; its ranges say where bins lie.
    """
    labels = sorted(labels, key=lambda label: label.number)
    groups = campaign_groups(labels, campaign)
    whole = [label for label in labels if label.ended_by is None]
    closest = [found[1] for label in whole if (found := closest_limit(label)) is not None]
    lists = outlier_lists(labels)
    return Statistics(
        groups=groups,
        rates=tuple(
            rate_of(group.key, value, own) for group in groups for value, own in group.sorted_tests(labels)
        ),
        first_rules=tuple(
            row
            for group in groups
            if group.key in ("all", "sled.level_g", "restraint", "wrap.material")
            for value, own in group.sorted_tests(labels)
            for row in first_rules(group.key, value, own)
        ),
        places=failure_places(labels),
        margins=rule_margins(whole),
        numerics=tuple(
            _numerics(engine, [label for label in labels if label.engine == engine])
            for engine in sorted({label.engine for label in labels})
        ),
        outliers=tuple(row for rows in lists.values() for row in rows[:LIST_LENGTH]),
        outlier_counts={kind: len(lists[kind]) for kind in ("ended", "estimate_decides")},
        near=sum(abs(share) <= NEAR for share in closest),
    )


def first_rule(label: Label) -> str:
    """The rule that a fail broke first, as its label has it."""
    return label.first_rule or OTHER_RULE


def first_rules(group: str, value: str, labels: Sequence[Label]) -> list[FirstRule]:
    """How often each rule is the first, among the fails of some tests; rules that never are have no row."""
    fails = [label for label in labels if label.success is False]
    weight = sum(label.weight for label in fails)
    found = []
    for rule in (*RULES, OTHER_RULE):
        own = [label.weight for label in fails if first_rule(label) == rule]
        if own:
            found.append(FirstRule(group, value, rule, len(own), len(own) / len(fails), sum(own) / weight))
    return found


def height_share(label: Label) -> float | None:
    """Where a test failed first, as a share of the load's height."""
    if label.first_height_m is None or not label.height_m:
        return None
    return label.first_height_m / label.height_m


def failure_places(labels: Sequence[Label]) -> tuple[Place, ...]:
    """Where and when fails begin, by the first broken rule."""
    found = []
    for rule in RULES:
        own = [label for label in labels if label.success is False and label.first_rule == rule]
        if not own:
            continue
        kinds = Counter(
            label.first_package if label.first_package in ("pallet", "film") else "package" for label in own
        )
        packages = Counter((str(label.factors.get("scheme")), str(label.first_package)) for label in own)
        # As often: by name, so that the same labels give the same list.
        most = sorted(packages.items(), key=lambda item: (-item[1], item[0]))[:LIST_LENGTH]
        found.append(
            Place(
                rule,
                spread(share for label in own if (share := height_share(label)) is not None),
                spread(label.first_time_s for label in own if label.first_time_s is not None),
                tuple(sorted((str(kind), count) for kind, count in kinds.items())),
                tuple((scheme, package, count) for (scheme, package), count in most),
            )
        )
    return tuple(found)


def rule_margins(labels: Sequence[Label]) -> tuple[RuleMargins, ...]:
    """Margins and error estimates of tests that ran to their end, by rule."""
    found = []
    for rule in dict.fromkeys((*RULES, *sorted({rule for label in labels for rule in label.margin_mm}))):
        own = [(label, limit) for label in labels if (limit := limit_mm(label, rule))]
        shares = spread(label.worst_mm[rule] / limit for label, limit in own)
        if shares is None:
            continue
        errors = [
            (label.error_mm[rule], abs(label.margin_mm[rule])) for label, _ in own if rule in label.error_mm
        ]
        found.append(
            RuleMargins(
                rule,
                shares,
                spread(error for error, _ in errors),
                sum(abs(label.margin_mm[rule]) <= NEAR * limit for label, limit in own),
                sum(error >= margin for error, margin in errors),
            )
        )
    return tuple(found)


def _numerics(engine: str, labels: Sequence[Label]) -> Numerics:
    spreads = [
        spread(getattr(label, what) for label in labels)
        for what in ("penetration_mm", "energy_residual", "time_step_s")
    ]
    penetration, residual, step = (found for found in spreads if found is not None)
    whole = [label for label in labels if label.ended_by is None]
    return Numerics(
        engine,
        penetration,
        residual,
        step,
        len(labels) - len(whole),
        sum(not label.error_mm for label in whole),
    )


def as_entry(value: Any) -> Any:
    """Statistics as JSON holds them."""
    if isinstance(value, Group):
        return {"key": value.key, "title": value.title, "values": list(value.values)}
    if hasattr(value, "__dataclass_fields__"):
        return {name: as_entry(getattr(value, name)) for name in value.__dataclass_fields__}
    if isinstance(value, Mapping):
        return {key: as_entry(entry) for key, entry in value.items()}
    if isinstance(value, (tuple, list)):
        return [as_entry(entry) for entry in value]
    return value
