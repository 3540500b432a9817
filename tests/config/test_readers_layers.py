"""Keeping, turning and mirroring layers, and what is refused because boxes would overlap or float."""

from collections.abc import Sequence

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from config.errors import RefusedInput
from config.package import Package
from config.readers import PatternPallet, vary_layers
from config.readers.layers import number_layers
from config.readers.pallet import bounds


def box(
    name: str,
    x: float,
    y: float,
    bottom: float,
    *,
    size: tuple[float, float, float] = (0.4, 0.3, 0.2),
    sheet: bool = False,
) -> Package:
    position = (x, y, bottom + size[2] / 2)
    kind = "interlayer" if sheet else "package"
    return Package(id=name, size_m=size, mass_kg=1.0, position_m=position, kind=kind)  # type: ignore[arg-type]


def load_of(packages: Sequence[Package]) -> PatternPallet:
    return PatternPallet(1, "p", (1.2, 0.8), None, None, None, number_layers(packages))


SHEET = (1.2, 0.8, 0.01)
SHEETED = load_of(
    [
        box("sheet 0", 0, 0, 0.0, size=SHEET, sheet=True),
        box("a", 0.3, 0.1, 0.01),
        box("sheet 1", 0, 0, 0.21, size=SHEET, sheet=True),
        box("b", 0.3, 0.1, 0.22),
        box("sheet 2", 0, 0, 0.42, size=SHEET, sheet=True),
        box("c", 0.3, 0.1, 0.43),
        box("sheet 3", 0, 0, 0.63, size=SHEET, sheet=True),
    ]
)

# Left: a tall box beside two low ones; the second low one is layer 2, the lid on both is layer 3.
TALL = load_of(
    [
        box("tall", -0.3, 0.0, 0.0, size=(0.4, 0.4, 0.4)),
        box("low", 0.3, 0.0, 0.0, size=(0.4, 0.4, 0.2)),
        box("upper", 0.3, 0.0, 0.2, size=(0.4, 0.4, 0.2)),
        box("lid", 0.0, 0.0, 0.4, size=(1.0, 0.4, 0.1)),
    ]
)


def names(pallet: PatternPallet) -> list[str]:
    return [package.id for package in pallet.packages]


def test_sheets_count_with_the_layer_below() -> None:
    assert [package.layer for package in SHEETED.packages] == [None, 1, 1, 2, 2, 3, 3]


def test_keeping_layers_drops_the_sheet_on_top() -> None:
    assert names(vary_layers(SHEETED, layers=2)) == ["sheet 0", "a", "sheet 1", "b"]
    assert names(vary_layers(SHEETED, layers=1)) == ["sheet 0", "a"]
    assert names(vary_layers(SHEETED, layers=3)) == names(SHEETED)[:-1]
    assert vary_layers(SHEETED) == SHEETED
    assert vary_layers(SHEETED, layers=2).notes == ("kept the lowest 2 of 3 layers",)


def test_turning_and_mirroring_move_packages_only() -> None:
    varied = vary_layers(SHEETED, rotate_layers=[2], mirror_layers=[3, 1])
    placed = {package.id: (package.position_m, package.yaw_deg) for package in varied.packages}
    assert placed["b"] == ((-0.3, -0.1, 0.32), 180.0)
    assert placed["a"] == ((0.3, -0.1, 0.11), 0.0)
    assert placed["c"] == ((0.3, -0.1, 0.53), 0.0)
    assert placed["sheet 1"] == ((0.0, 0.0, 0.215), 0.0)
    assert varied.notes == ("turned by 180 deg: layer 2", "mirrored: layer 1, 3")


def test_turning_and_mirroring_one_layer_is_a_mirror_in_x() -> None:
    (package,) = vary_layers(
        load_of([box("a", 0.3, 0.1, 0.0)]), rotate_layers=[1], mirror_layers=[1]
    ).packages
    assert (package.position_m, package.yaw_deg) == ((-0.3, 0.1, 0.1), 180.0)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"layers": 4}, "layers = 4: 1 to 3"),
        ({"layers": 0}, "layers = 0: 1 to 3"),
        ({"rotate_layers": [4]}, "rotate_layers = .4.: layers 1 to 3"),
        ({"layers": 1, "mirror_layers": [2]}, "mirror_layers = .2.: layers 1 to 1"),
        ({"rotate_layers": [0]}, "rotate_layers"),
        ({"rotate_layers": [2, 2]}, "each once"),
    ],
)
def test_layers_that_are_not_there(arguments: dict[str, object], said: str) -> None:
    with pytest.raises(RefusedInput, match=said):
        vary_layers(SHEETED, **arguments)  # type: ignore[arg-type]


def test_tall_box_spans_two_layers() -> None:
    assert [package.layer for package in TALL.packages] == [1, 1, 2, 3]
    assert names(vary_layers(TALL, layers=1)) == ["tall", "low"]
    # Turned alone, the upper low box would stand inside the tall one: 0.2 m of height shared.
    with pytest.raises(RefusedInput, match="rotate_layers = 2: tall and upper would overlap by 200 mm"):
        vary_layers(TALL, rotate_layers=[2])
    # Layers 1 and 2 together, and the symmetric lid, may turn.
    assert len(vary_layers(TALL, rotate_layers=[1, 2, 3]).packages) == 4
    assert len(vary_layers(TALL, rotate_layers=[3]).packages) == 4


def test_a_layer_that_would_float_is_refused() -> None:
    stack = load_of([box("a", 0.3, 0.2, 0.0), box("b", 0.3, 0.2, 0.2)])
    with pytest.raises(RefusedInput, match="rotate_layers = 2: b would rest on nothing"):
        vary_layers(stack, rotate_layers=[2])
    with pytest.raises(RefusedInput, match="mirror_layers = 1: b would rest on nothing"):
        vary_layers(stack, mirror_layers=[1])
    both = vary_layers(stack, rotate_layers=[1, 2])
    assert [package.position_m[:2] for package in both.packages] == [(-0.3, -0.2), (-0.3, -0.2)]


def test_a_fault_of_the_file_itself_is_not_blamed_on_the_change() -> None:
    # Layer 1 overlaps within itself and layer 2 floats already; the integrity check reports that, not this.
    faulty = load_of([box("a", 0.0, 0.0, 0.0), box("b", 0.1, 0.0, 0.0), box("c", 0.0, 0.0, 0.5)])
    assert len(vary_layers(faulty, rotate_layers=[1, 2]).packages) == 3


coordinate = st.integers(-4, 4).map(lambda step: step / 10)


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(coordinate, coordinate, st.integers(0, 4)), min_size=1, max_size=20), st.data())
def test_turning_every_layer_twice_gives_the_load_back(
    places: list[tuple[float, float, int]], data: st.DataObject
) -> None:
    load = load_of([box(f"p{n}", x, y, 0.2 * storey) for n, (x, y, storey) in enumerate(places)])
    count = max(package.layer or 0 for package in load.packages)
    everything = list(range(1, count + 1))
    once = vary_layers(load, rotate_layers=everything, mirror_layers=everything)
    twice = vary_layers(once, rotate_layers=everything, mirror_layers=everything)
    assert [bounds(package) for package in twice.packages] == [bounds(package) for package in load.packages]
    kept = data.draw(st.integers(1, count))
    remaining = vary_layers(load, layers=kept).packages
    assert {package.layer for package in remaining} == set(range(1, kept + 1))
