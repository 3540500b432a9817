"""Measured displacement as the bytes of PointCloud2, a package a row.

A row's five points are the middle of the package's side that faces the camera and its corners, clockwise from the upper
left. A point holds ``FIELDS``: where it is, frame ``sled`` [m]; how far it went since the start along the picture's
right and up [m], with the standard uncertainty of each [m]; the package's row in a pose frame; and whether it was seen.
What was not seen is NaN.
"""

from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sensor_msgs.msg import PointCloud2, PointField
from std_msgs.msg import Header

from msgs_adapters.cdr import serialize
from msgs_adapters.stamps import to_time_msg
from msgs_adapters.topics import SLED_FRAME
from sim_core.camera.layout import Side
from sim_core.frames import Array

FIELDS = ("x", "y", "z", "right", "up", "sigma_right", "sigma_up", "package", "state")
STATES = ("tracked", "occluded", "blurred", "out of view", "lost")
"""What the field ``state`` counts."""


def displacement_payload(
    stamp_ns: int,
    *,
    side: Side,
    faces: Array,
    rows: NDArray[np.intp],
    displacement: Array,
    sigma: Array,
    states: tuple[str, ...],
) -> bytes:
    """CDR bytes of one picture's measurement.

    Args:
        stamp_ns: of the picture [ns].
        side: that the camera sees.
        faces: corners of the packages' sides as stacked, frame ``sled`` [m], shape [n, 4, 3].
        rows: of the packages in a pose frame, shape [n].
        displacement: of middle and corners along right and up [m], shape [n, 5, 2].
        sigma: standard uncertainty of each [m], shape [n, 5, 2].
        states: of each package, one of ``STATES``.
    """
    points = np.empty((len(rows), 5, len(FIELDS)), "<f4")
    spots = np.concatenate((faces.mean(axis=1, keepdims=True), faces), axis=1)
    up = np.array([0.0, 0.0, 1.0])
    points[:, :, :3] = spots + displacement[:, :, :1] * side.right + displacement[:, :, 1:] * up
    points[:, :, 3:5], points[:, :, 5:7] = displacement, sigma
    points[:, :, 7] = rows[:, np.newaxis]
    points[:, :, 8] = np.array([STATES.index(state) for state in states])[:, np.newaxis]
    message = PointCloud2(
        header=Header(stamp=to_time_msg(stamp_ns), frame_id=SLED_FRAME),
        height=len(rows),
        width=5,
        fields=_fields(),
        is_bigendian=False,
        point_step=4 * len(FIELDS),
        row_step=20 * len(FIELDS),
        is_dense=not np.isnan(points).any(),
    )
    return serialize(message, rows={"data": np.frombuffer(points.tobytes(), np.uint8)})


@cache
def _fields() -> list[Any]:
    return [
        PointField(name=name, offset=4 * number, datatype=PointField.FLOAT32, count=1)
        for number, name in enumerate(FIELDS)
    ]
