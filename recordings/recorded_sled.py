"""Fills a ``recorded`` sled profile from a bag: a twin's own samples, or the readings of an accelerometer."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from config.errors import BrokenRecording, RefusedInput
from config.scene import RecordedSled, Scene
from config.scene_file import find_scene, read_scene, validate_scene
from sim_core.sled import stamp_ns

if TYPE_CHECKING:
    from recordings.bag_reader import BagReader


def load_scene(name_or_path: str, overrides: Sequence[str] = ()) -> Scene:
    """Reads a scene and, where its sled replays a bag, the bag's samples.

    Args:
        name_or_path: a scene file, a palletising file, or a shipped scene's name.
        overrides: ``key=value`` texts.

    Raises:
        RefusedInput: anything that cannot be used.
        BrokenRecording: the bag is damaged, lacks samples and readings, or has gaps in its samples.
    """
    path = find_scene(name_or_path)
    return with_recorded_samples(read_scene(path, overrides), path.parent)


def with_recorded_samples(scene: Scene, base: Path) -> Scene:
    """The scene with the samples of the bag that its sled names; other scenes as they are.

    Samples of a twin are taken bit for bit, so the same load moves in the same way to the last bit. From an
    accelerometer's readings they are made, and the scene says what was found in them.

    Args:
        scene: a resolved scene.
        base: folder that the bag's path starts from.

    Raises:
        RefusedInput: no bag is named, or its accelerometer recorded no test of a sled.
        BrokenRecording: the bag is damaged, or lacks samples and readings.
    """
    sled = scene.sled
    if not isinstance(sled, RecordedSled) or sled.samples_mps2:
        return scene
    if not sled.bag:
        raise RefusedInput("sled.bag", "missing", "names the bag to take the samples from")
    # Other scenes load neither bags nor messages.
    from recordings.bag_reader import BagReader

    with BagReader(base / sled.bag) as reader:
        recorded = sled_of_bag(reader, sled, scene.sampling.samples_hz)
    recorded |= {"profile": "recorded", "bag": Path(sled.bag).name}
    return validate_scene({**scene.model_dump(), "sled": recorded})


def sled_of_bag(reader: "BagReader", sled: RecordedSled, samples_hz: int) -> dict[str, Any]:
    """What a bag says of the sled, as fields of a :class:`~config.scene.RecordedSled`.

    Args:
        reader: the open bag.
        sled: names topic and direction, where they matter.
        samples_hz: rate of the samples.

    Raises:
        RefusedInput: its accelerometer recorded no test of a sled.
        BrokenRecording: it is damaged, or has not the one topic that is needed.
    """
    from recordings.bench_acceleration import IMU, bench_motion

    topic = sled_topic(reader, sled.topic)
    if reader.topics[topic].topic.type_name != IMU:
        return {"topic": sled.topic, "samples_mps2": _samples(reader, topic, samples_hz)}
    motion = bench_motion(reader, topic, samples_hz=samples_hz, direction=sled.direction)
    return {
        "topic": topic,
        "direction": sled.direction,
        "samples_mps2": motion.samples.tolist(),
        "level_mps2": motion.level_mps2,
        "source": motion.source.model_dump(),
    }


def sled_topic(reader: "BagReader", wanted: str) -> str:
    """Absolute name of the topic of a bag that the sled's motion is taken from; ``wanted`` may be relative, or empty.

    Raises:
        RefusedInput: the wanted topic carries no acceleration.
        BrokenRecording: there is none, or more than one.
    """
    from msgs_adapters.topics import SLED_ACCELERATION
    from recordings.bench_acceleration import IMU, imu_topics
    from recordings.judge_bag import topic_in_bag, topics_in_bag

    if wanted:
        topic = wanted if wanted in reader.topics else topic_in_bag(reader, wanted.lstrip("/"))
        kind = reader.topics[topic].topic.type_name
        if kind not in (IMU, SLED_ACCELERATION.type_name):
            raise RefusedInput(
                "sled.topic", topic, f"is {kind}: must be {IMU} or {SLED_ACCELERATION.type_name}"
            )
        return topic
    if topics_in_bag(reader, SLED_ACCELERATION.name):
        return topic_in_bag(reader, SLED_ACCELERATION.name)
    found = imu_topics(reader)
    if len(found) != 1:
        has = f"it has {', '.join(found)}: name one in sled.topic" if found else "it has neither"
        limit = f"must hold {SLED_ACCELERATION.name} or one topic of type {IMU}; {has}"
        raise BrokenRecording("bag", str(reader.path), limit)
    return found[0]


def _samples(reader: "BagReader", topic: str, rate_hz: int) -> list[tuple[float, float, float]]:
    from msgs_adapters.convert import sample_from_accel

    samples: list[tuple[float, float, float]] = []
    first_ns: int | None = None
    for message in reader.messages([topic]):
        sample = sample_from_accel(message.decode(), None)
        first_ns = sample.stamp_ns if first_ns is None else first_ns
        due_ns = stamp_ns(len(samples), rate_hz, first_ns)
        if sample.stamp_ns != due_ns:
            raise BrokenRecording(
                "sled/acceleration",
                f"sample {len(samples)} at {sample.stamp_ns} ns",
                f"must be at {due_ns} ns: every sample at sampling.samples_hz = {rate_hz}, none missing",
            )
        x, y, z = sample.acceleration.tolist()
        samples.append((x, y, z))
    if len(samples) < 2:
        raise BrokenRecording("sled/acceleration", len(samples), "at least two samples are needed")
    return samples
