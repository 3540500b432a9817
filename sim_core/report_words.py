"""The report in words: why the verdict is what it is, corners and figures as a reader says them."""

import math
from collections.abc import Mapping
from html import escape
from typing import Any

import numpy as np

from config.scene import Scene
from config.wrap import FORCE_WIDTH_M, FilmLaw, Turns, Wrap
from sim_core.geometry import CORNER_SIGNS, rotation_matrices
from sim_core.report_figures import Report, travel_direction
from sim_core.report_film import FilmMap, percent, yield_strain


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
    if tore_film(report, rule):
        when, height = f"{rule['time_s']:.2f} s after the first frame", figure_text(rule["height_m"], 2)
        return f"{doubt}The rule on damage is broken: the film tore, first {when}, {height} m above the sled."
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


def tore_film(report: Report, rule: Mapping[str, Any]) -> bool:
    """Whether it is torn film that breaks a rule, not a package, which can have the name ``film`` too."""
    torn_s = report.get("film", {}).get("torn_s", ())
    is_named = rule["rule"] == "damage" and rule["package"] == "film"
    return is_named and any(time_s >= 0.0 for time_s in torn_s)


def wrap_words(scene: Scene) -> str:
    """Film and layers of a scene's wrap, or ``none``."""
    if scene.wrap is None or scene.film is None:
        return "none"
    return f"{scene.wrap.material}, {turns_words(scene.wrap.model_dump()['turns'])}"


def film_sentences(report: Report, scene: Scene, film: FilmMap) -> str:
    """How the film of a wrapped scene fared, in plain text."""
    wrap, layer = scene.wrap, scene.film
    assert wrap is not None and layer is not None
    law = layer.around
    follows = "The film follows the load and does not hold it. " if wrap.coupling == "one_way" else ""
    largest, tears = percent(float(film.peaks[film.worst])), percent(law.break_strain)
    if film.first_torn is not None:
        side, height = film.place(film.first_torn)
        return (
            f"{follows}The film tore: first after {film.torn_s[film.first_torn]:.2f} s, laid {height:.2f} m above the"
            f" sled on the {side} side; {int(film.is_torn.sum())} of its {len(film.peaks)} elements tore in all."
            f" The largest strain is {largest}; around the load the film tears at {tears}."
        )
    side, height = film.place(film.worst)
    gave_way = report.get("wrap", {}).get("lost_j", 0.0) >= 0.005
    yields = "" if math.isinf(law.yield_force_npm) else f"yields at {percent(yield_strain(law))} and "
    breaks = f"tears at {tears}" if wrap.tear else f"would tear at {tears}, which the scene rules out"
    return (
        f"{follows}The film stayed whole{', but gave way for good' if gave_way else ''}: its largest strain is"
        f" {largest}, laid {height:.2f} m above the sled on the {side} side; around the load it {yields}{breaks}."
    )


def film_facts(report: Report, scene: Scene, film: FilmMap) -> list[tuple[str, str]]:
    """The film of a wrapped scene in figures: what it is, and, in a full report, what it went through."""
    wrap, layer = scene.wrap, scene.film
    assert wrap is not None and layer is not None
    law = layer.around
    heights, holds = film.corners[:, :, 1], "the film holds the load and is stretched by it"
    if wrap.coupling == "one_way":
        holds = "the film follows the load and is watched, but does not hold it"
    facts = [
        ("Film", f"{layer.material}, {1.0e6 * layer.thickness_m:.3g} µm a layer as laid"),
        ("Layers", turns_words(wrap.model_dump()["turns"])),
        ("From and to", f"{heights.min():.2f} to {heights.max():.2f} m above the sled"),
        ("Coupling", f"{wrap.coupling.replace('_', '-')}: {holds}"),
        ("Strain as laid", f"{percent(layer.strain)} around the load, from the film without tension"),
        ("Yields", _yield_words(law)),
        (
            "Tears",
            f"at {percent(law.break_strain)} around the load, {percent(layer.up.break_strain)} up its side",
        ),
    ]
    found = report.get("wrap")
    if found is None:
        return facts
    torn = "nowhere" if wrap.tear else "the scene lets no film tear"
    if found["torn"]:
        torn = f"{found['torn']} of {found['elements']} elements, first {_place_words(found, 'first_tear')}"
    return [
        *facts,
        ("Pull when settled", _pull_words(found["start_force_npm"], wrap)),
        ("Largest pull", _pull_words(found["peak_force_npm"], wrap)),
        ("Largest strain", f"{percent(found['peak_strain'])} {_place_words(found, 'peak')}"),
        ("Torn", torn),
        (
            "Energy lost",
            f"{found['lost_j']:.3g} J, by film that gave way or tore" if found["lost_j"] else "none",
        ),
        ("Mesh", f"{found['nodes']} nodes, {found['elements']} elements"),
    ]


def turns_words(turns: float | Mapping[str, float]) -> str:
    """Layers everywhere, or a machine's turns by height, as a report's ``wrap`` has them."""
    if not isinstance(turns, Mapping):
        return f"{turns:g} layer{'' if turns == 1.0 else 's'} everywhere"
    named = (("bottom", "at the foot"), ("middle", "up or down"), ("top", "at the head"))
    shown = [f"{turns[name]:g} {where}" for name, where in named if turns[name] > 0.0]
    return f"a machine's turns: {', '.join(shown)}"


def _yield_words(law: FilmLaw) -> str:
    strain = yield_strain(law)
    if math.isinf(strain):
        return "never: the film is elastic until it tears"
    return f"from {law.yield_force_npm:.0f} N/m of one layer, {percent(strain)} around the load"


def _pull_words(force_npm: float, wrap: Wrap) -> str:
    """Pull of all layers and, where they are as many everywhere, of a layer of the web that wrap forces are said of."""
    words = f"{force_npm:.0f} N/m, all layers together"
    if isinstance(wrap.turns, Turns):
        return words
    of_one = force_npm * FORCE_WIDTH_M / wrap.turns
    return f"{words}; {of_one:.{0 if of_one >= 99.95 else 1}f} N for 500 mm of one layer"


def _place_words(found: Mapping[str, Any], what: str) -> str:
    """Where and when the film was stretched most or tore first, from a report's ``wrap``."""
    x, y, z = (figure_text(value, 2) for value in found[f"{what}_position_m"])
    return f"at x {x}, y {y}, z {z} m, after {found[f'{what}_time_s']:.2f} s"


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
