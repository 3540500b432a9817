"""Friction of surface pairs for an engine that multiplies one number a body."""

from collections.abc import Mapping, Set
from dataclasses import dataclass

import numpy as np

FLOOR = 1.0e-9
IDLE_WEIGHT = 1.0e-3


@dataclass(frozen=True)
class UnmetPair:
    """A pair whose friction the factors miss by more than 0.1 %.

    Attributes:
        pair: the two surfaces.
        wanted: friction asked for.
        used: friction in use.
        touching: whether the pair carries weight at the start.
    """

    pair: tuple[str, str]
    wanted: float
    used: float
    touching: bool


@dataclass(frozen=True)
class FrictionFactors:
    """One factor a surface, whose products stand for the wanted pair frictions."""

    factors: dict[str, float]
    unmet: tuple[UnmetPair, ...]


def friction_factors(
    table: Mapping[frozenset[str], float], *, touching: Set[frozenset[str]] = frozenset()
) -> FrictionFactors:
    """Splits pair frictions into factors with μ_ij = c_i · c_j, in the least-squares sense of log μ.

    A table of pairs is met exactly when its logarithms are sums of one number a surface: always for a
    single package surface on any ground, and for chains of layers; never in general. Pairs that carry
    weight at the start count a thousand times more than those that might meet in a collapse.
    Zero friction needs a zero factor, so a pair with μ = 0 counts as a very small friction.

    Args:
        table: wanted friction of pairs of surfaces.
        touching: the pairs that carry weight at the start.
    """
    surfaces = sorted({surface for pair in table for surface in pair})
    pairs = sorted(tuple(sorted(pair)) for pair in table)
    if not pairs:
        return FrictionFactors({}, ())
    equations = np.zeros((len(pairs), len(surfaces)))
    wanted = np.array([table[frozenset(pair)] for pair in pairs])
    for row, pair in enumerate(pairs):
        for surface in (pair[0], pair[-1]):
            equations[row, surfaces.index(surface)] += 1.0
    weights = np.array([1.0 if frozenset(pair) in touching else IDLE_WEIGHT for pair in pairs])
    logs = np.log(np.maximum(wanted, FLOOR))
    solution = np.linalg.lstsq(equations * weights[:, None], logs * weights, rcond=1.0e-12)[0]
    factors = {surface: float(factor) for surface, factor in zip(surfaces, np.exp(solution), strict=True)}
    unmet = []
    for pair, friction in zip(pairs, wanted.tolist(), strict=True):
        used = factors[pair[0]] * factors[pair[-1]]
        if abs(used - friction) > 1.0e-3 * max(friction, 1.0e-3):
            unmet.append(UnmetPair((pair[0], pair[-1]), friction, used, frozenset(pair) in touching))
    return FrictionFactors(factors, tuple(unmet))
