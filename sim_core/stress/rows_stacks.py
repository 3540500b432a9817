"""Stacks that strain a contact solver: mass ratios, tall columns, sizes, counts, overlaps, long rests."""

import math
from collections.abc import Callable, Sequence

import numpy as np

from config.scene import Scene
from config.scene_file import find_scene, read_scene
from sim_core.accuracy.closed_forms import trapezoid_slip_m
from sim_core.stress.loads import CARTON, FLAT, Size, block_of, box, column, scene_of, still, trapezoid
from sim_core.stress.model import GRACEFUL, Judgement, StressRow, Trial, within

STILL_M = 1.0e-3
"""What must not move may not move further."""
CREEP_M = 1.0e-4
SINK_SHARE = 0.01
TEN_G = 'sled={"profile":"table","times_s":[0,0.02,0.08,0.1],"acceleration_mps2":[0,98.1,98.1,0]}'


def reference_bound_m(exact_m: float) -> float:
    """0.05 % or 0.1 mm, whichever is larger: the bar of the reference suite [m]."""
    return max(1.0e-4, 5.0e-4 * abs(exact_m))


def _stands(trials: Sequence[Trial]) -> Judgement:
    """No box of a column sinks into the one below by 1 % of the smaller one, none drifts by a millimetre."""
    trial = trials[0]
    edges = np.array([min(package.size_m) for package in trial.scene.packages])
    smaller = np.minimum(edges, np.concatenate([edges[:1], edges[:-1]]))
    given = np.array([package.position_m[2] for package in trial.scene.packages])
    sunk = np.diff(given - trial.paths()[:, :, 2], axis=1, prepend=0.0) / smaller
    sink, drift = float(sunk.max()), float(np.linalg.norm(trial.moves(), axis=2).max())
    words = f"sinks {100.0 * sink:.3g} % of a box (bound 1), drifts {1e3 * drift:.3g} mm (bound 1)"
    return Judgement(sink <= SINK_SHARE and drift <= STILL_M, words, 1e3 * drift, 1e3 * STILL_M, "mm")


def _stays(trials: Sequence[Trial]) -> Judgement:
    return within(max(trial.peak_m() for trial in trials), STILL_M, "largest corner displacement")


def _slips(trials: Sequence[Trial]) -> Judgement:
    """A block on the default trapezoid at 0.5 g and μ 0.3 slips by its closed form."""
    exact = trapezoid_slip_m(0.5, 0.05, 0.5, 0.3)
    slip = -float(trials[0].moves()[-1, 0, 0])
    return within(abs(slip - exact), reference_bound_m(exact), f"slip {1e3 * slip:.3f} mm, error")


def _is_warned_about(check: str) -> Callable[[Sequence[Trial]], Judgement]:
    def judge(trials: Sequence[Trial]) -> Judgement:
        told = [f for f in trials[0].finished.findings if f.check == check and f.severity != "note"]
        physics = _slips(trials)
        words = f"{told[0].check} warning: {told[0].limit}" if told else f"no {check} warning"
        return Judgement(
            bool(told) and physics.right,
            f"{physics.measured}; {words}",
            physics.value,
            physics.bound,
            physics.unit,
        )

    return judge


def _pair(ratio: float, engine: str, *, level_g: float = 0.0) -> list[Scene]:
    light = min(10.0, 5000.0 / ratio)
    boxes = column([CARTON, CARTON], [light, light * ratio])
    sled = trapezoid(level_g) if level_g else still(5.0)
    return [scene_of("heavy_on_light", boxes, sled, engine=engine)]


def _mass_ratio(ratio: int) -> StressRow:
    return StressRow(
        id=f"mass_ratio_{ratio}",
        group="Stacks",
        title=f"1:{ratio} heavy on light, 5 s at rest",
        expected="rigid boxes don't sink: under 1 % of a box's smallest edge (2.5 mm), drift under 1 mm",
        scenes=lambda engine: _pair(ratio, engine),
        judge=_stands,
        may=("right",) if ratio <= 10 else GRACEFUL,
        quick=ratio >= 100,
    )


