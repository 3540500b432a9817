"""Rigid engines behind one small interface; each stands in its own file and is imported only when used."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

from config.errors import RefusedInput
from config.scene import Scene
from sim_core.frames import Array
from sim_core.friction import UnmetPair


@dataclass(frozen=True)
class ContactState:
    """What the contacts look like at one moment.

    Attributes:
        count: number of contact points.
        penetration_m: depth of the deepest contact [m], 0 when none is closed.
        relative_penetration: depth over the smaller body's smallest edge, the largest of all contacts.
        deepest: ids of the two bodies of that contact.
    """

    count: int
    penetration_m: float
    relative_penetration: float
    deepest: tuple[str, str]


class RigidEngine(Protocol):
    """Rigid boxes on a sled, in frame ``sled``; row 0 of every array is the pallet.

    Attributes:
        name: the engine's name.
        impact_share: largest misplacement that a blow leaves, as a share of closing speed times step.
        residual_limit: largest residual that may stay step after step, in the engine's measure, or None.
    """

    name: str
    impact_share: float
    residual_limit: float | None

    @property
    def settings(self) -> Mapping[str, object]:
        """Settings as read back from the engine, where it tells them."""

    @property
    def unmet_friction(self) -> Sequence[UnmetPair]:
        """Pairs of surfaces whose friction the engine cannot represent."""

    def step(self, delta_velocity: Array, forces: Array | None, torques: Array | None = None) -> None:
        """Advances by one step.

        Args:
            delta_velocity: change of the sled's velocity over the step [m/s], shape [3].
            forces: external force on each body's centre over the step [N], shape [n, 3], or None.
            torques: external torque about each body's centre over the step [N·m], shape [n, 3], or None.
        """

    def poses(self) -> tuple[Array, Array]:
        """Centres [m], shape [n, 3], and unit quaternions x, y, z, w, shape [n, 4]."""

    def velocities(self) -> tuple[Array, Array]:
        """Linear [m/s] and angular [rad/s] velocities relative to the sled, each of shape [n, 3]."""

    def contacts(self) -> ContactState:
        """The contacts of the last step."""

    def support_n(self) -> float:
        """Sum of the normal forces on sled and blocked pallet in the last step, along z [N]."""

    def residual(self) -> float:
        """What the constraint solver left unsolved in the last step, in the engine's own measure."""

    def snapshot(self) -> int:
        """Keeps the whole state in memory and returns its handle."""

    def restore(self, handle: int) -> None:
        """Returns to a kept state; what follows is bit-identical to what followed then."""

    def forget(self, handle: int) -> None:
        """Drops a kept state."""

    def set_step(self, step_s: float) -> None:
        """Steps by another time from now on [s].

        A semi-implicit step leaves positions half a step of motion ahead of the velocities: they are moved to be
        ahead by half of the new one.
        """

    def close(self) -> None:
        """Frees the engine."""


def make_engine(scene: Scene) -> RigidEngine:
    """Builds the engine that the scene names, with the scene's bodies in place.

    Args:
        scene: a resolved scene; an engine that is still ``auto`` is Bullet.

    Raises:
        RefusedInput: the engine is not installed.
    """
    if scene.solver.engine == "mujoco":
        try:
            from sim_core.engines.mujoco import MujocoEngine
        except ImportError:
            raise RefusedInput(
                "solver.engine", "mujoco", "is not installed: pip install 'pallet-twin[mujoco]'"
            ) from None
        return MujocoEngine(scene)
    from sim_core.engines.bullet import BulletEngine

    return BulletEngine(scene)
