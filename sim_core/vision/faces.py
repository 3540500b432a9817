"""The cartons' own faces as marks: each is cut out where it should be now, and its print found again in the cutting.

Every face has a tile. The tiles of the reference picture are compared with tiles cut from each later picture along the
motion that is foretold for the face, turned and shifted with it: so that what is left to be found is small, however far
the package went, and every picture is compared with the first and not with the one before, which would drift.

Some of what stands out in the first picture is no print: gleams and folds of a film, edges of shadows. They stay behind
or change as the sled goes on. So every face has more points than are followed, and those that go astray give way to
others; and where hardly any agree, blocks several times as large as a point's surroundings are looked for instead.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from config.scene import Scene
from sim_core.camera.layout import Side, facing_packages, near_face, side_of
from sim_core.frames import Array
from sim_core.geometry import rotation_matrices, yaw_quaternion
from sim_core.vision.plane import Sight, undistorted
from sim_core.vision.spots import Spots, block_found, block_spots, spots_found, strong_spots

Grey = NDArray[np.uint8]
Flags = NDArray[np.bool_]

MOST_POINTS = 24
_POOL_POINTS = 96
ASTRAY_PICTURES = 2
"""A point that disagrees with its face in so many pictures in a row gives way to another."""
_MOST_BLOCKS = 24
MOST_TILE_PIXELS = 5.0e5
_MARGIN_PX = 12
_AROUND_PX = 25
COARSE = 4
"""How many times smaller a picture is made to look for a lost face."""


@dataclass(frozen=True, eq=False)
class Face:
    """A face of the load that the camera sees.

    Attributes:
        row: of its package in a pose frame.
        id: of its package.
        corners: as stacked, frame ``sled`` [m], shape [4, 3]; clockwise as seen, from the upper left one.
    """

    row: int
    id: str
    corners: Array

    @property
    def centre(self) -> Array:
        """Its middle [m], shape [3]."""
        middle: Array = self.corners.mean(axis=0)
        return middle

    @property
    def normal(self) -> Array:
        """Unit vector out of the face, shape [3]."""
        out = np.cross(self.corners[1] - self.corners[0], self.corners[0] - self.corners[3])
        unit: Array = out / np.linalg.norm(out)
        return unit


def placed(scene: Scene, row: int, points: Array) -> Array:
    """Points of a package's own frame in frame ``sled``, as it was stacked [m], shape [n, 3]."""
    package = scene.packages[row - 1]
    rotation = rotation_matrices(np.array([yaw_quaternion(package.yaw_deg)]))[0]
    moved: Array = points @ rotation.T + np.array(package.position_m)
    return moved


def faces_of(scene: Scene) -> list[Face]:
    """The faces that the camera sees while the load stands as it was stacked."""
    faces = []
    for row in facing_packages(scene):
        corners = near_face(scene, row)
        assert corners is not None
        faces.append(Face(row, scene.packages[row - 1].id, placed(scene, row, corners)))
    return faces


def in_plane(points: Array, side: Side) -> Array:
    """Places of points of frame ``sled`` along the side's ``right`` and up [m], shape [..., 3] to [..., 2]."""
    return np.stack((points @ side.right, points[..., 2]), axis=-1)


def moved_in_plane(points: Array, centre: Array, side: Side, shift: Array, turn: float) -> Array:
    """Points moved along right and up [m] and turned about the side's normal at a centre [rad], shape [n, 3]."""
    arm = points - centre
    along, up = arm @ side.right, arm[:, 2]
    cos, sin = np.cos(turn), np.sin(turn)
    change_along = cos * along - sin * up - along + shift[0]
    change_up = sin * along + cos * up - up + shift[1]
    up_m = change_up[:, None] * np.array([0.0, 0.0, 1.0])
    moved: Array = points + change_along[:, None] * side.right + up_m
    return moved


