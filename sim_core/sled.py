"""The sled's motion: acceleration profiles with exact closed-form velocity and position."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from config.errors import RefusedInput
from config.scene import EumosSled, RecordedSled, Scene, TableSled, direction_vector
from sim_core.frames import GRAVITY, AccelerometerSample, Array, SledSample

DEFAULT_EPOCH_NS = 1_000_000_000_000
"""Simulated time of the first sample, 1000 s: a clock that reads zero means 'no clock yet' in ROS."""


@dataclass(frozen=True)
class SledProfile:
    """Acceleration along the bench, linear between knots; two knots at one time are a jump.

    Velocity and position are the exact integrals: on a piece that starts at (t0, a0) with slope j,
    v = v0 + a0·τ + j·τ²/2 and x = x0 + v0·τ + a0·τ²/2 + j·τ³/6, with τ = t − t0.

    Attributes:
        times: knot times [s], never falling, shape [knot_count].
        accelerations: acceleration at the knots [m/s²], shape [knot_count, 3], frame ``world``.
        velocities: velocity at the knots [m/s], shape [knot_count, 3].
        positions: position at the knots [m], shape [knot_count, 3].
        level_mps2: what counts as peak acceleration where the knots carry noise [m/s²], or None.
    """

    times: Array
    accelerations: Array
    velocities: Array
    positions: Array
    level_mps2: float | None = None

    @classmethod
    def from_knots(
        cls, times: Array, accelerations: Array, *, level_mps2: float | None = None
    ) -> "SledProfile":
        """Integrates the knots; before the first one the sled stands, after the last it coasts.

        Args:
            times: knot times [s], never falling, shape [knot_count].
            accelerations: acceleration at the knots [m/s²], shape [knot_count, 3].
            level_mps2: what counts as peak acceleration, where that is not the knots' largest [m/s²].
        """
        steps = np.diff(times)[:, None]
        before, after = accelerations[:-1], accelerations[1:]
        velocities = np.zeros_like(accelerations)
        velocities[1:] = np.cumsum(0.5 * (before + after) * steps, axis=0)
        positions = np.zeros_like(accelerations)
        positions[1:] = np.cumsum(velocities[:-1] * steps + (2.0 * before + after) * steps**2 / 6.0, axis=0)
        return cls(times, accelerations, velocities, positions, level_mps2)

    @property
    def end_s(self) -> float:
        """Time of the last knot [s]: from here on the velocity is constant."""
        return float(self.times[-1])

    @property
    def peak_mps2(self) -> float:
        """Largest magnitude of the acceleration, or what counts as that [m/s²]."""
        if self.level_mps2 is not None:
            return self.level_mps2
        return float(np.linalg.norm(self.accelerations, axis=1).max())

    def state(self, time_s: float) -> tuple[Array, Array, Array]:
        """Acceleration [m/s²], velocity [m/s] and position [m] at a time, each of shape [3].

        At a jump the acceleration is the one after it.
        """
        if time_s < self.times[0]:
            zero = np.zeros(3)
            return zero, zero.copy(), zero.copy()
        k = int(np.searchsorted(self.times, time_s, side="right")) - 1
        tau = time_s - self.times[k]
        if k == len(self.times) - 1:
            return np.zeros(3), self.velocities[k].copy(), self.positions[k] + self.velocities[k] * tau
        start = self.accelerations[k]
        # j·τ, by the share of the piece that has passed: the slope of a very short piece could overflow.
        change = (self.accelerations[k + 1] - start) * (tau / (self.times[k + 1] - self.times[k]))
        return (
            start + change,
            self.velocities[k] + start * tau + change * tau / 2.0,
            self.positions[k] + self.velocities[k] * tau + start * tau**2 / 2.0 + change * tau**2 / 6.0,
        )


def build_profile(scene: Scene) -> SledProfile:
    """The profile that the scene asks for.

    Raises:
        RefusedInput: a ``recorded`` profile without its samples.
    """
    sled = scene.sled
    if isinstance(sled, RecordedSled):
        if not sled.samples_mps2:
            raise RefusedInput("sled.bag", sled.bag, "its samples are not loaded, or it has none")
        return _held_samples(
            np.array(sled.samples_mps2), scene.sampling.samples_hz, level_mps2=sled.level_mps2
        )
    if isinstance(sled, EumosSled):
        times, along = eumos_knots(sled)
    else:
        times, along = _table_knots(sled)
    x, y = direction_vector(sled.direction)
    return SledProfile.from_knots(times + sled.lead_s, along[:, None] * np.array([[x, y, 0.0]]))


def eumos_knots(sled: EumosSled) -> tuple[Array, Array]:
    """Knot times [s] and accelerations [m/s²] of the EUMOS 40509 profile, from the start of the rise.

    The level a falls linearly to the deceleration −d within ``fall_s``, and the deceleration lasts
    until the sled stands: t_d = (a·(t_r/2 + t_p) + (a − d)·t_f/2) / d.

    Raises:
        RefusedInput: the fall alone would drive the sled backwards.
    """
    level = sled.level_g * GRAVITY
    if level == 0.0:
        return np.array([0.0, sled.rise_s + sled.plateau_s]), np.zeros(2)
    braking = sled.deceleration_g * GRAVITY
    braking_s = (
        level * (0.5 * sled.rise_s + sled.plateau_s) + 0.5 * (level - braking) * sled.fall_s
    ) / braking
    if braking_s < 0.0:
        raise RefusedInput(
            "sled.fall_s", sled.fall_s, "shorter: the sled would roll backwards before it brakes"
        )
    durations = [0.0, sled.rise_s, sled.plateau_s, sled.fall_s, braking_s, 0.0]
    return np.cumsum(durations), np.array([0.0, level, level, -braking, -braking, 0.0])


def _table_knots(sled: TableSled) -> tuple[Array, Array]:
    times, along = np.array(sled.times_s), np.array(sled.acceleration_mps2)
    # Zero outside the table: a jump at either end where the table doesn't start or end at zero.
    times = np.concatenate([times[:1], times, times[-1:]])
    along = np.concatenate([[0.0], along, [0.0]])
    return times, along


def _held_samples(samples: Array, rate_hz: int, *, level_mps2: float | None) -> SledProfile:
    """Each sample held over its interval; sample 0 has none."""
    edges = np.arange(len(samples)) / rate_hz
    held = samples[1:]
    times = np.concatenate([np.repeat(edges, 2)[1:-1], edges[-1:]])
    knots = np.concatenate([np.repeat(held, 2, axis=0), np.zeros((1, 3))])
    return SledProfile.from_knots(times, knots, level_mps2=level_mps2)


def stamp_ns(index: int, rate_hz: int, epoch_ns: int) -> int:
    """Stamp of sample ``index`` at a whole rate [ns], rounded without drift."""
    return epoch_ns + (2 * index * 1_000_000_000 + rate_hz) // (2 * rate_hz)


def sled_samples(scene: Scene, *, epoch_ns: int = DEFAULT_EPOCH_NS) -> Iterator[SledSample]:
    """The sled's samples from standstill on, without end: the caller stops when the load rests.

    Args:
        scene: a resolved scene.
        epoch_ns: simulated time of sample 0 [ns].

    Raises:
        RefusedInput: the profile cannot be built.
    """
    profile = build_profile(scene)
    rate = scene.sampling.samples_hz
    recorded = scene.sled.samples_mps2 if isinstance(scene.sled, RecordedSled) else ()
    index, earlier = 0, np.zeros(3)
    while True:
        _, velocity, position = profile.state(index / rate)
        # A recorded sample is passed on as it is, so that a replay has the recording's very bits.
        mean = np.array(recorded[index]) if index < len(recorded) else (velocity - earlier) * rate
        if index == 0:
            mean = np.zeros(3)
        yield SledSample(
            index=index,
            stamp_ns=stamp_ns(index, rate, epoch_ns),
            interval_s=1.0 / rate if index else 0.0,
            acceleration=mean,
            velocity=velocity,
            position=position,
        )
        index, earlier = index + 1, velocity


def stop_sample(scene: Scene) -> int:
    """Index of the first sample at or after the profile's end."""
    return math.ceil(build_profile(scene).end_s * scene.sampling.samples_hz - 1.0e-6)


def accelerometer_samples(scene: Scene, *, epoch_ns: int = DEFAULT_EPOCH_NS) -> Iterator[AccelerometerSample]:
    """What the sled's accelerometer reads, without end; noise from the scene's seed.

    Specific force a − g in frame ``sled``, so (0, 0, +g) at rest (REP-145), plus bias and white noise.

    Args:
        scene: a resolved scene with an ``accelerometer``.
        epoch_ns: simulated time of the first reading [ns].
    """
    sensor = scene.accelerometer
    if sensor is None:
        return
    profile = build_profile(scene)
    noise = np.random.Generator(np.random.PCG64(scene.seed))
    offset = np.array(sensor.bias_mps2) + np.array([0.0, 0.0, GRAVITY])
    index = 0
    while True:
        acceleration, _, _ = profile.state(index / sensor.rate_hz)
        yield AccelerometerSample(
            stamp_ns=stamp_ns(index, sensor.rate_hz, epoch_ns),
            specific_force=acceleration + offset + sensor.noise_mps2 * noise.standard_normal(3),
            variance=sensor.noise_mps2**2,
        )
        index += 1
