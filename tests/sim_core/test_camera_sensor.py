"""Lens and sensor: noise as counted light has it, exposure in stops, and parts that cover what is busy."""

import numpy as np
import pytest

from sim_core.camera.sensor import Lens, Sensor, busy_parts
from sim_core.camera.view import CameraView


def _even(level: int) -> np.ndarray:
    return np.full((300, 400, 3), level, np.uint8)


@pytest.mark.parametrize("level", [32, 64, 128, 200])
def test_noise_grows_with_the_root_of_the_level(level: int):
    sensor = Sensor(width=400, exposure_ev=0.0, noise=3.0, seed=1)
    seen = sensor.expose(_even(level), 0).astype(float)
    # 360 000 samples tell a deviation to 1/850 of itself; the rounding to whole levels adds 1/12.
    assert seen.std() == pytest.approx(np.sqrt(9.0 * level / 128.0 + 1.0 / 12.0), rel=0.02)
    assert seen.mean() == pytest.approx(level, abs=0.1)


def test_noise_depends_on_seed_and_number_alone():
    picture = np.random.default_rng(0).integers(0, 256, (300, 400, 3)).astype(np.uint8)
    sensor, other = (Sensor(width=400, exposure_ev=0.0, noise=2.0, seed=seed) for seed in (4, 5))
    first = sensor.expose(picture, 7)
    assert (sensor.expose(picture, 8) != first).mean() > 0.3
    assert (other.expose(picture, 7) != first).mean() > 0.3
    assert np.array_equal(Sensor(width=400, exposure_ev=0.0, noise=2.0, seed=4).expose(picture, 7), first)
    assert np.array_equal(sensor.expose(picture, 7), first)


def test_a_stop_doubles_the_light():
    """Levels are the root of light: a stop is √2."""
    brighter = Sensor(width=400, exposure_ev=1.0, noise=0.0, seed=0).expose(_even(100), 0)
    assert np.unique(brighter).tolist() == [141]
    assert Sensor(width=400, exposure_ev=5.0, noise=0.0, seed=0).expose(_even(100), 0).max() == 255


def test_a_lens_without_distortion_leaves_the_picture_as_it_is():
    matrix = np.array([[300.0, 0.0, 99.5], [0.0, 300.0, 59.5], [0.0, 0.0, 1.0]])
    view = CameraView(200, 120, matrix, np.zeros(5), np.eye(3), np.zeros(3))
    lens = Lens(view, oversampling=2)
    whole = busy_parts(np.array([[0.0, 0.0, 200.0, 120.0]]), width=200, height=120, largest=(400, 400))[0]
    seen = lens.seen(whole)
    # A ramp by twice the place on the picture, drawn from the bottom up as OpenGL does.
    across = (seen.left + np.arange(seen.width))[None, :] / 2.0 + 99.5
    down = (seen.top + np.arange(seen.height))[::-1, None] / 2.0 + 59.5
    fine = np.dstack(np.broadcast_arrays(across, 2.0 * down, 0.0, 0.0)).clip(0, 255).astype(np.float32)
    bent = lens.bend(fine, whole, seen)
    rows, columns = np.mgrid[2:118, 2:198]
    np.testing.assert_allclose(bent[2:118, 2:198, 0], columns, atol=0.02)
    np.testing.assert_allclose(bent[2:118, 2:198, 1], 2.0 * rows, atol=0.04)


def test_parts_cover_the_boxes_once_and_little_else():
    rng = np.random.default_rng(2)
    for _ in range(100):
        corners = rng.uniform(-100.0, 2000.0, (int(rng.integers(1, 5)), 2))
        boxes = np.hstack((corners, corners + rng.uniform(5.0, 600.0, corners.shape)))
        drawn = np.zeros((1080, 1920), int)
        for part in busy_parts(boxes, width=1920, height=1080, largest=(500, 300)):
            assert part.width <= 500
            assert part.height <= 300
            drawn[part.rows, part.columns] += 1
        assert drawn.max() <= 1
        for left, top, right, bottom in boxes.clip(0, [1920, 1080] * 2).astype(int):
            assert drawn[top:bottom, left:right].all()


def test_what_may_be_anywhere_is_drawn_everywhere():
    parts = busy_parts(np.array([[np.nan, 0.0, 1.0, 1.0]]), width=640, height=360, largest=(640, 360))
    assert sum(part.width * part.height for part in parts) == 640 * 360
