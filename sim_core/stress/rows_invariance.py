"""What must not matter: left or right, the sled's direction, the order of the list, where a run begins again."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from config.scene import Scene
from sim_core.frames import Array
from sim_core.load_test import LoadTest
from sim_core.sled import sled_samples
from sim_core.stress.loads import CARTON, Raw, box, scene_of, trapezoid
from sim_core.stress.model import Judgement, StressRow, Trial, within

TOLERANCE_M = 1.0e-3
FRICTIONS = {("cardboard", "sled"): 0.25, ("cardboard", "cardboard"): 0.3}


def _uneven() -> list[Raw]:
    """Two stacks of unlike boxes without a symmetry; all slide at 0.4 g."""
    return [
        box("a", CARTON, 10.0, x=-0.3, y=0.05),
        box("b", (0.5, 0.4, 0.2), 14.0, x=0.3, y=-0.1),
        box("c", (0.35, 0.3, 0.2), 6.0, x=-0.3, y=0.08, base_m=0.25),
        box("d", (0.3, 0.3, 0.15), 3.0, x=0.28, y=-0.05, base_m=0.2),
    ]


def _uneven_scene(engine: str, boxes: list[Raw], **sled: Any) -> Scene:
    return scene_of("uneven", boxes, trapezoid(0.4, **sled), engine=engine, pairs=FRICTIONS)


def _mirrored(engine: str) -> list[Scene]:
    there = _uneven()
    flipped = [
        {**b, "position_m": [b["position_m"][0], -b["position_m"][1], b["position_m"][2]]} for b in there
    ]
    return [_uneven_scene(engine, there), _uneven_scene(engine, flipped)]


def _turned(engine: str) -> list[Scene]:
    there = _uneven()
    turned = []
    for package in there:
        x, y, z = package["position_m"]
        length, width, height = package["size_m"]
        turned.append({**package, "position_m": [-y, x, z], "size_m": [width, length, height]})
    return [_uneven_scene(engine, there), _uneven_scene(engine, turned, direction="+y")]


def _same_after(back: Array) -> Any:
    """The second trial, taken back by a linear map, moves as the first does."""

    def judge(trials: Sequence[Trial]) -> Judgement:
        first, second = (trial.moves() for trial in trials)
        n = min(len(first), len(second))
        difference = float(np.abs(first[:n] - second[:n] @ back.T).max())
        moved = 1e3 * float(np.abs(first).max())
        return within(difference, TOLERANCE_M, f"boxes move by up to {moved:.1f} mm; largest difference")

    return judge


def _reordered(engine: str) -> list[Scene]:
    return [_uneven_scene(engine, _uneven()), _uneven_scene(engine, _uneven()[::-1])]


def _repeated(engine: str) -> list[Scene]:
    return [_uneven_scene(engine, _uneven())] * 2


def _same_bits(trials: Sequence[Trial]) -> Judgement:
    first, second = trials
    rows = [second.row(package.id) for package in first.scene.packages]
    same = len(first.frames) == len(second.frames) and all(
        np.array_equal(a.positions[1:], b.positions[rows])
        and np.array_equal(a.orientations[1:], b.orientations[rows])
        for a, b in zip(first.frames, second.frames, strict=True)
    )
    return Judgement(same, f"{len(first.frames)} frames, {'every bit the same' if same else 'not the same'}")


def _goes_on_from_snapshot(trials: Sequence[Trial]) -> Judgement:
    """The engine, taken back to a kept state, does the same again to the last bit."""
    test, samples = LoadTest(trials[0].scene), sled_samples(trials[0].scene)
    try:
        for _ in range(121):
            test.take(next(samples))
        handle = test.engine.snapshot()
        runs = []
        for _ in range(2):
            test.engine.restore(handle)
            for _ in range(100):
                test.engine.step(np.array([0.01, 0.0, 0.0]), None)
            runs.append([array.copy() for array in (*test.engine.poses(), *test.engine.velocities())])
    finally:
        test.close()
    same = all(np.array_equal(a, b) for a, b in zip(*runs, strict=True))
    return Judgement(same, f"100 steps again: {'every bit the same' if same else 'not the same'}")


INVARIANCE_ROWS: tuple[StressRow, ...] = (
    StressRow(
        "mirror", "Invariance", "four unlike boxes and their mirror image in y, 0.4 g",
        "mirrored motion, to 1 mm", _mirrored, _same_after(np.diag([1.0, -1.0, 1.0])), quick=True,
    ),
    StressRow(
        "turn_90", "Invariance", "the same load and sled, turned by 90°", "turned motion, to 1 mm",
        _turned, _same_after(np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])), quick=True,
    ),
    StressRow(
        "reorder", "Invariance", "the same packages listed in reverse", "the same motion to the last bit",
        _reordered, _same_bits, may=("right",), quick=True,
    ),
    StressRow(
        "repeat", "Invariance", "the same scene twice in one process", "the same motion to the last bit",
        _repeated, _same_bits, may=("right",), quick=True,
    ),
    StressRow(
        "restart", "Invariance", "an engine taken back to a snapshot", "the same motion to the last bit",
        lambda engine: [_uneven_scene(engine, _uneven())], _goes_on_from_snapshot, may=("right",), quick=True,
    ),
)  # fmt: skip
"""The rows of this file."""
