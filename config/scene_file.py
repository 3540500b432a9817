"""From a file on disk to a resolved scene: reading, overriding, validating, fetching the load."""

import json
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pydantic import ValidationError

from config.errors import RefusedInput
from config.materials import material_library
from config.package import Package
from config.scene import CustomPallet, FileLoad, FilePallet, PackagesLoad, PatternSource, Scene
from config.shipped import SCENES

if TYPE_CHECKING:
    from config.readers import PatternFile

MAXIMUM_SCENE_BYTES = 16 * 2**20
_UNION_TAGS = {"packages", "file", "epal1", "custom", "eumos", "table", "recorded"}


def shipped_scenes() -> list[str]:
    """Names of the scenes that come with the product."""
    return SCENES.names()


def find_scene(name_or_path: str) -> Path:
    """The path of a scene file: a path as given, or the name of a shipped scene.

    Raises:
        RefusedInput: neither exists.
    """
    return SCENES.find(name_or_path)


def read_scene(path: Path, overrides: Sequence[str] = ()) -> Scene:
    """Reads a scene file, or builds a default test around a palletising file, and resolves it.

    Args:
        path: scene JSON, or a palletising file in any format that the readers know.
        overrides: ``key=value`` texts, as given to ``--set``.

    Raises:
        RefusedInput: anything in the file or the overrides that cannot be used.
    """
    raw = _read_raw(path)
    for override in overrides:
        apply_override(raw, override)
    return resolve_scene(validate_scene(raw), path.parent)


def overridden(scene: Scene, overrides: Sequence[str]) -> Scene:
    """A resolved scene with some values changed, as ``--set`` changes them.

    Raises:
        RefusedInput: an override cannot be used.
    """
    raw = json.loads(scene.to_json())
    for override in overrides:
        apply_override(raw, override)
    return validate_scene(raw)


def validate_scene(raw: object) -> Scene:
    """Builds the scene model.

    Raises:
        RefusedInput: the first value that breaks the schema, by field, value and limit.
    """
    try:
        return Scene.model_validate(raw)
    except ValidationError as error:
        raise refusal(error) from None


def scene_from_json(text: str) -> Scene:
    """Rebuilds a scene from the text that a node or a bag carries.

    Raises:
        RefusedInput: the text is not a scene.
    """
    return validate_scene(_parse_json(text, "scene"))


def resolve_scene(scene: Scene, base: Path, *, read: "Callable[[Path], PatternFile] | None" = None) -> Scene:
    """Fetches load and pallet from the palletising file, so that the scene stands on its own.

    Args:
        scene: a valid scene.
        base: folder that relative paths start from.
        read: reads a palletising file; by default the format's own reader.

    Raises:
        RefusedInput: the file, the pallet number, a layer or a surface is not to be had.
    """
    if isinstance(scene.load, FileLoad):
        scene = _resolve_pattern(scene, scene.load, base, read)
    elif isinstance(scene.pallet, FilePallet):
        raise RefusedInput(
            "pallet.kind", "file", "needs load.file, a palletising file to take the pallet from"
        )
    _check_surfaces(scene)
    return scene


def friction_table(scene: Scene) -> dict[frozenset[str], float]:
    """Known friction of the pairs of surfaces in the scene, keyed by the pair.

    The scene's own pairs come before the library's. A pair that neither names is absent: whether it is
    needed depends on what touches what.
    """
    named = {frozenset(pair.between): pair.friction for pair in scene.surfaces.pairs}
    packages = {package.surface for package in scene.packages}
    grounds = {"sled"}
    pallet = scene.pallet_box
    if pallet is not None:
        grounds.add(pallet.surface)
    possible = {frozenset((one, other)) for one in packages for other in packages | grounds}
    if pallet is not None and not pallet.fixed:
        possible.add(frozenset((pallet.surface, "sled")))
    table: dict[frozenset[str], float] = {}
    for pair in possible:
        first, second = (sorted(pair) * 2)[:2]
        entry = material_library().pair(first, second)
        if pair in named:
            table[pair] = named[pair]
        elif entry is not None:
            table[pair] = entry.friction
    return table


def _read_raw(path: Path) -> dict[str, Any]:
    # A palletising file may be larger; its own reader sets its limit.
    if path.suffix.lower() == ".xml" and path.is_file() and path.stat().st_size > MAXIMUM_SCENE_BYTES:
        return _scene_around(path)
    content = _read_bytes(path, "scene")
    if content.lstrip(b"\xef\xbb\xbf \t\r\n").startswith(b"<"):
        return _scene_around(path)
    raw = _json_object(content, path, "scene", "UTF-8 JSON, or a palletising file")
    if "productDimensions" in raw or "layerTypes" in raw:
        return _scene_around(path)
    return raw


