"""One accuracy run: sweeps the suite or a scene, writes the tables, the figures and the page."""

import json
from collections.abc import Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from config.errors import PalletTwinError
from config.scene import Scene
from config.scene_file import validate_scene
from sim_core.accuracy.bare_loops import LoopCost, bare_loops
from sim_core.accuracy.cases import Case, pressed_scene, reference_suite
from sim_core.accuracy.coverage import Coverage, coverage
from sim_core.accuracy.fronts import (
    GROWTH_COLUMNS,
    Choice,
    GrowthPoint,
    Order,
    as_table,
    cheapest,
    fitted_orders,
    growth,
    growth_exponents,
    work_precision,
)
from sim_core.accuracy.own_scene import scene_case
from sim_core.accuracy.sweep import FORMAT, Progress, Row, Setting, row_from_json, run_sweep, write_rows
from sim_core.accuracy.wrapped_loads import ON_CHANCE, case_name, wrapped_case
from sim_core.report import versions
from sim_core.work_precision import installed_engines, scene_kind, write_table

if TYPE_CHECKING:
    from sim_core.accuracy.film import FilmFindings

RATES_HZ = {"bullet": (120, 240, 480, 960, 1920), "mujoco": (60, 120, 240, 480, 960, 1920)}
ITERATIONS = {"bullet": (10, 20, 40, 80), "mujoco": (20, 40)}
QUICK_RATES_HZ = {"bullet": (240, 480, 960), "mujoco": (120, 240, 480)}
QUICK_ITERATIONS = {"bullet": (20, 40), "mujoco": (20, 40)}
QUICK_LEAVES_OUT = {"tipping", "inertial block", "square block at 45°"}
FINEST = {"bullet": (3840, 40), "mujoco": (1920, 40)}
PRESSED_FINEST = {"bullet": (1920, 80), "mujoco": (960, 40)}
PRESSED_ITERATIONS = {"bullet": (20, 40, 80), "mujoco": (40,)}
WRAPPED_RATES_HZ = (240, 480, 960, 1920)
"""At coarser steps a monitor halves the step: the film is too stiff for them."""
WRAPPED_ITERATIONS = {"bullet": (40, 100), "mujoco": (40,)}
WRAPPED_FINEST = {"bullet": (1920, 200), "mujoco": (1920, 40)}
QUICK_WRAPPED = (Setting("mujoco", 240, 40), Setting("mujoco", 480, 40))
GROWTH_SETTINGS = {"bullet": (480, 40), "mujoco": (240, 40)}
TOLERANCES_MM = (None, 0.1, 0.5, 1.0)
"""None is the product's promise."""
PROMISED, UNPROMISED = TOLERANCES_MM[:1], TOLERANCES_MM[1:]
"""A threshold has no error in mm, and nothing is promised of a wrapped load."""
CHANCE = tuple(case_name(load) for load in ON_CHANCE)


