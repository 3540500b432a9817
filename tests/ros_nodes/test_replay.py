"""A replayed recording: the bytes, the verdict and the pictures that it was recorded with; halts, steps and ends."""

import json
import os
import signal
import subprocess
import sys
import threading
import time
from importlib.resources import files
from pathlib import Path

import pytest

from config.errors import RefusedInput
from recordings.bag_reader import BagReader
from ros_nodes.answer_window import AnswerWindow
from ros_nodes.replay import replay
from tests.ros_nodes.graph import environment, node_pids, pallet_twin

CAMERA = '{"width_px": 160, "height_px": 90, "rate_hz": 15}'

# As the command line does it: signals, one line and one exit code for what is refused.
REPLAY = """
import json, signal, sys
from pathlib import Path
from config.errors import PalletTwinError
from ros_nodes import entry
for number in entry.SIGNALS:
    signal.signal(number, entry._interrupt)
from ros_nodes.replay import replay, replay_lines
try:
    played = replay(Path(sys.argv[1]), **json.loads(sys.argv[2]))
    print(json.dumps({**vars(played), "bag": "", "compared": [vars(c) for c in played.compared],
                      "equal": [c.is_equal for c in played.compared], "lines": list(replay_lines(played))}))
except PalletTwinError as error:
    print(error, file=sys.stderr)
    sys.exit(error.exit_code)
"""


def start_replay(bag: Path, env: dict[str, str], **options: object) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-c", REPLAY, str(bag), json.dumps(options)],
        env=env, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A block that slides, seen by a small camera."""
    folder = tmp_path_factory.mktemp("replay")
    done = pallet_twin(
        "run",
        "block_slip",
        "--set",
        f"camera={CAMERA}",
        "--out",
        "run",
        "--no-estimate",
        "--no-page",
        cwd=folder,
    )
    assert done.returncode == 0, done.stderr
    return folder / "run" / "bag"


def test_verdict_and_pictures_are_those_of_the_recording(bag: Path) -> None:
    process = start_replay(bag, environment(), judge=True, pictures=True, rate=None)
    out, errors = process.communicate(timeout=60)
    assert process.returncode == 0, errors
    played = json.loads(out)
    with BagReader(bag) as reader:
        report = next(reader.messages(["/twin/eumos/report"])).decode().data
        sent = {name: topic.message_count for name, topic in reader.topics.items()}
    assert played["report_json"] == report
    assert played["equal"] == [True] * 4
    assert {c["topic"]: c["count"] for c in played["compared"]} == {
        "eumos/status": sent["/twin/eumos/status"],
        "eumos/report": 1,
        "camera/camera_info": sent["/twin/camera/camera_info"],
        "camera/image_raw/compressed": sent["/twin/camera/image_raw/compressed"],
    }
    # What is made anew is not played, and what the bag lacks tells both that no frame will follow.
    assert not [name for name in played["topics"] if "/eumos/" in name or "/camera/" in name]
    assert played["topics"]["/twin/physics/progress"] == 1
    assert played["topics"]["/twin/packages/poses"] == sent["/twin/packages/poses"]
    assert any("eumos/report: 1 messages, byte for byte" in line for line in played["lines"])


# An independent reader: deserialised stamps aside, it takes bytes, with rclpy alone.
READER = """
import hashlib, json, sys, time, rclpy, rclpy.executors
from importlib import import_module
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
rclpy.init()
node = rclpy.create_node("guest")
got, count, offered = {}, {}, {}
for name, kind, latched in json.loads(sys.argv[1]):
    package, _, word = kind.partition("/msg/")
    got[name], count[name] = hashlib.sha256(), 0
    def take(data, name=name):
        got[name].update(data)
        count[name] += 1
    durability = DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE
    qos = QoSProfile(depth=5000, reliability=ReliabilityPolicy.RELIABLE, durability=durability)
    node.create_subscription(getattr(import_module(package + ".msg"), word), name, take, qos, raw=True)
executor = rclpy.executors.SingleThreadedExecutor()
executor.add_node(node)
last, total = time.monotonic(), 0
while time.monotonic() - last < (1.5 if total else 40.0):
    executor.spin_once(timeout_sec=0.2)
    if total == 0 or not offered:
        for name in got:
            for info in node.get_publishers_info_by_topic(name):
                offered.setdefault(name, []).append((info.qos_profile.reliability.name,
                                                     info.qos_profile.durability.name))
    if sum(count.values()) != total:
        last, total = time.monotonic(), sum(count.values())
