"""Makes a recording whole that was cut short or damaged, and says what is missing."""

import shutil
import tempfile
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Header, Metadata, Schema

from config.errors import BrokenRecording, RefusedInput
from config.scene_file import scene_from_json
from msgs_adapters.topics import SCENE, Topic, message_class
from recordings.bag_reader import BagReader, file_number, mcap_files
from recordings.bag_writer import (
    CONTINUED_RECORD,
    LIBRARY,
    ROSBAG2_RECORD,
    UNFINISHED_SUFFIX,
    BagWriter,
)
from recordings.mcap_file import is_being_written
from recordings.mcap_records import (
    HEAD,
    DamagedRecord,
    RawMessage,
    RawRecord,
    index_entries,
    parsed,
    records_of_chunk,
)
from recordings.mcap_source import McapSource, reading
from recordings.rosbag2_metadata import METADATA_FILE, parse_qos
from recordings.salvage import Damage, salvage
from recordings.schemas import MessageDefinition
from recordings.stamp_gaps import StampGaps
from recordings.test_bag import SCENE_ATTACHMENT, attach_scene

RECOVERY_RECORD = "pallet-twin recovery"
BROKEN_SUFFIX = ".broken"
_NAMING = (Opcode.SCHEMA, Opcode.CHANNEL)


@dataclass(frozen=True)
class Recovery:
    """What became of a recording.

    Attributes:
        bag: the directory that is whole now.
        was_whole: nothing was wrong, and nothing was done.
        counts: messages by absolute topic name.
        missing: how many messages a topic is known to lack, at least; topics that lack none are absent.
        damages: the bytes that could not be used, in order; the last may be a recording's missing end.
        start_ns: log time of the first message [ns].
        end_ns: log time of the last message [ns]; what came later is lost where the recording was cut.
        scene: whether the scene stands in the bag as an attachment still, again, or not at all.
        unchecked_names: names and types of topics come from an index whose checksum does not match.
        originals: the files as they were, where damage stands inside them; else they are gone, or untouched.
    """

    bag: Path
    was_whole: bool
    counts: Mapping[str, int]
    missing: Mapping[str, int]
    damages: tuple[Damage, ...]
    start_ns: int
    end_ns: int
    scene: Literal["whole", "restored", "absent"]
    unchecked_names: bool = False
    originals: tuple[Path, ...] = ()

    @property
    def message_count(self) -> int:
        """Messages of all topics."""
        return sum(self.counts.values())

    @property
    def is_cut(self) -> bool:
        """Whether the recording had no end."""
        return any(damage.is_end for damage in self.damages)

    def lines(self) -> list[str]:
        """All of this for a person, one fact a line."""
        duration_s = (self.end_ns - self.start_ns) / 1e9
        held = f"{self.message_count} messages of {sum(map(bool, self.counts.values()))} topics, {duration_s:.3f} s"
        if self.was_whole:
            return [f"{self.bag} is whole: {held}; nothing was changed"]
        lines = [f"{self.bag} is whole again: {held}"]
        lines += [self._told(damage) for damage in self.damages]
        lines += [f"missing {name}: at least {count} messages" for name, count in self.missing.items()]
        if not self.missing and not self.damages:
            lines.append("no message is missing")
        told = {"whole": "is there", "restored": "was made again from its message", "absent": "is not in it"}
        if self.unchecked_names:
            lines.append("topic names come from an index whose checksum does not match: they may be wrong")
        lines.append(f"the scene {told[self.scene]}")
        lines += [f"the damaged file is kept as {path}" for path in self.originals]
        return lines

    def _told(self, damage: Damage) -> str:
        span = ""
        if damage.span_ns is not None:
            first, last = ((time - self.start_ns) / 1e9 for time in damage.span_ns)
            span = f"; it held messages from {first:.3f} s to {last:.3f} s"
        place = f"{damage.file.name}: {damage.size} bytes at byte {damage.offset}"
        if damage.is_end:
            after_s = (self.end_ns - self.start_ns) / 1e9
            return (
                f"{place} are its unfinished end: nothing is known of what came after {after_s:.3f} s{span}"
            )
        return f"{place} are damaged ({damage.reason}){span}"


