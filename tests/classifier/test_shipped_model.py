"""The model that comes with the product: small, whole, and what its figures were made from."""

import json
from pathlib import Path

import numpy as np
import pytest

import classifier
from classifier.configuration import preset
from classifier.evaluation import model_digest
from classifier.frames import prepared_clip
from classifier.metrics import FIGURES
from classifier.running import read_judge
from ros_nodes.evaluate import model_in
from tests.classifier.sled_clip import sled_clip

FOLDER = Path(classifier.__file__).parent / "models" / "compact"


def test_it_is_found_by_its_name_unless_a_folder_has_that_name(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert model_in(Path("compact")).samefile(FOLDER)
    assert model_in(Path("nowhere")) == Path("nowhere")
    (tmp_path / "compact").mkdir()
    assert model_in(Path("compact")) == Path("compact")


def test_it_is_the_compact_network_and_small():
    judge, told = read_judge(FOLDER)
    assert judge.model.config == preset("compact")
    assert told["bags"]["campaign"] == "paper" and told["split"]["kind"] == "scheme"
    assert sum(path.stat().st_size for path in FOLDER.iterdir()) < 20e6


def test_its_figures_are_of_these_weights_and_complete():
    told = json.loads((FOLDER / "metrics.json").read_text())
    assert told["group_held_out"]["model"] == model_digest(FOLDER)
    for split in ("group_held_out", "random_split"):
        assert told[split]["tests"] > 200
        for figure in ("accuracy", "precision", "recall", "f1", "loss"):
            assert np.isfinite(told[split][figure]) and figure in FIGURES


@pytest.mark.parametrize(("slip_m", "passes"), [(0.0, True), (0.6, False)])
def test_it_tells_a_load_that_stays_from_one_that_is_swept_off(slip_m, passes):
    judge, _ = read_judge(FOLDER)
    answer = judge.judge(prepared_clip(sled_clip(count=24, slip_m=slip_m).pictures, judge.model.config))
    assert answer.passes == passes
