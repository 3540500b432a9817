"""The recorder node in processes of its own: all that a bench sends, at what cost, and a clear end."""

import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import pytest

from msgs_adapters.topics import PACKAGES_POSES, SLED_ACCELEROMETER
from recordings.bag_reader import BagReader
from tests.ros_nodes.graph import environment
from tests.ros_nodes.recorder_load import DOOR, RATES_HZ, record_load


def test_a_benchs_load_is_recorded_whole_and_cheaply(tmp_path: Path) -> None:
    load = record_load(tmp_path, seconds=3.0, parameters=("split_mb:=10",))
    lossless = {topic.name for topic in RATES_HZ if topic is not DOOR}
    assert {name: load.recorded[name] for name in lossless} == {name: load.sent[name] for name in lossless}
    # 10 to 14 % of a core on a busy machine; 40 % are allowed.
    assert load.cpu_share < 0.4
    assert load.memory_mb[1] < 200.0 and load.memory_mb[1] - load.memory_mb[0] < 30.0
    assert float(load.facts["most behind s"]) < 1.0 and "fell behind" not in load.log
    files = sorted((tmp_path / "bag").glob("*.mcap"))
    assert len(files) >= 4 and max(file.stat().st_size for file in files) < 11_000_000
    with BagReader(tmp_path / "bag") as reader:
        reader.verify()
        for topic in (SLED_ACCELEROMETER, PACKAGES_POSES):
            name = topic.absolute_name()
            stamps = [message.publish_time_ns for message in reader.messages([name])]
            steps = {round((later - stamp) * RATES_HZ[topic] / 1e9) for stamp, later in pairwise(stamps)}
            assert steps == {1}
            assert len(reader.receive_times(name)[0]) == len(stamps)
        # A topic that is none of the twin's, as its publisher offers it.
        door = reader.topics[DOOR.absolute_name()].topic
        assert (door.type_name, door.qos.reliability) == ("std_msgs/msg/String", "best_effort")
        assert next(reader.messages([door.name])).decode().data.endswith("door is shut")


@pytest.mark.parametrize(
    ("parameter", "words"),
    [("bag:=/sys/no_bag_here", "cannot be made"), ("topics:=not a name", "Invalid topic name")],
)
def test_what_cannot_be_recorded_is_one_line(tmp_path: Path, parameter: str, words: str) -> None:
    # Configured without a network: the transition is the node's own.
    program = (
        "import rclpy\n"
        "from ros_nodes.recorder_node import RecorderNode\n"
        "rclpy.init()\n"
        "node = RecorderNode()\n"
        "node.trigger_configure()\n"
        "print(node.error, node.done)\n"
    )
    arguments = ["--ros-args", "-p", f"bag:={tmp_path / 'bag'}", "-p", parameter]
    launch = f"import sys; sys.argv += {arguments!r}\n{program}"
    done = subprocess.run(
        [sys.executable, "-c", launch.replace("rclpy.init()", "rclpy.init(args=sys.argv)")],
        capture_output=True,
        text=True,
        timeout=60,
        env=environment(),
    )
    assert done.returncode == 0, done.stderr
    (line,) = done.stdout.splitlines()
    assert words in line and line.endswith("True")
