"""Film as constant-strain triangles that carry tension only: forces, stiffness, permanent set and tearing.

An element maps reference coordinates (X along the machine direction MD, Y along the transverse direction TD) to
space by F = [x1 − x0, x2 − x0]·Dm⁻¹, Dm = [X1 − X0, X2 − X0]. With U = √(FᵀF) its strain is the engineering
(Biot) strain E = U − I − Ep, Ep the permanent set, so that a pull along MD gives exactly F = E1·t·w·ΔL/L. Its
energy for each unit of reference area is Pipkin's relaxed one (IMA J. Appl. Math. 36, 1986),

    W(E) = min over γ ≥ 0, n of ½·(E + γ·n⊗n) : A : (E + γ·n⊗n) = max over T ⪰ 0 of T : E − ½·T : S : T,  S = A⁻¹

the wrinkles γ·n⊗n costing nothing. The maximum is A:E where that pulls in every direction (taut), zero where
nothing is stretched (slack), and otherwise uniaxial tension T = (E_tt/S_tttt)·t⊗t along the wrinkles, where t
makes E_tt²/S_tttt largest: E_tn·S_tttt = E_tt·S_tttn. Forces are exact derivatives of the energy.

All compiled kernels that share the material law stand in this file: numba's disk cache looks at the file of the
kernel it loads, not at the files of the functions which that one calls.

Units are SI; stiffness and membrane forces are N/m (stress times thickness), strains and set in tensor components
11 (MD), 22 (TD), 12. Arrays: positions [n, 3], triangles [m, 3], inverse_reference [m, 2, 2], area [m], stiffness
[m, 4] as A11, A22, A12, A66, set_strain [m, 3], torn [m]; float64, int64 and bool, contiguous.
"""

from collections.abc import Callable
from typing import TypeVar, cast

import numpy as np
from numba import njit
from numpy.typing import NDArray

from sim_core.frames import Array

Indices = NDArray[np.int64]
Flags = NDArray[np.bool_]
Kernel = TypeVar("Kernel", bound=Callable[..., object])

SLACK, WRINKLED, TAUT = 0, 1, 2
CHUNK = 64
"""Elements whose forces are computed side by side."""
FLATTEST = 1.0e-12
"""Triangles pressed flatter than this share of their size have no direction across: they push nothing there."""


def compiled(function: Kernel) -> Kernel:
    """The function as serial machine code, cached on disk; division by zero gives inf or NaN, as in NumPy."""
    return cast(Kernel, njit(cache=True, fastmath=False, error_model="numpy")(function))


@compiled
def _stretch(
    positions: Array, corners: Indices, inverse: Array
) -> tuple[tuple[float, ...], tuple[float, ...], float, float, float, float]:
    """Columns of F, then U11, U22, U12 and det U of one element."""
    a, b, c = corners[0], corners[1], corners[2]
    p0, p1, p2 = positions[a, 0], positions[a, 1], positions[a, 2]
    d10, d11, d12 = positions[b, 0] - p0, positions[b, 1] - p1, positions[b, 2] - p2
    d20, d21, d22 = positions[c, 0] - p0, positions[c, 1] - p1, positions[c, 2] - p2
    i00, i01, i10, i11 = inverse[0, 0], inverse[0, 1], inverse[1, 0], inverse[1, 1]
    f10, f11, f12 = d10 * i00 + d20 * i10, d11 * i00 + d21 * i10, d12 * i00 + d22 * i10
    f20, f21, f22 = d10 * i01 + d20 * i11, d11 * i01 + d21 * i11, d12 * i01 + d22 * i11
    c11 = f10 * f10 + f11 * f11 + f12 * f12
    c22 = f20 * f20 + f21 * f21 + f22 * f22
    c12 = f10 * f20 + f11 * f21 + f12 * f22
    # det U = |f1 × f2|: det C would lose half of the digits of a flat triangle.
    n0, n1, n2 = f11 * f22 - f12 * f21, f12 * f20 - f10 * f22, f10 * f21 - f11 * f20
    det = np.sqrt(n0 * n0 + n1 * n1 + n2 * n2)
    trace = np.sqrt(c11 + c22 + 2.0 * det)
    over = 1.0 / trace if trace > 0.0 else 0.0
    first, second = (f10, f11, f12), (f20, f21, f22)
    return first, second, (c11 + det) * over, (c22 + det) * over, c12 * over, det


