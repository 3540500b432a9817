"""Samples from an accelerometer reading by reading, while the sled still moves."""

from dataclasses import replace

import numpy as np
import pytest

from config.errors import RefusedInput
from config.scene import Scene
from config.scene_file import find_scene, read_scene
from sim_core.bench_live import LiveSample, LiveSled
from sim_core.bench_stand_in import SensorFaults, faulty_readings
from sim_core.sled import build_profile

FAULTS = SensorFaults(noise_mps2=0.05, gaps=((0.9, 0.02),), rest_s=2.0)


@pytest.fixture(scope="module")
def block() -> Scene:
    return read_scene(find_scene("block_slip"), ['sled={"profile": "eumos", "level_g": 0.5}'])


def played(
    scene: Scene, faults: SensorFaults, **options: object
) -> tuple[LiveSled, list[LiveSample], list[float]]:
    """The sled, its samples, and by how much each was late [s]."""
    sled = LiveSled(samples_hz=960, **options)  # type: ignore[arg-type]
    samples, late = [], []
    readings = faulty_readings(scene, faults, 1)
    for time_s, force in zip(readings.stamps, readings.forces, strict=True):
        for sample in sled.add(float(time_s), force):
            assert sled.start_s is not None
            samples.append(sample)
            late.append(float(time_s) - (sled.start_s + sample.index / 960.0))
    return sled, samples, late


def test_samples_come_while_the_sled_moves(block: Scene) -> None:
    sled, samples, late = played(block, FAULTS)
    assert [sample.index for sample in samples] == list(range(len(samples)))
    assert sled.state == "standing" and sled.start_s is not None
    speeds = np.cumsum([sample.acceleration[0] for sample in samples]) / 960.0
    profile = build_profile(block)
    true = [profile.state(sled.start_s + index / 960.0)[1][0] for index in range(len(samples))]
    # Noise: 0.05·√(0.001·1.9) = 2 mm/s; the bias at rest 0.05/√2000 over 1.9 s as much: four times both.
    assert np.abs(speeds - true).max() < 0.012
    assert abs(speeds[-1]) < 1e-9
    # A reading's time, or a gap's; before that, the rise must be seen once.
    assert max(late[300:]) < 0.022
    assert max(late) < 0.2


def test_it_stands_through_a_long_wait(block: Scene) -> None:
    sled, samples, _ = played(block, replace(FAULTS, noise_mps2=0.2, rest_s=8.0))
    assert sled.start_s is not None and sled.start_s == pytest.approx(-0.03, abs=0.03)
    assert len(samples) > 2000


def test_a_humming_bench_does_not_start_it(block: Scene) -> None:
    readings = faulty_readings(block, replace(FAULTS, rest_s=3.0), 1)
    sled = LiveSled(samples_hz=960)
    for time_s, force in zip(readings.stamps, readings.forces, strict=True):
        hum = 0.3 * np.sin(2.0 * np.pi * 30.0 * time_s) * np.array([1.0, 0.7, 0.3])
        sled.add(float(time_s), force + hum)
    assert sled.start_s == pytest.approx(-0.03, abs=0.04)


def test_direction_and_lead_are_as_asked(block: Scene) -> None:
    straight, turned = (played(block, FAULTS, direction=way)[1] for way in ("+x", "-y"))
    assert [s.acceleration[0] for s in straight] == [-s.acceleration[1] for s in turned]
    _, samples, _ = played(block, FAULTS, lead_s=0.5)
    assert not any(sample.acceleration.any() for sample in samples[: int(0.45 * 960)])


def test_silence_while_the_sled_moves_ends_it(block: Scene) -> None:
    with pytest.raises(RefusedInput, match=r"gap of 8\d\.\d ms"):
        played(block, replace(FAULTS, gaps=((2.5, 0.08),)))
    # Before the motion nothing is lost by it.
    assert played(block, replace(FAULTS, gaps=((0.7, 0.08),)))[0].state == "standing"


def test_time_that_stands_still_is_refused() -> None:
    sled = LiveSled(samples_hz=960)
    sled.add(1.0, np.array([0.0, 0.0, 9.81]))
    with pytest.raises(RefusedInput, match="time must advance"):
        sled.add(1.0, np.array([0.0, 0.0, 9.81]))
