"""From decoded pictures to what the network sees, and which frame is the critical one, from pictures alone."""

from collections.abc import Iterable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from classifier.configuration import Mode, NetworkConfig
from classifier.load_crop import LoadCrop, change_of, crop_square
from classifier.load_motion import (
    ALONG,
    CHANNELS,
    DISPLACED,
    LoadFollower,
    mean_displacement,
    packed_motion,
    parallax_rate,
)
from classifier.sled_board import BoardFollower, find_board
from classifier.sled_motion import SledMotion, fitted_motion
from config.errors import RefusedInput
from sim_core.frames import Array

Pixels = NDArray[np.uint8]

IMAGENET_MEAN = np.array([0.485, 0.456, 0.406])
"""Of red, green and blue over the pictures that the public weights were trained on, of 1."""
IMAGENET_DEVIATION = np.array([0.229, 0.224, 0.225])
GREY_MEAN, GREY_DEVIATION = 0.449, 0.226
CHANGE_LEVELS = 48.0
"""Grey levels of change that count as one."""
MOTION_SCALE = (4.0, 4.0, 3.0, 3.0, 3.0, 3.0)
"""Of the roots of displacements in heights and in metres, and of lengths in metres: 0.06 of the height, or 0.1 m, are
about one."""
DEPTH: dict[Mode, int] = {"rgb": 3, "change": 1, "motion": CHANNELS}
"""Bytes of a stored pixel."""
WORST_RESIDUAL_PX = 1.0
"""A sled whose targets fit no straight travel better than this is not followed, in a picture of 480 columns."""


@dataclass(frozen=True, eq=False)
class PreparedClip:
    """A clip as it is stored and shown to the network.

    Attributes:
        frames: shape [time, size, size, 3] (red, green, blue), [time, size, size, 1] (grey crop) or
            [time, size, size, CHANNELS] (see ``classifier.load_motion``).
        numbers: of the pictures that they were made of, ascending from 0, shape [time].
        critical: which of the frames changed most.
        change: of every picture of the clip against the first one, shape [picture_count]; where motion is looked at,
            the load's mean displacement [mm], else grey levels.
        followed: whether the sled was followed; if not, crops are whole pictures, and displacement is on the picture.
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
        self._load: LoadFollower | None = None

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
        if self._config.mode == "motion":
            if self._load is None:
                self._load = LoadFollower(grey, self._board)
            self._load.follow(grey, self._places[-1] if self._places else None)
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
        motion, remark = self._motion()
        if self._load is not None:
            return self._followed(self._load, motion, remark)
        crop = self._crop(motion, size) if motion is not None else None
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

    def _followed(self, load: LoadFollower, motion: SledMotion | None, remark: str) -> PreparedClip:
        """The clip as displacement on the sled."""
        size, count = self._config.size_px, len(self._greys)
        square = None
        if self._board is not None and motion is not None:
            square = crop_square(self._greys, self._board, motion)
        outline = load.outline(square.load if square is not None else None)
        moved = np.stack([load.displacement(number, motion) for number in range(count)])
        travel_m = load.travel_m(motion)
        parallax_m = parallax_rate(moved, travel_m, outline) * travel_m
        moved[..., 0] -= parallax_m[:, None, None].astype(np.float32)
        change = 1000.0 * np.array([mean_displacement(displacement, outline) for displacement in moved])
        peak = int(change.argmax())
        numbers = chosen_numbers(count, self._config.frames, peak)
        frames = [
            packed_motion(
                load.grey,
                moved[number],
                load.followed[number],
                outline,
                size,
                parallax_m=float(parallax_m[number]),
                travel_m=float(travel_m[number]),
            )
            for number in numbers
        ]
        critical = int(np.searchsorted(numbers, peak))
        return PreparedClip(np.stack(frames), numbers, critical, change, motion is not None, remark)

    def _motion(self) -> tuple[SledMotion | None, str]:
        """How the sled moves, and a word on it."""
        if self._board is None:
            return None, "sled not followed: no board with targets in the first one"
        height, width = self._greys[0].shape
        motion = fitted_motion(np.stack(self._places), (width, height))
        if motion is None:
            return None, "sled not followed: the sled's targets were lost"
        if motion.residual_px > WORST_RESIDUAL_PX * width / 480.0:
            return (
                None,
                f"sled not followed: the targets do not move as one, {motion.residual_px:.1f} px apart",
            )
        return motion, f"sled followed, targets within {motion.residual_px:.2f} px"

    def _crop(self, motion: SledMotion, size: int) -> LoadCrop:
        """What cuts the load out."""
        assert self._board is not None
        return LoadCrop(crop_square(self._greys, self._board, motion), motion, size)


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
    grey, the first frame's grey and the change (three). ``motion``: grey, displacement along and down in heights of the
    load and in metres, parallax, travel, what the flow does not explain, what is new.

    Args:
        frames: of a ``PreparedClip``, or of a part of it that begins with its first frame.
        config: of the network.

    Raises:
        RefusedInput: the frames are of another kind or size.
    """
    depth = DEPTH[config.mode]
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
    if config.mode == "motion":
        planes[:, 0] = (planes[:, 0] / np.float32(255.0) - np.float32(GREY_MEAN)) / np.float32(GREY_DEVIATION)
        roots = np.array(MOTION_SCALE, dtype=np.float32) / np.float32(127.0)
        lengths = slice(DISPLACED.start, ALONG.stop)
        planes[:, lengths] = (planes[:, lengths] - np.float32(128.0)) * roots[:, None, None]
        planes[:, ALONG.stop :] /= np.float32(CHANGE_LEVELS)
        return np.ascontiguousarray(planes)
    change = (planes - planes[:1]) / np.float32(CHANGE_LEVELS)
    if config.channels == 1:
        return change
    grey = (planes / np.float32(255.0) - np.float32(GREY_MEAN)) / np.float32(GREY_DEVIATION)
    return np.concatenate((grey, np.broadcast_to(grey[:1], grey.shape), change), axis=1)


def _resized(picture: Pixels, size: int) -> Pixels:
    """The whole picture as a square of another size."""
    return np.asarray(cv2.resize(picture, (size, size), interpolation=cv2.INTER_AREA), dtype=np.uint8)
