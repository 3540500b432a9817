"""The bench as the camera sees it: pallet, and the sled with its deck, catch platforms and board of targets."""

import numpy as np

from config.scene import Scene
from sim_core.camera.atlas import Atlas
from sim_core.camera.layout import (
    BOARD_BOTTOM_M,
    BOARD_GAP_M,
    BOARD_OVERHANG_M,
    BOARD_TOP_M,
    TARGET_RADIUS_M,
    Side,
    targets_of,
)
from sim_core.camera.meshes import PALLET, SLED, Mesh, box, merged, quad, turned
from sim_core.camera.print import quadrant_target
from sim_core.camera.surfaces import plywood, steel, wood
from sim_core.frames import Array

FLOOR_M = -0.46
"""Height of the hall's floor in frame ``world`` [m]."""
RAIL_TOP_M = -0.25
RAIL_GAUGE_M = 0.62
_LEAST_DEPTH_M = 0.9
CATCH_M = 2.6
"""How far the sled's platforms reach beyond the load at both ends: packages that fall come to lie on them."""
BOARD_PAINT = (0.8, 0.8, 0.79, 0.0)

_DECK_M = 0.021
_FRAME_M = 0.1
_BLUE = (0.10, 0.24, 0.46, 0.10)
_GREY = (0.34, 0.35, 0.36, 0.12)
_BLACK = (0.06, 0.06, 0.065, 0.10)
_UP = np.array([0.0, 0.0, 1.0])


def far_m(scene: Scene, side: Side) -> float:
    """How far along the side's normal the rearmost point of load and pallet stands [m]."""
    low = [
        float(np.array(package.position_m) @ side.normal) - 0.5 * float(np.hypot(*package.size_m[:2]))
        for package in scene.packages
    ]
    if scene.pallet_box is not None:
        low.append(-0.5 * float(np.abs(side.normal) @ np.array(scene.pallet_box.size_m)))
    return min(low, default=-0.4)


def bench_frame(side: Side) -> Array:
    """Axes in which the bench is built, a row each: to the right in the picture, away from the camera, up."""
    return np.array([side.right, -side.normal, _UP])


def deck_span(scene: Scene, side: Side) -> tuple[float, float]:
    """Where the sled's deck begins and ends, away from the camera [m]."""
    front = -(side.near_m + BOARD_GAP_M - 0.012)
    return front, max(-(far_m(scene, side) - 0.12), front + _LEAST_DEPTH_M)


def sled(scene: Scene, side: Side, atlas: Atlas, *, pixels_per_m: float) -> Mesh:
    """The sled in frame ``sled``: plywood on a steel frame, platforms at both ends, a white board with targets."""
    seed = scene.camera.seed if scene.camera is not None else 0
    left, right = side.left_m - BOARD_OVERHANG_M + 0.03, side.right_m + BOARD_OVERHANG_M - 0.03
    front, back = deck_span(scene, side)
    length, depth = right - left, back - front
    along, across = 0.5 * (left + right), 0.5 * (front + back)
    ply = atlas.add(plywood(length, depth, seed=seed, pixels_per_m=0.5 * pixels_per_m))
    bar = atlas.add(steel(1.0, _FRAME_M, seed=seed, pixels_per_m=pixels_per_m))
    plate = atlas.add(steel(CATCH_M, depth, seed=seed + 1, pixels_per_m=0.4 * pixels_per_m))
    parts: list[Mesh] = []

    def piece(
        x: float,
        y: float,
        top: float,
        size: tuple[float, float, float],
        picture: int,
        tint: tuple[float, ...],
    ) -> None:
        centre = np.array([x, y, top - 0.5 * size[2]])
        parts.append(box(centre, np.array(size), picture, body=SLED, tint=tint))  # type: ignore[arg-type]

    piece(along, across, 0.0, (length, depth, _DECK_M), ply, (1.0, 1.0, 1.0, 0.05))
    for y in (front + 0.035, back - 0.035):
        piece(along, y, -_DECK_M, (length, 0.06, _FRAME_M), bar, _BLUE)
    for x in np.linspace(left + 0.03, right - 0.03, 5).tolist():
        piece(x, across, -_DECK_M, (0.06, depth - 0.01, _FRAME_M), bar, _BLUE)
    for sign, end in ((-1.0, left), (1.0, right)):
        middle = end + sign * 0.5 * CATCH_M
        piece(middle, across, -0.001, (CATCH_M - 0.008, depth, 0.008), plate, (0.55, 0.56, 0.58, 0.10))
        for y in (front + 0.03, back - 0.03):
            piece(middle, y, -0.009, (CATCH_M, 0.05, 0.06), bar, _BLUE)
        for x in np.linspace(end + sign * 0.1, end + sign * (CATCH_M - 0.03), 5).tolist():
            piece(x, across, -0.009, (0.05, depth - 0.01, 0.06), bar, _BLUE)
        piece(end + sign * (CATCH_M - 0.35), across, -0.069, (0.08, RAIL_GAUGE_M + 0.1, 0.07), bar, _BLUE)
    wheels = (left + 0.2, right - 0.2, left - CATCH_M + 0.35, right + CATCH_M - 0.35)
    for x in wheels:
        for y in (across - 0.5 * RAIL_GAUGE_M, across + 0.5 * RAIL_GAUGE_M):
            piece(x, y, -0.115, (0.2, 0.1, 0.08), bar, _GREY)
            piece(x, y, -0.185, (0.24, 0.06, 0.065), 0, _BLACK)
    board_across = -(side.near_m + BOARD_GAP_M)
    piece(
        0.5 * (side.left_m + side.right_m), board_across + 0.006, BOARD_TOP_M,
        (side.right_m - side.left_m + 2.0 * BOARD_OVERHANG_M, 0.011, BOARD_TOP_M - BOARD_BOTTOM_M), 0, BOARD_PAINT,
    )  # fmt: skip
    built = turned(merged(parts), bench_frame(side), np.zeros(3))
    return merged([built, _targets(scene, side, atlas, pixels_per_m)])


