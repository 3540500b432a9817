"""Both rigid engines on one grid of loads, levels and frictions: where their verdicts agree, and where not."""

import hashlib
import json
import signal
import time
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass, field, fields
from importlib.metadata import version
from importlib.resources import files
from importlib.util import find_spec
from itertools import product
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from config.errors import RefusedInput
from config.scene import Scene
from config.scene_file import resolve_scene, validate_scene
from sim_core.accuracy.agreement_page import ENGINES, agreement_figure, summary, write_table
from sim_core.accuracy.cases import RawScene
from sim_core.accuracy.figures import standalone_svg
from sim_core.accuracy.sweep import Progress
from sim_core.companion import Companion
from sim_core.engines import make_engine
from sim_core.report import full_report, judgement, versions, worst_by_rule
from sim_core.run import run_test

FORMAT = 1
"""Version of the rows on disk; raise it when a row's fields or their meaning change."""
LEVELS_G = (0.2, 0.3, 0.4, 0.5, 0.8)
FRICTIONS = (0.3, 0.45, 0.6)
CARTONS = ("cardboard", "cardboard")
SHEETS = ("anti_slip", "cardboard")
WORKERS = 2
DECK_M = 0.144
SHEET_DROP_M = 0.02
"""A drop that the judge lets any package do, however thin."""


@dataclass(frozen=True)
class Layout:
    """A load of the grid: what stands on the pallet, and which way the sled goes.

    Attributes:
        name: a word or two.
        load: ``load`` of a scene file, relative to the shipped patterns.
        levels_g: the plateau levels that it is tested at [g].
        pair: the pair of surfaces whose friction is varied; every other pair is the material library's.
        frictions: its frictions.
        direction: the sled's direction.
        parts: further parts of the scene.
    """

    name: str
    load: RawScene
    levels_g: tuple[float, ...] = LEVELS_G
    pair: tuple[str, str] = CARTONS
    frictions: tuple[float, ...] = FRICTIONS
    direction: str = "+x"
    parts: RawScene = field(default_factory=dict)


@dataclass(frozen=True)
class GridPoint:
    """One scene of the grid, still without an engine."""

    layout: Layout
    level_g: float
    friction: float

    @property
    def name(self) -> str:
        """Such as ``tall_narrow_0.5g_0.45``."""
        return f"{self.layout.name.replace(' ', '_')}_{self.level_g:g}g_{self.friction:g}"

    def scene(self, engine: str) -> Scene:
        """The resolved scene for an engine at its default setting."""
        raw = {
            "name": self.name,
            "load": self.layout.load,
            "surfaces": {"pairs": [{"between": self.layout.pair, "friction": self.friction}]},
            "sled": {
                "profile": "eumos", "level_g": self.level_g, "plateau_s": 0.3, "direction": self.layout.direction,
            },
            "solver": {"engine": engine},
            **self.layout.parts,
        }  # fmt: skip
        return resolve_scene(validate_scene(raw), Path(str(files("config").joinpath("patterns"))))


@dataclass(frozen=True)
class Row:
    """One scene on one engine: the run at the default setting, and the estimate of its companion.

    Attributes:
        key: digest of all that the row depends on; a row on disk with this key is not run again.
        scene: the scene's name.
        layout: the layout's name.
        level_g: plateau level [g].
        friction: of the layout's pair of surfaces.
        engine: ``bullet`` or ``mujoco``.
        verdict: what the product says: with the estimate.
        states: ``pass`` or ``fail`` of each rule, as the run alone has it.
        worst_mm: worst displacement by rule [mm].
        limit_mm: its limit [mm].
        error_mm: its error estimate [mm]; empty when there is none.
        fall_mm: the least displacement of a package that toppled or fell [mm].
        problem: why there is no estimate, or None.
        ended_by: the monitor that ended the run, or None.
        unmet_friction: surface pairs whose friction the engine cannot represent, in words.
        halvings: how often a monitor halved the step.
        wall_s: wall time of the run [s].
        companion_wall_s: wall time of the companion, its process's start included [s].
    """

    key: str
    scene: str
    layout: str
    level_g: float
    friction: float
    engine: str
    verdict: str
    states: Mapping[str, str]
    worst_mm: Mapping[str, float]
    limit_mm: Mapping[str, float]
    error_mm: Mapping[str, float]
    fall_mm: float
    problem: str | None
    ended_by: str | None
    unmet_friction: Sequence[str]
    halvings: int
    wall_s: float
    companion_wall_s: float

    def is_settled(self, rule: str) -> bool:
        """Whether the error estimate leaves the rule's state standing.

        What toppled or fell has no displacement of its own in the report. It shows in the permanent one, and not
        below ``fall_mm``: there the estimate decides whether it could have been.
        """
        worst = self.worst_mm.get("permanent" if rule == "damage" else rule)
        error = self.error_mm.get("permanent" if rule == "damage" else rule)
        if worst is None or error is None or self.ended_by is not None:
            return False
        return abs(worst - (self.fall_mm if rule == "damage" else self.limit_mm[rule])) > error


