"""Film against closed forms: strip, patch, catenary, wave, cut at an angle, tension field, yield, tear."""

import subprocess
import sys

import numpy as np
import pytest

from config.errors import RefusedInput
from sim_core.frames import GRAVITY, Array
from sim_core.wrap.film import Film, make_film, plane_stress_stiffness, reference_shapes
from sim_core.wrap.membrane import (
    assemble_tangent,
    membrane_forces,
    membrane_state,
    tear_film,
    yield_film,
)
from sim_core.wrap.relaxation import Relaxed, explicit_step, relax, stable_step_s

STIFFNESSES = (400.0, 12_000.0, 4.0e6)
RATIOS = {"md": (1.0, 1.3, 0.3, 0.35), "td": (1.0, 0.2, 0.4, 0.1), "even": (1.0, 1.0, 0.3, 1.0 / 2.6)}


def material(scale: float, kind: str = "md") -> Array:
    md, td, poisson, shear = RATIOS[kind]
    return plane_stress_stiffness(md * scale, td * scale, poisson, shear * scale)


def rectangle(
    length: float, width: float, columns: int, rows: int, uneven: float = 0.0
) -> tuple[Array, Array]:
    """Flat nodes [n, 2] and triangles with alternating diagonals; ``uneven`` moves inner nodes by a share of a cell."""
    x, y = np.meshgrid(np.linspace(0.0, length, columns + 1), np.linspace(0.0, width, rows + 1))
    inner = (x > 0.0) & (x < length) & (y > 0.0) & (y < width)
    random = np.random.default_rng(7)
    x = x + uneven * inner * random.uniform(-1.0, 1.0, x.shape) * length / columns
    y = y + uneven * inner * random.uniform(-1.0, 1.0, y.shape) * width / rows
    at = np.arange((columns + 1) * (rows + 1)).reshape(rows + 1, columns + 1)
    a, b, c, d = at[:-1, :-1], at[:-1, 1:], at[1:, :-1], at[1:, 1:]
    even = (np.add.outer(np.arange(rows), np.arange(columns)) % 2 == 0)[..., None, None]
    split = np.where(
        even,
        np.stack((a, b, c, b, d, c), -1).reshape(rows, columns, 2, 3),
        np.stack((a, b, d, a, d, c), -1).reshape(rows, columns, 2, 3),
    )
    return np.stack((x.ravel(), y.ravel()), axis=1), split.reshape(-1, 3)


def flat_film(plane: Array, triangles: Array, stiffness: Array, angle: float = 0.0) -> tuple[Film, Array]:
    """A film whose MD lies at ``angle`` to x, and its nodes in the plane z = 0."""
    c, s = np.cos(angle), np.sin(angle)
    corners = (plane @ np.array([[c, -s], [s, c]]))[triangles]
    return make_film(triangles, corners, stiffness, len(plane)), np.c_[plane, np.zeros(len(plane))]


def on(plane: Array, axis: int, value: float) -> np.ndarray:
    return np.abs(plane[:, axis] - value) < 1e-9


def edge_shares(plane: Array, axis: int, value: float) -> Array:
    """Shares of a uniform pull on a straight edge, by node, shape [n]."""
    nodes = np.flatnonzero(on(plane, axis, value))
    nodes = nodes[np.argsort(plane[nodes, 1 - axis])]
    lengths = np.diff(plane[nodes, 1 - axis])
    shares = np.zeros(len(plane))
    shares[nodes[:-1]] += lengths
    shares[nodes[1:]] += lengths
    return shares / shares.sum()


def forces_of(film: Film, positions: Array) -> tuple[Array, float]:
    forces = np.empty_like(positions)
    return forces, membrane_forces(positions, *film.elements, forces)


def strains_of(film: Film, positions: Array) -> tuple[Array, Array]:
    strains, pulls = np.empty((len(film.triangles), 5)), np.empty((len(film.triangles), 2))
    triangles, inverse, _, stiffness, set_strain, torn = film.elements
    membrane_state(positions, triangles, inverse, stiffness, set_strain, torn, strains, pulls)
    return strains, pulls


