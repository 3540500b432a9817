"""From faulty readings to the sled's samples: each fault is found, named, and costs no more than it must."""

from dataclasses import replace

import numpy as np
import pytest

from config.errors import RefusedInput
from config.scene import Scene
from config.scene_file import find_scene, read_scene, validate_scene
from sim_core.bench_signal import BenchMotion, sled_motion, source_lines
from sim_core.bench_stand_in import FaultyReadings, SensorFaults, faulty_readings, mounting
from sim_core.frames import Array
from sim_core.load_test import LoadTest
from sim_core.sled import build_profile

BRAKES = 'sled={"profile": "eumos", "level_g": 0.5}'
FAULTLESS = SensorFaults(
    noise_mps2=0.0, bias_mps2=(0.0, 0.0, 0.0), roll_deg=0.0, pitch_deg=0.0, yaw_deg=0.0, dropped_share=0.0
)


@pytest.fixture(scope="module")
def block() -> Scene:
    return read_scene(find_scene("block_slip"), [BRAKES])


def motion_of(readings: FaultyReadings, **options: object) -> BenchMotion:
    return sled_motion(readings.stamps, readings.forces, samples_hz=960, **options)  # type: ignore[arg-type]


def speed(motion: BenchMotion, times: Array) -> Array:
    ends = motion.start_s + np.arange(len(motion.samples)) / 960.0
    return np.interp(times, ends, np.cumsum(motion.samples[:, 0]) / 960.0)


def true_speed(scene: Scene, times: Array) -> Array:
    profile = build_profile(scene)
    return np.array([profile.state(time_s)[1][0] for time_s in times])


def on_the_sled_of(scene: Scene, motion: BenchMotion) -> Scene:
    sled = {
        "profile": "recorded",
        "samples_mps2": motion.samples.tolist(),
        "level_mps2": motion.level_mps2,
        "source": motion.source.model_dump(),
    }
    return validate_scene({**scene.model_dump(), "sled": sled})


def displacement(scene: Scene) -> tuple[Array, Array]:
    test = LoadTest(scene)
    frames = list(test.frames())
    test.close()
    places = np.array([frame.positions for frame in frames])
    return np.arange(len(frames)) / scene.sampling.poses_hz, places - places[0]


def error_mm(scene: Scene, motion: BenchMotion) -> float:
    """Largest difference over time, packages and axes between the load on the true sled and on the recorded one."""
    times, clean = displacement(scene)
    others, driven = displacement(on_the_sled_of(scene, motion))
    at = np.clip(np.searchsorted(times, others + motion.start_s), 1, len(times) - 1)
    share = np.clip((others + motion.start_s - times[at - 1]) * scene.sampling.poses_hz, 0.0, 1.0)
    expected = clean[at - 1] + share[:, None, None] * (clean[at] - clean[at - 1])
    return float(1000.0 * np.abs(driven - expected).max())


def test_a_perfect_sensor_gives_the_profile_back(block: Scene) -> None:
    motion = motion_of(faulty_readings(block, FAULTLESS, 0))
    times = np.linspace(0.0, 2.0, 500)
    # Readings stand a millisecond apart: a corner of slope 98 m/s³ is cut by 98·0.001²/8 = 12 µm/s, a jump of 2 m/s² by
    # half a millisecond of it.
    assert np.abs(speed(motion, times) - true_speed(block, times)).max() < 1.1e-3
    assert motion.level_mps2 == pytest.approx(0.5 * 9.81, abs=2e-3)
    assert motion.source.ends == "standing" and motion.source.missing == 0
    assert not motion.samples[: int(0.05 * 960)].any()


