"""A sled driven by the accelerometer of any bag: topics, clocks, gaps, and what the scene says of them."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from config.errors import BrokenRecording, RefusedInput
from config.scene import RecordedSled, Scene
from config.scene_file import find_scene, read_scene
from msgs_adapters.cdr import serialize
from msgs_adapters.convert import to_imu
from msgs_adapters.topics import SLED_ACCELEROMETER, Topic
from recordings.bag_reader import BagReader
from recordings.bag_writer import BagWriter
from recordings.bench_acceleration import clock_fit
from recordings.bench_stand_in import EPOCH_NS, write_stand_in
from recordings.recorded_sled import load_scene
from recordings.test_bag import TestBag
from sim_core.bench_stand_in import SensorFaults, faulty_readings
from sim_core.frames import AccelerometerSample
from sim_core.run import run_test
from sim_core.sled import build_profile

FAULTS = SensorFaults(gaps=((0.9, 0.02),), clock_offset_s=3.0, clock_drift_ppm=400.0, jitter_s=2.0e-5)
BRAKES = 'sled={"profile": "eumos", "level_g": 0.5}'


@pytest.fixture(scope="module")
def block() -> Scene:
    return read_scene(find_scene("block_slip"), [BRAKES])


@pytest.fixture(scope="module")
def machine_bag(block: Scene, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_stand_in(tmp_path_factory.mktemp("bench") / "machine", block, FAULTS, seed=5)


def scene_file(folder: Path, sled: dict[str, object]) -> str:
    raw = json.loads(find_scene("block_slip").read_text())
    (folder / "scene.json").write_text(json.dumps({**raw, "sled": {"profile": "recorded", **sled}}))
    return str(folder / "scene.json")


def recorded(scene: Scene) -> RecordedSled:
    assert isinstance(scene.sled, RecordedSled)
    return scene.sled


def test_a_machines_bag_drives_the_sled(machine_bag: Path, block: Scene, tmp_path: Path) -> None:
    sled = recorded(load_scene(scene_file(tmp_path, {"bag": str(machine_bag)})))
    source = sled.source
    assert source is not None and source.topic == "/machine/sled/accelerometer"
    assert not source.uses_sensor_clock
    # The least delay is 0.2 ms.
    assert source.clock_offset_ms == pytest.approx(-3000.0, abs=1.0)
    assert source.clock_drift_ppm == pytest.approx(-400.0, abs=40.0)
    assert source.rate_hz == pytest.approx(1000.0, rel=1e-3)
    assert source.longest_gap_in_motion_ms == pytest.approx(20.0, abs=1.5)
    # Sample 0 is on the recording's clock, where the twin's first sample was at EPOCH_NS.
    lead_s = (source.start_ns - EPOCH_NS) / 1e9
    times = lead_s + np.arange(len(sled.samples_mps2)) / 960.0
    speeds = np.cumsum(np.array(sled.samples_mps2)[:, 0]) / 960.0
    profile = build_profile(block)
    true = np.array([profile.state(time_s)[1][0] for time_s in times])
    # Four times the stated uncertainty, and a delay of a millisecond at 4.9 m/s².
    assert np.abs(speeds - true).max() < 4.0 * source.speed_sigma_mps + 0.005


def test_the_scene_keeps_what_was_found(machine_bag: Path, tmp_path: Path) -> None:
    """It travels with the scene, so every bag and report of the run has it."""
    scene = load_scene(scene_file(tmp_path, {"bag": str(machine_bag), "direction": "-x"}))
    again = Scene.model_validate_json(scene.to_json())
    assert again == scene and recorded(again).source is not None
    assert build_profile(scene).peak_mps2 == recorded(scene).level_mps2 == pytest.approx(4.905, abs=0.03)
    assert np.sum(recorded(scene).samples_mps2, axis=0)[0] == pytest.approx(0.0, abs=1e-6)
    assert np.cumsum(np.array(recorded(scene).samples_mps2)[:, 0]).min() < -100.0


def test_a_twins_own_samples_come_before_its_accelerometer(tmp_path: Path) -> None:
    scene = read_scene(find_scene("block_slip"), [BRAKES, "accelerometer={}"])
    with TestBag(tmp_path / "twin", scene) as bag:
        run_test(scene, observers=[bag])
    exact = recorded(load_scene(scene_file(tmp_path, {"bag": "twin"})))
    assert exact.source is None and exact.level_mps2 is None
    sensed = recorded(load_scene(scene_file(tmp_path, {"bag": "twin", "topic": "sled/accelerometer"})))
    assert sensed.source is not None and sensed.source.uses_sensor_clock
    first = round((sensed.source.start_ns / 1e9 - 1000.0) * 960)
    speeds = [np.cumsum(np.array(sled.samples_mps2)[:, 0]) / 960.0 for sled in (exact, sensed)]
    count = len(speeds[1]) - first - 2
    # Twice the stated uncertainty, and a sample's time at 4.9 m/s².
    apart = speeds[1][:count] - speeds[0][first : first + count]
    assert np.abs(apart).max() < 3.0 * sensed.source.speed_sigma_mps + 4.905 / 960.0


def imu_bag(folder: Path, block: Scene, faults: SensorFaults, *names: str) -> Path:
    readings = faulty_readings(block, faults, 0)
    with BagWriter(folder) as bag:
        topics = [
            bag.add_topic(Topic(name, SLED_ACCELEROMETER.type_name, SLED_ACCELEROMETER.qos)) for name in names
        ]
        for stamp_s, force in zip(readings.stamps, readings.forces, strict=True):
            stamp_ns = EPOCH_NS + round(1e9 * stamp_s)
            payload = serialize(to_imu(AccelerometerSample(stamp_ns, force, 0.0)))
            for topic in topics:
                bag.write(topic, payload, log_time_ns=stamp_ns)
    return folder


def test_which_topic_is_said_where_there_are_several(block: Scene, tmp_path: Path) -> None:
    faults = replace(FAULTS, clock_offset_s=0.0, clock_drift_ppm=0.0, jitter_s=0.0)
    imu_bag(tmp_path / "two", block, faults, "/left/imu", "/right/imu")
    with pytest.raises(BrokenRecording, match=r"/left/imu, /right/imu: name one in sled\.topic"):
        load_scene(scene_file(tmp_path, {"bag": "two"}))
    assert recorded(load_scene(scene_file(tmp_path, {"bag": "two", "topic": "/left/imu"}))).source is not None
    with pytest.raises(BrokenRecording, match="must hold one topic middle"):
        load_scene(scene_file(tmp_path, {"bag": "two", "topic": "middle"}))


def test_a_long_silence_is_refused_in_one_line(block: Scene, tmp_path: Path) -> None:
    faults = replace(FAULTS, gaps=((1.0, 0.08),), clock_offset_s=0.0, clock_drift_ppm=0.0)
    imu_bag(tmp_path / "silent", block, faults, "/imu")
    with pytest.raises(RefusedInput, match=r"gap of 8\d\.\d ms at 0\.9\d\d s: .* for more than 50 ms"):
        load_scene(scene_file(tmp_path, {"bag": "silent"}))


def test_a_bag_without_any_sled_is_refused(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "none") as bag:
        name = bag.add_topic(Topic("/imu", SLED_ACCELEROMETER.type_name, SLED_ACCELEROMETER.qos))
        bag.add_topic(Topic("/odometry", "nav_msgs/msg/Odometry", SLED_ACCELEROMETER.qos))
        reading = AccelerometerSample(EPOCH_NS, np.array([0.0, 0.0, 9.81]), 0.0)
        bag.write(name, serialize(to_imu(reading)), log_time_ns=EPOCH_NS)
    with pytest.raises(RefusedInput, match="at least 50"):
        load_scene(scene_file(tmp_path, {"bag": "none"}))
    with pytest.raises(RefusedInput, match=r"sled\.topic = /odometry: is nav_msgs"):
        load_scene(scene_file(tmp_path, {"bag": "none", "topic": "/odometry"}))


def test_the_clocks_are_compared_by_the_quickest_messages() -> None:
    chance = np.random.Generator(np.random.PCG64(1))
    stamps = EPOCH_NS + 1_000_000 * np.arange(3000, dtype=np.int64)
    delays = 200_000 + chance.exponential(5.0e6, 3000)
    logs = stamps + np.round(2.0e9 + 3.0e-4 * (stamps - stamps[0]) + delays).astype(np.int64)
    fit = clock_fit(stamps, logs)
    assert fit is not None and not fit.is_same
    assert fit.offset_ns == pytest.approx(2.0e9 + 2.0e5, abs=1.0e5)
    assert fit.drift == pytest.approx(3.0e-4, abs=5.0e-5)
    # Written in one go, afterwards: reception says nothing.
    assert clock_fit(stamps, np.full(3000, EPOCH_NS)) is None
    same = clock_fit(stamps, stamps)
    assert same is not None and same.is_same and (same.moved(stamps) == stamps).all()


def test_the_stand_in_holds_no_scene(machine_bag: Path) -> None:
    with BagReader(machine_bag) as reader:
        assert set(reader.topics) == {"/machine/sled/accelerometer", "/machine/packages/poses"}
        assert not reader.attachment_names