def guided(plane: Array) -> tuple[np.ndarray, Array]:
    """A strip held at x = 0 so that it may contract: one node fixed, the edge's others slide along it, all in plane."""
    free = np.ones(len(plane), dtype=bool)
    fixed = np.zeros((len(plane), 2, 3))
    fixed[:, 0] = [0.0, 0.0, 1.0]
    fixed[on(plane, 0, 0.0), 1] = [1.0, 0.0, 0.0]
    free[np.flatnonzero(on(plane, 0, 0.0))[0]] = False
    return free, fixed


# Forces


def one_triangle(strain: Array, kind: str, random: np.random.Generator) -> tuple[Film, Array]:
    flat = np.array([[0.0, 0.0], [0.11, 0.01], [0.03, 0.09]])
    film = make_film(np.array([[0, 1, 2]]), flat[None], material(4000.0, kind), 3)
    turn = np.linalg.qr(random.normal(size=(3, 3)))[0]
    film.set_strain[:] = [0.01, -0.02, 0.015]
    stretch = np.array([[1.01 + strain[0], 0.015 + strain[2]], [0.015 + strain[2], 0.98 + strain[1]]])
    return film, np.ascontiguousarray(np.c_[flat @ stretch, np.zeros(3)] @ turn.T) + 0.3


@pytest.mark.parametrize("kind", RATIOS)
@pytest.mark.parametrize(
    ("strain", "pulls"),
    [((0.05, 0.03, 0.02), 2), ((0.06, -0.05, 0.03), 1), ((-0.04, 0.08, -0.05), 1), ((-0.05, -0.06, 0.01), 0)],
)
def test_forces_are_the_energys_slope(kind: str, strain: tuple[float, ...], pulls: int) -> None:
    film, positions = one_triangle(np.array(strain), kind, np.random.default_rng(3))
    forces, energy = forces_of(film, positions)
    principal = strains_of(film, positions)[1][0]
    assert (principal > 1e-6 * principal.max(initial=1.0)).sum() == pulls
    assert (energy > 0.0) == (pulls > 0)
    slopes, tangent, h = np.empty(9), np.empty((9, 9)), 1e-6
    for i in range(9):
        ahead, behind = positions.copy(), positions.copy()
        ahead.flat[i] += h
        behind.flat[i] -= h
        (after, above), (before, below) = forces_of(film, ahead), forces_of(film, behind)
        slopes[i], tangent[:, i] = (below - above) / (2.0 * h), (before - after).ravel() / (2.0 * h)
    assert np.abs(slopes - forces.ravel()).max() <= 1e-6 * np.abs(forces).max()
    blocks = np.empty((9, 3, 3))
    assemble_tangent(positions, *film.elements, film.slots, blocks)
    matrix = blocks[film.slots[0]].transpose(0, 2, 1, 3).reshape(9, 9)
    assert np.abs(matrix - tangent).max() <= 1e-6 * np.abs(tangent).max()
    # No force and no moment from nowhere.
    size = np.abs(forces).max()
    assert np.abs(forces.sum(axis=0)).max() <= 1e-9 * size
    assert np.abs(np.cross(positions, forces).sum(axis=0)).max() <= 1e-9 * size


def test_energy_is_the_least_over_all_wrinkles() -> None:
    # Brute force over direction and width of the wrinkles, for a strongly orthotropic film.
    film, _ = one_triangle(np.zeros(3), "td", np.random.default_rng(0))
    a11, a22, a12, a66 = film.stiffness[0]
    law = np.array([[a11, a12, 0.0], [a12, a22, 0.0], [0.0, 0.0, 4.0 * a66]])
    angles = np.linspace(0.0, np.pi, 20_001)
    across = np.stack((np.cos(angles) ** 2, np.sin(angles) ** 2, np.cos(angles) * np.sin(angles)), axis=1)
    random = np.random.default_rng(11)
    for strain in random.uniform(-0.1, 0.1, (60, 3)):
        film, positions = one_triangle(strain, "td", random)
        _, energy = forces_of(film, positions)
        width = np.maximum(0.0, -(across @ law @ strain) / np.einsum("ki,ij,kj->k", across, law, across))
        left = strain + width[:, None] * across
        least = 0.5 * film.area[0] * np.einsum("ki,ij,kj->k", left, law, left).min()
        # A slack film needs wrinkles in two directions: the bound is then from above only.
        assert energy <= least * (1.0 + 1e-9)
        if np.linalg.eigvalsh([[strain[0], strain[2]], [strain[2], strain[1]]])[1] > 0.0:
            assert energy == pytest.approx(least, rel=1e-6, abs=1e-9)


