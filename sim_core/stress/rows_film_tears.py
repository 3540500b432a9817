"""One hoop of film against a spring of its law, up to its yield and its break; and films that tear or let go."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from config.scene import Scene
from sim_core.frames import Array
from sim_core.monitors import MAXIMUM_SPEED_MPS
from sim_core.stress.film_cases import (
    BAND_LENGTH_M,
    BAND_WIDTH_M,
    ENERGY_SHARE,
    KRAFT,
    PATIENCE_S,
    STRETCH,
    band_opening_m,
    band_scene,
    block_scene,
    bound_scene,
    grid,
    toughness_j,
)
from sim_core.stress.loads import Raw, box
from sim_core.stress.model import Judgement, StressRow, Trial, within
from sim_core.stress.rows_stacks import CREEP_M

SPRING_SHARE = 0.01
"""A step of 0.3/ω keeps the peak of a spring within 1 %."""
COMPARED_S = 0.15
"""How long after the plateau paths are compared."""
STRAIN_SHARE = 2.0
"""How far past its break strain a film may be found, which tears once a frame while a fast box stretches it on."""
HOOP_SHARE = 0.02
"""What the frame in which it is widest, and rows at its borders, may be off the hoop's strain."""
GIVEN_SHARE = 1.0e-3
"""Of its toughness: round-off of what a film flows, no more may it seem to give."""


def _opening_m(trial: Trial) -> Array:
    """How far the two boxes of a band have come apart [m], shape [frame_count]."""
    moves = trial.moves()[:, :, 0]
    opening: Array = moves[:, 0] - moves[:, 1]
    return opening


def _opens_as_solved(
    *, mass_kg: float, level_g: float, hold_s: float
) -> Callable[[Sequence[Trial]], Judgement]:
    def judge(trials: Sequence[Trial]) -> Judgement:
        trial = trials[0]
        wrap, film = trial.scene.wrap, trial.scene.film
        assert wrap is not None and film is not None and isinstance(wrap.turns, float | int)
        solved = band_opening_m(
            film, layers=wrap.turns, mass_kg=mass_kg, level_g=level_g, hold_s=hold_s, end_s=hold_s + COMPARED_S + 0.05,
            tears=wrap.tear,
        )  # fmt: skip
        times, ways = trial.times_s(), _opening_m(trial)
        seen = times <= solved[-1, 0]
        exact = np.interp(times[seen], solved[:, 0], solved[:, 1])
        error, peak = float(np.abs(ways[seen] - exact).max()), float(exact.max())
        words = f"opens {1e3 * ways[seen].max():.2f} mm for {1e3 * peak:.2f} mm, path's error"
        return within(error, max(CREEP_M, SPRING_SHARE * peak), words)

    return judge


def _band(
    name: str, title: str, *, mass_kg: float, hold_s: float = 0.1, level_g: float = 0.5, group: str = "yield and tear",
    quick: bool = False, poses_hz: int = 240, **wrap: Any,
) -> StressRow:  # fmt: skip
    film, sampling = {**STRETCH, "tear": False, **wrap}, {"poses_hz": poses_hz}
    return StressRow(
        f"film_{name}", f"Film: {group}", f"{title}, {level_g:g} g",
        "two boxes come apart in one hoop of film, T = E·t·(perimeter/rest − 1) up to its yield and its break:"
        " m·x'' = m·a − 2·T·h, within 1 %",
        lambda engine: [
            band_scene(engine, film, mass_kg=mass_kg, level_g=level_g, hold_s=hold_s, sampling=sampling)
        ],
        _opens_as_solved(mass_kg=mass_kg, level_g=level_g, hold_s=hold_s), quick=quick, patience_s=PATIENCE_S,
    )  # fmt: skip


STICKY_KG, STICKY_G, STICKY_HOLD_S = 50.0, 0.5, 0.1


def _opens_between(trials: Sequence[Trial]) -> Judgement:
    """Film that sticks stretches on the long sides only; there it may narrow freely, or not at all."""
    trial = trials[0]
    film = trial.scene.film
    assert film is not None
    clamped = 1.0 / (1.0 - film.poisson**2 * film.up.stiffness_npm / film.around.stiffness_npm)
    peaks = []
    for stiffening in (1.0, clamped):
        solved = band_opening_m(
            film, layers=3.0, mass_kg=STICKY_KG, level_g=STICKY_G, hold_s=STICKY_HOLD_S, end_s=0.3,
            long_sides_only=True, stiffening=stiffening,
        )  # fmt: skip
        peaks.append(float(solved[:, 1].max()))
    most, least = peaks
    way = float(_opening_m(trial)[trial.times_s() <= 0.3].max())
    words = f"opens {1e3 * way:.2f} mm for {1e3 * least:.2f} to {1e3 * most:.2f} mm, outside by"
    return within(max(least - way, way - most, 0.0), SPRING_SHARE * most, words)


