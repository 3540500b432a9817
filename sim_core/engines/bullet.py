"""PyBullet behind the engine interface: the settings that hold, the traps avoided."""

import math
import os
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from config.scene import RecordedSled, Scene, direction_vector
from sim_core.engines import ContactState
from sim_core.frames import GRAVITY, Array
from sim_core.friction import friction_factors
from sim_core.geometry import turned_by_half_step, yaw_quaternion
from sim_core.rigid_model import RigidBox, build_rigid_model, with_sheets


def _import_pybullet() -> Any:
    # The module greets with its build time on standard error, which belongs to our own messages.
    kept = os.dup(2)
    sink = os.open(os.devnull, os.O_WRONLY)
    os.dup2(sink, 2)
    try:
        import pybullet
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(sink)
    return pybullet


p = _import_pybullet()

Triple = tuple[float, float, float]

SLED_SIZE_M = (200.0, 200.0, 1.0)
STILL_MPS = 1.0e-3
"""Slower bodies (or radians a second) are not moved when the step changes: it would be by less than a micrometre."""


@dataclass(frozen=True)
class PlanTurn:
    """A turn about z from the engine's own frame, whose x runs along the sled's travel, to frame ``sled``.

    Bullet's friction cone is skewed for motion off its world's axes: a 4:3 box that should slide straight at 45
    degrees drifts off by 8. Along an axis it is right, so the engine's world is laid along the travel.

    Attributes:
        degrees: the turn [deg].
    """

    degrees: float

    @classmethod
    def along(cls, scene: Scene) -> "PlanTurn":
        """The turn that lays x along the scene's sled; none for a recorded one, which may go any way."""
        if isinstance(scene.sled, RecordedSled):
            return cls(0.0)
        x, y = direction_vector(scene.sled.direction)
        return cls(math.degrees(math.atan2(y, x)))

    def __bool__(self) -> bool:
        return self.degrees != 0.0

    def to_engine(self, vectors: Array) -> Array:
        """Vectors of frame ``sled`` in the engine's frame, shape [n, 3]."""
        return vectors @ self._matrix if self else vectors

    def to_sled(self, vectors: Array) -> Array:
        """Vectors of the engine's frame in frame ``sled``, shape [n, 3]."""
        return vectors @ self._matrix.T if self else vectors

    def orientations_to_sled(self, orientations: Array) -> Array:
        """Unit quaternions x, y, z, w, shape [n, 4], turned from the engine's frame into frame ``sled``."""
        if not self:
            return orientations
        x, y, z, w = orientations.T
        _, _, s, c = yaw_quaternion(self.degrees)
        return np.stack([c * x - s * y, c * y + s * x, c * z + s * w, c * w - s * z], axis=1)

    @cached_property
    def _matrix(self) -> Array:
        """Rows are frame ``sled``'s axes in the engine's frame; a quarter turn is exact."""
        x, y = direction_vector(self.degrees)
        return np.array([[x, -y, 0.0], [y, x, 0.0], [0.0, 0.0, 1.0]])


