"""What the camera looks at: the load's side, the sled's targets in front of it, and the markers on the packages.

Renderer and measurement share these places, as a laboratory knows where it put its targets.
"""

from dataclasses import dataclass

import numpy as np

from config.scene import Scene
from sim_core.frames import Array
from sim_core.geometry import box_corners, footprint, height_span, yaw_quaternion
from sim_core.sled import build_profile

TARGET_RADIUS_M = 0.035
"""Radius of a quadrant target on the sled's board."""
BOARD_TOP_M, BOARD_BOTTOM_M = -0.02, -0.22
BOARD_GAP_M = 0.03
"""How far the board with the targets stands before the load's near side."""
BOARD_OVERHANG_M = 0.25
TARGET_SPACING_M = 0.25
RUN_ON_S = 0.5
LONGEST_SEEN_M = 8.0
"""Of the travel: a sled that goes on leaves the picture."""
_FACING = np.cos(np.deg2rad(30.0))


@dataclass(frozen=True)
class Side:
    """The side of load and sled that the camera sees, in frame ``sled``.

    Attributes:
        normal: unit vector out of the load, towards the camera, shape [3].
        right: unit vector to the right in the picture, shape [3].
        near_m: how far along ``normal`` the foremost face of load and pallet stands [m].
        left_m: least place of load and pallet along ``right`` [m].
        right_m: greatest place along ``right`` [m].
        top_m: the load's height [m].
        travel_m: least and greatest travel of the sled along ``right`` that is looked at [m].
    """

    normal: Array
    right: Array
    near_m: float
    left_m: float
    right_m: float
    top_m: float
    travel_m: tuple[float, float]

    def point(self, along_m: float, height_m: float, depth_m: float | None = None) -> Array:
        """A point of frame ``sled`` [m], shape [3], by its place in the picture's plane and along the normal."""
        depth = self.near_m if depth_m is None else depth_m
        place: Array = along_m * self.right + depth * self.normal + np.array([0.0, 0.0, height_m])
        return place


@dataclass(frozen=True)
class Marker:
    """A tag on a package.

    Attributes:
        tag: its number in the dictionary.
        package: row of the package in a pose frame: 1 is the scene's first.
        corners: of the black square in the package's own frame [m], shape [4, 3]; clockwise as the camera sees them,
            from the upper left one.
        sheet: of the white sheet around it, in the same order [m], shape [4, 3].
    """

    tag: int
    package: int
    corners: Array
    sheet: Array


def side_of(scene: Scene) -> Side:
    """The side of the load that the camera sees: the one on the right of the travel.

    Args:
        scene: a resolved scene.
    """
    travel = _travel(scene)
    ends = travel[np.argmax(np.abs(travel).sum(axis=1))]
    ahead = ends / np.linalg.norm(ends) if np.linalg.norm(ends) > 1.0e-9 else np.array([1.0, 0.0, 0.0])
    rightwards = np.array([ahead[1], -ahead[0], 0.0])
    sides = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
    normal = sides[np.argmax(np.round(sides @ rightwards, 9))]
    right = np.array([-normal[1], normal[0], 0.0])
    outline = [footprint(package) for package in scene.packages]
    top = max((height_span(package)[1] for package in scene.packages), default=0.0)
    pallet = scene.pallet_box
    if pallet is not None:
        half = 0.5 * np.array(pallet.size_m[:2])
        outline.append(half * np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]))
        top = max(top, pallet.size_m[2])
    points = np.vstack(outline) if outline else np.array([[-0.6, -0.4], [0.6, 0.4]])
    along, depth = points @ right[:2], points @ normal[:2]
    moved = np.clip(travel @ right, -LONGEST_SEEN_M, LONGEST_SEEN_M)
    return Side(
        normal=normal,
        right=right,
        near_m=float(depth.max()),
        left_m=float(along.min()),
        right_m=float(along.max()),
        top_m=max(top, 0.1),
        travel_m=(float(min(moved.min(), 0.0)), float(max(moved.max(), 0.0))),
    )


