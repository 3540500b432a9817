"""The bench's light: one lamp with soft shadows, and the hall, which reaches less of what is under something else.

Two depth maps are drawn for each picture: from the lamp, blurred as wide as its shadows are soft, and from straight
above, blurred much wider. Their first two moments bound how much of the light arrives (variance shadow maps:
Donnelly and Lauritzen, I3D 2006).
"""

import cv2
import numpy as np

from config.camera import Light
from sim_core.camera.gl_window import Floats, GlMesh, GlTexture, GlWindow
from sim_core.camera.layout import Side
from sim_core.camera.meshes import Mesh
from sim_core.camera.shaders import DEPTH_FRAGMENT, DEPTH_VERTEX
from sim_core.camera.view import CameraView
from sim_core.frames import Array

_WHITE = 0.92
"""Light that the camera gets from a white sheet that faces it: whoever set it up has exposed for that."""
_DARKEST = 0.2
_SOFT_M, _WIDE_M = 0.035, 0.22
_LAMP_TEXEL_M, _SKY_TEXEL_M = 0.006, 0.02
_LONGEST_PX = 1024


def lamp_direction(light: Light, view: CameraView, side: Side) -> Array:
    """Unit vector towards the lamp in frame ``world``, shape [3]."""
    back = -view.rotation[2] * np.array([1.0, 1.0, 0.0])
    back = back / np.linalg.norm(back) if np.linalg.norm(back) > 1.0e-3 else side.normal
    azimuth, elevation = np.deg2rad(light.azimuth_deg), np.deg2rad(light.elevation_deg)
    turn = np.array([[np.cos(azimuth), -np.sin(azimuth)], [np.sin(azimuth), np.cos(azimuth)]])
    flat = turn @ back[:2]
    return np.array([*(np.cos(elevation) * flat), np.sin(elevation)])


class _DepthMap:
    """A blurred map of depths along a direction, over a region that moves with the sled."""

    def __init__(
        self, towards: Array, region: Array, casters: Mesh, *, texel_m: float, blur_m: float
    ) -> None:
        up = np.array([0.0, 0.0, 1.0]) if abs(towards[2]) < 0.95 else np.array([0.0, 1.0, 0.0])
        right = np.cross(up, towards)
        right = right / np.linalg.norm(right)
        axes = np.array([right, np.cross(towards, right), -towards])
        placed = region @ axes.T
        low, high = placed.min(axis=0) - 0.1, placed.max(axis=0) + 0.1
        span = high - low
        texel = max(texel_m, float(span[:2].max()) / _LONGEST_PX)
        width, height = (int(edge) for edge in np.ceil(span[:2] / texel))
        # Depths are metres from the region's middle.
        self._map = np.eye(4)
        self._map[:3, :3] = axes / np.array([[span[0]], [span[1]], [1.0]])
        self._map[:3, 3] = -low[0] / span[0], -low[1] / span[1], -0.5 * (low[2] + high[2])
        self._clip = np.diag([2.0, 2.0, 2.0 / span[2], 1.0])
        self._clip[:2, 3] = -1.0
        self._depth_m = float(span[2])
        self.reach_m = 0.5 * self._depth_m
        self._kernel = 2 * max(1, round(0.5 * blur_m / texel)) + 1
        self._window = GlWindow(width, height)
        self._mesh = GlMesh(casters.points, casters.triangles, (DEPTH_VERTEX, DEPTH_FRAGMENT))
        self._window.add(self._mesh)
        self.texture = GlTexture(self._open(height, width))

    def _open(self, rows: int, columns: int) -> Floats:
        far = np.float32(self.reach_m)
        return np.full((rows, columns, 3), (far, far * far, far), np.float32)

    def from_world(self, sled: Array) -> Array:
        """Places on the map, 0 to 1, and depth [m] of points in ``world``, shape [4, 4]."""
        moved = self._map.copy()
        moved[:3, 3] -= moved[:3, :3] @ sled
        return moved

    def draw(self, points: Array, sled: Array) -> None:
        """Draws the map with its vertices at these places."""
        self._mesh.set("points", points)
        self._mesh.set_uniform("clip_from_world", self._clip @ self.from_world(sled))
        self._window.draw()
        depths = (self._window.depths() - np.float32(0.5)) * np.float32(self._depth_m)
        moments = cv2.merge([depths, depths * depths])
        for _ in range(2):
            moments = cv2.blur(moments, (self._kernel, self._kernel), borderType=cv2.BORDER_REPLICATE)
        # Textures have three channels; two are looked at.
        self.texture.set(np.dstack((moments, moments[..., :1])).astype(np.float32, copy=False))

    def clear(self) -> None:
        """Nothing is in the light's way."""
        self.texture.set(self._open(self._window.height, self._window.width))

    def close(self) -> None:
        """Gives the graphics back."""
        self._window.close()


class Lighting:
    """Light and its shadows for the meshes of one window.

    Args:
        light: of the scene's camera.
        view: the camera.
        side: of the load that it sees.
        region: corners of a box in frame ``sled`` in which things cast shadows [m], shape [8, 3].
        casters: all that casts shadows.
        pixel_m: size of the camera's pixels at the load [m]: shadows are drawn no finer.
    """

    def __init__(
        self, light: Light, view: CameraView, side: Side, region: Array, casters: Mesh, *, pixel_m: float
    ) -> None:
        self._lamp = lamp_direction(light, view, side)
        self._share = light.share
        self._casts = light.shadows
        back = -view.rotation[2] * np.array([1.0, 1.0, 0.0])
        facing = max(0.0, float(self._lamp @ back) / max(float(np.linalg.norm(back)), 1.0e-3))
        # The shaders' light on an upright sheet with nothing around it.
        sheet = (1.0 - self._share) * 0.83 + 1.55 * self._share * facing
        self._brightness = _WHITE / max(sheet, _DARKEST)
        upwards = np.array([0.0, 0.0, 1.0])
        texels = {"lamp": max(_LAMP_TEXEL_M, pixel_m), "sky": max(_SKY_TEXEL_M, 2.0 * pixel_m)}
        self._maps = {
            "lamp": _DepthMap(self._lamp, region, casters, texel_m=texels["lamp"], blur_m=_SOFT_M),
            "sky": _DepthMap(upwards, region, casters, texel_m=texels["sky"], blur_m=_WIDE_M),
        }
        self._eye, self._axis = view.position, -view.rotation[2]

    def shine_on(self, mesh: GlMesh) -> None:
        """Lets a mesh be seen in this light."""
        for name, own in self._maps.items():
            mesh.set_texture(f"{name}_map", own.texture)
            mesh.set_uniform(f"{name}_reach", own.reach_m)
            mesh.set_uniform(f"{name}_from_world", own.from_world(np.zeros(3)))
        mesh.set_uniform("lamp", self._lamp)
        mesh.set_uniform("lamp_share", self._share)
        mesh.set_uniform("brightness", self._brightness)
        mesh.set_uniform("eye", self._eye)
        mesh.set_uniform("axis", self._axis)

    def follow(self, points: Array, sled: Array, meshes: list[GlMesh]) -> None:
        """Casts the shadows of what is at these places [m], shape [n, 3], on the meshes."""
        for name, own in self._maps.items():
            if self._casts:
                own.draw(points, sled)
            for mesh in meshes:
                mesh.set_uniform(f"{name}_from_world", own.from_world(sled))

    def clear(self) -> None:
        """Nothing casts a shadow."""
        for own in self._maps.values():
            own.clear()

    def close(self) -> None:
        """Gives the graphics back."""
        for own in self._maps.values():
            own.close()