def run_accuracy(
    out: Path,
    *,
    scene: Scene | None = None,
    quick: bool = False,
    on_progress: Progress | None = None,
    repeats: int = 3,
) -> None:
    """Writes ``accuracy.json``, ``accuracy.csv``, the figures and ``accuracy.html`` into a folder.

    Without a scene also ``film.json``, the film's own settings, and ``work_precision.json``, the tables that engines,
    steps and film meshes are chosen from; those of wrapped loads need MuJoCo.

    Rows that the folder's files already hold are not run again unless what they depend on changed.

    Args:
        out: the folder, made where it is missing.
        scene: a resolved scene to measure against its own refined runs; None for the reference suite.
        quick: fewer settings, cases and loads, in one to two minutes.
        on_progress: called with the rows done, their number in the end, and what comes next in words.
        repeats: timed repetitions of each row.

    Raises:
        PalletTwinError: the scene's reference run was refused or ended by a monitor on every engine.
    """
    from sim_core.accuracy.page import write_page

    out.mkdir(parents=True, exist_ok=True)
    known = _known_rows(out / "accuracy.json")
    repeats = 1 if quick else repeats
    parts = _parts(scene, quick, on_progress)
    film = _measured_film(out, quick, repeats, on_progress) if scene is None else None
    parts += wrapped_parts(film, quick=quick) if film is not None else []
    rows: list[Row] = []
    for cases, settings in parts:
        done = list(rows)
        rows += run_sweep(
            cases, settings, repeats=repeats, known=known, on_progress=on_progress,
            on_row=partial(_write_unfinished, out, done, known),
        )  # fmt: skip
    cases = [case for group, _ in parts for case in group]
    orders = fitted_orders(rows, {case.name for case in cases if case.is_smooth})
    choices = _choices(rows, cases)
    points: list[GrowthPoint] = []
    if scene is None:
        points = growth(
            [Setting(engine, *GROWTH_SETTINGS[engine]) for engine in installed_engines()],
            columns=GROWTH_COLUMNS[:4] if quick else GROWTH_COLUMNS,
            on_progress=(lambda words: on_progress(len(rows), len(rows), words)) if on_progress else None,
        )
    covered = coverage(rows) if scene is None else []
    table = work_precision(rows, on_chance=CHANCE) if scene is None else ()
    loops = bare_loops(table, on_progress=on_progress) if scene is None and not quick else []
    _write_json(out, rows, orders, choices, points, covered, loops)
    write_rows(rows, out / "accuracy.csv")
    if scene is None:
        write_table(table, out / "work_precision.json", film.spacings if film is not None else ())
    write_page(out, rows, cases, orders, choices, points, covered, loops, film)


def sweep_settings(engine: str, *, quick: bool = False, is_wrapped: bool = False) -> list[Setting]:
    """The settings that a sweep goes through, coarse to fine."""
    rates, iterations = (QUICK_RATES_HZ, QUICK_ITERATIONS) if quick else (RATES_HZ, ITERATIONS)
    own_rates = tuple(rate for rate in rates[engine] if rate in WRAPPED_RATES_HZ or not is_wrapped)
    counts = (WRAPPED_ITERATIONS if is_wrapped else iterations)[engine]
    return [Setting(engine, rate, count) for count in counts for rate in own_rates]


def wrapped_parts(
    film: "FilmFindings", *, quick: bool = False
) -> list[tuple[Sequence[Case], Sequence[Setting]]]:
    """Wrapped loads over engines, steps and iterations, against MuJoCo's finest run with a tight film tolerance."""
    settings = (
        list(QUICK_WRAPPED)
        if quick
        else [s for engine in installed_engines() for s in sweep_settings(engine, is_wrapped=True)]
    )
    references = {load: film.reference_mm(load) for load in ("cartons", *film.plan.loads)}
    return [
        ([wrapped_case(load, reference)], settings)
        for load, reference in references.items()
        if reference is not None and (load == "cartons" or load in ON_CHANCE)
    ]


def _measured_film(
    out: Path, quick: bool, repeats: int, on_progress: Progress | None
) -> "FilmFindings | None":
    """The film's own sweeps, which need MuJoCo; only here are the film's kernels loaded."""
    if "mujoco" not in installed_engines():
        return None
    from sim_core.accuracy.film import QUICK, measure_film

    return measure_film(out, plan=QUICK if quick else None, on_progress=on_progress, repeats=repeats)


def _choices(rows: Sequence[Row], cases: Sequence[Case]) -> list[Choice]:
    counting = [row for row in rows if row.case not in CHANCE]
    return [
        choice
        for kind in sorted({case.kind for case in cases})
        for tolerance in (
            PROMISED if kind == "threshold" else UNPROMISED if kind == "wrapped" else TOLERANCES_MM
        )
        for choice in cheapest(counting, kind, tolerance)
    ]