def test_collapsed_triangles_push_finite_forces() -> None:
    flat = np.array([[0.0, 0.0], [0.1, 0.0], [0.0, 0.1]])
    film = make_film(np.array([[0, 1, 2]]), flat[None], material(4000.0, "td"), 3)
    for height in (0.0, 1e-300, 1e-18, 1e-12, 1e-6):
        for length in (0.0, 0.08, 0.15):
            positions = np.array([[0.0, 0.0, 0.0], [length, 0.0, 0.0], [0.5 * length, height, 0.0]])
            forces, energy = forces_of(film, positions)
            assert np.isfinite(forces).all() and np.isfinite(energy)
            assert np.abs(forces).max() <= 4000.0


# Closed forms


@pytest.mark.parametrize("scale", STIFFNESSES)
def test_a_pulled_strip_follows_hooke(scale: float) -> None:
    # ΔL = F·L/(E1·t·w), exact for engineering strain at any size of it; the free edges contract by ν12.
    length, width, strain = 1.0, 0.1, 0.08
    plane, triangles = rectangle(length, width, 20, 4, uneven=0.25)
    film, positions = flat_film(plane, triangles, material(scale))
    free, fixed = guided(plane)
    pull = scale * width * strain
    loads = np.zeros_like(positions)
    loads[:, 0] = pull * edge_shares(plane, 0, length)
    ended = relax(film, positions, free, loads, tolerance_n=1e-9 * pull, fixed_directions=fixed)
    assert ended.residual_n <= 1e-9 * pull
    tip = positions[on(plane, 0, length), 0].mean() - length
    assert tip == pytest.approx(pull * length / (scale * width), rel=1e-6)
    assert np.ptp(positions[:, 1]) == pytest.approx(width * (1.0 - 0.3 * strain), rel=1e-6)
    assert ended.energy_j == pytest.approx(0.5 * pull * tip, rel=1e-6)


@pytest.mark.parametrize("scale", STIFFNESSES)
def test_a_strip_under_its_own_weight(scale: float) -> None:
    # Tip ρ·g·L²/(2·E): per unit of area, weight·L²/(2·E1·t).
    length, width, weight = 1.0, 0.05, 0.02 * scale
    plane, triangles = rectangle(length, width, 40, 2)
    film, positions = flat_film(plane, triangles, material(scale))
    free, fixed = guided(plane)
    loads = np.zeros_like(positions)
    loads[:, 0] = film.nodal_masses(weight)
    relax(film, positions, free, loads, tolerance_n=1e-9 * weight, fixed_directions=fixed)
    tip = positions[on(plane, 0, length), 0].mean() - length
    assert tip == pytest.approx(weight * length**2 / (2.0 * scale), rel=5e-3)


@pytest.mark.parametrize(
    "gradient",
    [((1.06, 0.0), (0.0, 1.03)), ((1.06, 0.04), (0.01, 1.05)), ((0.6, -0.8), (0.8, 0.6))],
    ids=["tension", "shear", "rotation"],
)
def test_patch(gradient: tuple[tuple[float, float], ...]) -> None:
    plane, triangles = rectangle(1.0, 0.8, 8, 7, uneven=0.3)
    film, flat = flat_film(plane, triangles, material(4000.0))
    exact = np.c_[plane @ np.array(gradient).T, np.zeros(len(plane))]
    free = ~(on(plane, 0, 0.0) | on(plane, 0, 1.0) | on(plane, 1, 0.0) | on(plane, 1, 0.8))
    positions = exact.copy()
    rotated = np.allclose(np.array(gradient).T @ np.array(gradient), np.eye(2))
    if not rotated:
        # An unstressed film has no stiffness out of its plane: there only the strain is asked.
        positions[free] += np.random.default_rng(5).uniform(-0.01, 0.01, (free.sum(), 3))
    relax(film, positions, free, np.zeros_like(flat), tolerance_n=1e-9)
    assert np.abs(positions - exact).max() <= 1e-6
    values, vectors = np.linalg.eigh(np.array(gradient).T @ np.array(gradient))
    stretch = vectors @ np.diag(np.sqrt(values)) @ vectors.T - np.eye(2)
    expected = [stretch[0, 0], stretch[1, 1], stretch[0, 1]]
    assert np.abs(strains_of(film, positions)[0][:, :3] - expected).max() <= (1e-14 if rotated else 1e-6)


