"""What holds film on the vertical edges of boxes: it sticks, slips along an edge, or runs past it.

A film that lies flat on a face is not pressed onto it, so it is the edges that carry the load of a convex wrap. A node
on an edge of a box goes with the box. The film's pull T_before and T_after on its two sides holds still while

    e^(−μφ) ≤ T_after / T_before ≤ e^(μφ)                       (Euler and Eytelwein, φ the angle it is bent by)

which is |T_after − T_before| ≤ tanh(μφ/2)·(T_after + T_before): a form whose right side hardly changes as film runs,
so that it can be taken from the last iteration whatever μ is. Beyond it film runs past the edge: the node's unstretched
place changes, not its place. Along the edge it slips beyond μ times the press.

The kernels call none of another file: numba's disk cache would not see that one change.
"""

import numpy as np

from sim_core.frames import Array
from sim_core.wrap.contact import EDGE, FACE
from sim_core.wrap.membrane import Indices, compiled

STUCK, OPEN, ABSENT = 0, 2, 3
"""A way to move that friction holds, that nothing holds, or that isn't there; ±1 slips."""
MOST_ROUNDS = 12


@compiled
def set_directions(
    positions: Array,
    kinds: Indices,
    normals: Array,
    axes: Array,
    columns: int,
    even_ways: Array,
    odd_ways: Array,
) -> None:
    """Writes the ways in which each node can move, as its even and its odd cells see them.

    A node off the edges moves across, up and outwards, the last being blocked on a face. One on an edge has film that
    runs past it, seen by the cell before the edge along that one's side and by the cell after along the other side, and
    slip along the edge.

    Args:
        positions: nodes [m], shape [n, 3].
        kinds: shape [n].
        normals: of the faces that nodes are on, or of those they were on last, shape [n, 3].
        axes: upward directions of the edges that nodes are on, shape [n, 3].
        columns: nodes of one row.
        even_ways: unit vectors or zeros, shape [n, 3, 3], a way a row.
        odd_ways: the same for odd cells.
    """
    even_ways[:] = 0.0
    odd_ways[:] = 0.0
    before, after = np.empty(3), np.empty(3)
    for i in range(len(positions)):
        if kinds[i] <= FACE:
            # Across and up on a side face, forward and left on a top.
            n = normals[i]
            is_side = n[0] * n[0] + n[1] * n[1] > 0.5
            x, y, z = (-n[1], n[0], 0.0) if is_side else (n[2], 0.0, -n[0])
            size = np.sqrt(x * x + y * y + z * z)
            x, y, z = x / size, y / size, z / size
            even_ways[i, 0, 0], even_ways[i, 0, 1], even_ways[i, 0, 2] = x, y, z
            even_ways[i, 1, 0] = n[1] * z - n[2] * y
            even_ways[i, 1, 1] = n[2] * x - n[0] * z
            even_ways[i, 1, 2] = n[0] * y - n[1] * x
            even_ways[i, 2] = n
            odd_ways[i] = even_ways[i]
        elif kinds[i] == EDGE:
            column = i % columns
            start = i - column
            previous, following = start + (column - 1) % columns, start + (column + 1) % columns
            along_before = along_after = 0.0
            for k in range(3):
                before[k] = positions[i, k] - positions[previous, k]
                after[k] = positions[following, k] - positions[i, k]
                along_before += before[k] * axes[i, k]
                along_after += after[k] * axes[i, k]
            first = second = 0.0
            for k in range(3):
                before[k] -= along_before * axes[i, k]
                after[k] -= along_after * axes[i, k]
                first += before[k] * before[k]
                second += after[k] * after[k]
            first, second = np.sqrt(first), np.sqrt(second)
            for k in range(3):
                before[k] /= first
                after[k] /= second
                even_ways[i, 0, k] = after[k] if column % 2 == 0 else before[k]
                odd_ways[i, 0, k] = before[k] if column % 2 == 0 else after[k]
                even_ways[i, 1, k] = odd_ways[i, 1, k] = axes[i, k]