def _parts(
    scene: Scene | None, quick: bool, on_progress: Progress | None
) -> list[tuple[Sequence[Case], Sequence[Setting]]]:
    """What to sweep: the suite over all engines, or for each engine the scene with its own reference."""
    if scene is None:
        cases: Sequence[Case] = [
            case for case in reference_suite() if not (quick and case.name in QUICK_LEAVES_OUT)
        ]
        settings = [s for engine in installed_engines() for s in sweep_settings(engine, quick=quick)]
        return [(cases, settings), *([] if quick else _pressed_parts(on_progress))]
    parts: list[tuple[Sequence[Case], Sequence[Setting]]] = []
    problem: PalletTwinError | None = None
    is_wrapped = scene_kind(scene) == "wrapped"
    for engine in installed_engines():
        rate, iterations = (WRAPPED_FINEST if is_wrapped else FINEST)[engine]
        finest = Setting(engine, rate // 2 if quick else rate, iterations)
        if on_progress is not None:
            on_progress(0, 1, f"reference: {finest.words}")
        try:
            case = scene_case(scene, finest)
        except PalletTwinError as error:
            problem = error
            continue
        settings = sweep_settings(engine, quick=quick, is_wrapped=is_wrapped)
        settings = [s for s in settings if s.rate_hz < finest.rate_hz]
        parts.append(([case], settings))
    if not parts and problem is not None:
        raise problem
    return parts


def _pressed_parts(on_progress: Progress | None) -> list[tuple[Sequence[Case], Sequence[Setting]]]:
    """Packages that press on each other have no closed form: each engine's peak against its own finest run."""
    parts: list[tuple[Sequence[Case], Sequence[Setting]]] = []
    for engine, (rate, iterations) in PRESSED_FINEST.items():
        if engine not in installed_engines():
            continue
        finest = Setting(engine, rate, iterations)
        if on_progress is not None:
            on_progress(0, 1, f"reference of the pressed load: {finest.words}")
        case = scene_case(validate_scene(pressed_scene()), finest, only={"elastic"})
        settings = [
            Setting(engine, r, i)
            for i in PRESSED_ITERATIONS[engine]
            for r in RATES_HZ[engine]
            if 60 < r < rate
        ]
        parts.append(([case], settings))
    return parts


def _known_rows(path: Path) -> list[Row]:
    try:
        stored = json.loads(path.read_text(encoding="utf-8"))
        return [row_from_json(entry) for entry in stored["rows"]] if stored["format"] == FORMAT else []
    except (OSError, ValueError, KeyError, TypeError):
        # No earlier run, or a file that is not one: everything is run.
        return []


def _write_unfinished(out: Path, done: Sequence[Row], known: Sequence[Row], now: Sequence[Row]) -> None:
    """Keeps the rows of an earlier run that this one has not come to yet."""
    rows = {row.key: row for row in (*done, *now, *known)}
    _write_json(out, list(rows.values()), [], [], [], [], [])


def _write_json(
    out: Path,
    rows: Sequence[Row],
    orders: Sequence[Order],
    choices: Sequence[Choice],
    points: Sequence[GrowthPoint],
    covered: Sequence[Coverage],
    loops: Sequence[LoopCost],
) -> None:
    derived = ("error", "bars", "real_time_factor", "steps_per_s")
    content: dict[str, Any] = {
        "format": FORMAT,
        "versions": versions(),
        "rows": [asdict(row) | {name: getattr(row, name) for name in derived} for row in rows],
        "orders": [asdict(order) for order in orders],
        "choices": as_table(choices),
        "growth": [asdict(point) for point in points],
        "growth_exponents": growth_exponents(points),
        "coverage": [asdict(entry) for entry in covered],
        "loops": [asdict(loop) for loop in loops],
    }
    scratch = out / "accuracy.json.part"
    scratch.write_text(json.dumps(content, ensure_ascii=False, indent=1) + "\n", encoding="utf-8")
    scratch.replace(out / "accuracy.json")
