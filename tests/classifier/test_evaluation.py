"""Evaluating, predicting and the plain baselines, on a campaign of tiny tests and networks that know nothing."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from classifier.baselines import change_features
from classifier.breakdowns import by_first_rule, by_margin, early, looks, margin_share
from classifier.checkpoint import save_model
from classifier.clips import ClipCache
from classifier.configuration import NetworkConfig, preset
from classifier.displacement import FEATURES, _enlarged, measured_features
from classifier.evaluation import evaluate, split_of
from classifier.examples import Example, read_examples
from classifier.frames import PreparedClip, prepared_clip
from classifier.logistic import fitted_logistic, prior_logit
from classifier.mean_pooling import MeanPooling, pooled_logits
from classifier.metrics import logit, scores
from classifier.network import VideoClassifier, parameter_count
from classifier.prediction import SURE, predict_bag
from classifier.robustness import CONDITIONS
from classifier.rows import Rows
from classifier.running import Judge, RunningJudge, read_judge
from classifier.training_config import TrainingConfig
from config.campaign import read_campaign
from config.errors import RefusedInput
from config.shipped import CAMPAIGNS
from recordings.campaigns.workers import ProcessWorkers
from tests.classifier.sled_clip import sled_clip
from tests.recordings.tiny_campaign import CAMERA, SCENE, run, tiny

SMALL = {"size_px": 32, "base_width": 4, "lstm_units": 4, "critical_features": 4, "fused_features": 4}
TEMPERATURE, THRESHOLD = 1.5, 0.45


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Passes and fails of two schemes, seen on eight small pictures each."""
    folder = tmp_path_factory.mktemp("campaign")
    scene = {**SCENE, "camera": {**CAMERA, "width_px": 160, "height_px": 90, "pictures": 8}}
    run(folder, ProcessWorkers(1), tiny(tests=8, scene=scene))
    return folder


@pytest.fixture(scope="module")
def examples(campaign: Path) -> list[Example]:
    found = read_examples(campaign)
    assert {example.success for example in found} == {True, False} and len(found) >= 6
    return found


def small(**changed: object) -> NetworkConfig:
    return preset("compact", **{**SMALL, "frames": 5, **changed})


def untrained(config: NetworkConfig, *, bias: float = 0.0) -> VideoClassifier:
    torch.manual_seed(1)
    model = VideoClassifier(config).eval()
    with torch.no_grad():
        model.output.bias += bias
    return model


def parted(examples: list[Example], kind: str) -> dict[str, object]:
    numbers = [example.number for example in examples]
    return {"kind": kind, "seed": 0, "train": numbers[3:-1], "validation": numbers[-1:], "test": numbers[:3]}


def saved(folder: Path, examples: list[Example], kind: str) -> Path:
    told = {
        "threshold": THRESHOLD, "temperature": TEMPERATURE, "split": parted(examples, kind),
        "bags": {"campaign": "tiny", "count": len(examples), "sha256": "0" * 64}, "code": "0" * 64,
    }  # fmt: skip
    save_model(folder, untrained(small()), told)
    return folder


