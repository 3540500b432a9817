"""The report in words: why the verdict is what it is, corners and figures as a reader says them."""

from html import escape
from typing import Any

import numpy as np

from config.scene import Scene
from sim_core.geometry import CORNER_SIGNS, rotation_matrices
from sim_core.report_figures import Report, travel_direction


def verdict_sentence(report: Report, scene: Scene) -> str:
    """Why the verdict is what it is, in one sentence of plain text."""
    numerics = report.get("numerics", {})
    if numerics.get("ended_by") is not None:
        return f"No verdict: the test was {numerics['ended_by']}."
    rule = decisive_rule(report)
    if not report["rules"]:
        return "No verdict: no moment of the test was judged."
    if rule is None or not scene.packages:
        return "There is no package on the sled, so nothing could move out of its place."
    doubt = _doubt(report)
    if rule["limit_mm"] is None:
        stood = f"it stood {figure_text(rule['height_m'], 2)} m above the sled"
        return f"{doubt}The rule on damage is broken: package {rule['package']} toppled or fell; {stood}."
    worst, limit, _ = rule_figures(rule)
    over = f"limit of {limit} mm for {rule['title']}"
    moved = _movement(report, scene, rule, worst)
    if rule["state"] == "unresolved":
        error = figure_text(rule["error_mm"], 2)
        return f"The error estimate of {error} mm reaches across the {over}: {moved}."
    if rule["state"] == "fail":
        others = sum(other["state"] == "fail" for other in report["rules"]) - 1
        more = f", and {others} more rule{'s' if others > 1 else ''} failed" if others else ""
        return f"{doubt}The {over} was exceeded{more}: {moved}."
    share = f"{100.0 * (limit_share(rule) or 0.0):.0f} % of its limit of {limit} mm"
    return f"{doubt}Every rule passes; the closest is the {rule['title']}, at {share}: {moved}."


def decisive_rule(report: Report) -> dict[str, Any] | None:
    """The rule that decides: the worst among those that failed, or else the closest to its limit."""
    judged = [rule for rule in report["rules"] if rule["state"] != "off"]
    for state in ("fail", "unresolved", "pass"):
        rules = [
            rule
            for rule in judged
            if rule["state"] == state and (limit_share(rule) is not None or state == "fail")
        ]
        if rules:
            worst: dict[str, Any] = max(rules, key=lambda rule: limit_share(rule) or 0.0)
            return worst
    return None


def _doubt(report: Report) -> str:
    """Why a verdict is open although every rule has an answer."""
    if report["verdict"] != "unresolved":
        return ""
    if "numerics" not in report:
        return "No verdict, as the test is not complete. So far: "
    if report["numerics"]["error_estimate_mm"] is not None:
        return ""
    reason = report["numerics"]["error_estimate_from"].removeprefix("none: ")
    return f"No verdict, as there is no error estimate ({reason}). As computed: "


def _movement(report: Report, scene: Scene, rule: dict[str, Any], worst: str) -> str:
    """Who moved how far, where and when, for the rule's worst displacement."""
    if rule["package"] is None:
        return f"neighbouring layers moved by {worst} mm against each other"
    who = "the pallet" if rule["package"] == "pallet" else f"package {rule['package']}"
    where = f" at its {corner_words(report, scene, rule)} corner" if rule["corner"] is not None else ""
    height = f", {figure_text(rule['height_m'], 2)} m above the sled" if rule["height_m"] is not None else ""
    end = "at the end, " if rule["rule"].startswith("permanent") else ""
    when = f", {end}{rule['time_s']:.2f} s after the first frame" if rule["time_s"] is not None else ""
    return f"{who} moved by {worst} mm{where}{height}{when}"


def corner_words(report: Report, scene: Scene, rule: dict[str, Any]) -> str:
    """A corner in words seen along the travel, such as ``top front left``, from the settled poses."""
    if not report["moments"]:
        return str(rule.get("corner_name", rule["corner"]))
    row = next((i for i, package in enumerate(scene.packages, 1) if package.id == rule["package"]), 0)
    box = scene.pallet_box
    size = scene.packages[row - 1].size_m if row else (box.size_m if box is not None else (0.0, 0.0, 0.0))
    turn = rotation_matrices(np.array([report["moments"][0]["orientations_xyzw"][row]]))[0]
    offset = turn @ (CORNER_SIGNS[rule["corner"]] * 0.5 * np.array(size))
    x, y = travel_direction(report, scene)
    along, across = x * offset[0] + y * offset[1], x * offset[1] - y * offset[0]
    return " ".join(
        (
            "top" if offset[2] > 0.0 else "bottom",
            "front" if along > 0.0 else "rear",
            "left" if across > 0.0 else "right",
        )
    )


def limit_share(rule: dict[str, Any]) -> float | None:
    """Worst displacement as a share of the limit; None for a rule without one, and on an empty sled."""
    if not rule["limit_mm"] or rule["worst_mm"] is None:
        return None
    return float(rule["worst_mm"] / rule["limit_mm"])


def rule_figures(rule: dict[str, Any]) -> tuple[str, str, str]:
    """Worst, limit and margin in mm, with as many places as tell them apart."""
    close = rule["margin_mm"] is not None and abs(rule["margin_mm"]) < 0.1
    worst, limit, margin = (
        figure_text(rule[key], 3 if close else 1) for key in ("worst_mm", "limit_mm", "margin_mm")
    )
    return worst, limit, margin


def figure_text(value: float | None, places: int) -> str:
    """A figure with so many places, a true minus sign, no minus zero; a dash for None."""
    if value is None:
        return "–"
    text = f"{value:.{places}f}"
    return text.replace("-", "−") if float(text) else text.lstrip("-")


def safe_text(value: object) -> str:
    """Any text made harmless: escaped, and without control characters or halves of characters."""
    text = str(value).encode("utf-8", "replace").decode()
    return escape(
        "".join(c if c.isprintable() or c in " \n\t" else "\N{REPLACEMENT CHARACTER}" for c in text)
    )
