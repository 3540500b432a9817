"""What stands still around the bench: rails, floor and the hall's back wall, which is out of focus."""

import cv2
import numpy as np

from config.scene import RecordedSled, Scene, direction_vector
from sim_core.camera.atlas import Atlas
from sim_core.camera.layout import Side
from sim_core.camera.meshes import FIXED, SLED, Mesh, box, merged, quad, turned
from sim_core.camera.stage import CATCH_M, FLOOR_M, RAIL_GAUGE_M, RAIL_TOP_M, bench_frame, deck_span, far_m
from sim_core.camera.surfaces import Picture, concrete, generator, noise, steel
from sim_core.frames import Array

_WALL_BEHIND_M, _WALL_TOP_M = 3.4, 5.5
_AROUND_M = 5.0
_WALL_PX_PER_M = 90.0
_BLUR_M = 0.022
"""Radius of the wall's circles of confusion, as far as blur is."""


def backdrop(scene: Scene, side: Side, atlas: Atlas) -> Mesh:
    """Floor and back wall, in frame ``world``."""
    seed = scene.camera.seed if scene.camera is not None else 0
    left, right = side.left_m + side.travel_m[0] - _AROUND_M, side.right_m + side.travel_m[1] + _AROUND_M
    near, far = side.near_m + 5.0, far_m(scene, side) - _WALL_BEHIND_M
    floor = atlas.add(_floor(right - left, near - far, rail=near - side.near_m, seed=seed))
    wall = atlas.add(_wall(right - left, _WALL_TOP_M - FLOOR_M, seed=seed))
    ground = _rectangle(side, (left, right), ((FLOOR_M, far), (FLOOR_M, near)))
    behind = _rectangle(side, (left, right), ((_WALL_TOP_M, far), (FLOOR_M, far)))
    room = [
        quad(ground, floor, body=FIXED, tint=(0.86, 0.86, 0.86, 0.0)),
        quad(behind, wall, body=FIXED),
        *_rest_of_hall(side, (left, right), (near + 1.0, far), wall),
    ]
    return merged(room)


def _rest_of_hall(
    side: Side, ends: tuple[float, float], depths: tuple[float, float], wall: int
) -> list[Mesh]:
    """The other three walls, the ceiling, and more floor; from outside the hall they don't hide it."""
    (left, right), (near, far) = ends, depths

    def upright(first: tuple[float, float], last: tuple[float, float], share: float) -> Mesh:
        heights = (_WALL_TOP_M, _WALL_TOP_M, FLOOR_M, FLOOR_M)
        places = (first, last, last, first)
        corners = [side.point(along, up, depth) for up, (along, depth) in zip(heights, places, strict=True)]
        return quad(np.array(corners), wall, body=FIXED, part=(0.0, 0.0, share, 1.0))

    share = (near - far) / (right - left)
    above = [
        side.point(x, _WALL_TOP_M, y) for x, y in ((left, near), (right, near), (right, far), (left, far))
    ]
    wide = 40.0
    below = _rectangle(
        side, (left - wide, right + wide), ((FLOOR_M - 0.02, far - wide), (FLOOR_M - 0.02, near + wide))
    )
    return [
        upright((left, near), (left, far), share),
        upright((right, far), (right, near), share),
        upright((right, near), (left, near), 1.0),
        quad(np.array(above), 0, body=FIXED, tint=(0.22, 0.23, 0.24, 0.0)),
        quad(below, 0, body=FIXED, tint=(0.3, 0.295, 0.28, 0.0)),
    ]


def _rectangle(side: Side, ends: tuple[float, float], edges: tuple[tuple[float, float], ...]) -> Array:
    """Corners for ``quad``: from left to right, and from the first edge's height and depth to the second's."""
    (upper, behind), (lower, before) = edges
    left, right = ends
    return np.array(
        [side.point(left, upper, behind), side.point(right, upper, behind),
         side.point(right, lower, before), side.point(left, lower, before)]
    )  # fmt: skip


