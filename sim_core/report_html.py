"""The report as one HTML page that stands on its own: read at a glance, printed for a customer's file."""

import math
from pathlib import Path
from typing import Any

from config.scene import EumosSled, Scene, StandardPallet, direction_vector
from config.scene_file import friction_table
from sim_core.frames import GRAVITY
from sim_core.report_camera import ReportPictures, camera_section
from sim_core.report_figures import Report, time_figure, travel_direction
from sim_core.report_film import film_figure, film_map
from sim_core.report_style import STYLE
from sim_core.report_views import posed_loads, views_figure
from sim_core.report_words import (
    corner_words,
    figure_text,
    film_facts,
    film_sentences,
    limit_share,
    rule_figures,
    safe_text,
    tore_film,
    verdict_sentence,
    wrap_words,
)

SHOWN_PACKAGES = 10
_VERDICTS = {
    "pass": ("✓", "PASS"),
    "fail": ("✕", "FAIL"),
    "unresolved": ("?", "UNRESOLVED"),
    "off": ("–", "OFF"),
}
_RULE_NUMBERS = {"permanent": "i", "permanent_on_pallet": "ii", "elastic": "iii", "damage": "iv"}
_MODEL_LIMITS = (
    "Packages are rigid boxes: they slide, tilt and fall, but are not crushed, bent or torn.",
    "One Coulomb friction for each pair of surfaces, the same at rest and in motion, whatever the speed.",
    "Displacement is that of a package's corner relative to the sled, from the settled load on.",
)
_BARE_LIMITS = (
    "“Damage” means a package that toppled by more than 45° or fell from its place; crushed edges and leaking"
    " contents are for an inspection of the real load.",
)
_WRAPPED_LIMITS = (
    "“Damage” means a package that toppled by more than 45° or fell from its place, or film that tore; crushed"
    " edges and leaking contents are for an inspection of the real load.",
    "The film has no mass, clings to nothing, rubs only on the edges that bent it when it was laid, and is not"
    " folded over the top. It tears an element of its mesh at a time, so a hole is as fine as the mesh.",
)


def write_report_html(
    report: Report, scene: Scene, path: Path, *, pictures: ReportPictures | None = None
) -> None:
    """Writes the report as an HTML file, whole or not at all.

    Args:
        report: as made by ``sim_core.report.full_report`` or ``judgement``.
        scene: its resolved scene.
        path: file to write; one that exists is replaced.
        pictures: what the scene's camera saw, if anything.
    """
    content = report_html(report, scene, pictures=pictures).encode()
    scratch = path.with_name(path.name + ".part")
    try:
        scratch.write_bytes(content)
        scratch.replace(path)
    finally:
        scratch.unlink(missing_ok=True)


def report_html(report: Report, scene: Scene, *, pictures: ReportPictures | None = None) -> str:
    """The report as HTML: no script, nothing fetched, the same text for the same input.

    Args:
        report: as made by ``sim_core.report.full_report`` or ``judgement``.
        scene: its resolved scene.
        pictures: what the scene's camera saw, if anything.
    """
    title = f"{report['name']}: {report['verdict']}"
    parts = [
        _headline(report, scene),
        _test_data(report, scene),
        _rules(report, scene),
        camera_section(report, scene, pictures),
        _views(report, scene),
        _film(report, scene),
        _over_time(report, scene),
        _packages(report),
        _numerics(report),
        _integrity(report),
        _provenance(report, scene),
    ]
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta http-equiv="Content-Security-Policy"'
        " content=\"default-src 'none'; style-src 'unsafe-inline'; img-src data:; media-src data:\">\n"
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        '<meta name="color-scheme" content="light dark">\n'
        f"<title>{safe_text(title)}</title>\n<style>{STYLE}</style>\n</head>\n<body>\n<main>\n"
        + "\n".join(part for part in parts if part)
        + "\n</main>\n</body>\n</html>\n"
    )


