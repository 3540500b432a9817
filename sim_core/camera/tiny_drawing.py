"""The bench drawn without OpenGL: PyBullet's TinyRenderer, plain boxes in plain colours on the same camera."""

import numpy as np
import pybullet

from config.scene import Scene
from sim_core.camera.drawing import Poses
from sim_core.camera.layout import BOARD_BOTTOM_M, BOARD_GAP_M, BOARD_OVERHANG_M, BOARD_TOP_M, side_of
from sim_core.camera.lighting import lamp_direction
from sim_core.camera.meshes import edge_points
from sim_core.camera.sensor import Lens, Picture, Window, projection
from sim_core.camera.stage import FLOOR_M, bench_frame
from sim_core.camera.view import CameraView
from sim_core.frames import Array, FilmFrame
from sim_core.geometry import rotation_matrices

_CARDBOARD, _SHEET, _WOOD = (0.74, 0.60, 0.43, 1.0), (0.55, 0.45, 0.35, 1.0), (0.80, 0.68, 0.50, 1.0)
_WHITE, _PLYWOOD = (0.92, 0.92, 0.92, 1.0), (0.36, 0.26, 0.20, 1.0)
_HALL, _FLOOR, _PLAIN = (165, 168, 170), (140, 139, 135), (150, 150, 150)
_SLED_ROWS = 2
_NEAR_M, _FAR_M = 0.05, 100.0


class TinyDrawing:
    """Draws with PyBullet's software renderer: no film, no print, no targets, no shadows on the hall.

    Args:
        scene: a resolved scene with a camera.
        view: the camera.
    """

    def __init__(self, scene: Scene, view: CameraView) -> None:
        assert scene.camera is not None
        self._scene, self._view = scene, view
        self.lens = Lens(view, oversampling=1)
        self.described = "TinyRenderer of PyBullet"
        self.largest_part = view.width, view.height
        side = side_of(scene)
        self._light = scene.camera.light
        self._lamp = lamp_direction(scene.camera.light, view, side)
        long = side.right_m - side.left_m + 2.0 * BOARD_OVERHANG_M
        middle = 0.5 * (side.left_m + side.right_m)
        self._side, self._frame = side, bench_frame(side)
        boxes = [
            (side.point(middle, -0.06, 0.0), (long - 0.04, 2.0 * side.near_m, 0.12), _PLYWOOD),
            (
                side.point(middle, 0.5 * (BOARD_TOP_M + BOARD_BOTTOM_M), side.near_m + BOARD_GAP_M - 0.005),
                (long, 0.01, BOARD_TOP_M - BOARD_BOTTOM_M),
                _WHITE,
            ),
        ]
        pallet = scene.pallet_box
        sizes = [
            pallet.size_m if pallet is not None else None,
            *(package.size_m for package in scene.packages),
        ]
        colours = [_SHEET if package.kind == "interlayer" else _CARDBOARD for package in scene.packages]
        self._client = pybullet.connect(pybullet.DIRECT)
        self._offsets = np.array([centre for centre, _, _ in boxes])
        self._bodies = [self._body(size, colour) for _, size, colour in boxes]
        self._bodies += [
            self._body(size, colour) if size is not None else -1
            for size, colour in zip(sizes, [_WOOD, *colours], strict=True)
        ]
        half = 0.5 * np.array([*(size for _, size, _ in boxes), *(size or (0.0, 0.0, 0.0) for size in sizes)])
        self._outlines = np.array([edge_points(-own, own) for own in half])

    def _body(self, size: tuple[float, float, float], colour: tuple[float, float, float, float]) -> int:
        shape = pybullet.createVisualShape(
            pybullet.GEOM_BOX, halfExtents=[0.5 * edge for edge in size], rgbaColor=colour,
            specularColor=[0.0, 0.0, 0.0], physicsClientId=self._client,
        )  # fmt: skip
        body: int = pybullet.createMultiBody(baseVisualShapeIndex=shape, physicsClientId=self._client)
        return body

    def background(self) -> Picture:
        """What never moves, RGB, shape [height, width, 3]."""
        view = self._view
        whole = np.empty((view.height, view.width, 3), np.uint8)
        whole[...] = _PLAIN
        assert self._scene.camera is not None
        if self._scene.camera.background == "hall":
            whole[...] = _HALL
            # The floor, as far as a wall 3 m behind the load's middle.
            edge = self._side.point(0.0, FLOOR_M, -3.0)
            row = view.project(edge[None])[0, 1]
            if np.isfinite(row):
                whole[int(np.clip(row, 0, view.height)) :] = _FLOOR
        return whole

    def outlines(self, poses: Poses) -> Array:
        """Points around all that moves [m], frame ``world``, shape [bodies, n, 3]."""
        places, turns = self._places(poses)
        placed: Array = self._outlines @ turns.transpose(0, 2, 1) + places[:, None, :]
        return placed

    def light(self, poses: Poses, film: FilmFrame | None) -> None:
        """The lamp stands still, and shadows are cast where a part is drawn."""

    def place(self, poses: Poses, film: FilmFrame | None) -> None:
        """Moves what moves."""
        places, _ = self._places(poses)
        angle = np.arctan2(self._side.right[1], self._side.right[0])
        along = (0.0, 0.0, float(np.sin(0.5 * angle)), float(np.cos(0.5 * angle)))
        orientations = [along, along, *(tuple(row) for row in poses[2].tolist())]
        for body, place, orientation in zip(self._bodies, places.tolist(), orientations, strict=True):
            if body >= 0:
                pybullet.resetBasePositionAndOrientation(
                    body, place, orientation, physicsClientId=self._client
                )

    def part(self, part: Window) -> Picture:
        """A part of the picture as it stands, RGBA, opacity already in its colours."""
        seen = self.lens.seen(part)
        # OpenGL's camera looks along -z with y up; its clip coordinates are the same.
        flip = np.diag([1.0, -1.0, -1.0, 1.0])
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = self._view.rotation, self._view.translation
        clip = projection(self.lens.focal, seen, near_m=_NEAR_M, far_m=_FAR_M) @ flip
        _, _, colours, _, bodies = pybullet.getCameraImage(
            seen.width, seen.height,
            viewMatrix=(flip @ pose).T.ravel().tolist(), projectionMatrix=clip.T.ravel().tolist(),
            lightDirection=(10.0 * self._lamp).tolist(), lightColor=[1.0, 1.0, 1.0], lightDistance=10.0,
            shadow=int(self._light.shadows), lightAmbientCoeff=0.75, lightDiffuseCoeff=0.45, lightSpecularCoeff=0.0,
            renderer=pybullet.ER_TINY_RENDERER, physicsClientId=self._client,
        )  # fmt: skip
        drawn = np.array(colours, dtype=np.uint8).reshape(seen.height, seen.width, 4)
        there = np.array(bodies).reshape(seen.height, seen.width) >= 0
        drawn[..., 3] = np.where(there, 255, 0)
        drawn[~there] = 0
        return self.lens.bend(np.ascontiguousarray(drawn[::-1]), part, seen)

    def close(self) -> None:
        """Gives the graphics back."""
        pybullet.disconnect(self._client)

    def _places(self, poses: Poses) -> tuple[Array, Array]:
        """Centres [m] and rotations of all boxes in frame ``world``, shapes [n, 3] and [n, 3, 3]."""
        sled, positions, orientations = poses
        turns = np.concatenate((np.tile(self._frame.T, (2, 1, 1)), rotation_matrices(orientations)))
        return np.vstack((self._offsets + sled, positions + sled)), turns