@compiled
def _principal(m11: float, m22: float, m12: float) -> tuple[float, float, float, float]:
    """Larger and smaller eigenvalue of a symmetric matrix, and the larger one's unit direction."""
    middle, half = 0.5 * (m11 + m22), 0.5 * (m11 - m22)
    radius = np.sqrt(half * half + m12 * m12)
    if radius == 0.0:
        return middle, middle, 1.0, 0.0
    if half >= 0.0:
        cosine = np.sqrt(0.5 * (1.0 + half / radius))
        return middle + radius, middle - radius, cosine, m12 / (2.0 * radius * cosine)
    sine = np.sqrt(0.5 * (1.0 - half / radius))
    return middle + radius, middle - radius, m12 / (2.0 * radius * sine), sine


@compiled
def _compliance(a: Array) -> tuple[float, float, float, float]:
    """S1111, S2222, S1122 and 1/(2·A66) [m/N]."""
    over = 1.0 / (a[0] * a[1] - a[2] * a[2])
    return a[1] * over, a[0] * over, -a[2] * over, 0.5 / a[3]


@compiled
def _wrinkles(
    e11: float, e22: float, e12: float, s: tuple[float, float, float, float]
) -> tuple[float, float, float, float]:
    """Direction along the wrinkles (unit vector), E_tt and S_tttt there.

    With z the tangent of the angle from the principal direction of the strain (e1, e2), E_tt·(1 + z²) =
    e1 + e2·z² and p(z) = (1 + z²)²·S_tttt is of fourth degree. E_tt²/S_tttt is largest where
    r(z) = 4·e2·z·p − (e1 + e2·z²)·p' falls through zero, and the fifth powers in r cancel.
    """
    e1, e2, c, q = _principal(e11, e22, e12)
    cc, qq, cq, cross = c * c, q * q, c * q, 2.0 * (s[2] + s[3])
    p0 = s[0] * cc * cc + s[1] * qq * qq + cross * cq * cq
    p1 = cq * (4.0 * (s[1] * qq - s[0] * cc) + 2.0 * cross * (cc - qq))
    p2 = 6.0 * (s[0] + s[1]) * cq * cq + cross * (cc * cc + qq * qq - 4.0 * cq * cq)
    p3 = cq * (4.0 * (s[1] * cc - s[0] * qq) - 2.0 * cross * (cc - qq))
    p4 = s[0] * qq * qq + s[1] * cc * cc + cross * cq * cq
    r0, r1, r2 = -e1 * p1, 4.0 * e2 * p0 - 2.0 * e1 * p2, 3.0 * (e2 * p1 - e1 * p3)
    r3, r4 = 2.0 * e2 * p2 - 4.0 * e1 * p4, e2 * p3
    z = 0.0
    for attempt in range(2):
        if attempt == 1:
            z = _highest(e1, e2, p0, p1, p2, p3, p4)
        for _ in range(12):
            rise = r0 + z * (r1 + z * (r2 + z * (r3 + z * r4)))
            slope = r1 + z * (2.0 * r2 + z * (3.0 * r3 + z * 4.0 * r4))
            bend = 2.0 * r2 + z * (6.0 * r3 + z * 12.0 * r4)
            move = 2.0 * rise * slope / (2.0 * slope * slope - rise * bend)
            z -= move
            # Halley's step is cubic: what is left is below 1e-12.
            if abs(move) < 1e-4:
                break
        over = 1.0 / (1.0 + z * z)
        root = np.sqrt(over)
        cosine, sine = (c - z * q) * root, (q + z * c) * root
        ett, enn = (e1 + e2 * z * z) * over, (e1 * z * z + e2) * over
        stttt = (p0 + z * (p1 + z * (p2 + z * (p3 + z * p4)))) * over * over
        cs = cosine * sine
        snntt = s[2] + (s[0] + s[1] - 2.0 * s[2] - 2.0 * s[3]) * cs * cs
        # The energy is convex: pulled along, and wrinkles of positive width across, it is the right one.
        if abs(move) < 1e-4 and ett > 0.0 and ett * snntt - enn * stttt >= -1e-9 * (ett + abs(enn)) * stttt:
            break
    return cosine, sine, ett, stttt


