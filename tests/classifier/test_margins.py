"""Margins are the label's; a stretched clip moves by as much more as its margins say, and fails when they do."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from classifier.augmentation import drawn_stretch, stretched
from classifier.batches import ClipBatches
from classifier.clips import ClipCache
from classifier.configuration import preset
from classifier.examples import read_examples
from classifier.frames import network_input
from classifier.guidance import GuideCache, stretched_guide
from classifier.learner import margins_loss
from classifier.load_motion import CHANNELS, DISPLACED, packed_displacement, unpacked_displacement
from classifier.margins import MARGINS, RULES, margins_of
from classifier.training_config import training_preset
from tests.classifier.drawn_campaign import drawn_campaign


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return drawn_campaign(tmp_path_factory.mktemp("drawn") / "campaign", tests=8)


def _label(folder, worst_mm, margin_mm, *, damage="pass", success=True):
    example = read_examples(folder)[0]
    return replace(
        example.label,
        worst_mm=dict(zip(RULES, worst_mm, strict=False)),
        margin_mm=dict(zip(RULES, margin_mm, strict=False)),
        states={"damage": damage},
        verdict="pass" if success else "fail",
    )


def test_margins_are_shares_of_the_limits(folder):
    found = margins_of(_label(folder, (30.0, 10.0, 200.0), (30.0, 30.0, -100.0), success=False))
    assert found.shares == pytest.approx([0.5, 0.25, 2.0]) and found.failed and not found.is_damaged
    assert found.figures() == pytest.approx([*np.log([0.5, 0.25, 2.0]), 0.0])
    # What is far below or beyond a limit is all one; an unknown rule is unknown, and damage is one.
    far = margins_of(_label(folder, (0.0, 4000.0), (60.0, -3960.0), damage="fail", success=False)).figures()
    assert far[:2] == pytest.approx(np.log([0.05, 8.0])) and np.isnan(far[2]) and far[3] == 1.0


@pytest.mark.parametrize(("factor", "failed"), [(1.0, False), (1.2, False), (1.3, True), (0.5, False)])
def test_a_stretched_test_fails_when_a_share_is_above_one(folder, factor, failed):
    label = _label(folder, (48.0, 10.0, 60.0), (12.0, 30.0, 60.0))
    found = margins_of(label).stretched(factor)
    assert found.failed is failed and found.shares == pytest.approx(np.array([0.8, 0.25, 0.5]) * factor)


def test_damage_stays_however_little_moves(folder):
    label = _label(folder, (120.0, 10.0, 60.0), (-60.0, 30.0, 60.0), damage="fail", success=False)
    assert margins_of(label).stretched(0.1).failed
    assert not margins_of(replace(label, states={"damage": "pass"})).stretched(0.1).failed


def test_a_failure_that_nothing_known_accounts_for_stays_one(folder):
    for worst_mm in ((), (30.0, 10.0, 60.0)):
        label = _label(folder, worst_mm, (30.0, 30.0, 60.0)[: len(worst_mm)], success=False)
        assert margins_of(label).stretched(0.8).failed
    assert not margins_of(_label(folder, (), ())).stretched(1.4).failed


def test_a_stretched_clip_has_moved_as_far_and_the_sled_has_not():
    frames = np.full((2, 8, 8, CHANNELS), 77, np.uint8)
    frames[..., DISPLACED] = packed_displacement(np.float32([0.1, -0.05, 0.2, 0.0]))
    far = stretched(frames, 1.5)
    moved = unpacked_displacement(far[0, 0, 0, DISPLACED])
    # Packed twice: half a step of √d/127 each.
    assert moved == pytest.approx([0.15, -0.075, 0.3, 0.0], abs=2.0 * np.sqrt(0.3) / 127.0)
    kept = [channel for channel in range(CHANNELS) if not DISPLACED.start <= channel < DISPLACED.stop]
    assert (far[..., kept] == 77).all()
    assert stretched(frames, 1.0) is frames
    guide = np.log(np.float32([[0.05, 0.55, 1.05]]))
    assert np.exp(stretched_guide(guide, 1.5)) == pytest.approx(np.array([[0.05, 0.8, 1.55]]), rel=1.0e-5)


def test_factors_are_drawn_from_the_seed_as_often_whatever_they_are():
    on, off = (training_preset("compact", augmentation=share) for share in (1.0, 0.0))
    rngs = [np.random.default_rng(3) for _ in range(2)]
    factors = [drawn_stretch(rngs[0], on) for _ in range(200)]
    assert [drawn_stretch(rngs[1], off) for _ in range(200)] == [1.0] * 200
    assert rngs[0].random() == rngs[1].random()
    logs = np.log(factors)
    assert np.abs(logs).max() <= on.stretch < np.abs(logs).max() + 0.05 and abs(logs.mean()) < 0.1
    assert drawn_stretch(np.random.default_rng(0), training_preset("compact", stretch=0.0)) == 1.0


def test_a_batch_is_stretched_with_all_that_is_said_of_it(folder):
    examples = read_examples(folder)
    config = preset("compact", size_px=32, frames=3)
    clips, guides = ClipCache(folder / "clips", config), GuideCache(folder / "clips")
    only = training_preset("compact", augmentation=1.0, resize=0.0, rotation_deg=0.0, jitter=0.0, flip=False)
    (plain,) = ClipBatches(clips, batch=8, guides=guides).batches(examples)
    (far,) = ClipBatches(clips, batch=8, guides=guides, training=only).batches(examples)
    assert plain.margins.shape == (8, MARGINS) and plain.guide is not None and far.guide is not None
    for place, example in enumerate(examples):
        rng = np.random.default_rng([only.seed, 0, example.number])
        rng.random(4), rng.random(1), rng.random(3), rng.random(1)
        factor = drawn_stretch(rng, only)
        known = margins_of(example.label)
        assert factor != 1.0 and plain.failed[place] == (not example.success)
        assert far.failed[place] == known.stretched(factor).failed
        assert far.margins[place].numpy() == pytest.approx(known.stretched(factor).figures(), nan_ok=True)
        shown = network_input(stretched(clips.clip(example).frames, factor), config)
        assert np.array_equal(far.frames[place].numpy(), shown)
        assert far.guide[place].numpy() == pytest.approx(
            stretched_guide(plain.guide[place].numpy(), factor), rel=1.0e-5
        )


def test_the_loss_of_margins_is_hubers_and_unknown_shares_are_left_out(folder):
    (batch,) = ClipBatches(
        ClipCache(folder / "clips", preset("compact", size_px=32, frames=3)), batch=2
    ).batches(read_examples(folder)[:2])
    true = torch.tensor([[0.0, 1.0, float("nan"), 0.0], [0.0, 0.0, 0.0, 1.0]])
    batch = replace(batch, margins=true)
    told = torch.tensor([[0.0, 1.0, 5.0, -30.0], [0.0, 0.0, 0.0, 30.0]], requires_grad=True)
    assert margins_loss(told, batch).item() == pytest.approx(0.0, abs=1.0e-9)
    # One share of three is off by 2: (2 − 1/2)/3.
    off = told.detach() + torch.tensor([[2.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 0.0]])
    off.requires_grad_()
    loss = margins_loss(off, batch)
    assert loss.item() == pytest.approx(0.5)
    loss.backward()
    assert off.grad is not None and torch.isfinite(off.grad).all() and off.grad[0, 2] == 0.0
    assert margins_loss(None, batch).item() == 0.0
