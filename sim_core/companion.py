"""The error estimate: the same test at another step, in a process of its own, beside the real one.

The companion takes twice the step (half of it where twice does not fit the frames). With an error of first
order or better, the difference of a quantity between steps 2h and h is the error at h or more. Below a few
hundredths of a millimetre that no longer holds: sticking and slipping begin and end on the grid of the steps,
which makes an error that jumps from step to step; so the estimate has a floor.
Companions run as ``python -m sim_core.companion`` with the scene on standard input.
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


def companion_scene(scene: Scene) -> Scene:
    """The scene at twice its step, or half of it where twice does not fit between the frames."""
    for factor in (2.0, 0.5):
        solver = scene.solver.model_copy(
            update={"time_step_s": factor * scene.time_step_s, "iterations": scene.iterations}
        )
        candidate = scene.model_copy(update={"solver": solver})
        try:
            candidate.steps_and_samples()
        except ValueError:
            continue
        return candidate
    raise AssertionError("half of a step that fits always fits")


class Companion:
    """A companion run in the background.

    Args:
        scene: the resolved scene of the real run.
    """

    def __init__(self, scene: Scene) -> None:
        self._scene = companion_scene(scene)
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
        self._process.stdin.write(self._scene.to_json())
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
        step_s = self._scene.time_step_s
        try:
            companion = json.loads(answer)
        except json.JSONDecodeError:
            companion = {
                "worst_mm": {},
                "problem": f"the companion run ended with code {self._process.returncode}",
            }
        companions: dict[str, float] = companion["worst_mm"]
        if companion["problem"] is not None:
            return ErrorEstimate(step_s, {}, None, companion["problem"], companions)
        differences = {
            rule: max(abs(worst - companions[rule]), FLOOR_MM)
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


def _answer(scene: Scene) -> dict[str, object]:
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
    return {"worst_mm": {r.rule: r.worst_mm for r in rules if r.worst_mm is not None}, "problem": problem}


def main() -> None:
    """Reads a resolved scene from standard input and prints the companion's answer as JSON."""
    try:
        answer = _answer(scene_from_json(sys.stdin.read()))
    except PalletTwinError as error:
        answer = {"worst_mm": {}, "problem": str(error)}
    print(json.dumps(answer))


if __name__ == "__main__":
    main()
