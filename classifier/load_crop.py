"""A square of the picture that rides on the sled, with the load in it and the load's own movement alone."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from classifier.sled_board import Board
from classifier.sled_motion import SledMotion
from sim_core.frames import Array

Grey = NDArray[np.uint8]

_BELOW_TARGETS = 0.3
"""How far the crop reaches below the lower row of targets, in spacings."""
_BESIDE_TARGETS = 0.45
_INSET = 0.8
"""How far the load stands in from the outermost targets, in spacings: the board is 0.25 m longer at each end."""
_ABOVE_LOAD = 1.08
_USUAL_HEIGHT = 0.95
"""Of load and pallet, in board lengths, where the sled has not yet gone far enough to show it."""
_CHANGED = 18.0
_NODES_PX = 8
_BLUR_SHARE = 1.0 / 75.0


@dataclass(frozen=True)
class CropSquare:
    """Where the load is in the first picture, straightened [px].

    Attributes:
        left: of the crop.
        top: of the crop.
        edge: of the crop, which is square.
        load: left, top, right and bottom of the load with its pallet.
    """

    left: float
    top: float
    edge: float
    load: tuple[float, float, float, float]


def crop_square(greys: list[Grey], board: Board, motion: SledMotion) -> CropSquare:
    """Chooses the crop: all of the board, and the load up to its top where the sled has bared what is behind it.

    Args:
        greys: pictures from the first on, shape [height, width] each.
        board: as it is in the first one.
        motion: of the sled.
    """
    places = motion.straight(board.places)
    along = board.pattern[:, 0]
    spacing = float(np.linalg.norm(places[-1] - places[0]) / (along[-1] - along[0]))
    left, right = float(places[:, 0].min()), float(places[:, 0].max())
    deck, bottom = (
        float(places[:, 1].min()) - 0.3 * spacing,
        float(places[:, 1].max()) + _BELOW_TARGETS * spacing,
    )
    length = right - left
    middle, half = 0.5 * (left + right), 0.5 * length - _INSET * spacing
    farthest = int(np.argmax(np.abs(motion.travel)))
    travel_px = float(motion.travel[farthest]) * motion.size[0]
    seen = _uncovered(greys[0], greys[farthest], (middle, deck), half, travel_px)
    half, height = (half, _USUAL_HEIGHT * length) if seen is None else seen
    edge = max(length + 2.0 * _BESIDE_TARGETS * spacing, bottom - deck + _ABOVE_LOAD * height)
    load = (middle - half, deck - height, middle + half, deck)
    return CropSquare(middle - 0.5 * edge, bottom - edge, edge, load)


def _uncovered(
    first: Grey, later: Grey, foot: tuple[float, float], half: float, travel_px: float
) -> tuple[float, float] | None:
    """Half the load's width and its height [px], from what changed where it stood and no longer stands.

    Args:
        first: the first picture.
        later: one of the sled as far away as it goes.
        foot: the middle of the load on the deck in the first picture [px].
        half: of the pallet's width [px].
        travel_px: of the sled between the two.

    Returns:
        None where the sled has not bared enough of it.
    """
    middle, deck = foot
    bared = min(2.0 * half, abs(travel_px))
    left = middle - half if travel_px > 0.0 else middle + half - bared
    columns = slice(max(0, int(left)), max(0, int(np.ceil(left + bared))))
    if bared < 0.7 * half or deck < 8.0:
        return None
    before, after = (
        cv2.GaussianBlur(grey[: int(deck), columns].astype(np.float32), (5, 5), 0.0)
        for grey in (first, later)
    )
    changed = np.abs(before - after) > _CHANGED
    rows = np.flatnonzero(changed.mean(axis=1) > 0.25)
    if not len(rows):
        return None
    filled = np.flatnonzero(changed[rows[0] :].mean(axis=0) > 0.4)
    if not len(filled):
        return None
    if deck - float(rows[0]) < 0.7 * half:
        # No load is that flat: one that looks like what is behind it.
        return None
    # The load stands in the pallet's middle, so one end tells of the other.
    end = columns.start + (filled[0] if travel_px > 0.0 else filled[-1])
    return max(0.4 * half, min(half, abs(float(end) - middle))), deck - float(rows[0])


class LoadCrop:
    """Cuts the crop out of every picture.

    Args:
        square: of the first picture.
        motion: of the sled.
        size_px: edge of what is cut out.
    """

    def __init__(self, square: CropSquare, motion: SledMotion, size_px: int) -> None:
        self._motion, self._size = motion, size_px
        # Drawn finer by a whole number and averaged, so that a large load does not flicker.
        self._finer = max(1, int(np.ceil(square.edge / size_px - 0.25)))
        nodes = -(-size_px * self._finer // _NODES_PX) + 2
        centres = (np.arange(nodes) - 0.5) * _NODES_PX / (size_px * self._finer)
        x, y = np.meshgrid(square.left + square.edge * centres, square.top + square.edge * centres)
        self._nodes = np.stack((x, y), axis=-1) - 0.5
        scale = size_px / square.edge
        box = np.array(square.load) - np.array([square.left, square.top] * 2)
        self.load = np.clip(np.round(box * scale).astype(int), 0, size_px)

    def cut(self, grey: Grey, picture: int) -> Grey:
        """The crop of a picture by its number, shape [size_px, size_px]; what lies outside repeats the border."""
        fine = self._size * self._finer
        # The map is smooth: every eighth point says it all.
        sparse = self._motion.carried(self._nodes, picture).astype(np.float32)
        dense = cv2.resize(sparse, None, fx=_NODES_PX, fy=_NODES_PX, interpolation=cv2.INTER_LINEAR)
        dense = dense[_NODES_PX : _NODES_PX + fine, _NODES_PX : _NODES_PX + fine]
        seen = cv2.remap(
            grey,
            np.ascontiguousarray(dense[..., 0]),
            np.ascontiguousarray(dense[..., 1]),
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_REPLICATE,
        )
        return np.asarray(
            cv2.resize(seen, (self._size, self._size), interpolation=cv2.INTER_AREA), dtype=np.uint8
        )


def change_of(frames: NDArray[np.uint8], load: NDArray[np.intp] | None = None) -> Array:
    """How much each frame differs from the first one, as grey levels, shape [time].

    Args:
        frames: grey, shape [time, height, width].
        load: left, top, right and bottom of the part that counts [px]; None: all of it.
    """
    left, top, right, bottom = (0, 0, frames.shape[2], frames.shape[1]) if load is None else load
    part = frames[:, top : max(bottom, top + 1), left : max(right, left + 1)]
    # Soft enough that print which has moved by more than its own size still counts by how far.
    soft = [
        cv2.GaussianBlur(frame.astype(np.float32), (0, 0), _BLUR_SHARE * frames.shape[2]) for frame in part
    ]
    return np.array([float(np.abs(frame - soft[0]).mean()) for frame in soft])
