"""Recovers what is hidden in stand-ins for bench recordings: how far off the fit is, and how honest its interval."""

import json
import shutil
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from config.scene import Scene
from config.scene_file import find_scene, read_scene, validate_scene
from recordings.bench_stand_in import write_stand_in
from recordings.calibrate import calibrate_bag
from sim_core.bench_stand_in import SensorFaults
from sim_core.calibration_parameters import parameter_of

FRICTION_WITHIN, TENSION_WITHIN = 0.02, 0.10
"""What is asked of a recovered friction, and of a recovered T as a share of it."""
ROWS_FILE, TABLE_FILE = "recovery.json", "recovery.md"
TRUTH_STEP_S = 1.0 / 960.0
"""Half the step that is fitted with."""
EUMOS = {"profile": "eumos", "level_g": 0.5}


@dataclass(frozen=True)
class StandIn:
    """One stand-in.

    Attributes:
        name: of it.
        scene: the load as a laboratory would describe it.
        hidden: true values by parameter key.
        faults: of its accelerometer.
        seed: of its noise.
        with_pictures: displacement as pictures say it, not as poses.
        truth_engine: simulates what is recorded; the scene's own engine is the one that is fitted with.
    """

    name: str
    scene: Scene
    hidden: dict[str, float]
    faults: SensorFaults
    seed: int
    with_pictures: bool = False
    truth_engine: str = "bullet"


@dataclass(frozen=True)
class RecoveredValue:
    """One hidden value and what the fit said of it.

    Attributes:
        stand_in: name of the stand-in.
        key: the parameter's.
        truth_engine: that simulated it.
        true: hidden value.
        value: fitted.
        low: lower end of the 95 % interval.
        high: upper end of it.
        is_near: within what is asked.
        is_inside: the true value lies in the interval.
        rms_mm: left between measurement and simulation [mm].
        noise_mps2: of the accelerometer [m/s²].
        evaluations: simulations of the stand-in's fit.
        wall_s: of it [s].
    """

    stand_in: str
    key: str
    truth_engine: str
    true: float
    value: float
    low: float
    high: float
    is_near: bool
    is_inside: bool
    rms_mm: float
    noise_mps2: float
    evaluations: int
    wall_s: float


def run_recovery(
    out: Path,
    *,
    only: Sequence[str] = (),
    workers: int = 2,
    on_progress: Callable[[int, int, object], None] | None = None,
) -> list[RecoveredValue]:
    """Makes the stand-ins, calibrates each by its recording alone, and writes a table; rows that are there stay.

    Args:
        out: folder for rows and table.
        only: names of the stand-ins to take; none: all twenty.
        workers: processes that simulate.
        on_progress: called with stand-ins done, how many there are, and the name of the last one.
    """
    out.mkdir(parents=True, exist_ok=True)
    path = out / ROWS_FILE
    known = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    wanted = [one for one in stand_ins() if not only or one.name in only]
    for done, stand_in in enumerate(wanted, start=1):
        if stand_in.name not in known:
            rows = recovered(stand_in, out / "bag", workers=workers)
            known[stand_in.name] = [asdict(row) for row in rows]
            path.write_text(json.dumps(known, indent=1) + "\n", encoding="utf-8")
        if on_progress is not None:
            on_progress(done, len(wanted), stand_in.name)
    found = [RecoveredValue(**row) for one in wanted for row in known[one.name]]
    (out / TABLE_FILE).write_text(_table(found), encoding="utf-8")
    return found


def recovered(stand_in: StandIn, bag: Path, *, workers: int = 2) -> list[RecoveredValue]:
    """Writes a stand-in's recording, fits what is hidden in it, and removes it.

    Args:
        stand_in: the stand-in.
        bag: where its recording stands meanwhile.
        workers: processes that simulate.
    """
    truth = stand_in.scene
    for key, value in stand_in.hidden.items():
        truth = parameter_of(key, truth).applied(truth, value)
    solver = {"engine": stand_in.truth_engine, "time_step_s": TRUTH_STEP_S}
    truth = validate_scene({**truth.model_dump(), "solver": solver})
    shutil.rmtree(bag, ignore_errors=True)
    write_stand_in(bag, truth, stand_in.faults, seed=stand_in.seed, with_pictures=stand_in.with_pictures)
    fit = calibrate_bag(bag, stand_in.scene, fit=list(stand_in.hidden), workers=workers).fit
    shutil.rmtree(bag)
    rows = []
    for one, true in zip(fit.parameters, stand_in.hidden.values(), strict=True):
        asked = FRICTION_WITHIN if one.key.startswith("friction") else TENSION_WITHIN * true
        rows.append(
            RecoveredValue(
                stand_in=stand_in.name,
                key=one.key,
                truth_engine=stand_in.truth_engine,
                true=true,
                value=one.value,
                low=one.low,
                high=one.high,
                is_near=abs(one.value - true) <= asked,
                is_inside=one.low <= true <= one.high,
                rms_mm=fit.rms_mm,
                noise_mps2=stand_in.faults.noise_mps2,
                evaluations=fit.evaluations,
                wall_s=fit.wall_s,
            )
        )
    return rows


def stand_ins() -> list[StandIn]:
    """The twenty: single blocks, five slabs with two frictions hidden, small columns with friction, and with T.

    What is recorded is simulated at half the step, and in every other round by the other engine.
    """
    made = []
    for number in range(20):
        chance = np.random.Generator(np.random.PCG64([2026, number]))
        kind = ("block", "slabs", "columns", "fields")[number % 4]
        scene, hidden = _LOADS[kind](chance, number)
        made.append(
            StandIn(
                name=f"{kind}_{number // 4 + 1}",
                scene=scene,
                hidden=hidden,
                faults=_faults(chance),
                seed=number,
                with_pictures=kind == "block" and number % 8 == 0,
                truth_engine=_other_engine(scene) if number % 8 >= 4 else scene.solver.engine,
            )
        )
    return made


