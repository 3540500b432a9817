"""Pair frictions as products of factors: exact where they can be, named where they cannot."""

import math
from collections.abc import Mapping
from itertools import combinations_with_replacement

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from config.scene_file import find_scene, friction_table, read_scene
from sim_core.friction import FrictionFactors, friction_factors

Table = dict[frozenset[str], float]
# Logarithms of μ from 1e-2 to 1e1 are below 5; solved with weights 1 and 1e-3 they keep 1e-16 · 5 · 1e3.
SOLVED = 1.0e-9


def product(found: FrictionFactors, pair: frozenset[str]) -> float:
    first, second = (sorted(pair) * 2)[:2]
    return found.factors[first] * found.factors[second]


def assert_met(
    table: Mapping[frozenset[str], float], touching: frozenset[frozenset[str]] = frozenset()
) -> None:
    found = friction_factors(table, touching=touching)
    assert found.unmet == ()
    for pair, friction in table.items():
        assert product(found, pair) == pytest.approx(friction, rel=SOLVED)


def test_no_pairs_need_no_factors() -> None:
    assert friction_factors({}) == FrictionFactors({}, ())


def test_one_surface_on_itself_and_on_two_grounds() -> None:
    assert_met({frozenset({"c"}): 0.5, frozenset({"c", "wood"}): 0.4, frozenset({"c", "sled"}): 0.3})


@given(frictions=st.lists(st.floats(0.01, 10.0), min_size=1, max_size=12))
@settings(max_examples=60, deadline=None)
def test_a_chain_of_surfaces_is_always_met(frictions: list[float]) -> None:
    assert_met({frozenset({f"f{k}", f"f{k + 1}"}): mu for k, mu in enumerate(frictions)})


def test_the_shipped_slabs_are_met() -> None:
    table = friction_table(read_scene(find_scene("slabs")))
    assert sorted(table.values()) == [0.1, 0.2, 0.3, 0.4, 0.5]
    assert_met(table, frozenset(table))


@settings(max_examples=60, deadline=None)
@given(
    factors=st.dictionaries(st.sampled_from("abcdef"), st.floats(0.1, 3.0), min_size=1),
    chosen=st.integers(0, 2**21 - 1),
    standing=st.integers(0, 2**21 - 1),
)
def test_products_come_back(factors: dict[str, float], chosen: int, standing: int) -> None:
    pairs = list(combinations_with_replacement(sorted(factors), 2))
    table = {frozenset(p): factors[p[0]] * factors[p[1]] for k, p in enumerate(pairs) if chosen >> k & 1}
    touching = frozenset(frozenset(p) for k, p in enumerate(pairs) if standing >> k & 1)
    assert_met(table, touching)


def test_pairs_that_cannot_be_met_are_named() -> None:
    """Like on like 0.5 and the mixed pair 0.1 ask for c_a² = c_b² = 0.5 and c_a·c_b = 0.1 at once."""
    a, b, mixed = frozenset({"a"}), frozenset({"b"}), frozenset({"a", "b"})
    found = friction_factors({a: 0.5, b: 0.5, mixed: 0.1}, touching={mixed})
    # Weights of 1 and 1e-3: the normal equations leave the touching pair 2·1e-6·ln(5) away, in relative terms.
    assert product(found, mixed) == pytest.approx(0.1, rel=2.2e-6 * math.log(5.0))
    assert [(u.pair, u.wanted, u.touching) for u in found.unmet] == [
        (("a", "a"), 0.5, False),
        (("b", "b"), 0.5, False),
    ]
    assert [u.used for u in found.unmet] == [product(found, a), product(found, b)]

    standing = friction_factors({a: 0.5, b: 0.5, mixed: 0.1}, touching={a, b})
    assert [(u.pair, u.touching) for u in standing.unmet] == [(("a", "b"), False)]
    assert standing.unmet[0].used == pytest.approx(0.5, rel=1.0e-5)


def test_a_pair_that_is_touching_and_unmet_says_so() -> None:
    """Three ways into two numbers: all touch, so the error is spread evenly and every pair is named."""
    table = {frozenset({"a"}): 0.5, frozenset({"b"}): 0.5, frozenset({"a", "b"}): 0.1}
    found = friction_factors(table, touching=set(table))
    assert [(u.pair, u.touching) for u in found.unmet] == [
        (("a", "a"), True), (("a", "b"), True), (("b", "b"), True)
    ]  # fmt: skip


def test_no_friction_becomes_next_to_none() -> None:
    found = friction_factors({frozenset({"ice", "sled"}): 0.0, frozenset({"ice"}): 0.5})
    assert product(found, frozenset({"ice", "sled"})) < 1.0e-8
    assert product(found, frozenset({"ice"})) == pytest.approx(0.5, rel=SOLVED)
    assert found.unmet == ()


def test_the_order_of_a_table_changes_nothing() -> None:
    table: Table = {frozenset({"a", "b"}): 0.3, frozenset({"b", "c"}): 0.2, frozenset({"a"}): 0.7}
    backwards = dict(reversed(table.items()))
    assert friction_factors(table) == friction_factors(backwards)
