"""Direct solution of a film's tangent stiffness: the sides of the load by nested dissection, bordered by its edges.

The nodes on edges, and those of one column where the ring is cut, come last, as a border. What the others leave of
its stiffness is a small dense matrix, the core:

    K = [B Aᵀ; A C] = [Rᵀ·R Aᵀ; A C],   core C − A·B⁻¹·Aᵀ

So the ways in which film slips on edges can be held or let go at will without a new factorisation. A factor that is
a little out of date still serves, as modified Newton does.

B is taken apart by lines of nodes, again and again (George, SIAM J. Numer. Anal. 10, 1973): each line is eliminated
after what it separates, in a small dense front that holds it and what it is still coupled to (Duff and Reid, ACM
Trans. Math. Softw. 9, 1983). Nodes on faces have two unknowns there, others three. All sums run in one order, so the
factor is the same whenever it is made.
"""

from dataclasses import dataclass

import numpy as np

from sim_core.frames import Array
from sim_core.wrap.film import Film
from sim_core.wrap.fronts import backward, eliminate, forward
from sim_core.wrap.membrane import Flags, Indices, assemble_along, compiled

LEAF = 12
"""Nodes that aren't taken apart any more."""
LEAST_SHARE = 0.25
"""Share of the nodes that a line leaves on either side, at least."""


@dataclass(frozen=True, eq=False, slots=True)
class Numbering:
    """In which order the nodes are eliminated, and in which fronts.

    A front's members are the nodes that it eliminates, by rank, then those that they are coupled to by then, by rank.

    Attributes:
        places: of a node among those off the border, or −1 − its place in the border, shape [n].
        ranks: places, the border's after the others, shape [n].
        band_count: unknowns off the border, three a node.
        border_count: unknowns of the border.
        members: of all fronts, one after the other.
        starts: where each front's members start, shape [front_count + 1].
        own_counts: nodes that each front eliminates, shape [front_count].
        child_counts: fronts whose rest goes into each front, the last ones that are still open, shape [front_count].
        is_root: fronts whose rest goes into the core, shape [front_count].
        sizes: entries of all fronts' eliminated rows and of all open fronts, at most.
    """

    places: Indices
    ranks: Indices
    band_count: int
    border_count: int
    members: Indices
    starts: Indices
    own_counts: Indices
    child_counts: Indices
    is_root: Flags
    sizes: tuple[int, int]


@dataclass(frozen=True, eq=False, slots=True)
class Factor:
    """A factorised tangent stiffness; its arrays are never changed.

    Attributes:
        numbering: of the nodes.
        panels: R's rows front after front, each as long as its front is wide.
        panel_starts: where each front's rows start, shape [front_count + 1].
        is_blocked: nodes whose third way is coupled to nothing, shape [n].
        alone: stiffness along the third way, shape [n].
        core: shape [border_count, border_count].
    """

    numbering: Numbering
    panels: Array
    panel_starts: Indices
    is_blocked: Flags
    alone: Array
    core: Array

    def condense(self, pushes: Array) -> tuple[Array, Array]:
        """Solves the lower half.

        Args:
            pushes: [N], shape [n, 3].

        Returns:
            R⁻ᵀ·pushes off the border, three a node by rank, shape [band_count], and the pushes on the border less
            A·B⁻¹·pushes, shape [border_count].
        """
        values = np.empty((len(pushes), 3))
        values[self.numbering.ranks] = pushes
        flat = values.ravel()
        forward(*self._parts, flat)
        return flat[: self.numbering.band_count], flat[self.numbering.band_count :]

    def expand(self, moves: Array, inner: Array, steps: Array) -> None:
        """Writes the steps of all nodes [m], shape [n, 3], from those of the border.

        Args:
            moves: of the border [m], shape [border_count].
            inner: as :meth:`condense` gave it.
            steps: filled, shape [n, 3].
        """
        ranks = self.numbering.ranks
        flat = np.concatenate((inner, moves))
        backward(*self._parts, flat)
        np.take(flat.reshape(-1, 3), ranks, axis=0, out=steps)
        apart = self.is_blocked & (self.numbering.places >= 0)
        steps[apart, 2] /= self.alone[apart]

    @property
    def _parts(self) -> tuple[Indices, Indices, Indices, Indices, int, Flags, Array, Indices]:
        order = self.numbering
        fronts = order.ranks, order.members, order.starts, order.own_counts, order.band_count // 3
        return *fronts, self.is_blocked, self.panels, self.panel_starts