class BulletEngine:
    """Boxes as btMultiBody bases in a sled-fixed frame, the sled's acceleration as tilted gravity.

    Bodies are created from the ground up, whatever the scene's order: the solver visits contacts in
    that order, so a result doesn't depend on how the file lists its packages.

    Args:
        scene: a resolved scene.
    """

    name = "bullet"
    impact_share = 0.25
    # (14 mm/s)²: sound stacks of five layers stay below 5e-5, a column of ten has 1.4e-4, 1:100 heavy on light 7e-3.
    residual_limit: float | None = 2.0e-4

    def __init__(self, scene: Scene) -> None:
        self._step_s = scene.time_step_s
        self._client = p.connect(p.DIRECT)
        self._turn = PlanTurn.along(scene)
        self._configure(scene)
        self._model = build_rigid_model(scene)
        self._friction = friction_factors(self._model.friction, touching=self._model.touching)
        self.unmet_friction = self._friction.unmet
        self._names: dict[int, str] = {}
        self._edges: dict[int, float] = {}
        self._build(scene)
        self._start = self._starting_poses(scene)
        self._last_islands: object = ()
        self._state: tuple[Array, Array] | None = None
        self._motion: tuple[Array, Array] | None = None

    def _configure(self, scene: Scene) -> None:
        wanted = {
            "fixedTimeStep": scene.time_step_s,
            # Forces are held over sub-steps and contact forces come out too small: never sub-step.
            "numSubSteps": 0,
            "numSolverIterations": scene.iterations,
            "solverResidualThreshold": 0.0,
            "contactERP": 0.2,
            "contactSlop": 1.0e-5,
            "enableConeFriction": 1,
            "deterministicOverlappingPairs": 1,
            "reportSolverAnalytics": 1,
        }
        p.setPhysicsEngineParameter(**wanted, physicsClientId=self._client)
        read_back = p.getPhysicsEngineParameters(physicsClientId=self._client)
        self.settings: Mapping[str, object] = {
            **wanted,
            **{key: read_back[key] for key in wanted if key in read_back},
            "gravity": GRAVITY,
            "body": "btMultiBody",
        }

    def _build(self, scene: Scene) -> None:
        factors = self._friction.factors
        sled = RigidBox("sled", SLED_SIZE_M, 0.0, (0.0, 0.0, -SLED_SIZE_M[2] / 2.0), 0.0, "sled")
        self._ground = {self._add_box(sled, factors)}
        boxes = self._model.boxes
        bodies: list[int | None] = [None] * len(boxes)
        places = self._turn.to_engine(np.array([(0.0, 0.0, 0.0), *(q.position_m for q in scene.packages)]))
        order = sorted(
            (row for row, box in enumerate(boxes) if box is not None),
            key=lambda row: (row > 0, np.round(places[row, ::-1], 9).tolist(), row),
        )
        for row in order:
            box = boxes[row]
            assert box is not None
            bodies[row] = self._add_box(box, factors)
        pallet = boxes[0]
        self._still_pallet: Triple = pallet.position_m if pallet is not None else (0.0, 0.0, 0.0)
        self._pallet_moves = pallet is not None and pallet.mass_kg > 0.0
        if bodies[0] is not None and not self._pallet_moves:
            self._ground.add(bodies[0])
        self._moving = [
            (row, body)
            for row, body in enumerate(bodies)
            if body is not None and (row > 0 or self._pallet_moves)
        ]
        self._rows = np.array([row for row, _ in self._moving], dtype=int)

    def _starting_poses(self, scene: Scene) -> tuple[Array, Array]:
        positions = np.array([self._still_pallet, *(package.position_m for package in scene.packages)])
        turns = [yaw_quaternion(package.yaw_deg) for package in scene.packages]
        return positions, np.array([(0.0, 0.0, 0.0, 1.0), *turns])

    def _add_box(self, box: RigidBox, factors: Mapping[str, float]) -> int:
        length, width, height = box.size_m
        shape = p.createCollisionShape(
            p.GEOM_BOX,
            halfExtents=(length / 2.0, width / 2.0, (height + box.sheet_m) / 2.0),
            collisionFramePosition=(0.0, 0.0, box.sheet_m / 2.0),
            physicsClientId=self._client,
        )
        body = int(
            p.createMultiBody(
                box.mass_kg,
                shape,
                -1,
                self._turn.to_engine(np.array([box.position_m]))[0].tolist(),
                yaw_quaternion(box.yaw_deg - self._turn.degrees),
                physicsClientId=self._client,
            )
        )
        inertia = [
            box.mass_kg * (a * a + b * b) / 12.0
            for a, b in ((width, height), (length, height), (length, width))
        ]
        # Bullet damps every btMultiBody by 4 % unless told otherwise.
        p.changeDynamics(
            body, -1, lateralFriction=factors.get(box.face, 1.0), restitution=0.0, linearDamping=0.0,
            angularDamping=0.0, rollingFriction=0.0, spinningFriction=0.0,
            physicsClientId=self._client, **({"localInertiaDiagonal": inertia} if box.mass_kg > 0.0 else {}),
        )  # fmt: skip
        self._names[body] = box.name
        self._edges[body] = min(box.size_m)
        return body

    def step(self, delta_velocity: Array, forces: Array | None, torques: Array | None = None) -> None:
        """See ``RigidEngine.step``."""
        x, y, z = self._turn.to_engine(-delta_velocity[None] / self._step_s)[0].tolist()
        p.setGravity(x, y, z - GRAVITY, physicsClientId=self._client)
        if forces is not None:
            positions = self._turn.to_engine(self.poses()[0]).tolist()
            turned = self._turn.to_engine(forces).tolist()
            for row, body in self._moving:
                force = turned[row]
                if any(force):
                    p.applyExternalForce(
                        body, -1, force, positions[row], p.WORLD_FRAME, physicsClientId=self._client
                    )
        if torques is not None:
            turned = self._turn.to_engine(torques).tolist()
            for row, body in self._moving:
                if any(turned[row]):
                    p.applyExternalTorque(body, -1, turned[row], p.WORLD_FRAME, physicsClientId=self._client)
        self._state = self._motion = None
        self._last_islands = p.stepSimulation(physicsClientId=self._client)

    def poses(self) -> tuple[Array, Array]:
        """See ``RigidEngine.poses``."""
        if self._state is None:
            positions, orientations = self._start[0].copy(), self._start[1].copy()
            if self._moving:
                # One array of all numbers: a row at a time takes three times as long.
                client, get = self._client, p.getBasePositionAndOrientation
                read = [get(body, physicsClientId=client) for _, body in self._moving]
                state = np.array([(*place, *turn) for place, turn in read])
                positions[self._rows] = self._turn.to_sled(state[:, :3])
                orientations[self._rows] = self._turn.orientations_to_sled(state[:, 3:])
            self._state = with_sheets(self._model, positions, at_rest=self._start[0]), orientations
        return self._state

    def velocities(self) -> tuple[Array, Array]:
        """See ``RigidEngine.velocities``."""
        if self._motion is None:
            linear, angular = np.zeros_like(self._start[0]), np.zeros_like(self._start[0])
            if self._moving:
                client, get = self._client, p.getBaseVelocity
                read = [get(body, physicsClientId=client) for _, body in self._moving]
                state = np.array([(*speed, *spin) for speed, spin in read])
                linear[self._rows] = self._turn.to_sled(state[:, :3])
                angular[self._rows] = self._turn.to_sled(state[:, 3:])
            self._motion = with_sheets(self._model, linear), angular
        return self._motion

    def contacts(self) -> ContactState:
        """See ``RigidEngine.contacts``."""
        points = p.getContactPoints(physicsClientId=self._client)
        depth, relative, deepest = 0.0, 0.0, ("", "")
        for point in points:
            first, second, distance = point[1], point[2], point[8]
            depth = max(depth, -distance)
            share = -distance / min(self._edges[first], self._edges[second])
            if share > relative:
                relative, deepest = share, (self._names[first], self._names[second])
        return ContactState(len(points), depth, relative, deepest)

    def support_n(self) -> float:
        """See ``RigidEngine.support_n``."""
        points = p.getContactPoints(physicsClientId=self._client)
        return float(
            sum(point[9] * abs(point[7][2]) for point in points if self._ground & {point[1], point[2]})
        )

    def residual(self) -> float:
        """Largest remaining residual over the islands of the last step, in Bullet's velocity measure."""
        islands = self._last_islands
        if not isinstance(islands, (list, tuple)):
            return 0.0
        return max((float(island["remainingResidual"]) for island in islands), default=0.0)

    def snapshot(self) -> int:
        """See ``RigidEngine.snapshot``."""
        return int(p.saveState(physicsClientId=self._client))

    def restore(self, handle: int) -> None:
        """See ``RigidEngine.restore``."""
        p.restoreState(stateId=handle, physicsClientId=self._client)
        self._state = self._motion = None

    def forget(self, handle: int) -> None:
        """See ``RigidEngine.forget``."""
        p.removeState(handle, physicsClientId=self._client)

    def set_step(self, step_s: float) -> None:
        """See ``RigidEngine.set_step``."""
        p.setPhysicsEngineParameter(fixedTimeStep=step_s, physicsClientId=self._client)
        back_s, self._step_s = self._step_s - step_s, step_s
        bodies = [body for _, body in self._moving]
        if not bodies:
            return
        poses = [p.getBasePositionAndOrientation(body, physicsClientId=self._client) for body in bodies]
        motions = [p.getBaseVelocity(body, physicsClientId=self._client) for body in bodies]
        positions, orientations = (np.array(part) for part in zip(*poses, strict=True))
        linear, angular = (np.array(part) for part in zip(*motions, strict=True))
        places = (positions - 0.5 * back_s * linear).tolist()
        turns = turned_by_half_step(orientations, angular, back_s).tolist()
        is_moving = (np.abs(linear) > STILL_MPS).any(axis=1) | (np.abs(angular) > STILL_MPS).any(axis=1)
        for index in np.flatnonzero(is_moving):
            body, motion = bodies[index], motions[index]
            p.resetBasePositionAndOrientation(body, places[index], turns[index], physicsClientId=self._client)
            # A reset pose leaves the body at rest.
            p.resetBaseVelocity(body, *motion, physicsClientId=self._client)
        self._state = self._motion = None

    def close(self) -> None:
        """See ``RigidEngine.close``."""
        if self._client >= 0:
            p.disconnect(physicsClientId=self._client)
            self._client = -1
