"""One test from scene to result in one process: the loop that every other way of running repeats."""

import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Protocol

from config.errors import EndedByMonitor
from config.scene import Scene
from sim_core.frames import AccelerometerSample, FilmFrame, PoseFrame, RuleState, SledSample
from sim_core.integrity import Finding, require_integrity
from sim_core.judge import EumosJudge
from sim_core.load_test import LoadTest
from sim_core.sled import DEFAULT_EPOCH_NS, accelerometer_samples, sled_samples, stop_sample

STATUS_HZ = 10


class TestObserver(Protocol):
    """Something that follows a test; each call comes in the order of simulated time."""

    __test__: bool = False

    def on_reading(self, reading: AccelerometerSample) -> None:
        """An accelerometer reading, at or before the next sample."""

    def on_sample(self, sample: SledSample) -> None:
        """A sled sample, before the physics takes it."""

    def on_frame(self, frame: PoseFrame) -> None:
        """A pose frame, after the judge took it."""

    def on_film(self, frame: FilmFrame) -> None:
        """The film of a wrapped load, right after the pose frame of the same number."""

    def on_rules(self, stamp_ns: int, rules: list[RuleState]) -> None:
        """The rules as they stand, ten times a simulated second and at the end."""


@dataclass(frozen=True)
class PhysicsSummary:
    """What the physics can say about itself at the end of a test.

    Attributes:
        engine: name of the engine.
        settings: the engine's settings as read back.
        unmet_friction: surface pairs whose friction the engine cannot represent, in words.
        steps: physics steps taken, settling included.
        settle_s: simulated time that the load took to settle [s].
        simulated_s: simulated time from the first to the last frame [s].
        at_rest: whether the load rested at the end.
        penetration_m: deepest contact [m].
        speed_mps: largest speed relative to the sled [m/s].
        residual: largest remaining solver residual, in the engine's measure.
        usual_residual: largest median of it over ten checks.
        residual_limit: the limit of that median, or None where the engine has none.
        film_residual: largest median over ten checks of what the film leaves unbalanced, as a share of a row's pull.
        film: what the film went through, see ``sim_core/wrap/watch.py``, or None without one.
        contact_count: largest number of contact points.
        energy_residual: largest share of energy that appeared from nowhere.
        step_phase: largest step times spring frequency.
        smallest_step_s: the step in use at the end [s].
        halvings: when and why the step was halved, in words.
        ended_by: the monitor that ended the test, with its reason, or None.
    """

    engine: str
    settings: dict[str, object]
    unmet_friction: list[str]
    steps: int
    settle_s: float
    simulated_s: float
    at_rest: bool
    penetration_m: float
    speed_mps: float
    residual: float
    contact_count: int
    energy_residual: float
    step_phase: float
    smallest_step_s: float
    halvings: list[str]
    ended_by: str | None = None
    usual_residual: float = 0.0
    residual_limit: float | None = None
    film: dict[str, object] | None = None
    film_residual: float = 0.0


@dataclass(frozen=True)
class TestResult:
    """What a finished test leaves behind.

    Attributes:
        scene: the resolved scene.
        findings: what the integrity check found.
        judge: the judge with every frame taken.
        physics: the physics' own account.
        ended_by: the monitor's error that ended the test early, or None.
        wall_s: wall time of the loop, judging and observers included [s].
    """

    __test__ = False

    scene: Scene
    findings: list[Finding]
    judge: EumosJudge
    physics: PhysicsSummary
    ended_by: EndedByMonitor | None
    wall_s: float


def summarise_physics(test: LoadTest, ended_by: EndedByMonitor | None) -> PhysicsSummary:
    """Collects the physics' account of a test that ended."""
    return PhysicsSummary(
        engine=test.engine.name,
        settings=dict(test.engine.settings),
        unmet_friction=test.unmet_friction,
        steps=test.step_count,
        settle_s=test.settle_s,
        simulated_s=test.time_s,
        at_rest=test.at_rest,
        penetration_m=test.extremes.penetration_m,
        speed_mps=test.extremes.speed_mps,
        residual=test.extremes.residual,
        contact_count=test.extremes.contact_count,
        energy_residual=test.extremes.energy_residual,
        step_phase=test.extremes.step_phase,
        smallest_step_s=test.smallest_step_s,
        halvings=list(test.halvings),
        ended_by=str(ended_by) if ended_by is not None else None,
        usual_residual=test.extremes.usual_residual,
        residual_limit=test.engine.residual_limit,
        film=test.film_summary,
        film_residual=test.extremes.film_residual,
    )


def expected_end_s(scene: Scene) -> float:
    """About when the test will be over, if the load rests soon after the stop [s]."""
    return stop_sample(scene) / scene.sampling.samples_hz + 0.25


def status_due(frame: PoseFrame, scene: Scene) -> bool:
    """Whether the rules are published after this frame."""
    return frame.index % max(1, scene.sampling.poses_hz // STATUS_HZ) == 0


class Peekable(Iterator[AccelerometerSample]):
    """A series of readings whose next stamp can be looked at before it is taken."""

    def __init__(self, readings: Iterator[AccelerometerSample]) -> None:
        self._readings = readings
        self._next = next(readings, None)

    def has_next_until(self, stamp_ns: int) -> bool:
        """Whether the next reading is due at or before a stamp [ns]."""
        return self._next is not None and self._next.stamp_ns <= stamp_ns

    def __next__(self) -> AccelerometerSample:
        if self._next is None:
            raise StopIteration
        taken, self._next = self._next, next(self._readings, None)
        return taken


def run_test(
    scene: Scene,
    *,
    observers: Iterable[TestObserver] = (),
    on_progress: Callable[[float, dict[str, str]], None] | None = None,
    epoch_ns: int = DEFAULT_EPOCH_NS,
) -> TestResult:
    """Runs one test to its end.

    Args:
        scene: a resolved scene.
        observers: recorders and viewers that follow the test.
        on_progress: called with the simulated time [s] and the state of each rule, now and then.
        epoch_ns: simulated time of the first sample [ns].

    Raises:
        RefusedInput: the load fails its integrity check.
    """
    findings = require_integrity(scene)
    watching = list(observers)
    is_followed = bool(watching) or on_progress is not None
    readings = Peekable(accelerometer_samples(scene, epoch_ns=epoch_ns))
    began = time.perf_counter()
    test, judge = LoadTest(scene), EumosJudge(scene)
    ended_by: EndedByMonitor | None = None
    try:
        for sample in sled_samples(scene, epoch_ns=epoch_ns):
            while readings.has_next_until(sample.stamp_ns):
                reading = next(readings)
                for observer in watching:
                    observer.on_reading(reading)
            for observer in watching:
                observer.on_sample(sample)
            frame = test.take(sample)
            if frame is None:
                continue
            judge.add(frame)
            for observer in watching:
                observer.on_frame(frame)
            if test.film_frame is not None:
                judge.add_film(test.film_frame)
                for observer in watching:
                    observer.on_film(test.film_frame)
            if is_followed and (status_due(frame, scene) or test.finished):
                rules = judge.rules()
                for observer in watching:
                    observer.on_rules(frame.stamp_ns, rules)
                if on_progress is not None:
                    on_progress(test.time_s, {rule.rule: rule.state for rule in rules})
            if test.finished:
                break
    except EndedByMonitor as error:
        ended_by = error
    finally:
        physics = summarise_physics(test, ended_by)
        test.close()
    return TestResult(
        scene=scene,
        findings=findings,
        judge=judge,
        physics=physics,
        ended_by=ended_by,
        wall_s=time.perf_counter() - began,
    )
