"""How often the true error lies inside the error estimate: counted by hand on made rows, and on runs."""

import math
from typing import Any

import pytest

from sim_core.accuracy.cases import reference_suite
from sim_core.accuracy.coverage import SEEN_FROM_MM, coverage
from sim_core.accuracy.sweep import Measured, Row, Setting, run_sweep
from sim_core.companion import floor_mm

FLOOR_MM = floor_mm(1.0 / 480.0)


def measured(value: float, *, unit: str = "mm", kind: str = "closed form", name: str = "slip") -> Measured:
    """A quantity whose right value is 100."""
    return Measured(name, value, 100.0, kind, unit, abs(value - 100.0), 0.1)


def row(rate_hz: int, *quantities: Measured, iterations: int | None = None, **other: Any) -> Row:
    """A row whose companion has half the rate and half the iterations."""
    where = {"case": "block", "engine": "bullet", **other}
    count = iterations if iterations is not None else rate_hz // 12
    return Row("key", where["case"], "sliding", where["engine"], rate_hz, count, quantities=quantities)


def test_the_difference_to_the_companion_is_the_estimate() -> None:
    (found,) = coverage([row(240, measured(104.0)), row(480, measured(101.0))])
    assert (found.engine, found.quantities, found.inside, found.seen) == ("bullet", 1, 1.0, 1)
    assert found.median_ratio == pytest.approx(3.0) and found.misses == ()


def test_an_error_outside_is_told_in_words() -> None:
    rows = [
        row(240, measured(100.5)), row(480, measured(101.0)),
        row(240, measured(101.2), case="slab"), row(480, measured(101.0), case="slab"),
        row(240, measured(110.0), case="fine"), row(480, measured(101.0), case="fine"),
    ]  # fmt: skip
    (found,) = coverage(rows)
    assert found.quantities == 3 and found.inside == pytest.approx(1.0 / 3.0)
    assert found.median_ratio == pytest.approx(0.5)
    # The one whose estimate is the least share of its error comes first.
    assert found.misses == (
        "slab, slip, bullet 1/480 × 40: 1.000 mm, estimate 0.200 mm",
        "block, slip, bullet 1/480 × 40: 1.000 mm, estimate 0.500 mm",
    )


def test_an_agreement_by_chance_counts_with_the_floor() -> None:
    inside, outside = ([row(240, measured(100.0 + e)), row(480, measured(100.0 + e))] for e in (0.04, 0.06))
    assert FLOOR_MM == 0.05
    assert coverage(inside)[0].inside == 1.0
    assert coverage(outside)[0].misses == ("block, slip, bullet 1/480 × 40: 0.060 mm, estimate 0.050 mm",)


def test_errors_too_small_to_see_count_but_have_no_ratio() -> None:
    tiny = 0.9 * SEEN_FROM_MM
    (found,) = coverage([row(240, measured(100.5)), row(480, measured(100.0 + tiny))])
    assert (found.quantities, found.inside, found.seen) == (1, 1.0, 0)
    assert math.isnan(found.median_ratio)
    (exact,) = coverage([row(240, measured(100.0)), row(480, measured(100.0))])
    assert (exact.inside, exact.seen) == (1.0, 0)


@pytest.mark.parametrize(
    "quantity",
    [measured(101.0, unit="g"), measured(101.0, kind="self-refined"), measured(101.0, name="tilt")],
)
def test_what_has_no_right_value_in_mm_is_left_out(quantity: Measured) -> None:
    beside = [
        measured(104.0, unit=quantity.unit, kind=quantity.reference_kind),
        measured(104.0, name="other"),
    ]
    assert coverage([row(240, *beside), row(480, quantity)]) == []


def test_only_a_row_with_its_companion_counts() -> None:
    coarse, fine = row(240, measured(104.0)), row(480, measured(101.0))
    others = [
        row(480, measured(104.0), case="slab"),
        row(120, measured(104.0), iterations=10, engine="mujoco"),
        row(960, measured(101.0), iterations=40),
        # A run that a monitor ended has measured nothing.
        row(240, case="failed"),
        row(480, measured(101.0), case="failed"),
    ]
    assert coverage([coarse]) == coverage([fine]) == coverage(others) == []
    (found,) = coverage([coarse, fine, *others])
    assert found.quantities == 1


def test_each_engine_has_a_line_of_its_own() -> None:
    pairs = [
        row(rate, measured(value), engine=engine)
        for engine in ("mujoco", "bullet")
        for rate, value in ((240, 104.0), (480, 101.0))
    ]
    assert [found.engine for found in coverage(pairs)] == ["bullet", "mujoco"]
    assert coverage([]) == []


def test_the_estimate_covers_what_sliding_and_blows_leave() -> None:
    suite = {case.name: case for case in reference_suite()}
    cases = [suite[name] for name in ("block slip", "two blocks", "impact")]
    settings = [Setting("bullet", rate, rate // 12) for rate in (240, 480, 960)]
    rows = run_sweep(cases, settings, repeats=1)
    (found,) = coverage(rows)
    # Two pairs of settings for each quantity of each case.
    in_mm = sum(q.unit == "mm" for q in (q for row in rows for q in row.quantities))
    assert found.quantities == in_mm * 2 // 3
    assert found.inside == 1.0, found.misses
