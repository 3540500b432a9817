"""The wrap as configuration: what it refuses, what a layer of film does, how layers lie, and what the check says."""

import json
import math
import subprocess
import sys
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from config.errors import RefusedInput
from config.materials import material_library
from config.scene import Scene
from config.scene_file import find_scene, read_scene, scene_from_json, shipped_scenes, validate_scene
from config.wrap import FilmLaw, Turns, Wrap, film_properties, film_span, layers_at
from sim_core.integrity import Finding, check_integrity

FILM = {"material": "stretch_film_20", "turns": 3}
NAN, INF = math.nan, math.inf


def box(name: str, bottom: float = 0.144, **other: Any) -> dict[str, Any]:
    place = [0.0, 0.0, bottom + 0.125]
    return {"id": name, "size_m": [0.4, 0.3, 0.25], "mass_kg": 10, "position_m": place, **other}


def raw(*packages: dict[str, Any], wrap: Any = None, **parts: Any) -> dict[str, Any]:
    load = {"packages": packages or [box("a"), box("b", bottom=0.394)]}
    return {"name": "t", "load": load, "sled": {"profile": "eumos", "level_g": 0.5}, "wrap": wrap, **parts}


def scene(**wrap: Any) -> Scene:
    return validate_scene(raw(wrap={**FILM, **wrap}))


def findings(scene: Scene) -> list[tuple[str, str, str]]:
    return [
        (f.severity, f.subject, f.value) for f in check_integrity(scene) if f.check in ("wrap", "friction")
    ]


REFUSED: list[tuple[dict[str, Any], str, str]] = [
    ({"turns": -1}, "wrap.turns = -1", "greater than or equal to 0"),
    ({"turns": NAN}, "wrap.turns = nan", "greater than or equal to 0|finite"),
    ({"turns": INF}, "wrap.turns = inf", "finite"),
    ({"turns": "three"}, "wrap.turns = three", "number"),
    ({"turns": True}, "wrap.turns = True", "number"),
    ({"turns": None}, "wrap.turns", "number"),
    ({"turns": {}}, "wrap.turns = {0 keys}", "bottom, middle or top"),
    ({"turns": {"bottom": 2, "middle": -1}}, "wrap.turns.middle = -1", "greater than or equal to 0"),
    ({"turns": {"under": 2}}, "wrap.turns.under = 2", "unknown key"),
    ({"material": "cling"}, "wrap.material = cling", "unknown film; known: hood_100, kraft_80, stretch_film_12"),
    ({"colour": "red"}, "wrap.colour = red", "unknown key"),
    ({"coupling": "both"}, "wrap.coupling = both", "'two_way' or 'one_way'"),
    ({"overlap": 1.0}, "wrap.overlap = 1.0", "less than or equal to 0.95"),
    ({"web_width_m": 500}, "wrap.web_width_m = 500", "less than or equal to 3"),
    ({"pre_stretch": -0.1}, "wrap.pre_stretch = -0.1", "greater than or equal to 0"),
    ({"pre_stretch": NAN}, "wrap.pre_stretch = nan", "greater than or equal to 0|finite"),
    ({"pre_stretch": 5.9}, "wrap.pre_stretch = 5.9", "less than 5.9, the break strain of stretch_film_20"),
    ({"pre_stretch": 200}, "wrap.pre_stretch = 200", "is it given in percent?"),
    ({"material": "kraft_80", "pre_stretch": 0.5}, "wrap.pre_stretch = 0.5", "must be 0: kraft_80 does not yield"),
    ({"wrap_force_n": -1}, "wrap.wrap_force_n = -1", "greater than or equal to 0"),
    ({"wrap_force_n": 131}, "wrap.wrap_force_n = 131", r"at most 129\.8 N, where 500 mm of .* is drawn further"),
    ({"material": "kraft_80", "wrap_force_n": 3000}, "wrap.wrap_force_n = 3000", r"at most 2964 N, .* breaks"),
    ({"relaxation": 1.01}, "wrap.relaxation = 1.01", "less than or equal to 1"),
    ({"height_m": 0}, "wrap.height_m = 0", "greater than 0"),
    ({"pallet_overlap_m": 100}, "wrap.pallet_overlap_m = 100", "less than or equal to 1"),
    ({"top_overlap_m": -1}, "wrap.top_overlap_m = -1", "greater than or equal to 0"),
    ({"friction": INF}, "wrap.friction = inf", "finite"),
    ({"spacing_m": 0}, "wrap.spacing_m = 0", "greater than or equal to 0.005"),
    ({"tear": "yes"}, "wrap.tear = yes", "boolean"),
]  # fmt: skip


