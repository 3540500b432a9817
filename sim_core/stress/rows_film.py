"""Wrapped loads from no film to a rigid one, light and heavy, of every shape: against closed forms and bounds."""

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from config.scene import Scene
from sim_core.accuracy.closed_forms import trapezoid_slip_m
from sim_core.stress.film_cases import (
    ENERGY_SHARE,
    KRAFT,
    ON_PALLET,
    PATIENCE_S,
    SHAPES,
    STRETCH,
    block_scene,
    bound_scene,
    grid,
    loose_scene,
    stack_scene,
)
from sim_core.stress.loads import CARTON, Raw, box, still
from sim_core.stress.model import Judgement, StressRow, Trial, try_scene, within
from sim_core.stress.rows_invariance import TOLERANCE_M as MIRROR_M
from sim_core.stress.rows_invariance import mirrored, same_bits, uneven_boxes
from sim_core.stress.rows_stacks import CREEP_M, reference_bound_m

HELD_M = 1.0e-3
MESH_SHARE, MESH_M = 0.1, 1.0e-3
"""What half the mesh spacing may change of a peak."""
SETTLED_M = 3.0e-3
"""How far a load may settle without a word, as ``sim_core/load_test.py`` has it for what sinks."""
FINE, FINER, FINEST = 1.0 / 3840.0, 1.0 / 7680.0, 1.0 / 23040.0

STIFFNESSES: tuple[tuple[str, float, float | None], ...] = (
    ("stretch_film_20", 0.006, None), ("stretch_film_20", 0.06, None), ("stretch_film_20", 0.6, None),
    ("stretch_film_20", 6.0, None), ("stretch_film_20", 60.0, None), ("stretch_film_20", 200.0, None),
    ("kraft_80", 20.0, FINER), ("kraft_80", 200.0, FINEST),
)  # fmt: skip
"""Film, layers and time step [s]: E·t is 8, 80 and 800 N/m, 8, 80 and 270 kN/m, 3 and 30 MN/m."""


def _stepped(step_s: float | None) -> Raw:
    return {} if step_s is None else {"solver": {"time_step_s": step_s}}


def _stiffer_holds_better(trials: Sequence[Trial]) -> Judgement:
    """The first trial has no film; peaks never rise by more than what blows may leave in two runs."""
    words, peaks = [], []
    for (material, turns, _), trial in zip((("none", 0.0, None), *STIFFNESSES), trials, strict=True):
        if trial.refused is not None or trial.ended is not None:
            words.append(f"{material} x {turns:g}: {'refused' if trial.refused else 'ended'}")
            continue
        peaks.append(trial.peak_m())
        words.append(f"{material} x {turns:g}: {1e3 * peaks[-1]:.3f} mm")
    worst = max((later - earlier for earlier, later in pairwise(peaks)), default=0.0)
    is_rigid = trials[-1].ended is not None or peaks[-1] <= CREEP_M
    told = ", ".join(words) + ("" if is_rigid else f", the last should be under {1e3 * CREEP_M:g} mm")
    return Judgement(worst <= CREEP_M and is_rigid, told, 1e3 * max(worst, 0.0), 1e3 * CREEP_M, "mm of rise")


def _sweep(name: str, what: str, build: Callable[..., Scene], **wrap: Any) -> StressRow:
    def scenes(engine: str) -> list[Scene]:
        return [build(engine, None)] + [
            build(engine, {"material": material, "turns": turns, "tear": False, **wrap}, **_stepped(step_s))
            for material, turns, step_s in STIFFNESSES
        ]

    return StressRow(
        f"film_stiffness_{name}", "Film: stiffness", f"{what}, E·t from 8 N/m to 30 MN/m, 0.4 g",
        "a stiffer film never lets it move further, to 0.1 mm; with 30 MN/m it moves by under 0.1 mm",
        scenes, _stiffer_holds_better, partial=True, patience_s=PATIENCE_S,
    )  # fmt: skip


