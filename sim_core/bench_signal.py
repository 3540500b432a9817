"""From an accelerometer's readings to the sled's samples: mounting, bias, gravity, gaps and drift found and taken out.

A sensor that is fixed to the sled with rotation Rᵀ (sled to sensor) and bias b reads the specific force

    f = Rᵀ·(a − g) + b + noise,   g = (0, 0, −9.81) m/s²   (REP-145: +g upwards at rest).

The reading at rest, f0 = −Rᵀ·g + b, holds all of gravity and bias, so f − f0 = Rᵀ·a whatever they are. A sled runs on
a straight level track: the strongest direction of f − f0 is that of the travel, and the samples are its component.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from config.bench import ImuSource
from config.errors import RefusedInput
from config.scene import direction_vector
from sim_core.frames import GRAVITY, Array

LONGEST_GAP_S = 0.05
"""A longer one during the motion is refused: a rise to the level takes as long."""
LEAD_S = 0.1
"""Standstill that is kept before the motion."""
LEAST_REST_S = 0.03
WINDOW_S = 0.02
"""Over this, readings are averaged where the motion's start is looked for, and lines are laid at both ends of a gap."""
LEVEL_WINDOW_S = 0.2
LEAST_MOTION_MPS2, LEAST_CROSSING_MPS2, MOST_CROSSING_MPS2 = 0.3, 0.05, 0.9
SHORT_GAP_S, LONG_INTERVALS = 0.005, 1.5
"""A single missing reading is a straight line between its neighbours; intervals this many times as long are gaps."""
COASTING_SHARE = 0.1
"""A speed at the end above this share of the peak's is the sled's, not the sensor's drift."""


@dataclass(frozen=True, eq=False)
class BenchMotion:
    """The sled's motion as an accelerometer saw it.

    Attributes:
        samples: mean acceleration over each interval, frame ``world`` [m/s²], shape [sample_count, 3]; the first is 0.
        start_s: time of sample 0, on the readings' clock [s].
        level_mps2: the strongest acceleration over a fifth of a second [m/s²].
        source: everything that was found.
    """

    samples: Array
    start_s: float
    level_mps2: float
    source: ImuSource


@dataclass(frozen=True, eq=False)
class _Rest:
    """Readings at rest: mean before and after the motion, at which times, and how well known."""

    times: Array
    means: Array
    sigmas: Array

    @property
    def change(self) -> float:
        return float(np.linalg.norm(self.means[-1] - self.means[0]))

    def at(self, times: Array) -> Array:
        """The reading at rest at some times [m/s²], shape [n, 3]: it moves steadily where it moved at all."""
        return np.stack([np.interp(times, self.times, self.means[:, k]) for k in range(3)], axis=1)


def sled_motion(
    times: Array, forces: Array, *, samples_hz: int, direction: str | float = "+x", start_ns: int = 0
) -> BenchMotion:
    """Turns an accelerometer's readings into the samples of a sled.

    Each sample is the exact mean, over its interval, of the line through the readings. No filter is laid over them:
    what noise does to a load, it does through the speed, and that has no high frequencies.

    Args:
        times: of the readings, rising [s], shape [n].
        forces: specific force in the sensor's axes [m/s²], shape [n, 3].
        samples_hz: rate of the samples.
        direction: of the travel in frame ``sled``.
        start_ns: the readings' time 0 on the recording's clock [ns].

    Raises:
        RefusedInput: no readings, unordered or no numbers, in other units, without a standstill at both ends, without
            a motion, or with a long gap in it.
    """
    _require_readings(times, forces)
    period = float(np.median(np.diff(times)))
    noise = _noise(forces)
    first, last = _moving(times, forces, noise, period)
    rest = _rest(times, forces, first, last)
    bridged_s = _require_no_long_gap(times, first, last)
    inside = slice(first, last + 1)
    moving = forces[inside] - rest.at(times[inside])
    axis = _main_direction(times[inside], moving)
    knots, along = _bridged(times[inside], moving @ axis, period)
    sigma = float(np.sqrt(noise**2 @ axis**2))
    along, end_speed, drift, stands = _brought_to_rest(knots, along, sigma, rest, axis, period)
    start_s = max(float(times[0]), float(knots[0]) - LEAD_S)
    means = _interval_means(knots, along, start_s, samples_hz)
    x, y = direction_vector(direction)
    travel = np.array([x, y, 0.0])
    rotation = _rotation(rest.means[0], axis, travel)
    speed_sigma, travel_sigma = _uncertainty(sigma, period, float(knots[-1] - knots[0]), rest, axis, stands)
    source = ImuSource(
        start_ns=start_ns + round(start_s * 1.0e9),
        **_timing(times, period),
        longest_gap_in_motion_ms=1000.0 * bridged_s if bridged_s > LONG_INTERVALS * period else 0.0,
        noise_mps2=_triple(noise),
        **_mounted(rest, rotation),
        off_axis_share=_off_axis_share(moving, axis, noise),
        moves_from_s=float(knots[0] - times[0]),
        moves_until_s=float(knots[-1] - times[0]),
        ends="standing" if stands else "coasting",
        end_speed_mps=end_speed,
        drift_mps2=drift,
        speed_sigma_mps=speed_sigma,
        travel_sigma_mm=1000.0 * travel_sigma,
    )
    return BenchMotion(means[:, None] * travel, start_s, _level(means, samples_hz), source)


