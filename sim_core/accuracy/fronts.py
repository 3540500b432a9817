"""What a sweep says: fitted orders, work-precision fronts, the cheapest setting inside a tolerance, growth."""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from config.errors import PalletTwinError
from sim_core.accuracy.cases import RawScene, SceneKind, cartons_scene
from sim_core.accuracy.sweep import Cost, Row, Setting, run_track
from sim_core.work_precision import SceneKind as WantedKind
from sim_core.work_precision import TableRow

ERROR_FLOOR_MM = 1.0e-3
"""Errors below this are the contacts' softness and the reference's own last digits: no order is fitted to them."""
GROWTH_COLUMNS = ((1, 1, 1), (2, 1, 5), (4, 2, 5), (6, 4, 5), (10, 5, 5), (10, 10, 5))
"""Columns along x and y and layers of the loads of growing size: 1 to 500 cartons."""


@dataclass(frozen=True)
class Order:
    """How the error of one case falls with the step: error ∝ step^order.

    Attributes:
        case: the case's name.
        family: the setting family.
        order: least-squares slope of log(error) over log(step).
        coarsest_hz: lowest rate of the points used.
        finest_hz: highest rate of the points used.
        points: their number.
    """

    case: str
    family: str
    order: float
    coarsest_hz: int
    finest_hz: int
    points: int


@dataclass(frozen=True)
class Choice:
    """The cheapest setting that keeps every case of a kind inside a tolerance, for one engine.

    Attributes:
        kind: the kind of scene.
        tolerance_mm: the tolerance, or None for the product's promise.
        engine: the engine.
        setting: the setting in words, or None where none is inside.
        cost: wall time per simulated time, the largest of the cases [s/s].
        worst: the case that comes nearest to the tolerance, or misses it least where none is inside.
        error: its error there [mm], or in multiples of the promise.
    """

    kind: SceneKind
    tolerance_mm: float | None
    engine: str
    setting: str | None
    cost: float | None
    worst: str
    error: float


@dataclass(frozen=True)
class GrowthPoint:
    """What a step costs for one number of packages, the engine's building left out."""

    engine: str
    packages: int
    contacts: int
    step_ms: float
    real_time_factor: float


def fitted_orders(rows: Sequence[Row], smooth: set[str]) -> list[Order]:
    """Orders of the smooth cases, by log-log least squares from the coarsest step down to the error floor.

    Steps that a monitor halved, and all from the first error at the floor on, are left out.
    """
    found = []
    for case in sorted(smooth):
        families = sorted({row.setting.family for row in rows if row.case == case})
        for family in families:
            own = [row for row in rows if row.case == case and row.setting.family == family]
            points = []
            for row in sorted(own, key=lambda row: row.rate_hz):
                was_halved = row.smallest_step_s is not None and row.smallest_step_s * row.rate_hz < 0.99
                if row.error is None or was_halved:
                    continue
                if row.error <= ERROR_FLOOR_MM:
                    break
                points.append((row.rate_hz, row.error))
            if len(points) < 3:
                continue
            rates, errors = np.array(points).T
            slope = float(np.polyfit(np.log(1.0 / rates), np.log(errors), 1)[0])
            found.append(Order(case, family, slope, int(rates[0]), int(rates[-1]), len(points)))
    return found


def front(rows: Sequence[Row]) -> list[Row]:
    """The rows of one case that no other beats in both error and wall time, cheapest first."""
    done = [row for row in rows if row.error is not None and row.wall_min_s is not None]
    done.sort(key=lambda row: (row.wall_min_s, row.error))
    kept: list[Row] = []
    for row in done:
        if not kept or (row.error or 0.0) < (kept[-1].error or 0.0):
            kept.append(row)
    return kept


def cheapest(rows: Sequence[Row], kind: SceneKind, tolerance_mm: float | None) -> list[Choice]:
    """For each engine, the cheapest setting at which every case of a kind is inside the tolerance.

    Args:
        rows: a sweep.
        kind: the kind of scene.
        tolerance_mm: bound of the error in mm, or None for the product's promise.
    """
    choices = []
    for engine in sorted({row.engine for row in rows}):
        by_setting: dict[Setting, list[Row]] = {}
        for row in rows:
            if row.engine == engine and row.kind == kind:
                by_setting.setdefault(row.setting, []).append(row)
        ranked = []
        for setting, group in by_setting.items():
            scored = [(_score(row, rows, tolerance_mm), row.case) for row in group]
            cost = max((1.0 / row.real_time_factor for row in group if row.real_time_factor), default=np.inf)
            ranked.append((setting, max(scored), cost))
        if not ranked:
            continue
        limit = 1.0 if tolerance_mm is None else tolerance_mm
        inside = [entry for entry in ranked if entry[1][0] <= limit]
        if inside:
            setting, (error, worst), cost = min(inside, key=lambda entry: entry[2])
            choices.append(Choice(kind, tolerance_mm, engine, setting.words, cost, worst, error))
        else:
            _, (error, worst), _ = min(ranked, key=lambda entry: entry[1][0])
            choices.append(Choice(kind, tolerance_mm, engine, None, None, worst, error))
    return choices


