"""The film in the report: the unrolled drawing, what page and command line say of it, and that it is the truth."""

import json
import re
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

from config.scene import Scene
from config.scene_file import validate_scene
from config.wrap import film_span
from ros_nodes.output import film_lines, show_rules
from sim_core.accuracy.cases import cartons_scene
from sim_core.frames import FilmFrame, PoseFrame
from sim_core.geometry import yaw_quaternion
from sim_core.judge import EumosJudge
from sim_core.report import Report, full_report, judgement
from sim_core.report_film import boxes_behind, film_figure, film_map, percent
from sim_core.report_html import report_html
from sim_core.report_words import verdict_sentence
from sim_core.wrap.fit import fit_film, unrolled
from tests.sim_core.test_report_html import PageCheck, judged, physics, settled_poses

STRETCH = {"material": "stretch_film_20", "turns": 6}
PAPER = {"material": "kraft_80", "turns": 1}


def wrapped(wrap: dict[str, Any] | None, **parts: Any) -> Scene:
    """Forty cartons in columns on an EPAL pallet, 1.194 m deep, 0.794 m wide; the film is wound around 1.2 x 0.8 m."""
    raw = {**cartons_scene(5), "sled": {"profile": "eumos", "level_g": 0.5}, **parts}
    return validate_scene(raw if wrap is None else {**raw, "wrap": wrap})


def report_of(
    scene: Scene,
    *,
    strains: dict[int, float] | None = None,
    torn_s: dict[int, float] | None = None,
    turned_deg: float = 0.0,
    is_full: bool = True,
) -> Report:
    """A report on the film as a machine would have laid it, its elements strained and torn as said, else by 2 %."""
    positions, orientations = settled_poses(scene)
    turn = np.radians(turned_deg)
    spin = np.array([[np.cos(turn), -np.sin(turn), 0.0], [np.sin(turn), np.cos(turn), 0.0], [0.0, 0.0, 1.0]])
    positions = positions @ spin.T
    orientations = np.tile(yaw_quaternion(turned_deg), (len(positions), 1))
    assert scene.wrap is not None
    top = float(positions[:, 2].max()) + 0.5 * scene.packages[-1].size_m[2]
    mesh = fit_film(
        scene, positions, orientations, span_m=film_span(scene.wrap, deck_m=0.144, top_m=top), spacing_m=0.1
    )
    peaks, torn = np.full(len(mesh.triangles), 0.02), np.full(len(mesh.triangles), -1.0)
    for values, given in ((peaks, strains), (torn, torn_s)):
        for row, value in (given or {}).items():
            values[row] = value
    arrays = (
        mesh.positions[mesh.triangles],
        unrolled(mesh),
        np.stack([peaks] * 3, axis=1),
        peaks,
        peaks,
        torn,
    )
    frame = FilmFrame(0, 0, *(array.astype(np.float32) for array in arrays))
    judge = EumosJudge(scene)
    judge.add(PoseFrame(0, 0, positions, orientations))
    judge.add_film(frame)
    first = min((row for row in torn_s or {}), key=lambda row: (torn_s or {})[row], default=None)
    middles = frame.corners.mean(axis=1).tolist()
    film = {
        "nodes": len(mesh.positions), "elements": len(peaks), "peak_strain": float(peaks.max()),
        "peak_position_m": tuple(middles[int(peaks.argmax())]), "peak_time_s": 0.65, "start_force_npm": 540.0,
        "peak_force_npm": 600.0, "torn": len(torn_s or {}), "lost_j": 0.0, "residual": 1.0e-3,
        "first_tear_position_m": None if first is None else tuple(middles[first]),
        "first_tear_time_s": None if first is None else (torn_s or {})[first],
    }  # fmt: skip
    report = judgement(scene, judge)
    if is_full:
        report = full_report(
            report, scene, physics=physics(film=film), findings=[], estimate=None, wall_s=1.0, mode="run"
        )
    return report


