"""What a run watches in itself, each with a threshold that has a reason."""

from collections import deque
from dataclasses import dataclass
from statistics import median

import numpy as np

from sim_core.engines import ContactState
from sim_core.frames import Array

MAXIMUM_SPEED_MPS = 50.0
"""Half of the 100 m/s at which btMultiBody clamps each velocity in silence."""
MAXIMUM_DROP_M = 1.0
"""Below the platform, which is modelled 200 m wide: what gets here has left the model."""
MAXIMUM_RELATIVE_PENETRATION = 0.02
"""Of the smaller body's smallest edge, three checks running: an impact passes, a load that sinks does not."""
PENETRATION_CHECKS = 3
RESIDUAL_CHECKS = 10
"""A blow leaves a large residual once; the median of this many checks is what stays unsolved."""
MAXIMUM_FILM_RESIDUAL = 0.05
"""Median over ten checks of the force that the film leaves unbalanced, as a share of the pull of a row of it."""
MAXIMUM_STEP_PHASE = 0.3
"""Step times the frequency of the stiffest spring: below it a spring's peak is within 1 % (the explicit limit is 2)."""
MAXIMUM_ENERGY_RESIDUAL = 0.05
"""Energy that appears from nowhere, as a share of what the sled put in and the load's weight gave up."""


@dataclass(frozen=True)
class Breach:
    """A threshold that was passed: the monitor's name, and measured value, limit and place in words."""

    monitor: str
    reason: str


@dataclass
class Extremes:
    """The largest values seen.

    Attributes:
        penetration_m: deepest contact [m].
        speed_mps: largest speed relative to the sled [m/s].
        residual: largest remaining solver residual, in the engine's measure.
        usual_residual: largest median of the residual over ten checks.
        contact_count: largest number of contact points.
        step_phase: largest step times spring frequency.
        energy_residual: largest share of energy that appeared from nowhere.
        film_residual: largest median over ten checks of what the film leaves unbalanced, as a share of a row's pull.
    """

    penetration_m: float = 0.0
    speed_mps: float = 0.0
    residual: float = 0.0
    usual_residual: float = 0.0
    contact_count: int = 0
    step_phase: float = 0.0
    energy_residual: float = 0.0
    film_residual: float = 0.0


class Monitors:
    """Takes measurements, remembers the largest, and names the first breach.

    Args:
        names: a name for each body.
        radii: distance of each body's corners from its centre [m], shape [n].
    """

    def __init__(self, names: list[str], radii: Array) -> None:
        self._names, self._radii = names, radii
        self._deep_checks = 0
        self._residuals: deque[float] = deque(maxlen=RESIDUAL_CHECKS)
        self._film_residuals: deque[float] = deque(maxlen=RESIDUAL_CHECKS)
        self.extremes = Extremes()

    def forget_recent(self) -> None:
        """Starts counting anew, after the state was rolled back."""
        self._deep_checks = 0
        self._residuals.clear()
        self._film_residuals.clear()

    def motion(self, positions: Array, linear: Array, angular: Array) -> Breach | None:
        """Finite state, place and speed; shapes [n, 3], metres and radians a second."""
        speeds = np.linalg.norm(linear, axis=1) + np.linalg.norm(angular, axis=1) * self._radii
        sound = np.isfinite(speeds) & np.isfinite(positions).all(axis=1)
        if not sound.all():
            return Breach(
                "finite state", f"{self._names[int(np.argmin(sound))]} has no finite pose or velocity"
            )
        lowest = int(positions[:, 2].argmin())
        if positions[lowest, 2] < -MAXIMUM_DROP_M:
            return Breach("place", f"{self._names[lowest]} left the sled's platform and fell below it")
        fastest = int(speeds.argmax())
        speed = float(speeds[fastest])
        self.extremes.speed_mps = max(self.extremes.speed_mps, speed)
        if speed > MAXIMUM_SPEED_MPS:
            return Breach(
                "speed", f"{self._names[fastest]} at {speed:.1f} m/s, limit {MAXIMUM_SPEED_MPS} m/s"
            )
        return None

    def contacts(self, state: ContactState, residual: float) -> Breach | None:
        """Penetration, relative to the smaller body's smallest edge."""
        extremes = self.extremes
        extremes.penetration_m = max(extremes.penetration_m, state.penetration_m)
        extremes.contact_count = max(extremes.contact_count, state.count)
        extremes.residual = max(extremes.residual, residual)
        is_deep = state.relative_penetration > MAXIMUM_RELATIVE_PENETRATION
        self._deep_checks = self._deep_checks + 1 if is_deep else 0
        if self._deep_checks >= PENETRATION_CHECKS:
            return Breach(
                "penetration",
                f"{state.deepest[0]} and {state.deepest[1]} overlap by {100.0 * state.relative_penetration:.1f} %"
                f" of the smaller one's smallest edge, limit {100.0 * MAXIMUM_RELATIVE_PENETRATION:.0f} %",
            )
        return None

    def unsolved(self, residual: float, limit: float) -> Breach | None:
        """The solver's remaining residual, in the engine's measure: what stays over ten checks is creep."""
        usual = _usual(self._residuals, residual)
        self.extremes.usual_residual = max(self.extremes.usual_residual, usual)
        if usual > limit:
            return Breach(
                "residual", f"the solver leaves {usual:.2g} unsolved step after step, limit {limit:.2g}"
            )
        return None

    def unbalanced_film(self, residual: float) -> Breach | None:
        """What the film leaves unbalanced, as a share of the pull of a row of it: it has not found its rest."""
        usual = _usual(self._film_residuals, residual)
        self.extremes.film_residual = max(self.extremes.film_residual, usual)
        if usual > MAXIMUM_FILM_RESIDUAL:
            return Breach(
                "film",
                f"the film is out of balance by {100.0 * usual:.0f} % of a row's pull check after check,"
                f" limit {100.0 * MAXIMUM_FILM_RESIDUAL:.0f} %",
            )
        return None

    def stiffness(
        self, step_s: float, frequency: float, *, limit: float = MAXIMUM_STEP_PHASE
    ) -> Breach | None:
        """The step against the stiffest spring at work [rad/s]; a coarse run may have a wider limit."""
        phase = step_s * frequency
        self.extremes.step_phase = max(self.extremes.step_phase, phase)
        if phase > limit:
            return Breach(
                "stiffness",
                f"the step of {1000.0 * step_s:.3g} ms is {phase:.3g} of the stiffest spring's phase,"
                f" limit {limit}: at most {1000.0 * limit / frequency:.3g} ms would do",
            )
        return None

    def energy(self, residual: float) -> Breach | None:
        """The ledger's residual."""
        self.extremes.energy_residual = max(self.extremes.energy_residual, residual)
        if residual > MAXIMUM_ENERGY_RESIDUAL:
            return Breach(
                "energy",
                f"{100.0 * residual:.1f} % of the energy appeared from nowhere,"
                f" limit {100.0 * MAXIMUM_ENERGY_RESIDUAL:.0f} %",
            )
        return None


def _usual(recent: deque[float], residual: float) -> float:
    """Takes a residual and gives the median of the last ones; nothing is usual before ten of them."""
    recent.append(residual)
    return median(recent) if len(recent) == RESIDUAL_CHECKS else 0.0
