"""A recorded test of a real load, read by tools that are not ours."""

from pathlib import Path

import pytest
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore

from config.scene_file import find_scene, read_scene, scene_from_json
from tests.recordings.rerun_tools import drawn, rerun
from tests.ros_nodes.graph import pallet_twin

SCENE, SMALL = "eur_fields_05g", "load.layers=4"


@pytest.fixture(scope="module", params=["run", "up"])
def bag(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp(request.param)
    done = pallet_twin(request.param, SCENE, "--set", SMALL, "--out", "out", "--no-estimate", cwd=folder)
    assert done.returncode == 0, done.stderr
    return folder / "out" / "bag"


def test_rerun_finds_no_fault(bag: Path, tmp_path: Path) -> None:
    report = rerun(tmp_path, "mcap", "check", "--full", str(bag / "bag_0.mcap"))
    lines = [line.split() for line in report.splitlines() if " /" in line]
    assert len(lines) == 10
    assert all(line[0] == "ok" and line[-1] == "—" for line in lines), report


def test_rerun_draws_moving_boxes(bag: Path, tmp_path: Path) -> None:
    recording = tmp_path / "bag.rrd"
    rerun(tmp_path, "mcap", "convert", str(bag / "bag_0.mcap"), "-o", str(recording))
    boxes, transforms = drawn(recording)
    assert len(boxes) == 1 + 32
    moving = [
        child for child, (parent, x) in transforms.items() if parent == "sled" and max(x) - min(x) > 0.005
    ]
    assert len(moving) > 8
    travel = transforms["sled"][1]
    assert max(travel) - min(travel) > 1.0


def test_rosbags_reads_every_message_hash_and_profile(bag: Path) -> None:
    typestore = get_typestore(Stores.ROS2_JAZZY)
    with Reader(bag) as reader:
        assert all(c.digest == typestore.hash_rihs01(c.msgtype) for c in reader.connections)
        expected = reader.message_count
    with AnyReader([bag]) as reader:
        decoded = [reader.deserialize(payload, c.msgtype) for c, _, payload in reader.messages()]
    assert len(decoded) == expected > 1000


def test_mcap_reads_the_scene(bag: Path) -> None:
    with (bag / "bag_0.mcap").open("rb") as stream:
        (attachment,) = make_reader(stream, validate_crcs=True).iter_attachments()
    assert attachment.name == "scene.json"
    assert scene_from_json(attachment.data.decode()) == read_scene(find_scene(SCENE), [SMALL])
