"""The film's own settings, mesh, force tolerance and rigid step, one at a time: what each changes and what it costs.

Runs are on MuJoCo, whose own error is far below the film's. What one knob does shows best with the others fine, so
mesh and step are swept at a tolerance of 1e-4, the step also as shipped. The film is in equilibrium and has no mass,
so there is no artificial one to sweep.
"""

import gc
import hashlib
import json
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from config.errors import PalletTwinError
from config.scene import DEFAULT_TIME_STEP_S, Scene
from config.wrap import DEFAULT_SPACING_M
from sim_core.accuracy.cases import Track
from sim_core.accuracy.film_strip import StripPoint, strip_errors
from sim_core.accuracy.sweep import Progress, Setting
from sim_core.accuracy.wrapped_loads import Load, case_name, wrapped_scene
from sim_core.load_test import LoadTest
from sim_core.report import versions
from sim_core.work_precision import SpacingRow
from sim_core.wrap.load_film import TOLERANCE

FORMAT = 1
"""Version of the rows on disk; raise it when a row's fields or their meaning change."""
ITERATIONS = 40
SPACINGS_M = (0.2, 0.17, 0.14, 0.12, 0.1, 0.085, 0.07, 0.06, 0.05, 0.042, 0.035)
TOLERANCES = (3.0e-2, 1.0e-2, 3.0e-3, 1.0e-3, 3.0e-4, 1.0e-4)
RATES_HZ = (240, 480, 960, 1920, 3840)
QUICK_SPACINGS_M, QUICK_TOLERANCES, QUICK_RATES_HZ = (0.2, 0.14, 0.1), (1.0e-2, 3.0e-3, 1.0e-3), (240, 480)
REFINED_HZ = 960
"""Rate of the run in which everything is fine."""
OTHER_LOADS: tuple[Load, ...] = ("interlocked", "mixed sizes")
OTHER_SPACINGS_M, OTHER_RATES_HZ = (0.14, 0.1, 0.07, 0.05), (240, 480, 960, 1920)
DEFAULT_BAR_MM = 2.0
"""How near the defaults must come to the run in which everything is fine."""
FLOOR_MM = 1.0e-3
"""Errors below this are the reference's own: no order is fitted to them."""
SCATTERED = 3.0
"""Errors that lie off the fitted line by more than this factor have no order."""
REPEAT_BUDGET_S = 10.0
"""No further repetition of a timed run starts after this."""


@dataclass(frozen=True)
class FilmSetting:
    """What the sweeps vary.

    Attributes:
        rate_hz: rigid steps a second.
        spacing_m: spacing of the film's mesh [m].
        tolerance: force that may be left on a node, as a share of the pull of a row of film.
    """

    rate_hz: int = round(1.0 / DEFAULT_TIME_STEP_S)
    spacing_m: float = DEFAULT_SPACING_M
    tolerance: float = TOLERANCE

    @property
    def words(self) -> str:
        """Such as ``1/480 s, 0.1 m, 0.003``."""
        return f"1/{self.rate_hz} s, {self.spacing_m:g} m, {self.tolerance:g}"


@dataclass(frozen=True)
class FilmRow:
    """One wrapped load at one setting.

    Attributes:
        key: digest of all that the row depends on; a row on disk with this key is not run again.
        load: which wrapped load.
        rate_hz: rigid steps a second asked for.
        spacing_m: spacing of the mesh [m].
        tolerance: the film's force tolerance.
        peak_mm: largest displacement of any corner of any package [mm]; None where the run failed.
        peak_strain: largest strain anywhere in the film.
        peak_force_npm: largest pull, of all layers together [N/m].
        nodes: of the film's mesh.
        residual: largest force that was left on a node, as a share of the pull of a row.
        steps: rigid steps, settling included.
        halvings: how often a monitor halved the step.
        cpu_s: least processor time of the repetitions, judging left out [s].
        wall_s: least wall time of them [s].
        repeats: their number.
        reason: why the run failed, or None.
    """

    key: str
    load: Load
    rate_hz: int
    spacing_m: float
    tolerance: float
    peak_mm: float | None = None
    peak_strain: float = 0.0
    peak_force_npm: float = 0.0
    nodes: int = 0
    residual: float = 0.0
    steps: int = 0
    halvings: int = 0
    cpu_s: float = 0.0
    wall_s: float = 0.0
    repeats: int = 0
    reason: str | None = None

    @property
    def setting(self) -> FilmSetting:
        """The setting asked for."""
        return FilmSetting(self.rate_hz, self.spacing_m, self.tolerance)