@compiled
def _highest(e1: float, e2: float, p0: float, p1: float, p2: float, p3: float, p4: float) -> float:
    """tan(angle) at which E_tt²/S_tttt is largest, by bisection beside the best of 32 directions."""
    best, at = -np.inf, 0
    for k in range(-16, 16):
        z = np.tan(np.pi * (k + 0.5) / 32.0)
        pull = e1 + e2 * z * z
        value = pull * abs(pull) / (p0 + z * (p1 + z * (p2 + z * (p3 + z * p4))))
        if value > best:
            best, at = value, k
    low, high = np.pi * (at - 0.499) / 32.0, np.pi * (at + 1.499) / 32.0
    for _ in range(40):
        middle = 0.5 * (low + high)
        z = np.tan(middle)
        p = p0 + z * (p1 + z * (p2 + z * (p3 + z * p4)))
        slope = p1 + z * (2.0 * p2 + z * (3.0 * p3 + z * 4.0 * p4))
        if 4.0 * e2 * z * p > (e1 + e2 * z * z) * slope:
            low = middle
        else:
            high = middle
    return float(np.tan(0.5 * (low + high)))


@compiled
def _tension(e11: float, e22: float, e12: float, a: Array) -> tuple[float, float, float, float, int]:
    """Membrane force T11, T22, T12 [N/m], energy W [J/m²] and regime of an elastic strain."""
    t11, t22, t12 = a[0] * e11 + a[2] * e22, a[2] * e11 + a[1] * e22, 2.0 * a[3] * e12
    if t11 + t22 >= 0.0 and t11 * t22 >= t12 * t12:
        return t11, t22, t12, 0.5 * (t11 * e11 + t22 * e22) + t12 * e12, TAUT
    if e11 + e22 <= 0.0 and e11 * e22 >= e12 * e12:
        return 0.0, 0.0, 0.0, 0.0, SLACK
    cosine, sine, ett, stttt = _wrinkles(e11, e22, e12, _compliance(a))
    pull = max(ett, 0.0) / stttt
    return (
        pull * cosine * cosine,
        pull * sine * sine,
        pull * cosine * sine,
        0.5 * pull * max(ett, 0.0),
        WRINKLED,
    )


@compiled
def _second_order(
    t11: float, t22: float, t12: float, u11: float, u22: float, u12: float, det: float
) -> tuple[float, float, float]:
    """K with U·K + K·U = 2·T, so that ∂W/∂F = F·K."""
    trace = u11 + u22
    if trace <= 0.0:
        return 0.0, 0.0, 0.0
    # adj(U)·T·adj(U), with adj(U) = [[u22, −u12], [−u12, u11]].
    m11 = u22 * u22 * t11 - 2.0 * u12 * u22 * t12 + u12 * u12 * t22
    m22 = u12 * u12 * t11 - 2.0 * u12 * u11 * t12 + u11 * u11 * t22
    m12 = (u11 * u22 + u12 * u12) * t12 - u12 * (u22 * t11 + u11 * t22)
    over = 1.0 / max(det, FLATTEST * trace * trace)
    return (t11 + m11 * over) / trace, (t22 + m22 * over) / trace, (t12 + m12 * over) / trace


