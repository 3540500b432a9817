"""Fills a ``recorded`` sled profile with the samples of an earlier recording."""

from collections.abc import Sequence
from pathlib import Path

from config.errors import BrokenRecording, RefusedInput
from config.scene import RecordedSled, Scene
from config.scene_file import find_scene, read_scene, validate_scene
from sim_core.sled import stamp_ns


def load_scene(name_or_path: str, overrides: Sequence[str] = ()) -> Scene:
    """Reads a scene and, where its sled replays a bag, the bag's samples.

    Args:
        name_or_path: a scene file, a palletising file, or a shipped scene's name.
        overrides: ``key=value`` texts.

    Raises:
        RefusedInput: anything that cannot be used.
        BrokenRecording: the bag is damaged, has no such samples, or lacks some of them.
    """
    path = find_scene(name_or_path)
    return with_recorded_samples(read_scene(path, overrides), path.parent)


def with_recorded_samples(scene: Scene, base: Path) -> Scene:
    """The scene with the samples of the bag that its sled names; other scenes as they are.

    The samples are taken bit for bit, so the same load moves in the same way to the last bit.

    Args:
        scene: a resolved scene.
        base: folder that the bag's path starts from.
    """
    sled = scene.sled
    if not isinstance(sled, RecordedSled) or sled.samples_mps2:
        return scene
    if not sled.bag:
        raise RefusedInput("sled.bag", "missing", "names the bag to take the samples from")
    samples = _samples(base / sled.bag, scene.sampling.samples_hz)
    recorded = {"profile": "recorded", "bag": Path(sled.bag).name, "samples_mps2": samples}
    return validate_scene({**scene.model_dump(), "sled": recorded})


def _samples(bag: Path, rate_hz: int) -> list[tuple[float, float, float]]:
    # Other scenes load neither bags nor messages.
    from msgs_adapters.convert import sample_from_accel
    from msgs_adapters.topics import SLED_ACCELERATION
    from recordings.bag_reader import BagReader
    from recordings.judge_bag import topic_in_bag

    samples: list[tuple[float, float, float]] = []
    first_ns: int | None = None
    with BagReader(bag) as reader:
        for message in reader.messages([topic_in_bag(reader, SLED_ACCELERATION.name)]):
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
