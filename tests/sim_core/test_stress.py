"""The stability table: its quick rows hold, and the table itself tells right from wrong."""

import csv
import importlib.util
import json
import re
from dataclasses import replace

import pytest

from config.errors import RefusedInput
from sim_core.stress import KNOWN_WRONG, StressRow, all_rows, run_stress
from sim_core.stress.loads import FLAT, box, scene_of, still
from sim_core.stress.model import Judgement, within
from sim_core.stress.run import run_row

HAS_MUJOCO = importlib.util.find_spec("mujoco") is not None
QUICK = [row for row in all_rows() if row.quick]


@pytest.mark.parametrize(
    ("row", "engine"),
    [(row, engine) for row in QUICK for engine in row.engines if engine == "bullet" or HAS_MUJOCO],
    ids=lambda value: value if isinstance(value, str) else value.id,
)
def test_quick_row_is_not_silently_wrong(row: StressRow, engine: str) -> None:
    result = run_row(row, engine)
    if (row.id, engine) in {(known.row, known.engine) for known in KNOWN_WRONG}:
        assert result.outcome == "wrong", f"no longer wrong, so take it off KNOWN_WRONG: {result.measured}"
    else:
        assert result.is_acceptable, f"{result.outcome}: {result.measured}; expected: {result.expected}"


def test_ids_are_unique_and_known_defects_are_rows() -> None:
    ids = [row.id for row in all_rows()]
    assert len(ids) == len(set(ids))
    assert {known.row for known in KNOWN_WRONG} <= set(ids)
    assert all(known.reason for known in KNOWN_WRONG)


def resting(judge=lambda trials: Judgement(True, "")) -> StressRow:
    def scenes(engine: str):
        return [scene_of("one", [box("a", FLAT, 10.0)], still(0.1), engine=engine)]

    return StressRow("one", "Group", "one box", "rests", scenes, judge, may=("right",))


def test_value_beyond_bound_and_error_estimate_is_wrong() -> None:
    result = run_row(resting(lambda trials: within(3.0e-3, 1.0e-3, "moved")), "bullet")
    assert (result.outcome, result.is_acceptable) == ("wrong", False)
    assert "moved 3 mm, bound 1 mm; error estimate 0.05 mm" in result.measured


def test_nan_is_never_right() -> None:
    assert not within(float("nan"), 1.0, "moved").right


def test_traceback_counts_as_wrong() -> None:
    result = run_row(resting(lambda trials: Judgement(1 / 0 > 0, "")), "bullet")
    assert result.outcome == "wrong"
    assert "ZeroDivisionError" in result.measured


def test_refusal_and_end_are_only_acceptable_where_the_row_says_so() -> None:
    refusing = replace(
        resting(), scenes=lambda engine: [scene_of("x", [box("a", FLAT, -1.0)], still(0.1), engine=engine)]
    )
    result = run_row(refusing, "bullet")
    assert (result.outcome, result.is_acceptable) == ("refused", False)
    assert "mass_kg = -1.0: must be greater than 0" in result.measured
    assert run_row(replace(refusing, may=("refused",)), "bullet").is_acceptable


def test_table_on_disk_says_what_ran(tmp_path) -> None:
    seen = []
    results = run_stress(
        tmp_path / "new",
        only=["input_nan_*", "one_box", "speed_clamp"],
        on_progress=lambda done, total, result: seen.append((done, total, result.row)),
    )
    assert [done for done, _, _ in seen] == list(range(1, seen[0][1] + 1))
    assert {r.row: r.outcome for r in results if not r.row.startswith("input")} == {
        "one_box": "right",
        "speed_clamp": "ended",
    }
    rows = json.loads((tmp_path / "new" / "stress.json").read_text(encoding="utf-8"))["rows"]
    assert [row["outcome"] for row in rows] == [result.outcome for result in results]
    slip = next(row for row in rows if row["row"] == "one_box")
    assert slip["value"] <= slip["bound"] and slip["watched"]["contact_count"] == 4
    with (tmp_path / "new" / "stress.csv").open(encoding="utf-8", newline="") as file:
        assert [row["row"] for row in csv.DictReader(file)] == [result.row for result in results]
    page = (tmp_path / "new" / "stress.html").read_text(encoding="utf-8")
    assert page.count('<span class="mark refused">⊘ refused</span></td>') == sum(
        r.outcome == "refused" for r in results
    )
    assert not re.search(r"(src|href)=|https?://|@import", page)


@pytest.mark.parametrize(
    ("arguments", "field"),
    [({"only": ["no_such_row"]}, "only"), ({"engines": ["havok"]}, "engines"), ({"out": "file"}, "out")],
)
def test_impossible_request_is_refused(tmp_path, arguments, field) -> None:
    (tmp_path / "file").write_text("")
    out = tmp_path / arguments["out"] if "out" in arguments else None
    with pytest.raises(RefusedInput) as refusal:
        run_stress(
            out, only=arguments.get("only", ["input_nan_mass"]), engines=arguments.get("engines", ["bullet"])
        )
    assert refusal.value.field == field
