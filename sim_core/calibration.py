"""Fits a scene's parameters to measured displacement, and says how sure each fitted value is.

Least squares over all times and points, by SciPy's trust-region solver, from the best of a few starts that cover the
bounds. Each simulation sticks and slips, so derivatives are central differences over a step that is far above the
simulation's own noise. The time between the clocks of sled and displacement is fitted too.

The stated interval is not that of the residuals alone, which are far too smooth to be chance. With J the derivatives
and P = (JᵀJ)⁻¹·Jᵀ, whatever moves the displacement by δ moves the parameters by P·δ. Added in squares are

    chance      s²·τ·(JᵀJ)⁻¹, τ the time over which the residuals hang together,
    sled        the scatter of P·δ over redraws of the noise in the sled's own acceleration,
    step        P·δ of a run at twice the step, as for the error estimate of a test,
    jaggedness  P·δ of what a straight line through three runs leaves at the middle one,

and the interval is that of Student's t with their effective degrees of freedom (Welch and Satterthwaite).
"""

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from config.errors import RefusedInput
from config.scene import Scene
from sim_core.calibration_parameters import Parameter
from sim_core.calibration_runs import Runs
from sim_core.calibration_search import Fit, OnProgress
from sim_core.calibration_uncertainty import Uncertainty, uncertainty_of
from sim_core.residual import MeasuredDisplacement

MOST_TIMES = 160
"""Measurements in between are left out: a load does nothing that so many don't show."""
RESOLVED_SHARE = 0.5
"""An interval wider than this share of the bounds is no answer."""
POOR_FIT = 4.0
"""A fit that leaves more than this many standard uncertainties of the measurement is told as poor."""


@dataclass(frozen=True)
class FittedParameter:
    """One fitted value.

    Attributes:
        key: the parameter's.
        value: fitted.
        low: lower end of the 95 % interval.
        high: upper end of it.
        start: what the scene had, or None.
        is_resolved: False where the recording says too little about it.
        sigma_share: standard uncertainty from each cause, in the units of the fit (of the logarithm, for scales).
    """

    key: str
    value: float
    low: float
    high: float
    start: float | None
    is_resolved: bool
    sigma_share: Mapping[str, float]


@dataclass(frozen=True)
class Calibration:
    """What a fit came to.

    Attributes:
        parameters: in the order in which they were asked for.
        scene: the scene with the fitted values.
        rms_mm: root mean square of what is left between measurement and simulation [mm].
        sigma_mm: that of the measurement's own uncertainty [mm].
        clock_offset_ms: displacement's clock ahead of the sled's, as fitted [ms].
        evaluations: simulations run, those for the uncertainty included.
        points: measured values used.
        wall_s: [s].
        notes: what a reader must know.
    """

    parameters: list[FittedParameter]
    scene: Scene
    rms_mm: float
    sigma_mm: float
    clock_offset_ms: float
    evaluations: int
    points: int
    wall_s: float
    notes: list[str] = field(default_factory=list)


def calibrate(
    scene: Scene,
    measured: MeasuredDisplacement,
    parameters: Sequence[Parameter],
    *,
    workers: int = 2,
    most_evaluations: int = 150,
    on_progress: OnProgress | None = None,
) -> Calibration:
    """Fits parameters of a scene to measured displacement.

    Args:
        scene: a resolved scene whose sled moves as the measured one did.
        measured: the displacement.
        parameters: what to fit.
        workers: processes that simulate; 1: this one.
        most_evaluations: simulations that may be run before the uncertainty is looked at.
        on_progress: called with simulations run and the best root mean square so far [mm].

    Raises:
        RefusedInput: nothing to fit, or nothing measured, or the load does not stand with any value tried.
    """
    if not parameters:
        raise RefusedInput("--fit", "nothing", "must name at least one parameter")
    thinned = _thinned(measured)
    if not np.isfinite(thinned.displacement).any():
        raise RefusedInput("displacement", 0, "no measured value is a number")
    began = time.perf_counter()
    with Runs(scene, thinned.observed, parameters, workers) as runs:
        fit = Fit(runs, thinned, on_progress, most_evaluations)
        x, clock_s = fit.solve()
        outcome = uncertainty_of(fit, x, clock_s)
        fitted, notes = [], list(outcome.notes)
        for index, parameter in enumerate(parameters):
            fitted.append(_stated(parameter, x[index], index, outcome, scene))
            if not fitted[-1].is_resolved:
                notes.append(f"{parameter.key}: this displacement says too little about it")
        best = fit.left(x, clock_s)
        times = float(np.sqrt(np.mean((best / fit.sigma) ** 2)))
        if times > POOR_FIT:
            notes.append(
                f"{times:.1f} times the measurement's uncertainty is left: something else moves this load"
            )
    final = scene
    for parameter, one in zip(parameters, fitted, strict=True):
        final = parameter.applied(final, one.value)
    sigma = thinned.sigma[np.isfinite(thinned.displacement)]
    return Calibration(
        parameters=fitted,
        scene=final,
        rms_mm=float(1000.0 * np.sqrt(np.mean(best**2))),
        sigma_mm=float(1000.0 * np.sqrt(np.mean(sigma**2))),
        clock_offset_ms=1000.0 * clock_s,
        evaluations=runs.count,
        points=len(best),
        wall_s=time.perf_counter() - began,
        notes=notes,
    )


def _stated(
    parameter: Parameter, x: float, index: int, outcome: Uncertainty, scene: Scene
) -> FittedParameter:
    from scipy.special import stdtrit  # type: ignore[import-untyped]

    sigma, freedom = outcome.sigma(index)
    reach = float(stdtrit(min(freedom, 1.0e6), 0.975)) * sigma
    lower, upper = parameter.bounds
    low, high = float(max(lower, x - reach)), float(min(upper, x + reach))
    return FittedParameter(
        key=parameter.key,
        value=parameter.value(float(x)),
        low=parameter.value(low),
        high=parameter.value(high),
        start=parameter.read(scene),
        is_resolved=bool(high - low < RESOLVED_SHARE * (upper - lower)) and sigma > 0.0,
        sigma_share={
            cause: float(np.sqrt(covariance[index, index]))
            for cause, (covariance, _) in outcome.causes.items()
        },
    )


def _thinned(measured: MeasuredDisplacement) -> MeasuredDisplacement:
    every = max(1, -(-len(measured.times) // MOST_TIMES))
    return MeasuredDisplacement(
        measured.observed, measured.times[::every], measured.displacement[::every], measured.sigma[::every]
    )
