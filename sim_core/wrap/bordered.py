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
from sim_core.wrap.membrane import Flags, Indices, assemble_along, compiled

LEAST_PIVOT = 1.0e-6
"""Smallest pivot that counts as stiffness, as a share of the diagonal before elimination."""
LEAF = 20
"""Nodes that aren't taken apart any more."""
LEAST_SHARE = 0.25
"""Share of the nodes that a line leaves on either side, at least."""
TILE = 520
"""Columns of a front that are updated at once; not a power of two, whose rows would share the places of a cache."""


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
        _forward(*self._parts, flat)
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
        _backward(*self._parts, flat)
        np.take(flat.reshape(-1, 3), ranks, axis=0, out=steps)
        apart = self.is_blocked & (self.numbering.places >= 0)
        steps[apart, 2] /= self.alone[apart]

    @property
    def _parts(self) -> tuple[Indices, Indices, Indices, Indices, int, Flags, Array, Indices]:
        order = self.numbering
        fronts = order.ranks, order.members, order.starts, order.own_counts, order.band_count // 3
        return *fronts, self.is_blocked, self.panels, self.panel_starts

    @property
    def band(self) -> "Factor":
        """The factor, for callers that hand over its parts."""
        return self

    @property
    def arms(self) -> None:
        """Nothing, see ``band``."""

    @property
    def reaches(self) -> None:
        """Nothing, see ``band``."""


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
    _eliminate(
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


@compiled
def _eliminate(
    row_start: Indices,
    columns: Indices,
    blocks: Array,
    is_blocked: Flags,
    ranks: Indices,
    members: Indices,
    starts: Indices,
    own_counts: Indices,
    child_counts: Indices,
    is_root: Flags,
    stack: Array,
    panels: Array,
    panel_starts: Indices,
    core: Array,
) -> None:
    """Cholesky factor front by front; the rest of each waits on the stack for the front that it goes into."""
    n = len(ranks)
    inner_count = n - len(core) // 3
    places, spread = np.empty(n, np.int64), np.empty(3 * n, np.int64)
    opened, used, free = np.empty(len(own_counts), np.int64), 0, 0
    bases = np.empty(len(own_counts), np.int64)
    scales, tile = np.empty(3 * n), np.empty((8, TILE))
    for front in range(len(own_counts)):
        first, own, end = starts[front], starts[front] + own_counts[front], starts[front + 1]
        width = height = 0
        for at in range(first, end):
            node = members[at]
            places[node] = width
            width += 2 if is_blocked[node] and ranks[node] < inner_count else 3
            if at == own - 1:
                height = width
        square = stack[free : free + width * width].reshape(width, width)
        square[:] = 0.0
        for at in range(first, own):
            i = members[at]
            rows = 2 if is_blocked[i] else 3
            for other in range(row_start[i], row_start[i + 1]):
                j = columns[other]
                if ranks[j] >= ranks[i]:
                    block, row, column = blocks[other], places[i], places[j]
                    for a in range(rows):
                        for b in range(2 if is_blocked[j] and ranks[j] < inner_count else 3):
                            square[row + a, column + b] = block[a, b]
        for k in range(height):
            scales[k] = square[k, k]
        for child in range(child_counts[front]):
            done = opened[used - child_counts[front] + child]
            _add_rest(
                stack[bases[done] :], members[starts[done] + own_counts[done] : starts[done + 1]], places,
                is_blocked, ranks, inner_count, spread, square,
            )  # fmt: skip
        _reduce(square, height, scales, tile)
        panel = panels[panel_starts[front] :]
        for k in range(height):
            for j in range(k, width):
                panel[k * width + j] = square[k, j]
        panel_starts[front + 1] = panel_starts[front] + height * width
        base = bases[opened[used - child_counts[front]]] if child_counts[front] > 0 else free
        used -= child_counts[front]
        rest = width - height
        for row in range(rest):
            for column in range(row, rest):
                stack[base + row * rest + column] = square[height + row, height + column]
        free = base
        if is_root[front]:
            for at in range(own, end):
                places[members[at]] = 3 * (ranks[members[at]] - inner_count)
            _add_rest(stack[base:], members[own:end], places, is_blocked, ranks, inner_count, spread, core)
        else:
            opened[used], bases[front] = front, base
            used += 1
            free += rest * rest
    for i in range(n):
        if ranks[i] < inner_count:
            continue
        row = 3 * (ranks[i] - inner_count)
        for at in range(row_start[i], row_start[i + 1]):
            if ranks[columns[at]] >= ranks[i]:
                core[row : row + 3, 3 * (ranks[columns[at]] - inner_count) :][:, :3] += blocks[at]
    for a in range(len(core)):
        for b in range(a):
            core[a, b] = core[b, a]


@compiled
def _add_rest(
    rest: Array,
    nodes: Indices,
    places: Indices,
    is_blocked: Flags,
    ranks: Indices,
    inner_count: int,
    spread: Indices,
    square: Array,
) -> None:
    """Adds what is left of a front to the upper triangle of the one that it goes into."""
    size = 0
    for node in nodes:
        for way in range(2 if is_blocked[node] and ranks[node] < inner_count else 3):
            spread[size] = places[node] + way
            size += 1
    for row in range(size):
        into = square[spread[row]]
        for column in range(row, size):
            into[spread[column]] += rest[row * size + column]


@compiled
def _reduce(square: Array, height: int, scales: Array, tile: Array) -> None:
    """Eliminates the first unknowns of a front, in place in its upper triangle, eight at a time at most."""
    width = len(square)
    rounds = (height + 7) // 8
    for part in range(rounds):
        start, end = height * part // rounds, height * (part + 1) // rounds
        for k in range(start, end):
            pivot = square[k, k]
            # Film that gives way, or would by round-off, is held as stiff as its own element is.
            square[k, k] = np.sqrt(pivot if pivot > LEAST_PIVOT * scales[k] else scales[k])
            over = 1.0 / square[k, k]
            row = square[k]
            for j in range(k + 1, width):
                row[j] *= over
            for i in range(k + 1, end):
                factor, below = row[i], square[i]
                for j in range(i, width):
                    below[j] -= factor * row[j]
        _update(square, start, end, tile)


@compiled
def _update(square: Array, start: int, end: int, tile: Array) -> None:
    """Takes the products of up to eight finished rows off all rows after them, in tiles of columns."""
    width, rows = len(square), end - start
    lever = np.zeros(8)
    for left in range(end, width, TILE):
        right = min(left + TILE, width)
        for k in range(8):
            for j in range(right - left):
                tile[k, j] = square[start + k, left + j] if k < rows else 0.0
        for i in range(end, right):
            for k in range(rows):
                lever[k] = square[start + k, i]
            a, b, c, d = lever[0], lever[1], lever[2], lever[3]
            e, f, g, h = lever[4], lever[5], lever[6], lever[7]
            first = max(i, left)
            row, at = square[i, first:right], first - left
            p, q, r, s = tile[0, at:], tile[1, at:], tile[2, at:], tile[3, at:]
            t, u, v, w = tile[4, at:], tile[5, at:], tile[6, at:], tile[7, at:]
            for j in range(len(row)):
                row[j] -= (
                    (a * p[j] + b * q[j])
                    + (c * r[j] + d * s[j])
                    + ((e * t[j] + f * u[j]) + (g * v[j] + h * w[j]))
                )


def condense(
    places: Indices, pushes: Array, band: Factor, arms: None, reaches: None, inner: Array, outer: Array
) -> None:
    """As :meth:`Factor.condense`, for callers that hand over the parts of a factor and the arrays to fill."""
    inner[:], outer[:] = band.condense(pushes)


def expand(
    places: Indices, outer: Array, band: Factor, arms: None, reaches: None, inner: Array, steps: Array
) -> None:
    """As :meth:`Factor.expand`, for callers that hand over the parts of a factor."""
    band.expand(outer, inner, steps)


@compiled
def _unknowns(nodes: Indices, ranks: Indices, inner_count: int, is_blocked: Flags, spread: Indices) -> int:
    """Writes where the nodes' unknowns stand, three places a node by rank, and gives how many there are."""
    size = 0
    for node in nodes:
        rank = ranks[node]
        for way in range(2 if is_blocked[node] and rank < inner_count else 3):
            spread[size] = 3 * rank + way
            size += 1
    return size


@compiled
def _forward(
    ranks: Indices,
    members: Indices,
    starts: Indices,
    own_counts: Indices,
    inner_count: int,
    is_blocked: Flags,
    panels: Array,
    panel_starts: Indices,
    values: Array,
) -> None:
    """R⁻ᵀ·values in place, front by front."""
    spread, local = np.empty(len(values), np.int64), np.empty(len(values))
    for front in range(len(own_counts)):
        width = _unknowns(members[starts[front] : starts[front + 1]], ranks, inner_count, is_blocked, spread)
        panel = panels[panel_starts[front] : panel_starts[front + 1]]
        height = len(panel) // width
        for at in range(width):
            local[at] = values[spread[at]] if at < height else 0.0
        for k in range(height):
            row = panel[k * width : (k + 1) * width]
            value = local[k] / row[k]
            local[k] = value
            for j in range(k + 1, width):
                local[j] -= value * row[j]
        for at in range(width):
            if at < height:
                values[spread[at]] = local[at]
            else:
                values[spread[at]] += local[at]


@compiled
def _backward(
    ranks: Indices,
    members: Indices,
    starts: Indices,
    own_counts: Indices,
    inner_count: int,
    is_blocked: Flags,
    panels: Array,
    panel_starts: Indices,
    values: Array,
) -> None:
    """R⁻¹·values in place, front by front from the last, given those of the border."""
    spread, local = np.empty(len(values), np.int64), np.empty(len(values))
    for front in range(len(own_counts) - 1, -1, -1):
        width = _unknowns(members[starts[front] : starts[front + 1]], ranks, inner_count, is_blocked, spread)
        panel = panels[panel_starts[front] : panel_starts[front + 1]]
        height = len(panel) // width
        for at in range(width):
            local[at] = values[spread[at]]
        for k in range(height - 1, -1, -1):
            row = panel[k * width : (k + 1) * width]
            local[k] = (local[k] - _product(row, local, k + 1, width)) / row[k]
        for at in range(height):
            values[spread[at]] = local[at]


@compiled
def _product(row: Array, values: Array, start: int, end: int) -> float:
    """Sum of products, in eight sums beside each other that a processor takes at once."""
    a = b = c = d = e = f = g = h = 0.0
    whole = start + (end - start) // 8 * 8
    for at in range(start, whole, 8):
        a += row[at] * values[at]
        b += row[at + 1] * values[at + 1]
        c += row[at + 2] * values[at + 2]
        d += row[at + 3] * values[at + 3]
        e += row[at + 4] * values[at + 4]
        f += row[at + 5] * values[at + 5]
        g += row[at + 6] * values[at + 6]
        h += row[at + 7] * values[at + 7]
    total = ((a + b) + (c + d)) + ((e + f) + (g + h))
    for at in range(whole, end):
        total += row[at] * values[at]
    return total