def test_catenary() -> None:
    # y = a·cosh(x/a), L = 2a·sinh(d/2a), end tension w·y; nearly inextensible: strain 1e-5.
    length, span, width, areal_weight = 1.2, 1.0, 0.05, 50.0
    low, high = 0.1, 10.0
    for _ in range(80):
        a = 0.5 * (low + high)
        low, high = (a, high) if 2.0 * a * np.sinh(span / (2.0 * a)) > length else (low, a)
    plane, triangles = rectangle(length, width, 60, 2)
    film, positions = flat_film(plane, triangles, material(4.0e6))
    free = ~(on(plane, 0, 0.0) | on(plane, 0, length))
    share = plane[:, 0] / length
    positions[:, 0] = span * share
    positions[:, 2] = -0.1 * np.sin(np.pi * share)
    loads = np.zeros_like(positions)
    loads[:, 2] = -film.nodal_masses(areal_weight)
    weight = areal_weight * width
    ended = relax(film, positions, free, loads, tolerance_n=1e-6 * weight * length)
    assert ended.residual_n <= 1e-6 * weight * length
    x = positions[:, 0] - 0.5 * span
    exact = a * np.cosh(x / a) - a * np.cosh(0.5 * span / a)
    sag = -exact.min()
    assert np.abs(positions[:, 2] - exact).max() <= 0.01 * sag
    forces, _ = forces_of(film, positions)
    end = forces[on(plane, 0, 0.0)].sum(axis=0)
    # The clamped nodes carry half an element's weight of their own.
    end[2] += loads[on(plane, 0, 0.0), 2].sum()
    assert np.linalg.norm(end) == pytest.approx(weight * a * np.cosh(0.5 * span / a), rel=0.01)


def test_wave_along_a_strip() -> None:
    # Lowest axial mode of a strip held at both ends: f = c/2L with c = √(E/ρ) (ν = 0, so no lateral inertia).
    length, width, scale, areal_density = 1.0, 0.02, 4000.0, 0.0184
    plane, triangles = rectangle(length, width, 50, 1)
    film, positions = flat_film(plane, triangles, plane_stress_stiffness(scale, scale, 0.0, 0.5 * scale))
    masses = film.nodal_masses(areal_density)
    free = ~(on(plane, 0, 0.0) | on(plane, 0, length))
    positions[:, 0] *= 1.02
    positions[:, 1] *= 1.005
    # Stretched both ways, so that it stays taut; constant loads hold it there.
    loads = -forces_of(film, positions)[0]
    start, mode = positions.copy(), np.sin(np.pi * plane[:, 0] / length)
    velocities = np.zeros_like(positions)
    velocities[:, 0] = 0.5 * mode
    speed = np.sqrt(scale / areal_density)
    step_s = 0.9 * stable_step_s(film, areal_density)
    swings = []
    for _ in range(int(3.2 * length / speed / step_s)):
        explicit_step(film, positions, velocities, free, loads, masses, step_s)
        swings.append(float(mode @ (positions - start)[:, 0]))
    swing = np.array(swings)
    at = np.flatnonzero(swing[:-1] * swing[1:] < 0.0)
    crossings = step_s * (at + swing[at] / (swing[at] - swing[at + 1]))
    assert 2.0 * length / (crossings[2] - crossings[0]) == pytest.approx(speed, rel=5e-3)


