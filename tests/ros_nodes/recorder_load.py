"""The recorder node under a bench's load: what it records, and what that costs.

``python -m tests.ros_nodes.recorder_load [SECONDS]`` records 1 kHz Imu, 240 Hz poses of 60 packages, 30 pictures
a second of 400 kB and 30 film clouds a second of 200 kB, and prints the figures.
"""

import json
import os
import struct
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from msgs_adapters.cdr import serialize
from msgs_adapters.convert import to_imu, to_string
from msgs_adapters.publications import frame_publication, jpeg_publication
from msgs_adapters.topics import (
    CAMERA_COMPRESSED,
    PACKAGES_POSES,
    SLED_ACCELEROMETER,
    WRAP_STRAIN,
    QosSpec,
    Topic,
)
from recordings.bag_reader import BagReader
from sim_core.frames import AccelerometerSample, PoseFrame
from tests.ros_nodes.graph import environment

DOOR = Topic("bench/door", "std_msgs/msg/String", QosSpec(reliability="best_effort"))
"""A topic of which the twin knows nothing."""
RATES_HZ: dict[Topic, int] = {
    SLED_ACCELEROMETER: 1000,
    PACKAGES_POSES: 240,
    CAMERA_COMPRESSED: 30,
    WRAP_STRAIN: 30,
    DOOR: 5,
}
EPOCH_NS = 10**12
_TICKS = os.sysconf("SC_CLK_TCK")


@dataclass(frozen=True)
class Load:
    """A recording under load: what was sent and recorded, the recorder's share of a core and memory [MB]."""

    sent: dict[str, int]
    recorded: dict[str, int]
    cpu_share: float
    memory_mb: tuple[float, float]
    facts: dict[str, str]
    log: str
    size_mb: float


def payloads() -> dict[Topic, bytes]:
    random_ = np.random.default_rng(0)
    frame = PoseFrame(0, EPOCH_NS, random_.normal(size=(60, 3)), np.tile([0.0, 0, 0, 1], (60, 1)))
    from sensor_msgs.msg import PointCloud2

    cloud = PointCloud2()
    cloud.data.frombytes(random_.normal(size=50_000).astype(np.float32).tobytes())
    return {
        SLED_ACCELEROMETER: serialize(to_imu(AccelerometerSample(EPOCH_NS, np.zeros(3), 1e-4))),
        PACKAGES_POSES: frame_publication(frame).payload,
        CAMERA_COMPRESSED: jpeg_publication(EPOCH_NS, random_.bytes(400_000)).payload,
        WRAP_STRAIN: serialize(cloud),
        DOOR: serialize(to_string("a long word that says that the bench's door is shut")),
    }


