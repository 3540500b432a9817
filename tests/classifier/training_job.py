"""Trains a tiny network in a process of its own; can kill itself on the way, or be one of several.

``python -m tests.classifier.training_job FOLDER OUT SETTINGS [EPOCH SHARE]``: dies by SIGKILL in an epoch when so much of it is
done; with a share of 2, after it.
"""

import json
import os
import signal
import sys
from pathlib import Path

import torch

from classifier.configuration import NetworkConfig, preset
from classifier.learner import Epoch
from classifier.training import Trained, TrainingConfig, train, training_preset

EPOCHS = 3


def network() -> NetworkConfig:
    """Every part of the real one, dropout and clips of several lengths included."""
    return preset(
        "compact", size_px=32, frames=None, base_width=4, lstm_units=4, critical_features=4, fused_features=8,
        dropout=0.3,
    )  # fmt: skip


def training(**changes: object) -> TrainingConfig:
    values = {
        "epochs": EPOCHS, "batch": 3, "accumulation": 2, "test_share": 0.25, "validation_share": 0.25,
        "learning_rate": 3.0e-3, "schedule": "cosine",
    }  # fmt: skip
    return training_preset("compact", **{**values, **changes})


def job(folder: Path, out: Path, *, die_at: tuple[int, float] | None = None, **changes: object) -> Trained:
    def die(here: tuple[int, float]) -> None:
        if die_at is not None and here >= die_at:
            os.kill(os.getpid(), signal.SIGKILL)

    def step(number: int, share: float, _: float) -> None:
        die((number, share))

    def epoch(row: Epoch) -> None:
        die((row.number, 2.0))

    return train(folder, out, network=network(), training=training(**changes), on_step=step, on_epoch=epoch)


if __name__ == "__main__":
    torch.set_num_threads(1)
    folder, out, settings, *at = sys.argv[1:]
    found = job(
        Path(folder),
        Path(out),
        die_at=(int(at[0]), float(at[1])) if at else None,
        **json.loads(settings),
    )
    Path(out, f"digest-{os.environ.get('RANK', '0')}").write_text(found.digest)
