"""The quadrant targets on the sled's board: found anywhere in a picture, then followed to a fraction of a pixel."""

import cv2
import numpy as np
from numpy.typing import NDArray

from sim_core.frames import Array
from sim_core.vision.plane import undistorted

Grey = NDArray[np.uint8]

LEAST_SCORE = 0.7
"""Least correlation of a target with its ideal picture."""
_SEARCH_RADIUS_PX = 6.0
_RING = 1.25
_MOST_CANDIDATES = 40
_SOFT_PX = 0.6


def target_template(radius_px: float) -> NDArray[np.float32]:
    """An ideal target with a rim of white board around it, of odd size, for correlation."""
    half = max(2, round(_RING * radius_px))
    fine = 8
    along = (np.arange((2 * half + 1) * fine) + 0.5) / fine - half - 0.5
    inside = along[:, None] ** 2 + along[None, :] ** 2 <= radius_px**2
    black = inside & ((along[:, None] < 0.0) == (along[None, :] < 0.0))
    size = 2 * half + 1
    return np.asarray(
        cv2.resize(
            np.where(black, 0.0, 255.0).astype(np.float32), (size, size), interpolation=cv2.INTER_AREA
        ),
        dtype=np.float32,
    )


def find_targets(grey: Grey, board: Array, matrix: Array, distortion: Array) -> tuple[Array, float]:
    """Finds the board's targets in a picture of which nothing is known.

    Args:
        grey: the picture, shape [height, width].
        board: the targets' places on the board, right and down [m], shape [n, 2].
        matrix: intrinsics K, shape [3, 3].
        distortion: k1, k2, p1, p2, k3, shape [5].

    Returns:
        Their centres [px], shape [n, 2], NaN where not found, and their radius in the picture [px].
    """
    best, best_score, best_radius = np.full(board.shape, np.nan), 0.0, 0.0
    largest = 0.06 * min(grey.shape)
    for scale in 2.0 ** np.arange(0.0, -6.0, -0.5):
        radius = _SEARCH_RADIUS_PX / scale
        if radius > largest:
            break
        places, scores = _candidates(grey, float(scale))
        if len(places) < 4:
            continue
        rays = undistorted(places, matrix, distortion)
        chosen, quality = _assigned(rays, scores, board)
        if quality > best_score:
            best_score, best_radius = quality, radius
            best = np.where(chosen[:, None] >= 0, places[chosen], np.nan)
    seen = np.isfinite(best).all(axis=1)
    best[seen] = refined(grey, best[seen], best_radius)
    return best, best_radius


def refined(grey: Grey, centres: Array, radius_px: float) -> Array:
    """Centres to a fraction of a pixel, shape [n, 2]; NaN where no target is.

    Two soft edges that cross, I = m − A·tanh(u/w)·tanh(v/w) with the signed distances u and v from them, are fitted to
    the target's inside by Gauss-Newton: centre, direction of each edge, A, m and w. OpenCV's cornerSubPix leaves a
    bias of 0.06 px, which changes with the place in the pixel, on edges that run along the pixels; this leaves 0.01 px.

    Args:
        grey: the picture, shape [height, width].
        centres: to about a pixel [px], shape [n, 2].
        radius_px: of the targets in the picture.
    """
    reach = max(3, int(0.8 * radius_px))
    start = np.round(centres).astype(int)
    inside = ((start >= reach) & (start < np.array(grey.shape[::-1]) - reach)).all(axis=1)
    found = np.full(centres.shape, np.nan)
    if not inside.any():
        return found
    along = np.arange(-reach, reach + 1)
    dx, dy = (axis.ravel() for axis in np.meshgrid(along, along))
    round_px = dx * dx + dy * dy <= (reach + 0.5) ** 2
    dx, dy = dx[round_px], dy[round_px]
    own = start[inside]
    # Softened a little: an edge that is sharp to the pixel says nothing of its place within it.
    patches = np.array(
        [
            cv2.GaussianBlur(
                grey[y - reach : y + reach + 1, x - reach : x + reach + 1].astype(np.float32),
                (0, 0),
                _SOFT_PX,
            )
            for x, y in own
        ]
    )
    values = patches[:, dy + reach, dx + reach].astype(float)
    state, residual = _crossed_edges(values, dx.astype(float), dy.astype(float), centres[inside] - own)
    is_target = (
        (np.abs(state[:, :2]).max(axis=1) < 0.6 * reach)
        & (residual < 0.25 * np.abs(state[:, 4]))
        & (state[:, 4] > 8.0)
    )
    found[inside] = np.where(is_target[:, None], own + state[:, :2], np.nan)
    return found


