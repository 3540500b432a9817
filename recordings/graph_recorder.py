"""Records raw messages of a running graph: bytes in, the same bytes out, written by a thread of its own."""

import struct
import threading
import time
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from config.errors import PalletTwinError
from config.scene import Scene
from config.scene_file import scene_from_json
from msgs_adapters.convert import motion_from_odometry
from msgs_adapters.pose_payloads import pose_frame_from_payload
from msgs_adapters.publications import Publication
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
GATHER_S = 0.01
"""The writer wakes up no more often than that: each message of its own would cost a switch of threads."""
BEHIND_S = 1.0
JUMP_NS = 500_000_000
RECORDER_RECORD = "pallet-twin recorder"
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


@dataclass(frozen=True)
class _Taken:
    """A message that waits for the disk; when it came, on the wall clock [ns] and on a steady one [s]."""

    topic: Topic
    payload: bytes
    receive_time_ns: int
    arrival_s: float


class GraphRecorder:
    """Takes payloads from any thread and writes them in order of arrival.

    The bag's clock is simulated time: the newest stamp seen. Messages without a stamp that come before the
    first stamped one wait for it, so that a bag begins where the test begins. When each message came, on the
    wall clock, is kept beside it.

    Args:
        directory: the bag, made here.
        topics: what to record; ``/tf`` is added from poses and odometry.
        namespace: namespace of the relative topics.
        split_bytes: see ``BagWriter``.
        split_s: see ``BagWriter``.

    Attributes:
        error: why nothing is recorded any more, None while all is well.
        notes: what is worth telling, a line each, as it happens.
        received: messages taken, by relative topic name.
        last_arrival: when the last message came, on ``time.monotonic`` [s].

    Raises:
        RefusedInput: the directory exists and is not empty, or cannot be written.
    """

    def __init__(
        self,
        directory: Path,
        topics: Sequence[Topic],
        *,
        namespace: str = TWIN_NAMESPACE,
        split_bytes: int | None = None,
        split_s: float | None = None,
    ) -> None:
        self._writer = BagWriter(directory, split_bytes=split_bytes, split_s=split_s)
        self._names = {topic: self._writer.add_topic(topic, namespace=namespace) for topic in (*topics, TF)}
        self._changed = threading.Condition()
        self._queue: deque[_Taken] = deque()
        self._count = self._bytes = self._most_count = self._most_bytes = 0
        self._most_behind_s = 0.0
        self._is_closing = False
        self._waiting: list[tuple[_Taken, int | None]] = []
        self._now_ns: int | None = None
        self._scene_json: str | None = None
        self._transforms: TransformTrack | None = None
        self._frames = 0
        self._gaps: dict[str, int] = {}
        self._jumps: dict[str, int] = {}
        self._rates_hz: dict[Topic, float] = {}
        self._last_stamps: dict[Topic, int] = {}
        self.error: str | None = None
        self.notes: list[str] = []
        self.received: dict[str, int] = {topic.name: 0 for topic in topics}
        self.last_arrival = time.monotonic()
        self._thread = threading.Thread(target=self._write_all, name="bag writer")
        self._thread.start()

    def take(self, topic: Topic, payload: bytes) -> None:
        """Queues one message; waits where the disk is that far behind."""
        self.received[topic.name] += 1
        self.last_arrival = time.monotonic()
        taken = _Taken(topic, payload, time.time_ns(), self.last_arrival)
        with self._changed:
            self._changed.wait_for(self._has_room)
            self._queue.append(taken)
            self._count += 1
            self._bytes += len(payload)
            self._most_count = max(self._most_count, self._count)
            self._most_bytes = max(self._most_bytes, self._bytes)
            self._changed.notify_all()

    @property
    def gaps(self) -> dict[str, int]:
        """Messages that never arrived, by relative topic name: holes in the stamps of regular topics."""
        return dict(self._gaps)

    def close(self) -> None:
        """Writes what is queued, attaches the scene and finishes the bag."""
        with self._changed:
            self._is_closing = True
            self._changed.notify_all()
        self._thread.join()
        facts = {f"received {name}": str(count) for name, count in self.received.items()}
        facts |= {f"missing {name}": str(count) for name, count in self._gaps.items()}
        facts |= {f"time went back {name}": str(count) for name, count in self._jumps.items()}
        facts |= {
            "most waiting messages": str(self._most_count),
            "most waiting bytes": str(self._most_bytes),
            "most behind s": f"{self._most_behind_s:.3f}",
        }
        try:
            with suppress(OSError):
                if self._scene_json is not None:
                    attach_scene(self._writer, scene_from_json(self._scene_json))
                self._writer.add_metadata(RECORDER_RECORD, facts)
            self._writer.close()
        except OSError as error:
            self._fail(error)

    def _has_room(self) -> bool:
        return self._is_closing or (self._count < QUEUE_LIMIT and self._bytes < QUEUE_BYTES)

    def _write_all(self) -> None:
        try:
            self._write_until_closed()
        finally:
            with self._changed:
                # Whatever ended this thread: nobody shall wait for it.
                if not self._is_closing:
                    self.error = self.error or "the bag cannot be written: its writer has ended"
                self._is_closing = True
                self._changed.notify_all()

    def _write_until_closed(self) -> None:
        flushed, is_closing = time.monotonic(), False
        while not is_closing:
            with self._changed:
                self._changed.wait_for(lambda: self._queue or self._is_closing, FLUSH_PERIOD_S)
                is_closing = self._is_closing
                batch, self._queue = self._queue, deque()
            while batch:
                taken = batch.popleft()
                if self.error is None:
                    self._write_safely(taken)
                with self._changed:
                    self._count -= 1
                    self._bytes -= len(taken.payload)
                    self._changed.notify_all()
            now = time.monotonic()
            # Also when nothing comes any more: a crash must not cost what stands in a half-filled chunk.
            if now - flushed > FLUSH_PERIOD_S and self.error is None:
                flushed = now
                with self._failing():
                    self._writer.flush()
            if not is_closing:
                time.sleep(GATHER_S)

    def _write_safely(self, taken: _Taken) -> None:
        behind_s = time.monotonic() - taken.arrival_s
        if behind_s > BEHIND_S and self._most_behind_s <= BEHIND_S:
            waiting = f"{self._count} messages, {self._bytes / 1e6:.0f} MB"
            self.notes.append(f"the bag fell behind by {behind_s:.1f} s: {waiting} wait for the disk")
        self._most_behind_s = max(self._most_behind_s, behind_s)
        with self._failing():
            self._write(taken)

    @contextmanager
    def _failing(self) -> Iterator[None]:
        """An error ends the recording, not the thread: the graph would wait for room for ever."""
        try:
            yield
        except OSError as error:
            self._fail(error)
        except PalletTwinError as error:
            self.error = f"the bag cannot be written: {error}"

    def _fail(self, error: OSError) -> None:
        kept = "what was written until then can be read"
        self.error = self.error or f"the bag cannot be written: {error.strerror}; {kept}"

    def _write(self, taken: _Taken) -> None:
        stamp_ns = stamp_of(taken.topic, taken.payload)
        if stamp_ns is None and self._now_ns is None:
            self._waiting.append((taken, None))
            return
        if stamp_ns is not None:
            self._note_stamp(taken.topic, stamp_ns)
            self._now_ns = max(stamp_ns, self._now_ns or 0)
        waiting, self._waiting = self._waiting, []
        for entry in (*waiting, (taken, stamp_ns)):
            self._put(*entry)

    def _note_stamp(self, topic: Topic, stamp_ns: int) -> None:
        # rclpy's EventsExecutor cannot pass the publishers' sequence numbers on (7.1.6), stamps can.
        last_ns, rate_hz = self._last_stamps.get(topic), self._rates_hz.get(topic)
        self._last_stamps[topic] = stamp_ns
        if last_ns is None:
            return
        if last_ns - stamp_ns > JUMP_NS:
            # Log times stand still until the newest stamp is reached again: they must not run backwards.
            self._jumps[topic.name] = self._jumps.get(topic.name, 0) + 1
            back_s = (last_ns - stamp_ns) / 1e9
            self.notes.append(f"time went back by {back_s:.3f} s in {topic.name}: its node has started anew")
        elif rate_hz is not None:
            missing = round((stamp_ns - last_ns) * rate_hz / 1.0e9) - 1
            if missing > 0:
                self._gaps[topic.name] = self._gaps.get(topic.name, 0) + missing

    def _put(self, taken: _Taken, stamp_ns: int | None) -> None:
        assert self._now_ns is not None
        topic, payload = taken.topic, taken.payload
        self._writer.write(
            self._names[topic],
            payload,
            log_time_ns=self._now_ns,
            publish_time_ns=stamp_ns,
            receive_time_ns=taken.receive_time_ns,
        )
        try:
            transforms = self._transforms_from(topic, payload, stamp_ns)
        # Bytes that are no such message are recorded as they are; only nothing can be made of them.
        except (PalletTwinError, struct.error, ValueError, LookupError, RuntimeError) as error:
            self.notes.append(f"{topic.name} cannot be understood: {error}")
            return
        if transforms is not None:
            self._writer.write(
                self._names[TF],
                transforms.payload,
                log_time_ns=self._now_ns,
                publish_time_ns=transforms.stamp_ns,
            )

    def _transforms_from(self, topic: Topic, payload: bytes, stamp_ns: int | None) -> Publication | None:
        """The ``/tf`` message that a message completes, if any."""
        if topic is SCENE:
            self._take_scene(_decode(topic, payload).data)
        index = self._frames
        self._frames += topic is PACKAGES_POSES
        if self._transforms is None:
            return None
        if topic is SLED_ODOMETRY and stamp_ns is not None:
            motion = motion_from_odometry(_decode(topic, payload))
            return self._transforms.add_position(stamp_ns, motion.position)
        if topic is PACKAGES_POSES:
            return self._transforms.add_frame(pose_frame_from_payload(payload, index))
        return None

    def _take_scene(self, text: str) -> None:
        if self._scene_json is None:
            scene = scene_from_json(text)
            self._scene_json = text
            self._rates_hz = regular_rates_hz(scene)
            # Frames without the sled's positions would only pile up.
            if {SLED_ODOMETRY, PACKAGES_POSES} <= set(self._names):
                self._transforms = TransformTrack(scene)
        elif text != self._scene_json:
            self.notes.append(
                "another scene was published: /tf and the attached scene are those of the first"
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
    if scene.camera is not None and scene.camera.pictures is None:
        rates |= dict.fromkeys((CAMERA_COMPRESSED, CAMERA_IMAGE, CAMERA_INFO), float(scene.camera.rate_hz))
    return rates


def stamp_of(topic: Topic, payload: bytes) -> int | None:
    """The stamp that a payload begins with [ns], or None for a type without one."""
    if topic.type_name not in STAMPED_TYPES or len(payload) < 4 + _STAMP.size:
        return None
    seconds, nanoseconds = _STAMP.unpack_from(payload, 4)
    return int(seconds) * 1_000_000_000 + int(nanoseconds)


def _decode(topic: Topic, payload: bytes) -> Any:
    from rclpy.serialization import deserialize_message

    return deserialize_message(payload, message_class(topic.type_name))
