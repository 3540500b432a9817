"""Sleds, frictions and time steps at their ends: closed forms that hold whatever the engine does."""

import math
from collections.abc import Callable, Sequence

import numpy as np

from config.scene import Scene
from config.scene_file import find_scene, read_scene
from sim_core.accuracy.closed_forms import slab_slips_m, trapezoid_slip_m
from sim_core.frames import GRAVITY, Array
from sim_core.sled import build_profile
from sim_core.stress.loads import FLAT, Raw, Size, box, scene_of, trapezoid
from sim_core.stress.model import Judgement, StressRow, Trial, within
from sim_core.stress.rows_stacks import CREEP_M, STILL_M, reference_bound_m

Judge = Callable[[Sequence[Trial]], Judgement]
OBLONG = (0.4, 0.3, 0.1)
TALL = (0.4, 0.3, 0.6)
CRITICAL_G = TALL[0] / TALL[2]
SLABS_AT_S = 1.2


def _flat(engine: str, sled: Raw, friction: float) -> list[Scene]:
    return [scene_of("block", [box("a", FLAT, 10.0)], sled, engine=engine, friction=friction)]


def _slip_is(exact_m: float) -> Judge:
    """The block's slip along x at the end, against a closed form [m], with its sideways drift and its height."""

    def judge(trials: Sequence[Trial]) -> Judgement:
        moved = trials[0].moves()[-1, 0]
        error = float(np.linalg.norm(moved - np.array([-exact_m, 0.0, 0.0])))
        return within(
            error,
            reference_bound_m(exact_m),
            f"slip {-1e3 * moved[0]:.3f} mm for {1e3 * exact_m:.3f} mm, error",
        )

    return judge


def _stays_within(bound_m: float) -> Judge:
    def judge(trials: Sequence[Trial]) -> Judgement:
        return within(max(trial.peak_m() for trial in trials), bound_m, "largest corner displacement")

    return judge


def _slip_row(
    name: str, title: str, sled: Raw, friction: float, exact_m: float, *, why: str, quick: bool = True
) -> StressRow:
    return StressRow(
        id=name,
        group="Sled",
        title=title,
        expected=f"slips {1e3 * exact_m:.2f} mm: {why}",
        scenes=lambda engine: _flat(engine, sled, friction),
        judge=_slip_is(exact_m),
        quick=quick,
    )


def rectangle_slip_m(level_g: float, hold_s: float, friction: float, braking_g: float = 0.0) -> float:
    """Slip on a sled at a constant level that then brakes at a rate below μg, both at once [m].

    ½(A − μg)t² while the level holds, then the relative speed (A − μg)t falls at μg + d.
    """
    excess = (level_g - friction) * GRAVITY
    return 0.5 * excess * hold_s**2 + (excess * hold_s) ** 2 / (2.0 * (friction + braking_g) * GRAVITY)


def _keeps_speed(trials: Sequence[Trial]) -> Judgement:
    """Without friction the block stands still in the world: it moves by minus the sled's travel."""
    trial = trials[0]
    profile = build_profile(trial.scene)
    travel = np.array([profile.state(float(t))[2] for t in trial.times_s()])
    error = float(np.abs(trial.moves()[:, 0] + travel).max())
    return within(error, reference_bound_m(float(travel[-1, 0])), "furthest from its place in the world")


def _classes(engine: str, friction: float, shares: Sequence[float], *, hold_s: float) -> list[Scene]:
    return [
        scene_of(
            "tall", [box("a", TALL, 10.0)], trapezoid(CRITICAL_G * share, hold_s=hold_s), engine=engine,
            friction=friction,
        )
        for share in shares
    ]  # fmt: skip


