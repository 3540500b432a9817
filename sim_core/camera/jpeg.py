"""JPEG, the form in which pictures are recorded: the same picture gives the same bytes."""

import cv2
import numpy as np
from numpy.typing import NDArray

from config.errors import BrokenRecording

QUALITY = 95
"""Below what moves an edge by a tenth of a pixel, at a tenth of the bytes."""


def jpeg_of(picture: NDArray[np.uint8], *, quality: int = QUALITY) -> bytes:
    """JPEG of an RGB picture, shape [height, width, 3]."""
    _, encoded = cv2.imencode(
        ".jpg", cv2.cvtColor(picture, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, quality]
    )
    return encoded.tobytes()


def picture_of(encoded: bytes) -> NDArray[np.uint8]:
    """RGB picture of a JPEG, or of any other format that OpenCV reads, shape [height, width, 3].

    Raises:
        BrokenRecording: it is none.
    """
    found = cv2.imdecode(np.frombuffer(encoded, np.uint8), cv2.IMREAD_COLOR) if encoded else None
    if found is None:
        raise BrokenRecording("camera/image_raw/compressed.data", encoded[:8].hex(), "is not a picture")
    return np.asarray(cv2.cvtColor(found, cv2.COLOR_BGR2RGB), dtype=np.uint8)