def _holds(trials: Sequence[Trial]) -> Judgement:
    return within(max(trial.peak_m() for trial in trials), HELD_M, "largest corner displacement")


def _light(name: str, what: str, wrap: Raw, *, step_s: float | None = None, quick: bool = False) -> StressRow:
    return StressRow(
        f"film_light_{name}", "Film: light and heavy",
        f"four boxes of 0.1 kg in three layers of {what}{', a step of its own' if step_s else ''}, 0.5 g",
        "held to 1 mm: the film pulls with a hundred times the load's weight; or ended for its frequency",
        lambda engine: [stack_scene(engine, wrap, mass_kg=0.1, level_g=0.5, **_stepped(step_s))],
        _holds, quick=quick, patience_s=PATIENCE_S,
    )  # fmt: skip


def _holds_some(trials: Sequence[Trial]) -> Judgement:
    """The first trial has no film, the second has one: it takes something off, but cannot hold such a weight."""
    bare, wrapped = (trial.peak_m() for trial in trials)
    words = f"{1e3 * wrapped:.2f} mm, {1e3 * bare:.2f} mm without film"
    return Judgement(0.0 < wrapped <= bare + CREEP_M, words, 1e3 * wrapped, 1e3 * bare, "mm with and without")


def _heavy(mass_kg: float) -> StressRow:
    return StressRow(
        f"film_heavy_{mass_kg:.0f}", "Film: light and heavy", f"four boxes of {mass_kg:g} kg in three layers, 0.5 g",
        "slides on, but not further than without a film",
        lambda engine: [stack_scene(engine, wrap, mass_kg=mass_kg, level_g=0.5) for wrap in (None, STRETCH)],
        _holds_some, patience_s=PATIENCE_S,
    )  # fmt: skip


def _one_way(name: str, what: str, **parts: Any) -> StressRow:
    wraps = ({**STRETCH, "coupling": "one_way"}, None)
    return StressRow(
        name, "Film: none and little", f"a film that only follows a load {what}, and no film",
        "the same motion to the last bit",
        lambda engine: [stack_scene(engine, wrap, **parts) for wrap in wraps],
        same_bits, may=("right",), quick=True, patience_s=PATIENCE_S,
    )  # fmt: skip


def _refused(name: str, title: str, limit: str, **wrap: Any) -> StressRow:
    return StressRow(
        f"film_{name}", "Film: none and little", title, f"refused before the first step: {limit}",
        lambda engine: [block_scene(engine, {**STRETCH, **wrap})],
        lambda trials: Judgement(False, f"accepted; peak {1e3 * trials[0].peak_m():.4g} mm"),
        may=("refused",), engines=("bullet",), quick=True,
    )  # fmt: skip


def _as_finer_and_even(trials: Sequence[Trial]) -> Judgement:
    """The default mesh against half the spacing, and the load against its own mirror image in y."""
    peak, finer = (trial.peak_m() for trial in trials)
    allowed = max(MESH_M, MESH_SHARE * finer)
    places = np.array([package.position_m for package in trials[0].scene.packages])
    flip = np.array([1.0, -1.0, 1.0])
    twins = [int(np.linalg.norm(places - place * flip, axis=1).argmin()) for place in places]
    moves = trials[0].moves()
    skew = float(np.abs(moves * flip - moves[:, twins]).max())
    worst = max(abs(peak - finer) / allowed, skew / MIRROR_M)
    words = f"peak {1e3 * peak:.2f} mm, finer mesh {1e3 * finer:.2f} mm, off its mirror image by {1e3 * skew:.3f} mm"
    return Judgement(worst <= 1.0, words, worst, 1.0, "x")


def _meshed(name: str, group: str, title: str, boxes: Sequence[Raw], **wrap: Any) -> StressRow:
    return StressRow(
        f"film_{name}", f"Film: {group}", f"{title}, 0.4 g",
        "half the mesh spacing changes the peak by 10 % or 1 mm at most; mirror-symmetric in y to 1 mm",
        lambda engine: [
            bound_scene(engine, boxes, {**STRETCH, **wrap, **finer}) for finer in ({}, {"spacing_m": 0.05})
        ],
        _as_finer_and_even, patience_s=PATIENCE_S,
    )  # fmt: skip


