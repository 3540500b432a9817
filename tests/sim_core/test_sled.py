"""The sled's motion against integrals made another way, and its samples and readings against their promises."""

import math
from collections.abc import Callable
from fractions import Fraction
from itertools import islice
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

from config.errors import RefusedInput
from config.scene import Scene
from sim_core.sled import (
    DEFAULT_EPOCH_NS,
    SledProfile,
    accelerometer_samples,
    build_profile,
    sled_samples,
    stamp_ns,
    stop_sample,
)

MakeScene = Callable[..., Scene]
G = 9.81
# Speeds here stay below 20 m/s and travels below 100 m: 1e-12 is some 60 roundings of the largest of them.
ROUNDING = 1.0e-12


def pieces(sled: dict[str, Any]) -> list[tuple[float, float, float, float]]:
    """Start, end, first and last acceleration of each linear piece, written from the profile's description."""
    a, d = sled["level_g"] * G, sled["deceleration_g"] * G
    at_level = sled["lead_s"] + sled["rise_s"]
    falls = at_level + sled["plateau_s"]
    brakes = falls + sled["fall_s"]
    speed = a * sled["rise_s"] / 2.0 + a * sled["plateau_s"] + (a - d) / 2.0 * sled["fall_s"]
    return [
        (sled["lead_s"], at_level, 0.0, a),
        (at_level, falls, a, a),
        (falls, brakes, a, -d),
        (brakes, brakes + speed / d, -d, -d),
    ]


def integrals(sled: dict[str, Any], time_s: float) -> tuple[float, float]:
    """Velocity ∫a ds and travel ∫(t − s)·a ds (Cauchy), by two-point Gauss: exact for cubics on each piece."""
    velocity = travel = 0.0
    for start, end, first, last in pieces(sled):
        stop = min(end, time_s)
        if stop <= start:
            continue
        for node in (-1.0 / math.sqrt(3.0), 1.0 / math.sqrt(3.0)):
            s = start + (stop - start) * (1.0 + node) / 2.0
            a = first + (last - first) * (s - start) / (end - start)
            velocity += (stop - start) / 2.0 * a
            travel += (stop - start) / 2.0 * (time_s - s) * a
    return velocity, travel


@st.composite
def eumos_sleds(draw: st.DrawFn) -> dict[str, Any]:
    def between(low: float, high: float) -> float:
        return draw(st.floats(low, high))

    sled = {
        "profile": "eumos",
        "level_g": between(0.3, 1.0),
        "rise_s": draw(st.sampled_from([0.0, 0.01, 0.05])),
        "plateau_s": between(0.3, 1.0),
        "deceleration_g": between(0.2, 1.0),
        "fall_s": draw(st.sampled_from([0.0, 0.05, 0.3])),
        "lead_s": draw(st.sampled_from([0.0, 0.1, 1.0])),
        "direction": draw(st.sampled_from(["+x", "-x", "+y", "-y"]) | st.floats(-360.0, 360.0)),
    }
    assume(pieces(sled)[3][1] > pieces(sled)[3][0])
    return sled


def along(direction: str | float) -> tuple[float, float]:
    named = {"+x": 0.0, "+y": 90.0, "-x": 180.0, "-y": 270.0}
    angle = math.radians(named[direction] if isinstance(direction, str) else direction)
    return math.cos(angle), math.sin(angle)


@settings(max_examples=60, deadline=None)
@given(sled=eumos_sleds(), share=st.floats(0.0, 1.2))
def test_eumos_is_the_exact_integral_in_any_direction(
    make_scene: MakeScene, sled: dict[str, Any], share: float
) -> None:
    profile = build_profile(make_scene(sled=sled))
    end = pieces(sled)[-1][1]
    _, velocity, position = profile.state(share * end)
    speed, travel = integrals(sled, share * end)
    cosine, sine = along(sled["direction"])
    assert velocity == pytest.approx([speed * cosine, speed * sine, 0.0], abs=ROUNDING)
    assert position == pytest.approx([travel * cosine, travel * sine, 0.0], abs=100 * ROUNDING)
    assert profile.end_s == pytest.approx(end, abs=ROUNDING)
    assert profile.peak_mps2 == pytest.approx(max(sled["level_g"], sled["deceleration_g"]) * G)