def test_the_stable_step_is_one_and_not_far_from_the_limit() -> None:
    plane, triangles = rectangle(0.5, 0.4, 10, 8)
    film, positions = flat_film(plane, triangles, material(4000.0))
    masses = film.nodal_masses(0.02)
    positions *= 1.02
    loads = -forces_of(film, positions)[0]

    def worst_after(share: float) -> float:
        moved = positions + 1e-7 * np.random.default_rng(1).normal(size=positions.shape)
        velocities = np.zeros_like(moved)
        for _ in range(1500):
            step_s = share * stable_step_s(film, 0.02)
            explicit_step(film, moved, velocities, np.ones(len(moved), dtype=bool), loads, masses, step_s)
        return float(np.abs(moved - positions).max())

    assert worst_after(0.99) < 1e-5
    with np.errstate(all="ignore"):
        assert not worst_after(1.4) < 1e-5


@pytest.mark.parametrize("degrees", [0.0, 30.0, 45.0, 90.0])
@pytest.mark.parametrize("kind", RATIOS)
def test_modulus_of_a_strip_cut_at_an_angle(degrees: float, kind: str) -> None:
    scale, angle, strain = 4000.0, np.radians(degrees), 1e-4
    md, td, poisson, shear = (value * scale for value in RATIOS[kind])
    poisson /= scale
    c, s = np.cos(angle), np.sin(angle)
    modulus = 1.0 / (c**4 / md + (1.0 / shear - 2.0 * poisson / md) * (s * c) ** 2 + s**4 / td)
    length, width = 1.0, 0.2
    plane, triangles = rectangle(length, width, 10, 3, uneven=0.2)
    film, positions = flat_film(plane, triangles, material(scale, kind), angle)
    # Pulled evenly at both ends and held at a point and against turning only, the strip is free to shear.
    pull = modulus * width * strain
    loads = np.zeros_like(positions)
    loads[:, 0] = pull * (edge_shares(plane, 0, length) - edge_shares(plane, 0, 0.0))
    free, fixed = np.ones(len(plane), dtype=bool), np.zeros((len(plane), 2, 3))
    fixed[:, 0] = [0.0, 0.0, 1.0]
    bottom = np.flatnonzero(on(plane, 1, 0.0))
    free[bottom[0]] = False
    fixed[bottom[-1], 1] = [0.0, 1.0, 0.0]
    relax(film, positions, free, loads, tolerance_n=1e-10 * pull, fixed_directions=fixed)
    stretched = positions[bottom[-1], 0] - positions[bottom[0], 0] - length
    assert pull * length / (width * stretched) == pytest.approx(modulus, rel=1e-3)


def sheared_panel(length: float, scale: float, shear: float) -> tuple[Film, Relaxed]:
    height = 0.3
    plane, triangles = rectangle(length, height, round(length / 0.025), 12)
    film, positions = flat_film(plane, triangles, material(scale, "even"))
    free = ~(on(plane, 1, 0.0) | on(plane, 1, height))
    positions[:, 0] += shear * positions[:, 1]
    positions[free, 2] += 1e-4 * np.sin(40.0 * plane[free, 0])
    ended = relax(film, positions, free, np.zeros_like(positions), tolerance_n=1e-6 * scale * shear * 0.025)
    assert ended.residual_n <= 1e-6 * scale * shear * 0.025
    return film, ended


@pytest.mark.parametrize("scale", STIFFNESSES)
def test_a_sheared_panel_becomes_a_tension_field(scale: float) -> None:
    # Between rigid edges, away from its free ends, the film wrinkles at 45°: W = ½·E·t·e1², e1 = γ/2 (Wagner 1929),
    # instead of ½·G·t·γ². The ends cancel in the difference of two lengths.
    shear = 0.02
    (long_film, long_end), (short_film, short_end) = (
        sheared_panel(size, scale, shear) for size in (1.5, 1.0)
    )
    stretch = np.linalg.svd([[1.0, shear], [0.0, 1.0]])[1][0] - 1.0
    area = long_film.area.sum() - short_film.area.sum()
    field = 0.5 * scale * stretch**2 * area
    assert long_end.energy_j - short_end.energy_j == pytest.approx(field, rel=0.01)