@dataclass(frozen=True)
class Plan:
    """Which settings of the film are run.

    Attributes:
        spacings_m: meshes, coarse to fine [m].
        tolerances: film tolerances, loose to tight; the last one is that of mesh and step.
        rates_hz: rigid steps a second, coarse to fine.
        loads: further loads, over a few meshes and steps.
        is_refined: whether one run has everything fine.
    """

    spacings_m: tuple[float, ...] = SPACINGS_M
    tolerances: tuple[float, ...] = TOLERANCES
    rates_hz: tuple[int, ...] = RATES_HZ
    loads: tuple[Load, ...] = OTHER_LOADS
    is_refined: bool = True

    @property
    def knobs(self) -> dict[str, tuple[FilmSetting, ...]]:
        """The settings of the cartons by what is swept."""
        fine = self.tolerances[-1]
        return {
            "mesh spacing": tuple(FilmSetting(spacing_m=s, tolerance=fine) for s in self.spacings_m),
            "film tolerance": tuple(FilmSetting(tolerance=t) for t in self.tolerances),
            "rigid step": tuple(FilmSetting(rate, tolerance=fine) for rate in self.rates_hz),
            "rigid step, film as shipped": tuple(FilmSetting(rate) for rate in self.rates_hz),
        }

    @property
    def refined(self) -> FilmSetting | None:
        """The setting in which everything is fine."""
        return FilmSetting(REFINED_HZ, self.spacings_m[-1], self.tolerances[-1]) if self.is_refined else None

    def by_load(self, load: Load) -> dict[str, tuple[FilmSetting, ...]]:
        """The settings of a further load."""
        fine = self.tolerances[-1]
        return {
            "rigid step": tuple(FilmSetting(rate, tolerance=fine) for rate in OTHER_RATES_HZ),
            "mesh spacing": tuple(FilmSetting(spacing_m=s, tolerance=fine) for s in OTHER_SPACINGS_M),
        }

    @property
    def runs(self) -> list[tuple[Load, FilmSetting]]:
        """Everything that is run, each once."""
        wanted: list[tuple[Load, FilmSetting]] = [("cartons", FilmSetting())]
        wanted += [("cartons", setting) for swept in self.knobs.values() for setting in swept]
        wanted += [(load, s) for load in self.loads for swept in self.by_load(load).values() for s in swept]
        wanted += [("cartons", self.refined)] if self.refined is not None else []
        return list(dict.fromkeys(wanted))


QUICK = Plan(QUICK_SPACINGS_M, QUICK_TOLERANCES, QUICK_RATES_HZ, (), is_refined=False)


@dataclass(frozen=True)
class Knob:
    """One setting of the film, swept with the others as they are.

    Attributes:
        name: what is swept.
        unit: of its values: ``m``, ``s``, or empty for a share.
        default: the value that is shipped.
        reference: the finest run.
        points: value, error against the finest run [mm] and row of all others that ran.
    """

    name: str
    unit: str
    default: float
    reference: FilmRow
    points: tuple[tuple[float, float, FilmRow], ...]

    @property
    def order(self) -> tuple[float, float] | None:
        """Least-squares slope of log(error) over log(value) and the largest factor between an error and that line.

        None where there are fewer than three errors to fit.
        """
        found = [(value, error) for value, error, _ in self.points if error > FLOOR_MM]
        if len(found) < 3:
            return None
        values, errors = np.log(np.array(found)).T
        slope, level = np.polyfit(values, errors, 1)
        return float(slope), float(np.exp(np.abs(errors - level - slope * values).max()))

    @property
    def has_order(self) -> bool:
        """Whether the errors fall along the fitted line."""
        return self.order is not None and self.order[0] > 0.0 and self.order[1] <= SCATTERED


