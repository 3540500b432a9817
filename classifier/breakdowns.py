"""Where a model is right and wrong: by the rule that failed first, by margin, by how much of the video it has seen."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from classifier.clips import stamped_pictures_in
from classifier.examples import Example
from classifier.frames import PreparedClip
from classifier.metrics import Truth
from classifier.rows import Rows
from classifier.running import Judge, RunningJudge
from recordings.campaigns.labels import Label
from recordings.campaigns.statistics_rates import wilson
from sim_core.frames import Array

NO_RULE = "none"
MARGIN_EDGES = (0.0, 0.05, 0.1, 0.2, 0.5, np.inf)
SHARES = tuple(round(0.1 * tenth, 1) for tenth in range(1, 11))
"""Of the pictures of a video, at which the answer so far is asked for."""
TIME_BINS = 40


@dataclass(frozen=True)
class Group:
    """Tests that have something in common, and how many of them were called what.

    Attributes:
        name: what they have in common.
        called_pass: how many were called a pass.
        called_fail: how many were called a fail.
        right: share that was called what it is.
        low: of its 95 % interval (Wilson's).
        high: of it.
    """

    name: str
    called_pass: int
    called_fail: int
    right: float
    low: float
    high: float


@dataclass(frozen=True)
class Early:
    """What is right after a share of the video.

    Attributes:
        share: of the pictures.
        accuracy: over all tests.
        low: of its 95 % interval (Wilson's).
        high: of it.
        pass_right: share of the passes that are called one.
        fail_right: share of the fails that are called one.
        final: share of the tests whose answer is already that of the whole video.
    """

    share: float
    accuracy: float
    low: float
    high: float
    pass_right: float | None
    fail_right: float | None
    final: float


@dataclass(frozen=True, eq=False)
class Looks:
    """Where attention and change lie in a video, each as the mean over tests of what sums up to 1 in every test.

    Attributes:
        time: middle of each bin, as a share of the video, shape [bin_count].
        attention: of passes and fails, shape [2, bin_count].
        change: against the first picture, of passes and fails, shape [2, bin_count].
        on_critical: mean share of the attention on the frame of the largest change.
        even: what it would be if every frame had the same.
    """

    time: Array
    attention: Array
    change: Array
    on_critical: float
    even: float


def by_first_rule(examples: Sequence[Example], called: Truth) -> list[Group]:
    """Groups by the rule that was broken first; passes broke none."""
    names = [NO_RULE if example.success else example.label.first_rule or "unknown" for example in examples]
    order = sorted(set(names), key=lambda name: (name != NO_RULE, -names.count(name), name))
    return [_group(name, np.array([own == name for own in names]), examples, called) for name in order]


def by_margin(examples: Sequence[Example], called: Truth) -> list[Group]:
    """Groups by the distance of the worst rule to its limit, as a share of the limit."""
    away = np.abs([margin_share(example.label) for example in examples])
    found = []
    for low, high in pairwise(MARGIN_EDGES):
        words = f"{100 * low:.0f}–{100 * high:.0f} %" if np.isfinite(high) else f"above {100 * low:.0f} %"
        inside = (away >= low) & (away < high)
        if inside.any():
            found.append(_group(words, inside, examples, called))
    return found


def margin_share(label: Label) -> float:
    """Margin of the rule that is worst beside its limit, as a share of the limit; negative where it is broken.

    Infinite where no rule has a limit.
    """
    shares = [
        margin / (label.worst_mm[rule] + margin)
        for rule, margin in label.margin_mm.items()
        if rule in label.worst_mm and label.worst_mm[rule] + margin > 0.0
    ]
    return min(shares, default=np.inf)


def early_logits(
    examples: Sequence[Example],
    judge: Judge,
    rows: Rows,
    *,
    model_key: str,
    on_row: Callable[[], None] | None = None,
) -> Array:
    """Logits of success after each share of the pictures, shape [n, share_count]; tests that are there are not read.

    Nothing that comes later is known: crop, frames and the critical one are chosen from the pictures so far.

    Raises:
        BrokenRecording: a bag is damaged.
    """
    found = []
    for example in examples:
        key = f"{model_key} {SHARES} {example.label.bag_sha256}"
        if key not in rows:
            pictures = [pixels for _, pixels in stamped_pictures_in(example.bag)]
            wanted = [max(2, round(share * len(pictures))) for share in SHARES]
            running, told = RunningJudge(judge), {}
            for picture in pictures:
                running.take(picture)
                if running.pictures in wanted:
                    told[running.pictures] = running.answer().logit
            rows.add(key, {"logits": [told[count] for count in wanted]})
        found.append(rows[key]["logits"])
        if on_row is not None:
            on_row()
    return np.array(found, dtype=float)


def early(success: Truth, logits: Array, *, edge: float) -> list[Early]:
    """What is right after each share.

    Args:
        success: whether each test passed, shape [n].
        logits: see ``early_logits``.
        edge: logit of success from which a test is called a pass.
    """
    called = logits >= edge
    found = []
    for column, share in enumerate(SHARES):
        right = called[:, column] == success
        found.append(
            Early(
                share, float(right.mean()), *wilson(int(right.sum()), len(right)),
                _share(right[success]), _share(right[~success]),
                float((called[:, column] == called[:, -1]).mean()),
            )
        )  # fmt: skip
    return found


def looks(success: Truth, attention: Sequence[Array], clips: Sequence[PreparedClip]) -> Looks:
    """Where attention and change lie in time, over all tests.

    Args:
        success: whether each test passed, shape [n].
        attention: of each test's frames.
        clips: of each test.
    """
    middles = (np.arange(TIME_BINS) + 0.5) / TIME_BINS
    looked, changed, on_critical, even = [], [], [], []
    for own, clip in zip(attention, clips, strict=True):
        places = clip.numbers / max(1, len(clip.change) - 1)
        looked.append(_density(middles, places, own / np.gradient(places)))
        changed.append(_density(middles, np.linspace(0.0, 1.0, len(clip.change)), clip.change))
        on_critical.append(own[clip.critical])
        even.append(1.0 / len(own))
    return Looks(
        time=middles,
        attention=_means(np.array(looked), success),
        change=_means(np.array(changed), success),
        on_critical=float(np.mean(on_critical)),
        even=float(np.mean(even)),
    )


def _density(at: Array, places: Array, values: Array) -> Array:
    """Values over time as shares that sum up to 1."""
    found = np.interp(at, places, values)
    return np.asarray(found / found.sum()) if found.sum() > 0.0 else np.full(len(at), 1.0 / len(at))


def _means(rows: Array, success: Truth) -> Array:
    """Mean rows of passes and of fails; NaN where there are none."""
    return np.array(
        [
            rows[kind].mean(axis=0) if kind.any() else np.full(rows.shape[1], np.nan)
            for kind in (success, ~success)
        ]
    )


def _share(right: Truth) -> float | None:
    return float(right.mean()) if len(right) else None


def _group(name: str, inside: Truth, examples: Sequence[Example], called: Truth) -> Group:
    success = np.array([example.success for example in examples], dtype=bool)
    right = int((called == success)[inside].sum())
    count, passes = int(inside.sum()), int(called[inside].sum())
    return Group(name, passes, count - passes, right / count, *wilson(right, count))
