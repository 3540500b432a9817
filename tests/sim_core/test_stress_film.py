"""The film rows' own references: the hoop's spring, the film's toughness, and what the judgements see."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from config.errors import Interrupted
from config.scene import Scene
from sim_core.accuracy.closed_forms import trapezoid_travel_m
from sim_core.frames import GRAVITY
from sim_core.stress.film_cases import (
    BAND_HEIGHT_M,
    BAND_LENGTH_M,
    BAND_WIDTH_M,
    DECK_M,
    TOP_MARGIN_M,
    band_opening_m,
    band_scene,
    block_scene,
    toughness_j,
)
from sim_core.stress.loads import CARTON, still
from sim_core.stress.model import StressRow, Trial, try_scene
from sim_core.stress.rows_film_tears import film_is_sane
from sim_core.stress.run import run_row

SLACK_PAPER = {"material": "kraft_80", "turns": 1, "relaxation": 1.0}
MOTION: dict[str, Any] = {"mass_kg": 100.0, "level_g": 0.5, "hold_s": 0.1, "end_s": 0.3}
KNOTS_S = (0.0, 0.05, 0.15, 0.2)


def slack_paper() -> Scene:
    return band_scene("bullet", SLACK_PAPER, mass_kg=100.0)


def test_hoop_without_layers_is_free_motion() -> None:
    film = slack_paper().film
    assert film is not None
    times, ways = band_opening_m(film, layers=0.0, **MOTION).T
    exact = [trapezoid_travel_m(0.5, 0.05, 0.1, time) for time in times[::1000]]
    assert ways[::1000] == pytest.approx(exact, abs=2.0e-5)


def test_slack_elastic_hoop_is_an_oscillator() -> None:
    film = slack_paper().film
    assert film is not None
    times, ways = band_opening_m(film, layers=1.0, **MOTION).T
    hoop = 2.0 * (BAND_LENGTH_M + BAND_WIDTH_M)
    stiffness = 4.0 * (BAND_HEIGHT_M - TOP_MARGIN_M) * film.around.stiffness_npm / hoop
    omega = math.sqrt(stiffness / 100.0)
    # A ramp of slope s moves an oscillator by s/ω²·(τ − sin(ωτ)/ω); the trapezoid is four of them.
    slope, exact = 0.5 * GRAVITY / 0.05, np.zeros_like(times)
    for knot, sign in zip(KNOTS_S, (1.0, -1.0, -1.0, 1.0), strict=True):
        tau = np.maximum(times - knot, 0.0)
        exact += sign * slope / omega**2 * (tau - np.sin(omega * tau) / omega)
    assert ways.max() > 0.01
    # It ends where the boxes meet again.
    assert len(times) < 0.3 / 2.0e-5
    assert np.abs(ways - exact).max() < 1.0e-3 * ways.max()


def test_torn_hoop_is_free_from_its_break_on() -> None:
    film = slack_paper().film
    assert film is not None
    times, ways = band_opening_m(film, layers=0.2, tears=True, **{**MOTION, "level_g": 0.8}).T
    hoop = 2.0 * (BAND_LENGTH_M + BAND_WIDTH_M)
    torn = ways > 0.5 * hoop * film.around.break_strain
    coasts = torn & (times > KNOTS_S[-1])
    assert coasts.any()
    assert np.ptp(np.diff(ways[coasts])) < 1.0e-9


def test_toughness_of_paper_is_its_triangle() -> None:
    scene = block_scene("bullet", {**SLACK_PAPER, "turns": 3})
    film = scene.film
    assert film is not None
    # Straight to the break both ways; the turned box could need its diagonal on every side.
    side = math.hypot(*CARTON[:2])
    area = 4.0 * side * (CARTON[2] + DECK_M)
    each = sum(0.5 * law.stiffness_npm * law.break_strain**2 for law in (film.around, film.up))
    assert toughness_j(scene) == pytest.approx(3.0 * area * each)


@pytest.fixture(scope="module")
def resting() -> Trial:
    return try_scene(block_scene("bullet", SLACK_PAPER, sled=still(0.1)))


@pytest.mark.parametrize(
    ("film", "physics", "is_right"),
    [
        ({}, {}, True),
        ({"peak_strain": 1.0}, {}, False),
        ({"lost_j": -1.0}, {}, False),
        ({"lost_j": 1.0e4}, {}, False),
        ({}, {"energy_residual": 0.06}, False),
    ],
)
def test_figures_that_no_film_can_have_are_wrong(
    resting: Trial, film: dict[str, float], physics: dict[str, float], is_right: bool
) -> None:
    result = resting.finished
    changed = replace(result.physics, film={**(result.physics.film or {}), **film}, **physics)
    trial = replace(resting, result=replace(result, physics=changed))
    assert film_is_sane([trial]).right is is_right


def test_box_that_leaps_is_wrong(resting: Trial) -> None:
    frame = resting.frames[5]
    away = replace(frame, positions=frame.positions + np.array([0.5, 0.0, 0.0]))
    frames = (*resting.frames[:5], away, *resting.frames[6:])
    assert not film_is_sane([replace(resting, frames=frames)]).right


def test_run_that_takes_too_long_is_wrong() -> None:
    row = StressRow(
        "slow", "Group", "one carton", "is over at once",
        lambda engine: [block_scene(engine, None, sled=still(0.1))], film_is_sane, patience_s=0.0,
    )  # fmt: skip
    result = run_row(row, "bullet")
    assert (result.outcome, result.is_acceptable) == ("wrong", False)
    assert "TookTooLong: not over after 0 s" in result.measured


def test_interrupted_table_stops() -> None:
    def scenes(engine: str) -> list[Scene]:
        raise Interrupted

    with pytest.raises(Interrupted):
        run_row(StressRow("one", "Group", "one", "stops", scenes, film_is_sane), "bullet")
