"""The classifier's node on real topics: its last answer is that of the recording, in time, and of pictures alone."""

import json
import time
from pathlib import Path

import pytest
import torch
from rclpy.lifecycle import TransitionCallbackReturn

from classifier.checkpoint import save_model
from classifier.configuration import preset
from classifier.network import VideoClassifier
from classifier.prediction import predict_bag
from classifier.running import read_judge
from msgs_adapters.cdr import serialize
from msgs_adapters.convert import Progress, to_progress
from msgs_adapters.publications import jpeg_publication
from msgs_adapters.topics import (
    CAMERA_COMPRESSED,
    CAMERA_PROGRESS,
    CLASSIFIER_PROBABILITY,
    CLASSIFIER_REPORT,
)
from ros_nodes.classifier_node import ClassifierNode
from sim_core.camera.jpeg import jpeg_of
from tests.classifier.sled_clip import sled_clip
from tests.ros_nodes.graph import environment, pallet_twin, payloads
from tests.ros_nodes.test_bench_nodes import Graph

CAMERA = {"width_px": 160, "height_px": 90, "rate_hz": 15}
SHORT = {"profile": "eumos", "level_g": 0.3, "rise_s": 0.05, "plateau_s": 0.3, "deceleration_g": 0.8}


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An untrained one of the shipped size."""
    folder = tmp_path_factory.mktemp("model")
    torch.manual_seed(3)
    told = {"threshold": 0.4, "temperature": 1.5}
    save_model(folder, VideoClassifier(preset("compact")).eval(), told)
    return folder


def test_last_answer_comes_in_time_and_is_that_of_the_whole_clip(
    model: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    jpegs = [jpeg_of(picture) for picture in sled_clip(count=20).pictures]
    waits_s: list[float] = []
    # Other work on the machine may get in between; the bar is on what the answer takes.
    while len(waits_s) < 4 and min(waits_s, default=1.0) >= 0.1:
        graph = Graph(monkeypatch, ClassifierNode, parameters=[f"model:={model}"])
        try:
            waits_s.append(_played(graph, jpegs))
        finally:
            graph.close()
    assert min(waits_s) < 0.1


def _played(graph: Graph, jpegs: list[bytes]) -> float:
    """Sends pictures at 30 Hz; says how long after the last one all was answered and reported [s]."""
    for topic in (CAMERA_COMPRESSED, CAMERA_PROGRESS):
        graph.opens(topic)
    for topic in (CLASSIFIER_PROBABILITY, CLASSIFIER_REPORT):
        graph.hears(topic)
    assert graph.node.trigger_configure() == TransitionCallbackReturn.SUCCESS
    assert graph.node.trigger_activate() == TransitionCallbackReturn.SUCCESS
    graph.spin_until(graph.matched)
    heard, reports = (graph.heard[topic.name] for topic in (CLASSIFIER_PROBABILITY, CLASSIFIER_REPORT))
    began = time.monotonic()
    for number, jpeg in enumerate(jpegs):
        while time.monotonic() < began + number / 30.0:
            graph.executor.spin_once(timeout_sec=0.002)
        graph.says(CAMERA_COMPRESSED, jpeg_publication(1 + number, jpeg).payload)
    last = time.monotonic()
    progress = Progress(len(jpegs), len(jpegs), True)
    graph.says(CAMERA_PROGRESS, serialize(to_progress(progress)))
    graph.spin_until(lambda: reports)
    took = time.monotonic() - last
    told = json.loads(reports[0].data)
    graph.spin_until(lambda: len(heard) == told["answers"])
    assert told["pictures"] == len(jpegs) and 1 <= told["answers"] < len(jpegs)
    assert heard[-1].data == pytest.approx(1.0 - told["success_probability"], abs=1e-8)
    assert told["verdict"] == ("pass" if told["success_probability"] >= 0.6 else "fail")
    return took


@pytest.mark.parametrize(
    ("given", "words"), [("", "folder of a trained model"), ("nowhere", "model = nowhere")]
)
def test_a_model_that_is_not_there_is_refused(
    given: str, words: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    graph = Graph(monkeypatch, ClassifierNode, parameters=[f"model:={given!r}"])
    try:
        assert graph.node.trigger_configure() == TransitionCallbackReturn.FAILURE
        assert words in str(graph.node.error)
    finally:
        graph.close()


def test_up_has_the_pictures_guessed_and_predict_guesses_the_same(model: Path, tmp_path: Path) -> None:
    scene = {
        "name": "seen",
        "load": {"packages": [{"id": "a", "size_m": [0.4, 0.4, 0.4], "mass_kg": 10, "position_m": [0, 0, 0.2]}]},
        "pallet": None, "surfaces": {"pairs": [{"between": ["cardboard", "sled"], "friction": 0.5}]},
        "sled": SHORT, "camera": CAMERA,
    }  # fmt: skip
    (tmp_path / "scene.json").write_text(json.dumps(scene))
    done = pallet_twin(
        "up", "scene.json", "--classify", str(model), "--out", "up", "--no-estimate", "--no-page",
        cwd=tmp_path, env=environment(),
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    told = json.loads((tmp_path / "up" / "report.json").read_text())["classifier"]
    bag = tmp_path / "up" / "bag"
    assert len(payloads(bag, "/twin/classifier/failure_probability")) == told["answers"]
    assert len(payloads(bag, "/twin/classifier/report")) == 1
    found = predict_bag(bag, read_judge(model)[0])
    assert found.pictures == told["pictures"] == len(payloads(bag, "/twin/camera/image_raw/compressed"))
    assert found.success_probability == pytest.approx(told["success_probability"], abs=1e-5)
    assert found.verdict == told["verdict"] and "guess" in told["told"]


def test_classifying_needs_a_camera_and_a_model(model: Path, tmp_path: Path) -> None:
    for arguments, words in (
        (["up", "block_slip", "--classify", str(model)], "needs a camera"),
        (["up", "eur_camera", "--classify", "nowhere"], "--classify = nowhere: must be the folder"),
    ):
        done = pallet_twin(*arguments, cwd=tmp_path)
        assert done.returncode == 2 and words in done.stderr
        assert len(done.stderr.strip().splitlines()) == 1
    assert list(tmp_path.iterdir()) == []
