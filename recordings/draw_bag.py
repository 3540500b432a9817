"""A recording seen by another camera: its pictures are drawn anew, all else is kept as it is."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from config.camera import Camera
from config.errors import RefusedInput
from config.scene import Scene
from config.scene_file import overridden
from msgs_adapters.camera_payloads import Calibration
from msgs_adapters.cdr import serialize
from msgs_adapters.convert import motion_from_odometry, to_string
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
    CLASSIFIER_PROBABILITY,
    CLASSIFIER_REPORT,
    PACKAGES_POSES,
    SCENE,
    SLED_ODOMETRY,
    VISION_DISPLACEMENT,
    VISION_REPORT,
    WRAP_STRAIN,
)
from recordings.bag_reader import BagReader
from recordings.bag_writer import BagWriter
from recordings.judge_bag import scene_of_bag, topic_in_bag, topics_in_bag
from recordings.test_bag import attach_scene
from sim_core.camera.shot import ShotsInOrder
from sim_core.camera.source import DrawnPictures, Picture

_DRAWN = (
    CAMERA_INFO, CAMERA_IMAGE, CAMERA_COMPRESSED, CAMERA_PROGRESS, VISION_DISPLACEMENT, VISION_REPORT,
    CLASSIFIER_PROBABILITY, CLASSIFIER_REPORT,
)  # fmt: skip

OnPicture = Callable[[int, float], None]


@dataclass(frozen=True)
class DrawnBag:
    """A recording with new pictures.

    Attributes:
        scene: the recording's, with the camera that drew.
        bag: the new bag.
        pictures: as JPEG, in order.
        drawn_by: what drew them.
    """

    scene: Scene
    bag: Path
    pictures: list[Picture]
    drawn_by: str


def scene_with_camera(scene: Scene, overrides: Sequence[str] = ()) -> Scene:
    """A recording's scene with another camera.

    Args:
        scene: the recording's.
        overrides: ``camera.key=value`` texts; a scene without a camera gets the usual one first.

    Raises:
        RefusedInput: an override is none of the camera, or cannot be used.
    """
    for override in overrides:
        if override.partition("=")[0].split(".")[0] != "camera":
            raise RefusedInput("--set", override, "must be of the camera: what was recorded stays")
    if scene.camera is None:
        scene = scene.model_copy(update={"camera": Camera()})
    return overridden(scene, overrides)


def draw_bag(
    path: Path, out: Path, overrides: Sequence[str] = (), *, on_picture: OnPicture | None = None
) -> DrawnBag:
    """Draws the pictures of a recording anew, from its poses, film and sled alone.

    Args:
        path: the recording.
        out: the new bag's directory, made here.
        overrides: ``camera.key=value`` texts.
        on_picture: called with the number of pictures drawn and the simulated time since the start [s].

    Raises:
        BrokenRecording: the recording is damaged, or lacks scene, poses, odometry or film.
        RefusedInput: the camera cannot be used, or the directory is not empty.
    """
    with BagReader(path) as reader:
        scene = scene_with_camera(scene_of_bag(reader), overrides)
        for topic in (PACKAGES_POSES, SLED_ODOMETRY, *((WRAP_STRAIN,) if scene.film is not None else ())):
            topic_in_bag(reader, topic.name)
        source = DrawnPictures(scene)
        try:
            with BagWriter(out) as writer:
                return DrawnBag(
                    scene, out, _redrawn(reader, writer, scene, source, on_picture), source.described
                )
        finally:
            source.close()


def _redrawn(
    reader: BagReader,
    writer: BagWriter,
    scene: Scene,
    source: DrawnPictures,
    on_picture: OnPicture | None,
) -> list[Picture]:
    """Copies all but scene and pictures, and puts new ones in as soon as all is known that they show."""
    assert scene.camera is not None
    left_out = {name for topic in _DRAWN for name in topics_in_bag(reader, topic.name)}
    kept = [recorded.topic for name, recorded in reader.topics.items() if name not in left_out]
    namespace = topic_in_bag(reader, PACKAGES_POSES.name).removesuffix(f"/{PACKAGES_POSES.name}")
    for topic in kept:
        writer.add_topic(topic)
    is_raw = scene.camera.record == "raw"
    pictured = CAMERA_IMAGE if is_raw else CAMERA_COMPRESSED
    names = {topic: writer.add_topic(topic, namespace=namespace) for topic in (CAMERA_INFO, pictured)}
    view = source.view
    calibration = Calibration(view.width, view.height, view.matrix, view.distortion)
    frames, shots = FramesInOrder(scene), ShotsInOrder(scene)
    pictures: list[Picture] = []

    def write(publication: Publication, log_time_ns: int) -> None:
        writer.write(
            names[publication.topic],
            publication.payload,
            log_time_ns=log_time_ns,
            publish_time_ns=publication.stamp_ns,
        )

    for message in reader.messages([topic.name for topic in kept]):
        payload = message.payload
        if message.topic_name.endswith(f"/{SCENE.name}"):
            payload = serialize(to_string(scene.to_json()))
        writer.write(
            message.topic_name,
            payload,
            log_time_ns=message.log_time_ns,
            publish_time_ns=message.publish_time_ns,
        )
        if message.topic_name.endswith(f"/{SLED_ODOMETRY.name}"):
            motion = motion_from_odometry(message.decode())
            shots.add_motion(motion.stamp_ns, motion.position, motion.velocity)
        elif message.topic_name.endswith(f"/{PACKAGES_POSES.name}"):
            frames.add_poses(message.payload)
        elif message.topic_name.endswith(f"/{WRAP_STRAIN.name}"):
            frames.add_film(message.payload)
        for frame, film in frames.ready():
            shots.add_frame(frame, film)
        for shot in shots.ready():
            picture = source.picture(shot)
            write(camera_info_publication(shot.stamp_ns, calibration), message.log_time_ns)
            write(
                image_publication(shot.stamp_ns, picture.pixels)
                if is_raw
                else jpeg_publication(shot.stamp_ns, picture.jpeg),
                message.log_time_ns,
            )
            pictures.append(Picture(picture.index, picture.stamp_ns, jpeg=picture.jpeg))
            if on_picture is not None:
                on_picture(len(pictures), (shot.stamp_ns - pictures[0].stamp_ns) * 1.0e-9)
    attach_scene(writer, scene)
    return pictures