class FaceTracker:
    """Finds the print of the faces again.

    Args:
        scene: a resolved scene.
        faces: the faces to follow.
        sight: the camera as the first picture shows it.
    """

    def __init__(self, scene: Scene, faces: list[Face], sight: Sight) -> None:
        self._side = side_of(scene)
        self._faces = faces
        view = sight.view
        depths = view.in_optical(np.array([face.centre for face in faces]))[:, 2]
        edges = np.array(
            [
                (
                    np.linalg.norm(face.corners[1] - face.corners[0]),
                    np.linalg.norm(face.corners[3] - face.corners[0]),
                )
                for face in faces
            ]
        )
        native = float(depths.mean()) / view.matrix[0, 0]
        self.pixel_m = max(native, float(np.sqrt(edges.prod(axis=1).sum() / MOST_TILE_PIXELS)))
        sizes = np.maximum(np.round(edges / self.pixel_m).astype(int), 8) + 2 * _MARGIN_PX
        self._tiles = _packed(sizes)
        self._shape = (
            max(y + h for _, y, _, h in self._tiles),
            max(x + w for x, _, w, _ in self._tiles),
        )
        # The face with its margin, so that a tile's pixel grid lies square on the face.
        self._frames = [
            _widened(face.corners, (w, h), margin=_MARGIN_PX)
            for face, (_, _, w, h) in zip(faces, self._tiles, strict=True)
        ]
        self._mean = np.zeros(self._shape, np.float32)
        self._taken = 0
        self._plain: Grey = np.zeros(self._shape, np.uint8)
        self._reference = self._plain
        self._pool = Spots(len(faces), _POOL_POINTS)
        self._blocks = Spots(len(faces), _MOST_BLOCKS)
        # Which of the pool are followed; in how many pictures in a row each went astray, and in how many in all.
        self._followed = np.tile(np.arange(MOST_POINTS), (len(faces), 1))
        self._astray = np.zeros((len(faces), _POOL_POINTS), dtype=int)
        self._distrust = np.zeros((len(faces), _POOL_POINTS), dtype=int)

    def refer(self, grey: Grey, sight: Sight, travel_m: float) -> None:
        """Takes a picture of the load as it stands before the start; several are averaged."""
        still = np.zeros((len(self._faces), 3))
        everyone = list(range(len(self._faces)))
        mosaic, homographies = self._cut(grey, sight, travel_m, still, everyone)
        self._taken += 1
        self._mean += (mosaic - self._mean) / self._taken
        self._plain = np.round(self._mean).astype(np.uint8)
        self._reference = self._evened(self._plain)
        if self._taken == 1:
            self._choose(sight, homographies)

    def before(self, sight: Sight) -> Array:
        """Where the points are on the standing load, along right and up [m], shape [n, points, 2]; NaN for no point.

        The camera's pose is known better as the sled goes on: places are compared as one and the same pose has them.
        """
        rays, depths = self._of(self._pool.rays), self._of(self._pool.depths)
        return sight.on_plane(rays.reshape(-1, 2), self._side, depths.ravel(), 0.0).reshape(rays.shape)

    def blocks_before(self, sight: Sight, chosen: list[int]) -> Array:
        """The same for the blocks of some faces, shape [chosen, points, 2]."""
        rays, depths = self._blocks.rays[chosen], self._blocks.depths[chosen]
        return sight.on_plane(rays.reshape(-1, 2), self._side, depths.ravel(), 0.0).reshape(rays.shape)

    def exchange(self, agrees: Flags, chosen: list[int]) -> None:
        """Lets points that go on disagreeing give way to those of the pool that did so least often.

        Args:
            agrees: which of the points moved with their face, shape [n, points].
            chosen: the faces that were looked for.
        """
        for number in chosen:
            followed = self._followed[number]
            self._astray[number, followed] = np.where(agrees[number], 0, self._astray[number, followed] + 1)
            more = np.where(agrees[number], -1, 1)
            self._distrust[number, followed] = np.maximum(self._distrust[number, followed] + more, 0)
            spare = np.isfinite(self._pool.pixels[number, :, 0])
            gone = np.flatnonzero(~spare[followed] | (self._astray[number, followed] >= ASTRAY_PICTURES))
            spare[followed] = False
            others = np.flatnonzero(spare)
            others = others[np.argsort(self._distrust[number, others], kind="stable")][: len(gone)]
            followed[gone[: len(others)]] = others
            self._astray[number, others] = 0

    def _of(self, values: Array) -> Array:
        """Values of the points that are followed, of those of the pool."""
        return values[np.arange(len(values))[:, None], self._followed]

    def find(self, grey: Grey, sight: Sight, travel_m: float, foretold: Array, chosen: list[int]) -> Array:
        """Where the points are now, at the depth that they had, along right and up [m], shape [chosen, points, 2].

        Args:
            grey: the picture.
            sight: the camera.
            travel_m: of the sled.
            foretold: shift along right and up [m] and turn [rad] of every face, shape [n, 3].
            chosen: the faces to look for.
        """
        mosaic, homographies = self._cut(grey, sight, travel_m, foretold, chosen)
        mosaic = self._evened(mosaic)
        points, depths = self._of(self._pool.pixels)[chosen], self._of(self._pool.depths)[chosen]
        known = np.isfinite(points).all(axis=2)
        start = points[known].astype(np.float32)
        after = np.full((len(chosen), MOST_POINTS, 2), np.nan)
        if not len(start):
            return after
        spots = spots_found(self._reference, mosaic, start)
        owner = np.nonzero(known)[0]
        after[known] = self._places(spots, owner, depths[known], chosen, homographies, sight, travel_m)
        return after

    def find_blocks(
        self, grey: Grey, sight: Sight, travel_m: float, foretold: Array, chosen: list[int]
    ) -> Array:
        """The same for the faces' blocks: by correlation, less finely, but in spite of much that covers the print."""
        mosaic, homographies = self._cut(grey, sight, travel_m, foretold, chosen)
        mosaic = self._evened(mosaic)
        known = np.isfinite(self._blocks.pixels[chosen]).all(axis=2)
        start = self._blocks.pixels[chosen][known]
        there = np.array([block_found(self._reference, mosaic, x, y) for x, y in start.astype(int).tolist()])
        after = np.full((len(chosen), _MOST_BLOCKS, 2), np.nan)
        if len(there):
            depths, owner = self._blocks.depths[chosen][known], np.nonzero(known)[0]
            after[known] = self._places(there, owner, depths, chosen, homographies, sight, travel_m)
        return after

    def _places(
        self,
        there: Array,
        owner: NDArray[np.intp],
        depths: Array,
        chosen: list[int],
        homographies: Array,
        sight: Sight,
        travel_m: float,
    ) -> Array:
        """Places of tile pixels along right and up [m], shape [k, 2]; ``owner`` tells the face, of those chosen."""
        origin = np.array([self._tiles[number][:2] for number in chosen], dtype=float)
        pixels = _mapped(there - origin[owner], homographies[owner])
        rays = undistorted(pixels, sight.view.matrix, sight.view.distortion)
        return sight.on_plane(rays, self._side, depths, travel_m)

    def search(
        self, coarse: Grey, sight: Sight, travel_m: float, foretold: Array, number: int, *, reach_m: float
    ) -> tuple[Array, float]:
        """Looks for one face around where it is foretold: a better motion, shape [3], and its correlation.

        Args:
            coarse: the picture made ``COARSE`` times smaller: its pixels are means, not single ones of the picture's.
            sight: the camera.
            travel_m: of the sled.
            foretold: shift along right and up [m] and turn [rad] of every face, shape [n, 3].
            number: the face.
            reach_m: how far to look.
        """
        x, y, w, h = self._tiles[number]
        size = (max(6, w // COARSE), max(6, h // COARSE))
        wanted = cv2.resize(self._plain[y : y + h, x : x + w], size, interpolation=cv2.INTER_AREA)
        step = np.array([w / size[0], h / size[1]]) * self.pixel_m
        border = np.ceil(reach_m / step).astype(int)
        wide = (size[0] + 2 * int(border[0]), size[1] + 2 * int(border[1]))
        frame = _widened(self._frames[number], wide, margin=border)
        best, best_score = foretold[number].copy(), -1.0
        for turn in foretold[number, 2] + np.array([0.0, -0.15, 0.15]):
            shift = foretold[number, :2]
            corners = moved_in_plane(frame, self._faces[number].centre, self._side, shift, float(turn))
            pixels = sight.project(corners, travel_m)
            if not np.isfinite(pixels).all():
                continue
            homography = _homography(wide, (pixels + 0.5) / COARSE - 0.5)
            cut = cv2.warpPerspective(coarse, homography, wide, flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP)
            score = cv2.matchTemplate(cut, wanted, cv2.TM_CCOEFF_NORMED)
            _, peak, _, at = cv2.minMaxLoc(score)
            if peak > best_score:
                off = (np.array(at) - border) * step * (1.0, -1.0)
                cos, sin = np.cos(turn), np.sin(turn)
                best_score = float(peak)
                best = np.array(
                    [shift[0] + cos * off[0] - sin * off[1], shift[1] + sin * off[0] + cos * off[1], turn]
                )
        return best, best_score

    def _cut(
        self, grey: Grey, sight: Sight, travel_m: float, motions: Array, chosen: list[int]
    ) -> tuple[Grey, Array]:
        """The tiles along motions, in one picture; and the maps from a tile's pixels to the picture's."""
        mosaic = np.zeros(self._shape, np.uint8)
        frames = np.concatenate(
            [
                moved_in_plane(
                    self._frames[k], self._faces[k].centre, self._side, motions[k, :2], float(motions[k, 2])
                )
                for k in chosen
            ]
        )
        pixels = sight.project(frames, travel_m).reshape(-1, 4, 2)
        homographies = np.zeros((len(chosen), 3, 3))
        for place, number in enumerate(chosen):
            x, y, w, h = self._tiles[number]
            homographies[place] = _homography((w, h), pixels[place])
            cv2.warpPerspective(
                grey, homographies[place], (w, h), dst=mosaic[y : y + h, x : x + w],
                flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
            )  # fmt: skip
        return mosaic, homographies

    def _evened(self, mosaic: Grey) -> Grey:
        """Brightness as a share of its surroundings': a shadow or a lamp's gleam changes that only at its edge."""
        around = cv2.blur(mosaic, (_AROUND_PX, _AROUND_PX))
        return np.asarray(cv2.divide(mosaic, around, scale=110.0), dtype=np.uint8)

    def _choose(self, sight: Sight, homographies: Array) -> None:
        """Chooses points and blocks in the first picture."""
        for number in range(len(self._faces)):
            x, y, w, h = self._tiles[number]
            tile = np.ascontiguousarray(self._reference[y : y + h, x : x + w])
            apart, between = strong_spots(tile, (2 * MOST_POINTS, _POOL_POINTS), margin_px=_MARGIN_PX)
            for spots, found, first, last in (
                (self._pool, apart, 0, MOST_POINTS),
                (self._pool, between, MOST_POINTS, _POOL_POINTS),
                (self._blocks, block_spots(tile, margin_px=_MARGIN_PX), 0, _MOST_BLOCKS),
            ):
                pixels = _mapped(found, np.broadcast_to(homographies[number], (len(found), 3, 3)))
                rays = undistorted(pixels, sight.view.matrix, sight.view.distortion)
                points = _on_face(rays, sight, self._faces[number])
                kept = np.flatnonzero(~self._are_hidden(points, number))[: last - first]
                slots = slice(first, first + len(kept))
                spots.pixels[number, slots] = found[kept] + (x, y)
                spots.rays[number, slots] = rays[kept]
                spots.depths[number, slots] = points[kept] @ self._side.normal

    def _are_hidden(self, points: Array, number: int) -> Flags:
        """Which points of a face lie behind faces that are nearer to the camera."""
        places = in_plane(points, self._side)
        depths = [float((face.corners @ self._side.normal).max()) for face in self._faces]
        hidden = np.zeros(len(places), dtype=np.bool_)
        for face, depth in zip(self._faces, depths, strict=True):
            if depth > depths[number] + 1.0e-3:
                outline = in_plane(face.corners, self._side)
                low, high = outline.min(axis=0) - 0.02, outline.max(axis=0) + 0.02
                hidden |= ((places > low) & (places < high)).all(axis=1)
        return hidden


def _on_face(rays: Array, sight: Sight, face: Face) -> Array:
    """Where rays meet the plane of a face as stacked, frame ``sled`` [m], shape [n, 3]."""
    directions = np.column_stack((rays, np.ones(len(rays)))) @ sight.view.rotation
    origin = sight.view.position
    reach = ((face.centre - origin) @ face.normal) / (directions @ face.normal)
    points: Array = origin + reach[:, None] * directions
    return points


def _widened(corners: Array, size: tuple[int, int], *, margin: Array | int) -> Array:
    """Corners of a face [m], shape [4, 3], moved out so that a picture of this size has its margin around the face."""
    middle = corners.mean(axis=0)
    across, down = 0.5 * (corners[1] - corners[0]), 0.5 * (corners[3] - corners[0])
    border = np.broadcast_to(margin, 2)
    share = np.array(size) / (np.array(size) - 2 * border)
    u, v = share[0] * across, share[1] * down
    return np.array([middle - u - v, middle + u - v, middle + u + v, middle - u + v])


def _homography(size: tuple[int, int], pixels: Array) -> Array:
    """Map from a tile's pixels to a picture's, by the tile's corners in the picture [px], shape [4, 2]."""
    w, h = size
    own = np.array([[-0.5, -0.5], [w - 0.5, -0.5], [w - 0.5, h - 0.5], [-0.5, h - 0.5]], np.float32)
    # About the corners' middle, since the map is found in single precision.
    middle = pixels.mean(axis=0)
    found = np.asarray(cv2.getPerspectiveTransform(own, (pixels - middle).astype(np.float32)), dtype=float)
    back = np.array([[1.0, 0.0, middle[0]], [0.0, 1.0, middle[1]], [0.0, 0.0, 1.0]])
    homography: Array = back @ found
    return homography


def _mapped(points: Array, homographies: Array) -> Array:
    """Points through a map each, shape [n, 2]."""
    through = np.einsum("nab,nb->na", homographies, np.column_stack((points, np.ones(len(points)))))
    mapped: Array = through[:, :2] / through[:, 2:]
    return mapped


def _packed(sizes: NDArray[np.int_]) -> list[tuple[int, int, int, int]]:
    """Places of tiles in one picture, in rows: left, top, width and height of each [px]."""
    width = max(int(sizes[:, 0].max()), int(np.sqrt(sizes.prod(axis=1).sum() * 1.2)))
    tiles: dict[int, tuple[int, int, int, int]] = {}
    x = y = tall = 0
    for number in np.argsort(-sizes[:, 1], kind="stable").tolist():
        w, h = (int(edge) for edge in sizes[number])
        if x + w > width:
            x, y, tall = 0, y + tall, 0
        tiles[number] = (x, y, w, h)
        x, tall = x + w, max(tall, h)
    return [tiles[number] for number in range(len(sizes))]
