"""Quasi-static equilibrium of a film's free nodes by Newton's method, and its motion with true mass.

Each Newton step solves with the exact tangent stiffness by conjugate gradients that are preconditioned by the
nodes' own 3 × 3 blocks, and only as exactly as the residual deserves (Eisenstat and Walker, SIAM J. Sci. Comput.
17, 1996). Nodes in slack or wrinkled film have no stiffness in some direction: a small damping stiffness bounds
their step, grows where steps overshoot (Levenberg and Marquardt) and doesn't move the answer. A step counts only
if it lowers the potential energy, so the film can't blow up whatever its stiffness.
"""

from dataclasses import dataclass

import numpy as np

from config.errors import RefusedInput
from sim_core.frames import Array
from sim_core.wrap.film import Film
from sim_core.wrap.membrane import Flags, Indices, assemble_tangent, compiled, membrane_forces

LEAST_DAMPING = 1.0e-12
"""Damping stiffness where steps are small, as a share of the film's own stiffness."""
MOST_DAMPING = 1.0e3
"""Beyond this nothing moves: what is left is round-off."""
LEAST_EXACT = 0.02
"""Residual of the linear solve, as a share of the unbalanced forces, where Newton is far off."""
MOST_TRIALS = 12
"""Shares of a step that are tried."""
PATIENCE = 30
"""Newton steps before a film that hangs in its loads is taken through softer ones."""
LONGEST_STEP = 0.5
"""Longest move of a node in one step, as a share of the elements' size."""
ROUND_OFF = 1.0e-12
"""Energy differences below this share of the energies at work say nothing."""


@dataclass(frozen=True, slots=True)
class Relaxed:
    """How a relaxation ended.

    Attributes:
        iterations: Newton steps.
        force_evaluations: evaluations of the film's forces.
        solver_iterations: conjugate-gradient iterations, all steps together.
        residual_n: largest unbalanced force on a free node [N].
        energy_j: the film's elastic energy [J].
    """

    iterations: int
    force_evaluations: int
    solver_iterations: int
    residual_n: float
    energy_j: float

    def then(self, later: "Relaxed") -> "Relaxed":
        """The same relaxation with its next part."""
        return Relaxed(
            self.iterations + later.iterations,
            self.force_evaluations + later.force_evaluations,
            self.solver_iterations + later.solver_iterations,
            later.residual_n,
            later.energy_j,
        )


@dataclass(frozen=True, slots=True)
class _Task:
    film: Film
    free: Flags
    loads: Array
    blocked: Array


def relax(
    film: Film,
    positions: Array,
    free: Flags,
    loads: Array,
    *,
    tolerance_n: float,
    most_iterations: int = 200,
    fixed_directions: Array | None = None,
) -> Relaxed:
    """Moves the free nodes into equilibrium, in place, from where they are.

    Args:
        film: the elements.
        positions: node positions [m], shape [n, 3].
        free: which nodes move, shape [n].
        loads: constant forces on the nodes [N], shape [n, 3].
        tolerance_n: stop when no free node is out of balance by more [N]; round-off sets a floor near 1e-15 times
            the film's stiffness times its elements' size.
        most_iterations: Newton steps, about; the caller judges the residual that is left.
        fixed_directions: orthonormal directions in which a free node doesn't move, or zeros, shape [n, 2, 3]: one
            for a node that slides on a face, two for one that slides along an edge.

    Raises:
        RefusedInput: a position or load isn't finite; in balance it would never be, nor seem out of it.
    """
    for field, vectors in (("positions", positions), ("loads", loads)):
        if not np.isfinite(vectors).all():
            raise RefusedInput(field, "NaN or infinite", "must be finite")
    blocked = np.zeros((len(positions), 2, 3)) if fixed_directions is None else fixed_directions
    task = _Task(film, free, loads, blocked)
    done = _newton(task, positions, 1.0, tolerance_n, min(PATIENCE, most_iterations))
    heaviest = _largest(loads[free])
    stiffness, _ = film.scale()
    softness = 30.0 * np.abs(loads[free]).sum() / (stiffness * np.sqrt(film.area.sum()))
    stuck = done.residual_n > max(tolerance_n, 0.01 * heaviest)
    if stuck and 0.0 < softness < 0.3:
        # A nearly inextensible film far from its shape: a stretchy one finds it, and shows the stiff one the way.
        while softness < 0.3 and done.iterations < most_iterations:
            rest = most_iterations - done.iterations
            done = done.then(_newton(task, positions, softness, max(tolerance_n, 0.1 * heaviest), rest))
            softness *= 10.0
    if done.residual_n > tolerance_n or stuck:
        rest = max(most_iterations - done.iterations, 0)
        done = done.then(_newton(task, positions, 1.0, tolerance_n, rest))
    return done


