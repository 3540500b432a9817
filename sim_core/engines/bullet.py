"""PyBullet behind the engine interface: the settings that hold, the traps avoided."""

import os
from collections.abc import Mapping

import numpy as np

from config.scene import Scene
from config.scene_file import friction_table
from sim_core.engines import ContactState
from sim_core.frames import GRAVITY, Array
from sim_core.friction import friction_factors
from sim_core.geometry import yaw_quaternion
from sim_core.integrity import touching_surfaces


def _import_pybullet():  # type: ignore[no-untyped-def]
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
Quadruple = tuple[float, float, float, float]

SLED_HALF_SIZE_M = (10.0, 10.0, 0.5)


class BulletEngine:
    """Boxes as btMultiBody bases in a sled-fixed frame, the sled's acceleration as tilted gravity.

    Bodies are created from the ground up, whatever the scene's order: the solver visits contacts in
    that order, so a result doesn't depend on how the file lists its packages.

    Args:
        scene: a resolved scene.
    """

    name = "bullet"

    def __init__(self, scene: Scene) -> None:
        self._step_s = scene.time_step_s
        self._client = p.connect(p.DIRECT)
        self._configure(scene)
        self._friction = friction_factors(friction_table(scene), touching=touching_surfaces(scene))
        self.unmet_friction = self._friction.unmet
        self._names: dict[int, str] = {}
        self._edges: dict[int, float] = {}
        self._bodies = self._build(scene)
        self._last_islands: object = ()
        self._state: tuple[list[Triple], list[Quadruple]] | None = None

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

    def _build(self, scene: Scene) -> list[int | None]:
        factors = self._friction.factors
        ground = self._add_box("sled", (*SLED_HALF_SIZE_M,), 0.0, (0.0, 0.0, -SLED_HALF_SIZE_M[2]), 0.0,
                               factors.get("sled", 1.0))  # fmt: skip
        self._ground = {ground}
        bodies: list[int | None] = [None] * (len(scene.packages) + 1)
        pallet = scene.pallet_box
        if pallet is not None:
            half = tuple(edge / 2.0 for edge in pallet.size_m)
            bodies[0] = self._add_box(
                "pallet", half, 0.0 if pallet.fixed else pallet.mass_kg, (0.0, 0.0, half[2]), 0.0,
                factors.get(pallet.surface, 1.0),
            )  # fmt: skip
            if pallet.fixed:
                self._ground.add(bodies[0])
        self._still_pallet: Triple = (0.0, 0.0, pallet.size_m[2] / 2.0 if pallet is not None else 0.0)
        self._pallet_moves = pallet is not None and not pallet.fixed
        order = sorted(
            range(len(scene.packages)), key=lambda i: (scene.packages[i].position_m[::-1], scene.packages[i].id)
        )
        for index in order:
            package = scene.packages[index]
            bodies[index + 1] = self._add_box(
                package.id, tuple(edge / 2.0 for edge in package.size_m), package.mass_kg, package.position_m,
                package.yaw_deg, factors.get(package.surface, 1.0),
            )  # fmt: skip
        self._moving = bodies[0 if self._pallet_moves else 1 :]
        return bodies

    def _add_box(
        self,
        name: str,
        half_size: tuple[float, ...],
        mass: float,
        position: tuple[float, ...],
        yaw_deg: float,
        friction: float,
    ) -> int:
        shape = p.createCollisionShape(p.GEOM_BOX, halfExtents=half_size, physicsClientId=self._client)
        body = int(
            p.createMultiBody(
                mass, shape, -1, position, yaw_quaternion(yaw_deg), physicsClientId=self._client
            )
        )
        # Bullet damps every btMultiBody by 4 % unless told otherwise.
        p.changeDynamics(
            body, -1, lateralFriction=friction, restitution=0.0, linearDamping=0.0, angularDamping=0.0,
            rollingFriction=0.0, spinningFriction=0.0, physicsClientId=self._client,
        )  # fmt: skip
        self._names[body] = name
        self._edges[body] = 2.0 * min(half_size)
        return body

    def step(self, delta_velocity: Array, forces: Array | None) -> None:
        """See ``RigidEngine.step``."""
        x, y, z = (-delta_velocity / self._step_s).tolist()
        p.setGravity(x, y, z - GRAVITY, physicsClientId=self._client)
        if forces is not None:
            positions = self._read_state()[0]
            for body, force, position in zip(self._bodies, forces.tolist(), positions, strict=True):
                if body is not None and any(force):
                    p.applyExternalForce(body, -1, force, position, p.WORLD_FRAME, physicsClientId=self._client)
        self._state = None
        self._last_islands = p.stepSimulation(physicsClientId=self._client)

    def poses(self) -> tuple[Array, Array]:
        """See ``RigidEngine.poses``."""
        positions, orientations = self._read_state()
        return np.array(positions), np.array(orientations)

    def _read_state(self) -> tuple[list[Triple], list[Quadruple]]:
        if self._state is None:
            positions, orientations = [self._still_pallet], [(0.0, 0.0, 0.0, 1.0)]
            for body in self._moving:
                position, orientation = p.getBasePositionAndOrientation(body, physicsClientId=self._client)
                positions.append(position)
                orientations.append(orientation)
            first = 1 if self._pallet_moves else 0
            self._state = positions[first:], orientations[first:]
        return self._state

    def velocities(self) -> tuple[Array, Array]:
        """See ``RigidEngine.velocities``."""
        pairs = [] if self._pallet_moves else [((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))]
        pairs += [p.getBaseVelocity(body, physicsClientId=self._client) for body in self._moving]
        both = np.array(pairs)
        return both[:, 0], both[:, 1]

    def contacts(self) -> ContactState:
        """See ``RigidEngine.contacts``."""
        points = p.getContactPoints(physicsClientId=self._client)
        depth, relative, deepest, support = 0.0, 0.0, ("", ""), 0.0
        for point in points:
            first, second, distance = point[1], point[2], point[8]
            depth = max(depth, -distance)
            share = -distance / min(self._edges[first], self._edges[second])
            if share > relative:
                relative, deepest = share, (self._names[first], self._names[second])
            if first in self._ground or second in self._ground:
                support += point[9] * abs(point[7][2])
        return ContactState(len(points), depth, relative, deepest, support)

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
        self._state = None

    def close(self) -> None:
        """See ``RigidEngine.close``."""
        if self._client >= 0:
            p.disconnect(physicsClientId=self._client)
            self._client = -1
