"""Drives the twin by the machine's accelerometer, while the machine moves: stands where the sled's node does."""

from typing import Any

import numpy as np

from config.errors import PalletTwinError
from config.scene import Scene
from config.scene_file import scene_from_json
from msgs_adapters.convert import accelerometer_sample, progress_of
from msgs_adapters.publications import sample_publications
from msgs_adapters.topics import (
    CLOCK,
    PHYSICS_PROGRESS,
    SCENE,
    SLED_ACCELERATION,
    SLED_ACCELEROMETER,
    SLED_ODOMETRY,
    Topic,
)
from ros_nodes.node_process import SUCCESS, LifecycleState, TwinNode, run_node
from sim_core.bench_live import LiveSample, LiveSled
from sim_core.frames import SledSample
from sim_core.sled import stamp_ns


class BenchNode(TwinNode):
    """The machine's sled as a node of the twin.

    Publishes ``/clock``, ``sled/acceleration`` and ``sled/odometry`` as the sled's node does; subscribes to ``scene``,
    ``physics/progress`` and the machine's ``sled/accelerometer``. Stamps are the machine's.

    The scene's own sled is the plan: its lead is kept before the motion, the fields take its peak, and the test is over
    when the load rests after its end. It should not be shorter than what the machine does. Once the machine's sled
    stands, samples follow as the physics takes them, whether or not it still sends readings.
    """

    def __init__(self) -> None:
        super().__init__("bench_node")
        self._accelerometer = self.declare(
            "accelerometer_topic",
            SLED_ACCELEROMETER.absolute_name("/machine"),
            "the machine's accelerometer, sensor_msgs/Imu",
        )
        self._window = self.declare(
            "window_samples", 96, "samples sent ahead of the physics once the sled stands", from_value=1,
            to_value=4000,
        )  # fmt: skip
        self.await_readers()
        self._scene: Scene | None = None
        self._sled: LiveSled | None = None
        self._is_active = self._finished = False
        self._first_ns: int | None = None
        self._sent = self._acknowledged = 0
        self._velocity = self._position = np.zeros(3)
        self.listen(SCENE, self._take_scene)
        self.listen(PHYSICS_PROGRESS, self._take_progress)

    def set_up(self) -> bool:
        """Opens the topics; refused until the scene is there."""
        if self._scene is None:
            return False
        for topic in (CLOCK, SLED_ACCELERATION, SLED_ODOMETRY):
            self.open_topic(topic)
        sled = self._scene.sled
        self._sled = LiveSled(
            samples_hz=self._scene.sampling.samples_hz,
            direction=sled.direction,
            lead_s=getattr(sled, "lead_s", 0.1),
        )
        self.listen(
            Topic(self._accelerometer, SLED_ACCELEROMETER.type_name, SLED_ACCELEROMETER.qos),
            self._take_reading,
        )
        return True

    def on_activate(self, state: LifecycleState) -> Any:
        """Waits for its readers; from here on the machine may move."""
        result = super().on_activate(state)
        self._is_active = result == SUCCESS
        return result

    def on_end(self) -> None:
        """Sees that every reader has everything."""
        self.wait_for_acknowledgement()

    def _take_scene(self, message: Any) -> None:
        if self._scene is None:
            self._scene = scene_from_json(message.data)

    def _take_progress(self, message: Any) -> None:
        progress = progress_of(message)
        self._acknowledged = progress.samples
        self._finished = progress.finished or progress.error is not None
        if self._sled is not None and self._sled.state == "standing":
            while not self._finished and self._sent < self._acknowledged + self._window:
                self._send(self._sled.next_standing())

    def _take_reading(self, message: Any) -> None:
        if not self._is_active or self._finished:
            return
        assert self._sled is not None
        if self._sled.state == "standing":
            return
        try:
            reading = accelerometer_sample(message)
            self._first_ns = reading.stamp_ns if self._first_ns is None else self._first_ns
            samples = self._sled.add((reading.stamp_ns - self._first_ns) / 1.0e9, reading.specific_force)
        except PalletTwinError as error:
            self.error, self.done = error, True
            return
        for sample in samples:
            self._send(sample)

    def _send(self, sample: LiveSample) -> None:
        assert self._scene is not None and self._sled is not None
        assert self._sled.start_s is not None and self._first_ns is not None
        rate = self._scene.sampling.samples_hz
        began = self._velocity
        self._velocity = began + sample.acceleration / rate
        self._position = self._position + 0.5 * (began + self._velocity) / rate
        sent = SledSample(
            index=sample.index,
            stamp_ns=stamp_ns(sample.index, rate, self._first_ns + round(1.0e9 * self._sled.start_s)),
            interval_s=1.0 / rate if sample.index else 0.0,
            acceleration=sample.acceleration,
            velocity=self._velocity,
            position=self._position,
        )
        for publication in sample_publications(sent, self._scene):
            self.send(publication)
        self._sent += 1


def main(args: list[str] | None = None) -> None:
    """Runs the node."""
    run_node(BenchNode, args)


if __name__ == "__main__":
    main()
