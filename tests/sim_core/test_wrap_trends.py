"""What practice knows about wrapped loads, reproduced: pull with turns, interlayers, interlocking, kraft and LLDPE."""

from functools import cache

import numpy as np
import pytest

from config.scene import Scene
from recordings.recorded_sled import load_scene
from sim_core.judge import EumosJudge
from sim_core.load_test import LoadTest

UNTIL_S = 0.6
"""The plateau's end: displacement grows until then."""


def wrapped(name: str, turns: float, *, material: str = "stretch_film_20", level_g: float = 0.4) -> Scene:
    film = f'wrap={{"material": "{material}", "turns": {turns}}}'
    solver = f'solver={{"engine": "mujoco", "time_step_s": {1 / 240}}}'
    return load_scene(name, [film, solver, f"sled.level_g={level_g}", 'sled.direction="+y"'])


@cache
def moved_mm(name: str, turns: float) -> float:
    """Largest displacement of any corner until the plateau's end [mm]."""
    test = LoadTest(wrapped(name, turns))
    judge = EumosJudge(test.scene)
    for frame in test.frames():
        judge.add(frame)
        if test.time_s >= UNTIL_S:
            break
    test.close()
    return max(package.peak_mm for package in judge.packages())


def test_the_pull_on_a_load_grows_linearly_with_turns() -> None:
    pulls = []
    for turns in (2, 4, 8):
        test = LoadTest(wrapped("eur_columns", turns))
        next(test.frames())
        summary = test.film_summary
        assert summary is not None
        pulls.append(summary["start_force_npm"])
        test.close()
    per_turn = np.array(pulls) / [2.0, 4.0, 8.0]
    assert per_turn == pytest.approx(float(per_turn.mean()), rel=0.02)


def test_anti_slip_interlayers_save_a_fifth_of_the_film() -> None:
    # The same columns with sheets between the layers: with 2 layers of film less moves than without sheets in 2.5.
    assert moved_mm("eur_interlayers", 2.0) < moved_mm("eur_columns", 2.5)


def test_interlocked_layers_beat_columns() -> None:
    assert moved_mm("eur_interlocked", 2.0) < 0.5 * moved_mm("eur_columns", 2.5)


def test_kraft_tears_where_stretch_film_gives() -> None:
    # The same load at the same level: paper breaks at 4 %, stretch film stretches by more and stays whole.
    torn: dict[str, int] = {}
    for name in ("eur_wrap_kraft", "eur_wrap_lldpe"):
        test = LoadTest(load_scene(name, [f'solver={{"engine": "mujoco", "time_step_s": {1 / 240}}}']))
        judge = EumosJudge(test.scene)
        for frame in test.frames():
            judge.add(frame)
            if test.film_frame is not None:
                judge.add_film(test.film_frame)
            if test.time_s >= 0.5:
                break
        summary = test.film_summary
        assert summary is not None
        torn[name] = summary["torn"]
        damage = next(rule for rule in judge.rules() if rule.rule == "damage")
        if name == "eur_wrap_kraft":
            assert (damage.state, damage.package) == ("fail", "film")
            # At the deck, where the load slides on the pallet.
            assert summary["first_tear_position_m"][2] == pytest.approx(0.15, abs=0.03)
        else:
            assert damage.state == "pass" and summary["peak_strain"] > 0.05
        test.close()
    assert torn["eur_wrap_kraft"] > 0 and torn["eur_wrap_lldpe"] == 0


def test_what_collapses_unwrapped_stands_in_stretch_film() -> None:
    peaks = {}
    for name in ("eur_unwrapped", "eur_wrap_lldpe"):
        test = LoadTest(load_scene(name, [f'solver={{"engine": "mujoco", "time_step_s": {1 / 240}}}']))
        judge = EumosJudge(test.scene)
        for frame in test.frames():
            judge.add(frame)
            if test.time_s >= 0.8:
                break
        test.close()
        peaks[name] = {rule.rule: rule for rule in judge.rules()}["elastic"]
    assert peaks["eur_unwrapped"].state == "fail"
    assert peaks["eur_wrap_lldpe"].state == "pass"
    assert peaks["eur_wrap_lldpe"].worst_mm == pytest.approx(29.0, abs=2.0)
