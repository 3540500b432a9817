"""The physics against closed forms and an independent solution, at the default setting."""

import numpy as np
import pytest

from config.scene_file import find_scene, read_scene
from sim_core.accuracy.closed_forms import slab_slips_m, trapezoid_slip_m
from sim_core.load_test import LoadTest
from sim_core.run import run_test
from sim_core.sled import sled_samples
from tests.sim_core.scenes import block_scene, packages_of, run_shipped

SLAB_MASSES, SLAB_FRICTIONS = [100, 80, 60, 40, 20], [0.5, 0.4, 0.3, 0.2, 0.1]


def test_block_slides_as_far_as_the_closed_form_says() -> None:
    slip_m = trapezoid_slip_m(0.5, 0.05, 0.5, 0.3)
    assert slip_m == pytest.approx(0.46749964, abs=1.0e-8)
    moved = packages_of(run_shipped("block_slip").judge)["block"].final_displacement_mm
    # The corrected read is of second order in the step; 2e-4 is the product's promise.
    assert -moved[0] / 1000.0 == pytest.approx(slip_m, rel=2.0e-4)
    assert abs(moved[1]) < 0.1


@pytest.mark.parametrize(
    ("direction", "axis", "sign"), [("+x", 0, -1), ("-x", 0, 1), ("+y", 1, -1), ("-y", 1, 1)]
)
def test_slip_points_against_the_sled(direction: str, axis: int, sign: int) -> None:
    moved = packages_of(run_shipped("block_slip", f"sled.direction={direction}").judge)["block"]
    slip_mm = 1000.0 * trapezoid_slip_m(0.5, 0.05, 0.5, 0.3)
    assert sign * moved.final_displacement_mm[axis] == pytest.approx(slip_mm, rel=2.0e-4)
    assert abs(moved.final_displacement_mm[1 - axis]) < 0.1


def test_block_below_its_friction_sticks() -> None:
    result = run_test(block_scene(level_g=0.45, friction=0.5, size_m=(0.4, 0.3, 0.25)))
    assert packages_of(result.judge)["block"].peak_mm < 0.1


def tips(acceleration_mps2: float) -> bool:
    scene = block_scene(
        level_g=0.0,
        friction=1.0,
        size_m=(0.4, 0.3, 0.6),
        times_s=[0.0, 3.0],
        acceleration_mps2=[acceleration_mps2, acceleration_mps2],
    )
    return packages_of(run_test(scene).judge)["block"].peak_mm > 10.0


def test_block_tips_at_its_aspect_ratio() -> None:
    # a_crit = g·b/h with b = 0.2 m and h = 0.3 m; bracketed on both sides within 2e-4.
    critical = 9.81 * 0.2 / 0.3
    assert not tips(critical * (1.0 - 2.0e-4))
    assert tips(critical * (1.0 + 2.0e-4))


def slab_slips_at(end_s: float, *overrides: str) -> tuple[np.ndarray, np.ndarray]:
    """Slips along x and drifts along y of the shipped slabs at a time, both in metres."""
    scene = read_scene(find_scene("slabs"), overrides)
    test = LoadTest(scene)
    start = None
    try:
        for sample in sled_samples(scene):
            frame = test.take(sample)
            if frame is not None:
                start = frame.positions if start is None else start
            if sample.index == round(end_s * scene.sampling.samples_hz):
                assert frame is not None and start is not None
                moved = frame.positions[1:] - start[1:]
                return -moved[:, 0], moved[:, 1]
    finally:
        test.close()
    raise AssertionError("the samples never end")


@pytest.fixture(scope="module")
def expected_slips() -> np.ndarray:
    return slab_slips_m(SLAB_MASSES, SLAB_FRICTIONS, 0.45, 0.05, 0.4, 1.2)


def test_slabs_slip_as_the_independent_solution_says(expected_slips: np.ndarray) -> None:
    expected = expected_slips
    np.testing.assert_allclose(expected, [0.0, 0.0, 0.05003, 0.33542, 1.18740], atol=2.0e-5)
    slips, drifts = slab_slips_at(1.2)
    np.testing.assert_allclose(slips, expected, atol=2.0e-4)
    assert np.abs(drifts).max() < 2.0e-4


def test_slab_slip_converges_with_second_order(expected_slips: np.ndarray) -> None:
    expected = expected_slips
    errors = [
        np.abs(
            slab_slips_at(
                1.2, f"solver.time_step_s={1 / rate!r}", "solver.iterations=100", "sampling.poses_hz=120"
            )[0]
            - expected
        ).max()
        for rate in (120, 240)
    ]
    # Half the step must leave a quarter of the error; a third allows for what the solver leaves.
    assert errors[1] < errors[0] / 3.0


def test_nothing_moves_below_every_limit() -> None:
    # 0.2 g: under the friction of 0.5 and under the columns' tipping threshold of 0.15/0.625 g.
    result = run_shipped("stackbuilder")
    assert max(package.peak_mm for package in result.judge.packages()) < 1.5
    assert result.judge.verdict() == "pass"
    assert result.physics.at_rest


def test_columns_tip_above_their_aspect_ratio() -> None:
    # Columns 0.3 m deep and 1.25 m high tip at 0.24 g whatever the friction: the load of eur_columns at 0.3 g.
    result = run_shipped("eur_columns")
    assert result.judge.verdict() == "fail"
    assert {rule.rule for rule in result.judge.rules() if rule.state == "fail"} >= {
        "permanent",
        "elastic",
        "damage",
    }


def test_empty_pallet_passes() -> None:
    result = run_shipped("empty_pallet")
    assert result.judge.verdict() == "pass"
    assert result.judge.packages() == []