@compiled
def membrane_forces(
    positions: Array,
    triangles: Indices,
    inverse_reference: Array,
    area: Array,
    stiffness: Array,
    set_strain: Array,
    torn: Flags,
    forces: Array,
) -> float:
    """Writes the film's force on each node [N] into ``forces``, shape [n, 3], and gives its energy [J]."""
    forces[:] = 0.0
    energy = 0.0
    # Shape, law and forces of some elements each in a loop of its own: the processor guesses their branches better.
    shapes, pulls, found = np.empty((CHUNK, 10)), np.empty((CHUNK, 3)), np.empty(CHUNK, np.int64)
    for start in range(0, len(triangles), CHUNK):
        end = min(start + CHUNK, len(triangles))
        for k in range(start, end):
            f, g, u11, u22, u12, det = _stretch(positions, triangles[k], inverse_reference[k])
            shape = shapes[k - start]
            for row in range(3):
                shape[row], shape[3 + row] = f[row], g[row]
            shape[6], shape[7], shape[8], shape[9] = u11, u22, u12, det
        count = 0
        for k in range(start, end):
            if torn[k]:
                continue
            shape = shapes[k - start]
            e11, e22, e12 = (
                shape[6] - 1.0 - set_strain[k, 0],
                shape[7] - 1.0 - set_strain[k, 1],
                shape[8] - set_strain[k, 2],
            )
            t11, t22, t12, density, regime = _tension(e11, e22, e12, stiffness[k])
            if regime == SLACK:
                continue
            energy += area[k] * density
            found[count] = k
            pulls[count, 0], pulls[count, 1], pulls[count, 2] = t11, t22, t12
            count += 1
        for at in range(count):
            k = found[at]
            shape, inverse = shapes[k - start], inverse_reference[k]
            k11, k22, k12 = _second_order(
                pulls[at, 0], pulls[at, 1], pulls[at, 2], shape[6], shape[7], shape[8], shape[9]
            )
            for row in range(3):
                f1, g1 = shape[row], shape[3 + row]
                p1, p2 = area[k] * (f1 * k11 + g1 * k12), area[k] * (f1 * k12 + g1 * k22)
                on_second = p1 * inverse[0, 0] + p2 * inverse[0, 1]
                on_third = p1 * inverse[1, 0] + p2 * inverse[1, 1]
                forces[triangles[k, 0], row] += on_second + on_third
                forces[triangles[k, 1], row] -= on_second
                forces[triangles[k, 2], row] -= on_third
    return energy


@compiled
def assemble_tangent(
    positions: Array,
    triangles: Indices,
    inverse_reference: Array,
    area: Array,
    stiffness: Array,
    set_strain: Array,
    torn: Flags,
    slots: Indices,
    blocks: Array,
) -> None:
    """Writes the tangent stiffness [N/m] into ``blocks``, shape [block_count, 3, 3], as a sparse matrix's blocks.

    It is the energy's exact second derivative; where the regime changes, the one of the regime at hand.

    Args:
        slots: where the block of an element's corners i and j stands in ``blocks``, shape [m, 3, 3].
    """
    blocks[:] = 0.0
    rows, pulls, push = np.empty((4, 9)), np.empty((4, 9)), np.empty((3, 3))
    law, normal = np.empty((4, 4)), np.empty(3)
    for k in range(len(triangles)):
        if torn[k] or not _element_tangent(
            positions,
            triangles[k],
            inverse_reference[k],
            stiffness[k],
            set_strain[k],
            rows,
            law,
            push,
            normal,
        ):
            continue
        for at in range(9):
            for one in range(4):
                pulls[one, at] = area[k] * (
                    law[one, 0] * rows[0, at]
                    + law[one, 1] * rows[1, at]
                    + law[one, 2] * rows[2, at]
                    + law[one, 3] * rows[3, at]
                )
        for i in range(3):
            for j in range(3):
                block = blocks[slots[k, i, j]]
                bend = area[k] * push[i, j]
                for row in range(3):
                    for column in range(3):
                        p, q = 3 * i + row, 3 * j + column
                        block[row, column] += (
                            rows[0, p] * pulls[0, q]
                            + rows[1, p] * pulls[1, q]
                            + rows[2, p] * pulls[2, q]
                            + rows[3, p] * pulls[3, q]
                            + bend * normal[row] * normal[column]
                        )


