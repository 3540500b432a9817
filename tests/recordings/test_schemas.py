"""Definitions and hashes agree with the installed ones, with rosbags' and with mcap's parser."""

import json
import sys
from pathlib import Path

import pytest
from mcap_ros2._dynamic import generate_dynamic
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from config.errors import RefusedInput
from msgs_adapters.topics import ALL_TOPICS
from recordings.schemas import TF_MESSAGE, message_definition, type_hash

TYPESTORE = get_typestore(Stores.ROS2_JAZZY)
INSTALLED = sorted(Path(sys.prefix, "share").glob("*/msg/*.json"))


def test_the_hash_rule_reproduces_every_installed_hash() -> None:
    assert len(INSTALLED) > 100
    for path in INSTALLED:
        content = json.loads(path.read_text())
        message = content["type_description_msg"]
        expected = {entry["type_name"]: entry["hash_string"] for entry in content["type_hashes"]}
        root = message["type_description"]
        shuffled = reversed(message["referenced_type_descriptions"])
        assert type_hash(root, shuffled) == expected[root["type_name"]]


@pytest.mark.parametrize("type_name", sorted({topic.type_name for topic in ALL_TOPICS}))
def test_hash_and_text_agree_with_rosbags(type_name: str) -> None:
    definition = message_definition(type_name)
    assert definition.type_hash == TYPESTORE.hash_rihs01(type_name)
    parsed = get_types_from_msg(definition.text, type_name)
    assert set(parsed) >= {type_name}
    for name, fields in parsed.items():
        assert fields == TYPESTORE.fielddefs[name]
    # The parts stand as rosbag2 writes them: 80 equal signs, then the short name.
    parts = definition.text.split("=" * 80 + "\nMSG: ")
    assert [part.partition("\n")[0] for part in parts[1:]] == sorted(
        name.replace("/msg/", "/") for name in parsed if name != type_name
    )
    assert generate_dynamic(type_name, definition.text)


def test_tf_message_is_the_published_type() -> None:
    definition = message_definition(TF_MESSAGE)
    assert definition.text.startswith("geometry_msgs/TransformStamped[] transforms\n===")
    assert definition.type_hash == "RIHS01_e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087"


@pytest.mark.parametrize("type_name", ["tf2_msgs/msg/TF2Error", "../msg/x", "x/msg/../../../etc/passwd", ""])
def test_types_that_are_not_installed_are_refused(type_name: str) -> None:
    with pytest.raises(RefusedInput, match="is not installed"):
        message_definition(type_name)
