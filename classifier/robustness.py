"""What a model loses where camera, light, print or JPEG are others than in training: tests drawn anew, each alone."""

import json
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

import numpy as np

from classifier.clips import clip_of_bag, stamped_pictures_in
from classifier.configuration import NetworkConfig
from classifier.examples import Example
from classifier.frames import PreparedClip, prepared_clip
from classifier.metrics import Figure, figures, gain
from classifier.rows import Rows
from classifier.running import Judge
from classifier.side_by_side import side_by_side
from config.errors import PalletTwinError
from recordings.draw_bag import draw_bag
from sim_core.camera.jpeg import jpeg_of, picture_of
from sim_core.frames import Array

Ranges = tuple[tuple[float, float], ...]
Overrides = dict[str, float | int | list[float]]


@dataclass(frozen=True)
class Condition:
    """One thing that is another than in training.

    Attributes:
        name: of the condition.
        words: what is changed, and to what.
        scalars: ranges that a value of the camera is drawn from, each as long as it is likely; all lie outside those
            of the shipped campaign ``paper``.
        vectors: the same for each component of a value.
        new_print: whether print, tape and wood are drawn from another seed.
        jpeg_quality: with which recorded pictures are packed once more; None: they are drawn.
    """

    name: str
    words: str
    scalars: tuple[tuple[str, Ranges], ...] = ()
    vectors: tuple[tuple[str, tuple[Ranges, ...]], ...] = ()
    new_print: bool = False
    jpeg_quality: int | None = None

    def overrides(self, random: np.random.Generator) -> Overrides:
        """Values of the camera for one test."""
        found: Overrides = {name: _drawn(random, ranges) for name, ranges in self.scalars}
        found |= {name: [_drawn(random, axis) for axis in axes] for name, axes in self.vectors}
        if self.new_print:
            found["camera.seed"] = int(random.integers(2**32))
        return found


CONDITIONS = (
    Condition(
        "camera position",
        "nearer than 3 m or farther than 6 m, higher, further ahead or behind, aimed elsewhere",
        scalars=(("camera.distance_m", ((2.4, 3.0), (6.0, 7.5))), ("camera.zoom", ((0.75, 0.85),))),
        vectors=(
            ("camera.position_offset_m", (((-0.9, -0.5), (0.5, 0.9)), ((-0.3, 0.3),), ((0.8, 1.2),))),
            ("camera.aim_offset_m", (((-0.2, -0.15), (0.15, 0.2)), ((0.0, 0.0),), ((-0.1, 0.1),))),
        ),
    ),
    Condition(
        "light",
        "lamp further aside and lower, with more or less of the light; darker or brighter",
        scalars=(
            ("camera.light.azimuth_deg", ((-100.0, -60.0), (60.0, 100.0))),
            ("camera.light.elevation_deg", ((12.0, 30.0),)),
            ("camera.light.share", ((0.2, 0.4), (0.75, 0.9))),
            ("camera.exposure_ev", ((-0.8, -0.4), (0.4, 0.8))),
        ),
    ),
    Condition("texture", "other print, tape and wood on every surface", new_print=True),
    Condition("JPEG 50", "recorded pictures packed once more with quality 50", jpeg_quality=50),
    Condition("JPEG 25", "recorded pictures packed once more with quality 25", jpeg_quality=25),
)


@dataclass(frozen=True)
class Robustness:
    """What one condition does to a sample of tests.

    Attributes:
        condition: its name.
        words: what is changed.
        tests: of the sample that could be drawn.
        refused: of the sample that could not, such as where the camera does not see the load.
        recorded: accuracy on the same tests as they were recorded.
        accuracy: under the condition.
        change: of the accuracy, test by test; negative is lost.
        changed_verdicts: how many tests are called otherwise.
        lost_sled: tests on which the sled could no longer be followed.
    """

    condition: str
    words: str
    tests: int
    refused: int
    recorded: Figure
    accuracy: Figure
    change: Figure
    changed_verdicts: int
    lost_sled: int

    def entry(self) -> dict[str, object]:
        """The row for JSON."""
        return asdict(self)


def sampled(examples: Sequence[object], count: int, *, seed: int) -> list[int]:
    """Places of at most so many examples, drawn without regard to anything, ascending."""
    order = np.random.default_rng([seed, 7]).permutation(len(examples))
    return sorted(order[:count].tolist())