@pytest.mark.parametrize(("change", "start", "limit"), REFUSED)
def test_a_wrap_that_cannot_be_is_refused_by_field_value_and_limit(
    change: dict[str, Any], start: str, limit: str
) -> None:
    with pytest.raises(RefusedInput, match=limit) as caught:
        scene(**change)
    assert str(caught.value).startswith(start)
    assert "\n" not in str(caught.value)


def test_material_and_turns_are_required() -> None:
    for key in FILM:
        rest = {name: value for name, value in FILM.items() if name != key}
        with pytest.raises(RefusedInput, match=rf"wrap\.{key} = missing: is required"):
            validate_scene(raw(wrap=rest))


def test_a_scene_without_a_wrap_has_none_and_says_so() -> None:
    # The camera looks at a wrapped load.
    bare = [name for name in shipped_scenes() if "wrap" not in name.split("_") and name != "eur_camera"]
    assert len(bare) > 10
    for name in bare:
        shipped = read_scene(find_scene(name))
        assert shipped.wrap is None
        assert shipped.film is None
    assert json.loads(validate_scene(raw()).to_json())["wrap"] is None


@pytest.mark.parametrize("turns", [0, 0.0, {"bottom": 0}, {"bottom": 0, "middle": 0, "top": 0}])
def test_zero_turns_are_no_film(turns: Any) -> None:
    unwound = scene(turns=turns)
    assert unwound.wrap is not None
    assert unwound.film is None
    assert check_integrity(unwound) == check_integrity(validate_scene(raw()))


@pytest.mark.parametrize("turns", [2.5, {"bottom": 3, "middle": 2, "top": 2.5}])
def test_a_wrapped_scene_survives_its_json_and_the_command_line(turns: Any) -> None:
    wrapped = scene(turns=turns, pre_stretch=1.5, wrap_force_n=50, tear=False)
    assert scene_from_json(wrapped.to_json()) == wrapped
    assert scene_from_json(wrapped.to_json()).sha256 == wrapped.sha256
    overrides = [f"wrap={json.dumps(FILM)}", "wrap.turns=4", "wrap.pre_stretch=1.0"]
    over = read_scene(find_scene("eur_columns"), overrides)
    assert over.wrap == Wrap(material="stretch_film_20", turns=4.0, pre_stretch=1.0)


def test_a_layer_of_20_um_film_at_200_percent_in_figures() -> None:
    film = film_properties(Wrap(**FILM))
    assert film.thickness_m == pytest.approx(20e-6 / 3)
    assert film.around.stiffness_npm == pytest.approx(200e6 * 20e-6 / 3)
    assert film.up.stiffness_npm == pytest.approx(185e6 * 20e-6 / 3)
    # 60 N on half a metre, less 26 %.
    assert film.tension_npm == pytest.approx(88.8)
    assert film.strain == pytest.approx(88.8 / (200e6 * 20e-6 / 3))
    assert film.mass_kgpm2 == pytest.approx(920 * 20e-6 / 3)
    # The line from 9.75 MPa at 6.5 % to 19.5 MPa at 590 %, at 200 %, on the 20 µm of the roll.
    assert film.around.yield_force_npm == pytest.approx((9.75e6 + 9.75e6 / 5.835 * 1.935) * 20e-6)
    assert 10e6 < film.around.yield_force_npm / 20e-6 < 20e6
    assert film.around.break_force_npm == pytest.approx(19.5e6 * 20e-6)
    assert film.up.break_force_npm == pytest.approx(19.5e6 * film.thickness_m)
    assert film.friction_on("cardboard") == 0.4
    assert film.friction_on("wood") == 0.3
    with pytest.raises(RefusedInput, match=r"wrap\.friction = stretch_film_20 on steel: is not known"):
        film.friction_on("steel")


