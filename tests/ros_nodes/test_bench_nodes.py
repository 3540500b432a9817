"""The twin beside the machine: its accelerometer drives the twin, and its displacement is compared, over real topics."""

import json
import time
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
import rclpy
from rclpy.experimental import EventsExecutor
from rclpy.lifecycle import TransitionCallbackReturn

from config.scene import Scene
from config.scene_file import find_scene, read_scene
from msgs_adapters.cdr import serialize
from msgs_adapters.convert import Progress, sample_from_accel, to_progress, to_string
from msgs_adapters.pose_payloads import pose_array_payload
from msgs_adapters.topics import (
    PACKAGES_POSES,
    PHYSICS_PROGRESS,
    RESIDUAL_DISPLACEMENT,
    RESIDUAL_REPORT,
    SCENE,
    SLED_ACCELERATION,
    Topic,
    message_class,
    to_rclpy,
)
from recordings.bag_reader import BagReader
from recordings.bench_stand_in import EPOCH_NS, write_stand_in
from ros_nodes.bench_node import BenchNode
from ros_nodes.physics_node import PhysicsNode
from ros_nodes.residual_node import ResidualNode
from sim_core.bench_stand_in import SensorFaults
from sim_core.frames import PoseFrame
from sim_core.load_test import LoadTest
from tests.ros_nodes.graph import fresh_domain

MACHINE_ACCELEROMETER, MACHINE_DISPLACEMENT = "/machine/sled/accelerometer", "/machine/vision/displacement"


@pytest.fixture(scope="module")
def block() -> Scene:
    return read_scene(find_scene("block_slip"), ['sled={"profile": "eumos", "level_g": 0.5}'])


