"""CDR bytes: those of rclpy but for padding, and those of rosbags' independent encoder to the last byte."""

from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import AccelStamped, PoseArray
from hypothesis import given, settings
from hypothesis import strategies as st
from nav_msgs.msg import Odometry
from rclpy.serialization import deserialize_message, serialize_message
from rosbags.typesys import Stores, get_typestore
from rosidl_parser.definition import UnboundedWString
from sensor_msgs.msg import Imu, JointState, PointCloud2, PointField
from std_msgs.msg import Header, String
from visualization_msgs.msg import Marker, MarkerArray

from msgs_adapters.cdr import _value_writer, serialize
from msgs_adapters.stamps import to_clock, to_time_msg

TYPESTORE = get_typestore(Stores.ROS2_JAZZY)


def assert_is_rclpys_but_for_padding(payload: bytes, message: Any) -> None:
    """A byte may differ only where ours is zero and where rclpy's value means nothing to a reader.

    rclpy takes an empty sequence of doubles for eight bytes longer than it is, and appends so much.
    """
    theirs = bytearray(serialize_message(message))
    theirs.extend(bytes(-len(theirs) % 4))
    assert len(payload) <= len(theirs)
    ours = payload.ljust(len(theirs), b"\0")
    for position in [i for i, (a, b) in enumerate(zip(ours, theirs, strict=True)) if a != b]:
        assert ours[position] == 0
        theirs[position] ^= 0xFF
    assert deserialize_message(bytes(theirs), type(message)) == message
    assert deserialize_message(payload, type(message)) == message


def rosbags_encoding(payload: bytes, type_name: str) -> bytes:
    decoded = TYPESTORE.deserialize_cdr(payload, type_name)
    encoded = bytes(TYPESTORE.serialize_cdr(decoded, type_name))
    return encoded.ljust(len(encoded) + -len(encoded) % 4, b"\0")


def header(frame: str) -> Header:
    return Header(stamp=to_time_msg(12_000_000_345), frame_id=frame)


def messages(text: str, number: float) -> list[tuple[Any, str]]:
    imu = Imu(header=header(text))
    imu.linear_acceleration_covariance[4] = number
    status = DiagnosticStatus(
        level=DiagnosticStatus.WARN, name=text, message=text, values=[KeyValue(key=text, value="v")] * 2
    )
    marker = Marker(header=header(text), ns=text, id=-3, frame_locked=True, text=text)
    marker.texture.data.frombytes(b"\x01\x02\x03")
    marker.scale.x = number
    cloud = PointCloud2(header=header(text), fields=[PointField(name=text, datatype=7, count=1)], width=2)
    cloud.data.frombytes(bytes(range(8)))
    return [
        (String(data=text), "std_msgs/msg/String"),
        (to_clock(12_000_000_345), "rosgraph_msgs/msg/Clock"),
        (AccelStamped(header=header(text)), "geometry_msgs/msg/AccelStamped"),
        (PoseArray(header=header(text)), "geometry_msgs/msg/PoseArray"),
        (Odometry(header=header(text), child_frame_id=text), "nav_msgs/msg/Odometry"),
        (imu, "sensor_msgs/msg/Imu"),
        (DiagnosticArray(header=header(text), status=[status] * 2), "diagnostic_msgs/msg/DiagnosticArray"),
        (MarkerArray(markers=[marker] * 2), "visualization_msgs/msg/MarkerArray"),
        (cloud, "sensor_msgs/msg/PointCloud2"),
        (
            JointState(header=header(text), name=[text], position=[number], effort=[number, 1.0]),
            "sensor_msgs/msg/JointState",
        ),
    ]


@settings(max_examples=40, deadline=None)
@given(
    text=st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=12),
    number=st.floats(allow_nan=False),
)
def test_serialize_gives_the_bytes_of_rclpy_and_rosbags(text: str, number: float) -> None:
    for message, type_name in messages(text, number):
        payload = serialize(message)
        assert_is_rclpys_but_for_padding(payload, message)
        assert payload == rosbags_encoding(payload, type_name)


def test_equal_messages_give_equal_bytes_whatever_the_heap_held_before() -> None:
    rng = np.random.default_rng(1)
    seen = set()
    for _ in range(200):
        serialize_message(String(data="\x7f" * int(rng.integers(1, 3000))))
        seen.add(serialize(AccelStamped(header=header("ab"))))
    assert len(seen) == 1


def test_a_wide_string_is_refused() -> None:
    with pytest.raises(NotImplementedError, match="no CDR writer"):
        _value_writer(UnboundedWString())
