"""The error estimate: the same test at another step, in a process of its own, beside the real one.

The companion takes twice the step; half of it, and the difference doubled, where twice does not fit the
frames or does not let the load settle. With an error of first order or better, that is the error or more. Below a few
hundredths of a millimetre that no longer holds: sticking and slipping begin and end on the grid of the steps,
which makes an error that jumps from step to step; so the estimate has a floor.
Companions run as ``python -m sim_core.companion`` with the scenes to try on standard input.
"""

import json
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field

from config.errors import EndedByMonitor, PalletTwinError
from config.scene import Scene
from config.scene_file import scene_from_json
from sim_core.judge import EumosJudge
from sim_core.load_test import LoadTest
from sim_core.sled import sled_samples

FLOOR_MM = 0.05
"""Twice the largest error that the closed-form cases show where the difference is smaller than it."""


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


def companion_scenes(scene: Scene) -> list[Scene]:
    """The scene at twice its step, where that fits between the frames, and at half of it."""
    candidates = []
    for factor in (2.0, 0.5):
        solver = scene.solver.model_copy(
            update={"time_step_s": factor * scene.time_step_s, "iterations": scene.iterations}
        )
        candidate = scene.model_copy(update={"solver": solver})
        try:
            candidate.steps_and_samples()
        except ValueError:
            continue
        candidates.append(candidate)
    return candidates


class Companion:
    """A companion run in the background.

    Args:
        scene: the resolved scene of the real run.
    """

    def __init__(self, scene: Scene) -> None:
        self._step_s = scene.time_step_s
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-m", "sim_core.companion"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
            # Ctrl-C is for the run in front; it stops its companion itself.
            start_new_session=True,
        )
        assert self._process.stdin is not None
        self._process.stdin.write("\n".join(found.to_json() for found in companion_scenes(scene)))
        self._process.stdin.close()

    def estimate(self, worst_mm: Mapping[str, float]) -> ErrorEstimate:
        """Waits for the companion and compares it with the real run.

        Args:
            worst_mm: the real run's worst displacement by rule [mm].
        """
        assert self._process.stdout is not None
        with self._process.stdout as stream:
            answer = stream.read()
        self._process.wait()
        try:
            companion = json.loads(answer)
        except json.JSONDecodeError:
            problem = f"the companion run ended with code {self._process.returncode}"
            companion = {"worst_mm": {}, "step_s": 2.0 * self._step_s, "problem": problem}
        step_s: float = companion["step_s"]
        companions: dict[str, float] = companion["worst_mm"]
        if companion["problem"] is not None:
            return ErrorEstimate(step_s, {}, None, companion["problem"], companions)
        # Half the step has half the error or less: it differs by half of the error or more.
        factor = 1.0 if step_s > self._step_s else 2.0
        differences = {
            rule: max(factor * abs(worst - companions[rule]), FLOOR_MM)
            for rule, worst in worst_mm.items()
            if rule in companions
        }
        return ErrorEstimate(step_s, differences, max(differences.values(), default=0.0))

    def cancel(self) -> None:
        """Ends the companion without waiting for its answer."""
        assert self._process.stdout is not None
        self._process.stdout.close()
        self._process.kill()
        self._process.wait()


def _answer(scene: Scene) -> tuple[dict[str, object], bool]:
    """What the companion has to say, and whether its load settled."""
    test, judge = LoadTest(scene), EumosJudge(scene)
    problem = None
    try:
        for sample in sled_samples(scene):
            frame = test.take(sample)
            if frame is not None:
                judge.add(frame)
            if test.finished:
                break
    except EndedByMonitor as error:
        problem = f"at a step of {1000.0 * scene.time_step_s:.3g} ms: {error}"
    finally:
        test.close()
    rules = judge.rules() if judge.frame_count else []
    worst = {rule.rule: rule.worst_mm for rule in rules if rule.worst_mm is not None}
    return {"worst_mm": worst, "step_s": scene.time_step_s, "problem": problem}, judge.frame_count > 0


def main() -> None:
    """Reads resolved scenes, a line each, and prints the answer of the first whose load settles, as JSON."""
    answer: dict[str, object] = {}
    for line in sys.stdin.read().splitlines():
        scene = scene_from_json(line)
        try:
            answer, is_settled = _answer(scene)
        except PalletTwinError as error:
            answer, is_settled = {"worst_mm": {}, "step_s": scene.time_step_s, "problem": str(error)}, True
        if is_settled:
            break
    print(json.dumps(answer))


if __name__ == "__main__":
    main()