def test_mounting_and_bias_are_found(block: Scene) -> None:
    faults = replace(FAULTLESS, noise_mps2=0.05, roll_deg=3.0, pitch_deg=0.0, yaw_deg=-20.0)
    source = motion_of(faulty_readings(block, faults, 1)).source
    # The noise's share in the direction: σ/(a·√n) = 0.05/(2.5·√2000), and 0.05/√1000 of 9.81 in the roll.
    assert np.abs(np.array(source.rotation) - mounting(faults)).max() < 2e-3
    assert source.yaw_deg == pytest.approx(-20.0, abs=0.1)
    assert source.tilt_deg == pytest.approx(3.0, abs=0.1)
    faults = replace(faults, bias_mps2=(0.1, 0.0, -0.2))
    source = motion_of(faulty_readings(block, faults, 1)).source
    assert source.bias_mps2 == pytest.approx((0.1, 0.0, -0.2), abs=0.03)
    assert source.noise_mps2 == pytest.approx((0.05, 0.05, 0.05), rel=0.1)


def test_any_mounting_and_direction(block: Scene) -> None:
    """Upside down, looking backwards, travelling along -y: the samples are the same, but for where they point."""
    straight = motion_of(faulty_readings(block, FAULTLESS, 0))
    turned = replace(FAULTLESS, roll_deg=180.0, yaw_deg=170.0)
    motion = motion_of(faulty_readings(block, turned, 0), direction="-y")
    assert motion.samples[:, 1] == pytest.approx(-straight.samples[:, 0], abs=1e-9)
    assert not motion.samples[:, [0, 2]].any()


@pytest.mark.parametrize("middle_s", [0.6, 0.625, 0.65, 1.15, 1.2])
def test_a_gap_at_a_corner_of_the_profile_is_bridged(block: Scene, middle_s: float) -> None:
    """20 ms without readings where rise, plateau and fall begin and end."""
    readings = faulty_readings(block, replace(FAULTLESS, gaps=((middle_s, 0.02),)), 0)
    motion = motion_of(readings)
    times = np.linspace(0.0, 2.0, 500)
    assert np.abs(speed(motion, times) - true_speed(block, times)).max() < 1.2e-3
    assert motion.source.longest_gap_in_motion_ms == pytest.approx(20.0, abs=1.1)
    assert motion.source.missing in (19, 20)


@pytest.mark.parametrize("noise", [0.05, 0.1, 0.2])
def test_the_load_moves_as_on_the_true_sled(block: Scene, noise: float) -> None:
    """The bar of 3 mm; the block slides by 392 mm."""
    faults = SensorFaults(noise_mps2=noise, gaps=((0.9, 0.02), (1.16, 0.02)))
    assert error_mm(block, motion_of(faulty_readings(block, faults, 3))) < 3.0


def test_five_slabs_move_as_on_the_true_sled() -> None:
    """They slide by 1102 mm; what the noise leaves open is stated."""
    scene = read_scene(find_scene("slabs"), ['sled={"profile": "eumos", "level_g": 0.45}'])
    motion = motion_of(faulty_readings(scene, SensorFaults(noise_mps2=0.1, gaps=((0.9, 0.02),)), 1))
    assert error_mm(scene, motion) < 3.0
    # σ·√(τ·T³/12) = 0.1·√(0.001·1.8³/12)
    assert motion.source.travel_sigma_mm == pytest.approx(2.2, abs=0.4)


def test_cartons_slide_as_on_the_true_sled() -> None:
    scene = read_scene(
        find_scene("eur_unwrapped"),
        [
            "load.layers=1",
            "surfaces.pairs.1.friction=0.3",
            'solver={"engine": "mujoco", "time_step_s": 0.0020833333}',
        ],
    )
    motion = motion_of(faulty_readings(scene, SensorFaults(noise_mps2=0.05, gaps=((0.9, 0.02),)), 1))
    assert error_mm(scene, motion) < 3.0


def test_the_stated_uncertainty_is_that_of_the_speed(block: Scene) -> None:
    """Over forty draws the speed at half-time scatters as stated."""
    errors, stated = [], []
    for seed in range(40):
        motion = motion_of(faulty_readings(block, replace(FAULTLESS, noise_mps2=0.2), seed))
        errors.append(speed(motion, np.array([1.0]))[0] - true_speed(block, np.array([1.0]))[0])
        stated.append(motion.source.speed_sigma_mps)
    # A standard deviation from forty values is known within 11 %: three of them.
    assert np.std(errors) == pytest.approx(np.mean(stated), rel=0.35)


