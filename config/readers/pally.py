"""Reads the pallet patterns of Rocketfarm Pally: one JSON file, one product, layers by name.

Millimetres and grams. Pally's x runs along the pallet's width and its y along the length, from a corner,
seen from above with z up; so x here is Pally's y, and y here is Pally's x reversed, which keeps the frame
right-handed. `x y` of a box is its centre; with `r` = 0 its width lies along Pally's x, and `r` counts
degrees counter-clockwise.

A layer type's `altPattern` is read as the same layer for the robot's second pallet station: public writers
of this format fill it with the mirror image of `pattern`, or with `pattern` again. So `pattern` is pallet
1; where a layer's `altPattern` differs from it, the file has a pallet 2 as well, on which the layers
without one keep their `pattern`. `dimensions.height` is not read: writers put the load's own height there
as well as a limit.
"""

from collections.abc import Iterator, Sequence
from typing import Annotated, Literal, NamedTuple

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from config.errors import RefusedInput
from config.package import Package
from config.readers.layers import name_by_layer, number_layers
from config.readers.pallet import (
    EMPTY_PACK_LIST,
    PatternPallet,
    check_package_count,
    check_pallet_size,
    place,
    refusal_of,
)

KEYS = ("dimensions", "productDimensions", "layerTypes", "layers")
SEPARATOR_HEIGHT_MM = 1.0
"""Taken where a separator gives no height: the default of Pally's own shim paper."""
SEPARATOR_DENSITY = 200.0
"""kg/m3, unverified: the format gives separators no weight; a 3 mm anti-slip sheet weighs about 0.6 kg/m2."""

_Finite = Annotated[float, Field(allow_inf_nan=False, ge=-1e6, le=1e6)]
_Positive = Annotated[float, Field(allow_inf_nan=False, gt=0.0, le=1e6)]
_Name = Annotated[str, Field(min_length=1, max_length=120)]


class _Part(BaseModel):
    model_config = ConfigDict(extra="ignore", frozen=True, strict=True)


class _Dimensions(_Part):
    length: _Positive
    width: _Positive
    palletHeight: Annotated[float, Field(allow_inf_nan=False, ge=0.0, le=1e6)] | None = None
    maxLoadHeight: _Positive | None = None


class _Product(_Part):
    length: _Positive
    width: _Positive
    height: _Positive
    weight: _Positive


class _Box(_Part):
    x: _Finite
    y: _Finite
    r: list[_Finite] = [0.0]


class _LayerType(_Part):
    name: _Name
    kind: Literal["layer", "separator"] = Field(alias="class")
    height: _Positive | None = None
    pattern: list[_Box] = []
    altPattern: list[_Box] | None = None


class _GuiSettings(_Part):
    units: str = "metric"


class _Pattern(_Part):
    name: str = ""
    dimensions: _Dimensions
    productDimensions: _Product
    layerTypes: list[_LayerType]
    layers: list[str]
    guiSettings: _GuiSettings = _GuiSettings()


class _Layer(NamedTuple):
    field: str
    type: _LayerType
    boxes: Sequence[_Box]


def read_pally(data: object) -> tuple[PatternPallet, ...]:
    """Read a pattern's pallet, and the second station's where it differs.

    Packages are named ``L2-05`` (layer 2, fifth in file order), separators ``I2-1``.

    Raises:
        RefusedInput: missing or impossible figures, unknown layer names, turns that are not quarter turns,
            too many packages, or none at all.
    """
    try:
        pattern = _Pattern.model_validate(data)
    except ValidationError as error:
        raise refusal_of(error, str) from None
    size_m = pattern.dimensions.length / 1000.0, pattern.dimensions.width / 1000.0
    check_pallet_size("dimensions", size_m)
    first = list(_layers(pattern, second_station=False))
    second = list(_layers(pattern, second_station=True))
    stations = [first] if _outline(first) == _outline(second) else [first, second]
    for layers in stations:
        check_package_count("layers", sum(len(layer.boxes) or 1 for layer in layers))
    if not any(layer.boxes for layer in first):
        raise RefusedInput("layers", f"{len(first)} layers", EMPTY_PACK_LIST)
    return tuple(_read_pallet(pattern, number, layers) for number, layers in enumerate(stations, start=1))