@compiled
def assemble_along(
    positions: Array,
    triangles: Indices,
    inverse_reference: Array,
    area: Array,
    stiffness: Array,
    set_strain: Array,
    torn: Flags,
    slots: Indices,
    even_count: int,
    even_ways: Array,
    odd_ways: Array,
    ranks: Indices,
    blocks: Array,
) -> None:
    """As :func:`assemble_tangent`, along the nodes' ways; only blocks whose row's node has the lower rank or the same.

    Args:
        even_count: elements in even cells, which come first.
        even_ways: ways to move as even cells see them, or zeros, shape [n, 3, 3], a way a row.
        odd_ways: the same for odd cells.
        ranks: of the nodes, shape [n].
    """
    blocks[:] = 0.0
    rows, push, law, normal = np.empty((4, 9)), np.empty((3, 3)), np.empty((4, 4)), np.empty(3)
    along, pulls = np.empty((5, 9)), np.empty((4, 9))
    for k in range(len(triangles)):
        if torn[k] or not _element_tangent(
            positions,
            triangles[k],
            inverse_reference[k],
            stiffness[k],
            set_strain[k],
            rows,
            law,
            push,
            normal,
        ):
            continue
        ways = even_ways if k < even_count else odd_ways
        for i in range(3):
            node = triangles[k, i]
            for a in range(3):
                x, y, z = ways[node, a, 0], ways[node, a, 1], ways[node, a, 2]
                for one in range(4):
                    along[one, 3 * i + a] = (
                        rows[one, 3 * i] * x + rows[one, 3 * i + 1] * y + rows[one, 3 * i + 2] * z
                    )
                along[4, 3 * i + a] = normal[0] * x + normal[1] * y + normal[2] * z
        for at in range(9):
            for one in range(4):
                pulls[one, at] = area[k] * (
                    law[one, 0] * along[0, at]
                    + law[one, 1] * along[1, at]
                    + law[one, 2] * along[2, at]
                    + law[one, 3] * along[3, at]
                )
        for i in range(3):
            for j in range(3):
                if ranks[triangles[k, i]] > ranks[triangles[k, j]]:
                    continue
                block = blocks[slots[k, i, j]]
                bend = area[k] * push[i, j]
                for row in range(3):
                    for column in range(3):
                        p, q = 3 * i + row, 3 * j + column
                        block[row, column] += (
                            along[0, p] * pulls[0, q]
                            + along[1, p] * pulls[1, q]
                            + along[2, p] * pulls[2, q]
                            + along[3, p] * pulls[3, q]
                            + bend * along[4, p] * along[4, q]
                        )


@compiled
def _element_tangent(
    positions: Array,
    corners: Indices,
    inverse: Array,
    stiffness: Array,
    set_strain: Array,
    rows: Array,
    law: Array,
    push: Array,
    normal: Array,
) -> bool:
    """Writes what an element's tangent for each unit of its area is made of; False where it has no stiffness.

    The stiffness of corner i's motion p for corner j's motion q is rows[:, 3i + p]·law·rows[:, 3j + q] in the film's
    plane and push[i, j]·normal[p]·normal[q] across it.

    Args:
        rows: filled with slopes of U11, U22, 2·U12 and of the turn over the corners' motions, shape [4, 9].
        law: filled with slopes of the forces over these, shape [4, 4].
        push: filled, shape [3, 3].
        normal: filled, unit vector.
    """
    f, g, u11, u22, u12, det = _stretch(positions, corners, inverse)
    e11, e22, e12 = u11 - 1.0 - set_strain[0], u22 - 1.0 - set_strain[1], u12 - set_strain[2]
    t11, t22, t12, _, regime = _tension(e11, e22, e12, stiffness)
    trace = u11 + u22
    if regime == SLACK or det <= 1e-6 * trace * trace:
        return False
    _tension_slope(e11, e22, e12, stiffness, regime, law)
    k11, k22, k12 = _second_order(t11, t22, t12, u11, u22, u12, det)
    normal[0] = (f[1] * g[2] - f[2] * g[1]) / det
    normal[1] = (f[2] * g[0] - f[0] * g[2]) / det
    normal[2] = (f[0] * g[1] - f[1] * g[0]) / det
    for i in range(3):
        b1 = inverse[i - 1, 0] if i > 0 else -inverse[0, 0] - inverse[1, 0]
        b2 = inverse[i - 1, 1] if i > 0 else -inverse[0, 1] - inverse[1, 1]
        for j in range(3):
            c1 = inverse[j - 1, 0] if j > 0 else -inverse[0, 0] - inverse[1, 0]
            c2 = inverse[j - 1, 1] if j > 0 else -inverse[0, 1] - inverse[1, 1]
            push[i, j] = b1 * (k11 * c1 + k12 * c2) + b2 * (k12 * c1 + k22 * c2)
        for row in range(3):
            # Columns of R = F·U⁻¹, and how fast R turns in the film's plane.
            r1, r2 = (f[row] * u22 - g[row] * u12) / det, (g[row] * u11 - f[row] * u12) / det
            turn = (r2 * b1 - r1 * b2) / trace
            at = 3 * i + row
            rows[0, at] = r1 * b1 + u12 * turn
            rows[1, at] = r2 * b2 - u12 * turn
            rows[2, at] = r1 * b2 + r2 * b1 + (u22 - u11) * turn
            rows[3, at] = turn
    # The second variation of U: T : δ²U = K : (HᵀH − δU²) with RᵀδF = H = ω·J·U + δU.
    n11, n12 = u11 * k11 + u12 * k12, u11 * k12 + u12 * k22
    n21, n22 = u12 * k11 + u22 * k12, u12 * k12 + u22 * k22
    law[3, 0], law[3, 1], law[3, 2] = -n21, n12, 0.5 * (n11 - n22)
    law[3, 3] = n11 * u11 + (n12 + n21) * u12 + n22 * u22
    for one in range(3):
        law[one, 3] = law[3, one]
    return True