def _tower(engine: str, sled: dict[str, object], *, layers: int = 20, **solver: float) -> list[Scene]:
    boxes = column([CARTON] * layers, [10.0] * layers)
    sampling = {"poses_hz": 60} if solver.get("time_step_s", 0.0) > 1.0 / 240.0 else {}
    return [scene_of("column", boxes, sled, engine=engine, solver=dict(solver), sampling=sampling)]


def _topples(trials: Sequence[Trial]) -> Judgement:
    trial = trials[0]
    return Judgement(
        trial.tips(), f"{'topples' if trial.tips() else 'stands'}, peak {1e3 * trial.peak_m():.4g} mm"
    )


def _doubling(engine: str, *, upwards: bool) -> list[Scene]:
    edges = [0.05 * 2.0**k for k in range(6)]
    masses = [0.5 * 4.0**k for k in range(6)]
    order = slice(None) if upwards else slice(None, None, -1)
    boxes = column([(e, e, e) for e in edges[order]], masses[order])
    return [scene_of("doubling", boxes, still(3.0), engine=engine)]


def _one(engine: str, size_m: Size, mass_kg: float) -> list[Scene]:
    return [scene_of("one", [box("a", size_m, mass_kg)], trapezoid(0.5), engine=engine, friction=0.3)]


def _tiny_stack(trials: Sequence[Trial]) -> Judgement:
    return within(trials[0].sink_m(), CREEP_M, "three 1 mm cubes sink")


def _overlapping(engine: str, depth_m: float, *, sideways: bool) -> list[Scene]:
    if sideways:
        boxes = [box("a", CARTON, 10.0), box("b", CARTON, 10.0, x=CARTON[0] - depth_m)]
    else:
        boxes = [box("a", CARTON, 10.0), box("b", CARTON, 10.0, base_m=CARTON[2] - depth_m)]
    return [scene_of("overlap", boxes, still(0.5), engine=engine)]


def _parts_gently(trials: Sequence[Trial]) -> Judgement:
    """Nothing is further from its given place than the overlap or gap itself and the tolerance."""
    trial = trials[0]
    given = np.array([package.position_m for package in trial.scene.packages])
    moved = float(np.linalg.norm(trial.paths() - given, axis=2).max())
    noted = [f"{f.severity}: {f.check} {f.value}" for f in trial.finished.findings if f.check == "overlap"]
    told = f"; {noted[0]}" if noted else ""
    found = within(moved, 2.0e-3 + STILL_M, f"furthest from its given place{told}:")
    return found


def _overlap(depth_mm: float, sideways: bool) -> StressRow:
    return StressRow(
        id=f"overlap_{'side' if sideways else 'top'}_{depth_mm:g}mm",
        group="Overlaps and gaps",
        title=f"two boxes overlap by {depth_mm:g} mm {'side by side' if sideways else 'one on the other'}",
        expected="refused above 1 mm; below, told and pushed apart without a throw: Bullet would give"
        " v = ERP·depth/dt",
        scenes=lambda engine: _overlapping(engine, depth_mm / 1000.0, sideways=sideways),
        judge=_parts_gently,
        may=("refused",) if depth_mm > 1.0 else ("right",),
        quick=True,
    )


def _gap(gap_mm: float) -> StressRow:
    return StressRow(
        id=f"gap_{gap_mm:g}mm",
        group="Overlaps and gaps",
        title=f"a box {gap_mm:g} mm above the one that should carry it",
        expected="refused above 2 mm; below, it falls by the gap while settling and then rests",
        scenes=lambda engine: _overlapping(engine, -gap_mm / 1000.0, sideways=False),
        judge=_parts_gently,
        may=("refused",) if gap_mm > 2.0 else ("right",),
        quick=True,
    )


def _rests(trials: Sequence[Trial]) -> Judgement:
    moves = np.linalg.norm(trials[0].moves(), axis=2)
    return within(float(moves.max()), CREEP_M, "largest creep of a centre")


def _pallet(engine: str, *overrides: str) -> list[Scene]:
    return [read_scene(find_scene("eur_columns"), [f"solver.engine={engine}", *overrides])]


