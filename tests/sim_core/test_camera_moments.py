"""The camera's pictures fall where they should, and there are as many as the scene says."""

import pytest

from config.scene_file import find_scene, overridden, read_scene
from sim_core.camera.moments import PictureMoments
from sim_core.camera.taker import ShotTaker
from sim_core.run import run_test
from sim_core.sled import stop_sample

SCENE = "pally"


def _scene(camera: str, *more: str):
    return overridden(read_scene(find_scene(SCENE)), [f"camera={camera}", *more])


def test_a_rate_takes_every_so_many_frames():
    scene = _scene('{"rate_hz": 20}')
    moments = PictureMoments(scene)
    every = scene.sampling.poses_hz // 20
    assert [moments.number(k) for k in range(2 * every + 1) if moments.number(k) is not None] == [0, 1, 2]
    assert moments.count(1) == 1 and moments.count(every) == 1 and moments.count(every + 1) == 2
    assert moments.rate_hz == 20.0


@pytest.mark.parametrize("wanted", [2, 7, 64])
@pytest.mark.parametrize("level_g", [0.3, 0.8])
def test_a_number_of_pictures_is_spread_over_the_whole_test(wanted, level_g):
    scene = _scene(f'{{"pictures": {wanted}}}', f"sled.level_g={level_g}")
    taker = ShotTaker(scene)
    run_test(scene, observers=[taker])
    stamps = [shot.stamp_ns for shot in taker.shots]
    assert [shot.index for shot in taker.shots] == list(range(wanted))
    stop_s = stop_sample(scene) / scene.sampling.samples_hz
    # No picture is farther from the even spread than half a pose frame, and the end one.
    frame_s = 1.0 / scene.sampling.poses_hz
    for k, stamp in enumerate(stamps):
        even_s = (stop_s + 0.25) * k / (wanted - 1)
        assert abs((stamp - stamps[0]) * 1.0e-9 - even_s) <= 1.5 * frame_s


def test_pictures_show_the_film_of_their_own_frame():
    scene = overridden(read_scene(find_scene("eur_wrap_lldpe")), ['camera={"pictures": 65}'])
    moments = PictureMoments(scene)
    frames = [k for k in range(5000) if moments.number(k) is not None]
    assert all(frame % scene.sampling.frames_a_film_frame == 0 for frame in frames)
    assert [moments.number(frame) for frame in frames] == list(range(len(frames)))
    assert moments.count(frames[-1] + 1) == len(frames)
