"""The certificate of a climb: what was tested, the largest level that passed, and by how much, as one dictionary."""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import date
from typing import Any

from config.errors import RefusedInput
from config.scene import EumosSled, Scene, StandardPallet
from config.scene_file import friction_table
from sim_core.rating.climb import Climbed
from sim_core.rating.film_mass import film_mass_kg
from sim_core.rating.levels import CERTIFIED_G, FIRST_G, LevelPlan
from sim_core.report import Report, report_json, versions
from sim_core.report_words import decisive_rule, limit_share, wrap_words

STATEMENTS = (
    "This is the result of a simulation. No load was put on a sled, and no laboratory vouches for it.",
    "The simulation is verified, not validated for this load: its equations are held against closed forms and"
    " independent solutions, but these packages, this film and their friction were not measured on a bench.",
    "A level counts as passed only if every rule keeps its limit by more than the estimated error of the numbers.",
    "The certificate of EUMOS 40509 is given by a laboratory after a test of the real load unit.",
)
LONGEST_TEXT = 200


@dataclass(frozen=True)
class Label:
    """What a certificate says that no simulation knows.

    Attributes:
        date: day of issue, YYYY-MM-DD; empty is not given.
        institute: who issues it.
        producer: whose load it is.
    """

    date: str = ""
    institute: str = ""
    producer: str = ""

    def __post_init__(self) -> None:
        """Refuses what is no date, and texts that are no label.

        Raises:
            RefusedInput: the date is not a day as YYYY-MM-DD, or a text is too long.
        """
        if self.date:
            try:
                is_day = date.fromisoformat(self.date).isoformat() == self.date
            except ValueError:
                is_day = False
            if not is_day:
                raise RefusedInput("--date", self.date, "must be a day as YYYY-MM-DD")
        for name in ("institute", "producer"):
            if len(getattr(self, name)) > LONGEST_TEXT:
                raise RefusedInput(f"--{name}", getattr(self, name), f"at most {LONGEST_TEXT} characters")


def certificate(climbed: Climbed, plan: LevelPlan, label: Label) -> Report:
    """The certificate as a dictionary.

    The clock stands nowhere in it but in the levels' ``wall_s``; ``result_sha256`` is the digest of all but these, so
    that whoever repeats the rating can tell whether the result is the same.

    Args:
        climbed: a finished climb.
        plan: its levels.
        label: date and names.
    """
    scene, k = climbed.scene, climbed.largest_g
    stop_g = climbed.stopped_at_g
    stopped = climbed.levels.get(stop_g) if stop_g is not None else None
    content: dict[str, Any] = {
        "title": "Simulated rating of a load unit to EUMOS 40509",
        "statements": list(STATEMENTS),
        "date": label.date or None,
        "institute": label.institute or None,
        "producer": label.producer or None,
        "scene": scene.name,
        "description": scene.description,
        "scene_sha256": scene.sha256,
        "largest_passed_g": k,
        "certificate": k is not None and k >= CERTIFIED_G - 1.0e-9,
        "result": result_words(k),
        "ended": ended_words(climbed, plan),
        "stopped": None
        if stopped is None
        else {"level_g": stop_g, "verdict": stopped["verdict"], "why": stopped["why"]},
        "load": load_entry(scene, next(iter(climbed.levels.values()), None)),
        "profile": _profile_entry(scene),
        "plan": {"from_g": FIRST_G, "to_g": plan.to_g, "step_g": plan.step_g, "all_levels": plan.is_whole},
        "levels": [level_entry(level, report) for level, report in climbed.levels.items()],
        "versions": versions(),
    }
    return {**content, "result_sha256": _digest(content)}


def result_words(largest_g: float | None) -> str:
    """The result in a few words; a certificate begins at 0.5 g."""
    if largest_g is None:
        return f"no certificate, not even {FIRST_G:g} g was passed"
    if largest_g < CERTIFIED_G - 1.0e-9:
        return f"no certificate, largest level passed {largest_g:g} g"
    return f"largest level passed {largest_g:g} g"


