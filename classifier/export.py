"""The network as an ONNX file, and the proof that the file says the same as the network."""

import logging
import warnings
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from classifier.configuration import NetworkConfig
from classifier.network import VideoClassifier
from config.errors import RefusedInput

LARGEST_DIFFERENCE = 1.0e-4
"""Between a logit or an attention of the file and of the network."""
INPUTS, OUTPUTS = ("frames", "critical", "lengths"), ("logit", "attention")


def export_onnx(model: VideoClassifier, path: Path) -> None:
    """Writes a network as ONNX; batch and time are free.

    The file takes what ``VideoClassifier.forward`` takes: frames that ``classifier.frames`` has made and normalised.
    The configuration stands in its metadata under ``network``.
    """
    config, was_training = model.config, model.training
    model.eval()
    batch, time = torch.export.Dim("batch", min=1, max=1024), torch.export.Dim("time", min=2, max=4096)
    example = _example(config, batch=2, time=3, seed=0)
    log = logging.getLogger("torch.onnx")
    level = log.level
    try:
        with warnings.catch_warnings(), torch.no_grad():
            # The exporter's own business: it warns of what it deprecates inside itself and of torchvision's absence.
            warnings.simplefilter("ignore")
            log.setLevel(logging.ERROR)
            program = torch.onnx.export(
                model,
                tuple(torch.from_numpy(value) for value in example.values()),
                input_names=list(INPUTS),
                output_names=list(OUTPUTS),
                dynamic_shapes=({0: batch, 1: time}, {0: batch}, {0: batch}),
                dynamo=True,
                verbose=False,
            )
        assert program is not None
        program.model.metadata_props["network"] = config.to_json()
        program.save(str(path), external_data=False)
    finally:
        log.setLevel(level)
        model.train(was_training)


def check_onnx(path: Path, model: VideoClassifier) -> float:
    """Compares an ONNX file with its network on clips of several lengths, padded ones among them.

    Returns:
        The greatest difference of a logit or an attention.

    Raises:
        RefusedInput: the file cannot be run, is another network's, or differs by more than ``LARGEST_DIFFERENCE``.
    """
    import onnxruntime as ort

    options = ort.SessionOptions()
    options.intra_op_num_threads = torch.get_num_threads()
    options.log_severity_level = 3
    try:
        session = ort.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
    except Exception:  # onnxruntime's errors have no common base but this one.
        raise RefusedInput("onnx", str(path), "must be an ONNX file of this classifier") from None
    if tuple(value.name for value in session.get_inputs()) != INPUTS:
        raise RefusedInput("onnx", str(path), f"must take {', '.join(INPUTS)}")
    worst, was_training = 0.0, model.training
    model.eval()
    try:
        for batch, time in ((1, 4), (2, 7)):
            given = _example(model.config, batch=batch, time=time, seed=time)
            said = session.run(list(OUTPUTS), given)
            with torch.no_grad():
                expected = model(*(torch.from_numpy(value) for value in given.values()))
            for ours, theirs in zip(expected, said, strict=True):
                worst = max(worst, float(np.abs(ours.numpy() - np.asarray(theirs)).max()))
    finally:
        model.train(was_training)
    if not worst <= LARGEST_DIFFERENCE:
        raise RefusedInput("onnx", worst, f"may differ from the network by {LARGEST_DIFFERENCE:g} at most")
    return worst


def _example(config: NetworkConfig, *, batch: int, time: int, seed: int) -> dict[str, NDArray[np.generic]]:
    """Noise for every input; the last clip is one frame shorter than the rest."""
    noise = np.random.default_rng(seed)
    lengths = np.full(batch, time, dtype=np.int64)
    lengths[-1] -= 1
    frames = noise.normal(size=(batch, time, config.channels, config.size_px, config.size_px))
    critical = noise.integers(0, lengths, dtype=np.int64)
    return dict(zip(INPUTS, (frames.astype(np.float32), critical, lengths), strict=True))
