"""Plain figures of a frame of motion: how far its parts have moved, for a network that need not learn to measure."""

from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.nn import functional

from classifier.configuration import MOTION_FIGURES as FIGURES
from classifier.frames import CHANGE_LEVELS, MOTION_SCALE
from sim_core.judge import BAND_COUNT

_INSIDE = (0.2, 0.14, 0.8, 0.91)
"""Left, top, right and bottom of the load in a frame, as shares of it; see ``classifier.load_motion.Outline.shown``."""
_FOOT = (0.69, 0.875)
"""Top and bottom of its lowest packages."""
_EXPLAINED = 25.0 / CHANGE_LEVELS
"""Of what the flow does not explain: more, and what it tells is not believed."""
_LEAST = 0.005
"""Of displacement in heights or metres, that is added before the logarithm is taken."""


class MotionFigures(nn.Module):
    """Logarithms of how far the load and its bands have moved, and how much is not explained or new, evened out."""

    def __init__(self) -> None:
        super().__init__()
        self.even = nn.BatchNorm1d(FIGURES)

    def forward(self, pictures: Tensor) -> Tensor:
        """Figures, shape [n, FIGURES], of normalised frames of motion, shape [n, channels, size, size]."""
        figures: Tensor = self.even(raw_figures(pictures))
        return figures


def raw_figures(pictures: Tensor) -> Tensor:
    """The figures before they are evened out, shape [n, FIGURES].

    Means and maxima of displacement in heights of the load over all of it, in metres over its foot, and in heights over
    each height band. What is looked at are averages over squares of 5 and of about 9 px, a quarter and half of a
    package's edge, since one point can be wrong.

    Args:
        pictures: as ``network_input`` gives them, shape [n, channels, size, size].
    """
    roots = pictures[:, 1:5] / pictures.new_tensor(MOTION_SCALE[:4])[:, None, None]
    # Half as many points as pixels are enough of what is averaged over five of them.
    planes = torch.cat((roots * roots.abs(), pictures[:, -2:]), dim=1)
    narrow = functional.avg_pool2d(planes, 5, stride=2, padding=2)
    wide = functional.avg_pool2d(narrow, 3, stride=1, padding=1)
    size = narrow.shape[-1]
    left, top, right, bottom = (round(share * size) for share in _INSIDE)
    foot = slice(round(_FOOT[0] * size), round(_FOOT[1] * size))
    along = slice(left, right)
    lengths: list[Tensor] = []
    for blurred in (narrow, wide):
        heights = _length(blurred[:, 0], blurred[:, 1])
        metres = _length(blurred[:, 2], blurred[:, 3])
        believed = (blurred[:, 4] < _EXPLAINED).to(heights.dtype)
        whole, low = heights[:, top:bottom, along].flatten(1), metres[:, foot, along].flatten(1)
        sure, sure_low = (
            (heights * believed)[:, top:bottom, along].flatten(1),
            (metres * believed)[:, foot, along].flatten(1),
        )
        lengths += [whole.amax(dim=1), sure.amax(dim=1), low.amax(dim=1), sure_low.amax(dim=1)]
        lengths += [
            _upper(whole, 0.05),
            _upper(whole, 0.2),
            whole.mean(dim=1),
            _upper(low, 0.1),
            low.mean(dim=1),
        ]
    edges = [round(top + (bottom - top) * k / BAND_COUNT) for k in range(BAND_COUNT + 1)]
    heights = _length(narrow[:, 0], narrow[:, 1])
    lengths += [_upper(heights[:, high:low, along].flatten(1), 0.1) for high, low in pairwise(edges)]
    left_over, beside = narrow[:, 4, top:bottom, along].flatten(1), narrow[:, 5].flatten(1)
    doubts = [left_over.mean(dim=1), _upper(left_over, 0.05), beside.mean(dim=1), _upper(beside, 0.02)]
    return torch.cat((torch.log(torch.stack(lengths, dim=1) + _LEAST), torch.stack(doubts, dim=1)), dim=1)


def _length(along: Tensor, down: Tensor) -> Tensor:
    """Of vectors; ``norm`` takes six times as long, and ONNX knows no ``hypot``."""
    return torch.sqrt(along * along + down * down)


def _upper(values: Tensor, share: float) -> Tensor:
    """Mean of the largest share of values, shape [n, k] to [n]."""
    count = max(1, round(share * values.shape[1]))
    return values.topk(count, dim=1, sorted=False).values.mean(dim=1)
