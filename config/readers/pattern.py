"""Reads a palletising file of any supported format, and chooses one pallet of it."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from config.errors import RefusedInput
from config.readers import nist, pally, stackbuilder
from config.readers.layers import vary_layers
from config.readers.pallet import EMPTY_PACK_LIST, PatternPallet
from config.readers.source import parse_json, parse_xml, read_source

__all__ = ["PatternFile", "PatternFormat", "PatternPallet", "choose_pallet", "read_pattern", "vary_layers"]

PatternFormat = Literal["stackbuilder", "nist", "pally"]


@dataclass(frozen=True)
class PatternFile:
    """What a palletising file holds.

    Attributes:
        format: which of the three formats the content has.
        sha256: of the file's bytes, in hex.
        pallets: in file order.
    """

    format: PatternFormat
    sha256: str
    pallets: tuple[PatternPallet, ...]


def read_pattern(path: Path) -> PatternFile:
    """Read a palletising file; its content decides the format, not its name.

    Raises:
        RefusedInput: anything that is not a sound file of a supported format, named by element and value.
    """
    text, sha256 = read_source(path)
    start = text.lstrip()[:1]
    if start == "<":
        return _read_xml(text, sha256)
    if start in ("{", "["):
        return _read_json(text, sha256)
    raise RefusedInput("file", str(path), "XML or JSON of a supported palletising format")


def choose_pallet(file: PatternFile, number: int | None) -> PatternPallet:
    """The pallet of that number; None stands for the only one of a file that has one.

    Raises:
        RefusedInput: no such number, several pallets and no number, or a pallet without packages.
    """
    numbers = ", ".join(str(pallet.number) for pallet in file.pallets)
    if number is None and len(file.pallets) > 1:
        raise RefusedInput("pallet_number", "none", f"the file has several pallets, name one of {numbers}")
    for pallet in file.pallets:
        if number is None or pallet.number == number:
            if not pallet.packages:
                raise RefusedInput("pallet_number", pallet.number, EMPTY_PACK_LIST)
            return pallet
    raise RefusedInput("pallet_number", number, f"one of {numbers}")


def _read_xml(text: str, sha256: str) -> PatternFile:
    root = parse_xml(text)
    namespace, tag = root.tag[1:].split("}") if root.tag.startswith("{") else ("", root.tag)
    if tag == stackbuilder.ROOT and namespace in ("", stackbuilder.NAMESPACE):
        for element in root.iter():
            element.tag = element.tag.removeprefix(f"{{{stackbuilder.NAMESPACE}}}")
        return PatternFile("stackbuilder", sha256, stackbuilder.read_stackbuilder(root))
    if tag == nist.ROOT and not namespace:
        return PatternFile("nist", sha256, nist.read_nist(root))
    limit = (
        f"root {stackbuilder.ROOT} (StackBuilder, its namespace or none) or {nist.ROOT} (NIST, no namespace)"
    )
    raise RefusedInput("XML root", root.tag, limit)


def _read_json(text: str, sha256: str) -> PatternFile:
    data = parse_json(text)
    if not isinstance(data, dict) or not any(key in data for key in ("layerTypes", "productDimensions")):
        shown = ", ".join(data) if isinstance(data, dict) else type(data).__name__
        raise RefusedInput("JSON keys", shown or "(none)", f"{', '.join(pally.KEYS)} (Pally)")
    return PatternFile("pally", sha256, pally.read_pally(data))
