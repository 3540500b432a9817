"""Guesses live from the pictures so far how likely the test fails: the same on the twin and on a real bench."""

import statistics
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from config.errors import PalletTwinError, RefusedInput
from msgs_adapters.camera_payloads import jpeg_from_payload
from msgs_adapters.convert import progress_of
from msgs_adapters.publications import failure_probability_publication, guess_publication
from msgs_adapters.topics import (
    CAMERA_COMPRESSED,
    CAMERA_PROGRESS,
    CLASSIFIER_PROBABILITY,
    CLASSIFIER_REPORT,
)
from ros_nodes.node_process import SUCCESS, LifecycleState, TwinNode, run_node
from sim_core.camera.jpeg import picture_of
from sim_core.report import report_json

if TYPE_CHECKING:
    from classifier.running import Answer, Judge, RunningJudge

ANSWER_PERIOD_S = 0.002


class ClassifierNode(TwinNode):
    """The video classifier as a node.

    Publishes ``classifier/failure_probability`` for the pictures so far, and ``classifier/report``, a JSON summary,
    once the camera has taken its last one; subscribes to ``camera/image_raw/compressed`` and ``camera/progress``. Of
    scene, poses and samples it hears nothing.

    Every picture is taken; an answer is made whenever no other one is on the way, so that pictures which come faster
    than answers share one. The last picture always has its own.
    """

    def __init__(self) -> None:
        super().__init__("classifier_node")
        self.await_readers()
        self._model = self.declare("model", "", "folder of a trained model")
        self._threads = self.declare("threads", 1, "of the network", from_value=1, to_value=256)
        self._judge: Judge | None = None
        self._running: RunningJudge | None = None
        self._answer: Answer | None = None
        self._stamp_ns, self._answered, self._came = 0, 0, 0.0
        self._latencies_s: list[float] = []
        self._wanted: int | None = None
        self._is_told = False

    def set_up(self) -> bool:
        """Reads the model and opens the topics.

        Raises:
            RefusedInput: there is no model.
        """
        if not self._model:
            raise RefusedInput("classifier_node.model", self._model, "must be the folder of a trained model")
        import torch

        from classifier.running import RunningJudge, read_judge

        torch.set_num_threads(self._threads)
        self._judge, _ = read_judge(Path(self._model))
        self._judge.warm_up()
        self._running = RunningJudge(self._judge)
        for topic in (CLASSIFIER_PROBABILITY, CLASSIFIER_REPORT):
            self.open_topic(topic)
        self.listen(CAMERA_COMPRESSED, self._take_picture, raw=True)
        self.listen(CAMERA_PROGRESS, self._take_progress)
        return True

    def on_activate(self, state: LifecycleState) -> Any:
        """Begins to answer, once its readers are there."""
        result = super().on_activate(state)
        if result == SUCCESS:
            # A timer of its own, so that pictures are taken in between two answers.
            self._timer = self.create_timer(ANSWER_PERIOD_S, self._answer_newest)
        return result

    def on_end(self) -> None:
        """Sees that every reader has the report."""
        self.wait_for_acknowledgement()

    def _take_picture(self, payload: bytes) -> None:
        assert self._running is not None
        self._came = time.monotonic()
        try:
            self._stamp_ns, jpeg = jpeg_from_payload(payload)
            self._running.take(picture_of(jpeg))
        except PalletTwinError as error:
            self.error, self.done = error, True

    def _answer_newest(self) -> None:
        """Answers where there is something new; one picture alone shows no change yet."""
        if self._running is None or self._running.pictures < 2 or self._running.pictures == self._answered:
            return
        try:
            self._answer = self._running.answer()
        except PalletTwinError as error:
            self.error, self.done = error, True
            return
        self._answered = self._running.pictures
        self.send(failure_probability_publication(self._stamp_ns, 1.0 - self._answer.success))
        self._latencies_s.append(time.monotonic() - self._came)
        self._finish_if_complete()

    def _take_progress(self, message: Any) -> None:
        progress = progress_of(message)
        if progress.finished and self._wanted is None:
            self._wanted = progress.frames
            self._finish_if_complete()

    def _finish_if_complete(self) -> None:
        if self._is_told or self._answer is None or self._answered != self._wanted:
            return
        from classifier.prediction import GUESS
        from classifier.running import mattering_frames

        assert self._judge is not None
        self._is_told = True
        told = {
            "verdict": "pass" if self._answer.passes else "fail",
            "success_probability": self._answer.success,
            "threshold": self._judge.success_threshold,
            "pictures": self._answered,
            "frames": mattering_frames(self._answer).tolist(),
            "answers": len(self._latencies_s),
            "median_answer_s": statistics.median(self._latencies_s),
            "last_answer_s": self._latencies_s[-1],
            "remark": self._answer.clip.remark,
            "told": GUESS,
        }
        self.send(guess_publication(self._stamp_ns, report_json(told, compact=True)))


def main(args: list[str] | None = None) -> None:
    """Runs the node."""
    run_node(ClassifierNode, args)


if __name__ == "__main__":
    main()
