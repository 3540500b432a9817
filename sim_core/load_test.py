"""One load on the sled: settles it, then turns the sled's samples into pose frames, watching itself."""

from collections.abc import Iterator
from copy import copy
from dataclasses import asdict
from typing import TYPE_CHECKING

import numpy as np

from config.errors import EndedByMonitor
from config.scene import Scene
from sim_core.energy import EnergyLedger
from sim_core.engines import make_engine
from sim_core.force_fields import PerimeterForceFields
from sim_core.frames import Array, FilmFrame, PoseFrame, SledSample
from sim_core.geometry import rotation_matrices, turned_by_half_step
from sim_core.impacts import ImpactWatch
from sim_core.integrity import supports
from sim_core.monitors import MAXIMUM_STEP_PHASE, Breach, Extremes, Monitors
from sim_core.sled import build_profile, sled_samples, stop_sample

if TYPE_CHECKING:
    from sim_core.wrap.load_film import LoadFilm, State
    from sim_core.wrap.watch import FilmWatch

# Less than 1 and 2 mm/s: boxes that stick under shear still creep in the solver, by up to half of that.
SETTLED_FOR_S, SETTLED_WITHIN_M, SETTLE_LIMIT_S = 0.05, 5.0e-5, 2.0
SETTLED_SINK_M = 3.0e-3
"""Gap (2 mm) and overlap (1 mm) that the integrity check lets a package start with."""
DRAWN_M = 10.0e-3
"""A film may close the gaps between packages, and draws them by so much at most."""
REST_FOR_S, REST_WITHIN_M, REST_LIMIT_S = 0.25, 5.0e-4, 3.0
CONTACT_CHECK_HZ = 30
SNAPSHOT_HZ = 10
MAXIMUM_HALVINGS = 3
MOST_FILM_HALVINGS = 6
"""How often a film's stiffness may halve the scene's step before anything moves."""
IMPACT_LOOKOUT_S = 1.0 / 240.0
"""How often blows are looked for, and how far ahead."""


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

    def update(self, time_s: float, positions: Array, orientations: Array) -> bool:
        """Takes the poses at a time [s]; shapes [n, 3] and [n, 4]."""
        moved_m = 0.0
        if self._since_s is not None:
            # |Δq| is half the angle of a small turn.
            turned = 2.0 * np.linalg.norm(orientations - self._orientations, axis=1) * self._radii
            moved_m = float((np.linalg.norm(positions - self._positions, axis=1) + turned).max())
        if self._since_s is None or moved_m > self._within_m:
            self._since_s, self._positions, self._orientations = time_s, positions, orientations
        return time_s - self._since_s >= self._for_s - 1.0e-9


