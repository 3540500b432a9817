"""Film against boxes: nodes on vertical edges that stick, slip along them or let film run past, and nodes on faces.

A film that lies flat on a face is not pressed onto it, so it is the edges that carry the load of a convex wrap. A node
on an edge of a box goes with the box. The film's pull T_before and T_after on its two sides holds still while

    e^(−μφ) ≤ T_after / T_before ≤ e^(μφ)                       (Euler and Eytelwein, φ the angle it is bent by)

which is |T_after − T_before| ≤ tanh(μφ/2)·(T_after + T_before): a form whose right side hardly changes as film runs,
so that it can be taken from the last iteration whatever μ is. Beyond it film runs past the edge: the node's unstretched
place changes, not its place. Along the edge it slips beyond μ times the press. Faces only keep nodes out.

The kernels call none of another file: numba's disk cache would not see that one change.
"""

import numpy as np

from sim_core.frames import Array
from sim_core.wrap.membrane import Flags, Indices, compiled

FREE, FACE, EDGE, IDLE = 0, 1, 2, 3
"""What a node does: moves, slides on a face, goes with an edge, or has no film at it."""
STUCK, OPEN, ABSENT = 0, 2, 3
"""A way to move that friction holds, that nothing holds, or that isn't there; ±1 slips."""
FACING = 0.5
"""Cosine of the angle up to which a face looks the film's way."""
STAYS = 0.9
"""Cosine of the angle between a face that a node is on and the one it was put on."""
TOUCH_M = 1.0e-6
"""A node that is farther off a face than this has left it."""
MOST_ROUNDS = 12


@compiled
def find_faces(
    positions: Array,
    outwards: Array,
    kinds: Indices,
    holders: Indices,
    normals: Array,
    centres: Array,
    turns: Array,
    half_sizes: Array,
    is_solid: Flags,
    bodies: Indices,
    met_normals: Array,
    depths: Array,
) -> None:
    """The face that each free node is behind: of the boxes that it is in, of the one that it is deepest in.

    Tops, bottoms and side faces that look away from the load count, the one nearest to the node or that it is on.

    Args:
        positions: nodes [m], shape [n, 3].
        outwards: horizontal directions away from the load, shape [n, 3].
        kinds: FREE and FACE nodes are looked at, shape [n].
        holders: the body that a node on a face is on, shape [n].
        normals: of the faces that nodes are on, shape [n, 3].
        centres: of the bodies [m], shape [b, 3].
        turns: rotation matrices of the bodies, shape [b, 3, 3].
        half_sizes: of the bodies [m], shape [b, 3].
        is_solid: bodies that film can lie on, shape [b].
        bodies: filled with the body met, or -1, shape [n].
        met_normals: filled with outward normals, shape [n, 3].
        depths: filled with how deep the node is behind the face [m], shape [n].
    """
    local, reaches = np.empty(3), np.empty(len(centres))
    for body in range(len(centres)):
        turn, half = turns[body], half_sizes[body]
        reaches[body] = abs(turn[2, 0]) * half[0] + abs(turn[2, 1]) * half[1] + abs(turn[2, 2]) * half[2]
        if not is_solid[body]:
            reaches[body] = -1.0
    for i in range(len(positions)):
        bodies[i] = -1
        depths[i] = -TOUCH_M
        if kinds[i] > FACE:
            continue
        x, y, z = positions[i, 0], positions[i, 1], positions[i, 2]
        for body in range(len(centres)):
            dz = z - centres[body, 2]
            if abs(dz) > reaches[body]:
                continue
            turn, half = turns[body], half_sizes[body]
            dx, dy = x - centres[body, 0], y - centres[body, 1]
            local[2] = turn[0, 2] * dx + turn[1, 2] * dy + turn[2, 2] * dz
            if abs(local[2]) > half[2] + TOUCH_M:
                continue
            local[0] = turn[0, 0] * dx + turn[1, 0] * dy + turn[2, 0] * dz
            local[1] = turn[0, 1] * dx + turn[1, 1] * dy + turn[2, 1] * dz
            if abs(local[0]) > half[0] + TOUCH_M or abs(local[1]) > half[1] + TOUCH_M:
                continue
            nearest, found, side = np.inf, -1, 0.0
            for axis in range(3):
                facing = 1.0 if local[2] > 0.0 else -1.0
                if axis < 2:
                    facing = turn[0, axis] * outwards[i, 0] + turn[1, axis] * outwards[i, 1]
                    if abs(facing) < FACING:
                        continue
                sign = 1.0 if facing > 0.0 else -1.0
                depth = half[axis] - sign * local[axis]
                if kinds[i] == FACE and holders[i] == body:
                    along = 0.0
                    for k in range(3):
                        along += normals[i, k] * turn[k, axis] * sign
                    if along > STAYS:
                        nearest, found, side = depth, axis, sign
                        break
                if depth < nearest:
                    nearest, found, side = depth, axis, sign
            if found >= 0 and nearest > depths[i]:
                depths[i] = nearest
                bodies[i] = body
                for k in range(3):
                    met_normals[i, k] = side * turn[k, found]


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
def ride(
    kinds: Indices,
    holders: Indices,
    signs: Array,
    centres: Array,
    turns: Array,
    half_sizes: Array,
    along: Array,
    positions: Array,
    normals: Array,
    axes: Array,
) -> None:
    """Takes the nodes on edges along with their boxes, and puts those on faces back onto them.

    Args:
        kinds: shape [n].
        holders: the body that a node on an edge or a face is on, shape [n].
        signs: of the edges, x and y in the body's frame, shape [n, 2].
        centres: of the bodies [m], shape [b, 3].
        turns: rotation matrices of the bodies, shape [b, 3, 3].
        half_sizes: of the bodies [m], shape [b, 3].
        along: heights of edge nodes above their bodies' centres, along the edge [m], shape [n].
        positions: moved in place [m], shape [n, 3].
        normals: of the faces, turned along in place, shape [n, 3].
        axes: of the edges, filled, shape [n, 3].
    """
    for i in range(len(kinds)):
        if kinds[i] != EDGE and kinds[i] != FACE:
            continue
        turn, centre, half = turns[holders[i]], centres[holders[i]], half_sizes[holders[i]]
        if kinds[i] == EDGE:
            x, y = signs[i, 0] * half[0], signs[i, 1] * half[1]
            for k in range(3):
                axes[i, k] = turn[k, 2]
                positions[i, k] = centre[k] + turn[k, 0] * x + turn[k, 1] * y + turn[k, 2] * along[i]
            continue
        n = normals[i]
        axis, most, side = 0, 0.0, 1.0
        for one in range(3):
            likeness = turn[0, one] * n[0] + turn[1, one] * n[1] + turn[2, one] * n[2]
            if abs(likeness) > most:
                axis, most, side = one, abs(likeness), (1.0 if likeness > 0.0 else -1.0)
        gap = -half[axis]
        for k in range(3):
            n[k] = side * turn[k, axis]
            gap += n[k] * (positions[i, k] - centre[k])
        for k in range(3):
            positions[i, k] -= gap * n[k]


