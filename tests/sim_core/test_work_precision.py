"""Which engine and step a scene is given, from a table of error against run time."""

import json
import math
from collections.abc import Callable
from dataclasses import asdict, replace
from math import gcd
from pathlib import Path
from typing import Any, get_args

import pytest

from config.scene import Scene, Solver
from config.scene_file import find_scene, read_scene, scene_from_json, validate_scene
from sim_core.judge import EumosJudge
from sim_core.run import TestResult, run_test
from sim_core.work_precision import (
    SceneKind,
    TableRow,
    installed_engines,
    scene_kind,
    shipped_table,
    with_setting,
    write_table,
)
from tests.sim_core.scenes import GRAVITY, block_scene

MakeScene = Callable[..., Scene]
Box = Callable[..., dict[str, Any]]

SLIDING = (
    TableRow("sliding", "bullet", 240, 20, 0.8, 0.05, "impact"),
    TableRow("sliding", "bullet", 480, 40, 0.3, 0.10, "impact"),
    TableRow("sliding", "bullet", 960, 40, 0.2, 0.20, "five slabs"),
    TableRow("sliding", "mujoco", 240, 40, 0.9, 0.02, "impact"),
    TableRow("sliding", "mujoco", 960, 40, 0.25, 0.08, "impact"),
)
TABLE = (
    *SLIDING,
    TableRow("resting", "bullet", 960, 80, 0.4, 0.40, "40 cartons"),
    TableRow("resting", "mujoco", 480, 40, 0.1, 0.10, "40 cartons"),
)


def asking(name: str = "block_slip", **solver: Any) -> Scene:
    scene = read_scene(find_scene(name))
    return validate_scene({**scene.model_dump(), "solver": solver})


def with_level(scene: Scene, level_g: float) -> Scene:
    return validate_scene({**scene.model_dump(), "sled": {**scene.sled.model_dump(), "level_g": level_g}})


def chosen(scene: Scene, table: tuple[TableRow, ...] = TABLE) -> tuple[str, int, int]:
    solver = with_setting(scene, table)[0].solver
    assert solver.time_step_s is not None and solver.iterations is not None
    return solver.engine, round(1.0 / solver.time_step_s), solver.iterations


# What a scene asks of an engine.


def test_what_presses_is_pressed_whatever_else() -> None:
    assert scene_kind(read_scene(find_scene("eur_fields_05g"))) == "pressed"


@pytest.mark.parametrize(
    ("level_g", "kind"), [(0.0, "resting"), (0.4999, "resting"), (0.5, "sliding"), (0.8, "sliding")]
)
def test_what_stays_below_its_friction_rests(level_g: float, kind: str) -> None:
    assert scene_kind(block_scene(level_g=level_g, friction=0.5, size_m=(0.4, 0.3, 0.25))) == kind
    braked = block_scene(level_g=-level_g, friction=0.5, size_m=(0.4, 0.3, 0.25))
    assert scene_kind(braked) == kind


def test_only_surfaces_that_touch_count(make_scene: MakeScene, box: Box) -> None:
    pairs = [
        {"between": ["cardboard", "wood"], "friction": 0.6},
        {"between": ["film", "wood"], "friction": 0.1},
        {"between": ["cardboard", "film"], "friction": 0.6},
        {"between": ["film", "film"], "friction": 0.1},
    ]
    packages = box("a"), box("b", bottom=0.394, surface="film")
    parts = {"surfaces": {"pairs": pairs}, "sled": {"profile": "eumos", "level_g": 0.3}}
    # Film never lies on wood or on film here.
    assert scene_kind(make_scene(*packages, **parts)) == "resting"
    pairs[2]["friction"] = 0.2
    assert scene_kind(make_scene(*packages, **parts)) == "sliding"


def test_a_recorded_sled_counts_with_its_peak(make_scene: MakeScene, box: Box) -> None:
    for peak_g, kind in ((0.2, "resting"), (0.8, "sliding")):
        samples = [(0.0, 0.0, 0.0), (0.0, peak_g * GRAVITY, 0.0), (0.0, -peak_g * GRAVITY, 0.0)]
        scene = make_scene(box("a"), sled={"profile": "recorded", "samples_mps2": samples})
        assert scene_kind(scene) == kind


def test_an_empty_pallet_has_a_setting(make_scene: MakeScene) -> None:
    scene, _ = with_setting(make_scene(solver={"engine": "auto"}), TABLE)
    assert scene.solver.engine in installed_engines()


# Which setting it is given.


@pytest.mark.parametrize(
    ("solver", "setting"),
    [
        ({"engine": "bullet", "tolerance_mm": 0.8}, ("bullet", 240, 20)),
        ({"engine": "bullet", "tolerance_mm": 0.5}, ("bullet", 480, 40)),
        ({"engine": "bullet", "tolerance_mm": 0.2}, ("bullet", 960, 40)),
        ({"engine": "mujoco", "tolerance_mm": 0.5}, ("mujoco", 960, 40)),
        ({"engine": "auto", "tolerance_mm": 0.5}, ("mujoco", 960, 40)),
        ({"engine": "auto", "tolerance_mm": 0.2}, ("bullet", 960, 40)),
        # Without a tolerance of its own: 1 mm.
        ({"engine": "auto"}, ("mujoco", 240, 40)),
    ],
)
def test_the_cheapest_inside_the_tolerance(solver: dict[str, Any], setting: tuple[str, int, int]) -> None:
    scene = asking(**solver)
    assert chosen(scene) == setting
    given, why = with_setting(scene, TABLE)
    assert why.startswith("the cheapest setting inside ") and "for sliding loads" in why
    assert "{} at 1/{} s × {}".format(*setting) in why
    # The tolerance stays, nothing else changes, and the scene is one that a file may hold.
    assert given.solver.tolerance_mm == scene.solver.tolerance_mm
    assert given.model_copy(update={"solver": scene.solver}) == scene
    assert scene_from_json(given.to_json()) == given
    assert with_setting(given, TABLE) == (given, "as the scene says")