@compiled
def push_of(
    kinds: Indices,
    even_ways: Array,
    odd_ways: Array,
    even_forces: Array,
    odd_forces: Array,
    frictions: Array,
    columns: int,
    positions: Array,
    anchors: Array,
    drag: float,
    pushes: Array,
    limits: Array,
) -> None:
    """Writes the force along each way, and what friction can hold of it [N], shape [n, 3].

    Around an edge the force is T_after − T_before and the limit tanh(μφ/2)·(T_after + T_before); along it the limit is
    μ times the press. Other ways have none. Nodes off the edges are drawn to their anchors by ``drag`` [N/m].
    """
    limits[:] = 0.0
    for i in range(len(kinds)):
        even, odd = even_forces[i], odd_forces[i]
        for way in range(3):
            u, v = even_ways[i, way], odd_ways[i, way]
            pushes[i, way] = (
                u[0] * even[0]
                + u[1] * even[1]
                + u[2] * even[2]
                + v[0] * odd[0]
                + v[1] * odd[1]
                + v[2] * odd[2]
            )
        if kinds[i] <= FACE:
            for way in range(3):
                for k in range(3):
                    pushes[i, way] -= drag * (positions[i, k] - anchors[i, k]) * even_ways[i, way, k]
        if kinds[i] == FACE:
            pushes[i, 2] = 0.0
        if kinds[i] != EDGE:
            continue
        u, v = even_ways[i, 0], odd_ways[i, 0]
        apart = (
            u[0] * even[0] + u[1] * even[1] + u[2] * even[2] - v[0] * odd[0] - v[1] * odd[1] - v[2] * odd[2]
        )
        pulls = apart if i % columns % 2 == 0 else -apart
        bend = np.arccos(min(1.0, max(-1.0, u[0] * v[0] + u[1] * v[1] + u[2] * v[2])))
        limits[i, 0] = np.tanh(0.5 * frictions[i] * bend) * max(pulls, 0.0)
        square = 0.0
        for k in range(3):
            square += (even[k] + odd[k] - pushes[i, 1] * even_ways[i, 1, k]) ** 2
        limits[i, 1] = frictions[i] * np.sqrt(square)


@compiled
def largest_excess(kinds: Indices, pushes: Array, limits: Array, slips: Indices) -> float:
    """Largest force that neither a box nor friction carries [N].

    Args:
        kinds: shape [n].
        pushes: see :func:`push_of`.
        limits: see :func:`push_of`.
        slips: STUCK or the direction of slip around and along an edge, shape [n, 3].
    """
    largest = 0.0
    for i in range(len(kinds)):
        for way in range(3):
            force = pushes[i, way]
            if kinds[i] == EDGE:
                held = slips[i, way]
                excess = (
                    max(abs(force) - limits[i, way], 0.0) if held == STUCK else force - held * limits[i, way]
                )
                largest = max(largest, abs(excess))
            else:
                largest = max(largest, abs(force))
    return largest


@compiled
def slope_along(kinds: Indices, pushes: Array, limits: Array, slips: Indices, steps: Array) -> float:
    """Work that the unbalanced forces do on a step [J]: what a line search brings to nothing."""
    slope = 0.0
    for i in range(len(kinds)):
        for way in range(3):
            if kinds[i] != EDGE:
                slope += pushes[i, way] * steps[i, way]
            elif slips[i, way] != STUCK:
                slope += (pushes[i, way] - slips[i, way] * limits[i, way]) * steps[i, way]
    return slope


@compiled
def slip_step(
    stiffness: Array,
    pushes: Array,
    limits: Array,
    moved: Array,
    states: Indices,
    steps: Array,
    tolerance: float,
) -> int:
    """Which of the edges' ways slip, and how far, by an active set on their condensed stiffness.

    A way slips with the force that is left being its limit, or stands where it stood when the call began.

    Args:
        stiffness: of the ways on edges and on the cut, all else condensed out [N/m], shape [k, k].
        pushes: forces along them, condensed too [N], shape [k].
        limits: what friction holds [N], shape [k].
        moved: how far each has slipped since the call began [m], shape [k].
        states: STUCK, ±1, OPEN or ABSENT, shape [k]; changed in place.
        steps: filled with the moves [m], shape [k].
        tolerance: forces beyond a limit by less don't slip [N].

    Returns:
        Rounds taken.
    """
    count = len(pushes)
    chosen, right = np.empty(count, np.int64), np.empty(count)
    matrix = np.empty((count, count))
    for attempt in range(MOST_ROUNDS):
        size = 0
        for d in range(count):
            steps[d] = 0.0
            if states[d] == STUCK:
                steps[d] = -moved[d]
            elif states[d] != ABSENT:
                chosen[size] = d
                size += 1
        for a in range(size):
            d = chosen[a]
            right[a] = pushes[d]
            if states[d] != OPEN:
                right[a] -= states[d] * limits[d]
            for e in range(count):
                if steps[e] != 0.0:
                    right[a] -= stiffness[d, e] * steps[e]
            for b in range(a + 1):
                matrix[a, b] = stiffness[d, chosen[b]]
        _solve_dense(matrix, right, size)
        for a in range(size):
            steps[chosen[a]] = right[a]
        changed = False
        for d in range(count):
            if states[d] == STUCK:
                left = pushes[d]
                for e in range(count):
                    if steps[e] != 0.0:
                        left -= stiffness[d, e] * steps[e]
                if abs(left) > limits[d] + tolerance:
                    states[d] = 1 if left > 0.0 else -1
                    changed = True
            elif abs(states[d]) == 1 and states[d] * (moved[d] + steps[d]) < -1.0e-13:
                states[d] = STUCK
                changed = True
        if not changed:
            return attempt + 1
    return MOST_ROUNDS


