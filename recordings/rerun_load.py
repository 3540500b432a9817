"""The load in 3-D: packages, pallet, film and the sled's table, and the bench that they move along."""

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from config.scene import Scene
from msgs_adapters.colours import PALLET_COLOUR, full_strain, package_colour, strain_colours
from msgs_adapters.film_mesh import OPACITY
from recordings.rerun_blueprint import BENCH, SLED, WORLD
from sim_core.camera.layout import side_of
from sim_core.frames import Array, FilmFrame, PoseFrame

FILM_LIFT_M = 0.004
"""How far outside of where it is the film is drawn: on the faces of boxes neither would be seen whole."""
_MOVED = np.array((0.86, 0.08, 0.10))
_MOST_MOVED = 0.75
_TRANSLUCENT = (255, 255, 255, round(255 * OPACITY))
_TABLE_M, _TIE_SPACING_M = 0.08, 0.25


class LoadDrawing:
    """Draws the load at the time that the recording is set to.

    Packages have the colour of their layer, and take on red as they near the limit of rule (i).

    Args:
        scene: the resolved scene.
        recording: takes what is drawn.
    """

    def __init__(self, scene: Scene, recording: rr.RecordingStream) -> None:
        self._scene, self._recording = scene, recording
        # Neighbours of a layer differ a little, or cartons would not be told apart.
        shades = np.where(np.arange(len(scene.packages)) % 2, 0.86, 1.0)[:, np.newaxis]
        self._colours = np.array([package_colour(package) for package in scene.packages]) * shades
        self._first_positions: Array | None = None
        recording.log(WORLD, rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        self._draw_sizes()
        self._draw_bench()

    def draw(self, frame: PoseFrame, limit_m: float) -> None:
        """Draws packages and pallet.

        Args:
            frame: their poses; the first is what displacement counts from.
            limit_m: displacement at which a package is red [m].
        """
        if self._first_positions is None:
            self._first_positions = frame.positions
        moved = np.linalg.norm(frame.positions - self._first_positions, axis=1)[1:, np.newaxis]
        # Squared: half-way to the limit is no alarm yet.
        share = _MOST_MOVED * np.clip(moved / limit_m, 0.0, 1.0) ** 2
        self._recording.log(
            f"{SLED}/packages",
            rr.Boxes3D.from_fields(
                centers=frame.positions[1:],
                quaternions=frame.orientations[1:],
                colors=_bytes_of(self._colours * (1.0 - share) + _MOVED * share),
            ),
        )
        if self._scene.pallet_box is not None:
            pallet = rr.Boxes3D.from_fields(centers=frame.positions[:1], quaternions=frame.orientations[:1])
            self._recording.log(f"{SLED}/pallet", pallet)

    def draw_film(self, frame: FilmFrame) -> None:
        """Draws what is whole of the film, coloured by its strain."""
        is_whole = frame.torn_s < 0.0
        if not is_whole.any() or self._scene.film is None:
            self._recording.log(f"{SLED}/film", rr.Clear(recursive=False))
            return
        full = full_strain(self._scene.film.around)
        self._recording.log(
            f"{SLED}/film",
            rr.Mesh3D(
                vertex_positions=_lifted(frame.corners[is_whole]).reshape(-1, 3),
                vertex_colors=_bytes_of(strain_colours(frame.strains[is_whole, 0], full)).repeat(3, axis=0),
                albedo_factor=_TRANSLUCENT,
            ),
        )

    def _draw_sizes(self) -> None:
        packages, pallet = self._scene.packages, self._scene.pallet_box
        boxes = rr.Boxes3D(
            half_sizes=[0.5 * np.array(package.size_m) for package in packages],
            labels=[package.id for package in packages],
            show_labels=False,
            fill_mode="solid",
        )
        self._recording.log(f"{SLED}/packages", boxes, static=True)
        if pallet is not None:
            wood = _bytes_of(np.array([PALLET_COLOUR]))
            box = rr.Boxes3D(half_sizes=[0.5 * np.array(pallet.size_m)], colors=wood, fill_mode="solid")
            self._recording.log(f"{SLED}/pallet", box, static=True)

    def _draw_bench(self) -> None:
        """The sled's table under its top, and a track with ties at equal distances to see it move by."""
        side = side_of(self._scene)
        length, half = side.right_m - side.left_m + 0.3, 0.5 * _TABLE_M
        table = np.abs(0.5 * length * side.right + 0.65 * side.normal) + np.array([0.0, 0.0, half])
        box = rr.Boxes3D(
            centers=[(0.0, 0.0, -half - 0.001)], half_sizes=[table], colors=(96, 104, 112), fill_mode="solid"
        )
        self._recording.log(f"{SLED}/table", box, static=True)
        low, high = side.travel_m[0] + side.left_m - 0.6, side.travel_m[1] + side.right_m + 0.6
        ties = _TIE_SPACING_M * np.arange(
            np.floor(low / _TIE_SPACING_M), np.ceil(high / _TIE_SPACING_M) + 1.0
        )

        def point(along_m: float, across_m: float) -> Array:
            place: Array = along_m * side.right + across_m * side.normal - np.array([0.0, 0.0, 0.1])
            return place

        lines = [[point(along, -0.5), point(along, 0.5)] for along in ties]
        lines += [[point(ties[0], across), point(ties[-1], across)] for across in (-0.4, 0.4)]
        self._recording.log(BENCH, rr.LineStrips3D(lines, colors=(80, 90, 100), radii=0.006), static=True)


def _lifted(corners: NDArray[np.float32]) -> NDArray[np.float32]:
    """Elements of the film moved outwards along their normals [m], shape [m, 3, 3]."""
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    middles = corners.mean(axis=1)
    outward = np.sign(np.einsum("ij,ij->i", normals, middles - middles.mean(axis=0)))
    lengths = np.maximum(np.linalg.norm(normals, axis=1), 1.0e-12)
    lift: NDArray[np.float32] = (FILM_LIFT_M * outward / lengths)[:, np.newaxis] * normals
    return corners + lift[:, np.newaxis]


def _bytes_of(colours: Array) -> NDArray[np.uint8]:
    return np.round(255.0 * colours).astype(np.uint8)
