"""The material library: every figure has a source, every name is known, every pair stands once."""

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from config.materials import FilmKind, MaterialLibrary, material_library

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


def test_every_figure_of_a_film_has_a_source_of_its_own() -> None:
    words = {"described", "surface", "look", "around", "sources"}
    for name, film in LIBRARY.films.items():
        figures = {figure for figure, value in film if figure not in words and value is not None}
        assert figures == set(film.sources), name
        assert all(source.strip() for source in film.sources.values())
        assert film.surface in LIBRARY.surfaces


def test_a_film_has_a_friction_on_all_that_is_wrapped_and_on_itself() -> None:
    for film in LIBRARY.films.values():
        for surface in ("cardboard", "wood", "plastic", "anti_slip", "shrink_film", film.surface):
            assert LIBRARY.pair(film.surface, surface) is not None, surface


def test_films_are_as_thick_and_heavy_as_their_names_say() -> None:
    for name, micrometres in [("stretch_film_12", 12), ("stretch_film_17", 17), ("stretch_film_20", 20),
                              ("stretch_film_23", 23), ("hood_100", 100)]:  # fmt: skip
        assert LIBRARY.films[name].gauge_m == pytest.approx(micrometres * 1e-6)
    paper = LIBRARY.films["kraft_80"]
    assert paper.gauge_m * paper.density_kgpm3 == pytest.approx(0.080, rel=0.01)
    assert paper.yield_stress_pa is None
    # No film is wound tighter than it bears, and none comes off the roll broken.
    assert all(0.0 <= film.pre_stretch < film.break_strain_around for film in LIBRARY.films.values())


def test_a_film_is_like_another_but_for_what_it_says() -> None:
    thick, thin = LIBRARY.films["stretch_film_20"], LIBRARY.films["stretch_film_12"]
    differ = {"described", "gauge_m", "wrap_force_n", "sources"}
    assert {field for field, value in thin if value != getattr(thick, field)} == differ
    assert thin.sources["yield_stress_pa"] == thick.sources["yield_stress_pa"]


@pytest.mark.parametrize(
    ("change", "limit"),
    [
        ({"modulus_md_pa": -1.0}, "greater than 0"),
        ({"gauge_m": 20.0}, "less than or equal to 0.001"),
        ({"yield_strain": None}, "figures and sources differ: yield_strain"),
        ({"sources": {}}, "figures and sources differ"),
        ({"poisson": 1.1}, "poisson² must be less than"),
        ({"relaxation": float("nan")}, "finite|less than or equal"),
        ({"smell": "waxy"}, "smell"),
    ],
)
def test_a_film_that_cannot_be_is_refused(change: dict[str, object], limit: str) -> None:
    film = LIBRARY.films["stretch_film_20"].model_dump()
    with pytest.raises(ValueError, match=limit):
        FilmKind.model_validate({**film, **change})
    halved = {
        **film,
        "yield_strain": None,
        "sources": {k: v for k, v in film["sources"].items() if k != "yield_strain"},
    }
    with pytest.raises(ValueError, match="stand together or not at all"):
        FilmKind.model_validate(halved)


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
