"""MuJoCo behind the engine interface, with hard contacts that obey Coulomb's law and a friction for each pair.

MuJoCo solves a convex problem, in which a contact that slides with v must also open with μ·v: a sliding
block hops, by millimetres, at any step. What removes it is known from De Saxcé and Feng (1998): take
μ·|residual tangential acceleration| off the wanted normal acceleration, and a fixed point of that is
Coulomb's law. The last step's accelerations predict the shift, so that one solve is enough while
nothing changes abruptly; where the prediction misses, the step is solved again.

Contacts are found a little before they close, and may close within a step but not cross (Stewart and
Trinkle 1996): a contact that lets go for a moment, or an impact, then costs no overlap and no push back.
"""

from collections.abc import Mapping, Sequence
from itertools import combinations_with_replacement
from typing import Any
from xml.etree.ElementTree import Element, SubElement, tostring

import mujoco
import numpy as np

from config.scene import Scene
from sim_core.engines import ContactState
from sim_core.frames import GRAVITY, Array
from sim_core.friction import UnmetPair
from sim_core.geometry import rotation_matrices, yaw_quaternion
from sim_core.rigid_model import RigidBox, RigidModel, build_rigid_model, with_sheets

IMPEDANCE = 0.995
"""Share of the wanted contact acceleration that is met; the rest is the contact's softness."""
IMPRATIO = 100.0
"""Friction is this much harder than the normal direction, which keeps its regularised creep small."""
PUSH_OUT = 0.25
"""Share of an overlap that a step takes back."""
MARGIN_M = (1.0e-4, 1.0e-3)
"""Least and largest distance at which a contact is looked for: as far as the fastest body goes in a step."""
SHIFT_TOLERANCE_MPS = 5.0e-4
"""A wrong shift opens a contact at this speed: it lands again, under gravity, within 0.1 ms."""
SOLVES_A_STEP = 4
TOLERANCE, TOLERANCE_WRAPPED = 1.0e-10, 1.0e-8
"""Newton's method stops at this; under a film the last digits cost a quarter of the time and change nothing by a tenth
of a millimetre (37.13 and 37.04 mm of slip)."""
LEAST_ITERATIONS_WRAPPED = 100
"""Newton's method stops by itself: cut off after 20 iterations a wrapped load slid by 39 mm instead of 29."""
UNKNOWN_FRICTION = 0.5
"""For pairs that no table names and that don't touch at the start."""


