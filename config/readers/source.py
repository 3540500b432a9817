"""The bytes of a palletising file: read within limits, parsed without trust, checked against a schema."""

import hashlib
import json
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn
from xml.etree.ElementTree import Element, ParseError

from config.errors import RefusedInput

if TYPE_CHECKING:
    from xmlschema import XMLSchema11

SIZE_LIMIT_BYTES = 64 * 1024 * 1024
TAG_LIMIT = 2_000_000
DEPTH_LIMIT = 32


def read_source(path: Path) -> tuple[str, str]:
    """Read a text file whole.

    Returns:
        Its text without a byte-order mark, and the SHA-256 of its bytes in hex.

    Raises:
        RefusedInput: no such file, not a regular file, above 64 MiB, or not UTF-8.
    """
    try:
        if path.is_dir():
            raise RefusedInput("file", str(path), "a palletising file, not a directory")
        if not path.is_file():
            raise RefusedInput("file", str(path), "no such file")
        size = path.stat().st_size
        if size > SIZE_LIMIT_BYTES:
            raise RefusedInput("file", f"{path} ({size} bytes)", f"at most {SIZE_LIMIT_BYTES} bytes")
        content = path.read_bytes()
    except (OSError, ValueError) as error:
        raise RefusedInput("file", str(path), f"cannot be read: {error}") from None
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise RefusedInput("file", str(path), f"UTF-8 text (byte {error.start} is not)") from None
    return text, hashlib.sha256(content).hexdigest()


def parse_json(text: str) -> object:
    """Parse JSON as the standard has it: no NaN, no infinities, no key twice.

    Raises:
        RefusedInput: anything else, with the line and column where known.
    """

    def refuse_constant(name: str) -> NoReturn:
        raise RefusedInput("JSON", name, "a finite number")

    def unique_keys(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        found = dict(pairs)
        if len(found) < len(pairs):
            keys = [key for key, _ in pairs]
            twice = next(key for key in keys if keys.count(key) > 1)
            raise RefusedInput("JSON", twice, "each key once in its object")
        return found

    try:
        return json.loads(text, parse_constant=refuse_constant, object_pairs_hook=unique_keys)
    except json.JSONDecodeError as error:
        place = f"line {error.lineno}, column {error.colno}"
        raise RefusedInput("JSON", place, f"not valid JSON: {error.msg}") from None
    except (ValueError, RecursionError) as error:
        raise RefusedInput("JSON", type(error).__name__, f"not usable JSON: {error}") from None


def parse_xml(text: str) -> Element:
    """Parse XML that carries no document type, no entities and no external references.

    Raises:
        RefusedInput: not well-formed, holding any of those, or absurdly large or deep.
    """
    from defusedxml import DefusedXmlException  # type: ignore[import-untyped]
    from defusedxml.ElementTree import fromstring  # type: ignore[import-untyped]

    tags = text.count("<")
    if tags > TAG_LIMIT:
        raise RefusedInput("XML", f"{tags} tags", f"at most {TAG_LIMIT}")
    try:
        root: Element = fromstring(text, forbid_dtd=True, forbid_entities=True, forbid_external=True)
    except DefusedXmlException as error:
        kind = type(error).__name__
        raise RefusedInput("XML", kind, "no document type, entities or external references") from None
    except ParseError as error:
        raise RefusedInput("XML", "text", f"not well-formed XML: {error}") from None
    except (ValueError, LookupError) as error:
        raise RefusedInput("XML", "text", f"not usable XML: {error}") from None
    # A recursive validator must not meet a tree deeper than these formats ever are.
    level = [root]
    for _ in range(DEPTH_LIMIT):
        level = [child for parent in level for child in parent]
        if not level:
            return root
    raise RefusedInput("XML", f"more than {DEPTH_LIMIT} nested elements", f"at most {DEPTH_LIMIT}")


def check_schema(root: Element, schema_name: str) -> None:
    """Check a tree against one of the schemas in this package; nothing is fetched.

    Raises:
        RefusedInput: at the first violation, with the element's path, its text and the reason.
    """
    error = next(_schema(schema_name).iter_errors(root, use_location_hints=False), None)
    if error is None:
        return
    field = (error.path or root.tag).lstrip("/")
    found = error.elem
    value = "" if found is None else f"<{found.tag}>" if len(found) else (found.text or "").strip()
    raise RefusedInput(field, value or "(empty)", error.reason or error.message)


@cache
def _schema(name: str) -> "XMLSchema11":
    from xmlschema import XMLSchema11

    return XMLSchema11(Path(__file__).parent / "schemas" / name, allow="local", use_location_hints=False)
