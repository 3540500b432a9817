"""Blows: seen ahead, met with smaller steps, and none of that felt by what doesn't collide."""

import numpy as np
import pytest

from config.scene import Scene
from config.scene_file import validate_scene
from sim_core.accuracy.cases import boxes_scene
from sim_core.accuracy.closed_forms import pushed_slides_m
from sim_core.engines import make_engine
from sim_core.frames import GRAVITY
from sim_core.geometry import turned_by_half_step
from sim_core.impacts import ImpactWatch
from sim_core.load_test import LoadTest
from sim_core.sled import sled_samples

Rows = list[list[float]] | np.ndarray[tuple[int, int], np.dtype[np.float64]]
ENGINES = ("bullet", "mujoco")
SIZE_M = (0.4, 0.3, 0.25)


def impact_scene(gap_m: float, engine: str) -> Scene:
    """A frictionless block that a 0.3 g pulse drives into a resting one."""
    a = 0.3 * GRAVITY
    raw = boxes_scene(
        "impact",
        {"profile": "table", "times_s": [0.0, 0.2], "acceleration_mps2": [a, a]},
        [SIZE_M],
        [0.0],
    )
    first = raw["load"]["packages"][0]
    raw["load"]["packages"].append(
        {**first, "id": "hit", "surface": "face_1", "position_m": [-SIZE_M[0] - gap_m, 0.0, SIZE_M[2] / 2.0]}
    )
    raw["surfaces"]["pairs"] += [
        {"between": ["sled", "face_1"], "friction": 0.5},
        {"between": ["face_0", "face_1"], "friction": 0.0},
    ]
    return validate_scene({**raw, "solver": {"engine": engine}})


@pytest.mark.parametrize("engine", ENGINES)
def test_a_blow_is_right_wherever_in_a_step_it_falls(engine: str) -> None:
    # A step at 0.59 m/s is 1.23 mm long: gaps over that length put the blow at every phase of a step. Without smaller
    # steps Bullet is off by up to 0.29 mm, MuJoCo by 0.72 mm.
    for gap_m in 0.1 + np.linspace(0.0, 1.23e-3, 5):
        test = LoadTest(impact_scene(float(gap_m), engine))
        places = []
        for sample in sled_samples(test.scene):
            frame = test.take(sample)
            if frame is not None:
                places.append(frame.positions[1:, 0])
            if sample.index == test.scene.sampling.samples_hz:
                break
        test.close()
        slid_mm = 1000.0 * (places[0] - places[-1])
        assert np.abs(slid_mm - 1000.0 * np.array(pushed_slides_m(0.3, 0.2, gap_m, 0.5))).max() < 0.1
        assert 0 < test.impact_steps < 0.2 * test.step_count


@pytest.mark.parametrize("engine", ENGINES)
def test_changing_the_step_under_way_moves_nothing(engine: str) -> None:
    # Under constant acceleration x - h/2 v is exact for a semi-implicit step, and must stay so across changes.
    scene = boxes_scene(
        "slide",
        {"profile": "table", "times_s": [0.0, 2.0], "acceleration_mps2": [2.0, 2.0]},
        [SIZE_M],
        [0.0],
    )
    body = make_engine(validate_scene({**scene, "solver": {"engine": engine}}))
    time_s = 0.0
    try:
        start = body.poses()[0][1, 0]
        for step_s in (1 / 480, 1 / 3840, 1 / 480, 1 / 960):
            body.set_step(step_s)
            for _ in range(40):
                body.step(np.array([2.0 * step_s, 0.0, 0.0]), None)
                time_s += step_s
        moved = body.poses()[0][1, 0] - start - 0.5 * step_s * body.velocities()[0][1, 0]
    finally:
        body.close()
    # MuJoCo's least friction is 1e-5 of the weight.
    assert moved == pytest.approx(-0.5 * 2.0 * time_s**2, abs=2.0e-5)


@pytest.mark.parametrize("engine", ENGINES)
def test_changing_the_step_back_and_forth_keeps_turning_bodies(engine: str) -> None:
    sled = {"profile": "table", "times_s": [0.0, 1.0], "acceleration_mps2": [9.0, 9.0]}
    scene = boxes_scene("tip", sled, [(0.2, 0.3, 0.6)], [1.0])
    body = make_engine(validate_scene({**scene, "solver": {"engine": engine}}))
    try:
        for _ in range(150):
            body.step(np.array([9.0 / 480.0, 0.0, 0.0]), None)
        before, turning = body.poses(), body.velocities()
        assert np.abs(turning[1]).max() > 0.5
        body.set_step(1 / 3840)
        halfway = body.poses()
        body.set_step(1 / 480)
        after = body.poses()
        assert np.abs(body.velocities()[1] - turning[1]).max() < 1.0e-12
    finally:
        body.close()
    back_s = 1 / 480 - 1 / 3840
    wanted = turned_by_half_step(before[1], turning[1], back_s)
    assert np.abs(np.abs(wanted[1] @ halfway[1][1]) - 1.0) < 1.0e-6
    assert np.abs(after[0] - before[0]).max() < 1.0e-9
    assert np.abs(after[1] - before[1]).max() < 2.0e-6


def watch(positions: Rows, velocities: Rows, *, split: int = 1) -> int:
    half = np.full((len(positions), 3), 0.1)
    still = np.tile([0.0, 0.0, 0.0, 1.0], (len(positions), 1))
    return ImpactWatch(half, np.zeros(len(positions)), 0.25).substeps(
        1 / 480, split, 1 / 240, np.array(positions), still, np.array(velocities)
    )


def test_only_a_blow_ahead_asks_for_smaller_steps() -> None:
    closing = [[0.5, 0.0, 0.0], [0.0, 0.0, 0.0]]
    assert watch([[0.0, 0.0, 0.0], [0.201, 0.0, 0.0]], closing) == 8
    assert watch([[0.0, 0.0, 0.0], [0.201, 0.0, 0.0]], [[0.05, 0.0, 0.0], [0.0, 0.0, 0.0]]) == 1, "slow"
    assert watch([[0.0, 0.0, 0.0], [0.3, 0.0, 0.0]], closing) == 1, "far"
    assert watch([[0.0, 0.0, 0.0], [0.201, 0.25, 0.0]], closing) == 1, "passes by"
    assert watch([[0.0, 0.0, 0.0], [0.201, 0.0, 0.0]], [[-0.5, 0.0, 0.0], [0.0, 0.0, 0.0]]) == 1, "parting"
    assert watch([[0.0, 0.0, 0.0], [0.2, 0.0, 0.0]], closing) == 1, "has met"
    assert watch([[0.0, 0.0, -0.15], [0.201, 0.0, -0.15]], closing) == 1, "has fallen"
    assert watch([[0.0, 0.0, 0.0], [0.3, 0.0, 0.0], [0.301, 0.201, 0.0]], [[0.0, 0.0, 0.0]] * 3) == 1, "still"
    assert watch(np.zeros((0, 3)), np.zeros((0, 3))) == 1


def test_smaller_steps_stay_until_the_blow() -> None:
    # The whole step would take the body 0.4 mm further than the smaller one: past the other one's face.
    positions, closing = [[0.0, 0.0, 0.0], [0.2029, 0.0, 0.0]], [[0.5, 0.0, 0.0], [0.0, 0.0, 0.0]]
    assert watch(positions, closing) == 1
    assert watch(positions, closing, split=8) == 8
