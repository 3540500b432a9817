"""Impacts ahead: where two bodies are about to meet, the step is made smaller until they have met.

A blow falls somewhere inside a step, and a step knows only its ends: the bodies are misplaced by up to a quarter
of their closing speed times the step (three quarters in MuJoCo, where friction acts for the whole step of the
blow; both measured over the phase of the blow). Away from blows the reads are of second order, so small steps
are spent on blows alone.
"""

import numpy as np
from numpy.typing import NDArray

from sim_core.frames import Array
from sim_core.geometry import rotation_matrices

ALLOWED_M = 5.0e-5
"""Misplacement that one blow may leave."""
MOST_SUBSTEPS = 16
TOUCHING_M = 1.0e-5
"""Bodies nearer than this have met already."""
TOPPLED_UPRIGHT = 0.7
"""Cosine of a tilt of about 45°: what has toppled has failed, and where it lands is chance."""


class ImpactWatch:
    """Says into how many sub-steps a step is to be split, from where the bodies are and how fast they close.

    Bodies are taken as the upright boxes around them: falling back onto an edge after a tilt is not foreseen.
    Bodies that have toppled, or fallen by more than half their height, don't count: no step is small enough for
    a collapse.

    Args:
        half_sizes: half edge lengths of the bodies [m], shape [n, 3]; zero for a row without a body.
        heights: centres' heights at the start [m], shape [n].
        share_of_step: the engine's largest misplacement after a blow, as a share of closing speed times step.
    """

    def __init__(self, half_sizes: Array, heights: Array, share_of_step: float) -> None:
        self._half_sizes, self._share = half_sizes, share_of_step
        self._is_solid = (half_sizes > 0.0).all(axis=1)
        self._lowest = heights - half_sizes[:, 2]

    def substeps(
        self,
        step_s: float,
        split: int,
        ahead_s: float,
        positions: Array,
        orientations: Array,
        linear: Array,
    ) -> int:
        """Number of sub-steps for the time ahead: 1 where no blow is foreseen, at most 16.

        Args:
            step_s: the whole step [s].
            split: the number of sub-steps in use.
            ahead_s: how far to look [s].
            positions: centres [m], shape [n, 3].
            orientations: unit quaternions x, y, z, w, shape [n, 4].
            linear: velocities [m/s], shape [n, 3].
        """
        slowest = ALLOWED_M / (self._share * step_s)
        if not len(linear) or (np.ptp(linear, axis=0) < slowest).all():
            return 1
        # The whole step's positions are further ahead: going back to it must not pass over a blow.
        lead_s = 0.5 * step_s * (1.0 - 1.0 / split)
        closing = self._closing_speed(slowest, 1.25 * ahead_s + lead_s, positions, orientations, linear)
        if closing < slowest:
            return 1
        return int(min(2 ** int(np.ceil(np.log2(closing / slowest))), MOST_SUBSTEPS))

    def standing(self, positions: Array, turns: Array) -> NDArray[np.bool_]:
        """Which bodies have neither toppled nor fallen, shape [n].

        Args:
            positions: centres [m], shape [n, 3].
            turns: rotation matrices, shape [n, 3, 3].
        """
        upright: NDArray[np.bool_] = turns[:, 2, 2] > TOPPLED_UPRIGHT
        return (upright & (positions[:, 2] >= self._lowest)) | ~self._is_solid

    def _closing_speed(
        self, slowest: float, ahead_s: float, positions: Array, orientations: Array, linear: Array
    ) -> float:
        """Largest speed at which two bodies will meet within the time ahead [m/s]."""
        turns = rotation_matrices(orientations)
        counts = self.standing(positions, turns) & self._is_solid
        # Two bodies that close at a speed: at least one of them has half of it.
        fast = np.flatnonzero(np.linalg.norm(linear, axis=1) >= 0.5 * slowest)
        first, second = (index.ravel() for index in np.meshgrid(fast, np.arange(len(linear)), indexing="ij"))
        reach = np.einsum("nij,nj->ni", np.abs(turns), self._half_sizes)
        apart = positions[second] - positions[first]
        gaps = np.abs(apart) - reach[first] - reach[second]
        speeds = -np.sign(apart) * (linear[second] - linear[first])
        axis = gaps.argmax(axis=1)[:, None]
        gap, speed = (np.take_along_axis(values, axis, axis=1)[:, 0] for values in (gaps, speeds))
        # A body has a negative gap to itself.
        meets = (gap > TOUCHING_M) & (gap < ahead_s * speed) & counts[first] & counts[second]
        if not meets.any():
            return 0.0
        after = gaps[meets] - speeds[meets] * ahead_s
        # Bodies that pass each other on another axis don't meet.
        np.put_along_axis(after, axis[meets], -1.0, axis=1)
        hits = (after < 0.0).all(axis=1)
        return float(speed[meets][hits].max(initial=0.0))
