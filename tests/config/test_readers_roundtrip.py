"""Random loads written in each format by a small writer, and read back as the same boxes."""

import json
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from config.readers import PatternPallet, read_pattern
from config.readers.pallet import bounds

Edges = tuple[int, int, int]
Box = tuple[Edges, tuple[int, int, int], int, int]
"""Edges as it lies, lower corner, quarter turns, grams: all in mm and g; a turned box lies width along x."""

PALLET = (1200, 800)
DIRECTIONS = ("XP", "YP", "XN", "YN")
UNIT_MM = {"mm|kg": 1.0, "cm|kg": 10.0, "m|kg": 1000.0, "in|lb": 25.4}

edges = st.tuples(st.integers(50, 600), st.integers(50, 400), st.integers(20, 500))
boxes = st.lists(
    st.tuples(
        edges,
        st.tuples(st.integers(-50, 1200), st.integers(-50, 800), st.integers(0, 2000)),
        st.integers(0, 3),
        st.integers(1, 40_000),
    ),
    min_size=1,
    max_size=12,
)


def footprint(box: Box) -> tuple[int, int]:
    (length, width, _), _, turns, _ = box
    return (width, length) if turns % 2 else (length, width)


def expected_extents(box: Box) -> tuple[float, ...]:
    along_x, along_y = footprint(box)
    (_, _, height), (x, y, z), _, _ = box
    x0, y0 = x - PALLET[0] / 2, y - PALLET[1] / 2
    return tuple(value / 1000 for value in (x0, x0 + along_x, y0, y0 + along_y, z, z + height))


def read_text(text: str) -> tuple[PatternPallet, ...]:
    with TemporaryDirectory() as folder:
        path = Path(folder) / "load"
        path.write_text(text, encoding="utf-8")
        return read_pattern(path).pallets


def write_nist(load: list[Box]) -> str:
    packages = ""
    for number, box in enumerate(load, start=1):
        (length, width, height), (x, y, z), turns, grams = box
        along_x, along_y = footprint(box)
        packages += (
            f"<Package><PackSequence>{number}</PackSequence><Article><ID>a</ID><Length>{length}</Length>"
            f"<Width>{width}</Width><Height>{height}</Height><Weight>{grams}</Weight></Article>"
            f"<PlacePosition><X>{x + along_x / 2}</X><Y>{y + along_y / 2}</Y><Z>{z + height}</Z>"
            f"</PlacePosition><Orientation>{turns + 1}</Orientation></Package>"
        )
    return (
        "<Response><PackList><PackPallets><PackPallet><PalletNumber>4</PalletNumber><Dimensions>"
        f"<Length>{PALLET[0]}</Length><Width>{PALLET[1]}</Width></Dimensions><Packages>{packages}</Packages>"
        "</PackPallet></PackPallets></PackList></Response>"
    )


def write_stackbuilder(load: list[Box], unit: str) -> str:
    def length_in(mm: float) -> str:
        return repr(mm / UNIT_MM[unit])

    items = placements = ""
    floor = min(box[1][2] for box in load)
    for number, box in enumerate(load, start=1):
        (length, width, height), (x, y, z), turns, grams = box
        weight = grams / 1000 / (0.45359237 if unit == "in|lb" else 1.0)
        items += (
            f"<item><id>{number}</id><name/><length>{length_in(length)}</length><width>{length_in(width)}</width>"
            f"<height>{length_in(height)}</height><weight>{weight!r}</weight></item>"
        )
        # The corner at which the length axis (turned) and the width axis, a quarter turn on, both start.
        along_x, along_y = footprint(box)
        corner_x = x + (along_x if turns in (1, 2) else 0)
        corner_y = y + (along_y if turns in (2, 3) else 0)
        placements += (
            f"<placement><itemId>{number}</itemId><x>{length_in(corner_x)}</x><y>{length_in(corner_y)}</y>"
            f"<z>{length_in(z - floor + 144)}</z><L>{DIRECTIONS[turns]}</L>"
            f"<W>{DIRECTIONS[(turns + 1) % 4]}</W></placement>"
        )
    return (
        f"<orderDocument><author/><date>d</date><unit>{unit}</unit><orderType><orderNumber/><loadSpace>"
        f"<id>1</id><name/><length>{length_in(PALLET[0])}</length><width>{length_in(PALLET[1])}</width><maxLoadHeight>0"
        f"</maxLoadHeight><maxLoadWeight>0</maxLoadWeight><baseHeight>{length_in(144)}</baseHeight>"
        "<maxLengthOverhang>0</maxLengthOverhang><maxWidthOverhang>0</maxWidthOverhang></loadSpace>"
        f"<itemList>{items}</itemList><orderLine><itemId>1</itemId><quantity>1</quantity></orderLine>"
        f"<load><loadSpaceId>1</loadSpaceId><statistics/>{placements}</load></orderType></orderDocument>"
    )


