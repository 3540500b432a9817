"""Looks for the parameters with which a scene's displacement comes nearest to what was measured."""

from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from config.errors import RefusedInput
from sim_core.calibration_runs import Run, Runs
from sim_core.frames import Array
from sim_core.residual import MeasuredDisplacement

CLOCK_SIGMA_S, CLOCK_STEP_S = 0.02, 1.0e-3
"""How far the clocks of sled and displacement are expected to be apart, and the step of its derivative."""
STARTS, SWEEP = 3, 9
GOOD_FIT = 2.0
"""A fit that leaves no more than this many standard uncertainties of the measurement is taken at once."""
AGREE_STEPS, AGREEMENTS = 0.25, 2
"""Two further searches that end within this share of a step of the best say that there is nothing better."""
PEAK_MARGIN_S = 0.05
OnProgress = Callable[[int, float], None]
Seen = NDArray[np.bool_]


class Fit:
    """The search for one set of parameters.

    Args:
        runs: the scene's simulations.
        measured: the displacement.
        on_progress: called with simulations run and the best root mean square so far [mm].
        most_evaluations: no further search begins after so many simulations.

    Attributes:
        runs: as given.
        measured: as given.
        seen: which of the measured values are numbers, shape [n, k, p, c].
        values: those [m], shape [v].
        sigma: their standard uncertainties [m], shape [v].
        lower: least value of each parameter, in the fit's measure.
        upper: greatest.
        steps: over which derivatives are taken.
    """

    def __init__(
        self,
        runs: Runs,
        measured: MeasuredDisplacement,
        on_progress: OnProgress | None,
        most_evaluations: int,
    ) -> None:
        self.runs, self.measured = runs, measured
        self.seen = np.isfinite(measured.displacement)
        self.values = measured.displacement[self.seen]
        self.sigma = measured.sigma[self.seen]
        self.lower = np.array([parameter.bounds[0] for parameter in runs.parameters])
        self.upper = np.array([parameter.bounds[1] for parameter in runs.parameters])
        self.steps = np.array([parameter.step for parameter in runs.parameters])
        self._on_progress, self._most = on_progress, most_evaluations
        self._best = np.inf
        self._whole: Seen = np.ones(len(self.values), dtype=bool)
        # Cost, values and clock of the best search, and how many others ended there.
        self._found: tuple[float, Array, float] = (np.inf, np.full(len(self.lower), np.nan), 0.0)
        self._agreed = 0

    def solve(self) -> tuple[Array, float]:
        """The best values, and the clock's offset [s].

        Late displacement goes up and down with a value, by how often the load swung; until its peak it goes one way.
        So each search begins with what was measured until then. Searches go on, from the starts that look best and
        from where a plateau ends, until one leaves hardly more than the measurement's own uncertainty, or three came
        to the same values.
        """
        for x, clock_s, stages in self._starts():
            if self._try(x, clock_s, stages):
                break
            if self._agreed == 0 and any(
                self._try(start, self._found[2], [self._whole]) for start in self._swept()
            ):
                break
        return self._found[1], self._found[2]

    def _try(self, x: Array, clock_s: float, stages: list[Seen]) -> bool:
        """Searches from a start; True when no other is needed."""
        for seen in stages:
            x, clock_s = self._search(x, clock_s, seen)
        cost = self._cost(x, clock_s, self._whole)
        best, there, _ = self._found
        is_same = bool((np.abs(x - there) < AGREE_STEPS * self.steps).all())
        if cost < best:
            self._found = (cost, x, clock_s)
            self._agreed = self._agreed + 1 if is_same else 0
        elif is_same:
            self._agreed += 1
        good = GOOD_FIT**2 * len(self.values)
        return self._found[0] < good or self._agreed >= AGREEMENTS or self.runs.count > self._most

    def _swept(self) -> list[Array]:
        """Further starts around the best: one value at a time over its bounds, the others held.

        A value that does nothing where it stands, such as a friction that holds, may do much elsewhere. So beside the
        best there are the neighbours of all that come near it: where a plateau ends.
        """
        _, x, clock_s = self._found
        shares = (np.arange(SWEEP) + 0.5) / SWEEP
        starts: list[tuple[float, Array]] = []
        for index in range(len(x)):
            points = np.tile(x, (SWEEP, 1))
            points[:, index] = self.lower[index] + shares * (self.upper[index] - self.lower[index])
            self.runs.of(list(points))
            costs = np.array([self._cost(point, clock_s, self._whole) for point in points])
            near = costs <= 1.05 * costs.min()
            edge = ~near & (np.append(near[1:], False) | np.append(False, near[:-1]))
            starts += [(costs[k], points[k]) for k in np.flatnonzero(edge | (costs == costs.min()))]
        return [point for _, point in sorted(starts, key=lambda one: one[0])]

    def _search(self, x: Array, clock_s: float, seen: Seen) -> tuple[Array, float]:
        """Least squares from one start, over a part of what was measured."""
        from scipy.optimize import least_squares  # type: ignore[import-untyped]

        # In steps of the differences, and milliseconds: all of one size.
        scale = np.append(self.steps, CLOCK_STEP_S)
        rows = np.append(seen, True)
        found = least_squares(
            lambda u: self._residuals((u * scale)[:-1], float(u[-1]) * CLOCK_STEP_S)[rows],
            np.append(x, clock_s) / scale,
            jac=lambda u: self.derivatives((u * scale)[:-1], float(u[-1]) * CLOCK_STEP_S)[rows],
            bounds=(
                np.append(self.lower, -5.0 * CLOCK_SIGMA_S) / scale,
                np.append(self.upper, 5.0 * CLOCK_SIGMA_S) / scale,
            ),
            method="trf",
            xtol=1.0e-3,
            ftol=1.0e-3,
            gtol=1.0e-6,
            max_nfev=10,
        )
        return np.asarray((found.x * scale)[:-1], dtype=float), float(found.x[-1]) * CLOCK_STEP_S

    def left(self, x: Array, clock_s: float) -> Array:
        """Measured less simulated [m], of what was seen."""
        apart: Array = self.values - self.predicted(self.runs.of([x])[0], clock_s)
        return apart

    def _starts(self) -> Iterator[tuple[Array, float, list[Seen]]]:
        """Starts that cover the bounds, the best first: those of the way to the peak, and those of all of it."""
        peak, whole = self._until_peak(), self._whole
        starts = _spread(self.lower, self.upper)
        own = [parameter.read(self.runs.scene) for parameter in self.runs.parameters]
        if all(value is not None for value in own):
            pairs = zip(self.runs.parameters, own, strict=True)
            starts.insert(
                0, np.array([parameter.fit_value(value) for parameter, value in pairs if value is not None])
            )
        stands = [x for x, run in zip(starts, self.runs.of(starts), strict=True) if len(run[0])]
        if not stands:
            raise RefusedInput("load", self.runs.scene.name, "does not stand with any of the values tried")
        tried: set[bytes] = set()
        for rank in range(min(STARTS, len(stands))):
            for seen, stages in ((peak, [peak, whole]), (whole, [whole])):
                clocks = (-CLOCK_SIGMA_S, 0.0, CLOCK_SIGMA_S)
                costs = [min((self._cost(x, clock_s, seen), clock_s) for clock_s in clocks) for x in stands]
                best = sorted(range(len(stands)), key=lambda k: costs[k])[rank]
                key = stands[best].tobytes() + bytes([len(stages)])
                if key not in tried:
                    tried.add(key)
                    yield stands[best], costs[best][1], stages

    def _until_peak(self) -> Seen:
        """Which measured values come before the largest displacement, or a little after."""
        size = (
            np.where(self.seen, np.abs(self.measured.displacement), 0.0)
            .reshape(len(self.seen), -1)
            .max(axis=1)
        )
        until = self.measured.times <= self.measured.times[int(size.argmax())] + PEAK_MARGIN_S
        early: Seen = np.broadcast_to(until[:, None, None, None], self.seen.shape)[self.seen]
        return early

    def _cost(self, x: Array, clock_s: float, seen: Seen) -> float:
        rows = (self.left(x, clock_s) / self.sigma)[seen]
        return float(rows @ rows) + (clock_s / CLOCK_SIGMA_S) ** 2

    def predicted(self, run: Run, clock_s: float) -> Array:
        """Simulated displacement where and when something was measured [m]; after the run the load stands."""
        times, displacement = run
        if not len(times):
            return np.zeros(len(self.values))
        wanted = np.clip(self.measured.times - clock_s, times[0], times[-1])
        k = np.clip(np.searchsorted(times, wanted, side="right") - 1, 0, max(0, len(times) - 2))
        after = np.minimum(k + 1, len(times) - 1)
        length = np.maximum(times[after] - times[k], 1.0e-9)
        share = ((wanted - times[k]) / length)[:, None, None, None]
        between = displacement[k] + share * (displacement[after] - displacement[k])
        found: Array = between[self.seen]
        return found

    def _residuals(self, x: Array, clock_s: float) -> Array:
        apart = self.left(x, clock_s)
        rms_mm = 1000.0 * float(np.sqrt(np.mean(apart**2)))
        if self._on_progress is not None:
            self._best = min(self._best, rms_mm)
            self._on_progress(self.runs.count, self._best)
        return np.append(apart / self.sigma, clock_s / CLOCK_SIGMA_S)

    def derivatives(self, x: Array, clock_s: float) -> Array:
        """Derivatives of the residuals by parameters, in steps, and by the clock, in its step."""
        ends = self.ends(x)
        runs = self.runs.of([x, *(end for pair in ends for end in pair)])
        rows = []
        for index, (low, high) in enumerate(ends):
            width = (high[index] - low[index]) / self.steps[index]
            less, more = (self.predicted(runs[1 + 2 * index + side], clock_s) / self.sigma for side in (0, 1))
            rows.append(np.append(-(more - less) / width, 0.0))
        less, more = (self.predicted(runs[0], clock_s + side * CLOCK_STEP_S) / self.sigma for side in (-1, 1))
        rows.append(np.append(-0.5 * (more - less), CLOCK_STEP_S / CLOCK_SIGMA_S))
        return np.array(rows).T

    def ends(self, x: Array) -> list[Run]:
        """Both ends of each central difference, inside the bounds."""
        ends = []
        for index, step in enumerate(self.steps):
            low, high = x.copy(), x.copy()
            low[index] = max(self.lower[index], x[index] - step)
            high[index] = min(self.upper[index], x[index] + step)
            ends.append((low, high))
        return ends


def _spread(lower: Array, upper: Array) -> list[Array]:
    """Starts that cover the bounds: evenly for one value, a low-discrepancy sequence for more."""
    if len(lower) == 1:
        return [lower + share * (upper - lower) for share in (np.arange(7) + 0.5) / 7.0]
    # Additive recurrence with powers of the root of x^(d+1) = x + 1.
    ratio = 2.0
    for _ in range(40):
        ratio = (1.0 + ratio) ** (1.0 / (len(lower) + 1))
    steps = ratio ** -np.arange(1.0, len(lower) + 1)
    return [
        lower + np.mod(0.5 + number * steps, 1.0) * (upper - lower) for number in range(6 + 5 * len(lower))
    ]
