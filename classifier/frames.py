"""From decoded pictures to what the network sees, and which frame is the critical one, from pictures alone."""

from collections.abc import Iterable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from classifier.configuration import NetworkConfig
from classifier.load_crop import LoadCrop, change_of, crop_square
from classifier.sled_board import BoardFollower, find_board
from classifier.sled_motion import fitted_motion
from config.errors import RefusedInput
from sim_core.frames import Array

Pixels = NDArray[np.uint8]

IMAGENET_MEAN = np.array([0.485, 0.456, 0.406])
"""Of red, green and blue over the pictures that the public weights were trained on, of 1."""
IMAGENET_DEVIATION = np.array([0.229, 0.224, 0.225])
GREY_MEAN, GREY_DEVIATION = 0.449, 0.226
CHANGE_LEVELS = 48.0
"""Grey levels of change that count as one."""
WORST_RESIDUAL_PX = 1.0
"""A sled whose targets fit no straight travel better than this is not followed, in a picture of 480 columns."""


@dataclass(frozen=True, eq=False)
class PreparedClip:
    """A clip as it is stored and shown to the network.

    Attributes:
        frames: shape [time, size, size, 3] (red, green, blue) or [time, size, size, 1] (grey crop).
        numbers: of the pictures that they were made of, ascending from 0, shape [time].
        critical: which of the frames changed most.
        change: of every picture of the clip against the first one [grey levels], shape [picture_count].
        followed: whether the sled was followed; if not, frames are whole pictures.
        remark: how well it was followed, or why not.
    """

    frames: Pixels
    numbers: NDArray[np.intp]
    critical: int
    change: Array
    followed: bool
    remark: str


class ClipTaker:
    """Takes a clip's pictures in order; at any time gives the clip so far.

    Args:
        config: says what the frames are to be.
    """

    def __init__(self, config: NetworkConfig) -> None:
        self._config = config
        self._greys: list[Pixels] = []
        self._colours: list[Pixels] = []
        self._places: list[Array] = []
        self._follower: BoardFollower | None = None

    def take(self, picture: Pixels) -> None:
        """Takes the next picture: red, green and blue, shape [height, width, 3].

        Raises:
            RefusedInput: it is no such picture, or of another size than the first.
        """
        if picture.dtype != np.uint8 or picture.ndim != 3 or picture.shape[2] != 3 or min(picture.shape) < 3:
            raise RefusedInput("picture", picture.shape, "must be height by width by 3 bytes")
        grey = np.asarray(cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY), dtype=np.uint8)
        if not self._greys:
            self._board = find_board(grey)
            self._follower = BoardFollower(grey, self._board) if self._board is not None else None
        elif grey.shape != self._greys[0].shape:
            height, width = self._greys[0].shape
            raise RefusedInput("picture", picture.shape, f"must be {height} by {width} by 3, as the first")
        if self._follower is not None:
            self._places.append(self._follower.follow(grey))
        self._greys.append(grey)
        if self._config.mode == "rgb":
            self._colours.append(_resized(picture, self._config.size_px))

    def clip(self) -> PreparedClip:
        """The clip of the pictures so far.

        Raises:
            RefusedInput: there are less than two.
        """
        if len(self._greys) < 2:
            raise RefusedInput("pictures", len(self._greys), "must be at least 2")
        size = self._config.size_px
        crop, remark = self._crop(size)
        if crop is None:
            crops = np.stack([_resized(grey, size) for grey in self._greys])
        else:
            crops = np.stack([crop.cut(grey, number) for number, grey in enumerate(self._greys)])
        change = change_of(crops, None if crop is None else crop.load)
        peak = int(change.argmax())
        numbers = chosen_numbers(len(crops), self._config.frames, peak)
        critical = int(np.searchsorted(numbers, peak))
        every = np.stack(self._colours) if self._colours else crops[..., None]
        return PreparedClip(every[numbers], numbers, critical, change, crop is not None, remark)

    def _crop(self, size: int) -> tuple[LoadCrop | None, str]:
        """What cuts the load out, and a word on it."""
        if self._board is None:
            return None, "whole pictures: no board with targets in the first one"
        height, width = self._greys[0].shape
        motion = fitted_motion(np.stack(self._places), (width, height))
        if motion is None:
            return None, "whole pictures: the sled's targets were lost"
        if motion.residual_px > WORST_RESIDUAL_PX * width / 480.0:
            return None, f"whole pictures: the targets do not move as one, {motion.residual_px:.1f} px apart"
        square = crop_square(self._greys, self._board, motion)
        return LoadCrop(square, motion, size), f"sled followed, targets within {motion.residual_px:.2f} px"


def prepared_clip(pictures: Iterable[Pixels], config: NetworkConfig) -> PreparedClip:
    """Prepares a whole clip.

    Args:
        pictures: red, green and blue, shape [height, width, 3] each.
        config: says what the frames are to be.

    Raises:
        RefusedInput: see ``ClipTaker``.
    """
    taker = ClipTaker(config)
    for picture in pictures:
        taker.take(picture)
    return taker.clip()


def chosen_numbers(count: int, wanted: int | None, critical: int) -> NDArray[np.intp]:
    """Which of a clip's pictures are looked at: spread evenly from first to last, with the critical one among them.

    Args:
        count: of all pictures.
        wanted: how many; None, or more than there are: all.
        critical: number of the picture that must be among them.
    """
    if wanted is None or wanted >= count:
        return np.arange(count)
    numbers = np.round(np.linspace(0, count - 1, wanted)).astype(np.intp)
    # The first stays what it is: every change is one against it.
    if critical:
        numbers[1 + np.abs(numbers[1:] - critical).argmin()] = critical
    return numbers


def network_input(frames: Pixels, config: NetworkConfig) -> NDArray[np.float32]:
    """Normalised frames, shape [time, channels, size, size].

    ``rgb``: red, green and blue as the public weights expect them. ``change``: the change alone (one channel), or
    grey, the first frame's grey and the change (three).

    Args:
        frames: of a ``PreparedClip``, or of a part of it that begins with its first frame.
        config: of the network.

    Raises:
        RefusedInput: the frames are of another kind or size.
    """
    depth = 3 if config.mode == "rgb" else 1
    if frames.ndim != 4 or frames.shape[1:] != (config.size_px, config.size_px, depth):
        raise RefusedInput(
            "frames", frames.shape, f"must be time by {config.size_px} by {config.size_px} by {depth}"
        )
    planes = frames.transpose(0, 3, 1, 2).astype(np.float32)
    if config.mode == "rgb":
        scale, shift = 1.0 / (255.0 * IMAGENET_DEVIATION), IMAGENET_MEAN / IMAGENET_DEVIATION
        return np.ascontiguousarray(
            planes * scale[:, None, None].astype(np.float32) - shift[:, None, None].astype(np.float32)
        )
    change = (planes - planes[:1]) / np.float32(CHANGE_LEVELS)
    if config.channels == 1:
        return change
    grey = (planes / np.float32(255.0) - np.float32(GREY_MEAN)) / np.float32(GREY_DEVIATION)
    return np.concatenate((grey, np.broadcast_to(grey[:1], grey.shape), change), axis=1)


def _resized(picture: Pixels, size: int) -> Pixels:
    """The whole picture as a square of another size."""
    return np.asarray(cv2.resize(picture, (size, size), interpolation=cv2.INTER_AREA), dtype=np.uint8)
