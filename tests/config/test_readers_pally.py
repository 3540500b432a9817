"""Pally patterns: axes, turns, separators and stations worked out by hand, and what is refused."""

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from config.errors import RefusedInput
from config.readers import PatternPallet, read_pattern
from config.readers.pallet import bounds

ReadOnly = Callable[[str], PatternPallet]
Refuse = Callable[[str], RefusedInput]
Extents = Callable[..., tuple[float, ...]]


def pally_data(**changes: object) -> dict[str, object]:
    box = {"x": 150, "y": 200, "r": [0], "g": [], "f": 1}
    data: dict[str, object] = {
        "name": "p",
        "dimensions": {"height": 250, "width": 800, "length": 1200, "palletHeight": 144},
        "productDimensions": {"width": 300, "length": 400, "height": 250, "weight": 10000},
        "layerTypes": [{"name": "A", "class": "layer", "pattern": [box]}],
        "layers": ["A"],
    }
    return data | changes


def test_pally_axes_turn_into_ours(extents_mm: Extents, read_only: ReadOnly) -> None:
    # Pally x = 150 of 800 across, y = 200 of 1200 along: ours is x = 200 - 600, y = 400 - 150.
    pallet = read_only(json.dumps(pally_data()))
    (package,) = pallet.packages
    assert package.position_m == (-0.4, 0.25, 0.125)
    assert (package.size_m, package.yaw_deg, package.mass_kg) == ((0.4, 0.3, 0.25), 0.0, 10.0)
    assert extents_mm(pallet) == (0, 400, 500, 800, 0, 250)
    assert (pallet.size_m, pallet.deck_height_m) == ((1.2, 0.8), 0.144)


def test_pally_quarter_turn_swaps_the_edges(extents_mm: Extents, read_only: ReadOnly) -> None:
    layer = {"name": "A", "class": "layer", "pattern": [{"x": 200, "y": 150, "r": [270]}]}
    pallet = read_only(json.dumps(pally_data(layerTypes=[layer])))
    assert pallet.packages[0].yaw_deg == 270.0
    assert extents_mm(pallet) == (0, 300, 400, 800, 0, 250)


def test_pally_separators_lift_what_stands_on_them(read_only: ReadOnly) -> None:
    types = [
        {"name": "A", "class": "layer", "pattern": [{"x": 150, "y": 200, "r": [0]}]},
        {"name": "thick", "class": "separator", "height": 5},
        {"name": "thin", "class": "separator"},
    ]
    data = pally_data(layerTypes=types, layers=["thin", "A", "thick", "A"])
    pallet = read_only(json.dumps(data))
    bottoms = [(p.id, p.layer, round(bounds(p).z_min, 9)) for p in pallet.packages]
    assert bottoms == [("I0-1", None, 0.0), ("L1-01", 1, 0.001), ("I1-1", 1, 0.251), ("L2-01", 2, 0.256)]
    # 1.2 m x 0.8 m x 5 mm at 200 kg/m3
    assert pallet.packages[2].mass_kg == pytest.approx(0.96)
    assert any("no weight" in note for note in pallet.notes)
    assert any("no height" in note for note in pallet.notes)


def test_pally_alternative_pattern_is_the_second_station(tmp_path: Path) -> None:
    box, mirrored = {"x": 150, "y": 200, "r": [0]}, {"x": 650, "y": 200, "r": [0]}
    path = tmp_path / "p.json"
    layer = {"name": "A", "class": "layer", "pattern": [box], "altPattern": [mirrored]}
    path.write_text(json.dumps(pally_data(layerTypes=[layer])))
    first, second = read_pattern(path).pallets
    assert [first.number, second.number] == [1, 2]
    assert first.packages[0].position_m == (-0.4, 0.25, 0.125)
    assert second.packages[0].position_m == (-0.4, -0.25, 0.125)

    same = {**layer, "altPattern": [{**box, "r": [180]}]}
    path.write_text(json.dumps(pally_data(layerTypes=[same])))
    assert len(read_pattern(path).pallets) == 1