@pytest.fixture(scope="module")
def machine_bag(block: Scene, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_stand_in(
        tmp_path_factory.mktemp("machine") / "bag", block, SensorFaults(), seed=2, with_pictures=True
    )


class Graph:
    """Nodes of ours and one of the test's, in one process, on a domain of their own."""

    def __init__(
        self, monkeypatch: pytest.MonkeyPatch, *node_classes: Any, parameters: Sequence[str] = ()
    ) -> None:
        monkeypatch.setenv("ROS_DOMAIN_ID", fresh_domain())
        rclpy.init(
            args=["--ros-args", *(word for text in parameters for word in ("-p", text))] if parameters else []
        )
        self.nodes = [node_class() for node_class in node_classes]
        self.node = self.nodes[0]
        self.other = rclpy.create_node("other")
        self.executor = EventsExecutor()
        for node in (*self.nodes, self.other):
            self.executor.add_node(node)
        self.heard: dict[str, list[Any]] = {}
        self._publishers: dict[str, Any] = {}

    def opens(self, topic: Topic) -> None:
        kind = message_class(topic.type_name)
        self._publishers[topic.name] = self.other.create_publisher(kind, topic.name, to_rclpy(topic.qos))

    def hears(self, topic: Topic) -> None:
        kept = self.heard.setdefault(topic.name, [])
        kind = message_class(topic.type_name)
        self.other.create_subscription(kind, topic.name, kept.append, to_rclpy(topic.qos))

    def says(self, topic: Topic, payload: bytes) -> None:
        self._publishers[topic.name].publish(payload)

    def spin_until(self, condition: Any) -> None:
        deadline = time.monotonic() + 15.0
        while not condition():
            assert time.monotonic() < deadline, "nothing came in fifteen seconds"
            self.executor.spin_once(timeout_sec=0.02)

    def matched(self) -> bool:
        return all(publisher.get_subscription_count() for publisher in self._publishers.values())

    def close(self) -> None:
        for node in (*self.nodes, self.other):
            self.executor.remove_node(node)
            node.destroy_node()
        rclpy.shutdown()


def machine_messages(bag: Path, topic: str) -> list[bytes]:
    with BagReader(bag) as reader:
        return [message.payload for message in reader.messages([topic])]


def machine_topic(bag: Path, name: str) -> Topic:
    with BagReader(bag) as reader:
        return reader.topics[name].topic


def test_the_residual_is_published_and_summed_up(
    block: Scene, machine_bag: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    graph = Graph(monkeypatch, ResidualNode)
    try:
        measured = machine_topic(machine_bag, MACHINE_DISPLACEMENT)
        for topic in (SCENE, PACKAGES_POSES, PHYSICS_PROGRESS, measured):
            graph.opens(topic)
        for topic in (RESIDUAL_DISPLACEMENT, RESIDUAL_REPORT):
            graph.hears(topic)
        assert graph.node.trigger_configure() == TransitionCallbackReturn.SUCCESS
        assert graph.node.trigger_activate() == TransitionCallbackReturn.SUCCESS
        graph.spin_until(graph.matched)
        graph.says(SCENE, serialize(to_string(block.to_json())))
        test = LoadTest(block)
        frames = list(test.frames())
        test.close()
        for frame in frames:
            stamp_ns = EPOCH_NS + round(1e9 * frame.index / block.sampling.poses_hz)
            moved = PoseFrame(frame.index, stamp_ns, frame.positions, frame.orientations)
            graph.says(PACKAGES_POSES, pose_array_payload(moved))
        clouds = machine_messages(machine_bag, MACHINE_DISPLACEMENT)
        for payload in clouds:
            graph.says(measured, payload)
        graph.says(
            PHYSICS_PROGRESS, serialize(to_progress(Progress(len(frames), len(frames), finished=True)))
        )
        graph.spin_until(lambda: len(graph.heard[RESIDUAL_DISPLACEMENT.name]) == len(clouds))
        graph.spin_until(lambda: graph.heard[RESIDUAL_REPORT.name])
        report = json.loads(graph.heard[RESIDUAL_REPORT.name][-1].data)
    finally:
        graph.close()
    # The twin has the machine's own load and sled: what differs is a millimetre of noise.
    assert report["times"] == len(clouds)
    assert report["rms_mm"] == pytest.approx(1.0, abs=0.1)
    assert report["package"] == "block" and report["packages"][0]["peak_measured_mm"] > 380.0


def test_the_machines_accelerometer_drives_the_twin(
    block: Scene, machine_bag: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    graph = Graph(monkeypatch, BenchNode)
    try:
        accelerometer = machine_topic(machine_bag, MACHINE_ACCELEROMETER)
        for topic in (SCENE, PHYSICS_PROGRESS):
            graph.opens(topic)
        graph.hears(SLED_ACCELERATION)
        graph.spin_until(graph.matched)
        assert graph.node.trigger_configure() == TransitionCallbackReturn.FAILURE
        graph.says(SCENE, serialize(to_string(block.to_json())))
        graph.spin_until(lambda: graph.node.trigger_configure() == TransitionCallbackReturn.SUCCESS)
        assert graph.node.trigger_activate() == TransitionCallbackReturn.SUCCESS
        graph.opens(accelerometer)
        graph.spin_until(graph.matched)
        heard = graph.heard[SLED_ACCELERATION.name]
        for number, payload in enumerate(machine_messages(machine_bag, MACHINE_ACCELEROMETER)):
            graph.says(accelerometer, payload)
            if number % 100 == 0:
                graph.executor.spin_once(timeout_sec=0.001)
        graph.spin_until(lambda: len(heard) > 2000)
        count = len(heard)
        graph.says(PHYSICS_PROGRESS, serialize(to_progress(Progress(count + 50, 0))))
        graph.spin_until(lambda: len(heard) > count + 50)
    finally:
        graph.close()
    samples = [sample_from_accel(message, None) for message in heard]
    gaps = {round((b.stamp_ns - a.stamp_ns) / 1e3) for a, b in pairwise(samples)}
    # 960 Hz, and no sample missing.
    assert gaps == {1042}
    speed = sum(sample.acceleration[0] for sample in samples) / 960.0
    assert abs(speed) < 0.02 and max(sample.acceleration[0] for sample in samples) > 4.8


def test_the_twin_runs_beside_the_machine(
    block: Scene, machine_bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Everything the machine says goes through bench, physics and residual node; a friction of 0.3 is right."""
    (tmp_path / "scene.json").write_text(block.to_json())
    graph = Graph(
        monkeypatch,
        PhysicsNode,
        BenchNode,
        ResidualNode,
        parameters=[f"scene_file:={tmp_path / 'scene.json'}"],
    )
    physics, bench, residual = graph.nodes
    try:
        topics = {
            name: machine_topic(machine_bag, name) for name in (MACHINE_ACCELEROMETER, MACHINE_DISPLACEMENT)
        }
        graph.hears(RESIDUAL_REPORT)
        for node in (physics, residual):
            assert node.trigger_configure() == TransitionCallbackReturn.SUCCESS
            assert node.trigger_activate() == TransitionCallbackReturn.SUCCESS
        graph.spin_until(lambda: bench.trigger_configure() == TransitionCallbackReturn.SUCCESS)
        assert bench.trigger_activate() == TransitionCallbackReturn.SUCCESS
        for topic in topics.values():
            graph.opens(topic)
        graph.spin_until(graph.matched)
        with BagReader(machine_bag) as reader:
            for number, message in enumerate(reader.messages(list(topics))):
                graph.says(topics[message.topic_name], message.payload)
                if number % 20 == 0:
                    graph.executor.spin_once(timeout_sec=0.001)
        graph.spin_until(lambda: graph.heard[RESIDUAL_REPORT.name])
        report = json.loads(graph.heard[RESIDUAL_REPORT.name][-1].data)
    finally:
        graph.close()
    assert report["package"] == "block" and report["times"] > 60
    # Noise of 1 mm, and what the accelerometer's noise of 0.1 m/s² leaves open.
    assert report["rms_mm"] < 4.0 and report["packages"][0]["peak_simulated_mm"] > 380.0