def _headline(report: Report, scene: Scene) -> str:
    symbol, word = _VERDICTS[report["verdict"]]
    notices = []
    numerics = report.get("numerics", {})
    if numerics.get("ended_by") is not None:
        notices.append(
            "A monitor ended the test early: rules, figures and packages show the load as it was then."
        )
    elif numerics and not numerics["at_rest"] and report["packages"]:
        notices.append("The load had not come to rest when the test ended: “permanent” means at that moment.")
    if numerics.get("within_tolerance") is False:
        notices.append(
            f"The error estimate of {figure_text(numerics['error_estimate_mm'], 2)} mm is above the"
            f" tolerance of {numerics['tolerance_mm']:g} mm that the scene asks for."
        )
    if numerics.get("unmet_friction"):
        notices.append(
            "The engine could not represent every friction that was asked for: see “How sure is it”."
        )
    description = f'<p class="description">{safe_text(scene.description)}</p>' if scene.description else ""
    return (
        f'<header class="{report["verdict"]}"><p class="kicker">Load unit test to EUMOS 40509, simulated on'
        f" the digital twin of a sled bench</p>\n<h1>{safe_text(report['name'])}</h1>\n{description}"
        f'<div class="verdict"><p class="badge"><span aria-hidden="true">{symbol}</span> {word}</p>'
        f"<p>{safe_text(verdict_sentence(report, scene))}</p></div>\n"
        + "".join(f'<p class="notice"><strong>Note.</strong> {safe_text(notice)}</p>\n' for notice in notices)
        + "</header>"
    )


def _test_data(report: Report, scene: Scene) -> str:
    sled, load, recorded = scene.sled, report["load"], report["sled"]
    x, y = travel_direction(report, scene)
    named = {direction_vector(name): name.replace("-", "−") for name in ("+x", "-x", "+y", "-y")}
    direction = named.get((x, y)) or f"{math.degrees(math.atan2(y, x)):.0f}° from +x towards +y"
    peak_g = recorded["peak_mps2"] / GRAVITY
    if isinstance(sled, EumosSled):
        level, plateau = f"{sled.level_g:g} g", f"{sled.plateau_s:g} s"
        profile = f"EUMOS: rise in {1000.0 * sled.rise_s:g} ms, then braked with {sled.deceleration_g:g} g"
    else:
        level, plateau = f"{peak_g:.2f} g peak", "none: no EUMOS profile"
        profile = "given as a table" if sled.profile == "table" else "taken from a recording"
    packages = f"{load['package_count']}"
    if load["interlayer_count"]:
        packages += f" and {load['interlayer_count']} interlayer sheets"
    height = f"{report['height_m']:.3f} m" if report["height_m"] is not None else "not judged"
    box = scene.pallet_box
    pallet = "none: the load stands on the sled"
    if box is not None:
        kind = "EPAL 1, " if isinstance(scene.pallet, StandardPallet) else ""
        size = " × ".join(f"{1000.0 * edge:.0f}" for edge in box.size_m)
        pallet = (
            f"{kind}{size} mm, {box.mass_kg:g} kg, {'fixed to the sled' if box.fixed else 'free on the sled'}"
        )
    source = load["source"]
    origin = "listed package by package in the scene"
    if source is not None:
        origin = f"{source['file']} ({source['format']}, pallet {source['pallet_number']})"
    friction = [
        f"{' on '.join((sorted(pair) * 2)[:2])} {value:g}"
        for pair, value in sorted(friction_table(scene).items(), key=lambda entry: sorted(entry[0]))
    ]
    shown = ", ".join(friction[:8]) + (f" and {len(friction) - 8} more pairs" if len(friction) > 8 else "")
    fields = scene.force_fields
    wrap = wrap_words(scene)
    if fields is not None:
        spread, distance = f"σ = {fields.height_spread_m:g} m", f"d = {fields.distance_m:g} m"
        film = "" if wrap == "none" else f"; {wrap}"
        wrap = f"perimeter force fields, T = {fields.tension:g}, {spread}, {distance}{film}"
    facts = [
        ("Level", level), ("Plateau", plateau), ("Direction of travel", direction), ("Profile", profile),
        ("Travel of the sled", f"{recorded['travel_m']:.2f} m in {recorded['stop_s']:.2f} s"),
        ("Mass of the load", f"{load['mass_kg']:.1f} kg"), ("Packages", packages), ("Total height", height),
        ("Pallet", pallet), ("Wrap", wrap), ("Friction", shown or "no pair"), ("Load taken from", origin),
    ]  # fmt: skip
    return f"<section><h2>What was tested</h2>\n{_facts(facts)}</section>"


