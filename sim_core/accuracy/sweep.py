"""Runs cases over engines, steps and iterations: one row a run, with its error, its cost and how it ended."""

import csv
import gc
import hashlib
import json
import statistics
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from itertools import count
from math import gcd
from pathlib import Path
from typing import Any

from config.errors import PalletTwinError, RefusedInput
from config.scene import Scene
from config.scene_file import validate_scene
from sim_core.accuracy.cases import POSES_HZ, Case, RawScene, Track
from sim_core.engines import make_engine
from sim_core.load_test import LoadTest
from sim_core.monitors import Extremes
from sim_core.report import versions
from sim_core.sled import sled_samples

FORMAT = 1
"""Version of the rows on disk; raise it when a row's fields or their meaning change."""
REPEAT_BUDGET_S = 3.0
"""No further repetition of a timed run starts after this."""

Progress = Callable[[int, int, str], None]


@dataclass(frozen=True)
class Setting:
    """What a sweep varies.

    Attributes:
        engine: ``bullet`` or ``mujoco``.
        rate_hz: physics steps a second.
        iterations: solver iterations a step; for ``mujoco`` the most that it may take.
    """

    engine: str
    rate_hz: int
    iterations: int

    @property
    def family(self) -> str:
        """The settings that differ in the step alone."""
        return f"{self.engine} × {self.iterations}"

    @property
    def words(self) -> str:
        """Such as ``bullet 1/480 × 40``."""
        return f"{self.engine} 1/{self.rate_hz} × {self.iterations}"

    def applied(self, raw: RawScene) -> Scene:
        """The scene with these settings, sampled once a step (a recorded sled keeps its samples).

        Raises:
            RefusedInput: the setting doesn't fit the scene.
        """
        is_recorded = raw["sled"]["profile"] == "recorded"
        samples_hz = raw.get("sampling", {}).get("samples_hz", 960) if is_recorded else self.rate_hz
        poses_hz = gcd(gcd(self.rate_hz, samples_hz), raw.get("sampling", {}).get("poses_hz", POSES_HZ))
        solver = {"engine": self.engine, "time_step_s": 1.0 / self.rate_hz, "iterations": self.iterations}
        return validate_scene(
            {
                **raw,
                "solver": {**raw.get("solver", {}), **solver},
                "sampling": {"samples_hz": samples_hz, "poses_hz": poses_hz},
            }
        )


@dataclass(frozen=True)
class Measured:
    """One quantity of one row; ``error`` is in ``unit``, relative for the unit ``g``."""

    name: str
    value: float
    reference: float
    reference_kind: str
    unit: str
    error: float
    bar: float


