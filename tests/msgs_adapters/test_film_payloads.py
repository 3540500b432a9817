"""Film bytes against rclpy, rosbags and their own reading; hostile ones; and that they are cheap."""

import time
from array import array
from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message, serialize_message
from rosbags.typesys import Stores, get_typestore
from sensor_msgs.msg import PointCloud2, PointField
from std_msgs.msg import Header

from config.errors import BrokenRecording
from msgs_adapters.cdr import serialize
from msgs_adapters.film_payloads import FIELDS, film_cloud_payload, film_frame_from_payload
from msgs_adapters.stamps import to_time_msg
from sim_core.frames import FilmFrame
from tests.msgs_adapters.films import film, films

TYPESTORE = get_typestore(Stores.ROS2_JAZZY)
TYPE = "sensor_msgs/msg/PointCloud2"


def cloud(frame: FilmFrame) -> PointCloud2:
    """The message as a node would build it, a corner after the other."""
    points = array("f")
    for element in range(len(frame.corners)):
        for corner in range(3):
            points.extend(
                (*frame.corners[element, corner], *frame.unrolled[element, corner], *frame.strains[element])
            )
            points.extend((frame.peaks[element], frame.forces[element], frame.torn_s[element]))
    return PointCloud2(
        header=Header(stamp=to_time_msg(frame.stamp_ns), frame_id="sled"),
        height=len(frame.corners),
        width=3,
        fields=[
            PointField(name=name, offset=4 * i, datatype=PointField.FLOAT32, count=1)
            for i, name in enumerate(FIELDS)
        ],
        point_step=44,
        row_step=132,
        data=array("B", points.tobytes()),
        is_dense=True,
    )


@settings(max_examples=60, deadline=None)
@given(films)
def test_film_bytes_are_those_of_a_freshly_built_message(frame: FilmFrame) -> None:
    message, payload = cloud(frame), film_cloud_payload(frame)
    assert payload == serialize(message)
    assert deserialize_message(payload, PointCloud2) == message
    theirs = TYPESTORE.serialize_cdr(TYPESTORE.deserialize_cdr(payload, TYPE), TYPE)
    assert payload == bytes(theirs).ljust(len(payload), b"\0")


@settings(max_examples=60, deadline=None)
@given(films)
def test_films_survive_to_the_bit(frame: FilmFrame) -> None:
    # Also with whatever rclpy leaves in the padding.
    for payload in (film_cloud_payload(frame), serialize_message(cloud(frame))):
        read = film_frame_from_payload(payload, 8)
        for name in (field.name for field in fields(FilmFrame)):
            ours, theirs = np.asarray(getattr(frame, name)), np.asarray(getattr(read, name))
            assert (ours.dtype, ours.shape, ours.tobytes()) == (theirs.dtype, theirs.shape, theirs.tobytes())
            assert theirs.flags.c_contiguous


@settings(max_examples=60, deadline=None)
@given(films, st.data())
def test_cut_or_foreign_bytes_are_refused(frame: FilmFrame, data: st.DataObject) -> None:
    payload = film_cloud_payload(frame)
    # The last three bytes are padding.
    for broken in (
        payload[: data.draw(st.integers(0, len(payload) - 4))],
        b"\0\0" + payload[2:],
        payload.replace(b"sled", b"bent", 1),
        payload.replace(b"strain_up", b"strain_of", 1),
    ):
        with pytest.raises(BrokenRecording, match="is not a PointCloud2 of FLOAT32 x y z around"):
            film_frame_from_payload(broken, 0)


@settings(max_examples=200, deadline=None)
@given(films, st.data())
def test_a_changed_byte_gives_a_film_or_one_line(frame: FilmFrame, data: st.DataObject) -> None:
    payload = bytearray(film_cloud_payload(frame))
    payload[data.draw(st.integers(0, len(payload) - 1))] = data.draw(st.integers(0, 255))
    try:
        read = film_frame_from_payload(bytes(payload), 8)
    except BrokenRecording as error:
        assert "\n" not in str(error)
    else:
        assert read.corners.shape == frame.corners.shape
        assert np.isfinite(read.corners.sum(axis=1)).all()


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 2e38])
@pytest.mark.parametrize("name", ["corners", "unrolled", "peaks", "torn_s"])
def test_numbers_that_no_film_has_are_refused(name: str, value: float) -> None:
    frame = film(10**9, np.zeros((2, 21), np.float32))
    values = getattr(frame, name).copy()
    values.flat[-1] = value
    with pytest.raises(BrokenRecording, match="must be numbers below"):
        film_frame_from_payload(film_cloud_payload(replace(frame, **{name: values})), 0)


def test_an_element_says_one_thing_at_its_corners() -> None:
    message = cloud(film(10**9, np.ones((2, 21), np.float32)))
    message.data[-4:] = array("B", np.float32(2.0).tobytes())
    with pytest.raises(BrokenRecording, match="the same at its corners"):
        film_frame_from_payload(serialize(message), 0)


def test_1200_elements_cost_less_than_a_millisecond() -> None:
    frame = film(10**9, np.random.default_rng(0).normal(size=(1200, 21)).astype(np.float32))
    costs = []
    for _ in range(30):
        start = time.perf_counter()
        film_frame_from_payload(film_cloud_payload(frame), 0)
        costs.append(time.perf_counter() - start)
    assert min(costs) < 1.0e-3
