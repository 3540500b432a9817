"""Runs the stability table: every row for every engine, each to its outcome."""

import importlib.util
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from fnmatch import fnmatchcase
from pathlib import Path

from config.errors import Interrupted, RefusedInput
from sim_core.companion import Companion
from sim_core.stress.known import KNOWN_WRONG
from sim_core.stress.model import Judgement, Outcome, StressResult, StressRow, Trial, try_scene
from sim_core.stress.page import write_results
from sim_core.stress.rows_fields import FIELD_ROWS
from sim_core.stress.rows_film import FILM_ROWS
from sim_core.stress.rows_film_tears import FILM_TEAR_ROWS
from sim_core.stress.rows_input import INPUT_ROWS
from sim_core.stress.rows_invariance import INVARIANCE_ROWS
from sim_core.stress.rows_sled import SLED_ROWS
from sim_core.stress.rows_stacks import STACK_ROWS

ENGINES = ("bullet", "mujoco")

Progress = Callable[[int, int, StressResult], None]


def all_rows() -> tuple[StressRow, ...]:
    """Every row of the table, in its order."""
    return (*STACK_ROWS, *SLED_ROWS, *FIELD_ROWS, *FILM_ROWS, *FILM_TEAR_ROWS, *INVARIANCE_ROWS, *INPUT_ROWS)


def run_stress(
    out: Path | None,
    *,
    only: Sequence[str] = (),
    engines: Sequence[str] = ("bullet",),
    on_progress: Progress | None = None,
) -> list[StressResult]:
    """Runs the table and writes it.

    Args:
        out: folder for ``stress.json``, ``stress.csv`` and ``stress.html``, made if absent; None writes nothing.
        only: ids of rows, or patterns such as ``field_*``; all rows when empty.
        engines: names of the rigid engines; a row runs for those that it makes sense for.
        on_progress: called after each row with the rows done, the rows in all, and the newest result.

    Raises:
        RefusedInput: no row has such an id, an engine is unknown or not installed, or ``out`` can't be written.
    """
    rows = [row for row in all_rows() if not only or any(fnmatchcase(row.id, pattern) for pattern in only)]
    for pattern in only:
        if not any(fnmatchcase(row.id, pattern) for row in rows):
            raise RefusedInput("only", pattern, "no row has such an id; see docs/stress.md")
    for engine in engines:
        if engine not in ENGINES:
            raise RefusedInput("engines", engine, f"must be one of {', '.join(ENGINES)}")
        if engine == "mujoco" and importlib.util.find_spec("mujoco") is None:
            raise RefusedInput("engines", engine, "is not installed: pip install 'pallet-twin[mujoco]'")
    if out is not None:
        _make_folder(out)
    todo = [(row, engine) for row in rows for engine in engines if engine in row.engines]
    results: list[StressResult] = []
    for row, engine in todo:
        results.append(run_row(row, engine))
        if on_progress is not None:
            on_progress(len(results), len(todo), results[-1])
    if out is not None:
        write_results(out, results)
    return results


def run_row(row: StressRow, engine: str) -> StressResult:
    """Runs one row for one engine."""
    began = time.perf_counter()
    trials: list[Trial] = []
    try:
        for scene in row.scenes(engine):
            trials.append(try_scene(scene, patience_s=row.patience_s))
            if (trials[-1].refused or trials[-1].ended) and not row.partial:
                break
        outcome, judgement = _outcome_of(row, trials)
    except RefusedInput as error:
        outcome, judgement = "refused", Judgement(False, str(error))
    except Interrupted:
        raise
    # A traceback is what a user must never see: it is a defect of the product, so it is a row's outcome.
    except Exception as error:
        outcome, judgement = "wrong", Judgement(False, f"raised {type(error).__name__}: {error}")
    reasons = [known.reason for known in KNOWN_WRONG if (known.row, known.engine) == (row.id, engine)]
    return StressResult(
        row=row.id,
        engine=engine,
        group=row.group,
        title=row.title,
        expected=row.expected,
        outcome=outcome,
        is_acceptable=outcome in row.may,
        measured=judgement.measured,
        value=judgement.value,
        bound=judgement.bound,
        unit=judgement.unit,
        wall_s=time.perf_counter() - began,
        known_wrong=reasons[0] if reasons else None,
        watched=_watched(trials),
    )


def _outcome_of(row: StressRow, trials: Sequence[Trial]) -> tuple[Outcome, Judgement]:
    if not row.partial:
        for trial in trials:
            if trial.refused is not None:
                return "refused", Judgement(False, str(trial.refused))
            if trial.ended is not None:
                return "ended", Judgement(False, str(trial.ended))
    judgement = row.judge(trials)
    if judgement.right:
        return "right", judgement
    return _unless_estimated(judgement, trials)


def _unless_estimated(judgement: Judgement, trials: Sequence[Trial]) -> tuple[Outcome, Judgement]:
    """An error inside the run's own error estimate is stated, not silent; that there is none is told as well."""
    if judgement.unit != "mm" or judgement.value is None or len(trials) != 1:
        return "wrong", judgement
    rules = trials[0].finished.judge.rules()
    worst_mm = {rule.rule: rule.worst_mm for rule in rules if rule.worst_mm is not None}
    estimate = Companion(trials[0].scene).estimate(worst_mm, trials[0].finished.physics.smallest_step_s)
    if estimate.problem is not None or estimate.largest_mm is None:
        return "ended", replace(
            judgement, measured=f"{judgement.measured}; no error estimate: {estimate.problem}"
        )
    words = f"{judgement.measured}; error estimate {estimate.largest_mm:.4g} mm"
    is_stated = judgement.value <= estimate.largest_mm
    return ("right" if is_stated else "wrong"), replace(judgement, measured=words)


def _watched(trials: Sequence[Trial]) -> dict[str, float]:
    """What the monitors saw over all scenes of a row."""
    physics = [trial.result.physics for trial in trials if trial.result is not None]
    if not physics:
        return {}
    return {
        "penetration_mm": 1e3 * max(p.penetration_m for p in physics),
        "speed_mps": max(p.speed_mps for p in physics),
        "residual": max(p.residual for p in physics),
        "contact_count": max(p.contact_count for p in physics),
        "settle_s": max(p.settle_s for p in physics),
        "steps": sum(p.steps for p in physics),
    }


def _make_folder(out: Path) -> None:
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RefusedInput("out", str(out), error.strerror or "cannot be made") from None
