"""The crop rides on the sled and leaves the load's own movement in the picture; frames come out as the network expects."""

import cv2
import numpy as np
import pytest

from classifier.configuration import preset
from classifier.frames import (
    IMAGENET_DEVIATION,
    IMAGENET_MEAN,
    ClipTaker,
    chosen_numbers,
    network_input,
    prepared_clip,
)
from config.errors import RefusedInput
from sim_core.camera.source import Picture
from sim_core.camera.taker import PictureTaker
from sim_core.run import run_test
from tests.classifier.sled_clip import sled_clip
from tests.sim_core.vision_scenes import stack_scene

CROP = {"mode": "change", "size_px": 112, "channels": 3}
EVERY = preset("compact", **CROP, frames=None)


@pytest.fixture(scope="module")
def clip():
    return sled_clip()


@pytest.fixture(scope="module")
def prepared(clip):
    return prepared_clip(clip.pictures, EVERY)


def _shifts(frames, rows: slice, columns: slice):
    """How far a part of each crop stands from where it was in the first [px], shape [time, 2]."""
    parts = frames[:, rows, columns, 0].astype(np.float32)
    window = cv2.createHanningWindow(parts.shape[2:0:-1], cv2.CV_32F)
    found = np.array([cv2.phaseCorrelate(parts[0], part, window)[0] for part in parts])
    # Of a picture with itself it is not zero: half a pixel where the size is even.
    return found - found[0]


def test_the_load_stays_in_the_crop_while_the_sled_moves_on(clip, prepared):
    assert prepared.followed and "followed" in prepared.remark
    # The sled goes by 200 px of the picture: 90 px of the crop.
    shifts = _shifts(prepared.frames, slice(66, 86), slice(30, 82))
    assert np.abs(shifts).max() < 0.3


def test_what_slides_on_the_load_slides_in_the_crop_by_as_much(clip, prepared):
    # The board and its margins fill the crop: 1.6 m between the outermost targets, and 0.45 spacings beside each.
    pixels_a_m = 112 / (1.6 * (1.0 + 0.9 / 6.0))
    shifts = _shifts(prepared.frames, slice(34, 56), slice(34, 78))
    assert np.abs(shifts[:, 0] - clip.slip_m * pixels_a_m).max() < 0.5
    assert np.abs(shifts[:, 1]).max() < 0.3


def test_the_critical_frame_is_that_of_the_largest_slip(clip, prepared):
    assert prepared.critical == int(np.argmax(clip.slip_m))
    few = prepared_clip(clip.pictures, preset("compact", **CROP, frames=5))
    assert few.numbers[few.critical] == int(np.argmax(clip.slip_m))
    assert len(few.numbers) == 5 and few.numbers[0] == 0 and (np.diff(few.numbers) > 0).all()
    colour = prepared_clip(clip.pictures, preset("paper", size_px=64))
    assert colour.critical == prepared.critical and colour.frames.shape[1:] == (64, 64, 3)


def test_the_same_pictures_give_the_same_bytes_and_a_clip_can_grow(clip, prepared):
    taker = ClipTaker(EVERY)
    for picture in clip.pictures[:10]:
        taker.take(picture)
    assert taker.clip().followed
    for picture in clip.pictures[10:]:
        taker.take(picture)
    again = taker.clip()
    assert again.frames.tobytes() == prepared.frames.tobytes() and again.critical == prepared.critical


def test_targets_covered_for_a_while_do_no_harm(clip, prepared):
    pictures = [picture.copy() for picture in clip.pictures]
    pictures[7][:] = 0
    pictures[9][180:, 150:330] = 120
    covered = prepared_clip(pictures, EVERY)
    assert covered.followed
    others = [n for n in range(len(pictures)) if n not in (7, 9)]
    parts = np.concatenate((prepared.frames[:1], covered.frames[others]))
    assert np.abs(_shifts(parts, slice(66, 86), slice(30, 82))).max() < 0.3


@pytest.mark.parametrize("kind", ["black", "noise"])
def test_without_a_board_whole_pictures_are_used_and_it_is_said(kind):
    noise = np.random.default_rng(0)
    pictures = [
        np.zeros((270, 480, 3), np.uint8)
        if kind == "black"
        else noise.integers(0, 256, (270, 480, 3)).astype(np.uint8)
        for _ in range(3)
    ]
    clip = prepared_clip(pictures, EVERY)
    assert not clip.followed and clip.remark.startswith("sled not followed: no board")
    whole = cv2.resize(
        cv2.cvtColor(pictures[1], cv2.COLOR_RGB2GRAY), (112, 112), interpolation=cv2.INTER_AREA
    )
    assert (clip.frames[1, ..., 0] == whole).all()


def test_a_load_that_does_not_move_stays_put_before_the_benchs_own_camera():
    scene = stack_scene(level_g=0.2, friction=0.8, width_px=480, height_px=270, pictures=12)
    pictures: list[Picture] = []
    taker = PictureTaker(scene, [pictures.append])
    try:
        run_test(scene, observers=[taker])
    finally:
        taker.close()
    clip = prepared_clip([picture.pixels for picture in pictures], EVERY)
    assert clip.followed
    assert np.abs(_shifts(clip.frames, slice(46, 86), slice(34, 78))).max() < 0.3


def test_normalisation_is_what_the_public_weights_expect():
    config = preset("paper", size_px=32)
    frames = np.random.default_rng(1).integers(0, 256, (2, 32, 32, 3)).astype(np.uint8)
    expected = ((frames / 255.0 - IMAGENET_MEAN) / IMAGENET_DEVIATION).transpose(0, 3, 1, 2)
    given = network_input(frames, config)
    assert given.dtype == np.float32 and np.abs(given - expected).max() < 1.0e-5


def test_change_is_against_the_first_frame():
    frames = np.random.default_rng(1).integers(0, 256, (3, 112, 112, 1)).astype(np.uint8)
    given = network_input(frames, EVERY)
    assert given.shape == (3, 3, 112, 112)
    assert (given[0, 2] == 0.0).all() and (given[:, 1] == given[:1, 0]).all()
    assert given[2, 2] == pytest.approx((frames[2, ..., 0].astype(float) - frames[0, ..., 0]) / 48.0)
    alone = network_input(frames, preset("compact", **{**CROP, "channels": 1}))
    assert alone.shape == (3, 1, 112, 112) and (alone[:, 0] == given[:, 2]).all()


def test_numbers_are_spread_and_hold_the_critical_one():
    for count, wanted, critical in [
        (70, 24, 35),
        (70, 24, 0),
        (70, 24, 69),
        (64, 2, 17),
        (5, 24, 3),
        (9, 9, 1),
    ]:
        numbers = chosen_numbers(count, wanted, critical)
        assert len(numbers) == min(count, wanted) and numbers[0] == 0 and critical in numbers
        assert (np.diff(numbers) > 0).all() and numbers[-1] < count


def test_bad_pictures_are_refused_in_one_line(clip):
    taker = ClipTaker(EVERY)
    with pytest.raises(RefusedInput, match="at least 2"):
        taker.clip()
    taker.take(clip.pictures[0])
    for bad in (clip.pictures[0][:100], clip.pictures[0][..., 0], clip.pictures[0].astype(float)):
        with pytest.raises(RefusedInput, match="picture = "):
            taker.take(bad)
    with pytest.raises(RefusedInput, match="112 by 112 by 1"):
        network_input(np.zeros((2, 112, 112, 3), np.uint8), EVERY)
