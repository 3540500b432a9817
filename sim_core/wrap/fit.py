"""Lays the film around the settled load: rows of nodes on the load's outline, triangles between them.

In each row the film is the convex hull of what stands at that height, so it bridges gaps and hollows. Hull corners
are vertical edges of boxes; a column of nodes stands on each, and more between them, as far apart as asked for.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from config.errors import RefusedInput
from config.scene import Scene
from sim_core.frames import Array
from sim_core.geometry import CORNER_SIGNS, box_corners
from sim_core.wrap.membrane import Flags, Indices

EDGE_MARGIN_M = 2.0e-3
"""The uppermost row stands at least this far below the load's top, where the boxes still are."""
ON_HULL_M = 1.0e-9
BULGE_M = 1.0e-3
"""Corners that stand out from the line between their neighbours by less bend no film."""
LEAST_HEIGHT_M = 1.0e-3
"""Less film wraps nothing."""
SAME_LEVEL = 0.2
"""Tops and bottoms of boxes that are nearer to each other than this share of the spacing are one level."""
RELIEF = 0.2
"""Rows stand so far, as a share of the spacing, from where boxes begin and end: two rows with boxes that slide on each
other between them then tear at the film as much as rows that stand far closer do (36.9, 38.3, 33.9 and 32.0 mm of slip
at spacings of 0.1, 0.07, 0.05 and 0.035 m with even rows; 28.9, 27.7 and 28.2 mm with these)."""
SAME_COLUMN = 0.3
"""Corners of different rows that are nearer to each other than this share of the spacing share a column."""


@dataclass(frozen=True, eq=False, slots=True)
class FilmMesh:
    """The film as it was wrapped.

    Nodes run row after row from below, in each counter-clockwise from above. A cell is what lies between a column
    and the next; the triangles of even cells come first.

    Attributes:
        rows: number of rows.
        columns: number of columns, even; the last is next to the first, which stands on an edge.
        positions: nodes [m], frame ``sled``, shape [rows * columns, 3].
        triangles: node indices, outward by the right-hand rule, shape [m, 3].
        bands: row below each triangle, shape [m].
        even_count: number of triangles in even cells.
        owners: row of the body whose vertical edge a node stands on, or -1, shape [rows * columns].
        edges: signs of that edge in the body's frame, x and y, shape [rows * columns, 2].
        outwards: horizontal unit vectors away from the load, shape [rows * columns, 3].
        heights: of the rows above the sled [m], shape [rows].
    """

    rows: int
    columns: int
    positions: Array
    triangles: Indices
    bands: Indices
    even_count: int
    owners: Indices
    edges: Array
    outwards: Array
    heights: Array


def fit_film(
    scene: Scene, positions: Array, orientations: Array, *, span_m: tuple[float, float], spacing_m: float
) -> FilmMesh:
    """Fits the film around a settled load.

    Args:
        scene: a resolved scene with packages.
        positions: settled centres [m], shape [package_count + 1, 3], row 0 the pallet.
        orientations: settled unit quaternions, shape [package_count + 1, 4].
        span_m: lower and upper edge of the film above the sled [m].
        spacing_m: distance of rows and columns, about [m].

    Raises:
        RefusedInput: the film would be no higher than a millimetre.
    """
    half_sizes, is_solid = solid_boxes(scene)
    corners = box_corners(positions, orientations, half_sizes)
    low = span_m[0]
    high = min(span_m[1], float(corners[is_solid][:, :, 2].max()) - EDGE_MARGIN_M)
    if not high - low > LEAST_HEIGHT_M:
        raise RefusedInput("wrap.height_m", f"{high - low:.4g} m of film", "is too little to wrap anything")
    heights = _row_heights(corners[is_solid], low, high, spacing_m)
    outlines = [_outline(corners, is_solid, z) for z in heights]
    angles = _column_angles([points for points, _, _ in outlines], spacing_m)
    nodes, owners, edges = [], [], []
    for z, (points, bodies, signs) in zip(heights, outlines, strict=True):
        places, found = _on_outline(points, angles)
        nodes.append(np.column_stack([places, np.full(len(angles), z)]))
        owners.append(np.where(found >= 0, bodies[found], -1))
        edges.append(np.where(found[:, None] >= 0, signs[found], 0.0))
    rows, columns = len(heights), len(angles)
    triangles, bands, even_count = _triangles(rows, columns)
    rings = np.array(nodes)
    along = np.roll(rings, -1, axis=1) - np.roll(rings, 1, axis=1)
    outwards = np.cross(along, [0.0, 0.0, 1.0]).reshape(-1, 3)
    return FilmMesh(
        rows=rows, columns=columns, positions=rings.reshape(-1, 3), triangles=triangles, bands=bands,
        even_count=even_count, owners=np.concatenate(owners).astype(np.int64), edges=np.concatenate(edges),
        outwards=outwards / np.linalg.norm(outwards, axis=1, keepdims=True), heights=heights,
    )  # fmt: skip


