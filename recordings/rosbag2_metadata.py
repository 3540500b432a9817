"""The metadata.yaml beside a bag's file, and the QoS profiles inside both, as Jazzy writes them."""

from collections.abc import Sequence
from dataclasses import dataclass
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


def qos_text(spec: QosSpec) -> str:
    """The same as YAML text, as a channel's ``offered_qos_profiles`` holds it."""
    return _dump(qos_profiles(spec)).rstrip("\n")


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


def bag_information(
    file_name: str, topics: Sequence[TopicSummary], start_ns: int, end_ns: int
) -> dict[str, Any]:
    """The content of a bag of one file.

    Args:
        file_name: the MCAP file, beside metadata.yaml.
        topics: every topic, those without messages too.
        start_ns: log time of the first message [ns]; 0 when there is none.
        end_ns: log time of the last message [ns].
    """
    count = sum(topic.message_count for topic in topics)
    starting_time = {"nanoseconds_since_epoch": start_ns}
    duration = {"nanoseconds": end_ns - start_ns}
    span = {"starting_time": starting_time, "duration": duration, "message_count": count}
    return {
        "version": METADATA_VERSION,
        "storage_identifier": "mcap",
        "duration": duration,
        "starting_time": starting_time,
        "message_count": count,
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
        "relative_file_paths": [file_name],
        "files": [{"path": file_name, **span}],
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


def read_file_name(path: Path) -> str:
    """The name of the one MCAP file of which a metadata.yaml speaks.

    Raises:
        BrokenRecording: it is not YAML, not of a bag, or of a bag that is not one MCAP file.
    """
    try:
        information = yaml.safe_load(path.read_text(encoding="utf-8"))[_ROOT]
        storage, files = information["storage_identifier"], information["relative_file_paths"]
    except (OSError, yaml.YAMLError, UnicodeDecodeError, TypeError, LookupError, RecursionError):
        raise BrokenRecording("bag", str(path), "is not the metadata of a rosbag2 recording") from None
    if storage != "mcap":
        raise BrokenRecording(f"{path.name}.storage_identifier", storage, "must be 'mcap'")
    if not isinstance(files, list) or len(files) != 1 or not isinstance(files[0], str):
        raise BrokenRecording(f"{path.name}.relative_file_paths", files, "must name one file")
    # A bag comes from outside: its file must stand beside its metadata.
    if Path(files[0]).name != files[0] or files[0] == "..":
        raise BrokenRecording(f"{path.name}.relative_file_paths", files[0], "must be a name without a path")
    return files[0]


def _dump(content: Any) -> str:
    return yaml.dump(content, Dumper=_PlainDumper, sort_keys=False, allow_unicode=True, width=10_000)


class _PlainDumper(yaml.SafeDumper):
    """Writes equal values twice instead of naming one and referring to it."""

    def ignore_aliases(self, data: Any) -> bool:
        return True