def _rules(report: Report, scene: Scene) -> str:
    if not report["rules"]:
        words = "No rule was judged: the test ended before its first frame."
        return f"<section><h2>The rules</h2><p>{words}</p></section>"
    rows, torn = [], any(tore_film(report, rule) for rule in report["rules"])
    for rule in report["rules"]:
        worst, limit, margin = rule_figures(rule)
        share = limit_share(rule)
        error = (
            f" ± {figure_text(rule['error_mm'], 2)}"
            if rule["error_mm"] is not None and share is not None
            else ""
        )
        bar = ""
        if share is not None:
            bar = (
                f'<span class="bar {safe_text(rule["state"])}">'
                f'<span style="width:{100.0 * min(share, 1.0):.0f}%"></span></span> {100.0 * share:.0f} %'
            )
        number = _RULE_NUMBERS.get(rule["rule"])
        title = f"({number}) {rule['title']}" if number else rule["title"]
        package = rule["package"] if rule["package"] is not None else "–"
        if rule["rule"] == "damage":
            limit, worst = "none", "none" if rule["state"] == "pass" else "found"
        corner = corner_words(report, scene, rule) if rule["corner"] is not None else "–"
        rows.append(
            f'<tr><td>{_state(rule["state"])}</td><th scope="row">{safe_text(title)}</th>'
            f"<td class=n>{limit}</td><td class=n>{worst}{error}</td><td class=n>{margin}</td>"
            f"<td class=u>{bar or '–'}</td><td>{safe_text(package)}</td><td class=c>{safe_text(corner)}</td>"
            f"<td class=n>{figure_text(rule['time_s'], 2)}</td>"
            f"<td class=n>{figure_text(rule['height_m'], 3)}</td></tr>"
        )
    tear = " That of torn film is where it first tore, as laid." if torn else ""
    heads = (
        "state",
        "rule",
        "limit [mm]",
        "worst [mm]",
        "margin [mm]",
        "of the limit",
        "package",
        "corner",
        "time [s]",
        "height [m]",
    )
    return (
        "<section class=rules><h2>The rules</h2>\n"
        + _table(heads, rows, numeric=(2, 3, 4, 8, 9))
        + '<p class="small">Front is towards the travel, left and right as seen from behind. Worst values'
        " stand with their error estimate where one was made. Height is"
        f" that of the corner above the sled when settled.{tear}</p></section>"
    )


def _views(report: Report, scene: Scene) -> str:
    loads = posed_loads(report, scene)
    if not {"settled", "worst", "end"} <= set(loads):
        return ""
    names = ["the pallet"] + [f"package {package.id}" for package in scene.packages]
    said = []
    for moment, words in (("worst", "At the worst moment"), ("end", "At the end")):
        row, corner = loads[moment].worst_corner()
        moved = f"{loads[moment].moved_mm[row, corner]:.1f} mm"
        said.append(
            f"{words}, {loads[moment].time_s:.2f} s after the first frame, {names[row]} is farthest out:"
            f" {moved}."
        )
    shown = "Load unit from the side and from above at the worst moment and at the end."
    drawing = views_figure(report, scene, safe_text(f"{shown} {' '.join(said)}"))
    film = "" if scene.film is None else " The film is not drawn here."
    outside = ""
    if drawing.outside_count:
        count = drawing.outside_count
        outside = f" {count} package{'s' if count > 1 else ''} ended outside of the picture."
    return (
        '<section class="views"><h2>Where the packages went</h2>\n<figure>'
        + drawing.svg
        + f"<figcaption>{safe_text(' '.join(said))} {safe_text(outside)} The figure on a package is the"
        " displacement of its farthest corner [mm]; brighter is farther. Thin dashes: the settled load. Ring"
        " and cross: the farthest corner, with its way from the settled place. Seen with the travel to the"
        f" right.{film}</figcaption></figure></section>"
    )


def _film(report: Report, scene: Scene) -> str:
    film = film_map(report)
    if film is None or scene.film is None:
        return ""
    sentences = film_sentences(report, scene, film)
    label = f"The film cut open and laid flat, coloured by its largest strain. {sentences}"
    holes = " Hatched: torn, with a triangle where it tore first." if film.first_torn is not None else ""
    return (
        f'<section class="film"><h2>The film</h2>\n<p>{safe_text(sentences)}</p>\n<figure>'
        + film_figure(report, scene, film, safe_text(label))
        + "<figcaption>The film cut open along its first column and laid flat, as it was laid, seen from outside."
        " Colour: each element's largest strain in any direction, from the film without tension. Ring and cross:"
        f" the largest of all.{holes} White lines: the packages and the pallet behind it.</figcaption></figure>\n"
        + _facts(film_facts(report, scene, film))
        + "</section>"
    )


