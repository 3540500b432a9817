"""Lens and sensor: from the pinhole picture that was rendered to the bytes that the camera gives.

Colours are rendered as the square root of linear light ("gamma 2"): near enough to sRGB to be shown as they are, and
cheap to take into linear light and back.
"""

from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

from sim_core.camera.view import CameraView
from sim_core.frames import Array

Picture = NDArray[np.uint8]

_MID_GREY = 128.0
_BAND_ROWS, _NOISE_PLAY = 120, 256
_COLUMN_PX = 64
_DRAW_PX = 60_000
"""To draw once more costs as much as to draw so many pixels."""


@dataclass(frozen=True)
class Window:
    """A part of a picture [px]: from ``left`` and ``top`` on."""

    left: int
    top: int
    width: int
    height: int

    @property
    def rows(self) -> slice:
        """Rows of the picture that belong to it."""
        return slice(self.top, self.top + self.height)

    @property
    def columns(self) -> slice:
        """Columns of the picture that belong to it."""
        return slice(self.left, self.left + self.width)


class Lens:
    """Where on the distortion-free picture each pixel of the camera's picture is found.

    The distortion-free picture is ``oversampling`` times finer and goes on beyond the camera's as far as the lens
    bends light in; a part of it is rendered for every part of the camera's picture that is wanted. Its pixel (0, 0)
    has its middle on the optical axis.
    """

    def __init__(self, view: CameraView, *, oversampling: int) -> None:
        self._oversampling = oversampling
        pixels = np.stack(
            np.meshgrid(np.arange(view.width, dtype=float), np.arange(view.height, dtype=float)), axis=-1
        ).reshape(-1, 1, 2)
        rays = cv2.undistortPoints(
            pixels, view.matrix, view.distortion, criteria=(cv2.TERM_CRITERIA_COUNT, 30, 0.0)
        ).reshape(view.height, view.width, 2)
        self.focal = oversampling * float(view.matrix[0, 0])
        places = (self.focal * rays).astype(np.float32)
        # Pixel n of the blurred picture is the mean of n - 1 and n: its middle lies half a pixel before. In fixed
        # point a place gets the same fraction in whichever part it is drawn; rendered rows run upwards.
        shift = 0.5 if oversampling == 2 else 0.0
        self._cells, self._shares = cv2.convertMaps(
            places[..., 0] + np.float32(shift), np.float32(shift) - places[..., 1], cv2.CV_16SC2
        )

    def seen(self, part: Window) -> Window:
        """The part of the distortion-free picture that a part of the camera's needs."""
        cells = self._cells[part.rows, part.columns]
        rim = np.vstack((cells[0], cells[-1], cells[:, 0], cells[:, -1])).astype(int)
        (left, bottom), (right, top) = rim.min(axis=0) - 3, rim.max(axis=0) + 3
        return Window(int(left), int(-top), int(right - left) + 1, int(top - bottom) + 1)

    def bend(self, rendered: Picture, part: Window, seen: Window) -> Picture:
        """The camera's picture of a part from the distortion-free one, whose first row is at the bottom."""
        soft = cv2.blur(rendered, (2, 2)) if self._oversampling == 2 else rendered
        origin = np.array([-seen.left, seen.top + seen.height - 1], np.int16)
        cells = self._cells[part.rows, part.columns] + origin
        shares = self._shares[part.rows, part.columns]
        bent = cv2.remap(soft, cells, shares, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        return np.asarray(bent, np.uint8)


def projection(focal: float, seen: Window, *, near_m: float, far_m: float) -> Array:
    """Clip coordinates of points in the optical frame for a part of the distortion-free picture, shape [4, 4].

    OpenGL's: −1 is the left, the lower and the near edge of what is drawn, and a pixel is 2 / width wide.
    """
    return np.array(
        [
            [2.0 * focal / seen.width, 0.0, -2.0 * (seen.left - 0.5) / seen.width - 1.0, 0.0],
            [0.0, -2.0 * focal / seen.height, 2.0 * (seen.top - 0.5) / seen.height + 1.0, 0.0],
            [0.0, 0.0, (far_m + near_m) / (far_m - near_m), -2.0 * far_m * near_m / (far_m - near_m)],
            [0.0, 0.0, 1.0, 0.0],
        ]
    )  # fmt: skip


def busy_parts(boxes: Array, *, width: int, height: int, largest: tuple[int, int]) -> list[Window]:
    """Parts of a picture that cover some boxes, and little else.

    Columns of the picture are joined where drawing what lies between costs less than drawing once more.

    Args:
        boxes: left, top, right and bottom of each [px], shape [n, 4]; not finite: it may be anywhere.
        width: of the picture [px].
        height: of the picture [px].
        largest: width and height of the largest part [px].
    """
    if not np.isfinite(boxes).all():
        boxes = np.array([[0.0, 0.0, width, height]])
    runs: list[list[int]] = []
    wasted = 0
    for left in range(0, width, _COLUMN_PX):
        right = min(left + _COLUMN_PX, width)
        own = boxes[(boxes[:, 0] < right) & (boxes[:, 2] >= left)]
        top = max(0, int(own[:, 1].min(initial=height)))
        bottom = min(height, int(np.ceil(own[:, 3].max(initial=0.0))) + 1)
        if top >= bottom:
            continue
        if runs and runs[-1][1] == left:
            last = runs[-1]
            joined = [last[0], right, min(last[2], top), max(last[3], bottom)]
            more = _area(joined) - _area(last) - (right - left) * (bottom - top)
            if wasted + more < _DRAW_PX:
                runs[-1] = joined
                wasted += more
                continue
        runs.append([left, right, top, bottom])
        wasted = 0
    parts = []
    for left, right, top, bottom in runs:
        across, down = -(-(right - left) // largest[0]), -(-(bottom - top) // largest[1])
        xs = np.linspace(left, right, across + 1).astype(int).tolist()
        ys = np.linspace(top, bottom, down + 1).astype(int).tolist()
        parts += [Window(x0, y0, x1 - x0, y1 - y0) for x0, x1 in pairwise(xs) for y0, y1 in pairwise(ys)]
    return parts


def _area(run: list[int]) -> int:
    return (run[1] - run[0]) * (run[3] - run[2])


class Sensor:
    """Turns rendered light into the camera's bytes: exposure, and noise that depends on seed and number alone.

    The noise is that of counted light: its deviation grows with the root of a pixel's level, and the root of a level
    has the same noise everywhere. So it is added there, from one field of it at a place drawn for each band of rows.
    """

    def __init__(self, *, width: int, exposure_ev: float, noise: float, seed: int) -> None:
        self._seed, self._noise = seed, noise
        light = (np.arange(256) / 255.0) ** 2 * 2.0**exposure_ev
        levels = 255.0 * np.sqrt(np.minimum(light, 1.0))
        self._levels = np.round(levels).astype(np.uint8)
        # Fixed point: the root of 255 becomes 16 000.
        unit = 16000.0 / np.sqrt(255.0)
        self._scale = 1.0 / unit**2
        self._roots = np.round(np.sqrt(levels) * unit).astype(np.int16)
        deviation = 0.5 * noise / np.sqrt(_MID_GREY) * unit
        field = np.random.default_rng(seed).standard_normal(
            (_BAND_ROWS + _NOISE_PLAY, width + _NOISE_PLAY, 3), np.float32
        )
        self._field = np.round(np.clip(field * deviation, -16000, 16000)).astype(np.int16)

    def expose(self, rendered: Picture, index: int) -> Picture:
        """The camera's bytes of the picture with this number, RGB, shape [rows, columns, 3]."""
        if self._noise == 0.0:
            return np.asarray(cv2.LUT(rendered, self._levels), np.uint8)
        rows, columns = rendered.shape[:2]
        exposed = np.empty_like(rendered)
        places = np.random.default_rng([self._seed, index]).integers(
            0, _NOISE_PLAY, (-(-rows // _BAND_ROWS), 2)
        )
        for band, (down, across) in enumerate(places):
            part = slice(band * _BAND_ROWS, min((band + 1) * _BAND_ROWS, rows))
            roots = np.asarray(cv2.LUT(rendered[part], self._roots), np.int16)
            noise = self._field[down : down + len(roots), across : across + columns]
            cv2.add(roots, noise, dst=roots)
            np.maximum(roots, 0, out=roots)
            cv2.multiply(roots, roots, dst=exposed[part], scale=self._scale, dtype=cv2.CV_8U)
        return exposed
