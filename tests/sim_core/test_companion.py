"""The error estimate is the difference to a coarser run, and says why where there is none."""

import signal
from collections.abc import Callable
from typing import Any

import pytest

from config.scene import Scene
from config.scene_file import find_scene, read_scene
from sim_core.companion import (
    Answer,
    Companion,
    CrossCheck,
    companion_scenes,
    compared,
    floor_mm,
    held_share,
)
from sim_core.report import judgement, worst_by_rule
from sim_core.run import run_test

MakeScene = Callable[..., Scene]
Box = Callable[..., dict[str, Any]]


def worst(scene: Scene) -> dict[str, float]:
    return worst_by_rule(judgement(scene, run_test(scene).judge))


@pytest.mark.parametrize("name", ["block_slip", "slabs"])
def test_the_estimate_is_the_difference_to_the_doubled_step(name: str) -> None:
    scene = read_scene(find_scene(name))
    companion = Companion(scene)
    # Five slabs of falling weight don't come to rest with 20 iterations at 1/240 s: it keeps all 40.
    real, doubled = worst(scene), worst(companion_scenes(scene)[name == "slabs"])
    estimate = companion.estimate(real, scene.time_step_s)
    floor = floor_mm(scene.time_step_s)
    assert estimate.problem is None
    assert estimate.companion_step_s == 2.0 * scene.time_step_s
    # The same code on the same samples: the very numbers, since JSON keeps every bit.
    assert estimate.by_rule_mm == {rule: max(abs(real[rule] - doubled[rule]), floor) for rule in real}
    assert set(estimate.by_rule_mm) == {"permanent", "permanent_on_pallet", "elastic"}
    assert estimate.largest_mm == max(estimate.by_rule_mm.values())


@pytest.mark.parametrize(
    ("parts", "factor", "poses_hz"),
    [
        ({}, 2.0, 240),
        ({"solver": {"time_step_s": 1.0 / 1920, "iterations": 70}}, 2.0, 240),
        # Frames at 480 Hz leave no room for a step above 1/480 s: the companion has half as many.
        ({"sampling": {"poses_hz": 480}}, 2.0, 240),
        # Three samples a frame: two of them don't fit, half a sample does.
        (
            {"sampling": {"samples_hz": 720, "poses_hz": 240}, "solver": {"time_step_s": 1.0 / 720}},
            2.0,
            120,
        ),
        ({"sampling": {"samples_hz": 960, "poses_hz": 1}, "solver": {"time_step_s": 1.0 / 120}}, 2.0, 1),
        # Twice 1/60 s is more than a scene may ask for.
        ({"sampling": {"samples_hz": 960, "poses_hz": 1}, "solver": {"time_step_s": 1.0 / 60}}, 0.5, 1),
    ],
)
def test_the_companions_step(
    make_scene: MakeScene, box: Box, parts: dict[str, Any], factor: float, poses_hz: int
) -> None:
    scene = make_scene(box("a"), **parts)
    other = companion_scenes(scene)[0]
    assert other.time_step_s == pytest.approx(factor * scene.time_step_s, rel=1.0e-12)
    assert other.iterations == round(scene.iterations / max(1.0, factor))
    assert other.sampling.poses_hz == poses_hz
    assert other.model_copy(update={"solver": scene.solver, "sampling": scene.sampling}) == scene


def test_a_companion_that_a_monitor_ends_is_a_problem(make_scene: MakeScene, box: Box) -> None:
    """1000 m/s² on ice for 0.1 s: past 50 m/s after half of it, where the engine's word counts no more."""
    scene = make_scene(
        box("a", bottom=0.0),
        pallet=None,
        surfaces={"pairs": [{"between": ["cardboard", "sled"], "friction": 0.0}]},
        sled={"profile": "table", "times_s": [0.0, 0.1], "acceleration_mps2": [1000.0, 1000.0]},
    )
    estimate = Companion(scene).estimate({"elastic": 1.0}, scene.time_step_s)
    assert estimate.largest_mm is None
    assert estimate.by_rule_mm == {}
    assert estimate.problem is not None
    assert "ended by monitor 'speed'" in estimate.problem
    assert "limit 50.0 m/s" in estimate.problem


def test_a_companion_that_cannot_begin_is_a_problem(make_scene: MakeScene, box: Box) -> None:
    estimate = Companion(make_scene(box("a"), sled={"profile": "recorded"})).estimate({}, 1.0)
    assert estimate.largest_mm is None
    assert estimate.problem is not None
    assert "sled.bag" in estimate.problem


def test_a_cancelled_companion_is_gone(make_scene: MakeScene, box: Box) -> None:
    companion = Companion(make_scene(box("a")))
    companion.cancel()
    assert companion._process.returncode == -signal.SIGKILL
    companion.cancel()


@pytest.mark.parametrize("engine", ["bullet", "mujoco"])
def test_the_other_engine_agrees_on_a_closed_form(engine: str) -> None:
    scene = read_scene(find_scene("block_slip"), [f"solver.engine={engine}"])
    other = CrossCheck(scene)
    rules = judgement(scene, run_test(scene).judge)["rules"]
    checked = other.compare(rules)
    assert checked["engine"] == ({"bullet", "mujoco"} - {engine}).pop()
    assert checked["agrees"] and checked["problem"] is None
    slips = {rule["rule"]: rule["worst_mm"] for rule in checked["rules"]}
    assert slips["permanent"] == pytest.approx(467.49964, rel=2.0e-4)


def test_a_different_state_is_a_disagreement() -> None:
    scene = read_scene(find_scene("block_slip"))
    rules = [{**rule, "state": "pass"} for rule in judgement(scene, run_test(scene).judge)["rules"]]
    checked = CrossCheck(scene).compare(rules)
    assert not checked["agrees"]
    assert [entry["agrees"] for entry in checked["rules"] if entry["rule"] == "damage"] == [True]


def test_load_held_by_film_is_never_known_better_than_its_mesh() -> None:
    scene = read_scene(find_scene("eur_wrap_lldpe"), ["solver.engine=mujoco"])
    same = Answer({"elastic": 30.0}, {}, 2.0 * scene.time_step_s, None, 2.0 * scene.time_step_s)
    share = 0.075
    for overrides, expected in (
        ([], share),
        (["wrap.spacing_m=0.025"], 0.5 * share),
        # A film that only follows holds nothing.
        (['wrap.coupling="one_way"'], 0.0),
    ):
        held = read_scene(find_scene("eur_wrap_lldpe"), ["solver.engine=mujoco", *overrides])
        assert held_share(held) == pytest.approx(expected)
        estimate = compared(same, held, {"elastic": 30.0}, scene.time_step_s)
        assert estimate.by_rule_mm["elastic"] == pytest.approx(
            max(30.0 * expected, floor_mm(scene.time_step_s))
        )