def svg_of(report: Report, scene: Scene) -> str:
    film = film_map(report)
    assert film is not None
    return film_figure(report, scene, film, "label")


def test_the_sides_are_named_from_the_cut_on() -> None:
    film = film_map(report_of(wrapped(STRETCH)))
    assert film is not None
    assert [side.name for side in film.sides] == ["−y", "+x", "+y", "−x"]
    # The pallet, 1.2 x 0.8 m, and the load, a millimetre less: in the mean of all rows between the two.
    for side, length in zip(film.sides, (1.2, 0.8, 1.2, 0.8), strict=True):
        assert side.end_m - side.start_m == pytest.approx(length, abs=0.01)
    assert film.sides[0].start_m == 0.0 and film.sides[3].end_m == film.corners[:, :, 0].max()


def test_a_side_that_the_cut_divides_stands_at_both_ends() -> None:
    report = report_of(wrapped(STRETCH))
    corners = np.array(report["film"]["corners_m"]).reshape(-1, 3, 2)
    length, cut = corners[:, :, 0].max(), np.unique(corners[:, :, 0])[5]
    moved = corners - [cut, 0.0]
    moved[moved[:, :, 0].max(axis=1) < 1.0e-6] += [length, 0.0]
    film = film_map({**report, "film": {**report["film"], "corners_m": moved.reshape(-1, 6).tolist()}})
    assert film is not None
    assert [side.name for side in film.sides] == ["−y", "+x", "+y", "−x", "−y"]
    rectangles = boxes_behind(report, wrapped(STRETCH), film)[0]
    # Those of the cut side stand twice, once beyond either end.
    assert len(rectangles) == 64 + 21


def test_the_packages_behind_the_film_stand_where_they_are() -> None:
    scene = wrapped(STRETCH)
    report = report_of(scene)
    film = film_map(report)
    assert film is not None
    rectangles, top = boxes_behind(report, scene, film)
    # Five layers of 4 columns on two sides, 2 on the others, and the pallet on all four: what is inside is hidden.
    assert len(rectangles) == 2 * (5 * 4 + 1) + 2 * (5 * 2 + 1)
    assert top == pytest.approx(0.144 + 5 * 0.25)
    assert rectangles[:, [1, 3]].min() == 0.0 and rectangles[:, [1, 3]].max() == pytest.approx(top)
    front = rectangles[(rectangles[:, 0] > 1.19) & (rectangles[:, 2] < 2.01)]
    assert len(front) == 11
    assert np.ptp(front[front[:, 1] > 0.144, 0]) == pytest.approx(0.4, abs=0.003)


def test_a_load_that_stands_askew_has_no_packages_drawn() -> None:
    scene = wrapped(STRETCH)
    report = report_of(scene, turned_deg=40.0)
    film = film_map(report)
    assert film is not None
    assert len(boxes_behind(report, scene, film)[0]) == 0
    ElementTree.fromstring(svg_of(report, scene))


def test_a_whole_film_is_told_of() -> None:
    scene = wrapped(STRETCH)
    report = report_of(scene, strains={17: 0.0689})
    page = PageCheck(report_html(report, scene))
    film = film_map(report)
    assert film is not None and film.worst == 17
    side, height = film.place(17)
    # The film law of stretch_film_20: see config/wrap.py.
    said = f"its largest strain is 6.89 %, laid {height:.2f} m above the sled on the {side} side"
    assert (
        f"The film stayed whole: {said}; around the load it yields at 19.5 % and tears at 149 %." in page.text
    )
    for words in (
        "stretch_film_20, 6 layers everywhere", "two-way: the film holds the load",
        # 540 N/m of six layers are 45 N for half a metre of one.
        "540 N/m, all layers together; 45.0 N for 500 mm of one layer", "600 N/m, all layers together; 50.0 N",
        "after 0.65 s", "nowhere", "or film that tore", "The film is not drawn here",
    ):  # fmt: skip
        assert words in page.text, words
    assert any("laid flat" in label for label in page.labels)


