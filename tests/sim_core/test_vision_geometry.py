"""Targets, camera pose, planes and rigid motions: each against what it was made from."""

import cv2
import numpy as np
import pytest

from config.errors import RefusedInput
from sim_core.camera.print import quadrant_target
from sim_core.camera.view import view_of
from sim_core.vision.motion import fit_motions
from sim_core.vision.plane import SightFinder, undistorted
from sim_core.vision.spots import block_found
from sim_core.vision.targets import TargetTracker, find_targets, refined
from tests.sim_core.vision_scenes import stack_scene


def painted_target(centre: tuple[float, float], radius_px: float, *, size: int = 60) -> np.ndarray:
    """A quadrant target in white, each pixel the mean of 16 x 16 points of it."""
    fine = (np.arange(16 * size) + 0.5) / 16.0 - 0.5
    x, y = fine[None, :] - centre[0], fine[:, None] - centre[1]
    black = (x * x + y * y < radius_px**2) & ((x < 0.0) == (y < 0.0))
    grey = cv2.resize(
        np.where(black, 20.0, 230.0).astype(np.float32), (size, size), interpolation=cv2.INTER_AREA
    )
    return np.round(grey).astype(np.uint8)


@pytest.mark.parametrize("radius_px", [7.0, 12.6, 17.0])
def test_a_targets_centre_is_found_to_three_hundredths_of_a_pixel_wherever_it_is_in_the_pixel(radius_px):
    errors = []
    for place in np.random.default_rng(3).uniform(29.0, 31.0, (20, 2)):
        grey = painted_target(tuple(place), radius_px)
        errors.append(refined(grey, np.round(place)[None], radius_px)[0] - place)
    assert np.abs(errors).max() < 0.06
    assert np.sqrt(np.mean(np.square(errors))) < 0.03


def test_nothing_is_found_where_no_target_is():
    noise = np.random.default_rng(1).integers(0, 255, (80, 80)).astype(np.uint8)
    assert np.isnan(refined(noise, np.array([[40.0, 40.0], [2.0, 2.0]]), 12.0)).all()
    blank = np.full((80, 80), 200, np.uint8)
    assert np.isnan(TargetTracker(np.array([12.0])).follow(blank, np.array([[40.0, 40.0]]))).all()


def pasted_board(pixels: np.ndarray, radius_px: int, shape: tuple[int, int]) -> np.ndarray:
    """White with targets at whole pixels."""
    grey = np.full(shape, 220, np.uint8)
    mark = quadrant_target(2 * radius_px + 1)[..., 0]
    for x, y in np.round(pixels).astype(int):
        grey[y - radius_px : y + radius_px + 1, x - radius_px : x + radius_px + 1] = mark
    return grey


def test_the_board_is_found_without_knowing_where_to_look():
    scene = stack_scene()
    view = view_of(scene)
    finder = SightFinder(scene, view.matrix, view.distortion, view.width, view.height)
    truth = view.project(finder.targets)
    grey = pasted_board(truth, 8, (view.height, view.width))
    board = np.column_stack((finder.targets @ finder.side.right, -finder.targets[:, 2]))
    pixels, _ = find_targets(grey, board, view.matrix, view.distortion)
    assert np.abs(pixels - np.round(truth)).max() < 0.6
    # A covered target is missed, and none of the others is taken for it.
    x, y = np.round(truth[2]).astype(int)
    grey[y - 10 : y + 11, x - 10 : x + 11] = 220
    pixels, _ = find_targets(grey, board, view.matrix, view.distortion)
    assert np.isnan(pixels[2]).all()
    others = [k for k in range(len(truth)) if k != 2]
    assert np.abs(pixels[others] - np.round(truth[others])).max() < 0.6


CAMERAS = [
    {},
    {"position_m": (-0.8, -3.2, 1.6), "aim_m": (0.4, 0.0, 0.3), "focal_length_mm": 14.0},
    {"position_m": (1.5, -5.0, 0.2), "aim_m": (0.5, 0.0, 0.5), "focal_length_mm": 20.0},
]