def _flips_at_critical(shares: Sequence[float]) -> Judge:
    """The class flips once, between the last level below a_crit and the first above."""

    def judge(trials: Sequence[Trial]) -> Judgement:
        tips = [bool(trial.frames) and trial.tips() for trial in trials]
        wanted = [share > 1.0 for share in shares]
        words = ", ".join(f"{s:.4f} {'tips' if t else 'stands'}" for s, t in zip(shares, tips, strict=True))
        ends = "".join(f"; {trial.ended}" for trial in trials if trial.ended)
        return Judgement(tips == wanted, f"a/a_crit {words}{ends}")

    return judge


def _slabs(engine: str, *steps_s: float) -> list[Scene]:
    scenes = []
    for step in steps_s:
        poses = min(240, round(1.0 / step))
        settings = [f"solver.engine={engine}", f"solver.time_step_s={step!r}", f"sampling.poses_hz={poses}"]
        scenes.append(read_scene(find_scene("slabs"), settings))
    return scenes


def _slab_error_m(trial: Trial) -> float:
    """Largest error of any slab's slip at 1.2 s [m]."""
    exact = slab_slips_m([100, 80, 60, 40, 20], [0.5, 0.4, 0.3, 0.2, 0.1], 0.45, 0.05, 0.4, SLABS_AT_S)
    frame = int(np.argmin(np.abs(trial.times_s() - SLABS_AT_S)))
    return float(np.abs(trial.moves()[frame, :, 0] + exact).max())


def _order(trials: Sequence[Trial]) -> Judgement:
    steps = np.array([trial.scene.time_step_s for trial in trials])
    errors = np.array([_slab_error_m(trial) for trial in trials])
    slope = float(np.polyfit(np.log(steps), np.log(np.maximum(errors, 1.0e-9)), 1)[0])
    told = ", ".join(f"1/{1.0 / s:.0f} {1e3 * e:.3f} mm" for s, e in zip(steps, errors, strict=True))
    return Judgement(slope >= 1.7, f"order {slope:.2f} (bound 1.7): {told}", slope, 1.7, "order, at least")


def _slabs_right(trials: Sequence[Trial]) -> Judgement:
    return within(_slab_error_m(trials[0]), reference_bound_m(1.1874), "largest slip error")


def _no_sideways_drift(trials: Sequence[Trial]) -> Judgement:
    return within(float(np.abs(trials[0].moves()[:, :, 1]).max()), CREEP_M, "largest sideways drift")


def _goes_the_sleds_way(direction_deg: float) -> Judge:
    """Direction and length of the slip of a block on the default trapezoid at 0.5 g and μ 0.3."""
    exact = trapezoid_slip_m(0.5, 0.05, 0.5, 0.3)
    turn = math.radians(direction_deg)
    wanted = exact * np.array([math.cos(turn), math.sin(turn), 0.0])

    def judge(trials: Sequence[Trial]) -> Judgement:
        moved: Array = -trials[0].moves()[-1, 0]
        angle = math.degrees(math.atan2(moved[1], moved[0])) - direction_deg
        slip = 1e3 * float(np.linalg.norm(moved))
        words = f"slides {angle:+.2f}° off its way, slip {slip:.2f} mm for {1e3 * exact:.2f} mm, error"
        return within(float(np.linalg.norm(moved - wanted)), reference_bound_m(exact), words)

    return judge


def _diagonal_row(name: str, what: str, size_m: Size, *, direction_deg: float, yaw_deg: float) -> StressRow:
    return StressRow(
        id=name,
        group="Friction",
        title=f"{what}, 0.5 g, μ 0.3",
        expected="goes the sled's way (Coulomb friction has no direction of its own) and slips 467.50 mm",
        scenes=lambda engine: [
            scene_of(
                "diagonal",
                [box("a", size_m, 10.0, yaw_deg=yaw_deg)],
                trapezoid(0.5, direction=direction_deg),
                engine=engine,
                friction=0.3,
            )
        ],
        judge=_goes_the_sleds_way(direction_deg),
        may=("right",),
        quick=True,
    )


TABLE = {("a", "sled"): 0.3, ("b", "sled"): 0.2, ("a", "b"): 0.6, ("a", "a"): 0.25}


