"""A recording judged from its pictures: what the classifier guesses, how early it was sure, which frames mattered."""

from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from classifier.clips import stamped_pictures_in
from classifier.running import Answer, Judge, RunningJudge, mattering_frames
from config.errors import RefusedInput
from msgs_adapters.topics import CAMERA_COMPRESSED, CAMERA_IMAGE
from recordings.bag_reader import BagReader
from recordings.judge_bag import topics_in_bag

SURE = 0.9
"""Probability of its last verdict from which the classifier counts as sure."""
GUESS = "a classifier's guess from pictures alone, no judgement by EUMOS 40509"


@dataclass(frozen=True)
class FrameThatMattered:
    """A picture that the guess leans on: its number, its time since the first one [s], its share of the attention."""

    picture: int
    time_s: float
    attention: float


@dataclass(frozen=True)
class Prediction:
    """What a recording is guessed to be.

    Attributes:
        verdict: ``pass`` or ``fail``.
        success_probability: of a pass, by the whole clip.
        threshold: probability of success from which it is a pass.
        sure_from_s: time since the first picture from which on the verdict stayed and had a probability of at least
            ``SURE`` [s]; None: it was not sure at the end.
        settled_from_s: time from which on the verdict stayed [s].
        duration_s: from the first picture to the last [s].
        pictures: how many there are.
        largest_change: the picture that differs most from the first.
        frames: that mattered most, the first one most.
        running: time [s] and probability of success after each picture from the second on.
        remark: how the sled was followed.
        told: what kind of statement this is.
    """

    verdict: str
    success_probability: float
    threshold: float
    sure_from_s: float | None
    settled_from_s: float
    duration_s: float
    pictures: int
    largest_change: int
    frames: tuple[FrameThatMattered, ...]
    running: tuple[tuple[float, float], ...]
    remark: str
    told: str = GUESS

    def entry(self) -> dict[str, Any]:
        """The prediction for JSON."""
        return asdict(self)


def predict_bag(
    bag: Path, judge: Judge, *, on_picture: Callable[[int, int, object], None] | None = None
) -> Prediction:
    """Judges a recording after each of its pictures.

    Args:
        bag: directory or ``.mcap`` file; one without pictures whose scene has a camera is drawn.
        judge: who judges.
        on_picture: called with pictures judged, how many there are, and the last one's number.

    Raises:
        BrokenRecording: the bag is damaged.
        RefusedInput: it has no pictures and no camera, or less than two pictures.
    """
    running = RunningJudge(judge)
    stamps: list[int] = []
    answers: list[Answer] = []
    count = _picture_count(bag)
    for stamp_ns, pixels in stamped_pictures_in(bag):
        running.take(pixels)
        stamps.append(stamp_ns)
        if len(stamps) > 1:
            answers.append(running.answer())
        if on_picture is not None:
            on_picture(len(stamps), max(count, len(stamps)), len(stamps) - 1)
    if not answers:
        raise RefusedInput("pictures", len(stamps), "must be at least 2")
    times = [1.0e-9 * (stamp - stamps[0]) for stamp in stamps]
    last = answers[-1]
    told = [answer.success for answer in answers]
    settled = _held_from([answer.passes == last.passes for answer in answers])
    sure = _held_from([(p if last.passes else 1.0 - p) >= SURE for p in told])
    place = {int(number): k for k, number in enumerate(last.clip.numbers)}
    return Prediction(
        verdict="pass" if last.passes else "fail",
        success_probability=last.success,
        threshold=judge.success_threshold,
        sure_from_s=None if sure is None else times[1 + max(sure, settled or 0)],
        settled_from_s=times[1 + (settled or 0)],
        duration_s=times[-1],
        pictures=len(stamps),
        largest_change=int(last.clip.change.argmax()),
        frames=tuple(
            FrameThatMattered(number, times[number], float(last.attention[place[number]]))
            for number in mattering_frames(last).tolist()
        ),
        running=tuple(zip(times[1:], told, strict=True)),
        remark=last.clip.remark,
    )


def _picture_count(bag: Path) -> int:
    """How many pictures a recording holds; 0 where they have to be drawn."""
    with BagReader(bag) as reader:
        for topic in (CAMERA_IMAGE, CAMERA_COMPRESSED):
            for name in topics_in_bag(reader, topic.name):
                return reader.topics[name].message_count
    return 0


def _held_from(holds: list[bool]) -> int | None:
    """From which place on something held to the end; None: it did not at the end."""
    since = None
    for place, held in enumerate(holds):
        since = (place if since is None else since) if held else None
    return since
