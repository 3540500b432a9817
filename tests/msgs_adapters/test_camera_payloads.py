"""Pictures and calibration as bytes: those that rclpy reads and writes."""

import numpy as np
import pytest
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import CameraInfo, CompressedImage, Image

from config.errors import BrokenRecording
from msgs_adapters.camera_payloads import (
    Calibration,
    calibration_from_payload,
    camera_info_payload,
    image_payload,
    jpeg_from_payload,
    jpeg_payload,
    picture_from_payload,
)
from msgs_adapters.cdr import serialize

STAMP_NS = 1_000_033_333_333


@pytest.mark.parametrize("shape", [(4, 6, 3), (3, 5, 3), (1, 1, 3), (270, 480, 3)])
def test_image_is_what_ros_reads_and_comes_back(shape: tuple[int, int, int]) -> None:
    picture = np.random.default_rng(0).integers(0, 256, shape, dtype=np.uint8)
    payload = image_payload(STAMP_NS, picture)
    message = deserialize_message(payload, Image)
    assert (message.height, message.width, message.encoding, message.step) == (
        *shape[:2],
        "rgb8",
        3 * shape[1],
    )
    assert message.header.frame_id == "camera_optical" and message.header.stamp.nanosec == 33_333_333
    assert payload == serialize(message)
    for read in (payload, serialize_message(message)):
        stamp_ns, again = picture_from_payload(read)
        assert stamp_ns == STAMP_NS
        np.testing.assert_array_equal(again, picture)


def test_other_encodings_and_padded_rows_are_read() -> None:
    grey = np.arange(6, dtype=np.uint8).reshape(2, 3)
    padded = np.hstack((grey, np.full((2, 1), 255, np.uint8)))
    message = Image(height=2, width=3, encoding="mono8", step=4, data=padded.ravel().tolist())
    np.testing.assert_array_equal(picture_from_payload(serialize(message))[1], np.dstack([grey] * 3))
    message = Image(height=1, width=1, encoding="bgr8", step=3, data=[1, 2, 3])
    assert picture_from_payload(serialize(message))[1].tolist() == [[[3, 2, 1]]]


@pytest.mark.parametrize("size", [0, 1, 7, 4096])
def test_compressed_is_what_ros_reads_and_comes_back(size: int) -> None:
    jpeg = bytes(range(256)) * 16
    payload = jpeg_payload(STAMP_NS, jpeg[:size])
    message = deserialize_message(payload, CompressedImage)
    assert message.format == "rgb8; jpeg compressed bgr8" and bytes(message.data) == jpeg[:size]
    assert payload == serialize(message)
    assert jpeg_from_payload(serialize_message(message)) == (STAMP_NS, jpeg[:size])


def test_calibration_is_what_ros_reads_and_comes_back() -> None:
    matrix = np.array([[1718.8, 0.0, 959.5], [0.0, 1719.1, 539.5], [0.0, 0.0, 1.0]])
    calibration = Calibration(1920, 1080, matrix, np.array([-0.06, 0.02, 1e-3, -1e-3, 0.01]))
    payload = camera_info_payload(STAMP_NS, calibration)
    message = deserialize_message(payload, CameraInfo)
    assert (message.width, message.height, message.distortion_model) == (1920, 1080, "plumb_bob")
    np.testing.assert_array_equal(message.k.reshape(3, 3), matrix)
    np.testing.assert_array_equal(message.p.reshape(3, 4)[:, :3], matrix)
    np.testing.assert_array_equal(message.r.reshape(3, 3), np.eye(3))
    assert payload == serialize(message)
    again = calibration_from_payload(serialize_message(message))
    assert (again.width, again.height) == (1920, 1080)
    np.testing.assert_array_equal(again.matrix, matrix)
    np.testing.assert_array_equal(again.distortion, calibration.distortion)


@pytest.mark.parametrize("read", [picture_from_payload, jpeg_from_payload, calibration_from_payload])
def test_cut_and_foreign_bytes_are_refused(read) -> None:
    picture = np.zeros((4, 4, 3), np.uint8)
    whole = {
        picture_from_payload: image_payload(STAMP_NS, picture),
        jpeg_from_payload: jpeg_payload(STAMP_NS, b"jpeg"),
        calibration_from_payload: camera_info_payload(STAMP_NS, Calibration(4, 4, np.eye(3), np.zeros(5))),
    }[read]
    for payload in (b"", whole[:3], whole[:20], whole[:40], b"\0\0" + whole[2:], b"\xff" * 80):
        with pytest.raises(BrokenRecording, match="is not a"):
            read(payload)
