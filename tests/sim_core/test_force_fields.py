"""The perimeter force fields against their formula by hand, and their symmetries."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from config.scene import Scene
from sim_core.force_fields import PerimeterForceFields
from sim_core.frames import Array
from sim_core.geometry import yaw_quaternion

MakeScene = Callable[..., Scene]
Box = Callable[..., dict[str, Any]]
PEAK = 0.5 * 9.81


def settled_poses(scene: Scene) -> tuple[Array, Array]:
    turns = [yaw_quaternion(package.yaw_deg) for package in scene.packages]
    positions = np.array([(0.0, 0.0, 0.072), *(package.position_m for package in scene.packages)])
    return positions, np.array([(0.0, 0.0, 0.0, 1.0), *turns])


def fields_of(scene: Scene) -> PerimeterForceFields:
    assert scene.force_fields is not None
    return PerimeterForceFields(scene.force_fields, scene, PEAK, *settled_poses(scene))


def force_at(scene: Scene, *shift: float) -> Array:
    """Forces when every package is moved by one shift."""
    positions, orientations = settled_poses(scene)
    positions[1:] += shift
    return fields_of(scene).forces(positions, orientations)


@pytest.fixture(scope="module")
def one(make_scene: MakeScene, box: Box) -> Scene:
    return make_scene(box("a"), force_fields={"tension": 1.5, "distance_m": 0.05, "falloff": 2.0})


@pytest.fixture(scope="module")
def stack(make_scene: MakeScene, box: Box) -> Scene:
    boxes = [box(f"{k}", bottom=0.144 + 0.25 * k, mass=10.0 + k) for k in range(5)]
    return make_scene(*boxes, force_fields={"tension": 1.0, "height_spread_m": 0.4})


@settings(max_examples=40, deadline=None)
@given(
    places=st.lists(
        st.tuples(st.floats(-0.4, 0.4), st.floats(-0.3, 0.3), st.floats(0.0, 1.0)), min_size=1, max_size=6
    ),
    yaw=st.floats(-180.0, 180.0),
)
def test_the_settled_load_feels_nothing(
    make_scene: MakeScene, box: Box, places: list[tuple[float, float, float]], yaw: float
) -> None:
    boxes = [box(f"{k}", x=x, y=y, bottom=z, yaw_deg=yaw) for k, (x, y, z) in enumerate(places)]
    assert not force_at(make_scene(*boxes, force_fields={}), 0.0, 0.0, 0.0).any()


@pytest.mark.parametrize("shift", [0.001, 0.02, 0.0374, -0.03])
def test_the_strength_by_hand(one: Scene, shift: float) -> None:
    """F_base = T/4·m·a = 1.5/4·10·4.905 N; the near plane is at d − s, the far one at d + s, φ(r) = (d/r)²."""
    base, d = 1.5 / 4.0 * 10.0 * PEAK, 0.05
    expected = base * ((d / (d + shift)) ** 2 - (d / (d - shift)) ** 2)
    force = force_at(one, shift, 0.0, 0.0)
    # The gap d − s is a difference of positions of about 0.25 m: a relative rounding of 0.25·1e-16/12e-3.
    assert force[1] == pytest.approx([expected, 0.0, 0.0], rel=1.0e-13, abs=1.0e-12)
    assert not force[0].any()


@pytest.mark.parametrize("axis", [0, 1])
def test_beyond_a_quarter_of_the_distance_the_press_is_full(one: Scene, axis: int) -> None:
    base = 1.5 / 4.0 * 10.0 * PEAK
    for shift in (0.0375, 0.05, 0.4):
        moved = np.zeros(3)
        moved[axis] = shift
        far = (0.05 / (0.05 + shift)) ** 2
        assert force_at(one, *moved)[1, axis] == pytest.approx(-base * (16.0 - far), rel=1.0e-12)


@settings(max_examples=60, deadline=None)
@given(x=st.floats(-0.2, 0.2), y=st.floats(-0.2, 0.2), z=st.floats(-0.2, 0.2))
def test_forces_restore_and_are_odd(stack: Scene, x: float, y: float, z: float) -> None:
    forces, mirrored = force_at(stack, x, y, z), force_at(stack, -x, -y, z)
    largest = max(1.0, float(np.abs(forces).max()))
    # φ reaches 16 from a gap of 12.5 mm, known to 1e-16 m: 1e-14 of the largest force.
    assert mirrored == pytest.approx(-forces, abs=1.0e-12 * largest)
    assert not forces[:, 2].any()
    for axis, shift in ((0, x), (1, y)):
        if abs(shift) > 1.0e-9:
            assert (forces[1:, axis] * shift < 0.0).all()


@settings(max_examples=30, deadline=None)
@given(shift=st.floats(-0.037, 0.037), tension=st.floats(0.01, 100.0))
def test_forces_scale_with_the_tension_and_add_up_to_the_base(
    make_scene: MakeScene, box: Box, stack: Scene, shift: float, tension: float
) -> None:
    """Shares over the height add up to 1, so the whole load feels T/4·Σm·a·[φ − φ⁰], whatever σ_h is."""
    boxes = [box(f"{k}", bottom=0.144 + 0.25 * k, mass=10.0 + k) for k in range(5)]
    scene = make_scene(*boxes, force_fields={"tension": tension, "height_spread_m": 0.4})
    forces = force_at(scene, shift, 0.0, 0.0)
    assert forces == pytest.approx(tension * force_at(stack, shift, 0.0, 0.0), rel=1.0e-12, abs=1.0e-12)
    press = (0.05 / (0.05 + shift)) ** 2 - (0.05 / (0.05 - shift)) ** 2
    assert forces[:, 0].sum() == pytest.approx(tension / 4.0 * 60.0 * PEAK * press, rel=1.0e-11, abs=1.0e-11)


def test_the_height_spread_is_a_bell(stack: Scene) -> None:
    """Centres lie 0.25 m apart about the middle one: w ∝ exp(−Δz²/(2·0.4²))."""
    forces = force_at(stack, 0.01, 0.0, 0.0)[1:, 0]
    for k, dz in enumerate((-0.5, -0.25, 0.0, 0.25, 0.5)):
        assert forces[k] / forces[2] == pytest.approx(math.exp(-(dz**2) / 0.32), rel=1.0e-12)


def test_planes_stand_around_the_whole_load(make_scene: MakeScene, box: Box) -> None:
    """A box inside the perimeter is farther from the planes: φ falls with the distance from plane to box."""
    scene = make_scene(
        box("west", x=-0.4), box("east", x=0.4), box("middle"), force_fields={"distance_m": 0.1}
    )
    base, s = 1.0 / 4.0 * 30.0 * PEAK / 3.0, 0.05
    forces = force_at(scene, s, 0.0, 0.0)[:, 0]

    def press(gap: float) -> float:
        return (0.1 / gap) ** 2

    near, far = press(0.1 - s) - press(0.1), press(0.9 + s) - press(0.9)
    assert forces[2] == pytest.approx(-base * (near - far), rel=1.0e-12)
    assert forces[1] == pytest.approx(
        -base * (press(0.9 - s) - press(0.9) - press(0.1 + s) + press(0.1)), rel=1.0e-12
    )
    assert forces[3] == pytest.approx(-base * (press(0.5 - s) - press(0.5 + s)), rel=1.0e-12)


def test_a_turn_presses_where_the_corner_comes_out(make_scene: MakeScene, box: Box) -> None:
    """A box turned about its own axis reaches out on both sides alike: no net force, by symmetry."""
    scene = make_scene(
        box("a", size=(0.3, 0.3, 0.3)), box("b", x=-0.3, size=(0.3, 0.3, 0.3)), force_fields={}
    )
    positions, orientations = settled_poses(scene)
    orientations[1] = yaw_quaternion(15.0)
    forces = fields_of(scene).forces(positions, orientations)
    reach = 0.15 * (math.cos(math.radians(15.0)) + math.sin(math.radians(15.0))) - 0.15
    base = 20.0 / 4.0 * PEAK / 2.0

    def press(gap: float) -> float:
        return (0.05 / max(gap, 0.0125)) ** 2

    # Box a stands at the +x plane, and 0.3 m from the -x plane that b stands at.
    pushed = -base * ((press(0.05 - reach) - 1.0) - (press(0.35 - reach) - press(0.35)))
    assert forces[1] == pytest.approx([pushed, 0.0, 0.0], rel=1.0e-12, abs=1.0e-11)
    assert not forces[2].any()


@pytest.mark.parametrize("falloff", [1.0, 2.0, 4.0])
def test_the_frequency_is_the_slope_of_the_force(make_scene: MakeScene, box: Box, falloff: float) -> None:
    scene = make_scene(box("a"), force_fields={"falloff": falloff})
    h = 1.0e-5
    slope = (force_at(scene, -h, 0.0, 0.0)[1, 0] - force_at(scene, h, 0.0, 0.0)[1, 0]) / (2.0 * h)
    # The central difference misses F''' of (d/r)^p: p(p+1)(p+2)/d³·h²/3 of 2p/d, below 1e-6 for p ≤ 4.
    fields = fields_of(scene)
    positions, orientations = settled_poses(scene)
    assert fields.stiffest_frequency(positions, orientations) == pytest.approx(
        math.sqrt(slope / 10.0), rel=1.0e-6
    )
    # Beyond a quarter of d the near side pushes alike everywhere: what is left is stiffest across, k = 2·p·F/d.
    positions[1, 0] += 0.04
    expected = math.sqrt(2.0 * falloff * 10.0 / 4.0 * PEAK / 0.05 / 10.0)
    assert fields.stiffest_frequency(positions, orientations) == pytest.approx(expected, rel=1.0e-12)


def test_no_acceleration_is_no_force(make_scene: MakeScene, box: Box) -> None:
    scene = make_scene(box("a"), force_fields={})
    assert scene.force_fields is not None
    positions, orientations = settled_poses(scene)
    still = PerimeterForceFields(scene.force_fields, scene, 0.0, positions, orientations)
    assert not still.forces(positions + 0.02, orientations).any()
    assert still.stiffest_frequency(positions, orientations) == 0.0
