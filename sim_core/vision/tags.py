"""The AprilTags on the packages: found in a picture by their numbers, with their corners to a fraction of a pixel."""

import cv2
import numpy as np
from numpy.typing import NDArray

from config.scene import Scene
from sim_core.camera.layout import markers_of, side_of
from sim_core.frames import Array
from sim_core.vision.faces import Face, placed
from sim_core.vision.plane import Sight, undistorted

Grey = NDArray[np.uint8]
Region = tuple[int, int, int, int]

CORNERS_A_PACKAGE = 8
LEAST_SIZE, LARGEST_SIZE = 0.6, 1.5
"""Sizes of a tag in the picture, as shares of what is expected on the faces."""


class TagTracker:
    """Reads the tags of the packages that the camera sees.

    Args:
        scene: a resolved scene whose camera has markers.
        faces: the faces that carry them.
        pixel_m: about the size of a pixel on the faces [m].
    """

    def __init__(self, scene: Scene, faces: list[Face], pixel_m: float) -> None:
        assert scene.camera is not None and scene.camera.markers is not None
        self._side = side_of(scene)
        markers = markers_of(scene)
        corners = np.array([placed(scene, marker.package, marker.corners) for marker in markers])
        self._depths = (corners @ self._side.normal).ravel()
        edge_px = float(np.median(np.linalg.norm(corners[:, 1] - corners[:, 0], axis=1))) / pixel_m
        parameters = cv2.aruco.DetectorParameters()
        window = max(5, 2 * round(edge_px / 6.0) + 1)
        parameters.adaptiveThreshWinSizeMin = window
        parameters.adaptiveThreshWinSizeMax = window
        parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
        parameters.cornerRefinementWinSize = max(2, round(edge_px / 12.0))
        self._edge_px, self._parameters = edge_px, parameters
        name = f"DICT_{scene.camera.markers.dictionary.replace('apriltag', 'APRILTAG')}"
        self._detector = cv2.aruco.ArucoDetector(
            cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name)), parameters
        )
        self._number = {marker.tag: number for number, marker in enumerate(markers)}
        rows = {face.row: number for number, face in enumerate(faces)}
        owners = np.array([rows[marker.package] for marker in markers])
        # The first tag of a package has places 0 to 3 of its row, the second 4 to 7.
        second = np.array([number > 0 and owners[number - 1] == owner for number, owner in enumerate(owners)])
        self._row_of = np.repeat(owners, 4)
        self._place_of = (4 * second[:, None] + np.arange(4)).ravel()
        self._count = len(faces)
        self._sum = np.zeros((4 * len(markers), 2))
        self._taken = np.zeros((4 * len(markers), 1))

    def refer(self, grey: Grey, sight: Sight, region: Region) -> None:
        """Takes a picture of the load as it stands before the start; several are averaged."""
        rays = self._rays(grey, sight, region)
        seen = np.isfinite(rays).all(axis=1, keepdims=True)
        self._sum += np.where(seen, np.nan_to_num(rays), 0.0)
        self._taken += seen

    def before(self, sight: Sight) -> Array:
        """Where the corners are on the standing load, along right and up [m], shape [n, 8, 2]; NaN where not read."""
        mean = np.where(self._taken > 0, self._sum / np.maximum(self._taken, 1), np.nan)
        return self._sorted(sight.on_plane(mean, self._side, self._depths, 0.0))

    def find(self, grey: Grey, sight: Sight, travel_m: float, region: Region) -> Array:
        """Where the tags' corners are, at the depth that they had, along right and up [m], shape [n, 8, 2].

        Args:
            grey: the picture.
            sight: the camera.
            travel_m: of the sled.
            region: where to look: left, top, right and bottom [px].
        """
        return self._sorted(
            sight.on_plane(self._rays(grey, sight, region), self._side, self._depths, travel_m)
        )

    def _sorted(self, places: Array) -> Array:
        """Places of all tags' corners by package, shape [4·tags, 2] to [n, 8, 2]."""
        by_package = np.full((self._count, CORNERS_A_PACKAGE, 2), np.nan)
        by_package[self._row_of, self._place_of] = places
        return by_package

    def _rays(self, grey: Grey, sight: Sight, region: Region) -> Array:
        """Undistorted rays of all tags' corners, shape [4·tags, 2]; NaN where not found."""
        pixels = self._read(grey, region).reshape(-1, 2)
        return undistorted(pixels, sight.view.matrix, sight.view.distortion)

    def _read(self, grey: Grey, region: Region) -> Array:
        """Corners of every tag [px], shape [tag_count, 4, 2], clockwise from the upper left; NaN where not found."""
        corners = np.full((len(self._number), 4, 2), np.nan)
        left, top, right, bottom = region
        if right - left < 8 or bottom - top < 8:
            return corners
        # Outlines far from a tag's size are no tags; the rate is a share of the picture's longer edge.
        rate = 4.0 * self._edge_px / max(right - left, bottom - top)
        self._parameters.minMarkerPerimeterRate = LEAST_SIZE * rate
        self._parameters.maxMarkerPerimeterRate = LARGEST_SIZE * rate
        self._detector.setDetectorParameters(self._parameters)
        found, tags, _ = self._detector.detectMarkers(np.ascontiguousarray(grey[top:bottom, left:right]))
        if tags is None:
            return corners
        numbers = [int(tag) for tag in np.ravel(tags)]
        for quad, tag in zip(found, numbers, strict=True):
            # One number in two places: neither can be trusted.
            if tag in self._number and numbers.count(tag) == 1:
                corners[self._number[tag]] = quad.reshape(4, 2) + np.array([left, top])
        return corners
