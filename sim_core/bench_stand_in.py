"""Stand-ins for a bench that there is no recording of: what its accelerometer would have read, faults included."""

from dataclasses import dataclass

import numpy as np

from config.scene import Scene
from sim_core.frames import GRAVITY, Array
from sim_core.sled import build_profile


@dataclass(frozen=True)
class SensorFaults:
    """What is wrong with an accelerometer and its recording.

    Attributes:
        rate_hz: of the readings.
        noise_mps2: standard deviation of a reading [m/s²].
        bias_mps2: in the sensor's axes [m/s²].
        roll_deg: mounting, about x.
        pitch_deg: mounting, about y.
        yaw_deg: mounting, about z; the sensor is turned about x, then y, then z.
        dropped_share: share of single readings that are lost.
        gaps: middle, since the first reading, and length of each gap [s].
        clock_offset_s: the sensor's clock ahead of the true time [s].
        clock_drift_ppm: the sensor's clock gains so much.
        jitter_s: standard deviation of its stamps [s].
        rest_s: standstill before and after the sled's profile [s].
    """

    rate_hz: int = 1000
    noise_mps2: float = 0.1
    bias_mps2: tuple[float, float, float] = (0.1, -0.08, 0.06)
    roll_deg: float = 2.0
    pitch_deg: float = -1.5
    yaw_deg: float = 3.0
    dropped_share: float = 0.01
    gaps: tuple[tuple[float, float], ...] = ()
    clock_offset_s: float = 0.0
    clock_drift_ppm: float = 0.0
    jitter_s: float = 0.0
    rest_s: float = 0.5


@dataclass(frozen=True, eq=False)
class FaultyReadings:
    """Readings as they were taken and as they are stamped.

    Attributes:
        true_times: when each was taken, since sample 0 of the scene's sled [s], shape [n].
        stamps: the sensor's own times [s], shape [n].
        forces: readings in the sensor's axes [m/s²], shape [n, 3].
    """

    true_times: Array
    stamps: Array
    forces: Array


def faulty_readings(scene: Scene, faults: SensorFaults, seed: int) -> FaultyReadings:
    """What an accelerometer with these faults reads on the scene's sled.

    Args:
        scene: a scene whose sled is no recording.
        faults: what is wrong.
        seed: of noise, jitter and drops.
    """
    profile = build_profile(scene)
    chance = np.random.Generator(np.random.PCG64(seed))
    count = round((profile.end_s + 2.0 * faults.rest_s) * faults.rate_hz)
    times = np.arange(count) / faults.rate_hz - faults.rest_s
    kept = chance.random(count) >= faults.dropped_share
    for middle_s, length_s in faults.gaps:
        kept &= np.abs(times - times[0] - middle_s) >= 0.5 * length_s
    kept[[0, -1]] = True
    times = times[kept]
    true = np.array([profile.state(time_s)[0] for time_s in times])
    true[:, 2] += GRAVITY
    forces = true @ mounting(faults) + faults.bias_mps2
    forces += faults.noise_mps2 * chance.standard_normal(forces.shape)
    stamps = faults.clock_offset_s + (1.0 + 1.0e-6 * faults.clock_drift_ppm) * times
    stamps += faults.jitter_s * chance.standard_normal(len(times))
    return FaultyReadings(times, np.maximum.accumulate(stamps + 1.0e-9 * np.arange(len(stamps))), forces)


def mounting(faults: SensorFaults) -> Array:
    """Matrix whose columns are the sensor's axes in frame ``sled``, shape [3, 3]."""
    roll, pitch, yaw = np.radians([faults.roll_deg, faults.pitch_deg, faults.yaw_deg])
    about_x = np.array([[1, 0, 0], [0, np.cos(roll), -np.sin(roll)], [0, np.sin(roll), np.cos(roll)]])
    about_y = np.array([[np.cos(pitch), 0, np.sin(pitch)], [0, 1, 0], [-np.sin(pitch), 0, np.cos(pitch)]])
    about_z = np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
    turned: Array = about_z @ about_y @ about_x
    return turned
