"""Film against boxes: which faces its nodes meet, how they go with boxes, and what the boxes feel of them.

The kernels call none of another file: numba's disk cache would not see that one change.
"""

import numpy as np

from sim_core.frames import Array
from sim_core.wrap.membrane import Flags, Indices, compiled

FREE, FACE, EDGE, IDLE = 0, 1, 2, 3
"""What a node does: moves, slides on a face, goes with an edge, or has no film at it. Compiled into ``edges`` too,
whose cache doesn't see them change."""
FACING = 0.5
"""Cosine of the angle up to which a face looks the film's way."""
STAYS = 0.9
"""Cosine of the angle between a face that a node is on and the one it was put on."""
TOUCH_M = 1.0e-6
"""A node that is farther off a face than this has left it."""


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
