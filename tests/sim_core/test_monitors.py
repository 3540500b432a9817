"""What a run watches in itself, what it does on a breach, and the energy ledger against closed forms."""

from typing import Any

import numpy as np
import pytest

from config.errors import EndedByMonitor
from config.scene import Scene
from config.scene_file import find_scene, read_scene, validate_scene
from sim_core.engines import ContactState
from sim_core.frames import PoseFrame
from sim_core.load_test import LoadTest
from sim_core.monitors import MAXIMUM_STEP_PHASE, Monitors
from sim_core.run import run_test
from sim_core.sled import sled_samples
from tests.sim_core.scenes import run_shipped

GRAVITY = 9.81


def monitors() -> Monitors:
    return Monitors(["pallet", "a"], np.array([0.0, 0.2]))


def test_motion_names_the_body() -> None:
    still = np.zeros((2, 3))
    assert monitors().motion(still, still, still) is None
    lost = still.copy()
    lost[1, 0] = np.nan
    for arguments in ((lost, still, still), (still, lost, still), (still, still, lost)):
        breach = monitors().motion(*arguments)
        assert breach is not None and breach.monitor == "finite state" and breach.reason.startswith("a ")
    fast = still.copy()
    fast[1, 1] = 50.1
    breach = monitors().motion(still, fast, still)
    assert breach is not None and breach.monitor == "speed" and "50.1 m/s" in breach.reason


def test_an_impact_passes_and_a_sinking_load_does_not() -> None:
    watch = monitors()
    deep, fine = (ContactState(4, share * 0.2, share, ("pallet", "a")) for share in (0.021, 0.019))
    assert [watch.contacts(state, 0.0) for state in (deep, deep, fine, deep, deep)] == [None] * 5
    breach = watch.contacts(deep, 0.0)
    assert breach is not None and breach.monitor == "penetration"
    assert watch.extremes.penetration_m == 0.021 * 0.2


HIGH, LOW = 2.0, 0.5


@pytest.mark.parametrize(
    ("residuals", "breached_at"),
    [
        # The word of ten checks is needed, however large the first are.
        ([HIGH] * 10, 9),
        ([1.0e6] * 9, None),
        # One blow, or four, are none of ten; of five the median is the mean of both sides, 1.25.
        ([LOW] * 5 + [1.0e6] + [LOW] * 20, None),
        ([LOW] * 6 + [HIGH] * 4 + [LOW] * 10, None),
        ([LOW] * 10 + [HIGH] * 5, 14),
        ([LOW] * 10 + [HIGH] * 4 + [LOW] * 10, None),
        # What is not above the limit is allowed.
        ([1.0] * 30, None),
    ],
)
def test_what_stays_unsolved_is_a_breach_and_a_blow_is_not(
    residuals: list[float], breached_at: int | None
) -> None:
    watch = monitors()
    breaches = [watch.unsolved(residual, 1.0) for residual in residuals]
    assert next((k for k, breach in enumerate(breaches) if breach is not None), None) == breached_at
    if breached_at is not None:
        breach = breaches[breached_at]
        assert breach is not None and breach.monitor == "residual" and "limit 1" in breach.reason


def test_after_a_roll_back_the_residuals_are_counted_anew() -> None:
    watch = monitors()
    for _ in range(2):
        assert [watch.unsolved(HIGH, 1.0) for _ in range(9)] == [None] * 9
        watch.forget_recent()
    assert [watch.unsolved(HIGH, 1.0) is not None for _ in range(10)] == [False] * 9 + [True]


def creeping(**parts: Any) -> Scene:
    """Five boxes of 10 kg on each other, with ten iterations a step: too few for Gauss-Seidel."""
    boxes = [
        {"id": f"box_{k}", "size_m": [0.4, 0.3, 0.25], "mass_kg": 10, "position_m": [0, 0, 0.269 + 0.25 * k]}
        for k in range(5)
    ]
    solver = {"iterations": 10, **parts.pop("solver", {})}
    sled = {"profile": "eumos", "level_g": 0.2}
    return validate_scene(
        {"name": "five", "load": {"packages": boxes}, "solver": solver, "sled": sled, **parts}
    )


def halvings_of(scene: Scene, **options: Any) -> list[str]:
    test = LoadTest(scene, **options)
    try:
        for sample in sled_samples(scene):
            test.take(sample)
            if test.finished:
                break
        return test.halvings
    finally:
        test.close()


def test_a_solver_that_creeps_is_given_a_smaller_step() -> None:
    (halving,) = halvings_of(creeping())
    assert ": residual: the solver leaves " in halving and "limit 0.0002" in halving
    # Enough iterations need no halving, nor does a run that is meant to be coarse, nor a Newton solver.
    assert halvings_of(creeping(solver={"iterations": 80})) == []
    assert halvings_of(creeping(), with_residual_monitor=False) == []
    assert halvings_of(creeping(solver={"engine": "mujoco"})) == []


