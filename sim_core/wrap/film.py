"""A film's elements: what they are made of, their shape at rest, and which nodes they tie together."""

from dataclasses import dataclass

import numpy as np

from config.errors import RefusedInput
from sim_core.frames import Array
from sim_core.wrap.membrane import Flags, Indices


@dataclass(frozen=True, eq=False, slots=True)
class Film:
    """Elements of one film; :func:`make_film` builds it. Set strain and torn flags change in place.

    Attributes:
        triangles: corner nodes, shape [m, 3].
        inverse_reference: Dm⁻¹ [1/m], shape [m, 2, 2].
        area: reference areas [m²], shape [m].
        stiffness: A11, A22, A12, A66 [N/m], shape [m, 4].
        set_strain: permanent set in components 11, 22, 12, shape [m, 3].
        torn: shape [m].
        row_start: where each node's row of the tangent stiffness starts, shape [n + 1].
        columns: the node of each 3 × 3 block, shape [block_count].
        slots: the block of each pair of an element's corners, shape [m, 3, 3].
    """

    triangles: Indices
    inverse_reference: Array
    area: Array
    stiffness: Array
    set_strain: Array
    torn: Flags
    row_start: Indices
    columns: Indices
    slots: Indices

    @property
    def elements(self) -> tuple[Indices, Array, Array, Array, Array, Flags]:
        """What :func:`~sim_core.wrap.membrane.membrane_forces` takes between positions and forces."""
        return self.triangles, self.inverse_reference, self.area, self.stiffness, self.set_strain, self.torn

    def softened(self, share: float) -> tuple[Indices, Array, Array, Array, Array, Flags]:
        """The elements with a share of their stiffness."""
        before, after = self.elements[:3], self.elements[4:]
        return *before, share * self.stiffness, *after

    def scale(self) -> tuple[float, float]:
        """Typical stiffness [N/m] and element size [m]."""
        return float(self.stiffness[:, :2].mean()), float(np.sqrt(2.0 * np.median(self.area)))

    def nodal_masses(self, areal_density: float) -> Array:
        """Lumped masses [kg], shape [n], of a film of so many kg/m² at rest."""
        thirds = np.repeat(areal_density / 3.0 * self.area, 3)
        masses: Array = np.zeros(len(self.row_start) - 1)
        np.add.at(masses, self.triangles.ravel(), thirds)
        return masses


def make_film(triangles: Indices, corners: Array, stiffness: Array, node_count: int) -> Film:
    """A film without set or tears.

    Args:
        triangles: corner nodes, shape [m, 3].
        corners: reference coordinates of each element's corners [m], shape [m, 3, 2].
        stiffness: A11, A22, A12, A66 [N/m], shape [4] or [m, 4].
        node_count: number of nodes; those in no triangle are allowed.

    Raises:
        RefusedInput: a corner names no node, a triangle has no area, or the stiffness isn't positive definite.
    """
    if triangles.ndim != 2 or triangles.shape[1] != 3 or not len(triangles):
        raise RefusedInput("triangles", triangles.shape, "must have shape [m, 3], m at least 1")
    if triangles.min() < 0 or triangles.max() >= node_count:
        raise RefusedInput(
            "triangles", [int(triangles.min()), int(triangles.max())], f"must be 0 to {node_count - 1}"
        )
    if corners.shape != (len(triangles), 3, 2):
        raise RefusedInput("corners", corners.shape, f"must have shape [{len(triangles)}, 3, 2]")
    inverse, area = reference_shapes(corners)
    each = np.ascontiguousarray(np.broadcast_to(stiffness, (len(triangles), 4)), dtype=np.float64)
    a11, a22, a12, a66 = each.T
    if not (
        np.isfinite(each).all() and (a11 > 0.0).all() and (a11 * a22 > a12**2).all() and (a66 > 0.0).all()
    ):
        raise RefusedInput("stiffness", stiffness.tolist()[:4], "must be finite and positive definite")
    nodes = np.ascontiguousarray(triangles, dtype=np.int64)
    pairs = (nodes[:, :, None] * node_count + nodes[:, None, :]).ravel()
    # Every node has a block of its own, also one in no triangle.
    own = np.arange(node_count) * (node_count + 1)
    unique, slots = np.unique(np.concatenate((pairs, own)), return_inverse=True)
    return Film(
        triangles=nodes,
        inverse_reference=inverse,
        area=area,
        stiffness=each,
        set_strain=np.zeros((len(nodes), 3)),
        torn=np.zeros(len(nodes), dtype=np.bool_),
        row_start=np.searchsorted(unique, np.arange(node_count + 1) * node_count).astype(np.int64),
        columns=(unique % node_count).astype(np.int64),
        slots=np.ascontiguousarray(slots[: len(pairs)].reshape(-1, 3, 3), dtype=np.int64),
    )


def reference_shapes(corners: Array) -> tuple[Array, Array]:
    """Inverse reference matrices Dm⁻¹ [1/m], shape [m, 2, 2], and reference areas [m²], shape [m].

    Args:
        corners: reference coordinates X, Y of each element's own corners [m], shape [m, 3, 2]: elements on both
            sides of a ring's seam give one node different coordinates. Counter-clockwise or clockwise.

    Raises:
        RefusedInput: a coordinate isn't finite, or a triangle has (almost) no area.
    """
    if corners.ndim != 3 or corners.shape[1:] != (3, 2) or not np.isfinite(corners).all():
        raise RefusedInput("corners", corners.shape, "must be finite, of shape [m, 3, 2]")
    edges = np.stack((corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=2)
    determinants = edges[:, 0, 0] * edges[:, 1, 1] - edges[:, 0, 1] * edges[:, 1, 0]
    flat = np.flatnonzero(~(np.abs(determinants) > 1e-9 * (edges**2).sum(axis=(1, 2))))
    if len(flat):
        raise RefusedInput(f"corners[{flat[0]}]", corners[flat[0]].tolist(), "a triangle must have an area")
    return np.ascontiguousarray(np.linalg.inv(edges)), 0.5 * np.abs(determinants)


def plane_stress_stiffness(modulus_md: float, modulus_td: float, poisson: float, shear: float) -> Array:
    """Orthotropic plane-stress stiffness A11, A22, A12, A66 [N/m], shape [4].

    Args:
        modulus_md: E1·t along MD [N/m].
        modulus_td: E2·t along TD [N/m].
        poisson: ν12, the contraction along TD in a pull along MD; ν21 = ν12·E2/E1.
        shear: G12·t [N/m].

    Raises:
        RefusedInput: a modulus isn't positive and finite, or ν12² ≥ E1/E2.
    """
    for field, value in (("modulus_md", modulus_md), ("modulus_td", modulus_td), ("shear", shear)):
        if not (np.isfinite(value) and value > 0.0):
            raise RefusedInput(field, value, "must be positive and finite")
    share = 1.0 - poisson**2 * modulus_td / modulus_md
    if not share > 0.0:
        raise RefusedInput("poisson", poisson, "its square must be below modulus_md / modulus_td")
    return np.array([modulus_md, modulus_td, poisson * modulus_td, share * shear]) / share
