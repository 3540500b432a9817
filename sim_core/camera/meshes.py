"""Triangle meshes of the bench and its load: every vertex belongs to a body that moves, and to a picture it shows."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sim_core.frames import Array
from sim_core.geometry import CORNER_SIGNS

Index = NDArray[np.int64]

FIXED, SLED, PALLET = 0, 1, 2
"""Bodies: what stands in ``world``, the sled, row 0 of a pose frame; its row r is body 2 + r."""

# Of each face: its normal's axis and sign, and along which axes its picture runs to the right and up.
_FACES = (
    (0, -1.0, (1, -1.0), (2, 1.0)),
    (0, 1.0, (1, 1.0), (2, 1.0)),
    (1, -1.0, (0, 1.0), (2, 1.0)),
    (1, 1.0, (0, -1.0), (2, 1.0)),
    (2, -1.0, (0, -1.0), (1, 1.0)),
    (2, 1.0, (0, 1.0), (1, 1.0)),
)


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles with what their shader needs, a vertex a row.

    Attributes:
        points: places in the body's own frame [m], shape [n, 3].
        normals: unit normals in the same frame, shape [n, 3].
        places: on the vertex's picture, 0 to 1 from its left and its upper edge, shape [n, 2].
        pictures: number of that picture in the atlas, shape [n].
        tints: what its light is multiplied by, as colour in linear light, and its gloss, shape [n, 4].
        bodies: number of the body, shape [n].
        triangles: rows of their corners, shape [m, 3].
    """

    points: Array
    normals: Array
    places: Array
    pictures: Index
    tints: Array
    bodies: Index
    triangles: Index


def quad(
    corners: Array,
    picture: int,
    *,
    body: int,
    tint: tuple[float, float, float, float] = (1.0, 1.0, 1.0, 0.0),
    part: tuple[float, float, float, float] = (0.0, 0.0, 1.0, 1.0),
) -> Mesh:
    """A flat quadrangle that shows a picture.

    Args:
        corners: clockwise as seen from its front, from the picture's upper left one [m], shape [4, 3].
        picture: number of the picture in the atlas.
        body: that it belongs to.
        tint: colour and gloss.
        part: of the picture that is shown: left, top, right, bottom, 0 to 1.
    """
    normal = np.cross(corners[3] - corners[0], corners[1] - corners[0])
    left, top, right, bottom = part
    return Mesh(
        points=np.asarray(corners, dtype=float),
        normals=np.tile(normal / np.linalg.norm(normal), (4, 1)),
        places=np.array([[left, top], [right, top], [right, bottom], [left, bottom]]),
        pictures=np.full(4, picture),
        tints=np.tile(np.array(tint, dtype=float), (4, 1)),
        bodies=np.full(4, body),
        triangles=np.array([[0, 2, 1], [0, 3, 2]]),
    )


def box_face(centre: Array, half: Array, face: int) -> Array:
    """Corners of face −x, +x, −y, +y, −z or +z of a box, as ``quad`` takes them [m], shape [4, 3]."""
    axis, sign, (along, rightwards), (up, upwards) = _FACES[face]
    middle, right, top = np.array(centre, dtype=float), np.zeros(3), np.zeros(3)
    middle[axis] += sign * half[axis]
    right[along] = rightwards * half[along]
    top[up] = upwards * half[up]
    return np.array([middle - right + top, middle + right + top, middle + right - top, middle - right - top])


def box(
    centre: Array,
    size: Array,
    pictures: int | tuple[int, ...],
    *,
    body: int,
    tint: tuple[float, float, float, float] = (1.0, 1.0, 1.0, 0.0),
    faces: tuple[int, ...] = (0, 1, 2, 3, 4, 5),
    bulge: float = 0.0,
) -> Mesh:
    """A box in its body's axes.

    Args:
        centre: [m], shape [3].
        size: edge lengths [m], shape [3].
        pictures: of all faces, or of each.
        body: that it belongs to.
        tint: colour and gloss.
        faces: those that are there.
        bulge: by how much its sides look outwards near their edges [rad]: nothing filled is flat.
    """
    shown = (pictures,) * 6 if isinstance(pictures, int) else pictures
    half = 0.5 * np.asarray(size, dtype=float)
    built = merged([quad(box_face(centre, half, face), shown[face], body=body, tint=tint) for face in faces])
    leaning = built.normals + bulge * np.sign(built.points - centre)
    return replace(built, normals=leaning / np.linalg.norm(leaning, axis=1, keepdims=True))


def turned(mesh: Mesh, axes: Array, origin: Array) -> Mesh:
    """A mesh that was made in axes of its own.

    Args:
        mesh: in those axes.
        axes: their unit vectors, a row each, shape [3, 3].
        origin: their origin [m], shape [3].
    """
    return Mesh(
        mesh.points @ axes + origin, mesh.normals @ axes, mesh.places, mesh.pictures, mesh.tints, mesh.bodies,
        mesh.triangles,
    )  # fmt: skip


def merged(meshes: list[Mesh]) -> Mesh:
    """All of them as one; none at all is an empty one."""
    if not meshes:
        empty = np.zeros((0, 3))
        none = np.zeros(0, dtype=np.int64)
        return Mesh(
            empty, empty, empty[:, :2], none, np.zeros((0, 4)), none, np.zeros((0, 3), dtype=np.int64)
        )
    starts = np.cumsum([0, *(len(mesh.points) for mesh in meshes[:-1])])
    return Mesh(
        points=np.vstack([mesh.points for mesh in meshes]),
        normals=np.vstack([mesh.normals for mesh in meshes]),
        places=np.vstack([mesh.places for mesh in meshes]),
        pictures=np.concatenate([mesh.pictures for mesh in meshes]),
        tints=np.vstack([mesh.tints for mesh in meshes]),
        bodies=np.concatenate([mesh.bodies for mesh in meshes]),
        triangles=np.vstack([mesh.triangles + start for mesh, start in zip(meshes, starts, strict=True)]),
    )


def edge_points(low: Array, high: Array, pieces: int = 9) -> Array:
    """Points along the edges of a box from its least to its greatest corner, shape [12 · pieces, 3].

    A lens bends edges: their ends alone don't bound them in a picture.
    """
    corners = 0.5 * (low + high) + 0.5 * (high - low) * CORNER_SIGNS
    ends = [(a, b) for a in range(8) for b in range(a) if (CORNER_SIGNS[a] != CORNER_SIGNS[b]).sum() == 1]
    shares = np.linspace(0.0, 1.0, pieces)[:, None]
    return np.vstack([corners[a] + shares * (corners[b] - corners[a]) for a, b in ends])
