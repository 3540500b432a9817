"""The network has the layers that are written down, reads public weights, ignores padding and learns."""

import math
import subprocess
import sys

import numpy as np
import pytest
import torch
from torch import nn

from classifier.configuration import NetworkConfig, preset
from classifier.network import VideoClassifier, parameter_count
from classifier.resnet import ResNet, load_imagenet_weights
from config.errors import RefusedInput

SMALL = {"size_px": 32, "base_width": 4, "lstm_units": 6, "critical_features": 5, "fused_features": 7}


@pytest.fixture(autouse=True)
def _one_thread():
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    torch.manual_seed(0)
    yield
    torch.set_num_threads(before)


def _residual_count(kind: str, width: int, channels: int = 3) -> int:
    """Weights of a residual network by formula: k²·in·out of each convolution, two a channel of each normalisation."""
    blocks = {"resnet18": (2, 2, 2, 2), "resnet34": (3, 4, 6, 3), "resnet50": (3, 4, 6, 3)}[kind]
    count, inside = 49 * channels * width + 2 * width, width
    for stage, number in enumerate(blocks):
        w = width * 2**stage
        outside = 4 * w if kind == "resnet50" else w
        for block in range(number):
            if kind == "resnet50":
                count += inside * w + 9 * w * w + 4 * w * w + 2 * (w + w + 4 * w)
            else:
                count += 9 * inside * w + 9 * w * w + 4 * w
            if block == 0 and (inside != outside or stage):
                count += inside * outside + 2 * outside
            inside = outside
    return count


def _count(c: NetworkConfig) -> int:
    lstm = 2 * 4 * (c.lstm_units * c.features + c.lstm_units**2 + 2 * c.lstm_units)
    context = 2 * c.lstm_units
    attention = context * context + context + context
    critical = c.features * c.critical_features + c.critical_features
    # Peak and end of the plain figures, each with the two weights that even it out.
    fused = (
        (context + c.critical_features + 2 * c.figures) * c.fused_features + c.fused_features + 2 * c.figures
    )
    residual = _residual_count(c.backbone, c.base_width, c.channels)
    if c.pooling == "both":
        inside = c.features - c.figures
        residual += 2 * inside * inside + inside
    return residual + lstm + attention + critical + fused + c.fused_features + 1


@pytest.mark.parametrize(
    ("kind", "known"), [("resnet18", 11_176_512), ("resnet34", 21_284_672), ("resnet50", 23_508_032)]
)
def test_residual_networks_have_the_published_numbers_of_weights(kind, known):
    # torchvision's counts less its thousand classes: 513 000 weights behind 512 features, 2 049 000 behind 2048.
    assert parameter_count(ResNet(kind)) == known == _residual_count(kind, 64)
    assert (
        known + 1000 * ({"resnet50": 2048}.get(kind, 512) + 1)
        == {
            "resnet18": 11_689_512,
            "resnet34": 21_797_672,
            "resnet50": 25_557_032,
        }[kind]
    )


@pytest.mark.parametrize("name", ["paper", "compact"])
def test_presets_have_the_weights_that_their_figures_give(name):
    assert parameter_count(VideoClassifier(preset(name))) == _count(preset(name))


def test_paper_is_the_papers_network_layer_by_layer():
    config = preset("paper")
    assert (config.size_px, config.features, config.context_features) == (224, 2048, 512)
    model = VideoClassifier(config).eval()
    seen: dict[str, tuple[int, ...]] = {}

    def note(name: str):
        def hook(_module: nn.Module, _given: object, made: object) -> None:
            seen[name] = tuple((made[0] if isinstance(made, tuple) else made).shape)

        return hook

    for name, module in model.named_modules():
        module.register_forward_hook(note(name))
    with torch.no_grad():
        logit, attention = model(torch.randn(1, 2, 3, 224, 224), torch.tensor([1]))
    stages = {
        "conv1": (64, 112),
        "maxpool": (64, 56),
        "layer1": (256, 56),
        "layer2": (512, 28),
        "layer3": (1024, 14),
    }
    for name, (channels, edge) in {**stages, "layer4": (2048, 7)}.items():
        assert seen[f"backbone.{name}"] == (2, channels, edge, edge)
    assert seen["backbone"] == (2, 2048)
    assert seen["forwards"] == seen["backwards"] == (1, 2, 256)
    assert seen["attention_score"] == (1, 2, 1)
    assert seen["critical"] == (1, 128)
    assert model.fuse.in_features == 512 + 128 == 640 and seen["fuse"] == (1, 512)
    assert seen["output"] == (1, 1) and logit.shape == (1,) and attention.shape == (1, 2)