def _timing(times: Array, period: float) -> dict[str, Any]:
    gaps = np.diff(times)
    long = gaps > LONG_INTERVALS * period
    return {
        "readings": len(times),
        "rate_hz": 1.0 / period,
        "jitter_ms": 1000.0 * float(gaps[~long].std()),
        "missing": int(np.sum(np.round(gaps[long] / period) - 1.0)),
        "longest_gap_ms": 1000.0 * float(gaps.max()),
    }


def _mounted(rest: _Rest, rotation: Array) -> dict[str, Any]:
    """Gravity, bias and the sensor's place, from the reading at rest."""
    weighs = float(np.linalg.norm(rest.means[0]))
    up = np.array([0.0, 0.0, GRAVITY if weighs > 0.5 * GRAVITY else 0.0])
    return {
        "gravity_mps2": weighs,
        "bias_mps2": _triple(rest.means[0] - rotation.T @ up),
        "bias_change_mps2": rest.change,
        "rotation": (_triple(rotation[0]), _triple(rotation[1]), _triple(rotation[2])),
        "tilt_deg": float(np.degrees(np.arccos(np.clip(rotation[2, 2], -1.0, 1.0)))),
        "yaw_deg": float(np.degrees(np.arctan2(rotation[1, 0], rotation[0, 0]))),
    }


def source_lines(source: ImuSource) -> list[str]:
    """What was found and done, in words, a line each."""
    bias, noise = (
        ", ".join(f"{value:+.3f}" for value in values) for values in (source.bias_mps2, source.noise_mps2)
    )
    lines = [
        f"{source.readings} readings at {source.rate_hz:.1f} Hz, jitter {source.jitter_ms:.3f} ms,"
        f" {source.missing} missing, longest gap {source.longest_gap_ms:.1f} ms"
        + (
            f"; bridged {source.longest_gap_in_motion_ms:.1f} ms in the motion"
            if source.longest_gap_in_motion_ms
            else ""
        ),
        f"mounted with a tilt of {source.tilt_deg:.2f}° and a yaw of {source.yaw_deg:.2f}°: turned into frame sled",
        f"at rest {source.gravity_mps2:.3f} m/s²; bias {bias} m/s² (across the travel it counts as roll): taken off",
        f"noise {noise.replace('+', '')} m/s²: the sled's speed is known within {1000.0 * source.speed_sigma_mps:.1f}"
        f" mm/s and its travel within {source.travel_sigma_mm:.1f} mm (standard uncertainty); not filtered",
    ]
    if source.ends == "standing":
        lines.append(
            f"{1000.0 * source.end_speed_mps:+.1f} mm/s were left at the end:"
            f" {source.drift_mps2:+.4f} m/s² taken off over the motion, so that the sled stands"
        )
    else:
        lines.append(
            f"the sled coasts on at {source.end_speed_mps:.3f} m/s: no standstill at the end to remove drift by"
        )
    if source.off_axis_share > 0.05:
        lines.append(
            f"{100.0 * source.off_axis_share:.0f} % as much acceleration across the travel was left out"
        )
    if source.clock_offset_ms is not None and source.clock_drift_ppm is not None:
        used = "the sensor's stamps stand" if source.uses_sensor_clock else "moved to the recording's clock"
        lines.append(
            f"the recording's clock is {source.clock_offset_ms:+.2f} ms from the sensor's and gains"
            f" {source.clock_drift_ppm:+.0f} ppm: {used}"
        )
    return lines


