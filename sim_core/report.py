"""The report: one dictionary that says what was tested, what came out, how sure it is and what it cost."""

import json
import math
import platform
from collections.abc import Sequence
from dataclasses import asdict
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from config.scene import RecordedSled, Scene
from sim_core.companion import ErrorEstimate
from sim_core.integrity import Finding
from sim_core.judge import EumosJudge, Verdict, corner_name, verdict_of
from sim_core.monitors import (
    MAXIMUM_ENERGY_RESIDUAL,
    MAXIMUM_FILM_RESIDUAL,
    MAXIMUM_RELATIVE_PENETRATION,
    MAXIMUM_SPEED_MPS,
    MAXIMUM_STEP_PHASE,
)
from sim_core.run import PhysicsSummary
from sim_core.sled import build_profile

Report = dict[str, Any]

FAR_BEYOND = 2.0
"""A rule broken by more than this many times its limit: how far beyond interests nobody."""
PLAINLY_BEYOND = 1.5
"""A peak of this many limits in two runs settles a rule without an estimate."""


def judgement(scene: Scene, judge: EumosJudge, *, is_complete: bool = True) -> Report:
    """The part of the report that follows from scene and poses alone: the same bytes for the same poses.

    Args:
        scene: the resolved scene.
        judge: a judge that has taken every frame.
        is_complete: False when the test was ended early: then nothing can have passed.
    """
    rules = judge.rules() if judge.frame_count else []
    verdict: Verdict = verdict_of(rules) if is_complete and rules else "unresolved"
    return {
        "name": scene.name,
        "verdict": verdict,
        "rules": [_rule_entry(rule) for rule in rules],
        "first_failure": _first_entry(judge) if rules else None,
        "packages": [asdict(package) for package in judge.packages()] if rules else [],
        "height_m": judge.height_m if rules else None,
        "series": asdict(judge.series()) if rules else None,
        "moments": _moments(judge) if rules else [],
        **_film_entry(judge),
        "sled": _sled_entry(scene),
        "load": _load_entry(scene),
        "scene_sha256": scene.sha256,
    }


def full_report(
    judged: Report,
    scene: Scene,
    *,
    physics: PhysicsSummary,
    findings: list[Finding],
    estimate: ErrorEstimate | None,
    wall_s: float,
    mode: str,
    why: str = "as the scene says",
    refinements: Sequence[str] = (),
) -> Report:
    """The judgement with error estimate, numerics, integrity and versions.

    Args:
        judged: what ``judgement`` gave, here or in the validator node.
        scene: the resolved scene.
        physics: the physics' own account.
        findings: the integrity check's findings.
        estimate: the companion's, or None when none was asked for.
        wall_s: wall time of the test [s].
        mode: how it ran: ``run``, ``up fast`` or ``up real``.
        why: why it began with the engine and the step that it did.
        refinements: the coarser attempts before it and their estimates, in words.
    """
    report = dict(judged)
    if physics.ended_by is not None:
        # A part of a test compared with a whole one says nothing.
        estimate = None
    if estimate is not None:
        report["rules"] = [_with_error(rule, estimate) for rule in judged["rules"]]
        report["verdict"] = _verdict_with(report["rules"], estimate)
    report["numerics"] = _numerics(
        scene, physics, estimate, error_that_matters(judged["rules"], estimate), wall_s, mode
    )
    report["numerics"] |= {"setting_chosen": why, "refinements": list(refinements)}
    if physics.film is not None and scene.film is not None and scene.wrap is not None:
        around = scene.film.around
        report["wrap"] = {
            "material": scene.film.material,
            "turns": scene.wrap.model_dump(mode="json")["turns"],
            "coupling": scene.wrap.coupling,
            "yield_strain": None
            if math.isinf(around.yield_force_npm)
            else around.yield_force_npm / around.stiffness_npm,
            "break_strain": around.break_strain,
            **physics.film,
        }
    report["integrity"] = [asdict(finding) for finding in findings]
    report["versions"] = versions()
    return report


def error_that_matters(rules: Sequence[dict[str, Any]], estimate: ErrorEstimate | None) -> float | None:
    """Largest estimate [mm] of the rules that are not broken beyond all doubt; None where there is no estimate.

    A rule that is broken by more than twice its limit, estimate or not, has no use for a better one.
    """
    if estimate is None or estimate.largest_mm is None:
        return None
    errors = [0.0]
    for rule in rules:
        error_mm = estimate.by_rule_mm.get(rule["rule"])
        if error_mm is None:
            continue
        is_hopeless = (
            rule["limit_mm"] is not None
            and rule["worst_mm"] > FAR_BEYOND * rule["limit_mm"]
            and rule["worst_mm"] - error_mm > rule["limit_mm"]
        )
        errors.append(0.0 if is_hopeless else error_mm)
    return max(errors)


