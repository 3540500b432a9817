"""The film as a translucent mesh for viewers, coloured by strain; nothing is judged from it."""

from typing import Any

import numpy as np
from geometry_msgs.msg import Vector3
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker

from msgs_adapters.cdr import serialize
from msgs_adapters.colours import strain_colours
from msgs_adapters.stamps import to_time_msg
from msgs_adapters.topics import SLED_FRAME
from sim_core.frames import FilmFrame

OPACITY = 0.5


def film_mesh_payload(frame: FilmFrame, full: float) -> bytes:
    """CDR bytes of a ``visualization_msgs/Marker`` in frame ``sled``: a triangle for each element that is whole.

    Colours go by the largest strain in any direction, see :func:`~msgs_adapters.colours.strain_colours`. A film
    of which nothing is left deletes the marker: viewers refuse a list without triangles.

    Args:
        frame: the film.
        full: the strain that is red, see :func:`~msgs_adapters.colours.full_strain`.

    Raises:
        RefusedInput: the stamp is not a ROS time.
    """
    is_whole = frame.torn_s < 0.0
    points = frame.corners[is_whole].reshape(-1, 3).astype("<f8")
    colours = np.full((len(points), 4), OPACITY, "<f4")
    colours[:, :3] = strain_colours(frame.strains[is_whole, 0], full).repeat(3, axis=0)
    message: Any = Marker(
        header=Header(stamp=to_time_msg(frame.stamp_ns), frame_id=SLED_FRAME),
        ns="wrap",
        type=Marker.TRIANGLE_LIST,
        action=Marker.ADD if len(points) else Marker.DELETE,
        scale=Vector3(x=1.0, y=1.0, z=1.0),
        # Counts where a viewer takes no colours from the corners.
        color=ColorRGBA(r=1.0, g=1.0, b=1.0, a=OPACITY),
    )
    return serialize(message, rows={"points": points, "colors": colours})
