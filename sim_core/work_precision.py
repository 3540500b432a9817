"""Which engine and step a scene is given: the cheapest in the shipped table of error against run time."""

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

SceneKind = Literal["resting", "sliding", "pressed"]
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


def scene_kind(scene: Scene) -> SceneKind:
    """What the scene asks of an engine.

    ``pressed`` where something presses packages on each other; ``resting`` where the sled's peak acceleration stays
    below every friction of the surfaces that touch, so that nothing slides; else ``sliding``.

    Args:
        scene: a resolved scene.
    """
    if scene.force_fields is not None or scene.film is not None:
        return "pressed"
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


def write_table(rows: tuple[TableRow, ...], path: Path) -> None:
    """Writes a table, whole or not at all."""
    scratch = path.with_name(path.name + ".part")
    lines = ",\n  ".join(json.dumps(asdict(row), ensure_ascii=False) for row in rows)
    scratch.write_text(f'{{"rows": [\n  {lines}\n]}}\n', encoding="utf-8")
    scratch.replace(path)


def with_setting(scene: Scene, table: Sequence[TableRow] | None = None) -> tuple[Scene, str]:
    """The scene with engine, step and iterations filled in where it leaves them open, and why, in words.

    A scene that names neither a tolerance nor ``auto`` keeps the defaults; explicit settings stand. Loads whose
    packages press on each other keep the default step: on them errors don't fall with it.

    Args:
        scene: a resolved scene.
        table: the table to choose from; the shipped one for None.
    """
    asked = scene.solver
    is_open = asked.time_step_s is None and asked.iterations is None
    if not is_open or (asked.engine != "auto" and asked.tolerance_mm is None):
        return scene, "the default setting" if is_open else "as the scene says"
    kind, tolerance_mm = scene_kind(scene), asked.tolerance_mm or AUTO_TOLERANCE_MM
    if kind == "pressed":
        engine = "bullet" if asked.engine == "auto" else asked.engine
        why = PRESSED + ("; Bullet's costs least there" if asked.engine == "auto" else "")
        return scene.model_copy(update={"solver": asked.model_copy(update={"engine": engine})}), why
    engines = installed_engines() if asked.engine == "auto" else [asked.engine]
    rows = shipped_table() if table is None else table
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
        solver = asked.model_copy(update={"engine": engines[0]})
        return scene.model_copy(update={"solver": solver}), "no setting of the table fits the pose frames"
    return scene.model_copy(update={"solver": _solver(row, asked)}), why


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
