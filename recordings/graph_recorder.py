"""Records raw messages of a running graph: bytes in, the same bytes out, written by a thread of its own."""

import queue
import struct
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from config.scene import Scene
from config.scene_file import scene_from_json
from msgs_adapters.convert import motion_from_odometry
from msgs_adapters.pose_payloads import pose_frame_from_payload
from msgs_adapters.topics import (
    CAMERA_COMPRESSED,
    CAMERA_IMAGE,
    CAMERA_INFO,
    CLOCK,
    PACKAGES_POSES,
    SCENE,
    SLED_ACCELERATION,
    SLED_ACCELEROMETER,
    SLED_ODOMETRY,
    TF,
    TWIN_NAMESPACE,
    WRAP_STRAIN,
    Topic,
    message_class,
)
from recordings.bag_writer import BagWriter
from recordings.test_bag import TransformTrack, attach_scene

QUEUE_LIMIT = 200_000
QUEUE_BYTES = 512 * 2**20
"""What may wait for the disk: 200,000 messages of a bench, or 80 raw pictures of 1080p."""
FLUSH_PERIOD_S = 0.5
STAMPED_TYPES = frozenset(
    {
        "rosgraph_msgs/msg/Clock",
        "geometry_msgs/msg/AccelStamped",
        "geometry_msgs/msg/PoseArray",
        "sensor_msgs/msg/Imu",
        "sensor_msgs/msg/PointCloud2",
        "sensor_msgs/msg/Image",
        "sensor_msgs/msg/CompressedImage",
        "sensor_msgs/msg/CameraInfo",
        "visualization_msgs/msg/Marker",
        "nav_msgs/msg/Odometry",
        "diagnostic_msgs/msg/DiagnosticArray",
    }
)
"""Types whose payload begins, after the encapsulation, with the stamp."""
_STAMP = struct.Struct("<iI")


