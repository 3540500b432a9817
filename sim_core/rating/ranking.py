"""Variants in order: the largest level first, the least film second; as rows, JSON and CSV."""

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from sim_core.rating.certificate import level_entry, load_entry
from sim_core.rating.climb import Climbed
from sim_core.rating.levels import CERTIFIED_G, FIRST_G, LevelPlan
from sim_core.rating.variants import Variant
from sim_core.report import Report, versions


@dataclass(frozen=True)
class Ranked:
    """A variant in its place.

    Attributes:
        rank: from 1; equal for variants that pass as much with as much film.
        variant: what it is.
        climbed: what it came to.
        is_best: no other passes as much with less film, or more with as much.
    """

    rank: int
    variant: Variant
    climbed: Climbed
    is_best: bool

    @property
    def largest_g(self) -> float:
        """The largest level that passed [g], 0 for none."""
        return self.climbed.largest_g or 0.0

    @property
    def film_g(self) -> float | None:
        """Mass of the film [g]."""
        return None if self.variant.film_kg is None else 1000.0 * self.variant.film_kg


def ranked(variants: Sequence[Variant], climbs: Sequence[Climbed]) -> tuple[list[Ranked], list[Variant]]:
    """The variants that were tested in their order, and those that were refused.

    Args:
        variants: as planned.
        climbs: of those that have a scene, in their order.
    """
    planned = [variant for variant in variants if variant.scene is not None]
    refused = [variant for variant in variants if variant.scene is None]
    tested = []
    for variant, climbed in zip(planned, climbs, strict=True):
        if climbed.refused is not None:
            refused.append(Variant(variant.name, variant.overrides, refused=str(climbed.refused)))
        else:
            tested.append((variant, climbed))
    keys = [(-(climbed.largest_g or 0.0), _film(variant)) for variant, climbed in tested]
    rows = [
        Ranked(1 + sum(other < key for other in keys), variant, climbed, _is_best(key, keys))
        for (variant, climbed), key in zip(tested, keys, strict=True)
    ]
    return sorted(rows, key=lambda row: row.rank), refused


def _film(variant: Variant) -> float:
    return float("inf") if variant.film_kg is None else round(variant.film_kg, 6)


def _is_best(key: tuple[float, float], keys: Sequence[tuple[float, float]]) -> bool:
    if key[0] == 0.0:
        return False
    return not any(other != key and other[0] <= key[0] and other[1] <= key[1] for other in keys)


def ranking_entry(
    scene: str, rows: Sequence[Ranked], refused: Sequence[Variant], plan: LevelPlan, varied: Sequence[str]
) -> Report:
    """The rating as a dictionary: ``rating.json``.

    Args:
        scene: the base scene's name.
        rows: the ranked variants.
        refused: those that could not be tested.
        plan: the levels.
        varied: what was varied, as it was asked for.
    """
    return {
        "title": "Variants of a load unit, rated to EUMOS 40509 by simulation",
        "scene": scene,
        "varied": list(varied),
        "plan": {"from_g": FIRST_G, "to_g": plan.to_g, "step_g": plan.step_g, "all_levels": plan.is_whole},
        "variants": [_row_entry(row) for row in rows],
        "refused": [
            {"name": one.name, "overrides": list(one.overrides), "why": one.refused} for one in refused
        ],
        "versions": versions(),
    }


def _row_entry(row: Ranked) -> dict[str, Any]:
    climbed = row.climbed
    stop_g = climbed.stopped_at_g
    load = load_entry(climbed.scene, next(iter(climbed.levels.values()), None))
    return {
        "rank": row.rank,
        "name": row.variant.name,
        "overrides": list(row.variant.overrides),
        "largest_passed_g": climbed.largest_g,
        "certificate": row.largest_g >= CERTIFIED_G - 1.0e-9,
        "is_best_for_its_film": row.is_best,
        "film_kg": row.variant.film_kg,
        "film_g": row.film_g,
        "film_g_per_kg_load": None
        if row.film_g is None or not load["mass_kg"]
        else row.film_g / load["mass_kg"],
        "load": load,
        "stopped": None
        if stop_g is None
        else {
            "level_g": stop_g,
            "verdict": climbed.levels[stop_g]["verdict"],
            "why": climbed.levels[stop_g]["why"],
        },
        "levels": [level_entry(level, report) for level, report in climbed.levels.items()],
        "scene_sha256": climbed.scene.sha256,
    }


def ranking_csv(entry: Report) -> str:
    """The rating as CSV, a variant a row, the refused ones last."""
    columns = (
        "rank", "name", "largest_passed_g", "certificate", "film_g", "film_g_per_kg_load", "packages", "mass_kg",
        "height_m", "stopped_at_g", "stopped_by", "share_of_limit_at_largest", "error_estimate_mm", "wall_s",
        "overrides", "refused",
    )  # fmt: skip
    stream = io.StringIO()
    writer = csv.DictWriter(stream, columns, restval="", lineterminator="\n")
    writer.writeheader()
    for row in entry["variants"]:
        top = next((level for level in row["levels"] if level["level_g"] == row["largest_passed_g"]), None)
        stopped = row["stopped"] or {"level_g": "", "verdict": ""}
        writer.writerow({
            **{name: row[name] for name in ("rank", "name", "largest_passed_g", "certificate")},
            "film_g": "" if row["film_g"] is None else f"{row['film_g']:.3f}",
            "film_g_per_kg_load": "" if row["film_g_per_kg_load"] is None else f"{row['film_g_per_kg_load']:.4f}",
            **{name: row["load"][name] for name in ("packages", "mass_kg", "height_m")},
            "stopped_at_g": stopped["level_g"],
            "stopped_by": stopped["verdict"],
            "share_of_limit_at_largest": "" if top is None else top["share_of_limit"],
            "error_estimate_mm": "" if top is None else top["error_estimate_mm"],
            "wall_s": round(sum(level["wall_s"] for level in row["levels"]), 3),
            "overrides": " ".join(f"--set '{override}'" for override in row["overrides"]),
        })  # fmt: skip
    for row in entry["refused"]:
        writer.writerow({"name": row["name"], "refused": row["why"]})
    return stream.getvalue()
