"""A changed clip of motion is what another camera would have seen: displacement goes with the picture."""

import numpy as np
import pytest

from classifier.augmentation import augmented
from classifier.load_motion import CHANNELS, packed_displacement, unpacked_displacement
from classifier.training_config import TrainingConfig

SIZE = 64
ALWAYS = {"augmentation": 1.0, "resize": 0.0, "rotation_deg": 0.0, "jitter": 0.0, "flip": False}


def changed(frames: np.ndarray, seed: int, **how: object) -> np.ndarray:
    training = TrainingConfig.model_validate({**ALWAYS, **how})
    return augmented(frames, np.random.default_rng(seed), training)


@pytest.fixture
def noisy() -> np.ndarray:
    """Any frames: displacement is bytes from 1."""
    return np.random.default_rng(4).integers(1, 256, (3, SIZE, SIZE, CHANNELS), dtype=np.uint8)


def pointing(direction_deg: float, length: float) -> np.ndarray:
    """A bright spot on dark ground; displacement is the same everywhere, from the frame's middle towards the spot."""
    along, down = np.cos(np.deg2rad(direction_deg)), np.sin(np.deg2rad(direction_deg))
    frames = np.zeros((2, SIZE, SIZE, CHANNELS), np.uint8)
    rows, columns = np.mgrid[:SIZE, :SIZE] - 0.5 * (SIZE - 1.0)
    spot = np.exp(-((columns - 16.0 * along) ** 2 + (rows - 16.0 * down) ** 2) / (2.0 * 2.5**2))
    frames[..., 0] = np.round(255.0 * spot)
    frames[..., 1:5] = packed_displacement(length * np.float32([along, down, along, down]))
    return frames


def test_mirrored_displacement_along_changes_its_sign_and_down_does_not(noisy):
    mirrored = changed(noisy, 1, flip=True)
    turned_round = noisy[:, :, ::-1].copy()
    # Byte 128 is none, so the same length the other way is 256 less the byte.
    along = [1, 3, 5, 6]
    turned_round[..., along] = (256 - turned_round[..., along].astype(int)).astype(np.uint8)
    assert (mirrored == turned_round).all()


@pytest.mark.parametrize("flip", [False, True])
@pytest.mark.parametrize("direction_deg", [0.0, 65.0, 160.0, -100.0])
def test_displacement_turns_with_the_picture_and_keeps_its_length(direction_deg, flip):
    length = 0.25
    given = pointing(direction_deg, length)
    rows, columns = np.mgrid[:SIZE, :SIZE] - 0.5 * (SIZE - 1.0)
    inner = slice(16, 48)
    for seed in range(4):
        turned = changed(given, seed, flip=flip, rotation_deg=20.0, resize=0.1)
        weight = turned[0, ..., 0].astype(float)
        to_spot = complex((weight * columns).sum(), (weight * rows).sum()) / weight.sum()
        for pair in (slice(1, 3), slice(3, 5)):
            moved = unpacked_displacement(turned[:, inner, inner, pair]) @ np.array([1.0, 1.0j])
            # Bytes are packed twice: each component is off by two halves of a step, 2·√d/127 at most.
            assert np.abs(np.abs(moved) - length).max() < 2.0 * np.sqrt(2.0 * length) / 127.0
            assert np.abs(np.angle(moved / to_spot)).max() < 2.0 * np.sqrt(2.0 * length) / 127.0 / length
        assert abs(to_spot) == pytest.approx(16.0, rel=0.11)
        assert flip or abs(np.angle(to_spot * np.exp(-1.0j * np.deg2rad(direction_deg)))) < np.deg2rad(20.5)


def test_a_load_that_stands_still_does_so_for_any_camera(noisy):
    noisy[..., 1:5] = 128
    for seed in range(8):
        assert (changed(noisy, seed, flip=True, rotation_deg=20.0, resize=0.1)[..., 1:5] == 128).all()


def test_light_changes_what_is_seen_and_not_what_has_moved(noisy):
    lit = changed(noisy, 2, jitter=0.3)
    assert (lit[..., 1:] == noisy[..., 1:]).all() and not (lit[..., 0] == noisy[..., 0]).all()
    # The first picture's grey comes in every frame, and stays the same in all of them.
    still = np.repeat(noisy[:1], 3, axis=0)
    lit = changed(still, 3, jitter=0.3)
    assert (lit[0] == lit[1]).all() and (lit[0] == lit[2]).all()
