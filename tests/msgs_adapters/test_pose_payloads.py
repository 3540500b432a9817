"""Pose and transform bytes against rclpy, rosbags and their own reading; and that they are cheap."""

import time

import numpy as np
import pytest
from geometry_msgs.msg import Point, Pose, PoseArray, Quaternion
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from rclpy.serialization import deserialize_message, serialize_message
from rosbags.typesys import Stores, get_typestore
from std_msgs.msg import Header

from config.errors import BrokenRecording
from msgs_adapters.cdr import serialize
from msgs_adapters.pose_payloads import TransformEncoder, pose_array_payload, pose_frame_from_payload
from msgs_adapters.stamps import MAX_STAMP_NS, to_time_msg
from msgs_adapters.topics import package_frame
from sim_core.frames import PoseFrame

TYPESTORE = get_typestore(Stores.ROS2_JAZZY)

frames = st.builds(
    lambda stamp_ns, rows: PoseFrame(3, stamp_ns, rows[:, :3].copy(), rows[:, 3:].copy()),
    st.integers(0, MAX_STAMP_NS),
    st.integers(0, 12).flatmap(
        lambda n: arrays(np.float64, (n, 7), elements=st.floats(allow_nan=False, allow_infinity=False))
    ),
)


def pose_array(frame: PoseFrame) -> PoseArray:
    rows = np.hstack((frame.positions, frame.orientations)).tolist()
    poses = [
        Pose(position=Point(x=x, y=y, z=z), orientation=Quaternion(x=a, y=b, z=c, w=d))
        for x, y, z, a, b, c, d in rows
    ]
    return PoseArray(header=Header(stamp=to_time_msg(frame.stamp_ns), frame_id="sled"), poses=poses)


@settings(max_examples=60, deadline=None)
@given(frames)
def test_pose_bytes_are_those_of_a_freshly_built_message(frame: PoseFrame) -> None:
    message, payload = pose_array(frame), pose_array_payload(frame)
    assert payload == serialize(message)
    assert deserialize_message(payload, PoseArray) == message
    # "sled" leaves three bytes of padding before the count; rclpy does not clear them.
    theirs = serialize_message(message)
    assert (payload[:21], payload[24:]) == (theirs[:21], theirs[24:])
    assert payload[21:24] == bytes(3)


@settings(max_examples=60, deadline=None)
@given(frames)
def test_pose_frames_survive(frame: PoseFrame) -> None:
    # Also with whatever rclpy leaves in the padding.
    for payload in (pose_array_payload(frame), serialize_message(pose_array(frame))):
        read = pose_frame_from_payload(payload, 3)
        assert (read.index, read.stamp_ns) == (3, frame.stamp_ns)
        np.testing.assert_array_equal(read.positions, frame.positions, strict=True)
        np.testing.assert_array_equal(read.orientations, frame.orientations, strict=True)


@settings(max_examples=60, deadline=None)
@given(frames.filter(lambda frame: len(frame.positions) > 0), st.data())
def test_cut_or_foreign_bytes_are_refused(frame: PoseFrame, data: st.DataObject) -> None:
    payload = pose_array_payload(frame)
    with pytest.raises(BrokenRecording):
        pose_frame_from_payload(payload[: data.draw(st.integers(0, len(payload) - 1))], 0)
    with pytest.raises(BrokenRecording, match="frame_id"):
        pose_frame_from_payload(payload.replace(b"sled", b"bent"), 0)
    with pytest.raises(BrokenRecording):
        pose_frame_from_payload(b"\0\0" + payload[2:], 0)


@settings(max_examples=60, deadline=None)
@given(
    stamp_ns=st.integers(0, MAX_STAMP_NS),
    ids=st.lists(st.text(st.characters(codec="utf-8"), min_size=1, max_size=9), unique=True, max_size=6),
    seed=st.integers(0, 1000),
)
def test_transform_bytes_are_those_of_rosbags(stamp_ns: int, ids: list[str], seed: int) -> None:
    rng = np.random.default_rng(seed)
    frame = PoseFrame(0, stamp_ns, rng.normal(size=(len(ids) + 1, 3)), rng.normal(size=(len(ids) + 1, 4)))
    sled = rng.normal(size=3)
    assert TransformEncoder(ids).encode(frame, sled) == rosbags_transforms(frame, sled, ids)


def rosbags_transforms(frame: PoseFrame, sled: np.ndarray, ids: list[str]) -> bytes:
    kinds = TYPESTORE.types
    stamp = kinds["builtin_interfaces/msg/Time"](*divmod(frame.stamp_ns, 10**9))
    children = [("world", "sled"), *(("sled", name) for name in ("pallet", *map(package_frame, ids)))]
    positions = np.vstack((sled, frame.positions))
    orientations = np.vstack(([0.0, 0.0, 0.0, 1.0], frame.orientations))
    transforms = [
        kinds["geometry_msgs/msg/TransformStamped"](
            kinds["std_msgs/msg/Header"](stamp, parent),
            child,
            kinds["geometry_msgs/msg/Transform"](
                kinds["geometry_msgs/msg/Vector3"](*position.tolist()),
                kinds["geometry_msgs/msg/Quaternion"](*orientation.tolist()),
            ),
        )
        for (parent, child), position, orientation in zip(children, positions, orientations, strict=True)
    ]
    message = kinds["tf2_msgs/msg/TFMessage"](transforms)
    return bytes(TYPESTORE.serialize_cdr(message, "tf2_msgs/msg/TFMessage"))


def test_41_poses_cost_less_than_a_third_of_a_millisecond() -> None:
    rng = np.random.default_rng(0)
    frame = PoseFrame(0, 10**9, rng.normal(size=(41, 3)), rng.normal(size=(41, 4)))
    encoder, sled = TransformEncoder([str(i) for i in range(40)]), np.zeros(3)
    costs = []
    for _ in range(50):
        start = time.perf_counter()
        pose_array_payload(frame)
        encoder.encode(frame, sled)
        costs.append(time.perf_counter() - start)
    assert min(costs) < 0.3e-3


def test_place_that_is_no_number_is_refused_by_its_row() -> None:
    positions, orientations = np.zeros((3, 3)), np.tile([0.0, 0.0, 0.0, 1.0], (3, 1))
    positions[2, 1] = np.nan
    payload = pose_array_payload(PoseFrame(0, 10**9, positions, orientations))
    with pytest.raises(BrokenRecording, match=r"packages/poses\.poses\[2\] = .*nan.*: must be finite"):
        pose_frame_from_payload(payload, 0)
