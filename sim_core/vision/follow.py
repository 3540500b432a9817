"""Every package followed from picture to picture: by its print, checked and rescued by its tags, or given up."""

from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from config.scene import Scene
from sim_core.camera.layout import side_of
from sim_core.frames import Array
from sim_core.vision.faces import COARSE, MOST_POINTS, Face, FaceTracker, in_plane, moved_in_plane
from sim_core.vision.motion import Motions, fit_motions
from sim_core.vision.plane import Sight
from sim_core.vision.tags import TagTracker

Grey = NDArray[np.uint8]
Flags = NDArray[np.bool_]
State = Literal["tracked", "occluded", "blurred", "out of view", "lost"]
TRACKED: State = "tracked"

FACE_POINT_PX, BLOCK_POINT_PX, TAG_POINT_PX = 0.06, 0.15, 0.1
"""Least standard deviation of a point of a carton's print, of a block of it, and of a tag's corner."""
TOLERANCE_PX = 2.5
LEAST_POINTS, LEAST_SHARE = 4, 0.2
BLOCKS_SHARE = 0.25
"""So many of a face's blocks have to agree."""
UNSURE_SHARE = 0.7
"""Where less than this share of the points agrees, those that don't give way to others."""
STRONG_SHARE, WEAK_REACH, MOST_SPREAD_PX = 0.45, 0.08, 0.4
"""Where less than this share of the points agrees, packages leap less far, and the points must agree better."""
WEAK_M = 1.5e-3
"""Standard deviation of what few points say beyond what they differ by, measured behind film."""
BLUR_PX = 3.0
JUMP_M, JUMP_MORE_M, MOST_JUMP_M = 0.08, 0.05, 0.35
"""How far a package may be from where its speed foretells it; how much more for each picture without it; the most."""
NEIGHBOUR_SHARE = 0.45
"""Of the shorter edge of a face: so far a package may leap, whose neighbours look like it."""
PICTURES_A_TAG_CHECK = 10
DISAGREEMENT_M = 0.05
"""Print that is so far from where the tags say is another package's."""
_SEARCHES_A_PICTURE, _BLOCKS_A_PICTURE = 3, 5
AGREES_PX = 2.0
"""A point that is so near to where its face's motion takes it goes on being followed."""
_LEAST_MATCH = 0.6
SELDOM_AFTER, PICTURES_A_RETRY = 10, 5
"""After so many pictures without it a package is looked for in every so many only."""


@dataclass(frozen=True, eq=False)
class Followed:
    """Where the packages are in one picture.

    Attributes:
        displacement: of each face's centre and corners along right and up [m], shape [n, 5, 2]; NaN where not tracked.
        variance: of each [m²], shape [n, 5, 2].
        turn: of each face in the picture's plane [rad], shape [n].
        states: of each package.
        by_tags: which were found by their tags, shape [n].
    """

    displacement: Array
    variance: Array
    turn: Array
    states: tuple[State, ...]
    by_tags: Flags