def targets_of(scene: Scene) -> Array:
    """Centres of the quadrant targets on the sled's board [m], frame ``sled``, shape [n, 3], from left to right.

    They stand in two rows by turns, so that they fix the camera's place and not only its direction.
    """
    side = side_of(scene)
    left, right = side.left_m - BOARD_OVERHANG_M + 0.05, side.right_m + BOARD_OVERHANG_M - 0.05
    count = max(6, round((right - left) / TARGET_SPACING_M) + 1)
    upper, lower = BOARD_TOP_M - 1.4 * TARGET_RADIUS_M, BOARD_BOTTOM_M + 1.4 * TARGET_RADIUS_M
    return np.array(
        [
            side.point(along, lower if number % 2 else upper, side.near_m + BOARD_GAP_M)
            for number, along in enumerate(np.linspace(left, right, count))
        ]
    )


def facing_packages(scene: Scene) -> list[int]:
    """Rows in a pose frame of the packages whose side the camera sees while the load stands as it was placed."""
    side = side_of(scene)
    spans = {row: _span(scene, row, side) for row in range(1, len(scene.packages) + 1)}
    seen = []
    for row, (left, right, bottom, top, depth) in spans.items():
        if _near_face(scene, row, side) is None:
            continue
        hidden = sum(
            max(0.0, min(right, other[1]) - max(left, other[0]))
            * max(0.0, min(top, other[3]) - max(bottom, other[2]))
            for other in spans.values()
            if other[4] > depth + 1.0e-3
        )
        if hidden < 0.5 * (right - left) * (top - bottom):
            seen.append(row)
    return seen


def near_face(scene: Scene, row: int) -> Array | None:
    """Corners of the package's face towards the camera, in the package's own frame [m], shape [4, 3].

    Clockwise as the camera sees them, from the upper left one. None where no face looks at the camera within 30°.
    """
    return _near_face(scene, row, side_of(scene))


def markers_of(scene: Scene) -> list[Marker]:
    """The tags on the packages that face the camera: two each, side by side; none without ``camera.markers``."""
    markers = scene.camera.markers if scene.camera is not None else None
    if markers is None:
        return []
    placed: list[Marker] = []
    for row in facing_packages(scene):
        face = near_face(scene, row)
        assert face is not None
        across, down = face[1] - face[0], face[3] - face[0]
        width, height = float(np.linalg.norm(across)), float(np.linalg.norm(down))
        # A quiet zone of an eighth around the black square, and the two sheets within the face.
        size = min(markers.size_m, height / 1.35, width / 2.9)
        middle = face.mean(axis=0)
        u, v = across / width, down / height
        for shift in (-0.25, 0.25):
            centre = middle + shift * across
            frame = np.array([-u - v, u - v, u + v, -u + v])
            placed.append(
                Marker(
                    tag=len(placed),
                    package=row,
                    corners=centre + 0.5 * size * frame,
                    sheet=centre + 0.625 * size * frame,
                )
            )
    return placed


def _travel(scene: Scene) -> Array:
    """Places of the sled over the test [m], shape [n, 3]; where it doesn't stop, a little beyond the profile's end."""
    profile = build_profile(scene)
    _, speed, _ = profile.state(profile.end_s)
    end_s = profile.end_s + (RUN_ON_S if np.linalg.norm(speed) > 1.0e-6 else 0.0)
    return np.array([profile.state(time_s)[2] for time_s in np.linspace(0.0, end_s, 200)])


def _near_face(scene: Scene, row: int, side: Side) -> Array | None:
    package = scene.packages[row - 1]
    angle = np.deg2rad(package.yaw_deg)
    axes = np.array([[np.cos(angle), np.sin(angle), 0.0], [-np.sin(angle), np.cos(angle), 0.0]])
    facing = axes @ side.normal
    axis = int(np.argmax(np.abs(facing)))
    if abs(facing[axis]) < _FACING:
        return None
    sign = 1.0 if facing[axis] > 0.0 else -1.0
    half = 0.5 * np.array(package.size_m)
    normal = np.zeros(3)
    normal[axis] = sign
    up = np.array([0.0, 0.0, 1.0])
    right = np.cross(up, normal)
    centre = normal * half
    u, v = right * half, up * half
    return np.array([centre - u + v, centre + u + v, centre + u - v, centre - u - v])


def _span(scene: Scene, row: int, side: Side) -> tuple[float, float, float, float, float]:
    package = scene.packages[row - 1]
    corners = box_corners(
        np.array([package.position_m]),
        np.array([yaw_quaternion(package.yaw_deg)]),
        0.5 * np.array([package.size_m]),
    )[0]
    along, depth = corners @ side.right, corners @ side.normal
    return (
        float(along.min()),
        float(along.max()),
        float(corners[:, 2].min()),
        float(corners[:, 2].max()),
        float(depth.max()),
    )