def measure_robustness(
    examples: Sequence[Example],
    recorded: Array,
    judge: Judge,
    rows: Rows,
    *,
    model_key: str,
    conditions: Sequence[Condition] = CONDITIONS,
    seed: int = 0,
    workers: int = 1,
    on_row: Callable[[], None] | None = None,
) -> list[Robustness]:
    """Judges tests under each condition; rows that are there are not drawn again.

    Args:
        examples: the sample.
        recorded: logits of success of the pictures as recorded, shape [n].
        judge: who judges.
        rows: where results are kept.
        model_key: tells models apart.
        conditions: what is changed.
        seed: of what is drawn for each test.
        workers: processes that draw; 1: this one.
        on_row: told after each test under each condition.

    Raises:
        BrokenRecording: a bag is damaged.
    """
    wanted = {
        _key(model_key, condition, seed, example): (condition, example)
        for condition in conditions
        for example in examples
    }
    tasks = {
        key: (example.bag, _texts(condition, seed, example), condition.jpeg_quality)
        for key, (condition, example) in wanted.items()
        if key not in rows
    }
    if on_row is not None:
        for _ in range(len(wanted) - len(tasks)):
            on_row()
    for key, clip in side_by_side(partial(_clip, config=judge.model.config), tasks, workers):
        row: dict[str, object] = {"refused": clip}
        if isinstance(clip, PreparedClip):
            row = {"logit": judge.judge(clip).logit, "followed": clip.followed}
        rows.add(key, row)
        if on_row is not None:
            on_row()
    found = [
        [rows[_key(model_key, condition, seed, example)] for example in examples] for condition in conditions
    ]
    return [
        _told(condition, own, examples, recorded, judge)
        for condition, own in zip(conditions, found, strict=True)
    ]


def _told(
    condition: Condition,
    found: Sequence[dict[str, object]],
    examples: Sequence[Example],
    recorded: Array,
    judge: Judge,
) -> Robustness:
    drawn = np.array(["logit" in row for row in found], dtype=bool)
    success = np.array([example.success for example in examples], dtype=bool)[drawn]
    logits = np.array([row["logit"] for row in found if "logit" in row], dtype=float)
    before, threshold = recorded[drawn], judge.success_threshold
    nothing = Figure(None, None, None)
    is_empty = not len(logits)
    return Robustness(
        condition=condition.name,
        words=condition.words,
        tests=len(logits),
        refused=int((~drawn).sum()),
        recorded=nothing if is_empty else figures(success, before, threshold=threshold)["accuracy"],
        accuracy=nothing if is_empty else figures(success, logits, threshold=threshold)["accuracy"],
        change=nothing if is_empty else gain(success, logits, before, threshold=threshold),
        changed_verdicts=int(np.sum((logits >= _edge(threshold)) != (before >= _edge(threshold)))),
        lost_sled=sum(row.get("followed") is False for row in found),
    )


def _edge(threshold: float) -> float:
    return float(np.log(threshold / (1.0 - threshold)))


def _key(model_key: str, condition: Condition, seed: int, example: Example) -> str:
    what = json.dumps(asdict(condition), sort_keys=True)
    return f"{model_key} {seed} {what} {example.label.bag_sha256}"


def _texts(condition: Condition, seed: int, example: Example) -> list[str]:
    """The ``camera.key=value`` texts of a test, the same whatever else is drawn."""
    random = np.random.default_rng([seed, example.number, len(condition.name), *condition.name.encode()])
    return [f"{name}={json.dumps(value)}" for name, value in condition.overrides(random).items()]


def _drawn(random: np.random.Generator, ranges: Ranges) -> float:
    """A value of one of several ranges, all equally likely."""
    lengths = np.array([high - low for low, high in ranges])
    if not lengths.sum():
        return ranges[0][0]
    low, high = ranges[int(random.choice(len(ranges), p=lengths / lengths.sum()))]
    return round(float(random.uniform(low, high)), 4)


Task = tuple[Path, list[str], int | None]


def _clip(task: Task, config: NetworkConfig) -> PreparedClip | str:
    """A test's clip under a condition; what refuses it comes back in words."""
    bag, overrides, quality = task
    try:
        if quality is not None:
            packed = (
                picture_of(jpeg_of(picture, quality=quality)) for _, picture in stamped_pictures_in(bag)
            )
            return prepared_clip(packed, config)
        with tempfile.TemporaryDirectory(prefix="pallet-twin-") as scratch:
            return clip_of_bag(draw_bag(bag, Path(scratch) / "bag", overrides).bag, config)
    except PalletTwinError as error:
        return str(error)
