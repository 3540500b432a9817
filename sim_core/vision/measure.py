"""Displacement of a load's packages relative to the sled, measured picture by picture from nothing but the pictures."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from config.errors import RefusedInput
from config.scene import Scene
from sim_core.camera.layout import TARGET_RADIUS_M
from sim_core.frames import Array
from sim_core.vision.faces import Face, faces_of, in_plane
from sim_core.vision.follow import TRACKED, Followed, PackageFollower, State
from sim_core.vision.plane import Sight, SightFinder, undistorted
from sim_core.vision.targets import TargetTracker, find_targets
from sim_core.vision.verdict import MeasuredTest, judged

Grey = NDArray[np.uint8]

MOST_STILL_PICTURES = 16
STILL_M = 2.0e-4
"""The sled counts as standing while the targets are within this of their first places."""
PRINT_FLOOR_M, TAG_FLOOR_M = 2.0e-4, 5.0e-4
"""Standard deviations of what neither residuals nor the pose's covariance know of, measured on rendered scenes."""


@dataclass(frozen=True, eq=False)
class Measurement:
    """What one picture says. The points of a package are its face's centre and corners, clockwise from the upper left.

    Attributes:
        stamp_ns: of the picture [ns].
        time_s: since the first picture [s].
        sled_m: travel of the sled along the side's ``right``, from its targets; taken off the displacements [m].
        sled_sigma_m: its standard uncertainty [m].
        rows: of the packages in a pose frame, shape [n].
        displacement: along the side's ``right`` and up, frame ``sled``, since the reference pictures [m],
            shape [n, 5, 2]; NaN where a package is not tracked.
        sigma: standard uncertainty of each [m], shape [n, 5, 2].
        turn: of each face in the picture's plane, counter-clockwise [rad], shape [n].
        states: of each package.
        start_rays: undistorted, of the points on the standing load before the start, as the camera's pose was known at
            this picture, shape [n, 5, 2].
        rays: of the points now, in the same way, shape [n, 5, 2].
        target_rays: undistorted, of the sled's targets, shape [target_count, 2]; NaN where not seen.
    """

    stamp_ns: int
    time_s: float
    sled_m: float
    sled_sigma_m: float
    rows: NDArray[np.intp]
    displacement: Array
    sigma: Array
    turn: Array
    states: tuple[State, ...]
    start_rays: Array
    rays: Array
    target_rays: Array


