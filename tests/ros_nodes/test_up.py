"""The node graph: the same bytes as in one process, nothing lost, and a clear end when a node dies."""

import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.ros_nodes.graph import (
    HEAVY_ON_LIGHT,
    counts,
    environment,
    kill,
    missing_of,
    node_pids,
    pallet_twin,
    payloads,
    start,
    wait_until_recording,
)

SCENE = "eur_fields_05g"
SMALL = ("--set", "load.layers=2")


def test_graph_gives_the_bytes_of_a_run(tmp_path: Path) -> None:
    up = pallet_twin("up", SCENE, *SMALL, "--out", "up", "--no-estimate", cwd=tmp_path)
    assert up.returncode == 0, up.stderr
    for name in ("run", "again"):
        done = pallet_twin("run", SCENE, *SMALL, "--out", name, "--no-estimate", cwd=tmp_path)
        assert done.returncode == 0, done.stderr
    bags = [tmp_path / name / "bag" for name in ("up", "run", "again")]
    for topic in ("packages/poses", "eumos/status", "eumos/report", "scene", "robot_description"):
        first, *others = (payloads(bag, f"/twin/{topic}") for bag in bags)
        assert first and all(other == first for other in others), topic
    # The sled runs a bounded window ahead of the physics, so its streams may go on for some samples more.
    for topic in ("sled/acceleration", "sled/odometry", "sled/accelerometer"):
        graph, headless, _ = (payloads(bag, f"/twin/{topic}") for bag in bags)
        assert graph[: len(headless)] == headless, topic
    assert list(missing_of(bags[0])) == []
    reports = [json.loads((tmp_path / name / "report.json").read_text()) for name in ("up", "run")]
    assert [reports[0][key] for key in ("verdict", "rules", "packages", "series")] == [
        reports[1][key] for key in ("verdict", "rules", "packages", "series")
    ]
    assert reports[0]["numerics"]["mode"] == "up fast"


def test_graph_takes_the_step_that_keeps_the_tolerance(tmp_path: Path) -> None:
    tight = ("--set", "solver.tolerance_mm=0.06", "--set", "solver.iterations=40")
    for command in ("up", "run"):
        done = pallet_twin(command, "block_tip", *tight, "--out", command, cwd=tmp_path)
        assert done.returncode == 0, done.stderr
    poses = [payloads(tmp_path / name / "bag", "/twin/packages/poses") for name in ("up", "run")]
    assert poses[0] == poses[1]
    reports = [json.loads((tmp_path / name / "report.json").read_text()) for name in ("up", "run")]
    for key in ("time_step_s", "refinements", "setting_chosen", "error_estimate_mm", "within_tolerance"):
        assert reports[0]["numerics"][key] == reports[1]["numerics"][key], key
    assert len(reports[0]["numerics"]["refinements"]) == 1
    assert reports[0]["scene_sha256"] == reports[1]["scene_sha256"]


# An independent reader: its own process, deserialised messages, another executor than the recorder's.
READER = """
import sys, time, rclpy, rclpy.executors
from rclpy.qos import QoSProfile, ReliabilityPolicy
from geometry_msgs.msg import AccelStamped, PoseArray
from nav_msgs.msg import Odometry
from sensor_msgs.msg import Imu
rclpy.init()
node = rclpy.create_node("reader", namespace="/twin")
stamps = {}
def listen(kind, topic):
    stamps[topic] = []
    take = lambda m, s=stamps[topic]: s.append(m.header.stamp.sec * 10**9 + m.header.stamp.nanosec)
    node.create_subscription(kind, topic, take, QoSProfile(depth=20000, reliability=ReliabilityPolicy.RELIABLE))
for kind, topic in ((AccelStamped, "sled/acceleration"), (Imu, "sled/accelerometer"),
                    (Odometry, "sled/odometry"), (PoseArray, "packages/poses")):
    listen(kind, topic)
executor = rclpy.executors.SingleThreadedExecutor()
executor.add_node(node)
last = time.monotonic()
total = 0
while time.monotonic() - last < (4.0 if total else 60.0):
    executor.spin_once(timeout_sec=0.2)
    now = sum(map(len, stamps.values()))
    if now != total:
        last, total = time.monotonic(), now
print({topic: (len(s), s == sorted(set(s))) for topic, s in stamps.items()})
"""


