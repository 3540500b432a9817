"""Direct solution of a film's tangent stiffness: banded over the sides of the load, bordered by its edges.

Column after column around the load the matrix is a band, but for the nodes on edges and on one column where the ring
is cut. These come last, as a border, and what the band leaves of their stiffness is a small dense matrix, the core:

    K = [B Aᵀ; A C],   B = L·Lᵀ,   arms A·L⁻ᵀ,   core C − A·B⁻¹·Aᵀ

So the ways in which film slips on edges can be held or let go at will without a new factorisation. A factor that is
a little out of date still serves, as modified Newton does.
"""

from dataclasses import dataclass

import numpy as np

from sim_core.frames import Array
from sim_core.wrap.film import Film
from sim_core.wrap.membrane import Flags, Indices, assemble_tangent, compiled

LEAST_PIVOT = 1.0e-6
"""Smallest pivot that counts as stiffness, as a share of the diagonal before elimination."""


@dataclass(frozen=True, eq=False, slots=True)
class Numbering:
    """Where the nodes' unknowns, three a node, stand.

    Attributes:
        places: of a node in the band, or −1 − its place in the border, shape [n].
        band_count: unknowns of the band.
        border_count: unknowns of the border.
        width: unknowns that one in the band is coupled to, at most, among those before it.
    """

    places: Indices
    band_count: int
    border_count: int
    width: int


@dataclass(frozen=True, eq=False, slots=True)
class Factor:
    """A factorised tangent stiffness; its arrays are never changed.

    Attributes:
        band: L in rows, the diagonal last, shape [band_count, width + 1].
        arms: A·L⁻ᵀ, shape [border_count, band_count].
        reaches: first column of each arm that isn't zero and the one after the last, shape [border_count, 2].
        core: shape [border_count, border_count].
    """

    band: Array
    arms: Array
    reaches: Indices
    core: Array


def number_nodes(film: Film, on_border: Flags, columns: int) -> Numbering:
    """Numbers the nodes of rows of so many columns: those off the border column by column, then the border.

    Args:
        film: the elements.
        on_border: nodes on the border, those of column 0 among them, shape [n].
        columns: nodes of one row.
    """
    order = np.arange(len(on_border)).reshape(-1, columns).T.ravel()
    places = np.empty(len(on_border), dtype=np.int64)
    inner, outer = order[~on_border[order]], order[on_border[order]]
    places[inner] = np.arange(len(inner))
    places[outer] = -1 - np.arange(len(outer))
    rows = np.repeat(np.arange(len(on_border)), np.diff(film.row_start))
    apart = np.abs(places[rows] - places[film.columns])[(places[rows] >= 0) & (places[film.columns] >= 0)]
    return Numbering(places, 3 * len(inner), 3 * len(outer), 3 * int(apart.max(initial=0)) + 2)


def factorise(
    film: Film,
    positions: Array,
    even_count: int,
    even_ways: Array,
    odd_ways: Array,
    is_blocked: Flags,
    numbering: Numbering,
    *,
    damping: float,
) -> Factor:
    """Assembles and factorises the tangent stiffness along the nodes' ways.

    Args:
        film: the elements, those of even cells first.
        positions: [m], shape [n, 3].
        even_count: elements in even cells.
        even_ways: ways to move as even cells see them, or zeros, shape [n, 3, 3], a way a row.
        odd_ways: the same for odd cells.
        is_blocked: nodes that don't move along their third way, shape [n]; it is left uncoupled.
        numbering: of the nodes.
        damping: added to the diagonal [N/m].
    """
    halves = np.empty((2, len(film.columns), 3, 3))
    for half, part in enumerate((slice(None, even_count), slice(even_count, None))):
        assemble_tangent(
            positions, film.triangles[part], film.inverse_reference[part], film.area[part], film.stiffness[part],
            film.set_strain[part], film.torn[part], film.slots[part], halves[half],
        )  # fmt: skip
    band = np.zeros((numbering.band_count, numbering.width + 1))
    arms = np.zeros((numbering.border_count, numbering.band_count))
    core = np.zeros((numbering.border_count, numbering.border_count))
    reaches = np.zeros((numbering.border_count, 2), dtype=np.int64)
    _gather(
        film.row_start, film.columns, halves[0], halves[1], even_ways, odd_ways, is_blocked, numbering.places, damping,
        band, arms, core,
    )  # fmt: skip
    _eliminate(band, arms, core, reaches)
    return Factor(band, arms, reaches, core)


