"""Dense fronts of a sparse Cholesky factor: what they are made of, how they are eliminated, and solving with them.

The kernels call none of another file: numba's disk cache would not see that one change.
"""

import numpy as np

from sim_core.frames import Array
from sim_core.wrap.membrane import Flags, Indices, compiled

LEAST_PIVOT = 1.0e-6
"""Smallest pivot that counts as stiffness, as a share of the diagonal before elimination."""
TILE = 520
"""Columns of a front that are updated at once; not a power of two, whose rows would share the places of a cache."""


@compiled
def eliminate(
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
    """Cholesky factor front by front; the rest of each waits on the stack for the front that it goes into.

    Args:
        row_start: where each node's row of blocks starts, shape [n + 1].
        columns: the node of each block, shape [block_count].
        blocks: the stiffness [N/m], where the row's node has the lower rank or the same, shape [block_count, 3, 3].
        is_blocked: nodes whose third way is coupled to nothing: off the border it is left out, shape [n].
        ranks: see :class:`~sim_core.wrap.bordered.Numbering`, as ``members`` to ``is_root`` are.
        stack: room for the open fronts.
        panels: filled with the factor's rows, front after front.
        panel_starts: filled, shape [front_count + 1], zeros before.
        core: filled, shape [border_count, border_count], zeros before.
    """
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
        _lay_front(
            row_start, columns, blocks, is_blocked, ranks, inner_count, members[first:own], places, square
        )
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
    _finish_core(row_start, columns, blocks, ranks, inner_count, core)


@compiled
def _lay_front(
    row_start: Indices,
    columns: Indices,
    blocks: Array,
    is_blocked: Flags,
    ranks: Indices,
    inner_count: int,
    own: Indices,
    places: Indices,
    square: Array,
) -> None:
    """Writes the stiffness of a front's own nodes into its upper triangle, zeros elsewhere."""
    square[:] = 0.0
    for i in own:
        for at in range(row_start[i], row_start[i + 1]):
            j = columns[at]
            if ranks[j] >= ranks[i]:
                block, row, column = blocks[at], places[i], places[j]
                for a in range(2 if is_blocked[i] else 3):
                    for b in range(2 if is_blocked[j] and ranks[j] < inner_count else 3):
                        square[row + a, column + b] = block[a, b]


@compiled
def _finish_core(
    row_start: Indices, columns: Indices, blocks: Array, ranks: Indices, inner_count: int, core: Array
) -> None:
    """Adds the border's own stiffness to what the fronts left of it, and fills the lower triangle."""
    for i in range(len(ranks)):
        if ranks[i] < inner_count:
            continue
        row = 3 * (ranks[i] - inner_count)
        for at in range(row_start[i], row_start[i + 1]):
            column = 3 * (ranks[columns[at]] - inner_count)
            if column >= row:
                core[row : row + 3, column : column + 3] += blocks[at]
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
def forward(
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
def backward(
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