@settings(max_examples=60, deadline=None)
@given(sled=eumos_sleds())
def test_eumos_comes_to_rest_and_stays(make_scene: MakeScene, sled: dict[str, Any]) -> None:
    profile = build_profile(make_scene(sled=sled))
    for later in (0.0, 0.1, 5.0):
        acceleration, velocity, position = profile.state(profile.end_s + later)
        assert not acceleration.any()
        assert np.abs(velocity).max() < ROUNDING
        assert position == pytest.approx(profile.positions[-1], abs=5.0 * ROUNDING)
    standing = profile.state(sled["lead_s"] - 1.0e-9)
    assert not any(part.any() for part in standing)


def test_eumos_by_hand(make_scene: MakeScene) -> None:
    """0.5 g, rise 0.05 s, plateau 0.5 s, fall 0.05 s to −0.2 g, braking 1.35 s: 4.905·(0.025 + 0.5) and so on."""
    profile = build_profile(make_scene())
    a, d = 0.5 * G, 0.2 * G
    assert profile.times == pytest.approx([0.1, 0.15, 0.65, 0.7, 0.7 + 1.35, 2.05], abs=ROUNDING)
    speeds = [0.0, 0.025 * a, 0.525 * a, 0.525 * a + 0.5 * (a - d) * 0.05, 0.0, 0.0]
    assert profile.velocities[:, 0] == pytest.approx(speeds, abs=ROUNDING)
    acceleration, velocity, position = profile.state(0.4)
    assert acceleration[0] == a
    assert velocity[0] == pytest.approx(a * 0.275, abs=ROUNDING)
    # a·t²/6 after the rise, then v·t + a·t²/2 on the plateau.
    assert position[0] == pytest.approx(a * 0.05**2 / 6 + 0.025 * a * 0.25 + 0.5 * a * 0.25**2, abs=ROUNDING)


@pytest.mark.parametrize(
    ("direction", "axis", "sign"),
    [("+x", 0, 1), ("-x", 0, -1), ("+y", 1, 1), ("-y", 1, -1), (90.0, 1, 1), (-90.0, 1, -1), (180.0, 0, -1)],
)
def test_quarter_turns_have_no_other_component(
    make_scene: MakeScene, direction: str | float, axis: int, sign: int
) -> None:
    accelerations = build_profile(
        make_scene(sled={"profile": "eumos", "level_g": 0.5, "direction": direction})
    ).accelerations
    other = [k for k in range(3) if k != axis]
    assert not accelerations[:, other].any()
    assert sign * accelerations[2, axis] == 0.5 * G


def test_a_rise_of_no_time_is_a_jump(make_scene: MakeScene) -> None:
    profile = build_profile(make_scene(sled={"profile": "eumos", "level_g": 0.5, "rise_s": 0.0}))
    assert profile.state(0.1)[0][0] == 0.5 * G
    assert not profile.state(np.nextafter(0.1, 0.0))[0].any()


def test_level_zero_stands_still(make_scene: MakeScene) -> None:
    scene = make_scene(sled={"profile": "eumos", "level_g": 0.0})
    profile = build_profile(scene)
    assert profile.peak_mps2 == 0.0
    assert not profile.positions.any()
    assert profile.end_s == pytest.approx(0.1 + 0.05 + 0.5)
    assert not any(sample.acceleration.any() for sample in islice(sled_samples(scene), 1000))


def test_a_fall_that_would_roll_back_is_refused(make_scene: MakeScene) -> None:
    sled = {"profile": "eumos", "level_g": 0.1, "deceleration_g": 2.0, "fall_s": 0.5}
    with pytest.raises(RefusedInput, match=r"sled\.fall_s = 0\.5"):
        build_profile(make_scene(sled=sled))


def test_table_with_jumps(make_scene: MakeScene) -> None:
    """+2 for 0.1 s, then −2 for 0.1 s: a speed of 0.2 in the middle, a travel of 0.2·0.2/2, a jump at either end."""
    sled = {
        "profile": "table",
        "times_s": [0.5, 0.6, 0.6, 0.7],
        "acceleration_mps2": [2.0, 2.0, -2.0, -2.0],
        "lead_s": 0.25,
    }
    profile = build_profile(make_scene(sled=sled))
    assert not profile.state(0.75 - 1.0e-9)[0].any()
    assert profile.state(0.75)[0][0] == 2.0
    assert profile.state(0.86)[0][0] == -2.0
    assert profile.state(0.85)[1][0] == pytest.approx(0.2, abs=ROUNDING)
    acceleration, velocity, position = profile.state(0.95)
    assert not acceleration.any()
    assert velocity[0] == pytest.approx(0.0, abs=ROUNDING)
    assert position[0] == pytest.approx(0.02, abs=ROUNDING)


