"""The HTML report: what it says, that it stands on its own, and that no text from outside can break it."""

import json
import re
import subprocess
import sys
import time
from html.parser import HTMLParser
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from config.scene import Scene
from config.scene_file import validate_scene
from sim_core.companion import ErrorEstimate
from sim_core.frames import Array, PoseFrame
from sim_core.geometry import yaw_quaternion
from sim_core.integrity import Finding
from sim_core.judge import EumosJudge
from sim_core.report import full_report, judgement
from sim_core.report_html import report_html, write_report_html
from sim_core.report_views import posed_loads
from sim_core.report_words import corner_words, figure_text, verdict_sentence
from sim_core.run import PhysicsSummary

VOID_TAGS = {"meta", "br"}
ALLOWED_TAGS = {
    "html", "head", "meta", "title", "style", "body", "main", "header", "section", "footer", "h1", "h2",
    "p", "div", "span", "strong", "dl", "dt", "dd", "table", "thead", "tbody", "tr", "th", "td",
    "figure", "figcaption",
    "details", "summary", "ul", "li", "svg", "g", "path", "use", "defs", "text", "clippath", "rect",
}  # fmt: skip


class PageCheck(HTMLParser):
    """Walks a page: every tag is known, closed in order, and points nowhere outside of the page."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.open_tags: list[str] = []
        self.words: list[str] = []
        self.labels: list[str] = []
        self.feed(page)
        self.close()
        assert not self.open_tags

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        assert tag in ALLOWED_TAGS, tag
        for name, value in attrs:
            assert not name.startswith("on")
            assert name not in ("src", "href", "data", "action")
            if name == "xlink:href":
                assert value is not None and value.startswith("#")
            if name == "aria-label":
                self.labels.append(value or "")
        if tag not in VOID_TAGS:
            self.open_tags.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_starttag(tag, attrs)
        if tag not in VOID_TAGS:
            self.open_tags.pop()

    def handle_endtag(self, tag: str) -> None:
        assert self.open_tags.pop() == tag

    def handle_data(self, data: str) -> None:
        if "style" not in self.open_tags:
            self.words.append(data)

    @property
    def text(self) -> str:
        return " ".join(" ".join(self.words).split())


def stack(
    count: int = 4, *, ids: list[str] | None = None, sled: dict[str, Any] | None = None, **parts: Any
) -> Scene:
    """Columns of three boxes on an EPAL pallet, or as the parts say."""
    deck = 0.0 if parts.get("pallet", 0) is None else 0.144
    packages = [
        {
            "id": ids[k] if ids else f"p{k}",
            "size_m": [0.3, 0.4, 0.25],
            "mass_kg": 10.0,
            "position_m": [0.31 * (k // 3 % 4), 0.41 * (k // 12), deck + 0.125 + 0.25 * (k % 3)],
        }
        for k in range(count)
    ]
    sled = sled or {"profile": "eumos", "level_g": 0.5}
    return validate_scene({"name": "stack", "load": {"packages": packages}, "sled": sled, **parts})


def settled_poses(scene: Scene) -> tuple[Array, Array]:
    deck = scene.pallet_box.size_m[2] if scene.pallet_box is not None else 0.0
    positions = np.array([(0.0, 0.0, deck / 2.0), *(package.position_m for package in scene.packages)])
    turns = [yaw_quaternion(0.0), *(yaw_quaternion(package.yaw_deg) for package in scene.packages)]
    return positions, np.array(turns)


def judged(scene: Scene, shifts_m: list[tuple[float, float, float]]) -> EumosJudge:
    """A judge that saw the settled load, then its last package shifted, once every half second."""
    judge = EumosJudge(scene)
    positions, orientations = settled_poses(scene)
    for index, shift in enumerate([(0.0, 0.0, 0.0), *shifts_m]):
        moved = positions.copy()
        if scene.packages:
            moved[-1] += shift
        judge.add(PoseFrame(index, 1_000 + index * 500_000_000, moved, orientations))
    return judge


def physics(**changes: Any) -> PhysicsSummary:
    account: dict[str, Any] = {
        "engine": "bullet", "settings": {"erp": 0.2}, "unmet_friction": [], "steps": 960, "settle_s": 0.05,
        "simulated_s": 2.0, "at_rest": True, "penetration_m": 1.0e-4, "speed_mps": 1.0, "residual": 1.0e-6,
        "contact_count": 48,
        "energy_residual": 0.0,
        "step_phase": 0.0,
        "smallest_step_s": 1.0 / 480.0,
        "halvings": [],
    }  # fmt: skip
    return PhysicsSummary(**{**account, **changes})


def report_of(
    scene: Scene,
    shifts_m: list[tuple[float, float, float]],
    *,
    estimate: ErrorEstimate | None = None,
    findings: list[Finding] | None = None,
    **changes: Any,
) -> dict[str, Any]:
    judge = judged(scene, shifts_m)
    return full_report(
        judgement(scene, judge, is_complete="ended_by" not in changes), scene,
        physics=physics(**changes), findings=findings or [], estimate=estimate,
        wall_s=2.0, mode="run",
    )  # fmt: skip


def estimate_of(error_mm: float) -> ErrorEstimate:
    return ErrorEstimate(
        1.0 / 240.0, dict.fromkeys(("permanent", "permanent_on_pallet", "elastic"), error_mm), error_mm
    )


def test_a_pass_names_the_rule_that_comes_closest() -> None:
    # Height 0.144 + 3 · 0.25 = 0.894 m: elastic limit 89.4 mm, permanent 44.7 mm.
    # 60 mm at the peak is 67 % of the one, 10 mm at the end 22 % of the other.
    scene = stack(3)
    report = report_of(scene, [(-0.06, 0.0, 0.0), (-0.01, 0.0, 0.0)], estimate=estimate_of(0.5))
    page = PageCheck(report_html(report, scene))
    assert "✓ PASS" in page.text
    sentence = verdict_sentence(report, scene)
    assert (
        "elastic displacement of any part, at 67 % of its limit of 89.4 mm: package p2 moved by 60.0 mm"
        in sentence
    )
    assert sentence in page.text
    assert "60.0 ± 0.50" in page.text
    assert "29.4" in page.text
    assert "0.5 g" in page.text and "30.0 kg" in page.text and "0.894 m" in page.text


def test_a_fail_says_package_corner_height_and_time() -> None:
    scene = stack(3)
    report = report_of(scene, [(0.0, 0.0, 0.0), (0.3, 0.4, 0.0)])
    assert report["verdict"] == "fail"
    sentence = verdict_sentence(report, scene)
    assert "The limit of 44.7 mm for permanent displacement of any part was exceeded" in sentence
    assert "package p2 moved by 500.0 mm" in sentence and "1.00 s after the first frame" in sentence
    page = PageCheck(report_html(report, scene))
    assert "✕ FAIL" in page.text
    assert any("package p2 is farthest out: 500.0 mm" in label for label in page.labels)


def test_an_estimate_across_the_limit_is_said() -> None:
    scene = stack(3)
    report = report_of(scene, [(-0.089, 0.0, 0.0), (0.0, 0.0, 0.0)], estimate=estimate_of(2.0))
    assert report["verdict"] == "unresolved"
    assert "error estimate of 2.00 mm reaches across the limit of 89.4 mm" in verdict_sentence(report, scene)
    assert "? UNRESOLVED" in PageCheck(report_html(report, scene)).text


def test_a_missing_estimate_is_not_called_a_fail() -> None:
    scene = stack(3)
    estimate = ErrorEstimate(1.0 / 240.0, {}, None, "the companion fell over")
    report = report_of(scene, [(0.5, 0.0, 0.0)], estimate=estimate)
    assert report["verdict"] == "unresolved"
    sentence = verdict_sentence(report, scene)
    assert sentence.startswith(
        "No verdict, as there is no error estimate (the companion fell over). As computed: "
    )


def test_a_monitor_ended_the_test() -> None:
    scene = stack(3)
    ended_by = "ended by monitor 'speed' at 0.5000 s: p2 at 60.0 m/s, limit 50 m/s"
    report = report_of(scene, [(2.0, 0.0, 0.0)], ended_by=ended_by)
    text = PageCheck(report_html(report, scene)).text
    assert f"No verdict: the test was {ended_by}." in text
    assert "A monitor ended the test early" in text and "test ended here: 0.50 s" in text


def test_a_test_that_ended_before_its_first_frame() -> None:
    scene = stack(3)
    report = full_report(
        judgement(scene, EumosJudge(scene), is_complete=False), scene,
        physics=physics(ended_by="ended by monitor 'settling' at 0 s: it leans"),
        findings=[], estimate=None, wall_s=0.0, mode="up fast",
    )  # fmt: skip
    text = PageCheck(report_html(report, scene)).text
    assert "No rule was judged" in text and "it leans" in text and "the test was ended early" in text


@pytest.mark.parametrize("parts", [{}, {"pallet": None}])
def test_an_empty_sled(parts: dict[str, Any]) -> None:
    scene = stack(0, **parts)
    text = PageCheck(report_html(report_of(scene, [(0.0, 0.0, 0.0)]), scene)).text
    assert "There is no package on the sled" in text


@pytest.mark.parametrize(
    "sled",
    [
        {"profile": "table", "times_s": [0.0, 0.5], "acceleration_mps2": [4.0, 4.0], "direction": "-y"},
        {"profile": "recorded", "samples_mps2": [[0.0, 0.0, 0.0]] + [[0.0, -3.0, 0.0]] * 300},
        {"profile": "recorded", "samples_mps2": [[0.0, 0.0, 0.0]] * 2},
        {"profile": "eumos", "level_g": 0.0, "direction": 30.0},
    ],
)
def test_every_profile_has_its_page(sled: dict[str, Any]) -> None:
    scene = stack(1, sled=sled, pallet=None)
    PageCheck(report_html(report_of(scene, [(0.0, 0.01, 0.0)]), scene))
    PageCheck(report_html(judgement(scene, judged(scene, [])), scene))


@pytest.mark.parametrize(
    ("direction", "words"),
    [("+x", "top front left"), ("-x", "top rear right"), ("+y", "top front right"), ("-y", "top rear left")],
)
def test_corners_are_named_along_the_travel(direction: str, words: str) -> None:
    # Corner 7 is +x +y +z; for a travel to +y, +y is in front and +x to the right.
    scene = stack(1, sled={"profile": "eumos", "level_g": 0.5, "direction": direction})
    report = report_of(scene, [(0.0, 0.0, 0.0)])
    assert corner_words(report, scene, {"package": "p0", "corner": 7}) == words


@pytest.mark.parametrize(
    ("direction", "seen"), [("+x", (0.1, 0.2)), ("-x", (-0.1, -0.2)), ("+y", (0.2, -0.1))]
)
def test_views_turn_with_the_travel(direction: str, seen: tuple[float, float]) -> None:
    scene = stack(1, sled={"profile": "eumos", "level_g": 0.5, "direction": direction})
    loads = posed_loads(report_of(scene, [(0.1, 0.2, 0.0)]), scene)
    moved = loads["end"].corners[1] - loads["settled"].corners[1]
    np.testing.assert_allclose(moved, np.tile([*seen, 0.0], (8, 1)), atol=1.0e-12)
    assert loads["end"].moved_mm[1] == pytest.approx(1000.0 * np.hypot(0.1, 0.2))


def test_the_same_report_gives_the_same_bytes_after_json(tmp_path: Path) -> None:
    import matplotlib

    scene = stack(12)
    report = json.loads(json.dumps(report_of(scene, [(0.05, 0.0, 0.0)])))
    with matplotlib.rc_context({"font.size": 30.0, "svg.fonttype": "path"}):
        before = dict(matplotlib.rcParams)
        first = report_html(report, scene)
        assert dict(matplotlib.rcParams) == before
    path = tmp_path / "report.html"
    program = (
        "import json, sys; from pathlib import Path; from config.scene_file import scene_from_json;"
        "from sim_core.report_html import write_report_html; assert 'matplotlib' not in sys.modules;"
        "report, scene = json.load(sys.stdin);"
        "write_report_html(report, scene_from_json(json.dumps(scene)), Path(sys.argv[1]))"
    )
    given_text = json.dumps([report, json.loads(scene.to_json())])
    subprocess.run([sys.executable, "-c", program, str(path)], input=given_text, text=True, check=True)
    assert path.read_text(encoding="utf-8") == first
    assert [entry.name for entry in tmp_path.iterdir()] == ["report.html"]


def test_nothing_is_left_behind_when_the_page_cannot_be_made(tmp_path: Path) -> None:
    scene = stack(1)
    report = report_of(scene, [(0.0, 0.0, 0.0)])
    path = tmp_path / "report.html"
    path.write_text("the old one")
    with pytest.raises(KeyError):
        write_report_html({key: report[key] for key in report if key != "sled"}, scene, path)
    assert path.read_text() == "the old one"
    (tmp_path / "folder").mkdir()
    with pytest.raises(OSError):
        write_report_html(report, scene, tmp_path / "folder")
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["folder", "report.html"]


def test_figures_are_valid_svg_with_unique_ids() -> None:
    scene = stack(24)
    page = report_html(report_of(scene, [(-3.0, 0.5, -0.2)]), scene)
    ids = re.findall(r'\bid="([^"]+)"', page)
    assert len(ids) == len(set(ids)) and ids
    targets = set(re.findall(r'(?:xlink:href="|url\()#([^")]+)', page))
    assert targets <= set(ids)
    figures = re.findall(r"<svg.*?</svg>", page, flags=re.DOTALL)
    assert len(figures) == 2
    for figure in figures:
        ElementTree.fromstring(figure)
        assert "#0101" not in figure and "#0102" not in figure
    assert "://" not in re.sub(r'xmlns:xlink="[^"]*"', "", page)


def test_only_the_worst_ten_packages_stand_open() -> None:
    scene = stack(24)
    page = report_html(report_of(scene, [(0.02, 0.0, 0.0)]), scene)
    table, _, folded = page[page.index("The 10 packages that moved most") :].partition("<details>")
    assert table.count('<th scope="row">') == 10 and table.index("p23") < table.index("p0")
    assert folded.partition("</details>")[0].count('<th scope="row">') == 14


def test_size_and_time_of_large_loads() -> None:
    for count, bytes_limit in ((124, 1_500_000), (500, 3_000_000)):
        scene = stack(count)
        report = report_of(scene, [(-0.05, 0.02, 0.0)])
        began = time.perf_counter()
        page = report_html(report, scene)
        assert time.perf_counter() - began < 10.0
        assert len(page.encode()) < bytes_limit


def test_findings_unmet_friction_and_tolerance_are_told() -> None:
    scene = stack(3, solver={"tolerance_mm": 0.1})
    finding = Finding("warning", "overhang", "p1 & p2", "60 mm", "at most 50 mm")
    report = report_of(
        scene, [(0.0, 0.0, 0.0)], estimate=estimate_of(0.3), findings=[finding],
        unmet_friction=["a on b: wanted 0.1, used 0.2"], at_rest=False,
    )  # fmt: skip
    text = PageCheck(report_html(report, scene)).text
    for words in ("p1 & p2", "60 mm", "wanted 0.1, used 0.2", "0.1 mm: not kept", "had not come to rest"):
        assert words in text


def test_figures_have_true_minus_signs_and_no_minus_zero() -> None:
    assert [figure_text(value, 1) for value in (-1.25, -0.01, 0.0, None)] == ["−1.2", "0.0", "0.0", "–"]


texts = st.text(min_size=1, max_size=30) | st.sampled_from(
    [
        "</title><script>alert(1)</script>",
        "$x^{$",
        "\" onload='x'",
        "]]>",
        "<!--",
        "\x00\x1b[31m",
        "\u202egpj",
        "堆垛",
    ]
)


@settings(max_examples=15, deadline=None)
@given(
    ids=st.lists(texts.filter(lambda name: name != "pallet"), min_size=1, max_size=3, unique=True),
    words=texts,
)
def test_no_text_from_outside_breaks_the_page(ids: list[str], words: str) -> None:
    scene = stack(len(ids), ids=ids, description=words)
    finding = Finding("note", words, words, words, words)
    report = report_of(scene, [(0.2, 0.0, 0.0)], findings=[finding], ended_by=words)
    report["name"] = words
    report["versions"][words] = words
    page = report_html(report, scene)
    PageCheck(page)
    assert not re.search(r"[\x00-\x08\x0b-\x1f\x7f-\x9f]", page)
    page.encode()