@pytest.mark.parametrize(("name", "clips", "frames"), [("paper", 2, 3), ("compact", 3, 24)])
def test_one_step_of_training_runs_and_reaches_every_weight(name, clips, frames):
    model = VideoClassifier(preset(name))
    size, channels = model.config.size_px, model.config.channels
    descent = torch.optim.SGD(model.parameters(), lr=1.0e-3)
    before = {key: value.clone() for key, value in model.named_parameters()}
    logit, _ = model(torch.randn(clips, frames, channels, size, size), torch.zeros(clips, dtype=torch.int64))
    loss = nn.functional.binary_cross_entropy_with_logits(logit, torch.arange(clips) % 2.0)
    loss.backward()
    descent.step()
    assert math.isfinite(loss.item())
    assert [key for key, value in model.named_parameters() if torch.equal(value, before[key])] == []


def test_padding_changes_nothing_and_gets_no_attention():
    model = VideoClassifier(preset("compact", **SMALL)).eval()
    clip = torch.randn(1, 5, 9, 32, 32)
    with torch.no_grad():
        logit, attention = model(clip, torch.tensor([3]))
        for filler in (0.0, 1.0e3):
            padded = torch.cat((clip, torch.full((1, 4, 9, 32, 32), filler)), dim=1)
            both = torch.cat((padded, torch.randn(1, 9, 9, 32, 32)))
            logits, shares = model(both, torch.tensor([3, 8]), torch.tensor([5, 9]))
            assert logits[0].item() == pytest.approx(logit.item(), abs=1.0e-6)
            assert torch.allclose(shares[0, :5], attention[0], atol=1.0e-6)
            assert (shares[0, 5:] == 0.0).all()
            assert torch.allclose(shares.sum(dim=1), torch.ones(2), atol=1.0e-6)


def test_the_two_readings_are_a_bidirectional_lstm():
    model = VideoClassifier(preset("compact", **SMALL)).eval()
    both = nn.LSTM(model.config.features, 6, batch_first=True, bidirectional=True)
    for key in ("weight_ih_l0", "weight_hh_l0", "bias_ih_l0", "bias_hh_l0"):
        getattr(both, key).data = getattr(model.forwards, key).data
        getattr(both, f"{key}_reverse").data = getattr(model.backwards, key).data
    states: list[torch.Tensor] = []
    model.attention_hidden.register_forward_hook(lambda _module, given, _made: states.append(given[0]))
    features = torch.randn(2, 6, model.config.features)
    with torch.no_grad():
        model.judge(features, torch.tensor([0, 0]), torch.tensor([4, 6]))
        assert torch.allclose(states[0][0, :4], both(features[:1, :4])[0][0], atol=1.0e-6)
        assert torch.allclose(states[0][1], both(features[1:])[0][0], atol=1.0e-6)


def test_chunks_and_order_of_time_are_what_they_should_be():
    whole = VideoClassifier(preset("compact", **SMALL, chunk_frames=100)).eval()
    parts = VideoClassifier(preset("compact", **SMALL, chunk_frames=3)).eval()
    parts.load_state_dict(whole.state_dict())
    clip, critical = torch.randn(2, 7, 9, 32, 32), torch.tensor([1, 6])
    with torch.no_grad():
        assert torch.allclose(whole(clip, critical)[0], parts(clip, critical)[0], atol=1.0e-6)
        assert not torch.allclose(whole(clip, critical)[0], whole(clip.flip(1), 6 - critical)[0], atol=1.0e-6)


