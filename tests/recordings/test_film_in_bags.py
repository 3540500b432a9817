"""A wrapped load's bag: it holds the film, and judged again it gives the judgement of the test, torn film and all."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from config.errors import BrokenRecording
from config.scene import Scene
from config.scene_file import validate_scene
from msgs_adapters.cdr import serialize
from msgs_adapters.convert import to_string
from msgs_adapters.film_payloads import film_frame_from_payload
from msgs_adapters.publications import film_publication, frame_publication
from msgs_adapters.topics import SCENE, WRAP_MESH, WRAP_STRAIN
from recordings.bag_reader import BagReader
from recordings.bag_writer import BagWriter
from recordings.graph_recorder import GraphRecorder, regular_rates_hz
from recordings.judge_bag import judge_bag
from recordings.test_bag import TestBag, recorded_topics
from sim_core.accuracy.cases import cartons_scene
from sim_core.frames import FilmFrame, PoseFrame
from sim_core.judge import EumosJudge
from sim_core.report import judgement, report_json
from sim_core.run import run_test
from tests.recordings.conftest import film_frame
from tests.torn_scene import TORN

EPOCH_NS = 10**12
STRAIN, POSES = "/twin/wrap/strain", "/twin/packages/poses"


def column(layers: int, *, wrapped: bool = True) -> Scene:
    """A column of cartons on the bare sled, in one turn of paper that it tears at 0.8 g."""
    raw: dict[str, Any] = {
        **cartons_scene(layers, level_g=0.8, columns=(1, 1)),
        "solver": {"engine": "mujoco"},
    }
    raw["sled"]["plateau_s"] = 0.3
    return validate_scene(
        {**raw, "wrap": {"material": "kraft_80", "turns": 1, "spacing_m": 0.2}} if wrapped else raw
    )


def standing(index: int, scene: Scene) -> PoseFrame:
    """The column as it stands, pallet row first."""
    rows = np.array([(0.0, 0.0, 0.0), *(package.position_m for package in scene.packages)])
    orientations = np.tile([0.0, 0.0, 0.0, 1.0], (len(rows), 1))
    return PoseFrame(index, EPOCH_NS + index * 10**9 // 240, rows, orientations)


def film_at(index: int, *, torn_s: float = -1.0) -> FilmFrame:
    return replace(film_frame(index, torn_s=torn_s), stamp_ns=EPOCH_NS + index * 10**9 // 240)


def judged(scene: Scene, judge: EumosJudge) -> str:
    return report_json(judgement(scene, judge), compact=True)


def test_a_torn_load_is_judged_again_with_the_same_words(tmp_path: Path) -> None:
    scene = validate_scene(TORN)
    with TestBag(tmp_path / "bag", scene) as recording:
        result = run_test(scene, observers=[recording])
        recording.finish(judged(scene, result.judge))
    assert result.physics.film is not None and result.physics.film["torn"]
    again, judge = judge_bag(tmp_path / "bag")
    assert judged(again, judge) == judged(scene, result.judge)
    assert judge.film is not None and result.judge.film is not None
    assert judge.film.index == result.judge.film.index
    every = scene.sampling.frames_a_film_frame
    with BagReader(tmp_path / "bag") as bag:
        assert set(bag.topics) == {topic.absolute_name() for topic in recorded_topics(scene)} | {"/tf"}
        assert WRAP_MESH.absolute_name() not in bag.topics
        order = [message.topic_name for message in bag.messages([POSES, STRAIN])]
        assert order == [
            topic for i in range(judge.frame_count) for topic in (POSES, STRAIN)[: 1 + (i % every == 0)]
        ]
        films = [film_frame_from_payload(message.payload, 0) for message in bag.messages([STRAIN])]
        assert films[0].torn_s.max() == -1.0 and films[-1].torn_s.max() > 0.2


def test_film_that_tears_is_damage_though_nothing_moved(tmp_path: Path) -> None:
    scene = column(1)
    with TestBag(tmp_path / "bag", scene) as recording:
        for index in range(9):
            recording.on_frame(standing(index, scene))
            if index % 8 == 0:
                recording.on_film(film_at(index, torn_s=0.025 if index else -1.0))
    _, judge = judge_bag(tmp_path / "bag")
    (failing,) = [rule for rule in judge.rules() if rule.state == "fail"]
    assert (failing.rule, failing.package) == ("damage", "film")
    assert failing.time_s == pytest.approx(0.025)


def test_a_bag_without_the_topic_is_judged_by_its_poses(tmp_path: Path) -> None:
    bare = column(1, wrapped=False)
    assert WRAP_STRAIN not in recorded_topics(bare)
    assert WRAP_STRAIN in recorded_topics(column(1))
    with TestBag(tmp_path / "bag", bare) as recording:
        recording.on_frame(standing(0, bare))
    assert judge_bag(tmp_path / "bag")[1].film is None


def test_a_film_message_that_makes_no_sense_is_one_line(tmp_path: Path) -> None:
    scene = column(1)
    with BagWriter(tmp_path / "bag") as writer:
        names = {topic: writer.add_topic(topic) for topic in recorded_topics(scene)}
        pose, film = frame_publication(standing(0, scene)), film_publication(film_at(0))
        writer.write(names[pose.topic], pose.payload, log_time_ns=EPOCH_NS)
        writer.write(names[film.topic], film.payload[:-20], log_time_ns=EPOCH_NS)
        writer.attach("scene.json", "application/json", scene.to_json().encode())
    with pytest.raises(BrokenRecording, match="wrap/strain"):
        judge_bag(tmp_path / "bag")


def test_the_graphs_recorder_takes_film_before_poses_and_counts_what_is_missing(tmp_path: Path) -> None:
    scene = column(1)
    recorder = GraphRecorder(tmp_path / "bag", recorded_topics(scene))
    recorder.take(SCENE, serialize(to_string(scene.to_json())))
    for index in range(25):
        # The film of frame 16 is lost.
        if index in (0, 8, 24):
            recorder.take(WRAP_STRAIN, film_publication(film_at(index, torn_s=index / 240.0)).payload)
        recorder.take(*frame_publication(standing(index, scene))[::2])
    recorder.close()
    assert regular_rates_hz(scene)[WRAP_STRAIN] == 30.0
    assert recorder.gaps == {"wrap/strain": 1}
    judge = judge_bag(tmp_path / "bag")[1]
    assert judge.frame_count == 25
    assert judge.film is not None and judge.film.torn_s[1] == np.float32(0.1)
