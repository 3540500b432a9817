"""Displacement measured from a recording's pictures, beside its poses: in a run, in a graph, and afterwards."""

import json
from pathlib import Path

import numpy as np
import pytest
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import PointCloud2

from msgs_adapters.vision_payloads import FIELDS
from tests.ros_nodes.graph import environment, missing_of, pallet_twin, payloads

PARTS = (
    "--set", "camera.width_px=960", "--set", "camera.height_px=540", "--set", "camera.rate_hz=15",
    "--set", "camera.measure=true", "--no-estimate",
)  # fmt: skip


@pytest.fixture(scope="module")
def ran(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("measured")
    done = pallet_twin("run", "eur_camera_markers", *PARTS, "--out", "run", cwd=folder)
    if "no OpenGL" in done.stderr:
        pytest.skip("no OpenGL here: TinyRenderer draws no targets")
    assert done.returncode == 0, done.stderr
    return folder


def test_markers_are_measured_to_a_millimetre(ran: Path) -> None:
    done = pallet_twin("measure", "run/bag", "--json", "--video", "measured.mp4", cwd=ran)
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert told["points"] > 1000 and told["rms_error_mm"] < 1.5 and told["coverage"] > 0.9
    assert told["verdict"] == told["truth"]["verdict"] == "fail"
    true = {rule["rule"]: rule["worst_mm"] for rule in told["truth"]["rules"]}
    for rule in told["rules"]:
        assert abs(rule["worst_mm"] - true[rule["rule"]]) <= rule["error_mm"], rule["rule"]
    assert told["elastic_mm"] == next(r["worst_mm"] for r in told["rules"] if r["rule"] == "elastic")
    assert any("towards the camera" in line for line in told["unseen"])
    assert (ran / "measured.mp4").stat().st_size > 10_000
    shown = pallet_twin("measure", "run/bag", "--require", "pass", cwd=ran)
    assert shown.returncode == 4 and "RMS error" in shown.stdout and "by its pictures: FAIL" in shown.stdout


def test_report_holds_what_the_pictures_say(ran: Path) -> None:
    report = json.loads((ran / "run" / "report.json").read_text())
    assert report["vision"]["verdict"] == report["verdict"] == "fail"
    assert "Measured from the pictures alone: fail" in (ran / "run" / "report.html").read_text()


def test_graph_measures_as_a_run_does(ran: Path) -> None:
    done = pallet_twin("up", "eur_camera_markers", *PARTS, "--out", "up", cwd=ran, env=environment())
    assert done.returncode == 0, done.stderr
    for topic in ("vision/displacement", "vision/report", "camera/image_raw/compressed"):
        graph, headless = (payloads(ran / name / "bag", f"/twin/{topic}") for name in ("up", "run"))
        assert graph and graph == headless, topic
    assert list(missing_of(ran / "up" / "bag")) == []
    cloud = deserialize_message(payloads(ran / "up" / "bag", "/twin/vision/displacement")[-1], PointCloud2)
    assert [field.name for field in cloud.fields] == list(FIELDS) and cloud.width == 5
    points = np.frombuffer(bytes(cloud.data), "<f4").reshape(cloud.height, 5, len(FIELDS))
    # The lowest layer slid back by 65 mm.
    assert np.nanmin(points[:, :, 3]) < -0.06 and np.nanmax(points[:, :, 5]) < 0.01


def test_recording_without_pictures_is_refused(tmp_path: Path) -> None:
    assert pallet_twin("run", "block_slip", "--no-estimate", "--out", "o", cwd=tmp_path).returncode == 0
    done = pallet_twin("measure", "o/bag", cwd=tmp_path)
    assert done.returncode == 2 and "camera_info" in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