def _crossed_edges(values: Array, dx: Array, dy: Array, start: Array) -> tuple[Array, Array]:
    """The fit: centre, edges' directions, A, m and w, shape [n, 7], and the root mean square left over, shape [n]."""
    count = len(values)
    state = np.zeros((count, 7))
    state[:, :2] = start
    low, high = np.percentile(values, (15, 85), axis=1)
    state[:, 4], state[:, 5], state[:, 6] = 0.5 * (high - low), 0.5 * (high + low), 1.0
    residual = np.zeros_like(values)
    columns = np.empty((count, 7, values.shape[1]))
    for _ in range(6):
        x, y = dx - state[:, :1], dy - state[:, 1:2]
        ca, sa, cb, sb = (f(state[:, k, None]) for k in (2, 3) for f in (np.cos, np.sin))
        width = state[:, 6, None]
        u, v = ca * x + sa * y, cb * y - sb * x
        tu, tv = np.tanh(u / width), np.tanh(v / width)
        fall = -state[:, 4, None] / width
        du, dv = fall * tv * (1.0 - tu * tu), fall * tu * (1.0 - tv * tv)
        residual = values - state[:, 5, None] + state[:, 4, None] * tu * tv
        columns[:, 0] = -ca * du + sb * dv
        columns[:, 1] = -sa * du - cb * dv
        columns[:, 2] = du * (ca * y - sa * x)
        columns[:, 3] = dv * (-sb * y - cb * x)
        columns[:, 4] = -tu * tv
        columns[:, 5] = 1.0
        columns[:, 6] = -(du * u + dv * v) / width
        normal = columns @ columns.transpose(0, 2, 1) + 1.0e-6 * np.eye(7)
        step = np.linalg.solve(normal, columns @ residual[..., None])[..., 0]
        step[:, :2] = np.clip(step[:, :2], -2.0, 2.0)
        step[:, 2:4] = np.clip(step[:, 2:4], -0.1, 0.1)
        state += step
        state[:, 6] = np.clip(state[:, 6], 0.3, 4.0)
        if np.abs(step[:, :2]).max() < 1.0e-3:
            break
    return state, np.sqrt((residual**2).mean(axis=1))


class TargetTracker:
    """Follows targets whose places are foretold to within about their own size.

    Args:
        radii_px: of each target in the picture [px], shape [n].
    """

    def __init__(self, radii_px: Array) -> None:
        self._radii = radii_px
        self._templates = [target_template(radius) for radius in radii_px]

    def follow(self, grey: Grey, foretold: Array) -> Array:
        """Centres [px], shape [n, 2]; NaN for targets that are covered, out of the picture or not where foretold."""
        found = np.full(foretold.shape, np.nan)
        for number, (place, template) in enumerate(zip(foretold, self._templates, strict=True)):
            if not np.isfinite(place).all():
                continue
            half = len(template) // 2
            reach = half + int(np.ceil(1.2 * self._radii[number])) + 2
            corner = np.round(place).astype(int) - reach
            end = corner + 2 * reach + 1
            if (corner < 0).any() or end[0] > grey.shape[1] or end[1] > grey.shape[0]:
                corner, end = np.maximum(corner, 0), np.minimum(end, grey.shape[::-1])
                if (end - corner < len(template)).any():
                    continue
            window = grey[corner[1] : end[1], corner[0] : end[0]].astype(np.float32)
            score = cv2.matchTemplate(window, template, cv2.TM_CCOEFF_NORMED)
            _, peak, _, at = cv2.minMaxLoc(score)
            if peak < LEAST_SCORE:
                continue
            found[number] = corner + np.array(at) + half
        seen = np.isfinite(found).all(axis=1)
        if seen.any():
            found[seen] = refined(grey, found[seen], float(self._radii[seen].min()))
        return found


def _candidates(grey: Grey, scale: float) -> tuple[Array, Array]:
    """Places that look like a target of one size [px], shape [n, 2], and how much, shape [n]."""
    small = grey if scale == 1.0 else cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    template = target_template(_SEARCH_RADIUS_PX)
    half = len(template) // 2
    if min(small.shape) <= len(template):
        return np.zeros((0, 2)), np.zeros(0)
    score = cv2.matchTemplate(small.astype(np.float32), template, cv2.TM_CCOEFF_NORMED)
    peaks = (score >= cv2.dilate(score, np.ones((7, 7), np.uint8))) & (score > LEAST_SCORE)
    rows, columns = np.nonzero(peaks)
    order = np.argsort(-score[rows, columns])[:_MOST_CANDIDATES]
    rows, columns = rows[order], columns[order]
    places = (np.column_stack((columns, rows)) + half + 0.5) / scale - 0.5
    return places.astype(np.float64), score[rows, columns].astype(np.float64)


def _assigned(rays: Array, scores: Array, board: Array) -> tuple[NDArray[np.intp], float]:
    """Which candidate is which target, or -1, by the similarity that two of them give; and how good it is."""
    best, best_quality = np.full(len(board), -1), 0.0
    last = len(board) - 1
    spacing = float(np.linalg.norm(np.diff(board, axis=0), axis=1).min())
    places, layout = rays[:, 0] + 1j * rays[:, 1], board[:, 0] + 1j * board[:, 1]
    for first, second in ((0, last), (0, last - 1), (1, last), (1, last - 1)):
        step = layout[second] - layout[first]
        turn = (places[None, :] - places[:, None]) / step
        upright = (turn.real > 0.0) & (np.abs(turn.imag) < 0.5 * turn.real)
        for i, j in zip(*np.nonzero(upright), strict=True):
            foretold = places[i] + turn[i, j] * (layout - layout[first])
            distance = np.abs(foretold[:, None] - places[None, :]) / (abs(turn[i, j]) * spacing)
            nearest = distance.argmin(axis=1)
            off = distance[np.arange(len(board)), nearest]
            hit = off < 0.2
            if len(np.unique(nearest[hit])) < hit.sum():
                continue
            quality = float((scores[nearest] * (1.0 - off))[hit].sum())
            if quality > best_quality:
                best, best_quality = np.where(hit, nearest, -1), quality
    return best, best_quality
