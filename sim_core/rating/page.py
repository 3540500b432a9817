"""The certificate and the rating as HTML pages that stand on their own."""

import base64
from collections.abc import Mapping, Sequence
from typing import Any

from config.scene import Scene
from sim_core.frames import GRAVITY
from sim_core.rating.figures import RatedPoint, rating_figure, space_figure
from sim_core.rating.levels import CERTIFIED_G
from sim_core.rating.pictures import Pair
from sim_core.report import Report
from sim_core.report_style import STYLE
from sim_core.report_words import figure_text, safe_text

_SYMBOLS = {"pass": "✓", "fail": "✕", "unresolved": "?", "off": "–"}
_CSP = "default-src 'none'; style-src 'unsafe-inline'; img-src data:"


def certificate_html(
    entry: Report, *, shown: tuple[Report, Scene] | None = None, pictures: Pair | None = None
) -> str:
    """The certificate's page: the same text for the same input.

    Args:
        entry: as ``certificate`` made it.
        shown: the result and the scene of the level to show before and after, or None.
        pictures: what the camera saw of it; without them the page draws the load in space.
    """
    k = entry["largest_passed_g"]
    state = "pass" if entry["certificate"] else "fail" if k is None else "unresolved"
    badge = "none" if k is None else f"{k:g} g"
    described = (
        f'<p class="description">{safe_text(entry["description"])}</p>' if entry["description"] else ""
    )
    header = (
        f'<header class="{state}"><p class="kicker">Simulated rating of a load unit to EUMOS 40509, on the digital'
        f" twin of a sled bench</p>\n<h1>{safe_text(entry['scene'])}</h1>\n{described}"
        f'<div class="verdict"><p class="badge">{badge}</p><p><strong>{_first_upper(entry["result"])}.</strong>'
        f" {safe_text(entry['ended'])}</p></div>\n"
        f'<p class="notice"><strong>{safe_text(entry["statements"][0])}</strong>'
        f" {safe_text(entry['statements'][1])}</p></header>"
    )
    parts = [
        header,
        _section("Label", facts(_label(entry))),
        _section("The load", facts(_load(entry))),
        _before_and_after(entry, shown, pictures),
        _section("Every level", _levels(entry) + _small(
            "A level passes only if every rule keeps its limit by more than the error estimate. Error: the largest of"
            " the level's rules, from the same test at another step."
        )),
        _section("Margins by level", _margins(entry) + _small(
            "What is left to the limit [mm], with the error estimate; a negative margin breaks the rule."
        )),
        _section("What this is, and what it is not", _bullets(entry["statements"])),
        _section("Where it comes from", facts(_provenance(entry))),
    ]  # fmt: skip
    return _page(f"{entry['scene']}: {entry['result']}", parts)


def rating_html(entry: Report) -> str:
    """The rating's page: variants in order, and the plot of level against film.

    Args:
        entry: as ``ranking_entry`` made it.
    """
    rows = entry["variants"]
    points = [
        RatedPoint(row["rank"], row["film_g"], row["largest_passed_g"] or 0.0, row["is_best_for_its_film"])
        for row in rows
        if row["film_g"] is not None
    ]
    best = rows[0] if rows else None
    words = "No variant could be tested."
    if best is not None and best["largest_passed_g"] is None:
        words = "No variant passes even the first level."
    elif best is not None:
        film = "" if best["film_g"] is None else f" with {best['film_g']:.0f} g of film"
        words = f"Best: {best['name']}. It passes {best['largest_passed_g']:g} g{film}."
    header = (
        '<header class="pass"><p class="kicker">Packing variants rated to EUMOS 40509 by simulation</p>\n'
        f"<h1>{safe_text(entry['scene'])}</h1>\n<p>{safe_text(words)}</p>"
        f'<p class="small">{len(rows)} variants tested, {len(entry["refused"])} refused. Varied: '
        f"{safe_text('; '.join(entry['varied']) or 'nothing')}.</p></header>"
    )
    label = "Largest level passed against the mass of film, a point a variant, numbered by rank."
    figure = (
        f"<figure>{rating_figure(points, CERTIFIED_G, safe_text(label))}<figcaption>Numbers are ranks. Filled and on"
        " the line: no other variant passes as much with less film.</figcaption></figure>"
    )
    parts = [
        header,
        _section("Level against film", figure) if points else "",
        _section("Variants in order", _ranking(rows)),
        _section("Not tested", _refused(entry["refused"])) if entry["refused"] else "",
        _section("What this is", _small(
            "Results of a simulation: verification, not validation. Order: the largest level that passed first, the"
            " least film second. Film: its layers times the way around the load, as laid and with what is folded over"
            " the top. A level passes only if every rule keeps its limit by more than the error estimate."
        )),
    ]  # fmt: skip
    return _page(f"{entry['scene']}: variants", parts)