print(json.dumps({"digests": {n: h.hexdigest() for n, h in got.items()}, "counts": count,
                  "offered": {n: sorted(set(q)) for n, q in offered.items()}}))
"""


def test_guest_in_another_namespace_gets_every_byte_at_the_pace_of_the_bag(bag: Path) -> None:
    import hashlib

    env = {**environment(), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    env["FASTRTPS_DEFAULT_PROFILES_FILE"] = str(files("config").joinpath("fastdds.xml"))
    digests, listened = {}, []
    with BagReader(bag) as reader:
        recorded = {name: topic for name, topic in reader.topics.items() if name != "/tf"}
        for name, topic in recorded.items():
            moved = name.replace("/twin/", "/bench/left/")
            digest = hashlib.sha256()
            for message in reader.messages([name]):
                digest.update(message.payload)
            digests[moved] = digest.hexdigest()
            listened.append((moved, topic.topic.type_name, topic.topic.qos.durability == "transient_local"))
        duration_s = (reader.end_ns - reader.start_ns) / 1e9
    guest = subprocess.Popen(
        [sys.executable, "-c", READER, json.dumps(listened)], env=env, stdout=subprocess.PIPE, text=True
    )
    process = start_replay(bag, env, namespace="/bench/left", guests=1)
    out, errors = process.communicate(timeout=60)
    assert process.returncode == 0, errors
    played, seen = json.loads(out), json.loads(guest.communicate(timeout=60)[0])
    assert seen["digests"] == digests
    assert seen["counts"]["/clock"] == recorded["/clock"].message_count
    for name, latched in ((name, latched) for name, _, latched in listened):
        assert seen["offered"][name] == [["RELIABLE", "TRANSIENT_LOCAL" if latched else "VOLATILE"]], name
    assert played["wall_s"] == pytest.approx(duration_s, abs=0.5) and played["wall_s"] >= duration_s
    assert played["messages"] == sum(topic.message_count for topic in recorded.values())
    # 0.1 ms and 2 ms on a machine with nothing else to do.
    assert played["timing_ms"]["p50"] < 2.0
    assert "tf2_msgs" in played["left_out"]["/tf"]


# Steps through a recording by the services, then begins again, goes on and ends the player by a signal.
CONTROL = """
import json, os, signal, subprocess, sys, time, rclpy
from lifecycle_msgs.srv import ChangeState
from rclpy.qos import QoSProfile
from geometry_msgs.msg import AccelStamped, PoseArray
from std_srvs.srv import SetBool, Trigger
player = subprocess.Popen([sys.executable, "-m", "ros_nodes.player_node", "--ros-args", "-r", "__ns:=/twin",
    "-p", "bag:=" + json.dumps(sys.argv[1]), "-p", "paused:=true", "-p", "rate:=0.1",
    "-p", "readers:=packages/poses=1,sled/acceleration=1"], stdout=subprocess.DEVNULL)
rclpy.init()
node = rclpy.create_node("control", namespace="/twin")
poses, samples = [], []
node.create_subscription(PoseArray, "packages/poses", poses.append, QoSProfile(depth=5000), raw=True)
node.create_subscription(AccelStamped, "sled/acceleration", samples.append, QoSProfile(depth=5000), raw=True)
def call(kind, name, **values):
    client = node.create_client(kind, name)
    assert client.wait_for_service(20.0), name
    request = kind.Request()
    for key, value in values.items():
        setattr(request, key, value)
    future = client.call_async(request)
    rclpy.spin_until_future_complete(node, future, timeout_sec=20.0)
    return future.result()
def spin(seconds, until=lambda: False):
    end = time.monotonic() + seconds
    while time.monotonic() < end and not until():
        rclpy.spin_once(node, timeout_sec=0.02)
for number in (1, 3):
    from lifecycle_msgs.msg import Transition
    result = call(ChangeState, "player_node/change_state", transition=Transition(id=number))
    assert result.success
