"""Spots and blocks of a face's tile: where its print is worth following, and where it is found again.

Spots are corners of the print, followed by optical flow there and back. Blocks are several times as large as a spot's
surroundings and found by correlation: less finely, but in spite of much that covers the print.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from sim_core.frames import Array

Grey = NDArray[np.uint8]

_APART, _BETWEEN_APART = 0.11, 0.05
"""Of a face's shorter edge: so far spots are from each other that are followed first, and those between them."""
_WINDOW_PX = 15
_RETURN_PX = 0.5
"""A spot that is followed there and back must come home to so near."""
_BLOCK_PX, _BLOCK_REACH_PX, _LEAST_BLOCK_MATCH = 37, 8, 0.5
_LEAST_CONTRAST, _LEAST_PEAK = 4.0, 0.06
"""A block is looked for if its grey values vary so much; it is found if it matches so much less two pixels off."""


class Spots:
    """Places on the faces as they stood: pixels of the mosaic, undistorted rays, and depths [m]; NaN for none."""

    def __init__(self, faces: int, most: int) -> None:
        self.pixels = np.full((faces, most, 2), np.nan)
        self.rays = np.full((faces, most, 2), np.nan)
        self.depths = np.zeros((faces, most))


def strong_spots(tile: Grey, counts: tuple[int, int], *, margin_px: int) -> tuple[Array, Array]:
    """Corners in a tile [px], shape [n, 2] each: some far apart, and others between them, the strongest first.

    Args:
        tile: the face's cutting, with its margin.
        counts: how many there are of each kind at most.
        margin_px: of the tile around the face.
    """
    h, w = tile.shape
    mask = np.zeros((h, w), np.uint8)
    inset = margin_px + min(6, w // 12, h // 12)
    mask[inset : h - inset, inset : w - inset] = 255
    found = []
    for share, count in zip((_APART, _BETWEEN_APART), counts, strict=True):
        apart = max(5.0, share * min(w, h))
        strong = cv2.goodFeaturesToTrack(tile, count, 0.005, apart, mask=mask, blockSize=7)
        spots = np.zeros((0, 2)) if strong is None else strong.reshape(-1, 2).astype(float)
        for spot in spots:
            cv2.circle(mask, np.round(spot).astype(int).tolist(), round(apart), 0, cv2.FILLED)
        found.append(spots)
    return found[0], found[1]


def spots_found(reference: Grey, mosaic: Grey, start: NDArray[np.float32]) -> Array:
    """Where spots of the reference are in a mosaic, by optical flow [px], shape [n, 2]; NaN for those not found.

    Args:
        reference: the mosaic of the standing load.
        mosaic: that of a later picture.
        start: the spots [px], shape [n, 2].
    """
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 20, 0.01)
    window = (_WINDOW_PX, _WINDOW_PX)
    there, went, _ = cv2.calcOpticalFlowPyrLK(
        reference, mosaic, start, start.copy(), winSize=window, maxLevel=3, criteria=criteria,
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
    )  # fmt: skip
    back, came, _ = cv2.calcOpticalFlowPyrLK(
        mosaic, reference, there, start.copy(), winSize=window, maxLevel=1, criteria=criteria,
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
    )  # fmt: skip
    off = np.linalg.norm(back - start, axis=1)
    good = (went.ravel() > 0) & (came.ravel() > 0) & (off < _RETURN_PX)
    spots: Array = np.where(good[:, None], np.asarray(there, dtype=np.float64), np.nan)
    return spots


def block_spots(tile: Grey, *, margin_px: int) -> Array:
    """Middles of blocks in a tile that show something [px], shape [n, 2]; those that show most come first."""
    h, w = tile.shape
    half, found = _BLOCK_PX // 2, []
    across, down = w - 2 * (margin_px + half), h - 2 * (margin_px + half)
    if across < 1 or down < 1:
        return np.zeros((0, 2))
    first = margin_px + half
    for y in np.linspace(first, h - 1 - first, 1 + -(-down // half)).astype(int):
        for x in np.linspace(first, w - 1 - first, 1 + -(-across // half)).astype(int):
            block = tile[y - half : y + half + 1, x - half : x + half + 1]
            found.append((float(block.std()), float(x), float(y)))
    shown = sorted((entry for entry in found if entry[0] > _LEAST_CONTRAST), reverse=True)
    return np.array([entry[1:] for entry in shown]).reshape(-1, 2)


def block_found(reference: Grey, mosaic: Grey, x: int, y: int) -> tuple[float, float]:
    """Where the block around a pixel of the reference is in a mosaic [px]; NaN where nothing matches it alone."""
    half, reach = _BLOCK_PX // 2, _BLOCK_REACH_PX
    wanted = reference[y - half : y + half + 1, x - half : x + half + 1]
    around = half + reach
    low = max(x - around, 0), max(y - around, 0)
    searched = mosaic[low[1] : y + around + 1, low[0] : x + around + 1]
    score = cv2.matchTemplate(searched, wanted, cv2.TM_CCOEFF_NORMED)
    _, best, _, (column, row) = cv2.minMaxLoc(score)
    height, width = score.shape
    if best < _LEAST_BLOCK_MATCH or not (2 <= column < width - 2 and 2 <= row < height - 2):
        return float("nan"), float("nan")
    off = []
    for line in (score[row, column - 2 : column + 3], score[row - 2 : row + 3, column]):
        if best - max(float(line[0]), float(line[4])) < _LEAST_PEAK:
            return float("nan"), float("nan")
        # The vertex of the parabola through the three highest.
        off.append(0.5 * float(line[1] - line[3]) / float(line[1] - 2.0 * line[2] + line[3]))
    return low[0] + half + column + off[0], low[1] + half + row + off[1]