def _over_time(report: Report, scene: Scene) -> str:
    sled = report["sled"]
    label = (
        "Largest displacement by height band, sled acceleration and sled velocity against time. The sled"
        f" reaches {sled['peak_mps2'] / GRAVITY:.2f} g and its profile ends after {sled['stop_s']:.2f} s."
    )
    series = report["series"]
    if series is not None and series["bands"]:
        edges = series["band_edges_m"]
        peaks = [
            f"{edges[band]:.2f} to {edges[band + 1]:.2f} m {max(row):.1f} mm"
            for band, row in zip(series["bands"], series["displacement_mm"], strict=True)
        ]
        label += f" Peaks by height: {', '.join(peaks)}."
    return (
        f"<section><h2>How it went</h2>\n<figure>{time_figure(report, scene, safe_text(label))}"
        "<figcaption>Above: of every height band, the corner that is farthest out at each moment. The"
        " elastic limit holds for the peak, the permanent limit for what remains once the load rests. Below:"
        " what the sled did, along the travel.</figcaption></figure></section>"
    )


def _packages(report: Report) -> str:
    ordered = sorted(report["packages"], key=lambda package: -package["peak_mm"])
    if not ordered:
        return "<section><h2>Packages</h2><p>There is no package to report on.</p></section>"
    heads = ("package", "peak [mm]", "permanent [mm]", "Δx [mm]", "Δy [mm]", "Δz [mm]", "tilt [°]")
    rows = [
        f'<tr><th scope="row">{safe_text(package["id"])}</th>'
        + "".join(
            f"<td class=n>{figure_text(value, 1)}</td>"
            for value in (package["peak_mm"], package["permanent_mm"], *package["final_displacement_mm"])
        )
        + f"<td class=n>{figure_text(package['final_tilt_deg'], 2)}</td></tr>"
        for package in ordered
    ]
    numeric = range(1, 7)
    rest = ""
    if len(rows) > SHOWN_PACKAGES:
        rest = (
            f"<details><summary>The other {len(rows) - SHOWN_PACKAGES} packages</summary>\n"
            + _table(heads, rows[SHOWN_PACKAGES:], numeric=numeric)
            + "</details>"
        )
    heading = f"The {SHOWN_PACKAGES} packages that moved most" if len(rows) > SHOWN_PACKAGES else "Packages"
    return (
        f"<section><h2>{heading}</h2>\n{_table(heads, rows[:SHOWN_PACKAGES], numeric=numeric)}{rest}"
        '<p class="small">Peak: farthest corner until the end. Permanent: farthest corner at the end. Δ:'
        " displacement of the centre at the end in the sled's axes, x forward, y left, z up.</p></section>"
    )