story = []
spin(0.2)
story.append((len(poses), len(samples)))
for step in range(3):
    assert call(Trigger, "player/step").success
    spin(2.0, lambda: len(poses) == step + 1 and len(samples) == 1 + 4 * step)
    story.append((len(poses), len(samples)))
call(Trigger, "player/restart")
before = len(poses)
assert call(Trigger, "player/step").success
spin(2.0, lambda: len(poses) > before)
story.append(("again", poses[-1] == poses[0]))
call(SetBool, "player/pause", data=False)
spin(5.0, lambda: len(poses) > before + 10)
assert len(poses) > before + 10
words = call(SetBool, "player/pause", data=True).message
spin(0.2)
now = len(poses)
spin(0.3)
story.append((words.split(" at ")[0], len(poses) - now))
player.send_signal(signal.SIGINT)
began = time.monotonic()
story.append((player.wait(20.0), time.monotonic() - began < 5.0))
print(json.dumps(story))
"""


def test_player_halts_steps_and_begins_again_by_services(bag: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-c", CONTROL, str(bag)],
        env=environment(),
        capture_output=True,
        text=True,
        timeout=90,
    )
    assert done.returncode == 0, done.stderr
    *steps, again, halted, ended = json.loads(done.stdout)
    # Samples come four times as often as frames, and the first of both at the same time.
    assert steps == [[0, 0], [1, 1], [2, 5], [3, 9]]
    assert again == ["again", True]
    assert halted == ["halted", 0]
    assert ended == [0, True]


def test_signal_ends_a_replay_with_all_its_processes(bag: Path) -> None:
    process = start_replay(bag, environment(), judge=True, rate=0.01)
    deadline = time.monotonic() + 30.0
    while set(nodes := node_pids(process.pid)) != {"player_node", "validator_node"}:
        assert time.monotonic() < deadline and process.poll() is None
        time.sleep(0.05)
    time.sleep(1.0)
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=30)
    assert process.returncode == 130 and "Traceback" not in errors
    assert not any(Path(f"/proc/{pid}").exists() for pid in nodes.values())


def test_damaged_bag_gives_one_line(bag: Path, tmp_path: Path) -> None:
    data = bytearray(next(bag.glob("*.mcap")).read_bytes())
    data[len(data) // 2 : len(data) // 2 + 4000] = bytes(4000)
    (tmp_path / "broken.mcap").write_bytes(data)
    process = start_replay(tmp_path / "broken.mcap", environment(), rate=None)
    out, errors = process.communicate(timeout=60)
    assert process.returncode == 2 and out == ""
    assert len(errors.strip().splitlines()) == 1 and "is damaged" in errors


@pytest.mark.parametrize(("options", "words"), [
    ({"judge": True, "start_s": 0.2}, "--judge = with --start or --loop"),
    ({"judge": True, "leave_out": ["packages/*"]}, "needs packages/poses"),
    ({"rate": 0.0}, "--rate = 0.0: must be from 0.01"),
    ({"rate": 2000.0}, "--rate = 2000.0: must be from 0.01"),
    ({"loop": -1}, "--loop = -1"),
    ({"topics": ["nothing"]}, "fits no topic of the bag"),
    ({"start_s": 99.0}, "start = 99.0"),
])  # fmt: skip
def test_what_cannot_be_played_is_refused_before_anything_starts(
    bag: Path, options: dict[str, object], words: str
) -> None:
    before = dict(os.environ)
    with pytest.raises(RefusedInput) as refusal:
        replay(bag, **options)
    assert words in str(refusal.value)
    assert dict(os.environ) == before


def test_sender_waits_for_the_slowest_answer() -> None:
    window, sent = AnswerWindow(["judge", "camera"], 3), []

    def send() -> None:
        for stamp in range(1, 9):
            assert window.wait_for_room(stamp, lambda: False) is None
            sent.append(stamp)

    thread = threading.Thread(target=send)
    thread.start()
    for judge, camera, expected in ((0, 0, 3), (3, 0, 3), (3, 2, 5), (4, 4, 7), (8, 8, 8)):
        window.take("judge", judge)
        window.take("camera", camera)
        time.sleep(0.03)
        assert len(sent) == expected
    thread.join(1.0)
    for stamp in range(10):
        window.wait_for_room(stamp, lambda: True)
    window.forget()
    assert window.wait_for_room(1, lambda: False) is None
