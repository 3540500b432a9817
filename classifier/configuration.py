"""What a video classifier is built of and what it looks at: frozen figures with two presets, to and from JSON."""

from typing import Any, Literal, Self, get_args

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from config.errors import RefusedInput

Backbone = Literal["resnet18", "resnet34", "resnet50"]
Mode = Literal["rgb", "change", "motion"]
Preset = Literal["paper", "compact"]
Pooling = Literal["mean", "both"]

_CHANNELS: dict[Mode, tuple[int, ...]] = {"rgb": (3,), "change": (1, 3), "motion": (9,)}

MOTION_FIGURES = 28
"""Plain figures of a frame of motion."""

EXPANSION: dict[Backbone, int] = {"resnet18": 1, "resnet34": 1, "resnet50": 4}
"""Channels that a residual block gives, in multiples of its width."""


class NetworkConfig(BaseModel):
    """Everything that has to be known to build the network and to prepare its frames.

    Attributes:
        mode: ``rgb``: the whole picture in colour; ``change``: a crop that rides on the sled, as its grey, the first
            picture's grey and what has changed between the two; ``motion``: the same load's grey in the first picture,
            how far each part of it has moved since, parallax, the sled's travel, what the movement does not explain,
            and what came in.
        size_px: edge of a frame, which is square [px].
        frames: how many of a clip are looked at; None: all of them.
        channels: of a frame; 3, or 1 for the change alone; 9 for motion.
        backbone: which residual network sees each frame.
        base_width: channels of its first stage; 64 is the usual one. The last has eight times as many (ResNet-50: 32).
        pooling: how features of a picture's parts become those of the picture: their mean, or as many sums of mean and
            maximum, for one package that has moved far is enough.
        lstm_units: a direction.
        critical_features: to which the critical frame's features are reduced.
        fused_features: to which context and critical features are brought together.
        dropout: share of the fused features that is dropped in training.
        chunk_frames: how many frames the backbone sees at once; bounds memory. Results do not depend on it but in
            training, where the batch of a normalisation is a chunk.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    mode: Mode
    size_px: int = Field(ge=32, le=1024)
    frames: int | None = Field(ge=2, le=10_000)
    channels: int = 3
    backbone: Backbone
    base_width: int = Field(default=64, ge=4, le=256)
    pooling: Pooling = "mean"
    lstm_units: int = Field(ge=1, le=4096)
    critical_features: int = Field(ge=1, le=8192)
    fused_features: int = Field(ge=1, le=8192)
    dropout: float = Field(default=0.0, ge=0.0, lt=1.0)
    chunk_frames: int = Field(default=16, ge=1, le=10_000)

    @model_validator(mode="after")
    def _frames_have_the_channels_of_their_mode(self) -> Self:
        if self.channels not in (choices := _CHANNELS[self.mode]):
            raise ValueError(f"channels {self.channels} must be one of {choices} where mode is {self.mode}")
        return self

    @property
    def features(self) -> int:
        """Features of a frame, its figures included."""
        return 8 * self.base_width * EXPANSION[self.backbone] + self.figures

    @property
    def figures(self) -> int:
        """Plain figures of a frame, see ``classifier.motion_figures``."""
        return MOTION_FIGURES if self.mode == "motion" else 0

    @property
    def context_features(self) -> int:
        """Features of the whole clip: both directions of the LSTM."""
        return 2 * self.lstm_units

    def to_json(self) -> str:
        """The configuration as JSON text; ``from_json`` gives the same one back."""
        return self.model_dump_json(indent=1)

    @classmethod
    def from_json(cls, text: str) -> Self:
        """Reads a configuration.

        Raises:
            RefusedInput: it is no JSON, or a value is missing, unknown or outside its limits.
        """
        try:
            return cls.model_validate_json(text)
        except ValidationError as problem:
            raise _refused(problem) from None


def preset(name: str, **changed: Any) -> NetworkConfig:
    """A ready configuration.

    Args:
        name: ``paper``, the network of arXiv 2508.13989, or ``compact``, the same topology on a small scale.
        changed: values that are to differ from it.

    Raises:
        RefusedInput: there is no preset of that name, or a changed value is refused.
    """
    if name not in _PRESETS:
        raise RefusedInput("network", name, f"must be one of {', '.join(get_args(Preset))}")
    try:
        return NetworkConfig.model_validate({**_PRESETS[name], **changed})
    except ValidationError as problem:
        raise _refused(problem) from None


def _refused(problem: ValidationError) -> RefusedInput:
    """The first of what is wrong, as one line."""
    first = problem.errors()[0]
    field = ".".join(("network", *(str(part) for part in first["loc"])))
    return RefusedInput(field, first["input"], first["msg"])


_PRESETS: dict[str, dict[str, Any]] = {
    "paper": {
        "mode": "rgb",
        "size_px": 224,
        "frames": None,
        "backbone": "resnet50",
        "lstm_units": 256,
        "critical_features": 128,
        "fused_features": 512,
    },
    "compact": {
        "mode": "motion",
        "size_px": 64,
        "frames": 24,
        "channels": 9,
        "backbone": "resnet18",
        "base_width": 16,
        "pooling": "both",
        "lstm_units": 64,
        "critical_features": 32,
        "fused_features": 64,
        "dropout": 0.2,
        "chunk_frames": 192,
    },
}
