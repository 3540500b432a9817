"""Closed forms and independent solutions that the physics is held against, without any rigid-body engine."""

from bisect import bisect_right
from collections.abc import Callable, Sequence

import numpy as np

from sim_core.force_fields import NEAREST_SHARE
from sim_core.frames import GRAVITY, Array


def trapezoid_travel_m(level_g: float, rise_s: float, hold_s: float, time_s: float) -> float:
    """Travel at a time of a sled that accelerates 0 -> A -> 0 (rise, hold, fall as long) and then coasts [m]."""
    knots = [0.0, rise_s, rise_s + hold_s, 2.0 * rise_s + hold_s]
    a = level_g * GRAVITY
    accelerations, slopes = [0.0, a, a, 0.0], [a / rise_s, 0.0, -a / rise_s, 0.0]
    travel = speed = 0.0
    for start, end, acceleration, slope in zip(
        knots, [*knots[1:], np.inf], accelerations, slopes, strict=True
    ):
        tau = min(time_s, end) - start
        if tau <= 0.0:
            break
        travel += speed * tau + acceleration * tau**2 / 2.0 + slope * tau**3 / 6.0
        speed += acceleration * tau + slope * tau**2 / 2.0
    return float(travel)


def trapezoid_slip_m(level_g: float, rise_s: float, hold_s: float, friction: float) -> float:
    """Slip of a block on a sled that accelerates 0 -> A -> 0 and then coasts, in closed form [m].

    The block sticks until t1 = t_r·μg/A, slides with v = v1 + μg·(t − t1), and rejoins the coasting sled at
    t2 = t1 + (V − v1)/(μg), with V = A·(t_r + t_h); valid if t2 comes after the fall.

    Raises:
        ValueError: the block would rejoin the sled before it coasts.
    """
    a, grip = level_g * GRAVITY, friction * GRAVITY
    t1 = rise_s * grip / a
    v1 = a * t1**2 / (2.0 * rise_s)
    t2 = t1 + (a * (rise_s + hold_s) - v1) / grip
    if t2 < 2.0 * rise_s + hold_s:
        raise ValueError(f"the block rejoins the sled at {t2:.3f} s, before it coasts")
    travel = [trapezoid_travel_m(level_g, rise_s, hold_s, t) for t in (t1, t2)]
    return travel[1] - travel[0] - v1 * (t2 - t1) - grip * (t2 - t1) ** 2 / 2.0


def tipping_level_g(depth_m: float, height_m: float) -> float:
    """Constant level above which a box that doesn't slide tips, b/h of its centre of mass [g]."""
    return depth_m / height_m


def pushed_slides_m(
    level_g: float, pulse_s: float, gap_m: float, friction: float, *, mass_ratio: float = 1.0
) -> tuple[float, float]:
    """Slips of a frictionless block that runs into a block of friction μ across a gap [m], in closed form.

    A rectangular pulse A·t_p gives the first one the speed V = A·t_p; it meets the second, which sticks
    (A ≤ μg), after the pulse. They go on as one, without rebound, at V·m1/(m1 + m2), and only the second
    one's friction brakes both: s = v²·(m1 + m2)/(2μg·m2).

    Args:
        level_g: A [g].
        pulse_s: t_p [s].
        gap_m: between the blocks [m], longer than the way during the pulse.
        friction: μ of the second block.
        mass_ratio: m1/m2.
    """
    speed = level_g * GRAVITY * pulse_s
    if gap_m < speed * pulse_s / 2.0 or level_g > friction:
        raise ValueError("the blocks must meet after the pulse, and the second must stick until then")
    common = speed * mass_ratio / (1.0 + mass_ratio)
    slide = common**2 * (1.0 + mass_ratio) / (2.0 * friction * GRAVITY)
    return gap_m + slide, slide