def worst_by_rule(judged: Report) -> dict[str, float]:
    """Each rule's worst displacement [mm], by rule name."""
    return {rule["rule"]: rule["worst_mm"] for rule in judged["rules"] if rule["worst_mm"] is not None}


def _with_error(rule: dict[str, Any], estimate: ErrorEstimate) -> dict[str, Any]:
    """The rule with its error estimate; ``unresolved`` where the estimate reaches across the limit."""
    error_mm = estimate.by_rule_mm.get(rule["rule"])
    if rule["margin_mm"] is None or error_mm is None:
        return rule
    return {
        **rule,
        "error_mm": error_mm,
        "state": rule["state"] if abs(rule["margin_mm"]) > error_mm else "unresolved",
    }


def _verdict_with(rules: list[dict[str, Any]], estimate: ErrorEstimate) -> Verdict:
    """One rule that fails beyond its error settles the verdict.

    Without an estimate nothing is settled, but for one case: both runs broke the limit on the elastic peak by
    half as much again. A peak doesn't come down, and no such distance was ever an error of the step.
    """
    if estimate.largest_mm is None:
        elastic = next(rule for rule in rules if rule["rule"] == "elastic")
        both_mm = min(elastic["worst_mm"], estimate.worst_until_problem_mm.get("elastic", 0.0))
        return "fail" if both_mm > PLAINLY_BEYOND * elastic["limit_mm"] else "unresolved"
    states = {rule["state"] for rule in rules}
    if "fail" in states:
        return "fail"
    return "unresolved" if "unresolved" in states else "pass"


def write_report(report: Report, path: Path) -> None:
    """Writes a report as indented JSON, whole or not at all."""
    scratch = path.with_name(path.name + ".part")
    scratch.write_text(report_json(report) + "\n", encoding="utf-8")
    scratch.replace(path)


def report_json(report: Report, *, compact: bool = False) -> str:
    """A report as JSON text; numbers are rounded to a nanometre or finer, so that texts stay short."""
    return json.dumps(
        _rounded(report), ensure_ascii=False, allow_nan=False, indent=None if compact else 1,
        separators=(",", ":") if compact else None,
    )  # fmt: skip


PICTURED = ("mujoco", "vtk", "opencv-python-headless", "av", "numba", "scipy")
"""What pictures, film and draws depend on besides."""


def versions(more: Sequence[str] = ()) -> dict[str, str]:
    """Versions of everything that a result depends on.

    Args:
        more: further packages that it depends on.
    """
    found = {"python": platform.python_version(), "platform": f"{platform.system()} {platform.machine()}"}
    for name in ("pallet-twin", "numpy", "pybullet", "pydantic", *more):
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "not installed as a package"
    return found


def _rule_entry(rule: Any) -> dict[str, Any]:
    entry = asdict(rule)
    if rule.corner is not None:
        entry["corner_name"] = corner_name(rule.corner)
    return entry


def _first_entry(judge: EumosJudge) -> dict[str, Any] | None:
    first = judge.first_failure()
    if first is None:
        return None
    return asdict(first) | ({"corner_name": corner_name(first.corner)} if first.corner is not None else {})


def _moments(judge: EumosJudge) -> list[dict[str, Any]]:
    return [
        {
            "name": moment.name,
            "time_s": moment.time_s,
            "positions_m": moment.frame.positions.tolist(),
            "orientations_xyzw": moment.frame.orientations.tolist(),
        }
        for moment in judge.moments()
    ]


def _film_entry(judge: EumosJudge) -> dict[str, Any]:
    """The unrolled film, an element a row: corners, largest strain of the whole test, and when it tore."""
    film = judge.film
    if film is None:
        return {}
    return {
        "film": {
            "corners_m": [
                [round(value, 4) for value in row] for row in film.unrolled.reshape(-1, 6).tolist()
            ],
            "middles_m": [[round(value, 3) for value in row] for row in film.corners.mean(axis=1).tolist()],
            "peak_strain": [round(value, 5) for value in film.peaks.tolist()],
            "torn_s": [round(value, 4) for value in film.torn_s.tolist()],
        }
    }