def _centre_slips(trials: Sequence[Trial]) -> Judgement:
    """Film that holds to nothing but the load is an inner force: the load's centre slips as one block would."""
    trial = trials[0]
    masses = np.array([package.mass_kg for package in trial.scene.packages])
    slip = -float((trial.moves()[-1, :, 0] @ masses) / masses.sum())
    exact = trapezoid_slip_m(0.4, 0.05, 0.2, ON_PALLET)
    return within(abs(slip - exact), reference_bound_m(exact), f"centre slips {1e3 * slip:.3f} mm, error")


def _loose(
    name: str, group: str, title: str, boxes: Sequence[Raw], *, quick: bool = False, **wrap: Any
) -> StressRow:
    return StressRow(
        f"film_{name}", f"Film: {group}", f"{title}, no pallet, 0.4 g",
        "an inner force: the centre of mass slips 34.57 mm, as Σm under μg does without a film",
        lambda engine: [loose_scene(engine, boxes, {**STRETCH, **wrap})], _centre_slips, quick=quick,
        patience_s=PATIENCE_S,
    )  # fmt: skip


def _overhanging(engine: str, spacing_m: float | None = None) -> Scene:
    """A load that stands out over its pallet by 0.1 m all around."""
    return bound_scene(engine, grid(), {**STRETCH, "spacing_m": spacing_m}, deck_m=(0.602, 0.402))


def _mesh_error_is_stated(trials: Sequence[Trial]) -> Judgement:
    """The default mesh's error is small, or inside the error that the run states."""
    peak = trials[0].peak_m()
    finer = try_scene(_overhanging(trials[0].scene.solver.engine, 0.05)).peak_m()
    words = f"peak {1e3 * peak:.2f} mm, spacing 50 mm {1e3 * finer:.2f} mm, off by"
    return within(abs(peak - finer), MESH_M, words)


def _spacings_agree(trials: Sequence[Trial]) -> Judgement:
    """Every spacing up to the lowest box is near the finest one's peak; wider ones are at least warned of."""
    words, worst = [], 0.0
    finest = trials[0].peak_m()
    for trial in trials:
        wrap = trial.scene.wrap
        assert wrap is not None and wrap.spacing_m is not None
        told = any(f.subject == "wrap.spacing_m" for f in trial.finished.findings)
        words.append(f"{wrap.spacing_m:g} m: {1e3 * trial.peak_m():.2f} mm{' (warned)' if told else ''}")
        share = abs(trial.peak_m() - finest) / max(MESH_M, MESH_SHARE * finest)
        worst = worst if told else max(worst, share)
    return Judgement(worst <= 1.0, ", ".join(words), worst, 1.0, "x")


def _far_apart(engine: str) -> list[Scene]:
    return [loose_scene(engine, boxes, STRETCH) for boxes in (uneven_boxes(), mirrored(uneven_boxes()))]


def _mirrored_peaks_agree(trials: Sequence[Trial]) -> Judgement:
    first, second = (trial.peak_m() for trial in trials)
    energy = max(trial.finished.physics.energy_residual for trial in trials)
    worst = max(abs(first - second) / MIRROR_M, energy / ENERGY_SHARE)
    words = f"peaks {1e3 * first:.2f} and {1e3 * second:.2f} mm, energy residual {100.0 * energy:.2g} %"
    return Judgement(worst <= 1.0, words, worst, 1.0, "x")


