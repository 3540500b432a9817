"""Measured against simulated displacement over time: what is looked at, and by how much the two differ."""

from collections import deque
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from config.errors import RefusedInput
from config.scene import Scene
from sim_core.frames import Array, PoseFrame
from sim_core.geometry import rotation_matrices

EDGES = 2.0
"""A difference counts as seen beyond so many standard uncertainties."""


@dataclass(frozen=True, eq=False)
class Observed:
    """Which points of which packages are looked at, and along which axes.

    Attributes:
        rows: of the packages in a pose frame, shape [k].
        points: in each package's own frame [m], shape [k, p, 3].
        axes: unit vectors of frame ``sled``, shape [c, 3].
    """

    rows: NDArray[np.intp]
    points: Array
    axes: Array

    def spots(self, frame: PoseFrame) -> Array:
        """Where the points are, frame ``sled`` [m], shape [k, p, 3]."""
        turns = rotation_matrices(frame.orientations[self.rows])
        spots: Array = frame.positions[self.rows][:, None] + np.einsum("kij,kpj->kpi", turns, self.points)
        return spots

    def places(self, frame: PoseFrame) -> Array:
        """Where the points are along the axes [m], shape [k, p, c]."""
        along: Array = self.spots(frame) @ self.axes.T
        return along

    @property
    def shape(self) -> tuple[int, int, int]:
        """Packages, points a package and axes."""
        return len(self.rows), self.points.shape[1], len(self.axes)


@dataclass(frozen=True, eq=False)
class MeasuredDisplacement:
    """Displacement since the start as it was measured.

    Attributes:
        observed: what it is of.
        times: rising, since sample 0 of the sled [s], shape [n].
        displacement: [m], shape [n, k, p, c]; NaN where a point was not seen.
        sigma: standard uncertainty of each [m], same shape.
    """

    observed: Observed
    times: Array
    displacement: Array
    sigma: Array


def centres(scene: Scene) -> Observed:
    """The centres of all packages, along x and y: what poses say of sliding and leaning.

    Args:
        scene: a resolved scene.
    """
    rows = np.arange(1, len(scene.packages) + 1)
    return Observed(rows, np.zeros((len(rows), 1, 3)), np.eye(3)[:2])


def near_sides(scene: Scene, rows: NDArray[np.intp]) -> Observed:
    """Middle and corners of the packages' sides towards the camera, along the picture's right and up.

    Args:
        scene: a resolved scene.
        rows: of the packages in a pose frame.

    Raises:
        RefusedInput: a row is no package of the scene, or has no side towards the camera.
    """
    from sim_core.camera.layout import near_face, side_of

    found = [near_face(scene, int(row)) if 0 < row <= len(scene.packages) else None for row in rows]
    if not found or any(face is None for face in found):
        raise RefusedInput(
            "displacement", list(map(int, rows)), "must be packages whose side faces the camera"
        )
    faces = np.array(found, dtype=float)
    points = np.concatenate((faces.mean(axis=1, keepdims=True), faces), axis=1)
    return Observed(rows, points, np.stack((side_of(scene).right, [0.0, 0.0, 1.0])))


@dataclass(frozen=True)
class PackageResidual:
    """How far measurement and simulation of one package are apart.

    Attributes:
        id: the package's.
        points: how many were compared, over all times.
        rms_mm: root mean square of the difference of a component [mm].
        largest_mm: the largest [mm].
        largest_at_s: when [s].
        beyond_share: share of differences beyond twice their uncertainty.
        peak_measured_mm: largest measured displacement of a component [mm].
        peak_simulated_mm: largest simulated one, of the times that were measured [mm].
    """

    id: str
    points: int
    rms_mm: float
    largest_mm: float
    largest_at_s: float
    beyond_share: float
    peak_measured_mm: float
    peak_simulated_mm: float


@dataclass(frozen=True, eq=False)
class Difference:
    """Measured less simulated displacement at one time.

    Attributes:
        time_s: since sample 0 of the sled [s].
        rows: of the packages in a pose frame, shape [k].
        measured: [m], shape [k, p, c]; NaN where a point was not seen.
        simulated: [m], same shape.
        sigma: standard uncertainty of the measurement [m], same shape.
        spots: where the points are in the simulation, frame ``sled`` [m], shape [k, p, 3].
    """

    time_s: float
    rows: NDArray[np.intp]
    measured: Array
    simulated: Array
    sigma: Array
    spots: Array

    @property
    def difference(self) -> Array:
        """Measured less simulated [m], shape [k, p, c]."""
        apart: Array = self.measured - self.simulated
        return apart


