"""The camera as geometry: where it stands, and where on its picture a point in space falls.

Pinhole with OpenCV's ``plumb_bob`` distortion (docs.opencv.org, "Camera Calibration and 3D Reconstruction"): with
x = X/Z, y = Y/Z, r² = x² + y² in the optical frame (x right, y down, z forward)

    x' = x·(1 + k1·r² + k2·r⁴ + k3·r⁶) + 2·p1·x·y + p2·(r² + 2·x²)
    y' = y·(1 + k1·r² + k2·r⁴ + k3·r⁶) + p1·(r² + 2·y²) + 2·p2·x·y
    u = f·x' + cx,  v = f·y' + cy

Pixel (0, 0) is the middle of the upper left pixel.
"""

import math
from dataclasses import dataclass

import numpy as np

from config.camera import Camera
from config.errors import RefusedInput
from config.scene import Scene
from sim_core.camera.layout import BOARD_BOTTOM_M, BOARD_OVERHANG_M, side_of
from sim_core.camera.moments import PictureMoments
from sim_core.frames import Array

MARGIN = 1.04
"""How much wider than its contents a picture is, where the camera chooses its focal length."""


@dataclass(frozen=True, eq=False)
class CameraView:
    """A calibrated camera that stands still.

    Attributes:
        width: of the picture [px].
        height: of the picture [px].
        matrix: intrinsics K, shape [3, 3].
        distortion: k1, k2, p1, p2, k3, shape [5].
        rotation: turns vectors of frame ``world`` into the optical frame, shape [3, 3].
        translation: of the same transformation [m], shape [3].
    """

    width: int
    height: int
    matrix: Array
    distortion: Array
    rotation: Array
    translation: Array

    @property
    def position(self) -> Array:
        """Place of the lens in frame ``world`` [m], shape [3]."""
        return -self.rotation.T @ self.translation

    def in_optical(self, points_world: Array) -> Array:
        """Points of frame ``world`` in the optical frame [m], shape [n, 3]."""
        return points_world @ self.rotation.T + self.translation

    def distorted(self, rays: Array) -> Array:
        """Pixels of rays x = X/Z, y = Y/Z, shape [n, 2] to [n, 2]."""
        k1, k2, p1, p2, k3 = self.distortion
        x, y = rays[:, 0], rays[:, 1]
        r2 = x * x + y * y
        radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
        bent = np.column_stack(
            (
                x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
                y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
            )
        )
        focal, centre = self.matrix[[0, 1], [0, 1]], self.matrix[:2, 2]
        pixels: Array = bent * focal + centre
        return pixels

    def project(self, points_world: Array) -> Array:
        """Pixels of points in frame ``world``, shape [n, 3] to [n, 2]; NaN for points behind the lens."""
        points = self.in_optical(np.asarray(points_world, dtype=float))
        depth = np.where(points[:, 2] > 0.0, points[:, 2], np.nan)
        return self.distorted(points[:, :2] / depth[:, None])


def view_of(scene: Scene) -> CameraView:
    """The view of the scene's camera.

    Args:
        scene: a resolved scene that has a camera.

    Raises:
        RefusedInput: the camera stands where it aims, or its distortion folds the picture.
    """
    camera = scene.camera
    assert camera is not None
    side = side_of(scene)
    low, high = BOARD_BOTTOM_M, side.top_m
    middle = 0.5 * (side.left_m + side.right_m + sum(side.travel_m))
    seen = side.point(middle, 0.5 * (low + high))
    position = (
        np.array(camera.position_m)
        if camera.position_m is not None
        else seen + camera.distance_m * side.normal
    ) + np.array(camera.position_offset_m)
    aim = (np.array(camera.aim_m) if camera.aim_m is not None else seen) + np.array(camera.aim_offset_m)
    rotation = _looking(position, aim)
    half_span = 0.5 * (side.right_m - side.left_m + side.travel_m[1] - side.travel_m[0]) + BOARD_OVERHANG_M
    corners = np.array(
        [
            seen + sign * half_span * side.right + np.array([0.0, 0.0, rise * 0.5 * (high - low)])
            for sign in (-1.0, 1.0)
            for rise in (-1.0, 1.0)
        ]
    )
    focal = camera.zoom * _focal_px(camera, (corners - position) @ rotation.T)
    width, height = camera.width_px, camera.height_px
    matrix = np.array([[focal, 0.0, 0.5 * (width - 1)], [0.0, focal, 0.5 * (height - 1)], [0.0, 0.0, 1.0]])
    view = CameraView(width, height, matrix, np.array(camera.distortion), rotation, -rotation @ position)
    _require_single_valued(view)
    return view


def _looking(position: Array, aim: Array) -> Array:
    """Rotation from ``world`` to the optical frame of a level camera."""
    forward = aim - position
    distance = float(np.linalg.norm(forward))
    if distance < 1.0e-3:
        raise RefusedInput("camera.aim_m", tuple(aim), "must be another point than position_m")
    forward = forward / distance
    # Straight up or down, the picture's right is the bench's x.
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right = right / np.linalg.norm(right) if np.linalg.norm(right) > 1.0e-6 else np.array([1.0, 0.0, 0.0])
    return np.array([right, np.cross(forward, right), forward])


def _focal_px(camera: Camera, corners: Array) -> float:
    if camera.focal_length_mm is not None:
        return camera.focal_length_mm / camera.sensor_width_mm * camera.width_px
    if (corners[:, 2] <= 0.05).any():
        raise RefusedInput(
            "camera.position_m", camera.position_m, "must see the load from outside, or name focal_length_mm"
        )
    rays = np.abs(corners[:, :2] / corners[:, 2:]).max(axis=0) * MARGIN
    return float(min(0.5 * camera.width_px / rays[0], 0.5 * camera.height_px / rays[1]))


def _require_single_valued(view: CameraView) -> None:
    """Refuses a distortion under which two rays of the picture meet in one pixel."""
    k1, k2, _, _, k3 = view.distortion
    reach = math.hypot(0.5 * view.width, 0.5 * view.height) / view.matrix[0, 0]
    radii = np.linspace(0.0, 1.3 * reach, 400)
    bent = radii * (1.0 + k1 * radii**2 + k2 * radii**4 + k3 * radii**6)
    inside = np.concatenate(([0.0], bent[:-1])) < reach
    if (np.diff(bent) <= 0.0)[inside[1:]].any() or bent[-1] < reach:
        raise RefusedInput(
            "camera.distortion",
            tuple(map(float, view.distortion)),
            "smaller: it folds the picture at this focal length",
        )


def camera_entry(scene: Scene) -> dict[str, object]:
    """The report's figures of the scene's camera.

    Args:
        scene: a resolved scene that has a camera.
    """
    camera = scene.camera
    assert camera is not None
    view, side = view_of(scene), side_of(scene)
    focal_px = float(view.matrix[0, 0])
    distance = float(view.position @ side.normal) - side.near_m
    return {
        "width_px": view.width,
        "height_px": view.height,
        "rate_hz": PictureMoments(scene).rate_hz,
        "focal_length_mm": focal_px * camera.sensor_width_mm / camera.width_px,
        "position_m": view.position.tolist(),
        "distance_m": distance,
        "mm_per_px": 1000.0 * distance / focal_px,
    }
