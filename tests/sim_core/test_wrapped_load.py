"""A film in the test loop: it holds a load that falls without it, the same way every time, until it tears."""

from typing import Any

import numpy as np
import pytest

from config.scene_file import validate_scene
from sim_core.accuracy.cases import cartons_scene
from sim_core.judge import EumosJudge
from sim_core.load_test import LoadTest
from sim_core.sled import sled_samples
from sim_core.stress import all_rows

FILM = {"material": "stretch_film_20", "turns": 6}


def run(level_g: float, wrap: dict[str, Any] | None) -> tuple[LoadTest, EumosJudge]:
    raw = {**cartons_scene(4, level_g=level_g), "solver": {"engine": "mujoco"}}
    raw["sled"]["plateau_s"] = 0.3
    scene = validate_scene(raw if wrap is None else {**raw, "wrap": wrap})
    test, judge = LoadTest(scene), EumosJudge(scene)
    try:
        for sample in sled_samples(scene):
            frame = test.take(sample)
            if frame is not None:
                judge.add(frame)
            if test.finished or test.time_s > 1.0:
                break
    finally:
        test.close()
    return test, judge


@pytest.fixture(scope="module")
def wrapped() -> tuple[LoadTest, EumosJudge]:
    return run(0.4, FILM)


def worst_mm(judge: EumosJudge) -> float:
    return max(package.peak_mm for package in judge.packages())


def test_film_holds_what_falls_without_it(wrapped: tuple[LoadTest, EumosJudge]) -> None:
    # Columns of 0.3 m depth and 1 m height tip at 0.3 g; friction 0.5 lets nothing slide at 0.4 g.
    assert worst_mm(run(0.4, None)[1]) > 100.0
    assert worst_mm(wrapped[1]) < 5.0
    assert wrapped[0].halvings == []


def test_the_same_scene_gives_the_same_bytes(wrapped: tuple[LoadTest, EumosJudge]) -> None:
    again = run(0.4, FILM)[1]
    assert again.packages() == wrapped[1].packages()


def test_the_summary_tells_pull_and_strain(wrapped: tuple[LoadTest, EumosJudge]) -> None:
    summary = wrapped[0].film_summary
    film = wrapped[0].scene.film
    assert summary is not None and film is not None
    # Six layers pull with what one layer has left; its strain is that over E·t.
    assert summary["start_force_npm"] == pytest.approx(6.0 * film.tension_npm, rel=0.1)
    assert summary["peak_strain"] >= film.strain * 0.95
    assert summary["torn"] == 0
    assert wrapped[0].extremes.energy_residual < 0.01


def test_no_film_is_no_film(wrapped: tuple[LoadTest, EumosJudge]) -> None:
    unwound = run(0.2, {**FILM, "turns": 0})
    bare = run(0.2, None)
    assert unwound[0].film_summary is None
    assert unwound[1].packages() == bare[1].packages()


def test_a_fully_torn_film_is_no_film() -> None:
    # One column: a film presses several together, and that outlasts it.
    raw = {**cartons_scene(4, level_g=0.4, columns=(1, 1)), "solver": {"engine": "mujoco"}}
    bare, torn = LoadTest(validate_scene(raw)), LoadTest(validate_scene({**raw, "wrap": FILM}))
    judge, peaks = EumosJudge(torn.scene), []
    for test in (bare, torn):
        for sample in sled_samples(test.scene):
            frame = test.take(sample)
            if frame is None:
                continue
            if test is torn:
                judge.add(frame)
                if test.film_frame is not None:
                    judge.add_film(test.film_frame)
            if frame.index == 0:
                start = frame.positions
                if test._film is not None:
                    # It is stretched by 6.7 %: what would break at 1 % does, everywhere.
                    test._film._break_strain[:] = 0.01
            if test.time_s > 0.5:
                break
        peaks.append(np.abs(frame.positions - start).max())
        test.close()
    summary = torn.film_summary
    assert summary is not None
    assert summary["torn"] == summary["elements"]
    assert summary["first_tear_time_s"] == pytest.approx(1.0 / 240.0)
    assert summary["lost_j"] > 5.0
    assert peaks[1] == pytest.approx(peaks[0], rel=0.02)
    damage = next(rule for rule in judge.rules() if rule.rule == "damage")
    assert damage.state == "fail"
    assert torn.extremes.energy_residual < 0.01


def test_pulls_sum_to_nothing(wrapped: tuple[LoadTest, EumosJudge]) -> None:
    film = wrapped[0]._film
    assert film is not None
    forces, torques = film._forces, film._torques
    places = film._last_positions
    moment = (torques + np.cross(places, forces)).sum(axis=0)
    assert np.abs(forces.sum(axis=0)).max() < 1.0e-9 * np.abs(forces).max()
    assert np.abs(moment).max() < 1.0e-6 * np.abs(forces).max()


@pytest.mark.parametrize("poses_hz", [30, 480])
def test_how_often_poses_are_published_changes_nothing(poses_hz: int) -> None:
    # The film of this band is drawn further, so when it flows decides the path.
    row = next(row for row in all_rows() if row.id == "film_flows")
    (usual,) = row.scenes("mujoco")
    sampling = usual.sampling.model_copy(update={"poses_hz": poses_hz})
    ends = []
    for scene in (usual, usual.model_copy(update={"sampling": sampling})):
        test = LoadTest(scene)
        frames = {round(frame.stamp_ns / 1.0e6): frame.positions[1:, 0] for frame in test.frames()}
        test.close()
        ends.append(frames)
    shared = sorted(set(ends[0]) & set(ends[1]))
    ways = np.array([ends[0][at] for at in shared])
    apart = np.abs(ways - [ends[1][at] for at in shared]).max(axis=1)
    opening = np.abs(ways - ways[0]).max(axis=1)
    widest = int(opening.argmax())
    # Where the boxes meet again, looks for blows split steps, and these looks begin anew with every frame.
    assert opening[widest] > 0.4
    # As near as a step of 0.3/ω keeps the peak of a spring.
    assert apart[: widest + 1].max() < 0.01 * opening[widest]
