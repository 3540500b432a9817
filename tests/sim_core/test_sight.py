"""What the camera measurement is worth and what the camera costs: cost rows, the page, and its bytes."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from config.errors import RefusedInput
from config.scene_file import find_scene, overridden, read_scene
from sim_core.camera.cost import DRAWN, CameraCost, CostRow, measure_cost, write_cost
from sim_core.vision.sight_page import cost_table, sight_page, write_sight_page
from sim_core.vision.sweep import (
    DEVIATION_EDGES,
    Case,
    SightRow,
    rows_on_disk,
    run_sight,
    summaries,
)
from tests.sim_core.vision_scenes import stack_scene


@pytest.fixture(scope="module")
def cost() -> CameraCost:
    scene = read_scene(find_scene("eur_camera"))
    short = overridden(scene, ["sled.plateau_s=0.3", "sled.level_g=0.3", "sled.deceleration_g=0.5"])
    return measure_cost(short, sizes=[(160, 90), (80, 64)], pictures=3)


def _row(number: int, **changes: object) -> SightRow:
    row = SightRow(
        key=str(number), name=f"load {number}, 0.5 g", look=("markers", "bare", "film")[number % 3], level_g=0.5,
        rms_mm=0.2 + 0.1 * number, largest_mm=2.0 + number, coverage=0.97, errors=1000, deviations=(1, *20 * [25], *20 * [24], 19),
        tracked=0.9, verdict="pass", judged="pass", agrees=True, missed="", unsettled="", take_ms=20.0, slowest_ms=30.0,
    )  # fmt: skip
    return replace(row, **changes)


_ROWS = [
    *(_row(number) for number in range(4)),
    _row(5, name="left open", verdict="unresolved", agrees=False, unsettled="elastic permanent_on_pallet"),
    _row(6, name="<taken> wrongly", verdict="fail", agrees=False, missed="elastic", rms_mm=1.7),
]


def test_every_size_is_timed_every_way_on_the_same_pictures(cost):
    assert [(row.width_px, row.drawn) for row in cost.rows] == [(w, d) for w in (160, 80) for d in DRAWN]
    for row in cost.rows:
        assert row.pictures == 3
        assert 0.0 < row.low_s <= row.median_s <= row.high_s < 5.0
        assert row.processor_s > 0.0
        assert row.bar_s is None and row.state is None
    assert [row.share for row in cost.rows if row.drawn == "film and shadows"] == [1.0, 1.0]
    assert cost.packages == 40 and cost.drawn_by


def test_only_the_whole_picture_has_a_bar():
    row = CostRow(1920, 1080, "film and shadows", 30, 0.26, 0.251, 0.3, 0.25, 1.0)
    assert row.bar_s == 0.25 and row.state == "over"
    assert replace(row, median_s=0.25).state == "inside"
    assert replace(row, median_s=0.5).state == replace(row, low_s=0.25).state == "unresolved"
    assert replace(row, drawn="no film, shadows").state is None
    assert replace(row, width_px=480, height_px=270).bar_s == 0.03


def test_a_scene_without_film_or_camera_is_refused():
    with pytest.raises(RefusedInput, match="must have a camera and a film"):
        measure_cost(stack_scene())
    with pytest.raises(RefusedInput, match="at least 1"):
        measure_cost(read_scene(find_scene("eur_camera")), pictures=0)


def test_the_page_needs_no_other_file_and_names_what_is_open_or_wrong(tmp_path: Path, cost):
    page = write_sight_page(tmp_path, _ROWS, cost).read_text(encoding="utf-8")
    assert not re.search(r"(src|href)=(?![\"']#)|url\((?!#)|@import", page)
    assert page.count("<svg ") == 5
    assert "1 WRONG" in page and "Of 6 verdicts from pictures 4 are the judge" in page
    verdicts = page[page.index("<h2>Verdicts") : page.index("<h2>Every test")]
    assert "left open" in verdicts and "elastic, permanent on pallet" in verdicts
    assert "&lt;taken&gt; wrongly" in verdicts and "load 0" not in verdicts
    over = page[page.index("Tests over their bar") : page.index("<h2>Is the stated")]
    assert "&lt;taken&gt; wrongly" in over and "left open" not in over
    for row in cost_table(cost):
        assert row["median [ms]"] in page


def test_the_same_rows_are_the_same_bytes(tmp_path: Path, cost):
    first = write_sight_page(tmp_path, _ROWS, cost).read_bytes()
    assert write_sight_page(tmp_path, list(_ROWS), cost).read_bytes() == first
    assert sight_page(_ROWS[:-1], cost).encode() != first


def test_the_page_stands_without_rows_or_without_cost(tmp_path: Path, cost):
    bare = write_sight_page(tmp_path, [], cost).read_text(encoding="utf-8")
    assert bare.count("<svg ") == 1 and "holds no row" in bare and "WRONG" not in bare
    assert "sight --only-cost" in write_sight_page(tmp_path, _ROWS, None).read_text(encoding="utf-8")
    assert rows_on_disk(tmp_path) == []


def test_the_cost_reads_back(tmp_path: Path, cost):
    write_cost(cost, tmp_path / "sight_cost.json")
    told = json.loads((tmp_path / "sight_cost.json").read_text(encoding="utf-8"))
    assert tuple(CostRow(**row) for row in told.pop("rows")) == cost.rows
    assert CameraCost(**told, rows=cost.rows) == cost


def test_a_row_counts_every_error_and_is_read_again_as_it_was(tmp_path: Path):
    cases: list[Case] = [("stack, 0.3 g", "bare", stack_scene(level_g=0.3, rate_hz=10))]
    (row,), told = run_sight(tmp_path, cases=cases)
    assert row.level_g == 0.3 and row.look == "bare" and told == summaries([row])
    counts = np.array(row.deviations)
    assert counts.shape == (len(DEVIATION_EDGES) + 1,) and counts.sum() == row.errors > 100
    # Bins end at 1.75 and 2.0, on either side of 1.96.
    inside = [counts[1:-1][np.abs(DEVIATION_EDGES[:-1] + 0.125) < edge].sum() for edge in (1.75, 2.0)]
    assert inside[0] <= row.coverage * row.errors + 0.5 and row.coverage * row.errors - 0.5 <= inside[1]
    assert rows_on_disk(tmp_path, cases=cases) == [row]
    assert rows_on_disk(tmp_path) == []
    # A second run takes it from there: its time of measuring is the first one's.
    assert run_sight(tmp_path, cases=cases)[0] == [row]
    assert "deviations" not in (tmp_path / "sight.csv").read_text(encoding="utf-8").splitlines()[0]
