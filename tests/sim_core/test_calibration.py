"""Hidden values recovered from displacement, with intervals that say how sure they are."""

import numpy as np
import pytest

from config.errors import RefusedInput
from config.scene import Scene
from config.scene_file import find_scene, read_scene
from sim_core.calibration import Calibration, calibrate
from sim_core.calibration_parameters import parameter_of, usual_parameters
from sim_core.calibration_runs import simulated_displacement
from sim_core.residual import MeasuredDisplacement, centres

SLED = 'sled={"profile": "table", "times_s": [0, 0.05, 0.3, 0.35, 0.6], "acceleration_mps2": [0, 4.9, 4.9, -5.9, 0]}'
FRICTION = "friction:cardboard/sled"


def block(friction: float) -> Scene:
    return read_scene(find_scene("block_slip"), [SLED, f"surfaces.pairs.0.friction={friction}"])


def measured(scene: Scene, *, sigma_m: float = 0.001, late_s: float = 0.0) -> MeasuredDisplacement:
    observed = centres(scene)
    times, displacement = simulated_displacement(scene, observed)
    noise = sigma_m * np.random.Generator(np.random.PCG64(1)).standard_normal(displacement.shape)
    return MeasuredDisplacement(
        observed, times + late_s, displacement + noise, np.full(displacement.shape, sigma_m)
    )


def fitted(scene: Scene, data: MeasuredDisplacement, *keys: str) -> Calibration:
    return calibrate(scene, data, [parameter_of(key, scene) for key in keys], workers=1)


def test_hidden_friction_and_clock_are_found() -> None:
    outcome = fitted(block(0.6), measured(block(0.27), late_s=0.004), FRICTION)
    (one,) = outcome.parameters
    assert one.value == pytest.approx(0.27, abs=0.002)
    assert one.low < 0.27 < one.high and one.high - one.low < 0.02 and one.is_resolved
    assert one.start == 0.6
    assert outcome.clock_offset_ms == pytest.approx(4.0, abs=1.0)
    assert outcome.rms_mm == pytest.approx(1.0, abs=0.1) and outcome.sigma_mm == pytest.approx(1.0)
    assert outcome.scene.surfaces.pairs[0].friction == one.value
    assert set(one.sigma_share) == {"chance", "jaggedness", "step"}
    assert not outcome.notes


def test_what_the_load_does_not_show_is_not_resolved() -> None:
    """A block that never slides says only that its friction is enough."""
    outcome = fitted(block(0.8), measured(block(0.9)), FRICTION)
    (one,) = outcome.parameters
    assert not one.is_resolved
    assert outcome.notes == [f"{FRICTION}: this displacement says too little about it"]


def test_what_no_value_explains_is_told() -> None:
    data, scene = measured(block(0.2)), block(0.3)
    backwards = MeasuredDisplacement(data.observed, data.times, -data.displacement, data.sigma)
    outcome = calibrate(scene, backwards, [parameter_of(FRICTION, scene)], workers=1, most_evaluations=8)
    assert any("times the measurement's uncertainty is left" in note for note in outcome.notes)


def test_unseen_values_do_not_count() -> None:
    data = measured(block(0.27))
    gaps = data.displacement.copy()
    gaps[20:60] = np.nan
    outcome = fitted(block(0.3), MeasuredDisplacement(data.observed, data.times, gaps, data.sigma), FRICTION)
    assert outcome.parameters[0].value == pytest.approx(0.27, abs=0.002)
    with pytest.raises(RefusedInput, match="no measured value is a number"):
        nothing = np.full(gaps.shape, np.nan)
        fitted(block(0.3), MeasuredDisplacement(data.observed, data.times, nothing, data.sigma), FRICTION)


def test_parameters_are_named_and_bounded() -> None:
    scene = block(0.3)
    assert parameter_of("friction:sled/cardboard=0.2..0.5", scene).bounds == (0.2, 0.5)
    assert parameter_of(FRICTION, scene).read(scene) == 0.3
    assert [parameter.key for parameter in usual_parameters(scene)] == ["friction:sled/cardboard"]
    held = read_scene(find_scene("eur_fields_05g"))
    tension, spread = usual_parameters(held)
    assert (tension.key, spread.key) == ("force_fields.tension", "force_fields.height_spread_m")
    doubled = tension.applied(held, 2.0)
    assert doubled.force_fields is not None and doubled.force_fields.tension == 2.0
    # A scale is fitted by its logarithm.
    assert tension.value(tension.fit_value(2.0)) == pytest.approx(2.0)
    wrapped = read_scene(find_scene("eur_wrap_lldpe"))
    assert [parameter.key for parameter in usual_parameters(wrapped)] == ["wrap.wrap_force_n"]


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("friction", "must be one of friction:A/B, force_fields.tension"),
        ("friction:cardboard/ice", "no surface 'ice' here; there are: cardboard, sled"),
        ("force_fields.tension", "the scene has no force_fields"),
        ("friction:cardboard/sled=0.5..0.2", "must be KEY or KEY=LOWER..UPPER"),
        ("friction:cardboard/sled=a..b", "must be KEY or KEY=LOWER..UPPER"),
        ("seed", "must be one of"),
    ],
)
def test_other_parameters_are_refused(text: str, problem: str) -> None:
    with pytest.raises(RefusedInput, match=problem):
        parameter_of(text, block(0.3))
