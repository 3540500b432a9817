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
    SpacingRow,
    TableRow,
    film_spacing,
    installed_engines,
    scene_kind,
    shipped_spacings,
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
    TableRow("wrapped", "bullet", 480, 100, 0.8, 4.0, "wrapped cartons"),
    TableRow("wrapped", "bullet", 960, 100, 0.3, 7.0, "wrapped cartons"),
    TableRow("wrapped", "mujoco", 240, 20, 0.2, 1.0, "wrapped cartons"),
    TableRow("wrapped", "mujoco", 960, 20, 0.1, 2.0, "wrapped cartons"),
)
SPACINGS = (
    SpacingRow(0.2, 1.8, "wrapped cartons"),
    SpacingRow(0.1, 0.7, "wrapped cartons"),
    SpacingRow(0.05, 0.1, "wrapped cartons"),
)
FILM = {"material": "stretch_film_20", "turns": 3}


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
    fields = read_scene(find_scene("eur_fields_05g"))
    assert scene_kind(fields) == "pressed"
    for coupling in ("one_way", "two_way"):
        both = validate_scene({**fields.model_dump(), "wrap": {**FILM, "coupling": coupling}})
        assert scene_kind(both) == "pressed"


def wrapped(solver: dict[str, Any], **wrap: Any) -> Scene:
    scene = read_scene(find_scene("eur_columns"))
    return validate_scene({**scene.model_dump(), "solver": solver, "wrap": {**FILM, **wrap}})


def test_what_a_film_holds_is_wrapped_and_what_it_only_follows_is_not() -> None:
    bare = scene_kind(read_scene(find_scene("eur_columns")))
    assert scene_kind(wrapped({})) == "wrapped"
    assert scene_kind(wrapped({}, coupling="one_way")) == bare
    assert scene_kind(wrapped({}, turns=0)) == bare


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
    ("tolerance_mm", "spacing_m"), [(5.0, 0.2), (1.8, 0.2), (1.0, 0.1), (0.3, 0.05), (0.05, 0.05)]
)
def test_the_coarsest_mesh_inside_a_tolerance(tolerance_mm: float, spacing_m: float) -> None:
    row = film_spacing(tolerance_mm, SPACINGS)
    assert row is not None and row.spacing_m == spacing_m
    assert film_spacing(tolerance_mm, ()) is None


@pytest.mark.parametrize(
    ("solver", "setting", "spacing_m"),
    [
        # Without a tolerance of its own: 1 mm for the engine, and the film's own mesh.
        ({"engine": "auto"}, ("mujoco", 240, 20), None),
        # The mesh of 0.1 m takes 0.7 of 1 mm, and the engine has 0.3 mm.
        ({"engine": "auto", "tolerance_mm": 1.0}, ("mujoco", 240, 20), 0.1),
        ({"engine": "bullet", "tolerance_mm": 1.0}, ("bullet", 960, 100), 0.1),
        ({"engine": "bullet", "tolerance_mm": 1.5}, ("bullet", 480, 100), 0.1),
        ({"engine": "auto", "tolerance_mm": 0.25}, ("mujoco", 960, 20), 0.05),
    ],
)
def test_a_wrapped_load_shares_its_tolerance_between_mesh_and_engine(
    solver: dict[str, Any], setting: tuple[str, int, int], spacing_m: float | None
) -> None:
    if setting[0] not in installed_engines():
        pytest.skip("MuJoCo is not installed")
    scene = wrapped(solver)
    given, why = with_setting(scene, TABLE, SPACINGS)
    assert (given.solver.engine, round(1.0 / given.time_step_s), given.iterations) == setting
    assert given.wrap is not None and given.wrap.spacing_m == spacing_m
    assert "for wrapped loads: {} at 1/{} s × {}".format(*setting) in why
    if spacing_m is not None:
        assert f"; of {solver['tolerance_mm']:g} mm the film's mesh of {spacing_m:g} m takes " in why
    # The scene is one that a file may hold, and nothing in it is left open.
    assert scene_from_json(given.to_json()) == given
    assert with_setting(given, TABLE, SPACINGS) == (given, "as the scene says")


def test_a_mesh_that_no_tolerance_allows_is_the_finest() -> None:
    given, why = with_setting(wrapped({"tolerance_mm": 0.1}), TABLE, SPACINGS)
    assert given.wrap is not None and given.wrap.spacing_m == 0.05
    assert why.startswith("no setting is inside 0.025 mm for wrapped loads") and why.endswith(
        ", the finest there is"
    )


def test_a_mesh_of_the_scenes_own_stands() -> None:
    given, why = with_setting(wrapped({"tolerance_mm": 1.0}, spacing_m=0.3), TABLE, SPACINGS)
    assert given.wrap is not None and given.wrap.spacing_m == 0.3 and "mesh" not in why
    assert round(1.0 / given.time_step_s) == 480


def test_a_film_that_only_follows_keeps_its_mesh() -> None:
    given, why = with_setting(wrapped({"tolerance_mm": 1.0}, coupling="one_way"), TABLE, SPACINGS)
    assert given.wrap is not None and given.wrap.spacing_m is None and "mesh" not in why


def test_an_explicit_step_leaves_the_mesh_to_the_tolerance() -> None:
    given, why = with_setting(wrapped({"tolerance_mm": 0.2, "time_step_s": 1.0 / 960.0}), TABLE, SPACINGS)
    assert given.wrap is not None and given.wrap.spacing_m == 0.05
    assert given.time_step_s == 1.0 / 960.0 and why.startswith("as the scene says; of 0.2 mm the film's mesh")


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
    write_table(TABLE, path, SPACINGS)
    stored = json.loads(path.read_text())
    assert tuple(TableRow(**row) for row in stored["rows"]) == TABLE
    assert tuple(SpacingRow(**row) for row in stored["film_spacings"]) == SPACINGS
    assert path.read_text().count("\n") == len(TABLE) + len(SPACINGS) + 4
    write_table((), path)
    assert json.loads(path.read_text()) == {"rows": [], "film_spacings": []}
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


def test_the_shipped_meshes_are_better_the_finer_they_are() -> None:
    rows = shipped_spacings()
    assert len(rows) >= 3
    assert [row.spacing_m for row in rows] == sorted({row.spacing_m for row in rows}, reverse=True)
    assert [row.error_mm for row in rows] == sorted({row.error_mm for row in rows}, reverse=True)
    assert all(0.0 < row.error_mm < 5.0 for row in rows)
    # What is meshed without a tolerance is inside what the page promises of it.
    coarser = [row for row in rows if row.spacing_m >= 0.1]
    assert coarser[-1].error_mm <= 2.0


@pytest.mark.parametrize(("engine", "setting"), [("auto", ("mujoco", 240)), ("bullet", ("bullet", 480))])
def test_the_shipped_table_has_a_setting_for_wrapped_loads(engine: str, setting: tuple[str, int]) -> None:
    if setting[0] not in installed_engines():
        pytest.skip("MuJoCo is not installed")
    given, why = with_setting(wrapped({"engine": engine, "tolerance_mm": 1.0}, spacing_m=0.1))
    assert (given.solver.engine, round(1.0 / given.time_step_s)) == setting
    assert why.startswith("the cheapest setting inside 1 mm for wrapped loads: ")
    assert given.iterations >= (100 if setting[0] == "bullet" else 20)


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