@dataclass(frozen=True)
class FilmFindings:
    """What the film's sweeps came to.

    Attributes:
        plan: what was run.
        rows: every run.
        strip: the stretched strip.
    """

    plan: Plan
    rows: tuple[FilmRow, ...]
    strip: tuple[StripPoint, ...]

    def row(self, setting: FilmSetting | None, load: Load = "cartons") -> FilmRow | None:
        """The run of a load at a setting, or None where there is none."""
        return next((row for row in self.rows if row.load == load and row.setting == setting), None)

    def reference_mm(self, load: Load) -> float | None:
        """Peak displacement on the mesh that is shipped, everything else fine [mm]."""
        swept = self.plan.knobs if load == "cartons" else self.plan.by_load(load)
        row = self.row(swept["rigid step"][-1], load)
        return row.peak_mm if row is not None else None

    @property
    def knobs(self) -> tuple[Knob, ...]:
        """Each knob with its errors; both sweeps of the step have one reference."""
        found = []
        for name, settings in self.plan.knobs.items():
            swept = self.plan.knobs["rigid step"] if name.startswith("rigid step") else settings
            reference = self.row(swept[-1])
            if reference is not None and reference.peak_mm is not None:
                unit, default = _unit_and_value(name, FilmSetting())
                points = [
                    (_unit_and_value(name, s)[1], abs(row.peak_mm - reference.peak_mm), row)
                    for s in settings
                    if s != swept[-1] and (row := self.row(s)) is not None and row.peak_mm is not None
                ]
                found.append(Knob(name, unit, default, reference, tuple(points)))
        return tuple(found)

    @property
    def spacings(self) -> tuple[SpacingRow, ...]:
        """The table that meshes are chosen from: the error of a spacing is the largest of its own and all finer ones.

        Where boxes end between two rows is chance, so a mesh can be nearer to the answer than a finer one. Spacings
        that gain nothing over a coarser one are left out, and so are the finest, which is the reference, and the one
        before it, for which nothing but the reference speaks.
        """
        mesh = next((knob for knob in self.knobs if knob.name == "mesh spacing"), None)
        found: list[SpacingRow] = []
        for value, error, row in reversed(mesh.points if mesh is not None else ()):
            largest = max(error, found[-1].error_mm if found else 0.0)
            found.append(SpacingRow(value, largest, case_name(row.load)))
        kept: list[SpacingRow] = []
        for entry in reversed(found[1:]):
            if not kept or entry.error_mm < kept[-1].error_mm:
                kept.append(entry)
        return tuple(SpacingRow(r.spacing_m, float(f"{r.error_mm:.2g}"), r.case) for r in kept)


def _unit_and_value(knob: str, setting: FilmSetting) -> tuple[str, float]:
    if knob == "mesh spacing":
        return "m", setting.spacing_m
    return ("", setting.tolerance) if knob == "film tolerance" else ("s", 1.0 / setting.rate_hz)


