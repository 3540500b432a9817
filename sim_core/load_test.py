"""One load on the sled: settles it, then turns the sled's samples into pose frames, watching itself."""

from dataclasses import dataclass

import numpy as np

from config.errors import EndedByMonitor
from config.scene import Scene
from sim_core.engines import make_engine
from sim_core.force_fields import PerimeterForceFields
from sim_core.frames import Array, PoseFrame, SledSample
from sim_core.geometry import turned_by_half_step
from sim_core.sled import build_profile, stop_sample

# Less than 1 and 2 mm/s: boxes that stick under shear still creep in the solver, by up to half of that.
SETTLED_FOR_S, SETTLED_WITHIN_M, SETTLE_LIMIT_S = 0.05, 5.0e-5, 2.0
REST_FOR_S, REST_WITHIN_M, REST_LIMIT_S = 0.25, 5.0e-4, 3.0
MAXIMUM_SPEED_MPS = 50.0
"""Half of the 100 m/s at which btMultiBody clamps each velocity in silence."""
MAXIMUM_RELATIVE_PENETRATION = 0.02
"""Of the smaller body's smallest edge, three checks running: an impact passes, a load that sinks does not."""
PENETRATION_CHECKS = 3
CONTACT_CHECK_HZ = 30


@dataclass
class WatchedExtremes:
    """The largest values that the monitors saw.

    Attributes:
        penetration_m: deepest contact [m].
        speed_mps: largest speed relative to the sled [m/s].
        residual: largest remaining solver residual, in the engine's measure.
        contact_count: largest number of contact points.
    """

    penetration_m: float = 0.0
    speed_mps: float = 0.0
    residual: float = 0.0
    contact_count: int = 0


class RestWatch:
    """Says when no body has left its place for a while; a solver's jitter has speed but goes nowhere.

    Args:
        radii: distance of each body's corners from its centre [m], shape [n].
        within_m: how far a corner may go and still count as resting [m].
        for_s: how long [s].
    """

    def __init__(self, radii: Array, *, within_m: float, for_s: float) -> None:
        self._radii, self._within_m, self._for_s = radii, within_m, for_s
        self._since_s: float | None = None
        self._positions = self._orientations = np.zeros((0, 0))
        self.moved_m = 0.0

    def update(self, time_s: float, positions: Array, orientations: Array) -> bool:
        """Takes the poses at a time [s]; shapes [n, 3] and [n, 4]."""
        if self._since_s is not None:
            # |Δq| is half the angle of a small turn.
            turned = 2.0 * np.linalg.norm(orientations - self._orientations, axis=1) * self._radii
            self.moved_m = float((np.linalg.norm(positions - self._positions, axis=1) + turned).max())
        if self._since_s is None or self.moved_m > self._within_m:
            self._since_s, self._positions, self._orientations = time_s, positions, orientations
        return time_s - self._since_s >= self._for_s - 1.0e-9


