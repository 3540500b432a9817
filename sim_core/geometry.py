"""Boxes in space: corners, quaternions, and how deep two upright boxes overlap."""

import numpy as np

from config.package import Package
from sim_core.frames import Array

CORNER_SIGNS: Array = np.array(
    [[1.0 if corner >> axis & 1 else -1.0 for axis in range(3)] for corner in range(8)]
)
"""Corner c of a box, shape [8, 3]: bit 0 of c is +x, bit 1 is +y, bit 2 is +z."""


def yaw_quaternion(yaw_deg: float) -> tuple[float, float, float, float]:
    """Unit quaternion x, y, z, w of a turn about z, counter-clockwise from above."""
    half = np.deg2rad(yaw_deg) / 2.0
    return 0.0, 0.0, float(np.sin(half)), float(np.cos(half))


def rotation_matrices(orientations: Array) -> Array:
    """Rotation matrices of unit quaternions x, y, z, w: shape [n, 4] to [n, 3, 3]."""
    x, y, z, w = orientations.T
    return np.stack(
        [
            1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w),
            2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w),
            2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y),
        ],
        axis=1,
    ).reshape(-1, 3, 3)  # fmt: skip


def box_corners(positions: Array, orientations: Array, half_sizes: Array) -> Array:
    """Corners of boxes [m], shape [n, 8, 3], in the frame of the positions.

    Args:
        positions: centres [m], shape [n, 3].
        orientations: unit quaternions x, y, z, w, shape [n, 4].
        half_sizes: half edge lengths along each box's own axes [m], shape [n, 3].
    """
    local = half_sizes[:, None, :] * CORNER_SIGNS[None, :, :]
    corners: Array = positions[:, None, :] + local @ rotation_matrices(orientations).transpose(0, 2, 1)
    return corners


def turned_by_half_step(orientations: Array, angular_velocities: Array, step_s: float) -> Array:
    """Orientations moved back by half a step: q − ½·h·q̇, normalised, with q̇ = ½·ω·q.

    Args:
        orientations: unit quaternions x, y, z, w, shape [n, 4].
        angular_velocities: [rad/s], shape [n, 3], in the fixed frame.
        step_s: the step h [s].
    """
    vector, scalar = orientations[:, :3], orientations[:, 3:]
    rate = np.empty_like(orientations)
    rate[:, :3] = 0.5 * (scalar * angular_velocities + np.cross(angular_velocities, vector))
    rate[:, 3] = -0.5 * np.einsum("ij,ij->i", angular_velocities, vector)
    moved = orientations - 0.5 * step_s * rate
    normalised: Array = moved / np.linalg.norm(moved, axis=1, keepdims=True)
    return normalised


def footprint(package: Package) -> Array:
    """The four corners of an upright package's outline [m], shape [4, 2], in order around it."""
    angle = np.deg2rad(package.yaw_deg)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    half = 0.5 * np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * np.array(package.size_m[:2])
    corners: Array = half @ turn.T + np.array(package.position_m[:2])
    return corners


def height_span(package: Package) -> tuple[float, float]:
    """Bottom and top of an upright package [m]."""
    centre, height = package.position_m[2], package.size_m[2]
    return centre - height / 2.0, centre + height / 2.0


def overlap_depth(first: Package, second: Package) -> float:
    """How deep two upright boxes overlap [m]; negative is the gap along the best separating axis.

    Separating-axis test: for upright boxes the candidates are z and the two face normals of each.
    """
    low_a, high_a = height_span(first)
    low_b, high_b = height_span(second)
    depth = min(high_a, high_b) - max(low_a, low_b)
    outline_a, outline_b = footprint(first), footprint(second)
    for outline in (outline_a, outline_b):
        for edge in (outline[1] - outline[0], outline[2] - outline[1]):
            axis = edge / np.hypot(*edge)
            along_a, along_b = outline_a @ axis, outline_b @ axis
            depth = min(depth, float(min(along_a.max(), along_b.max()) - max(along_a.min(), along_b.min())))
    return depth


def polygon_area(polygon: Array) -> float:
    """Area of a simple polygon [m²], shape [n, 2] (shoelace formula)."""
    x, y = polygon[:, 0], polygon[:, 1]
    return float(0.5 * abs(x @ np.roll(y, -1) - y @ np.roll(x, -1)))


def clip_convex(subject: Array, window: Array) -> Array:
    """Intersection of two convex polygons, counter-clockwise, shape [n, 2] (Sutherland-Hodgman)."""
    for start, end in zip(window, np.roll(window, -1, axis=0), strict=True):
        if not len(subject):
            break
        edge = end - start
        side = edge[0] * (subject[:, 1] - start[1]) - edge[1] * (subject[:, 0] - start[0])
        kept: list[Array] = []
        for i in range(len(subject)):
            j = (i + 1) % len(subject)
            if side[i] >= 0.0:
                kept.append(subject[i])
            if (side[i] >= 0.0) != (side[j] >= 0.0):
                kept.append(subject[i] + (subject[j] - subject[i]) * side[i] / (side[i] - side[j]))
        subject = np.array(kept).reshape(-1, 2)
    return subject
