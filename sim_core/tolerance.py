"""A tolerance instead of a time step: the test is repeated at half its step until the error estimate keeps it."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

from config.errors import RefusedInput
from config.scene import Scene
from sim_core.companion import Answer, Companion, ErrorEstimate, compared
from sim_core.report import Report, error_that_matters, worst_by_rule
from sim_core.work_precision import with_setting

MAXIMUM_REFINEMENTS = 3
SHRINKS = 0.8
"""A half step that leaves more than this share of the estimate is not worth another one."""


class Attempted(Protocol):
    """What one attempt must tell."""

    @property
    def judged(self) -> Report:
        """The judgement."""

    @property
    def smallest_step_s(self) -> float:
        """The step that the monitors left it with [s]."""

    @property
    def is_complete(self) -> bool:
        """Whether it ran to its end."""


T = TypeVar("T", bound=Attempted)


@dataclass(frozen=True)
class Refined(Generic[T]):
    """The last attempt, with its scene and its error estimate.

    Attributes:
        scene: the scene with the setting that ran.
        result: the attempt's result.
        estimate: its error estimate, or None when none was asked for.
        why: why it began with the setting that it did.
        refinements: the coarser attempts before it and their estimates, in words.
    """

    scene: Scene
    result: T
    estimate: ErrorEstimate | None
    why: str
    refinements: tuple[str, ...]


def require_estimate(scene: Scene, with_estimate: bool) -> None:
    """Refuses a tolerance that nothing will be compared with.

    Raises:
        RefusedInput: a tolerance is to be kept without an estimate.
    """
    if scene.solver.tolerance_mm is not None and not with_estimate:
        raise RefusedInput(
            "solver.tolerance_mm", scene.solver.tolerance_mm, "cannot be kept with --no-estimate"
        )


def run_to_tolerance(
    asked: Scene, attempt: Callable[[Scene], T], *, with_estimate: bool = True
) -> Refined[T]:
    """Runs attempts, each at half the step of the one before, until one keeps the scene's tolerance.

    The first has a companion beside it; a later one is compared with the attempt before. It ends without the
    tolerance after three refinements, or when the estimate no longer shrinks.

    Args:
        asked: a resolved scene.
        attempt: runs one test.
        with_estimate: False for one attempt without an estimate.

    Raises:
        RefusedInput: a tolerance is to be kept without an estimate.
    """
    tolerance_mm = asked.solver.tolerance_mm
    require_estimate(asked, with_estimate)
    is_free = tolerance_mm is not None and asked.solver.time_step_s is None
    scene, why = with_setting(asked)
    if not with_estimate or not scene.packages:
        return Refined(scene, attempt(scene), None, why, ())
    result, estimate = _with_companion(scene, attempt)
    refinements: list[str] = []
    while is_free and tolerance_mm is not None and result.is_complete:
        error_mm = error_that_matters(result.judged["rules"], estimate)
        if error_mm is None or error_mm <= tolerance_mm or len(refinements) == MAXIMUM_REFINEMENTS:
            break
        finer = _at_half_step(scene, result.smallest_step_s)
        if finer is None:
            break
        refinements.append(f"1/{1.0 / result.smallest_step_s:.0f} s: {error_mm:.2g} mm")
        coarse = _answer(scene, result)
        scene, result = finer, attempt(finer)
        estimate = compared(coarse, scene, worst_by_rule(result.judged), result.smallest_step_s)
        left_mm = error_that_matters(result.judged["rules"], estimate)
        if left_mm is not None and left_mm > SHRINKS * error_mm:
            break
    return Refined(scene, result, estimate, why, tuple(refinements))


def _with_companion(scene: Scene, attempt: Callable[[Scene], T]) -> tuple[T, ErrorEstimate]:
    companion = Companion(scene)
    try:
        result = attempt(scene)
        return result, companion.estimate(worst_by_rule(result.judged), result.smallest_step_s)
    except BaseException:
        companion.cancel()
        raise


def _at_half_step(scene: Scene, step_s: float) -> Scene | None:
    """The scene at half of a step [s], or None where that doesn't fit its samples."""
    solver = scene.solver.model_copy(update={"time_step_s": step_s / 2.0, "iterations": scene.iterations})
    finer = scene.model_copy(update={"solver": solver})
    try:
        finer.steps_and_samples()
    except ValueError:
        return None
    return finer


def _answer(scene: Scene, result: Attempted) -> Answer:
    states = {rule["rule"]: rule["state"] for rule in result.judged["rules"]}
    return Answer(worst_by_rule(result.judged), states, scene.time_step_s, None, result.smallest_step_s)
