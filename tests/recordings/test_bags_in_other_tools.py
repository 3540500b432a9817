"""rosbags, mcap and rerun read the twin's bags without a complaint, and rerun draws moving boxes."""

from pathlib import Path

import pytest
import yaml
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from rosbags.interfaces import ConnectionExtRosbag2
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore

from tests.recordings.rerun_tools import drawn, rerun

Records = list[tuple[str, bytes, int]]


def test_rosbags_reads_and_decodes_every_message(sample_bag: Path, sample_records: Records) -> None:
    typestore = get_typestore(Stores.ROS2_JAZZY)
    with AnyReader([sample_bag]) as reader:
        read = []
        for connection, stamp_ns, payload in reader.messages():
            assert typestore.deserialize_cdr(payload, connection.msgtype) is not None
            assert reader.deserialize(payload, connection.msgtype) is not None
            read.append((connection.topic, bytes(payload), stamp_ns))
    assert read == sample_records


def test_rosbags_agrees_on_hashes_counts_and_qos(sample_bag: Path, sample_records: Records) -> None:
    typestore = get_typestore(Stores.ROS2_JAZZY)
    with Reader(sample_bag) as reader:
        assert reader.ros_distro == "jazzy"
        assert reader.message_count == len(sample_records)
        for connection in reader.connections:
            assert connection.digest == typestore.hash_rihs01(connection.msgtype)
            assert connection.msgcount == sum(name == connection.topic for name, _, _ in sample_records)
            latched = connection.topic.endswith(("scene", "report", "robot_description"))
            assert isinstance(connection.ext, ConnectionExtRosbag2)
            (qos,) = connection.ext.offered_qos_profiles
            assert qos.durability.name == ("TRANSIENT_LOCAL" if latched else "VOLATILE")
            assert qos.reliability.name == "RELIABLE"


def test_mcap_reads_header_channels_attachments_and_metadata(sample_bag: Path) -> None:
    with (sample_bag / "sample_0.mcap").open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        assert reader.get_header().profile == "ros2"
        assert {a.name: (a.media_type, a.data) for a in reader.iter_attachments()} == {
            "scene.json": ("application/json", b'{"name": "two"}'),
            "report.json": ("application/json", b'{"verdict": "pass"}'),
        }
        summary = reader.get_summary()
        assert summary is not None and summary.statistics is not None
        for channel in summary.channels.values():
            assert channel.message_encoding == "cdr"
            assert channel.metadata["topic_type_hash"].startswith("RIHS01_")
        records = {record.name: record.metadata for record in reader.iter_metadata()}
        information = yaml.safe_load(records["rosbag2"]["serialized_metadata"])
        beside = yaml.safe_load((sample_bag / "metadata.yaml").read_text())
        assert information == beside["rosbag2_bagfile_information"]
        moved = [d.decoded_message for d in reader.iter_decoded_messages(topics=["/tf"])]
        assert [t.child_frame_id for t in moved[0].transforms] == [
            "sled", "pallet", "package_a%20%26%20%3C1%3E", "package_b",
        ]  # fmt: skip
        assert moved[-1].transforms[3].transform.translation.x == pytest.approx(0.059)


@pytest.mark.parametrize("options", [(), ("--full",)])
def test_rerun_check_finds_no_fault(sample_bag: Path, tmp_path: Path, options: tuple[str, ...]) -> None:
    report = rerun(tmp_path, "mcap", "check", *options, str(sample_bag / "sample_0.mcap"))
    lines = [line.split() for line in report.splitlines() if " /" in line]
    assert len(lines) == 15
    if options:
        # Decoding any PointCloud2, rerun makes a chunk of each cloud and calls them unordered among themselves.
        (cloud,) = [line for line in lines if line[3] == "/twin/wrap/strain"]
        assert {"unordered", "chunks"} <= set(cloud)
        lines.remove(cloud)
    assert all(line[0] == "ok" and line[-1] == "—" for line in lines), report


def test_rerun_draws_boxes_on_frames_that_move(sample_bag: Path, tmp_path: Path) -> None:
    recording = tmp_path / "bag.rrd"
    rerun(tmp_path, "mcap", "convert", str(sample_bag / "sample_0.mcap"), "-o", str(recording))
    boxes, transforms = drawn(recording)
    # Half sizes of pallet and packages, each on the frame of its link.
    assert {frame: pytest.approx(half_size) for frame, half_size in boxes.items()} == {
        "pallet": [0.6, 0.4, 0.072],
        "package_a%20%26%20%3C1%3E": [0.2, 0.15, 0.125],
        "package_b": [0.1, 0.15, 0.125],
    }
    assert {child: parent for child, (parent, _) in transforms.items()} == {
        "sled": "world", "pallet": "sled", "package_a%20%26%20%3C1%3E": "sled", "package_b": "sled",
    }  # fmt: skip
    travel = {child: max(x) - min(x) for child, (_, x) in transforms.items()}
    assert travel["package_b"] == pytest.approx(0.059, abs=1e-6)
    assert travel["package_a%20%26%20%3C1%3E"] == 0.0
    # Half of 2 m/s² over 59 periods of 1/240 s, squared.
    assert travel["sled"] == pytest.approx(0.5 * 2.0 * (59 * 4_166_667e-9) ** 2, abs=1e-6)
