"""Pictures in bags: read in order, or shown again in the place of drawn ones."""

from collections.abc import Iterator
from pathlib import Path

from config.errors import BrokenRecording, RefusedInput
from config.scene import Scene
from msgs_adapters.camera_payloads import (
    Calibration,
    calibration_from_payload,
    jpeg_from_payload,
    picture_from_payload,
)
from msgs_adapters.topics import (
    CAMERA_COMPRESSED,
    CAMERA_IMAGE,
    CAMERA_INFO,
)
from recordings.bag_reader import BagReader
from recordings.judge_bag import topic_in_bag, topics_in_bag
from sim_core.camera.shot import Shot
from sim_core.camera.source import Picture
from sim_core.camera.view import CameraView, view_of


def has_pictures(reader: BagReader) -> bool:
    """Whether a bag holds pictures of a camera."""
    return any(topics_in_bag(reader, topic.name) for topic in (CAMERA_IMAGE, CAMERA_COMPRESSED))


def calibration_of_bag(reader: BagReader) -> Calibration:
    """The calibration that stands in a bag's first ``camera_info``.

    Raises:
        BrokenRecording: there is none.
    """
    for message in reader.messages([topic_in_bag(reader, CAMERA_INFO.name)]):
        return calibration_from_payload(message.payload)
    raise BrokenRecording("bag", str(reader.path), "has no camera_info message")


def pictures_of_bag(reader: BagReader) -> Iterator[Picture]:
    """Every picture of a bag in order; the raw ones where it holds both.

    Raises:
        BrokenRecording: it holds none, or one that cannot be read.
    """
    raw = topics_in_bag(reader, CAMERA_IMAGE.name)
    name = raw[0] if raw else topic_in_bag(reader, CAMERA_COMPRESSED.name)
    for index, message in enumerate(reader.messages([name])):
        if raw:
            stamp_ns, pixels = picture_from_payload(message.payload)
            yield Picture(index, stamp_ns, pixels=pixels)
            continue
        stamp_ns, jpeg = jpeg_from_payload(message.payload)
        yield Picture(index, stamp_ns, jpeg=jpeg)


class RecordedPictures:
    """The pictures of an earlier recording of the same test, as a ``PictureSource``.

    Args:
        path: the bag.
        scene: the resolved scene that is being played.

    Raises:
        RefusedInput: the bag holds no pictures, or they are of another size than the scene's.
    """

    def __init__(self, path: Path, scene: Scene) -> None:
        self._path, self._view = path, view_of(scene)
        self._reader = BagReader(path)
        seen = calibration_of_bag(self._reader)
        if (seen.width, seen.height) != (self._view.width, self._view.height):
            raise RefusedInput(
                "pictures",
                f"{seen.width} x {seen.height}",
                f"must be {self._view.width} x {self._view.height}",
            )
        self._pictures = pictures_of_bag(self._reader)

    @property
    def view(self) -> CameraView:
        """See ``PictureSource``."""
        return self._view

    @property
    def described(self) -> str:
        """See ``PictureSource``."""
        return f"recording {self._path.name}"

    def picture(self, shot: Shot) -> Picture:
        """The recorded picture with the shot's number.

        Raises:
            RefusedInput: the recording has no more pictures.
        """
        for picture in self._pictures:
            if picture.index == shot.index:
                return picture
        raise RefusedInput("pictures", str(self._path), f"holds no picture {shot.index}")

    def close(self) -> None:
        """Closes the bag."""
        self._reader.close()