class MujocoEngine:
    """Boxes as free bodies in a sled-fixed frame, the sled's acceleration as tilted gravity.

    Args:
        scene: a resolved scene.
    """

    name = "mujoco"
    impact_share = 0.75
    # Newton's method converges or says so; its gradient has no fixed measure.
    residual_limit: float | None = None

    def __init__(self, scene: Scene) -> None:
        self._step_s = scene.time_step_s
        self._model = build_rigid_model(scene)
        self._mj: Any = mujoco.MjModel.from_xml_string(_xml(self._model, scene))
        self._data: Any = mujoco.MjData(self._mj)
        pallet = self._model.boxes[0]
        pallet_at = pallet.position_m if pallet is not None else (0.0, 0.0, 0.0)
        self._start_positions = np.array([pallet_at, *(p.position_m for p in scene.packages)])
        self._start_orientations = np.array(
            [(0.0, 0.0, 0.0, 1.0), *(yaw_quaternion(p.yaw_deg) for p in scene.packages)]
        )
        self._rows = np.array(_moving_rows(self._model), dtype=int)
        self._bodies = np.array([self._mj.body(f"row_{row}").id for row in self._rows], dtype=int)
        self._snapshots: dict[int, Array] = {}
        self._handles = 0
        self._state: tuple[Array, Array] | None = None
        self._motion: tuple[Array, Array] | None = None
        mujoco.mj_forward(self._mj, self._data)
        option = self._mj.opt
        self.settings: Mapping[str, object] = {
            "version": mujoco.__version__,
            "timestep": float(option.timestep),
            "iterations": int(option.iterations),
            "tolerance": float(option.tolerance),
            "impratio": float(option.impratio),
            "cone": mujoco.mjtCone(option.cone).name,
            "solver": mujoco.mjtSolver(option.solver).name,
            "impedance": float(self._mj.geom_solimp[0, 0]),
            "push_out": PUSH_OUT,
            "margin_m": list(MARGIN_M),
            "shift_tolerance_mps": SHIFT_TOLERANCE_MPS,
            "solves_a_step": SOLVES_A_STEP,
            "gravity": GRAVITY,
        }

    @property
    def unmet_friction(self) -> Sequence[UnmetPair]:
        """None: every pair has its own friction."""
        return ()

    def step(self, delta_velocity: Array, forces: Array | None, torques: Array | None = None) -> None:
        """See ``RigidEngine.step``."""
        self._mj.opt.gravity[:] = -delta_velocity / self._step_s
        self._mj.opt.gravity[2] -= GRAVITY
        if forces is not None:
            self._data.xfrc_applied[self._bodies, :3] = forces[self._rows]
        if torques is not None:
            self._data.xfrc_applied[self._bodies, 3:] = torques[self._rows]
        model, data = self._mj, self._data
        self._state = self._motion = None
        self._set_margin()
        mujoco.mj_step1(model, data)
        mujoco.mj_fwdActuation(model, data)
        mujoco.mj_fwdAcceleration(model, data)
        self._solve_contacts()
        mujoco.mj_Euler(model, data)

    def _set_margin(self) -> None:
        speed = float(np.abs(self._data.qvel).max(initial=0.0))
        margin = min(max(1.1 * speed * self._step_s, MARGIN_M[0]), MARGIN_M[1])
        self._mj.geom_margin[:] = self._mj.pair_margin[:] = margin

    def _solve_contacts(self) -> None:
        """Solves for the accelerations, until the friction shift that went in is the one that comes out."""
        model, data, h = self._mj, self._data, self._step_s
        normal = data.contact.efc_address
        rubs = data.contact.dim > 1
        rubbing = normal[rubs]
        if not len(normal):
            mujoco.mj_fwdConstraint(model, data)
            return
        friction, distance, wanted = data.contact.friction[rubs, 0], data.contact.dist, data.efc_aref
        # Velocity after the step: what is left of an open distance, or a share of an overlap, over the step.
        goal = -(data.efc_vel[normal] + np.where(distance > 0.0, distance, PUSH_OUT * distance) / h) / h
        reached = np.empty(data.nefc)

        def shift() -> Array:
            mujoco.mj_mulJacVec(model, data, reached, data.qacc_warmstart)
            first, second = (reached[rubbing + k] - wanted[rubbing + k] for k in (1, 2))
            pushed = np.zeros(len(normal))
            pushed[rubs] = friction * np.hypot(first, second)
            return pushed

        expected = shift()
        for _ in range(SOLVES_A_STEP):
            wanted[normal] = goal - expected
            mujoco.mj_fwdConstraint(model, data)
            data.qacc_warmstart[:] = data.qacc
            found = shift()
            if np.abs(found - expected).max() * h <= SHIFT_TOLERANCE_MPS:
                break
            expected = found

    def poses(self) -> tuple[Array, Array]:
        """See ``RigidEngine.poses``."""
        if self._state is None:
            positions, orientations = self._start_positions.copy(), self._start_orientations.copy()
            state = self._data.qpos.reshape(-1, 7)
            positions[self._rows] = state[:, :3]
            orientations[self._rows] = state[:, [4, 5, 6, 3]]
            self._state = with_sheets(self._model, positions, at_rest=self._start_positions), orientations
        return self._state

    def velocities(self) -> tuple[Array, Array]:
        """See ``RigidEngine.velocities``."""
        if self._motion is None:
            linear, angular = np.zeros_like(self._start_positions), np.zeros_like(self._start_positions)
            state = self._data.qvel.reshape(-1, 6)
            linear[self._rows] = state[:, :3]
            # A free joint's angular velocity stands in the body's own frame.
            turns = rotation_matrices(self._data.qpos.reshape(-1, 7)[:, [4, 5, 6, 3]])
            angular[self._rows] = np.einsum("nij,nj->ni", turns, state[:, 3:])
            self._motion = with_sheets(self._model, linear), angular
        return self._motion

    def contacts(self) -> ContactState:
        """See ``RigidEngine.contacts``."""
        contact = self._data.contact
        if not len(contact.dist):
            return ContactState(0, 0.0, 0.0, ("", ""))
        depths = np.maximum(-contact.dist, 0.0)
        edges = 2.0 * self._mj.geom_size.min(axis=1)
        shares = depths / edges[contact.geom].min(axis=1)
        worst = int(shares.argmax())
        names = tuple(self._mj.geom(int(geom)).name for geom in contact.geom[worst])
        return ContactState(
            count=len(depths),
            penetration_m=float(depths.max()),
            relative_penetration=float(shares[worst]),
            deepest=(names[0], names[1]),
        )

    def support_n(self) -> float:
        """See ``RigidEngine.support_n``."""
        grounds = {geom for geom in range(self._mj.ngeom) if self._mj.geom_bodyid[geom] == 0}
        total, force = 0.0, np.zeros(6)
        for index in range(self._data.ncon):
            contact = self._data.contact[index]
            if grounds & set(contact.geom.tolist()):
                mujoco.mj_contactForce(self._mj, self._data, index, force)
                total += force[0] * abs(contact.frame[2])
        return float(total)

    def residual(self) -> float:
        """Norm of the constraint solver's gradient after its last iteration, largest of all islands."""
        count = max(1, int(self._data.nisland))
        largest = 0.0
        for island in range(min(count, len(self._data.solver_niter))):
            last = int(self._data.solver_niter[island]) - 1
            if last >= 0:
                largest = max(largest, float(self._data.solver[island * mujoco.mjNSOLVER + last].gradient))
        return largest

    def snapshot(self) -> int:
        """See ``RigidEngine.snapshot``."""
        kind = mujoco.mjtState.mjSTATE_INTEGRATION
        state = np.empty(mujoco.mj_stateSize(self._mj, kind))
        mujoco.mj_getState(self._mj, self._data, state, kind)
        self._handles += 1
        self._snapshots[self._handles] = state
        return self._handles

    def restore(self, handle: int) -> None:
        """See ``RigidEngine.restore``."""
        self._state = self._motion = None
        mujoco.mj_setState(self._mj, self._data, self._snapshots[handle], mujoco.mjtState.mjSTATE_INTEGRATION)
        mujoco.mj_forward(self._mj, self._data)

    def forget(self, handle: int) -> None:
        """See ``RigidEngine.forget``."""
        del self._snapshots[handle]

    def set_step(self, step_s: float) -> None:
        """See ``RigidEngine.set_step``; the contacts' damping follows the step."""
        self._mj.geom_solref[:, 1] *= self._step_s / step_s
        self._mj.pair_solref[:, 1] *= self._step_s / step_s
        back_s = self._step_s - step_s
        self._mj.opt.timestep = self._step_s = step_s
        # Integrates every position, quaternions included, along its velocity.
        self._state = self._motion = None
        mujoco.mj_integratePos(self._mj, self._data.qpos, self._data.qvel, -0.5 * back_s)

    def close(self) -> None:
        """See ``RigidEngine.close``."""


