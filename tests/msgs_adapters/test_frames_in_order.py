"""Whatever order two topics arrive in, poses and film come out as one process has them."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from config.errors import BrokenRecording
from config.scene import Scene
from config.scene_file import validate_scene
from msgs_adapters.film_payloads import film_cloud_payload
from msgs_adapters.frames_in_order import FramesInOrder
from msgs_adapters.pose_payloads import pose_array_payload
from sim_core.accuracy.cases import cartons_scene
from sim_core.frames import PoseFrame
from tests.msgs_adapters.films import film

COUNT, EVERY = 10, 4


def scene(*, wrapped: bool = True) -> Scene:
    wrap = {"wrap": {"material": "stretch_film_20", "turns": 2}} if wrapped else {}
    sampling = {"poses_hz": 240, "film_hz": 240 // EVERY}
    return validate_scene({**cartons_scene(1, columns=(1, 1)), "sampling": sampling, **wrap})


def poses(index: int) -> bytes:
    return pose_array_payload(PoseFrame(index, 10**9 + index, np.zeros((2, 3)), np.zeros((2, 4))))


def film_at(index: int) -> bytes:
    return film_cloud_payload(film(10**9 + index, np.full((1, 21), index, np.float32)))


@settings(max_examples=60, deadline=None)
@given(st.permutations([True] * 3 + [False] * COUNT))
def test_any_order_of_arrival_gives_the_order_of_a_run(arrivals: list[bool]) -> None:
    frames, given_out = FramesInOrder(scene()), []
    films, positions = iter(range(0, COUNT, EVERY)), iter(range(COUNT))
    for is_film in arrivals:
        if is_film:
            frames.add_film(film_at(next(films)))
        else:
            frames.add_poses(poses(next(positions)))
        given_out += frames.ready()
    assert [frame.index for frame, _ in given_out] == list(range(COUNT))
    assert [(frame.index, film.index, film.peaks[0]) for frame, film in given_out if film is not None] == [
        (index, index, float(index)) for index in range(0, COUNT, EVERY)
    ]


def test_poses_wait_for_their_film_and_no_longer() -> None:
    frames = FramesInOrder(scene())
    for index in range(COUNT):
        frames.add_poses(poses(index))
    assert list(frames.ready()) == []
    frames.add_film(film_at(0))
    assert [frame.index for frame, _ in frames.ready()] == list(range(EVERY))


def test_a_film_frame_that_got_lost_is_noticed() -> None:
    frames = FramesInOrder(scene())
    for index in range(COUNT):
        frames.add_poses(poses(index))
    for index in (0, 2 * EVERY):
        frames.add_film(film_at(index))
    with pytest.raises(BrokenRecording, match=r"must be that of frame 4, 1000000004"):
        list(frames.ready())


def test_without_a_film_nothing_waits() -> None:
    frames = FramesInOrder(scene(wrapped=False))
    frames.add_poses(poses(0))
    assert [(frame.index, film) for frame, film in frames.ready()] == [(0, None)]