@pytest.mark.parametrize("name", sorted(material_library().films))
@given(pre_stretch=st.floats(0.0, 5.8))
@settings(max_examples=40, deadline=None)
def test_every_film_is_sound_whatever_its_pre_stretch(name: str, pre_stretch: float) -> None:
    kind = material_library().films[name]
    film = film_properties(
        Wrap(material=name, turns=1, pre_stretch=pre_stretch if kind.yield_stress_pa is not None else 0.0)
    )
    two_over_one = film.up.stiffness_npm / film.around.stiffness_npm
    # A strain energy that is positive: ν12·ν21 < 1.
    assert film.poisson**2 * two_over_one < 1.0
    assert 0.0 < film.shear_npm < 0.5 * max(film.around.stiffness_npm, film.up.stiffness_npm)
    # The usual wrap force neither draws nor breaks it, and what is left is less.
    assert kind.wrap_force_n / 0.5 < min(film.around.yield_force_npm, film.around.break_force_npm)
    assert film.tension_npm < kind.wrap_force_n / 0.5
    assert 0.0 < film.strain < film.around.break_strain
    for law in (film.around, film.up):
        assert 0.0 < law.hardening <= 1.0
        assert law.break_strain > 0.0
    if kind.break_stress_pa is not None:
        # Drawing by the machine takes nothing off the force at which it tears.
        assert film.around.break_force_npm == pytest.approx(kind.break_stress_pa * kind.gauge_m)


@given(first=st.floats(0.0, 5.7), more=st.floats(0.01, 0.1))
@settings(max_examples=60, deadline=None)
def test_more_pre_stretch_is_thinner_softer_and_yields_later(first: float, more: float) -> None:
    """Stretching twice is stretching once: the film gives way where the machine stopped."""
    less, plus = (film_properties(Wrap(**FILM, pre_stretch=s)) for s in (first, first + more))
    assert plus.thickness_m < less.thickness_m
    assert plus.around.stiffness_npm < less.around.stiffness_npm
    assert plus.around.yield_force_npm >= less.around.yield_force_npm * (1.0 - 1e-12)
    if first > 0.065:
        # Drawn on from n by dn, the first film stands on the second one's yield: its plastic strain is dn/n.
        plastic = more / (1.0 + first)
        rise = less.around.hardening * less.around.stiffness_npm * plastic
        assert plus.around.yield_force_npm == pytest.approx(less.around.yield_force_npm + rise)


def test_a_law_without_a_yield_is_straight() -> None:
    paper = film_properties(Wrap(material="kraft_80", turns=1))
    assert paper.around.yield_force_npm == INF
    assert paper.around.break_force_npm == pytest.approx(1.3e9 * 114e-6 * 0.04)
    # √(ν12·ν21) = 0.293 gives the known shear modulus of paper.
    assert paper.shear_npm == pytest.approx(0.387 * math.sqrt(1.3e9 * 0.35e9) * 114e-6, rel=2e-3)
    assert FilmLaw(1000.0, 100.0, 0.1, 1.1).break_force_npm == pytest.approx(100.0 + 0.1 * 1000.0 * 1.0)


def test_the_hood_stretches_across_its_machine_direction() -> None:
    hood, kind = film_properties(Wrap(material="hood_100", turns=1)), material_library().films["hood_100"]
    assert hood.around.stiffness_npm == pytest.approx(kind.modulus_td_pa * 100e-6)
    assert hood.up.stiffness_npm == pytest.approx(kind.modulus_md_pa * 100e-6)
    # ν21/E2 = ν12/E1, in the library's 1 = MD and in the film's 1 = around alike.
    assert hood.poisson / kind.modulus_td_pa == pytest.approx(kind.poisson / kind.modulus_md_pa)


