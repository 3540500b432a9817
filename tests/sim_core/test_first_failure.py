"""The first broken rule is the one that is broken first and stays so."""

import numpy as np
import pytest

from sim_core.first_failure import FailureWatch

NAMES = ["pallet", "a", "b"]


def watch():
    settled = np.zeros((3, 8, 3))
    settled[1, :, 2], settled[2, :, 2] = 0.1, 1.0
    on_pallet = settled[:, :, 2] < 0.2
    return FailureWatch(NAMES, settled, on_pallet, permanent_m=0.05, base_m=0.04, elastic_m=0.10)


def run(frames, *, lost=None, torn=None):
    one = watch()
    for time_s, moved in frames:
        displacement = np.zeros((3, 8))
        for row, value in moved.items():
            displacement[row, 3] = value
        one.take(time_s, displacement, lambda time_s=time_s: lost(time_s) if lost else np.zeros(3, bool))
    return one.first(torn)


def test_nothing_is_broken_at_the_limits():
    assert run([(0.0, {2: 0.05, 1: 0.0399}), (0.1, {2: 0.10}), (0.2, {2: 0.05})]) is None


def test_the_base_limit_itself_is_broken():
    assert run([(0.1, {1: 0.04})]).rule == "permanent_on_pallet"


def test_a_lean_that_comes_back_breaks_the_peak_alone():
    first = run([(0.1, {2: 0.07}), (0.2, {2: 0.12}), (0.3, {2: 0.02})])
    assert (first.rule, first.time_s, first.package, first.corner, first.height_m) == (
        "elastic",
        0.2,
        "b",
        3,
        1.0,
    )


def test_a_slip_that_stays_is_broken_from_when_it_stayed():
    first = run([(0.1, {2: 0.06}), (0.2, {2: 0.03}), (0.3, {2: 0.07}), (0.4, {2: 0.12}), (0.5, {2: 0.11})])
    assert (first.rule, first.time_s) == ("permanent", 0.3)


def test_a_package_that_falls_and_one_that_comes_back():
    gone = {0.2: [False, False, True], 0.3: [False, True, True], 0.4: [False, True, False]}
    frames = [(t, {2: 0.2}) for t in gone]
    first = run([*frames], lost=lambda t: np.array(gone[t]))
    # All three limits are broken in the frame at 0.2 s; the package lost for good is "a", at 0.3 s.
    assert (first.rule, first.time_s) == ("permanent", 0.2)


@pytest.mark.parametrize(("torn_s", "rule"), [(0.05, "damage"), (0.5, "permanent")])
def test_film_that_tears_first_is_a_damage(torn_s, rule):
    first = run([(0.1, {2: 0.2})], torn=(torn_s, 0.7))
    assert first.rule == rule and (first.package == "film") == (rule == "damage")
