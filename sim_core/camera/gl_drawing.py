"""The bench drawn by VTK's OpenGL: one mesh of all that moves, one for the rails, one for the floor's shade."""

from dataclasses import replace

import numpy as np

from config.scene import Scene
from sim_core.camera.atlas import Atlas, on_sheet
from sim_core.camera.drawing import Poses
from sim_core.camera.film_look import FilmLook
from sim_core.camera.gl_window import GlMesh, GlTexture, GlWindow
from sim_core.camera.hall import backdrop, rails, shaded_floor, shadow_region
from sim_core.camera.layout import side_of
from sim_core.camera.lighting import Lighting
from sim_core.camera.load_look import packages
from sim_core.camera.meshes import PALLET, SLED, Mesh, edge_points, merged
from sim_core.camera.sensor import Lens, Picture, Window, busy_parts, projection
from sim_core.camera.shaders import SHADE_FRAGMENT, SOLID_FRAGMENT, SOLID_VERTEX
from sim_core.camera.stage import pallet, sled
from sim_core.camera.view import CameraView
from sim_core.frames import Array, FilmFrame
from sim_core.geometry import rotation_matrices

_NEAR_M, _FAR_M = 0.05, 100.0
_LARGEST_PX = 2048
_OVERSAMPLING = 2
_PLAIN = 150