def work_precision(rows: Sequence[Row], *, on_chance: Collection[str] = ()) -> tuple[TableRow, ...]:
    """The table that engines and steps are chosen from: settings that ended no case of a kind, with its worst error.

    A load that slides may also bump, so sliding loads count the impact's error too. Pressed loads have no row: their
    errors are chance, and don't fall with the step.

    Args:
        rows: a sweep.
        on_chance: cases whose error is chance, not the setting's: a setting must run them, and that is all.
    """
    kinds: dict[WantedKind, set[str]] = {
        "resting": {"resting"},
        "sliding": {"sliding", "impact"},
        "wrapped": {"wrapped"},
    }
    table = []
    for kind, sources in kinds.items():
        groups: dict[Setting, list[Row]] = {}
        for row in rows:
            if row.kind in sources:
                groups.setdefault(row.setting, []).append(row)
        for setting, group in groups.items():
            if any(row.error is None or row.real_time_factor is None for row in group):
                continue
            counting = [row for row in group if row.case not in on_chance]
            error, case = max((counted_error(row, rows) or 0.0, row.case) for row in counting)
            cost = max(1.0 / (row.real_time_factor or np.inf) for row in counting)
            engine: Literal["bullet", "mujoco"] = "mujoco" if setting.engine == "mujoco" else "bullet"
            table.append(
                TableRow(
                    kind, engine, setting.rate_hz, setting.iterations, _figures(error), _figures(cost), case
                )
            )
    return tuple(table)


def counted_error(row: Row, rows: Sequence[Row]) -> float | None:
    """What a row's error counts for in choosing a setting; None where it failed.

    Errors of step, film and solver cancel by chance in a wrapped load, so there a step counts as no better than any
    finer one.

    Args:
        row: a row of the sweep.
        rows: the sweep.
    """
    if row.error is None or row.kind != "wrapped":
        return row.error
    finer = [
        other.error or 0.0
        for other in rows
        if (other.case, other.setting.family) == (row.case, row.setting.family)
        and other.rate_hz >= row.rate_hz
    ]
    return max(finer, default=row.error)


def _figures(value: float) -> float:
    return float(f"{value:.3g}")


def _score(row: Row, rows: Sequence[Row], tolerance_mm: float | None) -> float:
    score = row.bars if tolerance_mm is None else counted_error(row, rows)
    return np.inf if row.failed or score is None else score


def growth(
    settings: Sequence[Setting],
    *,
    columns: Sequence[tuple[int, int, int]] = GROWTH_COLUMNS,
    end_s: float = 0.25,
    on_progress: Callable[[str], None] | None = None,
) -> list[GrowthPoint]:
    """Wall time a step for loads of growing size at rest under 0.2 g, one point a load and setting.

    Args:
        settings: one setting an engine.
        columns: columns along x and y, and layers, of each load.
        end_s: simulated time after settling [s].
        on_progress: called with what comes next.
    """
    points = []
    for setting in settings:
        for across, along, layers in columns:
            number = across * along * layers
            if on_progress is not None:
                on_progress(f"{number} packages, {setting.words}")
            raw: RawScene = {**cartons_scene(layers, columns=(across, along)), "pallet": None}
            for package in raw["load"]["packages"]:
                package["position_m"][2] = 0.25 * (package["layer"] - 0.5)
            costs = [Cost(), Cost()]
            try:
                for cost in costs:
                    run_track(setting.applied(raw), end_s, cost)
            except PalletTwinError:
                continue
            stepping_s = min(cost.wall_s - cost.build_s for cost in costs)
            points.append(
                GrowthPoint(
                    setting.engine, number, costs[0].extremes.contact_count,
                    1000.0 * stepping_s / costs[0].steps, costs[0].simulated_s / stepping_s,
                )
            )  # fmt: skip
    return points


def growth_exponents(points: Sequence[GrowthPoint]) -> dict[str, float]:
    """Slope of log(time a step) over log(contacts) by engine, from loads of 100 contacts on."""
    found = {}
    for engine in sorted({point.engine for point in points}):
        large = [(p.contacts, p.step_ms) for p in points if p.engine == engine and p.contacts >= 100]
        if len(large) >= 2:
            contacts, times = np.log(np.array(large, dtype=float)).T
            found[engine] = float(np.polyfit(contacts, times, 1)[0])
    return found


def as_table(choices: Sequence[Choice]) -> list[dict[str, Any]]:
    """Choices as rows for a table."""
    return [
        {
            "scene kind": choice.kind,
            "tolerance": "0.05 % or 0.1 mm" if choice.tolerance_mm is None else f"{choice.tolerance_mm:g} mm",
            "engine": choice.engine,
            "cheapest setting": choice.setting or "none",
            "wall s per simulated s": None if choice.cost is None else round(choice.cost, 3),
            "nearest case": choice.worst,
            "its error": "failed" if not np.isfinite(choice.error)
            else f"{choice.error:.2g} × allowed" if choice.tolerance_mm is None else f"{choice.error:.3g} mm",
        }
        for choice in choices
    ]  # fmt: skip