def ended_words(climbed: Climbed, plan: LevelPlan) -> str:
    """Why the climb ended, in a sentence."""
    stop_g = climbed.stopped_at_g
    if stop_g is None:
        return f"Every level up to the highest that was asked for, {plan.to_g:g} g, was passed."
    stopped = climbed.levels[stop_g]
    verb = "failed" if stopped["verdict"] == "fail" else "is unresolved, which does not count as passed"
    words = f"{stop_g:g} g {verb}. {stopped['why']}"
    above = [f"{level:g} g" for level, report in climbed.levels.items()
             if level > stop_g and report["verdict"] == "pass"]  # fmt: skip
    return words + (f" Above it, {', '.join(above)} passed; that does not count." if above else "")


def level_entry(level_g: float, report: Report) -> dict[str, Any]:
    """One level: verdict, margins with their errors, setting and cost."""
    numerics = report["numerics"]
    decisive = decisive_rule(report)
    names = ("rule", "title", "limit_mm", "worst_mm", "margin_mm", "error_mm", "state", "package", "time_s")
    return {
        "level_g": level_g,
        "verdict": report["verdict"],
        "why": report["why"],
        "closest_rule": decisive["rule"] if decisive is not None else None,
        "share_of_limit": limit_share(decisive) if decisive is not None else None,
        "rules": [{name: rule.get(name) for name in names} for rule in report["rules"]],
        "error_estimate_mm": numerics["error_estimate_mm"],
        "error_estimate_from": numerics["error_estimate_from"],
        "engine": numerics["engine"],
        "time_step_s": numerics["time_step_s"],
        "iterations": numerics["iterations"],
        "setting_chosen": numerics["setting_chosen"],
        "refinements": numerics["refinements"],
        "ended_by": numerics["ended_by"],
        "unmet_friction": numerics["unmet_friction"],
        "steps": numerics["steps"],
        "simulated_s": numerics["simulated_s"],
        "wall_s": round(report["wall_s"], 3),
        "scene_sha256": report["scene_sha256"],
    }


def load_entry(scene: Scene, report: Report | None) -> dict[str, Any]:
    """The load's description.

    Args:
        scene: the resolved scene.
        report: of one of its levels, for the height as it was judged; or None.
    """
    box = scene.pallet_box
    packages = [package for package in scene.packages if package.kind == "package"]
    source = getattr(scene.load, "source", None)
    film_kg = film_mass_kg(scene)
    low, high = 0.0, max((p.position_m[2] + 0.5 * p.size_m[2] for p in scene.packages), default=0.0)
    sizes = sorted({tuple(round(1000.0 * edge) for edge in package.size_m) for package in packages})
    return {
        "packages": len(packages),
        "interlayers": len(scene.packages) - len(packages),
        "package_sizes_mm": [list(size) for size in sizes[:12]],
        "mass_kg": round(sum(package.mass_kg for package in scene.packages), 6),
        "height_m": report["height_m"] if report is not None else high - low,
        "pallet": None
        if box is None
        else {
            "kind": "EPAL 1" if isinstance(scene.pallet, StandardPallet) else "custom",
            "size_m": list(box.size_m),
            "mass_kg": box.mass_kg,
            "fixed": box.fixed,
        },
        "wrap": wrap_words(scene),
        "film_kg": film_kg,
        "force_fields": None if scene.force_fields is None else scene.force_fields.model_dump(),
        "friction": {
            " on ".join((sorted(pair) * 2)[:2]): value
            for pair, value in sorted(friction_table(scene).items(), key=lambda entry: sorted(entry[0]))
        },
        "source": source.model_dump() if source is not None else None,
    }


def _profile_entry(scene: Scene) -> dict[str, Any]:
    assert isinstance(scene.sled, EumosSled)
    return {name: value for name, value in scene.sled.model_dump().items() if name != "level_g"}


def _digest(content: Mapping[str, Any]) -> str:
    levels = [{**entry, "wall_s": None} for entry in content["levels"]]
    timeless = json.loads(report_json({**content, "levels": levels}))
    return hashlib.sha256(json.dumps(timeless, sort_keys=True, ensure_ascii=False).encode()).hexdigest()