def _other_engine(scene: Scene) -> str:
    return "bullet" if scene.solver.engine == "mujoco" else "mujoco"


def _faults(chance: np.random.Generator) -> SensorFaults:
    x, y, z = chance.uniform(-0.1, 0.1, 3).tolist()
    roll, pitch, yaw = chance.uniform(-5.0, 5.0, 3).tolist()
    gaps = [
        (float(middle), float(length)) for middle, length in chance.uniform((0.3, 0.006), (2.5, 0.02), (3, 2))
    ]
    return SensorFaults(
        noise_mps2=float(chance.uniform(0.05, 0.2)),
        bias_mps2=(x, y, z),
        roll_deg=roll,
        pitch_deg=pitch,
        yaw_deg=yaw,
        gaps=tuple(gaps),
        clock_offset_s=float(chance.uniform(-5.0, 5.0)),
        clock_drift_ppm=float(chance.uniform(-200.0, 200.0)),
        jitter_s=2.0e-5,
    )


def _block(chance: np.random.Generator, number: int) -> tuple[Scene, dict[str, float]]:
    scene = read_scene(find_scene("block_slip"), [f"sled={json.dumps(EUMOS)}"])
    return scene, {"friction:cardboard/sled": float(chance.uniform(0.15, 0.42))}


def _slabs(chance: np.random.Generator, number: int) -> tuple[Scene, dict[str, float]]:
    scene = read_scene(find_scene("slabs"), [f"sled={json.dumps(EUMOS)}"])
    # So that each slides: the second slab carries what rubs off the third, 0.3 of 120 kg, and its own 0.5 of 80 kg.
    lower, upper = chance.uniform(0.25, 0.36), chance.uniform(0.14, 0.26)
    return scene, {"friction:face_1/face_2": float(lower), "friction:face_3/face_4": float(upper)}


def _columns(chance: np.random.Generator, number: int) -> tuple[Scene, dict[str, float]]:
    # With less friction they slide off the pallet.
    scene = _small_load(level_g=0.5, engine="mujoco", layers=1)
    return scene, {"friction:cardboard/wood": float(chance.uniform(0.28, 0.42))}


def _fields(chance: np.random.Generator, number: int) -> tuple[Scene, dict[str, float]]:
    scene = _small_load(level_g=0.6, engine=("bullet", "mujoco")[number // 8 % 2], layers=2, friction=0.3)
    scene = validate_scene({**scene.model_dump(), "force_fields": {"tension": 1.0}})
    return scene, {"force_fields.tension": float(np.exp(chance.uniform(np.log(0.4), np.log(2.5))))}


_LOADS: dict[str, Callable[[np.random.Generator, int], tuple[Scene, dict[str, float]]]] = {
    "block": _block,
    "slabs": _slabs,
    "columns": _columns,
    "fields": _fields,
}


def _small_load(*, level_g: float, engine: str, layers: int, friction: float = 0.45) -> Scene:
    """Two columns of cartons, one behind the other, on a EUR pallet."""
    packages: list[dict[str, Any]] = [
        {
            "id": f"{'ab'[column]}{layer + 1}",
            "size_m": (0.38, 0.38, 0.25),
            "mass_kg": 10.0,
            "position_m": (0.4 * column - 0.2, 0.0, 0.144 + 0.25 * layer + 0.125),
            "layer": layer + 1,
        }
        for column in range(2)
        for layer in range(layers)
    ]
    raw: dict[str, Any] = {
        "name": "small-load",
        "load": {"packages": packages},
        "surfaces": {"pairs": [{"between": ["cardboard", "wood"], "friction": friction}]},
        "sled": {**EUMOS, "level_g": level_g},
        "solver": {"engine": engine, "time_step_s": 1.0 / 480.0},
    }
    return validate_scene(raw)


def _table(rows: Sequence[RecoveredValue]) -> str:
    heads = (
        "stand-in", "truth by", "hidden", "true", "fitted", "95 % interval", "near", "inside", "left [mm]",
        "noise [m/s²]", "runs", "[s]",
    )  # fmt: skip
    lines = [f"| {' | '.join(heads)} |", "|---" * len(heads) + "|"]
    for row in rows:
        cells = (
            row.stand_in, row.truth_engine, row.key, f"{row.true:.4f}", f"{row.value:.4f}",
            f"{row.low:.4f} to {row.high:.4f}", _yes(row.is_near), _yes(row.is_inside), f"{row.rms_mm:.2f}",
            f"{row.noise_mps2:.2f}", str(row.evaluations), f"{row.wall_s:.0f}",
        )  # fmt: skip
        lines.append(f"| {' | '.join(cells)} |")
    names = {row.stand_in for row in rows}
    missed = {row.stand_in for row in rows if not row.is_near}
    outside = {row.stand_in for row in rows if not row.is_inside}
    lines.append("")
    lines.append(
        f"{len(names) - len(missed)} of {len(names)} within {FRICTION_WITHIN} of a friction or"
        f" {100.0 * TENSION_WITHIN:.0f} % of T; {len(names) - len(outside)} of {len(names)} with every true value in"
        " its interval."
    )
    return "\n".join(lines) + "\n"


def _yes(value: bool) -> str:
    return "yes" if value else "**no**"