@dataclass(frozen=True)
class Row:
    """One case at one setting.

    Attributes:
        key: digest of all that the row depends on; a row on disk with this key is not run again.
        case: the case's name.
        kind: the case's kind.
        engine: the engine.
        rate_hz: steps a second asked for.
        iterations: solver iterations asked for.
        settings: the engine's settings as read back.
        quantities: what was measured; empty when the run failed.
        wall_min_s: least wall time of the repetitions, stepping and reads, without error and judge [s].
        wall_median_s: their median [s].
        wall_max_s: their maximum [s].
        repeats: how many repetitions were timed, after a warm-up.
        steps: physics steps of one repetition, settling included.
        simulated_s: simulated time of one repetition, settling included [s].
        contacts: largest number of contact points.
        penetration_mm: deepest contact [mm].
        residual: largest remaining solver residual, in the engine's measure.
        energy_residual: largest share of energy that appeared from nowhere.
        smallest_step_s: the step at the end, where a monitor halved it [s].
        failed: whether a monitor ended the run or it was refused.
        reason: why, in one line.
    """

    key: str
    case: str
    kind: str
    engine: str
    rate_hz: int
    iterations: int
    settings: Mapping[str, Any] = field(default_factory=dict)
    quantities: tuple[Measured, ...] = ()
    wall_min_s: float | None = None
    wall_median_s: float | None = None
    wall_max_s: float | None = None
    repeats: int = 0
    steps: int = 0
    simulated_s: float = 0.0
    contacts: int = 0
    penetration_mm: float = 0.0
    residual: float = 0.0
    energy_residual: float = 0.0
    smallest_step_s: float | None = None
    failed: bool = False
    reason: str | None = None

    @property
    def setting(self) -> Setting:
        """The setting asked for."""
        return Setting(self.engine, self.rate_hz, self.iterations)

    @property
    def error(self) -> float | None:
        """Largest error: of the quantities in mm where there are any, else the relative one."""
        in_mm = [q.error for q in self.quantities if q.unit == "mm"]
        return max(in_mm or [q.error for q in self.quantities], default=None)

    @property
    def bars(self) -> float | None:
        """Largest error as a multiple of what is allowed: at most 1 keeps the promise."""
        return max((q.error / q.bar for q in self.quantities), default=None)

    @property
    def real_time_factor(self) -> float | None:
        """Simulated time over the least wall time."""
        return self.simulated_s / self.wall_min_s if self.wall_min_s else None

    @property
    def steps_per_s(self) -> float | None:
        """Steps a second of the fastest repetition."""
        return self.steps / self.wall_min_s if self.wall_min_s else None

    def flat(self) -> dict[str, Any]:
        """The row for the CSV table: one column a quantity's error."""
        flat = {
            name: value
            for name, value in asdict(self).items()
            if name not in ("settings", "quantities", "key")
        }
        derived = ("error", "bars", "real_time_factor", "steps_per_s")
        flat |= {name: getattr(self, name) for name in derived}
        flat["reference_kinds"] = " ".join(
            sorted({q.reference_kind.replace(" ", "-") for q in self.quantities})
        )
        flat["settings"] = json.dumps(self.settings, sort_keys=True)
        return flat | {f"error_{q.name.replace(' ', '_')}_{q.unit}": q.error for q in self.quantities}


@dataclass
class Cost:
    """What the runs of one measurement cost together; the wall time [s] holds that of building the engine."""

    wall_s: float = 0.0
    build_s: float = 0.0
    steps: int = 0
    simulated_s: float = 0.0
    smallest_step_s: float | None = None
    extremes: Extremes = field(default_factory=Extremes)


def run_track(scene: Scene, end_s: float | None, cost: Cost) -> Track:
    """Runs a scene until a time [s], or until its end for None, and adds to the cost.

    Raises:
        PalletTwinError: the scene was refused, or a monitor ended the run.
    """
    frames = []
    began = time.perf_counter()
    test = LoadTest(scene)
    cost.build_s += time.perf_counter() - began
    last = round(end_s * scene.sampling.samples_hz) if end_s is not None else None
    try:
        for sample in sled_samples(scene):
            frame = test.take(sample)
            if frame is not None:
                frames.append(frame)
            if sample.index == last or (last is None and test.finished):
                break
    finally:
        cost.wall_s += time.perf_counter() - began
        cost.steps += test.step_count
        cost.simulated_s += test.time_s + test.settle_s
        cost.smallest_step_s = test.smallest_step_s
        for entry in fields(Extremes):
            worst = max(getattr(cost.extremes, entry.name), getattr(test.extremes, entry.name))
            setattr(cost.extremes, entry.name, worst)
        test.close()
    return Track(scene, tuple(frames))


