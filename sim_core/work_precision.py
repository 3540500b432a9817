"""Which engine, step and film mesh a scene is given: the cheapest in the shipped tables of error against run time."""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Literal

from config.scene import Scene, Solver
from sim_core.frames import GRAVITY
from sim_core.rigid_model import build_rigid_model
from sim_core.sled import build_profile

AUTO_TOLERANCE_MM = 1.0
"""What ``auto`` chooses for where the scene asks for no tolerance."""
TABLE = Path(__file__).with_name("work_precision.json")

FILM_SHARE = 0.75
"""Share of a tolerance that the film's mesh may take; the engine gets what the mesh leaves."""

SceneKind = Literal["resting", "sliding", "wrapped", "pressed"]
PRESSED = "pressed loads: no step is known to be inside a tolerance, so the default step"


@dataclass(frozen=True)
class TableRow:
    """What one setting came to on the reference cases of one kind.

    Attributes:
        kind: the kind of scene.
        engine: ``bullet`` or ``mujoco``.
        rate_hz: steps a second.
        iterations: solver iterations a step.
        error_mm: largest error of the kind's cases [mm].
        cost: wall time per simulated time, the largest of the cases [s/s].
        case: the case with the largest error.
    """

    kind: SceneKind
    engine: Literal["bullet", "mujoco"]
    rate_hz: int
    iterations: int
    error_mm: float
    cost: float
    case: str

    @property
    def words(self) -> str:
        """Such as ``bullet at 1/480 s × 40``."""
        return f"{self.engine} at 1/{self.rate_hz} s × {self.iterations}"


@dataclass(frozen=True)
class SpacingRow:
    """What a film mesh is good for.

    Attributes:
        spacing_m: spacing of the mesh [m].
        error_mm: largest error of this spacing and all finer ones, on top of the engine's [mm].
        case: the wrapped load.
    """

    spacing_m: float
    error_mm: float
    case: str


def scene_kind(scene: Scene) -> SceneKind:
    """What the scene asks of an engine.

    ``pressed`` where force fields press packages on each other; ``wrapped`` where only a film does; ``resting`` where
    the sled's peak acceleration stays below every friction of the surfaces that touch, so that nothing slides; else
    ``sliding``. A film that is only watched asks nothing.

    Args:
        scene: a resolved scene.
    """
    if scene.force_fields is not None:
        return "pressed"
    if scene.is_held_by_film and scene.packages:
        return "wrapped"
    model = build_rigid_model(scene)
    least = min((model.friction[pair] for pair in model.touching if pair in model.friction), default=0.0)
    return "resting" if build_profile(scene).peak_mps2 < least * GRAVITY else "sliding"


def installed_engines() -> list[str]:
    """The rigid engines that are installed, the default first."""
    return ["bullet"] + (["mujoco"] if find_spec("mujoco") is not None else [])


@cache
def shipped_table() -> tuple[TableRow, ...]:
    """The table that ``pallet-twin accuracy`` made."""
    return tuple(TableRow(**row) for row in json.loads(TABLE.read_text(encoding="utf-8"))["rows"])


@cache
def shipped_spacings() -> tuple[SpacingRow, ...]:
    """The film meshes in the same file, coarse to fine."""
    stored = json.loads(TABLE.read_text(encoding="utf-8"))
    return tuple(SpacingRow(**row) for row in stored["film_spacings"])


def write_table(rows: Sequence[TableRow], path: Path, spacings: Sequence[SpacingRow] = ()) -> None:
    """Writes the tables, whole or not at all."""
    scratch = path.with_name(path.name + ".part")
    lines, meshes = (
        ",\n  ".join(json.dumps(asdict(row), ensure_ascii=False) for row in table)
        for table in (rows, spacings)
    )
    scratch.write_text(f'{{"rows": [\n  {lines}\n],\n"film_spacings": [\n  {meshes}\n]}}\n', encoding="utf-8")
    scratch.replace(path)


def film_spacing(tolerance_mm: float, spacings: Sequence[SpacingRow] | None = None) -> SpacingRow | None:
    """The coarsest film mesh whose error is inside a tolerance, the finest where none is; None without a table.

    Args:
        tolerance_mm: bound of the mesh's error alone [mm].
        spacings: the table to choose from; the shipped one for None.
    """
    rows = shipped_spacings() if spacings is None else spacings
    inside = [row for row in rows if row.error_mm <= tolerance_mm]
    if inside:
        return max(inside, key=lambda row: row.spacing_m)
    return min(rows, key=lambda row: row.spacing_m, default=None)


