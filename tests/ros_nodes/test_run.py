"""One test in one process, as a user runs it."""

import json
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from config.scene_file import find_scene
from recordings.judge_bag import judge_bag
from sim_core.report import judgement, report_json
from tests.ros_nodes.graph import (
    HEAVY_ON_LIGHT,
    environment,
    pallet_twin,
    payloads,
    start,
    wait_until_recording,
)


def test_run_leaves_report_page_and_bag(tmp_path: Path) -> None:
    done = pallet_twin("run", "block_slip", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    folder = tmp_path / "runs" / "block_slip"
    assert sorted(path.name for path in folder.iterdir()) == ["bag", "report.html", "report.json"]
    assert "block_slip: FAIL" in done.stdout
    assert "worst package block" in done.stdout
    for name in ("report.json", "report.html", "bag"):
        assert str(Path("runs") / "block_slip" / name) in done.stdout
    # The scene's verdict is a result, not an error; a second run takes the next folder.
    assert pallet_twin("run", "block_slip", "--no-bag", cwd=tmp_path).returncode == 0
    assert (tmp_path / "runs" / "block_slip-2" / "report.json").exists()


def test_json_is_the_report(tmp_path: Path) -> None:
    done = pallet_twin("run", "block_slip", "--json", "--no-bag", "--out", "here", cwd=tmp_path)
    printed = json.loads(done.stdout)
    written = json.loads((tmp_path / "here" / "report.json").read_text())
    printed.pop("paths")
    assert printed == written
    assert done.stderr == ""


def test_required_verdict_gives_its_own_code(tmp_path: Path) -> None:
    assert pallet_twin("run", "block_slip", "--no-bag", "--require", "pass", cwd=tmp_path).returncode == 4
    assert pallet_twin("run", "empty_pallet", "--no-bag", "--require", "pass", cwd=tmp_path).returncode == 0


def test_bag_is_judged_again_with_the_same_words(tmp_path: Path) -> None:
    assert pallet_twin("run", "slabs", "--out", "out", "--no-estimate", cwd=tmp_path).returncode == 0
    bag = tmp_path / "out" / "bag"
    done = pallet_twin("judge", str(bag), "--json", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    scene, judge = judge_bag(bag)
    # The judgement in the bag, the one from its poses, and what the command prints are one.
    assert done.stdout == report_json(judgement(scene, judge)) + "\n"
    live = payloads(bag, "/twin/eumos/report")[0]
    assert report_json(judgement(scene, judge), compact=True).encode() in live


def test_same_scene_gives_the_same_bag(tmp_path: Path) -> None:
    for name in ("a", "b"):
        assert pallet_twin("run", "block_slip", "--out", name, "--no-estimate", cwd=tmp_path).returncode == 0
    first, second = (tmp_path / name / "bag" / "bag_0.mcap" for name in ("a", "b"))
    assert first.read_bytes() == second.read_bytes()


TIGHT = ("--set", "solver.tolerance_mm=0.06", "--set", "solver.iterations=40")
FINER = ("--set", "solver.time_step_s=0.0010416666666666667", "--set", "solver.iterations=40")


def test_a_tolerance_leaves_the_bag_of_the_last_attempt_alone(tmp_path: Path) -> None:
    # A block on the brink of tipping: its estimate is 1.9 mm at the default step and 0.05 mm at half of it.
    done = pallet_twin("run", "block_tip", *TIGHT, "--out", "kept", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    explicit = pallet_twin("run", "block_tip", *FINER, "--out", "finer", "--no-estimate", cwd=tmp_path)
    assert explicit.returncode == 0, explicit.stderr
    bags = [tmp_path / name / "bag" for name in ("kept", "finer")]
    assert [sorted(path.name for path in bag.iterdir()) for bag in bags] == [
        ["bag_0.mcap", "metadata.yaml"]
    ] * 2
    first, second = (payloads(bag, "/twin/packages/poses") for bag in bags)
    assert first == second
    assert len(payloads(bags[0], "/twin/scene")) == len(payloads(bags[0], "/twin/eumos/report")) == 1
    report = json.loads((tmp_path / "kept" / "report.json").read_text())
    numerics = report["numerics"]
    assert numerics["time_step_s"] == numerics["smallest_step_s"] == pytest.approx(1.0 / 960.0)
    assert numerics["within_tolerance"] and numerics["error_estimate_mm"] <= 0.06
    assert [text.split(":")[0] for text in numerics["refinements"]] == ["1/480 s"]
    scene, judge = judge_bag(bags[0])
    assert scene.time_step_s == pytest.approx(1.0 / 960.0) and scene.solver.tolerance_mm == 0.06
    again = judgement(scene, judge)
    assert json.loads(report_json(again))["series"] == report["series"]
    assert again["scene_sha256"] == report["scene_sha256"]


def test_engine_auto_says_what_it_chose(tmp_path: Path) -> None:
    done = pallet_twin("run", "block_slip", "--set", "solver.engine=auto", "--no-bag", "--no-page", "--out", "out",
                       "--json", cwd=tmp_path)  # fmt: skip
    assert done.returncode == 0, done.stderr
    report = json.loads(done.stdout)
    assert report["numerics"]["engine"] in report["numerics"]["setting_chosen"].split()
    slips = {rule["rule"]: rule["worst_mm"] for rule in report["rules"]}
    # Without a tolerance of its own: 1 mm.
    assert slips["permanent"] == pytest.approx(467.49964, abs=1.0)
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["report.json"]


def test_interrupt_leaves_a_whole_bag(tmp_path: Path) -> None:
    process = start("run", "eur_fields_08g", "--out", "out", cwd=tmp_path, env=environment())
    wait_until_recording(tmp_path / "out" / "bag")
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=20)
    assert process.returncode == 130
    assert "interrupted" in errors and "Traceback" not in errors
    assert pallet_twin("check", "out/bag", cwd=tmp_path).returncode == 0


def test_monitor_ends_the_run_with_partial_results(tmp_path: Path) -> None:
    (tmp_path / "scene.json").write_text(json.dumps(HEAVY_ON_LIGHT))
    done = pallet_twin("run", "scene.json", "--out", "out", "--no-estimate", cwd=tmp_path)
    assert done.returncode == 3, done.stdout
    assert "ended by monitor" in done.stderr and "Traceback" not in done.stderr
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert report["verdict"] == "unresolved"
    assert "ended by monitor" in report["numerics"]["ended_by"]


@pytest.mark.parametrize("module", ["sim_core.run", "ros_nodes.cli"])
def test_import_loads_only_what_a_scene_needs(module: str) -> None:
    probe = (
        f"import sys, {module}; "
        "print([m for m in ('rclpy', 'torch', 'cv2', 'rerun', 'pyvista', 'numba', 'matplotlib') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", probe], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_help_teaches(tmp_path: Path) -> None:
    done = pallet_twin("--help", cwd=tmp_path)
    assert done.returncode == 0
    for command in ("run", "up", "check", "judge", "schema", "scenes"):
        assert command in done.stdout
    assert "Exit codes" in done.stdout


def test_recorded_sled_repeats_the_recorded_test(tmp_path: Path) -> None:
    assert pallet_twin("run", "slabs", "--out", "first", "--no-estimate", cwd=tmp_path).returncode == 0
    scene = json.loads(find_scene("slabs").read_text())
    scene["sled"] = {"profile": "recorded", "bag": "first/bag"}
    (tmp_path / "replay.json").write_text(json.dumps(scene))
    done = pallet_twin("run", "replay.json", "--out", "second", "--no-estimate", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    first, second = (
        payloads(tmp_path / name / "bag", "/twin/packages/poses") for name in ("first", "second")
    )
    # The recording ends when the load rests, so its replay takes that as the stop and watches a little longer.
    assert second[: len(first)] == first
