"""Makes an unfinished bag whole: every complete chunk of a ``.part`` file, with index and metadata."""

import shutil
from pathlib import Path

from mcap.exceptions import McapError
from mcap.records import Attachment, Channel, Message, Schema
from mcap.stream_reader import StreamReader

from config.errors import BrokenRecording
from config.scene_file import scene_from_json
from msgs_adapters.topics import SCENE, QosSpec, Topic, message_class
from recordings.bag_writer import UNFINISHED_SUFFIX, BagWriter
from recordings.rosbag2_metadata import parse_qos
from recordings.test_bag import attach_scene


def rescue_bag(directory: Path) -> int:
    """Rewrites the unfinished file of a bag directory as a finished bag; returns its message count.

    Raises:
        BrokenRecording: there is no unfinished file, or nothing in it can be read.
    """
    parts = sorted(directory.glob(f"*{UNFINISHED_SUFFIX}"))
    if len(parts) != 1:
        raise BrokenRecording("bag", str(directory), "holds no unfinished recording")
    # The broken file stays until the whole one is there.
    aside = directory.with_name(directory.name + ".broken")
    directory.rename(aside)
    try:
        count = _copy_messages(aside / parts[0].name, directory)
    except OSError:
        shutil.rmtree(directory, ignore_errors=True)
        aside.rename(directory)
        raise
    for entry in aside.iterdir():
        entry.unlink()
    aside.rmdir()
    return count


def _copy_messages(source: Path, directory: Path) -> int:
    schemas: dict[int, Schema] = {}
    channels: dict[int, tuple[str, Topic]] = {}
    scene_json: str | None = None
    with BagWriter(directory) as writer, source.open("rb") as stream:
        try:
            for record in StreamReader(stream).records:
                if isinstance(record, Schema):
                    schemas[record.id] = record
                elif isinstance(record, Channel):
                    topic = Topic(record.topic, schemas[record.schema_id].name, _qos(record))
                    channels[record.id] = (writer.add_topic(topic), topic)
                elif isinstance(record, Message):
                    name, topic = channels[record.channel_id]
                    writer.write(
                        name, record.data, log_time_ns=record.log_time, publish_time_ns=record.publish_time
                    )
                    if scene_json is None and topic.name.endswith(f"/{SCENE.name}"):
                        scene_json = _text(topic, record.data)
                elif isinstance(record, Attachment):
                    writer.attach(record.name, record.media_type, record.data)
        except McapError:
            pass  # The end of what is whole.
        if scene_json is not None:
            attach_scene(writer, scene_from_json(scene_json))
        writer.add_metadata(
            "pallet-twin recorder", {"rescued": "the recorder was ended before it could finish"}
        )
        return sum(writer.message_counts.values())


def _qos(channel: Channel) -> QosSpec:
    return parse_qos(channel.metadata.get("offered_qos_profiles", ""))


def _text(topic: Topic, payload: bytes) -> str:
    from rclpy.serialization import deserialize_message

    return str(deserialize_message(payload, message_class(topic.type_name)).data)
