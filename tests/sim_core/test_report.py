"""The report: its keys, its bytes, and when it calls a verdict unresolved."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from config.scene import Scene, Solver
from sim_core.companion import ErrorEstimate
from sim_core.frames import PoseFrame
from sim_core.integrity import check_integrity
from sim_core.judge import EumosJudge
from sim_core.report import Report, full_report, judgement, report_json, worst_by_rule, write_report
from sim_core.run import PhysicsSummary

MakeScene = Callable[..., Scene]
Box = Callable[..., dict[str, Any]]

PHYSICS = PhysicsSummary(
    engine="bullet",
    settings={"numSubSteps": 0},
    unmet_friction=[],
    steps=1000,
    settle_s=0.05,
    simulated_s=2.0,
    at_rest=True,
    penetration_m=1.0e-4,
    speed_mps=0.3,
    residual=1.0e-9,
    contact_count=4,
    energy_residual=0.0,
    step_phase=0.0,
    smallest_step_s=1.0 / 480.0,
    halvings=[],
)
RULES = ("permanent", "permanent_on_pallet", "elastic")


@pytest.fixture(scope="module")
def scene(make_scene: MakeScene, box: Box) -> Scene:
    """0.394 m high: limits of 19.7, 40 and 39.4 mm."""
    return make_scene(box("a"))


def judge_of(scene: Scene, *shifts_m: float) -> EumosJudge:
    """A package that stands, then is moved along x by each shift in turn, a frame each 1/240 s."""
    judge = EumosJudge(scene)
    for k, shift in enumerate((0.0, *shifts_m)):
        positions = np.array([(0.0, 0.0, 0.072), *(package.position_m for package in scene.packages)])
        positions[1:, 0] += shift
        orientations = np.tile((0.0, 0.0, 0.0, 1.0), (len(positions), 1))
        judge.add(PoseFrame(k, 10**12 + k * 4_166_667, positions, orientations))
    return judge


def estimate(error_mm: float) -> ErrorEstimate:
    return ErrorEstimate(1.0 / 240.0, dict.fromkeys(RULES, error_mm), error_mm)


def report_of(scene: Scene, *shifts_m: float, physics: PhysicsSummary = PHYSICS, **other: Any) -> Report:
    found = judgement(scene, judge_of(scene, *shifts_m), is_complete=physics.ended_by is None)
    given = {
        "findings": check_integrity(scene),
        "estimate": estimate(0.1),
        "wall_s": 1.0,
        "mode": "run",
        **other,
    }
    return full_report(found, scene, physics=physics, **given)


def states(report: Report) -> list[str]:
    return [rule["state"] for rule in report["rules"]]


def test_the_keys_of_the_design(scene: Scene) -> None:
    report = report_of(scene, 0.001)
    assert {
        "verdict", "rules", "series", "numerics", "packages", "integrity", "scene_sha256", "versions"
    } <= set(report)  # fmt: skip
    for rule in report["rules"]:
        assert {"limit_mm", "worst_mm", "margin_mm", "package", "corner", "time_s", "height_m"} <= set(rule)
    assert {
        "time_step_s", "iterations", "engine", "error_estimate_mm", "max_penetration_mm", "energy_residual",
        "wall_time_s", "real_time_factor", "monitors",
    } <= set(report["numerics"])  # fmt: skip
    assert report["numerics"]["real_time_factor"] == pytest.approx(2.05)
    assert report["numerics"]["max_penetration_mm"] == pytest.approx(0.1)
    (package,) = report["packages"]
    assert set(package) == {"id", "peak_mm", "permanent_mm", "final_displacement_mm", "final_tilt_deg"}
    assert package["final_displacement_mm"] == pytest.approx((1.0, 0.0, 0.0))
    assert report["scene_sha256"] == scene.sha256
    assert {"python", "numpy", "pybullet", "pydantic"} <= set(report["versions"])


def test_the_sled_and_the_load_are_told(scene: Scene) -> None:
    report = judgement(scene, judge_of(scene, 0.0))
    assert report["load"] == {"package_count": 1, "interlayer_count": 0, "mass_kg": 10.0, "source": None}
    assert report["sled"]["peak_mps2"] == pytest.approx(4.905)
    assert report["sled"]["stop_s"] == pytest.approx(2.05)
    assert report["sled"]["velocity_mps"][-1] == pytest.approx([0.0, 0.0, 0.0], abs=1.0e-12)


def test_the_same_poses_give_the_same_bytes(scene: Scene) -> None:
    one, other = (report_json(judgement(scene, judge_of(scene, 0.01, 0.004)), compact=True) for _ in range(2))
    assert one == other
    assert one != report_json(judgement(scene, judge_of(scene, 0.01, 0.004001)), compact=True)


def test_the_json_is_strict_and_says_what_the_report_says(scene: Scene) -> None:
    def refuse(constant: str) -> float:
        raise AssertionError(constant)

    report = report_of(scene, 0.01, 0.0)
    for compact in (False, True):
        text = report_json(report, compact=compact)
        read = json.loads(text, parse_constant=refuse)
        assert [rule["state"] for rule in read["rules"]] == states(report)
        # Nine decimals are kept.
        assert read["rules"][2]["worst_mm"] == pytest.approx(report["rules"][2]["worst_mm"], abs=0.5e-9)
    assert report_json(json.loads(text), compact=True) == text
    with pytest.raises(ValueError, match="JSON compliant"):
        report_json({**report, "height_m": float("nan")})


def test_a_report_is_written_whole(scene: Scene, tmp_path: Path) -> None:
    path = tmp_path / "report.json"
    report = report_of(scene, 0.001)
    write_report(report, path)
    write_report(report, path)
    assert path.read_text(encoding="utf-8") == report_json(report) + "\n"
    assert [entry.name for entry in tmp_path.iterdir()] == ["report.json"]
    with pytest.raises(ValueError, match="JSON compliant"):
        write_report({**report, "height_m": float("inf")}, path)
    assert json.loads(path.read_text(encoding="utf-8"))["name"] == "load"


@pytest.mark.parametrize(
    ("shift_m", "error_mm", "expected", "verdict"),
    [
        # Permanent limit 19.7 mm, on the pallet 40 mm, elastic 39.4 mm.
        (0.010, 9.6, ["pass", "pass", "pass", "pass"], "pass"),
        (0.010, 9.8, ["unresolved", "pass", "pass", "pass"], "unresolved"),
        (0.010, 35.0, ["unresolved", "unresolved", "unresolved", "pass"], "unresolved"),
        (0.0395, 0.3, ["fail", "pass", "unresolved", "pass"], "fail"),
        (0.0398, 0.5, ["fail", "unresolved", "unresolved", "pass"], "fail"),
        (0.060, 0.5, ["fail", "fail", "fail", "pass"], "fail"),
        (0.060, 45.0, ["unresolved", "unresolved", "unresolved", "pass"], "unresolved"),
    ],
)
def test_a_rule_is_unresolved_where_its_error_reaches_across_the_limit(
    scene: Scene, shift_m: float, error_mm: float, expected: list[str], verdict: str
) -> None:
    report = report_of(scene, shift_m, estimate=estimate(error_mm))
    assert (states(report), report["verdict"]) == (expected, verdict)
    assert [rule["error_mm"] for rule in report["rules"]] == [error_mm] * 3 + [None]
    assert report["numerics"]["error_estimate_mm"] == error_mm
    assert report["numerics"]["within_tolerance"] is None
    asking = scene.model_copy(update={"solver": Solver(tolerance_mm=1.0)})
    kept = report_of(asking, shift_m, estimate=estimate(error_mm))["numerics"]["within_tolerance"]
    assert kept == (error_mm <= 1.0)


@pytest.mark.parametrize("shift_m", [0.0, 0.06])
def test_a_companion_with_a_problem_settles_nothing(scene: Scene, shift_m: float) -> None:
    report = report_of(scene, shift_m, estimate=ErrorEstimate(1 / 240, {}, None, "it fell over"))
    assert report["verdict"] == "unresolved"
    assert report["numerics"]["error_estimate_from"] == "none: it fell over"
    assert report["numerics"]["within_tolerance"] is None


def test_without_an_estimate_the_judges_word_stands(scene: Scene) -> None:
    assert report_of(scene, 0.0, estimate=None)["verdict"] == "pass"
    assert report_of(scene, 0.06, estimate=None)["verdict"] == "fail"
    assert report_of(scene, 0.0, estimate=None)["numerics"]["error_estimate_from"] == "not asked for"


@pytest.mark.parametrize("shift_m", [0.0, 0.06])
def test_a_test_that_was_ended_is_unresolved(scene: Scene, shift_m: float) -> None:
    ended = replace(PHYSICS, ended_by="ended by monitor 'speed'")
    report = report_of(scene, shift_m, physics=ended)
    assert report["verdict"] == "unresolved"
    assert report["numerics"]["ended_by"] == "ended by monitor 'speed'"
    assert all(rule["error_mm"] is None for rule in report["rules"])


def test_a_test_without_a_frame_still_has_a_report(scene: Scene) -> None:
    found = judgement(scene, EumosJudge(scene), is_complete=False)
    assert (found["verdict"], found["rules"], found["series"]) == ("unresolved", [], None)
    json.loads(report_json(found))


def test_the_worst_of_each_rule(scene: Scene) -> None:
    worst = worst_by_rule(judgement(scene, judge_of(scene, 0.02, 0.005)))
    assert worst == {
        "permanent": pytest.approx(5.0), "permanent_on_pallet": pytest.approx(5.0), "elastic": pytest.approx(20.0)
    }  # fmt: skip
