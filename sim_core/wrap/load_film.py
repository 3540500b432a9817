"""The film around a load, coupled both ways to its rigid boxes: it follows them at rest, and they feel its pull.

90 g of film around 500 kg have no inertia: after each move of the boxes the film is in equilibrium. Nodes on the
vertical edges of boxes go with them, stick or slip by friction, or let film run past (see ``edges``); where the film
would pull a node off its edge, it lets go until it meets the box again. All other nodes are free but for the boxes,
which they may not enter. Newton's method finds that state from the last one, with a tangent that is renewed only when
it has become too old, so that a small move costs one or two evaluations of the film's forces.

Film laid without a pull upwards lies at a kink of its law: a little narrower, and it wrinkles and has no stiffness
upwards at all. A weak drag, from where the last move would take the nodes, keeps such nodes in place; what it carries
is below the tolerance for moves of millimetres and is gone when the load rests. All that is left on free nodes, drag
included, is handed to the nearest edges of the row, so the film's forces on the bodies sum to nothing whatever is left.

What is left out: film touches boxes at its nodes only and without friction but on edges that bent it when it was laid,
so an edge that comes to stand out later is met as well as the mesh resolves it; film that slips up an edge stays on
that edge's line; flow past an edge moves the film under the mesh, but its permanent set stays with the mesh; nothing
is folded over the top.
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from config.errors import RefusedInput
from config.scene import Scene
from config.wrap import FilmProperties, film_span, layers_at
from sim_core.frames import Array
from sim_core.geometry import rotation_matrices
from sim_core.wrap.bordered import Factor, factorise, number_nodes
from sim_core.wrap.contact import EDGE, FACE, FREE, IDLE, find_faces, follow, ride, share_out
from sim_core.wrap.edges import (
    ABSENT,
    OPEN,
    STUCK,
    largest_excess,
    move_nodes,
    push_of,
    set_directions,
    shift_reference,
    slip_step,
    slope_along,
)
from sim_core.wrap.film import Film, make_film, plane_stress_stiffness
from sim_core.wrap.fit import find_sides, fit_film, flattened, solid_boxes, unrolled
from sim_core.wrap.membrane import Flags, Indices, membrane_forces, tear_film, yield_film

STILL_M = 1.0e-7
"""Bodies that have moved by less since the last answer get it again, or by less than changes it by the tolerance."""
TOLERANCE = 3.0e-3
"""Force left on a node, as a share of the pull of a row of film: the error of the answer, about."""
FOLLOWS, LOOSEST = 0.05, 0.03
"""While boxes move the force may be off by this share of what the move changes it by, up to so much of a row's pull."""
LOST = 0.1
"""Film left so far out of balance, as a share of a row's pull, shows no strain or pull that is its own: it neither
flows nor tears, and the boxes keep the pull that it had before."""
LEAST_STRAIN = 1.0e-2
"""Strain whose pull the tolerance is a share of where the film was laid looser than that."""
PENETRATION_M = 2.0e-7
"""Nodes deeper in a box than this are put onto its face."""
CATCH_M = 5.0e-3
"""A node that was let go and meets its box nearer to the edge than this is on the edge again."""
LONGEST_MOVE = 0.1
"""Bodies that have moved by more than this share of the spacing are followed in parts of the way."""
MOST_PARTS = 64
MOST_STEPS, CONTACT_ROUNDS = 12, 5
WORTH_STEPS = 4
"""Newton steps with an old tangent that cost as much as a new tangent."""
LONGEST_STEP, WILD_STEPS = 0.3, 100.0
"""Longest move of a node in one step as a share of the spacing, and how many times that no step may ask for."""
DRAG = 1.0e-3
"""Stiffness that draws free nodes to where their edges take them, as a share of the film's own."""
LEAST_DAMPING = 1.0e-3
"""Share of the drag that keeps a stiffness regular."""
OVERSHOOT, SEARCHES = 0.6, 6
"""A step is shortened where the slope behind it is more than this share of the one before it, by so many trials."""
SLOW, STIFFER, SOFTER, MOST_DAMPING = 0.7, 5.0, 0.3, 500.0
"""Steps that leave more than this share of the excess raise the damping (Levenberg and Marquardt), others lower it,
from the drag to so many times the drag."""

