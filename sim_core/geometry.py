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
    # Row by row the same sums whatever the number of rows: a matrix product might round them otherwise.
    products = orientations[:, _FIRST] * orientations[:, _SECOND]
    entries: Array = np.einsum("np,pe->ne", products, _PRODUCTS_TO_MATRIX) + np.eye(3).ravel()
    return entries.reshape(-1, 3, 3)


def _products_to_matrix() -> Array:
    """How the nine entries of a rotation matrix less the identity are made of products of components."""
    x, y, z, w = range(4)
    terms = {
        (0, 0): [(y, y, -2.0), (z, z, -2.0)], (0, 1): [(x, y, 2.0), (z, w, -2.0)],
        (0, 2): [(x, z, 2.0), (y, w, 2.0)], (1, 0): [(x, y, 2.0), (z, w, 2.0)],
        (1, 1): [(x, x, -2.0), (z, z, -2.0)], (1, 2): [(y, z, 2.0), (x, w, -2.0)],
        (2, 0): [(x, z, 2.0), (y, w, -2.0)], (2, 1): [(y, z, 2.0), (x, w, 2.0)],
        (2, 2): [(x, x, -2.0), (y, y, -2.0)],
    }  # fmt: skip
    pairs = list(zip(_FIRST.tolist(), _SECOND.tolist(), strict=True))
    matrix = np.zeros((len(pairs), 9))
    for (row, column), entries in terms.items():
        for first, second, factor in entries:
            matrix[pairs.index((first, second)), 3 * row + column] = factor
    return matrix


def _products_to_rate() -> Array:
    """How q̇ = ½·ω·q is made of the products of q's components x, y, z, w with those of ω."""
    matrix = np.zeros((4, 3, 4))
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        # ½·(w·ω + ω × v) for the vector part, −½·ω·v for the scalar.
        matrix[3, i, i] = 0.5
        matrix[k, j, i] = 0.5
        matrix[j, k, i] = -0.5
        matrix[i, i, 3] = -0.5
    return matrix.reshape(12, 4)


_FIRST, _SECOND = np.triu_indices(4)
_PRODUCTS_TO_MATRIX = _products_to_matrix()
_PRODUCTS_TO_RATE = _products_to_rate()


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
    products = (orientations[:, :, None] * angular_velocities[:, None, :]).reshape(-1, 12)
    rate = np.einsum("np,pk->nk", products, _PRODUCTS_TO_RATE)
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