def _settling_is_told(trials: Sequence[Trial]) -> Judgement:
    """Displacement counts from the settled load: what it was drawn to before must be told."""
    trial = trials[0]
    given = np.array([package.position_m for package in trial.scene.packages])
    drawn = float(np.linalg.norm(trial.paths()[0] - given, axis=1).max())
    told = [f for f in trial.finished.findings if f.severity != "note"]
    words = f"drawn by {1e3 * drawn:.0f} mm while settling, peak after it {1e3 * trial.peak_m():.2f} mm, " + (
        f"told: {told[0].check}: {told[0].limit}" if told else "nothing says so"
    )
    return Judgement(bool(told) or drawn <= SETTLED_M, words, 1e3 * drawn, 1e3 * SETTLED_M, "mm drawn")


def _tall(engine: str) -> list[Scene]:
    boxes, critical_g, alone = [box("a", (0.3, 0.3, 1.2), 30.0)], 0.25, {**STRETCH, "pallet_overlap_m": 0.0}
    return [
        bound_scene(
            engine, boxes, wrap, level_g=share * critical_g, hold_s=2.0, deck_m=(0.3, 0.3), friction=0.9
        )
        for share, wrap in ((0.98, alone), (1.02, alone), (1.02, {**STRETCH, "turns": 10}))
    ]  # fmt: skip


def _tips_as_bare(trials: Sequence[Trial]) -> Judgement:
    """One box: film around it alone leaves g·b/h as it is, film down to the pallet holds it."""
    tips = [bool(trial.frames) and trial.tips() for trial in trials]
    told = ", ".join("tips" if t else "stands" for t in tips)
    return Judgement(
        tips == [False, True, False], f"alone at 0.98 and 1.02, tied down at 1.02 of g·b/h: {told}"
    )


def _rests(trials: Sequence[Trial]) -> Judgement:
    creep = float(np.linalg.norm(trials[0].moves(), axis=2).max())
    return within(creep, CREEP_M, "largest creep of a centre")


_SHAPE_TITLES = {
    "one_box": "one carton", "tall": "one tall box", "taper": "a load that tapers upwards",
    "mushroom": "a load that widens upwards", "hollow": "a load with a hollow",
    "turned_45": "boxes of which every other is turned by 45°", "low_boxes": "a layer of 2 cm between two of 20 cm",
    "plates": "three layers of 2 cm", "touching": "eight boxes without gaps",
    "gapped": "eight boxes with gaps of 1 mm", "gapped_10mm": "eight boxes with gaps of 10 mm",
}  # fmt: skip
_BELTS: Raw = {"turns": {"bottom": 3, "top": 3}, "web_width_m": 0.1}

