"""Says what differs between the machine and the twin that runs beside it: measured less simulated displacement."""

from typing import Any

from config.errors import PalletTwinError
from config.scene import RecordedSled, Scene
from config.scene_file import scene_from_json
from msgs_adapters.cdr import serialize
from msgs_adapters.convert import progress_of, to_string
from msgs_adapters.measured_displacement import displacement_from_payload
from msgs_adapters.pose_payloads import pose_frame_from_payload
from msgs_adapters.publications import Publication
from msgs_adapters.residual_payloads import residual_payload
from msgs_adapters.topics import (
    PACKAGES_POSES,
    PHYSICS_PROGRESS,
    RESIDUAL_DISPLACEMENT,
    RESIDUAL_REPORT,
    SCENE,
    VISION_DISPLACEMENT,
    Topic,
)
from ros_nodes.node_process import TwinNode, run_node
from sim_core.report import report_json
from sim_core.residual import Difference, DisplacementResidual, near_sides

MACHINE_NAMESPACE = "/machine"


class ResidualNode(TwinNode):
    """The comparison as a node.

    Publishes ``residual/displacement`` for every measurement and ``residual/report``, a JSON summary, once the twin's
    test is over; subscribes to ``scene``, ``packages/poses``, ``physics/progress`` and to the measured displacement of
    the machine.

    The twin's sample 0 is the machine's time ``measured_start_ns``; where that is 0, it is what the scene's recorded
    sled says, or else both have one clock.
    """

    def __init__(self) -> None:
        super().__init__("residual_node")
        self.await_readers()
        self._measured = self.declare(
            "measured_topic",
            VISION_DISPLACEMENT.absolute_name(MACHINE_NAMESPACE),
            "measured displacement, sensor_msgs/PointCloud2 as vision/displacement",
        )
        self._start_ns = self.declare(
            "measured_start_ns", 0, "the twin's sample 0 on the measurement's clock [ns]; 0: as the scene says",
            from_value=0, to_value=2**62,
        )  # fmt: skip
        self._scene: Scene | None = None
        self._residual: DisplacementResidual | None = None
        self._early_poses: list[bytes] = []
        self._early_clouds: list[bytes] = []
        self._first_ns: int | None = None
        self._frames = 0
        self._frames_at_end: int | None = None

    def set_up(self) -> bool:
        """Opens the topics; what compares is made when scene and first measurement are there."""
        self.open_topic(RESIDUAL_DISPLACEMENT)
        self.open_topic(RESIDUAL_REPORT)
        self.listen(SCENE, self._take_scene)
        self.listen(PACKAGES_POSES, self._take_poses, raw=True)
        self.listen(PHYSICS_PROGRESS, self._take_progress)
        measured = Topic(self._measured, VISION_DISPLACEMENT.type_name, VISION_DISPLACEMENT.qos)
        self.listen(measured, self._take_cloud, raw=True)
        return True

    def on_end(self) -> None:
        """Sees that every reader has the report."""
        self.wait_for_acknowledgement()

    def _take_scene(self, message: Any) -> None:
        if self._scene is None:
            self._scene = scene_from_json(message.data)
            early, self._early_poses = self._early_poses, []
            for payload in early:
                self._take_poses(payload)

    def _take_poses(self, payload: bytes) -> None:
        if self._scene is None or self._residual is None:
            # Three topics have no order between them.
            self._early_poses.append(payload)
            if self._scene is not None and self._early_clouds:
                self._begin()
            return
        frame = pose_frame_from_payload(payload, self._frames)
        self._first_ns = frame.stamp_ns if self._first_ns is None else self._first_ns
        self._frames += 1
        time_s = (frame.stamp_ns - self._first_ns) / 1.0e9
        self._send(self._residual.add_simulated(time_s, frame))
        self._finish_if_complete()

    def _take_cloud(self, payload: bytes) -> None:
        if self._residual is None or self._first_ns is None:
            self._early_clouds.append(payload)
            if self._scene is not None and self._early_poses:
                self._begin()
            return
        try:
            cloud = displacement_from_payload(payload)
            time_s = (cloud.stamp_ns - self._measured_start_ns()) / 1.0e9
            # The load stands before sample 0 of the twin.
            if time_s >= 0.0:
                self._send(self._residual.add_measured(time_s, cloud.displacement, cloud.sigma))
                self._finish_if_complete()
        except PalletTwinError as error:
            self.error, self.done = error, True

    def _begin(self) -> None:
        """The first measurement says which packages are seen."""
        assert self._scene is not None
        try:
            rows = displacement_from_payload(self._early_clouds[0]).rows
            self._residual = DisplacementResidual(self._scene, near_sides(self._scene, rows))
        except PalletTwinError as error:
            self.error, self.done = error, True
            return
        poses, self._early_poses = self._early_poses, []
        clouds, self._early_clouds = self._early_clouds, []
        for payload in poses:
            self._take_poses(payload)
        for payload in clouds:
            self._take_cloud(payload)

    def _measured_start_ns(self) -> int:
        if self._start_ns:
            return int(self._start_ns)
        sled = self._scene.sled if self._scene is not None else None
        if isinstance(sled, RecordedSled) and sled.source is not None:
            return sled.source.start_ns
        assert self._first_ns is not None
        return self._first_ns

    def _send(self, differences: list[Difference]) -> None:
        for difference in differences:
            stamp_ns = self._measured_start_ns() + round(1.0e9 * difference.time_s)
            payload = residual_payload(stamp_ns, difference)
            self.send(Publication(RESIDUAL_DISPLACEMENT, stamp_ns, payload))

    def _take_progress(self, message: Any) -> None:
        progress = progress_of(message)
        if progress.finished and self._frames_at_end is None:
            self._frames_at_end = progress.frames
            self._finish_if_complete()

    def _finish_if_complete(self) -> None:
        """After the last frame the load stands; whatever is measured then makes a new report."""
        if self._residual is None or self._frames != self._frames_at_end:
            return
        self._send(self._residual.finish())
        text = report_json(self._residual.summary(), compact=True)
        self.send(Publication(RESIDUAL_REPORT, 0, serialize(to_string(text))))


def main(args: list[str] | None = None) -> None:
    """Runs the node."""
    run_node(ResidualNode, args)


if __name__ == "__main__":
    main()
