"""The camera's pictures: things stand where the calibrated camera has them, and the same shot is the same bytes."""

import hashlib
import subprocess
import sys
from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
import pytest

from config.scene import Scene
from sim_core.camera.gl_drawing import projection_in_world
from sim_core.camera.gl_window import GlMesh, GlWindow
from sim_core.camera.layout import markers_of, targets_of
from sim_core.camera.meshes import FIXED, edge_points, merged, quad
from sim_core.camera.renderer import FALLBACK_VARIABLE, BenchRenderer
from sim_core.camera.sensor import Lens, Window
from sim_core.camera.shot import Shot
from sim_core.camera.view import CameraView
from sim_core.frames import FilmFrame
from sim_core.geometry import CORNER_SIGNS, yaw_quaternion

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
    assert len(misses) > 800
    assert np.linalg.norm(misses, axis=1).max() < 0.25
    assert np.abs(np.mean(misses, axis=0)).max() < 0.01


_SMALL = {"width_px": 320, "height_px": 180, "noise": 0.0, "background": "plain", "shutter_s": 0.0}


def _shot(scene: Scene, *, index: int = 0, film: FilmFrame | None = None, **changes: Any) -> Shot:
    """The load as it was placed, on the sled at its start."""
    pallet = 0.5 * scene.pallet_box.size_m[2] if scene.pallet_box is not None else 0.0
    positions = np.array([(0.0, 0.0, pallet), *(package.position_m for package in scene.packages)])
    orientations = np.array(
        [(0, 0, 0, 1.0), *(yaw_quaternion(package.yaw_deg) for package in scene.packages)]
    )
    at = {"sled": np.zeros(3), "velocity": np.zeros(3), "interval_s": 0.0, **changes}
    at = {"positions": positions, "orientations": orientations, **at}
    return Shot(
        index=index, stamp_ns=0, earlier_positions=at["positions"], earlier_orientations=at["orientations"],
        film=film, **at,
    )  # fmt: skip


def _film(scene: Scene, torn: tuple[int, ...] = ()) -> FilmFrame:
    """Film around the load's sides, four panes of 2 · 6 · 6 elements."""
    half, low, high, count = np.array([0.61, 0.41]), 0.1, 1.0, 6
    ring = half * np.array([[1, 1], [-1, 1], [-1, -1], [1, -1], [1, 1]])
    way = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(ring, axis=0), axis=1))))
    steps = np.linspace(0.0, way[-1], 4 * count + 1)
    around = np.column_stack([np.interp(steps, way, ring[:, axis]) for axis in range(2)])
    corners, unrolled = [], []
    for column in range(4 * count):
        for row in range(count):
            heights = low + (high - low) * (row + np.array([0, 1])) / count
            cell = [
                (column, heights[0]),
                (column + 1, heights[0]),
                (column + 1, heights[1]),
                (column, heights[1]),
            ]
            for triangle in ((0, 1, 2), (0, 2, 3)):
                corners.append([(*around[cell[k][0]], cell[k][1]) for k in triangle])
                unrolled.append([(steps[cell[k][0]], cell[k][1]) for k in triangle])
    number = len(corners)
    torn_s = np.full(number, -1.0, np.float32)
    torn_s[list(torn)] = 0.1
    return FilmFrame(
        index=0, stamp_ns=0, corners=np.array(corners, np.float32), unrolled=np.array(unrolled, np.float32),
        strains=np.full((number, 3), 0.1, np.float32), peaks=np.full(number, 0.1, np.float32),
        forces=np.zeros(number, np.float32), torn_s=torn_s,
    )  # fmt: skip


def _drawn(scene: Scene, shot: Shot) -> np.ndarray:
    renderer = BenchRenderer(scene)
    picture = renderer.picture(shot)
    renderer.close()
    return picture


@pytest.fixture(scope="module")
def layer(box: Callable[..., Any], make_scene: Callable[..., Scene]) -> Callable[..., Scene]:
    """Eight cartons on a pallet, in film or without; keywords change the camera."""

    def make(*, wrap: str | None = None, **camera: Any) -> Scene:
        cartons = [
            box(f"{row}{column}", x=-0.45 + 0.3 * column, y=-0.2 + 0.4 * row, size=(0.3, 0.4, 0.8))
            for row in range(2)
            for column in range(4)
        ]
        film = {"wrap": {"material": wrap, "turns": 2.0}} if wrap is not None else {}
        return make_scene(*cartons, camera={**_SMALL, **camera}, **film)

    return make