def prestrained_panel(scale: float) -> tuple[Film, Array, np.ndarray, float]:
    """1.2 m × 1.2 m, pre-strained 10 % in MD, vertical edges 10 mm apart in shear, and its typical nodal force."""
    plane, triangles = rectangle(1.2, 1.2, 20, 20)
    film, positions = flat_film(plane, triangles, material(scale))
    positions[:, 0] *= 1.1
    positions[on(plane, 0, 1.2), 1] += 0.010
    return film, positions, ~(on(plane, 0, 0.0) | on(plane, 0, 1.2)), 0.1 * scale * 0.06


@pytest.mark.parametrize("scale", STIFFNESSES)
def test_a_prestrained_panel_relaxes_to_one_answer(scale: float) -> None:
    film, positions, free, force = prestrained_panel(scale)
    other = positions.copy()
    other[free] += np.random.default_rng(2).uniform(-0.02, 0.02, (int(free.sum()), 3))
    loads = np.zeros_like(positions)
    ended, again = (relax(film, x, free, loads, tolerance_n=1e-8 * force) for x in (positions, other))
    assert max(ended.residual_n, again.residual_n) <= 1e-8 * force
    assert again.energy_j == pytest.approx(ended.energy_j, rel=1e-9)
    assert ended.energy_j / scale == pytest.approx(prestrained_energy_share(), rel=1e-6)
    # Warm: a tenth of a millimetre further takes a few steps, and nothing takes none.
    positions[np.isclose(positions[:, 0], 1.32), 1] += 1e-4
    assert relax(film, positions, free, loads, tolerance_n=1e-6 * force).iterations <= 4
    assert relax(film, positions, free, loads, tolerance_n=1e-6 * force).iterations == 0


def prestrained_energy_share() -> float:
    film, positions, free, force = prestrained_panel(1.0)
    return relax(film, positions, free, np.zeros_like(positions), tolerance_n=1e-8 * force).energy_j


@pytest.mark.parametrize("scale", STIFFNESSES)
def test_a_slack_net_falls_until_it_hangs(scale: float) -> None:
    # Held at its corners, 5 % too wide for them, and full of wrinkles; in stiff film strains are 1e-5.
    plane, triangles = rectangle(1.0, 1.0, 12, 12)
    film, positions = flat_film(plane, triangles, material(scale))
    positions[:, :2] *= 0.95
    positions[:, 2] = 1e-3 * np.sin(5.0 * plane[:, 0] + 1.0) * np.cos(3.0 * plane[:, 1])
    free = ~((on(plane, 0, 0.0) | on(plane, 0, 1.0)) & (on(plane, 1, 0.0) | on(plane, 1, 1.0)))
    loads = np.zeros_like(positions)
    loads[:, 2] = -film.nodal_masses(1.0) * GRAVITY
    ended = relax(film, positions, free, loads, tolerance_n=1e-6 * GRAVITY, most_iterations=300)
    assert ended.residual_n <= 1e-6 * GRAVITY
    reaction = forces_of(film, positions)[0][~free].sum(axis=0)
    assert reaction == pytest.approx([0.0, 0.0, loads[free, 2].sum()], abs=1e-4)


def test_fixed_directions_hold_and_leave_the_rest_in_balance() -> None:
    film, positions, free, force = prestrained_panel(12_000.0)
    fixed = np.zeros((len(positions), 2, 3))
    fixed[::3, 0] = [0.6, 0.0, 0.8]
    fixed[::6, 1] = [0.0, 1.0, 0.0]
    loads = np.zeros_like(positions)
    loads[:, 2] = 0.05 * force
    before = positions.copy()
    ended = relax(film, positions, free, loads, tolerance_n=1e-8 * force, fixed_directions=fixed)
    assert ended.residual_n <= 1e-8 * force
    assert np.abs(np.einsum("nki,ni->nk", fixed, positions - before)).max() <= 1e-12
    left = (loads + forces_of(film, positions)[0])[free]
    left -= np.einsum("nk,nki->ni", np.einsum("nki,ni->nk", fixed[free], left), fixed[free])
    assert np.abs(left).max() <= 1e-8 * force


