"""QoS texts survive, those of other tools are understood, and metadata.yaml is version 9."""

from pathlib import Path

import pytest
import yaml
from rosbags.rosbag2.metadata import parse_qos as rosbags_parse_qos

from config.errors import BrokenRecording
from msgs_adapters.topics import LATCHED, STREAM, QosSpec
from recordings.rosbag2_metadata import (
    FileSummary,
    bag_information,
    parse_qos,
    qos_text,
    read_file_names,
)


@pytest.mark.parametrize("spec", [STREAM, LATCHED, QosSpec(reliability="best_effort", depth=3)])
def test_qos_survives_and_is_what_rosbags_reads(spec: QosSpec) -> None:
    assert parse_qos(qos_text(spec)) == spec
    (qos,) = rosbags_parse_qos(qos_text(spec))
    assert (qos.depth, qos.reliability.name.lower(), qos.durability.name.lower()) == (
        spec.depth,
        spec.reliability,
        spec.durability,
    )
    assert qos.deadline.sec * 10**9 + qos.deadline.nsec == 2**63 - 1


@pytest.mark.parametrize("text", ["", "[]", "{", "x", "[1]", "- {depth: many}", "- {depth: 1}"])
def test_unknown_profiles_stand_at_the_default(text: str) -> None:
    assert parse_qos(text) == QosSpec()


def test_numbers_of_older_bags_and_unknown_depths_are_understood() -> None:
    old = "- {history: 3, depth: 0, reliability: 2, durability: 1}"
    assert parse_qos(old) == QosSpec(reliability="best_effort", durability="transient_local")


def test_metadata_yaml(sample_bag: Path) -> None:
    information = yaml.safe_load((sample_bag / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert information["version"] == 9
    assert information["relative_file_paths"] == ["sample_0.mcap"]
    counts = [topic["message_count"] for topic in information["topics_with_message_count"]]
    assert sum(counts) == information["message_count"] == information["files"][0]["message_count"]
    assert "&id" not in (sample_bag / "metadata.yaml").read_text()


def test_files_of_a_split_recording(tmp_path: Path) -> None:
    path = tmp_path / "metadata.yaml"
    body = "{rosbag2_bagfile_information: {storage_identifier: mcap, relative_file_paths: [%s]}}"
    path.write_text(body % "x_0.mcap, x_1.mcap")
    assert read_file_names(path) == ["x_0.mcap", "x_1.mcap"]
    for names, limit in (
        ("x, x", "twice"),
        ("x, ../x", "a path"),
        ("x, 1", "one file"),
        ('"a\\0b"', "a path"),
    ):
        path.write_text(body % names)
        with pytest.raises(BrokenRecording, match=limit):
            read_file_names(path)


def test_information_of_several_files() -> None:
    files = [
        FileSummary("x_0.mcap", 5, 9, 3),
        FileSummary("x_1.mcap", 9, 20, 2),
        FileSummary("x_2.mcap", 0, 0, 0),
    ]
    information = bag_information(files, [])
    assert information["starting_time"] == {"nanoseconds_since_epoch": 5}
    assert information["duration"] == {"nanoseconds": 15}
    assert information["message_count"] == 5
    assert [file["duration"]["nanoseconds"] for file in information["files"]] == [4, 11, 0]