def slab_slips_m(
    masses: Sequence[float],
    frictions: Sequence[float],
    level_g: float,
    rise_s: float,
    hold_s: float,
    end_s: float,
    *,
    step_s: float = 2.0e-4,
) -> Array:
    """Slip of every slab of a stack relative to the sled at a time [m], bottom first.

    m_i·dv_i/dt = f_i − f_(i+1) with |f_i| ≤ μ_i·g·Σ_(j≥i) m_j, stepped implicitly: interface forces that would
    bring neighbours to one velocity within the step, clamped, in Gauss-Seidel sweeps until they stand.
    """
    h, a = step_s, level_g * GRAVITY
    n = len(masses)
    grips = [mu * GRAVITY * sum(masses[i:]) * h for i, mu in enumerate(frictions)]
    ends = [0.0, rise_s, rise_s + hold_s, 2.0 * rise_s + hold_s]
    v, x = [0.0] * n, [0.0] * n
    impulse = [0.0] * n
    sled_v = sled_x = 0.0
    for step in range(round(end_s / h)):
        dv = float(np.interp((step + 0.5) * h, ends, [0.0, a, a, 0.0])) * h
        sled_x, sled_v = sled_x + (sled_v + dv / 2.0) * h, sled_v + dv
        v_start = list(v)
        for i in range(n):  # the last step's impulses are the best guess at this one's
            v[i] += (impulse[i] - (impulse[i + 1] if i + 1 < n else 0.0)) / masses[i]
        for _ in range(400):
            moved = 0.0
            for i in range(n):
                below = sled_v if i == 0 else v[i - 1]
                inverse = 1.0 / masses[i] + (0.0 if i == 0 else 1.0 / masses[i - 1])
                wanted = min(max(impulse[i] + (below - v[i]) / inverse, -grips[i]), grips[i])
                change = wanted - impulse[i]
                impulse[i] = wanted
                v[i] += change / masses[i]
                if i:
                    v[i - 1] -= change / masses[i - 1]
                moved = max(moved, abs(change))
            if moved < 1.0e-12:
                break
        x = [place + (before + now) / 2.0 * h for place, before, now in zip(x, v_start, v, strict=True)]
    return sled_x - np.array(x)


def field_motion_m(
    *,
    mass_kg: float,
    strength_n: float,
    distance_m: float,
    falloff: float,
    friction: float,
    knots_s: Sequence[float],
    acceleration_mps2: Sequence[float],
    end_s: float,
    step_s: float = 1.0e-4,
) -> Array:
    """Displacement over time of one package between two facing force fields, with Coulomb friction [m].

    m·dv/dt = −m·a(t) − F·[φ(d − x) − φ(d + x)] − μ·m·g·sign(v), φ(r) = (d/max(r, d/10))^p (the formula of
    ``sim_core/force_fields.py`` for one package), classical Runge-Kutta. A stop is found within its
    step by bisection; there the package stays until the other forces exceed μ·m·g.

    Returns:
        Rows of time [s], displacement [m] and velocity [m/s], shape [n, 3].
    """
    grip = friction * GRAVITY

    def pull(t: float, x: float) -> float:
        """Acceleration by everything but friction."""
        k = min(max(bisect_right(knots_s, t) - 1, 0), len(knots_s) - 2)
        share = (t - knots_s[k]) / (knots_s[k + 1] - knots_s[k])
        sled = acceleration_mps2[k] + share * (acceleration_mps2[k + 1] - acceleration_mps2[k])
        if t >= knots_s[-1]:
            sled = 0.0
        near, far = (max(r, NEAREST_SHARE * distance_m) for r in (distance_m - x, distance_m + x))
        press = (distance_m / near) ** falloff - (distance_m / far) ** falloff
        return float(-sled - strength_n / mass_kg * press)

    t, x, v = 0.0, 0.0, 0.0
    rows = [(t, x, v)]
    while t < end_s - 1.0e-12:
        h = min(step_s, end_s - t)
        heading = float(np.sign(v) or np.sign(pull(t + h, x)))

        def net(s: float, y: float, drag: float = heading * grip) -> float:
            return pull(s, y) - drag

        new_x, new_v = _runge_kutta(net, t, x, v, h)
        if new_v * heading <= 0.0:
            h = h if v == 0.0 else _stop_within(net, t, x, v, h)
            new_x, new_v = (x if v == 0.0 else _runge_kutta(net, t, x, v, h)[0]), 0.0
        t, x, v = t + h, new_x, new_v
        rows.append((t, x, v))
    return np.array(rows)


def _runge_kutta(
    force: Callable[[float, float], float], t: float, x: float, v: float, h: float
) -> tuple[float, float]:
    k1 = force(t, x)
    k2 = force(t + h / 2.0, x + h / 2.0 * v)
    k3 = force(t + h / 2.0, x + h / 2.0 * (v + h / 2.0 * k1))
    k4 = force(t + h, x + h * (v + h / 2.0 * k2))
    return x + h * v + h**2 / 6.0 * (k1 + k2 + k3), v + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)


def _stop_within(force: Callable[[float, float], float], t: float, x: float, v: float, h: float) -> float:
    low, high = 0.0, h
    for _ in range(40):
        middle = 0.5 * (low + high)
        still_moving = _runge_kutta(force, t, x, v, middle)[1] * v > 0.0
        low, high = (middle, high) if still_moving else (low, middle)
    return high
