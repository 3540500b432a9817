"""The sled's board in a video: its targets found without being told where, then followed from picture to picture."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from sim_core.frames import Array
from sim_core.vision.targets import TargetTracker, target_template

Grey = NDArray[np.uint8]

RADII_PX = 1.5 * 2.0 ** np.arange(0.0, 4.0, 0.5)
"""Sizes of targets that are looked for, in a picture of 480 columns."""
FEWEST_TARGETS = 5
_SEARCH_RADIUS_PX = 4.0
_LEAST_SCORE = 0.6
_MOST_CANDIDATES = 60
_SPACING = (5.8, 8.6)
"""Of neighbouring targets along the board, in radii: 0.24 m to 0.28 m over 0.035 m, seen from up to 30° aside."""
_ROW = 0.41
"""How far apart the two rows are, in spacings."""
_NEAR = 0.14
"""How far a target may be from its place in the pattern, in spacings."""
_FLAT_RADIUS_PX = 6.0
_FLAT_SPACING_PX = 43.0
_REACH = (1.6, 0.5)
"""How far the board may be from where it is foretold, along and across, in spacings."""
_LEAST_LIKENESS = 0.5


@dataclass(frozen=True, eq=False)
class Board:
    """The row of targets in one picture.

    Attributes:
        pattern: their places on the board in spacings, along and down, shape [n, 2].
        places: in the picture [px], shape [n, 2].
        radius_px: of a target.
    """

    pattern: Array
    places: Array
    radius_px: float


def find_board(grey: Grey) -> Board | None:
    """Looks for targets that stand in two rows by turns; None where there are fewer than ``FEWEST_TARGETS``.

    Args:
        grey: the picture, shape [height, width]; the board is in its lower three quarters.
    """
    skipped = grey.shape[0] // 4
    below = grey[skipped:]
    best, best_quality = None, 0.0
    for radius in RADII_PX * grey.shape[1] / 480.0:
        places, scores = _candidates(below, _SEARCH_RADIUS_PX / float(radius))
        found = _zigzag(places, scores, float(radius))
        if found is not None and found[2] > best_quality:
            pattern, chosen, best_quality = found
            best = Board(pattern, chosen + np.array([0.0, skipped]), float(radius))
    return best


def _candidates(grey: Grey, scale: float) -> tuple[Array, Array]:
    """Places that look like a target [px], shape [n, 2], and how much, shape [n]."""
    interpolation = cv2.INTER_AREA if scale < 1.0 else cv2.INTER_LINEAR
    sized = cv2.resize(grey, None, fx=scale, fy=scale, interpolation=interpolation)
    template = target_template(_SEARCH_RADIUS_PX)
    half = len(template) // 2
    if min(sized.shape) <= len(template):
        return np.zeros((0, 2)), np.zeros(0)
    score = cv2.matchTemplate(sized, template.astype(np.uint8), cv2.TM_CCOEFF_NORMED)
    peaks = (score >= cv2.dilate(score, np.ones((5, 5), np.uint8))) & (score > _LEAST_SCORE)
    rows, columns = np.nonzero(peaks)
    order = np.argsort(-score[rows, columns], kind="stable")[:_MOST_CANDIDATES]
    rows, columns = rows[order], columns[order]
    places = (np.column_stack((columns, rows)) + half + 0.5) / scale - 0.5
    return places.astype(np.float64), score[rows, columns].astype(np.float64)


def _zigzag(places: Array, scores: Array, radius_px: float) -> tuple[Array, Array, float] | None:
    """The longest zigzag among candidates: pattern and places, shape [n, 2] each, and the sum of its scores."""
    best, best_quality = None, 0.0
    steps = 0.5 * (places[None] - places[:, None])
    lengths = np.linalg.norm(steps, axis=2) / radius_px
    level = (steps[..., 0] > 0.0) & (np.abs(steps[..., 1]) < 0.35 * steps[..., 0])
    numbers = np.arange(-12, 13)
    for i, j in zip(*np.nonzero(level & (lengths > _SPACING[0]) & (lengths < _SPACING[1])), strict=True):
        step = steps[i, j]
        across = np.array([-step[1], step[0]])
        for side in (-_ROW, _ROW):
            pattern = np.column_stack((numbers, np.where(numbers % 2, side, 0.0)))
            foretold = places[i] + pattern[:, :1] * step + pattern[:, 1:] * across
            distance = np.linalg.norm(foretold[:, None] - places[None], axis=2) / np.linalg.norm(step)
            nearest = distance.argmin(axis=1)
            off = distance[np.arange(len(numbers)), nearest]
            hit = off < _NEAR * np.maximum(1.0, 0.3 * np.abs(numbers))
            # Only what is joined to the first pair; beyond a gap of two it is something else.
            for end in (slice(12, None, 1), slice(12, None, -1)):
                run = hit[end]
                gaps = np.flatnonzero(~run[:-1] & ~run[1:])
                run[gaps[0] if len(gaps) else len(run) :] = False
            if hit.sum() < FEWEST_TARGETS or not hit[numbers % 2 == 1].any():
                continue
            quality = float((scores[nearest] * (1.0 - off))[hit].sum())
            if quality > best_quality:
                best, best_quality = (pattern[hit], places[nearest[hit]], quality), quality
    return best


class BoardFollower:
    """Follows a board through the pictures after the one where it was found.

    Each picture is first flattened to the board as it would look from the front, with targets of a fixed size; the
    board is then looked for along its travel, and its targets measured to a fraction of a pixel.

    Args:
        grey: the picture where the board was found, shape [height, width].
        board: what was found.
    """

    def __init__(self, grey: Grey, board: Board) -> None:
        middle = board.pattern.mean(axis=0)
        self._flat = (board.pattern - middle) * _FLAT_SPACING_PX
        half = np.abs(self._flat).max(axis=0) + 2.0 * _FLAT_RADIUS_PX
        self._margin: Array = np.ceil(np.array(_REACH) * _FLAT_SPACING_PX)
        self._half: Array = np.ceil(half)
        self._tracker = TargetTracker(np.full(len(self._flat), _FLAT_RADIUS_PX))
        self._map = fitted_affine(self._flat, board.places)
        self._velocity: Array = np.zeros(2)
        self._looks = self._flattened(grey, self._half, 0.5)

    def follow(self, grey: Grey) -> Array:
        """The targets' places in the next picture [px], shape [n, 2]; NaN where they are covered or lost."""
        self._map[:, 2] += self._velocity
        wide = self._flattened(grey, self._half + self._margin, 0.5)
        _, likeness, _, at = cv2.minMaxLoc(cv2.matchTemplate(wide, self._looks, cv2.TM_CCOEFF_NORMED))
        if likeness < _LEAST_LIKENESS:
            return np.full(self._flat.shape, np.nan)
        moved = self._map[:, :2] @ (2.0 * np.array(at) - self._margin)
        self._map[:, 2] += moved
        flat = self._flattened(grey, self._half, 1.0)
        seen = self._tracker.follow(flat, self._flat + self._half) - self._half
        places: Array = seen @ self._map[:, :2].T + self._map[:, 2]
        good = np.isfinite(places).all(axis=1)
        before = self._map[:, 2].copy()
        if good.sum() >= 4 and np.ptp(self._flat[good, 1]) > 1.0:
            self._map = fitted_affine(self._flat[good], places[good])
        self._velocity = self._velocity + moved + self._map[:, 2] - before
        return places

    def _flattened(self, grey: Grey, half: Array, scale: float) -> Grey:
        """The board from the front, ``half`` flat pixels to each side of its middle, shape [height, width]."""
        width, height = (int(2 * scale * edge) + 1 for edge in half)
        linear = self._map[:, :2] / scale
        matrix = np.column_stack((linear, self._map[:, 2] - self._map[:, :2] @ half))
        return np.asarray(
            cv2.warpAffine(
                grey,
                matrix,
                (width, height),
                flags=cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP,
                borderMode=cv2.BORDER_REPLICATE,
            ),
            dtype=np.uint8,
        )


def fitted_affine(start: Array, end: Array) -> Array:
    """The affine map that takes points to points with the least squares, shape [2, 3].

    Args:
        start: shape [n, 2].
        end: shape [n, 2].
    """
    design = np.column_stack((start, np.ones(len(start))))
    return np.asarray(np.linalg.lstsq(design, end, rcond=None)[0].T, dtype=np.float64)