def test_the_nearest_where_none_is_inside() -> None:
    scene = asking(engine="auto", tolerance_mm=0.1)
    assert chosen(scene) == ("bullet", 960, 40)
    why = with_setting(scene, TABLE)[1]
    assert why == "no setting is inside 0.1 mm for sliding loads; the nearest: bullet at 1/960 s × 40"


def test_each_kind_has_rows_of_its_own() -> None:
    resting = with_level(asking("eur_columns", engine="auto", tolerance_mm=0.5), 0.1)
    assert chosen(resting) == ("mujoco", 480, 40)


@pytest.mark.parametrize(("asked", "given"), [("bullet", "bullet"), ("mujoco", "mujoco"), ("auto", "bullet")])
def test_pressed_loads_begin_at_the_default_step(asked: str, given: str) -> None:
    scene, why = with_setting(asking("eur_fields_05g", engine=asked, tolerance_mm=0.5), TABLE)
    assert scene.solver == Solver.model_validate({"engine": given, "tolerance_mm": 0.5})
    assert scene.time_step_s == 1.0 / 480.0 and why.startswith("pressed loads: no step is known")


@pytest.mark.parametrize(
    "solver",
    [
        {},
        {"engine": "mujoco"},
        {"time_step_s": 1.0 / 240.0, "tolerance_mm": 0.5},
        {"iterations": 7, "tolerance_mm": 0.5},
        {"engine": "mujoco", "time_step_s": 1.0 / 240.0, "iterations": 7},
    ],
)
def test_explicit_settings_and_defaults_stand(solver: dict[str, Any]) -> None:
    scene = asking(**solver)
    is_open = set(solver) <= {"engine"}
    assert with_setting(scene, TABLE) == (scene, "the default setting" if is_open else "as the scene says")


def test_a_step_between_pose_frames_is_not_chosen() -> None:
    scene = asking(engine="bullet", tolerance_mm=0.8)
    dense = validate_scene({**scene.model_dump(), "sampling": {"samples_hz": 960, "poses_hz": 480}})
    assert chosen(dense) == ("bullet", 480, 40)


@pytest.mark.parametrize("table", [(), (replace(SLIDING[0], rate_hz=100),)])
def test_where_nothing_fits_the_default_step_is_left(table: tuple[TableRow, ...]) -> None:
    given, why = with_setting(asking(engine="auto", tolerance_mm=0.5), table)
    assert given.solver == Solver(engine="bullet", tolerance_mm=0.5)
    assert given.time_step_s == 1.0 / 480.0 and "no setting of the table fits" in why


def slip_mm(result: TestResult) -> float:
    judge: EumosJudge = result.judge
    return judge.packages()[0].peak_mm


@pytest.mark.parametrize("tolerance_mm", [0.5, 0.2])
def test_the_setting_is_what_runs_and_keeps_the_tolerance(tolerance_mm: float) -> None:
    given, _ = with_setting(asking(engine="auto", tolerance_mm=tolerance_mm), TABLE)
    result = run_test(given)
    assert result.physics.engine == given.solver.engine == ("mujoco" if tolerance_mm == 0.5 else "bullet")
    assert result.physics.smallest_step_s == pytest.approx(1.0 / 960.0)
    assert slip_mm(result) == pytest.approx(467.49964, abs=tolerance_mm)


# The table.


def test_a_table_is_written_whole_and_read_again(tmp_path: Path) -> None:
    path = tmp_path / "table.json"
    write_table(TABLE, path)
    assert tuple(TableRow(**row) for row in json.loads(path.read_text())["rows"]) == TABLE
    assert path.read_text().count("\n") == len(TABLE) + 2
    write_table((), path)
    assert json.loads(path.read_text()) == {"rows": []}
    assert [entry.name for entry in tmp_path.iterdir()] == ["table.json"]


def test_the_shipped_table_serves_every_kind_but_the_pressed() -> None:
    rows = shipped_table()
    assert {row.kind for row in rows} == set(get_args(SceneKind)) - {"pressed"}
    assert {row.engine for row in rows} == {"bullet", "mujoco"}
    assert len({(row.kind, row.engine, row.rate_hz, row.iterations) for row in rows}) == len(rows)
    base = asking().model_dump()
    for row in rows:
        assert all(math.isfinite(value) and value > 0.0 for value in (row.error_mm, row.cost)), row
        assert row.case
        sampling = {"samples_hz": row.rate_hz, "poses_hz": gcd(row.rate_hz, 240)}
        solver = {"engine": row.engine, "time_step_s": 1.0 / row.rate_hz, "iterations": row.iterations}
        scene = validate_scene({**base, "sampling": sampling, "solver": solver})
        assert scene.steps_and_samples() == (1, 1), asdict(row)


@pytest.mark.parametrize(("name", "level_g"), [("eur_columns", 0.1), ("block_slip", None)])
@pytest.mark.parametrize("engine", ["bullet", "auto"])
def test_the_shipped_table_has_a_setting_for_a_scene_as_shipped(
    name: str, level_g: float | None, engine: str
) -> None:
    scene = asking(name, engine=engine, tolerance_mm=1.0)
    if level_g is not None:
        scene = with_level(scene, level_g)
    given, why = with_setting(scene)
    assert why.startswith("the cheapest setting inside 1 mm for ")
    assert given.solver.time_step_s is not None
    assert given.solver.engine in (installed_engines() if engine == "auto" else ["bullet"])