def test_a_solver_that_creeps_on_a_loose_pallet_is_given_a_smaller_step() -> None:
    assert "residual" in halvings_of(creeping(pallet={"kind": "epal1", "fixed": False}))[0]


def fields_scene(tension: float, **parts: Any) -> Scene:
    return validate_scene(
        {
            "name": "fields",
            "load": {
                "packages": [
                    {"id": "a", "size_m": [0.4, 0.3, 0.25], "mass_kg": 10, "position_m": [0, 0, 0.269]}
                ]
            },
            "force_fields": {"tension": tension},
            "sled": {"profile": "eumos", "level_g": 0.8},
            **parts,
        }
    )


def test_a_stiff_spring_halves_the_step() -> None:
    # ω at rest = √(2·p·F/(d·m)) with F = T/4·m·a: 56 rad/s at T = 20, so 1/480 s is 0.12 of the phase; nearer
    # to the plane the spring is up to 4³/2 times stiffer.
    result = run_test(fields_scene(20.0))
    assert result.ended_by is None
    assert result.physics.halvings == [] or result.physics.step_phase > MAXIMUM_STEP_PHASE
    stiff = run_test(fields_scene(400.0))
    assert stiff.ended_by is None
    assert stiff.physics.halvings and "stiffness" in stiff.physics.halvings[0]
    assert stiff.physics.smallest_step_s == pytest.approx(1.0 / 480.0 / 2 ** len(stiff.physics.halvings))


def test_a_spring_too_stiff_for_any_step_ends_the_run() -> None:
    result = run_test(fields_scene(1.0e7))
    assert result.ended_by is not None and result.ended_by.monitor == "stiffness"
    assert len(result.physics.halvings) == 3
    assert "would do" in str(result.ended_by)


def test_a_finer_start_needs_no_halving() -> None:
    scene = fields_scene(400.0, solver={"time_step_s": 1.0 / 3840}, sampling={"samples_hz": 3840})
    result, halved = run_test(scene), run_test(fields_scene(400.0))
    assert result.physics.halvings == []
    peaks = [{r.rule: r.worst_mm for r in found.judge.rules()}["elastic"] for found in (result, halved)]
    assert peaks[0] == pytest.approx(peaks[1], abs=0.1)


def frames_of(scene: Scene) -> list[PoseFrame]:
    test, frames = LoadTest(scene), []
    try:
        for sample in sled_samples(scene):
            frame = test.take(sample)
            if frame is not None:
                frames.append(frame)
            if test.finished:
                return frames
    finally:
        test.close()
    raise AssertionError("the samples never end")


def test_a_rolled_back_run_repeats_bit_for_bit() -> None:
    first, second = frames_of(fields_scene(400.0)), frames_of(fields_scene(400.0))
    assert len(first) == len(second)
    for one, other in zip(first, second, strict=True):
        np.testing.assert_array_equal(one.positions, other.positions)
        assert one.stamp_ns == other.stamp_ns


def test_a_load_that_stands_on_nothing_sound_is_ended() -> None:
    scene = validate_scene(
        {
            "name": "heavy-on-light",
            "load": {
                "packages": [
                    {"id": "light", "size_m": [0.4, 0.4, 0.2], "mass_kg": 0.5, "position_m": [0, 0, 0.1]},
                    {"id": "heavy", "size_m": [0.4, 0.4, 0.2], "mass_kg": 4000, "position_m": [0, 0, 0.3]},
                ]
            },
            "pallet": None,
            "sled": {"profile": "eumos", "level_g": 0.3},
        }
    )
    result = run_test(scene)
    assert isinstance(result.ended_by, EndedByMonitor)


def test_friction_takes_what_the_ledger_says() -> None:
    scene = read_scene(find_scene("block_slip"))
    test = LoadTest(scene)
    try:
        for sample in sled_samples(scene):
            test.take(sample)
            if test.finished:
                break
        # Friction μ·m·g over the slip of 0.46749964 m; the ledger integrates it frame by frame.
        assert test._ledger._dissipated == pytest.approx(0.3 * 10.0 * GRAVITY * 0.46749964, rel=1.0e-3)
        assert test.extremes.energy_residual < 1.0e-4
    finally:
        test.close()


@pytest.mark.parametrize("name", ["slabs", "eur_fields_05g", "eur_columns"])
def test_no_energy_comes_from_nowhere(name: str) -> None:
    assert run_shipped(name).physics.energy_residual < 0.02
