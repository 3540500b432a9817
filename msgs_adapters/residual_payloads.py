"""Measured less simulated displacement as the bytes of PointCloud2, a package a row.

The points are those of ``vision_payloads``, where the simulation has them; a point holds ``FIELDS``: where it is, frame
``sled`` [m]; by how much more the measured one went along the picture's right and up than the simulated one [m], with
the measurement's standard uncertainty of each [m]; and the package's row in a pose frame. What was not seen is NaN.
"""

from functools import cache
from typing import Any

import numpy as np
from sensor_msgs.msg import PointCloud2, PointField
from std_msgs.msg import Header

from msgs_adapters.cdr import serialize
from msgs_adapters.stamps import to_time_msg
from msgs_adapters.topics import SLED_FRAME
from sim_core.residual import Difference

FIELDS = ("x", "y", "z", "right", "up", "sigma_right", "sigma_up", "package")


def residual_payload(stamp_ns: int, difference: Difference) -> bytes:
    """CDR bytes of one comparison along two axes, at the measurement's stamp [ns]."""
    packages, points = difference.measured.shape[:2]
    rows = np.empty((packages, points, len(FIELDS)), "<f4")
    rows[:, :, :3] = difference.spots
    rows[:, :, 3:5], rows[:, :, 5:7] = difference.difference, difference.sigma
    rows[:, :, 7] = difference.rows[:, np.newaxis]
    message = PointCloud2(
        header=Header(stamp=to_time_msg(stamp_ns), frame_id=SLED_FRAME),
        height=packages,
        width=points,
        fields=_fields(),
        is_bigendian=False,
        point_step=4 * len(FIELDS),
        row_step=4 * points * len(FIELDS),
        is_dense=not np.isnan(rows).any(),
    )
    return serialize(message, rows={"data": np.frombuffer(rows.tobytes(), np.uint8)})


@cache
def _fields() -> list[Any]:
    return [
        PointField(name=name, offset=4 * number, datatype=PointField.FLOAT32, count=1)
        for number, name in enumerate(FIELDS)
    ]