def test_the_place_of_the_largest_strain_is_the_one_that_the_test_saw() -> None:
    report = report_of(wrapped(STRETCH))
    # Every element is stretched alike: where the largest strain was only the test itself can tell.
    report["wrap"]["peak_position_m"] = report["film"]["middles_m"][700]
    film = film_map(report)
    assert film is not None and film.worst == 700


def test_a_film_that_gave_way_is_told_of() -> None:
    scene = wrapped({"material": "stretch_film_20", "turns": {"bottom": 3, "middle": 2}})
    report = report_of(scene, strains={17: 0.5})
    report["wrap"]["lost_j"] = 7.2
    text = PageCheck(report_html(report, scene)).text
    assert "stayed whole, but gave way for good" in text and "7.2 J" in text
    assert "a machine's turns: 3 at the foot, 2 up or down" in text
    # Layers differ with height: no pull of one layer can be told.
    assert "540 N/m, all layers together " in text


def test_a_torn_film_breaks_the_rule_on_damage() -> None:
    scene = wrapped(PAPER)
    report = report_of(scene, strains={40: 0.07, 17: 0.05}, torn_s={40: 0.4, 17: 0.35})
    assert report["verdict"] == "fail"
    sentence = verdict_sentence(report, scene)
    assert sentence.startswith(
        "The rule on damage is broken: the film tore, first 0.35 s after the first frame"
    )
    assert "package film" not in sentence
    text, count = PageCheck(report_html(report, scene)).text, len(report["film"]["torn_s"])
    assert "The film tore: first after 0.35 s" in text and f"2 of its {count} elements tore in all" in text
    assert "around the load the film tears at 4 %" in text and "never: the film is elastic" in text
    assert "Hatched: torn" in text and "tore first: 0.35 s" in text and "where it first tore" in text


def test_a_package_named_film_is_a_package() -> None:
    raw = cartons_scene(5)
    raw["load"]["packages"][-1]["id"] = "film"
    scene = wrapped(STRETCH, load=raw["load"])
    judge = judged(scene, [(0.0, 0.0, -1.0)])
    report = full_report(
        judgement(scene, judge), scene, physics=physics(), findings=[], estimate=None, wall_s=1.0, mode="run"
    )
    damage = next(rule for rule in report["rules"] if rule["rule"] == "damage")
    assert "package film toppled or fell" in verdict_sentence({**report, "rules": [damage]}, scene)


def test_film_that_does_not_hold_or_tear_is_called_so() -> None:
    scene = wrapped({**STRETCH, "coupling": "one_way", "tear": False})
    text = PageCheck(report_html(report_of(scene), scene)).text
    assert "The film follows the load and does not hold it." in text
    assert "one-way: the film follows the load and is watched, but does not hold it" in text
    assert "would tear at 149 %, which the scene rules out" in text and "the scene lets no film tear" in text


def test_no_film_no_word_of_it() -> None:
    for scene in (wrapped(None), wrapped({**STRETCH, "turns": 0})):
        judge = judged(scene, [(0.001, 0.0, 0.0)])
        report = full_report(
            judgement(scene, judge),
            scene,
            physics=physics(),
            findings=[],
            estimate=None,
            wall_s=1.0,
            mode="run",
        )
        text = PageCheck(report_html(report, scene)).text
        assert "film" not in text.lower()
        assert film_lines(report) == [] and film_map(report) is None


def test_a_judgement_alone_has_its_film() -> None:
    scene = wrapped(STRETCH)
    report = report_of(scene, is_full=False)
    text = PageCheck(report_html(report, scene)).text
    assert "The film stayed whole" in text and "stretch_film_20, 6 layers everywhere" in text
    assert film_lines(report) == ["film: largest strain 2 %; not torn"]


