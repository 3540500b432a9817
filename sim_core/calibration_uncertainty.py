"""How sure fitted values are: what moves the measured or the simulated displacement moves them."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from config.scene import RecordedSled, Scene
from config.scene_file import validate_scene
from sim_core.calibration_runs import Run
from sim_core.calibration_search import CLOCK_STEP_S, Fit
from sim_core.companion import companion_scenes
from sim_core.frames import Array
from sim_core.load_test import REST_FOR_S

SLED_REDRAWS = 6


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """Covariance of the fit's values from each cause, with its degrees of freedom.

    Attributes:
        causes: covariance and degrees of freedom by cause; the last row and column are the clock's.
        notes: what is missing.
    """

    causes: Mapping[str, tuple[Array, float]]
    notes: list[str]

    def sigma(self, index: int) -> tuple[float, float]:
        """Standard uncertainty of one value, and its effective degrees of freedom."""
        parts = [(float(covariance[index, index]), freedom) for covariance, freedom in self.causes.values()]
        total = sum(part for part, _ in parts)
        lost = sum(part**2 / freedom for part, freedom in parts)
        return float(np.sqrt(total)), total**2 / lost if lost > 0.0 else np.inf


def uncertainty_of(fit: Fit, x: Array, clock_s: float) -> Uncertainty:
    """What moves the values, and by how much; see ``calibration``.

    Args:
        fit: the search that found them.
        x: values in the fit's measure.
        clock_s: the clock's offset [s].
    """
    derivatives = fit.derivatives(x, clock_s) / np.append(fit.steps, CLOCK_STEP_S)
    # What the displacement doesn't show is known to lie in its bounds, and no better: σ of a uniform distribution.
    bounded = np.append(np.sqrt(12.0) / (fit.upper - fit.lower), 0.0)
    inverse = np.linalg.inv(derivatives.T @ derivatives + np.diag(bounded**2))
    gain = inverse @ derivatives.T
    base = fit.predicted(fit.runs.of([x])[0], clock_s)

    def moved(run: Run) -> Array:
        change = (fit.predicted(run, clock_s) - base) / fit.sigma
        # The row of the clock's prior does not move.
        shift: Array = gain @ np.append(change, 0.0)
        return shift

    apart = (fit.values - base) / fit.sigma
    correlation = _correlation(fit, apart)
    freedom = max(1.0, len(apart) / correlation - len(x) - 1.0)
    spread = float(apart @ apart) / max(1, len(apart) - len(x) - 1) * correlation
    causes = {"chance": (inverse * max(1.0, spread), freedom)}
    causes["jaggedness"] = (_jaggedness(fit, x, moved), 2.0)
    redrawn = [_resledded(scene, seed) for seed, scene in enumerate([fit.runs.scene_of(x)] * SLED_REDRAWS)]
    noisy = [scene for scene in redrawn if scene is not None]
    for_sled = np.array([moved(run) for run in fit.runs.scenes(noisy)])
    if len(for_sled):
        causes["sled"] = (for_sled.T @ for_sled / len(for_sled), float(len(for_sled)))
    for_step = _step_shift(fit, x, moved)
    if for_step is None:
        return Uncertainty(causes, ["no run at another step came to its end: the step's error is not in it"])
    causes["step"] = (np.outer(for_step, for_step), 4.0)
    return Uncertainty(causes, [])


def _jaggedness(fit: Fit, x: Array, moved: Callable[[Run], Array]) -> Array:
    """What the straight line through each difference's ends leaves at its middle, as a covariance."""
    total = np.zeros((len(x) + 1, len(x) + 1))
    for index, (low, high) in enumerate(fit.ends(x)):
        less, more = (moved(run) for run in fit.runs.of([low, high]))
        share = (x[index] - low[index]) / (high[index] - low[index])
        left = (1.0 - share) * less + share * more
        total += np.outer(left, left)
    return total


def _step_shift(fit: Fit, x: Array, moved: Callable[[Run], Array]) -> Array | None:
    """What twice the step changes, or twice what half the step does; None where neither gives a whole test."""
    scene = fit.runs.scene_of(x)
    whole_s = fit.runs.of([x])[0][0][-1]
    for candidate in companion_scenes(scene):
        run = fit.runs.scenes([candidate])[0]
        # Ended early: no other opinion.
        if len(run[0]) and run[0][-1] > whole_s - REST_FOR_S:
            return moved(run) * (1.0 if candidate.time_step_s > scene.time_step_s else 2.0)
    return None


def _correlation(fit: Fit, apart: Array) -> float:
    """Over how many neighbours in time the residuals hang together: 1 + 2·Σ of their correlation while positive."""
    table = np.full(fit.seen.shape, np.nan)
    table[fit.seen] = apart
    series = table.reshape(len(table), -1)
    power = np.nanmean(series**2)
    total = 1.0
    for lag in range(1, len(series) // 2):
        products = series[lag:] * series[:-lag]
        if not np.isfinite(products).any():
            break
        share = float(np.nanmean(products) / power)
        if share <= 0.05:
            break
        total += 2.0 * share
    return total


def _resledded(scene: Scene, seed: int) -> Scene | None:
    """The scene with the noise of its sled's accelerometer drawn once more on top; None for a sled without noise.

    A reading's noise σ, one each τ, sums over a sample of Δt to a mean with σ·√(τ/Δt). Where the sled was brought to
    rest, so is the noise.
    """
    sled = scene.sled
    if not isinstance(sled, RecordedSled) or sled.source is None:
        return None
    source, samples = sled.source, np.array(sled.samples_mps2)
    sigma = float(np.mean(source.noise_mps2)) * np.sqrt(scene.sampling.samples_hz / source.rate_hz)
    moving = np.flatnonzero(samples.any(axis=1))
    if not sigma or not len(moving):
        return None
    strongest = samples[np.argmax(np.linalg.norm(samples, axis=1))]
    noise = sigma * np.random.Generator(np.random.PCG64(seed)).standard_normal(len(moving))
    if source.ends == "standing":
        noise -= noise.mean()
    samples[moving] += noise[:, None] * (strongest / np.linalg.norm(strongest))
    return validate_scene(
        {**scene.model_dump(), "sled": {**sled.model_dump(), "samples_mps2": samples.tolist()}}
    )