class GraphRecorder:
    """Takes payloads from any thread and writes them in order of arrival.

    The bag's clock is simulated time: the newest stamp seen. Messages without a stamp that come before the
    first stamped one wait for it, so that a bag begins where the test begins.

    Args:
        directory: the bag, made here.
        topics: what to record; ``/tf`` is added from poses and odometry.
        namespace: namespace of the relative topics.

    Raises:
        RefusedInput: the directory exists and is not empty.
    """

    def __init__(self, directory: Path, topics: Sequence[Topic], *, namespace: str = TWIN_NAMESPACE) -> None:
        self._writer = BagWriter(directory)
        self._names = {topic: self._writer.add_topic(topic, namespace=namespace) for topic in (*topics, TF)}
        self._queue: queue.Queue[tuple[Topic, bytes] | None] = queue.Queue(QUEUE_LIMIT)
        self._room, self._queued_bytes = threading.Condition(), 0
        self._waiting: list[tuple[Topic, bytes]] = []
        self._now_ns: int | None = None
        self._scene_json: str | None = None
        self._transforms: TransformTrack | None = None
        self._frames = 0
        self._gaps: dict[str, int] = {}
        self._rates_hz: dict[Topic, float] = {}
        self._last_stamps: dict[Topic, int] = {}
        self.error: str | None = None
        self.received: dict[str, int] = {topic.name: 0 for topic in topics}
        self.last_arrival = time.monotonic()
        self._thread = threading.Thread(target=self._write_all, name="bag writer")
        self._thread.start()

    def take(self, topic: Topic, payload: bytes) -> None:
        """Queues one message; waits where the disk is that far behind."""
        self.received[topic.name] += 1
        self.last_arrival = time.monotonic()
        with self._room:
            self._room.wait_for(lambda: self._queued_bytes < QUEUE_BYTES)
            self._queued_bytes += len(payload)
        self._queue.put((topic, payload))

    @property
    def gaps(self) -> dict[str, int]:
        """Messages that never arrived, by relative topic name: holes in the stamps of regular topics."""
        return dict(self._gaps)

    def close(self) -> None:
        """Writes what is queued, attaches the scene and finishes the bag."""
        self._queue.put(None)
        self._thread.join()
        if self._scene_json is not None:
            attach_scene(self._writer, scene_from_json(self._scene_json))
        counts = {f"received {name}": str(count) for name, count in self.received.items()}
        counts |= {f"missing {name}": str(count) for name, count in self._gaps.items()}
        self._writer.add_metadata("pallet-twin recorder", counts)
        self._writer.close()

    def _write_all(self) -> None:
        flushed = time.monotonic()
        while (entry := self._queue.get()) is not None:
            with self._room:
                self._queued_bytes -= len(entry[1])
                self._room.notify()
            if self.error is not None:
                continue
            try:
                self._write(*entry)
                if time.monotonic() - flushed > FLUSH_PERIOD_S:
                    self._writer.flush()
                    flushed = time.monotonic()
            except OSError as error:
                self.error = f"the bag cannot be written: {error.strerror}"

    def _write(self, topic: Topic, payload: bytes) -> None:
        stamp_ns = stamp_of(topic, payload)
        if stamp_ns is None and self._now_ns is None:
            self._waiting.append((topic, payload))
            return
        if stamp_ns is not None:
            self._note_gap(topic, stamp_ns)
            self._now_ns = max(stamp_ns, self._now_ns or 0)
            waiting, self._waiting = self._waiting, []
            for earlier, held in waiting:
                self._put(earlier, held, None)
        self._put(topic, payload, stamp_ns)

    def _note_gap(self, topic: Topic, stamp_ns: int) -> None:
        # rclpy's EventsExecutor cannot pass the publishers' sequence numbers on (7.1.6), stamps can.
        last_ns, rate_hz = self._last_stamps.get(topic), self._rates_hz.get(topic)
        if last_ns is not None and rate_hz is not None:
            missing = round((stamp_ns - last_ns) * rate_hz / 1.0e9) - 1
            if missing > 0:
                self._gaps[topic.name] = self._gaps.get(topic.name, 0) + missing
        self._last_stamps[topic] = stamp_ns

    def _put(self, topic: Topic, payload: bytes, stamp_ns: int | None) -> None:
        assert self._now_ns is not None
        self._writer.write(self._names[topic], payload, log_time_ns=self._now_ns, publish_time_ns=stamp_ns)
        if topic is SCENE and self._scene_json is None:
            self._scene_json = _decode(topic, payload).data
            scene = scene_from_json(self._scene_json)
            self._transforms = TransformTrack(scene)
            self._rates_hz = regular_rates_hz(scene)
        index = self._frames
        self._frames += topic is PACKAGES_POSES
        if self._transforms is None:
            return
        transforms = None
        if topic is SLED_ODOMETRY and stamp_ns is not None:
            motion = motion_from_odometry(_decode(topic, payload))
            transforms = self._transforms.add_position(stamp_ns, motion.position)
        elif topic is PACKAGES_POSES:
            transforms = self._transforms.add_frame(pose_frame_from_payload(payload, index))
        if transforms is not None:
            self._writer.write(
                self._names[TF],
                transforms.payload,
                log_time_ns=self._now_ns,
                publish_time_ns=transforms.stamp_ns,
            )


def regular_rates_hz(scene: Scene) -> dict[Topic, float]:
    """Topics whose stamps come at a fixed rate [Hz] in a scene."""
    rates: dict[Topic, float] = {
        CLOCK: scene.sampling.poses_hz,
        SLED_ODOMETRY: scene.sampling.poses_hz,
        PACKAGES_POSES: scene.sampling.poses_hz,
        SLED_ACCELERATION: scene.sampling.samples_hz,
    }
    if scene.accelerometer is not None:
        rates[SLED_ACCELEROMETER] = scene.accelerometer.rate_hz
    if scene.film is not None:
        rates[WRAP_STRAIN] = scene.sampling.poses_hz / scene.sampling.frames_a_film_frame
    if scene.camera is not None:
        rates |= dict.fromkeys((CAMERA_COMPRESSED, CAMERA_IMAGE, CAMERA_INFO), float(scene.camera.rate_hz))
    return rates


def stamp_of(topic: Topic, payload: bytes) -> int | None:
    """The stamp that a payload begins with [ns], or None for a type without one."""
    if topic.type_name not in STAMPED_TYPES:
        return None
    seconds, nanoseconds = _STAMP.unpack_from(payload, 4)
    return int(seconds) * 1_000_000_000 + int(nanoseconds)


def _decode(topic: Topic, payload: bytes) -> Any:
    from rclpy.serialization import deserialize_message

    return deserialize_message(payload, message_class(topic.type_name))
