"""From pixels to the load's near side: the camera's pose found from the sled's targets, and planes seen through it.

The camera stands still and the sled's board of targets moves past it on a straight line, so all pictures together
fix the pose far better than the first one does. What is called world here is frame ``sled`` while the sled stands
before the start: the camera's true place on the bench is neither known nor needed.
"""

from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from config.errors import RefusedInput
from config.scene import Scene
from sim_core.camera.layout import BOARD_GAP_M, Side, side_of, targets_of
from sim_core.camera.view import CameraView
from sim_core.frames import Array
from sim_core.sled import build_profile

TARGET_SIGMA_PX = 0.02
"""Least standard deviation of a target's centre, as measured on rendered pictures: few targets hide it in a fit."""
SLOPE_SIGMA = 2.0e-3
"""How straight with the board the rails may be taken to run [rad]."""
MOST_PICTURES = 48
_STEPS = np.array([1e-5, 1e-5, 1e-5, 1e-4, 1e-4, 1e-4, 1e-5, 1e-5])


def undistorted(pixels: Array, matrix: Array, distortion: Array) -> Array:
    """Rays x = X/Z, y = Y/Z of pixels, shape [n, 2] to [n, 2]; NaN stays NaN."""
    if not len(pixels):
        return np.zeros((0, 2))
    known = np.nan_to_num(np.asarray(pixels, dtype=float))
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 20, 1e-10)
    rays = cv2.undistortPoints(known[:, None], matrix, distortion, criteria=criteria)[:, 0]
    return np.where(np.isfinite(pixels), rays, np.nan)


@dataclass(frozen=True, eq=False)
class Sight:
    """A camera pose, the direction of the rails, and how sure both are.

    Attributes:
        view: the camera, relative to frame ``sled`` before the start.
        direction: travel of the sled for each metre along the side's ``right``, shape [3].
        covariance: of rotation [rad], translation [m] and the rails' slopes up and out, shape [8, 8].
        residual_px: root mean square of what the targets leave over [px].
    """

    view: CameraView
    direction: Array
    covariance: Array
    residual_px: float

    def on_plane(self, rays: Array, side: Side, depth_m: Array | float, travel_m: float) -> Array:
        """Where rays meet a plane that moves with the sled: along ``right`` and up, frame ``sled`` [m], shape [n, 2].

        Args:
            rays: undistorted, shape [n, 2].
            side: the side of the load that the camera sees.
            depth_m: place of the plane along the side's normal, frame ``sled`` [m], one or shape [n].
            travel_m: of the sled along the side's ``right`` [m].
        """
        origin = self.view.position - travel_m * self.direction
        homogeneous = np.column_stack((rays, np.ones(len(rays))))
        directions = homogeneous @ self.view.rotation
        reach = (depth_m - origin @ side.normal) / (directions @ side.normal)
        points = origin + reach[:, None] * directions
        return np.column_stack((points @ side.right, points[:, 2]))

    def project(self, points_sled: Array, travel_m: float) -> Array:
        """Pixels of points of frame ``sled``, shape [n, 3] to [n, 2]."""
        return self.view.project(points_sled + travel_m * self.direction)

    def varied(self) -> list["Sight"]:
        """The sight moved by one standard deviation along each of the independent errors of its pose."""
        values, vectors = np.linalg.eigh(self.covariance)
        return [
            _moved(self, np.sqrt(max(value, 0.0)) * vector)
            for value, vector in zip(values, vectors.T, strict=True)
        ]


def rails(scene: Scene, side: Side) -> Array:
    """Travel of the sled for each metre along the side's ``right``, as the scene has it, shape [3]."""
    profile = build_profile(scene)
    far = profile.positions[np.argmax(np.abs(profile.positions @ side.right))]
    along = float(far @ side.right)
    return far / along if abs(along) > 1.0e-6 else side.right.copy()


