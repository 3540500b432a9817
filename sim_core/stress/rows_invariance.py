"""What must not matter: left or right, the sled's direction, the order of the list, where a run begins again."""

import math
from collections.abc import Sequence
from contextlib import chdir
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from config.scene import Scene
from sim_core.engines import make_engine
from sim_core.frames import Array
from sim_core.load_test import LoadTest
from sim_core.monitors import MAXIMUM_SPEED_MPS
from sim_core.sled import sled_samples
from sim_core.stress.film_cases import STRETCH
from sim_core.stress.loads import CARTON, Raw, box, scene_of, trapezoid
from sim_core.stress.model import Judgement, StressRow, Trial, within

TOLERANCE_M = 1.0e-3
GAP_M = 1.0e-3
HUGE_N = 1.0e15
FRICTIONS = {("cardboard", "sled"): 0.25, ("cardboard", "cardboard"): 0.3}


def uneven_boxes() -> list[Raw]:
    """Two stacks of unlike boxes without a symmetry, 150 mm apart; all slide at 0.4 g."""
    return [
        box("a", CARTON, 10.0, x=-0.3, y=0.05),
        box("b", (0.5, 0.4, 0.2), 14.0, x=0.3, y=-0.1),
        box("c", (0.35, 0.3, 0.2), 6.0, x=-0.3, y=0.08, base_m=0.25),
        box("d", (0.3, 0.3, 0.15), 3.0, x=0.28, y=-0.05, base_m=0.2),
    ]


def _pushed_together() -> list[Raw]:
    """The same boxes with 1 mm between the stacks: a film would draw them together."""
    return [
        {**b, "position_m": [math.copysign(0.5 * (b["size_m"][0] + GAP_M), x), y, z]}
        for b in uneven_boxes()
        for x, y, z in (b["position_m"],)
    ]


def mirrored(boxes: list[Raw]) -> list[Raw]:
    """The same boxes, mirrored in y."""
    return [{**b, "position_m": [b["position_m"][0], -b["position_m"][1], b["position_m"][2]]} for b in boxes]


def _boxes(wrap: Raw | None) -> list[Raw]:
    return uneven_boxes() if wrap is None else _pushed_together()


def _scene(engine: str, boxes: list[Raw], wrap: Raw | None, **sled: Any) -> Scene:
    parts: Raw = {} if wrap is None else {"wrap": wrap}
    return scene_of("uneven", boxes, trapezoid(0.4, **sled), engine=engine, pairs=FRICTIONS, **parts)


def _mirrored(engine: str, wrap: Raw | None = None) -> list[Scene]:
    return [_scene(engine, boxes, wrap) for boxes in (_boxes(wrap), mirrored(_boxes(wrap)))]


def _turned(engine: str, wrap: Raw | None = None) -> list[Scene]:
    there = _boxes(wrap)
    turned = []
    for package in there:
        x, y, z = package["position_m"]
        length, width, height = package["size_m"]
        turned.append({**package, "position_m": [-y, x, z], "size_m": [width, length, height]})
    return [_scene(engine, there, wrap), _scene(engine, turned, wrap, direction="+y")]


def _same_after(back: Array) -> Any:
    """The second trial, taken back by a linear map, moves as the first does."""

    def judge(trials: Sequence[Trial]) -> Judgement:
        first, second = (trial.moves() for trial in trials)
        n = min(len(first), len(second))
        difference = float(np.abs(first[:n] - second[:n] @ back.T).max())
        moved = 1e3 * float(np.abs(first).max())
        return within(difference, TOLERANCE_M, f"boxes move by up to {moved:.1f} mm; largest difference")

    return judge


def _reordered(engine: str, wrap: Raw | None = None) -> list[Scene]:
    return [_scene(engine, boxes, wrap) for boxes in (_boxes(wrap), _boxes(wrap)[::-1])]


def _repeated(engine: str, wrap: Raw | None = None) -> list[Scene]:
    return [_scene(engine, _boxes(wrap), wrap)] * 2


def same_bits(trials: Sequence[Trial]) -> Judgement:
    """Two trials of the same packages, in any order, move alike to the last bit."""
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


def _shows_that_it_broke(trials: Sequence[Trial]) -> Judgement:
    """A state that no monitor could let pass stays one: an engine that starts anew by itself hides it."""
    engine, still = make_engine(trials[0].scene), np.zeros(3)
    forces = np.array([[0.0, 0.0, 0.0], [HUGE_N, 0.0, 0.0]])
    # MuJoCo writes its warning into a file where it runs.
    with TemporaryDirectory() as folder, chdir(folder):
        try:
            for _ in range(100):
                engine.step(np.array([0.01, 0.0, 0.0]), None)
            for push in (forces, None):
                engine.step(still, push)
            place, speed = engine.poses()[0][1], float(np.linalg.norm(engine.velocities()[0][1]))
        finally:
            engine.close()
    shows = not np.isfinite(place).all() or not speed <= MAXIMUM_SPEED_MPS
    words = f"a step later at x = {place[0]:.3g} m, {speed:.3g} m/s"
    return Judgement(shows, f"{words}: {'a monitor sees it' if shows else 'nobody sees it'}")


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
        _reordered, same_bits, may=("right",), quick=True,
    ),
    StressRow(
        "repeat", "Invariance", "the same scene twice in one process", "the same motion to the last bit",
        _repeated, same_bits, may=("right",), quick=True,
    ),
    StressRow(
        "restart", "Invariance", "an engine taken back to a snapshot", "the same motion to the last bit",
        lambda engine: [_scene(engine, _boxes(None), None)], _goes_on_from_snapshot, may=("right",), quick=True,
    ),
    StressRow(
        "huge_force", "Invariance", "1e15 N on a box for one step",
        "the state afterwards is huge or not finite, which ends the test; never a sound one that began anew",
        lambda engine: [_scene(engine, uneven_boxes()[:1], None)], _shows_that_it_broke, may=("right",), quick=True,
    ),
    StressRow(
        "film_mirror", "Invariance", "the four boxes in three layers of film, and their mirror image in y, 0.4 g",
        "mirrored motion, to 1 mm", lambda engine: _mirrored(engine, STRETCH),
        _same_after(np.diag([1.0, -1.0, 1.0])),
    ),
    StressRow(
        "film_turn_90", "Invariance", "the same wrapped load and sled, turned by 90°", "turned motion, to 1 mm",
        lambda engine: _turned(engine, STRETCH),
        _same_after(np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])),
    ),
    StressRow(
        "film_reorder", "Invariance", "the same wrapped packages listed in reverse",
        "the same motion to the last bit", lambda engine: _reordered(engine, STRETCH), same_bits,
    ),
    StressRow(
        "film_repeat", "Invariance", "the same wrapped scene twice in one process",
        "the same motion to the last bit", lambda engine: _repeated(engine, STRETCH), same_bits,
        may=("right",),
    ),
)  # fmt: skip
"""The rows of this file."""