def _require_readings(times: Array, forces: Array) -> None:
    if len(times) < 50:
        raise RefusedInput("sled.bag", len(times), "at least 50 accelerometer readings are needed")
    if not (np.isfinite(times).all() and np.isfinite(forces).all()):
        raise RefusedInput("sled.bag", "accelerometer", "its readings must be finite")
    backwards = np.flatnonzero(np.diff(times) <= 0.0)
    if len(backwards):
        limit = f"time must advance; reading {backwards[0] + 1} does not come after the one before"
        raise RefusedInput("sled.bag", f"{len(backwards)} accelerometer stamps", limit)


def _noise(forces: Array) -> Array:
    """Standard deviation of each axis [m/s²], from the differences of neighbours: a motion is smooth beside them."""
    steps = np.diff(forces, axis=0)
    sigma: Array = 1.4826 * np.median(np.abs(steps - np.median(steps, axis=0)), axis=0) / np.sqrt(2.0)
    return sigma


def _moving(times: Array, forces: Array, noise: Array, period: float) -> tuple[int, int]:
    """First and last reading of the motion, with a margin of one window each."""
    width = max(3, round(WINDOW_S / period))
    still = max(width, round(2.5 * WINDOW_S / period))
    sums = np.concatenate([np.zeros((1, 3)), np.cumsum(forces, axis=0)])
    smooth = (sums[width:] - sums[:-width]) / width
    before, after = np.median(forces[:still], axis=0), np.median(forces[-still:], axis=0)
    spread = float(np.linalg.norm(noise))
    # A bench that hums is not a sled that moves: twice what the first readings do by themselves.
    hum = 2.0 * float(np.linalg.norm(smooth[: 2 * still] - before, axis=1).max())
    limit = max(LEAST_CROSSING_MPS2, 3.0 * spread / np.sqrt(width), min(hum, MOST_CROSSING_MPS2))
    weighs = float(np.linalg.norm(before))
    if weighs > 0.5 and not 9.0 < weighs < 10.6:
        raise RefusedInput(
            "sled.bag",
            f"{weighs:.3f} at rest",
            "an accelerometer at rest must read 9.81 m/s² (or 0): other units?",
        )
    if np.linalg.norm(after - before) > LEAST_MOTION_MPS2 + limit:
        limit_text = "the recording must begin and end with the sled at rest, or coasting"
        raise RefusedInput("sled.bag", f"{np.linalg.norm(after - before):.2f} m/s² apart", limit_text)
    away = np.linalg.norm(smooth - before, axis=1)
    if away.max() < LEAST_MOTION_MPS2:
        raise RefusedInput("sled.bag", f"{away.max():.3f} m/s²", "the sled does not move in it")
    first = int(np.argmax(away > limit)) - width
    back = np.linalg.norm(smooth - after, axis=1) > limit
    last = len(back) - 1 - int(np.argmax(back[::-1])) + 2 * width
    if first < round(LEAST_REST_S / period):
        limit_text = f"must stand for {LEAST_REST_S} s before the motion: gravity and bias are found there"
        raise RefusedInput("sled.bag", f"motion at {max(0, first) * period:.3f} s", limit_text)
    return first, min(last, len(times) - 1)


