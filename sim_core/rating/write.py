"""Writes a rating into its folder: the certificate of one scene, or the order of many variants."""

from collections.abc import Sequence
from pathlib import Path

from config.scene import Scene
from sim_core.rating.certificate import Label, certificate
from sim_core.rating.climb import Climbed
from sim_core.rating.levels import LevelPlan, at_level, level_path
from sim_core.rating.page import certificate_html, rating_html
from sim_core.rating.pictures import before_and_after
from sim_core.rating.ranking import ranked, ranking_csv, ranking_entry
from sim_core.rating.variants import Variant
from sim_core.report import Report, report_json

LEVELS = "levels"
"""The folder of the levels' results, inside that of the rating."""


def write_certificate(out: Path, climbed: Climbed, plan: LevelPlan, label: Label) -> Report:
    """Writes ``certificate.json`` and ``certificate.html``, and returns the former as a dictionary.

    Args:
        out: the rating's folder.
        climbed: a finished climb.
        plan: its levels.
        label: date and names.

    Raises:
        RefusedInput: the test could not be run, or its camera cannot see what it should.
    """
    if climbed.refused is not None:
        raise climbed.refused
    entry = certificate(climbed, plan, label)
    shown = _shown(climbed)
    pictures = None
    if shown is not None:
        pictures = before_and_after(shown[1], shown[0], level_path(out / LEVELS, shown[1]))
    _write(out / "certificate.json", report_json(entry) + "\n")
    _write(out / "certificate.html", certificate_html(entry, shown=shown, pictures=pictures))
    return entry


def write_rating(
    out: Path,
    scene: str,
    variants: Sequence[Variant],
    climbs: Sequence[Climbed],
    plan: LevelPlan,
    varied: Sequence[str],
) -> Report:
    """Writes ``rating.json``, ``rating.csv`` and ``rating.html``, and returns the first as a dictionary.

    Args:
        out: the rating's folder.
        scene: the base scene's name.
        variants: as planned.
        climbs: of those that have a scene, in their order.
        plan: the levels.
        varied: what was varied, as it was asked for.
    """
    rows, refused = ranked(variants, climbs)
    entry = ranking_entry(scene, rows, refused, plan, varied)
    _write(out / "rating.json", report_json(entry) + "\n")
    _write(out / "rating.csv", ranking_csv(entry))
    _write(out / "rating.html", rating_html(entry))
    return entry


def _shown(climbed: Climbed) -> tuple[Report, Scene] | None:
    """The level to show: the largest that passed, or else the first of all."""
    level = climbed.largest_g if climbed.largest_g is not None else next(iter(climbed.levels), None)
    if level is None or not climbed.scene.packages:
        return None
    return climbed.levels[level], at_level(climbed.scene, level)


def _write(path: Path, text: str) -> None:
    scratch = path.with_name(path.name + ".part")
    scratch.write_text(text, encoding="utf-8")
    scratch.replace(path)
