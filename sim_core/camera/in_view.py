"""Whether the camera sees what it is there for, before anything is drawn."""

from collections.abc import Iterator

import numpy as np

from config.scene import Scene
from sim_core.camera.layout import facing_packages, markers_of, side_of, targets_of
from sim_core.camera.view import view_of
from sim_core.frames import Array
from sim_core.geometry import box_corners, yaw_quaternion
from sim_core.integrity import Finding

LEAST_TAG_PX = 16.0
"""A tag of 8 × 8 cells is read down to two pixels a cell."""


def camera_findings(scene: Scene) -> Iterator[Finding]:
    """What is remarkable about a scene's camera.

    Args:
        scene: a resolved scene that has a camera.

    Raises:
        RefusedInput: the camera stands where it aims, inside the load, or its distortion folds the picture.
    """
    view, side = view_of(scene), side_of(scene)
    travelled = [travel * side.right for travel in side.travel_m]
    seen = {"targets": targets_of(scene), "load": _corners(scene)}
    for what, points in seen.items():
        pixels = np.vstack([view.project(points + way) for way in travelled])
        inside = (pixels >= 0.0) & (pixels <= [view.width - 1, view.height - 1])
        if not inside.all():
            missing = 100.0 * (1.0 - inside.all(axis=1).mean())
            limit = "leave out camera.focal_length_mm and camera.aim_m to see the whole travel"
            yield Finding("warning", "camera", f"the {what}", f"{missing:.0f} % out of the picture", limit)
    if not scene.packages:
        return
    if not facing_packages(scene):
        yield Finding(
            "warning", "camera", "the load", "no side within 30° of the camera", "nothing to measure"
        )
    markers = markers_of(scene)
    if markers:
        middle = np.array([marker.corners for marker in markers])
        edge_m = float(np.linalg.norm(middle[:, 1] - middle[:, 0], axis=1).min())
        edge_px = edge_m * view.matrix[0, 0] / float(view.in_optical(side.point(0.0, 0.5)[None])[0, 2])
        if edge_px < LEAST_TAG_PX:
            limit = f"{LEAST_TAG_PX:.0f} px or more: larger camera.markers.size_m, more pixels, or a nearer camera"
            yield Finding("warning", "camera", "the smallest tag", f"{edge_px:.1f} px", limit)


def _corners(scene: Scene) -> Array:
    if not scene.packages:
        return np.zeros((0, 3))
    return box_corners(
        np.array([package.position_m for package in scene.packages]),
        np.array([yaw_quaternion(package.yaw_deg) for package in scene.packages]),
        0.5 * np.array([package.size_m for package in scene.packages]),
    ).reshape(-1, 3)
