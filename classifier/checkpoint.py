"""A trained model on disk: its weights, what it is built of, and what it was made from."""

import io
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from classifier.configuration import NetworkConfig
from classifier.network import VideoClassifier
from config.errors import RefusedInput

WEIGHTS, NETWORK, TOLD = "model.pt", "network.json", "model.json"
FORMAT = 1
"""Version of the folder; raise it when a file of it or its meaning changes."""


def save_model(folder: Path, model: VideoClassifier, told: Mapping[str, Any]) -> None:
    """Writes a model's folder: ``model.pt``, ``network.json`` and ``model.json``.

    Args:
        folder: made where it is missing; a model that it holds is replaced.
        model: the network.
        told: what is to be known of it, as JSON: ``bags``, ``code``, ``training``, ``split``, ``threshold``
            (probability of failure from which a test counts as failed) and ``temperature`` (that logits are divided
            by before they are a probability).
    """
    folder.mkdir(parents=True, exist_ok=True)
    write_tensors(folder / WEIGHTS, {name: value.contiguous() for name, value in model.state_dict().items()})
    write_text(folder / NETWORK, model.config.to_json())
    write_text(folder / TOLD, json.dumps({**told, "format": FORMAT}, indent=1, allow_nan=False))


def load_model(folder: Path) -> tuple[VideoClassifier, dict[str, Any]]:
    """Reads what ``save_model`` wrote.

    Returns:
        The network on the CPU, ready to judge (not to train), and what is told of it.

    Raises:
        RefusedInput: a file is missing or is not what it should be; nothing in a file is ever executed.
    """
    try:
        config = NetworkConfig.from_json((folder / NETWORK).read_text(encoding="utf-8"))
        told = json.loads((folder / TOLD).read_text(encoding="utf-8"))
    except OSError as error:
        what = error.strerror or "cannot be read"
        raise RefusedInput("model", str(folder), f"must be the folder of a trained model: {what}") from None
    except ValueError:
        raise RefusedInput("model", str(folder / TOLD), "is no JSON") from None
    if not isinstance(told, dict) or told.pop("format", None) != FORMAT:
        raise RefusedInput("model", str(folder / TOLD), f"is not of format {FORMAT}; train it again")
    model = VideoClassifier(config)
    weights = read_tensors(folder / WEIGHTS)
    try:
        model.load_state_dict(weights)
    except (RuntimeError, TypeError, AttributeError):
        raise RefusedInput("model", str(folder / WEIGHTS), f"is not of the network in {NETWORK}") from None
    return model.eval(), told


def read_tensors(path: Path) -> dict[str, Any]:
    """Reads a dictionary of tensors and plain values; nothing else in the file is executed or accepted.

    Raises:
        RefusedInput: it cannot be read, or holds something else.
    """
    try:
        stored = torch.load(path, map_location="cpu", weights_only=True)
    except OSError as error:
        raise RefusedInput("model", str(path), error.strerror or "cannot be read") from None
    except Exception:  # Whatever an unpickler meets in foreign bytes: there is no narrower family.
        raise RefusedInput("model", str(path), "is damaged, or no file of tensors") from None
    if not isinstance(stored, dict):
        raise RefusedInput("model", str(path), "must hold one dictionary")
    return stored


def write_tensors(path: Path, values: Mapping[str, Tensor | Any]) -> None:
    """Writes a dictionary of tensors and plain values, whole or not at all."""
    memory = io.BytesIO()
    torch.save(dict(values), memory)
    scratch = path.with_name(path.name + ".part")
    scratch.write_bytes(memory.getbuffer())
    scratch.replace(path)


def write_text(path: Path, text: str) -> None:
    """Writes a text, whole or not at all."""
    scratch = path.with_name(path.name + ".part")
    scratch.write_text(text + "\n", encoding="utf-8")
    scratch.replace(path)