FILM_ROWS: tuple[StressRow, ...] = (
    _sweep("block", "a carton bound to its pallet", block_scene),
    _sweep("slack", "the same with a film that has relaxed altogether", block_scene, relaxation=1.0),
    _sweep("slippery", "the same with a film without friction", block_scene, friction=0.0),
    _sweep("sticky", "the same with a film of friction 10", block_scene, friction=10.0),
    _sweep("stack", "two columns of two cartons bound to their pallet", stack_scene),
    StressRow(
        "film_stiff_default", "Film: stiffness", "a carton in 200 layers of kraft paper, the default step, 0.4 g",
        "held to 1 mm, or ended: the film's frequency asks for a step of 0.06 ms",
        lambda engine: [block_scene(engine, {**KRAFT, "turns": 200})], _holds, patience_s=PATIENCE_S,
    ),
    _light("default", "stretch film", STRETCH, quick=True),
    _light("fine", "stretch film", STRETCH, step_s=FINE),
    _light("kraft", "kraft paper", {**KRAFT, "turns": 3}),
    _light("kraft_fine", "kraft paper", {**KRAFT, "turns": 3}, step_s=FINEST),
    _heavy(100.0),
    _heavy(1000.0),
    StressRow(
        "film_zero_turns", "Film: none and little", "no turns of film, and no film", "the same to the last bit",
        lambda engine: [stack_scene(engine, {**STRETCH, "turns": 0}), stack_scene(engine, None)], same_bits,
        may=("right",), quick=True,
    ),
    _one_way("film_one_way", "that slides"),
    _one_way("film_one_way_fields", "held by force fields",
             force_fields={"tension": 10.0, "distance_m": 0.05, "falloff": 2.0}),
    _refused("height_least", "half a millimetre of film", "too little to wrap", height_m=5e-4, pallet_overlap_m=0.0),
    _refused("wrap_force_over", "a film laid with 130 N", "129.8 N draw it further", wrap_force_n=130.0),
    _refused("pre_stretch_break", "a film pre-stretched to its break", "it breaks", pre_stretch=5.9),
    _refused("pre_stretch_kraft", "kraft paper, pre-stretched", "does not yield", material="kraft_80", pre_stretch=0.1),
    _meshed("strip", "none and little", "5 cm of film on the load, 10 cm on its pallet", grid(), height_m=0.05),
    _meshed("strip_1cm", "none and little", "1 cm of film on the load, 10 cm on its pallet", grid(), height_m=0.01),
    _meshed("one_layer", "none and little", "film on pallet and lower layer only", grid(), height_m=0.2),
    _meshed("one_layer_alone", "none and little", "film on the lower layer only", grid(), height_m=0.2,
            pallet_overlap_m=0.0),
    _loose("bare_belt", "none and little", "film at foot and head, none between", grid(), **_BELTS),
    *(
        row
        for name, title in _SHAPE_TITLES.items()
        for row in (
            _loose(f"loose_{name}", "shapes", f"{title}, in three layers", SHAPES[name], quick=name == "taper"),
            _meshed(name, "shapes", f"{title}, bound to a pallet by three layers", SHAPES[name]),
        )
    ),
    StressRow(
        "film_overhang", "Film: shapes", "eight boxes that stand out over their pallet by 0.1 m, the default mesh",
        "off a mesh of half the spacing by 1 mm at most, or by no more than the error estimate",
        lambda engine: [_overhanging(engine)], _mesh_error_is_stated, patience_s=PATIENCE_S,
    ),
    StressRow(
        "film_spacing", "Film: shapes", "two columns of two cartons, mesh spacings of 0.02 to 1 m, 0.4 g",
        "each within 10 % or 1 mm of the finest, unless the spacing is warned of",
        lambda engine: [
            stack_scene(engine, {**STRETCH, "spacing_m": spacing}) for spacing in (0.02, 0.05, 0.1, 0.2, 0.3, 1.0)
        ],
        _spacings_agree, patience_s=PATIENCE_S,
    ),
    StressRow(
        "film_draws_together", "Film: shapes", "two cartons 0.4 m apart in three layers, no pallet",
        "refused, ended, or told: displacement counts from where the film has drawn them to",
        lambda engine: [
            loose_scene(engine, [box("a", CARTON, 10.0, x=-0.4), box("b", CARTON, 10.0, x=0.4)], STRETCH, level_g=0.2)
        ],
        _settling_is_told, quick=True, patience_s=PATIENCE_S,
    ),
    StressRow(
        "film_far_apart", "Film: shapes", "two unlike stacks 0.15 m apart in three layers, and their mirror image in y",
        "ended, for the film draws them together; or the same peak to 1 mm and no energy from nowhere",
        _far_apart, _mirrored_peaks_agree, patience_s=PATIENCE_S,
    ),
    StressRow(
        "film_tall_tips", "Film: shapes", "a tall box wrapped alone, and tied to its pallet, at 0.98 and 1.02 of g·b/h",
        "film around it alone changes nothing: stands below a_crit = g·b/h = 0.25 g, tips above; tied down it stands",
        _tall, _tips_as_bare, patience_s=PATIENCE_S,
    ),
    StressRow(
        "film_rest_10s", "Film: shapes", "eight wrapped boxes on a pallet, 10 s at rest", "no creep: under 0.1 mm",
        lambda engine: [bound_scene(engine, grid(), STRETCH, sled=still(10.0), sampling={"poses_hz": 60})],
        _rests, patience_s=PATIENCE_S,
    ),
)  # fmt: skip
"""The rows of this file."""
