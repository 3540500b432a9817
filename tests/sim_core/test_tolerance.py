"""A tolerance instead of a step: when the step is halved, when that ends, and what the second opinion counts for."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from config.errors import Interrupted, RefusedInput
from config.scene import Scene
from config.scene_file import find_scene, read_scene
from sim_core.companion import BackgroundTest, ErrorEstimate, floor_mm
from sim_core.report import Report, full_report, judgement, worst_by_rule
from sim_core.run import run_test
from sim_core.tolerance import MAXIMUM_REFINEMENTS, Refined, run_to_tolerance

MakeScene = Callable[..., Scene]
Box = Callable[..., dict[str, Any]]

# Iterations of its own keep a scene from the shipped table: it begins at the default step, whatever is in there.
OPEN_STEP = "solver.iterations=40"
TIGHT = "solver.tolerance_mm=0.06"


@dataclass(frozen=True)
class Attempt:
    """One run and what must be told of it."""

    scene: Scene
    judged: Report
    smallest_step_s: float
    is_complete: bool


@dataclass
class Attempts:
    """Runs tests and remembers them."""

    made: list[Attempt] = field(default_factory=list)

    def __call__(self, scene: Scene) -> Attempt:
        result = run_test(scene)
        is_complete = result.ended_by is None
        judged = judgement(scene, result.judge, is_complete=is_complete)
        self.made.append(Attempt(scene, judged, result.physics.smallest_step_s, is_complete))
        return self.made[-1]

    @property
    def rates_hz(self) -> list[int]:
        return [round(1.0 / attempt.scene.time_step_s) for attempt in self.made]


def refined(scene: Scene, **options: Any) -> tuple[Refined[Attempt], Attempts]:
    attempts = Attempts()
    return run_to_tolerance(scene, attempts, **options), attempts


def shipped(name: str, *overrides: str) -> Scene:
    return read_scene(find_scene(name), overrides)


def column(make_scene: MakeScene, box: Box, *, masses: tuple[float, ...], **parts: Any) -> Scene:
    """Boxes of 0.4 x 0.3 x 0.25 m on each other, from below."""
    boxes = [box(f"box_{k}", mass=mass, bottom=0.144 + 0.25 * k) for k, mass in enumerate(masses)]
    return make_scene(*boxes, **parts)


def test_a_step_that_keeps_the_tolerance_is_kept() -> None:
    result, attempts = refined(shipped("block_slip", TIGHT, OPEN_STEP))
    assert attempts.rates_hz == [480] and result.refinements == ()
    assert result.estimate is not None and result.estimate.largest_mm == 0.05
    assert result.result is attempts.made[0]


def test_a_step_that_does_not_is_halved_and_compared_with_the_attempt_before() -> None:
    result, attempts = refined(shipped("block_tip", TIGHT, OPEN_STEP))
    assert attempts.rates_hz == [480, 960]
    assert result.result is attempts.made[-1] and result.scene is attempts.made[-1].scene
    assert result.scene.iterations == 40 and result.scene.solver.tolerance_mm == 0.06
    (told,) = result.refinements
    assert told.startswith("1/480 s: ") and told.endswith(" mm")
    coarse, fine = (worst_by_rule(attempt.judged) for attempt in attempts.made)
    assert result.estimate is not None and result.estimate.problem is None
    floor = floor_mm(1.0 / 960.0)
    assert result.estimate.by_rule_mm == {rule: max(abs(fine[rule] - coarse[rule]), floor) for rule in fine}
    assert result.estimate.companion_step_s == 1.0 / 480.0
    assert result.estimate.largest_mm is not None and result.estimate.largest_mm <= 0.06


def test_three_refinements_at_most(make_scene: MakeScene, box: Box) -> None:
    # 100 kg on 20 kg: Gauss-Seidel's creep halves with the step and is still there at 1/3840 s.
    solver = {"tolerance_mm": 0.05, "iterations": 40}
    scene = column(make_scene, box, masses=(10.0, 10.0, 100.0), solver=solver, sled=sled_at(0.2))
    result, attempts = refined(scene)
    assert attempts.rates_hz == [480, 960, 1920, 3840]
    assert len(result.refinements) == MAXIMUM_REFINEMENTS
    assert result.estimate is not None and result.estimate.largest_mm is not None
    assert result.estimate.largest_mm > 0.05


def sled_at(level_g: float) -> dict[str, Any]:
    return {"profile": "eumos", "level_g": level_g}


def test_it_ends_where_a_half_step_does_not_help(make_scene: MakeScene, box: Box) -> None:
    # Three boxes that rock and slide at 0.6 g: where they end hangs on each blow, and no step settles that.
    scene = column(
        make_scene, box, masses=(10.0, 10.0, 10.0), sled=sled_at(0.6),
        solver={"tolerance_mm": 0.05, "iterations": 40},
        limits={"permanent_fraction": 1.0, "elastic_fraction": 1.0, "base_permanent_m": 10.0},
    )  # fmt: skip
    result, attempts = refined(scene)
    assert attempts.rates_hz == [480, 960]
    first_mm = float(result.refinements[0].split()[-2])
    assert result.estimate is not None and result.estimate.largest_mm is not None
    assert result.estimate.largest_mm > 0.8 * first_mm > 0.05


def test_how_far_beyond_its_limit_interests_nobody() -> None:
    # Slabs that slide 1.19 m: an estimate of 0.19 mm on limits of 0.05 and 0.1 m is of no interest ...
    result, attempts = refined(shipped("slabs", TIGHT, OPEN_STEP))
    assert attempts.rates_hz == [480]
    assert result.estimate is not None and result.estimate.largest_mm is not None
    assert result.estimate.largest_mm > 0.1
    # ... but it is on limits of 1 m.
    wide = shipped("slabs", TIGHT, OPEN_STEP, "limits.elastic_fraction=1", "limits.permanent_fraction=1")
    result, attempts = refined(wide)
    assert attempts.rates_hz[:2] == [480, 960]
    assert result.estimate is not None and result.estimate.by_rule_mm["elastic"] <= 0.06


def test_an_explicit_step_is_kept_whatever_the_tolerance() -> None:
    result, attempts = refined(shipped("block_tip", TIGHT, "solver.time_step_s=0.0020833333333333333"))
    assert attempts.rates_hz == [480] and result.refinements == () and result.why == "as the scene says"
    assert result.estimate is not None and result.estimate.largest_mm is not None
    assert result.estimate.largest_mm > 1.0


def test_without_a_tolerance_the_default_step_is_kept() -> None:
    result, attempts = refined(shipped("block_tip"))
    assert attempts.rates_hz == [480] and result.why == "the default setting"
    assert result.scene == shipped("block_tip")


def test_a_tolerance_without_an_estimate_is_refused_before_anything_runs() -> None:
    attempts = Attempts()
    with pytest.raises(RefusedInput, match=r"^solver.tolerance_mm = 1.0: cannot be kept with --no-estimate$"):
        run_to_tolerance(shipped("block_slip", "solver.tolerance_mm=1"), attempts, with_estimate=False)
    assert attempts.made == []
    result, attempts = refined(shipped("block_slip"), with_estimate=False)
    assert result.estimate is None and len(attempts.made) == 1


@pytest.mark.parametrize("tolerance_mm", [None, 0.05])
def test_an_empty_pallet_needs_no_estimate(make_scene: MakeScene, tolerance_mm: float | None) -> None:
    for engine in ("bullet", "auto"):
        scene = make_scene(solver={"tolerance_mm": tolerance_mm, "engine": engine})
        result, attempts = refined(scene)
        assert result.estimate is None and result.refinements == ()
        assert [attempt.judged["verdict"] for attempt in attempts.made] == ["pass"]
        assert result.scene.solver.engine in ("bullet", "mujoco")


def test_a_load_without_acceleration_keeps_any_tolerance(make_scene: MakeScene, box: Box) -> None:
    solver = {"tolerance_mm": 0.05, "iterations": 40}
    result, attempts = refined(make_scene(box("a"), sled=sled_at(0.0), solver=solver))
    assert attempts.rates_hz == [480] and attempts.made[0].judged["verdict"] == "pass"
    assert result.estimate is not None and result.estimate.largest_mm == 0.05


def test_a_test_that_a_monitor_ended_is_not_refined(make_scene: MakeScene, box: Box) -> None:
    # Five iterations hold no stack of five at any step that the monitors may halve to.
    scene = column(
        make_scene, box, masses=(10.0,) * 5, sled=sled_at(0.2), solver={"tolerance_mm": 0.05, "iterations": 5}
    )
    result, attempts = refined(scene)
    assert not result.result.is_complete
    assert attempts.rates_hz == [480] and result.refinements == ()


def test_a_step_that_spans_an_odd_number_of_samples_can_be_halved() -> None:
    result, _ = refined(shipped("block_tip", TIGHT, OPEN_STEP, "sampling.samples_hz=1440"))
    assert result.estimate is not None


def test_refining_a_test_whose_step_was_halved_leaves_an_estimate(make_scene: MakeScene, box: Box) -> None:
    solver = {"tolerance_mm": 0.05, "iterations": 10}
    scene = column(make_scene, box, masses=(10.0,) * 5, sled=sled_at(0.2), solver=solver)
    result, attempts = refined(scene)
    # The residual's monitor halves the first to 1/960 s; its companion, coarser still, does give an estimate.
    assert attempts.made[0].smallest_step_s < attempts.made[0].scene.time_step_s
    assert result.refinements
    assert result.estimate is not None and result.estimate.largest_mm is not None


def own_processes() -> set[str]:
    tasks = Path("/proc/self/task").iterdir()
    return {pid for task in tasks for pid in (task / "children").read_text().split()}


def test_an_interrupted_attempt_leaves_no_companion(make_scene: MakeScene, box: Box) -> None:
    before, during = own_processes(), set()

    def interrupted(_scene: Scene) -> Attempt:
        during.update(own_processes())
        raise Interrupted

    with pytest.raises(Interrupted):
        run_to_tolerance(make_scene(box("a")), interrupted)
    (companion,) = during - before
    assert not Path("/proc", companion).exists()


# Of a companion's scenes the first counts that stayed at its own step from a settled load to its end.


def fields(make_scene: MakeScene, box: Box, tension: float, rate_hz: int) -> Scene:
    """At a tension of 400 the fields' spring is too stiff for 1/480 s, and at 1e7 for any step."""
    return make_scene(
        box("a"), force_fields={"tension": tension}, sled=sled_at(0.8),
        solver={"time_step_s": 1.0 / rate_hz},
    )  # fmt: skip


