"""Sliding blocks and slabs on a trapezoid sled, without any rigid-body engine."""

import numpy as np

GRAVITY = 9.81


def trapezoid_slip_m(level_g: float, rise_s: float, hold_s: float, friction: float) -> float:
    """Slip of a block on a sled that accelerates 0 -> A -> 0 and then coasts, in closed form [m].

    The block sticks until t1 = t_r·μg/A, slides with v = v1 + μg·(t − t1), and rejoins the coasting sled at
    t2 = t1 + (V − v1)/(μg), with V = A·(t_r + t_h); valid if t2 comes after the fall.
    """
    a, grip = level_g * GRAVITY, friction * GRAVITY
    t1 = rise_s * grip / a
    v1 = a * t1**2 / (2.0 * rise_s)
    speed = a * (rise_s + hold_s)
    t2 = t1 + (speed - v1) / grip
    assert t2 >= 2.0 * rise_s + hold_s

    def travel(t: float) -> float:
        if t <= rise_s:
            return a * t**3 / (6.0 * rise_s)
        at_rise = a * rise_s**2 / 6.0
        if t <= rise_s + hold_s:
            tau = t - rise_s
            return at_rise + a * rise_s / 2.0 * tau + a * tau**2 / 2.0
        at_hold = at_rise + a * rise_s / 2.0 * hold_s + a * hold_s**2 / 2.0
        v_hold = a * (rise_s / 2.0 + hold_s)
        if t <= 2.0 * rise_s + hold_s:
            tau = t - rise_s - hold_s
            return at_hold + v_hold * tau + a * tau**2 / 2.0 - a * tau**3 / (6.0 * rise_s)
        at_fall = at_hold + v_hold * rise_s + a * rise_s**2 / 3.0
        return at_fall + speed * (t - 2.0 * rise_s - hold_s)

    return travel(t2) - travel(t1) - v1 * (t2 - t1) - grip * (t2 - t1) ** 2 / 2.0


def slab_slips_m(
    masses: list[float], frictions: list[float], level_g: float, rise_s: float, hold_s: float, end_s: float
) -> np.ndarray:
    """Slip of every slab of a stack relative to the sled at a time [m], bottom first.

    m_i·dv_i/dt = f_i − f_(i+1) with |f_i| ≤ μ_i·g·Σ_(j≥i) m_j, stepped implicitly: interface forces that would
    bring neighbours to one velocity within the step, clamped, in Gauss-Seidel sweeps until they stand.
    """
    h, a = 2.0e-4, level_g * GRAVITY
    n = len(masses)
    grips = [mu * GRAVITY * sum(masses[i:]) * h for i, mu in enumerate(frictions)]
    v, x = np.zeros(n), np.zeros(n)
    sled_v = sled_x = 0.0

    def acceleration(t: float) -> float:
        if t < rise_s:
            return a * t / rise_s
        if t < rise_s + hold_s:
            return a
        return max(0.0, a * (1.0 - (t - rise_s - hold_s) / rise_s))

    for step in range(round(end_s / h)):
        dv = acceleration((step + 0.5) * h) * h
        sled_x, sled_v = sled_x + (sled_v + dv / 2.0) * h, sled_v + dv
        v_start, impulse = v.copy(), np.zeros(n)
        for _ in range(200):
            moved = 0.0
            for i in range(n):
                below = sled_v if i == 0 else v[i - 1]
                inverse = 1.0 / masses[i] + (0.0 if i == 0 else 1.0 / masses[i - 1])
                wanted = float(np.clip(impulse[i] + (below - v[i]) / inverse, -grips[i], grips[i]))
                change = wanted - impulse[i]
                impulse[i] = wanted
                v[i] += change / masses[i]
                if i:
                    v[i - 1] -= change / masses[i - 1]
                moved = max(moved, abs(change))
            if moved < 1.0e-12:
                break
        x += (v_start + v) / 2.0 * h
    return sled_x - x
