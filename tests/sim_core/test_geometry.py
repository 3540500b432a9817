"""Corners, turns, overlaps and clips against algebra and brute force."""

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from config.package import Package
from sim_core.frames import Array
from sim_core.geometry import (
    CORNER_SIGNS,
    box_corners,
    clip_convex,
    footprint,
    overlap_depth,
    polygon_area,
    rotation_matrices,
    turned_by_half_step,
    yaw_quaternion,
)

SQUARE = 0.5 * np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])
# Coordinates here stay below 3 m: 1e-12 is far above their rounding and far below any wrong formula.
ROUNDING = 1.0e-12

edges = st.floats(0.1, 1.0)
places = st.floats(-0.8, 0.8)
angles = st.floats(-720.0, 720.0)


@st.composite
def boxes(draw: st.DrawFn, yaw: st.SearchStrategy[float] = angles) -> Package:
    return Package(
        id="p",
        size_m=(draw(edges), draw(edges), draw(edges)),
        mass_kg=1.0,
        position_m=(draw(places), draw(places), draw(places)),
        yaw_deg=draw(yaw),
    )


@st.composite
def unit_quaternions(draw: st.DrawFn) -> Array:
    parts = np.array([draw(st.floats(-1.0, 1.0)) for _ in range(4)])
    assume(np.linalg.norm(parts) > 0.1)
    return parts / np.linalg.norm(parts)


def multiplied(a: Array, b: Array) -> Array:
    """Hamilton product of quaternions x, y, z, w."""
    (x1, y1, z1, w1), (x2, y2, z2, w2) = a, b
    return np.array(
        [
            w1 * x2 + x1 * w2 + y1 * z2 - z1 * y2,
            w1 * y2 - x1 * z2 + y1 * w2 + z1 * x2,
            w1 * z2 + x1 * y2 - y1 * x2 + z1 * w2,
            w1 * w2 - x1 * x2 - y1 * y2 - z1 * z2,
        ]
    )


def rotated(quaternion: Array, vector: Array) -> Array:
    """q · v · q*."""
    conjugate = quaternion * [-1.0, -1.0, -1.0, 1.0]
    return multiplied(multiplied(quaternion, np.append(vector, 0.0)), conjugate)[:3]


def test_corner_numbers_are_bits() -> None:
    assert CORNER_SIGNS[0].tolist() == [-1, -1, -1]
    assert CORNER_SIGNS[1].tolist() == [1, -1, -1]
    assert CORNER_SIGNS[2].tolist() == [-1, 1, -1]
    assert CORNER_SIGNS[4].tolist() == [-1, -1, 1]
    assert len({tuple(signs) for signs in CORNER_SIGNS.tolist()}) == 8


@settings(max_examples=60, deadline=None)
@given(
    quaternion=unit_quaternions(),
    centre=st.tuples(places, places, places),
    half=st.tuples(edges, edges, edges),
)
def test_corners_are_the_rotated_local_ones(
    quaternion: Array, centre: tuple[float, ...], half: tuple[float, ...]
) -> None:
    corners = box_corners(np.array([centre]), quaternion[None], np.array([half]))
    assert corners.shape == (1, 8, 3)
    for corner, signs in zip(corners[0], CORNER_SIGNS, strict=True):
        assert corner == pytest.approx(centre + rotated(quaternion, signs * half), abs=ROUNDING)


@settings(max_examples=60, deadline=None)
@given(first=unit_quaternions(), second=unit_quaternions())
def test_rotation_matrices_are_a_group(first: Array, second: Array) -> None:
    one, two, both = rotation_matrices(np.array([first, second, multiplied(first, second)]))
    assert one @ one.T == pytest.approx(np.eye(3), abs=ROUNDING)
    assert np.linalg.det(one) == pytest.approx(1.0, abs=ROUNDING)
    assert one @ two == pytest.approx(both, abs=ROUNDING)


@given(yaw=angles)
def test_yaw_turns_x_towards_y(yaw: float) -> None:
    angle = math.radians(yaw)
    turned = rotated(np.array(yaw_quaternion(yaw)), np.array([1.0, 0.0, 0.0]))
    assert turned == pytest.approx([math.cos(angle), math.sin(angle), 0.0], abs=ROUNDING)


@given(box=boxes())
def test_the_footprint_is_the_outline_of_the_corners(box: Package) -> None:
    corners = box_corners(
        np.array([box.position_m]), np.array([yaw_quaternion(box.yaw_deg)]), 0.5 * np.array([box.size_m])
    )
    outline = footprint(box)
    assert sorted(map(tuple, np.round(corners[0, :4, :2], 9))) == sorted(map(tuple, np.round(outline, 9)))
    x, y = outline.T
    # Counter-clockwise: the shoelace sum is positive, and it is the area.
    area = 0.5 * float(x @ np.roll(y, -1) - y @ np.roll(x, -1))
    assert area == pytest.approx(box.size_m[0] * box.size_m[1], abs=ROUNDING)


def translations(angular: Array, step_s: float) -> Array:
    """The exact quaternion of a turn by −½·h·ω."""
    angle = -0.5 * step_s * float(np.linalg.norm(angular))
    axis = angular / max(np.linalg.norm(angular), 1.0e-300)
    return np.append(math.sin(angle / 2.0) * axis, math.cos(angle / 2.0))