class DisplacementMeasurer:
    """Takes pictures in order and measures how the packages move relative to the sled.

    It is told what a laboratory knows: the camera's calibration, the load as it was stacked and where targets and
    markers stand. The camera's pose and the sled's travel come from the targets.

    What is measured are two components, along the side's ``right`` and up, of the faces that look at the camera. The
    standard's displacement is the distance in space of any corner of any package: what moves towards the camera, and
    packages behind others, are not seen. ``verdict.py`` carries a term for that.

    Args:
        scene: a resolved scene that has a camera.
        matrix: intrinsics K, shape [3, 3].
        distortion: k1, k2, p1, p2, k3, shape [5].
        width: of the pictures [px].
        height: of the pictures [px].

    Raises:
        RefusedInput: the scene has no camera, or no package faces it.

    Attributes:
        faces: what is measured, in the order of the rows of a measurement.
        measurements: of every picture so far.
    """

    def __init__(self, scene: Scene, matrix: Array, distortion: Array, width: int, height: int) -> None:
        if scene.camera is None:
            raise RefusedInput("camera", None, "must say what is put up for the camera to see")
        self.scene = scene
        self.faces: list[Face] = faces_of(scene)
        if not self.faces:
            raise RefusedInput("load", len(scene.packages), "must have a package whose side faces the camera")
        self.finder = SightFinder(scene, matrix, distortion, width, height)
        self.side = self.finder.side
        self.measurements: list[Measurement] = []
        self._size = (width, height)
        # Of every picture, without what the pose does: that gets smaller as the sled goes on.
        self._variances: list[Array] = []
        corners = np.array([face.corners for face in self.faces])
        self._spots = in_plane(
            np.concatenate((corners.mean(axis=1, keepdims=True), corners), axis=1), self.side
        )
        self._depths = np.array([face.centre @ self.side.normal for face in self.faces])
        self._still_count = 0
        self._is_still = True

    def take(self, stamp_ns: int, picture: NDArray[np.uint8]) -> Measurement:
        """Measures the next picture.

        Args:
            stamp_ns: its time [ns]; later than the one before.
            picture: RGB, shape [height, width, 3].

        Raises:
            RefusedInput: the picture has another size or comes too early, or the first one shows too few targets.
        """
        if picture.shape != (self._size[1], self._size[0], 3):
            raise RefusedInput("picture", picture.shape, f"must be {self._size[1]} by {self._size[0]} by 3")
        if self.measurements and stamp_ns <= self.measurements[-1].stamp_ns:
            raise RefusedInput(
                "stamp_ns",
                stamp_ns,
                f"must be later than {self.measurements[-1].stamp_ns} of the picture before",
            )
        grey = np.asarray(cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY), dtype=np.uint8)
        measured = self._go_on(stamp_ns, grey) if self.measurements else self._begin(stamp_ns, grey)
        self.measurements.append(measured)
        return measured

    def result(self) -> MeasuredTest:
        """The test as measured so far, with every picture seen through the camera's pose as it is known now.

        Raises:
            RefusedInput: no picture has been taken yet.
        """
        if not self.measurements:
            raise RefusedInput("pictures", 0, "must be at least one")
        displacement, sigma = self.displacements()
        return judged(self.scene, self.faces, self.measurements, displacement, sigma)

    def displacements(self) -> tuple[Array, Array]:
        """All displacements and standard uncertainties through the pose as known now [m], shape [pictures, n, 5, 2]."""
        sight = self.finder.sight
        moved, sigma = [np.zeros_like(self._variances[0])], [np.zeros_like(self._variances[0])]
        for measured, own in zip(self.measurements[1:], self._variances[1:], strict=True):
            travel = self.finder.travel(measured.target_rays, near_m=measured.sled_m)[0]
            start = self._places(sight, measured.start_rays, 0.0)
            moved.append(self._places(sight, measured.rays, travel) - start)
            rays = measured.start_rays, measured.rays, measured.target_rays
            sigma.append(np.sqrt(own + self._pose_variance(*rays, travel)))
        return np.array(moved), np.array(sigma)

    def _begin(self, stamp_ns: int, grey: Grey) -> Measurement:
        """The first picture: finds the camera's pose and takes the reference."""
        targets = self._search_targets(grey)
        sight = self.finder.begin(targets)
        depths = sight.view.in_optical(self.finder.targets)[:, 2]
        self._targets = TargetTracker(sight.view.matrix[0, 0] * TARGET_RADIUS_M / depths)
        self._follower = PackageFollower(self.scene, self.faces, sight)
        self._follower.refer(grey, sight)
        count = len(self.faces)
        still = Followed(
            displacement=np.zeros((count, 5, 2)),
            variance=np.zeros((count, 5, 2)),
            turn=np.zeros(count),
            states=(TRACKED,) * count,
            by_tags=np.zeros(count, dtype=bool),
        )
        return self._measurement(stamp_ns, targets, (0.0, 0.0), still)

    def _go_on(self, stamp_ns: int, grey: Grey) -> Measurement:
        """Every later picture."""
        newest = self.measurements[-1]
        step_s = 1.0e-9 * (stamp_ns - newest.stamp_ns)
        targets = self._find_targets(grey, step_s)
        travel, sigma = self.finder.travel(self._rays(targets), near_m=newest.sled_m)
        if not np.isfinite(travel):
            return self._blind(stamp_ns, targets)
        sight = self.finder.add(targets, travel)
        followed = self._follower.follow(grey, sight, travel, step_s)
        self._is_still = self._is_still and abs(travel) < STILL_M and self._still_count < MOST_STILL_PICTURES
        if self._is_still:
            self._follower.refer(grey, sight)
            self._still_count += 1
        return self._measurement(stamp_ns, targets, (travel, sigma), followed)

    def _blind(self, stamp_ns: int, targets: Array) -> Measurement:
        """A picture that shows no target: nothing is known relative to the sled."""
        count = len(self.faces)
        nothing = np.full((count, 5, 2), np.nan)
        lost: list[State] = ["lost" for _ in self.faces]
        followed = Followed(
            nothing, nothing, np.full(count, np.nan), tuple(lost), np.zeros(count, dtype=bool)
        )
        return self._measurement(stamp_ns, targets, (self.measurements[-1].sled_m, float("nan")), followed)

    def _rays(self, pixels: Array) -> Array:
        return undistorted(pixels, self.finder.matrix, self.finder.distortion)

    def _search_targets(self, grey: Grey) -> Array:
        board = np.column_stack((self.finder.targets @ self.side.right, -self.finder.targets[:, 2]))
        return find_targets(grey, board, self.finder.matrix, self.finder.distortion)[0]

    def _find_targets(self, grey: Grey, step_s: float) -> Array:
        """The targets where the sled's speed foretells them, or anywhere."""
        newest, speed = self.measurements[-1], 0.0
        if len(self.measurements) > 1:
            earlier = self.measurements[-2]
            speed = (newest.sled_m - earlier.sled_m) / (1.0e-9 * (newest.stamp_ns - earlier.stamp_ns))
        foretold = self.finder.sight.project(self.finder.targets, newest.sled_m + step_s * speed)
        targets = self._targets.follow(grey, foretold)
        if np.isfinite(targets).all(axis=1).sum() < 2:
            targets = self._search_targets(grey)
        return targets

    def _places(self, sight: Sight, rays: Array, travel_m: float) -> Array:
        """Where rays meet the faces' planes, along right and up, frame ``sled`` [m], shape [n, k, 2]."""
        depths = np.repeat(self._depths, rays.shape[1])
        return sight.on_plane(rays.reshape(-1, 2), self.side, depths, travel_m).reshape(rays.shape)

    def _rays_of(self, sight: Sight, places: Array, travel_m: float) -> Array:
        """The other way round: undistorted rays of places on the faces' planes, shape [n, k, 2]."""
        points = (
            places[..., :1] * self.side.right
            + self._depths[:, None, None] * self.side.normal
            + places[..., 1:] * np.array([0.0, 0.0, 1.0])
        )
        return self._rays(sight.project(points.reshape(-1, 3), travel_m)).reshape(places.shape)

    def _pose_variance(self, start_rays: Array, rays: Array, target_rays: Array, travel_m: float) -> Array:
        """What the pose's uncertainty does to the displacement of the faces' centres [m²], shape [n, 1, 2]."""
        sight, middle, first = self.finder.sight, rays[:, :1], start_rays[:, :1]
        base = self._places(sight, middle, travel_m) - self._places(sight, first, 0.0)
        total = np.zeros_like(base)
        for other in sight.varied():
            travel = self.finder.travel(target_rays, near_m=travel_m, sight=other)[0]
            moved = self._places(other, middle, travel) - self._places(other, first, 0.0)
            total += (moved - base) ** 2
        return total

    def _measurement(
        self, stamp_ns: int, targets: Array, sled: tuple[float, float], followed: Followed
    ) -> Measurement:
        sight = self.finder.sight
        start_rays = self._rays_of(sight, self._spots, 0.0)
        rays = self._rays_of(sight, self._spots + followed.displacement, sled[0])
        target_rays = self._rays(targets)
        own = followed.variance.copy()
        pose = np.zeros_like(own)
        if self.measurements:
            own += np.where(followed.by_tags, TAG_FLOOR_M, PRINT_FLOOR_M)[:, None, None] ** 2
            own[..., 0] += sled[1] ** 2
            pose = self._pose_variance(start_rays, rays, target_rays, sled[0])
        self._variances.append(own)
        first_ns = self.measurements[0].stamp_ns if self.measurements else stamp_ns
        return Measurement(
            stamp_ns=stamp_ns,
            time_s=1.0e-9 * (stamp_ns - first_ns),
            sled_m=sled[0],
            sled_sigma_m=sled[1],
            rows=np.array([face.row for face in self.faces]),
            displacement=followed.displacement,
            sigma=np.sqrt(own + pose),
            turn=followed.turn,
            states=followed.states,
            start_rays=start_rays,
            rays=rays,
            target_rays=target_rays,
        )
