"""Four perimeter force fields that hold a load together, as a wrap would, without simulating one.

Field k stands on a vertical plane at distance d outside the settled load's perimeter, with outward
normal n_k. It acts on package i with

    f_ik = −n_k · F_base · w_i · [φ(r_ik) − φ(r⁰_ik)],   φ(r) = (d / max(r, d/4))^p,   F_base = T/4 · Σm · a

where r_ik is the distance from the package's outermost point along n_k to the plane, r⁰_ik that of the
settled load, w_i the package's share over the height, w_i ∝ exp(−(z_i − z_mid)²/(2·σ_h²)) with
Σw_i = 1, and a the sled's peak acceleration. Strength and placement follow arXiv 2508.13989, where T and
σ_h are calibrated. The settled press φ(r⁰) is left out: packages that stand pressed together carry it
among themselves, so what restrains a package is the change of the press as it leaves its place.
"""

import numpy as np

from config.scene import ForceFields, Scene
from sim_core.frames import Array
from sim_core.geometry import rotation_matrices

NORMALS: Array = np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])


NEAREST_SHARE = 0.25
"""The push stops growing this close to the plane, as a share of d: 16 times the push at the perimeter for p = 2."""


class PerimeterForceFields:
    """The fields of one settled load.

    Args:
        fields: the scene's parameters.
        scene: a resolved scene with at least one package.
        peak_mps2: the sled's peak acceleration a [m/s²].
        positions: settled centres [m], shape [package_count + 1, 3], row 0 the pallet.
        orientations: settled unit quaternions, shape [package_count + 1, 4].
    """

    def __init__(
        self, fields: ForceFields, scene: Scene, peak_mps2: float, positions: Array, orientations: Array
    ) -> None:
        self._half_sizes = 0.5 * np.array([package.size_m for package in scene.packages])
        masses = np.array([package.mass_kg for package in scene.packages])
        self._distance = fields.distance_m
        self._falloff = fields.falloff
        base = fields.tension / 4.0 * float(masses.sum()) * peak_mps2
        heights = positions[1:, 2]
        middle = 0.5 * (heights.min() + heights.max())
        share = np.exp(-((heights - middle) ** 2) / (2.0 * fields.height_spread_m**2))
        self._strengths = base * share / share.sum()
        settled = self._outermost(positions, orientations)
        self._planes = settled.max(axis=0) + fields.distance_m
        self._settled_press = self._press(settled)
        self._masses = masses

    def stiffest_frequency(self, positions: Array, orientations: Array) -> float:
        """Frequency √(k/m) of the stiffest package where it stands [rad/s], k = p·F·φ(r)/r."""
        gaps = self._planes - self._outermost(positions, orientations)
        held = np.maximum(gaps, NEAREST_SHARE * self._distance)
        slopes = self._falloff * self._strengths[:, None] * (self._distance / held) ** self._falloff / held
        # Nearer than that the push is constant: no spring.
        slopes[gaps < NEAREST_SHARE * self._distance] = 0.0
        along_axis = slopes.reshape(-1, 2, 2).sum(axis=2).max(axis=1)
        return float(np.sqrt((along_axis / self._masses).max()))

    def forces(self, positions: Array, orientations: Array) -> Array:
        """Force on each body's centre [N], shape [package_count + 1, 3]; row 0 (the pallet) is zero."""
        change = self._press(self._outermost(positions, orientations)) - self._settled_press
        pushes = self._strengths[:, None] * change
        forces = np.zeros_like(positions)
        forces[1:, :2] = -pushes @ NORMALS
        return forces

    def _press(self, outermost: Array) -> Array:
        """φ of every package and field, shape [package_count, 4]."""
        gaps = np.maximum(self._planes - outermost, NEAREST_SHARE * self._distance)
        press: Array = (self._distance / gaps) ** self._falloff
        return press

    def _outermost(self, positions: Array, orientations: Array) -> Array:
        """Support of each box along each field's normal [m], shape [package_count, 4]."""
        reach = np.abs(rotation_matrices(orientations[1:])[:, :2, :]) @ self._half_sizes[:, :, None]
        centres = positions[1:, :2] @ NORMALS.T
        support: Array = centres + reach[:, [0, 0, 1, 1], 0]
        return support
