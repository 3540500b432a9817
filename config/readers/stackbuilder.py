"""Reads the XML that treeDiM StackBuilder exports: one order, one pallet, its placements.

The document names its own unit. x runs along the pallet's length from a corner, y along its width, z up. `L`
and `W` of a placement are the directions of the box's own length and width axes; its height axis is L x W.
`x y z` is the corner at which those three axes start, so the box reaches from there along each axis: with
L = YP and W = XN it lies on the -x side of that corner. (StackBuilder's `BoxPosition`, and its XML exporter
in the default mode; the exporter can also write box centres without saying so, and such a file is refused
because its lowest box then stands neither on the floor nor on the pallet.)
A placement without axes is an interlayer: its edges along x, y, z, its corner the lowest one.
A box that lies on a side is given by its edges as it lies.
"""

from dataclasses import dataclass
from typing import NamedTuple
from xml.etree.ElementTree import Element

from config.errors import RefusedInput
from config.package import Package
from config.readers.layers import LEVEL_TOLERANCE_M, name_by_layer, number_layers
from config.readers.pallet import (
    EMPTY_PACK_LIST,
    PatternPallet,
    check_package_count,
    check_pallet_size,
    count_note,
    place,
)
from config.readers.source import check_schema

ROOT = "orderDocument"
NAMESPACE = "http://plmpack.com/stackbuilder/StackBuilderXMLExport.xsd"
UNITS: dict[str, tuple[float, float]] = {
    "mm|kg": (0.001, 1.0),
    "cm|kg": (0.01, 1.0),
    "m|kg": (1.0, 1.0),
    "in|lb": (0.0254, 0.45359237),
}
"""Metres in a unit of length and kilograms in a unit of weight, by the document's unit string."""

Axis = tuple[int, int, int]
_AXES: dict[str, Axis] = {
    "XP": (1, 0, 0),
    "XN": (-1, 0, 0),
    "YP": (0, 1, 0),
    "YN": (0, -1, 0),
    "ZP": (0, 0, 1),
    "ZN": (0, 0, -1),
}
_YAW_DEG: dict[Axis, float] = {(1, 0, 0): 0.0, (0, 1, 0): 90.0, (-1, 0, 0): 180.0, (0, -1, 0): 270.0}
_LOAD = "orderDocument/orderType/load"


@dataclass(frozen=True)
class _Item:
    size_m: tuple[float, float, float]
    mass_kg: float


class _Placements(NamedTuple):
    packages: list[Package]
    on_side: int


def read_stackbuilder(root: Element) -> tuple[PatternPallet, ...]:
    """Read the one pallet of an export.

    Packages are named ``L2-05`` (layer 2, fifth in file order), interlayers ``I2-1``.

    Raises:
        RefusedInput: what the schema refuses, another unit, an unknown item, axes that are not perpendicular,
            cylinders, heights without a clear origin, too many packages, or none at all.
    """
    unit = (root.findtext("unit") or "").strip()
    if unit not in UNITS:
        raise RefusedInput("orderDocument/unit", unit or "(empty)", f"one of {', '.join(UNITS)}")
    check_package_count(_LOAD, len(root.findall("orderType/load/placement")))
    check_schema(root, "stackbuilder.xsd")
    metre, kilogram = UNITS[unit]

    space = _find(root, "orderType/loadSpace")
    length_m, width_m, deck_m, max_height_m = (
        round(_number(space, tag) * metre, 9) for tag in ("length", "width", "baseHeight", "maxLoadHeight")
    )
    check_pallet_size("orderDocument/orderType/loadSpace", (length_m, width_m))
    placements = _read_placements(root, metre, kilogram)
    packages = _from_corner(placements.packages, (length_m / 2, width_m / 2), deck_m)
    notes = count_note(placements.on_side, "lies on a side", "lie on a side")
    return (
        PatternPallet(
            number=1,
            name=_text(space, "name"),
            size_m=(length_m, width_m),
            deck_height_m=deck_m or None,
            max_height_m=max_height_m or None,
            max_mass_kg=round(_number(space, "maxLoadWeight") * kilogram, 9) or None,
            packages=name_by_layer(number_layers(packages)),
            notes=notes,
        ),
    )


