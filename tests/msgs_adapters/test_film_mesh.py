"""The film's mesh: triangles of what is whole, coloured by strain, as any ROS tool reads them."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from rclpy.serialization import deserialize_message
from rosbags.typesys import Stores, get_typestore
from visualization_msgs.msg import Marker

from config.scene import Scene
from config.scene_file import validate_scene
from msgs_adapters.cdr import serialize
from msgs_adapters.colours import full_strain
from msgs_adapters.film_mesh import film_mesh_payload
from msgs_adapters.publications import film_markers_publication, film_publication, film_topics
from msgs_adapters.stamps import to_ns
from msgs_adapters.topics import WRAP_MESH, WRAP_STRAIN
from sim_core.accuracy.cases import cartons_scene
from sim_core.frames import FilmFrame
from tests.msgs_adapters.films import film, films

TYPESTORE = get_typestore(Stores.ROS2_JAZZY)
FULL = 0.09


def scene(material: str | None, turns: float = 2.0) -> Scene:
    wrap = {"wrap": {"material": material, "turns": turns}} if material is not None else {}
    return validate_scene({**cartons_scene(2, columns=(1, 1)), **wrap})


def strained(strains: list[float]) -> FilmFrame:
    """Elements at different heights with these largest strains."""
    count = len(strains)
    frame = film(5 * 10**9, np.zeros((count, 21), np.float32))
    corners = np.arange(9 * count, dtype=np.float32).reshape(count, 3, 3)
    rows = np.tile(np.float32(strains), (3, 1)).T
    return replace(frame, corners=corners, strains=rows, torn_s=np.full(count, -1.0, np.float32))


@settings(max_examples=60, deadline=None)
@given(films)
def test_mesh_bytes_are_those_of_the_message_and_of_rosbags(frame: FilmFrame) -> None:
    payload = film_mesh_payload(frame, FULL)
    message: Any = deserialize_message(payload, Marker)
    assert serialize(message) == payload
    theirs = TYPESTORE.serialize_cdr(
        TYPESTORE.deserialize_cdr(payload, "visualization_msgs/msg/Marker"), "visualization_msgs/msg/Marker"
    )
    assert payload == bytes(theirs).ljust(len(payload), b"\0")
    assert len(message.points) == len(message.colors) == 3 * int((frame.torn_s < 0.0).sum())


def test_colours_go_from_blue_over_green_and_yellow_to_red() -> None:
    message: Any = deserialize_message(
        film_mesh_payload(strained([-0.01, 0.0, FULL / 3, 2 * FULL / 3, FULL, 1.0]), FULL), Marker
    )
    assert (message.header.frame_id, to_ns(message.header.stamp)) == ("sled", 5 * 10**9)
    assert (message.ns, message.type, message.action) == ("wrap", Marker.TRIANGLE_LIST, Marker.ADD)
    assert message.pose.orientation.w == message.scale.x == message.scale.y == message.scale.z == 1.0
    shown = [(c.r, c.g, c.b) for c in message.colors]
    assert all(0.0 < colour.a < 1.0 for colour in (*message.colors, message.color))
    assert all(len(set(shown[i : i + 3])) == 1 for i in range(0, len(shown), 3))
    below, blue, green, yellow, red, above = shown[::3]
    assert (below, above) == (blue, red)
    assert blue.index(max(blue)) == 2 and green.index(max(green)) == 1 and red.index(max(red)) == 0
    assert yellow[0] > 0.8 and yellow[1] > 0.8 and yellow[2] < 0.2
    assert red[1] < 0.2
    between: Any = deserialize_message(film_mesh_payload(strained([FULL / 6]), FULL), Marker).colors[0]
    assert between.g == pytest.approx((blue[1] + green[1]) / 2.0)


def test_torn_elements_are_missing() -> None:
    frame = replace(strained([0.01, 0.02, 0.03]), torn_s=np.float32([-1.0, 0.5, -1.0]))
    message: Any = deserialize_message(film_mesh_payload(frame, FULL), Marker)
    np.testing.assert_array_equal(
        [[p.x, p.y, p.z] for p in message.points], frame.corners[[0, 2]].reshape(-1, 3)
    )
    nothing: Any = deserialize_message(
        film_mesh_payload(replace(frame, torn_s=np.float32([0.0, 0.5, 0.5])), FULL), Marker
    )
    assert (nothing.action, len(nothing.points)) == (Marker.DELETE, 0)


def test_red_is_where_the_film_is_drawn_or_else_where_it_breaks() -> None:
    stretch, kraft = scene("stretch_film_20").film, scene("kraft_80").film
    assert stretch is not None and kraft is not None
    law = stretch.around
    assert full_strain(law) == law.yield_force_npm / law.stiffness_npm < law.break_strain
    assert full_strain(kraft.around) == kraft.around.break_strain


def test_only_a_wrapped_scene_has_the_topics() -> None:
    assert film_topics(scene("stretch_film_20")) == (WRAP_STRAIN, WRAP_MESH)
    assert film_topics(scene(None)) == film_topics(scene("stretch_film_20", turns=0.0)) == ()
    frame = strained([0.01])
    assert film_publication(frame)[:2] == (WRAP_STRAIN, frame.stamp_ns)
    assert film_markers_publication(frame, scene("kraft_80"))[:2] == (WRAP_MESH, frame.stamp_ns)
