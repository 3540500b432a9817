"""The metadata.yaml beside a bag's file, and the QoS profiles inside both, as Jazzy writes them."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, lru_cache
from pathlib import Path
from typing import Any

import yaml

from config.errors import BrokenRecording
from msgs_adapters.topics import QosSpec

METADATA_FILE = "metadata.yaml"
METADATA_VERSION = 9
"""rosbag2's own number: QoS names are words since 9."""

_ROOT = "rosbag2_bagfile_information"
_INFINITE = {"sec": 9223372036, "nsec": 854775807}


@dataclass(frozen=True)
class TopicSummary:
    """A recorded topic, under its absolute name, and how many messages it has."""

    name: str
    type_name: str
    type_hash: str
    qos: QosSpec
    message_count: int


def qos_profiles(spec: QosSpec) -> list[dict[str, Any]]:
    """The list of one profile that stands for ``spec``; what the twin does not choose is at ROS's default."""
    return [
        {
            "history": "keep_last",
            "depth": spec.depth,
            "reliability": spec.reliability,
            "durability": spec.durability,
            "deadline": dict(_INFINITE),
            "lifespan": dict(_INFINITE),
            "liveliness": "automatic",
            "liveliness_lease_duration": dict(_INFINITE),
            "avoid_ros_namespace_conventions": False,
        }
    ]


@cache
def qos_text(spec: QosSpec) -> str:
    """The same as YAML text, as a channel's ``offered_qos_profiles`` holds it."""
    return _dump(qos_profiles(spec)).rstrip("\n")


@lru_cache(256)
def parse_qos(text: str) -> QosSpec:
    """The first profile of a YAML text; the default where other tools wrote none or something else."""
    try:
        profile = yaml.safe_load(text)[0]
        depth = int(profile["depth"])
        latched = profile["durability"] in ("transient_local", 1)
        lossy = profile["reliability"] in ("best_effort", 2)
    except (yaml.YAMLError, TypeError, ValueError, LookupError):
        return QosSpec()
    return QosSpec(
        reliability="best_effort" if lossy else "reliable",
        durability="transient_local" if latched else "volatile",
        # Endpoints found by discovery report depth 0: they do not send theirs.
        depth=depth if depth > 0 else QosSpec.depth,
    )


@dataclass(frozen=True)
class FileSummary:
    """One MCAP file of a bag: its name, log times of its first and last message [ns], how many it has."""

    name: str
    start_ns: int
    end_ns: int
    message_count: int


def bag_information(files: Sequence[FileSummary], topics: Sequence[TopicSummary]) -> dict[str, Any]:
    """The content of a bag.

    Args:
        files: the MCAP files, beside metadata.yaml, in order.
        topics: every topic, those without messages too.
    """
    spans = [file for file in files if file.message_count] or list(files[:1])
    start_ns, end_ns = min(file.start_ns for file in spans), max(file.end_ns for file in spans)
    return {
        "version": METADATA_VERSION,
        "storage_identifier": "mcap",
        "duration": {"nanoseconds": end_ns - start_ns},
        "starting_time": {"nanoseconds_since_epoch": start_ns},
        "message_count": sum(file.message_count for file in files),
        "topics_with_message_count": [
            {
                "topic_metadata": {
                    "name": topic.name,
                    "type": topic.type_name,
                    "serialization_format": "cdr",
                    "offered_qos_profiles": qos_profiles(topic.qos),
                    "type_description_hash": topic.type_hash,
                },
                "message_count": topic.message_count,
            }
            for topic in topics
        ],
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [file.name for file in files],
        "files": [
            {
                "path": file.name,
                "starting_time": {"nanoseconds_since_epoch": file.start_ns},
                "duration": {"nanoseconds": file.end_ns - file.start_ns},
                "message_count": file.message_count,
            }
            for file in files
        ],
        "custom_data": None,
        "ros_distro": "jazzy",
    }


def information_text(information: dict[str, Any]) -> str:
    """YAML text for the record ``rosbag2`` inside the file, whose key is ``serialized_metadata``."""
    return _dump(information)


def write_metadata(directory: Path, information: dict[str, Any]) -> None:
    """Writes metadata.yaml, whole or not at all."""
    unfinished = directory / f"{METADATA_FILE}.part"
    unfinished.write_text(_dump({_ROOT: information}), encoding="utf-8")
    unfinished.replace(directory / METADATA_FILE)


def read_file_names(path: Path) -> list[str]:
    """The names of the MCAP files of which a metadata.yaml speaks, in order.

    Raises:
        BrokenRecording: it is not YAML, not of a bag, or of a bag that is not made of MCAP files beside it.
    """
    try:
        information = yaml.safe_load(path.read_text(encoding="utf-8"))[_ROOT]
        storage, files = information["storage_identifier"], information["relative_file_paths"]
    except (OSError, yaml.YAMLError, UnicodeDecodeError, TypeError, LookupError, RecursionError, ValueError):
        raise BrokenRecording("bag", str(path), "is not the metadata of a rosbag2 recording") from None
    if storage != "mcap":
        raise BrokenRecording(f"{path.name}.storage_identifier", storage, "must be 'mcap'")
    field = f"{path.name}.relative_file_paths"
    if not isinstance(files, list) or not files or not all(isinstance(name, str) for name in files):
        raise BrokenRecording(field, files, "must name at least one file")
    for name in files:
        # A bag comes from outside: its files must stand beside its metadata.
        if Path(name).name != name or name == ".." or "\0" in name:
            raise BrokenRecording(field, name, "must be a name without a path")
    if len(set(files)) != len(files):
        raise BrokenRecording(field, files, "names a file twice")
    return files


def _dump(content: Any) -> str:
    return yaml.dump(content, Dumper=_PlainDumper, sort_keys=False, allow_unicode=True, width=10_000)


class _PlainDumper(yaml.SafeDumper):
    """Writes equal values twice instead of naming one and referring to it."""

    def ignore_aliases(self, data: Any) -> bool:
        return True
