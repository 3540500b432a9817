"""What optional parts cost: real processes, real graphs, and nothing of what is off."""

import csv
import json
from pathlib import Path

import pytest

from config.errors import NodeDied, RefusedInput
from config.scene import Scene
from recordings.recorded_sled import load_scene
from ros_nodes.parts import PARTS, Variant, variants
from ros_nodes.parts_cost import measure_parts
from ros_nodes.parts_page import Spread, computed_graph
from ros_nodes.parts_run import run_apart
from tests.ros_nodes.graph import fresh_domain


def scene_of(*overrides: str) -> Scene:
    return load_scene("block_slip", overrides)


def named(scene: Scene, name: str) -> Variant:
    return next(row for row in variants(scene)[0] if row.name == name)


def test_rows_differ_from_bare_by_their_part_alone() -> None:
    scene = load_scene("eur_fields_05g")
    assert scene.force_fields is not None and scene.accelerometer is not None
    rows, _ = variants(scene)
    assert [row.name for row in rows[:2]] == ["bare_loop", "bare"] and rows[-1].name == "all"
    bare = named(scene, "bare").scene
    assert bare.force_fields is None and bare.accelerometer is None
    for part in PARTS:
        row = named(scene, part.name)
        changed = {key for key in Scene.model_fields if getattr(row.scene, key) != getattr(bare, key)}
        assert changed == ({part.key} if part.key else set())
        assert row.options == ((part.option,) if part.option else ())
    assert named(scene, "all").scene == scene
    assert set(named(scene, "all").options) == {"with_bag", "with_page", "with_estimate", "cross_check"}


def test_a_scene_without_a_part_gets_its_default() -> None:
    fields = named(scene_of(), "force_fields").scene.force_fields
    assert fields is not None and fields.tension == 1.0


def test_every_row_has_the_one_setting_that_a_tolerance_chooses(tmp_path: Path) -> None:
    rows, _ = variants(scene_of("solver.tolerance_mm=1", "solver.engine=auto"))
    (solver,) = {row.scene.solver for row in rows}
    assert solver.engine in ("bullet", "mujoco") and solver.time_step_s is not None
    assert solver.tolerance_mm is None
    assert run_apart(rows[1], tmp_path).ended_by is None


def test_rows_that_do_not_fit_are_told() -> None:
    _, omitted = variants(scene_of("sampling.samples_hz=240", "solver.time_step_s=0.004166666666666667"))
    assert list(omitted) == ["dense_frames"] and "multiple of poses_hz" in omitted["dense_frames"]


def test_measurement(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", fresh_domain())
    scene, told = scene_of(), []
    measure_parts(
        scene, tmp_path, repeats=1, only=["recording"],
        on_progress=lambda done, total, name: told.append((done, total, name)),
    )  # fmt: skip
    assert told[0] == (1, 7, "bare") and told[-1] == (7, 7, "recording")
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["parts.csv", "parts.json", "parts.md"]
    table = json.loads((tmp_path / "parts.json").read_text())
    rows = {row["name"]: row for row in table["rows"]}
    assert list(rows) == ["bare_loop", "bare", "recording"]
    assert rows["bare"]["loop_ratio"] == {"minimum": 1.0, "median": 1.0, "maximum": 1.0}
    assert rows["bare"]["comes_in"] == [] and "mcap" in rows["recording"]["comes_in"]
    for row in rows.values():
        assert 0.0 < row["loop_s"]["median"] < row["process_s"]["median"]
        # numpy, pydantic and PyBullet alone take 40 MB; nothing runs beside.
        assert 40.0 < row["peak_mb"] < 400.0 and row["peak_beside_mb"] == row["cpu_beside_s"] == 0.0
    assert (
        rows["bare_loop"]["module_count"] < rows["bare"]["module_count"] < rows["recording"]["module_count"]
    )
    assert [(check["part"], check["holds"]) for check in table["off_checks"]] == [("recording", True)]
    # No call for each step of the physics: those for each sample only ask whether a reading is due.
    assert table["loop_extra"]["sim_core.run:Peekable.has_next_until"]["calls"] > 1000
    assert not any("force_fields" in name or "publications" in name for name in table["loop_extra"])
    shown, computed = table["graphs"]["bare"], rows["bare"]["graph"]
    assert (
        shown["nodes"] == computed["nodes"] == ["physics_node", "sled_node", "supervisor", "validator_node"]
    )
    # Advertised, but made only while somebody looks.
    assert set(shown["topics"]) - set(computed["topics"]) == {"/twin/packages/markers"}
    with (tmp_path / "parts.csv").open(newline="") as stream:
        assert [line["row"] for line in csv.DictReader(stream)] == list(rows)
    assert "| `recording` |" in (tmp_path / "parts.md").read_text()


def test_a_part_that_is_on_is_seen(tmp_path: Path) -> None:
    fields = run_apart(named(scene_of(), "force_fields"), tmp_path / "a", traced=True)
    assert fields.calls["sim_core.force_fields:PerimeterForceFields.forces"] > 500
    estimate = run_apart(named(scene_of(), "error_estimate"), tmp_path / "b")
    assert estimate.peak_beside_mb > 40.0 and estimate.cpu_beside_s > 0.1
    page = run_apart(named(scene_of(), "report_page"), tmp_path / "c")
    assert "matplotlib" in page.modules and (tmp_path / "c" / "report.html").exists()
    assert "matplotlib" not in estimate.modules and not (tmp_path / "b" / "report.html").exists()


def test_graph_follows_the_scene() -> None:
    scene = scene_of()
    bare, recorded = computed_graph(named(scene, "bare")), computed_graph(named(scene, "recording"))
    assert set(recorded.nodes) - set(bare.nodes) == {"recorder_node"} and recorded.topics == bare.topics
    read = computed_graph(named(scene, "accelerometer"))
    assert set(read.topics) - set(bare.topics) == {"/twin/sled/accelerometer"} and read.nodes == bare.nodes


def test_spread() -> None:
    assert Spread.of([3.0, 1.0, 2.0]) == Spread(1.0, 2.0, 3.0)


def test_bad_input(tmp_path: Path) -> None:
    scene = scene_of()
    with pytest.raises(RefusedInput, match="repeats = 0: at least 1"):
        measure_parts(scene, tmp_path / "a", repeats=0)
    (tmp_path / "file").write_text("")
    with pytest.raises(RefusedInput, match=r"--out = .*file"):
        measure_parts(scene, tmp_path / "file")
    with pytest.raises(RefusedInput, match="--only = wings: must be one of bare_loop, bare, force_fields"):
        measure_parts(scene, tmp_path / "b", only=["wings"])


def test_a_run_that_ends_early_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bare = named(scene_of(), "bare")
    (tmp_path / "mine.txt").write_text("")
    with pytest.raises(RefusedInput, match="holds more than an earlier test"):
        run_apart(bare, tmp_path)
    monkeypatch.setenv("PYTHONHOME", str(tmp_path))
    with pytest.raises(NodeDied, match="run 'bare' died: exit code 1"):
        run_apart(bare, tmp_path)