def with_setting(
    scene: Scene, table: Sequence[TableRow] | None = None, spacings: Sequence[SpacingRow] | None = None
) -> tuple[Scene, str]:
    """The scene with engine, step, iterations and film mesh filled in where it leaves them open, and why, in words.

    A scene that names neither a tolerance nor ``auto`` keeps the defaults; explicit settings stand. Loads whose
    packages press on each other keep the default step: on them errors don't fall with it. Where a film holds the load
    a tolerance also chooses its mesh, and the engine gets what the mesh leaves of it.

    Args:
        scene: a resolved scene.
        table: the table to choose engine and step from; the shipped one for None.
        spacings: the table to choose the film's mesh from; the shipped one for None.
    """
    scene, mesh_words, left_mm = _with_mesh(scene, spacings)
    asked = scene.solver
    is_open = asked.time_step_s is None and asked.iterations is None
    if not is_open or (asked.engine != "auto" and left_mm is None):
        return scene, ("the default setting" if is_open else "as the scene says") + mesh_words
    kind, tolerance_mm = scene_kind(scene), left_mm or AUTO_TOLERANCE_MM
    if kind == "pressed":
        engine = "bullet" if asked.engine == "auto" else asked.engine
        why = PRESSED + ("; Bullet's costs least there" if asked.engine == "auto" else "")
        solver = asked.model_copy(update={"engine": engine})
    else:
        solver, why = _with_row(scene, kind, tolerance_mm, shipped_table() if table is None else table)
    return scene.model_copy(update={"solver": solver}), why + mesh_words


def _with_row(
    scene: Scene, kind: SceneKind, tolerance_mm: float, rows: Sequence[TableRow]
) -> tuple[Solver, str]:
    asked = scene.solver
    engines = installed_engines() if asked.engine == "auto" else [asked.engine]
    fitting = [row for row in rows if row.kind == kind and row.engine in engines and _fits(scene, row)]
    inside = [row for row in fitting if row.error_mm <= tolerance_mm]
    if inside:
        row = min(inside, key=lambda row: row.cost)
        why = (
            f"the cheapest setting inside {tolerance_mm:g} mm for {kind} loads: {row.words}"
            f" ({row.error_mm:.2g} mm on {row.case})"
        )
    elif fitting:
        row = min(fitting, key=lambda row: row.error_mm)
        why = f"no setting is inside {tolerance_mm:g} mm for {kind} loads; the nearest: {row.words}"
    else:
        # Frames too rare or too odd for every step of the table: the default step fits any scene that was accepted.
        return asked.model_copy(update={"engine": engines[0]}), "no setting of the table fits the pose frames"
    return _solver(row, asked), why


def _with_mesh(scene: Scene, spacings: Sequence[SpacingRow] | None) -> tuple[Scene, str, float | None]:
    """The scene with its film's mesh, what to say of it, and what is left of the tolerance for the engine [mm]."""
    tolerance_mm = scene.solver.tolerance_mm
    if (
        tolerance_mm is None
        or scene.wrap is None
        or scene.wrap.spacing_m is not None
        or not scene.is_held_by_film
    ):
        return scene, "", tolerance_mm
    row = film_spacing(FILM_SHARE * tolerance_mm, spacings)
    if row is None:
        return scene, "", tolerance_mm
    wrap = scene.wrap.model_copy(update={"spacing_m": row.spacing_m})
    is_inside = row.error_mm <= FILM_SHARE * tolerance_mm
    words = (
        f"; of {tolerance_mm:g} mm the film's mesh of {row.spacing_m:g} m takes {row.error_mm:.2g} mm"
        f" ({row.case})" + ("" if is_inside else ", the finest there is")
    )
    left_mm = round(max(tolerance_mm - row.error_mm, (1.0 - FILM_SHARE) * tolerance_mm), 3)
    return scene.model_copy(update={"wrap": wrap}), words, left_mm


def _solver(row: TableRow, asked: Solver) -> Solver:
    return Solver(
        engine=row.engine,
        tolerance_mm=asked.tolerance_mm,
        time_step_s=1.0 / row.rate_hz,
        iterations=row.iterations,
    )


def _fits(scene: Scene, row: TableRow) -> bool:
    try:
        scene.model_copy(update={"solver": _solver(row, scene.solver)}).steps_and_samples()
    except ValueError:
        return False
    return True
