"""How a video classifier is trained: frozen figures with two presets, refused where they make no sense."""

from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from config.errors import RefusedInput


class TrainingConfig(BaseModel):
    """Everything that a training depends on beside its bags and its network; defaults as in arXiv 2508.13989.

    Attributes:
        seed: of the first weights, the order of clips, their augmentation and what is dropped out.
        split_seed: of the split, so that several seeds can be trained on one split.
        test_share: of all tests, that are never seen in training.
        validation_share: of all tests, that end the training.
        epochs: at most so many.
        patience: epochs without a lower validation loss after which training ends.
        batch: clips that go through the network at once, in each process.
        accumulation: batches to one step of the optimiser.
        learning_rate: of AdamW.
        weight_decay: of AdamW.
        schedule: of the learning rate: ``constant``, or ``cosine`` from the full rate to a hundredth of it at the end.
        warmup_epochs: over which the learning rate rises from nothing.
        average: share that is kept of the mean of all weights so far after each step of the optimiser; the mean is what
            is validated and kept. 0: the weights themselves are.
        success_weight: how much more a passed test weighs in the loss than a failed one; None: as many times as failed
            tests outnumber the passed ones in training, but never less than 1.
        guidance: weight of a second loss: from each frame's features, how far the load truly stood from its place. Only
            training knows that; it teaches the backbone what to look at.
        margins: weight of a third loss: from what the verdict is taken from, how far each rule was from its limit, and
            whether there was damage.
        augmentation: probability of each change to a clip; 0 changes nothing.
        resize: a clip is made larger or smaller by up to this share.
        rotation_deg: a clip is turned by up to so much [°].
        jitter: brightness and contrast, and in colour the saturation, change by up to this share.
        flip: clips may be mirrored left to right.
        stretch: a clip's displacements are multiplied by a factor whose logarithm is up to so much, and its verdict is
            what follows from that; for frames of displacement alone.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    seed: int = Field(default=0, ge=0, le=2**31)
    split_seed: int = Field(default=0, ge=0, le=2**31)
    test_share: float = Field(default=0.2, gt=0.0, lt=1.0)
    validation_share: float = Field(default=0.1, gt=0.0, lt=1.0)
    epochs: int = Field(default=100, ge=1, le=100_000)
    patience: int = Field(default=10, ge=1, le=100_000)
    batch: int = Field(default=8, ge=1, le=4096)
    accumulation: int = Field(default=2, ge=1, le=4096)
    learning_rate: float = Field(default=5.0e-4, gt=0.0, le=1.0)
    weight_decay: float = Field(default=1.0e-5, ge=0.0, le=1.0)
    schedule: Literal["constant", "cosine"] = "constant"
    warmup_epochs: float = Field(default=0.0, ge=0.0, le=1000.0)
    average: float = Field(default=0.0, ge=0.0, lt=1.0)
    success_weight: float | None = Field(default=None, ge=1.0, le=1000.0)
    guidance: float = Field(default=0.0, ge=0.0, le=100.0)
    margins: float = Field(default=0.0, ge=0.0, le=100.0)
    augmentation: float = Field(default=0.5, ge=0.0, le=1.0)
    resize: float = Field(default=0.1, ge=0.0, le=0.5)
    rotation_deg: float = Field(default=5.0, ge=0.0, le=45.0)
    jitter: float = Field(default=0.2, ge=0.0, le=0.9)
    flip: bool = True
    stretch: float = Field(default=0.0, ge=0.0, le=2.0)


def training_preset(name: str, **changed: Any) -> TrainingConfig:
    """A ready configuration.

    Args:
        name: ``paper`` or ``compact``.
        changed: values that are to differ from it.

    Raises:
        RefusedInput: there is no preset of that name, or a changed value is refused.
    """
    if name not in _PRESETS:
        raise RefusedInput("training", name, f"must be one of {', '.join(_PRESETS)}")
    try:
        return TrainingConfig.model_validate({**_PRESETS[name], **changed})
    except ValidationError as problem:
        first = problem.errors()[0]
        field = ".".join(("training", *(str(part) for part in first["loc"])))
        raise RefusedInput(field, first["input"], first["msg"]) from None


# 16 epochs of a thousand clips take a core eight minutes.
_PRESETS: dict[str, dict[str, Any]] = {
    "paper": {},
    "compact": {
        "epochs": 16,
        "patience": 16,
        "learning_rate": 1.0e-3,
        "weight_decay": 5.0e-2,
        "average": 0.99,
        "schedule": "cosine",
        "warmup_epochs": 2.0,
        "guidance": 4.0,
        "margins": 2.0,
        "stretch": 0.4,
    },
}