@dataclass(frozen=True, eq=False, slots=True)
class Sides:
    """The film's sides, from one edge of the load to the next in each row.

    Attributes:
        before: the edge node before each node, or -1 in a row without edges; an edge node's own, shape [n].
        after: the edge node after it, shape [n].
        shares: how far along its side each node is, 0 to 1, shape [n].
    """

    before: Indices
    after: Indices
    shares: Array


def find_sides(mesh: FilmMesh, is_edge: Flags) -> Sides:
    """The sides of a film as it was wrapped.

    Args:
        mesh: the film.
        is_edge: nodes on edges, shape [n].
    """
    shape = mesh.rows, mesh.columns
    rings, on_edge = mesh.positions.reshape(*shape, 3), is_edge.reshape(shape)
    gaps = np.linalg.norm(np.roll(rings, -1, axis=1) - rings, axis=2)
    before, after = np.full((2, *shape), -1, dtype=np.int64)
    shares = np.zeros(shape)
    for row in range(mesh.rows):
        edges = np.flatnonzero(on_edge[row])
        for first, second in zip(edges, np.roll(edges, -1), strict=True):
            nodes = (first + np.arange((second - first - 1) % mesh.columns + 1)) % mesh.columns
            along = np.cumsum(gaps[row, nodes])
            before[row, nodes], after[row, nodes] = row * mesh.columns + first, row * mesh.columns + second
            shares[row, nodes[1:]] = along[:-1] / along[-1]
    return Sides(before.ravel(), after.ravel(), shares.ravel())


def solid_boxes(scene: Scene) -> tuple[Array, Flags]:
    """Half sizes of every body [m], shape [package_count + 1, 3], and which of them a film can lie on."""
    pallet = scene.pallet_box
    sizes = [pallet.size_m if pallet is not None else (0.0, 0.0, 0.0)]
    sizes += [package.size_m for package in scene.packages]
    is_solid = [pallet is not None] + [package.kind == "package" for package in scene.packages]
    return 0.5 * np.array(sizes), np.array(is_solid)


def _row_heights(corners: Array, low: float, high: float, spacing_m: float) -> Array:
    """Heights of the rows: near to where boxes begin and end, and even between.

    A row stands for the film half-way to the next rows, and these borders are where boxes end, so that each box gets
    the film on its height; one more row stands on either edge of the film.
    """
    ends = np.sort(np.concatenate([corners[:, :, 2].min(axis=1), corners[:, :, 2].max(axis=1)]))
    levels = [low]
    for z in ends:
        if levels[-1] + SAME_LEVEL * spacing_m < z < high - SAME_LEVEL * spacing_m:
            levels.append(float(z))
    levels.append(high)
    rows = [low]
    for start, end in pairwise(levels):
        relief = min(RELIEF * spacing_m, 0.25 * (end - start))
        count = max(1, round((end - start - 2.0 * relief) / spacing_m))
        rows += np.linspace(start + relief, end - relief, count + 1).tolist()
    return np.array([*rows, high])


def _outline(corners: Array, is_solid: Flags, z: float) -> tuple[Array, Indices, Array]:
    """Convex hull of the bodies at a height, or at the nearest height that has any: points, bodies, edge signs."""
    low, high = corners[:, :, 2].min(axis=1), corners[:, :, 2].max(axis=1)
    apart = np.where(is_solid, np.maximum(np.maximum(low - z, z - high), 0.0), np.inf)
    rows = np.flatnonzero(apart <= apart.min() + ON_HULL_M)
    # The four vertical edges, taken where their lower corners are: a settled load stands upright.
    places = corners[rows][:, :4, :2].reshape(-1, 2)
    bodies, signs = np.repeat(rows, 4), np.tile(CORNER_SIGNS[:4, :2], (len(rows), 1))
    hull = _hull(places)
    return places[hull], bodies[hull], signs[hull]


def _hull(points: Array) -> Indices:
    """Indices of the convex hull, counter-clockwise, without points that hardly bend it (Andrew's monotone chain)."""
    order = np.lexsort((points[:, 1], points[:, 0]))

    def chain(indices: Indices) -> list[int]:
        kept: list[int] = []
        for index in indices:
            while len(kept) > 1:
                a, b, c = points[kept[-2]], points[kept[-1]], points[index]
                if (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]) > 0.0:
                    break
                kept.pop()
            kept.append(int(index))
        return kept[:-1]

    hull = chain(order) + chain(order[::-1])
    while len(hull) > 4:
        corners = points[hull]
        before, after = np.roll(corners, 1, axis=0), np.roll(corners, -1, axis=0)
        side, arm = after - before, corners - before
        bulges = np.abs(side[:, 0] * arm[:, 1] - side[:, 1] * arm[:, 0]) / np.linalg.norm(side, axis=1)
        if bulges.min() > BULGE_M:
            break
        del hull[int(bulges.argmin())]
    return np.array(hull, dtype=np.int64)


def _squared(points: Array) -> tuple[Array, Array, Array]:
    """An outline's points in the square of its bounding box, and that box's middle and half sizes.

    Corners of upright rectangles of any size and place then lie in the same four directions, in the same columns.
    """
    low, high = points.min(axis=0), points.max(axis=0)
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    return (points - middle) / half, middle, half