@compiled
def _gather(
    row_start: Indices,
    columns: Indices,
    even_blocks: Array,
    odd_blocks: Array,
    even_ways: Array,
    odd_ways: Array,
    is_blocked: Flags,
    places: Indices,
    damping: float,
    band: Array,
    arms: Array,
    core: Array,
) -> None:
    """Writes the stiffness along the ways into its lower triangle; a way that isn't there gets a one."""
    width = band.shape[1] - 1
    half, block = np.empty((3, 3)), np.empty((3, 3))
    for i in range(len(places)):
        for at in range(row_start[i], row_start[i + 1]):
            j = columns[at]
            here, there = places[i], places[j]
            # Border after band, and in each the later before the earlier: the lower triangle.
            if (here >= 0 and (there < 0 or there > here)) or (here < 0 and there < here):
                continue
            block[:] = 0.0
            for part in range(2):
                k = even_blocks[at] if part == 0 else odd_blocks[at]
                left = even_ways[i] if part == 0 else odd_ways[i]
                right = even_ways[j] if part == 0 else odd_ways[j]
                if not k.any():
                    continue
                for a in range(3):
                    for b in range(3):
                        half[a, b] = left[a, 0] * k[0, b] + left[a, 1] * k[1, b] + left[a, 2] * k[2, b]
                for a in range(3):
                    for b in range(3):
                        block[a, b] += (
                            half[a, 0] * right[b, 0] + half[a, 1] * right[b, 1] + half[a, 2] * right[b, 2]
                        )
            if is_blocked[i] or is_blocked[j]:
                for a in range(3):
                    for b in range(3):
                        if ((is_blocked[i] and a == 2) or (is_blocked[j] and b == 2)) and (i != j or a != b):
                            block[a, b] = 0.0
            if i == j:
                for a in range(3):
                    way = even_ways[i, a]
                    is_there = way[0] * way[0] + way[1] * way[1] + way[2] * way[2] > 0.5
                    block[a, a] += damping if is_there else 1.0
            for a in range(3):
                for b in range(3):
                    if here >= 0:
                        apart = 3 * (here - there) + a - b
                        if apart >= 0:
                            band[3 * here + a, width - apart] = block[a, b]
                    elif there >= 0:
                        arms[3 * (-1 - here) + a, 3 * there + b] = block[a, b]
                    else:
                        core[3 * (-1 - here) + a, 3 * (-1 - there) + b] = block[a, b]
                        core[3 * (-1 - there) + b, 3 * (-1 - here) + a] = block[a, b]


@compiled
def _eliminate(band: Array, arms: Array, core: Array, reaches: Indices) -> None:
    """Cholesky factor of the band, its arms and what is left of the core, in place, a node's three columns at once."""
    n, width = len(band), band.shape[1] - 1
    border, below = len(arms), width - 2
    first, second, third = np.empty(below), np.empty(below), np.empty(below)
    ends, rows, lower = np.zeros((3, border)), np.empty(border, np.int64), np.empty(6)
    reaches[:, 0] = n
    for k in range(0, n, 3):
        _factor_pivot(band, k, lower)
        count = min(below, n - 3 - k)
        last = 0
        for i in range(count):
            row = band[k + 3 + i]
            at = width - 3 - i
            _divide(row[at : at + 3], lower)
            first[i], second[i], third[i] = row[at], row[at + 1], row[at + 2]
            if first[i] != 0.0 or second[i] != 0.0 or third[i] != 0.0:
                last = i + 1
        for i in range(last):
            f, g, h = first[i], second[i], third[i]
            row = band[k + 3 + i, width - i : width + 1]
            for j in range(i + 1):
                row[j] -= f * first[j] + g * second[j] + h * third[j]
        found = 0
        for b in range(border):
            arm = arms[b, k : k + 3]
            if arm[0] != 0.0 or arm[1] != 0.0 or arm[2] != 0.0:
                _divide(arm, lower)
                ends[:, b] = arm
                rows[found] = b
                found += 1
                reaches[b, 0] = min(reaches[b, 0], k)
                reaches[b, 1] = k + 3
        start = rows[0] if found > 0 else 0
        for a in range(found):
            b = rows[a]
            f, g, h = ends[0, b], ends[1, b], ends[2, b]
            arm = arms[b, k + 3 : k + 3 + last]
            for j in range(last):
                arm[j] -= f * first[j] + g * second[j] + h * third[j]
            row, one, two, three = core[b, start : b + 1], ends[0, start:], ends[1, start:], ends[2, start:]
            for j in range(b + 1 - start):
                row[j] -= f * one[j] + g * two[j] + h * three[j]
        for a in range(found):
            ends[:, rows[a]] = 0.0
    for a in range(border):
        for b in range(a):
            core[b, a] = core[a, b]


