"""Every part of a drawn load is where the flow says it is, to millimetres; frames are packed alike in every run."""

import cv2
import numpy as np
import pytest

from classifier.configuration import preset
from classifier.frames import (
    CHANGE_LEVELS,
    GREY_DEVIATION,
    GREY_MEAN,
    ClipTaker,
    network_input,
    prepared_clip,
)
from classifier.load_motion import (
    ALONG as LENGTHS,
)
from classifier.load_motion import (
    CHANNELS,
    packed_displacement,
    unpacked_displacement,
)
from config.errors import RefusedInput
from tests.classifier.sled_clip import BEHIND_M, DISTANCE_M, LOAD_M, sled_clip

EVERY = preset("compact", frames=None)
# In a frame of 64 px the load fills rows 8 to 58 and columns 12 to 52; its halves, without their edges:
UPPER, LOWER, ALONG = slice(12, 30), slice(38, 56), slice(16, 48)
HEIGHTS, METRES = slice(1, 3), slice(3, 5)


@pytest.fixture(scope="module")
def clip():
    return sled_clip()


@pytest.fixture(scope="module")
def prepared(clip):
    return prepared_clip(clip.pictures, EVERY)


def _moved(clip, rows: slice, channels: slice = METRES):
    """Displacement of a part of the load along and down, shape [time, rows, columns, 2]."""
    return unpacked_displacement(clip.frames[:, rows, ALONG, channels])


def _bar_m(slip_m):
    """Of a mean: half a step of bytes is √d/127; flow is good to a tenth of the window's pixel of 9.4 mm.

    The targets stand 0.267 m apart, which counts for half, and 0.255 m, what is usual, for the other: 2.3 % too little, and
    as much again for what the rows say.
    """
    size = np.abs(slip_m)
    return np.sqrt(size) / 127.0 + 0.001 + 0.046 * size


@pytest.mark.parametrize("slip_m", [0.08, -0.08, 0.3])
def test_what_slides_is_measured_and_what_stands_is_not(slip_m):
    clip = sled_clip(slip_m=slip_m)
    prepared = prepared_clip(clip.pictures, EVERY)
    assert prepared.followed and prepared.frames.shape == (16, 64, 64, CHANNELS)
    # A square of the print is 50 mm wide: 0.3 m is six of them, come to in steps of one.
    along, down = np.moveaxis(_moved(prepared, UPPER).mean(axis=(1, 2)), -1, 0)
    assert (np.abs(along - clip.slip_m) < _bar_m(clip.slip_m)).all()
    assert np.abs(down).max() < 0.003
    assert np.abs(_moved(prepared, LOWER)).max() < 0.004
    # The same in heights of the load, whatever the targets' spacing is taken for; its outline is found to 2 px of 57.
    shares = _moved(prepared, UPPER, HEIGHTS)[..., 0].mean(axis=(1, 2))
    heights = clip.slip_m / LOAD_M[1]
    assert (np.abs(shares - heights) < _bar_m(heights)).all()


def test_nearly_every_point_of_what_slides_says_so(clip, prepared):
    off = np.abs(_moved(prepared, UPPER)[..., 0] - clip.slip_m[:, None, None])
    assert np.quantile(off, 0.95, axis=(1, 2)).max() < 0.01


def test_a_load_that_stands_deeper_does_not_slide_by_its_parallax():
    behind_m, travel_m = 0.35, 1.5
    deep = prepared_clip(sled_clip(behind_m=behind_m, count=24, slip_m=0.0).pictures, EVERY)
    assert deep.followed
    off, came = np.moveaxis(unpacked_displacement(deep.frames[:, 0, 0, LENGTHS]), -1, 0)
    # Metres are those of the board's plane, and up to 4.6 % too few, see above. A byte's step is √d/127.
    assert came[-1] == pytest.approx(0.1 * travel_m, rel=0.06)
    # A load usually stands 30 mm behind the board's plane, and is carried along as one that does.
    assert off[-1] == pytest.approx(-travel_m * (behind_m - BEHIND_M) / (DISTANCE_M + behind_m), rel=0.07)
    assert np.abs(_moved(deep, LOWER)).mean() < 0.004 < 0.1 * np.abs(off[-1])
    # What does slide is told beside it.
    clip = sled_clip(behind_m=behind_m, count=24, slip_m=0.08)
    slid = _moved(prepared_clip(clip.pictures, EVERY), UPPER)[..., 0].mean(axis=(1, 2))
    assert (np.abs(slid - clip.slip_m) < _bar_m(clip.slip_m) + 0.06 * clip.slip_m + 0.004).all()


def test_the_first_picture_stands_where_it_stood(prepared):
    assert (prepared.frames[0, ..., 1:5] == 128).all() and prepared.change[0] < 1.0e-3


def test_the_critical_frame_is_that_of_the_largest_slip(clip, prepared):
    assert prepared.critical == int(np.argmax(clip.slip_m))
    few = prepared_clip(clip.pictures, preset("compact", frames=5))
    assert few.numbers[few.critical] == prepared.critical and few.frames.shape == (5, 64, 64, CHANNELS)
    assert (few.frames == prepared.frames[few.numbers]).all()
    # Of the load's height, the part from 0.2 to 0.85 below its top counts; 0.5 is where 80 mm end.
    assert prepared.change.max() == pytest.approx(80.0 * 0.3 / 0.65, abs=3.0)


def test_a_picture_twice_as_large_says_the_same(clip, prepared):
    larger = [cv2.resize(one, None, fx=2.0, fy=2.0, interpolation=cv2.INTER_CUBIC) for one in clip.pictures]
    twice = prepared_clip(larger, EVERY)
    assert twice.followed and twice.critical == prepared.critical
    for rows in (UPPER, LOWER):
        one, other = (_moved(found, rows)[1:].mean(axis=(1, 2)) for found in (prepared, twice))
        assert np.abs(one - other).max() < 0.002


