"""The film's direct solver against a dense one: any grid, any border, blocked nodes among the others."""

import numpy as np
import pytest

from sim_core.frames import Array
from sim_core.wrap.bordered import factorise, number_nodes
from sim_core.wrap.film import make_film, plane_stress_stiffness
from sim_core.wrap.fit import flattened
from sim_core.wrap.membrane import Indices, assemble_tangent

DAMPING = 5.0


def ring(rows: int, columns: int) -> tuple[Array, Indices]:
    """Nodes of a tube, shape [n, 3], and triangles between them."""
    angles = 2.0 * np.pi * np.arange(columns) / columns
    nodes = np.array([(0.5 * np.cos(a), 0.5 * np.sin(a), 0.1 * row) for row in range(rows) for a in angles])
    cells = [
        (row * columns + column, row * columns + (column + 1) % columns)
        for row in range(rows - 1)
        for column in range(columns)
    ]
    triangles = [
        corners for a, b in cells for corners in ((a, b, b + columns), (a, b + columns, a + columns))
    ]
    return nodes, np.array(triangles, dtype=np.int64)


@pytest.mark.parametrize(
    ("rows", "columns", "edges"),
    [
        (2, 4, ()),
        (2, 40, ()),
        (9, 10, (5,)),
        (20, 24, (6, 12, 18)),
        # All nodes on the border: nothing is left to take apart.
        (10, 4, (1, 2, 3)),
    ],
)
def test_factor_solves_as_a_dense_matrix_does(rows: int, columns: int, edges: tuple[int, ...]) -> None:
    random = np.random.default_rng(3)
    nodes, triangles = ring(rows, columns)
    stiffness = plane_stress_stiffness(1.0e4, 1.0e4, 0.3, 4.0e3)
    film = make_film(triangles, flattened(nodes, triangles) / 1.05, stiffness, len(nodes))
    nodes += random.normal(scale=2.0e-3, size=nodes.shape)
    on_border = np.isin(np.arange(len(nodes)) % columns, (0, *edges))
    ways = np.linalg.qr(random.normal(size=(len(nodes), 3, 3)))[0]
    is_blocked = random.random(len(nodes)) < 0.4
    numbering = number_nodes(film, on_border, columns)
    half = len(triangles) // 2
    factor = factorise(film, nodes, half, ways, ways, is_blocked, numbering, damping=DAMPING)

    blocks = np.empty((len(film.columns), 3, 3))
    assemble_tangent(nodes, *film.elements, film.slots, blocks)
    dense = np.zeros((len(nodes), 3, len(nodes), 3))
    at = np.repeat(np.arange(len(nodes)), np.diff(film.row_start)), film.columns
    dense[at[0], :, at[1], :] = ways[at[0]] @ blocks @ ways[at[1]].transpose(0, 2, 1)
    for node in np.flatnonzero(is_blocked):
        alone = dense[node, 2, node, 2]
        dense[node, 2], dense[:, :, node, 2] = 0.0, 0.0
        dense[node, 2, node, 2] = alone
    matrix = dense.reshape(3 * len(nodes), -1) + DAMPING * np.eye(3 * len(nodes))

    pushes, steps = random.normal(size=nodes.shape), np.empty_like(nodes)
    inner, outer = factor.condense(pushes)
    moves = np.asarray(np.linalg.solve(factor.core, outer), dtype=np.float64)
    factor.expand(moves, inner, steps)
    wanted = np.linalg.solve(matrix, pushes.ravel()).reshape(-1, 3)
    assert np.abs(steps - wanted).max() < 1.0e-10 * np.abs(wanted).max()


def test_factor_is_the_same_to_the_bit() -> None:
    nodes, triangles = ring(12, 16)
    stiffness = plane_stress_stiffness(1.0e4, 5.0e3, 0.3, 4.0e3)
    film = make_film(triangles, flattened(nodes, triangles) / 1.05, stiffness, len(nodes))
    on_border = np.arange(len(nodes)) % 16 == 0
    ways, blocked = np.tile(np.eye(3), (len(nodes), 1, 1)), np.zeros(len(nodes), dtype=np.bool_)
    cores = [
        factorise(
            film, nodes, 0, ways, ways, blocked, number_nodes(film, on_border, 16), damping=DAMPING
        ).core.tobytes()
        for _ in range(2)
    ]
    assert cores[0] == cores[1]