def test_after_a_table_that_does_not_brake_the_sled_coasts(make_scene: MakeScene) -> None:
    sled = {"profile": "table", "times_s": [0.0, 0.5], "acceleration_mps2": [0.0, 4.0]}
    profile = build_profile(make_scene(sled=sled))
    # v = 4·0.5/2, x = slope·t³/6 = 8·0.125/6, then on at v.
    _, velocity, position = profile.state(2.5)
    assert velocity[0] == pytest.approx(1.0, abs=ROUNDING)
    assert position[0] == pytest.approx(1.0 / 6.0 + 2.0, abs=ROUNDING)


@settings(max_examples=40, deadline=None)
@example(knots=[(0.0, 0.0), (2.0e-313, 1.0)], time_s=0.0)
@given(
    knots=st.lists(st.tuples(st.floats(0.0, 1.0), st.floats(-20.0, 20.0)), min_size=2, max_size=12),
    time_s=st.floats(0.0, 2.0),
)
def test_any_profile_against_a_fine_sum(knots: list[tuple[float, float]], time_s: float) -> None:
    """The trapezoid rule of a piecewise linear acceleration is exact between its knots and the time asked for."""
    times = np.sort([t for t, _ in knots])
    accelerations = np.array([[a, -a, 0.5 * a] for _, a in knots])
    profile = SledProfile.from_knots(times, accelerations)
    grid = np.unique(np.concatenate([times[times <= time_s], [time_s], np.linspace(0.0, time_s, 200)]))
    # The middle of a cell lies on one piece; a linear piece's mean is its value there.
    middles = np.array([profile.state(t)[0] for t in 0.5 * (grid[1:] + grid[:-1])]).reshape(-1, 3)
    speed = (middles * np.diff(grid)[:, None]).sum(axis=0)
    assert profile.state(time_s)[1] == pytest.approx(speed, abs=ROUNDING)


@pytest.mark.parametrize("samples_hz", [240, 960, 3840])
def test_sample_means_add_up_to_the_velocity(make_scene: MakeScene, samples_hz: int) -> None:
    scene = make_scene(
        sled={"profile": "eumos", "level_g": 0.8, "direction": 30.0},
        sampling={"samples_hz": samples_hz},
        solver={"time_step_s": 1.0 / samples_hz},
    )
    profile, total = build_profile(scene), np.zeros(3)
    for sample in islice(sled_samples(scene), stop_sample(scene) + 10):
        total += sample.acceleration * sample.interval_s
        assert total == pytest.approx(sample.velocity, abs=ROUNDING)
        assert sample.position.tolist() == profile.state(sample.index / samples_hz)[2].tolist()
    assert np.abs(total).max() < ROUNDING


def test_sample_zero_has_no_interval(make_scene: MakeScene) -> None:
    first, second = islice(sled_samples(make_scene()), 2)
    assert (first.index, first.interval_s, first.stamp_ns) == (0, 0.0, DEFAULT_EPOCH_NS)
    assert not first.acceleration.any()
    assert (second.index, second.interval_s) == (1, 1.0 / 960.0)


@given(index=st.integers(0, 10**12), rate=st.integers(1, 10_000), epoch=st.integers(0, 2 * 10**18))
def test_stamps_never_drift(index: int, rate: int, epoch: int) -> None:
    """Within half a nanosecond of the exact time, however many samples lie before."""
    exact = epoch + Fraction(index * 10**9, rate)
    assert abs(stamp_ns(index, rate, epoch) - exact) <= Fraction(1, 2)
    assert stamp_ns(index * rate, rate, epoch) == epoch + index * 10**9


@settings(max_examples=40, deadline=None)
@given(sled=eumos_sleds(), rate=st.sampled_from([480, 960, 1920]))
def test_the_stop_sample_is_the_first_that_stands(
    make_scene: MakeScene, sled: dict[str, Any], rate: int
) -> None:
    scene = make_scene(sled=sled, sampling={"samples_hz": rate}, solver={"time_step_s": 1.0 / rate})
    stop, end = stop_sample(scene), build_profile(scene).end_s
    # A millionth of a sample is forgiven, so that a profile that ends on a sample has that one.
    assert stop / rate >= end - 1.1e-6 / rate
    assert (stop - 1) / rate < end


