"""The sled's samples from any bag's accelerometer: readings, their clock against the recording's, and the motion."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from config.errors import BrokenRecording
from msgs_adapters.convert import accelerometer_sample
from recordings.bag_reader import BagReader
from sim_core.bench_signal import BenchMotion, sled_motion
from sim_core.frames import Array

IMU = "sensor_msgs/msg/Imu"
SAME_CLOCK_MS, SAME_CLOCK_PPM = 20.0, 100.0
"""A sensor's stamps within this of the recording's clock are taken as they are: the rest is transport."""
_CLOCK_BLOCKS = 20


@dataclass(frozen=True)
class ClockFit:
    """The recording's clock against that of a message's stamps.

    Attributes:
        offset_ns: the recording's clock ahead of the sensor's at the first message, least delay included [ns].
        drift: the recording's clock gains so much on the sensor's, as a share.
    """

    offset_ns: float
    drift: float

    @property
    def is_same(self) -> bool:
        """Whether the stamps are on the recording's clock already."""
        return abs(self.offset_ns) < 1.0e6 * SAME_CLOCK_MS and abs(self.drift) < 1.0e-6 * SAME_CLOCK_PPM

    def moved(self, stamps: NDArray[np.int64]) -> NDArray[np.int64]:
        """Stamps on the recording's clock [ns], shape [n]; those of the same clock stay as they are."""
        if self.is_same:
            return stamps
        since = stamps - stamps[0]
        moved: NDArray[np.int64] = stamps + np.round(self.offset_ns + self.drift * since).astype(np.int64)
        return moved


def imu_topics(reader: BagReader) -> list[str]:
    """Absolute names of the topics of a bag that carry accelerometer readings."""
    return [
        name
        for name, recorded in reader.topics.items()
        if recorded.topic.type_name == IMU and recorded.message_count
    ]


def bench_motion(
    reader: BagReader, topic_name: str, *, samples_hz: int, direction: str | float = "+x"
) -> BenchMotion:
    """The motion of the sled that an Imu topic of a bag recorded.

    Args:
        reader: the open bag.
        topic_name: absolute.
        samples_hz: rate of the samples.
        direction: of the travel in frame ``sled``.

    Raises:
        RefusedInput: the readings are no recording of a sled's test, or have a long gap in the motion.
        BrokenRecording: the bag is damaged or has no such topic.
    """
    stamps, logs, forces = readings_of(reader, topic_name)
    fit = clock_fit(stamps, logs)
    on_bag_clock = fit.moved(stamps) if fit is not None else stamps
    times = (on_bag_clock - on_bag_clock[0]) / 1.0e9
    motion = sled_motion(
        times, forces, samples_hz=samples_hz, direction=direction, start_ns=int(on_bag_clock[0])
    )
    found: dict[str, object] = {"topic": topic_name}
    if fit is not None:
        found |= {
            "clock_offset_ms": fit.offset_ns / 1.0e6,
            "clock_drift_ppm": 1.0e6 * fit.drift,
            "uses_sensor_clock": fit.is_same,
        }
    return BenchMotion(
        motion.samples, motion.start_s, motion.level_mps2, motion.source.model_copy(update=found)
    )


def readings_of(reader: BagReader, topic_name: str) -> tuple[NDArray[np.int64], NDArray[np.int64], Array]:
    """Stamps [ns], log times [ns] and specific forces [m/s²], shape [n, 3], in order of the stamps.

    A reading that came twice counts once.

    Raises:
        BrokenRecording: the bag has no such topic, or another type on it.
        RefusedInput: a reading is not finite, or the sensor says that it does not report acceleration.
    """
    if topic_name in reader.topics and reader.topics[topic_name].topic.type_name != IMU:
        raise BrokenRecording("topic", topic_name, f"must be {IMU}")
    stamps, logs, forces = [], [], []
    for message in reader.messages([topic_name]):
        reading = accelerometer_sample(message.decode())
        stamps.append(reading.stamp_ns)
        logs.append(message.log_time_ns)
        forces.append(reading.specific_force)
    if not stamps:
        raise BrokenRecording("topic", topic_name, "holds no reading")
    kept, order = np.unique(np.array(stamps, np.int64), return_index=True)
    return kept, np.array(logs, np.int64)[order], np.array(forces)[order]


def clock_fit(stamps: NDArray[np.int64], logs: NDArray[np.int64]) -> ClockFit | None:
    """How the recording's clock runs against the stamps, from the messages that came with the least delay.

    Args:
        stamps: rising [ns], shape [n].
        logs: reception on the recording's clock [ns], shape [n].

    Returns:
        None where reception tells nothing: too few messages, or log times that do not advance with the stamps.
    """
    if len(stamps) < 5 * _CLOCK_BLOCKS:
        return None
    spans = float(stamps[-1] - stamps[0]), float(logs[-1] - logs[0])
    if not 0.5 < spans[1] / spans[0] < 2.0:
        return None
    since, ahead = (stamps - stamps[0]).astype(float), (logs - stamps).astype(float)
    # Of each block the message with the least delay: queues only ever add to it.
    blocks = [block[ahead[block].argmin()] for block in np.array_split(np.arange(len(stamps)), _CLOCK_BLOCKS)]
    drift, offset = np.polyfit(since[blocks], ahead[blocks], 1)
    return ClockFit(float(offset), float(drift))