def recover_bag(path: Path, out: Path | None = None) -> Recovery:
    """Writes a recording anew from everything in it that is whole, with index and metadata.

    Chunks and attachments count as whole when their checksums match. The original is not touched before the
    new recording stands.

    Args:
        path: a recording's directory, or one of its files (``.mcap`` or ``.mcap.part``).
        out: directory of the new recording. By default it takes the place of a directory's files, which are
            kept with the suffix ``.broken`` if they are damaged inside and not only cut short; for a file it
            is ``<file>-recovered`` beside it.

    Raises:
        BrokenRecording: there is no recording, or nothing in it can be read.
        RefusedInput: it is being recorded, or ``out`` is not empty or cannot be made.
        OSError: the disk is full; the original is as it was.
    """
    files = _files_of(path)
    for file in files:
        with reading(file):
            if is_being_written(file):
                raise RefusedInput("bag", str(file), "is being recorded right now")
    if out is None and path.is_dir():
        whole = _if_whole(path)
        return whole if whole is not None else _recover_in_place(path, files)
    name = path.name.partition(".mcap")[0]
    out = out if out is not None else path.with_name(f"{name}-recovered")
    return _recover_into(files, out, out)


def rescue_bag(directory: Path) -> int:
    """Makes the directory of a recorder that was killed whole; returns its message count.

    Raises:
        BrokenRecording: there is no unfinished file, or nothing in it can be read.
    """
    if not any(directory.glob(f"*{UNFINISHED_SUFFIX}")):
        raise BrokenRecording("bag", str(directory), "holds no unfinished recording")
    return recover_bag(directory).message_count


def _files_of(path: Path) -> list[Path]:
    """The files that may hold messages, in order."""
    if path.is_file():
        return [path]
    if not path.is_dir():
        raise BrokenRecording("bag", str(path), "does not exist")
    found = {*path.glob("*.mcap"), *path.glob(f"*.mcap{UNFINISHED_SUFFIX}")}
    if not found:
        raise BrokenRecording("bag", str(path), "is no recording: it holds no .mcap file")
    with suppress(BrokenRecording):
        listed = mcap_files(path)
        # Some recorders name files in another way than by numbers.
        return listed + sorted(found - set(listed), key=file_number)
    return sorted(found, key=file_number)


def _if_whole(directory: Path) -> Recovery | None:
    if not (directory / METADATA_FILE).is_file():
        return None
    try:
        with BagReader(directory) as reader:
            reader.verify()
            counts = {name: topic.message_count for name, topic in reader.topics.items()}
            scene: Literal["whole", "absent"] = (
                "whole" if SCENE_ATTACHMENT in reader.attachment_names else "absent"
            )
            return Recovery(directory, True, counts, {}, (), reader.start_ns, reader.end_ns, scene)
    except BrokenRecording:
        return None


def _recover_in_place(directory: Path, files: Sequence[Path]) -> Recovery:
    directory = directory.resolve()
    # Beside the recording, so that moving is renaming; under its name, since that is in its files' names.
    with tempfile.TemporaryDirectory(prefix=f".{directory.name}-", dir=directory.parent) as work:
        recovery = _recover_into(files, Path(work, directory.name), directory)
        old = [*files, *directory.glob(METADATA_FILE)]
        aside = [(entry, _free_name(entry)) for entry in old]
        for entry, name in aside:
            entry.rename(name)
        for entry in sorted(Path(work, directory.name).iterdir()):
            shutil.move(entry, directory / entry.name)
    damaged = {damage.file for damage in recovery.damages if not damage.is_end}
    for entry, name in aside:
        if entry not in damaged:
            name.unlink()
    kept = tuple(name for entry, name in aside if entry in damaged)
    return replace(recovery, originals=kept)


def _free_name(entry: Path) -> Path:
    names = (entry.with_name(f"{entry.name}{BROKEN_SUFFIX}{number or ''}") for number in range(1_000_000))
    return next(name for name in names if not name.exists())


