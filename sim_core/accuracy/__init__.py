"""Error against run time: reference cases, sweeps over settings, fronts, figures and the accuracy page."""

from sim_core.accuracy.run import run_accuracy

__all__ = ["run_accuracy"]