def _newton(
    task: _Task, positions: Array, softness: float, tolerance_n: float, most_iterations: int
) -> Relaxed:
    """Newton's method for a film of ``softness`` times the stiffness."""
    film, free, loads, blocked = task.film, task.free, task.loads, task.blocked
    elements = film.elements if softness == 1.0 else film.softened(softness)
    typical, size = film.scale()
    longest_step = LONGEST_STEP * size
    blocks = np.empty((len(film.columns), 3, 3))
    forces, step, trial = np.empty_like(positions), np.empty_like(positions), np.empty_like(positions)
    energy = membrane_forces(positions, *elements, forces)
    residual = loads + forces
    keep_permitted(residual, free, blocked)
    iteration, evaluations, solver_iterations = 0, 1, 0
    damping, before = LEAST_DAMPING, np.inf
    while iteration < most_iterations and _largest(residual) > tolerance_n and damping < MOST_DAMPING:
        iteration += 1
        assemble_tangent(positions, *elements, film.slots, blocks)
        norm = float(np.sqrt(_dot(residual, residual)))
        exactness = max(min(LEAST_EXACT, (norm / before) ** 1.5), 0.1 * tolerance_n / norm, 1e-6)
        before = norm
        while True:
            matrix = (film.row_start, film.columns, blocks, damping * softness * typical)
            solver_iterations += solve_step(*matrix, free, blocked, residual, step, exactness)
            length = _largest(step)
            if length <= 8.0 * longest_step or damping >= 1.0:
                break
            damping = max(100.0 * damping, 1e-6)
        share = min(1.0, longest_step / length) if length > 0.0 else 1.0
        downhill = _dot(residual, step)
        for _ in range(MOST_TRIALS):
            evaluations += 1
            trial[:] = positions + share * step
            new_energy = membrane_forces(trial, *elements, forces)
            after = loads + forces
            keep_permitted(after, free, blocked)
            slope = _dot(after, step)
            work = share * _dot(loads, step)
            rise = new_energy - energy - work
            noise = ROUND_OFF * (abs(energy) + abs(new_energy) + abs(work))
            # Near the answer the energy's change drowns in round-off, its slope doesn't.
            if rise <= -1e-4 * share * downhill or (rise <= noise and abs(slope) <= 0.9 * downhill):
                positions[:], residual, energy = trial, after, new_energy
                damping = max(0.1 * damping, LEAST_DAMPING) if share > 0.5 else min(4.0 * damping, 1.0)
                break
            share *= min(max(downhill / (downhill - slope), 0.1), 0.5) if slope < downhill else 0.5
        else:
            damping = max(100.0 * damping, 1e-8)
    return Relaxed(iteration, evaluations, solver_iterations, _largest(residual), float(energy))


def _largest(vectors: Array) -> float:
    """Length of the longest vector, shape [n, 3]."""
    return float(np.sqrt(np.einsum("ij,ij->i", vectors, vectors).max(initial=0.0)))


@compiled
def _dot(first: Array, second: Array) -> float:
    """Sum of products in the order of the nodes, the same on every machine, shapes [n, 3]."""
    total = 0.0
    for i in range(len(first)):
        total += first[i, 0] * second[i, 0] + first[i, 1] * second[i, 1] + first[i, 2] * second[i, 2]
    return total


@compiled
def keep_permitted(vectors: Array, free: Flags, blocked: Array) -> None:
    """Takes out of ``vectors`` what fixed nodes and fixed directions don't permit, in place, shape [n, 3]."""
    for i in range(len(vectors)):
        if not free[i]:
            vectors[i] = 0.0
            continue
        for k in range(2):
            n = blocked[i, k]
            along = vectors[i, 0] * n[0] + vectors[i, 1] * n[1] + vectors[i, 2] * n[2]
            for row in range(3):
                vectors[i, row] -= along * n[row]


@compiled
def solve_step(
    row_start: Indices,
    columns: Indices,
    blocks: Array,
    damping: float,
    free: Flags,
    blocked: Array,
    residual: Array,
    step: Array,
    exactness: float,
) -> int:
    """Preconditioned conjugate gradients for (tangent + damping)·step = residual; gives the iterations.

    It stops at ``exactness`` times the residual, or where the curvature isn't positive.
    """
    n = len(residual)
    inverses = np.empty((n, 3, 3))
    for i in range(n):
        if free[i]:
            _invert_block(row_start, columns, blocks, damping, i, blocked[i], inverses[i])
    left, push, scaled = residual.copy(), np.empty((n, 3)), np.empty((n, 3))
    step[:] = 0.0
    _precondition(inverses, left, scaled, free, blocked)
    direction = scaled.copy()
    product = _dot(left, scaled)
    goal = exactness * exactness * _dot(left, left)
    for iteration in range(1, 10 * n + 1):
        _multiply(row_start, columns, blocks, damping, direction, push, free, blocked)
        curvature = _dot(direction, push)
        if not curvature > 0.0:
            if iteration == 1:
                step[:] = scaled
            return iteration
        length = product / curvature
        size = 0.0
        for i in range(n):
            for row in range(3):
                step[i, row] += length * direction[i, row]
                left[i, row] -= length * push[i, row]
                size += left[i, row] * left[i, row]
        if size <= goal:
            return iteration
        _precondition(inverses, left, scaled, free, blocked)
        after = _dot(left, scaled)
        share = after / product
        product = after
        for i in range(n):
            for row in range(3):
                direction[i, row] = scaled[i, row] + share * direction[i, row]
    return 10 * n