@pytest.fixture(scope="module")
def models(examples: list[Example], tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("models")
    return {kind: saved(folder / kind, examples, kind) for kind in ("scheme", "random")}


def test_an_evaluation_tells_every_figure_and_is_not_done_twice(
    campaign: Path, examples: list[Example], models: dict[str, Path], tmp_path: Path
) -> None:
    own, out = tmp_path / "campaign", tmp_path / "out"
    shutil.copytree(campaign, own)
    texture, jpeg = CONDITIONS[2], CONDITIONS[3]

    def evaluated() -> dict[str, bytes]:
        evaluate(
            models["scheme"], own, out, random_split=models["random"], redrawn=2, conditions=[texture, jpeg]
        )
        return {path.name: path.read_bytes() for path in sorted(out.iterdir()) if path.is_file()}

    first = evaluated()
    told = json.loads(first["metrics.json"])
    held = told["group_held_out"]
    assert {"accuracy", "precision", "recall", "f1", "loss", "tests", "intervals"} <= held.keys()
    assert {"accuracy", "precision", "recall", "f1", "loss", "tests", "intervals"} <= told[
        "random_split"
    ].keys()
    assert "intervals_by_scheme" in held and "intervals_by_scheme" not in told["random_split"]
    assert held["tests"] == 3 and held["threshold"] == pytest.approx(1.0 - THRESHOLD)
    # By hand: the network's logit is that of failure.
    judge = read_judge(models["scheme"])[0]
    cache = ClipCache(tmp_path / "clips", small())
    success = np.array([example.success for example in examples[:3]])
    logits = np.array([judge.judge(cache.clip(example)).logit for example in examples[:3]])
    expected = scores(success, logits, threshold=1.0 - THRESHOLD)
    assert held["accuracy"] == expected["accuracy"] and held["loss"] == pytest.approx(expected["loss"])
    assert held["uncalibrated"]["loss"] == pytest.approx(scores(success, TEMPERATURE * logits)["loss"])
    assert [row["name"] for row in told["baselines"]] == [
        "majority", "regression on change", "regression on displacement", "perfect sight",
    ]  # fmt: skip
    assert [row["condition"] for row in told["robustness"]] == [texture.name, jpeg.name]
    assert all(row["tests"] == 2 and row["refused"] == 0 for row in told["robustness"])
    assert (
        told["early"][-1]["accuracy"] == pytest.approx(held["accuracy"]) and told["early"][-1]["final"] == 1.0
    )
    page, card = first["evaluation.html"].decode(), first["model_card.md"].decode()
    assert page.count("<svg") == 7 and "success (pass)" in page and "regression on displacement" in page
    assert "classifier's guess" in card and "schemes never seen" in card
    # Everything that takes long is kept: no bag is opened a second time.
    for bag in own.glob("tests/*/bag"):
        shutil.rmtree(bag)
    assert evaluated() == first


def test_a_campaign_that_is_not_the_models_is_refused(
    campaign: Path, examples: list[Example], models: dict[str, Path], tmp_path: Path
) -> None:
    split = parted(examples, "scheme")
    with pytest.raises(RefusedInput, match="test 999: was the model's"):
        split_of({"split": {**split, "test": [999]}}, examples)
    for wrong in (
        {},
        {"split": {"kind": "other"}},
        {"split": {**split, "train": 3}},
        {"split": {**split, "test": []}},
    ):
        with pytest.raises(RefusedInput, match=r"^model\.split"):
            split_of(wrong, examples)
    with pytest.raises(RefusedInput, match="beside one by scheme"):
        evaluate(models["random"], campaign, tmp_path / "out", random_split=models["scheme"])
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(("mode", "channels"), [("motion", 9), ("change", 3), ("rgb", 3)])
def test_a_running_judge_ends_with_the_answer_of_the_whole_clip(mode: str, channels: int) -> None:
    config = small(mode=mode, channels=channels)
    judge = Judge(untrained(config), temperature=2.0)
    pictures = sled_clip(count=9).pictures
    running, answers = RunningJudge(judge), []
    for picture in pictures:
        running.take(picture)
        if running.pictures > 1:
            answers.append(running.answer())
    whole = judge.judge(prepared_clip(pictures, config))
    assert answers[-1].logit == pytest.approx(whole.logit, abs=1e-5)
    np.testing.assert_allclose(answers[-1].attention, whole.attention, atol=1e-6)
    assert [len(answer.clip.change) for answer in answers] == list(range(2, 10))
    with pytest.raises(RefusedInput, match="at least 2"):
        RunningJudge(judge).answer()


def test_a_prediction_says_from_when_on_it_was_sure(examples: list[Example]) -> None:
    for bias, verdict in ((20.0, "fail"), (-20.0, "pass")):
        found = predict_bag(examples[0].bag, Judge(untrained(small(), bias=bias)))
        assert found.verdict == verdict and found.pictures == 8
        # Sure since the first answer, which the second picture makes possible.
        assert found.sure_from_s == found.settled_from_s == found.running[0][0] > 0.0
        assert found.success_probability == found.running[-1][1]
        assert sum(frame.attention for frame in found.frames) <= 1.0 + 1e-6
        assert "guess" in found.entry()["told"]
    unsure = predict_bag(examples[0].bag, Judge(untrained(small())))
    assert 1.0 - SURE < unsure.success_probability < SURE and unsure.sure_from_s is None


def test_conditions_lie_outside_what_the_paper_campaign_draws() -> None:
    vary = read_campaign(CAMPAIGNS.find("paper")).vary
    drawn = [
        (name, float(value), index)
        for condition in CONDITIONS[:2]
        for number in range(50)
        for name, values in condition.overrides(np.random.default_rng(number)).items()
        for index, value in enumerate(values if isinstance(values, list) else [values])
    ]
    assert drawn
    for name, value, index in drawn:
        if name in ("camera.distance_m", "camera.light.elevation_deg", "camera.light.share", "camera.zoom"):
            low, high = vary[name].low, vary[name].high
            assert not low < value < high, (name, value)
        if name == "camera.position_offset_m" and index != 1:
            low, high = vary[name].low[index], vary[name].high[index]
            assert not low < value < high, (name, value)


def test_groups_count_what_is_in_them(examples: list[Example]) -> None:
    label = replace(
        examples[0].label,
        worst_mm={"elastic": 108.0, "permanent": 10.0},
        margin_mm={"elastic": -8.0, "permanent": 90.0},
    )
    assert margin_share(label) == pytest.approx(-0.08)
    failed = replace(examples[0], success=False, label=replace(label, first_rule="elastic"))
    near = replace(label, worst_mm={"elastic": 97.0}, margin_mm={"elastic": 3.0}, first_rule=None)
    passed = replace(examples[0], success=True, label=near)
    tests, called = [failed, failed, passed], np.array([True, False, True])
    none, elastic = by_first_rule(tests, called)
    assert (none.name, none.called_pass, none.called_fail, none.right) == ("none", 1, 0, 1.0)
    assert (elastic.name, elastic.called_pass, elastic.called_fail, elastic.right) == ("elastic", 1, 1, 0.5)
    assert [(row.name, row.right) for row in by_margin(tests, called)] == [("0–5 %", 1.0), ("5–10 %", 0.5)]


def test_early_answers_and_looks_are_means_over_tests() -> None:
    success = np.array([True, False])
    logits = np.tile(np.linspace(-1.0, 1.0, 10), (2, 1)) * np.array([[1.0], [-1.0]])
    rows = early(success, logits, edge=0.0)
    assert [row.accuracy for row in rows] == 5 * [0.0] + 5 * [1.0]
    assert [row.final for row in rows] == 5 * [0.0] + 5 * [1.0]
    clip = PreparedClip(
        np.zeros((3, 4, 4, 1), np.uint8), np.array([0, 5, 10]), 1, np.linspace(0, 1, 11), True, ""
    )
    told = looks(success, [np.array([0.2, 0.6, 0.2])] * 2, [clip, clip])
    assert told.on_critical == 0.6 and told.even == pytest.approx(1 / 3)
    np.testing.assert_allclose(told.attention.sum(axis=1), 1.0)
    assert told.attention[0].argmax() in (19, 20) and told.change[0].argmax() == 39


def test_regression_has_the_closed_form_of_one_binary_feature() -> None:
    # 30 of 40 pass with the feature, 10 of 60 without it.
    given = np.repeat([1.0, 1.0, 0.0, 0.0], [30, 10, 10, 50])[:, None]
    success = np.repeat([True, False, True, False], [30, 10, 10, 50])
    fit = fitted_logistic(given, success, penalty=0.0)
    expected = logit(np.array([0.75, 1 / 6]))
    np.testing.assert_allclose(fit.logits(np.array([[1.0], [0.0]])), expected, atol=1e-3)
    held = fitted_logistic(given, success, penalty=1.0e6)
    np.testing.assert_allclose(held.logits(np.array([[1.0], [0.0]])), logit(np.array(0.4)), atol=1e-3)
    assert prior_logit(np.array([True, False])) == 0.0


def test_what_cannot_be_measured_is_told_and_not_measured_again(
    examples: list[Example], tmp_path: Path
) -> None:
    rows = Rows(tmp_path / "rows.jsonl")
    found, refused = measured_features(examples[:2], rows)
    assert found.shape == (2, len(FEATURES))
    for values, reason in zip(found, refused, strict=True):
        assert np.isfinite(values).all() if reason is None else np.isnan(values).all()
    lost = [replace(example, bag=tmp_path / "gone") for example in examples[:2]]
    again, reasons = measured_features(lost, Rows(tmp_path / "rows.jsonl"))
    np.testing.assert_array_equal(again, found)
    assert reasons == refused
    # Enlarged pictures: the middle of pixel x lies in the middle of its k pixels.
    matrix = np.array([[600.0, 0.0, 239.5], [0.0, 600.0, 134.5], [0.0, 0.0, 1.0]])
    larger = _enlarged(matrix, 4)
    ray = np.array([0.1, -0.05, 1.0])
    np.testing.assert_allclose((larger @ ray)[:2], 4.0 * ((matrix @ ray)[:2] + 0.5) - 0.5)


def test_the_network_without_time_has_as_many_weights_and_goes_on_where_it_ended(
    examples: list[Example], tmp_path: Path
) -> None:
    for config in (small(), preset("compact")):
        assert parameter_count(MeanPooling(config)) == pytest.approx(
            parameter_count(VideoClassifier(config)), rel=0.01
        )
    cache, kept = ClipCache(tmp_path / "clips", small()), tmp_path / "kept.pt"
    parts = examples[2:], examples[:2], examples[:2]
    once = pooled_logits(parts, small(), TrainingConfig(epochs=2, batch=2), cache, tmp_path / "once.pt")

    class Ended(Exception):
        pass

    def end(_done: int, _total: int) -> None:
        raise Ended

    with pytest.raises(Ended):
        pooled_logits(parts, small(), TrainingConfig(epochs=2, batch=2), cache, kept, on_epoch=end)
    again = pooled_logits(parts, small(), TrainingConfig(epochs=2, batch=2), cache, kept)
    np.testing.assert_array_equal(again, once)


def test_order_does_not_matter_to_the_network_without_time() -> None:
    model = MeanPooling(small()).eval()
    frames = torch.randn(1, 5, small().channels, 32, 32)
    with torch.inference_mode():
        ahead, back = (model(given, torch.tensor([5])) for given in (frames, frames.flip(1)))
        padded = model(torch.cat((frames, torch.randn_like(frames[:, :2])), dim=1), torch.tensor([5]))
    assert float(back) == pytest.approx(float(ahead), abs=1e-5)
    assert float(padded) == pytest.approx(float(ahead), abs=1e-5)


def test_change_features_grow_with_the_change() -> None:
    clip = PreparedClip(
        np.zeros((2, 4, 4, 1), np.uint8), np.arange(2), 1, np.array([0.0, 3.0, 1.0]), True, ""
    )
    np.testing.assert_allclose(change_features(clip), [*np.log([3.1, 1.1, 0.1, 3.1, 1.1]), 1.0])


def test_a_row_that_was_cut_short_is_computed_anew(tmp_path: Path) -> None:
    path = tmp_path / "rows" / "rows.jsonl"
    for key in ("a", "b"):
        Rows(path).add(key, {"value": key})
    path.write_bytes(path.read_bytes()[:-4])
    rows = Rows(path)
    assert rows["a"] == {"value": "a"} and "b" not in rows
    rows.add("b", {"value": "c"})
    assert Rows(path)["b"] == {"value": "c"} and Rows(path)["a"] == {"value": "a"}
