"""The independent solutions against each other and against what they must tend to."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sim_core.accuracy.closed_forms import (
    field_motion_m,
    pushed_slides_m,
    slab_slips_m,
    tipping_level_g,
    trapezoid_slip_m,
    trapezoid_travel_m,
)

G = 9.81


def test_trapezoid_slip_has_its_published_value() -> None:
    assert trapezoid_slip_m(0.5, 0.05, 0.5, 0.3) == pytest.approx(0.46749964, abs=1.0e-8)


def test_trapezoid_travel_is_a_mean_speed_times_the_time() -> None:
    # V = A·(t_r + t_h); the profile is symmetric, so the mean speed until its end is V/2.
    speed = 0.5 * G * 0.55
    assert trapezoid_travel_m(0.5, 0.05, 0.5, 0.6) == pytest.approx(speed / 2.0 * 0.6, rel=1.0e-12)
    assert trapezoid_travel_m(0.5, 0.05, 0.5, 1.6) == pytest.approx(speed / 2.0 * 0.6 + speed, rel=1.0e-12)


@settings(max_examples=20, deadline=None)
@given(friction=st.floats(0.2, 0.35), level=st.floats(0.45, 0.8))
def test_one_slab_is_the_block_of_the_closed_form(friction: float, level: float) -> None:
    # The slide begins inside a step: its speed is off by up to (A/t_r)·h²/8 for up to 2.2 s.
    expected = trapezoid_slip_m(level, 0.05, 0.5, friction)
    found = slab_slips_m([7.0], [friction], level, 0.05, 0.5, 3.0, step_s=2.0e-4)[0]
    assert found == pytest.approx(expected, abs=2.0e-6)


def test_slab_solution_is_converged() -> None:
    masses, frictions = [100, 80, 60, 40, 20], [0.5, 0.4, 0.3, 0.2, 0.1]
    coarse, fine = (slab_slips_m(masses, frictions, 0.45, 0.05, 0.4, 1.2, step_s=h) for h in (4.0e-4, 1.0e-4))
    np.testing.assert_allclose(fine, [0.0, 0.0, 0.05003, 0.33542, 1.18740], atol=1.0e-5)
    np.testing.assert_allclose(coarse, fine, atol=2.0e-6)


def test_a_block_that_would_not_rejoin_a_coasting_sled_is_refused() -> None:
    with pytest.raises(ValueError, match="before it coasts"):
        trapezoid_slip_m(0.31, 0.05, 0.5, 0.3)


def test_pushed_blocks_lose_what_the_second_one_rubs_away() -> None:
    first, second = pushed_slides_m(0.3, 0.2, 0.1, 0.5, mass_ratio=2.0)
    common = 0.3 * G * 0.2 * 2.0 / 3.0
    # ½·(m1 + m2)·v² = μ·m2·g·s
    assert 0.5 * 3.0 * common**2 == pytest.approx(0.5 * 1.0 * G * second)
    assert first - second == pytest.approx(0.1)
    with pytest.raises(ValueError, match="stick"):
        pushed_slides_m(0.6, 0.2, 0.5, 0.5)


def motion(force_n: float, acceleration: float, friction: float = 0.0, step_s: float = 1.0e-4) -> np.ndarray:
    return field_motion_m(
        mass_kg=10.0, strength_n=force_n, distance_m=0.05, falloff=2.0, friction=friction,
        knots_s=[0.0, 9.0], acceleration_mps2=[acceleration, acceleration], end_s=1.0, step_s=step_s,
    )  # fmt: skip


def test_small_swing_between_fields_is_that_of_a_spring() -> None:
    # φ(d − x) − φ(d + x) ≈ 2p·x/d, so k = 2p·F/d, and a constant load swings to 2·m·a/k.
    force, acceleration = 1000.0, 0.01
    peak = 2.0 * 10.0 * acceleration / (4.0 * force / 0.05)
    assert np.abs(motion(force, acceleration)[:, 1]).max() == pytest.approx(peak, rel=1.0e-4)


def test_swing_with_friction_stops_inside_its_dead_zone() -> None:
    rows = motion(200.0, 4.0, friction=0.2)
    x, v = rows[-1, 1:]
    assert v == 0.0
    press = (0.05 / (0.05 - x)) ** 2 - (0.05 / (0.05 + x)) ** 2
    assert abs(-4.0 - 200.0 / 10.0 * press) <= 0.2 * G
    np.testing.assert_allclose(motion(200.0, 4.0, friction=0.2, step_s=1.0e-3)[-1, 1], x, atol=1.0e-7)


def test_package_below_its_friction_never_leaves() -> None:
    assert not motion(200.0, 1.9, friction=0.2)[:, 1:].any()


def test_tipping_level_is_the_aspect_ratio() -> None:
    assert tipping_level_g(0.2, 0.3) == pytest.approx(2.0 / 3.0)
