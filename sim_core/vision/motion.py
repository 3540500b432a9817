"""How rigid faces moved, from points on them: robust, all packages at once, with covariance.

A package moves along the side's ``right`` (a), up (h) and turns in the picture's plane (φ, counter-clockwise): that is
what is looked for. It may also come nearer (δ) and turn about the upright (ψ) and the level axis (χ) of its face. As a
point is taken to have kept its depth, a point that came nearer by e seems shifted away from the foot f of the camera's
perpendicular on the plane, by (p − f)·e/D with the camera's distance D. The six are fitted together; δ, ψ and χ, of
which a single camera sees little, are held near zero by how far they go in practice.
"""

from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from sim_core.frames import Array

Flags = NDArray[np.bool_]

_HYPOTHESES = 32
_ITERATIONS, _FIRST_ITERATIONS = 8, 3
FREE = (0.03, 0.1, 0.1)
"""How far δ [m], ψ and χ [rad] are let go at first, to see whether they explain what the points do."""
CLEARLY_BETTER, MOST_AGREE = 20.0, 0.7
"""How many variances of a point the sum of squares has to fall by, and how many of the points have to agree, for that
to be believed: few points let themselves be explained by anything."""
NEARER_M, TURNED_RAD = 3.0e-4, 1.0e-3
"""How far packages that hardly move come nearer, or turn out of the picture's plane: standard deviations, as simulated
loads on a EUR pallet do at 0.3 g to 0.8 g."""
NEARER_SHARE, TURNED_SHARE = 0.03, 0.05
"""And what is added for each metre that a package moved: m/m and rad/m."""


@dataclass(frozen=True, eq=False)
class Motions:
    """Motions of all faces, one a row.

    Attributes:
        centre: displacement of the face's centre along right and up [m], shape [n, 2].
        turn: φ [rad], shape [n].
        outward: δ [m], ψ and χ [rad], shape [n, 3].
        covariance: of a, h, φ, δ, ψ, χ, shape [n, 6, 6].
        spread_m: robust standard deviation of the points' residuals [m], shape [n].
        used: how many points agree, shape [n].
        share: of the points that could be looked for, shape [n].
        comes_out: whether a large δ, ψ or χ would explain much better what the points do, shape [n].
    """

    centre: Array
    turn: Array
    outward: Array
    covariance: Array
    spread_m: Array
    used: NDArray[np.intp]
    share: Array
    comes_out: Flags

    def replaced(self, others: "Motions", where: NDArray[np.bool_]) -> "Motions":
        """These motions with some of them taken from others, shape [n]."""
        return Motions(
            **{
                field.name: np.where(
                    where.reshape(-1, *[1] * (getattr(self, field.name).ndim - 1)),
                    getattr(others, field.name),
                    getattr(self, field.name),
                )
                for field in fields(self)
            }
        )

    def of(self, rows: list[int]) -> "Motions":
        """Those of some faces."""
        return Motions(**{field.name: getattr(self, field.name)[rows] for field in fields(self)})

    def moved(self, points: Array, centres: Array) -> Array:
        """Where points of the faces are in the plane after the motion [m], shape [n, k, 2]."""
        turned = self._turned(points - centres[:, None])
        return centres[:, None] + self.centre[:, None] + turned

    def _turned(self, arm: Array) -> Array:
        cos, sin = np.cos(self.turn)[:, None], np.sin(self.turn)[:, None]
        return np.stack(
            (cos * arm[..., 0] - sin * arm[..., 1], sin * arm[..., 0] + cos * arm[..., 1]), axis=-1
        )

    def with_rows(self, rows: list[int], others: "Motions") -> "Motions":
        """These motions with some faces' taken from others, which are of these faces only."""
        changed = {}
        for field in fields(self):
            values = getattr(self, field.name).copy()
            values[rows] = getattr(others, field.name)
            changed[field.name] = values
        return Motions(**changed)

    def displaced(self, points: Array, centres: Array) -> tuple[Array, Array]:
        """Displacement of points of the faces along right and up, and its variances [m, m²], shape [n, k, 2] each.

        Args:
            points: places before the motion [m], shape [n, k, 2].
            centres: of the faces before the motion [m], shape [n, 2].
        """
        arm = points - centres[:, None]
        turned = self._turned(arm)
        lever = np.stack((-turned[..., 1], turned[..., 0]), axis=-1)
        c = self.covariance[:, None, :3, :3]
        variance = np.stack(
            [
                c[..., k, k] + 2.0 * lever[..., k] * c[..., k, 2] + lever[..., k] ** 2 * c[..., 2, 2]
                for k in (0, 1)
            ],
            axis=-1,
        )
        return self.centre[:, None] + turned - arm, variance