def record_load(folder: Path, *, seconds: float, parameters: tuple[str, ...] = ()) -> Load:
    """Records a bench's load for so long into ``folder/bag``, each side a process of its own."""
    env = {**environment(), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    env["FASTRTPS_DEFAULT_PROFILES_FILE"] = str(files("config").joinpath("fastdds.xml"))
    names = ",".join(topic.name for topic in RATES_HZ)
    arguments = ["--ros-args", "-r", "__ns:=/twin", "-p", f"bag:={folder / 'bag'}", "-p", f"topics:={names}"]
    arguments += [word for parameter in parameters for word in ("-p", parameter)]
    with (folder / "log").open("wb") as log:
        recorder = subprocess.Popen(
            [sys.executable, "-m", "ros_nodes.recorder_node", *arguments], env=env, stdout=log, stderr=log
        )
    try:
        command = [
            sys.executable,
            "-m",
            "tests.ros_nodes.recorder_load",
            "publish",
            str(seconds),
            str(recorder.pid),
        ]
        sender = subprocess.run(
            command, env=env, capture_output=True, text=True, timeout=seconds + 60, check=False
        )
        assert sender.returncode == 0, sender.stderr
        recorder.terminate()
        recorder.wait(timeout=30)
    finally:
        recorder.kill()
    told = json.loads(sender.stdout)
    with BagReader(folder / "bag") as reader:
        recorded = {topic.name: reader.topics[topic.absolute_name()].message_count for topic in RATES_HZ}
        facts = reader.metadata("pallet-twin recorder")
    return Load(
        told["sent"],
        recorded,
        told["cpu_s"] / told["wall_s"],
        (told["memory_mb"][0], told["memory_mb"][1]),
        facts,
        (folder / "log").read_text(),
        sum(path.stat().st_size for path in (folder / "bag").iterdir()) / 1e6,
    )


def publish(seconds: float, recorder: int) -> None:
    """Brings a recorder up, sends the load, and tells what the recorder spent on it."""
    import rclpy
    from lifecycle_msgs.msg import Transition
    from lifecycle_msgs.srv import ChangeState
    from rclpy.duration import Duration

    from msgs_adapters.topics import message_class, to_rclpy

    rclpy.init()
    node = rclpy.create_node("load", namespace="/twin")
    publishers: dict[Topic, Any] = {
        topic: node.create_publisher(message_class(topic.type_name), topic.name, to_rclpy(topic.qos))
        for topic in RATES_HZ
    }
    client = node.create_client(ChangeState, "recorder_node/change_state")
    assert client.wait_for_service(timeout_sec=20.0)
    for transition in (Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_ACTIVATE):
        request = ChangeState.Request()
        request.transition.id = transition
        deadline = time.monotonic() + 20.0
        while True:
            future = client.call_async(request)
            rclpy.spin_until_future_complete(node, future, timeout_sec=20.0)
            if future.result().success:
                break
            assert time.monotonic() < deadline
            time.sleep(0.05)
    while any(not publisher.get_subscription_count() for publisher in publishers.values()):
        time.sleep(0.01)
    bodies, sent = payloads(), dict.fromkeys(RATES_HZ, 0)
    spent_s, memory_mb, began = cpu_s(recorder), 0.0, time.monotonic()
    while (now_s := time.monotonic() - began) < seconds:
        for topic, rate_hz in RATES_HZ.items():
            while sent[topic] / rate_hz <= now_s:
                stamp_ns = EPOCH_NS + sent[topic] * 10**9 // rate_hz
                stamp = struct.pack("<iI", *divmod(stamp_ns, 10**9))
                body = bodies[topic]
                publishers[topic].publish(body if topic is DOOR else body[:4] + stamp + body[12:])
                sent[topic] += 1
        if memory_mb == 0.0 and now_s > seconds / 3:
            memory_mb = resident_mb(recorder)
        time.sleep(0.001)
    for publisher in publishers.values():
        publisher.wait_for_all_acked(Duration(seconds=10))
    result = {
        "sent": {topic.name: count for topic, count in sent.items()},
        "cpu_s": cpu_s(recorder) - spent_s,
        "wall_s": time.monotonic() - began,
        "memory_mb": [memory_mb, resident_mb(recorder)],
    }
    sys.stdout.write(json.dumps(result))
    node.destroy_node()
    rclpy.try_shutdown()


def cpu_s(process: int) -> float:
    """CPU time that a process has used [s]."""
    fields = Path(f"/proc/{process}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / _TICKS


def resident_mb(process: int) -> float:
    """Memory that a process alone holds [MB]; segments of the middleware are shared."""
    lines = Path(f"/proc/{process}/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("RssAnon")) / 1000


def main(arguments: list[str]) -> None:
    if arguments[:1] == ["publish"]:
        publish(float(arguments[1]), int(arguments[2]))
        return
    with tempfile.TemporaryDirectory() as name:
        load = record_load(Path(name), seconds=float(arguments[0]) if arguments else 30.0)
    most = {key: value for key, value in load.facts.items() if key.startswith("most")}
    sys.stdout.write(
        f"sent {load.sent}, recorded {load.recorded}: {load.size_mb:.0f} MB\n"
        f"recorder: {load.cpu_share:.0%} of a core, memory {load.memory_mb[0]:.0f} then "
        f"{load.memory_mb[1]:.0f} MB\n{most} {load.log}\n"
    )


if __name__ == "__main__":
    main(sys.argv[1:])
