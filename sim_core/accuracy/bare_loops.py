"""The engines' own loops with nothing of ours around them, beside our whole tests: what our layers cost."""

import itertools
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from config.scene import Scene
from config.scene_file import validate_scene
from sim_core.accuracy.cases import cartons_scene
from sim_core.engines import make_engine
from sim_core.frames import GRAVITY, Array
from sim_core.judge import EumosJudge
from sim_core.load_test import LoadTest
from sim_core.run import expected_end_s
from sim_core.sled import sled_samples
from sim_core.work_precision import TableRow, installed_engines, with_setting

TOLERANCE_MM = 0.5
SETTLE_S = 0.2
MUJOCO_RATES_HZ = (120, 240, 480, 960)
MUJOCO_IMPEDANCES = (0.99, 0.999, 0.9999)
BULLET_SETTINGS = ((240, 50), (240, 200), (480, 50), (480, 100), (960, 25), (960, 50), (1920, 25))


@dataclass(frozen=True)
class LoopCost:
    """What one loop came to on the 40 cartons at 0.2 g, where nothing may move.

    Attributes:
        name: what ran.
        is_ours: whether it is our whole test: settling, stepping, monitors, reads and judge.
        peak_mm: largest displacement of a carton, which is all error [mm]; not a number where it was not looked at.
        wall_min_s: least wall time over the rounds, building left out [s].
        wall_median_s: their median [s].
        simulated_s: simulated time, settling included [s].
    """

    name: str
    is_ours: bool
    peak_mm: float
    wall_min_s: float
    wall_median_s: float
    simulated_s: float


@dataclass(frozen=True)
class _Loop:
    name: str
    is_ours: bool
    run: Callable[[], tuple[float, float, float]]
    """Gives wall time [s], peak [mm] and simulated time [s]."""


def bare_loops(
    table: Sequence[TableRow],
    *,
    rounds: int = 5,
    on_progress: Callable[[int, int, str], None] | None = None,
) -> list[LoopCost]:
    """Times raw loops at the cheapest of their settings inside 0.5 mm, and our tests, in turns.

    A raw loop only steps the engine with the sled's acceleration and reads positions at 240 Hz: no impact watch,
    no monitor, no judge. MuJoCo's is its own contact model, stiffened as far as it stays inside the tolerance.

    Args:
        table: what ``auto`` chooses from.
        rounds: timed runs of each, taking turns.
        on_progress: called with what is done and how much there is of it, first the search and then the rounds.
    """
    candidates = _raw_bullet() + (_raw_mujoco() if "mujoco" in installed_engines() else [])
    chosen: dict[str, tuple[float, _Loop]] = {}
    for index, loop in enumerate(candidates):
        if on_progress is not None:
            on_progress(index, len(candidates), f"40 cartons, {loop.name}")
        wall_s, peak_mm, _ = loop.run()
        engine = loop.name.split()[1]
        if peak_mm <= TOLERANCE_MM and wall_s < chosen.get(engine, (np.inf,))[0]:
            chosen[engine] = (wall_s, loop)
    loops = [loop for _, loop in chosen.values()] + _ours(table)
    walls: dict[str, list[float]] = {loop.name: [] for loop in loops}
    peaks: dict[str, tuple[float, float]] = {}
    for turn in range(rounds):
        for loop in loops:
            if on_progress is not None:
                on_progress(turn, rounds, f"40 cartons, {loop.name}")
            wall_s, peak_mm, simulated_s = loop.run()
            walls[loop.name].append(wall_s)
            peaks[loop.name] = (peak_mm, simulated_s)
    return [
        LoopCost(
            loop.name,
            loop.is_ours,
            peaks[loop.name][0],
            min(walls[loop.name]),
            float(np.median(walls[loop.name])),
            peaks[loop.name][1],
        )
        for loop in loops
    ]


def _ours(table: Sequence[TableRow]) -> list[_Loop]:
    raw = cartons_scene()
    solvers = [{"engine": "auto", "tolerance_mm": TOLERANCE_MM}, {"tolerance_mm": TOLERANCE_MM}]
    auto, bullet = (with_setting(validate_scene({**raw, "solver": s}), table)[0] for s in solvers)
    named = {f"auto: {_words(auto)}": auto}
    if auto.solver.engine != "bullet":
        named[_words(bullet)] = bullet
    loops = []
    for name, scene in named.items():
        loops.append(_Loop(f"our test, {name}", True, partial(_our_test, scene)))
        loops.append(_Loop(f"engine alone, {_words(scene)}", False, partial(_engine_alone, scene)))
    return loops


def _words(scene: Scene) -> str:
    return f"{scene.solver.engine} 1/{1.0 / scene.time_step_s:.0f} × {scene.iterations}"


def _our_test(scene: Scene) -> tuple[float, float, float]:
    test, judge = LoadTest(scene), EumosJudge(scene)
    began = time.perf_counter()
    try:
        for frame in test.frames():
            judge.add(frame)
        wall_s = time.perf_counter() - began
    finally:
        test.close()
    return wall_s, max(package.peak_mm for package in judge.packages()), test.time_s + test.settle_s


