"""The material library: every figure has a source, every name is known, every pair stands once."""

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from config.materials import MaterialLibrary, material_library

LIBRARY = material_library()
names = st.sampled_from(sorted(LIBRARY.surfaces))


def test_pairs_name_known_surfaces_and_stand_once() -> None:
    pairs = [frozenset(pair.between) for pair in LIBRARY.pairs]
    assert set().union(*pairs) <= set(LIBRARY.surfaces)
    assert len(set(pairs)) == len(pairs)


def test_every_figure_has_a_source() -> None:
    assert all(pair.source.strip() for pair in LIBRARY.pairs)
    assert all(kind.source.strip() for kind in LIBRARY.pallets.values())
    assert all(description.strip() for description in LIBRARY.surfaces.values())


def test_frictions_are_those_of_goods_on_goods() -> None:
    assert all(0.0 < pair.friction <= 1.0 for pair in LIBRARY.pairs)


@given(first=names, second=names)
def test_a_pair_is_the_same_in_either_order(first: str, second: str) -> None:
    found = LIBRARY.pair(first, second)
    assert found == LIBRARY.pair(second, first)
    if found is not None:
        assert set(found.between) == {first, second}


def test_figures_of_the_ctu_code_and_of_the_euro_pallet() -> None:
    for first, second, friction in [
        ("cardboard", "cardboard", 0.5),
        ("wood", "cardboard", 0.5),
        ("wood", "plywood", 0.45),
    ]:
        pair = LIBRARY.pair(first, second)
        assert pair is not None
        assert pair.friction == friction
        assert "CTU Code" in pair.source
    pallet = LIBRARY.pallets["epal1"]
    assert pallet.size_m == (1.2, 0.8, 0.144)
    assert (pallet.mass_kg, pallet.safe_load_kg, pallet.surface) == (25.0, 1500.0, "wood")


def test_what_may_stand_on_the_sled_has_a_friction_there() -> None:
    for surface in ("cardboard", "shrink_film", "anti_slip", "wood", "plastic"):
        assert LIBRARY.pair(surface, "sled") is not None


def test_unknown_pairs_are_none_and_the_library_is_read_once() -> None:
    assert LIBRARY.pair("cardboard", "cheese") is None
    assert material_library() is LIBRARY


def test_unknown_keys_are_refused() -> None:
    raw = json.loads(LIBRARY.model_dump_json())
    raw["pairs"][0]["sauce"] = "x"
    with pytest.raises(ValueError, match="sauce"):
        MaterialLibrary.model_validate(raw)
