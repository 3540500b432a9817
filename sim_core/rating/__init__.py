"""The largest EUMOS level that a load passes, with a certificate, and the packing that does best with least film."""

from sim_core.rating.climb import Climb, Climbed, climb_all
from sim_core.rating.levels import CERTIFIED_G, LevelPlan, rated_level
from sim_core.rating.variants import Variant, parse_vary, plan_variants

__all__ = [
    "CERTIFIED_G",
    "Climb",
    "Climbed",
    "LevelPlan",
    "Variant",
    "climb_all",
    "parse_vary",
    "plan_variants",
    "rated_level",
]
