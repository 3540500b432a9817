"""The film's own settings: what is swept, what follows from it, a strip against Hooke, and a wrapped load as a case."""

import json
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest

from sim_core.accuracy.figures import standalone_svg
from sim_core.accuracy.film import (
    FORMAT,
    FilmFindings,
    FilmRow,
    FilmSetting,
    Plan,
    measure_film,
    row_key,
)
from sim_core.accuracy.film_figures import knobs_figure, strip_figure
from sim_core.accuracy.film_strip import BAR, StripPoint, strip_errors
from sim_core.accuracy.film_tables import bar_rows, knob_rows, load_rows, spacing_rows
from sim_core.accuracy.fronts import work_precision
from sim_core.accuracy.run import CHANCE, sweep_settings, wrapped_parts
from sim_core.accuracy.sweep import Measured, Row, Setting, run_case
from sim_core.accuracy.wrapped_loads import Load, wrapped_case, wrapped_scene
from sim_core.work_precision import SpacingRow

SMALL = Plan((0.2, 0.14, 0.1, 0.07, 0.05), (1.0e-2, 1.0e-3), (240, 480, 960, 1920), ("mixed sizes",))
PEAKS_MM = {0.2: 28.5, 0.14: 26.0, 0.1: 28.9, 0.07: 28.1, 0.05: 28.0}
STRIP = (StripPoint(4000.0, 1, 0.5, 0.001), StripPoint(4000.0, 2, 1.0e-4, 0.001))


def made(load: Load, setting: FilmSetting) -> FilmRow:
    """A row whose peak depends on the mesh by chance, on step and tolerance with second and first order."""
    peak = PEAKS_MM.get(setting.spacing_m, 28.9) + 2.0e4 / setting.rate_hz**2 + 100.0 * setting.tolerance
    return FilmRow(
        f"{load} {setting}", load, **asdict(setting), peak_mm=peak, peak_strain=0.2, peak_force_npm=1200.0, nodes=760,
        residual=setting.tolerance, steps=1000, cpu_s=setting.rate_hz / 200.0, wall_s=setting.rate_hz / 190.0,
        repeats=2,
    )  # fmt: skip


def found(plan: Plan = SMALL) -> FilmFindings:
    return FilmFindings(plan, tuple(made(*run) for run in plan.runs), STRIP)


def test_a_plan_runs_each_setting_once() -> None:
    for plan in (Plan(), SMALL):
        assert len(set(plan.runs)) == len(plan.runs)
        assert plan.runs[0] == ("cartons", FilmSetting())
        assert all(("cartons", setting) in plan.runs for swept in plan.knobs.values() for setting in swept)
    assert FilmSetting() == FilmSetting(480, 0.1, 3.0e-3)
    assert (Plan().spacings_m[0], Plan().spacings_m[-1]) == (0.2, 0.035)
    assert (Plan().tolerances[0], Plan().tolerances[-1]) == (3.0e-2, 1.0e-4)


def test_each_knob_is_held_against_its_finest() -> None:
    mesh, tolerance, step, shipped = found().knobs
    assert [round(error, 6) for _, error, _ in mesh.points] == [0.5, 2.0, 0.9, 0.1]
    assert (mesh.unit, mesh.default, mesh.reference.spacing_m) == ("m", 0.1, 0.05)
    assert [value for value, _, _ in tolerance.points] == [1.0e-2]
    assert tolerance.points[0][1] == pytest.approx(0.9)
    # 1/240² − 1/1920² and so on: nearly second order; as shipped the loose film leaves the same error everywhere.
    assert step.order == (pytest.approx(2.15, abs=0.05), pytest.approx(1.1, abs=0.1))
    assert [row.rate_hz for _, _, row in step.points] == [240, 480, 960]
    assert [row.rate_hz for _, _, row in shipped.points] == [240, 480, 960, 1920]
    assert shipped.reference == step.reference
    assert shipped.points[-1][1] == pytest.approx(100.0 * (3.0e-3 - 1.0e-3))


def test_a_spacing_is_as_bad_as_the_worst_of_all_finer_ones() -> None:
    case = "wrapped cartons"
    # 0.2 m is nearer to the answer than 0.14 m, by chance; for 0.07 m speaks only the reference.
    assert found().spacings == (SpacingRow(0.2, 2.0, case), SpacingRow(0.1, 0.9, case))
    assert [entry["spacing [m]"] for entry in spacing_rows(found())] == ["0.2", "0.1"]


def test_tables_tell_bars_and_rows() -> None:
    findings = found()
    orders, default, mass, strip = bar_rows(findings)
    assert "rigid step: 2." in orders["found"]
    away = abs(made("cartons", FilmSetting()).peak_mm - made("cartons", findings.plan.refined).peak_mm)  # type: ignore[operator, arg-type]
    assert default["found"].endswith(f"{away:.2f} mm") and default["holds"] == "yes"
    assert mass["found"] == "there is none"
    assert strip["found"] == "Newton steps: 2 at 4 kN/m" and strip["holds"] == "yes"
    assert [entry["error [mm]"] for entry in knob_rows(findings)].count("reference") == 3
    assert [entry["load"] for entry in load_rows(findings)] == ["cartons"] * 2 + ["mixed sizes"] * 2
    far = replace(findings, rows=tuple(replace(row, peak_mm=row.spacing_m * 100.0) for row in findings.rows))
    assert bar_rows(far)[1]["holds"] == "no"