def _sled_entry(scene: Scene) -> dict[str, Any]:
    profile = build_profile(scene)
    thin = max(1, len(profile.times) // 2000)
    source = scene.sled.source if isinstance(scene.sled, RecordedSled) else None
    return {
        "profile": scene.sled.profile,
        "times_s": profile.times[::thin].tolist(),
        "acceleration_mps2": profile.accelerations[::thin].tolist(),
        "velocity_mps": profile.velocities[::thin].tolist(),
        "peak_mps2": profile.peak_mps2,
        "travel_m": float((profile.positions[-1] ** 2).sum() ** 0.5),
        "stop_s": profile.end_s,
        # What was found in an accelerometer's readings, where they drive it.
        "source": source.model_dump() if source is not None else None,
    }


def _load_entry(scene: Scene) -> dict[str, Any]:
    source = getattr(scene.load, "source", None)
    return {
        "package_count": sum(package.kind == "package" for package in scene.packages),
        "interlayer_count": sum(package.kind == "interlayer" for package in scene.packages),
        "mass_kg": sum(package.mass_kg for package in scene.packages),
        "source": source.model_dump() if source is not None else None,
    }


def _numerics(
    scene: Scene,
    physics: PhysicsSummary,
    estimate: ErrorEstimate | None,
    matters_mm: float | None,
    wall_s: float,
    mode: str,
) -> dict[str, Any]:
    largest = estimate.largest_mm if estimate is not None else None
    tolerance_mm = scene.solver.tolerance_mm
    edges = [edge for package in scene.packages for edge in package.size_m]
    return {
        "mode": mode,
        "engine": physics.engine,
        "time_step_s": scene.time_step_s,
        "iterations": scene.iterations,
        "settings": physics.settings,
        "steps": physics.steps,
        "error_estimate_mm": largest,
        "error_estimate_from": _estimate_origin(scene, estimate, physics.ended_by is not None),
        "tolerance_mm": tolerance_mm,
        "within_tolerance": None
        if matters_mm is None or tolerance_mm is None
        else matters_mm <= tolerance_mm,
        "max_penetration_mm": 1000.0 * physics.penetration_m,
        "max_contacts": physics.contact_count,
        "solver_residual": physics.residual,
        "energy_residual": physics.energy_residual,
        "smallest_step_s": physics.smallest_step_s,
        "halvings": physics.halvings,
        "settle_s": physics.settle_s,
        "simulated_s": physics.simulated_s,
        "at_rest": physics.at_rest,
        "wall_time_s": wall_s,
        "real_time_factor": (physics.simulated_s + physics.settle_s) / wall_s if wall_s > 0.0 else None,
        "unmet_friction": physics.unmet_friction,
        "ended_by": physics.ended_by,
        "monitors": [
            {"monitor": "speed", "worst": physics.speed_mps, "limit": MAXIMUM_SPEED_MPS, "unit": "m/s"},
            {
                "monitor": "penetration",
                "worst": 1000.0 * physics.penetration_m,
                "limit": 1000.0 * MAXIMUM_RELATIVE_PENETRATION * min(edges, default=0.0),
                "unit": "mm, the limit for the thinnest body and three checks running",
            },
            {
                "monitor": "stiffness",
                "worst": physics.step_phase,
                "limit": MAXIMUM_STEP_PHASE,
                "unit": "rad, step times the stiffest spring's frequency",
            },
            {
                "monitor": "energy",
                "worst": physics.energy_residual,
                "limit": MAXIMUM_ENERGY_RESIDUAL,
                "unit": "share of the energy moved",
            },
            *(
                [
                    {
                        "monitor": "residual",
                        "worst": physics.usual_residual,
                        "limit": physics.residual_limit,
                        "unit": "m²/s², what the solver leaves step after step",
                    }
                ]
                if physics.residual_limit is not None
                else []
            ),
            *(
                [
                    {
                        "monitor": "film",
                        "worst": physics.film_residual,
                        "limit": MAXIMUM_FILM_RESIDUAL,
                        "unit": "share of a row's pull, what the film leaves unbalanced",
                    }
                ]
                if physics.film is not None
                else []
            ),
        ],
    }


def _estimate_origin(scene: Scene, estimate: ErrorEstimate | None, is_cut_short: bool) -> str:
    if is_cut_short:
        return "none: the test was ended early"
    if estimate is None:
        return "not asked for"
    if estimate.problem is not None:
        return f"none: {estimate.problem}"
    return (
        f"difference between steps of {1000.0 * scene.time_step_s:.4g} ms"
        f" and {1000.0 * estimate.companion_step_s:.4g} ms"
    )


def _rounded(value: Any) -> Any:
    if isinstance(value, float):
        return round(value, 9)
    if isinstance(value, dict):
        return {key: _rounded(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [_rounded(entry) for entry in value]
    return value