def _floor(width_m: float, depth_m: float, *, rail: float, seed: int) -> Picture:
    """Concrete with sawn joints and the yellow line that nobody crosses while the sled moves."""
    floor = concrete(width_m, depth_m, seed=seed, pixels_per_m=140.0)
    scale = floor.shape[1] / width_m
    for joint in np.arange(1.1, width_m, 3.0):
        column = int(joint * scale)
        floor[:, column : column + 1] = floor[:, column : column + 1] // 2
    for line in (depth_m - rail - 2.2, depth_m - rail + 1.0):
        row, thick = int(line * scale), max(2, int(0.08 * scale))
        paint = floor[row : row + thick].astype(np.float32) / 150.0
        floor[row : row + thick] = np.clip(paint * np.array([205.0, 165.0, 40.0]), 0, 255).astype(np.uint8)
    return floor


def _wall(width_m: float, height_m: float, *, seed: int) -> Picture:
    """Painted sheet-metal wall with columns, a dado, a gate, cabinets and daylight from above, out of focus."""
    rng = generator("wall", seed)
    rows, columns = int(height_m * _WALL_PX_PER_M), int(width_m * _WALL_PX_PER_M)
    wall = np.empty((rows, columns, 3), np.float32)

    def paint(left: float, right: float, low: float, high: float, colour: tuple[float, float, float]) -> None:
        top, bottom = rows - int(high * _WALL_PX_PER_M), rows - int(low * _WALL_PX_PER_M)
        wall[max(top, 0) : bottom, max(0, int(left * _WALL_PX_PER_M)) : int(right * _WALL_PX_PER_M)] = colour

    wall[...] = (172.0, 174.0, 172.0)
    ribs = 1.0 + 0.02 * np.sign(np.sin(np.arange(columns) * (2.0 * np.pi / (0.25 * _WALL_PX_PER_M))))
    wall *= ribs[None, :, None]
    paint(0.0, width_m, 0.0, 1.15, (128.0, 134.0, 138.0))
    paint(0.0, width_m, 1.15, 1.2, (98.0, 102.0, 106.0))
    for column in np.arange(0.6, width_m, 3.6):
        paint(column, column + 0.24, 0.0, height_m, (118.0, 122.0, 126.0))
        paint(column + 0.07, column + 0.17, 0.0, height_m, (96.0, 100.0, 104.0))
    paint(0.0, width_m, 3.15, 3.3, (120.0, 122.0, 124.0))
    gate = 0.5 * width_m + 2.1
    paint(gate, gate + 2.6, 0.0, 2.9, (150.0, 156.0, 163.0))
    for slat in np.arange(0.0, 2.9, 0.36):
        paint(gate, gate + 2.6, slat, slat + 0.02, (116.0, 120.0, 126.0))
    cabinet = 0.5 * width_m - 3.4
    for step, tall, colour in ((0.0, 1.95, (92.0, 100.0, 108.0)), (0.85, 1.95, (98.0, 106.0, 113.0)),
                               (1.9, 0.95, (78.0, 92.0, 118.0))):  # fmt: skip
        paint(cabinet + step, cabinet + step + 0.8, 0.05, tall, colour)
        paint(cabinet + step + 0.38, cabinet + step + 0.41, 0.1, tall - 0.05, (66.0, 70.0, 76.0))
    paint(cabinet + 3.0, cabinet + 3.16, 0.9, 1.4, (150.0, 40.0, 34.0))
    wall *= 1.0 + 0.03 * noise(rng, (rows, columns), (60.0, 60.0), 3)[..., None]
    # Daylight from above and lamps along the wall: brighter up there, and in pools.
    up = np.linspace(1.0, 0.0, rows)[:, None, None]
    pools = 0.5 + 0.5 * np.cos(np.arange(columns) * (2.0 * np.pi / (4.5 * _WALL_PX_PER_M)))[None, :, None]
    wall *= 0.78 + 0.22 * up + 0.07 * pools
    radius = max(1, round(_BLUR_M * _WALL_PX_PER_M))
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (4 * radius + 1, 4 * radius + 1)).astype(np.float32)
    blurred = cv2.filter2D(wall, -1, disc / disc.sum(), borderType=cv2.BORDER_REPLICATE)
    return np.clip(blurred, 0.0, 255.0).astype(np.uint8)


