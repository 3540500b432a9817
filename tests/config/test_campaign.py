"""Campaign files: what can be said in them, and what is refused in one line."""

import json

import pytest

from config.campaign import Range, campaign_from_raw, read_campaign
from config.errors import RefusedInput
from config.shipped import CAMPAIGNS

SCENE = {"name": "x", "load": {}, "sled": {"profile": "eumos", "level_g": 0.5}}


def raw(**changes):
    return {
        "name": "try",
        "tests": 4,
        "scene": SCENE,
        "loads": [{"file": "eur_brick_600x400.pally.json"}],
        **changes,
    }


def test_shipped_campaigns_are_read():
    assert CAMPAIGNS.names() == ["paper", "smoke"]
    paper = read_campaign(CAMPAIGNS.find("paper"))
    assert paper.tests == 1500
    assert paper.balance is not None and paper.balance.success_share == pytest.approx(1 / 3, abs=1e-4)
    assert len({load.scheme_name for load in paper.loads}) >= 20
    pictures = paper.vary["camera.pictures"]
    assert isinstance(pictures, Range) and (pictures.low, pictures.high) == (60.0, 70.0)
    assert read_campaign(CAMPAIGNS.find("smoke")).tests == 8


def test_ranges_reach_their_ends_and_stay_inside():
    linear = Range.model_validate({"from": 0.35, "to": 0.5})
    assert linear.at([0.0]) == 0.35 and linear.at([1.0 - 1e-16]) == 0.5
    assert linear.at([1.0 / 3.0]) == 0.4
    log = Range.model_validate({"from": 0.01, "to": 100.0, "scale": "log"})
    assert log.at([0.5]) == 1.0 and log.at([0.25]) == 0.1
    whole = Range.model_validate({"from": 60, "to": 70, "whole": True})
    assert [whole.at([k / 11.0 + 1e-9]) for k in range(11)] == list(range(60, 71))
    vector = Range.model_validate({"from": [0, 1], "to": [1, 3]})
    assert vector.dimension == 2 and vector.at([0.5, 0.25]) == [0.5, 1.5]


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"tests": None}, "tests must say how many"),
        ({"mode": "grid"}, "tests must be absent"),
        ({"mode": "list", "tests": None}, "cases must hold the tests"),
        ({"mode": "grid", "tests": None, "balance": {}}, "balance must be absent"),
        ({"mode": "grid", "tests": None, "vary": {"a": {"from": 0, "to": 1}}}, "vary.a must be a list"),
        ({"mode": "grid", "tests": None, "layouts": ["random"]}, "layouts must not hold random"),
        ({"vary": {"sled.level_g": {"from": 1, "to": 0}}}, "must be at most"),
        ({"vary": {"sled.level_g": {"from": 0, "to": 1, "scale": "log"}}}, "above 0 on a log scale"),
        ({"vary": {"sled.level_g": []}}, "at least 1 item"),
        ({"vary": {"a": {"from": [0, 1], "to": [1, 2, 3]}}}, "vectors of one length"),
        ({"friction": {"cardboard": [0.5]}}, "must be two surfaces"),
        ({"loads": []}, "at least 1 item"),
        ({"loads": [{"file": "a"}, {"file": "a"}]}, "a stands twice"),
        ({"layouts": ["sideways"]}, "'as_filed', 'turned', 'mirrored' or 'random'"),
        ({"test": 4}, "unknown key"),
    ],
)
def test_what_cannot_be_is_refused(changes, told):
    with pytest.raises(RefusedInput) as refused:
        campaign_from_raw(raw(**changes))
    assert told in str(refused.value) and "\n" not in str(refused.value)


def test_a_file_is_read_with_overrides(tmp_path):
    path = tmp_path / "c.json"
    path.write_text(json.dumps(raw()))
    assert read_campaign(path, ["tests=9", 'vary={"sled.level_g":[0.3]}']).tests == 9
    path.write_text('{"name": "try", "name": "other"}')
    with pytest.raises(RefusedInput, match="stands twice"):
        read_campaign(path)
    with pytest.raises(RefusedInput, match="shipped: paper, smoke"):
        CAMPAIGNS.find("nothing")
