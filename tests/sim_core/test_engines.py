"""Both engines behind the one interface: the same scenes, the same answers, the same promises."""

import itertools

import numpy as np
import pytest

from config.scene import Scene
from config.scene_file import find_scene, read_scene, validate_scene
from sim_core.engines import make_engine
from sim_core.load_test import LoadTest
from sim_core.run import run_test
from sim_core.sled import sled_samples
from tests.sim_core.scenes import packages_of, run_shipped

ENGINES = ["bullet", "mujoco"]
GRAVITY = 9.81


def shipped(name: str, engine: str, *overrides: str) -> Scene:
    return read_scene(find_scene(name), [f"solver.engine={engine}", *overrides])


@pytest.mark.parametrize("engine", ENGINES)
def test_block_slips_as_in_closed_form(engine: str) -> None:
    moved = packages_of(run_shipped("block_slip", f"solver.engine={engine}").judge)["block"]
    assert -moved.final_displacement_mm[0] == pytest.approx(467.49964, rel=2.0e-4)


@pytest.mark.parametrize("engine", ENGINES)
def test_snapshot_goes_on_bit_for_bit(engine: str) -> None:
    scene = shipped("stackbuilder", engine, "load.layers=2")
    test = LoadTest(scene)
    samples = sled_samples(scene)
    for _ in range(101):
        test.take(next(samples))
    handle = test.engine.snapshot()
    push = np.array([0.02, 0.005, 0.0])
    runs = []
    for _ in range(2):
        test.engine.restore(handle)
        for _ in range(60):
            test.engine.step(push, None)
        runs.append([array.copy() for array in (*test.engine.poses(), *test.engine.velocities())])
    test.close()
    for first, second in zip(*runs, strict=True):
        np.testing.assert_array_equal(first, second)


@pytest.mark.parametrize("engine", ENGINES)
def test_order_of_the_packages_changes_no_bit(engine: str) -> None:
    scene = shipped("mixed_sizes", engine, "sled.plateau_s=0.3")
    raw = scene.model_dump(mode="json")
    raw["load"]["packages"].reverse()
    first, second = (packages_of(run_test(s).judge) for s in (scene, validate_scene(raw)))
    assert first == {name: second[name] for name in first}


@pytest.mark.parametrize("engine", ENGINES)
def test_weight_and_external_force_balance(engine: str) -> None:
    scene = shipped("stackbuilder", engine, "load.layers=1")
    test = LoadTest(scene)
    test.take(next(sled_samples(scene)))
    weight_n = GRAVITY * sum(package.mass_kg for package in scene.packages)
    assert test.engine.support_n() == pytest.approx(weight_n, rel=5.0e-3)
    # A lift of half the weight, held until the contacts have answered.
    lift = np.zeros((len(scene.packages) + 1, 3))
    lift[1:, 2] = 0.5 * GRAVITY * 10.0
    held = []
    for _ in range(240):
        test.engine.step(np.zeros(3), lift)
        held.append(test.engine.support_n())
    # The boxes may bounce on their contacts; over half a second that evens out.
    assert np.mean(held[60:]) == pytest.approx(0.5 * weight_n, rel=1.0e-2)
    test.close()


@pytest.mark.parametrize("engine", ENGINES)
def test_spin_is_read_in_the_fixed_frame(engine: str) -> None:
    # A box with a free fall under it: no contact, so a torque-free turn about its upright axis stays as it is.
    scene = validate_scene(
        {
            "name": "spin",
            "load": {
                "packages": [
                    {
                        "id": "a",
                        "size_m": [0.4, 0.3, 0.2],
                        "mass_kg": 5,
                        "position_m": [0, 0, 5],
                        "yaw_deg": 30,
                    }
                ]
            },
            "pallet": None,
            "sled": {"profile": "eumos", "level_g": 0.0},
            "solver": {"engine": engine},
        }
    )
    engine_under_test = make_engine(scene)
    step_s = scene.time_step_s
    for _ in range(48):
        engine_under_test.step(np.array([0.0, 0.0, 0.0]), None)
    linear, angular = engine_under_test.velocities()
    positions, orientations = engine_under_test.poses()
    assert linear[1, 2] == pytest.approx(-GRAVITY * 48 * step_s, rel=1.0e-9)
    # Semi-implicit: the fall after n steps is g·h²·n(n+1)/2.
    assert positions[1, 2] == pytest.approx(5.0 - GRAVITY * step_s**2 * 48 * 49 / 2.0, rel=1.0e-9)
    np.testing.assert_allclose(angular[1], 0.0, atol=1.0e-12)
    np.testing.assert_allclose(
        orientations[1], [0.0, 0.0, np.sin(np.pi / 12), np.cos(np.pi / 12)], atol=1.0e-12
    )


def table_scene(engine: str, upper: float, lower: float) -> Scene:
    """Two boxes of different surfaces, one on the other, on the sled, with two frictions."""
    return validate_scene(
        {
            "name": "pairs",
            "load": {
                "packages": [
                    {
                        "id": "low",
                        "size_m": [1.2, 0.8, 0.2],
                        "mass_kg": 20,
                        "position_m": [0, 0, 0.1],
                        "surface": "wood",
                    },
                    {"id": "top", "size_m": [0.4, 0.3, 0.1], "mass_kg": 5, "position_m": [0, 0, 0.25]},
                ]
            },
            "pallet": None,
            "surfaces": {
                "pairs": [
                    {"between": ["wood", "sled"], "friction": lower},
                    {"between": ["cardboard", "wood"], "friction": upper},
                    {"between": ["wood", "wood"], "friction": 0.3},
                ]
            },
            "sled": {
                "profile": "table",
                "times_s": [0, 0.3],
                "acceleration_mps2": [0.4 * GRAVITY, 0.4 * GRAVITY],
            },
            "solver": {"engine": engine},
        }
    )


@pytest.mark.parametrize(("engine", "lower"), [*itertools.product(ENGINES, [0.2, 0.6])])
def test_each_pair_has_its_own_friction(engine: str, lower: float) -> None:
    # At 0.4 g the low box slides on 0.2 and sticks on 0.6; the top one slides on neither (0.5).
    moved = packages_of(run_test(table_scene(engine, 0.5, lower)).judge)
    if lower > 0.4:
        assert moved["low"].peak_mm < 0.1 and moved["top"].peak_mm < 0.1
        return
    # Constant 0.4 g for T, then grip alone: slip = ½·(a − μg)·T² + ((a − μg)·T)²/(2μg), with a − μg = μg.
    slip_mm = 1000.0 * (0.5 * 0.2 * GRAVITY * 0.3**2 + (0.2 * GRAVITY * 0.3) ** 2 / (2 * 0.2 * GRAVITY))
    assert moved["low"].peak_mm == pytest.approx(slip_mm, rel=3.0e-3)
    assert moved["top"].peak_mm == pytest.approx(slip_mm, rel=3.0e-3)


def test_engines_agree_on_a_load_held_by_fields() -> None:
    peaks = []
    for engine in ENGINES:
        rules = {
            rule.rule: rule.worst_mm
            for rule in run_shipped("eur_fields_05g", f"solver.engine={engine}").judge.rules()
        }
        peaks.append(rules["elastic"])
    assert peaks[0] is not None and peaks[1] is not None
    assert abs(peaks[0] - peaks[1]) < 1.0