def _unmet_table(engine: str) -> list[Scene]:
    flat = (0.6, 0.4, 0.1)
    boxes = [
        box("a", flat, 10.0, y=-1.0, surface="a"),
        box("b", flat, 10.0, y=1.0, surface="b"),
        box("a_low", (4.0, 0.8, 0.1), 100.0, surface="a"),
        box("a_high", flat, 10.0, x=-1.0, base_m=0.1, surface="a"),
        box("b_high", flat, 10.0, x=1.0, base_m=0.1, surface="b"),
    ]
    return [scene_of("unmet", boxes, trapezoid(0.5), engine=engine, pairs=TABLE)]


def _table_met_or_told(trials: Sequence[Trial]) -> Judgement:
    trial = trials[0]
    errors = []
    for name, friction in (("a", 0.3), ("b", 0.2)):
        exact = trapezoid_slip_m(0.5, 0.05, 0.5, friction)
        slip = -float(trial.moves()[-1, trial.row(name) - 1, 0])
        errors.append(abs(slip - exact) / reference_bound_m(exact))
    unmet = trial.finished.physics.unmet_friction
    told = f"told: {'; '.join(unmet)}" if unmet else "every pair met"
    return Judgement(
        bool(unmet) or max(errors) <= 1.0,
        f"{told}; slip error {max(errors):.3g} x its bound",
        max(errors),
        1.0,
        "x",
    )


def _unnamed_pair(engine: str) -> list[Scene]:
    boxes = [box("a", FLAT, 10.0, x=0.31, surface="a"), box("b", FLAT, 10.0, x=-0.31, surface="b")]
    pairs = {("a", "sled"): 0.5, ("b", "sled"): 0.1}
    return [scene_of("unnamed", boxes, trapezoid(0.3), engine=engine, pairs=pairs)]


def _unnamed_told(trials: Sequence[Trial]) -> Judgement:
    finished = trials[0].finished
    told = [f for f in finished.findings if f.check == "friction"]
    words = [*finished.physics.unmet_friction, *(f"{f.check} of {f.subject}: {f.limit}" for f in told)]
    return Judgement(bool(words), "; ".join(words) or "nothing says that a on b has no friction of its own")


def _ran_anyway(trials: Sequence[Trial]) -> Judgement:
    trial = trials[0]
    travel = build_profile(trial.scene).state(float(trial.times_s()[-1]))[2][0]
    error = abs(float(trial.moves()[-1, 0, 0]) + travel)
    return within(error, reference_bound_m(travel), "no monitor spoke; the free block's place is off by")


_SLOPE = math.tan(math.radians(30.0))

