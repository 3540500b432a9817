"""How the film looks: clear with its highlights and folds, milky, of brown paper, or coloured by its strain."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from config.scene import Scene
from config.wrap import Turns
from sim_core.camera.gl_window import GlMesh, GlTexture
from sim_core.camera.shaders import FILM_FRAGMENT, FILM_VERTEX
from sim_core.camera.surfaces import fold_heights, kraft_paper
from sim_core.frames import Array, FilmFrame

_TOWARDS_EYE_M = 0.012
"""The film is drawn so much nearer to the camera than it is: it lies on the cartons, and would sink into them."""
_FOLD_PX_PER_M = 500.0
_NICE = (0.01, 0.02, 0.05, 0.1, 0.2, 0.3, 0.5, 1.0, 2.0, 5.0, 10.0)


@dataclass(frozen=True)
class _Look:
    """Colour [gamma 2], opacity and evenness of what scatters light in the film; its gloss, its folds' relief."""

    colour: tuple[float, float, float]
    opacity: float
    evenness: float
    gloss: float
    relief: float


_LOOKS = {
    "clear_film": _Look((0.93, 0.95, 0.97), opacity=0.09, evenness=0.0, gloss=1.0, relief=2.2),
    "milky_film": _Look((0.93, 0.94, 0.95), opacity=0.5, evenness=0.3, gloss=0.8, relief=1.6),
    "kraft": _Look((0.80, 0.64, 0.46), opacity=1.0, evenness=1.0, gloss=0.04, relief=0.6),
}
_STRAINED = _Look((1.0, 1.0, 1.0), opacity=0.8, evenness=1.0, gloss=0.25, relief=1.0)


class FilmLook:
    """The film of one scene in one window; its mesh is made anew where the film has other elements.

    Args:
        scene: a resolved scene with a camera and a film.
        eye: place of the lens in ``world`` [m], shape [3].
    """

    def __init__(self, scene: Scene, frame: FilmFrame, eye: Array) -> None:
        assert scene.camera is not None and scene.film is not None
        self._eye = eye
        self._shows_strain = scene.camera.film == "strain"
        look = _STRAINED if self._shows_strain else _LOOKS[scene.film.look]
        self._strain_end = legend_end(scene)
        unrolled = frame.unrolled.reshape(-1, 2).astype(float)
        low, high = unrolled.min(axis=0), unrolled.max(axis=0)
        tint = np.array([*(part * part for part in look.colour), look.opacity])
        self._unrolled = frame.unrolled
        count = len(unrolled)
        self._nodes = _nodes(frame)
        self.mesh = GlMesh(
            np.zeros((count, 3)), np.arange(count).reshape(-1, 3), (FILM_VERTEX, FILM_FRAGMENT), is_solid=False,
            normal=np.zeros((count, 3)), place=(unrolled - low) / (high - low),
            tint=np.tile(tint, (count, 1)),
        )  # fmt: skip
        self.mesh.set_texture("folds", GlTexture(_folds(scene, low, high)).repeat())
        self.mesh.set_uniform("gloss", look.gloss)
        self.mesh.set_uniform("relief", look.relief)
        self.mesh.set_uniform("evenness", look.evenness)

    def fits(self, frame: FilmFrame) -> bool:
        """Whether this is the film of that frame."""
        return frame.unrolled is self._unrolled or np.array_equal(frame.unrolled, self._unrolled)

    def place(self, frame: FilmFrame, sled: Array) -> Array:
        """Puts the film where it is; gives its corners in frame ``world`` [m], shape [m · 3, 3]."""
        corners = frame.corners.astype(float) + sled
        whole = np.flatnonzero(frame.torn_s < 0.0)
        own = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        sums = np.zeros((self._nodes.max() + 1, 3))
        np.add.at(sums, self._nodes[whole], own[whole][:, None, :])
        lengths = np.linalg.norm(sums, axis=1, keepdims=True)
        normals = (sums / np.maximum(lengths, 1.0e-12))[self._nodes].reshape(-1, 3)
        points = corners.reshape(-1, 3)
        rays = self._eye - points
        distances = np.linalg.norm(rays, axis=1, keepdims=True)
        self.mesh.set("points", points + rays * (_TOWARDS_EYE_M / np.maximum(distances, _TOWARDS_EYE_M)))
        self.mesh.set("normal", normals)
        if self._shows_strain:
            colours = strain_colours(frame.strains[:, 0].astype(float), self._strain_end) ** 2
            tints = np.hstack((colours, np.full((len(colours), 1), _STRAINED.opacity)))
            self.mesh.set("tint", np.repeat(tints, 3, axis=0))
        shown = whole
        if len(whole) == len(corners):
            # Behind a load in whole film its far sides can't be seen.
            shown = whole[np.einsum("mi,mi->m", own, self._eye - corners[:, 0]) > 0.0]
        # What is nearer is drawn over what is farther.
        order = shown[np.argsort(-distances.reshape(-1, 3).mean(axis=1)[shown], kind="stable")]
        self.mesh.set_triangles(3 * order[:, None] + np.arange(3))
        return points


def _nodes(frame: FilmFrame) -> NDArray[np.int64]:
    """Which corners are one: node numbers, shape [m, 3]. The film is closed around the load."""
    unrolled = np.round(frame.unrolled.reshape(-1, 2).astype(float), 4)
    length = unrolled[:, 0].max()
    unrolled[:, 0] = np.where(unrolled[:, 0] > length - 1.0e-3, 0.0, unrolled[:, 0])
    _, numbers = np.unique(unrolled, axis=0, return_inverse=True)
    return numbers.reshape(-1, 3)


