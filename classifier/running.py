"""A running judgement from the pictures so far: the same object for a node, a recording and an evaluation."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from classifier.checkpoint import load_model
from classifier.frames import DEPTH, ClipTaker, Pixels, PreparedClip, network_input
from classifier.metrics import probability
from classifier.network import VideoClassifier
from config.errors import RefusedInput
from sim_core.frames import Array


@dataclass(frozen=True, eq=False)
class Answer:
    """What the classifier guesses of a clip.

    Attributes:
        logit: of success, divided by the temperature.
        success: probability of success.
        passes: whether it is called a pass.
        attention: each frame's share in the guess, shape [time].
        clip: what it looked at.
    """

    logit: float
    success: float
    passes: bool
    attention: Array
    clip: PreparedClip


class Judge:
    """A trained network with its threshold and its temperature.

    Args:
        model: the network, ready to judge.
        threshold: probability of failure from which a test is called a fail.
        temperature: that logits are divided by.
    """

    def __init__(self, model: VideoClassifier, *, threshold: float = 0.5, temperature: float = 1.0) -> None:
        self.model, self.threshold, self.temperature = model, threshold, temperature

    @property
    def success_threshold(self) -> float:
        """Probability of success from which a test is called a pass."""
        return 1.0 - self.threshold

    def judge(self, clip: PreparedClip, features: torch.Tensor | None = None) -> Answer:
        """Judges a clip, from its frames or from features of them that are known already, shape [time, features]."""
        with torch.inference_mode():
            if features is None:
                features = self.features(clip.frames)
            said, attention = self.model.judge(features.unsqueeze(0), torch.tensor([clip.critical]))
        # The network's logit is that of failure.
        logit = -float(said) / self.temperature
        success = float(probability(np.array(logit)))
        return Answer(
            logit, success, success >= self.success_threshold, attention[0].numpy().astype(np.float64), clip
        )

    def warm_up(self) -> None:
        """Judges an empty clip, so that the first real one finds everything in place."""
        config = self.model.config
        shape = 2, config.size_px, config.size_px, DEPTH[config.mode]
        nothing = np.zeros(shape, dtype=np.uint8)
        self.judge(PreparedClip(nothing, np.arange(2), 0, np.zeros(2), False, ""))

    def features(self, frames: Pixels) -> torch.Tensor:
        """Features of frames, shape [time, features]."""
        given = torch.from_numpy(network_input(frames, self.model.config))
        with torch.inference_mode():
            return self.model.features(given.unsqueeze(0))[0]


def read_judge(folder: Path) -> tuple[Judge, dict[str, Any]]:
    """The judge in a model's folder, and what is told of the model.

    Raises:
        RefusedInput: it holds no model, or its threshold or temperature is none.
    """
    model, told = load_model(folder)
    threshold, temperature = told.get("threshold", 0.5), told.get("temperature", 1.0)
    if not isinstance(threshold, int | float) or not 0.0 < threshold < 1.0:
        raise RefusedInput("model.threshold", threshold, "must be a probability between 0 and 1")
    if not isinstance(temperature, int | float) or not 0.0 < temperature < np.inf:
        raise RefusedInput("model.temperature", temperature, "must be a positive number")
    return Judge(model, threshold=float(threshold), temperature=float(temperature)), told


class RunningJudge:
    """Takes a test's pictures in order, and judges what it has seen whenever it is asked.

    The last answer is that of the whole clip. Frames that stay as they were are seen by the backbone only once: all of
    them where frames are whole pictures. A crop, or displacement, is made anew when more of the sled's way is known.

    Args:
        judge: who judges.
    """

    def __init__(self, judge: Judge) -> None:
        self._judge = judge
        self._taker = ClipTaker(judge.model.config)
        self._known: dict[bytes, torch.Tensor] = {}
        self.pictures = 0

    def take(self, picture: Pixels) -> None:
        """Takes the next picture: red, green and blue, shape [height, width, 3].

        Raises:
            RefusedInput: it is no such picture, or of another size than the first.
        """
        self._taker.take(picture)
        self.pictures += 1

    def answer(self) -> Answer:
        """The judgement of the pictures so far.

        Raises:
            RefusedInput: there are less than two.
        """
        clip = self._taker.clip()
        return self._judge.judge(clip, self._features(clip.frames))

    def _features(self, frames: Pixels) -> torch.Tensor:
        """Features of frames, those of new ones computed together."""
        # What the network makes of a frame depends on the first one, too.
        first = frames[0].tobytes() if self._judge.model.config.mode == "change" else b""
        keys = [first + frame.tobytes() for frame in frames]
        new = [number for number, key in enumerate(keys) if key not in self._known]
        if new:
            # The first frame goes with them, so that they are prepared against it.
            seen = self._judge.features(frames[sorted({0, *new})])
            places = {number: place for place, number in enumerate(sorted({0, *new}))}
            self._known |= {keys[number]: seen[places[number]] for number in new}
        self._known = {key: self._known[key] for key in keys}
        return torch.stack([self._known[key] for key in keys])


def mattering_frames(answer: Answer, *, count: int = 3) -> NDArray[np.intp]:
    """Numbers of the pictures with the largest attention, the largest first."""
    return answer.clip.numbers[np.argsort(-answer.attention, kind="stable")[:count]]