def facts(pairs: Sequence[tuple[str, str]]) -> str:
    """Names and values as a list."""
    shown = "".join(
        f"<div><dt>{safe_text(name)}</dt><dd>{safe_text(value)}</dd></div>\n" for name, value in pairs
    )
    return f"<dl>{shown}</dl>"


def _label(entry: Report) -> list[tuple[str, str]]:
    k, mass_kg = entry["largest_passed_g"], entry["load"]["mass_kg"]
    force = "none was passed"
    if k is not None:
        force = f"{k:g} g, {k * mass_kg * GRAVITY:.0f} N on the load of {mass_kg:g} kg"
    return [
        ("Date", entry["date"] or "not given"),
        ("Institute", entry["institute"] or "not given"),
        ("Producer", entry["producer"] or "not given"),
        ("Maximum inertial force", force),
    ]


def _load(entry: Report) -> list[tuple[str, str]]:
    load, profile = entry["load"], entry["profile"]
    sheets = f" and {load['interlayers']} interlayer sheets" if load["interlayers"] else ""
    sizes = "; ".join(" × ".join(f"{edge}" for edge in size) for size in load["package_sizes_mm"])
    pallet = "none: the load stands on the sled"
    if load["pallet"] is not None:
        box = load["pallet"]
        size = " × ".join(f"{1000.0 * edge:.0f}" for edge in box["size_m"])
        kind = "EPAL 1, " if box["kind"] == "EPAL 1" else ""
        fixed = "fixed to the sled" if box["fixed"] else "free on the sled"
        pallet = f"{kind}{size} mm, {box['mass_kg']:g} kg, {fixed}"
    film = "not known: force fields stand for it"
    if load["film_kg"] is not None:
        film = f"{1000.0 * load['film_kg']:.1f} g" if load["film_kg"] else "none"
    friction = ", ".join(f"{pair} {value:g}" for pair, value in list(load["friction"].items())[:8])
    source = load["source"]
    origin = "listed in the scene" if source is None else f"{source['file']} ({source['format']})"
    held = load["wrap"]
    if load["force_fields"] is not None:
        held = f"perimeter force fields, T = {load['force_fields']['tension']:g}; film: {held}"
    return [
        ("Packages", f"{load['packages']}{sheets}"),
        ("Sizes [mm]", sizes or "none"),
        ("Mass", f"{load['mass_kg']:g} kg"),
        ("Height", "not judged" if load["height_m"] is None else f"{load['height_m']:.3f} m above the sled"),
        ("Pallet", pallet),
        ("Wrap", held),
        ("Film", film),
        ("Friction", friction or "no pair"),
        ("Load taken from", origin),
        ("Sled", f"EUMOS profile: {profile['plateau_s']:g} s at the level, reached in"
                 f" {1000.0 * profile['rise_s']:g} ms, then braked with {profile['deceleration_g']:g} g;"
                 f" direction {profile['direction']}"),
    ]  # fmt: skip