class GlDrawing:
    """Draws with OpenGL, a part of the picture at a time.

    Args:
        scene: a resolved scene with a camera.
        view: the camera.

    Raises:
        NoOpenGl: there is none.
    """

    def __init__(self, scene: Scene, view: CameraView) -> None:
        assert scene.camera is not None
        self._scene, self._view = scene, view
        self.lens = Lens(view, oversampling=_OVERSAMPLING)
        # A little more than the whole picture needs without distortion; larger ones are drawn in parts.
        width, height = (
            min(_LARGEST_PX, _OVERSAMPLING * (edge + edge // 16) + 32) for edge in (view.width, view.height)
        )
        self._window = GlWindow(width, height)
        self.largest_part = (width - 32) // _OVERSAMPLING, (height - 32) // _OVERSAMPLING
        self._window.draw()
        self.described = self._window.described
        side = side_of(scene)
        middle = side.point(0.5 * (side.left_m + side.right_m), 0.5 * side.top_m)
        depth = max(0.1, float(view.in_optical(middle[None])[0, 2]))
        density = self.lens.focal / depth
        atlas = Atlas()
        self._moving = merged(
            [
                sled(scene, side, atlas, pixels_per_m=density),
                pallet(scene, atlas, pixels_per_m=density),
                packages(scene, atlas, pixels_per_m=density),
            ]
        )
        self._moving = _near_ones_first(self._moving, scene, view)
        hall = scene.camera.background == "hall"
        fixed = {
            "far": backdrop(scene, side, atlas) if hall else merged([]),
            "near": rails(scene, side, atlas),
        }
        self._floor = shaded_floor(scene, side) if hall else merged([])
        sheet, shares = atlas.sheet()
        texture = GlTexture(sheet)
        self._light = Lighting(
            scene.camera.light, view, side, shadow_region(scene, side), self._moving, pixel_m=2.0 / density
        )
        self._meshes = {
            name: self._add(mesh, shares, texture, fragment)
            for name, mesh, fragment in (
                ("far", fixed["far"], SOLID_FRAGMENT),
                ("near", fixed["near"], SOLID_FRAGMENT),
                ("floor", self._floor, SHADE_FRAGMENT),
                ("moving", self._moving, SOLID_FRAGMENT),
            )
            if len(mesh.points)
        }
        bodies = self._moving.bodies
        self._bodies = np.unique(bodies)
        spans = np.array(
            [
                [ends(self._moving.points[bodies == body], axis=0) for ends in (np.min, np.max)]
                for body in self._bodies
            ]
        )
        # The floor around the sled is darker too.
        spans[self._bodies == SLED] += np.array([[[-0.1, -0.1, -0.3], [0.1, 0.1, 0.0]]])
        self._outlines = np.array([edge_points(low, high) for low, high in spans])
        self._film: FilmLook | None = None

    def _add(self, mesh: Mesh, shares: Array, texture: GlTexture, fragment: str) -> GlMesh:
        solid = GlMesh(
            mesh.points, mesh.triangles, (SOLID_VERTEX, fragment),
            normal=mesh.normals, place=on_sheet(mesh, shares), tint=mesh.tints,
        )  # fmt: skip
        solid.set_texture("sheet", texture)
        self._light.shine_on(solid)
        self._window.add(solid)
        return solid

    def background(self) -> Picture:
        """The hall with the rails, or an even grey."""
        view = self._view
        whole = np.full((view.height, view.width, 3), _PLAIN, np.uint8)
        self._light.clear()
        for name, mesh in self._meshes.items():
            mesh.actor.SetVisibility(name in ("far", "near"))
        everywhere = np.array([[0.0, 0.0, view.width, view.height]])
        for part in busy_parts(everywhere, width=view.width, height=view.height, largest=self.largest_part):
            drawn = self.part(part).astype(np.uint16)
            own = whole[part.rows, part.columns]
            own[...] = drawn[..., :3] + own * (255 - drawn[..., 3:]) // 255
        for name, mesh in self._meshes.items():
            mesh.actor.SetVisibility(name != "far")
        return whole

    def outlines(self, poses: Poses) -> Array:
        """Points around all that moves [m], frame ``world``, shape [bodies, n, 3]."""
        turns, moves = _motions(poses)
        placed: Array = (
            self._outlines @ turns[self._bodies].transpose(0, 2, 1) + moves[self._bodies][:, None, :]
        )
        return placed

    def light(self, poses: Poses, film: FilmFrame | None) -> None:
        """Casts the shadows of one picture."""
        self._require_film(film)
        meshes = list(self._meshes.values()) + ([self._film.mesh] if self._film is not None else [])
        self._light.follow(self._points(poses)[0], poses[0], meshes)

    def place(self, poses: Poses, film: FilmFrame | None) -> None:
        """Moves what moves."""
        points, normals = self._points(poses)
        self._meshes["moving"].set("points", points)
        self._meshes["moving"].set("normal", normals)
        if "floor" in self._meshes:
            self._meshes["floor"].set("points", self._floor.points + poses[0])
        if self._film is not None:
            self._film.mesh.actor.SetVisibility(film is not None)
            if film is not None:
                self._film.place(film, poses[0])

    def part(self, part: Window) -> Picture:
        """A part of the picture as it stands, RGBA, opacity already in its colours."""
        seen = self.lens.seen(part)
        if seen.width > self._window.width or seen.height > self._window.height:
            return self._halves(part)
        matrix = projection_in_world(self._view, self.lens.focal, seen)
        for mesh in self._meshes.values():
            mesh.set_uniform("clip_from_world", matrix)
        if self._film is not None:
            self._film.mesh.set_uniform("clip_from_world", matrix)
        self._window.draw(seen.width, seen.height)
        return self.lens.bend(self._window.colours(seen.width, seen.height), part, seen)

    def _halves(self, part: Window) -> Picture:
        """Where the lens spreads a part over more than fits into the window."""
        if part.width >= part.height:
            half = part.width // 2
            first = self.part(Window(part.left, part.top, half, part.height))
            return np.hstack(
                (first, self.part(Window(part.left + half, part.top, part.width - half, part.height)))
            )
        half = part.height // 2
        first = self.part(Window(part.left, part.top, part.width, half))
        return np.vstack(
            (first, self.part(Window(part.left, part.top + half, part.width, part.height - half)))
        )

    def close(self) -> None:
        """Gives the graphics back."""
        self._light.close()
        self._window.close()

    def _require_film(self, film: FilmFrame | None) -> None:
        if film is None or (self._film is not None and self._film.fits(film)):
            return
        if self._film is not None:
            self._window.remove(self._film.mesh)
        self._film = FilmLook(self._scene, film, self._view.position)
        self._light.shine_on(self._film.mesh)
        self._window.add(self._film.mesh)

    def _points(self, poses: Poses) -> tuple[Array, Array]:
        """Places and normals of all that moves in frame ``world`` [m], shape [n, 3] each."""
        turns, moves = _motions(poses)
        bodies = self._moving.bodies
        return (
            np.einsum("nij,nj->ni", turns[bodies], self._moving.points) + moves[bodies],
            np.einsum("nij,nj->ni", turns[bodies], self._moving.normals),
        )


def _near_ones_first(mesh: Mesh, scene: Scene, view: CameraView) -> Mesh:
    """The mesh with its bodies drawn from the camera backwards, so that what is hidden is not coloured first."""
    places = [np.zeros(3)] * (PALLET + 1) + [np.array(package.position_m) for package in scene.packages]
    depths = view.in_optical(np.array(places))[:, 2]
    order = np.argsort(depths[mesh.bodies[mesh.triangles[:, 0]]], kind="stable")
    return replace(mesh, triangles=mesh.triangles[order])


def projection_in_world(view: CameraView, focal: float, seen: Window) -> Array:
    """Clip coordinates of points in frame ``world`` for a part of the distortion-free picture, shape [4, 4]."""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = view.rotation, view.translation
    return projection(focal, seen, near_m=_NEAR_M, far_m=_FAR_M) @ pose


def _motions(poses: Poses) -> tuple[Array, Array]:
    """Rotation and place [m] of every body in frame ``world``, shapes [n, 3, 3] and [n, 3]."""
    sled, positions, orientations = poses
    turns = np.concatenate((np.tile(np.eye(3), (SLED + 1, 1, 1)), rotation_matrices(orientations)))
    return turns, np.vstack((np.zeros(3), sled, positions + sled))