def run_agreement(out: Path, *, quick: bool = False, on_progress: Progress | None = None) -> None:
    """Writes ``agreement.json``, ``agreement.csv`` and ``agreement.svg`` into a folder.

    Rows that the folder's ``agreement.json`` already holds are not run again unless what they depend on changed;
    it is written after every row.

    Args:
        out: the folder, made where it is missing.
        quick: a handful of scenes, in about half a minute.
        on_progress: called with the rows done, their number in the end, and what came last in words.

    Raises:
        RefusedInput: one of the engines is not installed.
    """
    if find_spec("mujoco") is None:
        raise RefusedInput("solver.engine", "mujoco", "is not installed: pip install 'pallet-twin[mujoco]'")
    out.mkdir(parents=True, exist_ok=True)
    tasks = [(point, engine) for point in grid(quick=quick) for engine in ENGINES]
    keys = [row_key(point.scene(engine)) for point, engine in tasks]
    known = _known_rows(out / "agreement.json")
    rows = {row.key: row for row in known if row.key in keys}
    missing = [
        (point, engine, key) for (point, engine), key in zip(tasks, keys, strict=True) if key not in rows
    ]
    if on_progress is not None:
        on_progress(len(rows), len(tasks), "agreement of the engines")
    for row in _run_all(missing):
        rows[row.key] = row
        _write_json(out, [rows[key] for key in keys if key in rows], known)
        if on_progress is not None:
            on_progress(len(rows), len(tasks), f"{row.scene}, {row.engine}")
    ordered = [rows[key] for key in keys]
    _write_json(out, ordered, known)
    write_table(ordered, out / "agreement.csv")
    figure = standalone_svg(agreement_figure(ordered, summary(ordered)))
    (out / "agreement.svg").write_text(figure, encoding="utf-8")


def grid(*, quick: bool = False) -> list[GridPoint]:
    """Every layout at each of its levels and every friction; for ``quick`` five scenes of the smallest ones."""
    if quick:
        low, tall = (layout for layout in layouts() if layout.name in ("low wide", "tall narrow"))
        chosen = [(low, 0.2), (low, 0.8), (tall, 0.2), (tall, 0.5), (tall, 0.8)]
        return [GridPoint(layout, level_g, 0.45) for layout, level_g in chosen]
    return [
        GridPoint(layout, level_g, friction)
        for layout in layouts()
        for level_g, friction in product(layout.levels_g, layout.frictions)
    ]


def layouts() -> list[Layout]:
    """The loads of the grid, on an EUR pallet, from 5 packages to 44."""
    columns = stack((0.3, 0.4, 0.25), columns=(4, 2), layers=3, mass_kg=10.0)
    return [
        Layout("columns", columns),
        Layout("columns file", {"file": "eur_columns.stackbuilder.xml"}),
        Layout("interlocked", {"file": "eur_interlocked.pally.json"}),
        Layout("mixed sizes", {"file": "eur_mixed.nist.xml"}),
        Layout(
            "interlayers", {"file": "eur_columns_antislip.stackbuilder.xml"}, pair=SHEETS,
            frictions=(0.45, 0.6, 0.8), direction="+y",
        ),
        Layout("low wide", stack((0.6, 0.4, 0.2), columns=(2, 2), layers=2, mass_kg=15.0), direction="+y"),
        Layout("tall narrow", stack((0.6, 0.4, 0.3), columns=(1, 1), layers=5, mass_kg=12.0)),
        # Pressed loads cost MuJoCo most, so there are fewer of them.
        Layout("held by fields", columns, (0.3, 0.5, 0.8), parts={"force_fields": {"tension": 1.0}}),
    ]  # fmt: skip


