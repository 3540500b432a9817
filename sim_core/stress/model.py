"""Rows of the stability table as data: what is run, what is expected, what came out."""

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from config.errors import EndedByMonitor, RefusedInput
from config.scene import Scene
from sim_core.frames import Array, PoseFrame
from sim_core.run import TestResult, run_test

Outcome = Literal["right", "refused", "ended", "wrong"]
GRACEFUL: tuple[Outcome, ...] = ("right", "refused", "ended")


@dataclass(frozen=True)
class Trial:
    """One scene that was tried.

    Attributes:
        scene: the resolved scene.
        frames: every pose frame until the end, the settled load first.
        result: what the test left behind, or None when it was refused.
        refused: the refusal before the first step, or None.
    """

    scene: Scene
    frames: tuple[PoseFrame, ...]
    result: TestResult | None
    refused: RefusedInput | None = None

    @property
    def ended(self) -> EndedByMonitor | None:
        """The monitor's error that ended the test, or None."""
        return self.result.ended_by if self.result is not None else None

    @property
    def finished(self) -> TestResult:
        """The result of a test that was not refused.

        Raises:
            ValueError: it was refused.
        """
        if self.result is None:
            raise ValueError("the trial was refused")
        return self.result

    def row(self, package: str) -> int:
        """Row of a package among the poses."""
        return 1 + [p.id for p in self.scene.packages].index(package)

    def times_s(self) -> Array:
        """Time of each frame since the first [s], shape [frame_count]."""
        return np.array([(f.stamp_ns - self.frames[0].stamp_ns) / 1.0e9 for f in self.frames])

    def paths(self) -> Array:
        """Centres of all packages over time [m], frame ``sled``, shape [frame_count, package_count, 3]."""
        return np.array([frame.positions[1:] for frame in self.frames])

    def moves(self) -> Array:
        """Displacement of all centres from the settled load [m], shape [frame_count, package_count, 3]."""
        paths = self.paths()
        moves: Array = paths - paths[0]
        return moves

    def sink_m(self) -> float:
        """How far any package ever was below the place that the scene gives it, settling included [m]."""
        given = np.array([package.position_m[2] for package in self.scene.packages])
        return float((given - self.paths()[:, :, 2]).max())

    def peak_m(self) -> float:
        """Largest displacement of any corner from the settled load until the end [m]."""
        return max((p.peak_mm for p in self.finished.judge.packages()), default=0.0) / 1000.0

    def tips(self) -> bool:
        """Whether a package ends tilted by more than 45 degrees, or has fallen off its place."""
        return any(r.rule == "damage" and r.state == "fail" for r in self.finished.judge.rules())


class TookTooLong(Exception):
    """A run that was given up: to its user it hangs."""


class _Path:
    """Keeps every frame of a test, for as long as patience lasts [s]."""

    __test__ = False

    def __init__(self, patience_s: float) -> None:
        self.frames: list[PoseFrame] = []
        self._patience_s, self._began = patience_s, time.perf_counter()

    def on_reading(self, reading: object) -> None:
        """Not needed."""

    def on_sample(self, sample: object) -> None:
        """Not needed."""

    def on_frame(self, frame: PoseFrame) -> None:
        """Keeps a frame."""
        self.frames.append(frame)
        if time.perf_counter() - self._began > self._patience_s:
            simulated_s = (frame.stamp_ns - self.frames[0].stamp_ns) / 1.0e9
            raise TookTooLong(f"not over after {self._patience_s:g} s, at {simulated_s:.3f} s of the test")

    def on_film(self, frame: object) -> None:
        """Not needed."""

    def on_rules(self, stamp_ns: int, rules: object) -> None:
        """Not needed."""


def try_scene(scene: Scene, *, patience_s: float = math.inf) -> Trial:
    """Runs one scene to its end, its refusal or its breach.

    Raises:
        TookTooLong: it was not over in time.
    """
    path = _Path(patience_s)
    try:
        result = run_test(scene, observers=[path])
    except RefusedInput as error:
        return Trial(scene, (), None, error)
    if result.wall_s > patience_s:
        # What takes so long before the first frame doesn't come by the observer.
        raise TookTooLong(f"over after {result.wall_s:.0f} s, limit {patience_s:g} s")
    return Trial(scene, tuple(path.frames), result)


@dataclass(frozen=True)
class Judgement:
    """What a row's trials say.

    Attributes:
        right: whether the measured value lies within the stated bound.
        measured: the measured values in words, with units.
        value: the value that is held against the bound, where there is one.
        bound: the bound.
        unit: unit of both.
    """

    right: bool
    measured: str
    value: float | None = None
    bound: float | None = None
    unit: str = ""


def within(value_m: float, bound_m: float, words: str) -> Judgement:
    """A length that must stay within a bound, both in metres; told in millimetres."""
    value, bound = 1000.0 * value_m, 1000.0 * bound_m
    # A NaN is not within anything.
    return Judgement(
        bool(value <= bound), f"{words} {value:.4g} mm, bound {bound:.4g} mm", value, bound, "mm"
    )


@dataclass(frozen=True)
class StressRow:
    """One row of the table.

    Attributes:
        id: short name.
        group: heading that it stands under.
        title: the case in words.
        expected: the expected physics and why, with its formula.
        scenes: builds the scenes for an engine; may raise RefusedInput.
        judge: judges the trials, one a scene, once none was refused or ended (unless ``partial``).
        may: the outcomes that are acceptable here; ``wrong`` never is.
        engines: the engines for which the row makes sense.
        quick: whether the row belongs to the quick selection of the tests.
        partial: whether ``judge`` wants refused and ended trials too.
        patience_s: wall time after which a scene counts as hanging [s].
    """

    id: str
    group: str
    title: str
    expected: str
    scenes: Callable[[str], Sequence[Scene]]
    judge: Callable[[Sequence[Trial]], Judgement]
    may: tuple[Outcome, ...] = GRACEFUL
    engines: tuple[str, ...] = ("bullet", "mujoco")
    quick: bool = False
    partial: bool = False
    patience_s: float = math.inf


@dataclass(frozen=True)
class KnownWrong:
    """Why a row is known to be wrong with an engine, and what would make it right or catch it."""

    row: str
    engine: str
    reason: str


@dataclass(frozen=True)
class StressResult:
    """What one row came to with one engine.

    Attributes:
        row: the row's id.
        engine: the engine.
        group: heading that the row stands under.
        title: the case in words.
        expected: the expected physics.
        outcome: ``right``, ``refused``, ``ended`` or ``wrong``.
        is_acceptable: whether the outcome is one that the row accepts.
        measured: the measured values in words, or the line of the refusal or the monitor.
        value: the value that was held against the bound, or None.
        bound: the bound, or None.
        unit: unit of both.
        wall_s: wall time, all scenes of the row and the judging [s].
        known_wrong: why the row is known to be wrong, or None.
        watched: what the monitors saw: the largest values over the row's scenes.
    """

    row: str
    engine: str
    group: str
    title: str
    expected: str
    outcome: Outcome
    is_acceptable: bool
    measured: str
    value: float | None
    bound: float | None
    unit: str
    wall_s: float
    known_wrong: str | None
    watched: Mapping[str, float]
