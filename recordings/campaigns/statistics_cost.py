"""What a campaign's tests took, from their costs: the one part of the statistics that differs from run to run."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from recordings.campaigns.labels import Label
from recordings.campaigns.one_test import Cost
from recordings.campaigns.statistics_groups import Group
from recordings.campaigns.statistics_rates import Spread, spread


@dataclass(frozen=True)
class CostRow:
    """What tests of one kind took.

    Attributes:
        group: see ``Rate``.
        value: see ``Rate``.
        tests: how many have a cost.
        wall_s: wall time of a test, all of it [s].
        process_s: processor time of a test [s].
        estimate_share: of the wall time that went into error estimates.
        real_time_factor: simulated seconds a wall second, error estimate left out.
        wall_total_s: wall time of all [s].
        process_total_s: processor time of all [s].
    """

    group: str
    value: str
    tests: int
    wall_s: Spread
    process_s: Spread
    estimate_share: float
    real_time_factor: float
    wall_total_s: float
    process_total_s: float


def cost_rows(
    labels: Sequence[Label], costs: Mapping[int, Cost], groups: Sequence[Group]
) -> tuple[CostRow, ...]:
    """What tests took: all, by restraint and by the number of packages; those without a cost are left out."""
    own = [label for label in labels if label.number in costs]
    shown = [group for group in groups if group.key in ("all", "restraint")]
    rows = [(group.key, value, tests) for group in shown for value, tests in group.sorted_tests(own)]
    for low, high in ((0, 20), (20, 50), (50, 100), (100, math.inf)):
        tests = [label for label in own if low < label.packages <= high]
        value = f"{low + 1} to {high}" if high < math.inf else f"more than {low}"
        rows += [("packages", value, tests)] if tests else []
    return tuple(_cost_row(group, value, tests, costs) for group, value, tests in rows if tests)


def _cost_row(group: str, value: str, labels: Sequence[Label], costs: Mapping[int, Cost]) -> CostRow:
    own = [costs[label.number] for label in labels]
    wall, process = spread(cost.wall_s for cost in own), spread(cost.process_s for cost in own)
    assert wall is not None and process is not None
    total = sum(cost.wall_s for cost in own)
    return CostRow(
        group,
        value,
        len(own),
        wall,
        process,
        sum(cost.estimate_s for cost in own) / total if total else 0.0,
        sum(label.simulated_s for label in labels) / max(1.0e-9, sum(cost.test_s for cost in own)),
        total,
        sum(cost.process_s for cost in own),
    )