@compiled
def _tension_slope(e11: float, e22: float, e12: float, a: Array, regime: int, law: Array) -> None:
    """Writes ∂(T11, T22, T12)/∂(E11, E22, 2·E12) of a taut or wrinkled strain into ``law``, shape [≥3, ≥3]."""
    if regime == TAUT:
        law[:] = 0.0
        law[0, 0], law[1, 1], law[2, 2], law[0, 1], law[1, 0] = a[0], a[1], a[3], a[2], a[2]
        return
    s11, s22, s12, shear = s = _compliance(a)
    c, q, ett, stttt = _wrinkles(e11, e22, e12, s)
    cc, qq, cq = c * c, q * q, c * q
    alpha, beta = s12 + shear - s11, s22 - s12 - shear
    stttn = cq * (alpha * cc + beta * qq)
    enn, etn = qq * e11 + cc * e22 - 2.0 * cq * e12, cq * (e22 - e11) + (cc - qq) * e12
    # Slope over the angle of E_tn·S_tttt − E_tt·S_tttn: the wrinkles turn with the strain.
    turning = (
        (ett - enn) * stttt
        - 2.0 * etn * stttn
        + ett * ((cc - qq) * (alpha * cc + beta * qq) + 2.0 * cq * cq * (beta - alpha))
    )
    along, ratio = (cc, qq, cq), stttn / stttt
    across = (-cq - ratio * cc, cq - ratio * qq, 0.5 * (cc - qq) - ratio * cq)
    sideways = 2.0 * ett / turning if turning > 0.0 else 0.0
    for i in range(3):
        for j in range(3):
            law[i, j] = along[i] * along[j] / stttt + sideways * across[i] * across[j]


@compiled
def membrane_state(
    positions: Array,
    triangles: Indices,
    inverse_reference: Array,
    stiffness: Array,
    set_strain: Array,
    torn: Flags,
    strains: Array,
    principal_forces: Array,
) -> None:
    """Writes what each element shows: its strain, and the force that it carries.

    Args:
        strains: total E11, E22, E12 (set included), then the larger and smaller principal strain, shape [m, 5].
        principal_forces: larger and smaller principal membrane force [N/m], shape [m, 2]; torn ones carry none.
    """
    for k in range(len(triangles)):
        _, _, u11, u22, u12, _ = _stretch(positions, triangles[k], inverse_reference[k])
        e11, e22 = u11 - 1.0, u22 - 1.0
        strains[k, 0], strains[k, 1], strains[k, 2] = e11, e22, u12
        strains[k, 3], strains[k, 4], _, _ = _principal(e11, e22, u12)
        t11, t22, t12, _, _ = _tension(
            e11 - set_strain[k, 0], e22 - set_strain[k, 1], u12 - set_strain[k, 2], stiffness[k]
        )
        if torn[k]:
            t11, t22, t12 = 0.0, 0.0, 0.0
        principal_forces[k, 0], principal_forces[k, 1], _, _ = _principal(t11, t22, t12)


