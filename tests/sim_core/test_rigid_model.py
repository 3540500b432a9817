"""Bodies and friction that an engine gets: interlayers become interfaces, everything else stays itself."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from config.scene import Scene
from config.scene_file import find_scene, friction_table, read_scene
from sim_core.friction import friction_factors
from sim_core.rigid_model import RigidBox, RigidModel, build_rigid_model, with_sheets

MakeScene = Callable[..., Scene]
Box = Callable[..., dict[str, Any]]


def sheet(
    name: str, bottom: float, *, size: tuple[float, ...] = (1.2, 0.8, 0.003), **other: Any
) -> dict[str, Any]:
    return {
        "id": name, "size_m": size, "mass_kg": 0.6, "position_m": (0.0, 0.0, bottom + size[2] / 2),
        "surface": "anti_slip", "kind": "interlayer", **other,
    }  # fmt: skip


def between(first: str, second: str, friction: float) -> dict[str, Any]:
    return {"between": [first, second], "friction": friction}


def bodies(model: RigidModel) -> dict[str, RigidBox]:
    return {found.name: found for found in model.boxes if found is not None}


def interface(model: RigidModel, first: str, second: str) -> float:
    """Wanted friction between two bodies, by name."""
    boxes = bodies(model)
    pair = frozenset((boxes[first].face, boxes[second].face))
    assert pair in model.touching
    return model.friction[pair]


def test_plain_packages_are_bodies_as_the_scene_has_them(make_scene: MakeScene, box: Box) -> None:
    scene = make_scene(box("a"), box("b", x=0.1, bottom=0.394, yaw_deg=30.0, mass=3.0))
    model = build_rigid_model(scene)
    assert [found.name for found in model.boxes if found is not None] == ["pallet", "a", "b"]
    assert model.boxes[2] == RigidBox("b", (0.4, 0.3, 0.25), 3.0, (0.1, 0.0, 0.519), 30.0, "cardboard")
    assert model.sheets == ()
    assert model.friction == friction_table(scene)
    assert model.touching == {frozenset({"cardboard", "wood"}), frozenset({"cardboard"})}


def test_a_blocked_pallet_has_no_mass_and_no_pallet_no_body(make_scene: MakeScene, box: Box) -> None:
    assert bodies(build_rigid_model(make_scene(box("a"))))["pallet"].mass_kg == 0.0
    free = build_rigid_model(make_scene(box("a"), pallet={"kind": "epal1", "fixed": False}))
    assert bodies(free)["pallet"].mass_kg == 25.0
    assert bodies(free)["pallet"].position_m == (0.0, 0.0, 0.072)
    assert interface_of_ground(free) == 0.45
    bare = build_rigid_model(make_scene(box("a", bottom=0.0), pallet=None))
    assert bare.boxes[0] is None
    assert bare.touching == {frozenset({"cardboard", "sled"})}


def interface_of_ground(model: RigidModel) -> float:
    pair = frozenset({"wood", "sled"})
    assert pair in model.touching
    return model.friction[pair]


@pytest.mark.parametrize(("below", "above", "weaker"), [(0.6, 0.2, 0.2), (0.15, 0.4, 0.15), (0.3, 0.3, 0.3)])
def test_a_sheet_is_an_interface_with_the_smaller_friction(
    make_scene: MakeScene, box: Box, below: float, above: float, weaker: float
) -> None:
    pairs = [between("anti_slip", "cardboard", below), between("anti_slip", "shrink_film", above)]
    scene = make_scene(
        box("low"),
        sheet("mat", 0.394),
        box("high", bottom=0.397, surface="shrink_film"),
        surfaces={"pairs": pairs},
    )
    model = build_rigid_model(scene)
    assert model.boxes[2] is None
    assert interface(model, "low", "high") == weaker
    assert interface(model, "pallet", "low") == 0.5
    # The engine's factors meet what touches.
    unmet = friction_factors(model.friction, touching=model.touching).unmet
    assert not [pair for pair in unmet if pair.touching]


def test_the_packages_below_carry_the_sheets_thickness(make_scene: MakeScene, box: Box) -> None:
    scene = make_scene(
        box("west", x=-0.2), box("east", x=0.2), sheet("mat", 0.394, size=(0.8, 0.3, 0.005)),
        box("top", bottom=0.399),
    )  # fmt: skip
    model = build_rigid_model(scene)
    assert {name: found.sheet_m for name, found in bodies(model).items()} == {
        "pallet": 0.0, "west": 0.005, "east": 0.005, "top": 0.0
    }  # fmt: skip
    assert bodies(model)["west"].size_m == (0.4, 0.3, 0.25)
    assert [(found.row, found.carriers) for found in model.sheets] == [(3, (1, 2))]
    assert model.sheets[0].position_m == pytest.approx([0.0, 0.0, 0.3965])


def test_a_sheets_pose_is_the_mean_of_its_carriers(make_scene: MakeScene, box: Box) -> None:
    scene = make_scene(box("west", x=-0.2), box("east", x=0.2), sheet("mat", 0.394), box("top", bottom=0.397))
    model = build_rigid_model(scene)
    start = np.array([(0.0, 0.0, 0.072), *(package.position_m for package in scene.packages)])
    moved = start.copy()
    moved[1] += (0.25, 0.0, 0.0)
    moved[2] += (0.75, -0.5, 0.125)
    moved[3] = np.nan
    moved[4] += (3.0, 0.0, 0.0)
    kept = moved.copy()
    filled = with_sheets(model, moved, at_rest=start)
    # Differences of coordinates below 1 m, and one sum: a few 1e-16.
    assert filled[3] == pytest.approx(start[3] + (0.5, -0.25, 0.0625), abs=1.0e-15)
    assert filled[[0, 1, 2, 4]].tolist() == kept[[0, 1, 2, 4]].tolist()
    rates = np.array([[0.0, 0, 0], [1.0, 2.0, 3.0], [3.0, 0.0, 1.0], [9.0, 9.0, 9.0], [7.0, 7.0, 7.0]])
    assert with_sheets(model, rates)[3].tolist() == [2.0, 1.0, 2.0]


def test_a_sheet_on_the_deck_belongs_to_the_pallet(make_scene: MakeScene, box: Box) -> None:
    pairs = [between("anti_slip", "wood", 0.25)]
    scene = make_scene(sheet("mat", 0.144), box("a", bottom=0.147), surfaces={"pairs": pairs})
    model = build_rigid_model(scene)
    assert bodies(model)["pallet"].sheet_m == 0.003
    assert model.sheets[0].carriers == (0,)
    assert interface(model, "a", "pallet") == 0.25


def test_the_shipped_interlayers_slide_on_the_sheets(make_scene: MakeScene) -> None:
    """Four sheets between five layers of eight: 40 bodies; cardboard on anti-slip 0.6 in the joints, 0.5 below."""
    scene = read_scene(find_scene("eur_interlayers"))
    model = build_rigid_model(scene)
    assert len(bodies(model)) == 41
    assert [len(found.carriers) for found in model.sheets] == [8, 8, 8, 8]
    layers = {package.id: package.layer for package in scene.packages}
    for name, found in bodies(model).items():
        assert found.sheet_m == (0.003 if layers.get(name, 5) < 5 else 0.0)
    by_layer = {layers[name]: found.face for name, found in bodies(model).items() if name in layers}
    assert model.friction[frozenset((by_layer[1], "wood"))] == 0.5
    for lower in range(1, 5):
        pair = frozenset((by_layer[lower], by_layer[lower + 1]))
        assert pair in model.touching
        assert model.friction[pair] == 0.6
