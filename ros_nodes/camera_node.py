"""Draws what the bench's camera sees, from scene, poses, film and the sled's motion alone."""

import time
from collections import deque
from pathlib import Path
from typing import TYPE_CHECKING, Any

from config.errors import PalletTwinError
from config.scene import Scene
from config.scene_file import scene_from_json
from msgs_adapters.camera_payloads import Calibration
from msgs_adapters.cdr import serialize
from msgs_adapters.convert import Progress, motion_from_odometry, progress_of, to_progress
from msgs_adapters.frames_in_order import FramesInOrder
from msgs_adapters.publications import (
    Publication,
    camera_info_publication,
    image_publication,
    jpeg_publication,
)
from msgs_adapters.topics import (
    CAMERA_COMPRESSED,
    CAMERA_IMAGE,
    CAMERA_INFO,
    CAMERA_PROGRESS,
    PACKAGES_POSES,
    PHYSICS_PROGRESS,
    SCENE,
    SLED_ODOMETRY,
    WRAP_STRAIN,
)
from ros_nodes.node_process import SUCCESS, LifecycleState, TwinNode, run_node

if TYPE_CHECKING:
    from sim_core.camera.shot import Shot, ShotsInOrder
    from sim_core.camera.source import PictureSource

DRAW_PERIOD_S = 0.001
LATE_S = 0.1
"""A picture that leaves so long after its poses came counts as late."""


class CameraNode(TwinNode):
    """The bench's camera as a node.

    Publishes ``camera/camera_info`` with every picture, ``camera/image_raw`` and ``camera/image_raw/compressed`` while
    somebody reads them, and ``camera/progress``; subscribes to ``scene``, ``packages/poses``, ``sled/odometry``,
    ``physics/progress`` and, where the scene has a film, ``wrap/strain``.
    """

    def __init__(self) -> None:
        super().__init__("camera_node")
        self.await_readers()
        self._pictures = self.declare(
            "pictures",
            "",
            "bag of the same test whose pictures are shown instead of drawing them; empty: draw",
        )
        self._pace = self.declare("pace", "fast", "fast: no picture is late; real: it is told how many were")
        self._scene: Scene | None = None
        self._source: PictureSource | None = None
        self._calibration: Calibration | None = None
        self._frames: FramesInOrder | None = None
        self._shots: ShotsInOrder | None = None
        self._early: list[bytes] = []
        self._motions: list[Any] = []
        self._due: deque[tuple[float, Shot]] = deque()
        self._taken = 0
        self._wanted: int | None = None
        self._late, self._latest_s = 0, 0.0

    def set_up(self) -> bool:
        """Opens the topics; the renderer is made when the scene arrives."""
        for topic in (CAMERA_INFO, CAMERA_IMAGE, CAMERA_COMPRESSED, CAMERA_PROGRESS):
            self.open_topic(topic)
        self.listen(SCENE, self._take_scene)
        self.listen(PACKAGES_POSES, self._take_poses, raw=True)
        self.listen(SLED_ODOMETRY, self._take_motion)
        self.listen(PHYSICS_PROGRESS, self._take_progress)
        return True

    def on_activate(self, state: LifecycleState) -> Any:
        """Begins to draw what comes, once its readers are there."""
        result = super().on_activate(state)
        if result == SUCCESS:
            # A timer of its own, so that messages are taken in between two pictures.
            self._timer = self.create_timer(DRAW_PERIOD_S, self._draw_one)
        return result

    def on_end(self) -> None:
        """Sees that every reader has every picture, and says how the pace was kept."""
        self.wait_for_acknowledgement()
        if self._late and self._pace == "real":
            self.get_logger().warning(
                f"camera fell behind with {self._late} of {self._taken} pictures, at most by {self._latest_s:.2f} s;"
                " none was dropped"
            )
        if self._source is not None:
            self._source.close()

    def _take_scene(self, message: Any) -> None:
        if self._scene is not None:
            return
        from sim_core.camera.shot import ShotsInOrder
        from sim_core.camera.source import DrawnPictures

        try:
            scene = scene_from_json(message.data)
            if self._pictures:
                from recordings.bag_pictures import RecordedPictures

                source: PictureSource = RecordedPictures(Path(self._pictures), scene)
            else:
                source = DrawnPictures(scene)
        except PalletTwinError as error:
            self.error, self.done = error, True
            return
        self.get_logger().info(f"pictures from {source.described}")
        view = source.view
        self._calibration = Calibration(view.width, view.height, view.matrix, view.distortion)
        self._scene, self._source = scene, source
        self._frames, self._shots = FramesInOrder(scene), ShotsInOrder(scene)
        if scene.film is not None:
            self.listen(WRAP_STRAIN, self._take_film, raw=True)
        for motion in self._motions:
            self._shots.add_motion(motion.stamp_ns, motion.position, motion.velocity)
        early, self._early, self._motions = self._early, [], []
        for payload in early:
            self._take_poses(payload)

    def _take_motion(self, message: Any) -> None:
        motion = motion_from_odometry(message)
        if self._shots is None:
            self._motions.append(motion)
            return
        self._shots.add_motion(motion.stamp_ns, motion.position, motion.velocity)
        self._queue_shots()

    def _take_poses(self, payload: bytes) -> None:
        if self._frames is None:
            # Two topics have no order between them: the scene may overtake its poses or not.
            self._early.append(payload)
            return
        self._frames.add_poses(payload)
        self._queue_shots()

    def _take_film(self, payload: bytes) -> None:
        assert self._frames is not None
        self._frames.add_film(payload)
        self._queue_shots()

    def _queue_shots(self) -> None:
        assert self._frames is not None and self._shots is not None
        for frame, film in self._frames.ready():
            self._shots.add_frame(frame, film)
        now = time.monotonic()
        self._due.extend((now, shot) for shot in self._shots.ready())

    def _take_progress(self, message: Any) -> None:
        progress = progress_of(message)
        if not progress.finished or self._wanted is not None or self._scene is None:
            return
        from sim_core.camera.moments import PictureMoments

        self._wanted = PictureMoments(self._scene).count(progress.frames)
        self._report_progress()

    def _draw_one(self) -> None:
        if not self._due:
            return
        assert self._source is not None and self._calibration is not None
        came, shot = self._due.popleft()
        try:
            picture = self._source.picture(shot)
        except PalletTwinError as error:
            self.error, self.done = error, True
            return
        self.send(camera_info_publication(shot.stamp_ns, self._calibration))
        if self.has_readers(CAMERA_IMAGE):
            self.send(image_publication(shot.stamp_ns, picture.pixels))
        if self.has_readers(CAMERA_COMPRESSED):
            self.send(jpeg_publication(shot.stamp_ns, picture.jpeg))
        self._taken += 1
        late_s = time.monotonic() - came
        self._late += late_s > LATE_S
        self._latest_s = max(self._latest_s, late_s)
        self._report_progress()

    def _report_progress(self) -> None:
        message = to_progress(
            Progress(
                self._taken,
                self._taken,
                self._taken == self._wanted,
                values={"pictures": str(self._taken), "of": str(self._wanted or "")},
            )
        )
        self.send(Publication(CAMERA_PROGRESS, 0, serialize(message)))


def main(args: list[str] | None = None) -> None:
    """Runs the node."""
    run_node(CameraNode, args)


if __name__ == "__main__":
    main()