@compiled
def yield_film(
    positions: Array,
    triangles: Indices,
    inverse_reference: Array,
    area: Array,
    stiffness: Array,
    set_strain: Array,
    torn: Flags,
    yield_force: Array,
    tangent_ratio: float,
) -> tuple[float, int]:
    """Lets overloaded elements flow along their largest pull, once a step; nodes stay where they are.

    In uniaxial tension the force then rises with ``tangent_ratio`` times the elastic slope. The set strain grows
    along the pull alone: neck-in beyond the elastic one isn't modelled.

    Args:
        set_strain: grows in place.
        yield_force: largest principal membrane force that is still elastic [N/m], shape [m]; hardens in place.
        tangent_ratio: slope after yield over slope before it, in [0, 1).

    Returns:
        Elastic energy given up [J], which is what the flow and the hardening take, and the number of elements.
    """
    lost, count = 0.0, 0
    for k in range(len(triangles)):
        if torn[k]:
            continue
        _, _, u11, u22, u12, _ = _stretch(positions, triangles[k], inverse_reference[k])
        before = -1.0
        after = 0.0
        for _ in range(50):
            e11, e22, e12 = (
                u11 - 1.0 - set_strain[k, 0],
                u22 - 1.0 - set_strain[k, 1],
                u12 - set_strain[k, 2],
            )
            t11, t22, t12, after, regime = _tension(e11, e22, e12, stiffness[k])
            pull, _, c, s = _principal(t11, t22, t12)
            if before < 0.0:
                before = after
            excess = pull - yield_force[k]
            if excess <= 1e-12 * yield_force[k]:
                break
            cc, ss, cs = c * c, s * s, c * s
            s11, s22, s12, shear = _compliance(stiffness[k])
            slope = 1.0 / (s11 * cc * cc + s22 * ss * ss + 2.0 * (s12 + shear) * cs * cs)
            hardening = slope * tangent_ratio / (1.0 - tangent_ratio)
            if regime == TAUT:
                a = stiffness[k]
                slope = a[0] * cc * cc + a[1] * ss * ss + 2.0 * (a[2] + 2.0 * a[3]) * cs * cs
            flow = excess / (slope + hardening)
            set_strain[k, 0] += flow * cc
            set_strain[k, 1] += flow * ss
            set_strain[k, 2] += flow * cs
            yield_force[k] += hardening * flow
        lost += area[k] * (before - after)
        count += before != after
    return lost, count


@compiled
def tear_film(
    positions: Array,
    triangles: Indices,
    inverse_reference: Array,
    area: Array,
    stiffness: Array,
    set_strain: Array,
    torn: Flags,
    break_strain: Array,
) -> tuple[Indices, float]:
    """Tears elements stretched beyond their break strain, once a step; torn ones carry nothing any more.

    An element tears where its largest principal strain e (total, set included), along a direction at θ to MD,
    passes the ellipse (e·cos θ/ε_MD)² + (e·sin θ/ε_TD)² = 1.

    Args:
        torn: set in place.
        break_strain: break strains along MD and TD, shape [m, 2].

    Returns:
        The newly torn elements, and the elastic energy lost with them [J].
    """
    newly, lost = np.empty(len(triangles), np.int64), 0.0
    count = 0
    for k in range(len(triangles)):
        if torn[k]:
            continue
        _, _, u11, u22, u12, _ = _stretch(positions, triangles[k], inverse_reference[k])
        e11, e22 = u11 - 1.0, u22 - 1.0
        largest, _, c, s = _principal(e11, e22, u12)
        reach = (largest * c / break_strain[k, 0]) ** 2 + (largest * s / break_strain[k, 1]) ** 2
        if largest > 0.0 and reach > 1.0:
            lost += (
                area[k]
                * _tension(
                    e11 - set_strain[k, 0], e22 - set_strain[k, 1], u12 - set_strain[k, 2], stiffness[k]
                )[3]
            )
            torn[k] = True
            newly[count] = k
            count += 1
    return newly[:count].copy(), lost