def _layers(pattern: _Pattern, *, second_station: bool) -> Iterator[_Layer]:
    """The layers from below, each with the boxes that the station puts there; a separator has none."""
    types: dict[str, tuple[int, _LayerType]] = {}
    for index, layer_type in enumerate(pattern.layerTypes):
        if layer_type.name in types:
            raise RefusedInput(f"layerTypes[{index}].name", layer_type.name, "each layer type once")
        types[layer_type.name] = index, layer_type
    for position, name in enumerate(pattern.layers):
        if name not in types:
            raise RefusedInput(f"layers[{position}]", name, f"one of {', '.join(types)}")
        index, layer_type = types[name]
        if layer_type.kind == "separator":
            yield _Layer(f"layerTypes[{index}]", layer_type, ())
            continue
        height, expected = layer_type.height, pattern.productDimensions.height
        if height is not None and abs(height - expected) > 1.0:
            raise RefusedInput(
                f"layerTypes[{index}].height", height, f"the product's height, {expected:g} mm"
            )
        if not layer_type.pattern:
            raise RefusedInput(
                f"layerTypes[{index}].pattern", "[]", "at least one box in a layer that is used"
            )
        if second_station and layer_type.altPattern:
            yield _Layer(f"layerTypes[{index}].altPattern", layer_type, layer_type.altPattern)
        else:
            yield _Layer(f"layerTypes[{index}].pattern", layer_type, layer_type.pattern)


def _outline(layers: Sequence[_Layer]) -> list[set[tuple[float, float, float]]]:
    return [{(box.x, box.y, turn % 180.0) for box in layer.boxes for turn in box.r[:1]} for layer in layers]


def _read_pallet(pattern: _Pattern, number: int, layers: Sequence[_Layer]) -> PatternPallet:
    dimensions, product = pattern.dimensions, pattern.productDimensions
    packages: list[Package] = []
    bottom_mm = 0.0
    for layer in layers:
        if layer.type.kind == "separator":
            height_mm = layer.type.height or SEPARATOR_HEIGHT_MM
            packages.append(_separator(layer.field, pattern, len(packages), bottom_mm, height_mm))
            bottom_mm += height_mm
            continue
        for index, box in enumerate(layer.boxes):
            field = f"{layer.field}[{index}]"
            packages.append(
                place(
                    field,
                    id=f"box-{len(packages)}",
                    size_m=(product.length / 1000.0, product.width / 1000.0, product.height / 1000.0),
                    mass_kg=product.weight / 1000.0,
                    position_m=(
                        (box.y - dimensions.length / 2) / 1000.0,
                        (dimensions.width / 2 - box.x) / 1000.0,
                        (bottom_mm + product.height / 2) / 1000.0,
                    ),
                    yaw_deg=_turn(field, box),
                )
            )
        bottom_mm += product.height
    return PatternPallet(
        number=number,
        name=pattern.name if number == 1 else f"{pattern.name} (second station)",
        size_m=(dimensions.length / 1000.0, dimensions.width / 1000.0),
        deck_height_m=dimensions.palletHeight / 1000.0 if dimensions.palletHeight else None,
        max_height_m=dimensions.maxLoadHeight / 1000.0 if dimensions.maxLoadHeight else None,
        max_mass_kg=None,
        packages=name_by_layer(number_layers(packages)),
        notes=_notes(pattern, layers),
    )


def _separator(field: str, pattern: _Pattern, index: int, bottom_mm: float, height_mm: float) -> Package:
    length, width = pattern.dimensions.length / 1000.0, pattern.dimensions.width / 1000.0
    return place(
        field,
        id=f"box-{index}",
        size_m=(length, width, height_mm / 1000.0),
        mass_kg=length * width * height_mm / 1000.0 * SEPARATOR_DENSITY,
        position_m=(0.0, 0.0, (bottom_mm + height_mm / 2) / 1000.0),
        interlayer=True,
    )


def _turn(field: str, box: _Box) -> float:
    turns = {turn % 180.0 for turn in box.r}
    if len(turns) != 1 or not turns <= {0.0, 90.0}:
        raise RefusedInput(f"{field}.r", list(box.r), "quarter turns in degrees, all along the same edge")
    return box.r[0] % 360.0


def _notes(pattern: _Pattern, layers: Sequence[_Layer]) -> tuple[str, ...]:
    notes = []
    separators = [layer.type for layer in layers if layer.type.kind == "separator"]
    if separators:
        notes.append(f"separators have no weight in the file: taken at {SEPARATOR_DENSITY:g} kg/m3")
    if any(separator.height is None for separator in separators):
        notes.append(f"a separator has no height in the file: taken as {SEPARATOR_HEIGHT_MM:g} mm")
    if pattern.guiSettings.units != "metric":
        notes.append(
            f"display units are {pattern.guiSettings.units}; figures are read as millimetres and grams"
        )
    return tuple(notes)
