"""What a campaign draws: the same for the same seed, inside its ranges, and balanced without bending anything."""

import numpy as np
import pytest

from config.campaign import campaign_from_raw
from config.errors import RefusedInput
from recordings.campaigns.balance import DrawOrder
from recordings.campaigns.drafts import Draft, Drafts, RefusedDraft

SCENE = {
    "name": "x",
    "load": {},
    "sled": {"profile": "eumos", "level_g": 0.5},
    "solver": {"engine": "bullet"},
}
BRICK = "eur_brick_600x400.pally.json"


def drafts(base, **changes):
    raw = {"name": "try", "tests": 40, "seed": 3, "scene": SCENE, "loads": [{"file": BRICK}], **changes}
    if raw.get("mode", "random") != "random":
        raw.pop("tests")
    return Drafts(campaign_from_raw(raw), base)


def made(draft):
    assert isinstance(draft, Draft), draft
    return draft


VARIED = {
    "layouts": ["as_filed", "turned", "mirrored", "random"],
    "vary": {"sled.level_g": [0.3, 0.5], "sled.plateau_s": {"from": 0.35, "to": 0.5}},
    "friction": {"cardboard/wood": {"from": 0.3, "to": 0.6}},
    "mass_factor": {"from": 0.5, "to": 2.0},
    "restraints": [
        {"name": "loose"},
        {"name": "fields", "vary": {"force_fields.tension": {"from": 0.1, "to": 10.0, "scale": "log"}}},
    ],
}


def test_a_number_is_the_same_test_whatever_was_drawn_before(tmp_path):
    one, other = drafts(tmp_path, **VARIED), drafts(tmp_path, **VARIED)
    late = made(one.draft(33))
    for number in (5, 33, 7):
        again = made(other.draft(number))
    assert made(other.draft(33)).scene.to_json() == late.scene.to_json()
    assert again.number == 7
    elsewhere = made(drafts(tmp_path, **VARIED, seed=4).draft(33))
    assert elsewhere.factors != late.factors


def test_scenes_have_what_was_drawn(tmp_path):
    filed = {p.id: p for p in made(drafts(tmp_path).draft(0)).scene.packages}
    for number in range(12):
        draft = made(drafts(tmp_path, **VARIED).draft(number))
        scene, factors = draft.scene, draft.factors
        assert scene.sled.level_g == factors["sled.level_g"] and 0.35 <= scene.sled.plateau_s <= 0.5
        pair = next(pair for pair in scene.surfaces.pairs if set(pair.between) == {"cardboard", "wood"})
        assert pair.friction == factors["friction cardboard/wood"]
        assert max(package.layer for package in scene.packages) == factors["layers"] in (4, 5)
        assert (scene.force_fields is not None) == (factors["restraint"] == "fields")
        heavier = scene.packages[0].mass_kg / filed[scene.packages[0].id].mass_kg
        assert heavier == pytest.approx(factors["mass_factor"], rel=1e-4)
        second = {
            package.layer for package in scene.packages if package.position_m != filed[package.id].position_m
        }
        expected = {"as_filed": set(), "turned": {2, 4}, "mirrored": {2, 4}}
        assert factors["layout"] == "random" or second <= expected[factors["layout"]]


def test_draws_fill_their_ranges_evenly(tmp_path):
    many = drafts(tmp_path, **VARIED)
    plateaus = np.sort([many.factors(k)["sled.plateau_s"] for k in range(256)])
    # A Sobol sequence of 2^8 points puts one into each of 256 cells, but for four digits.
    assert np.abs(plateaus - (0.35 + 0.15 * (np.arange(256) + 0.5) / 256)).max() < 0.15 / 256
    tensions = [many.factors(k).get("force_fields.tension") for k in range(256)]
    held = [tension for tension in tensions if tension is not None]
    assert len(held) == pytest.approx(128, abs=2)
    assert np.median(held) == pytest.approx(1.0, rel=0.15)