def fit_motions(
    before: Array,
    after: Array,
    centres: Array,
    foot: Array,
    distance: Array,
    *,
    point_sigma_m: Array,
    tolerance_m: float,
    moved_m: Array,
    may_come_out: Flags | None = None,
) -> Motions:
    """Fits the motion of every face to its points.

    Args:
        before: points of the faces, along right and up [m], shape [n, k, 2]; NaN where a face has fewer.
        after: the same points now, at the depth that they had [m], shape [n, k, 2]; NaN for points not found.
        centres: of the faces before [m], shape [n, 2].
        foot: of the camera's perpendicular on the plane, along right and up, as the sled stands [m], shape [2].
        distance: of the camera from the faces [m], shape [n].
        point_sigma_m: least standard deviation of a point of each face [m], shape [n].
        tolerance_m: how far a point may be off and still agree, to begin with [m].
        moved_m: about how far each face moved: how far it may have come nearer grows with it, shape [n].
        may_come_out: whose δ, ψ and χ may be large, if that explains what the points do, shape [n]; without it
            nobody's, and that they might is not taken for an uncertainty.
    """
    count = len(before)
    looked: Flags = np.array(np.isfinite(before).all(axis=2), dtype=np.bool_)
    found: Flags = np.logical_and(looked, np.isfinite(after[..., 0]) & np.isfinite(after[..., 1]))
    arm = np.nan_to_num(before - centres[:, None])
    shift = np.nan_to_num(after - centres[:, None])
    p, q = arm[..., 0] + 1j * arm[..., 1], shift[..., 0] + 1j * shift[..., 1]
    place, turn = _consensus(p, q, found, tolerance_m)
    usual = np.column_stack((NEARER_M + NEARER_SHARE * moved_m, *2 * [TURNED_RAD + TURNED_SHARE * moved_m]))
    start = np.zeros((count, 6))
    start[:, 0], start[:, 1], start[:, 2] = place.real, place.imag, turn
    seen = _Seen(p, shift, looked, found, centres, foot, distance, point_sigma_m, tolerance_m)
    held, held_off = _descended(seen, start, usual, usual)
    if may_come_out is None:
        return held
    free, free_off = _descended(seen, start, usual, np.broadcast_to(FREE, usual.shape))
    # To come nearer explains any noise a little better: it has to explain much.
    gain = (np.minimum(held_off, tolerance_m) ** 2 - np.minimum(free_off, tolerance_m) ** 2).sum(axis=1)
    better = gain / (CLEARLY_BETTER * free.spread_m**2)
    comes_out = (better > 1.0) & (free.share >= MOST_AGREE)
    best = replace(held.replaced(free, comes_out & may_come_out), comes_out=comes_out)
    # Of two explanations that fit alike, either may be true: half of what they differ by is a standard deviation.
    apart = np.column_stack((free.centre - held.centre, free.turn - held.turn))
    apart *= np.clip(better, 0.0, 1.0)[:, None]
    best.covariance[:, :3, :3] += 0.25 * apart[:, :, None] * apart[:, None]
    return best


@dataclass(frozen=True, eq=False)
class _Seen:
    """The points of all faces, about their centres: before as complex numbers, and after; and what they are seen by."""

    p: NDArray[np.complex128]
    shift: Array
    looked: Flags
    found: Flags
    centres: Array
    foot: Array
    distance: Array
    sigma_m: Array
    tolerance_m: float


