"""Residual networks of 18, 34 and 50 layers (He et al., CVPR 2016), named as in the files of ImageNet weights."""

from collections.abc import Mapping
from pathlib import Path
from typing import cast

import torch
from torch import Tensor, nn

from classifier.configuration import EXPANSION, Backbone, Pooling
from config.errors import RefusedInput

BLOCKS: dict[Backbone, tuple[int, int, int, int]] = {
    "resnet18": (2, 2, 2, 2),
    "resnet34": (3, 4, 6, 3),
    "resnet50": (3, 4, 6, 3),
}
"""Residual blocks in each of the four stages."""


def _convolution(inside: int, outside: int, edge: int, stride: int = 1) -> nn.Conv2d:
    return nn.Conv2d(inside, outside, edge, stride, padding=edge // 2, bias=False)


class BasicBlock(nn.Module):
    """Two 3 × 3 convolutions beside a short cut: [n, inside, h, w] to [n, width, h/stride, w/stride]."""

    def __init__(self, inside: int, width: int, stride: int) -> None:
        super().__init__()
        self.conv1 = _convolution(inside, width, 3, stride)
        self.bn1 = nn.BatchNorm2d(width)
        self.conv2 = _convolution(width, width, 3)
        self.bn2 = nn.BatchNorm2d(width)
        self.downsample = _short_cut(inside, width, stride)

    def forward(self, x: Tensor) -> Tensor:
        """Gives what the block sees plus what it makes of it."""
        made = torch.relu(self.bn1(self.conv1(x)))
        made = self.bn2(self.conv2(made))
        return torch.relu(made + (x if self.downsample is None else self.downsample(x)))


class Bottleneck(nn.Module):
    """A 3 × 3 convolution between two of 1 × 1: [n, inside, h, w] to [n, 4·width, h/stride, w/stride]."""

    def __init__(self, inside: int, width: int, stride: int) -> None:
        super().__init__()
        self.conv1 = _convolution(inside, width, 1)
        self.bn1 = nn.BatchNorm2d(width)
        # The stride stands at the middle convolution, as where the public weights were trained.
        self.conv2 = _convolution(width, width, 3, stride)
        self.bn2 = nn.BatchNorm2d(width)
        self.conv3 = _convolution(width, 4 * width, 1)
        self.bn3 = nn.BatchNorm2d(4 * width)
        self.downsample = _short_cut(inside, 4 * width, stride)

    def forward(self, x: Tensor) -> Tensor:
        """Gives what the block sees plus what it makes of it."""
        made = torch.relu(self.bn1(self.conv1(x)))
        made = torch.relu(self.bn2(self.conv2(made)))
        made = self.bn3(self.conv3(made))
        return torch.relu(made + (x if self.downsample is None else self.downsample(x)))


def _short_cut(inside: int, outside: int, stride: int) -> nn.Sequential | None:
    if stride == 1 and inside == outside:
        return None
    return nn.Sequential(_convolution(inside, outside, 1, stride), nn.BatchNorm2d(outside))


class ResNet(nn.Module):
    """A residual network up to its mean over the picture, or more; it has no classes of its own.

    Args:
        kind: ``resnet18``, ``resnet34`` or ``resnet50``.
        base_width: channels of the first stage.
        channels: of the pictures.
        pooling: see ``NetworkConfig``.

    Attributes:
        features: of a picture.
    """

    def __init__(
        self, kind: Backbone, *, base_width: int = 64, channels: int = 3, pooling: Pooling = "mean"
    ) -> None:
        super().__init__()
        block = Bottleneck if kind == "resnet50" else BasicBlock
        self.conv1 = _convolution(channels, base_width, 7, 2)
        self.bn1 = nn.BatchNorm2d(base_width)
        self.maxpool = nn.MaxPool2d(3, 2, padding=1)
        inside = base_width
        for stage, count in enumerate(BLOCKS[kind]):
            width = base_width * 2**stage
            blocks = []
            for number in range(count):
                blocks.append(block(inside, width, 2 if stage and not number else 1))
                inside = width * EXPANSION[kind]
            self.add_module(f"layer{stage + 1}", nn.Sequential(*blocks))
        self.features = inside
        self.mix = nn.Linear(2 * inside, inside) if pooling == "both" else None
        for module in self.modules():
            if isinstance(module, nn.Conv2d):
                nn.init.kaiming_normal_(module.weight, mode="fan_out", nonlinearity="relu")

    def forward(self, pictures: Tensor) -> Tensor:
        """Features, shape [n, features], of normalised pictures, shape [n, channels, h, w]."""
        x = self.maxpool(torch.relu(self.bn1(self.conv1(pictures))))
        for stage in range(1, 5):
            x = self.get_submodule(f"layer{stage}")(x)
        features: Tensor = x.mean(dim=(2, 3))
        if self.mix is None:
            return features
        mixed: Tensor = self.mix(torch.cat((features, x.amax(dim=(2, 3))), dim=1))
        return mixed


def load_imagenet_weights(model: ResNet, path: Path) -> None:
    """Takes the weights from a file in the format of torchvision's; its classes, ``fc.*``, are left out.

    Args:
        model: changed only if all of its weights are in the file.
        path: a ``.pth`` file with one dictionary of tensors; nothing else in it is executed or accepted.

    Raises:
        RefusedInput: the file cannot be read, or a weight is missing, unknown or of another shape.
    """
    try:
        stored = torch.load(path, map_location="cpu", weights_only=True)
    except OSError as problem:
        raise RefusedInput("weights", str(path), problem.strerror or "cannot be read") from None
    except Exception:  # Whatever an unpickler meets in foreign bytes: there is no narrower family.
        raise RefusedInput("weights", str(path), "must be a file of tensors that torch.save wrote") from None
    if not isinstance(stored, Mapping) or not all(isinstance(value, Tensor) for value in stored.values()):
        raise RefusedInput("weights", str(path), "must hold one dictionary of tensors")
    given = {str(name): cast(Tensor, value) for name, value in stored.items()}
    given = {name: value for name, value in given.items() if not name.startswith("fc.")}
    wanted = model.state_dict()
    for name, value in wanted.items():
        if name not in given:
            # Files older than this count have none, and it plays no part where weights are only used.
            if name.endswith("num_batches_tracked"):
                given[name] = torch.zeros_like(value)
                continue
            raise RefusedInput("weights", name, f"is missing in {path.name}")
        if given[name].shape != value.shape:
            raise RefusedInput(
                f"weights.{name}", tuple(given[name].shape), f"must have the shape {tuple(value.shape)}"
            )
    unknown = sorted(given.keys() - wanted.keys())
    if unknown:
        raise RefusedInput("weights", unknown[0], "is no weight of this network")
    model.load_state_dict(given)