def test_marks_stand_on_the_scale_only_where_it_reaches() -> None:
    scene = wrapped(STRETCH)
    low = svg_of(report_of(scene, strains={17: 0.1}), scene)
    assert "as laid 6.66 %" in low and "yields" not in low and "tears" not in low
    drawn = svg_of(report_of(scene, strains={17: 0.5}), scene)
    assert "yields 19.5 %" in drawn and "tears" not in drawn
    torn = svg_of(report_of(scene, strains={17: 1.6}, torn_s={17: 0.4}), scene)
    assert "yields 19.5 %" in torn and "tears 149 %" in torn


def test_elements_of_one_strain_have_one_colour() -> None:
    scene = wrapped(STRETCH)
    report = report_of(scene, strains={17: 0.5, 18: 0.5})
    svg, count = svg_of(report, scene), len(report["film"]["torn_s"])
    # All elements but two have the darkest shade, two the brightest, each shade one path of triangles.
    areas = [
        (path.count("M "), colour)
        for path, colour in re.findall(r'<path d="([^"]*)"[^>]*style="fill: (#[0-9a-f]{6});', svg)
        if path.count("z") > 1
    ]
    assert sorted(count for count, _ in areas) == [2, count - 2]
    assert len({colour for _, colour in areas}) == 2


def test_torn_elements_are_holes() -> None:
    scene = wrapped(PAPER)
    everything = dict.fromkeys(range(len(report_of(scene)["film"]["torn_s"])), 0.3)
    for torn_s in ({17: 0.4}, everything):
        svg = svg_of(report_of(scene, strains={17: 0.05}, torn_s=torn_s), scene)
        ElementTree.fromstring(svg)
        paths = re.findall(r'<path d="([^"]*)"[^>]*style="fill: var\(--paper\)', svg)
        assert len(torn_s) in [path.count("z") for path in paths]


def test_the_same_film_gives_the_same_bytes_after_json() -> None:
    scene = wrapped(STRETCH)
    report = report_of(scene, strains={17: 0.5, 40: 1.6}, torn_s={40: 0.4})
    page = report_html(report, scene)
    assert report_html(json.loads(json.dumps(report)), scene) == page
    ids = re.findall(r'\bid="([^"]+)"', page)
    assert len(ids) == len(set(ids))
    assert set(re.findall(r'(?:xlink:href="|url\()#([^")]+)', page)) <= set(ids)
    assert len(re.findall(r"<svg", page)) == 3 and "#0101" not in page
    assert len(page.encode()) < 500_000


def test_the_command_line_says_how_the_film_fared(capsys: pytest.CaptureFixture[str]) -> None:
    scene = wrapped(STRETCH)
    report = report_of(scene, strains={17: 0.0689})
    x, y, z = report["wrap"]["peak_position_m"]
    place = f"x {x:.2f} y {y:.2f} z {z:.2f} m"
    assert film_lines(report) == [
        f"film stretch_film_20, 6 layers everywhere: largest strain 6.89 % (yields at 19.5 %, breaks at 149 %), {place} at 0.65 s;"
        " not torn",
        "film pulls 540 N/m when settled and 600 N/m at most; lost 0 J",
    ]
    report["wrap"] |= {"yield_strain": 0.195, "coupling": "one_way"}
    first = film_lines(report)[0]
    assert "(yields at 19.5 %, breaks at 149 %)" in first and "which follows and does not hold" in first
    torn = report_of(wrapped(PAPER), strains={40: 0.07}, torn_s={40: 0.4})
    show_rules(torn)
    shown = " ".join(capsys.readouterr().out.split())
    assert re.search(r"damage .* fail film torn, \d\.\d\d m high, first at 0\.40 s", shown)
    assert f"1 of {len(torn['film']['torn_s'])} elements torn, first x " in shown and "film pulls" in shown


def test_strains_are_told_in_three_figures() -> None:
    texts = [percent(strain) for strain in (0.0, 0.000648, 0.0689, 0.5923, 0.99951, 1.4947, 12.0)]
    assert texts == ["0 %", "0.0648 %", "6.89 %", "59.2 %", "100 %", "149 %", "1200 %"]
