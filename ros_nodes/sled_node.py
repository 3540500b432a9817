"""Owns time: plays the sled's profile as samples, on the wall clock or as fast as the physics takes them."""

import time
from collections.abc import Iterator
from typing import Any

from config.scene import Scene
from config.scene_file import scene_from_json
from msgs_adapters.convert import progress_of
from msgs_adapters.publications import reading_publication, sample_publications, sled_topics
from msgs_adapters.topics import PHYSICS_PROGRESS, SCENE
from ros_nodes.node_process import FAILURE, LifecycleState, TwinNode, run_node
from ros_nodes.readers import readers_wanted
from sim_core.frames import SledSample
from sim_core.run import Peekable
from sim_core.sled import DEFAULT_EPOCH_NS, accelerometer_samples, sled_samples


class SledNode(TwinNode):
    """The sled as a node.

    Publishes ``/clock``, ``sled/acceleration``, ``sled/odometry`` and, where the scene has one,
    ``sled/accelerometer``.

    It needs the ``scene`` before it can be configured, and starts when it is activated and its readers
    are matched. Pace ``real``: samples leave on the wall clock. Pace ``fast``: samples leave as
    ``physics/progress`` acknowledges them. In both a bounded window ahead of the physics, so that a slow
    reader lags but loses nothing; falling behind is counted.
    """

    def __init__(self) -> None:
        super().__init__("sled_node")
        self._pace = self.declare(
            "pace", "fast", "'fast' (as the physics acknowledges) or 'real' (wall clock)"
        )
        self._window = self.declare(
            "window_samples", 96, "samples sent ahead of the physics, pace fast", from_value=1, to_value=4000
        )
        self._real_window = self.declare(
            "window_samples_real",
            2000,
            "samples ahead of the physics, pace real",
            from_value=1,
            to_value=4000,
        )
        self._epoch_ns = self.declare(
            "epoch_ns", DEFAULT_EPOCH_NS, "simulated time of the first sample [ns], not 0", from_value=1,
            to_value=2**62,
        )  # fmt: skip
        self._readers = self.declare(
            "readers", "", "matched readers to wait for, topic=count, comma-separated"
        )
        self._period_s = self.declare(
            "timer_period_s", 0.002, "how often samples leave", from_value=0.0005, to_value=0.1
        )
        self._scene: Scene | None = None
        self._samples: Iterator[SledSample] | None = None
        self._sent = self._acknowledged = self._late = 0
        self._worst_lag_s = 0.0
        self._finished = False
        self.listen(SCENE, self._take_scene)
        self.listen(PHYSICS_PROGRESS, self._take_progress)

    def set_up(self) -> bool:
        """Opens the topics that the scene needs; refused until the scene is there."""
        if self._scene is None:
            return False
        for topic in sled_topics(self._scene):
            self.open_topic(topic)
        return True

    def on_activate(self, state: LifecycleState) -> Any:
        """Starts the sled once every reader is matched."""
        assert self._scene is not None
        missing = self.wait_for_readers(readers_wanted(self._readers))
        if missing is not None:
            self.get_logger().error(f"no reader for {missing}")
            return FAILURE
        result = super().on_activate(state)
        self._samples = sled_samples(self._scene, epoch_ns=self._epoch_ns)
        self._readings = Peekable(accelerometer_samples(self._scene, epoch_ns=self._epoch_ns))
        self._began = time.monotonic()
        self._timer = self.create_timer(self._period_s, self._send_due)
        return result

    def on_end(self) -> None:
        """Sees that every reader has everything, and says how the pace was kept."""
        self.wait_for_acknowledgement()
        if self._late:
            self.get_logger().warning(
                f"fell behind the wall clock for {self._late} samples, at most by {self._worst_lag_s:.3f} s;"
                " nothing was dropped"
            )

    def _take_scene(self, message: Any) -> None:
        if self._scene is None:
            self._scene = scene_from_json(message.data)

    def _take_progress(self, message: Any) -> None:
        progress = progress_of(message)
        self._acknowledged = progress.samples
        self._finished = progress.finished or progress.error is not None
        if self._pace == "fast":
            self._send_due()

    def _send_due(self) -> None:
        if self._samples is None or self._finished:
            return
        assert self._scene is not None
        limit = self._acknowledged + (self._window if self._pace == "fast" else self._real_window)
        if self._pace == "real":
            elapsed = time.monotonic() - self._began
            due = int(elapsed * self._scene.sampling.samples_hz) + 1
            self._note_lag(due, limit, elapsed)
            limit = min(limit, due)
        while self._sent < limit:
            self._send_sample(next(self._samples))

    def _note_lag(self, due: int, limit: int, elapsed: float) -> None:
        assert self._scene is not None
        if due > limit:
            self._late += 1
            behind = elapsed - self._sent / self._scene.sampling.samples_hz
            self._worst_lag_s = max(self._worst_lag_s, behind)

    def _send_sample(self, sample: SledSample) -> None:
        assert self._scene is not None
        while self._readings.has_next_until(sample.stamp_ns):
            self.send(reading_publication(next(self._readings)))
        for publication in sample_publications(sample, self._scene):
            self.send(publication)
        self._sent += 1


def main(args: list[str] | None = None) -> None:
    """Runs the node."""
    run_node(SledNode, args)


if __name__ == "__main__":
    main()
