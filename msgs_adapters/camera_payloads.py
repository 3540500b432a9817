"""Pictures and the camera's calibration to and from the bytes of Image, CompressedImage and CameraInfo.

A picture of 1920 x 1080 takes 6 MB, so its bytes are copied as they are and never walked.
"""

import struct
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from config.errors import BrokenRecording
from msgs_adapters.cdr import ENCAPSULATION, align, write_string
from msgs_adapters.stamps import split_stamp
from msgs_adapters.topics import CAMERA_FRAME
from sim_core.frames import Array

JPEG_FORMAT = "rgb8; jpeg compressed bgr8"
"""As image_transport's compressed_image_transport names a JPEG that was made from rgb8."""

_STAMP = struct.Struct("<iI")
_COUNT = struct.Struct("<I")
_SIZE = struct.Struct("<II")
_ENCODINGS = {"rgb8": 3, "bgr8": 3, "mono8": 1}
_MODEL = "plumb_bob"
_LARGEST_EDGE = 65_536


@dataclass(frozen=True, eq=False)
class Calibration:
    """What ``camera_info`` says.

    Attributes:
        width: of the picture [px].
        height: of the picture [px].
        matrix: intrinsics K, shape [3, 3].
        distortion: k1, k2, p1, p2, k3, shape [5].
    """

    width: int
    height: int
    matrix: Array
    distortion: Array


def image_payload(stamp_ns: int, picture: NDArray[np.uint8]) -> bytes:
    """CDR bytes of a ``sensor_msgs/Image``, encoding rgb8.

    Args:
        stamp_ns: when the shutter closed [ns].
        picture: RGB, shape [height, width, 3].
    """
    height, width, _ = picture.shape
    head = _head(stamp_ns)
    align(head, 4)
    head += _SIZE.pack(height, width)
    write_string(head, "rgb8")
    head += b"\0"
    align(head, 4)
    head += _SIZE.pack(3 * width, picture.size)
    return b"".join((head, picture.tobytes(), bytes(-picture.size % 4)))


def picture_from_payload(payload: bytes) -> tuple[int, NDArray[np.uint8]]:
    """Stamp [ns] and RGB picture, shape [height, width, 3], of an Image in rgb8, bgr8 or mono8.

    Raises:
        BrokenRecording: the bytes are no such message.
    """
    try:
        stamp_ns, offset = _after_head(payload)
        height, width = _SIZE.unpack_from(payload, offset)
        encoding, offset = _text(payload, offset + _SIZE.size)
        # is_bigendian is a byte, and of no meaning for bytes.
        step, size = _SIZE.unpack_from(payload, _aligned(offset + 1))
        start, channels = _aligned(offset + 1) + _SIZE.size, _ENCODINGS[encoding]
        if size != step * height or step < width * channels or not 0 < width < _LARGEST_EDGE:
            raise ValueError
        rows = np.frombuffer(payload, np.uint8, size, start).reshape(height, step)[:, : width * channels]
    except (struct.error, ValueError, KeyError):
        limit = f"is not an Image in {', '.join(_ENCODINGS)}"
        raise BrokenRecording("camera/image_raw", payload[:16].hex(), limit) from None
    picture = rows.reshape(height, width, channels)
    if encoding == "bgr8":
        picture = picture[:, :, ::-1]
    return stamp_ns, np.ascontiguousarray(np.broadcast_to(picture, (height, width, 3)))


def jpeg_payload(stamp_ns: int, jpeg: bytes) -> bytes:
    """CDR bytes of a ``sensor_msgs/CompressedImage`` that holds a JPEG, taken at a stamp [ns]."""
    head = _head(stamp_ns)
    write_string(head, JPEG_FORMAT)
    align(head, 4)
    head += _COUNT.pack(len(jpeg))
    return b"".join((head, jpeg, bytes(-len(jpeg) % 4)))


