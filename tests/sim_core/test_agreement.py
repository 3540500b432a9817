"""The grid on which the engines are compared: its scenes, its counting, its files and its figure."""

import csv
import json
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest

from sim_core.accuracy.agreement import GridPoint, Row, grid, layouts, opinion, run_agreement
from sim_core.accuracy.agreement_page import (
    ENGINES,
    Compared,
    agreement_figure,
    compare,
    look_of,
    summary,
    write_table,
)
from sim_core.accuracy.figures import standalone_svg
from sim_core.integrity import require_integrity
from sim_core.report import judgement, worst_by_rule
from sim_core.run import run_test

LIMITS = {"permanent": 50.0, "elastic": 100.0}


def made_row(engine: str, permanent: float, elastic: float, *, error: float = 1.0, **changed: Any) -> Row:
    worst = {"permanent": permanent, "elastic": elastic}
    states = {rule: "pass" if worst[rule] <= LIMITS[rule] else "fail" for rule in worst} | {"damage": "pass"}
    row = Row(
        key=engine, scene="load_0.5g_0.3", layout="load", level_g=0.5, friction=0.3, engine=engine,
        verdict="fail" if "fail" in states.values() else "pass", states=states, worst_mm=worst, limit_mm=LIMITS,
        error_mm=dict.fromkeys(worst, error), fall_mm=125.0, problem=None, ended_by=None, unmet_friction=(),
        halvings=0, wall_s=1.0, companion_wall_s=0.5,
    )  # fmt: skip
    return replace(row, **changed)


def outcomes(*rows: Row) -> dict[str, str]:
    return {entry.rule: entry.outcome for entry in compare(rows)}


def test_the_grid_is_wide_enough_and_every_scene_stands() -> None:
    points = grid()
    assert len(points) >= 60
    assert len({point.name for point in points}) == len(points)
    assert {(point.level_g, point.friction) for point in points} >= set(product((0.2, 0.5, 0.8), (0.3, 0.6)))
    counts = []
    for layout in layouts():
        scene = GridPoint(layout, layout.levels_g[-1], layout.frictions[0]).scene("mujoco")
        require_integrity(scene)
        assert scene.solver.engine == "mujoco" and scene.solver.time_step_s is None
        counts.append(len(scene.packages))
    assert len(counts) >= 5 and min(counts) <= 8 and max(counts) >= 40
    assert sum(bool(layout.parts) for layout in layouts()) == 1


@pytest.mark.parametrize("engine", ENGINES)
def test_an_opinion_is_the_run_with_its_companions_estimate(engine: str) -> None:
    scene = next(point for point in grid(quick=True) if point.level_g == 0.2).scene(engine)
    found = opinion(scene)
    judged = judgement(scene, run_test(scene).judge)
    assert found["worst_mm"] == worst_by_rule(judged)
    assert found["states"] == {rule["rule"]: rule["state"] for rule in judged["rules"]}
    assert found["error_mm"].keys() == found["worst_mm"].keys() == found["limit_mm"].keys()
    assert min(found["error_mm"].values()) > 0.0
    assert (found["verdict"], found["problem"], found["ended_by"]) == ("pass", None, None)


def test_equal_states_agree() -> None:
    assert set(outcomes(made_row("bullet", 1.0, 2.0), made_row("mujoco", 40.0, 90.0)).values()) == {"agree"}


@pytest.mark.parametrize(
    ("error_mm", "outcome"),
    [(1.0, "disagree"), (9.9, "disagree"), (10.1, "inside the estimate")],
)
def test_different_states_are_measured_with_the_estimates(error_mm: float, outcome: str) -> None:
    passing = made_row("bullet", 1.0, 90.0, error=error_mm)
    assert outcomes(passing, made_row("mujoco", 1.0, 180.0)) == {
        "permanent": "agree",
        "elastic": outcome,
        "damage": "agree",
    }


@pytest.mark.parametrize(
    "why",
    [{"error_mm": {}, "problem": "no estimate"}, {"ended_by": "ended by monitor 'energy'"}],
)
def test_without_an_estimate_nothing_is_settled(why: dict[str, Any]) -> None:
    rows = made_row("bullet", 1.0, 2.0, **why), made_row("mujoco", 1.0, 180.0)
    assert outcomes(*rows)["elastic"] == "inside the estimate"
    assert summary(rows)["outside"] == 0
    assert summary(rows)["share"] is None


@pytest.mark.parametrize(
    ("permanent_mm", "outcome"), [(20.0, "disagree"), (120.0, "inside the estimate"), (400.0, "disagree")]
)
def test_a_fall_is_settled_by_the_permanent_displacement(permanent_mm: float, outcome: str) -> None:
    states = {"permanent": "fail", "elastic": "fail", "damage": "fail"}
    stands = made_row("bullet", permanent_mm, 400.0, error=10.0)
    assert outcomes(stands, made_row("mujoco", 900.0, 900.0, states=states))["damage"] == outcome