class PackageFollower:
    """Follows the faces of a load.

    Args:
        scene: a resolved scene with a camera.
        faces: the faces that the camera sees.
        sight: the camera as the first picture shows it.
    """

    def __init__(self, scene: Scene, faces: list[Face], sight: Sight) -> None:
        assert scene.camera is not None
        self._faces, self._side = faces, side_of(scene)
        self._shutter_s = scene.camera.shutter_s
        self._size = (sight.view.width, sight.view.height)
        self._centres = in_plane(np.array([face.centre for face in faces]), self._side)
        corners = in_plane(np.array([face.corners for face in faces]), self._side)
        self._spots = np.concatenate((self._centres[:, None], corners), axis=1)
        self._narrow = np.linalg.norm(np.diff(corners[:, :3], axis=1), axis=2).min(axis=1)
        self._depths = np.array([face.centre @ self._side.normal for face in faces])
        self._distance = sight.view.position @ self._side.normal - self._depths
        self.pixel_m = float(self._distance.mean()) / float(sight.view.matrix[0, 0])
        # A film holds the packages in one plane, and its gleams on them look like anything.
        self._may_come_out = scene.film is None
        self._came_out = np.zeros(len(faces), dtype=np.bool_)
        self._tracker = FaceTracker(scene, faces, sight)
        is_marked = scene.camera.markers is not None
        self._tags = TagTracker(scene, faces, self.pixel_m) if is_marked else None
        self._motion, self._rate = np.zeros((len(faces), 3)), np.zeros((len(faces), 3))
        self._missed = np.zeros(len(faces), dtype=int)
        self._count = 0

    def refer(self, grey: Grey, sight: Sight) -> None:
        """Takes a picture of the load as it stands before the start."""
        self._tracker.refer(grey, sight, 0.0)
        if self._tags is not None:
            self._tags.refer(grey, sight, self._load_region(sight, 0.0))

    def follow(self, grey: Grey, sight: Sight, travel_m: float, step_s: float) -> Followed:
        """Takes the next picture.

        Args:
            grey: the picture, shape [height, width].
            sight: the camera.
            travel_m: of the sled, along the side's ``right``.
            step_s: time since the picture before [s].
        """
        # Nothing is foretold to go on for long: what is lost stays where it was last seen.
        foretold = self._motion + step_s * np.where(self._missed[:, None] > 2, 0.0, self._rate)
        self._count += 1
        motions, good = self._by_print(grey, sight, travel_m, foretold)
        by_tags = np.zeros(len(self._faces), dtype=bool)
        if self._tags is not None and (not good.all() or self._count % PICTURES_A_TAG_CHECK == 0):
            motions, good, by_tags = self._by_tags(grey, sight, travel_m, foretold, motions, good)
        displacement, variance = motions.displaced(self._spots, self._centres)
        displacement[~good], variance[~good] = np.nan, np.nan
        states = [TRACKED] * len(self._faces)
        outlines = self._outlines(foretold) if not good.all() else np.zeros(0)
        for number in np.flatnonzero(~good).tolist():
            states[number] = self._why_not(number, outlines, good, sight, travel_m)
        # What is not so in two pictures in a row is noise.
        self._came_out = motions.comes_out & good
        self._keep(good, np.column_stack((motions.centre, motions.turn)), step_s)
        variance += np.where(by_tags | (motions.share >= STRONG_SHARE), 0.0, WEAK_M)[:, None, None] ** 2
        # What moves is seen where it was half the exposure before the stamp.
        variance = variance + (0.5 * self._shutter_s * self._rate[:, None, :2]) ** 2
        return Followed(displacement, variance, np.where(good, motions.turn, np.nan), tuple(states), by_tags)

    def _by_print(self, grey: Grey, sight: Sight, travel: float, foretold: Array) -> tuple[Motions, Flags]:
        """Motions by the faces' print, and which to believe; what was lost is looked for, a few a picture."""
        before = self._tracker.before(sight)
        after = np.full((len(self._faces), MOST_POINTS, 2), np.nan)
        nobody = np.zeros(len(self._faces), dtype=bool)
        is_turn = (self._count + np.arange(len(self._faces))) % PICTURES_A_RETRY == 0
        looked = np.flatnonzero((self._missed < SELDOM_AFTER) | is_turn).tolist()
        if looked:
            after[looked] = self._tracker.find(grey, sight, travel, foretold, looked)
        motions = self._fitted(before, after, foretold, nobody, travel, sight)
        good = self._are_good(motions, nobody, foretold)
        doubtful = [k for k in looked if not good[k] or motions.share[k] < STRONG_SHARE]
        # What is lost comes first, and of that the least long lost.
        doubtful.sort(key=lambda k: (bool(good[k]), int(self._missed[k]), float(motions.share[k])))
        doubtful = doubtful[:_BLOCKS_A_PICTURE]
        if doubtful:
            motions = self._by_blocks(grey, sight, travel, foretold, motions, doubtful)
            good = self._are_good(motions, nobody, foretold)
        lost = sorted((k for k in looked if not good[k]), key=lambda k: int(self._missed[k]))
        again, found = foretold.copy(), []
        coarse = _shrunk(grey) if lost else grey
        for number in lost[:_SEARCHES_A_PICTURE]:
            reach = float(self._reach_m[number])
            again[number], score = self._tracker.search(
                coarse, sight, travel, foretold, number, reach_m=reach
            )
            if score > _LEAST_MATCH:
                found.append(number)
        if found:
            motions = self._by_blocks(grey, sight, travel, again, motions, found)
            good = self._are_good(motions, nobody, foretold)
        there = motions.moved(np.nan_to_num(before), self._centres)
        agrees = np.linalg.norm(after - there, axis=2) < AGREES_PX * self.pixel_m
        unsure = [k for k in looked if not good[k] or motions.share[k] < UNSURE_SHARE]
        self._tracker.exchange(agrees & good[:, None], unsure)
        return motions, good

    def _by_blocks(
        self, grey: Grey, sight: Sight, travel: float, foretold: Array, motions: Motions, chosen: list[int]
    ) -> Motions:
        """The motions with those of some faces by their blocks, where enough of these agree."""
        before = self._tracker.blocks_before(sight, chosen)
        after = self._tracker.find_blocks(grey, sight, travel, foretold, chosen)
        nobody = np.zeros(len(self._faces), dtype=bool)
        found = self._fitted(before, after, foretold, nobody, travel, sight, chosen)
        taken = np.flatnonzero((found.share >= BLOCKS_SHARE) & (found.used > LEAST_POINTS)).tolist()
        return motions.with_rows([chosen[k] for k in taken], found.of(taken))

    def _by_tags(
        self, grey: Grey, sight: Sight, travel: float, foretold: Array, motions: Motions, good: Flags
    ) -> tuple[Motions, Flags, Flags]:
        """The same with the tags read: they know which package is which."""
        assert self._tags is not None
        tagged = self._tags.find(grey, sight, travel, self._load_region(sight, travel))
        both = np.where(np.isfinite(tagged), self._tags.before(sight), np.nan)
        is_read = np.isfinite(both).all(axis=2).sum(axis=1) >= LEAST_POINTS
        rough = np.nan_to_num(np.nanmean(np.where(is_read[:, None, None], tagged - both, 0.0), axis=1))
        told = np.where(is_read[:, None], np.column_stack((rough, foretold[:, 2])), foretold)
        by_tags = self._fitted(both, tagged, told, is_read, travel, sight)
        # The tags' corners are fewer than the print's points: they only overrule what went astray.
        apart = np.linalg.norm(by_tags.centre - motions.centre, axis=1)
        is_taken = is_read & self._are_good(by_tags, is_read, foretold) & (~good | (apart > DISAGREEMENT_M))
        merged = motions.replaced(by_tags, is_taken)
        return merged, self._are_good(merged, is_taken, foretold) & (good | is_taken), is_taken

    def _load_region(self, sight: Sight, travel: float) -> tuple[int, int, int, int]:
        """Where in the picture the load was last, and a little around it: left, top, right and bottom [px]."""
        pixels = sight.project(self._outlines(self._motion).reshape(-1, 3), travel)
        reach = 0.1 / self.pixel_m
        low = np.clip(np.nanmin(pixels, axis=0) - reach, 0, self._size).astype(int).tolist()
        high = np.clip(np.nanmax(pixels, axis=0) + reach, 0, self._size).astype(int).tolist()
        return low[0], low[1], high[0], high[1]

    def _fitted(
        self,
        before: Array,
        after: Array,
        near: Array,
        is_tagged: Flags,
        travel: float,
        sight: Sight,
        chosen: list[int] | None = None,
    ) -> Motions:
        """Motions of all faces by points, or of the chosen ones by blocks."""
        rows = chosen if chosen is not None else list(range(len(self._faces)))
        least_px = FACE_POINT_PX if chosen is None else BLOCK_POINT_PX
        return fit_motions(
            before,
            after,
            self._centres[rows],
            in_plane(sight.view.position - travel * sight.direction, self._side),
            self._distance[rows],
            point_sigma_m=self.pixel_m * np.where(is_tagged[rows], TAG_POINT_PX, least_px),
            tolerance_m=self.pixel_m * TOLERANCE_PX,
            moved_m=np.linalg.norm(near[rows, :2], axis=1),
            may_come_out=self._came_out[rows] if self._may_come_out else None,
        )

    @property
    def _reach_m(self) -> Array:
        """How far from where it is foretold a package may be that was last seen some pictures ago [m], shape [n].

        Never as far as a neighbour that is printed alike.
        """
        most = np.minimum(MOST_JUMP_M, NEIGHBOUR_SHARE * self._narrow)
        reach: Array = np.minimum(JUMP_M + JUMP_MORE_M * self._missed, most)
        return reach

    def _are_good(self, motions: Motions, is_tagged: Flags, foretold: Array) -> Flags:
        """Which motions to believe: enough points agree, no leap, and no two packages in one place.

        Cartons are printed alike: a leap may be the neighbour's print.
        """
        good = (motions.used >= LEAST_POINTS) & (motions.share >= LEAST_SHARE)
        leap = np.linalg.norm(motions.centre - foretold[:, :2], axis=1)
        # The fewer points agree, the less of a surprise is believed.
        is_strong = motions.share >= STRONG_SHARE
        is_sharp = motions.spread_m < MOST_SPREAD_PX * self.pixel_m
        good &= is_tagged | (leap < self._reach_m * np.where(is_strong, 1.0, WEAK_REACH))
        good &= is_strong | (is_sharp & (motions.used > LEAST_POINTS))
        places = np.where(good[:, None], self._centres + motions.centre, np.nan)
        apart = np.linalg.norm(places[:, None] - places[None], axis=2)
        room = 0.5 * np.minimum(self._narrow[:, None], self._narrow[None])
        clash = (apart < room) & (np.abs(self._depths[:, None] - self._depths[None]) < 0.1)
        np.fill_diagonal(clash, False)
        distrust = np.where(is_tagged, 0.0, 1.0 + leap)
        good &= ~(clash & (distrust[:, None] >= distrust[None])).any(axis=1)
        return good

    def _why_not(self, number: int, outlines: Array, good: Flags, sight: Sight, travel: float) -> State:
        """Why a package is not tracked: it is out of the picture, smeared, behind another, or just lost."""
        pixels = sight.project(outlines[number], travel)
        if not ((pixels > 0).all() and (pixels < np.array(self._size) - 1).all()):
            return "out of view"
        speed = float(np.linalg.norm(self._rate[number, :2]))
        if speed * self._shutter_s / self.pixel_m > BLUR_PX:
            return "blurred"
        flat = in_plane(outlines, self._side)
        low, high = flat.min(axis=1), flat.max(axis=1)
        shared = np.clip(np.minimum(high[number], high) - np.maximum(low[number], low), 0.0, None).prod(
            axis=1
        )
        others = good & (shared > 0.3 * (high[number] - low[number]).prod())
        return "occluded" if others.any() else "lost"

    def _outlines(self, motions: Array) -> Array:
        """Corners of the faces along motions, frame ``sled`` [m], shape [n, 4, 3]."""
        return np.array(
            [
                moved_in_plane(face.corners, face.centre, self._side, motion[:2], float(motion[2]))
                for face, motion in zip(self._faces, motions, strict=True)
            ]
        )

    def _keep(self, good: Flags, motion: Array, step_s: float) -> None:
        """Keeps where the packages are and how fast they go."""
        steps = step_s * (1 + self._missed[:, None])
        rate = np.where(self._missed[:, None] < 5, (motion - self._motion) / steps, 0.0)
        self._rate = np.where(good[:, None], rate, self._rate)
        self._motion = np.where(good[:, None], motion, self._motion)
        self._missed = np.where(good, 0, self._missed + 1)


def _shrunk(grey: Grey) -> Grey:
    height, width = grey.shape
    size = (width // COARSE, height // COARSE)
    whole = grey[: size[1] * COARSE, : size[0] * COARSE]
    return np.asarray(cv2.resize(whole, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