def _descended(seen: _Seen, state: Array, usual: Array, first: Array) -> tuple[Motions, Array]:
    """Weighted Gauss-Newton from a state, shape [n, 6]; and how far off the points found are [m], shape [n, k].

    Args:
        seen: the points.
        state: to begin with.
        usual: how far δ, ψ and χ usually go, shape [n, 3].
        first: how far they may go in the first steps, while points that are wrong drop out, shape [n, 3].
    """
    prior = np.zeros_like(state)
    prior[:, 3:] = 2.0 / first**2
    spread = np.full(len(state), seen.tolerance_m)
    for number in range(_ITERATIONS):
        model, columns = _model(state, seen.p, seen.centres, seen.foot, seen.distance)
        residual = seen.shift - model
        off = np.sqrt(residual[..., 0] ** 2 + residual[..., 1] ** 2)
        # Of two components 1.1774 σ is the median of the length.
        spread = np.maximum(_median(off, seen.found & (off < 3.0 * spread[:, None])) / 1.1774, seen.sigma_m)
        reach = np.minimum(4.0 * spread, seen.tolerance_m)[:, None]
        weight = seen.found * np.clip(1.0 - (off / reach) ** 2, 0.0, None) ** 2
        scaled = (weight / (spread**2)[:, None])[..., None, None] * columns
        normal = np.einsum("nkca,nkcb->nab", columns, scaled, optimize=True)
        normal[:, range(6), range(6)] += prior + 1.0e-6
        right = np.einsum("nkca,nkc->na", scaled, residual) - prior * state
        state = state + np.linalg.solve(normal, right[..., None])[..., 0]
        if number >= _FIRST_ITERATIONS - 1:
            # Cauchy's distribution, by weights: small ones are held near zero, a large one that shows is let be.
            prior[:, 3:] = 2.0 / (usual**2 + state[:, 3:] ** 2)
    used = (weight > 0.1).sum(axis=1)
    motions = Motions(
        centre=state[:, :2],
        turn=state[:, 2],
        outward=state[:, 3:],
        covariance=np.linalg.inv(normal),
        spread_m=spread,
        used=used,
        share=used / np.maximum(seen.looked.sum(axis=1), 1),
        comes_out=np.zeros(len(state), dtype=np.bool_),
    )
    return motions, np.where(seen.found, off, 0.0)


def _model(
    state: Array, p: NDArray[np.complex128], centres: Array, foot: Array, distance: Array
) -> tuple[Array, Array]:
    """Where the points should be seen, less the centres, shape [n, k, 2], and how that depends on the state."""
    turned = p * np.exp(1j * state[:, 2])[:, None]
    place = turned + (state[:, 0] + 1j * state[:, 1])[:, None]
    away = place + (centres[:, 0] - foot[0] + 1j * (centres[:, 1] - foot[1]))[:, None]
    away = away / distance[:, None]
    nearer = state[:, 3, None] + turned.real * state[:, 4, None] + turned.imag * state[:, 5, None]
    seen = place + away * nearer
    one = np.ones_like(p)
    columns = [one, 1j * one, 1j * turned, away, away * turned.real, away * turned.imag]
    stacked = np.stack(columns, axis=-1)
    return np.stack((seen.real, seen.imag), axis=-1), np.stack((stacked.real, stacked.imag), axis=2)


def _consensus(
    p: NDArray[np.complex128], q: NDArray[np.complex128], found: NDArray[np.bool_], tolerance_m: float
) -> tuple[NDArray[np.complex128], Array]:
    """The rigid motion that most points of each face agree with: place of the centre, and turn."""
    count, width = p.shape
    draws = np.random.default_rng(0).random((_HYPOTHESES, 2, 1, width))
    # Two different points that were found, for each face and hypothesis.
    first = np.where(found, draws[:, 0], -1.0).argmax(axis=2)
    rows = np.arange(count)
    others = np.broadcast_to(found, (_HYPOTHESES, count, width)).copy()
    others[np.arange(_HYPOTHESES)[:, None], rows, first] = False
    span = np.abs(p[None] - p[rows, first][..., None])
    # Rather far from each other: a short arm tells no turn.
    second = np.where(others, draws[:, 1] + 3.0 * span / max(float(span.max()), 1.0e-9), -1.0).argmax(axis=2)
    pa, pb, qa, qb = p[rows, first], p[rows, second], q[rows, first], q[rows, second]
    ratio = (qb - qa) * np.conj(pb - pa)
    unit = np.where(np.abs(ratio) > 1.0e-12, ratio / np.maximum(np.abs(ratio), 1.0e-12), 1.0)
    place = 0.5 * (qa + qb - unit * (pa + pb))
    off = np.abs(q[None] - place[..., None] - unit[..., None] * p[None])
    agree = found[None] & (off < tolerance_m)
    quality = np.where(agree, 1.0 - (off / tolerance_m) ** 2, 0.0).sum(axis=2)
    best = quality.argmax(axis=0)
    return place[best, rows], np.angle(unit[best, rows])


def _median(values: Array, where: NDArray[np.bool_]) -> Array:
    """Median of each row's values where asked for; 0 for a row of none."""
    ordered = np.sort(np.where(where, values, np.inf), axis=1)
    count = where.sum(axis=1)
    rows = np.arange(len(values))
    low, high = (
        ordered[rows, np.maximum(count - 1, 0) // 2],
        ordered[rows, np.minimum(count // 2, values.shape[1] - 1)],
    )
    return np.where(count > 0, 0.5 * (np.where(count > 0, low, 0.0) + np.where(count > 0, high, 0.0)), 0.0)