def _read_placements(root: Element, metre: float, kilogram: float) -> _Placements:
    """Packages in file order, placed relative to the pallet's corner and the file's zero height."""
    items = _read_items(root, metre, kilogram)
    ordered = int(_text(root, "orderType/orderLine/itemId"))
    packages: list[Package] = []
    on_side = 0
    for index, element in enumerate(root.iterfind("orderType/load/placement"), start=1):
        field = f"{_LOAD}/placement[{index}]"
        item_id = int(_text(element, "itemId"))
        item = items.get(item_id)
        if item is None:
            limit = f"one of {', '.join(map(str, items)) or 'no items'}"
            raise RefusedInput(f"{field}/itemId", item_id, limit)
        axes = _read_axes(field, element)
        if axes is None and item_id == ordered:
            limit = "boxes only: packages need both axes, cylinders are not read"
            raise RefusedInput(field, "no L and W", limit)
        size_m, yaw_deg = _as_it_lies(item, axes)
        on_side += axes is not None and _upright_edge(axes) != 2
        packages.append(
            place(
                field,
                id=f"placement-{index}",
                size_m=size_m,
                mass_kg=item.mass_kg,
                position_m=_centre(tuple(_number(element, axis) * metre for axis in "xyz"), item, axes),
                yaw_deg=yaw_deg,
                interlayer=axes is None,
            )
        )
    if not any(package.kind == "package" for package in packages):
        raise RefusedInput(_LOAD, f"{len(packages)} placements", EMPTY_PACK_LIST)
    return _Placements(packages, on_side)


def _read_items(root: Element, metre: float, kilogram: float) -> dict[int, _Item]:
    items: dict[int, _Item] = {}
    for index, element in enumerate(root.iterfind("orderType/itemList/item"), start=1):
        number = int(_text(element, "id"))
        if number in items:
            field = f"orderDocument/orderType/itemList/item[{index}]/id"
            raise RefusedInput(field, number, "each item once")
        length, width, height = (_number(element, edge) * metre for edge in ("length", "width", "height"))
        items[number] = _Item((length, width, height), _number(element, "weight") * kilogram)
    return items


def _read_axes(field: str, element: Element) -> tuple[Axis, Axis, Axis] | None:
    """World directions of the box's length, width and height; None for an interlayer."""
    names = [_text(element, tag) for tag in ("L", "W") if element.find(tag) is not None]
    if not names:
        return None
    if len(names) == 1 or names[0][0] == names[1][0]:
        raise RefusedInput(f"{field}/W", " and ".join(names), "L and W, perpendicular to each other")
    (a, b, c), (d, e, f) = along, across = _AXES[names[0]], _AXES[names[1]]
    return along, across, (b * f - c * e, c * d - a * f, a * e - b * d)


def _centre(
    corner: tuple[float, ...], item: _Item, axes: tuple[Axis, Axis, Axis] | None
) -> tuple[float, float, float]:
    along, across, up = axes or (_AXES["XP"], _AXES["YP"], _AXES["ZP"])
    length, width, height = item.size_m
    x, y, z = (corner[k] + (length * along[k] + width * across[k] + height * up[k]) / 2 for k in range(3))
    return x, y, z


def _upright_edge(axes: tuple[Axis, Axis, Axis]) -> int:
    """Which of the box's own edges is vertical: 0 length, 1 width, 2 height."""
    return next(edge for edge in range(3) if axes[edge][2] != 0)


def _as_it_lies(
    item: _Item, axes: tuple[Axis, Axis, Axis] | None
) -> tuple[tuple[float, float, float], float]:
    length, width, height = item.size_m
    if axes is None:
        return item.size_m, 0.0
    upright = _upright_edge(axes)
    if upright == 2:
        return item.size_m, _YAW_DEG[axes[0]]
    if upright == 1:
        return (length, height, width), _YAW_DEG[axes[0]]
    return (height, width, length), _YAW_DEG[axes[2]]


def _from_corner(
    packages: list[Package], corner_to_centre: tuple[float, float], deck_m: float
) -> list[Package]:
    """The packages in the pallet's frame; the file may count heights from the floor or from the deck."""
    lowest = min(package.position_m[2] - package.size_m[2] / 2 for package in packages)
    base = min((0.0, deck_m), key=lambda height: abs(lowest - height))
    if abs(lowest - base) > LEVEL_TOLERANCE_M:
        found, limit = f"lowest bottom at {lowest * 1000:.1f} mm", f"0 or baseHeight, {deck_m * 1000:.1f} mm"
        raise RefusedInput(f"{_LOAD}/placement", found, limit)

    def moved(package: Package) -> Package:
        shift = (*corner_to_centre, base)
        position = [round(value - by, 9) + 0.0 for value, by in zip(package.position_m, shift, strict=True)]
        return package.model_copy(update={"position_m": tuple(position)})

    return [moved(package) for package in packages]


def _find(element: Element, path: str) -> Element:
    found = element.find(path)
    if found is None:
        raise RefusedInput(f"{element.tag}/{path}", "(missing)", "this element")
    return found


def _text(element: Element, path: str) -> str:
    return (element.findtext(path) or "").strip()


def _number(element: Element, path: str) -> float:
    return float(_text(element, path))
