"""Perfect sight is the judge's truth of what faces the camera, and nothing of what goes away from it or stands behind."""

import numpy as np
import pytest

from classifier.examples import read_examples
from classifier.perfect_sight import FEATURES, sight_of_bag, sighted_features
from classifier.rows import Rows
from config.errors import RefusedInput
from msgs_adapters.publications import frame_publication, jpeg_publication
from recordings.bag_writer import BagWriter
from recordings.judge_bag import judge_bag
from recordings.test_bag import attach_scene
from sim_core.camera.jpeg import jpeg_of
from sim_core.camera.layout import side_of
from sim_core.frames import PoseFrame
from tests.classifier.drawn_campaign import PICTURES, SCENE, SLID_MM, START_NS, drawn_campaign, write_bag

PERMANENT_MM, ELASTIC_MM = 50.0, 100.0


def _bag(folder, way, *, pictures=True, toppled=False):
    """The upper box goes the way and half of it back, [m]; a picture at each of three moments."""
    turn = [np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)] if toppled else [0.0, 0.0, 0.0, 1.0]
    with BagWriter(folder) as writer:
        for index, share in enumerate((0.0, 1.0, 0.5)):
            positions = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.25], [0.0, 0.0, 0.75]])
            positions[2] += share * np.asarray(way)
            turns = np.tile([0.0, 0.0, 0.0, 1.0], (3, 1))
            turns[2] = turn if index == 2 else turns[2]
            stamp_ns = START_NS + 40_000_000 * index
            said = [frame_publication(PoseFrame(index, stamp_ns, positions, turns))]
            if pictures:
                said.append(jpeg_publication(stamp_ns, jpeg_of(np.zeros((48, 64, 3), np.uint8))))
            for publication in said:
                name = writer.add_topic(publication.topic)
                writer.write(name, publication.payload, log_time_ns=stamp_ns)
        attach_scene(writer, SCENE)
    return folder


def test_what_moves_along_the_picture_is_seen_as_the_judge_sees_it(tmp_path):
    side = side_of(SCENE)
    bag = _bag(tmp_path / "along", 0.08 * side.right)
    _, judge = judge_bag(bag)
    assert judge.peak_mm == pytest.approx(80.0)
    # 80 of 100 mm at the peak, 40 of 50 mm at the end.
    assert sight_of_bag(bag) == pytest.approx([np.log(0.8), 0.0], abs=1.0e-6)
    assert len(FEATURES) == 2


def test_what_moves_towards_the_camera_is_not_seen(tmp_path):
    side = side_of(SCENE)
    assert sight_of_bag(_bag(tmp_path / "towards", 0.4 * side.normal)) == [pytest.approx(np.log(0.01)), 0.0]
    both = _bag(tmp_path / "both", 0.4 * side.normal + 0.2 * side.right)
    assert sight_of_bag(both) == pytest.approx([np.log(200.0 / ELASTIC_MM), 0.0], abs=1.0e-6)


def test_what_topples_in_sight_is_seen(tmp_path):
    assert sight_of_bag(_bag(tmp_path / "toppled", (0.0, 0.0, 0.0), toppled=True))[1] == 1.0


def test_a_campaigns_tests_are_read_once_and_what_cannot_be_is_nothing(tmp_path):
    examples = read_examples(drawn_campaign(tmp_path / "campaign", tests=4))
    rows, told = Rows(tmp_path / "rows.jsonl"), []
    found = sighted_features(examples, rows, on_row=lambda: told.append(1))
    slid_mm = SLID_MM * PICTURES
    expected = [
        max(np.log(0.01), np.log(slid_mm / PERMANENT_MM) if not one.success else np.log(0.01))
        for one in examples
    ]
    assert len(told) == 4 and found[:, 1].tolist() == [0.0] * 4
    for value, wanted in zip(found[:, 0], expected, strict=True):
        # Clips have one picture more or less.
        assert value == pytest.approx(wanted, abs=np.log(PICTURES / (PICTURES - 1)) + 1.0e-6)
    again = sighted_features(examples, Rows(tmp_path / "rows.jsonl"))
    assert np.array_equal(again, found)
    bare = read_examples(drawn_campaign(tmp_path / "bare", tests=2, posed=False))
    assert np.isnan(sighted_features(bare, rows)).all()


def test_a_bag_without_pictures_is_refused_in_one_line(tmp_path):
    with pytest.raises(RefusedInput, match="must hold pictures") as refused:
        sight_of_bag(_bag(tmp_path / "bag", (0.0, 0.0, 0.0), pictures=False))
    assert "\n" not in str(refused.value)
    write_bag(tmp_path / "posed", [np.zeros((48, 64, 3), np.uint8)] * 2, slid_mm=0.0)
    assert sight_of_bag(tmp_path / "posed")[0] == pytest.approx(np.log(0.01))