def rails(scene: Scene, side: Side, atlas: Atlas) -> Mesh:
    """Two rails on steel beams, on cross-beams on the floor, in frame ``world``."""
    seed = scene.camera.seed if scene.camera is not None else 0
    left, right = side.left_m + side.travel_m[0] - _AROUND_M, side.right_m + side.travel_m[1] + _AROUND_M
    bar = atlas.add(steel(2.0, 0.1, seed=seed, pixels_per_m=300.0))
    middle = 0.5 * sum(deck_span(scene, side))
    length, along = right - left, 0.5 * (left + right)
    paint, bright = (0.26, 0.27, 0.29, 0.08), (0.7, 0.7, 0.72, 0.35)
    parts: list[Mesh] = []

    def beam(y: float, top: float, wide: float, high: float, tint: tuple[float, float, float, float]) -> None:
        # In pieces, so that light and picture vary along it.
        for x in np.arange(left, right, 2.0).tolist():
            centre = np.array([x + 1.0, middle + y, top - 0.5 * high])
            parts.append(box(centre, np.array([2.0, wide, high]), bar, body=FIXED, tint=tint))

    for y in (-0.5 * RAIL_GAUGE_M, 0.5 * RAIL_GAUGE_M):
        beam(y, RAIL_TOP_M, 0.05, 0.03, bright)
        beam(y, RAIL_TOP_M - 0.03, 0.11, 0.012, paint)
        beam(y, RAIL_TOP_M - 0.042, 0.012, 0.1, paint)
        beam(y, RAIL_TOP_M - 0.142, 0.11, 0.012, paint)
    high = RAIL_TOP_M - 0.154 - FLOOR_M
    for x in np.arange(along - 0.5 * length + 0.45, along + 0.5 * length, 0.9).tolist():
        centre = np.array([x, middle, FLOOR_M + 0.5 * high])
        parts.append(box(centre, np.array([0.1, RAIL_GAUGE_M + 0.3, high]), bar, body=FIXED, tint=paint))
    return turned(merged(parts), _rail_frame(scene, side), np.zeros(3))


def _rail_frame(scene: Scene, side: Side) -> Array:
    """Axes of the rails, a row each: along them to the right in the picture, away from the camera, up."""
    if isinstance(scene.sled, RecordedSled):
        return bench_frame(side)
    ahead = np.array([*direction_vector(scene.sled.direction), 0.0])
    right = ahead if ahead @ side.right > 0.0 else -ahead
    up = np.array([0.0, 0.0, 1.0])
    return np.array([right, np.cross(up, right), up])


def shadow_region(scene: Scene, side: Side) -> Array:
    """Corners of the box around sled and load in which things cast shadows, frame ``sled`` [m], shape [8, 3]."""
    near, far = side.near_m + 0.35, -deck_span(scene, side)[1] - 0.33
    left, right = side.left_m - CATCH_M - 0.4, side.right_m + CATCH_M + 0.4
    return np.array(
        [
            side.point(along, height, depth)
            for along in (left, right)
            for height in (FLOOR_M, 1.1 * side.top_m)
            for depth in (near, far)
        ]
    )


def shaded_floor(scene: Scene, side: Side) -> Mesh:
    """The part of the floor on which shadows fall, in frame ``sled``."""
    near, far = side.near_m + 0.7, far_m(scene, side) - 1.6
    left, right = side.left_m - CATCH_M - 0.8, side.right_m + CATCH_M + 0.8
    return quad(_rectangle(side, (left, right), ((FLOOR_M, far), (FLOOR_M, near))), 0, body=SLED)
