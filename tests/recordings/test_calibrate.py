"""A scene calibrated by what a bench would have recorded: noisy accelerometer, noisy displacement, two clocks."""

import json
from pathlib import Path

import numpy as np
import pytest

from config.errors import BrokenRecording, RefusedInput
from config.scene import Scene
from config.scene_file import find_scene, read_scene
from msgs_adapters.measured_displacement import displacement_from_payload
from msgs_adapters.topics import PACKAGES_POSES
from recordings.bag_reader import BagReader
from recordings.bag_writer import BagWriter
from recordings.bench_recovery import recovered, stand_ins
from recordings.bench_stand_in import write_stand_in
from recordings.calibrate import calibrate_bag, calibration_lines, compare_bag, write_calibrated
from recordings.test_bag import TestBag
from sim_core.bench_stand_in import SensorFaults
from sim_core.run import run_test

SLED = 'sled={"profile": "table", "times_s": [0, 0.05, 0.3, 0.35, 0.6], "acceleration_mps2": [0, 4.9, 4.9, -5.9, 0]}'
FAULTS = SensorFaults(noise_mps2=0.1, gaps=((0.8, 0.02),), clock_offset_s=3.0, clock_drift_ppm=200.0)
FRICTION = "friction:cardboard/sled"


def block(friction: float) -> Scene:
    return read_scene(find_scene("block_slip"), [SLED, f"surfaces.pairs.0.friction={friction}"])


@pytest.fixture(scope="module")
def seen_bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The block with a friction of 0.27, as pictures measure it."""
    folder = tmp_path_factory.mktemp("bench") / "seen"
    return write_stand_in(folder, block(0.27), FAULTS, seed=3, with_pictures=True)


def test_a_scene_is_calibrated_by_pictures(seen_bag: Path, tmp_path: Path) -> None:
    calibrated = calibrate_bag(seen_bag, block(0.6), fit=[FRICTION], workers=1)
    (one,) = calibrated.fit.parameters
    assert one.value == pytest.approx(0.27, abs=0.005) and one.low < 0.27 < one.high
    assert "sled" in one.sigma_share
    assert calibrated.displacement_topic == "/machine/vision/displacement"
    text = " ".join(calibration_lines(calibrated))
    assert f"{FRICTION} = 0.2" in text and "the scene had 0.6" in text and "clocks" in text
    json.dumps(calibrated.entry())
    # The scene keeps its own sled.
    write_calibrated(tmp_path / "fitted.json", calibrated)
    again = read_scene(tmp_path / "fitted.json")
    assert again == calibrated.scene and again.sled == block(0.6).sled
    assert again.surfaces.pairs[0].friction == one.value


def test_a_comparison_says_how_far_the_twin_is(seen_bag: Path) -> None:
    right, wrong = (compare_bag(seen_bag, block(friction)) for friction in (0.27, 0.30))
    assert right["rms_mm"] < 2.0 and right["displacement"] == "/machine/vision/displacement"
    assert wrong["rms_mm"] > 5.0 and wrong["package"] == "block"
    assert any("mounted with a tilt" in line for line in right["sled"])


def test_one_of_the_stand_ins_is_recovered(tmp_path: Path) -> None:
    """Of the twenty of the bench: poses, random mounting, bias, noise, gaps, clock."""
    by_name = {one.name: one for one in stand_ins()}
    assert len(by_name) == 20
    (row,) = recovered(by_name["columns_2"], tmp_path / "bag", workers=1)
    assert row.is_near and row.is_inside
    assert not (tmp_path / "bag").exists()


def test_a_twins_own_bag_is_calibrated_exactly(tmp_path: Path) -> None:
    with TestBag(tmp_path / "twin", block(0.31)) as bag:
        run_test(block(0.31), observers=[bag])
    fit = calibrate_bag(tmp_path / "twin", block(0.31), workers=1).fit
    assert fit.parameters[0].value == pytest.approx(0.31, abs=1e-3)
    assert fit.rms_mm < 0.05 and abs(fit.clock_offset_ms) < 0.1


def test_bag_and_scene_must_fit(seen_bag: Path, tmp_path: Path) -> None:
    with pytest.raises(BrokenRecording, match="packages/poses"):
        calibrate_bag(seen_bag, block(0.3), displacement="packages/poses", workers=1)
    with pytest.raises(
        RefusedInput, match="must be geometry_msgs/msg/PoseArray or sensor_msgs/msg/PointCloud2"
    ):
        calibrate_bag(seen_bag, block(0.3), displacement="/machine/sled/accelerometer", workers=1)
    with TestBag(tmp_path / "twin", block(0.31)) as bag:
        run_test(block(0.31), observers=[bag])
    with pytest.raises(BrokenRecording, match="must be 6, the pallet and the scene's packages"):
        compare_bag(tmp_path / "twin", read_scene(find_scene("slabs")))
    with BagWriter(tmp_path / "bare") as writer:
        writer.add_topic(PACKAGES_POSES)
    with pytest.raises(
        BrokenRecording, match=r"must hold sled/acceleration or one topic of type sensor_msgs/msg/Imu"
    ):
        calibrate_bag(tmp_path / "bare", block(0.3), workers=1)


def test_clouds_are_read_as_written(seen_bag: Path) -> None:
    with BagReader(seen_bag) as reader:
        payloads = [message.payload for message in reader.messages(["/machine/vision/displacement"])]
    first, last = displacement_from_payload(payloads[0]), displacement_from_payload(payloads[-1])
    assert first.rows.tolist() == [1] and first.displacement.shape == first.sigma.shape == (1, 5, 2)
    assert np.abs(first.displacement).max() < 0.005 < 0.02 < np.abs(last.displacement[..., 0]).min()
    assert first.sigma == pytest.approx(0.001)
    with pytest.raises(BrokenRecording, match="vision/displacement"):
        displacement_from_payload(payloads[0][:40])