@pytest.mark.parametrize(("renderer", "bar_px"), [("gl", 0.5), ("tiny", 0.75)])
def test_a_package_fills_its_projection(
    renderer: str, bar_px: float, box: Callable[..., Any], make_scene: Callable[..., Scene], monkeypatch: Any
):
    """In the air and turned at random; the bar is the mean distance between the two outlines."""
    monkeypatch.setenv(FALLBACK_VARIABLE, renderer)
    size = (0.5, 0.35, 0.3)
    light = {"elevation_deg": 30.0, "azimuth_deg": -20.0}
    scene = make_scene(
        box("a", size=size, bottom=0.5), pallet=None,
        camera={**_SMALL, "aim_m": (0.8, 0.0, 0.9), "distortion": (-0.15, 0.05, 0.003, -0.002, 0.0), "light": light},
    )  # fmt: skip
    rng, drawing = np.random.default_rng(3), BenchRenderer(scene)
    assert drawing.described.startswith("TinyRenderer" if renderer == "tiny" else "VTK")
    corners = edge_points(-0.5 * np.array(size), 0.5 * np.array(size), pieces=40)
    view = drawing.view
    for _ in range(10):
        turn, _ = cv2.Rodrigues(rng.normal(0.0, 1.0, 3))
        w = 0.5 * np.sqrt(max(1.0e-9, 1.0 + np.trace(turn)))
        axis = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
        place = np.array([rng.uniform(-0.2, 1.8), rng.uniform(-0.2, 0.2), rng.uniform(0.7, 1.2)])
        shot = _shot(
            scene,
            positions=np.array([np.zeros(3), place]),
            orientations=np.array([[0, 0, 0, 1.0], [*(axis / (4.0 * w)), w]]),
        )
        outline = cv2.projectPoints(
            corners @ turn.T + place,
            cv2.Rodrigues(view.rotation)[0],
            view.translation,
            view.matrix,
            view.distortion,
        )[0]
        expected = np.zeros((view.height, view.width), np.uint8)
        hull = cv2.convexHull(np.round(outline * 256.0).astype(np.int32))
        cv2.fillConvexPoly(expected, hull, 255, cv2.LINE_AA, shift=8)
        picture = drawing.picture(shot).astype(int)
        seen = np.abs(picture - picture[2, 2]).max(axis=2) > 12
        above = int(view.project(np.array([[x, 1.2, 0.03] for x in np.linspace(-3, 5, 50)]))[:, 1].min())
        wrong = (seen != (expected > 127))[:above]
        assert (expected > 127)[above:].sum() == 0
        assert wrong.sum() / cv2.arcLength(hull.astype(np.float32) / 256.0, True) < bar_px
    drawing.close()


def test_targets_and_tags_are_where_they_are_put(layer: Callable[..., Scene]):
    scene = layer(width_px=1280, height_px=720, markers={"size_m": 0.12})
    renderer = BenchRenderer(scene)
    sled = np.array([0.4, 0.0, 0.0])
    picture = cv2.cvtColor(renderer.picture(_shot(scene, sled=sled)), cv2.COLOR_RGB2GRAY)
    view = renderer.view
    for u, v in view.project(targets_of(scene) + sled):
        # Upper left is black and upper right is white: what is white of a few rows tells the line between them.
        column, row = round(u), round(v)
        line = picture[row - 5 : row - 1, column - 5 : column + 6].mean(axis=0)
        assert line[0] < 60
        assert line[-1] > 150
        assert column + 5.5 - ((line - line[0]) / (line[-1] - line[0])).sum() == pytest.approx(u, abs=0.05)
    tags = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    settings = cv2.aruco.DetectorParameters()
    settings.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    found, numbers, _ = cv2.aruco.ArucoDetector(tags, settings).detectMarkers(picture)
    markers = {marker.tag: marker for marker in markers_of(scene)}
    assert sorted(numbers.ravel().tolist()) == sorted(markers)
    for quad_seen, tag in zip(found, numbers.ravel().tolist(), strict=True):
        marker = markers[tag]
        place = np.array(scene.packages[marker.package - 1].position_m) + sled
        expected = view.project(marker.corners + place)
        misses = quad_seen[0] - expected
        assert np.linalg.norm(misses, axis=1).max() < 0.75
        assert np.linalg.norm(misses.mean(axis=0)) < 0.25
    renderer.close()


_ELSEWHERE = """
import hashlib, pickle, sys
scene, shot = pickle.loads(sys.stdin.buffer.read())
from sim_core.camera.renderer import BenchRenderer
print(hashlib.sha256(BenchRenderer(scene).picture(shot).tobytes()).hexdigest())
"""


