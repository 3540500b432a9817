"""A network while it learns: its epochs, its loss, and all of its state that the next epoch depends on."""

import hashlib
import os
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import nullcontext
from copy import deepcopy
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn.parallel import DistributedDataParallel

from classifier.batches import Batch, ClipBatches, epoch_order
from classifier.checkpoint import save_model
from classifier.clips import ClipCache
from classifier.configuration import NetworkConfig
from classifier.examples import Example
from classifier.guidance import GUIDES, GuideCache
from classifier.margins import MARGINS
from classifier.metrics import fitted_temperature
from classifier.network import VideoClassifier
from classifier.ranks import Ranks
from classifier.resnet import load_imagenet_weights
from classifier.training_config import TrainingConfig
from config.errors import RefusedInput
from sim_core.frames import Array

OnStep = Callable[[int, float, float], None]
"""Told the epoch's number, the share of it that is done, and the loss of the last step."""
_MOST_THREADS = 4
"""That prepare batches: a GPU may need so many, a processor one."""
_DAMAGE = 0.25
"""Of the loss of margins, that damage counts for: seldom anything is damaged that has not moved too far."""
_LOWEST_RATE = 0.01
"""Of the learning rate, at the end of a cosine."""


@dataclass(frozen=True)
class Epoch:
    """What an epoch came to.

    Attributes:
        number: from 1.
        train_loss: weighted binary cross-entropy, while training and with augmentation.
        validation_loss: the same on the validation tests.
        validation_accuracy: share of them that are judged right.
        learning_rate: at its end.
        seconds: that it took, validation and all [s].
        frames_hz: frames that were trained on a second, in all processes.
        compute_share: of the epoch that the network was at work; the rest is waiting for clips.
        loading_share: processor time of the threads that prepare clips, of the epoch.
        is_best: whether the validation loss was lower than ever.
        left_s: at most, until the training ends [s].
    """

    number: int
    train_loss: float
    validation_loss: float
    validation_accuracy: float
    learning_rate: float
    seconds: float
    frames_hz: float
    compute_share: float
    loading_share: float
    is_best: bool
    left_s: float