def film_is_sane(trials: Sequence[Trial]) -> Judgement:
    """What no film can do: outstretch its break, lose more than its toughness, give energy, carry a box off at once."""
    trial = trials[-1]
    physics, film = trial.finished.physics, trial.scene.film
    seen: Any = physics.film
    assert film is not None and seen is not None
    toughness = toughness_j(trial.scene)
    most_strain = STRAIN_SHARE * max(film.around.break_strain, film.up.break_strain)
    lost = seen["lost_j"] / toughness
    leap = float(np.abs(np.diff(trial.paths(), axis=0)).max() / np.diff(trial.times_s()).min())
    shares = {
        f"energy residual {100.0 * physics.energy_residual:.2g} %": physics.energy_residual / ENERGY_SHARE,
        f"peak strain {seen['peak_strain']:.3g} of {most_strain:.3g}": seen["peak_strain"] / most_strain,
        f"film lost {seen['lost_j']:.3g} J of {toughness:.3g} J": max(lost, -lost / GIVEN_SHARE),
        f"at most {leap:.3g} m/s from frame to frame": leap / MAXIMUM_SPEED_MPS,
    }
    worst = max(shares.values()) if np.isfinite(trial.paths()).all() else np.inf
    told = ", ".join(shares) + f"; moved {1e3 * trial.peak_m():.0f} mm"
    return Judgement(bool(worst <= 1.0), told, min(worst, 1.0e9), 1.0, "x")


def _strain_is_that_of_the_hoop(trials: Sequence[Trial]) -> Judgement:
    """Without friction the film's largest strain is that of the hoop where the boxes are furthest apart."""
    film, seen = trials[0].scene.film, trials[0].finished.physics.film
    assert film is not None and seen is not None
    sane = film_is_sane(trials)
    share = 1.0 + _opening_m(trials[0]).max() / (BAND_LENGTH_M + BAND_WIDTH_M)
    strain, exact = float(str(seen["peak_strain"])), float((1.0 + film.strain) * share - 1.0)
    worst = max(float(sane.value or 0.0), abs(strain - exact) / (HOOP_SHARE * exact))
    words = f"peak strain {strain:.4g} for {exact:.4g}; {sane.measured}"
    return Judgement(sane.right and worst <= 1.0, words, worst, 1.0, "x")


def _tear_is_told(trials: Sequence[Trial]) -> Judgement:
    """Torn elements, a failed damage rule, and figures of film and energy that can be."""
    film = trials[-1].finished.physics.film or {}
    rule = next(rule for rule in trials[-1].finished.judge.rules() if rule.rule == "damage")
    sane = film_is_sane(trials)
    words = f"damage rule: {rule.state}, {film.get('torn')} of {film.get('elements')} elements torn; {sane.measured}"
    is_told = bool(film.get("torn")) and rule.state == "fail"
    return Judgement(is_told and sane.right, words, sane.value, sane.bound, sane.unit)


def _torn(name: str, title: str, build: Callable[[str], Scene], *, quick: bool = False) -> StressRow:
    return StressRow(
        f"film_tears_{name}", "Film: yield and tear", title,
        "torn elements and a failed damage rule; no strain far past the break; no more energy lost than the film's"
        " toughness, none from nowhere beyond 5 %; over in half a minute",
        lambda engine: [build(engine)], _tear_is_told, quick=quick, patience_s=PATIENCE_S,
    )  # fmt: skip


def _flows_on(name: str, title: str, **parts: Any) -> StressRow:
    """A wide way apart and back, and a slack film until all rests."""
    wrap = {**STRETCH, "turns": 1, "tear": False}
    return StressRow(
        f"film_flows_on{name}", "Film: yield and tear", f"{title}, until all rests, 0.5 g",
        "the largest strain is that of the hoop at its widest, within 2 %; energy lost and the ledger as they can be",
        lambda engine: [band_scene(engine, wrap, mass_kg=50.0, hold_s=0.3, **parts)],
        _strain_is_that_of_the_hoop, patience_s=PATIENCE_S,
    )  # fmt: skip


def _three_columns(engine: str) -> Scene:
    boxes = [box(f"a{i}", (0.2, 0.3, 0.9), 15.0, x=(i - 1) * 0.201) for i in range(3)]
    return bound_scene(
        engine, boxes, {**STRETCH, "turns": 0.3}, deck_m=(0.602, 0.3), friction=0.6, level_g=0.8, hold_s=0.4
    )