@pytest.mark.parametrize("camera", CAMERAS)
def test_the_cameras_pose_and_the_travel_come_from_the_targets_alone(camera):
    scene = stack_scene(**camera)
    view = view_of(scene)
    finder = SightFinder(scene, view.matrix, view.distortion, view.width, view.height)
    sight = finder.begin(view.project(finder.targets))
    for travel in (0.05, 0.2, 0.4):
        pixels = view.project(finder.targets + travel * finder.side.right)
        found, _ = finder.travel(undistorted(pixels, view.matrix, view.distortion), near_m=travel - 0.03)
        assert found == pytest.approx(travel, abs=2e-5)
        sight = finder.add(pixels, found)
    assert np.abs(sight.view.position - view.position).max() < 1e-4
    assert np.abs(sight.view.rotation - view.rotation).max() < 1e-5


@pytest.mark.parametrize("kept", [1, 0])
def test_opencv_may_tell_more_errors_than_poses(kept, monkeypatch):
    # It leaves out a pose that comes to no number, but not its error.
    scene = stack_scene()
    view = view_of(scene)
    solve = cv2.solvePnPGeneric

    def fewer(*arguments, **options):
        found, turns, shifts, errors = solve(*arguments, **options)
        # In order of their errors: the first is the true one.
        return found, turns[:kept], shifts[:kept], errors

    monkeypatch.setattr(cv2, "solvePnPGeneric", fewer)
    finder = SightFinder(scene, view.matrix, view.distortion, view.width, view.height)
    pixels = view.project(finder.targets)
    if kept:
        assert np.abs(finder.begin(pixels).view.position - view.position).max() < 1e-4
    else:
        with pytest.raises(RefusedInput, match="on no board"):
            finder.begin(pixels)


def test_the_poses_uncertainty_is_of_the_size_of_its_error():
    # Normalised error of the camera's place over many noisy boards: its mean square is 1, with 3 x 40 samples about
    # 1 ± 0.13; the noise is taken at its floor, so that it may be somewhat below.
    scene = stack_scene()
    view = view_of(scene)
    rng = np.random.default_rng(0)
    squares = []
    for _ in range(40):
        finder = SightFinder(scene, view.matrix, view.distortion, view.width, view.height)
        truth = view.project(finder.targets)
        sight = finder.begin(truth + 0.02 * rng.standard_normal(truth.shape))
        moved = [np.linalg.norm(other.view.position - sight.view.position) ** 2 for other in sight.varied()]
        squares.append(np.sum((sight.view.position - view.position) ** 2) / np.sum(moved))
    assert 0.4 < np.mean(squares) < 1.6


def test_a_ray_meets_the_plane_where_the_point_is():
    scene = stack_scene(**CAMERAS[1])
    view = view_of(scene)
    finder = SightFinder(scene, view.matrix, view.distortion, view.width, view.height)
    sight = finder.begin(view.project(finder.targets))
    places = np.array([[-0.3, 0.2], [0.1, 0.7], [0.4, 1.1]])
    points = np.array([finder.side.point(a, h, 0.25) for a, h in places])
    rays = undistorted(sight.project(points, 0.7), view.matrix, view.distortion)
    assert np.abs(sight.on_plane(rays, finder.side, 0.25, 0.7) - places).max() < 1e-9


def test_fewer_than_five_targets_are_refused():
    scene = stack_scene()
    view = view_of(scene)
    finder = SightFinder(scene, view.matrix, view.distortion, view.width, view.height)
    pixels = view.project(finder.targets)
    pixels[4:] = np.nan
    with pytest.raises(RefusedInput, match="at least 5"):
        finder.begin(pixels)


CENTRES = np.array([[0.2, 0.4], [-0.4, 1.0]])
FOOT = np.array([0.6, 0.6])


def seen_after(
    before: np.ndarray, shift: np.ndarray, turn: float, nearer: float, distance: float
) -> np.ndarray:
    """Where points of a face that moved, turned and came nearer seem to be on the plane that they left."""
    arm = before - before.mean(axis=0)
    cos, sin = np.cos(turn), np.sin(turn)
    place = before.mean(axis=0) + arm @ np.array([[cos, sin], [-sin, cos]]) + shift
    return FOOT + (place - FOOT) * distance / (distance - nearer)