def _folds(scene: Scene, low: Array, high: Array) -> NDArray[np.uint8]:
    """Slopes of the folds around and up, 128 is level, how much film lies there, its shade, shape [rows, columns, 4].

    Row 0 is at the film's lower edge.
    """
    assert scene.camera is not None
    around_m, up_m = (high - low).tolist()
    heights = fold_heights(around_m, up_m, seed=scene.camera.seed, pixels_per_m=_FOLD_PX_PER_M)[::-1]
    pixel_m = around_m / heights.shape[1]
    around = (np.roll(heights, -1, axis=1) - np.roll(heights, 1, axis=1)) / (2.0 * pixel_m)
    up = np.gradient(heights, axis=0) / pixel_m
    crests = cv2.GaussianBlur(np.abs(around), (0, 0), 1.5)
    thick = 0.25 * np.clip(crests / max(float(np.percentile(crests, 95)), 1.0e-9), 0.0, 1.5)
    layers, edges = _layers(scene, around_m, up_m, heights.shape)
    thick += 0.35 * layers + 0.3 * edges
    up += 0.08 * edges
    parts = (0.5 + around, 0.5 + up, thick, _shade(scene, around_m, up_m, heights.shape))
    folds: NDArray[np.uint8] = np.round(255.0 * np.clip(np.stack(parts, axis=-1), 0.0, 1.0)).astype(np.uint8)
    return folds


def _shade(scene: Scene, around_m: float, up_m: float, shape: tuple[int, ...]) -> Array:
    """How light the film is where, about 0.9 for paper and 1 for film, shape [rows, columns]."""
    assert scene.camera is not None and scene.film is not None
    if scene.film.look != "kraft" or scene.camera.film == "strain":
        return np.ones(shape)
    paper = kraft_paper(around_m, up_m, seed=scene.camera.seed, pixels_per_m=_FOLD_PX_PER_M)
    grey = cv2.resize(cv2.cvtColor(paper, cv2.COLOR_RGB2GRAY), shape[::-1]).astype(float)
    shade: Array = 0.9 * grey / grey.mean()
    return shade


def _layers(scene: Scene, around_m: float, up_m: float, shape: tuple[int, ...]) -> tuple[Array, Array]:
    """How many layers lie where, 1 is the most, and how near an edge of the web is, shape [rows, columns] each."""
    wrap = scene.wrap
    assert wrap is not None
    height = np.linspace(0.0, up_m, shape[0])[:, None]
    along = np.linspace(0.0, 1.0, shape[1])[None, :]
    layers, edges = np.zeros(shape), np.zeros(shape)
    web = min(wrap.web_width_m, up_m)
    if not isinstance(wrap.turns, Turns):
        return np.full(shape, 0.5), edges
    width = 0.004

    def lay(bottom: Array | float, count: float) -> None:
        layers[...] += count * ((height >= bottom) & (height <= bottom + web))
        for edge in (bottom, bottom + web):
            edges[...] = np.maximum(edges, min(1.0, 0.5 * count) * np.exp(-(((height - edge) / width) ** 2)))

    lay(0.0, wrap.turns.bottom)
    lay(up_m - web, wrap.turns.top)
    # Passes climb or descend by the part of the web that doesn't lie on the turn before.
    climb = web * (1.0 - wrap.overlap)
    for number in range(round(wrap.turns.middle)):
        slope = climb * (1.0 if number % 2 == 0 else -1.0)
        for turn in range(-1, int(up_m / climb) + 2):
            lay(turn * climb + slope * along, 1.0)
    return layers / max(float(layers.max()), 1.0e-9), edges


def legend_end(scene: Scene) -> float:
    """Upper end of the scale of colours: the yield strain of the film as it lies, or its break strain; rounded up."""
    assert scene.film is not None
    law = scene.film.around
    end = min(law.break_strain, law.yield_force_npm / law.stiffness_npm)
    return next((nice for nice in _NICE if nice >= end), end)


def strain_colours(strains: Array, end: float) -> Array:
    """Colours of strains from 0 to the scale's end, RGB 0 to 1, shape [n] to [n, 3]."""
    levels = np.round(255.0 * np.clip(strains / end, 0.0, 1.0)).astype(np.uint8)
    shown = cv2.applyColorMap(levels[:, None], cv2.COLORMAP_TURBO)
    colours: Array = np.asarray(shown, dtype=float)[:, 0, ::-1] / 255.0
    return colours


def draw_legend(picture: NDArray[np.uint8], scene: Scene) -> None:
    """Draws what the colours of the film's strain mean into a picture's upper left corner."""
    end = legend_end(scene)
    unit = max(1.0, picture.shape[0] / 54.0)
    width, height, margin = round(14 * unit), round(unit), round(unit)
    panel = picture[margin : margin + round(4.6 * unit), margin : margin + width + 2 * margin]
    panel[...] = panel // 4
    bar = 255.0 * strain_colours(np.linspace(0.0, end, width), end)
    top = margin + round(1.9 * unit)
    picture[top : top + height, 2 * margin : 2 * margin + width] = np.round(bar).astype(np.uint8)
    scale, thick = unit / 26.0, max(1, round(unit / 14.0))

    def write(text: str, share: float, row: float) -> None:
        (long, _), _ = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, scale, thick)
        place = (round(2 * margin + share * (width - long)), round(margin + row * unit))
        cv2.putText(
            picture, text, place, cv2.FONT_HERSHEY_SIMPLEX, scale, (240, 240, 240), thick, cv2.LINE_AA
        )

    write("largest strain of the film", 0.0, 1.3)
    for share in (0.0, 0.5, 1.0):
        write(f"{100.0 * share * end:g} %", share, 4.0)