def test_a_sled_that_coasts_on_is_not_stopped() -> None:
    scene = read_scene(find_scene("slabs"))
    motion = motion_of(faulty_readings(scene, replace(FAULTLESS, bias_mps2=(0.1, 0.0, 0.0)), 0))
    assert motion.source.ends == "coasting" and motion.source.drift_mps2 == 0.0
    # 4.4145 m/s² over 0.45 s.
    assert motion.source.end_speed_mps == pytest.approx(1.986525, abs=1e-3)
    assert "coasts on at 1.98" in " ".join(source_lines(motion.source))


def test_gravity_may_be_taken_off_already(block: Scene) -> None:
    readings = faulty_readings(block, FAULTLESS, 0)
    bare = FaultyReadings(readings.true_times, readings.stamps, readings.forces - [0.0, 0.0, 9.81])
    assert motion_of(bare).samples == pytest.approx(motion_of(readings).samples, abs=1e-9)
    assert motion_of(bare).source.gravity_mps2 == pytest.approx(0.0, abs=1e-9)


def test_a_humming_bench_is_not_a_moving_sled(block: Scene) -> None:
    """30 Hz at 0.5 m/s² all the time, along and across."""
    readings = faulty_readings(block, replace(FAULTLESS, noise_mps2=0.05, rest_s=2.0), 0)
    hum = 0.5 * np.sin(2.0 * np.pi * 30.0 * readings.stamps)[:, None] * [1.0, 0.7, 0.3]
    motion = sled_motion(readings.stamps, readings.forces + hum, samples_hz=960)
    # The profile moves from 0.1 s on, and the readings begin 2 s before it.
    assert motion.source.moves_from_s == pytest.approx(2.1, abs=0.05)
    times = np.linspace(0.0, 2.0, 500)
    # A half wave of the hum: 0.5/(π·30), and what it does to bias and drift.
    assert np.abs(speed(motion, times) - true_speed(block, times)).max() < 0.012


def test_the_lines_name_every_fault(block: Scene) -> None:
    faults = SensorFaults(gaps=((0.9, 0.02),))
    text = " ".join(source_lines(motion_of(faulty_readings(block, faults, 0)).source))
    for words in (
        "1000.0 Hz",
        "missing",
        "bridged 20.0 ms",
        "tilt",
        "yaw of ",
        "bias",
        "noise",
        "taken off over",
    ):
        assert words in text


def test_what_cannot_be_used_is_refused(block: Scene) -> None:
    readings = faulty_readings(block, replace(FAULTLESS, noise_mps2=0.05), 0)
    times, forces = readings.stamps, readings.forces
    for problem, (bad_times, bad_forces) in {
        r"gap of 6\d\.0 ms at 0\.8": without(times, forces, 0.36, 0.42),
        "other units": (times, forces / 9.81),
        "does not move": (times[:400], forces[:400]),
        "begin and end with the sled at rest": (times[:1200], forces[:1200]),
        "must stand for": (times[580:], forces[580:]),
        "time must advance": (np.append(times, times[:1]), np.append(forces, forces[:1], axis=0)),
        "at least 50": (times[:20], forces[:20]),
        "must be finite": (times, np.where(forces > 12.0, np.nan, forces) * [1.0, np.nan, 1.0]),
    }.items():
        with pytest.raises(RefusedInput, match=problem) as refused:
            sled_motion(bad_times, bad_forces, samples_hz=960)
        assert "\n" not in str(refused.value)


def without(times: Array, forces: Array, from_s: float, until_s: float) -> tuple[Array, Array]:
    kept = (times < from_s) | (times > until_s)
    return times[kept], forces[kept]