def test_the_same_shot_is_the_same_bytes_whatever_was_drawn_before(layer: Callable[..., Scene]):
    import pickle

    scene = layer(wrap="stretch_film_20", noise=2.0, background="hall")
    whole, film = _shot(scene, film=_film(scene)), _film(scene, torn=tuple(range(80, 120)))
    shot = _shot(scene, index=3, film=film, sled=np.array([0.5, 0.0, 0.0]))
    renderer = BenchRenderer(scene)
    first = renderer.picture(shot)
    assert first.shape == (180, 320, 3)
    assert first.dtype == np.uint8
    assert first.flags.c_contiguous
    others = [renderer.picture(_shot(scene)), renderer.picture(whole)]
    assert all((other != first).any() for other in others)
    assert np.array_equal(renderer.picture(shot), first)
    renderer.close()
    elsewhere = subprocess.run(
        [sys.executable, "-c", _ELSEWHERE], input=pickle.dumps((scene, shot)), capture_output=True, check=True
    )
    assert elsewhere.stdout.decode().strip() == hashlib.sha256(first.tobytes()).hexdigest()
    assert elsewhere.stderr == b""


@pytest.mark.parametrize("material", ["stretch_film_20", "kraft_80"])
def test_torn_film_is_missing(material: str, layer: Callable[..., Scene]):
    scene = layer(wrap=material)
    renderer = BenchRenderer(scene)
    count = len(_film(scene).torn_s)
    bare, torn, whole = (
        renderer.picture(_shot(scene, film=film)).astype(int)
        for film in (None, _film(scene, torn=tuple(range(count))), _film(scene))
    )
    renderer.close()
    # Drawn in other parts, a pixel may round to the next level.
    assert np.abs(bare - torn).max() <= 1
    assert (np.abs(whole - bare).max(axis=2) > 3).mean() > 0.03


def test_strain_is_shown_in_colours_with_their_scale(layer: Callable[..., Scene]):
    clear, strain = (
        _drawn(scene, _shot(scene, film=_film(scene)))
        for scene in (layer(wrap="stretch_film_20", film=film) for film in ("clear", "strain"))
    )
    changed = np.abs(clear.astype(int) - strain).max(axis=2) > 20
    assert changed[:20, :60].any()
    # 10 % of the scale's 20 %: the middle of the colours, green.
    column, row = changed[40:110].any(axis=0).nonzero()[0], changed[:, 100:].any(axis=1).nonzero()[0]
    middle = strain[int(np.median(row)), int(np.median(column))].astype(int)
    assert middle[1] > max(middle[0], middle[2])


def test_what_moves_is_blurred_over_the_exposure_before_the_stamp(
    box: Callable[..., Any], make_scene: Callable[..., Scene]
):
    """The white board of the sled against plain grey, 2 m/s over 50 ms: its edge is a ramp of 0.1 m."""
    speed, shutter = 2.0, 0.05
    light = {"share": 0.0, "shadows": False}
    scene = make_scene(box("a"), camera={**_SMALL, "shutter_s": shutter, "rate_hz": 20, "light": light})
    renderer = BenchRenderer(scene)
    sled = np.array([0.3, 0.0, 0.0])
    picture = renderer.picture(_shot(scene, sled=sled, velocity=np.array([speed, 0.0, 0.0])))
    target = targets_of(scene)[0] + sled
    # Below the platforms and left of the lower row's first target, over the board's left edge.
    ends = [target[0] - 0.05, target[0] - 0.05 - speed * shutter]
    right, left = (renderer.view.project(np.array([[x, target[1], -0.19]]))[0] for x in ends)
    row = picture[round(left[1]), :, 0].astype(float) ** 2
    line = row[round(left[0]) - 6 : round(right[0]) + 7]
    renderer.close()
    shares = (line - line[0]) / (line[-1] - line[0])
    middle = round(left[0]) - 6 + np.interp(0.5, shares, np.arange(len(shares)))
    assert middle == pytest.approx(0.5 * (left[0] + right[0]), abs=0.7)
    ramp = np.interp([0.1, 0.9], shares, np.arange(len(shares)))
    assert np.diff(ramp)[0] == pytest.approx(0.8 * (right[0] - left[0]), abs=1.0)


def test_bare_pallet_and_load_without_pallet_are_drawn(
    box: Callable[..., Any], make_scene: Callable[..., Scene]
):
    sheet = box("sheet", size=(1.0, 0.7, 0.004), kind="interlayer", bottom=0.25)
    for scene in (
        make_scene(camera=_SMALL),
        make_scene(box("a", bottom=0.0), sheet, pallet=None, camera={**_SMALL, "film": "strain"}),
    ):
        picture = _drawn(scene, _shot(scene))
        assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 100