def test_overrides_come_before_the_library_and_friction_from_the_scene() -> None:
    film = film_properties(Wrap(**FILM, wrap_force_n=100, relaxation=0.5, friction=0.2))
    assert film.tension_npm == pytest.approx(100.0)
    assert set(film.friction.values()) == {0.2}
    relaxed = film_properties(Wrap(**FILM, relaxation=1.0))
    assert (relaxed.tension_npm, relaxed.strain) == (0.0, 0.0)
    pairs = {"pairs": [{"between": ["cardboard", "stretch_film"], "friction": 0.7}]}
    named = validate_scene(raw(wrap=FILM, surfaces=pairs)).film
    assert named is not None
    assert (named.friction_on("cardboard"), named.friction_on("wood")) == (0.7, 0.3)


def test_containment_grows_with_turns_and_with_force() -> None:
    """Layers times tension: linear in the turns and in the wrap force (gap-co.com)."""

    def containment(turns: float, force: float) -> float:
        wrap = Wrap(material="stretch_film_17", turns=turns, wrap_force_n=force)
        return layers_at(wrap, 1.5, 0.7) * film_properties(wrap).tension_npm

    assert containment(6, 40) == pytest.approx(2 * containment(3, 40))
    assert containment(3, 80) == pytest.approx(2 * containment(3, 40))


def test_a_number_of_turns_lies_everywhere() -> None:
    wrap = Wrap(material="stretch_film_20", turns=2.5)
    assert [layers_at(wrap, 1.2, z) for z in (0.0, 0.6, 1.2)] == [2.5] * 3
    assert [layers_at(wrap, 1.2, z) for z in (-0.01, 1.21, NAN)] == [0.0] * 3


def test_a_machine_lays_ends_and_passes() -> None:
    """2 m of film, a 0.5 m web that rises 0.25 m a turn: two layers a pass, but within a web of the ends."""
    wrap = Wrap(material="stretch_film_20", turns=Turns(bottom=3.0, middle=2.0, top=1.0), overlap=0.5)
    heights = {
        0.0: 3.0,
        0.25: 3.0 + 2.0,
        0.5: 3.0 + 4.0,
        0.51: 4.0,
        1.0: 4.0,
        1.49: 4.0,
        1.5: 5.0,
        1.75: 3.0,
        2.0: 1.0,
    }
    assert {z: pytest.approx(layers_at(wrap, 2.0, z)) for z in heights} == heights


@given(
    height=st.floats(0.1, 3.0), web=st.floats(0.1, 1.0), overlap=st.floats(0.0, 0.9), ends=st.integers(0, 3)
)
@settings(max_examples=60, deadline=None)
def test_no_film_is_lost_or_made(height: float, web: float, overlap: float, ends: int) -> None:
    """Layers summed over the height are turns times web: the film that left the roll, per length around."""
    wrap = Wrap(
        material="stretch_film_20", turns=Turns(bottom=ends, middle=1.0), web_width_m=web, overlap=overlap
    )
    strip = height / 4000
    area = sum(layers_at(wrap, height, (i + 0.5) * strip) for i in range(4000)) * strip
    held = min(web, height)
    turns = ends + max(1.0, (height - held) / (held * (1.0 - overlap)))
    # Each of the bottom turns has an edge, which the sum meets within half a strip.
    assert area == pytest.approx(turns * held, rel=1e-3, abs=(ends + 11) * strip)


def test_where_the_web_covers_all_a_pass_is_one_turn() -> None:
    wrap = Wrap(material="stretch_film_20", turns=Turns(middle=2.0))
    for height in (0.2, 0.5, 0.5 + 1e-9):
        assert layers_at(wrap, height, height / 2) == pytest.approx(2.0)


def test_the_film_spans_from_pallet_to_top() -> None:
    def span(**other: Any) -> tuple[float, float]:
        return film_span(Wrap(**FILM, **other), deck_m=0.144, top_m=1.2)

    assert span() == (pytest.approx(0.044), 1.2)
    assert span(pallet_overlap_m=0.0, height_m=0.5) == (0.144, pytest.approx(0.644))
    assert span(pallet_overlap_m=0.5, height_m=5.0) == (0.0, 1.2)
    assert film_span(Wrap(**FILM), deck_m=0.0, top_m=1.0) == (0.0, 1.0)


