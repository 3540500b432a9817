"""Which messages each part of a test sends, as topic, stamp and CDR bytes: one list for nodes and for bags."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from config.scene import Scene
from msgs_adapters.camera_payloads import Calibration, camera_info_payload, image_payload, jpeg_payload
from msgs_adapters.cdr import serialize
from msgs_adapters.colours import full_strain
from msgs_adapters.convert import to_diagnostics, to_float, to_markers, to_string
from msgs_adapters.film_mesh import film_mesh_payload
from msgs_adapters.film_payloads import film_cloud_payload
from msgs_adapters.pose_payloads import pose_array_payload
from msgs_adapters.robot_description import robot_description
from msgs_adapters.sled_payloads import accel_payload, imu_payload, odometry_payload
from msgs_adapters.stamps import to_clock
from msgs_adapters.topics import (
    CAMERA_COMPRESSED,
    CAMERA_IMAGE,
    CAMERA_INFO,
    CLASSIFIER_PROBABILITY,
    CLASSIFIER_REPORT,
    CLOCK,
    EUMOS_REPORT,
    EUMOS_STATUS,
    PACKAGES_MARKERS,
    PACKAGES_POSES,
    ROBOT_DESCRIPTION,
    SCENE,
    SLED_ACCELERATION,
    SLED_ACCELEROMETER,
    SLED_ODOMETRY,
    VISION_DISPLACEMENT,
    VISION_REPORT,
    WRAP_MESH,
    WRAP_STRAIN,
    Topic,
)
from sim_core.frames import AccelerometerSample, FilmFrame, PoseFrame, RuleState, SledSample

MARKERS_HZ = 30


class Publication(NamedTuple):
    """One message: its topic, the simulated time of what it says [ns], its CDR bytes."""

    topic: Topic
    stamp_ns: int
    payload: bytes


def sled_topics(scene: Scene) -> tuple[Topic, ...]:
    """What the sled sends in this scene."""
    sensor = (SLED_ACCELEROMETER,) if scene.accelerometer is not None else ()
    return (CLOCK, SLED_ACCELERATION, SLED_ODOMETRY, *sensor)


def film_topics(scene: Scene) -> tuple[Topic, ...]:
    """What the film is sent on in this scene, its mesh only while somebody looks."""
    return (WRAP_STRAIN, WRAP_MESH) if scene.film is not None else ()


def sample_publications(sample: SledSample, scene: Scene) -> Iterator[Publication]:
    """The acceleration of every sample; clock and odometry of those that a pose frame falls on."""
    if sample.index % (scene.sampling.samples_hz // scene.sampling.poses_hz) == 0:
        yield Publication(CLOCK, sample.stamp_ns, serialize(to_clock(sample.stamp_ns)))
        yield Publication(SLED_ODOMETRY, sample.stamp_ns, odometry_payload(sample))
    yield Publication(SLED_ACCELERATION, sample.stamp_ns, accel_payload(sample))


def reading_publication(reading: AccelerometerSample) -> Publication:
    """An accelerometer reading."""
    return Publication(SLED_ACCELEROMETER, reading.stamp_ns, imu_payload(reading))


def scene_publications(scene: Scene, stamp_ns: int) -> Iterator[Publication]:
    """What every late joiner needs: the scene, and the load as URDF."""
    pallet = scene.pallet_box
    description = robot_description(scene.packages, pallet.size_m if pallet is not None else None)
    yield Publication(SCENE, stamp_ns, serialize(to_string(scene.to_json())))
    yield Publication(ROBOT_DESCRIPTION, stamp_ns, serialize(to_string(description)))


def frame_publication(frame: PoseFrame) -> Publication:
    """The poses of a frame."""
    return Publication(PACKAGES_POSES, frame.stamp_ns, pose_array_payload(frame))


def markers_due(frame: PoseFrame, scene: Scene) -> bool:
    """Whether markers are sent with this frame, if anybody looks at them."""
    return frame.index % max(1, scene.sampling.poses_hz // MARKERS_HZ) == 0


def markers_publication(frame: PoseFrame, scene: Scene) -> Publication:
    """The load as coloured cubes."""
    pallet = scene.pallet_box
    message = to_markers(frame, scene.packages, pallet.size_m if pallet is not None else None)
    return Publication(PACKAGES_MARKERS, frame.stamp_ns, serialize(message))


def film_publication(frame: FilmFrame) -> Publication:
    """The film of a frame."""
    return Publication(WRAP_STRAIN, frame.stamp_ns, film_cloud_payload(frame))


def film_markers_publication(frame: FilmFrame, scene: Scene) -> Publication:
    """The film as a mesh coloured by strain, of a scene that has one."""
    assert scene.film is not None
    return Publication(WRAP_MESH, frame.stamp_ns, film_mesh_payload(frame, full_strain(scene.film.around)))


def camera_topics(scene: Scene) -> tuple[Topic, ...]:
    """What is recorded of the camera in this scene."""
    if scene.camera is None:
        return ()
    vision = (VISION_DISPLACEMENT, VISION_REPORT) if scene.camera.measure else ()
    return (CAMERA_INFO, CAMERA_IMAGE if scene.camera.record == "raw" else CAMERA_COMPRESSED, *vision)


def camera_info_publication(stamp_ns: int, calibration: Calibration) -> Publication:
    """The calibration, with every picture."""
    return Publication(CAMERA_INFO, stamp_ns, camera_info_payload(stamp_ns, calibration))


def image_publication(stamp_ns: int, pixels: NDArray[np.uint8]) -> Publication:
    """A picture as it is."""
    return Publication(CAMERA_IMAGE, stamp_ns, image_payload(stamp_ns, pixels))


def jpeg_publication(stamp_ns: int, jpeg: bytes) -> Publication:
    """A picture as JPEG."""
    return Publication(CAMERA_COMPRESSED, stamp_ns, jpeg_payload(stamp_ns, jpeg))


def displacement_publication(stamp_ns: int, payload: bytes) -> Publication:
    """What was measured in a picture, see ``vision_payloads``."""
    return Publication(VISION_DISPLACEMENT, stamp_ns, payload)


def vision_report_publication(stamp_ns: int, report_json: str) -> Publication:
    """The judgement from the pictures alone."""
    return Publication(VISION_REPORT, stamp_ns, serialize(to_string(report_json)))


def failure_probability_publication(stamp_ns: int, probability: float) -> Publication:
    """How likely the test fails, guessed from the pictures up to a stamp [ns]."""
    return Publication(CLASSIFIER_PROBABILITY, stamp_ns, serialize(to_float(probability)))


def guess_publication(stamp_ns: int, report_json: str) -> Publication:
    """What a classifier guesses of the whole video."""
    return Publication(CLASSIFIER_REPORT, stamp_ns, serialize(to_string(report_json)))


def rules_publication(stamp_ns: int, rules: list[RuleState]) -> Publication:
    """The rules as they stand."""
    return Publication(EUMOS_STATUS, stamp_ns, serialize(to_diagnostics(stamp_ns, rules)))


def report_publication(stamp_ns: int, report_json: str) -> Publication:
    """The judgement at the end."""
    return Publication(EUMOS_REPORT, stamp_ns, serialize(to_string(report_json)))