_PAPER: Raw = {"material": "kraft_80", "turns": 0.2}
_DRAWN: Raw = {"turns": 1, "mass_kg": 50.0, "hold_s": 0.3}

FILM_TEAR_ROWS: tuple[StressRow, ...] = (
    _band("band", "two boxes in three layers", mass_kg=50.0, group="closed forms", quick=True),
    _band("band_weak", "two boxes in 0.3 layers", mass_kg=10.0, turns=0.3, group="closed forms"),
    _band("band_slack", "three layers, all tension lost by relaxation", mass_kg=50.0, relaxation=1.0,
          group="closed forms"),
    _band("band_not_relaxed", "three layers, none of it lost", mass_kg=50.0, relaxation=0.0, group="closed forms"),
    _band("band_no_force", "three layers, laid without a force", mass_kg=50.0, wrap_force_n=0.0, group="closed forms"),
    _band("band_hood", "a hood", mass_kg=50.0, material="hood_100", turns=1, group="closed forms"),
    _band("band_kraft", "kraft paper", mass_kg=100.0, material="kraft_80", turns=1, group="closed forms"),
    _band("band_untorn", "kraft paper past its break, told not to tear", mass_kg=100.0, level_g=0.8, **_PAPER,
          group="closed forms"),
    StressRow(
        "film_band_sticks", "Film: closed forms", "three layers that stick to the edges, friction 10, 0.5 g",
        "only the long sides stretch: between a film that narrows freely and one that cannot, E/(1 − ν12·ν21)",
        lambda engine: [
            band_scene(
                engine, {**STRETCH, "friction": 10.0}, mass_kg=STICKY_KG, level_g=STICKY_G, hold_s=STICKY_HOLD_S
            )
        ],
        _opens_between, patience_s=PATIENCE_S,
    ),
    _band("flows", "a pre-stretched film drawn further", **_DRAWN, quick=True),
    _band("flows_30hz", "the same, 30 pose frames a second", **_DRAWN, poses_hz=30),
    _band("flows_at_once", "a film laid with all the force it bears", **_DRAWN, wrap_force_n=129.8, relaxation=0.0),
    _band("flows_undrawn", "a film that was not pre-stretched", **_DRAWN, pre_stretch=0.0),
    _band("flows_at_yield", "a film pre-stretched to its yield point", **_DRAWN, pre_stretch=0.065),
    _band("pre_stretch_most", "a film pre-stretched to just below its break", mass_kg=80.0, hold_s=0.3, turns=0.5,
          pre_stretch=5.899, tear=True),
    _flows_on("", "a film drawn further"),
    _flows_on("_30hz", "a film drawn further, 30 pose frames a second", sampling={"poses_hz": 30}),
    _band("tears", "kraft paper that tears", mass_kg=100.0, level_g=0.8, **_PAPER, tear=True),
    _band("tears_30hz", "the same, 30 pose frames a second", mass_kg=100.0, level_g=0.8, **_PAPER, tear=True,
          poses_hz=30),
    _torn("band", "the same: what is told of it, to its end", lambda engine: band_scene(
        engine, _PAPER, mass_kg=100.0, level_g=0.8
    )),
    _torn("block", "a carton of 200 kg bound to its pallet by kraft paper, 0.8 g", lambda engine: block_scene(
        engine, KRAFT, mass_kg=200.0, level_g=0.8, hold_s=0.3
    )),
    _torn("kraft", "eight boxes in 0.3 layers of kraft paper, 0.8 g", lambda engine: bound_scene(
        engine, grid(), {**KRAFT, "turns": 0.3}, level_g=0.8, hold_s=0.3
    ), quick=True),
    _torn("stretch", "eight boxes in one layer of stretch film, 0.8 g", lambda engine: bound_scene(
        engine, grid(), {**STRETCH, "turns": 1}, level_g=0.8, hold_s=0.3
    )),
    _torn("2g", "eight boxes in three layers of stretch film, 2 g", lambda engine: bound_scene(
        engine, grid(), STRETCH, level_g=2.0, hold_s=0.3
    )),
    _torn("10g", "eight boxes in three layers of stretch film, 10 g", lambda engine: bound_scene(
        engine, grid(), STRETCH, level_g=10.0, hold_s=0.04
    )),
    StressRow(
        "film_topples", "Film: yield and tear", "three columns that topple in a film too weak to hold them, 0.8 g",
        "strain, energy lost and the ledger stay what they can be, to the end of the run",
        lambda engine: [_three_columns(engine)], film_is_sane, patience_s=PATIENCE_S,
    ),
)  # fmt: skip
"""The rows of this file."""