class LoadTest:
    """The load of one scene, stepped by sled samples.

    The same samples give the same frames to the last bit, whoever feeds them and however fast.

    Args:
        scene: a resolved scene that passed its integrity check.
        with_residual_monitor: False lets the solver leave what it leaves, for a run that is meant to be coarse.
        film_tolerance: force that may be left on a node of a film, as a share of the pull of a row of it; its own
            for None.

    Raises:
        RefusedInput: the profile cannot be built.

    Attributes:
        film_halvings: how often the scene's step was halved for the film's stiffness.
        film_frame: the film at the pose frame that was given out last, where one is due with it.
    """

    def __init__(
        self, scene: Scene, *, with_residual_monitor: bool = True, film_tolerance: float | None = None
    ) -> None:
        self.scene = scene
        self.engine = make_engine(scene)
        self._residual_limit = self.engine.residual_limit if with_residual_monitor else None
        self.settle_s = 0.0
        self.step_count = 0
        self.halvings: list[str] = []
        self.finished = False
        self.at_rest = False
        self._steps_a_group, self._samples_a_group = scene.steps_and_samples()
        self._samples_a_frame = scene.sampling.samples_hz // scene.sampling.poses_hz
        self._step_s = scene.time_step_s
        self._stop_sample = stop_sample(scene)
        self._limit_sample = self._stop_sample + round(REST_LIMIT_S * scene.sampling.samples_hz)
        edges = [(0.0, 0.0, 0.0)] + [package.size_m for package in scene.packages]
        self._radii = 0.5 * np.linalg.norm(np.array(edges), axis=1)
        self._rest = RestWatch(self._radii, within_m=REST_WITHIN_M, for_s=REST_FOR_S)
        self._monitors = Monitors(["pallet", *(package.id for package in scene.packages)], self._radii)
        self._ledger = self._ledger_then = EnergyLedger(scene)
        pallet = scene.pallet_box
        sizes = np.array([pallet.size_m if pallet is not None else (0.0, 0.0, 0.0), *edges[1:]])
        heights = self.engine.poses()[0][:, 2].copy()
        self._impacts = ImpactWatch(0.5 * sizes, heights, self.engine.impact_share)
        self._groups_a_lookout = max(
            1, round(IMPACT_LOOKOUT_S * scene.sampling.samples_hz / self._samples_a_group)
        )
        # Where frames come more often than blows are looked for: so many frames a look.
        self._frames_a_lookout = max(1, round(IMPACT_LOOKOUT_S * scene.sampling.poses_hz))
        self._frames_to_give = self._frames_a_lookout
        self._film_lost_j = 0.0
        # A film that is asked again at the same place answers more exactly: the ledger's look must change nothing.
        self._film_asked: tuple[Array, Array] | None = None
        self._film_said: tuple[Array, Array] = (np.zeros((0, 3)), np.zeros((0, 3)))
        self._split = 1
        self._steps_then = (self._step_s, self._split)
        self.impact_steps = 0
        self._frame_count = 0
        self._frames_a_check = max(1, scene.sampling.poses_hz // CONTACT_CHECK_HZ)
        self._frames_a_snapshot = max(1, scene.sampling.poses_hz // SNAPSHOT_HZ)
        # Changes of the sled's velocity, a sample each: since the last frame, and of the frames since the snapshot.
        self._pending: list[Array] = []
        self._since_snapshot: list[list[Array]] = []
        self._since_ledger: list[list[Array]] = []
        self._snapshot: int | None = None
        self._read_poses: tuple[Array, Array] | None = None
        self._fields = self._build_fields()
        self._film: LoadFilm | None = None
        self._film_tolerance = film_tolerance
        self._film_watch: FilmWatch | None = None
        self._film_then: State = ()
        self.film_frame: FilmFrame | None = None
        self.film_halvings = 0
        # A coarse run, at twice the step, is to stay at twice the step.
        self._film_phase_limit = MAXIMUM_STEP_PHASE * (1.0 if with_residual_monitor else 2.0)
        self._film_holds = scene.is_held_by_film
        # What doesn't move, or has no body, has no frequency.
        masses = [package.mass_kg if package.kind == "package" else np.inf for package in scene.packages]
        self._masses = np.array([pallet.mass_kg if pallet and not pallet.fixed else np.inf, *masses])

    @property
    def time_s(self) -> float:
        """Simulated time since the first frame [s]."""
        return max(0, self._frame_count - 1) / self.scene.sampling.poses_hz

    @property
    def extremes(self) -> Extremes:
        """The largest values that the monitors saw."""
        return self._monitors.extremes

    @property
    def film_summary(self) -> dict[str, object] | None:
        """What the film went through, or None without one, or before the load had settled."""
        if self._film_watch is None:
            return None
        return asdict(self._film_watch.summary) | {"step_divisor": 2**self.film_halvings}

    @property
    def smallest_step_s(self) -> float:
        """The step in use at the end [s]: the scene's, halved on breaches."""
        return self._step_s

    def feed(self, index: int, acceleration: Array, stamp_ns: int) -> PoseFrame | None:
        """Settles on sample 0, and takes every later one; steps and returns a frame when one is due.

        On a breach of a monitor the state rolls back to the last snapshot, the step is halved, and the samples
        since are stepped again; frames that were given out stand. After three halvings the test ends.

        Args:
            index: the sample's index, from 0; they must come without a gap.
            acceleration: mean acceleration over the sample's interval [m/s²], shape [3].
            stamp_ns: the sample's stamp [ns].

        Raises:
            EndedByMonitor: the load does not stand by itself, or a monitor was breached for good; earlier
                frames stand.
        """
        if index == 0:
            return self._settle(stamp_ns)
        self._pending.append(acceleration / self.scene.sampling.samples_hz)
        if index % self._samples_a_frame:
            return None
        self._advance(self._pending)
        while (breach := self._watch()) is not None:
            self._roll_back(breach)
            self._advance(self._pending)
        self._since_snapshot.append(self._pending)
        self._pending = []
        if self._film is not None:
            self._follow_film()
        frame = self._frame(stamp_ns)
        self._show_film(frame)
        if frame.index % self._frames_a_snapshot == 0:
            self._take_snapshot()
        self._look_for_rest(index, frame)
        return frame

    def take(self, sample: SledSample) -> PoseFrame | None:
        """Takes a sled sample of this process; see ``feed``."""
        return self.feed(sample.index, sample.acceleration, sample.stamp_ns)

    def frames(self) -> Iterator[PoseFrame]:
        """Every frame of the scene's own sled, to the end of the test.

        Raises:
            EndedByMonitor: as ``feed``; the frames until then have been given out.
        """
        for sample in sled_samples(self.scene):
            frame = self.take(sample)
            if frame is not None:
                yield frame
            if self.finished:
                return

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
        """Lets the load come to rest under gravity, and again under the film's pull, and returns it as frame 0."""
        self.settle_s = self._come_to_rest()
        self._require_places()
        if self.scene.film is not None:
            from sim_core.wrap.load_film import TOLERANCE, LoadFilm
            from sim_core.wrap.watch import FilmWatch

            tolerance = TOLERANCE if self._film_tolerance is None else self._film_tolerance
            self._film = LoadFilm(self.scene, *self.engine.poses(), tolerance=tolerance)
            if self._film_holds:
                self._settle_under_film(self._film)
            self._film_watch = FilmWatch(self._film)
        self._monitors.contacts(self.engine.contacts(), self.engine.residual())
        self._ledger = self._accounted()
        self._take_snapshot()
        frame = self._frame(stamp_ns)
        self._show_film(frame)
        return frame

    def _settle_under_film(self, film: "LoadFilm") -> None:
        """Lets the load come to rest under the film's pull.

        Raises:
            EndedByMonitor: it doesn't, or the film drew a package from its place: the test would be another load's.
        """
        self._fit_step_to_film(film)
        before = self.engine.poses()[0]
        self.settle_s += self._come_to_rest()
        drawn_m = np.linalg.norm(self.engine.poses()[0] - before, axis=1)[1:]
        row = int(drawn_m.argmax())
        if drawn_m[row] > DRAWN_M:
            raise EndedByMonitor(
                "settling",
                f"the film drew {self.scene.packages[row].id} by {1000.0 * drawn_m[row]:.1f} mm while the load"
                f" settled, limit {1000.0 * DRAWN_M:.0f} mm: packages stand apart",
                0.0,
            )

    def _fit_step_to_film(self, film: "LoadFilm") -> None:
        """Halves the step until it is small enough for the film, whose forces are those of the step before.

        Raises:
            EndedByMonitor: no step that is worth taking is small enough.
        """
        frequency = film.stiffest_frequency(self._masses)
        while self._step_s * frequency > self._film_phase_limit and self.film_halvings < MOST_FILM_HALVINGS:
            self.film_halvings += 1
            self._set_step(self._step_s / 2.0, self._split)
        # The film's frequency is that of the film as it was laid, and the step only becomes smaller: once is enough.
        breach = self._monitors.stiffness(self._step_s, frequency, limit=self._film_phase_limit)
        if breach is not None:
            raise EndedByMonitor(breach.monitor, breach.reason, 0.0)

    def _come_to_rest(self) -> float:
        """Steps on the standing sled until nothing moves, and says how long that took [s]."""
        still = np.zeros(3)
        watch = RestWatch(self._radii, within_m=SETTLED_WITHIN_M, for_s=SETTLED_FOR_S)
        time_s = 0.0
        while self.scene.packages and not watch.update(time_s, *self.engine.poses()):
            self._step(still)
            time_s += self._step_s
            breach = self._monitors.motion(self.engine.poses()[0], *self.engine.velocities())
            if breach is None and time_s > SETTLE_LIMIT_S:
                breach = Breach(
                    "settling",
                    f"after {SETTLE_LIMIT_S} s at rest the load still moves by more than"
                    f" {1000.0 * SETTLED_WITHIN_M} mm within {SETTLED_FOR_S} s: it does not stand by itself",
                )
            if breach is not None:
                # No halving here: a companion would halve to the same step, and the two would agree on an error.
                raise EndedByMonitor(breach.monitor, breach.reason, 0.0)
        return time_s

    def _require_places(self) -> None:
        """Refuses a load that settled by sinking: displacement from there would look small.

        Raises:
            EndedByMonitor: a package came closer to what it stands on than gap and overlap at the start allow.
        """
        heights = self.engine.poses()[0][:, 2]
        for support in supports(self.scene):
            package = self.scene.packages[support.package]
            row, below = support.package + 1, support.below + 1
            ground = self.scene.packages[support.below].position_m[2] if support.below >= 0 else 0.0
            now = heights[row] - (heights[below] if support.below >= 0 else 0.0)
            sunk_m = float(package.position_m[2] - ground - now)
            if abs(sunk_m) > SETTLED_SINK_M and package.kind == "package":
                raise EndedByMonitor(
                    "settling",
                    f"{package.id} sank by {1000.0 * sunk_m:.1f} mm into what it stands on while the load settled,"
                    f" limit {1000.0 * SETTLED_SINK_M:.0f} mm",
                    0.0,
                )

    def _advance(self, changes: list[Array]) -> None:
        """Steps over samples, in groups that hold a whole number of steps, smaller ones where bodies will meet."""
        size = self._samples_a_group
        groups = [sum(changes[i : i + size], np.zeros(3)) for i in range(0, len(changes), size)]
        for start in range(0, len(groups), self._groups_a_lookout):
            ahead = groups[start : start + self._groups_a_lookout]
            self._split_before_impacts(len(ahead) * size / self.scene.sampling.samples_hz)
            steps = self._steps_a_group * 2 ** (self.film_halvings + len(self.halvings)) * self._split
            for change in ahead:
                for _ in range(steps):
                    self._step(change / steps)
            if start + self._groups_a_lookout < len(groups):
                self._let_film_give()

    def _let_film_give(self) -> None:
        """Lets the film flow and tear where it is overloaded; what it loses is told at the next frame."""
        if self._film is None or self._film.is_gone:
            return
        if not self._film_holds:
            self._film.wrenches(*self.engine.poses())
        if not self._film.is_lost:
            self._film_lost_j += self._film.commit()
            self._film_asked = None

    def _split_before_impacts(self, ahead_s: float) -> None:
        split = self._impacts.substeps(
            self._step_s, self._split, ahead_s, *self.engine.poses(), self.engine.velocities()[0]
        )
        if split != self._split:
            self._set_step(self._step_s, split)

    def _set_step(self, step_s: float, split: int) -> None:
        self._step_s, self._split = step_s, split
        self.engine.set_step(step_s / split)
        self._read_poses = None

    def _watch(self) -> Breach | None:
        """Every monitor, on the state of the frame that is due."""
        positions, orientations = self.engine.poses()
        linear, angular = self.engine.velocities()
        breach = self._monitors.motion(positions, linear, angular)
        if breach is None and self._fields is not None:
            frequency = self._fields.stiffest_frequency(positions, orientations)
            breach = self._monitors.stiffness(self._step_s, frequency)
        if breach is None and self._frame_count % self._frames_a_check == 0:
            breach = self._watch_contacts(positions, orientations)
        if breach is None:
            ledger = self._accounted()
            breach = self._monitors.energy(ledger.residual)
            if breach is None:
                self._ledger, self._since_ledger = ledger, []
        return breach

    def _watch_contacts(self, positions: Array, orientations: Array) -> Breach | None:
        residual, limit = self.engine.residual(), self._residual_limit
        breach = self._monitors.contacts(self.engine.contacts(), residual)
        # In a collapse the residual is large whatever the step, and the verdict is settled.
        stands = self._impacts.standing(positions, rotation_matrices(orientations)).all()
        if breach is None and limit is not None and stands:
            breach = self._monitors.unsolved(residual, limit)
        if breach is None and self._film is not None and stands:
            breach = self._monitors.unbalanced_film(self._film.residual)
        return breach

    def _accounted(self) -> EnergyLedger:
        """The ledger with the state of the frame that is due."""
        ledger = copy(self._ledger)
        positions, orientations = self._read()
        forces, torques = self._loads(*self.engine.poses())
        changes = [change for frame in self._since_ledger for change in frame] + self._pending
        ledger.update(
            sum(changes, np.zeros(3)), positions, orientations, *self.engine.velocities(), forces, torques
        )
        return ledger

    def _take_snapshot(self) -> None:
        if self._snapshot is not None:
            self.engine.forget(self._snapshot)
        self._snapshot, self._steps_then = self.engine.snapshot(), (self._step_s, self._split)
        self._film_then = self._film.state() if self._film is not None else ()
        self._ledger_then = self._ledger
        self._since_snapshot = []
        self._since_ledger = []

    def _follow_film(self) -> None:
        """Looks at the film, and lets go of one that cannot matter any more."""
        assert self._film is not None and self._film_watch is not None
        if self._film.is_gone:
            return
        time_s = self.time_s + 1.0 / self.scene.sampling.poses_hz
        positions, orientations = self.engine.poses()
        # Tears run a ring of elements each time, so how often that is must not be a matter of publishing.
        self._frames_to_give -= 1
        if self._frames_to_give <= 0:
            self._let_film_give()
            self._frames_to_give = self._frames_a_lookout
        if self._film.is_lost:
            self._film_watch.note_tears(time_s)
        else:
            self._film_watch.take(time_s, self._film_lost_j)
            self._film_lost_j = 0.0
        stands = self._impacts.standing(positions, rotation_matrices(orientations)).all()
        if not stands or (self._film.is_lost and self._film.film.torn.any()):
            # Rule (iv) is broken: what torn film, or film on packages that lie about, does costs most and changes
            # nothing.
            self._film.let_go()
            self._film_asked = None
            self._film_watch.summary.let_go_s = time_s

    def _show_film(self, frame: PoseFrame) -> None:
        self.film_frame = None
        if self._film_watch is not None and frame.index % self.scene.sampling.frames_a_film_frame == 0:
            self.film_frame = self._film_watch.frame(frame.index, frame.stamp_ns)

    def _roll_back(self, breach: Breach) -> None:
        if len(self.halvings) == MAXIMUM_HALVINGS or self._snapshot is None:
            raise EndedByMonitor(breach.monitor, breach.reason, self.time_s)
        self.halvings.append(f"at {self.time_s:.3f} s: {breach.monitor}: {breach.reason}")
        halved_s = self._step_s / 2.0
        # The state was kept with positions ahead by half of the step of then.
        self._set_step(*self._steps_then)
        self.engine.restore(self._snapshot)
        if self._film is not None:
            self._film.restore(self._film_then)
            self._film_asked = None
            if self._film_watch is not None and not self._film.is_gone:
                self._film_watch.summary.let_go_s = None
        self._set_step(halved_s, self._split)
        self._monitors.forget_recent()
        self._ledger, self._since_ledger = self._ledger_then, self._since_snapshot
        for changes in self._since_snapshot:
            self._advance(changes)
            self._let_film_give()

    def _build_fields(self) -> PerimeterForceFields | None:
        if self.scene.force_fields is None or not self.scene.packages:
            return None
        peak = build_profile(self.scene).peak_mps2
        return PerimeterForceFields(self.scene.force_fields, self.scene, peak, *self.engine.poses())

    def _step(self, delta_velocity: Array) -> None:
        self.engine.step(delta_velocity, *self._loads(*self.engine.poses()))
        self._read_poses = None
        self.step_count += 1
        self.impact_steps += self._split > 1

    def _loads(self, positions: Array, orientations: Array) -> tuple[Array | None, Array | None]:
        """Forces and torques of fields and film on the bodies where they are, or None where there are none."""
        forces = self._fields.forces(positions, orientations) if self._fields is not None else None
        if self._film is None or not self._film_holds:
            return forces, None
        if self._film_asked is None or not all(
            map(np.array_equal, self._film_asked, (positions, orientations))
        ):
            self._film_asked = positions, orientations
            self._film_said = self._film.wrenches(positions, orientations)
        pulls, torques = self._film_said
        return (pulls if forces is None else forces + pulls), torques

    def _read(self) -> tuple[Array, Array]:
        """Poses at the time of the velocities: a semi-implicit step leaves positions half a step of motion ahead."""
        if self._read_poses is None:
            step_s = self._step_s / self._split
            positions, orientations = self.engine.poses()
            linear, angular = self.engine.velocities()
            self._read_poses = (
                positions - 0.5 * step_s * linear,
                turned_by_half_step(orientations, angular, step_s),
            )
        return self._read_poses

    def _frame(self, stamp_ns: int) -> PoseFrame:
        positions, orientations = self._read()
        frame = PoseFrame(self._frame_count, stamp_ns, positions, orientations)
        self._frame_count += 1
        return frame

    def _look_for_rest(self, index: int, frame: PoseFrame) -> None:
        if index < self._stop_sample:
            return
        self.at_rest = self._rest.update(self.time_s, frame.positions, frame.orientations)
        self.finished = self.at_rest or index >= self._limit_sample
