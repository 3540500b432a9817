"""A strip of film under one pull at any stiffness: how far its elongation is from Hooke's after each Newton step."""

import time
from dataclasses import dataclass

import numpy as np

from sim_core.frames import Array
from sim_core.wrap.film import Film, make_film, plane_stress_stiffness
from sim_core.wrap.membrane import Flags, Indices
from sim_core.wrap.relaxation import relax

STIFFNESSES_NPM = (400.0, 4.0e3, 4.0e4, 4.0e5, 4.0e6)
"""E·t along the strip: from a tenth of one layer of stretch film to a thousand of them."""
PULL_N = 16.0
"""It stretches the softest strip by 40 %, the stiffest by 40 µm/m."""
LENGTH_M, WIDTH_M, COLUMNS, ROWS = 1.0, 0.1, 20, 4
UNEVEN = 0.25
"""Inner nodes are moved by up to this share of a cell, so that no element stands as the strip does."""
ACROSS, POISSON, SHEAR = 1.3, 0.3, 0.35
"""Moduli across and in shear, as shares of that along the strip."""
MOST_STEPS = 32
BAR = 5.0e-3
"""The elongation must come this near to the closed form."""
ROUND_OFF = 1.0e-9
"""What the forces are brought into balance to, as a share of the pull."""


@dataclass(frozen=True)
class StripPoint:
    """The strip after some Newton steps from rest.

    Attributes:
        stiffness_npm: E·t along the strip [N/m].
        steps: Newton steps.
        error: of the elongation, |ΔL/ΔL0 − 1| with ΔL0 = F·L/(E·t·w).
        cpu_s: processor time [s].
    """

    stiffness_npm: float
    steps: int
    error: float
    cpu_s: float


def strip_errors(stiffnesses_npm: tuple[float, ...] = STIFFNESSES_NPM) -> tuple[StripPoint, ...]:
    """The strip at each stiffness after one, two, three Newton steps, until its forces are in balance.

    Args:
        stiffnesses_npm: E·t along the strip [N/m].
    """
    points = []
    for stiffness in stiffnesses_npm:
        for steps in range(1, MOST_STEPS + 1):
            point, is_balanced = _pulled(stiffness, steps)
            points.append(point)
            if is_balanced:
                break
    return tuple(points)


def _pulled(stiffness_npm: float, steps: int) -> tuple[StripPoint, bool]:
    film, positions, is_end = _strip(stiffness_npm)
    is_start = positions[:, 0] == 0.0
    free = np.ones(len(positions), dtype=bool)
    fixed = np.zeros((len(positions), 2, 3))
    # In its plane; the held edge may contract, but for one node.
    fixed[:, 0] = [0.0, 0.0, 1.0]
    fixed[is_start, 1] = [1.0, 0.0, 0.0]
    free[np.flatnonzero(is_start)[0]] = False
    loads = np.zeros_like(positions)
    ends = np.flatnonzero(is_end)
    # An even pull on equal elements: the outer nodes have half of what the inner ones have.
    loads[ends, 0] = PULL_N / ROWS
    loads[ends[[0, -1]], 0] *= 0.5
    began = time.process_time()
    done = relax(
        film, positions, free, loads, tolerance_n=ROUND_OFF * PULL_N, most_iterations=steps, fixed_directions=fixed
    )  # fmt: skip
    cpu_s = time.process_time() - began
    elongation = float(positions[is_end, 0].mean()) - LENGTH_M
    error = abs(elongation * stiffness_npm * WIDTH_M / (PULL_N * LENGTH_M) - 1.0)
    return StripPoint(stiffness_npm, steps, error, cpu_s), done.residual_n <= ROUND_OFF * PULL_N


def _strip(stiffness_npm: float) -> tuple[Film, Array, Flags]:
    """Flat film without tension, its nodes row after row [m], shape [n, 3], and which of them stand at its end."""
    x, y = np.meshgrid(np.linspace(0.0, LENGTH_M, COLUMNS + 1), np.linspace(0.0, WIDTH_M, ROWS + 1))
    random = np.random.default_rng(1)
    for values, size in ((x, LENGTH_M / COLUMNS), (y, WIDTH_M / ROWS)):
        values[1:-1, 1:-1] += random.uniform(-UNEVEN, UNEVEN, (ROWS - 1, COLUMNS - 1)) * size
    nodes = np.column_stack([x.ravel(), y.ravel()])
    triangles = _triangles()
    law = plane_stress_stiffness(stiffness_npm, ACROSS * stiffness_npm, POISSON, SHEAR * stiffness_npm)
    film = make_film(triangles, nodes[triangles], law, len(nodes))
    return film, np.column_stack([nodes, np.zeros(len(nodes))]), nodes[:, 0] == LENGTH_M


def _triangles() -> Indices:
    """Two a cell, their diagonals in turns."""
    found = []
    for row in range(ROWS):
        for column in range(COLUMNS):
            a = row * (COLUMNS + 1) + column
            b, d = a + 1, a + COLUMNS + 1
            c = d + 1
            found += [(a, b, c), (a, c, d)] if (row + column) % 2 == 0 else [(a, b, d), (b, c, d)]
    return np.array(found, dtype=np.int64)
