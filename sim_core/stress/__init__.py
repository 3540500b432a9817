"""The stability table: scenes that break a physics engine, each with what is expected and what came out."""

from sim_core.stress.known import KNOWN_WRONG
from sim_core.stress.model import KnownWrong, Outcome, StressResult, StressRow
from sim_core.stress.run import all_rows, run_stress

__all__ = ["KNOWN_WRONG", "KnownWrong", "Outcome", "StressResult", "StressRow", "all_rows", "run_stress"]