def test_real_pace_loses_nothing(tmp_path: Path) -> None:
    env = {**environment(), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    from importlib.resources import files

    env["FASTRTPS_DEFAULT_PROFILES_FILE"] = str(files("config").joinpath("fastdds.xml"))
    reader = subprocess.Popen([sys.executable, "-c", READER], env=env, stdout=subprocess.PIPE, text=True)
    began = time.monotonic()
    up = pallet_twin(
        "up", SCENE, "--pace", "real", "--guests", "1", "--out", "up", "--no-estimate", cwd=tmp_path, env=env
    )
    assert up.returncode == 0, up.stderr
    assert (
        time.monotonic() - began > json.loads((tmp_path / "up" / "report.json").read_text())["sled"]["stop_s"]
    )
    seen = eval(reader.communicate(timeout=60)[0])
    recorded = counts(tmp_path / "up" / "bag")
    for topic, (count, in_order) in seen.items():
        assert count == recorded[f"/twin/{topic}"] > 500, topic
        assert in_order, topic
    assert list(missing_of(tmp_path / "up" / "bag")) == []


@pytest.mark.parametrize("name", ["sled_node", "physics_node", "validator_node", "recorder_node"])
def test_killed_node_ends_the_test(tmp_path: Path, name: str) -> None:
    process = start("up", SCENE, "--pace", "real", "--out", "up", cwd=tmp_path, env=environment())
    bag = tmp_path / "up" / "bag"
    wait_until_recording(bag)
    nodes = node_pids(process.pid)
    assert set(nodes) == {"sled_node", "physics_node", "validator_node", "recorder_node"}
    began = time.monotonic()
    kill(nodes[name])
    _, errors = process.communicate(timeout=30)
    # 2 s on a quiet machine; a busy one must not fail the test.
    assert time.monotonic() - began < 10.0
    assert process.returncode == 3
    assert name in errors and "SIGKILL" in errors and "Traceback" not in errors
    done = pallet_twin("check", str(bag), cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert counts(bag)["/twin/packages/poses"] > 10
    assert pallet_twin("judge", str(bag), cwd=tmp_path).returncode == 0
    assert not any(Path(f"/proc/{pid}").exists() for pid in nodes.values())


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_signal_ends_the_graph_with_a_whole_bag(tmp_path: Path, number: signal.Signals) -> None:
    process = start("up", SCENE, "--pace", "real", "--out", "up", cwd=tmp_path, env=environment())
    bag = tmp_path / "up" / "bag"
    wait_until_recording(bag)
    nodes = node_pids(process.pid)
    process.send_signal(number)
    _, errors = process.communicate(timeout=30)
    assert process.returncode == 130
    assert "interrupted" in errors and "Traceback" not in errors
    assert pallet_twin("check", str(bag), cwd=tmp_path).returncode == 0
    assert not any(Path(f"/proc/{pid}").exists() for pid in nodes.values())


def test_graph_without_recorder(tmp_path: Path) -> None:
    done = pallet_twin("up", "block_slip", "--out", "up", "--no-record", "--no-estimate", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert sorted(path.name for path in (tmp_path / "up").iterdir()) == ["report.html", "report.json"]


def test_load_that_cannot_settle_ends_the_graph(tmp_path: Path) -> None:
    (tmp_path / "scene.json").write_text(json.dumps(HEAVY_ON_LIGHT))
    done = pallet_twin("up", "scene.json", "--out", "up", "--no-estimate", cwd=tmp_path)
    assert done.returncode == 3, done.stdout + done.stderr
    assert "ended by monitor" in done.stderr
    assert pallet_twin("check", "up/bag", cwd=tmp_path).returncode == 0


def test_killed_supervisor_takes_its_nodes_along(tmp_path: Path) -> None:
    process = start("up", SCENE, "--pace", "real", "--out", "up", cwd=tmp_path, env=environment())
    bag = tmp_path / "up" / "bag"
    wait_until_recording(bag)
    nodes = node_pids(process.pid)
    process.kill()
    process.communicate(timeout=30)
    deadline = time.monotonic() + 20.0
    while any(Path(f"/proc/{pid}/exe").exists() for pid in nodes.values()):
        assert time.monotonic() < deadline, "nodes outlive their supervisor"
        time.sleep(0.05)
    # The recorder was asked to end, so its bag is whole.
    assert pallet_twin("check", str(bag), cwd=tmp_path).returncode == 0


def test_second_twin_in_a_domain_is_refused(tmp_path: Path) -> None:
    env = environment()
    first = start("up", SCENE, "--pace", "real", "--out", "first", "--no-estimate", cwd=tmp_path, env=env)
    wait_until_recording(tmp_path / "first" / "bag", more_than=0)
    second = pallet_twin("up", "block_slip", "--out", "second", cwd=tmp_path, env=env)
    assert second.returncode == 2
    assert "another twin runs there" in second.stderr
    first.communicate(timeout=60)
    assert first.returncode == 0


@pytest.mark.parametrize("kind", ["full folder", "file"])
def test_place_that_cannot_be_recorded_into_is_refused_at_once(tmp_path: Path, kind: str) -> None:
    place = tmp_path / "there"
    if kind == "file":
        place.write_text("")
    else:
        place.mkdir()
        (place / "mine").write_text("")
    began = time.monotonic()
    done = pallet_twin("up", "block_slip", "--out", "up", "--record", "there", cwd=tmp_path)
    assert done.returncode == 2
    assert "--record = there" in done.stderr
    assert time.monotonic() - began < 15.0
    assert not (tmp_path / "up").exists()