Samples = st.lists(st.tuples(*3 * [st.floats(-100.0, 100.0)]), min_size=1, max_size=40)


@settings(max_examples=40, deadline=None)
@given(samples=Samples)
def test_recorded_samples_come_back_bit_for_bit(
    make_scene: MakeScene, samples: list[tuple[float, float, float]]
) -> None:
    scene = make_scene(sled={"profile": "recorded", "samples_mps2": samples})
    played = list(islice(sled_samples(scene), len(samples) + 5))
    for sample, recorded in zip(played[1:], samples[1:], strict=False):
        assert sample.acceleration.tobytes() == np.array(recorded).tobytes()
    assert not played[0].acceleration.any()
    assert not any(sample.acceleration.any() for sample in played[len(samples) :])
    speed = np.cumsum([np.zeros(3), *map(np.array, samples[1:])], axis=0)[-1] / 960.0
    # 40 samples of 100 m/s² at 960 Hz stay below 5 m/s.
    assert played[-1].velocity == pytest.approx(speed, abs=ROUNDING)
    assert stop_sample(scene) == len(samples) - 1


def test_a_recording_of_a_test_replays_it(make_scene: MakeScene) -> None:
    scene = make_scene(sled={"profile": "eumos", "level_g": 0.7, "direction": 33.0})
    first = list(islice(sled_samples(scene), stop_sample(scene) + 1))
    samples = [sample.acceleration.tolist() for sample in first]
    again = make_scene(sled={"profile": "recorded", "samples_mps2": samples})
    for one, other in zip(first, sled_samples(again), strict=False):
        assert one.acceleration.tobytes() == other.acceleration.tobytes()
        assert one.stamp_ns == other.stamp_ns
        assert other.velocity == pytest.approx(one.velocity, abs=ROUNDING)


def test_a_recorded_profile_without_samples_is_refused(make_scene: MakeScene) -> None:
    with pytest.raises(RefusedInput, match=r"sled\.bag"):
        build_profile(make_scene(sled={"profile": "recorded"}))


def readings(scene: Scene, count: int) -> np.ndarray:
    return np.array([reading.specific_force for reading in islice(accelerometer_samples(scene), count)])


def test_accelerometer_noise_is_what_the_scene_says(make_scene: MakeScene) -> None:
    sigma, count = 0.05, 16_000
    scene = make_scene(
        sled={"profile": "eumos", "level_g": 0.5, "lead_s": 10.0},
        accelerometer={"rate_hz": 1600, "noise_mps2": sigma, "bias_mps2": [0.1, -0.2, 0.3]},
        seed=7,
    )
    noise = readings(scene, count) - [0.1, -0.2, 0.3 + G]
    # Four standard errors: σ/√n of a mean, √(2/n) of a relative variance, 1/√n of a correlation.
    assert np.abs(noise.mean(axis=0)).max() < 4.0 * sigma / math.sqrt(count)
    assert np.abs(noise.var(axis=0) / sigma**2 - 1.0).max() < 4.0 * math.sqrt(2.0 / count)
    pairs = np.corrcoef(np.column_stack([noise[1:], noise[:-1]]).T) - np.eye(6)
    assert np.abs(pairs).max() < 4.0 / math.sqrt(count)
    assert next(accelerometer_samples(scene)).variance == sigma**2


def test_accelerometer_noise_follows_the_seed_alone(make_scene: MakeScene) -> None:
    one, same, other = (make_scene(accelerometer={}, seed=seed) for seed in (3, 3, 4))
    assert readings(one, 500).tobytes() == readings(same, 500).tobytes()
    assert not (readings(one, 500) == readings(other, 500)).any()


def test_a_silent_accelerometer_reads_the_specific_force(make_scene: MakeScene) -> None:
    scene = make_scene(accelerometer={"noise_mps2": 0.0})
    read = readings(scene, 3000)
    assert read[:100].tolist() == [[0.0, 0.0, G]] * 100
    assert read[400].tolist() == [0.5 * G, 0.0, G]
    assert read[1500] == pytest.approx([-0.2 * G, 0.0, G], abs=ROUNDING)
    stamps = [reading.stamp_ns for reading in islice(accelerometer_samples(scene), 5)]
    assert stamps == [DEFAULT_EPOCH_NS + k * 1_000_000 for k in range(5)]
    assert not list(accelerometer_samples(make_scene()))
