"""Many pictures on one sheet, so that one draw call shows them all."""

import cv2
import numpy as np
from numpy.typing import NDArray

from sim_core.camera.meshes import Mesh
from sim_core.frames import Array

Picture = NDArray[np.uint8]

GUTTER_PX = 2
"""A picture's edge goes on for so far, so that filtering never sees its neighbour."""
_SHEET_PX = 4096


class Atlas:
    """Pictures in the order in which they were added; number 0 is plain white."""

    def __init__(self) -> None:
        self._pictures: list[Picture] = [np.full((4, 4, 3), 255, np.uint8)]
        self._known: dict[tuple[tuple[int, ...], bytes], int] = {}

    def add(self, picture: Picture) -> int:
        """Takes an RGB picture and gives its number: the same one for the same picture."""
        key = (picture.shape, picture.tobytes())
        if key not in self._known:
            self._known[key] = len(self._pictures)
            self._pictures.append(picture)
        return self._known[key]

    def sheet(self) -> tuple[Picture, Array]:
        """All pictures on one sheet.

        Returns:
            The sheet, RGB, its first row at the top, and each picture's left, top, width and height on it as shares
            of the sheet, shape [n, 4].
        """
        # Shelves: the tallest first, from left to right, so that little is lost above the lower ones.
        places = np.zeros((len(self._pictures), 2), dtype=int)
        sizes = np.array([picture.shape[:2] for picture in self._pictures]) + 2 * GUTTER_PX
        width = max(_SHEET_PX, int(sizes[:, 1].max())) if sizes.prod(axis=1).sum() > 2**20 else 1024
        width = max(width, int(sizes[:, 1].max()))
        left = top = height = 0
        for number in np.argsort(-sizes[:, 0], kind="stable"):
            if left + sizes[number, 1] > width:
                left, top, height = 0, top + height, 0
            places[number] = top, left
            left += int(sizes[number, 1])
            height = max(height, int(sizes[number, 0]))
        sheet = np.zeros((top + height, width, 3), np.uint8)
        for picture, (row, column), (rows, columns) in zip(self._pictures, places, sizes, strict=True):
            sheet[row : row + rows, column : column + columns] = cv2.copyMakeBorder(
                picture, GUTTER_PX, GUTTER_PX, GUTTER_PX, GUTTER_PX, cv2.BORDER_REPLICATE
            )
        extent = np.array([width, top + height])
        inner = sizes - 2 * GUTTER_PX
        return sheet, np.hstack(((places[:, ::-1] + GUTTER_PX) / extent, inner[:, ::-1] / extent))


def on_sheet(mesh: Mesh, shares: Array) -> Array:
    """Texture coordinates of a mesh's vertices, 0 to 1 from the sheet's left and upper edge, shape [n, 2]."""
    own = shares[mesh.pictures]
    places: Array = own[:, :2] + mesh.places * own[:, 2:]
    return places