def jpeg_from_payload(payload: bytes) -> tuple[int, bytes]:
    """Stamp [ns] and compressed bytes of a CompressedImage, whatever their format.

    Raises:
        BrokenRecording: the bytes are no such message.
    """
    try:
        stamp_ns, offset = _after_head(payload)
        _, offset = _text(payload, offset)
        offset = _aligned(offset)
        (size,) = _COUNT.unpack_from(payload, offset)
        start = offset + _COUNT.size
        if len(payload) < start + size:
            raise ValueError
    except (struct.error, ValueError):
        raise BrokenRecording(
            "camera/image_raw/compressed", payload[:16].hex(), "is not a CompressedImage"
        ) from None
    return stamp_ns, bytes(payload[start : start + size])


def camera_info_payload(stamp_ns: int, calibration: Calibration) -> bytes:
    """CDR bytes of the ``sensor_msgs/CameraInfo`` of a picture at a stamp [ns]: plumb_bob, no rectification."""
    payload = _head(stamp_ns)
    align(payload, 4)
    payload += _SIZE.pack(calibration.height, calibration.width)
    write_string(payload, _MODEL)
    align(payload, 4)
    payload += _COUNT.pack(5)
    align(payload, 8)
    projection = np.hstack((calibration.matrix, np.zeros((3, 1))))
    for values in (calibration.distortion, calibration.matrix, np.eye(3), projection):
        payload += np.ascontiguousarray(values, "<f8").tobytes()
    # Binning and region of interest: none.
    payload += _SIZE.pack(0, 0) + 2 * _SIZE.pack(0, 0) + b"\0"
    align(payload, 4)
    return bytes(payload)


def calibration_from_payload(payload: bytes) -> Calibration:
    """The calibration in a CameraInfo of model plumb_bob.

    Raises:
        BrokenRecording: the bytes are no such message, or its figures are no camera's.
    """
    try:
        _, offset = _after_head(payload)
        height, width = _SIZE.unpack_from(payload, offset)
        model, offset = _text(payload, offset + _SIZE.size)
        offset = _aligned(offset)
        (count,) = _COUNT.unpack_from(payload, offset)
        if model != _MODEL or count != 5:
            raise ValueError
        numbers = np.frombuffer(payload, "<f8", 14, _aligned(offset + _COUNT.size, 8))
    except (struct.error, ValueError):
        raise BrokenRecording(
            "camera/camera_info", payload[:16].hex(), f"is not a CameraInfo of model {_MODEL} with 5 figures"
        ) from None
    matrix = numbers[5:].reshape(3, 3).astype(np.float64)
    if not np.isfinite(numbers).all() or matrix[0, 0] <= 0.0 or matrix[1, 1] <= 0.0:
        raise BrokenRecording("camera/camera_info.k", matrix.ravel().tolist(), "must hold two focal lengths")
    return Calibration(width, height, matrix, numbers[:5].astype(np.float64))


def _head(stamp_ns: int) -> bytearray:
    head = bytearray(ENCAPSULATION + _STAMP.pack(*split_stamp(stamp_ns)))
    write_string(head, CAMERA_FRAME)
    return head


def _after_head(payload: bytes) -> tuple[int, int]:
    if payload[:2] != ENCAPSULATION[:2]:
        raise ValueError
    seconds, nanoseconds = _STAMP.unpack_from(payload, len(ENCAPSULATION))
    _, offset = _text(payload, len(ENCAPSULATION) + _STAMP.size)
    return seconds * 1_000_000_000 + nanoseconds, _aligned(offset)


def _text(payload: bytes, offset: int) -> tuple[str, int]:
    """The string that stands at an offset, aligned, and where it ends."""
    offset = _aligned(offset)
    (size,) = _COUNT.unpack_from(payload, offset)
    start = offset + _COUNT.size
    return bytes(payload[start : start + size - 1]).decode(), start + size


def _aligned(offset: int, size: int = 4) -> int:
    return offset + (len(ENCAPSULATION) - offset) % size