@pytest.mark.parametrize("kind", ["black", "noise"])
def test_without_a_board_the_pictures_middle_is_looked_at_and_it_is_said(kind):
    noise = np.random.default_rng(0)
    shape = (270, 480, 3)
    pictures = [
        np.zeros(shape, np.uint8) if kind == "black" else noise.integers(0, 256, shape, dtype=np.uint8)
        for _ in range(3)
    ]
    clip = prepared_clip(pictures, EVERY)
    assert not clip.followed and clip.remark.startswith("sled not followed: no board")
    assert clip.frames.shape == (3, 64, 64, CHANNELS)
    if kind == "black":
        assert (clip.frames[..., 1:7] == 128).all() and (clip.frames[..., 7] == 0).all()
        assert (clip.change == 0.0).all() and clip.critical == 0


def test_a_picture_in_which_nothing_is_seen_does_no_harm_to_those_behind_it(clip, prepared):
    pictures = [picture.copy() for picture in clip.pictures]
    pictures[7][:] = 0
    pictures[9][180:, 150:330] = 120
    covered = prepared_clip(pictures, EVERY)
    assert covered.followed
    others = [number for number in range(len(pictures)) if number not in (7, 9)]
    for rows in (UPPER, LOWER):
        one, other = (_moved(found, rows)[others].mean(axis=(1, 2)) for found in (prepared, covered))
        assert np.abs(one - other).max() < 0.001


def test_without_targets_a_clip_is_still_one(clip):
    pictures = [*clip.pictures[:4], *(np.zeros_like(one) for one in clip.pictures[4:])]
    lost = prepared_clip(pictures, EVERY)
    assert (
        not lost.followed
        and "targets were lost" in lost.remark
        and lost.frames.shape == (16, 64, 64, CHANNELS)
    )


def test_bytes_of_a_displacement_come_back_within_half_a_step():
    given = np.linspace(-1.0, 1.0, 4001, dtype=np.float32)
    off = np.abs(unpacked_displacement(packed_displacement(given)) - given)
    # The root is off by 1/254 at most, so d = r² by 2·r/254 + 1/254².
    assert (off <= np.sqrt(np.abs(given)) / 127.0 + 1.0 / 254.0**2 + 1.0e-6).all()
    for size_m, step_m in ((0.04, 0.003), (0.1, 0.005)):
        near = unpacked_displacement(packed_displacement(np.float32([size_m])) + np.arange(2, dtype=np.uint8))
        assert np.diff(near)[0] == pytest.approx(step_m, abs=0.0005)
    bytes_ = np.arange(1, 256, dtype=np.uint8)
    assert (packed_displacement(unpacked_displacement(bytes_)) == bytes_).all()
    assert packed_displacement(np.float32([0.0, -0.0, 7.0, -7.0])).tolist() == [128, 128, 255, 1]


def test_the_same_pictures_give_the_same_bytes_on_one_thread_and_on_many(clip, prepared):
    threads = cv2.getNumThreads()
    try:
        for count in (1, 3):
            cv2.setNumThreads(count)
            again = prepared_clip(clip.pictures, EVERY)
            assert again.frames.tobytes() == prepared.frames.tobytes()
            assert again.change.tobytes() == prepared.change.tobytes()
    finally:
        cv2.setNumThreads(threads)


def test_a_clip_that_is_asked_for_after_every_picture_ends_the_same(clip, prepared):
    taker = ClipTaker(EVERY)
    for number, picture in enumerate(clip.pictures):
        taker.take(picture)
        if number:
            grown = taker.clip()
            assert len(grown.frames) == number + 1
    assert grown.frames.tobytes() == prepared.frames.tobytes()
    assert grown.change.tobytes() == prepared.change.tobytes()
    assert (grown.critical, grown.followed, grown.remark) == (prepared.critical, True, prepared.remark)


def test_the_network_sees_print_displacement_and_what_is_left():
    frames = np.full((2, 64, 64, CHANNELS), 128, np.uint8)
    # 0.0625 of the height and 1/9 m have the roots 1/4 and 1/3: both count as one, to half a byte of 32.
    lengths = np.float32([0.0625, -0.0625, 1.0 / 9.0, -1.0 / 9.0, -1.0 / 9.0, 1.0 / 9.0])
    frames[1, ..., 1:7] = packed_displacement(lengths)
    frames[1, ..., 0], frames[1, ..., 7:] = 255, int(CHANGE_LEVELS)
    given = network_input(frames, EVERY)
    assert given.shape == (2, CHANNELS, 64, 64) and given.dtype == np.float32
    assert (given[0, 1:7] == 0.0).all()
    bright = (1.0 - GREY_MEAN) / GREY_DEVIATION
    told = [bright, 1.0, -1.0, 1.0, -1.0, -1.0, 1.0, 1.0, 1.0]
    assert given[1, :, 7, 7] == pytest.approx(told, abs=0.016)
    with pytest.raises(RefusedInput, match="64 by 64 by 9"):
        network_input(frames[..., :3], EVERY)


def test_what_falls_out_beside_the_load_is_seen_though_nothing_on_it_moves():
    clip = sled_clip(slip_m=0.0)
    plain = prepared_clip(clip.pictures, EVERY)
    late = [picture.copy() for picture in clip.pictures]
    # Something bright where only the hall was, on the floor behind the sled's way.
    late[-1][120:170, 330:350] = 250
    fallen = prepared_clip(late, EVERY)
    new = fallen.frames[-1, ..., 8].astype(int) - plain.frames[-1, ..., 8].astype(int)
    assert new.max() > 60 and (fallen.frames[:-1] == plain.frames[:-1]).all()
