"""Draws what the bench's camera sees: scene and shot in, picture out."""

import logging
import os

import cv2
import numpy as np
from numpy.typing import NDArray

from config.scene import Scene
from sim_core.camera.drawing import Drawing, Poses
from sim_core.camera.film_look import draw_legend
from sim_core.camera.sensor import Sensor, Window, busy_parts
from sim_core.camera.shot import Shot
from sim_core.camera.view import CameraView, view_of
from sim_core.frames import FilmFrame
from sim_core.geometry import box_corners

Picture = NDArray[np.uint8]

FALLBACK_VARIABLE = "PALLET_TWIN_RENDERER"
"""Set to ``tiny`` this environment variable lets PyBullet draw even where there is OpenGL."""
_log = logging.getLogger(__name__)
_MOST_PICTURES = 64
_EDGE_PX = 3.0


def _drawing(scene: Scene, view: CameraView) -> Drawing:
    if os.environ.get(FALLBACK_VARIABLE) != "tiny":
        from sim_core.camera.gl_drawing import GlDrawing
        from sim_core.camera.gl_window import NoOpenGl

        try:
            return GlDrawing(scene, view)
        except NoOpenGl:
            _log.warning("no OpenGL here: PyBullet draws plain boxes")
    from sim_core.camera.tiny_drawing import TinyDrawing

    return TinyDrawing(scene, view)


class BenchRenderer:
    """Draws the pictures of a test; the same shot gives the same bytes, whatever was drawn before.

    The exposure ends at the shot's stamp: what moves is seen, on average, where it was half the exposure before.

    Args:
        scene: a resolved scene with a camera.
        view: from elsewhere than the scene says.
    """

    def __init__(self, scene: Scene, view: CameraView | None = None) -> None:
        camera = scene.camera
        assert camera is not None
        self.view = view if view is not None else view_of(scene)
        self._scene, self._shutter_s = scene, camera.shutter_s
        self._drawing = _drawing(scene, self.view)
        self.described = self._drawing.described
        self._background = self._drawing.background()
        self._sensor = Sensor(
            width=self.view.width, exposure_ev=camera.exposure_ev, noise=camera.noise, seed=camera.seed
        )
        pallet = scene.pallet_box
        sizes = [
            pallet.size_m if pallet is not None else (0.0, 0.0, 0.0),
            *(p.size_m for p in scene.packages),
        ]
        self._half = 0.5 * np.array(sizes)

    def picture(self, shot: Shot) -> Picture:
        """What the camera sees, RGB, shape [height, width, 3], C-contiguous."""
        count = self._pictures(shot)
        moments = [shot.before(self._shutter_s * (k + 0.5) / count) for k in range(count)]
        parts = self._parts(moments, shot.film)
        whole = self._background.copy()
        self._drawing.light(moments[count // 2], shot.film)
        sums = [np.zeros((part.height, part.width, 3), np.float32) for part in parts]
        for poses in moments:
            self._drawing.place(poses, shot.film)
            for part, light in zip(parts, sums, strict=True):
                seen = self._over_background(part)
                if count == 1:
                    whole[part.rows, part.columns] = seen
                else:
                    # Squares of what was drawn are light.
                    cv2.accumulateSquare(seen, light)
        if count > 1:
            for part, light in zip(parts, sums, strict=True):
                whole[part.rows, part.columns] = cv2.convertScaleAbs(cv2.sqrt(light / count))
        exposed = self._sensor.expose(whole, shot.index)
        camera = self._scene.camera
        if camera is not None and camera.film == "strain" and self._scene.film is not None:
            draw_legend(exposed, self._scene)
        return exposed

    def close(self) -> None:
        """Gives the graphics back."""
        self._drawing.close()

    def _pictures(self, shot: Shot) -> int:
        """How many pictures make one, so that nothing moves by more than about a pixel between them."""
        ends = [
            self.view.project(box_corners(positions + sled, orientations, self._half).reshape(-1, 3))
            for sled, positions, orientations in (shot.before(0.0), shot.before(self._shutter_s))
        ]
        moved = np.linalg.norm(ends[1] - ends[0], axis=1)
        return int(np.clip(np.ceil(np.nan_to_num(moved).max(initial=0.0)), 1, _MOST_PICTURES))

    def _parts(self, moments: list[Poses], film: FilmFrame | None) -> list[Window]:
        outlines = [
            outline
            for poses in (moments[0], moments[-1])[: len(moments)]
            for outline in (
                self._drawing.outlines(poses),
                *([film.corners.astype(float) + poses[0]] if film is not None else []),
            )
        ]
        pixels = [
            self.view.project(points.reshape(-1, 3)).reshape(*points.shape[:2], 2) for points in outlines
        ]
        boxes = np.vstack(
            [np.hstack((own.min(axis=1) - _EDGE_PX, own.max(axis=1) + _EDGE_PX)) for own in pixels]
        )
        return busy_parts(
            boxes, width=self.view.width, height=self.view.height, largest=self._drawing.largest_part
        )

    def _over_background(self, part: Window) -> Picture:
        drawn = self._drawing.part(part)
        clear = cv2.merge([cv2.bitwise_not(cv2.extractChannel(drawn, 3))] * 3)
        behind = cv2.multiply(self._background[part.rows, part.columns], clear, scale=1.0 / 255.0)
        return np.asarray(cv2.add(cv2.cvtColor(drawn, cv2.COLOR_RGBA2RGB), behind), np.uint8)