@settings(max_examples=40, deadline=None)
@given(boxes)
def test_nist_round_trip(load: list[Box]) -> None:
    (pallet,) = read_text(write_nist(load))
    assert pallet.number == 4
    assert len({package.id for package in pallet.packages}) == len(load)
    for package, box in zip(pallet.packages, load, strict=True):
        assert bounds(package) == pytest.approx(expected_extents(box), abs=1e-9)
        assert package.mass_kg == pytest.approx(box[3] / 1000, abs=1e-9)


@settings(max_examples=40, deadline=None)
@given(boxes, st.sampled_from(sorted(UNIT_MM)))
def test_stackbuilder_round_trip(load: list[Box], unit: str) -> None:
    (pallet,) = read_text(write_stackbuilder(load, unit))
    floor = min(box[1][2] for box in load) / 1000
    for package, box in zip(pallet.packages, load, strict=True):
        x0, x1, y0, y1, z0, z1 = expected_extents(box)
        # Rounding of centres and edges to a nanometre allows one nanometre at a face.
        assert bounds(package) == pytest.approx((x0, x1, y0, y1, z0 - floor, z1 - floor), abs=2e-9)
        assert package.mass_kg == pytest.approx(box[3] / 1000, abs=1e-9)


@settings(max_examples=40, deadline=None)
@given(
    edges,
    st.lists(
        st.lists(
            st.tuples(st.integers(0, 800), st.integers(0, 1200), st.sampled_from((0, 90, 180, 270))),
            min_size=1,
        ),
        min_size=1,
        max_size=4,
    ),
    st.lists(st.booleans(), min_size=4, max_size=4),
)
def test_pally_round_trip(
    product: Edges, layers: list[list[tuple[int, int, int]]], sheets: list[bool]
) -> None:
    length, width, height = product
    names: list[str] = []
    for number in range(len(layers)):
        names += ["sheet"] * sheets[number] + [f"layer {number}"]
    types: list[dict[str, object]] = [{"name": "sheet", "class": "separator", "height": 4}]
    types += [
        {"name": f"layer {n}", "class": "layer", "pattern": [{"x": x, "y": y, "r": [r]} for x, y, r in layer]}
        for n, layer in enumerate(layers)
    ]
    data = {
        "dimensions": {"length": PALLET[0], "width": PALLET[1]},
        "productDimensions": {"length": length, "width": width, "height": height, "weight": 700},
        "layerTypes": types,
        "layers": names,
    }
    (pallet,) = read_text(json.dumps(data))
    packages = [package for package in pallet.packages if package.kind == "package"]
    expected = []
    bottom = 0
    for number, layer in enumerate(layers):
        bottom += 4 * sheets[number]
        for x, y, turn in layer:
            along_x, along_y = (width, length) if turn % 180 else (length, width)
            centre_x, centre_y = y - PALLET[0] / 2, PALLET[1] / 2 - x
            in_x = centre_x - along_x / 2, centre_x + along_x / 2
            in_y = centre_y - along_y / 2, centre_y + along_y / 2
            expected.append((*in_x, *in_y, bottom, bottom + height))
        bottom += height
    assert len(packages) == len(expected)
    for package, extents in zip(packages, expected, strict=True):
        assert bounds(package) == pytest.approx([value / 1000 for value in extents], abs=1e-9)
    assert [p.layer for p in packages] == [n + 1 for n, layer in enumerate(layers) for _ in layer]
