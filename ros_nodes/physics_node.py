"""Steps the load by the sled's samples: one exact step count a sample, poses out."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

from config.errors import EndedByMonitor, RefusedInput
from config.scene_file import scene_from_json
from msgs_adapters.cdr import serialize
from msgs_adapters.convert import Progress, sample_from_accel, to_progress
from msgs_adapters.publications import (
    Publication,
    film_markers_publication,
    film_publication,
    film_topics,
    frame_publication,
    markers_due,
    markers_publication,
    scene_publications,
)
from msgs_adapters.topics import (
    PACKAGES_MARKERS,
    PACKAGES_POSES,
    PHYSICS_PROGRESS,
    ROBOT_DESCRIPTION,
    SCENE,
    SLED_ACCELERATION,
    WRAP_MESH,
    WRAP_STRAIN,
)
from ros_nodes.node_process import FAILURE, LifecycleState, TwinNode, run_node
from ros_nodes.readers import readers_wanted
from sim_core.load_test import LoadTest
from sim_core.run import summarise_physics
from sim_core.sled import stamp_ns


class PhysicsNode(TwinNode):
    """The physics as a node.

    Publishes ``packages/poses``, ``physics/progress``, the latched ``scene`` and ``robot_description``, and
    ``packages/markers`` while somebody looks at them, and of a wrapped load ``wrap/strain``, and ``wrap/mesh``
    while somebody looks; subscribes to ``sled/acceleration``.

    A gap in the samples ends the test: a pose after it would be wrong.
    """

    def __init__(self) -> None:
        super().__init__("physics_node")
        self._scene_file = self.declare("scene_file", "", "resolved scene as JSON")
        self._readers = self.declare(
            "readers", "", "matched readers to wait for, topic=count, comma-separated"
        )
        self._acknowledge = self.declare(
            "acknowledge_samples", 16, "samples between two progress messages", from_value=1, to_value=4000
        )
        self._test: LoadTest | None = None
        self._next = self._frames = 0
        self._first_ns = 0
        self._over = False

    def set_up(self) -> bool:
        """Builds the load and opens the topics."""
        try:
            text = Path(self._scene_file).read_text(encoding="utf-8")
        except OSError as error:
            raise RefusedInput("scene_file", self._scene_file, error.strerror or "cannot be read") from None
        self._scene = scene_from_json(text)
        self._test = LoadTest(self._scene)
        for topic in (
            PACKAGES_POSES,
            PACKAGES_MARKERS,
            PHYSICS_PROGRESS,
            SCENE,
            ROBOT_DESCRIPTION,
            *film_topics(self._scene),
        ):
            self.open_topic(topic)
        self.listen(SLED_ACCELERATION, self._take_sample)
        return True

    def on_activate(self, state: LifecycleState) -> Any:
        """Sends the scene and waits for the samples."""
        wanted = readers_wanted(self._readers)
        # The scene tells the validator whether there is a film to listen to.
        film = {name: wanted.pop(name) for name in [WRAP_STRAIN.name] if name in wanted}
        missing = self.wait_for_readers(wanted)
        if missing is None:
            for publication in scene_publications(self._scene, 0):
                self.send(publication)
            missing = self.wait_for_readers(film)
        if missing is not None:
            self.get_logger().error(f"no reader for {missing}")
            return FAILURE
        return super().on_activate(state)

    def on_end(self) -> None:
        """Frees the engine once every reader has everything."""
        self.wait_for_acknowledgement()
        if self._test is not None:
            self._test.close()

    def _take_sample(self, message: Any) -> None:
        if self._over or self._test is None:
            return
        sample = sample_from_accel(message, None)
        if self._next == 0:
            self._first_ns = sample.stamp_ns
        due_ns = stamp_ns(self._next, self._scene.sampling.samples_hz, self._first_ns)
        if sample.stamp_ns != due_ns:
            self.fail(f"sled/acceleration has a gap: sample {self._next} at {due_ns} ns is missing")
            return
        try:
            frame = self._test.feed(self._next, sample.acceleration, sample.stamp_ns)
        except EndedByMonitor as error:
            self._over = True
            self._report_progress(error)
            return
        self._next += 1
        if frame is not None:
            self._frames += 1
            self.send(frame_publication(frame))
            if self._test.film_frame is not None:
                self.send(film_publication(self._test.film_frame))
                if self.has_readers(WRAP_MESH):
                    self.send(film_markers_publication(self._test.film_frame, self._scene))
            if markers_due(frame, self._scene) and self.has_readers(PACKAGES_MARKERS):
                self.send(markers_publication(frame, self._scene))
        self._over = self._test.finished
        if self._over or self._next % self._acknowledge == 0:
            self._report_progress(None)

    def _report_progress(self, error: EndedByMonitor | None) -> None:
        assert self._test is not None
        values = {"time_s": f"{self._test.time_s:.6f}"}
        if self._over:
            values["summary"] = json.dumps(asdict(summarise_physics(self._test, error)))
        if error is not None:
            values |= {"monitor": error.monitor, "reason": error.reason}
        message = to_progress(
            Progress(self._next, self._frames, self._over, str(error) if error is not None else None, values)
        )
        self.send(Publication(PHYSICS_PROGRESS, 0, serialize(message)))


def main(args: list[str] | None = None) -> None:
    """Runs the node."""
    run_node(PhysicsNode, args)


if __name__ == "__main__":
    main()