def test_a_grid_makes_every_combination_once(tmp_path):
    grid = drafts(
        tmp_path,
        mode="grid",
        loads=[{"file": BRICK, "layers": [3, 4]}, {"file": "eur_tower_300x200.pally.json", "layers": [4, 4]}],
        layouts=["as_filed", "turned"],
        vary={"sled.level_g": [0.3, 0.8]},
        restraints=[{"name": "loose"}, {"name": "fields", "vary": {"force_fields.tension": [1, 2]}}],
    )
    assert grid.count == 3 * 2 * (1 + 2) * 2
    factors = [
        tuple(sorted((k, str(v)) for k, v in made(grid.draft(n)).factors.items())) for n in range(grid.count)
    ]
    assert len(set(factors)) == grid.count


def test_a_list_makes_its_cases(tmp_path):
    listed = drafts(
        tmp_path,
        mode="list",
        cases=[{"layers": 2, "sled.level_g": 0.4}, {"layout": "turned", "mass_factor": 2.0}],
    )
    first, second = made(listed.draft(0)), made(listed.draft(1))
    assert first.scene.sled.level_g == 0.4 and first.factors["layers"] == 2
    assert second.factors["layout"] == "turned" and second.factors["layers"] == 5
    with pytest.raises(RefusedInput, match=r"cases\.0\.load = nowhere"):
        drafts(tmp_path, mode="list", cases=[{"load": "nowhere"}])


def test_a_bad_file_is_named_and_the_others_are_drawn(tmp_path):
    (tmp_path / "bad.json").write_text('{"productDimensions": 3}')
    some = drafts(tmp_path, loads=[{"file": BRICK}, {"file": "bad.json"}, {"file": "missing.xml"}])
    assert set(some.bad_loads) == {"bad.json", "missing.xml"}
    kinds = {draft.factors["scheme"]: type(draft) for draft in map(some.draft, range(20))}
    assert kinds == {"eur_brick_600x400": Draft, "bad": RefusedDraft, "missing": RefusedDraft}
    with pytest.raises(RefusedInput):
        drafts(tmp_path, loads=[{"file": "bad.json"}])


def test_a_layout_that_would_leave_a_package_in_the_air_falls_back(tmp_path):
    mixed = drafts(tmp_path, loads=[{"file": "eur_mixed_halves.nist.xml"}], layouts=["turned"])
    assert made(mixed.draft(0)).factors["layout"] == "as_filed"


def outcomes_of(order, rounds, size, passes):
    """Runs rounds against a law that stands in for physics: what passes depends on the draw alone."""
    found, weights = [], []
    for _ in range(rounds):
        stream = order.round(found)
        new = [next(stream) for _ in range(size)]
        found += [(order._drafts.factors(number), passes(number)) for number, _ in new]
        weights += [weight for _, weight in new]
    return found, np.array(weights)


@pytest.mark.parametrize(("natural", "wanted"), [(0.12, 1 / 3), (0.7, 1 / 3)])
def test_a_balance_reaches_its_share_and_the_weights_lead_back(tmp_path, natural, wanted):
    campaign = {
        **VARIED,
        # Two files of one scheme, and a value that is said twice.
        "loads": [{"file": BRICK}, {"file": "eur_tower_300x200.pally.json", "scheme": "eur_brick_600x400"}],
        "layouts": ["as_filed", "turned"],
        "mass_factor": None,
        "tests": 600,
        "vary": {"sled.level_g": {"from": 0.3, "to": 0.8}, "camera.background": ["hall", "hall", "plain"]},
        "balance": {"success_share": wanted, "round": 100},
    }
    some = drafts(tmp_path, **campaign)

    def passes(number):
        factors = some.factors(number)
        # Chance decides a little, too: a test is never foreseen for sure.
        luck = np.random.default_rng((9, number)).normal(0.0, 0.03)
        return bool((factors["sled.level_g"] - 0.3) / 0.5 + luck < natural)

    found, weights = outcomes_of(DrawOrder(some), 6, 100, passes)
    success = np.array([outcome for _, outcome in found])
    assert success.mean() == pytest.approx(wanted, abs=0.05)
    # Weighted back the rate is that of the ranges, within three standard errors of the draws.
    back = (success * weights).sum() / weights.sum()
    assert back == pytest.approx(natural, abs=0.06)
    again, _ = outcomes_of(DrawOrder(drafts(tmp_path, **campaign)), 6, 100, passes)
    assert again == found


def test_without_a_balance_every_draw_is_a_test(tmp_path):
    stream = DrawOrder(drafts(tmp_path)).round([])
    assert [next(stream) for _ in range(5)] == [(k, 1.0) for k in range(5)]