@compiled
def follow(
    positions: Array, before: Array, kinds: Indices, edge_before: Indices, edge_after: Indices, shares: Array
) -> None:
    """Moves nodes off the edges as the edges of their row have moved since ``before`` [m], shape [n, 3], in place."""
    for i in range(len(kinds)):
        first, second = edge_before[i], edge_after[i]
        if kinds[i] > FACE or first < 0 or first == i:
            continue
        for k in range(3):
            one, other = positions[first, k] - before[first, k], positions[second, k] - before[second, k]
            positions[i, k] += one + shares[i] * (other - one)


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


@compiled
def share_out(
    positions: Array,
    forces: Array,
    kinds: Indices,
    holders: Indices,
    normals: Array,
    columns: int,
    centres: Array,
    body_forces: Array,
    body_torques: Array,
) -> None:
    """Sums the film's forces on the bodies; nothing of them is lost.

    An edge gives its box all of a node's force, a face the part along its normal. What is left on a free node, because
    the film isn't quite at rest, goes to the nearest edge nodes before and after it in its row (or in the nearest row
    that has any) by the rule of the lever, which keeps the force, and the moment too where the side is straight.

    Args:
        positions: nodes [m], shape [n, 3].
        forces: the film's on its nodes [N], shape [n, 3].
        kinds: shape [n].
        holders: the body that a node on an edge or a face is on, shape [n].
        normals: of the faces, shape [n, 3].
        columns: nodes of one row.
        centres: of the bodies [m], shape [b, 3].
        body_forces: filled [N], shape [b, 3].
        body_torques: filled, about the centres [N m], shape [b, 3].
    """
    body_forces[:] = 0.0
    body_torques[:] = 0.0
    rows = len(positions) // columns
    held = np.empty((len(positions), 3))
    held[:] = forces
    # Rows where something holds the film, the nearest for each row.
    nearest = np.full(rows, -1)
    for row in range(rows):
        for away in range(rows):
            for sign in (-1, 1):
                other = row + sign * away
                if nearest[row] < 0 and 0 <= other < rows:
                    for column in range(columns):
                        if kinds[other * columns + column] == EDGE:
                            nearest[row] = other
                            break
            if nearest[row] >= 0:
                break
    for i in range(len(positions)):
        if kinds[i] > FACE:
            continue
        along = 0.0
        if kinds[i] == FACE:
            along = forces[i, 0] * normals[i, 0] + forces[i, 1] * normals[i, 1] + forces[i, 2] * normals[i, 2]
            for k in range(3):
                held[i, k] = along * normals[i, k]
        else:
            held[i] = 0.0
        row = nearest[i // columns]
        if row < 0:
            continue
        first, second = i % columns, i % columns
        while kinds[row * columns + first] != EDGE:
            first = (first - 1) % columns
        while kinds[row * columns + second] != EDGE:
            second = (second + 1) % columns
        a, b = row * columns + first, row * columns + second
        length = reach = 0.0
        for k in range(2):
            length += (positions[b, k] - positions[a, k]) ** 2
            reach += (positions[b, k] - positions[a, k]) * (positions[i, k] - positions[a, k])
        share = min(1.0, max(0.0, reach / length)) if length > 0.0 else 0.0
        for k in range(3):
            left = forces[i, k] - along * normals[i, k]
            held[a, k] += (1.0 - share) * left
            held[b, k] += share * left
    for i in range(len(positions)):
        if kinds[i] != EDGE and kinds[i] != FACE:
            continue
        body = holders[i]
        f = held[i]
        x, y, z = (
            positions[i, 0] - centres[body, 0],
            positions[i, 1] - centres[body, 1],
            positions[i, 2] - centres[body, 2],
        )
        for k in range(3):
            body_forces[body, k] += f[k]
        body_torques[body, 0] += y * f[2] - z * f[1]
        body_torques[body, 1] += z * f[0] - x * f[2]
        body_torques[body, 2] += x * f[1] - y * f[0]