class SightFinder:
    """Finds the camera's pose and the sled's travel from the targets of all pictures so far.

    Args:
        scene: a resolved scene with a camera; its camera tells only what is put up where, never the pose.
        matrix: intrinsics K, shape [3, 3].
        distortion: k1, k2, p1, p2, k3, shape [5].
        width: of the pictures [px].
        height: of the pictures [px].
    """

    def __init__(self, scene: Scene, matrix: Array, distortion: Array, width: int, height: int) -> None:
        self.side = side_of(scene)
        self.targets = targets_of(scene)
        self.matrix, self.distortion = np.asarray(matrix, dtype=float), np.asarray(distortion, dtype=float)
        self._size = (width, height)
        self._rails = rails(scene, self.side)
        self._seen: list[Array] = []
        self._travels: list[float] = []
        self._sight: Sight | None = None

    @property
    def sight(self) -> Sight:
        """The newest estimate."""
        assert self._sight is not None
        return self._sight

    def begin(self, pixels: Array) -> Sight:
        """Takes the targets of the first picture, shape [n, 2], NaN where not seen.

        Raises:
            RefusedInput: fewer than five targets are seen.
        """
        seen: NDArray[np.bool_] = np.asarray(np.isfinite(pixels).all(axis=1))
        if seen.sum() < 5:
            raise RefusedInput("picture", int(seen.sum()), "must show at least 5 of the sled's targets")
        self._sight = replace(self._first(pixels, seen), direction=self._rails)
        self._seen, self._travels = [pixels], [0.0]
        self._refine()
        return self._sight

    def travel(self, rays: Array, *, near_m: float, sight: Sight | None = None) -> tuple[float, float]:
        """Travel along ``right`` [m], and its standard uncertainty [m]; outliers are refused. NaN if nothing is seen.

        Args:
            rays: undistorted, of the targets, shape [n, 2]; NaN where not seen.
            near_m: about the travel.
            sight: the camera, where it is not the newest estimate.
        """
        sight, side = sight or self.sight, self.side
        seen = np.flatnonzero(np.isfinite(rays).all(axis=1))
        if not len(seen):
            return float("nan"), float("nan")
        pixel_m = float(sight.view.in_optical(self.targets)[:, 2].mean()) / self.matrix[0, 0]
        own, depths = self.targets[seen] @ side.right, self.targets[seen] @ side.normal
        travel = near_m
        for _ in range(2):
            # The plane's depth changes with the travel where the rails run at an angle.
            off = sight.on_plane(rays[seen], side, depths, travel)[:, 0] - own
            apart = np.abs(off - np.median(off))
            kept = apart <= max(4.0 * float(np.median(apart)), 0.3 * pixel_m)
            travel += float(off[kept].mean())
        sigma = max(float(np.std(off[kept])), TARGET_SIGMA_PX * pixel_m) / float(np.sqrt(kept.sum()))
        return travel, sigma

    def add(self, pixels: Array, travel_m: float) -> Sight:
        """Takes the targets of a further picture with its travel, and sharpens the pose where that tells anything."""
        reach = max(0.02, 0.02 * float(np.ptp(self._travels)))
        if (
            np.isfinite(pixels).all(axis=1).sum() >= 3
            and min(abs(travel_m - s) for s in self._travels) > reach
        ):
            self._seen.append(pixels)
            self._travels.append(travel_m)
            if len(self._seen) > MOST_PICTURES:
                # Of the two nearest neighbours one goes.
                order = np.argsort(self._travels)
                gaps = np.diff(np.array(self._travels)[order])
                closest = int(np.argmin(gaps[1:])) + 1 if len(gaps) > 1 else 0
                gone = int(order[closest + 1])
                gone = gone if gone else int(order[closest])
                del self._seen[gone], self._travels[gone]
            self._refine()
        return self.sight

    def _first(self, pixels: Array, seen: NDArray[np.bool_]) -> Sight:
        """Pose of a flat board: of the two that fit alike, the one of a level camera.

        Raises:
            RefusedInput: no pose fits.
        """
        board = np.column_stack(
            (self.targets @ self.side.right, -self.targets[:, 2], np.zeros(len(self.targets)))
        )
        middle = board[seen].mean(axis=0)
        _, turns, shifts, _ = cv2.solvePnPGeneric(
            board[seen] - middle, pixels[seen], self.matrix, self.distortion, flags=cv2.SOLVEPNP_IPPE
        )
        if not turns:
            raise RefusedInput("picture", int(seen.sum()), "shows targets that are on no board")
        # Counted here: OpenCV may tell more errors than poses.
        errors = [
            self._off_px(board[seen] - middle, pixels[seen], *pose)
            for pose in zip(turns, shifts, strict=True)
        ]
        frame = np.array([self.side.right, [0.0, 0.0, -1.0], -self.side.normal])
        found = []
        for turn, shift, error in zip(turns, shifts, errors, strict=True):
            turn, shift = cv2.solvePnPRefineLM(
                board[seen] - middle, pixels[seen], self.matrix, self.distortion, turn, shift
            )
            rotation = np.asarray(cv2.Rodrigues(turn)[0])
            depth = self.side.near_m + BOARD_GAP_M
            # board = frame·(point) − middle, with the board's own depth taken off.
            offset = np.array([middle[0], middle[1], -depth])
            view = CameraView(
                *self._size, self.matrix, self.distortion, rotation @ frame, shift.ravel() - rotation @ offset
            )
            level = abs(float(view.rotation[1, 2] + 1.0))
            found.append((error / max(min(errors), 0.05) + 20.0 * level, view))
        best = min(found, key=lambda item: item[0])[1]
        return Sight(best, self._rails, np.zeros((8, 8)), 0.0)

    def _off_px(self, board: Array, pixels: Array, turn: Any, shift: Any) -> float:
        """Root mean square of how far a pose's targets are from where they are seen, each coordinate by itself [px]."""
        seen = cv2.projectPoints(board, turn, shift, self.matrix, self.distortion)[0].reshape(-1, 2)
        return float(np.sqrt(np.mean((seen - pixels) ** 2)))

    def _refine(self) -> None:
        """Gauss-Newton over pose, slopes of the rails and travels; these are eliminated picture by picture."""
        seen, travels = np.array(self._seen), np.array(self._travels)
        sight = self.sight
        count = len(seen)
        valid = np.asarray(np.isfinite(seen).all(axis=2))
        prior = np.zeros(8)
        prior[6:] = 1.0 / SLOPE_SIGMA**2
        for _ in range(4):
            base = self._predicted(sight, travels)
            residual = np.where(valid[..., None], np.nan_to_num(seen) - base, 0.0)
            sigma = max(TARGET_SIGMA_PX, 1.4826 * float(np.median(np.abs(residual[valid]))))
            weight = valid[..., None] / np.maximum(1.0, np.abs(residual) / (2.5 * sigma)) / sigma**2
            # The targets cross the columns of pixels but stay on their rows: what a place between two rows does to
            # them is the same in every picture.
            weight = weight * np.array([1.0, 1.0 / count])
            columns = np.stack(
                [
                    (self._predicted(_moved(sight, step * axis), travels) - base) / step
                    for axis, step in zip(np.eye(8), _STEPS, strict=True)
                ],
                axis=-1,
            ).reshape(count, -1, 8)
            along = ((self._predicted(sight, travels + 1e-4) - base) / 1e-4).reshape(count, -1)
            w, r = weight.reshape(count, -1), residual.reshape(count, -1)
            own = np.einsum("ki,ki,ki->k", along, w, along)
            own[0] = np.inf  # The first travel is 0 by definition.
            mixed = np.einsum("kia,ki,ki->ka", columns, w, along)
            pull = np.einsum("ki,ki,ki->k", along, w, r)
            normal = np.einsum("kia,ki,kib->ab", columns, w, columns) + np.diag(prior)
            normal -= np.einsum("ka,kb->ab", mixed / own[:, None], mixed)
            right = np.einsum("kia,ki,ki->a", columns, w, r) - (pull / own) @ mixed
            slopes = np.array(self._slopes(sight)) - np.array(
                self._slopes(replace(sight, direction=self._rails))
            )
            right[6:] -= slopes / SLOPE_SIGMA**2
            step = np.linalg.solve(normal, right)
            travels = travels + np.where(np.isfinite(own), (pull - mixed @ step) / own, 0.0)
            sight = _moved(sight, step)
            if np.abs(step / _STEPS).max() < 0.1:
                break
        left = float(np.sqrt(np.mean(residual[valid] ** 2)))
        self._sight = replace(sight, covariance=np.linalg.inv(normal), residual_px=left)
        self._travels = travels.tolist()

    def _slopes(self, sight: Sight) -> tuple[float, float]:
        return float(sight.direction[2]), float(sight.direction @ self.side.normal)

    def _predicted(self, sight: Sight, travels: Array) -> Array:
        points = self.targets[None] + travels[:, None, None] * sight.direction
        return sight.view.project(points.reshape(-1, 3)).reshape(len(travels), -1, 2)


def _moved(sight: Sight, step: Array) -> Sight:
    """The sight with its camera turned and shifted, and its rails tilted up and outwards."""
    view = sight.view
    turn = np.asarray(cv2.Rodrigues(step[:3])[0])
    outwards = np.cross(sight.direction, [0.0, 0.0, 1.0])
    outwards = outwards / max(float(np.linalg.norm(outwards)), 1e-12)
    return replace(
        sight,
        view=replace(view, rotation=turn @ view.rotation, translation=turn @ view.translation + step[3:6]),
        direction=sight.direction + np.array([0.0, 0.0, step[6]]) + step[7] * outwards,
    )