def stack(
    pitch_m: tuple[float, float, float], *, columns: tuple[int, int], layers: int, mass_kg: float
) -> RawScene:
    """A load of equal cartons in columns in the middle of the deck, 1 mm apart.

    Args:
        pitch_m: distance of neighbours along x, y and z [m]; cartons are 1 mm less in x and y.
        columns: number of them along x and y.
        layers: number of layers.
        mass_kg: of one carton [kg].
    """
    length, width, height = pitch_m
    places = product(range(layers), range(columns[0]), range(columns[1]))
    return {
        "packages": [
            {
                "id": f"carton_{number}",
                "size_m": [length - 0.001, width - 0.001, height],
                "mass_kg": mass_kg,
                "position_m": [
                    length * (i - (columns[0] - 1) / 2.0),
                    width * (j - (columns[1] - 1) / 2.0),
                    DECK_M + height * (layer + 0.5),
                ],
                "layer": layer + 1,
            }
            for number, (layer, i, j) in enumerate(places, start=1)
        ]
    }


def opinion(scene: Scene) -> dict[str, Any]:
    """A test and, after it, its companion: the fields of a ``Row`` that come out of them.

    The only place here that knows how an error estimate is had.

    Args:
        scene: a resolved scene.
    """
    result = run_test(scene)
    judged = judgement(scene, result.judge, is_complete=result.ended_by is None)
    began = time.perf_counter()
    estimate = Companion(scene).estimate(worst_by_rule(judged), result.physics.smallest_step_s)
    companion_wall_s = time.perf_counter() - began
    report = full_report(
        judged, scene, physics=result.physics, findings=result.findings, estimate=estimate,
        wall_s=result.wall_s, mode="run",
    )  # fmt: skip
    return {
        "verdict": report["verdict"],
        "states": {rule["rule"]: rule["state"] for rule in judged["rules"]},
        "worst_mm": worst_by_rule(judged),
        "limit_mm": {r["rule"]: r["limit_mm"] for r in judged["rules"] if r["limit_mm"] is not None},
        "error_mm": dict(estimate.by_rule_mm),
        "problem": estimate.problem,
        "ended_by": result.physics.ended_by,
        "unmet_friction": list(result.physics.unmet_friction),
        "halvings": len(result.physics.halvings),
        "wall_s": result.wall_s,
        "companion_wall_s": companion_wall_s,
    }


def row_key(scene: Scene) -> str:
    """Digest of the resolved scene, the versions and the engine's settings as read back."""
    engine = make_engine(scene)
    try:
        settings = dict(engine.settings)
    finally:
        engine.close()
    parts = [FORMAT, scene.to_json(), {**versions(), "mujoco": version("mujoco")}, settings]
    return hashlib.sha256(json.dumps(parts, sort_keys=True, default=str).encode()).hexdigest()


def _run_all(tasks: Sequence[tuple[GridPoint, str, str]]) -> Iterator[Row]:
    """Rows as they come from the worker processes."""
    if not tasks:
        return
    # Spawned, not forked: a fork would share the parent's threads and physics server.
    pool = ProcessPoolExecutor(WORKERS, mp_context=get_context("spawn"), initializer=_leave_interrupts)
    try:
        for done in as_completed([pool.submit(_run_row, *task) for task in tasks]):
            yield done.result()
    finally:
        pool.shutdown(cancel_futures=True)


def _leave_interrupts() -> None:
    """Ctrl-C is for the process in front: it lets the rows under way end."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _run_row(point: GridPoint, engine: str, key: str) -> Row:
    scene = point.scene(engine)
    return Row(
        key=key, scene=point.name, layout=point.layout.name, level_g=point.level_g, friction=point.friction,
        engine=engine,
        fall_mm=1000.0 * min(max(0.5 * package.size_m[2], SHEET_DROP_M) for package in scene.packages),
        **opinion(scene),
    )  # fmt: skip


def _known_rows(path: Path) -> list[Row]:
    names = {entry.name for entry in fields(Row)}
    try:
        stored = json.loads(path.read_text(encoding="utf-8"))
        entries = stored["rows"] + stored["other_rows"]
        return [Row(**{name: entry[name] for name in names}) for entry in entries]
    except (OSError, ValueError, KeyError, TypeError):
        # No earlier run, or a file that is not one: everything is run.
        return []


def _write_json(out: Path, rows: Sequence[Row], known: Sequence[Row]) -> None:
    """Keeps what is known of scenes that this run doesn't have, or has not come to yet."""
    have = {(row.scene, row.engine) for row in rows}
    content = {
        "format": FORMAT,
        "versions": {**versions(), "mujoco": version("mujoco")},
        "summary": summary(rows),
        "rows": [asdict(row) for row in rows],
        "other_rows": [asdict(row) for row in known if (row.scene, row.engine) not in have],
    }
    scratch = out / "agreement.json.part"
    scratch.write_text(json.dumps(content, ensure_ascii=False, indent=1) + "\n", encoding="utf-8")
    scratch.replace(out / "agreement.json")
