"""A small recording with messages on every topic of the twin."""

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from config.package import Package
from msgs_adapters import convert, topics
from msgs_adapters.cdr import serialize
from msgs_adapters.film_mesh import film_mesh_payload
from msgs_adapters.film_payloads import film_cloud_payload
from msgs_adapters.pose_payloads import TransformEncoder, pose_array_payload
from msgs_adapters.robot_description import robot_description
from msgs_adapters.stamps import to_clock
from recordings.bag_writer import BagWriter
from sim_core.frames import AccelerometerSample, FilmFrame, PoseFrame, RuleState, SledSample

EPOCH_NS = 1_700_000_000 * 10**9
PERIOD_NS = 4_166_667
FRAME_COUNT = 60
PALLET_SIZE_M = (1.2, 0.8, 0.144)
PACKAGES = [
    Package(id="a & <1>", size_m=(0.4, 0.3, 0.25), mass_kg=10, position_m=(0, 0, 0.269), layer=1),
    Package(id="b", size_m=(0.2, 0.3, 0.25), mass_kg=10, position_m=(0, 0, 0.519), layer=2),
]
RULE = RuleState("permanent", "Permanent displacement", "pass", 40.0, 1.5, 38.5, "b", 3, 0.1, 0.6, 0.2)

Records = Iterator[tuple[topics.Topic, bytes, int]]


def pose_frame(index: int) -> PoseFrame:
    """The upper package slides forward by 1 mm a frame."""
    positions = np.array([[0.0, 0.0, 0.072], [0.0, 0.0, 0.269], [0.001 * index, 0.0, 0.519]])
    return PoseFrame(index, EPOCH_NS + index * PERIOD_NS, positions, np.tile([0.0, 0.0, 0.0, 1.0], (3, 1)))


def film_frame(index: int, *, torn_s: float = -1.0) -> FilmFrame:
    """Two elements beside the packages, stretched a little more each frame; the second one torn or not."""
    corners = np.array(
        [[[0.2, 0, 0], [0.2, 0.1, 0], [0.2, 0.1, 0.6]], [[0.2, 0, 0], [0.2, 0.1, 0.6], [0.2, 0, 0.6]]]
    )
    strains = np.full((2, 3), 0.03 + 0.001 * index)
    values = (
        corners,
        corners[:, :, 1:],
        strains,
        strains[:, 0],
        1.0e4 * strains[:, 0],
        np.array([-1.0, torn_s]),
    )
    return FilmFrame(index, EPOCH_NS + index * PERIOD_NS, *(value.astype(np.float32) for value in values))


def records() -> Records:
    """Topic, payload and log time [ns] of every message, in order."""
    description = robot_description(PACKAGES, PALLET_SIZE_M)
    yield topics.SCENE, serialize(convert.to_string('{"name": "two"}')), EPOCH_NS
    yield topics.ROBOT_DESCRIPTION, serialize(convert.to_string(description)), EPOCH_NS
    transforms = TransformEncoder([package.id for package in PACKAGES])
    for index in range(FRAME_COUNT):
        frame, time_s = pose_frame(index), index * PERIOD_NS / 1e9
        acceleration = np.array([2.0, 0.0, 0.0])
        sample = SledSample(
            index, frame.stamp_ns, PERIOD_NS / 1e9, acceleration, acceleration * time_s,
            0.5 * acceleration * time_s**2,
        )  # fmt: skip
        reading = AccelerometerSample(frame.stamp_ns, np.array([2.0, 0.0, 9.80665]), 1e-4)
        progress = convert.Progress(index + 1, index + 1, values={"real_time_factor": "2.5"})
        for topic, payload in (
            (topics.CLOCK, serialize(to_clock(frame.stamp_ns))),
            (topics.SLED_ACCELERATION, serialize(convert.to_accel(sample))),
            (topics.SLED_ACCELEROMETER, serialize(convert.to_imu(reading))),
            (topics.SLED_ODOMETRY, serialize(convert.to_odometry(sample))),
            (topics.PACKAGES_POSES, pose_array_payload(frame)),
            (topics.TF, transforms.encode(frame, sample.position)),
            (topics.PACKAGES_MARKERS, serialize(convert.to_markers(frame, PACKAGES, PALLET_SIZE_M))),
            (topics.WRAP_STRAIN, film_cloud_payload(film_frame(index))),
            (topics.WRAP_MESH, film_mesh_payload(film_frame(index), 0.09)),
            (topics.PHYSICS_PROGRESS, serialize(convert.to_progress(progress))),
            (topics.DIAGNOSTICS, serialize(convert.to_diagnostics(frame.stamp_ns, []))),
            (topics.EUMOS_STATUS, serialize(convert.to_diagnostics(frame.stamp_ns, [RULE]))),
        ):
            yield topic, payload, frame.stamp_ns
    yield topics.EUMOS_REPORT, serialize(convert.to_string('{"verdict": "pass"}')), frame.stamp_ns


def write_sample_bag(directory: Path) -> Path:
    with BagWriter(directory, chunk_bytes=8192) as bag:
        for topic in topics.ALL_TOPICS:
            bag.add_topic(topic)
        for topic, payload, stamp_ns in records():
            bag.write(topic.absolute_name(), payload, log_time_ns=stamp_ns)
        bag.attach("scene.json", "application/json", b'{"name": "two"}')
        bag.attach("report.json", "application/json", b'{"verdict": "pass"}')
        bag.add_metadata("pallet_twin", {"version": "0", "gaps": "0"})
    return directory


@pytest.fixture(scope="session")
def sample_bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_sample_bag(tmp_path_factory.mktemp("bags") / "sample")


@pytest.fixture
def sample_records() -> list[tuple[str, bytes, int]]:
    return [(topic.absolute_name(), payload, stamp_ns) for topic, payload, stamp_ns in records()]


@pytest.fixture
def make_bag() -> Callable[[Path], Path]:
    return write_sample_bag


@pytest.fixture
def mcap_bytes(sample_bag: Path) -> bytes:
    return (sample_bag / "sample_0.mcap").read_bytes()
