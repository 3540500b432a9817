"""Displacement measured from drawn pictures against the poses that they were drawn from; and what is said about it."""

import numpy as np
import pytest

from config.errors import RefusedInput
from config.scene import Scene
from sim_core.camera.renderer import BenchRenderer
from sim_core.camera.shot import Shot
from sim_core.camera.view import view_of
from sim_core.vision.annotate import RED, annotated
from sim_core.vision.measure import DisplacementMeasurer
from sim_core.vision.trial import Trial, picture_trial
from sim_core.vision.verdict import judged
from tests.sim_core.vision_scenes import stack_scene


@pytest.fixture(scope="module")
def plain() -> Trial:
    return picture_trial(stack_scene())


@pytest.fixture(scope="module")
def marked() -> Trial:
    return picture_trial(stack_scene(markers={"size_m": 0.1}))


def test_without_markers_the_error_is_below_3_mm_and_covered(plain):
    assert np.abs(plain.truth).max() > 0.02
    assert plain.tracked_share > 0.9
    assert plain.rms_mm < 3.0
    assert plain.coverage > 0.9


def test_with_markers_the_error_is_below_one_and_a_half_mm_and_covered(marked):
    assert marked.tracked_share > 0.95
    assert marked.rms_mm < 1.5
    assert marked.coverage > 0.9


def test_the_rules_are_the_judges_within_the_uncertainty(plain, marked):
    for trial in (plain, marked):
        assert [rule.rule for rule in trial.measured.rules] == [rule.rule for rule in trial.judged]
        for seen, true in zip(trial.measured.rules, trial.judged, strict=True):
            assert seen.limit_mm == pytest.approx(true.limit_mm, rel=0.01)
            assert seen.worst_mm == pytest.approx(true.worst_mm, abs=seen.error_mm)
            assert seen.state in (true.state, "unresolved")


def scene_and_shots() -> tuple[Scene, list[Shot]]:
    """A load that stands for three pictures, then slides together with its sled's travel: straight lines, no physics."""
    scene = stack_scene(markers={"size_m": 0.1})
    start = np.array([[0.0, 0.0, 0.072], *(package.position_m for package in scene.packages)])
    still = np.tile([0.0, 0.0, 0.0, 1.0], (len(start), 1))
    shots = []
    for index in range(9):
        step = max(0, index - 2)
        positions = start.copy()
        positions[3] += step * np.array([-0.012, 0.0, 0.0])
        shots.append(
            Shot(index, 33_333_333 * index, np.array([0.03 * step, 0.0, 0.0]), np.zeros(3), positions, still,
                 positions, still, 0.0)
        )  # fmt: skip
    return scene, shots


@pytest.fixture(scope="module")
def slide() -> tuple[Scene, list[Shot], list[np.ndarray]]:
    scene, shots = scene_and_shots()
    renderer = BenchRenderer(scene)
    pictures = [renderer.picture(shot) for shot in shots]
    renderer.close()
    return scene, shots, pictures


def measurer_of(scene: Scene) -> DisplacementMeasurer:
    view = view_of(scene)
    return DisplacementMeasurer(scene, view.matrix, view.distortion, view.width, view.height)


def test_one_sliding_package_among_standing_ones(slide):
    scene, shots, pictures = slide
    measurer = measurer_of(scene)
    for shot, picture in zip(shots, pictures, strict=True):
        measured = measurer.take(shot.stamp_ns, picture)
    assert set(measured.states) == {"tracked"}
    assert measured.sled_m == pytest.approx(0.18, abs=1e-3)
    expected = np.zeros((6, 5, 2))
    expected[measured.rows.tolist().index(3), :, 0] = -0.072
    assert np.abs(measured.displacement - expected).max() < 1.5e-3
    result = measurer.result()
    # Resting at the end is what it is not: the newest picture counts, and the peak is there.
    assert result.rules[2].worst_mm == pytest.approx(72.0, abs=1.0)
    assert result.rules[2].package == "a2"
    assert result.picture_count == len(shots)