@settings(max_examples=60, deadline=None)
@given(
    quaternion=unit_quaternions(),
    angular=st.tuples(*3 * [st.floats(-20.0, 20.0)]),
    step_s=st.sampled_from([1.0 / 60, 1.0 / 240, 1.0 / 960]),
)
def test_half_a_step_back_is_the_exact_turn_to_third_order(
    quaternion: Array, angular: tuple[float, ...], step_s: float
) -> None:
    """q − ½h·½ωq turns by 2·atan(x), x = h|ω|/4, not by 2x; |Δq| is half of that angle's error, at most x³/3."""
    omega = np.array(angular)
    (moved,) = turned_by_half_step(quaternion[None], omega[None], step_s)
    exact = multiplied(translations(omega, step_s), quaternion)
    x = step_s * float(np.linalg.norm(omega)) / 4.0
    assert np.linalg.norm(moved - exact) <= x**3 / 3.0 + 1.0e-15
    assert np.linalg.norm(moved) == pytest.approx(1.0, abs=1.0e-15)


def test_half_a_step_back_of_no_turn_is_the_same() -> None:
    quaternions = np.array([yaw_quaternion(30.0), (0.0, 0.0, 0.0, 1.0)])
    assert turned_by_half_step(quaternions, np.zeros((2, 3)), 0.01) == pytest.approx(quaternions, abs=1.0e-16)


@settings(max_examples=60, deadline=None)
@given(first=boxes(), second=boxes())
def test_overlap_is_symmetric(first: Package, second: Package) -> None:
    assert overlap_depth(first, second) == pytest.approx(overlap_depth(second, first), abs=ROUNDING)


@settings(max_examples=60, deadline=None)
@given(first=boxes(st.just(0.0)), second=boxes(st.just(0.0)))
def test_overlap_of_axis_aligned_boxes_is_exact(first: Package, second: Package) -> None:
    shared = [
        min(a + la / 2, b + lb / 2) - max(a - la / 2, b - lb / 2)
        for a, la, b, lb in zip(first.position_m, first.size_m, second.position_m, second.size_m, strict=True)
    ]
    assert overlap_depth(first, second) == pytest.approx(min(shared), abs=ROUNDING)


@settings(max_examples=60, deadline=None)
@given(first=boxes(), second=boxes())
def test_overlap_against_every_direction(first: Package, second: Package) -> None:
    """The least shared length over all directions: for convex polygons it is found at a face normal.

    Along a direction u the shared length changes with u's angle by at most the outlines' reach from the
    first centre, below 1.6·√2 + 2·√2/2 < 4 m, so 7200 directions over half a turn miss it by at most 4·π/7200/2.
    """
    depth = overlap_depth(first, second)
    (low_a, high_a), (low_b, high_b) = (
        (p.position_m[2] - p.size_m[2] / 2, p.position_m[2] + p.size_m[2] / 2) for p in (first, second)
    )
    directions = np.linspace(0.0, math.pi, 7200, endpoint=False)
    u = np.array([np.cos(directions), np.sin(directions)])
    a, b = footprint(first) @ u, footprint(second) @ u
    plan = np.minimum(a.max(axis=0), b.max(axis=0)) - np.maximum(a.min(axis=0), b.min(axis=0))
    brute = min(float(plan.min()), min(high_a, high_b) - max(low_a, low_b))
    if depth >= 0.0:
        assert depth - ROUNDING <= brute <= depth + 4.0 * math.pi / 7200 / 2.0
    else:
        assert inside_both(first, second) == 0


def inside_both(first: Package, second: Package) -> int:
    """How many points of a 21³ grid through the first box lie well inside the second."""
    grid = np.linspace(-0.5, 0.5, 21)
    local = np.stack(np.meshgrid(grid, grid, grid), axis=-1).reshape(-1, 3) * first.size_m
    one, two = rotation_matrices(np.array([yaw_quaternion(first.yaw_deg), yaw_quaternion(second.yaw_deg)]))
    points = (local @ one.T + first.position_m - second.position_m) @ two
    return int((np.abs(points) < 0.5 * np.array(second.size_m) - 1.0e-9).all(axis=1).sum())


@settings(max_examples=60, deadline=None)
@given(first=boxes(), second=boxes())
def test_a_point_inside_both_boxes_is_an_overlap(first: Package, second: Package) -> None:
    if inside_both(first, second):
        assert overlap_depth(first, second) > 0.0


@pytest.mark.parametrize(
    ("x", "y", "area"), [(0.0, 0.0, 1.0), (0.25, 0.5, 0.375), (-0.75, 0.0, 0.25), (1.5, 0.0, 0.0)]
)
def test_clipped_squares(x: float, y: float, area: float) -> None:
    clipped = clip_convex(SQUARE, SQUARE + [x, y])
    assert (polygon_area(clipped) if len(clipped) >= 3 else 0.0) == pytest.approx(area, abs=ROUNDING)


def test_a_square_turned_by_45_degrees_leaves_an_octagon() -> None:
    """Unit squares share a regular octagon of inner radius 1/2: area 8·r²·tan(22.5°) = 2·(√2 − 1)."""
    turn = math.sqrt(0.5) * np.array([[1.0, -1.0], [1.0, 1.0]])
    octagon = clip_convex(SQUARE, SQUARE @ turn.T)
    assert len(octagon) == 8
    assert polygon_area(octagon) == pytest.approx(2.0 * (math.sqrt(2.0) - 1.0), abs=ROUNDING)


@settings(max_examples=60, deadline=None)
@given(first=boxes(), second=boxes())
def test_clipping_is_symmetric_and_never_grows(first: Package, second: Package) -> None:
    one, two = footprint(first), footprint(second)
    areas = [
        polygon_area(clipped) if len(clipped := clip_convex(a, b)) >= 3 else 0.0
        for a, b in ((one, two), (two, one))
    ]
    assert areas[0] == pytest.approx(areas[1], abs=ROUNDING)
    assert areas[0] <= min(polygon_area(one), polygon_area(two)) + ROUNDING
