"""How often the true error lies inside the error estimate, over every run of a sweep that has a companion in it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sim_core.accuracy.sweep import Row
from sim_core.companion import floor_mm

SEEN_FROM_MM = 0.01
"""Below this error an estimate is its floor, and its ratio to the error says nothing."""


@dataclass(frozen=True)
class Coverage:
    """What the estimates of one engine came to.

    Attributes:
        engine: the engine.
        quantities: number of quantities compared, over all cases and settings.
        inside: share of them whose true error lies inside the estimate.
        median_ratio: median of estimate over true error, where that is above 0.01 mm.
        seen: how many those are.
        misses: the quantities outside, in words, largest miss first.
    """

    engine: str
    quantities: int
    inside: float
    median_ratio: float
    seen: int
    misses: tuple[str, ...]


def coverage(rows: Sequence[Row]) -> list[Coverage]:
    """Coverage by engine: each row's companion is the row at twice the step and half the iterations.

    Args:
        rows: a sweep over cases whose right values are known; quantities that are not in mm, and references that are
            only a finer run of the same engine, are left out.
    """
    found = []
    by_setting = {(row.case, row.engine, row.rate_hz, row.iterations): row for row in rows}
    for engine in sorted({row.engine for row in rows}):
        ratios: list[tuple[float, float, str]] = []
        for row in rows:
            beside = by_setting.get((row.case, engine, row.rate_hz // 2, round(0.5 * row.iterations)))
            if row.engine != engine or beside is None:
                continue
            values = {q.name: q.value for q in beside.quantities}
            for q in row.quantities:
                if q.unit != "mm" or q.reference_kind == "self-refined" or q.name not in values:
                    continue
                estimate = max(abs(values[q.name] - q.value), floor_mm(1.0 / row.rate_hz))
                words = (
                    f"{row.case}, {q.name}, {row.setting.words}: {q.error:.3f} mm, estimate {estimate:.3f} mm"
                )
                ratios.append((estimate / max(q.error, 1.0e-12), q.error, words))
        if not ratios:
            continue
        seen = [ratio for ratio, error, _ in ratios if error > SEEN_FROM_MM]
        misses = sorted((ratio, words) for ratio, _, words in ratios if ratio < 1.0)
        found.append(
            Coverage(
                engine, len(ratios), 1.0 - len(misses) / len(ratios),
                float(np.median(seen)) if seen else float("nan"), len(seen), tuple(w for _, w in misses),
            )
        )  # fmt: skip
    return found