def test_the_share_counts_what_lies_outside_both_estimates() -> None:
    rows = [
        *(made_row(engine, 1.0, 2.0, scene="still") for engine in ENGINES),
        # Equal, but nearer to the limit than the estimate: no evidence.
        *(made_row(engine, 1.0, 99.5, scene="close") for engine in ENGINES),
        made_row("bullet", 1.0, 90.0, scene="differ"),
        made_row("mujoco", 1.0, 180.0, scene="differ"),
        made_row("bullet", 1.0, 2.0, scene="alone"),
    ]
    found = summary(rows)
    assert (found["scenes"], found["verdicts"], found["agreeing"], found["disagreeing"]) == (3, 9, 8, 1)
    assert (found["outside"], found["outside_agreeing"]) == (8, 7)
    assert found["share"] == pytest.approx(7 / 8) and not found["is_met"]
    assert (found["both_pass"], found["pass_against_fail"]) == (2, 1)
    # Of the limits 50 and 100 mm, 99.5 and 90 and 180 are within a factor of three; 99.5 is inside its estimate.
    assert (found["near_limit"], found["near_limit_agreeing"]) == (1, 0)
    assert (found["displacements"], found["displacements_within_estimates"]) == (6, 5)
    (differing,) = found["disagreements"]
    assert (differing["scene"], differing["rule"]) == ("differ", "elastic")
    assert differing["mujoco"]["worst_mm"] == 180.0 and differing["bullet"]["error_mm"] == 1.0


def test_a_run_leaves_its_files_and_runs_only_what_is_missing(tmp_path: Path) -> None:
    calls: list[tuple[int, int]] = []
    run_agreement(tmp_path, quick=True, on_progress=lambda done, total, _: calls.append((done, total)))
    assert calls == [(done, 10) for done in range(11)]
    path = tmp_path / "agreement.json"
    stored = json.loads(path.read_text(encoding="utf-8"))
    assert stored["summary"]["scenes"] == 5
    assert stored["summary"]["verdicts"] == 20
    assert stored["summary"]["disagreeing"] == 0
    assert stored["summary"]["both_pass"] >= 1 and stored["summary"]["both_fail"] >= 1
    ElementTree.fromstring((tmp_path / "agreement.svg").read_text(encoding="utf-8"))

    stored["rows"][3]["key"] = "another version"
    stored["other_rows"] = [{**stored["rows"][0], "key": "other", "scene": "of_the_full_grid"}]
    path.write_text(json.dumps(stored), encoding="utf-8")
    calls.clear()
    run_agreement(tmp_path, quick=True, on_progress=lambda done, total, _: calls.append((done, total)))
    assert calls == [(9, 10), (10, 10)]
    again = json.loads(path.read_text(encoding="utf-8"))
    timeless = {"key": None, "wall_s": None, "companion_wall_s": None}
    assert [{**row, **timeless} for row in again["rows"]] == [{**row, **timeless} for row in stored["rows"]]
    assert again["other_rows"] == stored["other_rows"]
    assert not list(tmp_path.glob("*.part"))


def test_the_table_has_a_line_a_row(tmp_path: Path) -> None:
    rows = [made_row("bullet", 1.0, 90.0), made_row("mujoco", 1.0, 180.0, error_mm={}, problem="why")]
    write_table(rows, tmp_path / "rows.csv")
    with (tmp_path / "rows.csv").open(encoding="utf-8") as stream:
        lines = list(csv.DictReader(stream))
    assert [line["engine"] for line in lines] == list(ENGINES)
    assert [line["states_elastic"] for line in lines] == ["pass", "fail"]
    assert [line["error_mm_elastic"] for line in lines] == ["1.0", ""]


def test_a_scene_is_drawn_by_its_worst_rule() -> None:
    still, moved = made_row("bullet", 1.0, 2.0), made_row("mujoco", 1.0, 180.0)

    def look(first: Row, second: Row) -> str:
        return look_of([Compared(first, second, rule) for rule in first.states])

    assert look(still, replace(still, engine="mujoco")) == "pass"
    assert look(replace(moved, engine="bullet"), moved) == "fail"
    assert look(still, moved) == "differ"
    assert look(replace(still, error_mm={}), moved) == "open"


def test_the_figure_is_the_same_bytes_twice_and_stands_alone() -> None:
    rows = [made_row("bullet", 0.0, 90.0), made_row("mujoco", 1.0, 180.0)]
    figure = agreement_figure(rows, summary(rows))
    assert figure == agreement_figure(rows, summary(rows))
    assert "differ" in figure and "2 of 3 verdicts" in figure
    root = ElementTree.fromstring(standalone_svg(figure))
    assert root.tag == "{http://www.w3.org/2000/svg}svg"
