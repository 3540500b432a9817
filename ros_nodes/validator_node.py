"""Judges the EUMOS limits live, from scene, poses and film alone."""

from typing import Any

from config.scene import Scene
from config.scene_file import scene_from_json
from msgs_adapters.convert import progress_of
from msgs_adapters.frames_in_order import FramesInOrder
from msgs_adapters.publications import report_publication, rules_publication
from msgs_adapters.topics import (
    EUMOS_REPORT,
    EUMOS_STATUS,
    PACKAGES_POSES,
    PHYSICS_PROGRESS,
    SCENE,
    WRAP_STRAIN,
)
from ros_nodes.node_process import TwinNode, run_node
from sim_core.judge import EumosJudge
from sim_core.report import judgement, report_json
from sim_core.run import status_due


class ValidatorNode(TwinNode):
    """The judge as a node.

    Publishes ``eumos/status`` ten times a simulated second and ``eumos/report`` at the end; subscribes to
    ``scene``, ``packages/poses`` and ``physics/progress``, and to ``wrap/strain`` where the scene has a film.
    """

    def __init__(self) -> None:
        super().__init__("validator_node")
        self.await_readers()
        self._scene: Scene | None = None
        self._judge: EumosJudge | None = None
        self._frames: FramesInOrder | None = None
        self._early: list[bytes] = []
        self._last_ns = 0
        self._frames_at_end: int | None = None
        self._is_complete = True
        self._status_sent = False

    def set_up(self) -> bool:
        """Opens the topics; the judge is made when the scene arrives, and the film's topic opened."""
        self.open_topic(EUMOS_STATUS)
        self.open_topic(EUMOS_REPORT)
        self.listen(SCENE, self._take_scene)
        self.listen(PACKAGES_POSES, self._take_poses, raw=True)
        self.listen(PHYSICS_PROGRESS, self._take_progress)
        return True

    def on_end(self) -> None:
        """Sees that every reader has the report."""
        self.wait_for_acknowledgement()

    def _take_scene(self, message: Any) -> None:
        if self._scene is None:
            self._scene = scene_from_json(message.data)
            self._judge = EumosJudge(self._scene)
            self._frames = FramesInOrder(self._scene)
            if self._scene.film is not None:
                self.listen(WRAP_STRAIN, self._take_film, raw=True)
            early, self._early = self._early, []
            for payload in early:
                self._take_poses(payload)

    def _take_poses(self, payload: bytes) -> None:
        if self._frames is None:
            # Two topics have no order between them: the scene may overtake its poses or not.
            self._early.append(payload)
            return
        self._frames.add_poses(payload)
        self._judge_what_is_there()

    def _take_film(self, payload: bytes) -> None:
        assert self._frames is not None
        self._frames.add_film(payload)
        self._judge_what_is_there()

    def _judge_what_is_there(self) -> None:
        assert self._judge is not None and self._scene is not None and self._frames is not None
        for frame, film in self._frames.ready():
            self._judge.add(frame)
            if film is not None:
                self._judge.add_film(film)
            self._last_ns = frame.stamp_ns
            self._status_sent = status_due(frame, self._scene)
            if self._status_sent:
                self._send_status()
            if self._frames_at_end == self._judge.frame_count:
                self._send_report()

    def _take_progress(self, message: Any) -> None:
        progress = progress_of(message)
        if not progress.finished or self._frames_at_end is not None:
            return
        self._frames_at_end = progress.frames
        self._is_complete = progress.error is None
        if self._judge is not None and self._judge.frame_count == progress.frames:
            self._send_report()

    def _send_status(self) -> None:
        assert self._judge is not None
        self.send(rules_publication(self._last_ns, self._judge.rules()))

    def _send_report(self) -> None:
        assert self._judge is not None and self._scene is not None
        if self._is_complete and not self._status_sent:
            self._send_status()
        report = judgement(self._scene, self._judge, is_complete=self._is_complete)
        self.send(report_publication(self._last_ns, report_json(report, compact=True)))


def main(args: list[str] | None = None) -> None:
    """Runs the node."""
    run_node(ValidatorNode, args)


if __name__ == "__main__":
    main()