def _collapses(trials: Sequence[Trial]) -> Judgement:
    verdict, peak = trials[0].finished.judge.verdict(), trials[0].peak_m()
    return Judgement(
        verdict == "fail" and math.isfinite(peak), f"verdict {verdict}, peak {1e3 * peak:.4g} mm"
    )


def _empty(trials: Sequence[Trial]) -> Judgement:
    judge = trials[0].finished.judge
    return Judgement(
        judge.verdict() == "pass" and not judge.packages(), f"verdict {judge.verdict()}, no packages"
    )


STACK_ROWS: tuple[StressRow, ...] = (
    *(_mass_ratio(ratio) for ratio in (10, 100, 1000, 10_000)),
    StressRow(
        "mass_ratio_100_pulse", "Stacks", "1:100 heavy on light at 0.3 g",
        "sticks: 0.3 g < μg = 0.5 g and < g·b/h = 0.8 g; no corner moves by 1 mm",
        lambda engine: _pair(100.0, engine, level_g=0.3), _stays, quick=True,
    ),
    StressRow(
        "doubling_up", "Stacks", "six boxes, each twice the size and four times the mass of the one below it",
        "stands: each centre of mass is over its support; sink under 1 % of the smallest edge (0.5 mm)",
        lambda engine: _doubling(engine, upwards=True), _stands, quick=True,
    ),
    StressRow(
        "doubling_down", "Stacks", "the same six boxes, the largest at the bottom",
        "stands; sink under 1 % of the smallest edge (0.5 mm)",
        lambda engine: _doubling(engine, upwards=False), _stands, may=("right",),
    ),
    StressRow(
        "column_20_rest", "Stacks", "column of 20 boxes, 5 s at rest", "drift under 1 mm, sink under 2.5 mm",
        lambda engine: _tower(engine, still(5.0)), _stands,
    ),
    StressRow(
        "column_10_rest", "Stacks", "column of 10 boxes, 5 s at rest", "drift under 1 mm, sink under 2.5 mm",
        lambda engine: _tower(engine, still(5.0), layers=10), _stands,
    ),
    StressRow(
        "column_10_low", "Stacks", "column of 10 boxes at 0.08 g",
        "half of what tips it, g·b/h = 0.16 g: no corner moves by 1 mm",
        lambda engine: _tower(engine, trapezoid(0.08), layers=10), _stays,
    ),
    StressRow(
        "column_10_half_g", "Stacks", "column of 10 boxes at 0.5 g", "topples: a_crit = g·b/h = 0.16 g",
        lambda engine: _tower(engine, trapezoid(0.5), layers=10), _topples,
    ),
    StressRow(
        "column_20_low", "Stacks", "column of 20 boxes at 0.04 g",
        "half of what tips it, g·b/h = 0.08 g: no corner moves by 1 mm",
        lambda engine: _tower(engine, trapezoid(0.04)), _stays,
    ),
    StressRow(
        "column_20_half_g", "Stacks", "column of 20 boxes at 0.5 g", "topples: a_crit = g·b/h = 0.08 g",
        lambda engine: _tower(engine, trapezoid(0.5)), _topples,
    ),
    StressRow(
        "column_20_coarse", "Stacks", "column of 20 boxes at rest, time step 1/60 s, 10 iterations",
        "drift under 1 mm, sink under 2.5 mm",
        lambda engine: _tower(engine, still(2.0), time_step_s=1.0 / 60.0, iterations=10), _stands,
    ),
    StressRow(
        "touching", "Stacks", "18 cartons in columns, touching without a gap, 0.2 g, μ 0.5",
        "nothing moves: 0.2 g < μg and < g·b/h = 0.53 g",
        lambda engine: [
            scene_of("touching", block_of((3, 2, 3), CARTON, 10.0, gap_m=0.0), trapezoid(0.2), engine=engine)
        ],
        _stays, may=("right",),
    ),
    StressRow(
        "gapped", "Stacks", "the same 18 cartons with gaps of 1 mm",
        "nothing moves: 0.2 g < μg and < g·b/h = 0.53 g",
        lambda engine: [
            scene_of("gapped", block_of((3, 2, 3), CARTON, 10.0, gap_m=1.0e-3), trapezoid(0.2), engine=engine)
        ],
        _stays, may=("right",),
    ),
    StressRow(
        "rest_60s", "Stacks", "two columns of two cartons, 60 s at rest", "no creep: under 0.1 mm",
        lambda engine: [
            scene_of("rest", block_of((2, 1, 2), CARTON, 10.0, gap_m=1.0e-3), still(60.0), engine=engine,
                     sampling={"poses_hz": 60})
        ],
        _rests, may=("right",),
    ),
    StressRow(
        "empty_pallet", "Counts and sizes", "an empty pallet", "runs; no rows, no division by zero, passes",
        lambda engine: [read_scene(find_scene("empty_pallet"), [f"solver.engine={engine}"])], _empty,
        may=("right",), quick=True,
    ),
    StressRow(
        "one_box", "Counts and sizes", "one box, 0.5 g, μ 0.3", "slips 467.50 mm (closed form)",
        lambda engine: _one(engine, FLAT, 10.0), _slips, may=("right",), quick=True,
    ),
    StressRow(
        "thin_plate", "Counts and sizes", "a plate 2 mm thin, 0.5 g, μ 0.3", "slips 467.50 mm (closed form)",
        lambda engine: _one(engine, (1.0, 0.6, 0.002), 3.0), _slips, quick=True,
    ),
    StressRow(
        "tiny_box", "Counts and sizes", "a cube of 1 mm, 0.5 g, μ 0.3",
        "slips 467.50 mm (closed form), and a warning asks whether the unit is right",
        lambda engine: _one(engine, (0.001, 0.001, 0.001), 1.0e-6),
        _is_warned_about("size"), quick=True,
    ),
    StressRow(
        "tiny_stack", "Counts and sizes", "three cubes of 1 mm on each other, at rest",
        "sink under 0.1 mm: contact tolerances are absolute in Bullet",
        lambda engine: [
            scene_of("tiny", column([(0.001, 0.001, 0.001)] * 3, [1.0e-6] * 3), still(1.0), engine=engine)
        ],
        _tiny_stack, quick=True,
    ),
    StressRow(
        "huge_box", "Counts and sizes", "a box of 5 m x 5 m x 1 m and 5 t, 0.5 g, μ 0.3",
        "slips 467.50 mm (closed form), and a warning asks whether the unit is right",
        lambda engine: _one(engine, (5.0, 5.0, 1.0), 5000.0),
        _is_warned_about("size"), quick=True,
    ),
    StressRow(
        "two_hundred", "Counts and sizes", "200 boxes, ten layers in columns, 0.1 g, μ 0.5",
        "nothing moves: 0.1 g < μg and < g·b/h = 0.24 g",
        lambda engine: [
            scene_of("two_hundred", block_of((5, 4, 10), (0.24, 0.19, 0.1), 5.0, gap_m=1.0e-3),
                     trapezoid(0.1, hold_s=0.3), engine=engine)
        ],
        _stays,
    ),
    StressRow(
        "pallet_0g", "Pallets", "40 cartons on a pallet, level 0", "nothing moves, passes",
        lambda engine: _pallet(engine, "sled.level_g=0"), _stays, may=("right",),
    ),
    StressRow(
        "pallet_2g", "Pallets", "40 cartons on a pallet at 2 g, nothing holds them",
        "fails: 2 g > μg = 0.5 g, the load slides by metres; every number finite",
        lambda engine: _pallet(engine, "sled.level_g=2"), _collapses,
    ),
    StressRow(
        "pallet_10g", "Pallets", "40 cartons on a pallet, 10 g for 0.08 s from a table",
        "fails: 10 g > μg; every number finite",
        lambda engine: _pallet(engine, TEN_G), _collapses,
    ),
    *(_overlap(depth, sideways) for sideways in (False, True) for depth in (0.1, 0.9, 5.0, 100.0)),
    *(_gap(gap) for gap in (0.5, 1.9, 10.0)),
)  # fmt: skip
"""The rows of this file."""
