"""Measured displacement from the bytes of PointCloud2: what ``vision_payloads`` writes, read back."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sensor_msgs.msg import PointCloud2

from config.errors import BrokenRecording
from msgs_adapters.stamps import to_ns
from msgs_adapters.vision_payloads import FIELDS
from sim_core.frames import Array

_WHERE = "vision/displacement"


@dataclass(frozen=True, eq=False)
class DisplacementCloud:
    """What one picture says.

    Attributes:
        stamp_ns: of the picture [ns].
        rows: of the packages in a pose frame, shape [k].
        displacement: of middle and corners along the picture's right and up [m], shape [k, 5, 2]; NaN: not seen.
        sigma: standard uncertainty of each [m], same shape.
    """

    stamp_ns: int
    rows: NDArray[np.intp]
    displacement: Array
    sigma: Array


def displacement_from_payload(payload: bytes) -> DisplacementCloud:
    """The measurement that a message's CDR bytes hold.

    Raises:
        BrokenRecording: the bytes are no PointCloud2.
    """
    from rclpy.serialization import deserialize_message

    try:
        message = deserialize_message(payload, PointCloud2)
    except (RuntimeError, ValueError, MemoryError):
        raise BrokenRecording(_WHERE, payload[:16].hex(), "is no PointCloud2") from None
    return displacement_cloud(message)


def displacement_cloud(message: Any) -> DisplacementCloud:
    """The measurement that a PointCloud2 holds.

    Raises:
        BrokenRecording: it has other fields, or another size than it says.
    """
    names = tuple(field.name for field in message.fields)
    if names != FIELDS or message.width != 5 or message.point_step != 4 * len(FIELDS):
        raise BrokenRecording(
            f"{_WHERE}.fields", ", ".join(names), f"must be {', '.join(FIELDS)}, five points a row"
        )
    try:
        points = np.frombuffer(message.data, "<f4").reshape(message.height, 5, len(FIELDS))
    except ValueError:
        limit = f"must hold {message.height} rows of five points"
        raise BrokenRecording(f"{_WHERE}.data", len(message.data), limit) from None
    rows = points[:, 0, FIELDS.index("package")]
    if not (np.isfinite(rows).all() and (rows >= 0.0).all()):
        raise BrokenRecording(f"{_WHERE}.package", rows.tolist(), "must be rows of a pose frame")
    right, sigma = FIELDS.index("right"), FIELDS.index("sigma_right")
    return DisplacementCloud(
        to_ns(message.header.stamp),
        rows.astype(np.intp),
        points[:, :, right : right + 2].astype(np.float64),
        points[:, :, sigma : sigma + 2].astype(np.float64),
    )