@compiled
def _solve_dense(matrix: Array, right: Array, size: int) -> None:
    """Cholesky in the lower triangle of the leading ``size`` rows, and the solution in ``right``, in place."""
    scale = 0.0
    for a in range(size):
        scale = max(scale, matrix[a, a])
    for a in range(size):
        for b in range(a + 1):
            value = matrix[a, b]
            for c in range(b):
                value -= matrix[a, c] * matrix[b, c]
            if a > b:
                matrix[a, b] = value / matrix[b, b]
            else:
                # Film that could run around the whole ring has no stiffness there: it isn't moved.
                matrix[a, a] = np.sqrt(value) if value > 1.0e-9 * scale else 1.0e3 * np.sqrt(scale)
        value = right[a]
        for c in range(a):
            value -= matrix[a, c] * right[c]
        right[a] = value / matrix[a, a]
    for a in range(size - 1, -1, -1):
        right[a] /= matrix[a, a]
        for c in range(a):
            right[c] -= matrix[a, c] * right[a]


@compiled
def move_nodes(
    steps: Array,
    kinds: Indices,
    ways: Array,
    columns: int,
    edge_before: Indices,
    edge_after: Indices,
    shares: Array,
    stretch: float,
    positions: Array,
    along: Array,
    shifts: Array,
) -> None:
    """Moves nodes by a step along their ways; film that runs past edges moves the unstretched places of whole sides.

    Film that runs past an edge by q on one end of a side and r on its other end is shared out linearly between them:
    the side stays evenly meshed, and its nodes stay where they are on the box.

    Args:
        steps: along the ways [m], shape [n, 3].
        kinds: shape [n].
        ways: as even cells see them, shape [n, 3, 3].
        columns: nodes of one row.
        edge_before: the edge node before each node in its row, or -1, shape [n]; an edge node's own.
        edge_after: the one after it, shape [n].
        shares: how far each node is from the one to the other, shape [n].
        stretch: stretched over unstretched length.
        positions: moved in place [m], shape [n, 3].
        along: heights of edge nodes on their boxes, moved in place [m], shape [n].
        shifts: filled with the changes of unstretched X [m], shape [n].
    """
    for i in range(len(kinds)):
        shifts[i] = 0.0
        if kinds[i] == EDGE:
            shifts[i] = -steps[i, 0] / stretch
            along[i] += steps[i, 1]
    sides = np.zeros((len(kinds), 3))
    for i in range(len(kinds)):
        first, second = edge_before[i], edge_after[i]
        if kinds[i] > FACE or first < 0 or (shifts[first] == 0.0 and shifts[second] == 0.0):
            continue
        column = i % columns
        start = i - column
        previous, following = start + (column - 1) % columns, start + (column + 1) % columns
        size = 0.0
        for k in range(3):
            sides[i, k] = positions[following, k] - positions[previous, k]
            size += sides[i, k] ** 2
        shift = shifts[first] + shares[i] * (shifts[second] - shifts[first])
        if first != i:
            shifts[i] = shift
        for k in range(3):
            sides[i, k] *= shifts[i] * stretch / np.sqrt(size)
    for i in range(len(kinds)):
        if kinds[i] <= FACE:
            for k in range(3):
                positions[i, k] += sides[i, k]
                for way in range(3 - kinds[i]):
                    positions[i, k] += steps[i, way] * ways[i, way, k]


@compiled
def shift_reference(triangles: Indices, shifts: Array, reference: Array, inverse: Array, area: Array) -> None:
    """Shifts the unstretched X of nodes [m], shape [n], in all their triangles, in place."""
    for t in range(len(triangles)):
        changed = False
        for corner in range(3):
            shift = shifts[triangles[t, corner]]
            if shift != 0.0:
                reference[t, corner, 0] += shift
                changed = True
        if not changed:
            continue
        a = reference[t, 1, 0] - reference[t, 0, 0]
        b = reference[t, 2, 0] - reference[t, 0, 0]
        c = reference[t, 1, 1] - reference[t, 0, 1]
        d = reference[t, 2, 1] - reference[t, 0, 1]
        determinant = a * d - b * c
        inverse[t, 0, 0], inverse[t, 0, 1] = d / determinant, -b / determinant
        inverse[t, 1, 0], inverse[t, 1, 1] = -c / determinant, a / determinant
        area[t] = 0.5 * determinant
