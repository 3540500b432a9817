"""Clips are made once, from pictures alone: nothing of a label or of the judge can reach the network's input."""

from dataclasses import fields, replace

import numpy as np
import pytest

from classifier.clips import ClipCache, clip_from_bytes, clip_of_bag, clip_to_bytes
from classifier.configuration import preset
from classifier.examples import Example, read_examples
from classifier.frames import network_input
from classifier.load_motion import CHANNELS
from config.errors import BrokenRecording, RefusedInput
from recordings.campaigns.labels import Label
from recordings.campaigns.one_test import run_one
from tests.classifier.drawn_campaign import drawn_campaign, label, pictures, write_bag
from tests.recordings.tiny_campaign import SCENE, tasks, tiny

SMALL = preset("compact", size_px=32, frames=4)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return drawn_campaign(tmp_path_factory.mktemp("drawn") / "campaign", tests=4)


def _same(one, other) -> bool:
    return clip_to_bytes(one) == clip_to_bytes(other)


class _BlindLabel:
    """Knows the bag's digest, and fails whoever asks for anything else."""

    def __init__(self, bag_sha256: str) -> None:
        self.bag_sha256 = bag_sha256

    def __getattr__(self, name: str):
        raise AssertionError(f"{name} of the label was asked for")


def test_a_clip_comes_back_from_disk_as_it_was_made(folder, tmp_path):
    example = read_examples(folder)[0]
    made = ClipCache(tmp_path, SMALL).clip(example)
    again = ClipCache(tmp_path, SMALL).clip(replace(example, bag=tmp_path / "gone"))
    assert _same(made, again) and _same(made, clip_of_bag(example.bag, SMALL))
    for field in fields(made):
        one, other = getattr(made, field.name), getattr(again, field.name)
        assert np.array_equal(one, other) and getattr(one, "dtype", None) == getattr(other, "dtype", None)


def test_colour_comes_back_too(folder):
    clip = clip_of_bag(read_examples(folder)[0].bag, preset("paper", size_px=32))
    assert np.array_equal(clip_from_bytes(clip_to_bytes(clip)).frames, clip.frames)


def test_a_damaged_clip_is_made_anew_and_other_frames_have_a_place_of_their_own(folder, tmp_path):
    example, cache = read_examples(folder)[0], ClipCache(tmp_path, SMALL)
    made = cache.clip(example)
    stored = next(tmp_path.rglob("*.clip"))
    for damaged in (stored.read_bytes()[:-40], b"", b"{}\n"):
        stored.write_bytes(damaged)
        assert _same(cache.clip(example), made)
    wider = ClipCache(tmp_path, preset("compact", size_px=48, frames=4))
    assert not wider.has(example) and wider.clip(example).frames.shape == (4, 48, 48, CHANNELS)
    # Width and LSTM say nothing of frames.
    assert ClipCache(tmp_path, preset("compact", size_px=32, frames=4, base_width=4, lstm_units=3)).has(
        example
    )


def test_the_same_bag_under_two_labels_gives_the_same_clip(folder, tmp_path):
    example = read_examples(folder)[0]
    other = label(99, "pass", "another", bag_sha256=example.label.bag_sha256, worst_mm={"elastic": 1.0})
    lied = Example(99, example.bag, "another", not example.success, other)
    assert _same(ClipCache(tmp_path / "a", SMALL).clip(example), ClipCache(tmp_path / "b", SMALL).clip(lied))


def test_nothing_of_a_label_but_the_bags_digest_is_ever_asked_for(folder, tmp_path):
    example = read_examples(folder)[0]
    blind: Label = _BlindLabel(example.label.bag_sha256)  # type: ignore[assignment]
    cache = ClipCache(tmp_path, SMALL)
    cache.prepare([replace(example, label=blind)])
    assert _same(cache.clip(replace(example, label=blind)), clip_of_bag(example.bag, SMALL))


def test_what_the_judge_said_in_a_bag_changes_nothing(tmp_path):
    shown = pictures(5, slides=True)
    clips = []
    for verdict in (None, "pass", "fail"):
        write_bag(tmp_path / str(verdict), shown, verdict=verdict)
        clips.append(clip_of_bag(tmp_path / str(verdict), SMALL))
    assert _same(clips[0], clips[1]) and _same(clips[0], clips[2])
    assert (network_input(clips[0].frames, SMALL) == network_input(clips[2].frames, SMALL)).all()


def test_a_recipe_is_drawn_to_the_pictures_that_a_camera_would_have_recorded(tmp_path):
    (task,) = tasks(tiny(), 1)
    clips = []
    for with_pictures in (True, False):
        done = run_one(replace(task, with_pictures=with_pictures))
        bag = tmp_path / str(with_pictures) / "bag"
        bag.mkdir(parents=True)
        for name, content in done.bag.items():
            (bag / name).write_bytes(content)
        clips.append(clip_of_bag(bag, SMALL))
    assert _same(*clips)


def test_a_bag_without_pictures_and_camera_is_refused(tmp_path):
    (task,) = tasks(tiny(scene=SCENE), 1)
    done = run_one(task)
    (tmp_path / "bag").mkdir()
    for name, content in done.bag.items():
        (tmp_path / "bag" / name).write_bytes(content)
    with pytest.raises(RefusedInput, match="has no pictures, and its scene has no camera"):
        clip_of_bag(tmp_path / "bag", SMALL)


def test_another_bag_than_the_labels_is_refused(folder, tmp_path):
    first, second = read_examples(folder)[:2]
    with pytest.raises(BrokenRecording, match="has the digest"):
        ClipCache(tmp_path, SMALL).clip(replace(first, bag=second.bag))
    assert not list(tmp_path.rglob("*.clip"))


def test_two_workers_make_what_is_missing_and_a_refusal_comes_back_as_one(folder, tmp_path):
    examples, cache, told = read_examples(folder), ClipCache(tmp_path, SMALL), []
    made = cache.clip(examples[0])
    stamp = next(tmp_path.rglob("*.clip")).stat().st_mtime_ns
    bad = replace(examples[1], label=label(1, "pass", "", bag_sha256="0" * 64))
    with pytest.raises(BrokenRecording, match="has the digest"):
        cache.prepare(
            [*examples, bad], workers=2, on_progress=lambda done, total, _: told.append((done, total))
        )
    # What was made until then is kept, and what was there is not made again.
    assert told == [(2 + k, 5) for k in range(len(told))]
    cache.prepare(examples)
    assert all(map(cache.has, examples)) and _same(cache.clip(examples[0]), made)
    assert stamp in {path.stat().st_mtime_ns for path in tmp_path.rglob("*.clip")}
    assert not list(tmp_path.rglob("*.part"))