def _rest(times: Array, forces: Array, first: int, last: int) -> _Rest:
    """The reading at rest, from both ends where both are long enough; one value unless it moved beyond doubt."""
    parts = [slice(0, first), slice(last + 1, len(times))]
    parts = [part for part in parts if part.stop - part.start >= 30] or parts[:1]
    counts = np.array([part.stop - part.start for part in parts])
    means = np.array([forces[part].mean(axis=0) for part in parts])
    sigma = np.array(
        [forces[part].std(axis=0) / np.sqrt(count) for part, count in zip(parts, counts, strict=True)]
    )
    middles = np.array([times[part].mean() for part in parts])
    if len(parts) == 2 and not (np.abs(means[1] - means[0]) > 4.0 * np.hypot(*sigma)).any():
        pooled = (means * counts[:, None]).sum(axis=0) / counts.sum()
        means = np.array([pooled, pooled])
        sigma = np.tile(np.sqrt(((sigma * counts[:, None]) ** 2).sum(axis=0)) / counts.sum(), (2, 1))
    return _Rest(middles, means, sigma)


def _main_direction(times: Array, moving: Array) -> Array:
    """Unit vector of the strongest acceleration, towards the side that the sled travels to, shape [3]."""
    axis: Array = np.linalg.eigh(moving.T @ moving)[1][:, -1]
    speeds = _integral(times, moving @ axis)
    return axis if float(np.sum(speeds[1:] * np.diff(times))) >= 0.0 else -axis


def _off_axis_share(moving: Array, axis: Array, noise: Array) -> float:
    along = moving @ axis
    across = moving - along[:, None] * axis
    beyond = float((across**2).sum(axis=1).mean() - (noise**2).sum() + noise**2 @ axis**2)
    return float(np.sqrt(max(0.0, beyond) / (along**2).mean()))


def _require_no_long_gap(times: Array, first: int, last: int) -> float:
    gaps = np.diff(times[first : last + 1])
    worst = int(gaps.argmax())
    if gaps[worst] > LONGEST_GAP_S:
        at_s = times[first + worst] - times[0]
        raise RefusedInput(
            "sled.bag",
            f"a gap of {1000.0 * gaps[worst]:.1f} ms at {at_s:.3f} s",
            f"the accelerometer must not be silent for more than {1000.0 * LONGEST_GAP_S:.0f} ms while the sled moves",
        )
    return float(gaps[worst])


def _bridged(times: Array, along: Array, period: float) -> tuple[Array, Array]:
    """Fills gaps by the lines through the neighbours at both ends, to where the two meet.

    A straight bridge between two single readings carries their noise over the whole gap, and cuts the corners that a
    trapezoid has: by j·τ²/8 of speed for a change of slope j in the middle of a gap τ. Where the lines don't meet in
    the gap, the cubic that continues both.
    """
    knots, values = [times], [along]
    for left in np.flatnonzero(np.diff(times) > max(SHORT_GAP_S, LONG_INTERVALS * period)):
        near, far = times[left], times[left + 1]
        start, slope_in = _line(times, along, int(left), near - WINDOW_S, near)
        end, slope_out = _line(times, along, int(left) + 1, far, far + WINDOW_S)
        length = far - near
        turn = slope_in - slope_out
        meets = (end - start - slope_out * length) / turn if turn else -1.0
        s = np.arange(1, max(2, round(length / period))) / max(2, round(length / period))
        if 0.0 < meets < length:
            filled = np.where(
                s * length < meets, start + slope_in * s * length, end - slope_out * (1.0 - s) * length
            )
        else:
            filled = (
                start * (1.0 + 2.0 * s) * (1.0 - s) ** 2 + length * slope_in * s * (1.0 - s) ** 2
                + end * s**2 * (3.0 - 2.0 * s) + length * slope_out * s**2 * (s - 1.0)
            )  # fmt: skip
        knots.append(near + s * length)
        values.append(filled)
    order = np.argsort(np.concatenate(knots), kind="stable")
    return np.concatenate(knots)[order], np.concatenate(values)[order]


def _line(times: Array, along: Array, at: int, from_s: float, until_s: float) -> tuple[float, float]:
    """Value and slope, at reading ``at``, of the line through its neighbours in a window."""
    near = (times >= from_s) & (times <= until_s)
    if near.sum() < 5:
        return float(along[at]), 0.0
    slope, value = np.polyfit(times[near] - times[at], along[near], 1)
    return float(value), float(slope)