State = tuple[Any, ...]


class LoadFilm:
    """The film of one wrapped load.

    Args:
        scene: a resolved scene with a wrap around packages.
        positions: settled centres [m], shape [package_count + 1, 3], row 0 the pallet.
        orientations: settled unit quaternions x, y, z, w, shape [package_count + 1, 4].
        spacing_m: distance of rows and columns of the mesh [m]; else the scene's.
        film: one layer of film in figures; else the scene's.
        tolerance: force that may be left on a node, as a share of the pull of a row of film.

    Raises:
        RefusedInput: there is no film to lay, or its friction on a surface of the load is not known.

    Attributes:
        nodes: where the film is [m], frame ``sled``, shape [n, 3]; changes in place.
        film: its elements; :func:`~sim_core.wrap.membrane.membrane_state` shows what they carry.
        unrolled: the elements' corners on the film unrolled as it was laid, see
            :class:`~sim_core.frames.FilmFrame`, shape [m, 3, 2].
        residual_n: largest force that the last answer left unbalanced [N].
        is_gone: whether it was let go.
        answers: how often the film was brought to rest since it was laid.
        steps_taken: Newton steps since the film was laid.
        tangents_made: tangents factorised since the film was laid.
    """

    def __init__(
        self,
        scene: Scene,
        positions: Array,
        orientations: Array,
        *,
        spacing_m: float | None = None,
        film: FilmProperties | None = None,
        tolerance: float = TOLERANCE,
    ) -> None:
        wrap, layer = scene.wrap, film or scene.film
        if wrap is None or layer is None:
            raise RefusedInput("wrap", None, "must name a film with turns around packages")
        self._half_sizes, self._is_solid = solid_boxes(scene)
        deck = scene.pallet_box.size_m[2] if scene.pallet_box is not None else 0.0
        reach = np.abs(rotation_matrices(orientations)[:, 2, :] * self._half_sizes).sum(axis=1)
        top = float((positions[:, 2] + reach)[self._is_solid].max())
        lower, upper = film_span(wrap, deck_m=deck, top_m=top)
        spacing = spacing_m or scene.film_spacing_m
        mesh = fit_film(scene, positions, orientations, span_m=(lower, upper), spacing_m=spacing)
        layers = np.array([
            np.mean([layers_at(wrap, upper - lower, z - lower) for z in np.linspace(a, b, 17)])
            for a, b in zip(mesh.heights[:-1], mesh.heights[1:], strict=True)
        ])  # fmt: skip
        if not layers.max() > 0.0:
            raise RefusedInput("wrap.turns", wrap.turns, "leave no film on the load")
        self._columns = mesh.columns
        self._outwards, self._signs, self._owners = mesh.outwards, mesh.edges, mesh.owners
        self.nodes = mesh.positions.copy()
        kept = layers[mesh.bands] > 0.0
        triangles, bands = mesh.triangles[kept], mesh.bands[kept]
        self.unrolled = unrolled(mesh)[kept].astype(np.float32)
        self._even_count = int(kept[: mesh.even_count].sum())
        self._start_kinds(triangles)
        self._frictions = self._frictions_of(scene, layer)
        self._lay(layer, triangles, layers[bands], spacing, tolerance)
        self._sides = find_sides(mesh, self._is_edge)
        turns = rotation_matrices(orientations)
        local = np.einsum("nk,nkj->nj", self.nodes - positions[self._owners], turns[self._owners])
        self._along = np.where(self._kinds == EDGE, local[:, 2], 0.0)
        self._tears = wrap.tear
        self._reaches = np.linalg.norm(self._half_sizes, axis=1)
        self._last_positions = positions.copy()
        self._last_orientations = orientations.copy()
        self._forces, self._torques = np.zeros_like(positions), np.zeros_like(positions)
        self._still_m, self._hardest, self.answers, self._committed = STILL_M, 0.0, 0, 0
        self.wrenches(positions, orientations)
        self._held_stiffness = self._stiffness_on_bodies(len(positions))
        self._hardest = float(self._held_stiffness.max(initial=1.0))
        self._still_m = max(STILL_M, self._tolerance_n / self._hardest)

    def _start_kinds(self, triangles: Indices) -> None:
        """Sets what each node is at first, and makes the arrays that the kernels write to."""
        n = len(self.nodes)
        self._kinds = np.where(self._owners >= 0, EDGE, FREE).astype(np.int64)
        self._kinds[np.bincount(triangles.ravel(), minlength=n) == 0] = IDLE
        self._is_edge = self._kinds == EDGE
        self._holders = np.where(self._is_edge, self._owners, -1)
        self._normals, self._axes = self._outwards.copy(), np.zeros((n, 3))
        self._slips = np.zeros((n, 3), dtype=np.int64)
        self._moved = np.zeros((n, 3))
        self._even_ways, self._odd_ways = np.zeros((n, 3, 3)), np.zeros((n, 3, 3))
        self._even, self._odd = np.zeros((n, 3)), np.zeros((n, 3))
        self._pushes, self._limits, self._steps = np.zeros((n, 3)), np.zeros((n, 3)), np.zeros((n, 3))
        self._anchors = self.nodes.copy()
        self._shifts, self._depths = np.zeros(n), np.zeros(n)
        self._met_bodies, self._met_normals = np.full(n, -1, dtype=np.int64), np.zeros((n, 3))
        self._factor: Factor | None = None
        self.residual_n, self.steps_taken, self.tangents_made = 0.0, 0, 0
        self._is_changed, self.is_gone = True, False

    def _frictions_of(self, scene: Scene, layer: FilmProperties) -> Array:
        """Friction of the film on the box whose edge each node is on, shape [n]."""
        pallet = scene.pallet_box
        surfaces = [pallet.surface if pallet is not None else ""] + [p.surface for p in scene.packages]
        met = {surfaces[owner]: 0.0 for owner in self._owners[self._is_edge]}
        known = {surface: layer.friction_on(surface) for surface in met}
        return np.array([
            known[surfaces[owner]] if is_edge else 0.0
            for owner, is_edge in zip(self._owners, self._is_edge, strict=True)
        ])  # fmt: skip

    def _lay(
        self, layer: FilmProperties, triangles: Indices, layers: Array, spacing: float, tolerance: float
    ) -> None:
        """Makes the elements, stretched around the load and free of pull upwards."""
        one = plane_stress_stiffness(
            layer.around.stiffness_npm, layer.up.stiffness_npm, layer.poisson, layer.shear_npm
        )
        self._stretch = 1.0 + layer.strain
        narrowed = 1.0 - layer.poisson * layer.strain
        self._reference = flattened(self.nodes, triangles) / [self._stretch, narrowed]
        # The layer's figures are those of a metre as it is laid, the elements' those of a metre before it narrowed.
        self.film: Film = make_film(
            triangles, self._reference, narrowed * layers[:, None] * one, len(self.nodes)
        )
        self._yield_force = layer.around.yield_force_npm * narrowed * layers
        self._hardening = layer.around.hardening
        self._break_strain = np.tile([layer.around.break_strain, layer.up.break_strain], (len(layers), 1))
        pull = max(layer.strain, LEAST_STRAIN) * layer.around.stiffness_npm * layers.max()
        self._row_pull_n = pull * spacing
        self._tolerance_n = self._goal_n = tolerance * self._row_pull_n
        self._longest_m, self._longest_move_m = LONGEST_STEP * spacing, LONGEST_MOVE * spacing
        self._drag = DRAG * self.film.scale()[0]
        on_border = self._is_edge.copy()
        on_border[:: self._columns] = True
        self._numbering = number_nodes(self.film, on_border, self._columns)
        order = np.flatnonzero(on_border)
        self._border_nodes = order[np.argsort(-1 - self._numbering.places[order])]
        halves = (slice(None, self._even_count), slice(self._even_count, None))
        self._halves: list[Any] = [tuple(values[half] for values in self.film.elements) for half in halves]

    def _stiffness_on_bodies(self, body_count: int) -> Array:
        """Stiffness that each body feels on its edges [N/m], shape [body_count]: the larger of around and along them.

        All other edges held, from the tangent with the free nodes condensed out.
        """
        factor, border = self._tangent(LEAST_DAMPING * self._drag), self._border_nodes
        stiffness = np.zeros((body_count, 2))
        on_edge = np.flatnonzero(self._kinds[border] == EDGE)
        columns, owners = border % self._columns, self._owners[border]
        for way in range(2):
            core = factor.core[way::3, way::3]
            for one in on_edge:
                # Nodes of one edge of the body move together; its other edges move another way.
                same = on_edge[(columns[on_edge] == columns[one]) & (owners[on_edge] == owners[one])]
                stiffness[owners[one], way] += core[one, same].sum()
        hardest: Array = stiffness.max(axis=1)
        return hardest

    @property
    def residual(self) -> float:
        """Largest force that the last answer left unbalanced, as a share of the pull of a row of film."""
        return float(self.residual_n / self._row_pull_n)

    @property
    def is_lost(self) -> bool:
        """Whether the last answer left the film out of balance by more than its strain can be trusted with."""
        return self.residual > LOST

    @property
    def off_edges(self) -> Flags:
        """Nodes that are on no edge, shape [n]."""
        off: Flags = self._kinds != EDGE
        return off

    def stiffest_frequency(self, masses: Array) -> float:
        """√(k/m) of the body that the film as it was laid holds hardest [rad/s].

        k is Σ A11·h·(1/L_before + 1/L_after) over the body's edge nodes, h the height of a row and L the film's length
        to the next edge, and what film above and below adds to it.

        Args:
            masses: of the bodies [kg], shape [package_count + 1].
        """
        return float(np.sqrt((self._held_stiffness / masses).max()))

    def wrenches(self, positions: Array, orientations: Array) -> tuple[Array, Array]:
        """The film's forces [N] and torques about the centres [N m] on the bodies, each [package_count + 1, 3].

        They sum to nothing. Where no body has moved by more than shows, or poses aren't finite, they are the last
        ones. After a long move they are only as exact as that asks for; at the same place again they are exact.
        Read-only.

        Args:
            positions: centres [m], shape [package_count + 1, 3].
            orientations: unit quaternions x, y, z, w, shape [package_count + 1, 4].
        """
        before, turned_before = self._last_positions, self._last_orientations
        turned = 2.0 * np.abs(orientations - turned_before).max(axis=1) * self._reaches
        moved = float((np.abs(positions - before).max(axis=1) + turned).max())
        if self.is_gone or (moved <= self._still_m and not self._is_changed) or not math.isfinite(moved):
            return self._forces, self._torques
        self._is_changed = False
        self.answers += 1
        self._goal_n = min(
            max(self._tolerance_n, FOLLOWS * moved * self._hardest), LOOSEST * self._row_pull_n
        )
        parts = min(max(1, math.ceil(moved / self._longest_move_m)), MOST_PARTS)
        for part in range(1, parts + 1):
            share = part / parts
            turns = rotation_matrices(_between(turned_before, orientations, share))
            self._follow(before + share * (positions - before) if part < parts else positions, turns)
        # What a fast load left loose is made exact once it rests.
        self._is_changed = self._goal_n > self._tolerance_n or self.residual > LOOSEST
        self._last_positions, self._last_orientations = positions.copy(), orientations.copy()
        if self.is_lost and self.answers > 1:
            return self._forces, self._torques
        forces, torques = np.empty_like(positions), np.empty_like(positions)
        share_out(
            self.nodes, self._even + self._odd, self._kinds, self._holders, self._normals, self._columns,
            positions, forces, torques,
        )  # fmt: skip
        # They may be given again: nobody may add to them.
        forces.flags.writeable = torques.flags.writeable = False
        self._forces, self._torques = forces, torques
        return forces, torques

    def _follow(self, positions: Array, turns: Array) -> None:
        """Brings the film to rest around bodies that have moved a little."""
        self._moved[:] = 0.0
        before = self.nodes.copy()
        self._ride(positions, turns)
        follow(self.nodes, before, self._kinds, self._sides.before, self._sides.after, self._sides.shares)
        self._ride(positions, turns)
        self._anchors[:] = self.nodes
        self._settle(positions, turns)

    def _ride(self, positions: Array, turns: Array) -> None:
        """Takes the nodes on edges and faces along with their boxes."""
        ride(
            self._kinds, self._holders, self._signs, positions, turns, self._half_sizes, self._along, self.nodes,
            self._normals, self._axes,
        )  # fmt: skip

    def _settle(self, positions: Array, turns: Array) -> None:
        """Newton steps and contact changes in turns, until nothing is out of balance."""
        rounds, aged = 0, 0
        before, damping = np.inf, self._drag
        self._evaluate()
        for _ in range(MOST_STEPS):
            excess = largest_excess(self._kinds, self._pushes, self._limits, self._slips)
            if excess <= self._goal_n:
                rounds += 1
                if rounds > CONTACT_ROUNDS or not self._change_contacts(
                    positions, turns, may_release=rounds < CONTACT_ROUNDS
                ):
                    break
                before = np.inf
                self._evaluate()
                continue
            # An old tangent is kept as long as it promises to be done before a new one would be made.
            if aged > 0 and not excess * (excess / before) ** WORTH_STEPS <= self._goal_n:
                self._factor = None
            factor = STIFFER if excess > SLOW * before else SOFTER
            damping = min(max(factor * damping, self._drag), MOST_DAMPING * self._drag)
            before = excess
            if self._factor is None:
                self._factor, aged = self._tangent(damping), 0
            aged += 1
            if not self._step(self._factor, positions, turns):
                self._factor, damping = None, STIFFER * damping
        else:
            # Not at rest yet, but in no box.
            for _ in range(CONTACT_ROUNDS):
                if not self._change_contacts(positions, turns, may_release=False):
                    break
            self._evaluate()
        self.residual_n = largest_excess(self._kinds, self._pushes, self._limits, self._slips)

    def _tangent(self, damping: float) -> Factor:
        self.tangents_made += 1
        return factorise(
            self.film, self.nodes, self._even_count, self._even_ways, self._odd_ways, self._kinds == FACE,
            self._numbering, damping=damping,
        )  # fmt: skip

    def _evaluate(self) -> None:
        """Forces of the film, along the ways that nodes can move, and what friction holds of them."""
        set_directions(
            self.nodes, self._kinds, self._normals, self._axes, self._columns, self._even_ways, self._odd_ways
        )
        for half, forces in zip(self._halves, (self._even, self._odd), strict=True):
            triangles, inverse, area, stiffness, set_strain, torn = half
            membrane_forces(self.nodes, triangles, inverse, area, stiffness, set_strain, torn, forces)
        push_of(
            self._kinds, self._even_ways, self._odd_ways, self._even, self._odd, self._frictions, self._columns,
            self.nodes, self._anchors, self._drag, self._pushes, self._limits,
        )  # fmt: skip

    def _step(self, factor: Factor, positions: Array, turns: Array) -> bool:
        """One Newton step of nodes, slips and flows; False where the film gives way, and nothing was done."""
        numbering, border = self._numbering, self._border_nodes
        inner, outer = factor.condense(self._pushes)
        states = self._slips[border]
        kinds = self._kinds[border]
        states[kinds == FREE] = OPEN
        states[kinds == FACE] = (OPEN, OPEN, ABSENT)
        states[kinds == EDGE, 2] = ABSENT
        states[kinds == IDLE] = ABSENT
        flat, moves = states.ravel(), np.empty(numbering.border_count)
        moved = self._moved[border].ravel()
        limits = self._limits[border].ravel()
        slip_step(factor.core, outer, limits, moved, flat, moves, self._goal_n)
        factor.expand(moves, inner, self._steps)
        longest = float(np.abs(self._steps).max())
        if not longest <= WILD_STEPS * self._longest_m:
            return False
        if longest > self._longest_m:
            self._steps *= self._longest_m / longest
        self.steps_taken += 1
        slips = flat.reshape(-1, 3)
        self._slips[border] = np.where(np.abs(slips) == 1, slips, STUCK)
        downhill = slope_along(self._kinds, self._pushes, self._limits, self._slips, self._steps)
        self._move(1.0, positions, turns)
        at, low, high = 1.0, (0.0, downhill), (1.0, 0.0)
        for _ in range(SEARCHES):
            slope = slope_along(self._kinds, self._pushes, self._limits, self._slips, self._steps)
            if abs(slope) <= OVERSHOOT * downhill or (at == 1.0 and slope > 0.0):
                break
            # The slope falls along the step: its zero lies between, by false position, not too near to either end.
            low, high = (low, (at, slope)) if slope < 0.0 else ((at, slope), high)
            share = min(max(low[1] / (low[1] - high[1]), 0.1), 0.9)
            goal = low[0] + share * (high[0] - low[0])
            self._move(goal - at, positions, turns)
            at = goal
        return True

    def _move(self, share: float, positions: Array, turns: Array) -> None:
        """Moves nodes and film along a share of the steps."""
        border, steps = self._border_nodes, share * self._steps
        self._moved[border] += np.where(self._is_edge[border, None], steps[border], 0.0)
        move_nodes(
            steps, self._kinds, self._even_ways, self._columns, self._sides.before, self._sides.after,
            self._sides.shares, self._stretch, self.nodes, self._along, self._shifts,
        )  # fmt: skip
        if self._shifts.any():
            film = self.film
            shift_reference(film.triangles, self._shifts, self._reference, film.inverse_reference, film.area)
        self._ride(positions, turns)
        self._evaluate()

    def _change_contacts(self, positions: Array, turns: Array, *, may_release: bool) -> bool:
        """Puts nodes that are in boxes onto faces, and lets go what the film pulls off; whether anything changed."""
        before = self._kinds.copy()
        held_by = self._holders.copy()
        forces = self._even + self._odd
        if may_release:
            edges = np.flatnonzero(self._kinds == EDGE)
            pull = (
                np.einsum("nk,nkj->nj", forces[edges], turns[self._owners[edges]])[:, :2] * self._signs[edges]
            )
            off = edges[(pull >= 0.0).all(axis=1) & (pull.max(axis=1) > self._goal_n)]
            faces = np.flatnonzero(self._kinds == FACE)
            outward = np.einsum("nk,nk->n", forces[faces], self._normals[faces])
            off = np.concatenate([off, faces[outward > self._goal_n]])
        else:
            off = np.array([], dtype=np.int64)
        find_faces(
            self.nodes, self._outwards, self._kinds, self._holders, self._normals, positions, turns, self._half_sizes,
            self._is_solid, self._met_bodies, self._met_normals, self._depths,
        )  # fmt: skip
        met = (self._met_bodies >= 0) & (self._kinds <= FACE)
        deep = met & (self._depths > PENETRATION_M)
        left = (self._kinds == FACE) & ~met
        self._kinds[deep] = FACE
        self._holders[deep], self._normals[deep] = self._met_bodies[deep], self._met_normals[deep]
        self._kinds[left] = FREE
        self._kinds[off] = FREE
        self._catch(np.flatnonzero(deep & self._is_edge), positions, turns)
        free = self._kinds == FREE
        self._holders[free] = -1
        freed = free & (before != FREE)
        self._normals[freed] = self._outwards[freed]
        self._slips[self._kinds != EDGE] = STUCK
        self._moved[self._kinds != before] = 0.0
        changed = bool((self._kinds != before).any() or (self._holders != held_by).any())
        if ((self._kinds == EDGE) != (before == EDGE)).any():
            self._factor = None
        if changed:
            self._ride(positions, turns)
        return changed

    def _catch(self, nodes: Indices, positions: Array, turns: Array) -> None:
        """Nodes that were let go and have met their own box again near its edge are on it again."""
        owners = self._owners[nodes]
        local = np.einsum("nk,nkj->nj", self.nodes[nodes] - positions[owners], turns[owners])
        room = self._half_sizes[owners, :2] - local[:, :2] * self._signs[nodes]
        back = ((room > -CATCH_M) & (room < CATCH_M)).all(axis=1) & (self._holders[nodes] == owners)
        caught = nodes[back]
        self._kinds[caught], self._holders[caught] = EDGE, self._owners[caught]
        self._along[caught] = local[back, 2]

    def commit(self) -> float:
        """Lets overloaded film flow and tear, once a step; gives the elastic energy that it lost [J]."""
        film = self.film
        lost = 0.0
        if self.answers == self._committed:
            return lost
        self._committed = self.answers
        if np.isfinite(self._yield_force).any():
            flowed, count = yield_film(self.nodes, *film.elements, self._yield_force, self._hardening)
            lost += flowed
            self._is_changed |= count > 0
        if self._tears:
            torn, freed = tear_film(self.nodes, *film.elements, self._break_strain)
            lost += freed
            if len(torn):
                self._lose_bare_nodes()
        return lost

    def _lose_bare_nodes(self) -> None:
        """Takes the nodes out that have no whole element any more."""
        whole = self.film.triangles[~self.film.torn]
        self._kinds[np.bincount(whole.ravel(), minlength=len(self.nodes)) == 0] = IDLE
        self._slips[self._kinds == IDLE] = STUCK
        self._factor, self._is_changed = None, True

    def let_go(self) -> None:
        """Holds nothing from now on: what it would do to a load that has fallen is not followed."""
        self.is_gone, self.residual_n = True, 0.0
        self._forces, self._torques = np.zeros_like(self._forces), np.zeros_like(self._torques)

    _KEPT: Sequence[str] = (
        "nodes", "_reference", "_along", "_kinds", "_holders", "_normals", "_axes", "_slips", "_yield_force",
        "_last_positions", "_last_orientations", "_forces", "_torques",
    )  # fmt: skip
    _KEPT_ELEMENTS: Sequence[str] = ("inverse_reference", "area", "set_strain", "torn")

    def state(self) -> State:
        """All that the film remembers; :meth:`restore` takes it back to the bit."""
        own = tuple(getattr(self, name).copy() for name in self._KEPT)
        elements = tuple(getattr(self.film, name).copy() for name in self._KEPT_ELEMENTS)
        return own, elements, (self._factor, self._is_changed, self.is_gone, self.residual_n)

    def restore(self, state: State) -> None:
        """Takes the film back to a state that :meth:`state` gave."""
        own, elements, (self._factor, self._is_changed, self.is_gone, self.residual_n) = state
        self.nodes[:] = own[0]
        for name, value in zip(self._KEPT[1:], own[1:], strict=True):
            setattr(self, name, value.copy())
        for name, value in zip(self._KEPT_ELEMENTS, elements, strict=True):
            getattr(self.film, name)[...] = value


def _between(first: Array, second: Array, share: float) -> Array:
    """Orientations part of the way from the first to the second, which is near; shape [n, 4]."""
    if share == 1.0:
        return second
    mixed = first + share * (second * np.sign(np.einsum("nk,nk->n", first, second))[:, None] - first)
    result: Array = mixed / np.linalg.norm(mixed, axis=1, keepdims=True)
    return result
