"""How a point that rides on the sled moves through the picture, from the board's targets in all pictures of a clip."""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from sim_core.frames import Array

LOAD_BEHIND_BOARD = 0.03 / 4.5
"""Of the load's near side, in usual distances to the camera: it seems slower than the board by so much."""
_PRIOR = np.array([0.15, 0.15, 0.15, 0.05])
"""What is usual: tilts of plane and travel, in picture widths over the focal length, and the lens' bend."""
_SIGMA = 0.1
"""Of a target's place [px]."""
_ROUNDS = 3


@dataclass(frozen=True, eq=False)
class SledMotion:
    """The picture's change while a plane slides in itself before a camera that stands still.

    A plane with the horizon l that slides along itself towards the vanishing point v, l·v = 0, is seen through the
    homography H = I + s·v·lᵀ (Hartley and Zisserman, Multiple View Geometry, 2003, A7: an elation), in which s alone
    changes from picture to picture. So the few numbers that tell how the camera stands come from all pictures together,
    and hold far above the board, where the board of one picture says little. The lens bends straight lines:
    p_straight = p·(1 + κ·|p|²).

    Coordinates are picture widths from the picture's middle.

    Attributes:
        horizon: l, shape [3].
        vanishing: v, shape [3].
        bend: κ.
        travel: s of each picture, shape [n]; 0 in the first.
        residual_px: root mean square of what is left of the targets' places [px].
        size: width and height of the pictures [px].
    """

    horizon: Array
    vanishing: Array
    bend: float
    travel: Array
    residual_px: float
    size: tuple[int, int]

    def straight(self, places: Array) -> Array:
        """Places in the picture [px], shape [..., 2], as they were with a lens that does not bend [px]."""
        scaled = self._scaled(places)
        return self._in_px(scaled * (1.0 + self.bend * (scaled**2).sum(axis=-1, keepdims=True)))

    def carried(self, places: Array, picture: int) -> Array:
        """Where points of the load's near side are in a picture [px], shape [..., 2].

        Args:
            places: in the first picture, straight [px], shape [..., 2].
            picture: its number.
        """
        slide = self.travel[picture] * (1.0 - LOAD_BEHIND_BOARD)
        scaled = self._scaled(places)
        slide = slide * (scaled @ self.horizon[:2] + 1.0)[..., None]
        moved = (scaled + slide * self.vanishing[:2]) / (1.0 + slide * self.vanishing[2])
        square = (moved**2).sum(axis=-1, keepdims=True)
        # The inverse of the bend to its second order: below 0.01 px for any lens that the fit may find.
        return self._in_px(moved * (1.0 - self.bend * square + 3.0 * (self.bend * square) ** 2))

    def _scaled(self, places: Array) -> Array:
        scaled: Array = (places - 0.5 * (np.array(self.size) - 1.0)) / self.size[0]
        return scaled

    def _in_px(self, scaled: Array) -> Array:
        places: Array = scaled * self.size[0] + 0.5 * (np.array(self.size) - 1.0)
        return places


def fitted_motion(places: Array, size: tuple[int, int]) -> SledMotion | None:
    """The motion that explains where the targets are.

    Args:
        places: of each target in each picture [px], shape [picture_count, n, 2]; NaN where not seen.
        size: width and height of the pictures [px].

    Returns:
        None where too little was seen: less than three targets in the first picture, or in half of all.
    """
    places = places[:, np.isfinite(places[0]).all(axis=1)]
    seen = np.asarray(np.isfinite(places).all(axis=2))
    enough = np.asarray(seen.sum(axis=1) >= 3)
    if not enough[0] or enough.mean() < 0.5:
        return None
    scaled = (places - 0.5 * (np.array(size) - 1.0)) / size[0]
    weights = (seen & enough[:, None]).astype(float)
    scaled = np.where(weights[..., None] > 0.0, scaled, 0.0)
    moved = (weights[..., None] * (scaled - scaled[0])).sum(axis=1)
    farthest = moved[np.argmax(np.abs(moved[:, 0]))]
    heading = float(np.arctan2(farthest[1], farthest[0])) if np.abs(farthest[0]) > 1.0e-3 else 0.0
    heading = heading if np.abs(heading) < 0.5 * np.pi else heading - np.copysign(np.pi, heading)
    unit = size[0] / _SIGMA

    def residuals(camera: Array) -> Array:
        left = _explained(camera, heading, scaled, weights)[0]
        return np.concatenate((left.ravel() * unit, camera / _PRIOR))

    camera = least_squares(residuals, np.zeros(4), loss="soft_l1", x_scale=0.1, max_nfev=20).x
    left, travel = _explained(camera, heading, scaled, weights)
    numbers = np.arange(len(travel))
    travel = np.interp(numbers, numbers[enough], travel[enough] - travel[0])
    residual = float(np.sqrt((left**2).sum() / weights.sum())) * size[0]
    return SledMotion(*_plane(camera, heading), float(camera[3]), travel, residual, size)


def _plane(camera: Array, heading: float) -> tuple[Array, Array]:
    """Horizon and vanishing point, shape [3] each, of two tilts of the plane and one of the travel."""
    along = np.array([np.cos(heading + camera[2]), np.sin(heading + camera[2])])
    return np.array([camera[0], camera[1], 1.0]), np.append(along, -(camera[:2] @ along))


def _explained(camera: Array, heading: float, places: Array, weights: Array) -> tuple[Array, Array]:
    """What is left of the places, shape [picture_count, n, 2], and each picture's s, shape [picture_count]."""
    horizon, vanishing = _plane(camera, heading)
    places = places * (1.0 + camera[3] * (places**2).sum(axis=2, keepdims=True))
    start = places[0]
    for _ in range(_ROUNDS):
        near = start @ horizon[:2] + 1.0
        # H·p ∝ q, cleared of its denominator, is linear in s: q − p = s·(l·p)·(v − w·q).
        slope = near[:, None] * (vanishing[:2] - vanishing[2] * places)
        top = (weights[..., None] * (places - start) * slope).sum(axis=(1, 2))
        travel = top / np.maximum((weights[..., None] * slope**2).sum(axis=(1, 2)), 1.0e-12)
        # The inverse of an elation is the one with −s: every picture says where the targets were in the first.
        slide = (travel - travel[0])[:, None] * (places @ horizon[:2] + 1.0)
        back = (places - slide[..., None] * vanishing[:2]) / (1.0 - slide * vanishing[2])[..., None]
        start = (weights[..., None] * back).sum(axis=0) / weights.sum(axis=0)[:, None]
    return (back - start) * weights[..., None], travel