class DisplacementResidual:
    """Sets measurements beside pose frames as they come, in whatever order between the two.

    A measurement between two frames is compared with the straight line between them; one after the last frame waits
    until ``finish``, when the load stands where it stood last.

    Args:
        scene: a resolved scene.
        observed: what is measured.
    """

    def __init__(self, scene: Scene, observed: Observed) -> None:
        self.observed = observed
        self._ids = [scene.packages[row - 1].id for row in observed.rows]
        self._frames: deque[tuple[float, Array]] = deque()
        self._waiting: deque[tuple[float, Array, Array]] = deque()
        self._start: Array | None = None
        self.differences: list[Difference] = []

    def add_simulated(self, time_s: float, frame: PoseFrame) -> list[Difference]:
        """Takes the next pose frame, at a time since sample 0 [s]; gives what can be compared now."""
        spots = self.observed.spots(frame)
        if self._start is None:
            self._start = spots
        self._frames.append((time_s, spots))
        return self._compare()

    def add_measured(self, time_s: float, displacement: Array, sigma: Array) -> list[Difference]:
        """Takes the next measurement [m], shape [k, p, c], at a time since sample 0 [s]; gives what can be compared.

        Raises:
            RefusedInput: it is of another number of packages or points.
        """
        if displacement.shape != self.observed.shape:
            limit = f"must be {self.observed.shape}: packages, points and axes, as in the first one"
            raise RefusedInput("displacement", displacement.shape, limit)
        self._waiting.append((time_s, displacement, sigma))
        return self._compare()

    def finish(self) -> list[Difference]:
        """Compares what is left with the last frame: nothing moves after it."""
        if not self._frames:
            return []
        self._frames.append((np.inf, self._frames[-1][1]))
        return self._compare()

    def _compare(self) -> list[Difference]:
        found = []
        while self._waiting and self._frames and self._waiting[0][0] <= self._frames[-1][0]:
            time_s, measured, sigma = self._waiting.popleft()
            while len(self._frames) > 1 and self._frames[1][0] < time_s:
                self._frames.popleft()
            before_s, spots = self._frames[0]
            if len(self._frames) > 1 and np.isfinite(self._frames[1][0]) and time_s > before_s:
                after_s, after = self._frames[1]
                spots = spots + (time_s - before_s) / (after_s - before_s) * (after - spots)
            assert self._start is not None
            moved = (spots - self._start) @ self.observed.axes.T
            found.append(Difference(time_s, self.observed.rows, measured, moved, sigma, spots))
        self.differences += found
        return found

    def packages(self) -> list[PackageResidual]:
        """What was seen of each package so far; none of one that was never seen."""
        if not self.differences:
            return []
        apart = 1000.0 * np.array([one.difference for one in self.differences])
        sigma = 1000.0 * np.array([one.sigma for one in self.differences])
        measured = 1000.0 * np.array([one.measured for one in self.differences])
        simulated = 1000.0 * np.array([one.simulated for one in self.differences])
        times = [one.time_s for one in self.differences]
        found = []
        for column, name in enumerate(self._ids):
            seen = np.isfinite(apart[:, column])
            if not seen.any():
                continue
            size = np.where(seen, np.abs(apart[:, column]), 0.0)
            worst = size.reshape(len(times), -1).max(axis=1)
            beyond = size[seen] > EDGES * sigma[:, column][seen]
            found.append(
                PackageResidual(
                    id=name,
                    points=int(seen.sum()) // len(self.observed.axes),
                    rms_mm=float(np.sqrt(np.mean(size[seen] ** 2))),
                    largest_mm=float(worst.max()),
                    largest_at_s=float(times[int(worst.argmax())]),
                    beyond_share=float(beyond.mean()),
                    peak_measured_mm=float(np.abs(measured[:, column][seen]).max()),
                    peak_simulated_mm=float(np.abs(simulated[:, column][seen]).max()),
                )
            )
        return found

    def summary(self) -> dict[str, Any]:
        """All of it for a report: overall figures, the package that differs most, and every package."""
        packages = self.packages()
        if not packages:
            return {"times": len(self.differences), "packages": []}
        worst = max(packages, key=lambda package: package.largest_mm)
        points = sum(package.points for package in packages)
        squares = sum(package.points * package.rms_mm**2 for package in packages)
        return {
            "times": len(self.differences),
            "points": points,
            "rms_mm": float(np.sqrt(squares / points)),
            "largest_mm": worst.largest_mm,
            "largest_at_s": worst.largest_at_s,
            "package": worst.id,
            "beyond_share": sum(package.points * package.beyond_share for package in packages) / points,
            "packages": [asdict(package) for package in packages],
        }
