"""The energy ledger: what the sled and the fields put into the load must be there, or be rubbed away.

In frame ``sled`` the sled's acceleration a acts on every body as the inertial force −m·a. Over an interval

    D = W_sled + W_fields − ΔE,   E = Σ ½·m·v² + ½·ω·J·ω + m·g·z,
    W_sled = −Δv_sled · ½·(p0 + p1),   W_fields = Σ ½·(F0 + F1) · (x1 − x0) + ½·(τ0 + τ1) · Δθ

with p the load's momentum. D is what friction and inelastic contacts took: it may only grow. A fall of
the sum of all D is energy from nowhere; the residual is the largest such fall, over the energy moved so far.
"""

import numpy as np

from config.scene import Scene
from sim_core.frames import GRAVITY, Array
from sim_core.geometry import rotation_matrices

LEAST_LIFT_M = 1.0e-2
"""Below the energy that lifts the whole load by this, a residual says nothing."""


class EnergyLedger:
    """Accounts for a load's energy frame by frame.

    Args:
        scene: a resolved scene.
    """

    def __init__(self, scene: Scene) -> None:
        pallet = scene.pallet_box
        moves = pallet is not None and not pallet.fixed
        sizes = [
            pallet.size_m if pallet is not None else (0.0, 0.0, 0.0),
            *(p.size_m for p in scene.packages),
        ]
        # Sheets have no body; a blocked pallet doesn't move.
        masses = [pallet.mass_kg if moves and pallet is not None else 0.0] + [
            0.0 if p.kind == "interlayer" else p.mass_kg for p in scene.packages
        ]
        self._masses = np.array(masses)
        squares = np.array(sizes) ** 2
        self._inertias = self._masses[:, None] * (squares.sum(axis=1)[:, None] - squares) / 12.0
        self._floor = GRAVITY * float(self._masses.sum()) * LEAST_LIFT_M
        self._before: tuple[Array, Array, Array, Array, Array, float, float] | None = None
        self._dissipated = self._most_dissipated = self._moved = 0.0
        self.residual = 0.0

    def update(
        self,
        delta_velocity: Array,
        positions: Array,
        orientations: Array,
        linear: Array,
        angular: Array,
        forces: Array | None,
        torques: Array | None = None,
    ) -> None:
        """Takes the state at a frame.

        Args:
            delta_velocity: change of the sled's velocity since the frame before [m/s], shape [3].
            positions: centres at the time of the velocities [m], shape [n, 3].
            orientations: unit quaternions x, y, z, w, shape [n, 4].
            linear: velocities [m/s], shape [n, 3].
            angular: angular velocities in the fixed frame [rad/s], shape [n, 3].
            forces: forces of fields and film [N], shape [n, 3], or None.
            torques: torques of the film about the centres [N·m], shape [n, 3], or None.
        """
        momentum = self._masses @ linear
        in_body = np.einsum("nji,nj->ni", rotation_matrices(orientations), angular)
        kinetic = 0.5 * float(self._masses @ (linear**2).sum(axis=1) + (self._inertias * in_body**2).sum())
        potential = GRAVITY * float(self._masses @ positions[:, 2])
        push = forces if forces is not None else np.zeros_like(positions)
        twist = torques if torques is not None else np.zeros_like(positions)
        if self._before is not None:
            places, facing, pushes, twists, earlier, kinetic_before, potential_before = self._before
            work = -float(delta_velocity @ (earlier + momentum)) / 2.0
            work += 0.5 * float(((pushes + push) * (positions - places)).sum())
            if torques is not None:
                work += 0.5 * float(((twists + twist) * _turned_by(facing, orientations)).sum())
            gained = kinetic - kinetic_before + potential - potential_before
            self._dissipated += work - gained
            self._most_dissipated = max(self._most_dissipated, self._dissipated)
            self._moved += abs(work) + abs(potential - potential_before)
            scale = max(self._moved, self._floor)
            if scale > 0.0:
                self.residual = max(self.residual, (self._most_dissipated - self._dissipated) / scale)
        self._before = (positions, orientations, push, twist, momentum, kinetic, potential)


def _turned_by(before: Array, after: Array) -> Array:
    """Small turns between unit quaternions as vectors in the fixed frame [rad], shape [n, 3]: 2·vec(q1·q0*)."""
    first, second = before[:, :3], after[:, :3]
    vectors = before[:, 3:] * second - after[:, 3:] * first - np.cross(second, first)
    turned: Array = 2.0 * vectors * np.sign(np.einsum("ij,ij->i", before, after))[:, None]
    return turned
