"""Pictures as laboratories show them: where the load stood, how far its corners went, and what the limits are."""

from typing import TYPE_CHECKING

import cv2
import numpy as np
from numpy.typing import NDArray

from sim_core.frames import Array
from sim_core.vision.verdict import COVERAGE, load_height

if TYPE_CHECKING:
    from sim_core.vision.measure import DisplacementMeasurer, Measurement

Picture = NDArray[np.uint8]

RED, PALE, INK, PAPER = (230, 30, 30), (120, 220, 255), (20, 22, 26), (250, 250, 250)
LEAST_SHOWN_M = 1.0e-3
"""Shorter displacements get no line and no figure."""
_FINE = 16
"""Parts of a pixel that OpenCV draws to: four bits."""
_FONT = cv2.FONT_HERSHEY_SIMPLEX


def annotated(
    picture: Picture,
    measurer: "DisplacementMeasurer",
    measurement: "Measurement",
    *,
    exaggeration: float = 1.0,
) -> Picture:
    """A copy of a picture with the measured displacement drawn on it.

    Thin outlines show where the packages stood, as the sled stands now; red lines lead from their corners to where
    these are. The largest displacement is ringed, with its figure and its expanded uncertainty.

    Args:
        picture: RGB, shape [height, width, 3].
        measurer: that took the picture.
        measurement: what it said.
        exaggeration: how many times longer than they are displacements are drawn; figures stay as they are.

    Returns:
        RGB, shape [height, width, 3].
    """
    drawn = picture.copy()
    scale = picture.shape[0] / 1080.0
    thick = max(1, round(2.0 * scale))
    corners = np.array([face.corners for face in measurer.faces])
    moved = measurement.displacement[:, 1:]
    now = corners + exaggeration * (
        moved[..., :1] * measurer.side.right + moved[..., 1:] * np.array([0.0, 0.0, 1.0])
    )
    stood, stands = (_pixels(measurer, measurement, points) for points in (corners, now))
    for outline in stood:
        cv2.polylines(drawn, [_fine(outline)], True, PALE, 1, cv2.LINE_AA, 4)
    far = np.linalg.norm(moved, axis=2)
    for start, end, distance in zip(stood, stands, far, strict=True):
        for a, b, length in zip(_fine(start), _fine(end), distance, strict=True):
            if np.isfinite(length) and length >= LEAST_SHOWN_M:
                cv2.line(drawn, a.tolist(), b.tolist(), RED, thick, cv2.LINE_AA, 4)
    if np.isfinite(far).any() and np.nanmax(far) >= LEAST_SHOWN_M:
        row, corner = np.unravel_index(int(np.nanargmax(far)), far.shape)
        _ring(drawn, stands[row, corner], f"{1000.0 * far[row, corner]:.1f} mm", scale)
    _panel(drawn, _words(measurer, measurement, far, exaggeration), scale)
    return drawn


def _words(
    measurer: "DisplacementMeasurer", measurement: "Measurement", far: Array, exaggeration: float
) -> list[str]:
    """Time, largest displacement, limits, and what is not seen."""
    limits, height = measurer.scene.limits, load_height(measurer.scene)
    words = [f"t = {measurement.time_s:.3f} s    sled {measurement.sled_m:.3f} m"]
    if np.isfinite(far).any():
        row, corner = np.unravel_index(int(np.nanargmax(far)), far.shape)
        spread = float(np.linalg.norm(measurement.sigma[row, corner + 1])) / np.sqrt(2.0)
        words.append(
            f"largest {1000.0 * far[row, corner]:.1f} +- {1000.0 * COVERAGE * spread:.1f} mm,"
            f" package {measurer.faces[row].id}"
        )
    words.append(
        f"EUMOS 40509: elastic {1000.0 * limits.elastic_fraction * height:.0f} mm,"
        f" permanent {1000.0 * limits.permanent_fraction * height:.0f} mm,"
        f" on pallet {1000.0 * limits.base_permanent_m:.0f} mm"
    )
    missing = [
        face.id for face, state in zip(measurer.faces, measurement.states, strict=True) if state != "tracked"
    ]
    if missing:
        more = f" and {len(missing) - 4} more" if len(missing) > 4 else ""
        words.append(f"not tracked: {', '.join(missing[:4])}{more}")
    if exaggeration != 1.0:
        words.append(f"displacements drawn {exaggeration:g} times")
    return words


def _pixels(measurer: "DisplacementMeasurer", measurement: "Measurement", points: Array) -> Array:
    """Pixels of points of frame ``sled``, shape [n, 4, 3] to [n, 4, 2]."""
    flat = measurer.finder.sight.project(points.reshape(-1, 3), measurement.sled_m)
    return flat.reshape(len(points), 4, 2)


def _fine(points: Array) -> NDArray[np.int32]:
    """Pixels in the parts that OpenCV draws to, within what it can count."""
    return np.round(np.clip(np.nan_to_num(points), -1.0e4, 1.0e4) * _FINE).astype(np.int32)


def _ring(drawn: Picture, place: Array, words: str, scale: float) -> None:
    """A ring around a place, with words beside it on the side where there is room."""
    radius = round(12 * scale * _FINE)
    x, y = _fine(place).tolist()
    for colour, thick in ((PAPER, 4), (RED, 2)):
        cv2.circle(drawn, (x, y), radius, colour, max(1, round(thick * scale)), cv2.LINE_AA, 4)
    size, thick = 0.8 * scale, max(1, round(2 * scale))
    (wide, tall), _ = cv2.getTextSize(words, _FONT, size, thick)
    left = x // _FINE + round(18 * scale)
    if left + wide > drawn.shape[1]:
        left = x // _FINE - round(18 * scale) - wide
    at = (
        int(np.clip(left, 0, max(drawn.shape[1] - wide, 0))),
        int(np.clip(y // _FINE - 14 * scale, tall, drawn.shape[0] - 1)),
    )
    edge = round(5 * scale)
    corners = (at[0] - edge, at[1] - tall - edge), (at[0] + wide + edge, at[1] + edge)
    cv2.rectangle(drawn, *corners, PAPER, cv2.FILLED)
    cv2.putText(drawn, words, at, _FONT, size, RED, thick, cv2.LINE_AA)


def _panel(drawn: Picture, words: list[str], scale: float) -> None:
    """Words in the upper left corner, on a dark ground."""
    size, thick, step, edge = 0.75 * scale, max(1, round(1.5 * scale)), round(34 * scale), round(16 * scale)
    wide = max(cv2.getTextSize(line, _FONT, size, thick)[0][0] for line in words) + 2 * edge
    tall = len(words) * step + edge
    ground = drawn[:tall, :wide]
    ground[:] = (0.35 * ground + 0.65 * np.array(INK)).astype(np.uint8)
    for number, line in enumerate(words):
        cv2.putText(drawn, line, (edge, (number + 1) * step), _FONT, size, PAPER, thick, cv2.LINE_AA)
