"""Message definitions and type hashes from the installed ROS packages, as a bag carries them."""

import hashlib
import json
import os
import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from config.errors import RefusedInput

TF_MESSAGE = "tf2_msgs/msg/TFMessage"
_TRANSFORM = "geometry_msgs/msg/TransformStamped"
_NESTED_TYPE_UNBOUNDED_SEQUENCE = 145  # type_description_interfaces/msg/FieldType

TypeDescription = Mapping[str, Any]


@dataclass(frozen=True)
class MessageDefinition:
    """What a bag says about a message type.

    Attributes:
        type_name: such as ``sensor_msgs/msg/Imu``.
        text: the ``ros2msg`` definition, followed by those of every type it holds.
        type_hash: ``RIHS01_`` and 64 hexadecimal digits (REP-2016).
        encoding: what the text is written in.
    """

    type_name: str
    text: str
    type_hash: str
    encoding: str = "ros2msg"


@cache
def message_definition(type_name: str) -> MessageDefinition:
    """Definition and hash of an installed message type, or of ``tf2_msgs/msg/TFMessage``.

    Raises:
        RefusedInput: the type is not installed.
    """
    if type_name == TF_MESSAGE:
        # The wheels hold no tf2_msgs; the type is one sequence of an installed one.
        root, referenced = _tf_description()
        root_text = f"{_short_name(_TRANSFORM)}[] transforms\n"
    else:
        root, referenced = _installed_description(type_name)
        root_text = _installed_file(type_name, ".msg").read_text(encoding="utf-8")
    names = sorted(description["type_name"] for description in referenced)
    texts = [
        f"{'=' * 80}\nMSG: {_short_name(name)}\n{_installed_file(name, '.msg').read_text(encoding='utf-8')}"
        for name in names
    ]
    text = "\n".join((root_text.rstrip("\n"), *(part.rstrip("\n") for part in texts))) + "\n"
    return MessageDefinition(type_name, text, type_hash(root, referenced))


def type_hash(root: TypeDescription, referenced: Iterable[TypeDescription]) -> str:
    """RIHS01 hash of a type description: SHA-256 of its JSON without default values (REP-2016).

    Args:
        root: ``type_name`` and ``fields`` of the type.
        referenced: those of every type that it holds, directly or not.
    """
    ordered = sorted(referenced, key=lambda description: description["type_name"])
    hashed = {
        "type_description": _without_defaults(root),
        "referenced_type_descriptions": [_without_defaults(description) for description in ordered],
    }
    text = json.dumps(hashed, separators=(", ", ": "))
    return "RIHS01_" + hashlib.sha256(text.encode()).hexdigest()


def _without_defaults(description: TypeDescription) -> TypeDescription:
    fields = [{"name": field["name"], "type": field["type"]} for field in description["fields"]]
    return {"type_name": description["type_name"], "fields": fields}


def _tf_description() -> tuple[TypeDescription, list[TypeDescription]]:
    transform, referenced = _installed_description(_TRANSFORM)
    field_type = {
        "type_id": _NESTED_TYPE_UNBOUNDED_SEQUENCE,
        "capacity": 0,
        "string_capacity": 0,
        "nested_type_name": _TRANSFORM,
    }
    root = {"type_name": TF_MESSAGE, "fields": [{"name": "transforms", "type": field_type}]}
    return root, [transform, *referenced]


def _installed_description(type_name: str) -> tuple[TypeDescription, list[TypeDescription]]:
    description = json.loads(_installed_file(type_name, ".json").read_text(encoding="utf-8"))
    message = description["type_description_msg"]
    return message["type_description"], message["referenced_type_descriptions"]


def _installed_file(type_name: str, suffix: str) -> Path:
    package, _, name = type_name.partition("/msg/")
    # Only plain names may become a path: the type name can come from a recording.
    if package.isidentifier() and name.isidentifier():
        # A system installation of ROS names its prefixes; the wheels use the environment's own.
        prefixes = [*filter(None, os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)), sys.prefix]
        for prefix in prefixes:
            path = Path(prefix, "share", package, "msg", name + suffix)
            if path.is_file():
                return path
    raise RefusedInput("message type", type_name, "is not installed")


def _short_name(type_name: str) -> str:
    return type_name.replace("/msg/", "/")
