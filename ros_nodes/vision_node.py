"""Measures displacement live, from scene and camera alone: the same on the twin and on a real bench."""

from typing import Any

from config.errors import PalletTwinError
from config.scene import Scene
from config.scene_file import scene_from_json
from msgs_adapters.camera_payloads import Calibration, calibration_from_payload, picture_from_payload
from msgs_adapters.convert import progress_of
from msgs_adapters.topics import (
    CAMERA_IMAGE,
    CAMERA_INFO,
    CAMERA_PROGRESS,
    SCENE,
    VISION_DISPLACEMENT,
    VISION_REPORT,
)
from recordings.live_measurement import LiveMeasurement
from ros_nodes.node_process import TwinNode, run_node


class VisionNode(TwinNode):
    """Measured displacement as a node.

    Publishes ``vision/displacement`` for every picture and ``vision/report`` when the camera says that it took its last
    one; subscribes to ``scene``, ``camera/camera_info``, ``camera/image_raw`` and ``camera/progress``.
    """

    def __init__(self) -> None:
        super().__init__("vision_node")
        self.await_readers()
        self._scene: Scene | None = None
        self._calibration: Calibration | None = None
        self._measurement: LiveMeasurement | None = None
        self._early: list[bytes] = []
        self._taken = 0
        self._wanted: int | None = None

    def set_up(self) -> bool:
        """Opens the topics; what measures is made when scene and calibration are there."""
        for topic in (VISION_DISPLACEMENT, VISION_REPORT):
            self.open_topic(topic)
        self.listen(SCENE, self._take_scene)
        self.listen(CAMERA_INFO, self._take_calibration, raw=True)
        self.listen(CAMERA_IMAGE, self._take_picture, raw=True)
        self.listen(CAMERA_PROGRESS, self._take_progress)
        return True

    def on_end(self) -> None:
        """Sees that every reader has the report."""
        self.wait_for_acknowledgement()

    def _take_scene(self, message: Any) -> None:
        if self._scene is None:
            self._scene = scene_from_json(message.data)
            self._begin()

    def _take_calibration(self, payload: bytes) -> None:
        if self._calibration is None:
            self._calibration = calibration_from_payload(payload)
            self._begin()

    def _begin(self) -> None:
        """Three topics have no order between them: pictures wait for scene and calibration."""
        if self._scene is None or self._calibration is None:
            return
        try:
            self._measurement = LiveMeasurement(self._scene, self._calibration)
        except PalletTwinError as error:
            self.error, self.done = error, True
            return
        early, self._early = self._early, []
        for payload in early:
            self._take_picture(payload)

    def _take_picture(self, payload: bytes) -> None:
        if self._measurement is None:
            self._early.append(payload)
            return
        try:
            _, publication = self._measurement.take(*picture_from_payload(payload))
        except PalletTwinError as error:
            self.error, self.done = error, True
            return
        self.send(publication)
        self._taken += 1
        self._finish_if_complete()

    def _take_progress(self, message: Any) -> None:
        progress = progress_of(message)
        if progress.finished and self._wanted is None:
            self._wanted = progress.frames
            self._finish_if_complete()

    def _finish_if_complete(self) -> None:
        if self._measurement is not None and self._taken == self._wanted:
            self.send(self._measurement.finish()[1])


def main(args: list[str] | None = None) -> None:
    """Runs the node."""
    run_node(VisionNode, args)


if __name__ == "__main__":
    main()