def test_nothing_is_wrong_with_a_plain_wrap() -> None:
    for material in material_library().films:
        assert check_integrity(scene(material=material)) == []


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"coupling": "one_way"}, ("warning", "wrap.coupling", "one_way")),
        ({"pallet_overlap_m": 0}, ("note", "wrap.pallet_overlap_m", "0 m")),
        ({"pallet_overlap_m": 0.2}, ("note", "wrap.pallet_overlap_m", "0.2 m")),
        ({"height_m": 0.25}, ("warning", "b", "above the film's edge at 0.394 m")),
        ({"height_m": 0.4}, ("note", "wrap.height_m", "0.4 m")),
        ({"spacing_m": 0.3}, ("warning", "wrap.spacing_m", "0.3 m")),
        ({"turns": {"bottom": 2, "top": 2}, "web_width_m": 0.2}, ("warning", "wrap.turns", "no film between 0.25 m and 0.44 m")),
    ],
)  # fmt: skip
def test_what_is_remarkable_about_a_wrap_is_told(
    change: dict[str, Any], expected: tuple[str, str, str]
) -> None:
    assert findings(scene(**change)) == [expected]


def test_film_and_fields_hold_twice_and_one_way_film_may_be_held_by_fields() -> None:
    both = validate_scene(raw(wrap=FILM, force_fields={}))
    assert findings(both) == [("warning", "wrap.coupling", "two_way")]
    assert findings(validate_scene(raw(wrap={**FILM, "coupling": "one_way"}, force_fields={}))) == []


def test_a_wrapped_empty_pallet_is_an_empty_pallet() -> None:
    empty = validate_scene({**raw(wrap=FILM), "load": {"packages": []}})
    assert empty.film is None
    assert findings(empty) == [("warning", "the empty pallet", "stretch_film_20")]


def test_packages_on_the_sled_are_wrapped_without_a_pallet() -> None:
    assert findings(validate_scene(raw(box("a", bottom=0.0), wrap=FILM, pallet=None))) == [
        ("note", "the load", "has no pallet")
    ]


def test_friction_of_the_film_must_be_known_where_it_lies() -> None:
    metal = {"surface": "steel", "kind": "custom", "size_m": [1.2, 0.8, 0.144], "mass_kg": 25}
    pairs = {"pairs": [{"between": ["cardboard", "steel"], "friction": 0.3}]}

    def wrapped(**wrap: Any) -> Scene:
        return validate_scene(raw(wrap={**FILM, **wrap}, pallet=metal, surfaces=pairs))

    (missing,) = [finding for finding in check_integrity(wrapped()) if finding.severity == "error"]
    assert (missing.check, missing.subject) == ("friction", "stretch_film_20 on steel")
    assert "set wrap.friction" in missing.limit
    assert findings(wrapped(friction=0.3)) == []
    assert findings(wrapped(pallet_overlap_m=0)) == [("note", "wrap.pallet_overlap_m", "0 m")]


def test_the_schema_describes_every_field() -> None:
    schema = Scene.model_json_schema()
    assert schema["properties"]["wrap"]["description"]
    for part in ("Wrap", "Turns"):
        assert schema["$defs"][part]["description"]
        for name, field in schema["$defs"][part]["properties"].items():
            assert len(field.get("description", "")) > 10, name
    turns = schema["$defs"]["Wrap"]["properties"]["turns"]
    assert {"number", "Turns"} == {
        option.get("type", option.get("$ref", "")[8:]) for option in turns["oneOf"]
    }


def test_a_wrapped_scene_loads_nothing_heavy() -> None:
    code = (
        "import sys; from config.scene_file import scene_from_json; scene = scene_from_json(sys.stdin.read());"
        " assert scene.film.tension_npm > 0;"
        " print([m for m in ('numpy', 'numba', 'scipy', 'pybullet', 'rclpy', 'sim_core') if m in sys.modules])"
    )
    told = subprocess.run(
        [sys.executable, "-c", code], input=scene().to_json(), capture_output=True, text=True, check=True
    )
    assert told.stdout.strip() == "[]"


def test_findings_are_findings_in_order() -> None:
    told = check_integrity(scene(coupling="one_way", height_m=0.4, pallet_overlap_m=0))
    assert all(isinstance(finding, Finding) for finding in told)
    assert [finding.severity for finding in told] == ["warning", "note", "note"]
