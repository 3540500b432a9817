"""Judges a recording again, from its scene, its poses and its film alone."""

from pathlib import Path

from config.errors import BrokenRecording
from config.scene import Scene
from config.scene_file import scene_from_json
from msgs_adapters.film_payloads import film_frame_from_payload
from msgs_adapters.pose_payloads import pose_frame_from_payload
from msgs_adapters.topics import PACKAGES_POSES, SCENE, WRAP_STRAIN
from recordings.bag_reader import BagReader
from recordings.test_bag import SCENE_ATTACHMENT
from sim_core.judge import EumosJudge


def scene_of_bag(reader: BagReader) -> Scene:
    """The scene that a bag was recorded from: its attachment, or else its ``scene`` topic.

    Raises:
        BrokenRecording: the bag has neither.
        RefusedInput: what it has is not a scene.
    """
    if SCENE_ATTACHMENT in reader.attachment_names:
        return scene_from_json(reader.attachment(SCENE_ATTACHMENT).decode())
    for message in reader.messages([topic_in_bag(reader, SCENE.name)]):
        return scene_from_json(message.decode().data)
    raise BrokenRecording("bag", str(reader.path), "has no scene: neither an attachment nor a message")


def judge_bag(path: Path) -> tuple[Scene, EumosJudge]:
    """Feeds every pose message of a bag, and every one of the film where the bag has that, to a new judge.

    Poses and film can stand in any order between them: the film's messages say all of the test until then.

    Raises:
        BrokenRecording: the file is damaged, or holds no scene or no poses.
    """
    with BagReader(path) as reader:
        scene = scene_of_bag(reader)
        judge = EumosJudge(scene)
        names = [topic_in_bag(reader, PACKAGES_POSES.name)]
        if topics_in_bag(reader, WRAP_STRAIN.name):
            names.append(topic_in_bag(reader, WRAP_STRAIN.name))
        film_index = 0
        for message in reader.messages(names):
            if message.topic_name != names[0]:
                judge.add_film(film_frame_from_payload(message.payload, film_index))
                film_index += scene.sampling.frames_a_film_frame
                continue
            frame = pose_frame_from_payload(message.payload, judge.frame_count)
            try:
                judge.add(frame)
            except ValueError as error:
                raise BrokenRecording("packages/poses", str(error), "must fit the bag's scene") from None
    if judge.frame_count == 0:
        raise BrokenRecording("bag", str(path), "holds no pose message")
    return scene, judge


def topic_in_bag(reader: BagReader, name: str) -> str:
    """The absolute name of a relative topic in a bag, whatever the namespace it was recorded in.

    Raises:
        BrokenRecording: no topic, or several, end in that name.
    """
    found = topics_in_bag(reader, name)
    if len(found) != 1:
        raise BrokenRecording("bag", str(reader.path), f"must hold one topic {name}, holds {len(found)}")
    return found[0]


def topics_in_bag(reader: BagReader, name: str) -> list[str]:
    """The absolute names of all topics in a bag that end in a relative one."""
    return [topic for topic in reader.topics if topic == f"/{name}" or topic.endswith(f"/{name}")]