def test_a_covered_package_is_not_made_up(slide):
    scene, shots, pictures = slide
    measurer = measurer_of(scene)
    view = view_of(scene)
    for shot, picture in zip(shots, pictures, strict=True):
        seen = picture
        if shot.index >= 5:
            corners = view.project(measurer.faces[0].corners + shot.sled)
            low, high = corners.min(axis=0).astype(int) - 3, corners.max(axis=0).astype(int) + 3
            seen = picture.copy()
            seen[low[1] : high[1], low[0] : high[0]] = (90, 110, 90)
        measured = measurer.take(shot.stamp_ns, seen)
    assert measured.states[0] != "tracked"
    assert np.isnan(measured.displacement[0]).all()
    assert measured.states[1:] == ("tracked",) * 5
    result = measurer.result()
    assert any("package a0" in words for words in result.unseen)
    # What is not seen at the end may be anywhere: no pass.
    assert result.rules[0].state != "pass"


def test_pictures_that_do_not_fit_are_refused(slide):
    scene, _, pictures = slide
    measurer = measurer_of(scene)
    with pytest.raises(RefusedInput, match="540 by 960"):
        measurer.take(0, pictures[0][:100])
    with pytest.raises(RefusedInput, match="at least 5"):
        measurer.take(0, np.zeros_like(pictures[0]))
    with pytest.raises(RefusedInput, match="at least one"):
        measurer.result()
    measurer.take(5, pictures[0])
    with pytest.raises(RefusedInput, match="later than 5"):
        measurer.take(5, pictures[1])
    without = scene.model_copy(update={"camera": None})
    view = view_of(scene)
    with pytest.raises(RefusedInput, match="camera"):
        DisplacementMeasurer(without, view.matrix, view.distortion, view.width, view.height)


def test_the_drawing_shows_where_the_package_went(slide):
    scene, shots, pictures = slide
    measurer = measurer_of(scene)
    for shot, picture in zip(shots, pictures, strict=True):
        measured = measurer.take(shot.stamp_ns, picture)
    before = pictures[-1].copy()
    drawn = annotated(pictures[-1], measurer, measured)
    assert np.array_equal(before, pictures[-1])
    assert drawn.shape == before.shape
    face = next(face for face in measurer.faces if face.row == 3)
    middle = face.corners[3] - np.array([0.036, 0.0, 0.0]) + shots[-1].sled
    x, y = np.round(view_of(scene).project(middle[None])[0]).astype(int)
    assert np.abs(drawn[y - 1 : y + 2, x].astype(int) - RED).sum(axis=1).min() < 90
    longer = annotated(pictures[-1], measurer, measured, exaggeration=2.0)
    twice = face.corners[3] - np.array([0.108, 0.0, 0.0]) + shots[-1].sled
    x, y = np.round(view_of(scene).project(twice[None])[0]).astype(int)
    assert np.abs(longer[y - 1 : y + 2, x].astype(int) - RED).sum(axis=1).min() < 90


def test_a_limit_inside_the_uncertainty_or_what_is_not_seen_is_unresolved(slide):
    scene, shots, pictures = slide
    measurer = measurer_of(scene)
    for shot, picture in zip(shots, pictures, strict=True):
        measurer.take(shot.stamp_ns, picture)
    displacement, sigma = measurer.displacements()
    height = 1.0e-3 * measurer.result().rules[2].limit_mm / scene.limits.elastic_fraction
    states = []
    for limit_m in (0.060, 0.0718, 0.090, 0.110):
        limits = scene.limits.model_copy(update={"elastic_fraction": limit_m / height})
        changed = scene.model_copy(update={"limits": limits})
        states.append(
            judged(changed, measurer.faces, measurer.measurements, displacement, sigma).rules[2].state
        )
    assert states == ["fail", "unresolved", "unresolved", "pass"]
