"""One test in this process, recorded and seen by its camera on the way: what one attempt leaves behind."""

import shutil
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from config.errors import RefusedInput
from config.scene import Scene
from sim_core.report import Report, judgement, report_json
from sim_core.run import TestObserver, TestResult, run_test

if TYPE_CHECKING:
    from msgs_adapters.publications import Publication
    from recordings.live_measurement import LiveMeasurement
    from recordings.test_bag import TestBag
    from sim_core.camera.source import Picture


@dataclass(frozen=True)
class RecordedTest:
    """One run in this process.

    Attributes:
        result: what the run left behind.
        judged: its judgement.
        seen: what its camera saw, or None without one.
    """

    __test__ = False

    result: TestResult
    judged: Report
    seen: "Seen | None"

    @property
    def smallest_step_s(self) -> float:
        """The step that the monitors left it with [s]."""
        return self.result.physics.smallest_step_s

    @property
    def is_complete(self) -> bool:
        """Whether it ran to its end."""
        return self.result.ended_by is None


def recorded_test(
    scene: Scene,
    *,
    bag: Path | None,
    with_camera: bool = True,
    on_progress: Callable[[float, dict[str, str]], None] | None = None,
) -> RecordedTest:
    """Runs a test, with the observers that its scene asks for.

    Args:
        scene: a resolved scene.
        bag: directory of the recording; what is there is replaced. None for no recording.
        with_camera: False leaves the camera out.
        on_progress: see ``run_test``.

    Raises:
        RefusedInput: the load fails its integrity check, or the camera cannot see or measure what it should.
    """
    with ExitStack() as stack:
        observers: list[TestObserver] = []
        recording = None
        if bag is not None:
            from recordings import test_bag

            # What is there is a coarser attempt's.
            shutil.rmtree(bag, ignore_errors=True)
            recording = stack.enter_context(test_bag.TestBag(bag, scene))
            observers.append(recording)
        seen: Seen | None = None
        if with_camera and scene.camera is not None:
            seen = Seen(scene, recording)
            stack.callback(seen.close)
            observers.append(seen.taker)
        result = run_test(scene, observers=observers, on_progress=on_progress)
        judged = judgement(scene, result.judge, is_complete=result.ended_by is None)
        if seen is not None:
            seen.finish()
        if recording is not None:
            recording.finish(report_json(judged, compact=True))
    return RecordedTest(result, judged, seen)


class Seen:
    """What the camera of a test in this process sees: kept as JPEG, recorded, and measured where the scene asks."""

    def __init__(self, scene: Scene, recording: "TestBag | None") -> None:
        from msgs_adapters.camera_payloads import Calibration
        from sim_core.camera.taker import PictureTaker

        assert scene.camera is not None
        self.pictures: list[Picture] = []
        self.measured: Report | None = None
        self.taker = PictureTaker(scene, [self._keep])
        self._recording = recording
        view = self.taker.source.view
        self._calibration = Calibration(view.width, view.height, view.matrix, view.distortion)
        self._live: LiveMeasurement | None = None
        if scene.camera.measure:
            from recordings import live_measurement

            if self.taker.source.described.startswith("TinyRenderer"):
                limit = "finds no OpenGL here, and TinyRenderer draws no targets: install Mesa's EGL"
                raise RefusedInput("camera.measure", True, limit)

            self._live = live_measurement.LiveMeasurement(scene, self._calibration)

    @property
    def drawn_by(self) -> str:
        """What made the pictures, in words."""
        return self.taker.source.described

    def close(self) -> None:
        """Frees the camera."""
        self.taker.close()

    def finish(self) -> None:
        """Judges what was measured."""
        if self._live is not None and self.pictures:
            self.measured, publication = self._live.finish()
            self._record(publication)

    def _keep(self, picture: "Picture") -> None:
        from sim_core.camera.source import Picture

        if self._recording is not None:
            self._recording.add_picture(picture.stamp_ns, picture.pixels, picture.jpeg, self._calibration)
        if self._live is not None:
            self._record(self._live.take(picture.stamp_ns, picture.pixels)[1])
        # As pixels they would take 6 MB each.
        self.pictures.append(Picture(picture.index, picture.stamp_ns, jpeg=picture.jpeg))

    def _record(self, publication: "Publication") -> None:
        if self._recording is not None:
            self._recording.add(publication)