def test_the_same_run_gives_the_same_bytes() -> None:
    ends = []
    for _ in range(2):
        film, positions, free, force = prestrained_panel(12_000.0)
        relax(film, positions, free, np.zeros_like(positions), tolerance_n=1e-6 * force)
        ends.append(positions.tobytes())
    assert ends[0] == ends[1]


# Permanent set and tears


@pytest.mark.parametrize("hardening", [0.0, 0.2])
@pytest.mark.parametrize("angle", [0.0, np.pi / 2.0])
def test_yield_leaves_the_closed_forms_set(hardening: float, angle: float) -> None:
    # Drawn to strain e: T = Y + r·E·(e − Y/E). Let go to 1 % of T: e − 0.99·T/E.
    length, width, scale, limit, drawn = 0.5, 0.1, 4000.0, 160.0, 0.12
    plane, triangles = rectangle(length, width, 8, 2)
    film, positions = flat_film(plane, triangles, material(scale), angle)
    modulus = scale * (1.0 if angle == 0.0 else RATIOS["md"][1])
    free, fixed = guided(plane)
    tip = on(plane, 0, length)
    fixed[tip, 1] = [1.0, 0.0, 0.0]
    yield_force, loads = np.full(len(triangles), limit), np.zeros_like(positions)
    work = lost = 0.0
    steps = 120
    for k in range(steps):
        pulls = [-forces_of(film, positions)[0][tip, 0].sum()]
        positions[:, 0] *= (1.0 + drawn * (k + 1) / steps) / (1.0 + drawn * k / steps)
        for _ in range(60):
            relax(film, positions, free, loads, tolerance_n=1e-8 * limit * width, fixed_directions=fixed)
            pulls.append(-forces_of(film, positions)[0][tip, 0].sum())
            gone, count = yield_film(positions, *film.elements, yield_force, hardening)
            lost += gone
            if not count:
                break
        work += 0.5 * (pulls[0] + pulls[1]) * drawn * length / steps
    pull = limit + hardening * modulus * (drawn - limit / modulus)
    assert -forces_of(film, positions)[0][tip, 0].sum() == pytest.approx(pull * width, rel=1e-5)
    stored = forces_of(film, positions)[1]
    assert work == pytest.approx(lost + stored, rel=1e-3)
    # Not let go all of the way: slack film has no length of its own.
    fixed[tip, 1] = 0.0
    loads[:, 0] = 0.01 * pull * width * edge_shares(plane, 0, length)
    relax(film, positions, free, loads, tolerance_n=1e-10 * limit, fixed_directions=fixed)
    assert positions[tip, 0].mean() / length - 1.0 == pytest.approx(drawn - 0.99 * pull / modulus, rel=1e-5)
    # Drawn again it yields where it was left, not before.
    positions[:, 0] *= (1.0 + drawn) / (positions[tip, 0].mean() / length)
    fixed[tip, 1] = [1.0, 0.0, 0.0]
    relax(film, positions, free, loads, tolerance_n=1e-10 * limit, fixed_directions=fixed)
    assert strains_of(film, positions)[1][:, 0].max() <= yield_force.min() * (1.0 + 1e-5)


def test_a_tear_loses_exactly_its_energy() -> None:
    plane, triangles = rectangle(0.4, 0.3, 6, 5, uneven=0.3)
    film, flat = flat_film(plane, triangles, material(4000.0))
    positions = flat * [1.3, 1.1, 1.0] + 0.01 * np.random.default_rng(4).normal(size=flat.shape)
    breaks = np.tile([0.35, 0.30], (len(triangles), 1))
    before = forces_of(film, positions)[1]
    strains = strains_of(film, positions)[0]
    newly, lost = tear_film(positions, *film.elements, breaks)
    assert 0 < len(newly) < len(triangles) and film.torn[newly].all() and film.torn.sum() == len(newly)
    forces, after = forces_of(film, positions)
    assert before - after == pytest.approx(lost, rel=1e-12)
    assert strains[newly, 3].min() > 0.30
    assert np.abs(forces.sum(axis=0)).max() <= 1e-9 * np.abs(forces).max()
    again, nothing = tear_film(positions, *film.elements, breaks)
    assert len(again) == 0 and nothing == 0.0
    # A film with no whole element left carries nothing and holds nothing.
    film.torn[:] = True
    ended = relax(film, positions, np.ones(len(plane), dtype=bool), np.zeros_like(flat), tolerance_n=1e-12)
    assert ended.iterations == 0 and ended.energy_j == 0.0 and not forces_of(film, positions)[0].any()


