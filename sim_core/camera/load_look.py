"""The packages as the camera sees them: printed cartons and sheets, with AprilTags stuck on."""

import numpy as np

from config.scene import Scene
from sim_core.camera.atlas import Atlas
from sim_core.camera.layout import markers_of
from sim_core.camera.meshes import PALLET, Mesh, box, merged, quad
from sim_core.camera.print import carton_faces, tag_sheet

_LARGEST_SHEET_PX = 24.0e6
"""All faces of all packages together."""
_BULGE = 0.06
_TAG_RELIEF_M = 3.0e-4
"""Paper stands off the board by so much."""


def packages(scene: Scene, atlas: Atlas, *, pixels_per_m: float) -> Mesh:
    """Every package in its own frame, and its tags.

    Args:
        scene: a resolved scene with a camera.
        atlas: gets the faces.
        pixels_per_m: resolution of what is printed.
    """
    assert scene.camera is not None
    area = sum(2.0 * (x * y + y * z + z * x) for x, y, z in (package.size_m for package in scene.packages))
    density = min(pixels_per_m, float(np.sqrt(_LARGEST_SHEET_PX / max(area, 1.0e-9))))
    parts = []
    for row, package in enumerate(scene.packages, start=1):
        faces = carton_faces(package, seed=scene.camera.seed, pixels_per_m=density)
        pictures = tuple(atlas.add(face) for face in faces)
        parts.append(box(np.zeros(3), np.array(package.size_m), pictures, body=PALLET + row, bulge=_BULGE))
    return merged([*parts, _tags(scene, atlas, pixels_per_m)])


def _tags(scene: Scene, atlas: Atlas, pixels_per_m: float) -> Mesh:
    markers = scene.camera.markers if scene.camera is not None else None
    parts = []
    for marker in markers_of(scene):
        assert markers is not None
        edge = float(np.linalg.norm(marker.sheet[1] - marker.sheet[0]))
        # A texel for each rendered pixel: finer ones would let edges jump from one to the next.
        size_px = int(np.clip(edge * pixels_per_m, 32, 2048))
        picture = atlas.add(tag_sheet(markers.dictionary, marker.tag, size_px))
        normal = np.cross(marker.sheet[3] - marker.sheet[0], marker.sheet[1] - marker.sheet[0])
        front = marker.sheet + _TAG_RELIEF_M * normal / np.linalg.norm(normal)
        parts.append(quad(front, picture, body=PALLET + marker.package, tint=(0.85, 0.85, 0.85, 0.0)))
    return merged(parts)
