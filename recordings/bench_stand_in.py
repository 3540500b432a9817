"""Writes what a bench would have recorded of a scene: faulty accelerometer, noisy displacement, clocks of their own."""

from pathlib import Path

import numpy as np

from config.errors import RefusedInput
from config.scene import Scene
from msgs_adapters.cdr import serialize
from msgs_adapters.convert import to_imu
from msgs_adapters.pose_payloads import pose_array_payload
from msgs_adapters.topics import PACKAGES_POSES, SLED_ACCELEROMETER, VISION_DISPLACEMENT, Topic
from msgs_adapters.vision_payloads import displacement_payload
from recordings.bag_writer import BagWriter
from sim_core.bench_stand_in import SensorFaults, faulty_readings
from sim_core.camera.layout import facing_packages, near_face, side_of
from sim_core.frames import AccelerometerSample, PoseFrame
from sim_core.load_test import LoadTest
from sim_core.residual import near_sides

MACHINE = "/machine"
EPOCH_NS = 1_700_000_000_000_000_000
DISPLACEMENT_HZ = 60
LEAST_DELAY_NS, USUAL_DELAY_NS = 200_000, 300_000
"""A message arrives after the first, and the second more on average."""

Record = tuple[int, Topic, bytes]


def write_stand_in(
    directory: Path,
    scene: Scene,
    faults: SensorFaults,
    *,
    seed: int,
    displacement_sigma_m: float = 0.001,
    with_pictures: bool = False,
) -> Path:
    """Simulates a scene and writes what the bench would have recorded, under ``/machine``; no scene stands in it.

    Args:
        directory: the bag, made here.
        scene: a resolved scene with everything that is to be hidden.
        faults: of the accelerometer.
        seed: of every noise.
        displacement_sigma_m: standard deviation of a measured displacement [m].
        with_pictures: displacement as ``vision/displacement`` says it, of the near side; else as poses.

    Raises:
        RefusedInput: the directory is not empty, or nothing faces the camera.
        EndedByMonitor: the scene's test was ended.
    """
    chance = np.random.Generator(np.random.PCG64([seed, 1]))
    frames = _frames(scene)
    kind = VISION_DISPLACEMENT if with_pictures else PACKAGES_POSES
    payloads = (
        _clouds(scene, frames, displacement_sigma_m, chance)
        if with_pictures
        else _poses(frames, displacement_sigma_m, chance)
    )
    records: list[Record] = [
        (frame.stamp_ns, kind, payload) for frame, payload in zip(frames, payloads, strict=True)
    ]
    readings = faulty_readings(scene, faults, seed)
    for true_s, stamp_s, force in zip(readings.true_times, readings.stamps, readings.forces, strict=True):
        sample = AccelerometerSample(EPOCH_NS + round(1.0e9 * stamp_s), force, faults.noise_mps2**2)
        records.append((EPOCH_NS + round(1.0e9 * true_s), SLED_ACCELEROMETER, serialize(to_imu(sample))))
    delays = LEAST_DELAY_NS + chance.exponential(USUAL_DELAY_NS, len(records))
    arrived = [
        (stamp_ns + round(delay), topic, payload)
        for (stamp_ns, topic, payload), delay in zip(records, delays, strict=True)
    ]
    with BagWriter(directory) as bag:
        names = {topic: bag.add_topic(topic, namespace=MACHINE) for topic in (SLED_ACCELEROMETER, kind)}
        for log_ns, topic, payload in sorted(arrived, key=lambda record: record[0]):
            bag.write(names[topic], payload, log_time_ns=log_ns)
    return directory


def _frames(scene: Scene) -> list[PoseFrame]:
    """Every so many frames of the test, stamped from ``EPOCH_NS`` on."""
    every = max(1, scene.sampling.poses_hz // DISPLACEMENT_HZ)
    test = LoadTest(scene)
    try:
        return [
            PoseFrame(
                frame.index,
                EPOCH_NS + round(1.0e9 * frame.index / scene.sampling.poses_hz),
                frame.positions,
                frame.orientations,
            )
            for frame in test.frames()
            if frame.index % every == 0
        ]
    finally:
        test.close()


def _poses(frames: list[PoseFrame], sigma_m: float, chance: np.random.Generator) -> list[bytes]:
    return [
        pose_array_payload(
            PoseFrame(
                frame.index,
                frame.stamp_ns,
                frame.positions + sigma_m * chance.standard_normal(frame.positions.shape),
                frame.orientations,
            )
        )
        for frame in frames
    ]


def _clouds(
    scene: Scene, frames: list[PoseFrame], sigma_m: float, chance: np.random.Generator
) -> list[bytes]:
    rows = np.array(facing_packages(scene), dtype=np.intp)
    if not len(rows):
        raise RefusedInput("load", len(scene.packages), "must have a package whose side faces the camera")
    observed, side = near_sides(scene, rows), side_of(scene)
    faces = np.array([near_face(scene, int(row)) for row in rows], dtype=float)
    first = observed.places(frames[0])
    written = []
    for frame in frames:
        moved = observed.places(frame) - first
        written.append(
            displacement_payload(
                frame.stamp_ns,
                side=side,
                faces=faces + frames[0].positions[rows][:, None],
                rows=rows,
                displacement=moved + sigma_m * chance.standard_normal(moved.shape),
                sigma=np.full(moved.shape, sigma_m),
                states=("tracked",) * len(rows),
            )
        )
    return written
