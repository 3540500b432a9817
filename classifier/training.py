"""Trains a video classifier on a campaign's bags; killed at any moment, it goes on to the same weights."""

import json
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import torch

from classifier.clips import ClipCache, OnClip
from classifier.configuration import NetworkConfig
from classifier.curves import write_curves
from classifier.examples import Example, Split, read_examples, split_at_random, split_by_scheme
from classifier.guidance import GuideCache
from classifier.learner import Epoch, Learner, OnStep
from classifier.ranks import Ranks, joined
from classifier.run_folder import (
    CURVES,
    MODEL,
    RunFolder,
    code_digest,
    digest_of,
    file_digest,
    read_checkpoint,
    write_checkpoint,
)
from classifier.training_config import TrainingConfig, training_preset
from config.errors import RefusedInput
from sim_core.report import PICTURED, versions

__all__ = ["Epoch", "SplitKind", "Trained", "TrainingConfig", "train", "training_preset"]

SplitKind = Literal["scheme", "random"]


@dataclass(frozen=True)
class Trained:
    """A finished training.

    Attributes:
        model: folder of the best network, see ``classifier.checkpoint``.
        epochs: all of them.
        split: numbers of the tests in each part are in ``run.json``; these are indices into ``read_examples``.
        counts: tests in training, validation and test.
        digest: SHA-256 of this process's weights at the end; the same in all processes.
    """

    model: Path
    epochs: tuple[Epoch, ...]
    split: Split
    counts: tuple[int, int, int]
    digest: str

    @property
    def best(self) -> Epoch:
        """The epoch whose network was kept."""
        return next(epoch for epoch in reversed(self.epochs) if epoch.is_best)


OnEpoch = Callable[[Epoch], None]


def train(
    folder: Path,
    out: Path,
    *,
    network: NetworkConfig,
    training: TrainingConfig,
    split: SplitKind = "scheme",
    weights: Path | None = None,
    cache: Path | None = None,
    workers: int = 1,
    on_clip: OnClip | None = None,
    on_step: OnStep | None = None,
    on_epoch: OnEpoch | None = None,
) -> Trained:
    """Trains a network, or goes on with one; under ``torchrun``, together with the other processes.

    On one machine's processor, the same arguments and number of threads give the same weights to the last bit, whatever
    interrupts it: order, augmentation and dropout follow from seed and epoch alone, and everything else is in the
    checkpoint, which is written after each epoch.

    Args:
        folder: of a campaign.
        out: folder of the training; gone on with if it holds the same one.
        network: what to train.
        training: how.
        split: how tests are parted: no scheme of the test part in another, or at random.
        weights: of ImageNet for the backbone, in torchvision's format.
        cache: folder of prepared clips; by default, ``clips`` in the campaign's folder.
        workers: processes that prepare clips before the training begins.
        on_clip: told of each clip that was prepared.
        on_step: told after each step of the optimiser.
        on_epoch: told after each epoch, those on disk included.

    Raises:
        RefusedInput: campaign, folder, weights or settings cannot be used.
        BrokenRecording: a bag is damaged.
    """
    with joined() as ranks, torch.random.fork_rng():
        examples = read_examples(folder)
        parts = _split_of(examples, split, training)
        told = _told(folder, examples, parts, network, training, split, weights, ranks)
        run = RunFolder(out, told) if ranks.is_first else nullcontext(None)
        with run as own:
            ranks.wait()
            clips = ClipCache(cache if cache is not None else folder / "clips", network)
            used = [examples[index] for index in sorted((*parts.train, *parts.validation))]
            mine = used[ranks.rank :: ranks.count]
            told_of = on_clip if ranks.is_first else None
            clips.prepare(mine, workers=workers, on_progress=told_of)
            guides = GuideCache(clips.folder) if training.guidance > 0.0 else None
            if guides is not None:
                learned = [examples[index] for index in parts.train]
                guides.prepare(learned[ranks.rank :: ranks.count], workers=workers, on_progress=told_of)
            ranks.wait()
            learner = Learner(network, training, [examples[k] for k in parts.train], ranks, weights)
            learner.restore(read_checkpoint(out))
            validation = [examples[index] for index in parts.validation]
            _run_epochs(
                learner, validation, clips, guides, out, own, on_step, on_epoch if ranks.is_first else None
            )
            ranks.wait()
            counts = len(parts.train), len(parts.validation), len(parts.test)
            return Trained(out / MODEL, tuple(learner.epochs), parts, counts, learner.digest())


def _run_epochs(
    learner: Learner,
    validation: Sequence[Example],
    clips: ClipCache,
    guides: GuideCache | None,
    out: Path,
    run: RunFolder | None,
    on_step: OnStep | None,
    on_epoch: OnEpoch | None,
) -> None:
    """All epochs that are left, each one safe on disk before the next begins."""
    for epoch in learner.epochs:
        if on_epoch is not None:
            on_epoch(epoch)
    if run is not None and learner.epochs and not run.is_finished:
        # The run before may have ended between its checkpoint and these.
        _write_progress(out, run, learner)
    while not learner.is_finished:
        epoch = learner.epoch(clips, guides, validation, on_step)
        if run is not None:
            if epoch.is_best:
                learner.keep_best(out / MODEL, run.told)
            write_checkpoint(out, learner.state())
            _write_progress(out, run, learner)
        if on_epoch is not None:
            on_epoch(epoch)


def _write_progress(out: Path, run: RunFolder, learner: Learner) -> None:
    """What a person looks at while it trains; nothing depends on it."""
    run.write_run([asdict(row) for row in learner.epochs], is_finished=learner.is_finished)
    write_curves(out / CURVES, learner.epochs)


def _split_of(examples: Sequence[Example], kind: SplitKind, training: TrainingConfig) -> Split:
    """The split, if there is enough in each part.

    Raises:
        RefusedInput: there is not.
    """
    part = split_by_scheme if kind == "scheme" else split_at_random
    found = part(
        examples, seed=training.split_seed, test_share=training.test_share,
        validation_share=training.validation_share,
    )  # fmt: skip
    learned = {examples[index].success for index in found.train}
    if len(learned) < 2 or not found.validation:
        limit = "must be enough for passed and failed tests to train on, and some to validate with"
        raise RefusedInput("tests", len(examples), limit)
    return found


def _told(
    folder: Path,
    examples: Sequence[Example],
    split: Split,
    network: NetworkConfig,
    training: TrainingConfig,
    kind: SplitKind,
    weights: Path | None,
    ranks: Ranks,
) -> dict[str, Any]:
    """What a training is made from, as JSON."""
    rows = [[example.number, example.label.bag_sha256, example.success] for example in examples]
    campaign = json.loads((folder / "campaign.json").read_text(encoding="utf-8"))
    parts = {
        name: [examples[index].number for index in getattr(split, name)]
        for name in ("train", "validation", "test")
    }
    return {
        "bags": {
            "campaign": campaign.get("campaign", {}).get("name", ""), "count": len(rows), "sha256": digest_of(rows),
        },
        "split": {"kind": kind, "seed": training.split_seed, **parts},
        "network": json.loads(network.to_json()),
        "training": training.model_dump(),
        "weights": file_digest(weights) if weights is not None else None,
        "processes": ranks.count,
        "versions": versions((*PICTURED, "torch")),
        "code": code_digest(),
        "earlier_code": [],
    }  # fmt: skip