def read_json(path: Path, source: str) -> dict[str, Any]:
    """The JSON object in a file; a key that stands twice, or a number that is none, is refused.

    Args:
        path: the file.
        source: what a refusal names.

    Raises:
        RefusedInput: the file cannot be read, or holds something else.
    """
    return _json_object(_read_bytes(path, source), path, source, "UTF-8 JSON")


def _read_bytes(path: Path, source: str) -> bytes:
    try:
        size = path.stat().st_size
        if not path.is_file():
            raise RefusedInput(source, str(path), "must be a file")
        if size > MAXIMUM_SCENE_BYTES:
            raise RefusedInput(source, f"{path} of {size} bytes", f"at most {MAXIMUM_SCENE_BYTES} bytes")
        return path.read_bytes()
    except OSError as error:
        raise RefusedInput(source, str(path), error.strerror or "cannot be read") from None


def _json_object(content: bytes, path: Path, source: str, wanted: str) -> dict[str, Any]:
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise RefusedInput(source, str(path), f"must be {wanted}") from None
    raw = _parse_json(text, str(path))
    if not isinstance(raw, dict):
        raise RefusedInput(source, type(raw).__name__, "must be a JSON object")
    return raw


def _scene_around(path: Path) -> dict[str, Any]:
    """The default test of a bare palletising file: 0.5 g, pallet as the file has it."""
    name = (
        "".join(c if (c.isascii() and c.isalnum()) or c in "_-." else "_" for c in path.stem).lstrip("_-.")
        or "load"
    )
    return {
        "name": name[:80],
        "load": {"file": path.name},
        "pallet": {"kind": "file"},
        "sled": {"profile": "eumos", "level_g": 0.5},
    }


