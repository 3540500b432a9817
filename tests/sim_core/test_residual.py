"""Measured against simulated displacement: paired in time, whatever comes first, and summed up by package."""

from collections.abc import Callable

import numpy as np
import pytest

from config.errors import RefusedInput
from config.scene import Scene
from sim_core.frames import Array, PoseFrame
from sim_core.residual import DisplacementResidual, centres, near_sides

MakeScene = Callable[..., Scene]


@pytest.fixture(scope="module")
def two(make_scene: MakeScene, box: Callable[..., dict[str, object]]) -> Scene:
    return make_scene(box("a"), box("b", bottom=0.394))


def frame(scene: Scene, index: int, shift: Array) -> PoseFrame:
    """The load as it was stacked, its packages shifted along x [m], shape [2]."""
    positions = np.array([(0.0, 0.0, 0.0), *(package.position_m for package in scene.packages)])
    positions[1:, 0] += shift
    return PoseFrame(index, 0, positions, np.tile([0.0, 0.0, 0.0, 1.0], (3, 1)))


def test_a_measurement_is_set_beside_the_line_between_two_frames(two: Scene) -> None:
    residual = DisplacementResidual(two, centres(two))
    assert residual.add_simulated(0.0, frame(two, 0, np.zeros(2))) == []
    measured = np.zeros((2, 1, 2))
    measured[1, 0, 0] = 0.007
    # It waits for the frame after it.
    assert residual.add_measured(0.25, measured, np.full((2, 1, 2), 0.001)) == []
    (difference,) = residual.add_simulated(1.0, frame(two, 1, np.array([0.0, 0.020])))
    # A quarter of the way to 20 mm.
    assert difference.simulated[:, 0, 0] == pytest.approx([0.0, 0.005])
    assert difference.difference[:, 0, 0] == pytest.approx([0.0, 0.002])
    assert difference.spots[1, 0] == pytest.approx([0.005, 0.0, 0.519])


def test_after_the_last_frame_the_load_stands(two: Scene) -> None:
    residual = DisplacementResidual(two, centres(two))
    residual.add_simulated(0.0, frame(two, 0, np.zeros(2)))
    residual.add_simulated(1.0, frame(two, 1, np.array([0.010, 0.0])))
    assert residual.add_measured(5.0, np.zeros((2, 1, 2)), np.full((2, 1, 2), 0.001)) == []
    (difference,) = residual.finish()
    assert difference.difference[0, 0, 0] == pytest.approx(-0.010)
    assert len(residual.add_measured(6.0, np.zeros((2, 1, 2)), np.full((2, 1, 2), 0.001))) == 1


def test_the_summary_names_the_package_that_differs_most(two: Scene) -> None:
    residual = DisplacementResidual(two, centres(two))
    for index in range(11):
        residual.add_simulated(0.1 * index, frame(two, index, np.zeros(2)))
    chance = np.random.Generator(np.random.PCG64(0))
    for index in range(10):
        measured = 0.001 * chance.standard_normal((2, 1, 2))
        measured[0] = np.nan if index < 5 else measured[0]
        measured[1, 0, 0] += 0.030 if index == 7 else 0.0
        residual.add_measured(0.1 * index, measured, np.full((2, 1, 2), 0.001))
    summary = residual.summary()
    assert summary["times"] == 10 and summary["points"] == 15
    assert summary["package"] == "b" and summary["largest_mm"] == pytest.approx(30.0, abs=4.0)
    assert summary["largest_at_s"] == pytest.approx(0.7)
    a, b = summary["packages"]
    # Of a there are five points of two components: 1 mm within three times 1/√20.
    assert a["points"] == 5 and a["rms_mm"] == pytest.approx(1.0, abs=0.7)
    assert b["beyond_share"] >= 0.05
    assert summary["rms_mm"] == pytest.approx(np.sqrt((5 * a["rms_mm"] ** 2 + 10 * b["rms_mm"] ** 2) / 15))


def test_what_was_never_seen_is_not_summed_up(two: Scene) -> None:
    residual = DisplacementResidual(two, centres(two))
    assert residual.summary() == {"times": 0, "packages": []} and residual.finish() == []
    residual.add_simulated(0.0, frame(two, 0, np.zeros(2)))
    residual.add_measured(0.0, np.full((2, 1, 2), np.nan), np.full((2, 1, 2), 0.001))
    assert residual.summary() == {"times": 1, "packages": []}


def test_sides_follow_the_packages(two: Scene) -> None:
    """Travel along +x is seen from its right, from -y: middle and corners of that side, to the right and up."""
    observed = near_sides(two, np.array([2]))
    assert observed.shape == (1, 5, 2)
    places = observed.places(frame(two, 0, np.array([0.0, 0.1])))
    assert places[0, 0] == pytest.approx([0.1, 0.519])
    assert places[0, 1] == pytest.approx([-0.1, 0.644])
    for rows in ([3], [0], []):
        with pytest.raises(RefusedInput, match="side faces the camera"):
            near_sides(two, np.array(rows, dtype=np.intp))
    with pytest.raises(RefusedInput, match="as in the first one"):
        DisplacementResidual(two, observed).add_measured(0.0, np.zeros((2, 5, 2)), np.zeros((2, 5, 2)))