@compiled
def _factor_pivot(band: Array, k: int, lower: Array) -> None:
    """Cholesky factor of the three columns' own block, in place and as 00, 10, 11, 20, 21, 22 in ``lower``."""
    width = band.shape[1] - 1
    at = 0
    for row in range(3):
        for column in range(row + 1):
            first = value = band[k + row, width - row + column]
            for before in range(column):
                value -= band[k + row, width - row + before] * band[k + column, width - column + before]
            if column < row:
                value /= band[k + column, width]
            else:
                # Film that gives way, or would by round-off, is held as stiff as its own element is.
                value = np.sqrt(value if value > LEAST_PIVOT * first else max(first, 1.0))
            band[k + row, width - row + column] = value
            lower[at] = value
            at += 1


@compiled
def _divide(row: Array, lower: Array) -> None:
    """A row's three entries over the pivot's factor, in place."""
    row[0] /= lower[0]
    row[1] = (row[1] - lower[1] * row[0]) / lower[2]
    row[2] = (row[2] - lower[3] * row[0] - lower[4] * row[1]) / lower[5]


@compiled
def condense(
    places: Indices, pushes: Array, band: Array, arms: Array, reaches: Indices, inner: Array, outer: Array
) -> None:
    """Solves the band's lower half: ``inner`` = L⁻¹·pushes, ``outer`` = pushes on the border less arms·inner.

    Args:
        places: see :class:`Numbering`.
        pushes: [N], shape [n, 3].
        band: see :class:`Factor`.
        arms: see :class:`Factor`.
        reaches: see :class:`Factor`.
        inner: filled, shape [band_count].
        outer: filled, shape [border_count].
    """
    for i in range(len(places)):
        for way in range(3):
            if places[i] >= 0:
                inner[3 * places[i] + way] = pushes[i, way]
            else:
                outer[3 * (-1 - places[i]) + way] = pushes[i, way]
    width = band.shape[1] - 1
    for k in range(len(inner)):
        value, start = inner[k], k - width
        for j in range(max(0, start), k):
            value -= band[k, j - start] * inner[j]
        inner[k] = value / band[k, width]
    for b in range(len(outer)):
        for k in range(reaches[b, 0], reaches[b, 1]):
            outer[b] -= arms[b, k] * inner[k]


@compiled
def expand(
    places: Indices, outer: Array, band: Array, arms: Array, reaches: Indices, inner: Array, steps: Array
) -> None:
    """Writes the steps of all nodes [m], shape [n, 3], from those of the border; ``inner`` is used up."""
    for b in range(len(outer)):
        if outer[b] != 0.0:
            for k in range(reaches[b, 0], reaches[b, 1]):
                inner[k] -= arms[b, k] * outer[b]
    width = band.shape[1] - 1
    for k in range(len(inner) - 1, -1, -1):
        inner[k] /= band[k, width]
        value, start = inner[k], k - width
        for j in range(max(0, start), k):
            inner[j] -= band[k, j - start] * value
    for i in range(len(places)):
        for way in range(3):
            steps[i, way] = (
                inner[3 * places[i] + way] if places[i] >= 0 else outer[3 * (-1 - places[i]) + way]
            )