def run_case(case: Case, setting: Setting, *, repeats: int = 3) -> Row:
    """One row: a warm-up run that gives the error, then timed repetitions that don't look at it.

    Args:
        case: the case.
        setting: the setting.
        repeats: timed repetitions, fewer where they take long.
    """
    row = {"case": case.name, "kind": case.kind, **asdict(setting)}
    first = Cost()
    settings: dict[str, Any] = {}
    try:
        settings = read_back(case, setting)
        values = case.measure(lambda raw, end_s: run_track(setting.applied(raw), end_s, first))
    except PalletTwinError as error:
        return Row(
            key=row_key(case, setting, settings, repeats), settings=settings, failed=True, reason=str(error),
            **row, **_account(first),
        )  # fmt: skip
    walls: list[float] = []
    gc.collect()
    for _ in count():
        cost = Cost()
        case.measure(lambda raw, end_s, cost=cost: run_track(setting.applied(raw), end_s, cost))  # type: ignore[misc]
        walls.append(cost.wall_s)
        if len(walls) >= repeats or sum(walls) > REPEAT_BUDGET_S:
            break
    return Row(
        key=row_key(case, setting, settings, repeats),
        settings=settings,
        quantities=tuple(
            Measured(
                q.name,
                float(values[q.name]),
                q.reference,
                q.kind,
                q.unit,
                float(q.error(values[q.name])),
                q.bar,
            )
            for q in case.quantities
        ),
        wall_min_s=min(walls),
        wall_median_s=statistics.median(walls),
        wall_max_s=max(walls),
        repeats=len(walls),
        **row,
        **_account(first),
    )


def read_back(case: Case, setting: Setting) -> dict[str, Any]:
    """The engine's own account of the settings that would run.

    Raises:
        RefusedInput: the setting doesn't fit the scene, or the engine is not installed.
    """
    engine = make_engine(setting.applied(case.scene))
    try:
        return dict(engine.settings)
    finally:
        engine.close()


def row_key(case: Case, setting: Setting, settings: Mapping[str, Any], repeats: int) -> str:
    """Digest of all that a row depends on."""
    parts = [
        FORMAT, case.name, case.kind, case.scene, [asdict(q) for q in case.quantities],
        asdict(setting), settings, repeats, versions(),
    ]  # fmt: skip
    return hashlib.sha256(json.dumps(parts, sort_keys=True, default=str).encode()).hexdigest()


def run_sweep(
    cases: Sequence[Case],
    settings: Sequence[Setting],
    *,
    repeats: int = 3,
    known: Iterable[Row] = (),
    on_row: Callable[[list[Row]], None] | None = None,
    on_progress: Progress | None = None,
) -> list[Row]:
    """Every case at every setting.

    Args:
        cases: the cases.
        settings: the settings.
        repeats: timed repetitions of each.
        known: rows of an earlier sweep; those whose key still holds are taken over.
        on_row: called after each new row with all rows so far.
        on_progress: called with the rows done, their number in the end, and what comes next in words.
    """
    earlier = {row.key: row for row in known}
    rows: list[Row] = []
    total = len(cases) * len(settings)
    for case in cases:
        for setting in settings:
            if on_progress is not None:
                on_progress(len(rows), total, f"{case.name}, {setting.words}")
            try:
                read = read_back(case, setting)
            except RefusedInput:
                read = {}
            old = earlier.get(row_key(case, setting, read, repeats))
            rows.append(old if old is not None else run_case(case, setting, repeats=repeats))
            if old is None and on_row is not None:
                on_row(rows)
    if on_progress is not None:
        on_progress(total, total, "done")
    return rows


def write_rows(rows: Sequence[Row], path: Path) -> None:
    """Writes rows as CSV, whole or not at all."""
    flat = [row.flat() for row in rows]
    columns = list(dict.fromkeys(name for entry in flat for name in entry))
    scratch = path.with_name(path.name + ".part")
    with scratch.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, columns, restval="")
        writer.writeheader()
        writer.writerows(flat)
    scratch.replace(path)


def row_from_json(entry: Mapping[str, Any]) -> Row:
    """A row as ``asdict`` wrote it."""
    known = {f.name for f in fields(Row)}
    quantities = tuple(Measured(**quantity) for quantity in entry["quantities"])
    return Row(**{**{k: v for k, v in entry.items() if k in known}, "quantities": quantities})


def _account(cost: Cost) -> dict[str, Any]:
    return {
        "steps": cost.steps,
        "simulated_s": cost.simulated_s,
        "contacts": cost.extremes.contact_count,
        "penetration_mm": 1000.0 * cost.extremes.penetration_m,
        "residual": cost.extremes.residual,
        "energy_residual": cost.extremes.energy_residual,
        "smallest_step_s": cost.smallest_step_s,
    }
