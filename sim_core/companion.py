"""Second opinions: the same test at a coarser setting or on another engine, in a process of its own.

The companion takes twice the step and half the iterations, an eighth of the work of a step each way; its error is that
of the test times two to four, or more, so the difference is the test's error or more. Where that does not let the
load settle it keeps the iterations, and at last takes half the step and 2.5 times the difference: in the work-precision
table half the step alone leaves 0.42 to 0.59 of the error.

Sticking and slipping begin and end on the grid of the steps, so an error can jump from step to step and the
difference be small by chance. Hence the floor: g·h², what gravity moves in a step, for no event is timed better, and
never less than what blows may leave; where film holds the load, a share of the displacement, for mesh and chance.
``docs/accuracy.md`` says how often the true error lies inside.

Companions run as ``python -m sim_core.companion`` with the scenes to try on standard input.
"""

import json
import math
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

from config.errors import EndedByMonitor, PalletTwinError
from config.scene import Scene, Solver
from config.scene_file import scene_from_json
from config.wrap import DEFAULT_SPACING_M
from sim_core.frames import GRAVITY
from sim_core.judge import EumosJudge
from sim_core.load_test import LoadTest

LEAST_MM = 0.05
"""What a blow may leave, see ``sim_core/impacts.py``."""
FINER_FACTOR = 2.5
"""Half the step leaves up to 0.59 of the error, so it differs by 0.4 of it or more."""
HELD_SHARES = {"mujoco": 0.075, "bullet": 0.1}
"""Least error of a load that a film holds, as a share of its displacement, at the default mesh: run and companion have
the same mesh, and packages pressed together stick by chance. ``docs/accuracy.md`` has the scatter behind it."""


@dataclass(frozen=True)
class ErrorEstimate:
    """How far the companion's answer lies from the real one's.

    Attributes:
        companion_step_s: the companion's time step [s].
        by_rule_mm: difference of each rule's worst displacement [mm], by rule name.
        largest_mm: the largest of them [mm].
        problem: why there is no estimate, or None.
        worst_until_problem_mm: the companion's worst displacement by rule until then [mm].
    """

    companion_step_s: float
    by_rule_mm: dict[str, float]
    largest_mm: float | None
    problem: str | None = None
    worst_until_problem_mm: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Answer:
    """What a test in the background came to.

    Attributes:
        worst_mm: worst displacement by rule [mm].
        states: state by rule.
        step_s: its time step [s].
        problem: what ended it early, or None.
        smallest_step_s: the step that its monitors left it with [s].
    """

    worst_mm: dict[str, float]
    states: dict[str, str]
    step_s: float
    problem: str | None
    smallest_step_s: float = 0.0


def floor_mm(step_s: float) -> float:
    """The least error that a test at this step [s] is credited with [mm]: g·h², or what a blow leaves."""
    return max(1000.0 * GRAVITY * step_s**2, LEAST_MM)


def held_share(scene: Scene) -> float:
    """The least error of a displacement as a share of it, where film holds the load; the mesh's falls with its root."""
    if not scene.is_held_by_film or not scene.packages:
        return 0.0
    engine = scene.solver.engine if scene.solver.engine != "auto" else "bullet"
    return HELD_SHARES[engine] * min(1.0, math.sqrt(scene.film_spacing_m / DEFAULT_SPACING_M))


