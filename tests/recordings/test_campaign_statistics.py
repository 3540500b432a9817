"""Statistics of a campaign: intervals and weights in closed form, first rules, margins, bins, page and command."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st

from config.campaign import Campaign, campaign_from_raw
from config.errors import RefusedInput
from recordings.campaigns.labels import Label, table_of, write_parquet
from recordings.campaigns.one_test import Cost
from recordings.campaigns.statistics import Statistics, campaign_statistics
from recordings.campaigns.statistics_cost import cost_rows
from recordings.campaigns.statistics_groups import campaign_groups
from recordings.campaigns.statistics_outliers import closest_limit
from recordings.campaigns.statistics_page import COST_TITLE, statistics_page
from recordings.campaigns.statistics_rates import NORMAL_95, rate_of, weighted_share, wilson
from ros_nodes.campaign_statistics import write_statistics
from tests.ros_nodes.graph import pallet_twin

RAW: dict[str, Any] = {
    "name": "trial",
    "description": "less than < and & in it",
    "tests": 8,
    "scene": {"sled": {"profile": "eumos", "level_g": 0.5}},
    "loads": [{"file": "eur_columns.nist.xml"}],
    "vary": {"sled.level_g": [0.3, 0.5, 0.8], "camera.distance_m": {"from": 3, "to": 5}},
    "friction": {"cardboard/wood": {"from": 0.2, "to": 0.6}},
    "restraints": [
        {"name": "none"},
        {"name": "<b>fields", "vary": {"force_fields.tension": {"from": 0.1, "to": 10, "scale": "log"}}},
        {"name": "film", "vary": {"wrap.material": ["stretch_film_20"]}},
    ],
}


def campaign() -> Campaign:
    return campaign_from_raw(RAW)


def label(number: int, verdict: str = "pass", **changes: Any) -> Label:
    """A test whose permanent displacement stays 20 mm inside of 70 mm, or exceeds it by as much."""
    margin = 20.0 if verdict == "pass" else -20.0
    factors = {
        "scheme": "eur_columns",
        "layers": 5,
        "layout": "as_filed",
        "restraint": "none",
        "sled.level_g": 0.5,
    }
    told: dict[str, Any] = {
        "number": number, "weight": 1.0, "packages": 40, "mass_kg": 300.0, "height_m": 1.4, "verdict": verdict,
        "judged": verdict, "first_rule": "permanent" if verdict == "fail" else None,
        "first_time_s": 0.4 if verdict == "fail" else None, "first_package": "p1" if verdict == "fail" else None,
        "first_corner": None, "first_height_m": 0.7 if verdict == "fail" else None, "states": {"permanent": verdict},
        "worst_mm": {"permanent": 70.0 - margin}, "margin_mm": {"permanent": margin}, "error_mm": {"permanent": 1.0},
        "estimate_problem": None, "ended_by": None, "engine": "bullet", "time_step_s": 0.002, "penetration_mm": 0.1,
        "energy_residual": 1.0e-3, "simulated_s": 2.0, "pictures": 0, "scene_sha256": "", "bag_sha256": "",
        "bag_bytes": 1, "factors": factors,
    }  # fmt: skip
    factors |= changes.pop("factors", {})
    return Label(**{**told, **changes})


def statistics(*labels: Label) -> Statistics:
    return campaign_statistics(labels, campaign())


@pytest.mark.parametrize(
    ("passes", "tests", "low", "high"),
    # Newcombe, Statistics in Medicine 17, 1998, 857-872, table I, method 3.
    [(81, 263, 0.2553, 0.3662), (15, 148, 0.0624, 0.1605), (0, 20, 0.0, 0.1611), (1, 29, 0.0061, 0.1718)],
)
def test_intervals_are_the_published_ones(passes: int, tests: int, low: float, high: float) -> None:
    assert wilson(passes, tests) == pytest.approx((low, high), abs=5.0e-5)
    assert wilson(tests - passes, tests) == pytest.approx((1.0 - high, 1.0 - low), abs=5.0e-5)


@given(st.integers(1, 10_000).flatmap(lambda tests: st.tuples(st.integers(0, tests), st.just(tests))))
def test_interval_ends_are_where_the_share_is_196_deviations_away(case: tuple[int, int]) -> None:
    passes, tests = case
    low, high = wilson(passes, tests)
    assert 0.0 <= low <= passes / tests <= high <= 1.0
    for end in (low, high):
        # The interval's defining equation: (p̂ − p)² = z² p (1 − p) / n.
        assert (passes / tests - end) ** 2 == pytest.approx(
            NORMAL_95**2 * end * (1.0 - end) / tests, abs=1.0e-9
        )


def test_weights_give_back_the_share_that_a_choice_has_changed() -> None:
    assert weighted_share([True, True, False], [1.0, 1.0, 2.0])[0] == 0.5
    # Equal weights of any size change nothing.
    assert weighted_share([True] * 15 + [False] * 133, [3.0] * 148) == pytest.approx(
        (15 / 148, *wilson(15, 148))
    )
    # All alike: n is (Σw)²/Σw² = 16/6.
    assert weighted_share([True] * 3, [1.0, 1.0, 2.0]) == pytest.approx((1.0, *wilson(16 / 6, 16 / 6)))
    # Draws pass with a chance of 0.2; passes are kept, of the fails each fourth. A kept fail stands for four draws.
    source = np.random.default_rng(5)
    inside = 0
    for _ in range(400):
        passes = source.random(400) < 0.2
        kept = passes | (source.random(400) < 0.25)
        share, low, high = weighted_share(list(passes[kept]), list(np.where(passes[kept], 1.0, 4.0)))
        assert share == pytest.approx(0.2, abs=0.12)
        inside += low <= 0.2 <= high
    # Of 400 intervals of 95 % 380 ± 4.4 should hold; four deviations to either side.
    assert 362 <= inside <= 398


def test_unresolved_tests_are_counted_apart() -> None:
    rate = rate_of("all", "all", [label(0), label(1, "fail"), label(2, "unresolved"), label(3, weight=2.0)])
    assert (rate.tests, rate.passes, rate.fails, rate.unresolved) == (4, 2, 1, 1)
    assert rate.rate == pytest.approx(2 / 3) and rate.weighted_rate == pytest.approx(3 / 4)
    nothing = rate_of("all", "all", [label(0, "unresolved")])
    assert nothing.rate is nothing.low is nothing.weighted_rate is None and nothing.unresolved == 1


def test_tests_are_told_apart_by_what_was_drawn() -> None:
    labels = [
        label(0, factors={"sled.level_g": 0.3, "friction cardboard/wood": 0.2}),
        label(1, factors={"sled.level_g": 0.8, "friction cardboard/wood": 0.3, "restraint": "film",
                          "wrap.material": "stretch_film_20"}),
        label(2, factors={"friction cardboard/wood": 0.6, "restraint": "<b>fields", "force_fields.tension": 0.5}),
        label(3, factors={"layers": 10, "restraint": "<b>fields", "force_fields.tension": 10.0}),
    ]  # fmt: skip
    groups = {group.key: group for group in campaign_groups(labels, campaign())}
    assert groups["sled.level_g"].values == ("0.3", "0.5", "0.8")
    assert groups["layers"].values == ("5", "10")
    # In the campaign's order; the direction that no test drew is the scene's.
    assert groups["restraint"].values == ("none", "<b>fields", "film")
    assert groups["sled.direction"].values == ("+x",)
    assert groups["wrap.material"].values == ("no film", "stretch_film_20")
    # Four bins of 0.1; an edge belongs to the bin above it, the last one to the last bin.
    friction = groups["friction cardboard/wood"]
    assert [friction.value_of(one) for one in labels] == ["0.2 to 0.3", "0.3 to 0.4", "0.5 to 0.6", "none"][
        :3
    ] + [None]
    tension = groups["force_fields.tension"]
    assert [tension.value_of(one) for one in labels] == [None, None, "0.316 to 1", "3.16 to 10"]
    assert "camera.distance_m" not in groups


def test_the_rule_that_fails_first_is_counted_by_level_and_restraint() -> None:
    labels = [
        label(0, "fail"),
        label(1, "fail", first_rule="elastic", weight=3.0),
        label(2, "fail", first_rule="elastic", factors={"sled.level_g": 0.8}, first_package="film"),
        label(3, "fail", first_rule=None, factors={"sled.level_g": 0.8}),
        # Neither counts: the one passes, the other settles nothing.
        label(4),
        label(5, "unresolved", first_rule="damage"),
    ]
    found = statistics(*labels)
    rows = {(row.group, row.value, row.rule): row for row in found.first_rules}
    assert {rule: row.fails for (group, _, rule), row in rows.items() if group == "all"} == {
        "permanent": 1, "elastic": 2, "other": 1,
    }  # fmt: skip
    half = rows["sled.level_g", "0.5", "elastic"]
    assert (half.fails, half.share, half.weighted_share) == (1, 0.5, 0.75)
    assert rows["restraint", "none", "elastic"].fails == 2
    elastic = next(place for place in found.places if place.rule == "elastic")
    assert elastic.places == (("film", 1), ("package", 1))
    assert elastic.height_share is not None and elastic.height_share.median == pytest.approx(0.5)
    assert elastic.packages == (("eur_columns", "film", 1), ("eur_columns", "p1", 1))


def test_margins_errors_and_outliers() -> None:
    close = replace(label(3), worst_mm={"permanent": 68.0}, margin_mm={"permanent": 2.0}, error_mm={"permanent": 3.0},
                    states={"permanent": "unresolved"}, verdict="unresolved")  # fmt: skip
    hopeless = label(4, "fail", worst_mm={"permanent": 700.0}, margin_mm={"permanent": -630.0},
                     error_mm={"permanent": 300.0})  # fmt: skip
    ended = label(5, "unresolved", ended_by="ended by monitor 'speed'", worst_mm={"permanent": 70.0},
                  margin_mm={"permanent": 0.0})  # fmt: skip
    found = statistics(
        *(label(k, penetration_mm=float(k)) for k in (6, 0, 1, 2, 7, 8)), close, hopeless, ended
    )
    (permanent,) = found.margins
    assert (permanent.share.tests, permanent.near, permanent.inside_error) == (8, 1, 1)
    assert permanent.share.largest == pytest.approx(10.0)
    assert closest_limit(close) == ("permanent", pytest.approx(2 / 70)) and found.near == 1
    lists = {
        kind: [row for row in found.outliers if row.kind == kind]
        for kind in {row.kind for row in found.outliers}
    }
    assert all(len(rows) <= 5 for rows in lists.values())
    assert lists["near_limit"][0].number == 3 and lists["near_limit"][0].bag == "tests/00003/bag"
    # A load that is 630 mm beyond its limit, give or take 300 mm, is no matter of its error.
    assert [row.number for row in lists["error"]] == [3, 0, 1, 2, 6]
    assert [row.number for row in lists["penetration"]] == [8, 7, 6, 2, 1]
    assert [row.number for row in lists["ended"]] == [5] and "speed" in lists["ended"][0].told
    assert [row.told for row in lists["estimate_decides"]] == [
        "pass by the poses alone, unresolved with the estimate"
    ]
    assert found.outlier_counts == {"ended": 1, "estimate_decides": 1}


def forty_labels() -> list[Label]:
    source = np.random.default_rng(2)
    labels = []
    for number in range(40):
        level, restraint = (0.3, 0.5, 0.8)[number % 3], ("none", "<b>fields", "film")[number % 4 % 3]
        verdict = "pass" if source.random() > level else "fail"
        labels.append(
            label(number, verdict, weight=0.5 + source.random(), penetration_mm=float(source.random()),
                  first_package="<i>p", factors={"sled.level_g": level, "restraint": restraint})
        )  # fmt: skip
    return labels


def test_the_same_labels_give_the_same_page_and_costs_stay_in_their_section() -> None:
    labels = forty_labels()
    costs = {one.number: Cost(2.0, 1.5, 1.2, 0.8, "w") for one in labels}
    found = statistics(*labels)
    assert statistics(*reversed(labels)).rates == found.rates
    page = statistics_page(found, labels, campaign(), refused={"<why>": 2}, costs=costs)
    assert page == statistics_page(found, labels, campaign(), refused={"<why>": 2}, costs=costs)
    slower = {number: replace(cost, wall_s=9.0) for number, cost in costs.items()}
    other = statistics_page(found, labels, campaign(), refused={"<why>": 2}, costs=slower)
    physical, _, took = page.partition(f"<h2>{COST_TITLE}</h2>")
    assert other != page and other.partition(f"<h2>{COST_TITLE}</h2>")[0] == physical
    assert "1.3 min" in took and "40 %" in took.replace("\u00a0", " ")
    for name in ("<b>fields", "<i>p", "<why>"):
        assert name not in page and name.replace("<", "&lt;").replace(">", "&gt;") in page
    assert page.count("<svg") > 10 and "http://" not in page.replace("http://www.w3.org", "")
    assert 'href="tests/' in physical and "pallet-twin view tests/" in physical
    # A campaign in which nothing is settled, or nothing was timed, has a page too.
    for few in ([label(0, "unresolved", error_mm={})], [label(0)], [label(0, "fail", ended_by="speed")]):
        assert COST_TITLE in statistics_page(statistics(*few), few, campaign(), refused={}, costs={})


def test_cost_is_summed_by_restraint_and_packages() -> None:
    labels = [label(0), label(1, packages=60), label(2)]
    costs = {0: Cost(4.0, 3.0, 1.0, 3.0, "a"), 1: Cost(2.0, 2.0, 1.0, 1.0, "b")}
    rows = {
        (row.group, row.value): row for row in cost_rows(labels, costs, campaign_groups(labels, campaign()))
    }
    everything = rows["all", "all"]
    assert (everything.tests, everything.wall_total_s, everything.process_total_s) == (2, 6.0, 5.0)
    assert everything.estimate_share == pytest.approx(4 / 6) and everything.real_time_factor == pytest.approx(
        2.0
    )
    assert rows["packages", "21 to 50"].wall_s.largest == 4.0 and rows["packages", "51 to 100"].tests == 1
    assert rows["restraint", "none"].wall_s.median == 3.0


def campaign_folder(folder: Path, labels: list[Label]) -> Path:
    folder.mkdir()
    told = {"format": 1, "campaign": json.loads(campaign().to_json()), "versions": {}}
    (folder / "campaign.json").write_text(json.dumps(told))
    for one in labels:
        (folder / "tests" / f"{one.number:05d}").mkdir(parents=True)
        (folder / "tests" / f"{one.number:05d}" / "label.json").write_text(one.to_json())
    costs = [{"number": one.number, **vars(Cost(2.0, 1.5, 1.2, 0.8, "w"))} for one in labels]
    if costs:
        write_parquet(table_of(costs), folder / "costs.parquet")
    (folder / "refused.json").write_text(json.dumps([{"number": 9, "factors": {}, "reason": "too high"}]))
    return folder


def test_the_command_writes_page_and_table_and_shows_them(tmp_path: Path) -> None:
    campaign_folder(tmp_path / "out", forty_labels())
    done = pallet_twin("statistics", "out", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "fails first by: permanent" in done.stdout and "out/statistics.html" in done.stdout
    written = [(tmp_path / "out" / name).read_bytes() for name in ("statistics.html", "statistics.parquet")]
    _, entry = write_statistics(tmp_path / "out")
    assert written == [
        (tmp_path / "out" / name).read_bytes() for name in ("statistics.html", "statistics.parquet")
    ]
    table = pq.read_table(tmp_path / "out" / "statistics.parquet").to_pylist()
    assert table[0] == entry["rates"][0] and table[0]["group"] == "all" and table[0]["tests"] == 40
    assert {
        "group",
        "value",
        "tests",
        "passes",
        "fails",
        "unresolved",
        "rate",
        "low",
        "high",
        "weighted_rate",
    } <= set(table[0])
    assert entry["refused"] == {"too high": 1} and entry["costs"][0]["tests"] == 40
    json.dumps(entry, allow_nan=False)


def test_what_is_no_campaign_is_refused_in_one_line(tmp_path: Path) -> None:
    done = pallet_twin("statistics", "nowhere", cwd=tmp_path)
    assert done.returncode == 2 and done.stdout == ""
    assert done.stderr.count("\n") == 1 and "pallet-twin campaign" in done.stderr
    empty, begun = tmp_path / "empty", campaign_folder(tmp_path / "begun", [])
    empty.mkdir()
    for folder in (empty, begun):
        with pytest.raises(RefusedInput, match="pallet-twin campaign"):
            write_statistics(folder)
        assert not list(folder.glob("statistics*"))
    for name, damage in (("costs.parquet", "no table"), ("refused.json", "[1]"), ("campaign.json", "{")):
        folder = campaign_folder(tmp_path / name, [label(0)])
        (folder / name).write_text(damage)
        with pytest.raises(RefusedInput, match=name):
            write_statistics(folder)