def _engine_alone(scene: Scene) -> tuple[float, float, float]:
    """The same steps on the same engine behind the interface, and nothing else."""
    test = LoadTest(scene)
    try:
        changes = []
        for sample in sled_samples(scene):
            changes.append(sample.acceleration / scene.sampling.samples_hz)
            test.take(sample)
            if test.finished:
                break
        settle = round(test.settle_s / scene.time_step_s)
        simulated_s = test.time_s + test.settle_s
    finally:
        test.close()
    steps, samples = scene.steps_and_samples()
    groups = [sum(changes[i : i + samples], np.zeros(3)) for i in range(1, len(changes), samples)]
    engine = make_engine(scene)
    began = time.perf_counter()
    try:
        for change in [np.zeros(3)] * settle + [group / steps for group in groups for _ in range(steps)]:
            engine.step(change, None)
        wall_s = time.perf_counter() - began
    finally:
        engine.close()
    return wall_s, float("nan"), simulated_s


def _accelerations(rate_hz: int) -> Array:
    """Mean acceleration along x over each step [m/s²], from rest to a quarter of a second after the stop."""
    scene = validate_scene(
        {**cartons_scene(), "sampling": {"samples_hz": rate_hz, "poses_hz": min(240, rate_hz)}}
        | {"solver": {"time_step_s": 1.0 / rate_hz}}
    )
    count = round(expected_end_s(scene) * rate_hz)
    samples = itertools.islice(sled_samples(scene), 1, count + 1)
    return np.concatenate([np.zeros(round(SETTLE_S * rate_hz)), [s.acceleration[0] for s in samples]])


def _timed(
    accelerations: Array, rate_hz: int, step: Callable[[float], object], read: Callable[[], Array]
) -> tuple[float, float, float]:
    settle, thin = round(SETTLE_S * rate_hz), max(1, rate_hz // 240)
    start, peak = np.zeros(0), 0.0
    began = time.perf_counter()
    for index, acceleration in enumerate(accelerations.tolist()):
        step(acceleration)
        if index + 1 == settle:
            start = read()
        elif index >= settle and index % thin == 0:
            peak = max(peak, float(np.abs(read() - start).max()))
    return time.perf_counter() - began, 1000.0 * peak, len(accelerations) / rate_hz


def _raw_bullet() -> list[_Loop]:
    return [
        _Loop(f"raw bullet 1/{rate} × {count}", False, partial(_run_bullet, rate, count))
        for rate, count in BULLET_SETTINGS
    ]


def _run_bullet(rate_hz: int, iterations: int) -> tuple[float, float, float]:
    from sim_core.engines.bullet import p

    client = p.connect(p.DIRECT)
    try:
        p.setPhysicsEngineParameter(
            fixedTimeStep=1.0 / rate_hz, numSubSteps=0, numSolverIterations=iterations,
            solverResidualThreshold=0.0, contactERP=0.2, physicsClientId=client,
        )  # fmt: skip
        bodies = []
        for size, mass, place in _boxes():
            shape = p.createCollisionShape(
                p.GEOM_BOX, halfExtents=[e / 2.0 for e in size], physicsClientId=client
            )
            body = p.createMultiBody(mass, shape, -1, place, physicsClientId=client)
            p.changeDynamics(
                body, -1, lateralFriction=0.5**0.5, linearDamping=0.0, angularDamping=0.0,
                physicsClientId=client,
            )  # fmt: skip
            if mass:
                bodies.append(body)

        def step(acceleration: float) -> None:
            p.setGravity(-acceleration, 0.0, -GRAVITY, physicsClientId=client)
            p.stepSimulation(physicsClientId=client)

        def read() -> Array:
            return np.array([p.getBasePositionAndOrientation(b, physicsClientId=client)[0] for b in bodies])

        return _timed(_accelerations(rate_hz), rate_hz, step, read)
    finally:
        p.disconnect(physicsClientId=client)


def _raw_mujoco() -> list[_Loop]:
    return [
        _Loop(f"raw mujoco 1/{rate}, impedance {value:g}", False, partial(_run_mujoco, rate, value))
        for rate in MUJOCO_RATES_HZ
        for value in MUJOCO_IMPEDANCES
    ]


def _run_mujoco(rate_hz: int, impedance: float) -> tuple[float, float, float]:
    import mujoco

    bodies = []
    for size, mass, place in _boxes():
        half, at = (" ".join(str(v) for v in values) for values in ([e / 2.0 for e in size], place))
        geom = f'<geom type="box" size="{half}" mass="{mass or 1.0}"/>'
        joint = "<freejoint/>" if mass else ""
        bodies.append(f'<body pos="{at}">{joint}{geom}</body>')
    model: Any = mujoco.MjModel.from_xml_string(
        f'<mujoco><option timestep="{1.0 / rate_hz!r}" cone="elliptic" impratio="100"/><default>'
        f'<geom friction="0.5 0 0" solref="{2.02 / rate_hz!r} 1" solimp="{min(impedance, 0.99)} {impedance} 0.001"/>'
        f"</default><worldbody>{''.join(bodies)}</worldbody></mujoco>"
    )
    data: Any = mujoco.MjData(model)

    def step(acceleration: float) -> None:
        model.opt.gravity[0] = -acceleration
        mujoco.mj_step(model, data)

    def read() -> Array:
        return data.qpos.reshape(-1, 7)[:, :3].copy()  # type: ignore[no-any-return]

    model.opt.gravity[2] = -GRAVITY
    return _timed(_accelerations(rate_hz), rate_hz, step, read)


def _boxes() -> Sequence[tuple[tuple[float, ...], float, tuple[float, ...]]]:
    """Size, mass (0 for the pallet, which is blocked) and centre of every box."""
    scene = validate_scene(cartons_scene())
    pallet = scene.pallet_box
    assert pallet is not None
    deck = (pallet.size_m, 0.0, (0.0, 0.0, pallet.size_m[2] / 2.0))
    return [deck, *((q.size_m, q.mass_kg, q.position_m) for q in scene.packages)]