def _recover_into(files: Sequence[Path], out: Path, bag: Path) -> Recovery:
    split_bytes = max(file.stat().st_size for file in files) if len(files) > 1 else None
    writer = BagWriter(out, split_bytes=split_bytes, in_order=False)
    try:
        with writer:
            copy = _Copy(writer)
            for file in files:
                copy.add_file(file)
            if not copy.has_content:
                raise BrokenRecording("bag", str(bag), "holds no message that can be read")
            return copy.finish(bag)
    except (OSError, RefusedInput):
        shutil.rmtree(out, ignore_errors=True)
        raise


@dataclass
class _TopicState:
    """What is known of a topic so far."""

    last_sequence: int = -1
    skipped: int = 0
    gaps: StampGaps = field(default_factory=StampGaps)


class _Copy:
    """Copies what is whole in files, one after the other, into a new bag, and counts what is not."""

    def __init__(self, writer: BagWriter) -> None:
        self.topics: dict[str, _TopicState] = {}
        self._writer = writer
        self._damages: list[Damage] = []
        self._lost: Counter[str] = Counter()
        self._scene_json: str | None = None
        self._attachments: set[str] = set()
        self._is_unchecked = False
        self._span_ns: tuple[int, int] | None = None

    def add_file(self, path: Path) -> None:
        """Copies a file."""
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, str] = {}
        self._spare: list[RawRecord] = []
        self._numbers_its_messages = False
        self._kept: Counter[str] = Counter()
        lost: Counter[str] = Counter()
        counted = self._counts_of_index(path)
        # What names the channels may stand only behind the messages, when the chunk that began the file is lost.
        if not counted:
            found_records = (found[0] for found in salvage(path) if not isinstance(found, Damage))
            self._spare = [record for record in found_records if record.opcode in _NAMING]
        is_lost = False
        for found in salvage(path):
            if isinstance(found, Damage):
                self._damages.append(found)
                is_lost = True
                continue
            record, content = found
            if record.opcode == Opcode.CHUNK:
                is_lost = False
                self._add_all(content, record, path)
            elif record.opcode == Opcode.MESSAGE_INDEX and is_lost:
                # The index behind a chunk outlives it.
                channel_id, count = index_entries(record)
                lost[self._channels.get(channel_id, f"channel {channel_id}")] += count
            elif record.opcode == Opcode.MESSAGE:
                self._add_all(HEAD.pack(record.opcode, len(record.body)) + record.body, record, path)
            else:
                self._add_record(record)
        self._lost += lost | (counted - self._kept)

    def _counts_of_index(self, path: Path) -> Counter[str]:
        """How many messages of each topic a file has that still has its index; its channels are taken over."""
        counts: Counter[str] = Counter()
        with suppress(BrokenRecording):
            source = McapSource(path)
            source.close()
            for channel in source.channels.values():
                self._schemas[channel.schema_id] = source.schema_of(channel)
                self._add_channel(channel)
                counts[channel.topic] += source.statistics.channel_message_counts.get(channel.id, 0)
        return counts

    @property
    def has_content(self) -> bool:
        """Whether there is anything to finish: a message, or a recording that was cut before its first one."""
        is_damaged = any(not damage.is_end for damage in self._damages)
        return self._span_ns is not None or (self._numbers_its_messages and not is_damaged)

    def finish(self, bag: Path) -> Recovery:
        """Closes the new bag; ``bag`` is how it will be called."""
        scene: Literal["whole", "restored", "absent"] = "absent"
        if SCENE_ATTACHMENT in self._attachments:
            scene = "whole"
        elif self._scene_json is not None:
            # Another recorder's topic may have that name.
            with suppress(RefusedInput):
                attach_scene(self._writer, scene_from_json(self._scene_json))
                scene = "restored"
        counts = dict(self._writer.message_counts)
        missing = {name: self._missing(name) for name in {**counts, **self._lost}}
        missing = {name: count for name, count in missing.items() if count > 0}
        self._writer.add_metadata(RECOVERY_RECORD, self._record(missing, scene))
        self._writer.close()
        start_ns, end_ns = self._span_ns or (0, 0)
        return Recovery(
            bag, False, counts, missing, tuple(self._damages), start_ns, end_ns, scene, self._is_unchecked
        )

    def _record(self, missing: Mapping[str, int], scene: str) -> dict[str, str]:
        values = {"rescued": "from a recording that was damaged or not finished", "scene": scene}
        for number, damage in enumerate(self._damages):
            place = f"{damage.file.name}: {damage.size} bytes at byte {damage.offset}"
            values[f"damage {number}"] = f"{place}: {'its end' if damage.is_end else damage.reason}"
        return values | {f"missing {name}": str(count) for name, count in missing.items()}

    def _missing(self, name: str) -> int:
        """The largest of what index, numbers and stamps say; each may know less than the others."""
        state = self.topics.get(name, _TopicState())
        return max(self._lost[name], state.skipped, state.gaps.missing)

    def _add_record(self, record: RawRecord) -> None:
        if record.opcode == Opcode.HEADER:
            self._numbers_its_messages = parsed(record, Header).library.startswith(LIBRARY)
        elif record.opcode == Opcode.SCHEMA:
            self._add(parsed(record, Schema))
        elif record.opcode == Opcode.CHANNEL:
            self._add(parsed(record, Channel))
        elif record.opcode == Opcode.ATTACHMENT:
            attached = parsed(record, Attachment)
            self._attachments.add(attached.name)
            self._writer.attach(
                attached.name, attached.media_type, attached.data, log_time_ns=attached.log_time
            )
        elif record.opcode == Opcode.METADATA:
            metadata = parsed(record, Metadata)
            if metadata.name not in (ROSBAG2_RECORD, CONTINUED_RECORD):
                self._writer.add_metadata(metadata.name, metadata.metadata)

    def _add_all(self, content: bytes, record: RawRecord, path: Path) -> None:
        """Adds a chunk's records; one whose writer computed no checksum can be damaged all the same."""
        try:
            for part in records_of_chunk(content, record.offset):
                self._add(part)
        except DamagedRecord as error:
            size = record.end - record.offset
            self._damages.append(Damage(path, record.offset, size, str(error), False, None))

    def _add(self, part: RawMessage | Schema | Channel) -> None:
        if isinstance(part, Schema):
            self._schemas[part.id] = part
        elif isinstance(part, Channel):
            self._add_channel(part)
        else:
            self._add_message(part)

    def _add_channel(self, channel: Channel) -> None:
        schema = self._schemas.get(channel.schema_id)
        if schema is None or channel.id in self._channels:
            return
        type_hash = channel.metadata.get("topic_type_hash", "")
        text = schema.data.decode(errors="replace")
        definition = MessageDefinition(schema.name, text, type_hash, schema.encoding)
        topic = Topic(channel.topic, schema.name, parse_qos(channel.metadata.get("offered_qos_profiles", "")))
        # A name that stands for another type already is a damaged one; its messages count as lost.
        with suppress(RefusedInput):
            self._channels[channel.id] = self._writer.add_topic(topic, definition=definition)
            self.topics.setdefault(self._channels[channel.id], _TopicState())

    def _add_message(self, message: RawMessage) -> None:
        if message.channel not in self._channels and self._spare:
            spare, self._spare, self._is_unchecked = self._spare, [], True
            for record in spare:
                self._add_record(record)
        name = self._channels.get(message.channel)
        if name is None:
            self._lost[f"channel {message.channel}"] += 1
            return
        self._kept[name] += 1
        state = self.topics[name]
        if self._numbers_its_messages:
            # What a file repeats of the one before it, or a copy that went wrong.
            if message.sequence <= state.last_sequence:
                return
            state.skipped += max(0, message.sequence - state.last_sequence - 1)
            state.last_sequence = message.sequence
        state.gaps.add(message.publish_ns)
        first, last = self._span_ns or (message.log_ns, message.log_ns)
        self._span_ns = min(first, message.log_ns), max(last, message.log_ns)
        if self._scene_json is None and name.endswith(f"/{SCENE.name}"):
            self._scene_json = _text(message.payload)
        self._writer.write(
            name,
            message.payload,
            log_time_ns=message.log_ns,
            publish_time_ns=message.publish_ns,
            sequence=message.sequence,
        )


def _text(payload: bytes) -> str | None:
    from rclpy.serialization import deserialize_message

    try:
        return str(deserialize_message(payload, message_class(SCENE.type_name)).data)
    except (RuntimeError, ValueError):
        return None