BOX = {"x": 150, "y": 200, "r": [0]}


def one_box(**changes: object) -> dict[str, object]:
    return {"layerTypes": [{"name": "A", "class": "layer", "pattern": [BOX | changes]}]}


@pytest.mark.parametrize(
    ("changes", "field", "said"),
    [
        (
            {"productDimensions": {"width": 300, "length": 400, "height": 250, "weight": 0}},
            "weight",
            "greater",
        ),
        (
            {"productDimensions": {"width": -300, "length": 400, "height": 250, "weight": 1}},
            "width",
            "greater",
        ),
        (
            {"productDimensions": {"width": "300", "length": 400, "height": 250, "weight": 1}},
            "width",
            "number",
        ),
        ({"productDimensions": {"length": 400, "height": 250, "weight": 1}}, "width", "required"),
        ({"productDimensions": {"width": 300, "length": 40000, "height": 9, "weight": 1}}, "size_m[0]", "10"),
        ({"dimensions": {"width": 800, "length": True}}, "dimensions.length", "number"),
        ({"dimensions": {"width": 800, "length": 99999}}, "dimensions", "10 m"),
        ({"layers": ["B"]}, "layers[0]", "one of A"),
        ({"layers": [1]}, "layers[0]", "string"),
        ({"layers": "A"}, "layers", "list"),
        ({"layerTypes": {}}, "layerTypes", "list"),
        (one_box(x="left"), "layerTypes[0].pattern[0].x", "number"),
        (one_box(r=[45]), "layerTypes[0].pattern[0].r", "quarter turns"),
        (one_box(r=[0, 90]), "layerTypes[0].pattern[0].r", "quarter turns"),
        (one_box(r=[]), "layerTypes[0].pattern[0].r", "quarter turns"),
        ({"layerTypes": [{"name": "A", "class": "box"}]}, "layerTypes[0].class", "separator"),
        (
            {"layerTypes": [{"name": "A", "class": "layer", "pattern": []}]},
            "layerTypes[0].pattern",
            "one box",
        ),
        (
            {"layerTypes": [{"name": "A", "class": "separator", "height": 0}]},
            "layerTypes[0].height",
            "greater",
        ),
        (
            {"layerTypes": [{"name": "A", "class": "layer", "height": 90, "pattern": [BOX]}]},
            "layerTypes[0].height",
            "250 mm",
        ),
        ({"layers": ["A"] * 5001}, "layers", "at most 5000"),
    ],
)
def test_pally_violations(refuse: Refuse, changes: dict[str, object], field: str, said: str) -> None:
    error = refuse(json.dumps(pally_data(**changes)))
    assert error.field.endswith(field)
    assert said in str(error)


@pytest.mark.parametrize(
    "changes", [{"layers": []}, {"layerTypes": [{"name": "s", "class": "separator"}], "layers": ["s"]}]
)
def test_pattern_without_packages(refuse: Refuse, changes: dict[str, object]) -> None:
    assert "the pack list holds no package" in str(refuse(json.dumps(pally_data(**changes))))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('{"layers": [', "line 1"),
        ('{"layers": NaN}', "finite number"),
        ('{"layers": -Infinity}', "finite number"),
        ('{"a": 1, "a": 2}', "each key once"),
        ('{"a": ' + "9" * 5000 + "}", "not usable JSON"),
        ("[" * 200_000, "not usable JSON"),
        ("[1, 2]", "list"),
        ('{"boxes": []}', "boxes"),
        (json.dumps(pally_data()).replace('"x": 150', '"x": 1e999'), "layerTypes[0].pattern[0].x"),
    ],
)
def test_unusable_json(refuse: Refuse, text: str, said: str) -> None:
    assert said in str(refuse(text))