def _targets(scene: Scene, side: Side, atlas: Atlas, pixels_per_m: float) -> Mesh:
    # A texel for each rendered pixel: finer ones would let edges jump from one to the next.
    size_px = int(np.clip(2.0 * TARGET_RADIUS_M * pixels_per_m, 16, 2048))
    picture = atlas.add(quadrant_target(size_px))
    square = TARGET_RADIUS_M * np.array(
        [-side.right + _UP, side.right + _UP, side.right - _UP, -side.right - _UP]
    )
    return merged(
        [quad(centre + square, picture, body=SLED, tint=BOARD_PAINT) for centre in targets_of(scene)]
    )


def pallet(scene: Scene, atlas: Atlas, *, pixels_per_m: float) -> Mesh:
    """The pallet in its own frame, built of boards and blocks as EN 13698-1 has the 800 mm × 1200 mm one.

    Another size is the same pallet, stretched.
    """
    if scene.pallet_box is None:
        return merged([])
    length, width, height = scene.pallet_box.size_m
    seed = scene.camera.seed if scene.camera is not None else 0
    x, y, z = length / 1.2, width / 0.8, height / 0.144
    woods = [atlas.add(wood(length, 0.15, seed=seed + n, pixels_per_m=0.8 * pixels_per_m)) for n in range(6)]
    ends = [atlas.add(wood(0.145 * x, 0.1, seed=seed + 50 + n, pixels_per_m=pixels_per_m)) for n in range(4)]
    board, parts = 0.022 * z, []
    rng = np.random.default_rng(seed)

    def piece(
        centre: tuple[float, float, float], size: tuple[float, float, float], pictures: list[int]
    ) -> None:
        shade = float(rng.uniform(0.72, 1.0))
        tint = (shade, shade * float(rng.uniform(0.95, 1.0)), shade * float(rng.uniform(0.88, 1.0)), 0.0)
        picture = pictures[int(rng.integers(len(pictures)))]
        parts.append(box(np.array(centre), np.array(size), picture, body=PALLET, tint=tint))

    top, bottom = 0.5 * height, -0.5 * height
    lower = ((-0.35, 0.1), (0.0, 0.145), (0.35, 0.1))
    upper = ((-0.3275, 0.145), (-0.1775, 0.1), (0.0, 0.145), (0.1775, 0.1), (0.3275, 0.145))
    for place, wide in upper:
        piece((0.0, place * y, top - 0.5 * board), (length, wide * y, board), woods)
    block = height - 3.0 * board
    for place in (-0.5275, 0.0, 0.5275):
        piece((place * x, 0.0, top - 1.5 * board), (0.145 * x, width, board), woods)
        for across, wide in lower:
            piece((place * x, across * y, bottom + board + 0.5 * block), (0.145 * x, wide * y, block), ends)
    for across, wide in lower:
        piece((0.0, across * y, bottom + 0.5 * board), (length, wide * y, board), woods)
    return merged(parts)
