"""The camera's pictures: things stand where the calibrated camera has them, and the same shot is the same bytes."""

import cv2
import numpy as np
import pytest

from sim_core.camera.gl_drawing import projection_in_world
from sim_core.camera.gl_window import GlMesh, GlWindow
from sim_core.camera.meshes import FIXED, merged, quad
from sim_core.camera.sensor import Lens, Window
from sim_core.camera.view import CameraView
from sim_core.geometry import CORNER_SIGNS

_FLAT = (
    "//VTK::System::Dec\nin vec4 vertexMC; uniform mat4 clip_from_world;"
    "void main() { gl_Position = clip_from_world * vertexMC; }",
    "//VTK::System::Dec\n//VTK::Output::Dec\nvoid main() { gl_FragData[0] = vec4(1.0); }",
)

# Turned, so that no edge lies along the rows of what is rendered: two samples a pixel tell one to 1/4 px only.
_MARK = np.array([[-0.6, -1.2, 0], [1.2, -0.6, 0], [0.6, 1.2, 0], [-1.2, 0.6, 0]])


def _random_view(rng: np.random.Generator) -> CameraView:
    width, height = int(rng.integers(200, 400)), int(rng.integers(150, 300))
    focal = width * rng.uniform(0.7, 3.0)
    matrix = np.array(
        [[focal, 0, rng.uniform(0.4, 0.6) * width], [0, focal, rng.uniform(0.4, 0.6) * height], [0, 0, 1]]
    )
    strength = min(1.0, (focal / width) ** 2)
    distortion = strength * rng.uniform(-1, 1, 5) * [0.25, 0.1, 0.02, 0.02, 0.05]
    rotation = cv2.Rodrigues(rng.normal(0.0, 1.0, 3))[0]
    return CameraView(width, height, matrix, distortion, rotation, rng.uniform(-2.0, 2.0, 3))


def test_corners_of_boxes_are_where_opencv_projects_them():
    """Bar: 0.5 px. A mark of some pixels on each corner, square to the lens, has its middle there."""
    rng, misses = np.random.default_rng(5), []
    window = GlWindow(1024, 1024)
    for _ in range(200):
        view = _random_view(rng)
        lens = Lens(view, oversampling=2)
        ahead = np.array([*rng.uniform(-0.3, 0.3, 2) * view.width / view.matrix[0, 0], 1.0]) * rng.uniform(
            2.0, 6.0
        )
        turn = cv2.Rodrigues(rng.normal(0.0, 1.0, 3))[0]
        corners = ahead + 0.5 * rng.uniform(0.1, 0.3, 3) * ahead[2] * CORNER_SIGNS @ turn.T
        # Marks in the optical frame: right, then down.
        marks = [place + 3.0 * place[2] / view.matrix[0, 0] * _MARK for place in corners]
        mesh = merged([quad((mark - view.translation) @ view.rotation, 0, body=FIXED) for mark in marks])
        drawn = GlMesh(mesh.points, mesh.triangles, _FLAT)
        window.add(drawn)
        picture = np.zeros((view.height, view.width))
        whole = Window(0, 0, view.width, view.height)
        seen = lens.seen(whole)
        drawn.set_uniform("clip_from_world", projection_in_world(view, lens.focal, seen))
        window.draw(seen.width, seen.height)
        picture = lens.bend(window.colours(seen.width, seen.height), whole, seen)[..., 0].astype(float)
        window.remove(drawn)
        expected = cv2.projectPoints(corners, np.zeros(3), np.zeros(3), view.matrix, view.distortion)[0][:, 0]
        for number, (u, v) in enumerate(expected):
            apart = np.abs(np.delete(expected, number, axis=0) - (u, v)).max(axis=1).min()
            if apart < 14.0 or not (8 < u < view.width - 9 and 8 < v < view.height - 9):
                continue
            column, row = round(u), round(v)
            spot = picture[row - 6 : row + 7, column - 6 : column + 7]
            rows, columns = np.mgrid[row - 6 : row + 7, column - 6 : column + 7]
            middle = np.array([(spot * columns).sum(), (spot * rows).sum()]) / spot.sum()
            misses.append(middle - (u, v))
    window.close()
    print(len(misses), np.linalg.norm(misses, axis=1).max(), np.mean(misses, axis=0), np.std(misses, axis=0))
    assert len(misses) > 800
    assert np.linalg.norm(misses, axis=1).max() < 0.25
    assert np.abs(np.mean(misses, axis=0)).max() < 0.01