def companion_scenes(scene: Scene) -> list[Scene]:
    """The scene at twice its step with half its iterations, with all of them, and at half its step.

    Pose frames become as many fewer as the step needs; nobody but the judge sees them.
    """
    candidates = []
    if scene.wrap is not None and scene.wrap.coupling == "one_way":
        # Film that only follows changes no displacement.
        scene = scene.model_copy(update={"wrap": None})
    for factor, share in ((2.0, 0.5), (2.0, 1.0), (0.5, 1.0)):
        step_s = factor * scene.time_step_s
        iterations = max(1, round(share * scene.iterations))
        try:
            solver = Solver(engine=scene.solver.engine, time_step_s=step_s, iterations=iterations)
        except ValueError:
            # Out of the bounds of what a scene may ask for.
            continue
        for poses_hz in (scene.sampling.poses_hz, scene.sampling.poses_hz // 2):
            sampling = scene.sampling.model_copy(update={"poses_hz": max(1, poses_hz)})
            candidate = scene.model_copy(update={"solver": solver, "sampling": sampling})
            try:
                candidate.steps_and_samples()
            except ValueError:
                continue
            candidates.append(candidate)
            break
    return candidates


def compared(
    answer: Answer, scene: Scene, worst_mm: Mapping[str, float], smallest_step_s: float
) -> ErrorEstimate:
    """The error estimate of a test from what its companion came to.

    Args:
        answer: the companion's answer.
        scene: the test's scene.
        worst_mm: the test's worst displacement by rule [mm].
        smallest_step_s: the step that the test's monitors left it with [s].
    """
    problem = answer.problem
    if problem is None and 0.75 < answer.smallest_step_s / smallest_step_s < 1.5:
        problem = (
            f"both runs had to halve their steps to {1000.0 * smallest_step_s:.3g} ms, so they tell nothing"
        )
    if problem is not None:
        return ErrorEstimate(answer.step_s, {}, None, problem, answer.worst_mm)
    step_s, share = scene.time_step_s, held_share(scene)
    factor = 1.0 if answer.step_s > step_s else FINER_FACTOR
    differences = {
        rule: max(factor * abs(worst - answer.worst_mm[rule]), floor_mm(step_s), share * worst)
        for rule, worst in worst_mm.items()
        if rule in answer.worst_mm
    }
    return ErrorEstimate(answer.step_s, differences, max(differences.values(), default=0.0))


def answer_here(scenes: Sequence[Scene], *, is_coarse: bool = True, enough_mm: float | None = None) -> Answer:
    """What ``BackgroundTest(scenes)`` answers, worked out in this process: for one that already has its core's worth.

    Args:
        scenes: resolved scenes to try in turn; the first that needs no halved step is the answer.
        is_coarse: they are meant to be coarse: what the solver leaves unsolved halves no step.
        enough_mm: a peak that settles the test: the run ends when it is reached, with that as its problem [mm].
    """
    return _first_sound([scene.to_json() for scene in scenes], is_coarse, enough_mm)


class BackgroundTest:
    """One test in a process of its own, without recording.

    Args:
        scenes: resolved scenes to try in turn; the first that needs no halved step is the answer.
        is_coarse: they are meant to be coarse: what the solver leaves unsolved halves no step.
    """

    def __init__(self, scenes: Sequence[Scene], *, is_coarse: bool = True) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-m", "sim_core.companion", *(["--coarse"] if is_coarse else [])],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
            # Ctrl-C is for the run in front; it stops its companions itself.
            start_new_session=True,
        )
        assert self._process.stdin is not None
        self._process.stdin.write("\n".join(scene.to_json() for scene in scenes))
        self._process.stdin.close()

    def answer(self) -> Answer:
        """Waits for the test's end."""
        assert self._process.stdout is not None
        with self._process.stdout as stream:
            text = stream.read()
        self._process.wait()
        try:
            return Answer(**json.loads(text))
        except (json.JSONDecodeError, TypeError):
            return Answer({}, {}, 0.0, f"the run beside this one ended with code {self._process.returncode}")

    def cancel(self) -> None:
        """Ends the test without waiting for its answer."""
        assert self._process.stdout is not None
        self._process.stdout.close()
        self._process.kill()
        self._process.wait()


class Companion(BackgroundTest):
    """A companion run for the error estimate.

    Args:
        scene: the resolved scene of the real run.
    """

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        super().__init__(companion_scenes(scene))

    def estimate(self, worst_mm: Mapping[str, float], smallest_step_s: float) -> ErrorEstimate:
        """Waits for the companion and compares it with the real run.

        Args:
            worst_mm: the real run's worst displacement by rule [mm].
            smallest_step_s: the step that the real run's monitors left it with [s].
        """
        return compared(self.answer(), self._scene, worst_mm, smallest_step_s)


