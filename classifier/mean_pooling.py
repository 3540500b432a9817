"""A network that sees every frame as the classifier does, and has no idea of time: its features are averaged."""

import hashlib
import json
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from classifier.batches import ClipBatches, epoch_order
from classifier.checkpoint import read_tensors, write_tensors
from classifier.clips import ClipCache
from classifier.configuration import NetworkConfig
from classifier.examples import Example
from classifier.learner import Loss
from classifier.metrics import fitted_temperature
from classifier.network import VideoClassifier, parameter_count
from classifier.resnet import ResNet
from classifier.training_config import TrainingConfig
from sim_core.frames import Array

OnEpoch = Callable[[int, int], None]


class MeanPooling(nn.Module):
    """Backbone, mean over time, two hidden layers: as many weights as the classifier of the same configuration.

    Args:
        config: of the classifier that it is compared with.
    """

    def __init__(self, config: NetworkConfig) -> None:
        super().__init__()
        self.config = config
        self.backbone = ResNet(
            config.backbone,
            base_width=config.base_width,
            channels=config.channels,
            pooling=config.pooling,
        )
        self.backbone.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        hidden = _hidden(
            self.backbone.features,
            parameter_count(VideoClassifier(config)) - parameter_count(self.backbone),
        )
        self.head = nn.Sequential(
            nn.Linear(self.backbone.features, hidden), nn.ReLU(), nn.Linear(hidden, hidden), nn.ReLU(),
            nn.Dropout(config.dropout), nn.Linear(hidden, 1),
        )  # fmt: skip

    def forward(self, frames: Tensor, lengths: Tensor) -> Tensor:
        """Logits of failure, shape [batch], of frames, shape [batch, time, channels, h, w]; see ``VideoClassifier``."""
        chunks = torch.split(frames.flatten(0, 1), self.config.chunk_frames)
        seen = torch.cat([self.backbone(chunk) for chunk in chunks]).reshape(*frames.shape[:2], -1)
        inside = torch.arange(frames.shape[1], device=frames.device).unsqueeze(0) < lengths.unsqueeze(1)
        mean = (seen * inside.unsqueeze(2)).sum(dim=1) / lengths.unsqueeze(1)
        return self.head(mean).squeeze(1)  # type: ignore[no-any-return]


def pooled_logits(
    parts: tuple[Sequence[Example], Sequence[Example], Sequence[Example]],
    config: NetworkConfig,
    training: TrainingConfig,
    clips: ClipCache,
    kept: Path,
    *,
    on_epoch: OnEpoch | None = None,
) -> Array:
    """Trains it as the classifier was trained, and judges the test tests; goes on after the last whole epoch.

    Same clips, augmentation, loss, optimiser, batches and patience; a constant learning rate.

    Args:
        parts: tests to learn from, to validate, to judge.
        config: of the classifier.
        training: of the classifier.
        clips: of all of them.
        kept: file for the network on the way.
        on_epoch: told the epoch and how many there are at most.

    Returns:
        Logits of success, divided by the temperature of the validation tests, shape [n].
    """
    train, validation, test = parts
    with torch.random.fork_rng():
        torch.manual_seed(training.seed)
        model = MeanPooling(config)
        optimiser = torch.optim.AdamW(
            model.parameters(), lr=training.learning_rate, weight_decay=training.weight_decay
        )
        losses, best = _restored(kept, _digest(parts, config, training), model, optimiser)
        loss = Loss(train, training.success_weight)
        while not _is_finished(losses, training):
            number = len(losses)
            torch.manual_seed(int(np.random.default_rng([training.seed, number, 99]).integers(2**62)))
            _train_epoch(model, optimiser, loss, train, training, clips, number)
            losses.append(_validation_loss(model, loss, validation, training, clips))
            if losses[-1] == min(losses):
                best = {name: value.clone() for name, value in model.state_dict().items()}
            state = {"digest": _digest(parts, config, training), "losses": losses, "best": best}
            write_tensors(kept, {**state, "model": model.state_dict(), "optimiser": optimiser.state_dict()})
            if on_epoch is not None:
                on_epoch(len(losses), training.epochs)
        model.load_state_dict(best)
        weighing = float(np.log(loss.success_weight))
        success = np.array([example.success for example in validation], dtype=bool)
        temperature = fitted_temperature(success, _logits(model, validation, training, clips) - weighing)
        return (_logits(model, test, training, clips) - weighing) / temperature


def _is_finished(losses: Sequence[float], training: TrainingConfig) -> bool:
    if not losses:
        return False
    return len(losses) >= training.epochs or len(losses) - 1 - int(np.argmin(losses)) >= training.patience


def _train_epoch(
    model: MeanPooling,
    optimiser: torch.optim.Optimizer,
    loss: Loss,
    examples: Sequence[Example],
    training: TrainingConfig,
    clips: ClipCache,
    number: int,
) -> None:
    order = epoch_order(len(examples), seed=training.seed, epoch=number)
    source = ClipBatches(clips, batch=training.batch, training=training)
    model.train()
    done = 0
    optimiser.zero_grad(set_to_none=True)
    for place, batch in enumerate(source.batches([examples[k] for k in order], epoch=number), start=1):
        done += len(batch.lengths)
        inside = training.batch * training.accumulation
        part = loss(model(batch.frames, batch.lengths), batch) / inside
        part.backward()  # type: ignore[no-untyped-call]
        if place % training.accumulation == 0 or done == len(order):
            optimiser.step()
            optimiser.zero_grad(set_to_none=True)


def _validation_loss(
    model: MeanPooling, loss: Loss, examples: Sequence[Example], training: TrainingConfig, clips: ClipCache
) -> float:
    model.eval()
    total = 0.0
    with torch.inference_mode():
        for batch in ClipBatches(clips, batch=training.batch).batches(examples):
            total += float(loss(model(batch.frames, batch.lengths), batch))
    return total / len(examples)


def _logits(
    model: MeanPooling, examples: Sequence[Example], training: TrainingConfig, clips: ClipCache
) -> Array:
    """Logits of success, shape [n]."""
    model.eval()
    with torch.inference_mode():
        batches = ClipBatches(clips, batch=training.batch).batches(examples)
        said = [-model(batch.frames, batch.lengths).numpy() for batch in batches]
    return np.concatenate(said).astype(np.float64)


def _hidden(features: int, wanted: int) -> int:
    """Units h of each hidden layer: features h + h + h² + h + h + 1 = wanted."""
    linear = features + 3.0
    return max(1, round(0.5 * (float(np.sqrt(linear**2 + 4.0 * (wanted - 1.0))) - linear)))


def _digest(parts: Sequence[Sequence[Example]], config: NetworkConfig, training: TrainingConfig) -> str:
    what = [
        [[example.label.bag_sha256 for example in part] for part in parts], config.model_dump(), training.model_dump(),
    ]  # fmt: skip
    return hashlib.sha256(json.dumps(what, sort_keys=True).encode()).hexdigest()


def _restored(
    kept: Path, digest: str, model: MeanPooling, optimiser: torch.optim.Optimizer
) -> tuple[list[float], dict[str, Tensor]]:
    """What an earlier run came to, if it was of the same tests and settings."""
    if not kept.is_file():
        return [], {}
    state = read_tensors(kept)
    if state.get("digest") != digest:
        return [], {}
    model.load_state_dict(state["model"])
    optimiser.load_state_dict(state["optimiser"])
    return list(state["losses"]), dict(state["best"])