def _before_and_after(entry: Report, shown: tuple[Report, Scene] | None, pictures: Pair | None) -> str:
    if shown is None:
        return ""
    report, scene = shown
    title = f"Before and after, at {scene.sled.level_g:g} g" if hasattr(scene.sled, "level_g") else ""
    if pictures is not None:
        figures = "".join(
            f'<figure class="picture"><img alt="{words}" src="data:image/jpeg;base64,'
            f'{base64.b64encode(jpeg).decode()}"><figcaption>{words}, as the camera of the twin sees it</figcaption>'
            "</figure>"
            for words, jpeg in zip(("Before the test", "After the test"), pictures, strict=True)
        )
        return _section(title, figures)
    if not {"settled", "end"} <= {moment["name"] for moment in report["moments"]}:
        return ""
    label = "The load in space, before the test and after it."
    return _section(
        title,
        f"<figure>{space_figure(report, scene, safe_text(label))}<figcaption>Drawn from the simulated places, seen from"
        " the front right; the travel is to the lower right. Darkest: in its place; brightest: displaced by the limit"
        " for the elastic peak. Film is not drawn."
        "</figcaption></figure>",
    )


def _levels(entry: Report) -> str:
    heads = ("level", "verdict", "closest rule", "worst [mm]", "limit [mm]", "of the limit", "error [mm]",
             "engine and step", "simulated [s]", "run time [s]")  # fmt: skip
    rows = []
    for level in entry["levels"]:
        rule = next((rule for rule in level["rules"] if rule["rule"] == level["closest_rule"]), None)
        setting = (
            f"{level['engine']}, {1000.0 * level['time_step_s']:.4g} ms × {level['iterations']}"
            + (f", after {', '.join(level['refinements'])}" if level["refinements"] else "")
        )  # fmt: skip
        rows.append([
            f'<th scope="row">{level["level_g"]:g} g</th>',
            f"<td>{_state(level['verdict'])}</td>",
            f"<td>{safe_text('–' if rule is None else _words(rule))}</td>",
            *(f"<td class=n>{figure_text(rule[key] if rule is not None else None, 1)}</td>"
              for key in ("worst_mm", "limit_mm")),
            f"<td class=u>{_bar(level['verdict'], level['share_of_limit'])}</td>",
            f"<td class=n>{figure_text(level['error_estimate_mm'], 2)}</td>",
            f"<td>{safe_text(setting)}</td>",
            f"<td class=n>{level['simulated_s']:.2f}</td><td class=n>{level['wall_s']:.2f}</td>",
        ])  # fmt: skip
    return _table(heads, ["".join(row) for row in rows], numeric=(3, 4, 6, 8, 9))


def _margins(entry: Report) -> str:
    titles: dict[str, str] = {}
    for level in entry["levels"]:
        titles |= {rule["rule"]: _words(rule) for rule in level["rules"] if rule["state"] != "off"}
    rows = []
    for level in entry["levels"]:
        found = {rule["rule"]: rule for rule in level["rules"]}
        cells = "".join(f"<td class=n>{_margin(found.get(name))}</td>" for name in titles)
        rows.append(f'<th scope="row">{level["level_g"]:g} g</th>{cells}')
    return _table(("level", *titles.values()), rows, numeric=range(1, 1 + len(titles)))


def _margin(rule: Mapping[str, Any] | None) -> str:
    if rule is None:
        return "–"
    if rule["margin_mm"] is None:
        return _state(rule["state"])
    error = "" if rule["error_mm"] is None else f" ± {figure_text(rule['error_mm'], 2)}"
    text = f"{figure_text(rule['margin_mm'], 1)}{error}"
    return text if rule["state"] == "pass" else f"{text} {_state(rule['state'])}"


def _ranking(rows: Sequence[Mapping[str, Any]]) -> str:
    heads = (
        "rank",
        "variant",
        "passes",
        "film [g]",
        "film [g/kg load]",
        "load",
        "of the limit there",
        "stopped at",
    )
    cells = []
    for row in rows:
        load, stopped = row["load"], row["stopped"]
        top = next((level for level in row["levels"] if level["level_g"] == row["largest_passed_g"]), None)
        ended = "nothing up to the highest level"
        if stopped is not None:
            ended = f"{stopped['level_g']:g} g {stopped['verdict']}{_by(row['levels'], stopped['level_g'])}"
        passes = "none" if row["largest_passed_g"] is None else f"{row['largest_passed_g']:g} g"
        cells.append(
            f"<td class=n>{row['rank']}</td>"
            f'<th scope="row">{safe_text(row["name"])}{" ●" if row["is_best_for_its_film"] else ""}</th>'
            f"<td class=n><strong>{passes}</strong></td><td class=n>{figure_text(row['film_g'], 1)}</td>"
            f"<td class=n>{figure_text(row['film_g_per_kg_load'], 2)}</td>"
            f"<td>{load['packages']} packages, {load['mass_kg']:g} kg</td>"
            f"<td class=u>{_bar('pass', top['share_of_limit'] if top is not None else None)}</td>"
            f"<td>{safe_text(ended)}</td>"
        )
    return _table(heads, cells, numeric=(0, 2, 3, 4))


