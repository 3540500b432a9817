"""The network that judges a test from its pictures: residual network, LSTM both ways, attention, critical frame."""

import torch
from torch import Tensor, nn

from classifier.configuration import NetworkConfig
from classifier.motion_figures import MotionFigures
from classifier.resnet import ResNet


class VideoClassifier(nn.Module):
    """Says how likely a test failed, from frames alone (topology of arXiv 2508.13989).

    Every frame becomes features; an LSTM reads them forwards and backwards; attention sums what it says up to one
    context vector; the frame of the largest change is seen a second time beside it; both are fused to one figure.

    Args:
        config: what to build.
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
        # A third faster on a CPU, by the order of its weights in memory alone.
        self.backbone.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.figures = MotionFigures() if config.figures else None
        self.forwards = nn.LSTM(config.features, config.lstm_units, batch_first=True)
        self.backwards = nn.LSTM(config.features, config.lstm_units, batch_first=True)
        self.attention_hidden = nn.Linear(config.context_features, config.context_features)
        self.attention_score = nn.Linear(config.context_features, 1, bias=False)
        self.critical = nn.Linear(config.features, config.critical_features)
        told = config.context_features + config.critical_features + 2 * config.figures
        self.fuse = nn.Linear(told, config.fused_features)
        self.dropout = nn.Dropout(config.dropout)
        self.output = nn.Linear(config.fused_features, 1)

    def forward(
        self, frames: Tensor, critical: Tensor, lengths: Tensor | None = None
    ) -> tuple[Tensor, Tensor]:
        """Judges clips.

        Args:
            frames: normalised, shape [batch, time, channels, h, w]; what is behind a clip's length is padding.
            critical: which of its frames changed most, from 0, int64, shape [batch].
            lengths: frames of each clip, int64, shape [batch]; None: no padding.

        Returns:
            Logits of failure, shape [batch], and each frame's share in the context, shape [batch, time].
        """
        return self.judge(self.features(frames), critical, lengths)

    def features(self, frames: Tensor) -> Tensor:
        """Features, shape [batch, time, features], of frames, shape [batch, time, channels, h, w]."""
        pictures = frames.flatten(0, 1)
        if torch.compiler.is_exporting():
            seen = self._seen(pictures)
        else:
            chunks = torch.split(pictures, self.config.chunk_frames)
            seen = torch.cat([self._seen(chunk) for chunk in chunks])
        return torch.unflatten(seen, 0, frames.shape[:2])

    def _seen(self, pictures: Tensor) -> Tensor:
        """Features of pictures, with their figures behind those of the backbone."""
        seen: Tensor = self.backbone(pictures)
        return seen if self.figures is None else torch.cat((seen, self.figures(pictures)), dim=1)

    def judge(
        self, features: Tensor, critical: Tensor, lengths: Tensor | None = None
    ) -> tuple[Tensor, Tensor]:
        """The part behind the backbone: as ``forward``, but from features, shape [batch, time, features]."""
        fused, attention = self.fused(features, critical, lengths)
        return self.output(fused).squeeze(1), attention

    def fused(
        self, features: Tensor, critical: Tensor, lengths: Tensor | None = None
    ) -> tuple[Tensor, Tensor]:
        """What the verdict is taken from, shape [batch, fused_features], and attention; see ``judge``."""
        batch, time = features.shape[:2]
        if lengths is None:
            lengths = torch.full((batch,), time, dtype=torch.int64, device=features.device)
        steps = torch.arange(time, device=features.device).unsqueeze(0)
        inside = steps < lengths.unsqueeze(1)
        # Each clip turned round within its own length, so that the way back, too, meets the padding last.
        turned = torch.where(inside, lengths.unsqueeze(1) - 1 - steps, steps)
        ahead = self.forwards(features)[0]
        back = _rows(self.backwards(_rows(features, turned))[0], turned)
        states = torch.cat((ahead, back), dim=2)
        score = self.attention_score(torch.tanh(self.attention_hidden(states))).squeeze(2)
        attention = torch.softmax(score.masked_fill(~inside, float("-inf")), dim=1)
        context = (attention.unsqueeze(2) * states).sum(dim=1)
        chosen = _rows(features, critical.unsqueeze(1)).squeeze(1)
        told = [context, torch.relu(self.critical(chosen))]
        if self.figures is not None:
            # What the standard asks for: the peak, and what remains.
            known = features[:, :, -self.config.figures :]
            peak = known.masked_fill(~inside.unsqueeze(2), float("-inf")).amax(dim=1)
            told += [peak, _rows(known, (lengths - 1).unsqueeze(1)).squeeze(1)]
        both = torch.cat(told, dim=1)
        return self.dropout(torch.relu(self.fuse(both))), attention


def _rows(values: Tensor, index: Tensor) -> Tensor:
    """Of each clip's rows those of an index: [batch, time, n] by [batch, k] gives [batch, k, n]."""
    return values.gather(1, index.unsqueeze(2).expand(-1, -1, values.shape[2]))


def parameter_count(module: nn.Module) -> int:
    """How many weights a module has that are learnt."""
    return sum(weight.numel() for weight in module.parameters())