def test_a_companion_that_halved_its_step_gives_way_to_one_that_did_not(
    make_scene: MakeScene, box: Box
) -> None:
    halves, stays, never = (fields(make_scene, box, 400.0, rate) for rate in (480, 960, 1920))
    answer = BackgroundTest([halves, stays, never]).answer()
    assert answer.problem is None and answer.step_s == answer.smallest_step_s == stays.time_step_s
    assert answer.worst_mm == worst_by_rule(judgement(stays, run_test(stays).judge))


def test_where_every_companion_halved_its_step_the_first_to_end_counts(
    make_scene: MakeScene, box: Box
) -> None:
    ended, first, second = (
        fields(make_scene, box, tension, rate) for tension, rate in ((1.0e7, 480), (400.0, 480), (400.0, 240))
    )
    answer = BackgroundTest([ended, first, second]).answer()
    assert answer.problem is None
    assert answer.step_s == first.time_step_s > answer.smallest_step_s
    alone = BackgroundTest([ended]).answer()
    assert alone.problem is not None and "ended by monitor 'stiffness'" in alone.problem
    assert BackgroundTest([]).answer().problem == "no other step fits its samples"


def test_a_coarse_step_has_a_companion_too() -> None:
    # Twice 1/60 s is more than a scene may ask for; the companion at half the step would do.
    coarse = shipped("block_slip", f"solver.time_step_s={1.0 / 60.0}", "sampling.poses_hz=60")
    estimate = refined(coarse)[0].estimate
    assert estimate is not None and estimate.problem is None


@pytest.mark.parametrize(
    ("friction", "companion_mm", "verdict"),
    # The limit is 62.5 mm; at friction 0.3 the block slides 467 mm, at 0.45 it slides 75 mm.
    [
        (0.3, 94.0, "fail"),
        (0.3, 93.0, "unresolved"),
        (0.3, None, "unresolved"),
        (0.45, 94.0, "unresolved"),
    ],
)
def test_without_an_estimate_only_a_plain_failure_of_both_is_one(
    friction: float, companion_mm: float | None, verdict: str
) -> None:
    scene = shipped(
        "block_slip", f"surfaces.pairs.0.friction={friction}", "limits.elastic_fraction=0.25",
        "limits.permanent_fraction=1",
    )  # fmt: skip
    result = run_test(scene)
    judged = judgement(scene, result.judge)
    assert worst_by_rule(judged)["elastic"] > 62.5
    told = {"elastic": companion_mm} if companion_mm is not None else {}
    estimate = ErrorEstimate(1.0 / 240.0, {}, None, "it fell", told)
    report = full_report(
        judged, scene, physics=result.physics, findings=[], estimate=estimate, wall_s=1.0, mode="run"
    )
    assert report["verdict"] == verdict