def _column_angles(outlines: list[Array], spacing_m: float) -> Array:
    """Directions of the columns from the load's middle: to the corners of all rows' outlines, and between them."""
    squared, _, half = _squared(np.concatenate(outlines))
    whole = squared[_hull(squared)]
    near = SAME_COLUMN * spacing_m / float(half.max())
    kept = sorted(float(np.arctan2(y, x)) for x, y in whole)
    for outline in outlines:
        for x, y in _squared(outline)[0]:
            angle = float(np.arctan2(y, x))
            if min(abs(np.angle(np.exp(1j * (angle - other)))) for other in kept) > near:
                kept.append(angle)
    # Corners that no outline of all shows stand on its sides.
    corners = _on_outline(whole, np.array(sorted(kept)))[0]
    ends = np.roll(corners, -1, axis=0)
    lengths = np.linalg.norm((ends - corners) * half, axis=1)
    counts = np.maximum(1 if len(corners) > 8 else 2, np.round(lengths / spacing_m)).astype(int)
    # Cells before and after a column are told apart by being even or odd, also across the seam.
    counts[lengths.argmax()] += counts.sum() % 2
    found: list[float] = []
    for start, end, count in zip(corners, ends, counts.tolist(), strict=True):
        for k in range(count):
            x, y = start + (end - start) * k / count
            found.append(float(np.arctan2(y, x)))
    return np.unwrap(np.array(found))


def _on_outline(points: Array, angles: Array) -> tuple[Array, Indices]:
    """A point of the outline in each direction, moved to the nearest corner where it is some column's nearest.

    Returns:
        Points [m], shape [columns, 2], and each one's corner of the outline or -1.
    """
    squared, middle, half = _squared(points)
    rays = np.column_stack([np.cos(angles), np.sin(angles)])
    starts, sides = squared, np.roll(squared, -1, axis=0) - squared
    # Ray s·u meets side p + t·d where u × (p + t·d) = 0.
    along = rays[:, None, 0] * sides[None, :, 1] - rays[:, None, 1] * sides[None, :, 0]
    across = rays[:, None, 0] * starts[None, :, 1] - rays[:, None, 1] * starts[None, :, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        t = -across / along
        places = starts[None] + t[:, :, None] * sides[None]
        reach = np.einsum("cpk,ck->cp", places, rays)
    valid = np.isfinite(t) & (t >= -1.0e-9) & (t <= 1.0 + 1.0e-9) & (reach > 0.0)
    side = np.where(valid, reach, -np.inf).argmax(axis=1)
    result = middle + places[np.arange(len(angles)), side] * half
    corner_of = np.full(len(angles), -1, dtype=np.int64)
    turns = np.angle(np.exp(1j * (angles[None] - np.arctan2(squared[:, 1], squared[:, 0])[:, None])))
    for corner in range(len(points)):
        # A column holds one corner: a second one that is as near takes the next.
        column = int(np.where(corner_of < 0, np.abs(turns[corner]), np.inf).argmin())
        result[column], corner_of[column] = points[corner], corner
    return result, corner_of


def _triangles(rows: int, columns: int) -> tuple[Indices, Indices, int]:
    """Two triangles a cell, those of even cells first, their diagonals alternating so that none is preferred.

    Returns:
        Triangles, the row below each, and how many lie in even cells.
    """
    found, bands = [], []
    for parity in range(2):
        for row in range(rows - 1):
            for column in range(parity, columns, 2):
                beside = (column + 1) % columns
                a, b = row * columns + column, row * columns + beside
                d, c = a + columns, b + columns
                found += [(a, b, c), (a, c, d)] if (row + column) % 2 == 0 else [(a, b, d), (b, c, d)]
                bands += [row, row]
    return np.array(found, dtype=np.int64), np.array(bands, dtype=np.int64), len(found) // 2


def flattened(positions: Array, triangles: Indices) -> Array:
    """Each triangle laid into its own plane: x horizontal along it, y up along it [m], shape [m, 3, 2]."""
    corners = positions[triangles]
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    normal = np.cross(first, second)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    across = np.cross([0.0, 0.0, 1.0], normal)
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    up = np.cross(normal, across)
    relative = corners - corners[:, :1]
    return np.stack(
        [np.einsum("mck,mk->mc", relative, across), np.einsum("mck,mk->mc", relative, up)], axis=2
    )


def unrolled(mesh: FilmMesh) -> Array:
    """The triangles' corners on the unrolled film: way around, the mean of all rows, and height [m], [m, 3, 2].

    It is cut along the first column; the way around goes on past the end, so that no triangle is torn by the cut.
    """
    rings = mesh.positions.reshape(mesh.rows, mesh.columns, 3)
    gaps = np.linalg.norm(np.roll(rings, -1, axis=1) - rings, axis=2).mean(axis=0)
    ends = np.cumsum(gaps)
    columns, rows = mesh.triangles % mesh.columns, mesh.triangles // mesh.columns
    around = np.concatenate([[0.0], ends[:-1]])[columns]
    is_last = (columns == mesh.columns - 1).any(axis=1)[:, None] & (columns == 0)
    return np.stack([np.where(is_last, ends[-1], around), mesh.heights[rows]], axis=2)
