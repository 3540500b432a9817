"""A test as a bag: every message that the node graph would send, and what makes a bag stand on its own."""

from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np
from numpy.typing import NDArray

from config.scene import Scene
from msgs_adapters.camera_payloads import Calibration
from msgs_adapters.pose_payloads import TransformEncoder
from msgs_adapters.publications import (
    Publication,
    camera_info_publication,
    camera_topics,
    film_publication,
    frame_publication,
    image_publication,
    jpeg_publication,
    reading_publication,
    report_publication,
    rules_publication,
    sample_publications,
    scene_publications,
    sled_topics,
)
from msgs_adapters.topics import (
    EUMOS_REPORT,
    EUMOS_STATUS,
    PACKAGES_POSES,
    ROBOT_DESCRIPTION,
    SCENE,
    TF,
    WRAP_STRAIN,
    Topic,
)
from recordings.bag_writer import BagWriter
from sim_core.frames import AccelerometerSample, Array, FilmFrame, PoseFrame, RuleState, SledSample

SCENE_ATTACHMENT = "scene.json"
TRANSFORMS_HZ = 60


def recorded_topics(scene: Scene) -> tuple[Topic, ...]:
    """What a bag of this scene holds, ``/tf`` aside."""
    film = (WRAP_STRAIN,) if scene.film is not None else ()
    return (
        *sled_topics(scene), SCENE, ROBOT_DESCRIPTION, PACKAGES_POSES, *film, *camera_topics(scene), EUMOS_STATUS,
        EUMOS_REPORT,
    )  # fmt: skip


class TransformTrack:
    """Pairs pose frames with the sled's positions and makes the ``/tf`` messages of a bag.

    Args:
        scene: the resolved scene.
    """

    def __init__(self, scene: Scene) -> None:
        self._encoder = TransformEncoder([package.id for package in scene.packages])
        self._every = max(1, scene.sampling.poses_hz // TRANSFORMS_HZ)
        self._travelled: dict[int, Array] = {}
        self._waiting: dict[int, PoseFrame] = {}

    def add_position(self, stamp_ns: int, position: Array) -> Publication | None:
        """Takes the sled's position [m] at a stamp; gives a message when its frame was waiting."""
        waiting = self._waiting.pop(stamp_ns, None)
        if waiting is not None:
            return self._publication(waiting, position)
        self._travelled[stamp_ns] = position
        while len(self._travelled) > 10_000:
            self._travelled.pop(next(iter(self._travelled)))
        return None

    def add_frame(self, frame: PoseFrame) -> Publication | None:
        """Takes a frame; gives a message when one is due and the sled's position is known."""
        if frame.index % self._every:
            return None
        position = self._travelled.pop(frame.stamp_ns, None)
        if position is None:
            self._waiting[frame.stamp_ns] = frame
            return None
        return self._publication(frame, position)

    def _publication(self, frame: PoseFrame, position: Array) -> Publication:
        return Publication(TF, frame.stamp_ns, self._encoder.encode(frame, position))


class TestBag:
    """Records a test that runs in this process; a ``TestObserver`` and a context manager.

    Args:
        directory: the bag, made here.
        scene: the resolved scene.

    Raises:
        RefusedInput: the directory exists and is not empty.
    """

    __test__ = False

    def __init__(self, directory: Path, scene: Scene) -> None:
        self._scene = scene
        self._writer = BagWriter(directory)
        self._names = {topic: self._writer.add_topic(topic) for topic in (*recorded_topics(scene), TF)}
        self._transforms = TransformTrack(scene)
        self._now_ns = 0

    @property
    def directory(self) -> Path:
        """The bag's directory."""
        return self._writer.path.parent

    def on_reading(self, reading: AccelerometerSample) -> None:
        """See ``TestObserver``."""
        self._write(reading_publication(reading))

    def on_sample(self, sample: SledSample) -> None:
        """See ``TestObserver``."""
        if sample.index == 0:
            for publication in scene_publications(self._scene, sample.stamp_ns):
                self._write(publication)
        for publication in sample_publications(sample, self._scene):
            self._write(publication)
        self._transforms.add_position(sample.stamp_ns, sample.position)

    def on_frame(self, frame: PoseFrame) -> None:
        """See ``TestObserver``."""
        self._write(frame_publication(frame))
        transforms = self._transforms.add_frame(frame)
        if transforms is not None:
            self._write(transforms)

    def on_film(self, frame: FilmFrame) -> None:
        """See ``TestObserver``."""
        self._write(film_publication(frame))

    def add_picture(
        self, stamp_ns: int, pixels: NDArray[np.uint8], jpeg: bytes, calibration: Calibration
    ) -> None:
        """Takes a picture of the scene's camera, as pixels and as JPEG, taken at a stamp [ns]."""
        assert self._scene.camera is not None
        self._write(camera_info_publication(stamp_ns, calibration))
        is_raw = self._scene.camera.record == "raw"
        self._write(image_publication(stamp_ns, pixels) if is_raw else jpeg_publication(stamp_ns, jpeg))

    def add(self, publication: Publication) -> None:
        """Takes any other message of the test."""
        self._write(publication)

    def on_rules(self, stamp_ns: int, rules: list[RuleState]) -> None:
        """See ``TestObserver``."""
        self._write(rules_publication(stamp_ns, rules))

    def finish(self, judgement_json: str) -> None:
        """Writes the judgement as the last message."""
        self._write(report_publication(self._now_ns, judgement_json))

    def close(self) -> None:
        """Attaches the scene and finishes the bag."""
        attach_scene(self._writer, self._scene)
        self._writer.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _write(self, publication: Publication) -> None:
        self._now_ns = max(self._now_ns, publication.stamp_ns)
        self._writer.write(
            self._names[publication.topic],
            publication.payload,
            log_time_ns=self._now_ns,
            publish_time_ns=publication.stamp_ns,
        )


def attach_scene(writer: BagWriter, scene: Scene) -> None:
    """Makes a bag self-contained."""
    writer.attach(SCENE_ATTACHMENT, "application/json", scene.to_json().encode())