def _numerics(report: Report) -> str:
    found = report.get("numerics")
    if found is None:
        return ""
    tolerance_mm = found["tolerance_mm"]
    within = {True: "kept", False: "not kept", None: "not to be told without an error estimate"}
    tolerance = (
        "none" if tolerance_mm is None else f"{tolerance_mm:g} mm: {within[found['within_tolerance']]}"
    )
    if found["refinements"]:
        tolerance += f", after {', '.join(found['refinements'])}"
    estimate = found["error_estimate_mm"]
    error = f"{figure_text(estimate, 2)} mm, " if estimate is not None else ""
    factor = found["real_time_factor"]
    pace = f", {factor:.2f} times real time" if factor is not None else ""
    step = f"{1000.0 * found['time_step_s']:.4g} ms with {found['iterations']} solver iterations"
    rest = "rested" if found["at_rest"] else "did not rest yet"
    facts = [
        ("Error estimate", f"{error}{found['error_estimate_from']}"),
        ("Tolerance asked for", tolerance),
        ("Engine and step", found["setting_chosen"]),
        ("Engine", f"{found['engine']}, run as “{found['mode']}”"),
        ("Time step", f"{step}, {found['steps']} steps in all"),
        ("Deepest penetration", f"{figure_text(found['max_penetration_mm'], 3)} mm between two bodies"),
        ("Contacts", f"{found['max_contacts']} contact points at most"),
        ("Solver residual", f"{found['solver_residual']:.3g} at most, in the engine's own measure"),
        ("Settling", f"{found['settle_s']:.3f} s until the load stood still, before the test"),
        ("Test", f"{found['simulated_s']:.2f} s simulated; at the end the load {rest}"),
        ("Computing time", f"{found['wall_time_s']:.2f} s{pace}"),
        ("Unmet friction", "; ".join(found["unmet_friction"]) or "none: every pair is as asked"),
        ("Ended by a monitor", found["ended_by"] or "no"),
    ]  # fmt: skip
    rows = []
    for monitor in found["monitors"]:
        unit, _, remark = monitor["unit"].partition(", ")
        remark = f" ({remark})" if remark else ""
        rows.append(
            f'<tr><th scope="row">{safe_text(monitor["monitor"])}</th>'
            f"<td class=n>{monitor['worst']:.3g} {safe_text(unit)}</td>"
            f"<td>{monitor['limit']:.3g} {safe_text(unit + remark)}</td></tr>"
        )
    settings = [(str(name), str(value)) for name, value in found["settings"].items()]
    return (
        f"<section><h2>How sure is it</h2>\n{_facts(facts)}"
        + _table(("monitor", "worst seen", "ends the test at"), rows, numeric=(1,))
        + f"<details><summary>The engine's settings, as read back</summary>{_facts(settings)}</details>"
        + "</section>"
    )


def _integrity(report: Report) -> str:
    if "integrity" not in report:
        return ""
    rows = [
        f'<tr><td>{safe_text(finding["severity"])}</td><th scope="row">{safe_text(finding["check"])}</th>'
        + "".join(f"<td>{safe_text(finding[key])}</td>" for key in ("subject", "value", "limit"))
        + "</tr>"
        for finding in report["integrity"]
    ]
    body = _table(("severity", "check", "package", "found", "limit or consequence"), rows)
    if not rows:
        body = "<p>The check of the load before the test found nothing to remark on.</p>"
    elif len(rows) > SHOWN_PACKAGES:
        body = f"<details><summary>{len(rows)} findings</summary>{body}</details>"
    return f"<section><h2>Check of the load before the test</h2>\n{body}</section>"


def _provenance(report: Report, scene: Scene) -> str:
    facts = [("Scene, SHA-256", report["scene_sha256"])]
    source = report["load"]["source"]
    if source is not None:
        facts.append((f"{source['file']}, SHA-256", source["sha256"]))
        facts += [("Note of the reader", note) for note in source["notes"]]
    versions = report.get("versions", {})
    if versions:
        facts.append(("Versions", ", ".join(f"{name} {number}" for name, number in versions.items())))
    more = _BARE_LIMITS if scene.film is None else _WRAPPED_LIMITS
    limits = "".join(f"<li>{safe_text(line)}</li>" for line in _MODEL_LIMITS + more)
    return (
        f"<section><h2>What the model does not show</h2><ul>{limits}</ul></section>\n"
        f'<footer><h2>Where it comes from</h2>\n{_facts(facts)}<p class="small">Result of a simulation, not a'
        " laboratory's certificate.</p></footer>"
    )


def _state(state: str) -> str:
    symbol, word = _VERDICTS[state]
    return f'<span class="state {state}"><span aria-hidden="true">{symbol}</span> {word.lower()}</span>'


def _facts(facts: list[tuple[str, str]]) -> str:
    return (
        "<dl>"
        + "".join(
            f"<div><dt>{safe_text(name)}</dt><dd>{safe_text(value)}</dd></div>\n" for name, value in facts
        )
        + "</dl>"
    )


def _table(heads: tuple[str, ...], rows: list[str], *, numeric: Any = ()) -> str:
    cells = "".join(
        f'<th scope="col"{" class=n" if i in numeric else ""}>{head}</th>' for i, head in enumerate(heads)
    )
    body = "\n".join(rows)
    return f'<div class="scroll"><table><thead><tr>{cells}</tr></thead>\n<tbody>{body}</tbody></table></div>'