@compiled
def _multiply(
    row_start: Indices,
    columns: Indices,
    blocks: Array,
    damping: float,
    vectors: Array,
    result: Array,
    free: Flags,
    blocked: Array,
) -> None:
    for i in range(len(vectors)):
        if not free[i]:
            result[i] = 0.0
            continue
        x, y, z = damping * vectors[i, 0], damping * vectors[i, 1], damping * vectors[i, 2]
        for at in range(row_start[i], row_start[i + 1]):
            block, v = blocks[at], vectors[columns[at]]
            x += block[0, 0] * v[0] + block[0, 1] * v[1] + block[0, 2] * v[2]
            y += block[1, 0] * v[0] + block[1, 1] * v[1] + block[1, 2] * v[2]
            z += block[2, 0] * v[0] + block[2, 1] * v[1] + block[2, 2] * v[2]
        result[i, 0], result[i, 1], result[i, 2] = x, y, z
    keep_permitted(result, free, blocked)


@compiled
def _precondition(inverses: Array, vectors: Array, result: Array, free: Flags, blocked: Array) -> None:
    for i in range(len(vectors)):
        if free[i]:
            m, v = inverses[i], vectors[i]
            for row in range(3):
                result[i, row] = m[row, 0] * v[0] + m[row, 1] * v[1] + m[row, 2] * v[2]
    keep_permitted(result, free, blocked)


@compiled
def _invert_block(
    row_start: Indices,
    columns: Indices,
    blocks: Array,
    damping: float,
    node: int,
    blocked: Array,
    inverse: Array,
) -> None:
    """Inverse of a node's own block, with a wall in its fixed directions; its stiffness alone where that fails."""
    m = inverse
    for at in range(row_start[node], row_start[node + 1]):
        if columns[at] == node:
            m[:] = blocks[at]
    trace = abs(m[0, 0]) + abs(m[1, 1]) + abs(m[2, 2]) + damping
    for row in range(3):
        m[row, row] += damping
        for column in range(3):
            for k in range(2):
                m[row, column] += trace * blocked[k, row] * blocked[k, column]
    a, b, c, d, e, f = m[0, 0], m[1, 1], m[2, 2], m[1, 2], m[0, 2], m[0, 1]
    second = a * b - f * f
    det = c * second - d * (a * d - f * e) + e * (f * d - b * e)
    if a > 0.0 and second > 0.0 and det > 1e-14 * trace * second:
        m[0, 0], m[1, 1], m[2, 2] = (b * c - d * d) / det, (a * c - e * e) / det, second / det
        m[0, 1], m[0, 2], m[1, 2] = (e * d - f * c) / det, (f * d - e * b) / det, (e * f - a * d) / det
        m[1, 0], m[2, 0], m[2, 1] = m[0, 1], m[0, 2], m[1, 2]
    else:
        m[:] = 0.0
        m[0, 0] = m[1, 1] = m[2, 2] = 1.0 / trace


def stable_step_s(film: Film, areal_density: float) -> float:
    """Longest stable step of :func:`explicit_step` [s]: 2/ω, ω that of the stiffest element on its own.

    No frequency of the whole lies above it (Irons and Treharne, 1971). Membrane forces up to a tenth of the
    stiffness are allowed for.

    Args:
        film: the elements, at least one of them whole.
        areal_density: mass for each unit of reference area [kg/m²].
    """
    first = -film.inverse_reference.sum(axis=1, keepdims=True)
    gradients = np.concatenate((first, film.inverse_reference), axis=1)
    steepest = np.linalg.eigvalsh(np.einsum("mai,maj->mij", gradients, gradients))[:, 1]
    a11, a22, a12, a66 = film.stiffness.T
    stiffest = np.maximum(0.5 * (a11 + a22) + np.hypot(0.5 * (a11 - a22), a12), 2.0 * a66)
    squares = 3.0 * 1.1 * stiffest * steepest / areal_density
    return float(2.0 / np.sqrt(squares[~film.torn].max()))


def explicit_step(
    film: Film,
    positions: Array,
    velocities: Array,
    free: Flags,
    loads: Array,
    nodal_masses: Array,
    step_s: float,
) -> float:
    """One semi-implicit Euler step of a film with true mass, in place; gives the elastic energy before it [J].

    Args:
        film: the elements.
        positions: [m], shape [n, 3].
        velocities: [m/s], shape [n, 3].
        free: which nodes move, shape [n].
        loads: forces on the nodes [N], shape [n, 3].
        nodal_masses: lumped masses [kg], shape [n].
        step_s: below :func:`stable_step_s`.
    """
    forces = np.empty_like(positions)
    energy = membrane_forces(positions, *film.elements, forces)
    forces += loads
    velocities[free] += step_s * forces[free] / nodal_masses[free, None]
    positions[free] += step_s * velocities[free]
    return float(energy)