def _parse_json(text: str, source: str) -> Any:
    def refuse_constant(name: str) -> float:
        raise RefusedInput(source, name, "must be a finite number")

    def refuse_duplicates(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        found = dict(pairs)
        if len(found) < len(pairs):
            keys = [key for key, _ in pairs]
            twice = next(key for key in keys if keys.count(key) > 1)
            raise RefusedInput(source, twice, "the key stands twice in one object")
        return found

    try:
        return json.loads(text, parse_constant=refuse_constant, object_pairs_hook=refuse_duplicates)
    except json.JSONDecodeError as error:
        raise RefusedInput(
            source, f"line {error.lineno}, column {error.colno}", f"is not JSON: {error.msg}"
        ) from None
    except (RecursionError, ValueError) as error:
        raise RefusedInput(source, type(error).__name__, f"is not JSON that can be read: {error}") from None


def apply_override(raw: dict[str, Any], override: str) -> None:
    """Puts a ``key=value`` text into raw JSON; the value is JSON where it can be, else text.

    Raises:
        RefusedInput: it is no such text, or its key leads through a value.
    """
    key, equals, text = override.partition("=")
    if not equals or not key:
        raise RefusedInput("--set", override, "must be KEY=VALUE, such as sled.level_g=0.6")
    try:
        value = json.loads(text)
    except (ValueError, RecursionError):
        value = text
    if isinstance(value, float) and not math.isfinite(value):
        raise RefusedInput(key, text, "must be a finite number")
    set_value(raw, key, value, source="--set")


def set_value(raw: dict[str, Any], key: str, value: Any, *, source: str) -> None:
    """Puts a value under a dotted key into raw JSON, and makes the parts on the way to it.

    Raises:
        RefusedInput: the key leads through a value, or beyond the end of a list; named by ``source``.
    """
    *parents, last = key.split(".")
    if parents[:1] == ["pallet"] and "pallet" not in raw:
        raw["pallet"] = {"kind": "epal1"}
    node: Any = raw
    for depth, part in enumerate(parents):
        if isinstance(node, list):
            node = node[_list_index(node, part, key, source)]
        else:
            if node.get(part) is None:
                node[part] = {}
            node = node[part]
        if not isinstance(node, (dict, list)):
            raise RefusedInput(source, key, f"{'.'.join(parents[: depth + 1])} holds a value, not a part")
    if isinstance(node, list):
        node[_list_index(node, last, key, source)] = value
    else:
        node[last] = value


def _list_index(items: list[Any], part: str, key: str, source: str) -> int:
    if not part.isdecimal() or int(part) >= len(items):
        raise RefusedInput(source, key, f"'{part}' must be a number from 0 to {len(items) - 1}")
    return int(part)


def refusal(error: ValidationError, source: str = "scene") -> RefusedInput:
    """The first of a model's complaints in one line, by field, value and limit.

    Args:
        error: what the model said.
        source: what is named where the complaint has no field.
    """
    first, count = error.errors()[0], error.error_count()
    place = [str(part) for part in first["loc"]]
    field = ".".join(
        part
        for i, part in enumerate(place)
        if not (i == 1 and place[0] in ("load", "pallet", "sled") and part in _UNION_TAGS) and "[" not in part
    )
    limit = first["msg"].removeprefix("Value error, ").replace("Input should", "must")
    if first["type"] == "extra_forbidden":
        limit = "unknown key"
    elif first["type"] == "missing":
        limit = "is required"
    elif first["type"] == "union_tag_invalid":
        field, limit = f"{field}.profile", f"must be one of {first['ctx']['expected_tags']}"
    elif field == "pallet.kind":
        limit = "must be 'epal1', 'custom' or 'file'; or pallet null"
    if ("size_m" in field or "position_m" in field) and first["type"] == "less_than_equal":
        limit += " m; is it given in millimetres?"
    if count > 1:
        limit += f" ({count - 1} more like this)" if count > 2 else " (1 more)"
    value = first["input"]
    if first["type"] == "union_tag_invalid":
        value = first["ctx"]["tag"]
    shown = f"{{{len(value)} keys}}" if isinstance(value, dict) else value
    if first["type"] == "missing":
        shown = "missing"
    return RefusedInput(field or source, shown, limit)


def _resolve_pattern(
    scene: Scene, load: FileLoad, base: Path, read: "Callable[[Path], PatternFile] | None"
) -> Scene:
    from config.readers import choose_pallet, read_pattern, vary_layers

    file = (read or read_pattern)(base / load.file)
    pattern = choose_pallet(file, load.pallet_number)
    pattern = vary_layers(
        pattern, layers=load.layers, rotate_layers=load.rotate_layers, mirror_layers=load.mirror_layers
    )
    pallet = scene.pallet
    if isinstance(pallet, FilePallet):
        pallet = CustomPallet(
            size_m=(*pattern.size_m, pattern.deck_height_m or pallet.height_m),
            mass_kg=pallet.mass_kg,
            surface=pallet.surface,
            fixed=pallet.fixed,
        )
    scene = scene.model_copy(update={"pallet": pallet})
    deck_z = scene.pallet_box.size_m[2] if scene.pallet_box is not None else 0.0
    packages = tuple(_place(package, load, deck_z) for package in pattern.packages)
    sheets = sum(package.kind == "interlayer" for package in packages)
    notes = pattern.notes
    if sheets:
        notes = (
            *notes,
            f"{sheets} interlayers are taken as '{load.interlayer_surface}' (load.interlayer_surface)",
        )
    source = PatternSource(
        file=Path(load.file).name,
        format=file.format,
        sha256=file.sha256,
        pallet_number=pattern.number,
        notes=notes,
    )
    return validate_scene(
        {**scene.model_dump(), "load": PackagesLoad(packages=packages, source=source).model_dump()}
    )


def _place(package: Package, load: FileLoad, deck_z: float) -> Package:
    x, y, z = package.position_m
    length, width, height = package.size_m
    is_sheet = package.kind == "interlayer"
    trim = 0.0 if is_sheet else load.clearance_m
    if min(length, width) <= 4.0 * trim:
        raise RefusedInput(
            "load.clearance_m",
            load.clearance_m,
            f"must be under a quarter of the smallest edge ({package.id})",
        )
    return package.model_copy(
        update={
            "position_m": (x, y, z + deck_z),
            "size_m": (length - trim, width - trim, height),
            "surface": load.interlayer_surface if is_sheet else load.surface,
        }
    )


def _check_surfaces(scene: Scene) -> None:
    library = set(material_library().surfaces)
    known = library | {name for pair in scene.surfaces.pairs for name in pair.between}
    limit = f"unknown material; known: {', '.join(sorted(known))}"
    for index, package in enumerate(scene.packages):
        if package.surface not in known:
            raise RefusedInput(f"load.packages.{index}.surface", package.surface, limit)
    if scene.pallet_box is not None and scene.pallet_box.surface not in known:
        raise RefusedInput("pallet.surface", scene.pallet_box.surface, limit)
    used = {package.surface for package in scene.packages} | {"sled"}
    if scene.pallet_box is not None:
        used.add(scene.pallet_box.surface)
    for index, pair in enumerate(scene.surfaces.pairs):
        for name in pair.between:
            if name not in library | used:
                limit = f"nothing here has this surface; there are: {', '.join(sorted(used))}"
                raise RefusedInput(f"surfaces.pairs.{index}", name, limit)
