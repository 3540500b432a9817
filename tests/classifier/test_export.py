"""The ONNX file says what the network says, for any length of clip, and another network's file is refused."""

import pytest
import torch

from classifier.configuration import NetworkConfig, preset
from classifier.export import LARGEST_DIFFERENCE, check_onnx, export_onnx
from classifier.network import VideoClassifier
from config.errors import RefusedInput


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    torch.manual_seed(0)
    model = VideoClassifier(preset("compact")).train()
    path = tmp_path_factory.mktemp("onnx") / "compact.onnx"
    export_onnx(model, path)
    return model, path


def test_onnx_gives_what_torch_gives(exported):
    model, path = exported
    assert model.training
    assert check_onnx(path, model) < LARGEST_DIFFERENCE


def test_the_file_is_alone_and_tells_its_configuration(exported):
    onnx = pytest.importorskip("onnx")
    model, path = exported
    assert [entry.name for entry in path.parent.iterdir()] == ["compact.onnx"]
    metadata = {entry.key: entry.value for entry in onnx.load(path).metadata_props}
    assert NetworkConfig.from_json(metadata["network"]) == model.config


def test_another_networks_file_is_refused(exported, tmp_path):
    _, path = exported
    torch.manual_seed(1)
    with pytest.raises(RefusedInput, match="may differ"):
        check_onnx(path, VideoClassifier(preset("compact")))
    (tmp_path / "no.onnx").write_bytes(b"no network")
    with pytest.raises(RefusedInput, match="must be an ONNX file"):
        check_onnx(tmp_path / "no.onnx", VideoClassifier(preset("compact")))
