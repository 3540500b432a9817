"""Levels of a rating: which are tried in which order, one test at one of them, and its result on disk."""

import hashlib
import json
import time
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from config.errors import RefusedInput
from config.scene import EumosSled, Scene, Solver
from sim_core.companion import Answer, ErrorEstimate, answer_here, companion_scenes, compared
from sim_core.report import Report, error_that_matters, full_report, judgement, versions, worst_by_rule
from sim_core.report_words import verdict_sentence
from sim_core.run import TestResult, run_test
from sim_core.tolerance import MAXIMUM_REFINEMENTS, SHRINKS
from sim_core.work_precision import with_setting

FORMAT = 1
"""Version of the results on disk; raise it when their fields or their meaning change."""
FIRST_G, COARSE_G, HIGHEST_G = 0.2, 0.1, 2.0
"""Laboratories start at 0.2 g and climb by 0.1 g; the sled of a scene reaches 2 g."""
CERTIFIED_G = 0.5
"""Certificates start here (nbn.be)."""
KEPT = ("name", "verdict", "rules", "height_m", "moments", "load", "scene_sha256", "numerics", "wrap", "integrity",
        "versions")  # fmt: skip
"""What is kept of a level's report: series and film maps are for ``pallet-twin run`` at that level."""


@dataclass(frozen=True)
class LevelPlan:
    """The levels of a climb, in units of its finest step.

    Attributes:
        to_g: the highest level [g].
        step_g: how fine the largest passing level is wanted: below 0.1 g the gap between the last level that passed
            and the first that did not is halved, on this grid [g].
        is_whole: all 0.1 g levels are tried, also above one that did not pass.
    """

    to_g: float = 0.8
    step_g: float = COARSE_G
    is_whole: bool = False

    def __post_init__(self) -> None:
        """Refuses levels off the grid.

        Raises:
            RefusedInput: the step is no whole fraction of 0.1 g, or the highest level off its grid or out of bounds.
        """
        parts = COARSE_G / self.step_g if self.step_g > 0.0 else 0.0
        if not 1.0 - 1.0e-9 <= parts <= 100.0 + 1.0e-6 or abs(parts - round(parts)) > 1.0e-6:
            limit = "must be 0.1 or a whole fraction of it, such as 0.05 or 0.025, and at least 0.001"
            raise RefusedInput("--step", self.step_g, limit)
        if not FIRST_G - 1.0e-9 <= self.to_g <= HIGHEST_G + 1.0e-9:
            raise RefusedInput("--to", self.to_g, f"must be {FIRST_G:g} to {HIGHEST_G:g} g")
        steps = self.to_g / self.step_g
        if abs(steps - round(steps)) > 1.0e-6:
            raise RefusedInput("--to", self.to_g, f"must be a multiple of the step, {self.step_g:g} g")

    @property
    def coarse(self) -> tuple[int, ...]:
        """0.2 g, 0.3 g and so on up to the highest level, in steps."""
        tenth, last = round(COARSE_G / self.step_g), round(self.to_g / self.step_g)
        levels = list(range(round(FIRST_G / self.step_g), last + 1, tenth))
        return tuple(levels if levels[-1] == last else [*levels, last])

    def level_g(self, number: int) -> float:
        """A level [g] from its number of steps."""
        return round(number * self.step_g, 6)

    def walk(self, verdicts: Mapping[int, str]) -> tuple[list[int], list[int]]:
        """The levels that count, as the climb met them, and those that it still needs, the most needed first.

        A standard's climb needs one level at a time: the others in the second list are worth trying only where a
        processor has nothing better to do.

        Args:
            verdicts: of the levels that have been run.
        """
        coarse = self.coarse
        above = next((k for k, level in enumerate(coarse) if verdicts.get(level) != "pass"), len(coarse))
        met = [level for level in (coarse if self.is_whole else coarse[: above + 1]) if level in verdicts]
        if self.is_whole and len(met) < len(coarse):
            return met, [level for level in coarse if level not in verdicts]
        if above == len(coarse):
            return met, []
        if coarse[above] not in verdicts:
            known_end = next(
                (k for k in range(above, len(coarse)) if verdicts.get(coarse[k], "pass") != "pass"),
                len(coarse),
            )
            return met, [level for level in coarse[above:known_end] if level not in verdicts]
        low, high = (coarse[above - 1], coarse[above]) if above else (0, 0)
        while high - low > 1:
            middle = (low + high) // 2
            if middle not in verdicts:
                return met, [middle]
            met.append(middle)
            low, high = (middle, high) if verdicts[middle] == "pass" else (low, middle)
        return met, []

    def largest(self, verdicts: Mapping[int, str]) -> int | None:
        """The largest level that passed with no other verdict met below it, or None."""
        largest = None
        for level in sorted(self.walk(verdicts)[0]):
            if verdicts[level] != "pass":
                break
            largest = level
        return largest