@pytest.mark.parametrize(
    ("degrees", "limit"), [(0.0, 0.4), (90.0, 0.1), (45.0, np.sqrt(2.0 / (1 / 0.16 + 1 / 0.01)))]
)
def test_break_strains_lie_on_an_ellipse(degrees: float, limit: float) -> None:
    flat = np.array([[0.0, 0.0], [0.1, 0.0], [0.0, 0.1]])
    direction = np.array([np.cos(np.radians(degrees)), np.sin(np.radians(degrees))])
    for share, torn in ((0.999, 0), (1.001, 1)):
        film = make_film(np.array([[0, 1, 2]]), flat[None], material(4000.0), 3)
        stretch = np.eye(2) + limit * share * np.outer(direction, direction)
        positions = np.c_[flat @ stretch, np.zeros(3)]
        assert len(tear_film(positions, *film.elements, np.array([[0.4, 0.1]]))[0]) == torn


# What is refused, and what is compiled


def test_refusals_name_the_value() -> None:
    flat = np.array([[0.0, 0.0], [0.1, 0.0], [0.2, 0.0]])
    with pytest.raises(RefusedInput, match=r"corners\[0\]"):
        reference_shapes(flat[None])
    with pytest.raises(RefusedInput, match="finite"):
        reference_shapes(np.full((1, 3, 2), np.nan))
    for values, field in (
        ((0.0, 1.0, 0.0, 1.0), "modulus_md"),
        ((1.0, 1.0, 1.0, 1.0), "poisson"),
        ((1.0, 1.0, 0.0, np.inf), "shear"),
    ):
        with pytest.raises(RefusedInput, match=field):
            plane_stress_stiffness(*values)
    with pytest.raises(RefusedInput, match="triangles"):
        make_film(np.array([[0, 1, 3]]), flat[None], material(1.0), 3)
    with pytest.raises(RefusedInput, match="stiffness"):
        make_film(
            np.array([[0, 1, 2]]), flat[None] + [[0, 0], [0, 0], [0, 1]], np.array([1.0, 1.0, 2.0, 1.0]), 3
        )


def test_a_film_at_nan_is_refused() -> None:
    film, positions, free, _ = prestrained_panel(1.0)
    positions[7, 2] = np.nan
    with pytest.raises(RefusedInput, match="positions"):
        relax(film, positions, free, np.zeros_like(positions), tolerance_n=1.0)


def test_a_second_process_compiles_nothing() -> None:
    # This file has called every kernel: they are on disk.
    film, positions, free, force = prestrained_panel(1.0)
    relax(film, positions, free, np.zeros_like(positions), tolerance_n=1e-3 * force)
    script = """
import numpy as np
from sim_core.wrap import membrane, relaxation
from sim_core.wrap.film import make_film, plane_stress_stiffness
flat = np.array([[0.0, 0.0], [0.1, 0.0], [0.0, 0.1]])
film = make_film(np.array([[0, 1, 2]]), flat[None], plane_stress_stiffness(1.0, 1.0, 0.3, 0.4), 3)
positions, free = np.c_[1.1 * flat, np.zeros(3)], np.array([False, False, True])
relaxation.relax(film, positions, free, np.zeros((3, 3)), tolerance_n=1e-12)
for kernel in (membrane.membrane_forces, membrane.assemble_tangent, relaxation.solve_step):
    assert sum(kernel.stats.cache_hits.values()) == 1 and not kernel.stats.cache_misses, kernel
"""
    subprocess.run([sys.executable, "-c", script], check=True, timeout=60)
