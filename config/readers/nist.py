"""Reads the pack lists of the NIST palletising challenge: one XML file, one or more packed pallets.

Lengths are millimetres, weights grams. A pallet's origin is a corner of its top, x along `Length`, y along
`Width`, z up. `PlacePosition` is the centre of the face that points up. `Orientation` counts, from 1,
quarter turns about z in groups of four: 1 to 4 upright, 5 to 8 with the article's width upwards, 9 to 12
with its length upwards, and 13 to 24 the same again upside down. Which edge then lies along x is as in
NIST's own pallet viewer (response.cc, `Package::findBoundaries`, 2011, public domain); the sense of the
quarter turns, which that program does not need, is taken as counter-clockwise. A box that lies on a side is
given by its edges as it lies: (length, height, width) or (height, width, length).
"""

from xml.etree.ElementTree import Element

from config.errors import RefusedInput
from config.package import Package
from config.readers.layers import number_layers
from config.readers.pallet import (
    EMPTY_PACK_LIST,
    PatternPallet,
    check_package_count,
    check_pallet_size,
    count_note,
    place,
)
from config.readers.source import check_schema

ROOT = "Response"
_PALLETS = "Response/PackList/PackPallets"


def read_nist(root: Element) -> tuple[PatternPallet, ...]:
    """Read every pallet of a pack list, in file order.

    Packages are named by their `PackSequence` and article, such as ``017-83777``.

    Raises:
        RefusedInput: what the schema refuses, a number given twice, too many packages, or none at all.
    """
    for index, packages in enumerate(root.iterfind("PackList/PackPallets/PackPallet/Packages"), start=1):
        check_package_count(f"{_PALLETS}/PackPallet[{index}]/Packages", len(packages))
    check_schema(root, "nist.xsd")
    pallets = tuple(
        _read_pallet(f"{_PALLETS}/PackPallet[{index}]", element)
        for index, element in enumerate(root.iterfind("PackList/PackPallets/PackPallet"), start=1)
    )
    if not any(pallet.packages for pallet in pallets):
        raise RefusedInput(_PALLETS, f"{len(pallets)} pallets", EMPTY_PACK_LIST)
    numbers = [pallet.number for pallet in pallets]
    for index, number in enumerate(numbers, start=1):
        if number in numbers[: index - 1]:
            field = f"{_PALLETS}/PackPallet[{index}]/PalletNumber"
            raise RefusedInput(field, number, "each pallet number once")
    return pallets


def _read_pallet(field: str, element: Element) -> PatternPallet:
    length_m, width_m = (_number(element, f"Dimensions/{edge}") / 1000.0 for edge in ("Length", "Width"))
    check_pallet_size(f"{field}/Dimensions", (length_m, width_m))
    packages: list[Package] = []
    ids: set[str] = set()
    on_side = 0
    for index, package in enumerate(element.iterfind("Packages/Package"), start=1):
        where = f"{field}/Packages/Package[{index}]"
        placed = _read_package(where, package, length_m, width_m)
        if placed.id in ids:
            raise RefusedInput(f"{where}/PackSequence", placed.id, "each sequence number and article once")
        ids.add(placed.id)
        packages.append(placed)
        on_side += _group(package) != 0
    return PatternPallet(
        number=int(_text(element, "PalletNumber")),
        name=(element.findtext("Description") or "").strip(),
        size_m=(length_m, width_m),
        deck_height_m=None,
        max_height_m=_optional(element, "Dimensions/MaxLoadHeight"),
        max_mass_kg=_optional(element, "Dimensions/MaxLoadWeight"),
        packages=number_layers(packages),
        notes=count_note(on_side, "lies on a side", "lie on a side"),
    )


def _read_package(field: str, element: Element, length_m: float, width_m: float) -> Package:
    length, width, height = (
        _number(element, f"Article/{edge}") / 1000.0 for edge in ("Length", "Width", "Height")
    )
    size_m = ((length, width, height), (length, height, width), (height, width, length))[_group(element)]
    x, y, top = (_number(element, f"PlacePosition/{axis}") / 1000.0 for axis in "XYZ")
    return place(
        field,
        id=f"{int(_text(element, 'PackSequence')):03d}-{_text(element, 'Article/ID')}",
        size_m=size_m,
        mass_kg=_number(element, "Article/Weight") / 1000.0,
        position_m=(x - length_m / 2, y - width_m / 2, top - size_m[2] / 2),
        yaw_deg=90.0 * ((int(_text(element, "Orientation")) - 1) % 4),
    )


def _group(element: Element) -> int:
    """0 upright, 1 width upwards, 2 length upwards."""
    return (int(_text(element, "Orientation")) - 1) // 4 % 3


def _text(element: Element, path: str) -> str:
    return (element.findtext(path) or "").strip()


def _number(element: Element, path: str) -> float:
    return float(_text(element, path))


def _optional(element: Element, path: str) -> float | None:
    return None if element.find(path) is None else _number(element, path) / 1000.0
