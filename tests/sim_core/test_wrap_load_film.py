"""The film around a load against closed forms: hoop tension, hull bands, capstan; contact, momentum and restart."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from config.errors import RefusedInput
from config.scene import Scene
from config.scene_file import validate_scene
from config.wrap import FilmProperties
from sim_core.accuracy.cases import cartons_scene
from sim_core.frames import Array
from sim_core.geometry import rotation_matrices, yaw_quaternion
from sim_core.wrap.load_film import LoadFilm

SIDE_X, SIDE_Y, HEIGHT = 0.5, 0.4, 0.5
GAP = 0.001
LENGTH, WIDTH = 2 * SIDE_X + GAP, 2 * SIDE_Y + GAP


def block(layers: int = 1, *extra: dict[str, Any], **wrap: Any) -> Scene:
    """Layers of two by two boxes on the sled, wrapped in three layers of stretch film."""
    boxes = [
        {
            "id": f"box_{layer}_{x}_{y}",
            "size_m": [SIDE_X, SIDE_Y, HEIGHT],
            "mass_kg": 10.0,
            "position_m": [x * (SIDE_X + GAP) / 2, y * (SIDE_Y + GAP) / 2, HEIGHT * (layer + 0.5)],
        }
        for layer in range(layers)
        for x in (-1, 1)
        for y in (-1, 1)
    ]
    return validate_scene({
        "name": "block",
        "load": {"packages": boxes + list(extra)},
        "pallet": None,
        "sled": {"profile": "eumos", "level_g": 0.5},
        "wrap": {"material": "stretch_film_20", "turns": 3, **wrap},
    })  # fmt: skip


def cartons(**wrap: Any) -> Scene:
    return validate_scene({**cartons_scene(), "wrap": {"material": "stretch_film_20", "turns": 3, **wrap}})


def placed(scene: Scene) -> tuple[Array, Array]:
    """Centres and orientations of the bodies as the scene has them, row 0 the pallet."""
    pallet = scene.pallet_box
    base = (0.0, 0.0, pallet.size_m[2] / 2 if pallet is not None else 0.0)
    positions = np.array([base, *(package.position_m for package in scene.packages)])
    return positions, np.tile([0.0, 0.0, 0.0, 1.0], (len(positions), 1))


def properties(scene: Scene) -> FilmProperties:
    assert scene.film is not None
    return scene.film


def hoops_only(scene: Scene, friction: float) -> FilmProperties:
    """The scene's film with hardly any stiffness but around the load.

    In Biot strain a sheet gives way in shear where its modulus is below a quarter of the pull, so two per cent of E
    is the least at a strain of 0.067.
    """
    film = properties(scene)
    least = 0.02 * film.around.stiffness_npm
    up = replace(film.up, stiffness_npm=least, yield_force_npm=math.inf)
    return replace(film, up=up, poisson=0.0, shear_npm=least, friction=dict.fromkeys(film.friction, friction))


def film_height(film: LoadFilm) -> float:
    return float(np.ptp(film.nodes[:, 2]))


def depth_in_boxes(scene: Scene, nodes: Array, positions: Array, orientations: Array) -> float:
    """How deep the deepest node is inside a box [m]."""
    turns = rotation_matrices(orientations)
    deepest = 0.0
    for package, centre, turn in zip(scene.packages, positions[1:], turns[1:], strict=True):
        room = 0.5 * np.array(package.size_m) - np.abs((nodes - centre) @ turn)
        deepest = max(deepest, float(room.min(axis=1).max()))
    return deepest


def test_hoop_tension_pulls_on_each_corner_box_by_root_two_t_h() -> None:
    scene = block()
    film = LoadFilm(scene, *placed(scene))
    forces, torques = film.wrenches(*placed(scene))
    # T = E·t·layers·strain on both sides of the corner, for all of the film's height.
    pull = properties(scene).around.stiffness_npm * 3 * properties(scene).strain * film_height(film)
    inwards = -np.sign(placed(scene)[0][1:, :2])
    assert np.allclose(forces[1:, :2], pull * inwards, rtol=1e-3)
    assert np.allclose(np.linalg.norm(forces[1:], axis=1), math.sqrt(2) * pull, rtol=1e-3)
    # Alone it presses, and sums to nothing.
    assert np.abs(forces.sum(axis=0)).max() < 1e-9 * pull
    assert np.abs(forces[:, 2]).max() < 1e-3 * pull
    moments = (np.cross(placed(scene)[0], forces) + torques).sum(axis=0)
    assert np.abs(moments).max() < 1e-6 * pull


# At 20 mm the least stiffness that the film needs up its side takes over 1.3 % of the pull.
@pytest.mark.parametrize("shift", [0.005, 0.010])
def test_frictionless_film_is_hull_bands(shift: float) -> None:
    scene = block(2)
    positions, orientations = placed(scene)
    film = LoadFilm(scene, positions, orientations, film=hoops_only(scene, 0.0))
    top = film_height(film) - HEIGHT
    positions[7:, 0] += shift
    forces, _ = film.wrenches(positions, orientations)
    # T = E·t·(perimeter/rest − 1), with rest = first perimeter/(1 + strain), on both sides of every corner.
    perimeter, strain = 2 * (LENGTH + WIDTH), properties(scene).strain
    stretched = (1 + strain) * (perimeter + 2 * shift) / perimeter - 1
    pull = 3 * properties(scene).around.stiffness_npm * stretched * top
    assert np.allclose(np.abs(forces[5:, :2]), pull, rtol=0.01)
    assert np.allclose(np.abs(forces[1:5, :2]), properties(scene).tension_npm * 3 * HEIGHT, rtol=0.01)


@pytest.mark.parametrize("shift", [0.005, 0.020])
def test_layer_that_shifts_whole_is_held_by_no_frictionless_hoop(shift: float) -> None:
    scene = block(2)
    positions, orientations = placed(scene)
    film = LoadFilm(scene, positions, orientations, film=hoops_only(scene, 0.0))
    top = film_height(film) - HEIGHT
    positions[5:, 0] += shift
    forces, _ = film.wrenches(positions, orientations)
    # The perimeter of no row has changed.
    pull = 3 * properties(scene).tension_npm * top
    assert np.allclose(np.abs(forces[5:, :2]).mean(), pull, rtol=0.01)
    # What shear there is shows in the sum: G·(shift/row) on two sides of the load, at most.
    shear = 2 * LENGTH * 3 * 0.02 * properties(scene).around.stiffness_npm * shift / 0.1
    assert -shear < forces[5:, 0].sum() < 0.0


def test_sliding_film_obeys_the_capstan() -> None:
    friction = 0.15
    scene = block(1)
    positions, orientations = placed(scene)
    film = LoadFilm(scene, positions, orientations, film=hoops_only(scene, friction))
    for _ in range(10):
        positions[3:, 0] += 0.004
        forces, _ = film.wrenches(positions, orientations)
    # T_long/T_short = e^(μπ/2), and the film's length at rest is what it was: Σ side/(1 + T/E·t) = perimeter/(1 + ε).
    ratio = math.exp(friction * math.pi / 2)
    modulus, strain = 3 * properties(scene).around.stiffness_npm, properties(scene).strain
    rest = 2 * (LENGTH + WIDTH) / (1 + strain)
    low, high = 0.0, modulus
    for _ in range(60):
        short = 0.5 * (low + high)
        length = 2 * (LENGTH + 0.04) / (1 + ratio * short / modulus) + 2 * WIDTH / (1 + short / modulus)
        low, high = (short, high) if length > rest else (low, short)
    height = film_height(film)
    assert np.allclose(np.abs(forces[1:, 0]) / np.abs(forces[1:, 1]), ratio, rtol=0.01)
    assert np.allclose(np.abs(forces[1:, 1]), short * height, rtol=0.01)
    # A film that sticks keeps what the short sides had, and stretches the long ones alone.
    positions, _ = placed(scene)
    film = LoadFilm(scene, positions, orientations, film=hoops_only(scene, 3.0))
    positions[3:, 0] += 0.04
    forces, _ = film.wrenches(positions, orientations)
    long = modulus * ((1 + strain) * (LENGTH + 0.04) / LENGTH - 1) * height
    assert np.allclose(np.abs(forces[1:, 0]), long, rtol=0.01)
    assert np.allclose(np.abs(forces[1:, 1]), modulus * strain * height, rtol=0.01)


def moved_about(scene: Scene, seed: int) -> tuple[Array, Array]:
    """The load with every box moved by millimetres and turned by tenths of a degree."""
    random = np.random.default_rng(seed)
    positions, orientations = placed(scene)
    positions[1:] += random.normal(0.0, 2.0e-3, (len(positions) - 1, 3)) * [1.0, 1.0, 0.2]
    orientations[1:, :3] = random.normal(0.0, 1.0e-3, (len(positions) - 1, 3))
    return positions, orientations / np.linalg.norm(orientations, axis=1, keepdims=True)


@pytest.mark.parametrize("seed", range(4))
def test_nothing_of_the_films_momentum_is_lost(seed: int) -> None:
    scene = cartons()
    film = LoadFilm(scene, *placed(scene))
    positions, orientations = moved_about(scene, seed)
    for _ in range(5):
        forces, torques = film.wrenches(positions, orientations)
    largest = np.abs(forces).max()
    assert np.abs(forces.sum(axis=0)).max() < 1e-9 * largest
    moments = (np.cross(positions, forces) + torques).sum(axis=0)
    assert np.abs(moments).max() < 1e-3 * largest
    assert film.residual < 1.0e-2


@pytest.mark.parametrize("move", ["top layer out", "top layer back", "one carton out", "all about"])
def test_no_node_enters_a_box(move: str) -> None:
    scene = cartons()
    positions, orientations = placed(scene)
    film = LoadFilm(scene, positions, orientations)
    if move == "all about":
        positions, orientations = moved_about(scene, 7)
    elif move == "one carton out":
        # The second of a long side, in the middle layer, is in no corner of the load.
        positions[1 + 16 + 3, 1] += 0.015
    else:
        positions[33:, 0] += 0.02 if move == "top layer out" else -0.02
    forces, _ = film.wrenches(positions, orientations)
    inner = film.nodes[film.off_edges]
    assert depth_in_boxes(scene, inner, positions, orientations) < 1e-6
    if move == "one carton out":
        assert forces[20, 1] < 0.0


def test_film_goes_off_an_edge_that_leaves_it_and_comes_back() -> None:
    # A box that stands out by 20 mm between two others on the long side bends the film at its two outer edges.
    out = {
        "id": "out", "size_m": [0.3, 0.1, HEIGHT], "mass_kg": 5.0,
        "position_m": [0.0, WIDTH / 2 - 0.03, HEIGHT / 2],
    }  # fmt: skip
    sides = [
        {
            "id": f"side_{x}_{y}", "size_m": [0.3, WIDTH / 2, HEIGHT], "mass_kg": 5.0,
            "position_m": [x * 0.35, y * WIDTH / 4, HEIGHT / 2],
        }
        for x in (-1, 1) for y in (-1, 1)
    ]  # fmt: skip
    scene = validate_scene({
        "name": "out", "load": {"packages": [*sides, out]}, "pallet": None,
        "sled": {"profile": "eumos", "level_g": 0.5}, "wrap": {"material": "stretch_film_20", "turns": 3},
    })  # fmt: skip
    positions, orientations = placed(scene)
    film = LoadFilm(scene, positions, orientations)
    at_first = film.wrenches(positions, orientations)[0][5].copy()
    assert at_first[1] < -5.0
    for _ in range(10):
        positions[5, 1] -= 0.005
        forces, _ = film.wrenches(positions, orientations)
    # While it moves the film is as exact as the move asks for.
    forces, _ = film.wrenches(positions, orientations)
    assert np.abs(forces[5]).max() < 0.1
    for _ in range(10):
        positions[5, 1] += 0.005
        forces, _ = film.wrenches(positions, orientations)
    forces, _ = film.wrenches(positions, orientations)
    assert forces[5, 1] == pytest.approx(at_first[1], rel=0.1)


def test_more_layers_hold_more() -> None:
    held = []
    for turns in (1, 2, 3, 6):
        scene = cartons(turns=turns)
        positions, orientations = placed(scene)
        film = LoadFilm(scene, positions, orientations)
        positions[33:, 0] += 0.01
        held.append(-film.wrenches(positions, orientations)[0][33:, 0].sum())
    # Film on itself is all one: the force is in proportion to the layers.
    assert held[0] > 10.0
    assert np.allclose(np.array(held) / held[0], [1, 2, 3, 6], rtol=0.02)


def test_answer_does_not_hang_on_the_tolerance() -> None:
    scene = cartons()
    answers = []
    for tolerance in (1e-3, 1e-5):
        positions, orientations = placed(scene)
        film = LoadFilm(scene, positions, orientations, tolerance=tolerance)
        for step in range(1, 21):
            positions[33:, 0] += 5.0e-4 * math.sin(0.3 * step)
            forces, _ = film.wrenches(positions, orientations)
        answers.append(forces)
    assert np.abs(answers[0] - answers[1]).max() < 0.005 * np.abs(answers[1]).max()


def test_restored_film_goes_on_to_the_bit() -> None:
    scene = cartons(friction=0.2)
    positions, orientations = placed(scene)
    film = LoadFilm(scene, positions, orientations)

    def run(film: LoadFilm, steps: range) -> list[bytes]:
        found = []
        for step in steps:
            moved = positions.copy()
            moved[33:, 0] += 4.0e-3 * math.sin(0.4 * step)
            moved[25:33, 1] += 2.0e-3 * step
            forces, torques = film.wrenches(moved, orientations)
            film.commit()
            found.append(forces.tobytes() + torques.tobytes() + film.nodes.tobytes())
        return found

    run(film, range(1, 6))
    kept = film.state()
    first = run(film, range(6, 14))
    film.restore(kept)
    assert run(film, range(6, 14)) == first
    film.restore(kept)
    assert run(film, range(6, 14)) == first


def test_still_bodies_cost_nothing() -> None:
    scene = cartons()
    positions, orientations = placed(scene)
    film = LoadFilm(scene, positions, orientations)
    positions[33:, 0] += 0.001
    film.wrenches(positions, orientations)
    first = film.wrenches(positions, orientations)
    steps = film.steps_taken
    again = film.wrenches(positions + 5.0e-8, orientations)
    assert again[0] is first[0] and film.steps_taken == steps
    turned = orientations.copy()
    turned[40] = yaw_quaternion(0.01)
    assert film.wrenches(positions, turned)[0] is not first[0]


def test_poses_that_are_not_finite_get_the_last_answer() -> None:
    scene = block()
    positions, orientations = placed(scene)
    film = LoadFilm(scene, positions, orientations)
    first, nodes = film.wrenches(positions, orientations)[0], film.nodes.copy()
    positions[2, 0] = math.nan
    assert film.wrenches(positions, orientations)[0] is first
    assert (film.nodes == nodes).all()


def test_small_moves_take_few_steps_and_rarely_a_new_tangent() -> None:
    scene = cartons()
    positions, orientations = placed(scene)
    film = LoadFilm(scene, positions, orientations)
    for _ in range(50):
        positions[33:, 0] += 1.0e-4
        film.wrenches(positions, orientations)
    assert film.steps_taken <= 50 * 3.2
    # A tangent costs as much as four steps: about one a move.
    assert film.tangents_made <= 60


def test_film_that_is_torn_pulls_nothing() -> None:
    scene = block()
    positions, orientations = placed(scene)
    film = LoadFilm(scene, positions, orientations)
    assert film.commit() == 0.0
    # 1.5 times its strain to break: all that is stretched by it tears.
    positions[3:, 0] += 2.0
    film.wrenches(positions, orientations)
    assert film.commit() > 0.0
    film.film.torn[:] = True
    positions[3:, 0] += 0.001
    forces, torques = film.wrenches(positions, orientations)
    assert not forces.any() and not torques.any()


def test_drawn_film_is_slack_when_the_load_comes_back() -> None:
    scene = block()
    positions, orientations = placed(scene)
    film = LoadFilm(scene, positions, orientations)
    before = film.wrenches(positions, orientations)[0].copy()
    for shift in [0.05] * 5 + [-0.05] * 5:
        positions[3:, 0] += shift
        film.wrenches(positions, orientations)
        film.commit()
    after, _ = film.wrenches(positions, orientations)
    assert np.abs(after[1:, 0]).max() < 0.9 * np.abs(before[1:, 0]).min()


def test_film_laid_without_tension_holds_only_what_moves() -> None:
    scene = cartons(wrap_force_n=0.0)
    positions, orientations = placed(scene)
    film = LoadFilm(scene, positions, orientations)
    assert np.abs(film.wrenches(positions, orientations)[0]).max() < 1e-6
    for _ in range(10):
        positions[33:, 0] += 0.001
        forces, _ = film.wrenches(positions, orientations)
    assert forces[33:, 0].sum() < -5.0
    assert np.isfinite(forces).all()


def test_film_by_height_is_only_where_it_was_laid() -> None:
    scene = block(2, turns={"top": 2}, web_width_m=0.3)
    positions, orientations = placed(scene)
    film = LoadFilm(scene, positions, orientations)
    forces, _ = film.wrenches(positions, orientations)
    assert not forces[1:5].any()
    # Two layers of a web of 0.3 m, of which the mesh stops short by 2 mm; its bands follow the web's edge roughly.
    assert np.abs(forces[5:, 0]).mean() == pytest.approx(2 * 0.3 * properties(scene).tension_npm, rel=0.05)


def test_stiffest_frequency_is_that_of_the_hoops() -> None:
    scene = block()
    film = LoadFilm(scene, *placed(scene), film=hoops_only(scene, 0.3))
    masses = np.array([25.0, 10.0, 10.0, 10.0, 10.0])
    # k = E·t·layers·height·(1/L_before + 1/L_after), the film's lengths being those before it was stretched.
    stiffness = (
        (1 + properties(scene).strain)
        * 3
        * properties(scene).around.stiffness_npm
        * film_height(film)
        * (1 / LENGTH + 1 / WIDTH)
    )
    assert film.stiffest_frequency(masses) == pytest.approx(math.sqrt(stiffness / 10.0), rel=5e-3)


def test_what_cannot_be_wrapped_is_refused() -> None:
    scene = block()
    with pytest.raises(RefusedInput, match="wrap"):
        LoadFilm(scene.model_copy(update={"wrap": None}), *placed(scene))
    box = {**scene.model_dump()["load"]["packages"][0], "id": "b", "surface": "steel"}
    scene = validate_scene({**scene.model_dump(), "load": {"packages": [box]}})
    with pytest.raises(RefusedInput, match=r"wrap\.friction = stretch_film_20 on steel"):
        LoadFilm(scene, *placed(scene))