def test_weights_in_imagenets_format_are_read(tmp_path):
    source, model = ResNet("resnet18", base_width=8), ResNet("resnet18", base_width=8)
    stored = {**source.state_dict(), "fc.weight": torch.zeros(1000, 64), "fc.bias": torch.zeros(1000)}
    # The names of the public files, as far as a few can stand for all.
    assert {
        "conv1.weight",
        "bn1.running_var",
        "layer1.0.conv1.weight",
        "layer2.0.downsample.0.weight",
    } <= stored.keys()
    assert {"layer2.0.downsample.1.bias", "layer4.1.bn2.num_batches_tracked"} <= stored.keys()
    torch.save(stored, tmp_path / "weights.pth")
    load_imagenet_weights(model, tmp_path / "weights.pth")
    for key, value in model.state_dict().items():
        assert torch.equal(value, stored[key])


def test_weights_that_do_not_fit_are_refused_in_one_line(tmp_path):
    model, path = ResNet("resnet18", base_width=8), tmp_path / "weights.pth"
    before = {key: value.clone() for key, value in model.state_dict().items()}
    good = ResNet("resnet18", base_width=8).state_dict()
    lacking = {key: value for key, value in good.items() if key != "layer3.1.bn2.weight"}
    cases = {
        "layer3.1.bn2.weight: is missing": lacking,
        "weights.conv1.weight = \\(8, 1, 7, 7\\)": {**good, "conv1.weight": torch.zeros(8, 1, 7, 7)},
        "is no weight of this network": {**good, "layer9.weight": torch.zeros(1)},
        "dictionary of tensors": [1, 2],
    }
    for said, stored in cases.items():
        torch.save(stored, path)
        with pytest.raises(RefusedInput, match=said):
            load_imagenet_weights(model, path)
    for content in (b"", b"no weights", b"PK\x03\x04 broken"):
        path.write_bytes(content)
        with pytest.raises(RefusedInput, match=r"torch\.save"):
            load_imagenet_weights(model, path)
    with pytest.raises(RefusedInput, match="No such file"):
        load_imagenet_weights(model, tmp_path / "none.pth")
    assert all(torch.equal(value, before[key]) for key, value in model.state_dict().items())


def test_configurations_go_through_json_and_errors_name_the_choices():
    for name in ("paper", "compact"):
        assert NetworkConfig.from_json(preset(name).to_json()) == preset(name)
    for said, attempt in {
        "one of paper, compact": lambda: preset("huge"),
        "'resnet18', 'resnet34' or 'resnet50'": lambda: preset("paper", backbone="vgg"),
        "'rgb', 'change' or 'motion'": lambda: preset("paper", mode="depth"),
        "channels 1 must be one of": lambda: preset("paper", channels=1),
        "channels 3 must be one of": lambda: preset("compact", channels=3),
        "network.units": lambda: preset("compact", units=3),
        "network.size_px": lambda: NetworkConfig.from_json('{"mode": "rgb"}'),
        "network": lambda: NetworkConfig.from_json("{"),
    }.items():
        with pytest.raises(RefusedInput, match=said) as refusal:
            attempt()
        assert "\n" not in str(refusal.value)
    with pytest.raises(ValueError, match="frozen"):
        preset("paper").size_px = 3  # type: ignore[misc]


def test_nothing_but_the_classifier_imports_torch():
    modules = (
        "config.scene_file, sim_core.run, sim_core.camera.renderer, sim_core.vision.measure, msgs_adapters.camera_payloads, "
        "recordings.bag_pictures, recordings.campaigns.driver, ros_nodes.cli, classifier.configuration, classifier.frames, "
        "classifier.guidance"
    )
    probe = f"import sys, {modules}; print([m for m in ('torch', 'onnx', 'onnxruntime') if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", probe], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_the_same_seed_builds_the_same_network():
    built = []
    for _ in range(2):
        torch.manual_seed(3)
        built.append(VideoClassifier(preset("compact", **SMALL)).eval())
    with torch.no_grad():
        said = [model(torch.ones(1, 2, 9, 32, 32), torch.tensor([0]))[0].numpy() for model in built]
    assert np.array_equal(*said)
