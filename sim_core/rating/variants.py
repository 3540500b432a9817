"""Variants of a scene: what may be varied, every combination of it, and which of them can be tested at all."""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path
from typing import Any

from config.errors import PalletTwinError, RefusedInput
from config.scene import Scene
from config.scene_file import find_scene, read_scene
from sim_core.integrity import require_integrity
from sim_core.rating.film_mass import film_mass_kg
from sim_core.rating.levels import FIRST_G, at_level

MAXIMUM_VARIANTS = 5000

Choice = tuple[str, tuple[str, ...]]
"""One value, or a few that belong together: its name, and ``KEY=VALUE`` texts as for ``--set``."""


@dataclass(frozen=True)
class Variant:
    """One packing of a load.

    Attributes:
        name: what differs, in words.
        overrides: ``KEY=VALUE`` texts that make it.
        scene: the resolved scene, or None where it is refused.
        film_kg: mass of its film [kg]; None where that is not known.
        refused: why it cannot be tested, or None.
    """

    name: str
    overrides: tuple[str, ...] = ()
    scene: Scene | None = field(default=None, repr=False)
    film_kg: float | None = None
    refused: str | None = None


def parse_vary(texts: Sequence[str]) -> list[list[Choice]]:
    """What is varied, an axis a list.

    Args:
        texts: each ``KEY=V1,V2,...`` with values as JSON or plain words, or a JSON file: an object
            ``{KEY: [V1, V2], ...}`` is an axis a key, a list ``[{"name": "...", KEY: V, ...}, ...]`` one axis.

    Raises:
        RefusedInput: one is neither.
    """
    axes: list[list[Choice]] = []
    for text in texts:
        key, equals, values = text.partition("=")
        if text.lower().endswith(".json") and (not equals or Path(text).is_file()):
            axes += _axes_of_file(Path(text))
        elif not equals or not key or not values:
            raise RefusedInput(
                "--vary", text, "must be KEY=VALUE,VALUE such as wrap.turns.middle=1,2,3, or a JSON file"
            )
        else:
            axes.append(_axis(key, _split(values)))
    keys = [override.partition("=")[0] for axis in axes for override in axis[0][1]]
    twice = next((key for key in keys if keys.count(key) > 1), None)
    if twice is not None:
        raise RefusedInput("--vary", twice, "is varied twice")
    return axes


def _axis(key: str, values: Sequence[str]) -> list[Choice]:
    """A key's values; those that differ in their last part alone, as paths in one folder do, go by that."""
    shorts = [value.rpartition("/")[2] if "[" not in value else value for value in values]
    names = shorts if len(set(shorts)) == len(values) else values
    return [(f"{key}={name}", (f"{key}={value}",)) for name, value in zip(names, values, strict=True)]


def _split(text: str) -> list[str]:
    """A text at the commas that stand in no bracket and no quotes."""
    parts, depth, is_quoted, begin = [], 0, False, 0
    for place, letter in enumerate(text):
        if letter == '"':
            is_quoted = not is_quoted
        elif not is_quoted and letter in "[{":
            depth += 1
        elif not is_quoted and letter in "]}":
            depth -= 1
        elif letter == "," and not is_quoted and depth == 0:
            parts.append(text[begin:place])
            begin = place + 1
    return [part.strip() for part in (*parts, text[begin:])]


def _axes_of_file(path: Path) -> list[list[Choice]]:
    try:
        raw = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise RefusedInput("--vary", str(path), f"is not JSON that can be read: {error}") from None
    if isinstance(raw, dict) and raw and all(isinstance(values, list) and values for values in raw.values()):
        return [[_choice({key: value}) for value in values] for key, values in raw.items()]
    if isinstance(raw, list) and raw and all(isinstance(entry, dict) and entry for entry in raw):
        return [[_choice(entry) for entry in raw]]
    limit = 'must hold {"KEY": [V1, V2], ...} or [{"name": "...", "KEY": V, ...}, ...]'
    raise RefusedInput("--vary", str(path), limit)


def _choice(entry: Mapping[str, Any]) -> Choice:
    overrides = tuple(
        f"{key}={json.dumps(value, ensure_ascii=False, separators=(',', ':'))}"
        for key, value in entry.items()
        if key != "name"
    )
    return str(entry.get("name") or " ".join(overrides) or "as it is"), overrides


def plan_variants(
    scene: str, overrides: Sequence[str] = (), axes: Sequence[Sequence[Choice]] = ()
) -> list[Variant]:
    """Every combination of the axes, each read anew from the scene's file, checked, and with the mass of its film.

    Relative paths in it, such as that of ``load.file``, start from the scene file's folder. What cannot be tested
    is told of its variant.

    Args:
        scene: a scene file, a palletising file, or a shipped scene's name.
        overrides: ``KEY=VALUE`` texts for all variants.
        axes: what is varied, as ``parse_vary`` gives it; none for the scene alone.

    Raises:
        RefusedInput: no such scene, too many variants, or none of them can be tested.
    """
    path = find_scene(scene)
    count = 1
    for axis in axes:
        count *= len(axis)
    if count > MAXIMUM_VARIANTS:
        raise RefusedInput("--vary", f"{count} variants", f"at most {MAXIMUM_VARIANTS}")
    variants, first_error = [], None
    for name, chosen in _combinations(axes):
        try:
            variants.append(_variant(path, name, chosen, overrides))
        except PalletTwinError as error:
            first_error = first_error or error
            variants.append(Variant(name, chosen, refused=str(error)))
    if first_error is not None and all(variant.scene is None for variant in variants):
        raise first_error
    return variants


def _combinations(axes: Sequence[Sequence[Choice]]) -> Iterator[tuple[str, tuple[str, ...]]]:
    for choices in product(*axes):
        name = ", ".join(words for words, _ in choices)
        yield name or "as it is", tuple(text for _, texts in choices for text in texts)


def _variant(path: Path, name: str, chosen: tuple[str, ...], overrides: Sequence[str]) -> Variant:
    scene = read_scene(path, (*overrides, *chosen))
    require_integrity(at_level(scene, FIRST_G))
    return Variant(name, chosen, scene, film_mass_kg(scene))