def _by(levels: Sequence[Mapping[str, Any]], level_g: float) -> str:
    """The rule that decided a level, and how much of its limit was used."""
    level = next(level for level in levels if level["level_g"] == level_g)
    if level["ended_by"] is not None:
        return f": {level['ended_by']}"
    if level["closest_rule"] is None:
        return ""
    share = level["share_of_limit"]
    return f": {level['closest_rule'].replace('_', ' ')}" + (
        "" if share is None else f", {100.0 * share:.0f} %"
    )


def _refused(rows: Sequence[Mapping[str, Any]]) -> str:
    cells = [f'<th scope="row">{safe_text(row["name"])}</th><td>{safe_text(row["why"])}</td>' for row in rows]
    return _table(("variant", "why"), cells)


def _provenance(entry: Report) -> list[tuple[str, str]]:
    plan = entry["plan"]
    finer = "" if plan["step_g"] >= 0.1 else f", the last gap halved down to {plan['step_g']:g} g"
    found = [
        ("Levels", f"from {plan['from_g']:g} g by 0.1 g up to {plan['to_g']:g} g{finer}"),
        ("Scene, SHA-256", entry["scene_sha256"]),
        ("Result, SHA-256", f"{entry['result_sha256']} (of all but the run times)"),
        ("Versions", ", ".join(f"{name} {number}" for name, number in entry["versions"].items())),
    ]
    source = entry["load"]["source"]
    if source is not None:
        found.insert(2, (f"{source['file']}, SHA-256", source["sha256"]))
    unmet = sorted({line for level in entry["levels"] for line in level["unmet_friction"]})
    return found + [("Friction not met", line) for line in unmet]


def _words(rule: Mapping[str, Any]) -> str:
    return str(rule["rule"]).replace("_", " ")


def _state(state: str) -> str:
    return f'<span class="state {state}"><span aria-hidden="true">{_SYMBOLS[state]}</span> {state}</span>'


def _bar(state: str, share: float | None) -> str:
    if share is None:
        return "–"
    width = 100.0 * min(share, 1.0)
    return f'<span class="bar {state}"><span style="width:{width:.0f}%"></span></span> {100.0 * share:.0f} %'


def _first_upper(text: str) -> str:
    return safe_text(text[:1].upper() + text[1:])


def _bullets(lines: Sequence[str]) -> str:
    return f"<ul>{''.join(f'<li>{safe_text(line)}</li>' for line in lines)}</ul>"


def _small(words: str) -> str:
    return f'<p class="small">{safe_text(words)}</p>'


def _section(title: str, content: str) -> str:
    return f"<section><h2>{safe_text(title)}</h2>\n{content}</section>"


def _table(heads: Sequence[str], rows: Sequence[str], *, numeric: Sequence[int] = ()) -> str:
    cells = "".join(
        f'<th scope="col"{" class=n" if place in numeric else ""}>{safe_text(head)}</th>'
        for place, head in enumerate(heads)
    )
    body = "\n".join(f"<tr>{row}</tr>" for row in rows)
    return f'<div class="scroll"><table><thead><tr>{cells}</tr></thead>\n<tbody>{body}</tbody></table></div>'


def _page(title: str, parts: Sequence[str]) -> str:
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{_CSP}">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        '<meta name="color-scheme" content="light dark">\n'
        f"<title>{safe_text(title)}</title>\n<style>{STYLE}</style>\n</head>\n<body>\n<main>\n"
        + "\n".join(part for part in parts if part)
        + "\n</main>\n</body>\n</html>\n"
    )