def measure_film(
    out: Path, *, plan: Plan | None = None, on_progress: Progress | None = None, repeats: int = 3
) -> FilmFindings:
    """Runs the film's sweeps and the strip, and writes ``film.json`` after every run.

    Rows that the file already holds are not run again unless what they depend on changed.

    Args:
        out: an existing folder.
        plan: what is run; everything for None.
        on_progress: called with the runs done, their number in the end, and what comes next in words.
        repeats: timed repetitions, fewer where they take long.
    """
    path, plan = out / "film.json", plan or Plan()
    known = {row.key: row for row in _known_rows(path)}
    keys = {run: row_key(*run) for run in plan.runs}
    if any(key not in known for key in keys.values()):
        # The first film loads or compiles its kernels: that is nobody's cost.
        run_film("cartons", FilmSetting(spacing_m=1.0), key="", repeats=1)
    for number, ((load, setting), key) in enumerate(keys.items()):
        if on_progress is not None:
            on_progress(number, len(keys), f"film of {load}, {setting.words}")
        if key not in known:
            known[key] = run_film(load, setting, key=key, repeats=repeats)
            _write(path, FilmFindings(plan, tuple(known.values()), ()))
    findings = FilmFindings(plan, tuple(known[key] for key in keys.values()), strip_errors())
    _write(path, findings, [row for row in known.values() if row.key not in keys.values()])
    return findings


def run_film(load: Load, setting: FilmSetting, *, key: str, repeats: int) -> FilmRow:
    """One row: the test run some times over, the same to the bit each time."""
    cpu: list[float] = []
    walls: list[float] = []
    row: dict[str, Any] = {"key": key, "load": load, **asdict(setting)}
    scene = film_scene(load, setting)
    gc.collect()
    while len(cpu) < repeats and sum(walls) <= REPEAT_BUDGET_S:
        began, began_cpu = time.perf_counter(), time.process_time()
        test = LoadTest(scene, film_tolerance=setting.tolerance)
        try:
            frames = tuple(test.frames())
        except PalletTwinError as error:
            return FilmRow(**row, reason=str(error))
        finally:
            test.close()
        cpu.append(time.process_time() - began_cpu)
        walls.append(time.perf_counter() - began)
    told: Mapping[str, Any] = test.film_summary or {}
    return FilmRow(
        **row,
        peak_mm=Track(scene, frames).peak_mm(),
        **{name: told[name] for name in ("peak_strain", "peak_force_npm", "nodes", "residual")},
        steps=test.step_count, halvings=len(test.halvings), cpu_s=min(cpu), wall_s=min(walls), repeats=len(cpu),
    )  # fmt: skip


def film_scene(load: Load, setting: FilmSetting) -> Scene:
    """The resolved scene of a wrapped load at a setting; the film's tolerance is no part of it."""
    raw = wrapped_scene(load)
    raw["wrap"] = {**raw["wrap"], "spacing_m": setting.spacing_m}
    return Setting("mujoco", setting.rate_hz, ITERATIONS).applied(raw)


def row_key(load: Load, setting: FilmSetting) -> str:
    """Digest of all that a row depends on."""
    parts = [FORMAT, film_scene(load, setting).to_json(), asdict(setting), versions(), version("mujoco")]
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()


def _write(path: Path, findings: FilmFindings, others: Sequence[FilmRow] = ()) -> None:
    """Writes rows, strip and what follows from them, whole or not at all; and rows that belong to another plan."""
    content = {
        "format": FORMAT,
        "versions": {**versions(), "mujoco": version("mujoco")},
        "rows": [asdict(row) for row in findings.rows],
        "other_rows": [asdict(row) for row in others],
        "orders": {knob.name: knob.order for knob in findings.knobs},
        "spacings": [asdict(row) for row in findings.spacings],
        "strip": [asdict(point) for point in findings.strip],
    }
    scratch = path.with_name(path.name + ".part")
    scratch.write_text(json.dumps(content, ensure_ascii=False, indent=1) + "\n", encoding="utf-8")
    scratch.replace(path)


def _known_rows(path: Path) -> list[FilmRow]:
    known = {f.name for f in fields(FilmRow)}
    try:
        stored = json.loads(path.read_text(encoding="utf-8"))
        entries = stored["rows"] + stored["other_rows"] if stored["format"] == FORMAT else []
        return [FilmRow(**{name: entry[name] for name in known}) for entry in entries]
    except (OSError, ValueError, KeyError, TypeError):
        # No earlier run, or a file that is not one: everything is run.
        return []
