"""Figures of a frame are what its planes say: how far the load, its foot and its bands have moved."""

import numpy as np
import pytest
import torch

from classifier.configuration import MOTION_FIGURES, preset
from classifier.frames import network_input
from classifier.load_motion import CHANNELS, DISPLACED, packed_displacement
from classifier.motion_figures import MotionFigures, raw_figures
from classifier.network import VideoClassifier

CONFIG = preset("compact")
# Of nine lengths a blur: maxima of heights and metres, with and without what is not believed; shares and means.
WHOLE, SURE, LOW, SURE_LOW = 0, 1, 2, 3
BANDS = slice(18, 24)


def _frames(rows: slice, heights: float, metres: float, unlike: int = 0) -> torch.Tensor:
    """One frame in which some rows have moved along, the others not."""
    frames = np.zeros((1, 64, 64, CHANNELS), np.uint8)
    frames[..., DISPLACED.start : 7] = 128
    frames[:, rows, :, DISPLACED] = packed_displacement(np.float32([heights, 0.0, metres, 0.0]))
    frames[:, rows, :, 7] = unlike
    return torch.from_numpy(network_input(frames, CONFIG))


def _lengths(given: torch.Tensor) -> np.ndarray:
    return np.exp(raw_figures(given)[0, :24].numpy()) - 0.005


def test_a_load_that_moves_as_one_has_moved_by_that():
    found = _lengths(_frames(slice(0, 64), 0.06, 0.09))
    # A byte's step is √d/127.
    assert found[[WHOLE, SURE, 4, 5, 6]] == pytest.approx(0.06, abs=0.002)
    assert found[[LOW, SURE_LOW, 7, 8]] == pytest.approx(0.09, abs=0.0025)
    assert found[BANDS] == pytest.approx(0.06, abs=0.002)


def test_what_moves_at_the_top_is_no_movement_of_the_foot():
    found = _lengths(_frames(slice(0, 24), 0.06, 0.09))
    assert found[WHOLE] == pytest.approx(0.06, abs=0.002) and found[6] < 0.03
    assert found[[LOW, SURE_LOW, 7, 8]] == pytest.approx(0.0, abs=1.0e-6)
    top, *_, bottom = found[BANDS]
    assert top == pytest.approx(0.06, abs=0.002) and bottom == pytest.approx(0.0, abs=1.0e-6)


def test_what_the_flow_does_not_explain_is_not_believed():
    found = _lengths(_frames(slice(0, 24), 0.06, 0.09, unlike=60))
    # At the edge of what moves a square sees half of both, and less than half of it is left.
    assert found[WHOLE] == pytest.approx(0.06, abs=0.002) and found[SURE] < 0.5 * 0.06
    doubts = raw_figures(_frames(slice(0, 24), 0.06, 0.09, unlike=60))[0, 24:]
    assert doubts[0] > 0.3 and (doubts[2:] == 0.0).all()


def test_the_network_has_them_behind_the_features_of_its_backbone():
    torch.manual_seed(0)
    model = VideoClassifier(CONFIG).eval()
    given = torch.cat([_frames(slice(0, end), 0.06, 0.09) for end in (0, 30, 64, 20)])
    with torch.no_grad():
        features = model.features(given.unsqueeze(0))
        assert features.shape == (1, 4, CONFIG.features) == (1, 4, 128 + MOTION_FIGURES)
        assert isinstance(model.figures, MotionFigures)
        assert torch.allclose(features[0, :, 128:], model.figures(given), atol=1.0e-6)
        # Peak and end count, whatever stands behind the end.
        critical, length = torch.tensor([2]), torch.tensor([3])
        logit, _ = model.judge(features, critical, length)
        features[:, 3] = 1.0e3
        assert model.judge(features, critical, length)[0].item() == pytest.approx(logit.item(), abs=1.0e-6)
    assert VideoClassifier(preset("paper", base_width=4)).figures is None