class LoadTest:
    """The load of one scene, stepped by sled samples.

    The same samples give the same frames to the last bit, whoever feeds them and however fast.

    Args:
        scene: a resolved scene that passed its integrity check.

    Raises:
        RefusedInput: the profile cannot be built.
    """

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self.engine = make_engine(scene)
        self.extremes = WatchedExtremes()
        self.settle_s = 0.0
        self.step_count = 0
        self.finished = False
        self.at_rest = False
        self._steps_a_feed, self._samples_a_feed = scene.steps_and_samples()
        self._samples_a_frame = scene.sampling.samples_hz // scene.sampling.poses_hz
        self._step_s = scene.time_step_s
        self._stop_sample = stop_sample(scene)
        self._limit_sample = self._stop_sample + round(REST_LIMIT_S * scene.sampling.samples_hz)
        edges = [(0.0, 0.0, 0.0)] + [package.size_m for package in scene.packages]
        self._radii = 0.5 * np.linalg.norm(np.array(edges), axis=1)
        self._rest = RestWatch(self._radii, within_m=REST_WITHIN_M, for_s=REST_FOR_S)
        self._deep_checks = 0
        self._frame_count = 0
        self._frames_a_check = max(1, scene.sampling.poses_hz // CONTACT_CHECK_HZ)
        self._samples_held = 0
        self._delta_velocity = np.zeros(3)
        self._fields = self._build_fields()

    @property
    def time_s(self) -> float:
        """Simulated time since the first frame [s]."""
        return max(0, self._frame_count - 1) / self.scene.sampling.poses_hz

    def feed(self, index: int, acceleration: Array, stamp_ns: int) -> PoseFrame | None:
        """Settles on sample 0, and steps on every later one; returns a frame when one is due.

        Args:
            index: the sample's index, from 0; they must come without a gap.
            acceleration: mean acceleration over the sample's interval [m/s²], shape [3].
            stamp_ns: the sample's stamp [ns].

        Raises:
            EndedByMonitor: the load does not stand by itself, or a monitor was breached; earlier frames stand.
        """
        if index == 0:
            return self._settle(stamp_ns)
        self._delta_velocity = self._delta_velocity + acceleration / self.scene.sampling.samples_hz
        self._samples_held += 1
        if self._samples_held == self._samples_a_feed:
            share = self._delta_velocity / self._steps_a_feed
            for _ in range(self._steps_a_feed):
                self._step(share)
            self._samples_held, self._delta_velocity = 0, np.zeros(3)
        if index % self._samples_a_frame:
            return None
        frame = self._frame(stamp_ns)
        self._watch_motion()
        if frame.index % self._frames_a_check == 0:
            self._watch_contacts()
        self._look_for_rest(index, frame)
        return frame

    def take(self, sample: SledSample) -> PoseFrame | None:
        """Takes a sled sample of this process; see ``feed``."""
        return self.feed(sample.index, sample.acceleration, sample.stamp_ns)

    @property
    def unmet_friction(self) -> list[str]:
        """Surface pairs whose friction the engine cannot represent, in words."""
        return [
            f"{pair.pair[0]} on {pair.pair[1]}: wanted {pair.wanted:.3g}, used {pair.used:.3g}"
            + ("" if pair.touching else " (not touching at the start)")
            for pair in self.engine.unmet_friction
        ]

    def close(self) -> None:
        """Frees the engine."""
        self.engine.close()

    def _settle(self, stamp_ns: int) -> PoseFrame:
        """Lets the load come to rest under gravity and returns it as frame 0."""
        still = np.zeros(3)
        watch = RestWatch(self._radii, within_m=SETTLED_WITHIN_M, for_s=SETTLED_FOR_S)
        steps = 0
        while self.scene.packages and not watch.update(steps * self._step_s, *self.engine.poses()):
            self._step(still)
            steps += 1
            self._watch_motion()
            if steps * self._step_s > SETTLE_LIMIT_S:
                raise EndedByMonitor(
                    "settling",
                    f"the load moved by {1000.0 * watch.moved_m:.3f} mm within {SETTLED_FOR_S} s, after"
                    f" {SETTLE_LIMIT_S} s at rest, limit {1000.0 * SETTLED_WITHIN_M} mm: it does not stand by itself",
                    0.0,
                )
        self.settle_s = steps * self._step_s
        self._watch_contacts()
        return self._frame(stamp_ns)

    def _build_fields(self) -> PerimeterForceFields | None:
        if self.scene.force_fields is None or not self.scene.packages:
            return None
        peak = build_profile(self.scene).peak_mps2
        return PerimeterForceFields(self.scene.force_fields, self.scene, peak, *self.engine.poses())

    def _step(self, delta_velocity: Array) -> None:
        forces = self._fields.forces(*self.engine.poses()) if self._fields is not None else None
        self.engine.step(delta_velocity, forces)
        self.step_count += 1

    def _frame(self, stamp_ns: int) -> PoseFrame:
        """Poses at the stamp: a semi-implicit step leaves positions half a step of motion ahead."""
        positions, orientations = self.engine.poses()
        linear, angular = self.engine.velocities()
        frame = PoseFrame(
            index=self._frame_count,
            stamp_ns=stamp_ns,
            positions=positions - 0.5 * self._step_s * linear,
            orientations=turned_by_half_step(orientations, angular, self._step_s),
        )
        self._frame_count += 1
        return frame

    def _watch_motion(self) -> None:
        """Takes note of the largest speed of any corner.

        Raises:
            EndedByMonitor: the state is not finite, or faster than the engine can represent.
        """
        linear, angular = self.engine.velocities()
        speeds = np.linalg.norm(linear, axis=1) + np.linalg.norm(angular, axis=1) * self._radii
        speed = float(speeds.max())
        if not np.isfinite(speed) or not np.isfinite(self.engine.poses()[0]).all():
            row = int(np.argmin(np.isfinite(speeds)))
            raise EndedByMonitor(
                "finite state", f"{self._body_name(row)} has no finite pose or velocity", self.time_s
            )
        self.extremes.speed_mps = max(self.extremes.speed_mps, speed)
        if speed > MAXIMUM_SPEED_MPS:
            raise EndedByMonitor(
                "speed",
                f"{self._body_name(int(speeds.argmax()))} at {speed:.1f} m/s, limit {MAXIMUM_SPEED_MPS} m/s",
                self.time_s,
            )

    def _watch_contacts(self) -> None:
        state = self.engine.contacts()
        extremes = self.extremes
        extremes.penetration_m = max(extremes.penetration_m, state.penetration_m)
        extremes.contact_count = max(extremes.contact_count, state.count)
        extremes.residual = max(extremes.residual, self.engine.residual())
        is_deep = state.relative_penetration > MAXIMUM_RELATIVE_PENETRATION
        self._deep_checks = self._deep_checks + 1 if is_deep else 0
        if self._deep_checks >= PENETRATION_CHECKS:
            raise EndedByMonitor(
                "penetration",
                f"{state.deepest[0]} and {state.deepest[1]} overlap by {100.0 * state.relative_penetration:.1f} %"
                f" of the smaller one's smallest edge, limit {100.0 * MAXIMUM_RELATIVE_PENETRATION:.0f} %",
                self.time_s,
            )

    def _look_for_rest(self, index: int, frame: PoseFrame) -> None:
        if index < self._stop_sample:
            return
        self.at_rest = self._rest.update(self.time_s, frame.positions, frame.orientations)
        self.finished = self.at_rest or index >= self._limit_sample

    def _body_name(self, row: int) -> str:
        return "pallet" if row == 0 else self.scene.packages[row - 1].id