def _moving_rows(model: RigidModel) -> list[int]:
    """Rows of the boxes that move, from the ground up, whatever the scene's order."""
    rows = [row for row, box in enumerate(model.boxes) if box is not None and (row > 0 or box.mass_kg > 0.0)]
    return sorted(rows, key=lambda row: (model.boxes[row].position_m[::-1], row))  # type: ignore[union-attr]


def _xml(model: RigidModel, scene: Scene) -> str:
    root = Element("mujoco", model="load")
    SubElement(root, "compiler", angle="radian", autolimits="true")
    is_wrapped = scene.is_held_by_film
    tolerance = TOLERANCE_WRAPPED if is_wrapped else TOLERANCE
    iterations = max(scene.iterations, LEAST_ITERATIONS_WRAPPED) if is_wrapped else scene.iterations
    option = SubElement(
        root, "option", timestep=repr(scene.time_step_s), cone="elliptic", impratio=repr(IMPRATIO),
        iterations=str(iterations), tolerance=repr(tolerance), solver="Newton", integrator="Euler",
    )  # fmt: skip
    # A state that went wild would begin anew from its start, and look sound.
    SubElement(option, "flag", autoreset="disable")
    contact = {
        # Damping 1/h asks the tangential velocity to vanish within the step; the normal rows are set by hand.
        "solref": f"-1.0 {-1.0 / scene.time_step_s!r}",
        "solimp": f"{IMPEDANCE!r} {IMPEDANCE!r} 0.001",
        "margin": repr(MARGIN_M[1]),
    }
    default = SubElement(root, "default")
    SubElement(default, "geom", contact, condim="3")
    SubElement(default, "pair", contact, condim="3")
    world = SubElement(root, "worldbody")
    SubElement(world, "geom", name="sled", type="plane", size="10 10 1")
    pallet = model.boxes[0]
    if pallet is not None and pallet.mass_kg == 0.0:
        _add_geom(world, pallet, at=pallet.position_m)
    for row in _moving_rows(model):
        _add_body(world, f"row_{row}", model.boxes[row])
    _add_frictions(root, model)
    return tostring(root, encoding="unicode")


