"""Changes to a clip of which is known what they do to its verdict: the same change to all of its frames."""

import cv2
import numpy as np

from classifier.frames import Pixels
from classifier.load_motion import ALONG, CHANNELS, DISPLACED, packed_displacement, unpacked_displacement
from classifier.training_config import TrainingConfig


def augmented(frames: Pixels, rng: np.random.Generator, training: TrainingConfig) -> Pixels:
    """A clip as another camera might have seen it.

    Each of four changes comes with the probability ``training.augmentation``: another size, other colours, mirrored
    left to right, turned. What comes in from beyond the border repeats it. Displacement is turned and mirrored with the
    picture; another size leaves it as it is, since it is in metres and heights of the load.

    Args:
        frames: as they are stored, shape [time, size, size, depth]; not changed.
        rng: says what changes, and by how much; it draws as often whatever happens.
        training: how much at most.

    Returns:
        Frames of the same shape.
    """
    wanted = rng.random(4) < training.augmentation
    scale = 1.0 + rng.uniform(-training.resize, training.resize) * wanted[0]
    colour = rng.uniform(-training.jitter, training.jitter, size=3) * wanted[1]
    mirrored = bool(wanted[2] and training.flip)
    angle = rng.uniform(-training.rotation_deg, training.rotation_deg) * wanted[3]
    if scale != 1.0 or mirrored or angle:
        frames = _moved(frames, float(scale), float(angle), mirrored=mirrored)
    if not colour.any():
        return frames
    if frames.shape[3] != CHANNELS:
        return _recoloured(frames, *colour)
    # Light changes what is seen and not what has moved.
    return np.concatenate((_recoloured(frames[..., :1], *colour), frames[..., 1:]), axis=3)


def drawn_stretch(rng: np.random.Generator, training: TrainingConfig) -> float:
    """By which factor a clip's displacement is to be multiplied: 1 where it is not; drawn as often whatever happens."""
    wanted, exponent = rng.random() < training.augmentation, rng.uniform(-training.stretch, training.stretch)
    return float(np.exp(exponent)) if wanted and training.stretch else 1.0


def stretched(frames: Pixels, factor: float) -> Pixels:
    """A clip of displacements in which everything has moved that many times as far; the sled's travel stays.

    Args:
        frames: as they are stored, shape [time, size, size, CHANNELS]; not changed.
        factor: of all displacements.
    """
    if factor == 1.0:
        return frames
    moved = frames.copy()
    moved[..., DISPLACED] = packed_displacement(
        unpacked_displacement(frames[..., DISPLACED]) * np.float32(factor)
    )
    return moved


def _moved(frames: Pixels, scale: float, angle_deg: float, *, mirrored: bool) -> Pixels:
    """Frames turned and sized about their middle."""
    time, height, width, depth = frames.shape
    middle = (0.5 * (width - 1.0), 0.5 * (height - 1.0))
    matrix = cv2.getRotationMatrix2D(middle, angle_deg, scale)
    if mirrored:
        matrix[:, 2] += matrix[:, 0] * (width - 1.0)
        matrix[:, 0] = -matrix[:, 0]
    moved = np.empty_like(frames)
    for number in range(time):
        seen = cv2.warpAffine(
            frames[number], matrix, (width, height), flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
        )
        moved[number] = seen.reshape(height, width, depth)
    if depth == CHANNELS:
        turned = (matrix[:, :2].T / scale).astype(np.float32)
        for first in range(DISPLACED.start, DISPLACED.stop, 2):
            pair = slice(first, first + 2)
            moved[..., pair] = packed_displacement(unpacked_displacement(moved[..., pair]) @ turned)
        if mirrored:
            # The byte of no length is 128, and 0 is none of a length.
            moved[..., ALONG] = 255 - moved[..., ALONG] + 1
    return moved


def _recoloured(frames: Pixels, brightness: float, contrast: float, saturation: float) -> Pixels:
    """Frames brighter, richer in contrast about the first one's mean, and in colour more saturated, by these shares."""
    mean = float(frames[0].mean())
    levels = np.arange(256.0)
    levels = (levels - mean) * (1.0 + contrast) + mean * (1.0 + brightness)
    toned = cv2.LUT(frames.reshape(-1, 1), np.clip(np.round(levels), 0, 255).astype(np.uint8))
    recoloured = np.asarray(toned, dtype=np.uint8).reshape(frames.shape)
    if frames.shape[3] == 1 or not saturation:
        return recoloured
    # Out of grey by as much as the colours are to be stronger; the weights are those of grey in Rec. 601.
    grey = np.array([0.299, 0.587, 0.114])
    matrix = (1.0 + saturation) * np.eye(3) - saturation * grey
    flat = recoloured.reshape(1, -1, 3)
    return np.asarray(cv2.transform(flat, matrix), dtype=np.uint8).reshape(frames.shape)