def test_a_run_that_failed_is_left_out() -> None:
    rows = tuple(
        replace(row, peak_mm=None, reason="ended by monitor 'x'") if row.spacing_m == 0.14 else row
        for row in found().rows
    )
    mesh = replace(found(), rows=rows).knobs[0]
    assert [value for value, _, _ in mesh.points] == [0.2, 0.1, 0.07]


def test_figures_are_the_same_bytes_twice_and_stand_alone() -> None:
    figures = [knobs_figure(found(), 1.0), strip_figure(STRIP)]
    assert figures == [knobs_figure(found(), 1.0), strip_figure(STRIP)]
    for figure in figures:
        ElementTree.fromstring(standalone_svg(figure))
    assert "order 2.1" in figures[0] or "order 2.2" in figures[0]
    assert "E·t = 4 kN/m" in figures[1]


def test_only_what_is_missing_is_run_and_the_film_gets_its_tolerance(tmp_path: Path) -> None:
    plan = Plan((0.1,), (2.0e-2,), (240,), (), is_refined=False)
    missing = ("cartons", FilmSetting(240, tolerance=2.0e-2))
    rows: list[dict[str, Any]] = [
        asdict(replace(made(*run), key=row_key(*run))) for run in plan.runs if run != missing
    ]
    stored = {"format": FORMAT, "rows": rows, "other_rows": []}
    (tmp_path / "film.json").write_text(json.dumps(stored), encoding="utf-8")
    findings = measure_film(tmp_path, plan=plan, repeats=1)
    row = findings.row(missing[1])
    assert row is not None and row.peak_mm is not None and 20.0 < row.peak_mm < 35.0
    assert 3.0e-3 < row.residual <= 2.0e-2
    assert row.nodes > 500 and row.cpu_s > 0.0 and row.halvings == 0
    assert {r.peak_mm for r in findings.rows} == {row.peak_mm, *(entry["peak_mm"] for entry in rows)}
    written = json.loads((tmp_path / "film.json").read_text(encoding="utf-8"))
    assert len(written["rows"]) == len(plan.runs) and written["other_rows"] == []
    # Another plan keeps what it doesn't have.
    other = measure_film(tmp_path, plan=replace(plan, rates_hz=(480,)), repeats=1)
    assert len(other.rows) == len(plan.runs) - 2
    assert len(json.loads((tmp_path / "film.json").read_text(encoding="utf-8"))["other_rows"]) == 2


@pytest.mark.parametrize("stiffness_npm", [400.0, 12_000.0, 4.0e6])
def test_a_strip_of_any_stiffness_comes_to_hookes_length(stiffness_npm: float) -> None:
    points = strip_errors((stiffness_npm,))
    assert points[-1].error < 1.0e-8
    assert [point.steps for point in points] == list(range(1, len(points) + 1))
    # Stretched by 40 % it moves half an element a step; else Newton's first steps do it.
    assert sum(point.error > BAR for point in points) < (30 if stiffness_npm < 1000.0 else 5)


def test_wrapped_cartons_are_held_and_both_engines_have_settings() -> None:
    assert wrapped_scene("mixed sizes")["wrap"] == wrapped_scene("cartons")["wrap"]
    row = run_case(wrapped_case("cartons", 29.0), Setting("mujoco", 240, 20), repeats=1)
    assert not row.failed and row.kind == "wrapped"
    assert row.error is not None and row.error < 1.0
    parts = wrapped_parts(found())
    assert [case.name for cases, _ in parts for case in cases] == ["wrapped cartons", "wrapped mixed sizes"]
    assert {setting.engine for setting in parts[0][1]} >= {"bullet"}
    assert {setting.iterations for setting in sweep_settings("bullet", is_wrapped=True)} == {40, 100}


def test_a_case_left_to_chance_says_what_runs_but_not_how_well() -> None:
    def row(rate_hz: int, case: str, error: float | None, wall_s: float) -> Row:
        quantities = (
            () if error is None else (Measured("peak", error, 0.0, "self-refined", "mm", error, 1.0),)
        )
        return Row(
            "key", case, "wrapped", "bullet", rate_hz, 100, quantities=quantities, wall_min_s=wall_s,
            repeats=1, steps=1, simulated_s=1.0, failed=error is None,
        )  # fmt: skip

    (chance,) = CHANCE
    rows = [
        row(480, "wrapped cartons", 0.8, 4.0), row(480, chance, 2.5, 5.0),
        row(240, "wrapped cartons", 0.5, 2.0), row(240, chance, None, 1.0),
    ]  # fmt: skip
    (entry,) = work_precision(rows, on_chance=CHANCE)
    assert (entry.kind, entry.rate_hz, entry.error_mm, entry.cost, entry.case) == (
        "wrapped", 480, 0.8, 4.0, "wrapped cartons",
    )  # fmt: skip