def _add_body(world: Element, name: str, box: RigidBox | None) -> None:
    assert box is not None
    x, y, z, w = yaw_quaternion(box.yaw_deg)
    body = SubElement(world, "body", name=name, pos=_numbers(box.position_m), quat=_numbers((w, x, y, z)))
    SubElement(body, "freejoint")
    length, width, height = box.size_m
    inertia = [
        box.mass_kg * (a * a + b * b) / 12.0 for a, b in ((width, height), (length, height), (length, width))
    ]
    SubElement(body, "inertial", pos="0 0 0", mass=repr(box.mass_kg), diaginertia=_numbers(inertia))
    _add_geom(body, box, at=(0.0, 0.0, 0.0))


def _add_geom(parent: Element, box: RigidBox, *, at: tuple[float, float, float]) -> None:
    half = (box.size_m[0] / 2.0, box.size_m[1] / 2.0, (box.size_m[2] + box.sheet_m) / 2.0)
    centre = (at[0], at[1], at[2] + box.sheet_m / 2.0)
    SubElement(parent, "geom", name=box.name, type="box", size=_numbers(half), pos=_numbers(centre))


def _add_frictions(root: Element, model: RigidModel) -> None:
    """One friction for all geoms where the table has one value; else an explicit contact pair each."""
    faces = {"sled": "sled"} | {box.name: box.face for box in model.boxes if box is not None}
    known = {
        friction
        for a, b in combinations_with_replacement(set(faces.values()), 2)
        if (friction := model.friction.get(frozenset((a, b)))) is not None
    }
    if len(known) <= 1:
        friction = next(iter(known), UNKNOWN_FRICTION)
        for geom in root.iter("geom"):
            if "name" in geom.attrib:
                geom.attrib |= _friction_of(friction, "0 0")
        return
    for geom in root.iter("geom"):
        if "name" in geom.attrib:
            geom.attrib |= {"contype": "0", "conaffinity": "0"}
    pairs = SubElement(root, "contact")
    names = list(faces)
    fixed = {"sled"} | ({"pallet"} if model.boxes[0] is not None and model.boxes[0].mass_kg == 0.0 else set())
    for index, first in enumerate(names):
        for second in names[index + 1 :]:
            if first in fixed and second in fixed:
                continue
            friction = model.friction.get(frozenset((faces[first], faces[second])), UNKNOWN_FRICTION)
            names_and_friction = {"geom1": first, "geom2": second}
            SubElement(pairs, "pair", names_and_friction | _friction_of(friction, f"{friction!r} 0 0 0"))


def _friction_of(friction: float, rest: str) -> dict[str, str]:
    # MuJoCo's least friction is 1e-5; without any, a contact has no friction rows at all.
    return {"condim": "1"} if friction == 0.0 else {"friction": f"{friction!r} {rest}"}


def _numbers(values: Sequence[float]) -> str:
    return " ".join(repr(float(value)) for value in values)