def number_nodes(film: Film, on_border: Flags, columns: int) -> Numbering:
    """Numbers the nodes of rows of so many columns: those off the border by nested dissection, then the border.

    Args:
        film: the elements.
        on_border: nodes on the border, those of column 0 among them, shape [n].
        columns: nodes of one row.
    """
    grid = np.arange(len(on_border)).reshape(-1, columns)
    fronts: list[tuple[Indices, list[int]]] = []
    roots = set(_dissect(grid, on_border, fronts))
    outer = grid.T.ravel()[on_border[grid.T.ravel()]]
    order = np.concatenate([own for own, _ in fronts] + [outer])
    inner_count = len(order) - len(outer)
    ranks = np.empty(len(order), dtype=np.int64)
    ranks[order] = np.arange(len(order))
    members: list[Indices] = []
    for own, children in fronts:
        met = [film.columns[film.row_start[node] : film.row_start[node + 1]] for node in own]
        met += [members[child] for child in children]
        found = np.unique(ranks[np.concatenate(met)])
        members.append(order[found[found >= ranks[own[0]]]])
    widths = [3 * len(nodes) for nodes in members]
    heights = [3 * len(own) for own, _ in fronts]
    open_fronts: list[int] = []
    used = most = 0
    for index, (_, children) in enumerate(fronts):
        most = max(most, used + widths[index] ** 2)
        used -= sum(open_fronts.pop() for _ in children)
        if index not in roots:
            open_fronts.append((widths[index] - heights[index]) ** 2)
            used += open_fronts[-1]
    return Numbering(
        places=np.where(on_border, inner_count - 1 - ranks, ranks),
        ranks=ranks,
        band_count=3 * inner_count,
        border_count=3 * len(outer),
        members=np.concatenate([*members, np.empty(0, np.int64)]),
        starts=np.cumsum([0] + [len(nodes) for nodes in members]),
        own_counts=np.array([len(own) for own, _ in fronts], dtype=np.int64),
        child_counts=np.array([len(children) for _, children in fronts], dtype=np.int64),
        is_root=np.isin(np.arange(len(fronts)), list(roots)),
        sizes=(sum(h * w for h, w in zip(heights, widths, strict=True)), most),
    )


def _dissect(grid: Indices, on_border: Flags, fronts: list[tuple[Indices, list[int]]]) -> list[int]:
    """Appends the fronts of a grid's nodes, each after those it separates, and gives those that nothing separates."""
    inner = ~on_border[grid]
    count = int(inner.sum())
    if count == 0:
        return []
    best: tuple[int, float, int, int] | None = None
    for axis in range(2):
        on_lines = inner.sum(axis=1 - axis)
        before = np.cumsum(on_lines) - on_lines
        after = count - before - on_lines
        for line in np.flatnonzero(np.minimum(before, after) >= LEAST_SHARE * (count - on_lines)):
            found = int(on_lines[line]), float(abs(before[line] - after[line])), axis, int(line)
            best = found if best is None or found < best else best
    if count <= LEAF or best is None:
        fronts.append((grid[inner], []))
        return [len(fronts) - 1]
    _, _, across, at = best
    lines = np.moveaxis(grid, across, 0)
    children = []
    for part in (lines[:at], lines[at + 1 :]):
        children += _dissect(np.moveaxis(part, 0, across), on_border, fronts)
    own = lines[at][~on_border[lines[at]]]
    if not len(own):
        return children
    fronts.append((own, children))
    return [len(fronts) - 1]


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
    blocks = np.empty((len(film.columns), 3, 3))
    assemble_along(
        positions, *film.elements, film.slots, even_count, even_ways, odd_ways, numbering.ranks, blocks
    )
    alone = np.empty(len(positions))
    _finish(film.row_start, film.columns, even_ways, is_blocked, damping, blocks, alone)
    core = np.zeros((numbering.border_count, numbering.border_count))
    panels, stack = np.empty(numbering.sizes[0]), np.empty(numbering.sizes[1])
    panel_starts = np.zeros(len(numbering.starts), dtype=np.int64)
    eliminate(
        film.row_start, film.columns, blocks, is_blocked, numbering.ranks, numbering.members, numbering.starts,
        numbering.own_counts, numbering.child_counts, numbering.is_root, stack, panels, panel_starts, core,
    )  # fmt: skip
    return Factor(numbering, panels, panel_starts, is_blocked.copy(), alone, core)


@compiled
def _finish(
    row_start: Indices,
    columns: Indices,
    ways: Array,
    is_blocked: Flags,
    damping: float,
    blocks: Array,
    alone: Array,
) -> None:
    """Damps the nodes' own blocks, puts a one where there is no way, and cuts off the third ways of blocked nodes."""
    for i in range(len(is_blocked)):
        for at in range(row_start[i], row_start[i + 1]):
            j, block = columns[at], blocks[at]
            if i == j:
                for a in range(3):
                    x, y, z = ways[i, a, 0], ways[i, a, 1], ways[i, a, 2]
                    block[a, a] += damping if x * x + y * y + z * z > 0.5 else 1.0
                alone[i] = block[2, 2]
            for a in range(3):
                if is_blocked[i]:
                    block[2, a] = 0.0
                if is_blocked[j]:
                    block[a, 2] = 0.0
            if i == j:
                block[2, 2] = alone[i]