def at_level(scene: Scene, level_g: float) -> Scene:
    """The scene at a level [g].

    Raises:
        RefusedInput: its sled does not follow the EUMOS profile.
    """
    if not isinstance(scene.sled, EumosSled):
        raise RefusedInput("sled.profile", scene.sled.profile, "must be eumos: its level is what is stepped")
    return scene.model_copy(update={"sled": scene.sled.model_copy(update={"level_g": level_g})})


def rated_level(scene: Scene) -> Report:
    """One test at its level with its error estimate, once more at half the step where that leaves it unresolved.

    Everything runs in this process, one test after the other. A step that the scene names is kept.

    Args:
        scene: a resolved scene.

    Returns:
        The parts of a full report that are named in ``KEPT``, ``why`` its verdict is what it is in a sentence, and
        ``wall_s``, the wall time of all its tests [s].

    Raises:
        RefusedInput: the load fails its integrity check.
    """
    began = time.perf_counter()
    setting, why = with_setting(scene)
    result, judged = _tried(setting)
    estimate: ErrorEstimate | None = None
    if setting.packages and result.ended_by is None:
        answer = answer_here(companion_scenes(setting))
        estimate = compared(answer, setting, worst_by_rule(judged), result.physics.smallest_step_s)
    told: list[str] = []
    is_shrinking = True
    while True:
        report = full_report(
            judged, setting, physics=result.physics, findings=result.findings, estimate=estimate,
            wall_s=result.wall_s, mode="rate", why=why, refinements=told,
        )  # fmt: skip
        step_s = result.physics.smallest_step_s
        is_worth_it = is_shrinking and _wants_finer(scene, report, estimate, len(told))
        finer = _half_step(setting, step_s) if is_worth_it else None
        if finer is None:
            break
        error_mm = error_that_matters(judged["rules"], estimate)
        told.append(
            f"1/{1.0 / step_s:.0f} s: " + ("no estimate" if error_mm is None else f"{error_mm:.2g} mm")
        )
        states = {rule["rule"]: rule["state"] for rule in judged["rules"]}
        answer = Answer(worst_by_rule(judged), states, setting.time_step_s, None, step_s)
        setting = finer
        result, judged = _tried(setting)
        estimate = compared(answer, setting, worst_by_rule(judged), result.physics.smallest_step_s)
        left_mm = error_that_matters(judged["rules"], estimate)
        is_shrinking = error_mm is None or left_mm is None or left_mm <= SHRINKS * error_mm
    kept = {name: report[name] for name in KEPT if name in report}
    return {**kept, "why": verdict_sentence(report, setting), "wall_s": time.perf_counter() - began}


def _tried(scene: Scene) -> tuple[TestResult, Report]:
    result = run_test(scene)
    return result, judgement(scene, result.judge, is_complete=result.ended_by is None)


def _wants_finer(asked: Scene, report: Report, estimate: ErrorEstimate | None, refinements: int) -> bool:
    """Whether half the step is worth a try: once for a verdict, as often as the tolerance may ask for the tolerance."""
    if estimate is None or report["numerics"]["ended_by"] is not None or asked.solver.time_step_s is not None:
        return False
    if report["numerics"]["within_tolerance"] is False and refinements < MAXIMUM_REFINEMENTS:
        return True
    return report["verdict"] == "unresolved" and refinements == 0


def _half_step(scene: Scene, step_s: float) -> Scene | None:
    """The scene at half of a step [s], or None where a scene cannot have that."""
    try:
        solver = Solver.model_validate(
            {**scene.solver.model_dump(), "time_step_s": step_s / 2.0, "iterations": scene.iterations}
        )
        finer = scene.model_copy(update={"solver": solver})
        finer.steps_and_samples()
    except ValueError:
        return None
    return finer


def level_key(scene: Scene) -> str:
    """Digest of all that a level's result depends on: the scene as asked for and as set, and the versions.

    Raises:
        RefusedInput: the scene cannot be tested.
    """
    made_with = dict(versions())
    for name in ("mujoco", "numba"):
        try:
            made_with[name] = version(name)
        except PackageNotFoundError:
            made_with[name] = "not installed"
    parts = [FORMAT, scene.to_json(), with_setting(scene)[0].to_json(), made_with]
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()


def level_path(folder: Path, scene: Scene) -> Path:
    """Where the result of a scene at its level is kept."""
    assert isinstance(scene.sled, EumosSled)
    return folder / f"{scene.name}_{scene.sled.level_g:g}g_{level_key(scene)[:20]}.json"


def stored_level(path: Path) -> Report | None:
    """A result on disk; None where there is none that can be read."""
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    is_whole = isinstance(found, dict) and {"verdict", "rules", "numerics", "why", "wall_s"} <= found.keys()
    return found if is_whole else None


def refused_fields(error: RefusedInput) -> dict[str, Any]:
    """A refusal as it can be sent to another process."""
    return {"field": error.field, "value": str(error.value), "limit": error.limit}
