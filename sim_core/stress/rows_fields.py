"""Force fields from slack to rigid: one package against an own solution, a whole pallet against monotony."""

from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np

from config.scene import Scene
from config.scene_file import find_scene, read_scene
from sim_core.accuracy.closed_forms import field_motion_m
from sim_core.frames import GRAVITY
from sim_core.stress.loads import CARTON, box, scene_of, trapezoid
from sim_core.stress.model import Judgement, StressRow, Trial, within

LEVEL_G, FRICTION, MASS_KG = 0.5, 0.1, 10.0
DISTANCE_M, FALLOFF = 0.05, 2.0
ONE_PACKAGE_TENSIONS = (1e-3, 1e-1, 1.0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7)
QUICK_TENSIONS = (1e-1, 1e1, 1e3, 1e6)
PALLET_TENSIONS = (1e-3, 1.0, 1e1, 1e2, 1e3, 1e5, 1e7)
COMPARED_UNTIL_S = 1.2
SOLVED_UP_TO = 1.0e3
"""Above, a bound takes the solution's place: the field is then a rigid wall to within a micrometre or so."""


def _one_package(engine: str, *tensions: float) -> list[Scene]:
    return [
        scene_of(
            "field", [box("a", CARTON, MASS_KG)], trapezoid(LEVEL_G), engine=engine, friction=FRICTION,
            force_fields={"tension": tension, "distance_m": DISTANCE_M, "falloff": FALLOFF},
        )
        for tension in tensions
    ]  # fmt: skip


def _held_as_solved(tension: float) -> Callable[[Sequence[Trial]], Judgement]:
    peak_mps2 = LEVEL_G * GRAVITY

    def judge(trials: Sequence[Trial]) -> Judgement:
        trial = trials[0]
        times, along = trial.times_s(), np.abs(trial.moves()[:, 0, 0])
        if tension > SOLVED_UP_TO:
            # The slope at rest is k = 2pF/d with F = T/4·m·a, a sudden load moves by 2ma/k = 4d/(pT) at most.
            limit = 4.0 * DISTANCE_M / (FALLOFF * tension)
            return within(float(along.max()), limit + 1.0e-4, "peak")
        solved = field_motion_m(
            mass_kg=MASS_KG, strength_n=tension / 4.0 * MASS_KG * peak_mps2, distance_m=DISTANCE_M,
            falloff=FALLOFF, friction=FRICTION, knots_s=(0.0, 0.05, 0.55, 0.6),
            acceleration_mps2=(0.0, peak_mps2, peak_mps2, 0.0), end_s=COMPARED_UNTIL_S,
        )  # fmt: skip
        seen = times <= COMPARED_UNTIL_S + 1.0e-9
        exact = float(np.abs(np.interp(times[seen], solved[:, 0], solved[:, 1])).max())
        peak = float(along[seen].max())
        # A step of 0.3/ω keeps the peak of a spring within 1 %.
        bound = max(1.0e-4, 0.01 * exact)
        return within(abs(peak - exact), bound, f"peak {1e3 * peak:.3f} mm for {1e3 * exact:.3f} mm, error")

    return judge


def _tension_row(tension: float) -> StressRow:
    return StressRow(
        id=f"field_{tension:.0e}".replace("+0", "").replace("-0", "m"),
        group="Force fields",
        title=f"one package held by fields of tension {tension:g}, 0.5 g, μ 0.1",
        expected="peak within 1 % or 0.1 mm of an own solution of m·x'' = -ma - f(x) - friction"
        if tension <= SOLVED_UP_TO
        else "moves by 2ma/k = 4d/(pT) at most, to 0.1 mm",
        scenes=lambda engine: _one_package(engine, tension),
        judge=_held_as_solved(tension),
        quick=tension in QUICK_TENSIONS,
    )


def _pallets(engine: str) -> list[Scene]:
    return [
        read_scene(
            find_scene("eur_fields_05g"), [f"solver.engine={engine}", f"force_fields.tension={tension!r}"]
        )
        for tension in PALLET_TENSIONS
    ]


def _more_holds_better(trials: Sequence[Trial]) -> Judgement:
    """Peaks never rise with the tension by more than the tolerance; collapsed loads count as one class."""
    words, peaks = [], []
    for tension, trial in zip(PALLET_TENSIONS, trials, strict=True):
        if trial.refused is not None or trial.ended is not None:
            words.append(f"{tension:g}: {'refused' if trial.refused else 'ended'}")
            continue
        collapsed = trial.tips()
        words.append(f"{tension:g}: {'collapses' if collapsed else f'{1e3 * trial.peak_m():.2f} mm'}")
        peaks.append(np.inf if collapsed else trial.peak_m())
    rises = [b - a for a, b in pairwise(peaks) if b > a]
    worst = max(rises, default=0.0)
    tolerance = 1.0e-3
    return Judgement(worst <= tolerance, ", ".join(words), 1e3 * min(worst, 1e3), 1.0, "mm of rise")


FIELD_ROWS: tuple[StressRow, ...] = (
    *(_tension_row(tension) for tension in ONE_PACKAGE_TENSIONS),
    StressRow(
        "field_pallet", "Force fields", "40 cartons held by fields of tension 1e-3 to 1e7, 0.5 g",
        "more tension never moves the load more (1 mm); each run right, refused or ended",
        _pallets, _more_holds_better, partial=True,
    ),
)  # fmt: skip
"""The rows of this file."""
