"""The pictures that tell a test: before the start, where the load leans most, and at the end."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from sim_core.camera.jpeg import jpeg_of
from sim_core.camera.source import Picture

SHOWN_WIDTH_PX, SHOWN_QUALITY = 960, 85


@dataclass(frozen=True)
class KeyPicture:
    """One of them.

    Attributes:
        name: ``start``, ``peak`` or ``end``.
        time_s: since the first picture [s].
        jpeg: the picture, made small enough for a page.
        width_px: its width.
        height_px: its height.
    """

    name: str
    time_s: float
    jpeg: bytes
    width_px: int
    height_px: int


def key_pictures(pictures: Sequence[Picture], rules: Sequence[dict[str, Any]]) -> tuple[KeyPicture, ...]:
    """Start, peak and end of a test.

    Args:
        pictures: all pictures of a test, in order.
        rules: the rule entries of its report: the peak is that of the elastic rule.
    """
    if not pictures:
        return ()
    times = [(picture.stamp_ns - pictures[0].stamp_ns) * 1.0e-9 for picture in pictures]
    peak_s = next((rule["time_s"] for rule in rules if rule["rule"] == "elastic"), None) or 0.0
    peak = min(range(len(times)), key=lambda k: abs(times[k] - peak_s))
    chosen = {"start": 0, "peak": peak, "end": len(pictures) - 1}
    return tuple(_shown(name, times[index], pictures[index]) for name, index in chosen.items())


def _shown(name: str, time_s: float, picture: Picture) -> KeyPicture:
    height, width = picture.pixels.shape[:2]
    if width <= SHOWN_WIDTH_PX:
        return KeyPicture(name, time_s, picture.jpeg, width, height)
    size = SHOWN_WIDTH_PX, round(height * SHOWN_WIDTH_PX / width)
    small = np.asarray(cv2.resize(picture.pixels, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    return KeyPicture(name, time_s, jpeg_of(small, quality=SHOWN_QUALITY), *size)