class Learner:
    """A network with its optimiser, and how far they are.

    Args:
        network: what to train.
        training: how.
        examples: to learn from.
        ranks: processes that train it.
        weights: of ImageNet for the backbone.
    """

    def __init__(
        self,
        network: NetworkConfig,
        training: TrainingConfig,
        examples: Sequence[Example],
        ranks: Ranks,
        weights: Path | None,
    ) -> None:
        self.epochs: list[Epoch] = []
        self._training, self._examples, self._ranks = training, examples, ranks
        torch.manual_seed(training.seed)
        self._model = VideoClassifier(network)
        if weights is not None:
            load_imagenet_weights(self._model.backbone, weights)
        self._guided = Guided(
            self._model, guided=training.guidance > 0.0, told_margins=training.margins > 0.0
        ).to(ranks.device)
        self._joint: nn.Module = DistributedDataParallel(self._guided) if ranks.count > 1 else self._guided
        self._optimiser = torch.optim.AdamW(
            self._guided.parameters(), lr=training.learning_rate, weight_decay=training.weight_decay
        )
        self._averaged = _averaged(self._model) if training.average > 0.0 else None
        self._loss = Loss(examples, training.success_weight)
        self._threads = max(1, min(_MOST_THREADS, len(os.sched_getaffinity(0)) // (2 * ranks.count)))
        self._validation_logits: Array = np.zeros(0)
        self._validation_success: Array = np.zeros(0)

    @property
    def is_finished(self) -> bool:
        """Whether all epochs are over, or none was better for too long."""
        best = max((epoch.number for epoch in self.epochs if epoch.is_best), default=0)
        done = len(self.epochs)
        return done >= self._training.epochs or done - best >= self._training.patience

    def state(self) -> dict[str, Any]:
        """All that the next epoch depends on; its random numbers follow from seed and epoch."""
        return {
            "model": self._guided.state_dict(),
            "averaged": None if self._averaged is None else self._averaged.state_dict(),
            "optimiser": self._optimiser.state_dict(),
            "epochs": [asdict(epoch) for epoch in self.epochs],
        }

    def digest(self) -> str:
        """SHA-256 of all weights and running means."""
        digest = hashlib.sha256()
        for value in self._model.state_dict().values():
            digest.update(value.cpu().contiguous().numpy().tobytes())
        return digest.hexdigest()

    def restore(self, state: dict[str, Any] | None) -> None:
        """Goes back to a state; None is the beginning."""
        if state is not None:
            self._guided.load_state_dict(state["model"])
            if self._averaged is not None:
                self._averaged.load_state_dict(state["averaged"])
            self._optimiser.load_state_dict(state["optimiser"])
            self.epochs = [Epoch(**epoch) for epoch in state["epochs"]]

    def epoch(
        self,
        clips: ClipCache,
        guides: GuideCache | None,
        validation: Sequence[Example],
        on_step: OnStep | None,
    ) -> Epoch:
        """Trains for one epoch, and judges the validation tests.

        Args:
            clips: where prepared clips are.
            guides: where true displacement is; needed with guidance alone.
            validation: the tests that are judged.
            on_step: told after each step.

        Raises:
            RefusedInput: the loss is no longer finite.
        """
        began, number = time.perf_counter(), len(self.epochs)
        watch = Watch()
        train_loss, frames = self._trained(clips, guides, number, watch, on_step)
        trained_s = time.perf_counter() - began
        for module in (self._model, self._kept):
            self._ranks.share_buffers(module)
        validation_loss, accuracy = self._validated(clips, validation, watch)
        if not np.isfinite(train_loss + validation_loss):
            limit = "makes the loss grow beyond all bounds; name a lower one"
            raise RefusedInput("training.learning_rate", self._training.learning_rate, limit)
        seconds = time.perf_counter() - began
        best = min((epoch.validation_loss for epoch in self.epochs), default=float("inf"))
        found = Epoch(
            number=number + 1,
            train_loss=train_loss,
            validation_loss=validation_loss,
            validation_accuracy=accuracy,
            learning_rate=float(self._optimiser.param_groups[0]["lr"]),
            seconds=seconds,
            frames_hz=frames / trained_s,
            compute_share=watch.compute_s / seconds,
            loading_share=watch.loading_s / seconds,
            is_best=validation_loss < best,
            left_s=seconds * (self._training.epochs - number - 1),
        )
        self.epochs.append(found)
        return found

    def keep_best(self, folder: Path, told: dict[str, Any]) -> None:
        """Writes the network as it is, with the temperature from the validation tests.

        Training weighs passes w times as much, which makes every odds of failure w times too small. So ln w is added to
        the network's last bias: probabilities come out right, and an even chance parts fail from pass, which is right
        most often.
        """
        weighing = float(np.log(self._loss.success_weight))
        model = VideoClassifier(self._model.config)
        model.load_state_dict(self._kept.state_dict())
        with torch.no_grad():
            model.output.bias.add_(weighing)
        fitted = fitted_temperature(
            self._validation_success.astype(bool), -(self._validation_logits + weighing)
        )
        # Validation is of schemes that were seen: good enough to take confidence back, not to add some.
        temperature = max(1.0, fitted)
        epoch = self.epochs[-1]
        best = {
            "epoch": epoch.number,
            "validation_loss": epoch.validation_loss,
            "validation_accuracy": epoch.validation_accuracy,
            "success_weight": self._loss.success_weight,
            "temperature": temperature,
            "threshold": 0.5,
        }
        save_model(folder, model.cpu(), {**told, **best})

    def _trained(
        self,
        clips: ClipCache,
        guides: GuideCache | None,
        number: int,
        watch: "Watch",
        on_step: OnStep | None,
    ) -> tuple[float, int]:
        """Mean loss of an epoch, and how many frames all processes saw."""
        training, ranks = self._training, self._ranks
        order = epoch_order(
            len(self._examples), seed=training.seed, epoch=number, rank=ranks.rank, ranks=ranks.count
        )
        torch.manual_seed(int(np.random.default_rng([training.seed, number, ranks.rank]).integers(2**62)))
        source = ClipBatches(
            clips,
            batch=training.batch,
            training=training,
            threads=self._threads,
            guides=guides if training.guidance > 0.0 else None,
        )
        stream = iter(watch.waiting(source.batches([self._examples[k] for k in order], epoch=number)))
        step_clips = training.batch * training.accumulation
        steps = -(-len(order) // step_clips)
        total, frames = 0.0, 0
        self._joint.train()
        for step in range(steps):
            inside = min(step_clips, len(order) - step * step_clips)
            rate = learning_rate(training, number + (step + 1) / steps)
            for group in self._optimiser.param_groups:
                group["lr"] = rate
            self._optimiser.zero_grad(set_to_none=True)
            loss, batches = 0.0, -(-inside // training.batch)
            for place in range(batches):
                batch = next(stream)
                frames += batch.frame_count
                # Processes add up their gradients only once a step.
                apart = isinstance(self._joint, DistributedDataParallel) and place + 1 < batches
                with self._joint.no_sync() if apart else nullcontext():  # type: ignore[operator]
                    logits, (guess, margins) = self._said(self._joint, batch)
                    part = self._loss(logits, batch) / inside
                    beside = training.guidance * guidance_loss(guess, batch)
                    beside = beside + training.margins * margins_loss(margins, batch)
                    whole = part + beside / inside
                    whole.backward()  # type: ignore[no-untyped-call]
                loss += float(part.detach())
            self._optimiser.step()
            self._average(number * steps + step)
            total += loss * inside
            if on_step is not None:
                on_step(number + 1, (step + 1) / steps, loss)
        next(stream, None)
        sums = ranks.gathered((total, len(order), frames))
        return sum(row[0] for row in sums) / sum(row[1] for row in sums), sum(row[2] for row in sums)

    def _validated(
        self, clips: ClipCache, examples: Sequence[Example], watch: "Watch"
    ) -> tuple[float, float]:
        """Loss and share of right verdicts on examples, shared out to all processes."""
        ranks = self._ranks
        source = ClipBatches(clips, batch=self._training.batch, threads=self._threads)
        kept = self._kept.eval()
        mine: list[tuple[float, float, float]] = []
        with torch.no_grad():
            for batch in watch.waiting(source.batches(examples[ranks.rank :: ranks.count])):
                logits, _ = self._said(kept, batch)
                losses = self._loss.each(logits, batch)
                mine += zip(logits.tolist(), losses.tolist(), batch.failed.tolist(), strict=True)
        rows = np.array([row for part in ranks.gathered(mine) for row in part])
        self._validation_logits, self._validation_success = rows[:, 0], 1.0 - rows[:, 2]
        return float(rows[:, 1].mean()), float(((rows[:, 0] > 0.0) == (rows[:, 2] > 0.5)).mean())

    @property
    def _kept(self) -> VideoClassifier:
        """The network that is validated and kept."""
        return self._model if self._averaged is None else self._averaged

    def _average(self, step: int) -> None:
        """Takes the weights after a step, counted from 0, into their mean."""
        if self._averaged is None:
            return
        # The first steps are soon forgotten.
        share = min(self._training.average, (1.0 + step) / (10.0 + step))
        with torch.no_grad():
            new = self._model.state_dict()
            for name, mean in self._averaged.state_dict().items():
                if mean.is_floating_point():
                    mean.lerp_(new[name], 1.0 - share)
                else:
                    mean.copy_(new[name])

    def _said(self, model: nn.Module, batch: Batch) -> tuple[Tensor, list[Tensor | None]]:
        """Logits and what else a network or a ``Guided`` says, on a processor's own precision, on a GPU half of it."""
        device = self._ranks.device
        with torch.autocast(device.type, torch.bfloat16, enabled=device.type == "cuda"):
            logits, *beside = model(
                batch.frames.to(device), batch.critical.to(device), batch.lengths.to(device)
            )
        return logits.float(), [None if part is None else part.float() for part in beside]


def _averaged(model: VideoClassifier) -> VideoClassifier:
    """A copy that no gradient reaches."""
    copy = deepcopy(model)
    return copy.requires_grad_(False)


class Guided(nn.Module):
    """The network and, where it is guided, what tells more from its features than the verdict; that is not kept.

    Args:
        model: the network.
        guided: whether each frame's displacement is told from its features.
        told_margins: whether margins are told from what the verdict is taken from.
    """

    def __init__(self, model: VideoClassifier, *, guided: bool, told_margins: bool = False) -> None:
        super().__init__()
        self.model = model
        self.guess = nn.Linear(model.config.features, GUIDES) if guided else None
        self.margins = nn.Linear(model.config.fused_features, MARGINS) if told_margins else None

    def forward(
        self, frames: Tensor, critical: Tensor, lengths: Tensor
    ) -> tuple[Tensor, Tensor | None, Tensor | None]:
        """Logits of failure, [batch], guessed displacement, [batch, time, GUIDES], and margins, [batch, MARGINS]."""
        features = self.model.features(frames)
        fused, _ = self.model.fused(features, critical, lengths)
        logits = self.model.output(fused).squeeze(1)
        return (
            logits,
            None if self.guess is None else self.guess(features),
            None if self.margins is None else self.margins(fused),
        )


def guidance_loss(guess: Tensor | None, batch: Batch) -> Tensor:
    """How far guesses are from true displacement, each clip's mean, summed up; Huber's loss, of logarithms."""
    if guess is None or batch.guide is None:
        return torch.zeros(())
    guide = batch.guide.to(guess.device)
    known = torch.isfinite(guide)
    each = nn.functional.smooth_l1_loss(guess, torch.where(known, guide, guess.detach()), reduction="none")
    return (each.sum(dim=(1, 2)) / known.sum(dim=(1, 2))).sum()


def margins_loss(told: Tensor | None, batch: Batch) -> Tensor:
    """How far told margins are from the true ones, summed up: Huber's loss of shares, some cross-entropy of damage."""
    if told is None:
        return torch.zeros(())
    true = batch.margins.to(told.device)
    known = torch.isfinite(true[:, :-1])
    shares = told[:, :-1]
    wanted = torch.where(known, true[:, :-1], shares.detach())
    apart = nn.functional.smooth_l1_loss(shares, wanted, reduction="none").mean(dim=1)
    damage = nn.functional.binary_cross_entropy_with_logits(told[:, -1], true[:, -1], reduction="none")
    return (apart + _DAMAGE * damage).sum()


class Loss:
    """Weighted binary cross-entropy; the weights of all training tests have the mean 1.

    Args:
        examples: to learn from.
        success_weight: see ``TrainingConfig``.
    """

    def __init__(self, examples: Sequence[Example], success_weight: float | None) -> None:
        passed = sum(example.success for example in examples)
        failed = len(examples) - passed
        self.success_weight = max(1.0, failed / passed) if success_weight is None else success_weight
        self._unit = len(examples) / (failed + self.success_weight * passed)

    def each(self, logits: Tensor, batch: Batch) -> Tensor:
        """The loss of each clip, shape [batch]."""
        failed = batch.failed.to(logits.device)
        weight = self._unit * torch.where(failed > 0.5, 1.0, self.success_weight)
        return weight * nn.functional.binary_cross_entropy_with_logits(logits, failed, reduction="none")

    def __call__(self, logits: Tensor, batch: Batch) -> Tensor:
        """The losses' sum."""
        return self.each(logits, batch).sum()


class Watch:
    """Tells how long the network works on batches, and how long it waits for them."""

    def __init__(self) -> None:
        self.compute_s = self.loading_s = 0.0

    def waiting(self, batches: Iterable[Batch]) -> Iterator[Batch]:
        """The same batches; what happens between asking for two of them counts as work."""
        for batch in batches:
            self.loading_s += batch.loading_s
            began = time.perf_counter()
            yield batch
            self.compute_s += time.perf_counter() - began


def learning_rate(training: TrainingConfig, done: float) -> float:
    """The learning rate of a step.

    Args:
        training: says how it goes.
        done: epochs that are over after the step.
    """
    rate = training.learning_rate
    if done < training.warmup_epochs:
        return rate * done / training.warmup_epochs
    if training.schedule == "constant":
        return rate
    span = max(1.0e-9, training.epochs - training.warmup_epochs)
    share = min(1.0, (done - training.warmup_epochs) / span)
    return rate * (_LOWEST_RATE + (1.0 - _LOWEST_RATE) * 0.5 * (1.0 + float(np.cos(np.pi * share))))