class CrossCheck(BackgroundTest):
    """The same test on the other engine, at its default setting.

    Args:
        scene: the resolved scene of the real run.
    """

    def __init__(self, scene: Scene) -> None:
        self._engine: Literal["bullet", "mujoco"] = "mujoco" if scene.solver.engine == "bullet" else "bullet"
        other = scene.model_copy(update={"solver": Solver(engine=self._engine)})
        try:
            other.steps_and_samples()
        except ValueError:
            # The default step doesn't fit the samples: the scene's own does.
            solver = Solver(engine=self._engine, time_step_s=scene.time_step_s)
            other = scene.model_copy(update={"solver": solver})
        super().__init__([other], is_coarse=False)

    def compare(self, rules: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
        """Waits for the other engine and says rule by rule whether the two agree.

        Args:
            rules: the real run's rule entries, as in a report.
        """
        answer = self.answer()
        compared = [
            {
                "rule": rule["rule"],
                "state": answer.states.get(rule["rule"]),
                "worst_mm": answer.worst_mm.get(rule["rule"]),
                "agrees": answer.states.get(rule["rule"]) == rule["state"],
            }
            for rule in rules
        ]
        return {
            "engine": self._engine,
            "time_step_s": answer.step_s,
            "problem": answer.problem,
            "agrees": answer.problem is None and all(entry["agrees"] for entry in compared),
            "rules": compared,
        }


def _answer(scene: Scene, is_coarse: bool, enough_mm: float | None, *, only_sound: bool) -> Answer | None:
    """What a test comes to; with ``only_sound`` None as soon as it leaves its own step, or has a problem."""
    # The residual's monitor would halve a coarse test to the step of the one that it is compared with.
    test, judge = LoadTest(scene, with_residual_monitor=not is_coarse), EumosJudge(scene)
    problem = None
    try:
        for frame in test.frames():
            judge.add(frame)
            if enough_mm is not None and judge.peak_mm > enough_mm:
                problem = (
                    f"ended when its peak, too, was beyond {enough_mm:.0f} mm: the rule is broken by far"
                )
                break
            # Where only a plain failure is looked for, it is one at any step.
            if only_sound and test.halvings and enough_mm is None:
                return None
    except EndedByMonitor as error:
        if only_sound:
            return None
        problem = f"at a step of {1000.0 * scene.time_step_s:.3g} ms: {error}"
    finally:
        test.close()
    if only_sound and problem is None and test.halvings:
        return None
    rules = judge.rules() if judge.frame_count else []
    worst = {rule.rule: rule.worst_mm for rule in rules if rule.worst_mm is not None}
    states: dict[str, str] = {rule.rule: rule.state for rule in rules}
    return Answer(worst, states, scene.time_step_s, problem, test.smallest_step_s)


def _first_sound(lines: Sequence[str], is_coarse: bool, enough_mm: float | None = None) -> Answer:
    """The answer of the first scene that needs no halved step; else of the first with the most to say."""
    answers = []
    # Whole runs that are not sound are the last resort: a step that doesn't hold is given up when it shows.
    for only_sound in (True, False):
        for line in lines:
            step_s = 0.0
            try:
                scene = scene_from_json(line)
                step_s = scene.time_step_s
                answer = _answer(scene, is_coarse, enough_mm, only_sound=only_sound)
            except PalletTwinError as error:
                answer = None if only_sound else Answer({}, {}, step_s, str(error))
            if answer is not None and only_sound:
                return answer
            answers += [answer] if answer is not None else []
    answers.sort(key=lambda answer: (answer.problem is not None, not answer.worst_mm))
    return answers[0] if answers else Answer({}, {}, 0.0, "no other step fits its samples")


def main() -> None:
    """Reads resolved scenes, a line each, and prints an answer as JSON."""
    answer = _first_sound(sys.stdin.read().splitlines(), "--coarse" in sys.argv[1:])
    print(json.dumps(asdict(answer)))


if __name__ == "__main__":
    main()