def fitted(before: np.ndarray, after: np.ndarray, moved_m: float, *, may_come_out: bool = True):
    return fit_motions(
        before, after, before.mean(axis=1), FOOT, np.full(len(before), 4.0), point_sigma_m=np.full(len(before), 1e-4),
        tolerance_m=3e-3, moved_m=np.full(len(before), moved_m),
        may_come_out=np.full(len(before), may_come_out),
    )  # fmt: skip


def test_a_rigid_motion_is_found_among_points_that_are_wrong():
    rng = np.random.default_rng(5)
    before = CENTRES[:, None] + rng.uniform(-0.15, 0.15, (2, 20, 2))
    shift, turn = np.array([0.05, -0.02]), 0.3
    after = np.array([seen_after(points, shift, turn, 0.0, 4.0) for points in before])
    after += 1e-4 * rng.standard_normal(after.shape)
    # Seven of twenty stay with the film in front.
    after[:, :7] = before[:, :7] + 0.01 * rng.standard_normal((2, 7, 2))
    motions = fitted(before, after, 0.05)
    assert motions.used.tolist() == [13, 13]
    assert np.abs(motions.centre - shift).max() < 3e-4
    assert motions.turn == pytest.approx([turn, turn], abs=2e-3)
    corners = before.mean(axis=1)[:, None] + np.array([[[0.15, 0.1]]])
    moved, variance = motions.displaced(corners, before.mean(axis=1))
    arm = np.array([0.15, 0.1])
    cos, sin = np.cos(turn), np.sin(turn)
    expected = shift + np.array([[cos, -sin], [sin, cos]]) @ arm - arm
    assert np.abs(moved[:, 0] - expected).max() < 4.0 * np.sqrt(variance.max())


def test_a_package_that_comes_nearer_is_not_taken_for_one_that_moves_sideways():
    before = CENTRES[:, None] + np.random.default_rng(6).uniform(-0.15, 0.15, (2, 20, 2))
    after = np.array([seen_after(points, np.zeros(2), 0.0, 0.02, 4.0) for points in before])
    # Taken as it looks, the second face would have moved by (centre − foot)·δ/D = 5 mm.
    assert np.linalg.norm((after - before).mean(axis=1), axis=1).max() > 5e-3
    assert np.abs(fitted(before, after, 0.005).centre).max() < 3e-4


def test_a_package_that_may_have_come_nearer_has_an_uncertainty_that_says_so():
    before = CENTRES[:, None] + np.random.default_rng(6).uniform(-0.15, 0.15, (2, 20, 2))
    after = np.array([seen_after(points, np.zeros(2), 0.0, 0.02, 4.0) for points in before])
    held = fitted(before, after, 0.005, may_come_out=False)
    assert held.comes_out.all()
    spread = np.sqrt(np.diagonal(held.covariance, axis1=1, axis2=2)[:, :2])
    assert np.abs(held.centre).max() > 3e-3
    # Half of what the two explanations differ by, at the least.
    assert (np.abs(held.centre) <= 2.0 * spread + 3e-4).all()


def test_a_block_is_found_again_to_a_tenth_of_a_pixel_and_not_where_nothing_is_like_it():
    rng = np.random.default_rng(2)
    reference = cv2.GaussianBlur(rng.uniform(0.0, 255.0, (90, 90)), (0, 0), 2.0)
    reference = cv2.normalize(reference, None, 20.0, 235.0, cv2.NORM_MINMAX).astype(np.uint8)
    matrix = np.array([[1.0, 0.0, 3.4], [0.0, 1.0, -2.3]])
    moved = cv2.warpAffine(reference, matrix, (90, 90), flags=cv2.INTER_CUBIC)
    # A gleam over a tenth of it.
    moved[30:80, 44:49] = cv2.add(moved[30:80, 44:49], 60)
    assert block_found(reference, moved, 45, 45) == pytest.approx((48.4, 42.7), abs=0.15)
    other = rng.uniform(0.0, 255.0, (90, 90)).astype(np.uint8)
    assert np.isnan(block_found(reference, other, 45, 45)).all()
