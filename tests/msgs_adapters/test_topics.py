"""Topics name installed types, frames are unique, and nothing of ROS is loaded by naming a topic."""

import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rclpy.qos import DurabilityPolicy, HistoryPolicy, ReliabilityPolicy

from config.errors import RefusedInput
from msgs_adapters.topics import (
    ALL_TOPICS,
    CLOCK,
    LATCHED,
    PACKAGES_POSES,
    PALLET_FRAME,
    SLED_FRAME,
    STREAM,
    TF,
    WORLD_FRAME,
    message_class,
    package_frame,
    to_rclpy,
)

ids = st.text(st.characters(codec="utf-8"), min_size=1, max_size=120)


def test_every_topic_but_tf_has_an_installed_type() -> None:
    for topic in ALL_TOPICS:
        if topic is not TF:
            package, name = topic.type_name.split("/msg/")
            assert message_class(topic.type_name).__name__ == name
            assert message_class(topic.type_name).__module__.startswith(package)


@pytest.mark.parametrize("name", ["tf2_msgs/msg/TFMessage", "os/msg/path", "..x/msg/A", "String", ""])
def test_types_that_are_not_installed_are_refused(name: str) -> None:
    with pytest.raises(RefusedInput, match="is not installed"):
        message_class(name)


def test_names_are_pushed_into_the_namespace_unless_absolute() -> None:
    assert PACKAGES_POSES.absolute_name() == "/twin/packages/poses"
    assert PACKAGES_POSES.absolute_name("/machine/") == "/machine/packages/poses"
    assert PACKAGES_POSES.in_namespace("").name == "/packages/poses"
    assert CLOCK.absolute_name("/machine") == "/clock"


def test_qos_reaches_rclpy() -> None:
    stream, latched = to_rclpy(STREAM), to_rclpy(LATCHED)
    assert (stream.depth, stream.reliability) == (5000, ReliabilityPolicy.RELIABLE)
    assert (stream.durability, stream.history) == (DurabilityPolicy.VOLATILE, HistoryPolicy.KEEP_LAST)
    assert (latched.depth, latched.durability) == (1, DurabilityPolicy.TRANSIENT_LOCAL)


@settings(max_examples=60, deadline=None)
@given(a=ids, b=ids)
def test_frames_are_plain_and_unique(a: str, b: str) -> None:
    assert (package_frame(a) == package_frame(b)) == (a == b)
    assert package_frame(a).isascii() and package_frame(a).isprintable() and " " not in package_frame(a)
    assert package_frame(a) not in (SLED_FRAME, WORLD_FRAME, PALLET_FRAME)


def test_topics_and_the_reader_load_no_rclpy() -> None:
    root = Path(__file__).parents[2]
    code = "import sys, msgs_adapters.topics, recordings.bag_reader; print('rclpy' in sys.modules)"
    run = subprocess.run(
        [sys.executable, "-c", code], cwd=root, capture_output=True, text=True, timeout=60, check=True
    )
    assert run.stdout.strip() == "False"