def _integral(times: Array, values: Array) -> Array:
    """Running integral of the line through some points, shape [n]."""
    steps: Array = np.concatenate([[0.0], np.cumsum(0.5 * (values[1:] + values[:-1]) * np.diff(times))])
    return steps


def _brought_to_rest(
    times: Array, along: Array, sigma: float, rest: _Rest, axis: Array, period: float
) -> tuple[Array, float, float, bool]:
    """Takes a constant off so that the sled stands at the end, if it does: the likeliest, for bias and for white noise.

    Returns:
        the acceleration [m/s²], the speed left at the end [m/s], the constant [m/s²], and whether the sled stands.
    """
    speeds = _integral(times, along)
    lasts = float(times[-1] - times[0])
    from_noise = 4.0 * np.hypot(sigma * np.sqrt(period * lasts), _bias_sigma(rest, axis) * lasts)
    stands = abs(speeds[-1]) < COASTING_SHARE * float(np.abs(speeds).max()) + from_noise
    drift = float(speeds[-1]) / lasts if stands else 0.0
    return along - drift, float(speeds[-1]), drift, bool(stands)


def _bias_sigma(rest: _Rest, axis: Array) -> float:
    return float(np.sqrt((rest.sigmas[-1] ** 2) @ axis**2))


def _interval_means(times: Array, along: Array, start_s: float, samples_hz: int) -> Array:
    """Mean of the line through the points over each interval of the grid, zero outside them; the first is 0."""
    count = int(np.ceil((times[-1] - start_s) * samples_hz - 1.0e-9)) + 1
    grid = np.clip(start_s + np.arange(count) / samples_hz, times[0], times[-1])
    speeds, slopes = _integral(times, along), np.diff(along) / np.diff(times)
    k = np.clip(np.searchsorted(times, grid, side="right") - 1, 0, len(slopes) - 1)
    past = grid - times[k]
    at_grid = speeds[k] + along[k] * past + 0.5 * slopes[k] * past**2
    means: Array = np.concatenate([[0.0], np.diff(at_grid) * samples_hz])
    return means


def _level(means: Array, samples_hz: int) -> float:
    """Largest magnitude of the mean over a window [m/s²]: a single sample would be raised by its noise."""
    width = min(len(means), max(1, round(LEVEL_WINDOW_S * samples_hz)))
    sums = np.concatenate([[0.0], np.cumsum(means)])
    return float(np.abs(sums[width:] - sums[:-width]).max() / width)


def _uncertainty(
    sigma: float, period: float, lasts: float, rest: _Rest, axis: Array, stands: bool
) -> tuple[float, float]:
    """Standard uncertainty of speed [m/s] and travel [m] after a motion of so many seconds.

    White noise of σ each period sums to a speed of σ·√(period·t). Tied to rest at both ends it is a Brownian bridge:
    half as much in the middle, and a travel of σ·√(period·T³/12); free, σ·√(period·T³/3) and what the bias adds.
    """
    if stands:
        return 0.5 * sigma * np.sqrt(period * lasts), sigma * np.sqrt(period * lasts**3 / 12.0)
    bias = _bias_sigma(rest, axis)
    speed = np.hypot(sigma * np.sqrt(period * lasts), bias * lasts)
    return float(speed), float(np.hypot(sigma * np.sqrt(period * lasts**3 / 3.0), 0.5 * bias * lasts**2))


def _rotation(at_rest: Array, axis: Array, travel: Array) -> Array:
    """Matrix that turns readings into frame ``sled``: the travel's axis is kept, gravity gives the roll."""
    up = at_rest - (at_rest @ axis) * axis
    if np.linalg.norm(up) < 0.5 * GRAVITY:
        # Gravity was taken off: the sensor's own z is the best guess.
        up = np.array([0.0, 0.0, 1.0]) - axis[2] * axis
    up /= np.linalg.norm(up)
    here = np.stack([axis, np.cross(up, axis), up])
    vertical = np.array([0.0, 0.0, 1.0])
    there = np.stack([travel, np.cross(vertical, travel), vertical])
    turned: Array = there.T @ here
    return turned


def _triple(values: Array) -> tuple[float, float, float]:
    x, y, z = values.tolist()
    return x, y, z