SLED_ROWS: tuple[StressRow, ...] = (
    _slip_row("sled_2g", "2 g for 0.1 s, μ 0.3", trapezoid(2.0, hold_s=0.1), 0.3,
              trapezoid_slip_m(2.0, 0.05, 0.1, 0.3), why="closed form of the trapezoid"),
    _slip_row("sled_10g", "10 g for 0.04 s, μ 0.3", trapezoid(10.0, rise_s=0.01, hold_s=0.04), 0.3,
              trapezoid_slip_m(10.0, 0.01, 0.04, 0.3), why="closed form of the trapezoid"),
    _slip_row("sled_reversed", "the pulse reversed, -0.5 g, μ 0.3", trapezoid(-0.5), 0.3,
              -trapezoid_slip_m(0.5, 0.05, 0.5, 0.3), why="mirror image of the pulse forwards"),
    _slip_row("sled_rise_0", "EUMOS profile with rise 0 and fall 0: 0.5 g at once, then -0.2 g, μ 0.3",
              {"profile": "eumos", "level_g": 0.5, "rise_s": 0.0, "fall_s": 0.0, "plateau_s": 0.5}, 0.3,
              rectangle_slip_m(0.5, 0.5, 0.3, 0.2), why="½(A - μg)t² + ((A - μg)t)²/(2(μg + d))"),
    _slip_row("sled_long_slide", "EUMOS profile, 2 g for 0.6 s, μ 0.3: slides by 13 m",
              {"profile": "eumos", "level_g": 2.0, "rise_s": 0.0, "fall_s": 0.0, "plateau_s": 0.6}, 0.3,
              rectangle_slip_m(2.0, 0.6, 0.3, 0.2), why="½(A - μg)t² + ((A - μg)t)²/(2(μg + d))"),
    StressRow(
        "off_the_platform", "Sled", "10 g for 0.45 s without friction: further than any platform reaches",
        "keeps its place in the world and its height, or the run ends where the modelled platform does",
        lambda engine: _flat(engine, trapezoid(10.0, rise_s=0.0, hold_s=0.45), 0.0), _keeps_speed, quick=True,
    ),
    StressRow(
        "sled_0g", "Sled", "level 0", "nothing moves, the verdict is pass",
        lambda engine: _flat(engine, {"profile": "eumos", "level_g": 0.0}, 0.3), _stays_within(1.0e-5),
        may=("right",), quick=True,
    ),
    StressRow(
        "speed_clamp", "Sled", "1000 m/s² for 0.2 s without friction: 200 m/s relative to the sled",
        "Bullet clamps each velocity at 100 m/s in silence; the speed monitor must end it",
        lambda engine: [
            scene_of("clamp", [box("a", FLAT, 10.0)],
                     {"profile": "table", "times_s": [0.0, 0.2], "acceleration_mps2": [1000.0, 1000.0]},
                     engine=engine, friction=0.0)
        ],
        _ran_anyway, may=("ended",), quick=True,
    ),
    StressRow(
        "friction_0", "Friction", "μ 0, 0.5 g", "keeps its speed in the world exactly: moves by minus the travel",
        lambda engine: _flat(engine, trapezoid(0.5, hold_s=0.1), 0.0), _keeps_speed, may=("right",), quick=True,
    ),
    StressRow(
        "friction_1_5", "Friction", "μ 1.5, a box of b/h = 2/3 at 0.98 and 1.02 of g·b/h",
        "tips before it slides, at a_crit = g·b/h = 0.667 g",
        lambda engine: _classes(engine, 1.5, (0.98, 1.02), hold_s=1.5), _flips_at_critical((0.98, 1.02)),
        may=("right",), quick=True, partial=True,
    ),
    StressRow(
        "friction_10", "Friction", "μ 10 on a flat box of b/h = 12, 8 g", "sticks: 8 g < μg = 10 g",
        lambda engine: [
            scene_of("grip", [box("a", (1.2, 1.2, 0.1), 10.0)], trapezoid(8.0, hold_s=0.1), engine=engine,
                     friction=10.0)
        ],
        _stays_within(STILL_M), quick=True,
    ),
    StressRow(
        "friction_11", "Friction", "μ 11", "refused: Bullet caps the product at 10 in silence",
        lambda engine: _flat(engine, trapezoid(0.5), 11.0), _stays_within(0.0), may=("refused",), quick=True,
    ),
    StressRow(
        "friction_product", "Friction", "a on sled 10, b on sled 0.05, and b on a 10: factors of 10 and more",
        "a sticks at 5 g: each body's factor may pass 10, the product of a pair that meets does not",
        lambda engine: [
            scene_of("product", [box("a", (1.2, 1.2, 0.1), 100.0, surface="a"),
                                 box("b", (0.6, 0.6, 0.05), 5.0, base_m=0.1, surface="b")],
                     trapezoid(5.0, hold_s=0.1), engine=engine,
                     pairs={("a", "sled"): 10.0, ("b", "sled"): 0.05, ("a", "b"): 10.0})
        ],
        _stays_within(STILL_M), quick=True,
    ),
    StressRow(
        "friction_table", "Friction", "a friction table that one factor a surface cannot give",
        "slips right, or the pairs that are not met are told",
        _unmet_table, _table_met_or_told, quick=True,
    ),
    StressRow(
        "friction_unnamed", "Friction", "side by side, 20 mm apart: two surfaces whose pair has no friction",
        "they meet; that no friction is known for the pair is told",
        _unnamed_pair, _unnamed_told, quick=True,
    ),
    StressRow(
        "slope_below", "Friction", "a slope of 30° as a level of tan 30°, μ 1 % under tan 30°",
        "slides by ½(A - μg)t² + ((A - μg)t)²/(2μg)",
        lambda engine: _flat(engine, trapezoid(_SLOPE, rise_s=0.0, hold_s=1.0), 0.99 * _SLOPE),
        _slip_is(rectangle_slip_m(_SLOPE, 1.0, 0.99 * _SLOPE)), may=("right",), quick=True,
    ),
    StressRow(
        "slope_above", "Friction", "the same slope, μ 1 % over tan 30°", "sticks, creep under 0.1 mm",
        lambda engine: _flat(engine, trapezoid(_SLOPE), 1.01 * _SLOPE), _stays_within(CREEP_M), quick=True,
    ),
    StressRow(
        "stick_10s", "Friction", "sticking at 0.45 g of μg = 0.5 g for 10 s", "creep under 0.1 mm",
        lambda engine: _flat(engine, trapezoid(0.45, hold_s=10.0), 0.5), _stays_within(CREEP_M),
    ),
    _diagonal_row("diagonal_square", "a square box slides at 45°", (0.4, 0.4, 0.1), direction_deg=45.0, yaw_deg=0.0),
    _diagonal_row("diagonal_4_3", "a 4:3 box slides at 45°", OBLONG, direction_deg=45.0, yaw_deg=0.0),
    _diagonal_row("diagonal_along", "a 4:3 box slides lengthways at 30°", OBLONG, direction_deg=30.0, yaw_deg=30.0),
    _diagonal_row("yawed", "a 4:3 box turned by 30° slides along x", OBLONG, direction_deg=0.0, yaw_deg=30.0),
    StressRow(
        "tie_break", "Tipping", "a box at a_crit (1 ± 1e-3) and (1 ± 1e-4) for 4 s",
        "stands below a_crit = g·b/h, tips above: the class flips once",
        lambda engine: _classes(engine, 1.0, (0.999, 0.9999, 1.0001, 1.001), hold_s=4.0),
        _flips_at_critical((0.999, 0.9999, 1.0001, 1.001)), partial=True,
    ),
    StressRow(
        "step_order", "Time step", "the five slabs at 1/60, 1/120, 1/240 and 1/480 s",
        "second order: fitted order at least 1.7 against an own solution",
        lambda engine: _slabs(engine, 1 / 60, 1 / 120, 1 / 240, 1 / 480), _order, may=("right",), engines=("bullet",),
    ),
    StressRow(
        "step_default", "Time step", "the five slabs at the default step", "every slip within 0.05 %",
        lambda engine: _slabs(engine, 1 / 480), _slabs_right, may=("right",), quick=True,
    ),
    StressRow(
        "step_tenth", "Time step", "the five slabs at a tenth of the default step", "every slip within 0.05 %",
        lambda engine: _slabs(engine, 1 / 4800), _slabs_right, may=("right",),
    ),
    StressRow(
        "step_x10", "Time step", "the five slabs at ten times the default step", "right, or refused",
        lambda engine: _slabs(engine, 10 / 480), _slabs_right, quick=True,
    ),
    StressRow(
        "step_x100", "Time step", "the five slabs at a hundred times the default step", "right, or refused",
        lambda engine: _slabs(engine, 100 / 480), _slabs_right, quick=True,
    ),
    StressRow(
        "sideways_drift", "Time step", "the five slabs: sideways drift of a straight run", "under 0.1 mm",
        lambda engine: _slabs(engine, 1 / 480), _no_sideways_drift, may=("right",), quick=True,
    ),
)  # fmt: skip
"""The rows of this file."""
