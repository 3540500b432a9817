"""The scenes that come with the product: each loads, stands by itself, and is called what its file is called."""

import json

import pytest

from config.readers.pallet import bounds
from config.scene import Scene
from config.scene_file import find_scene, friction_table, read_scene, shipped_scenes, validate_scene
from sim_core.integrity import check_integrity, supports

EXPECTED = {
    "block_slip", "block_tip", "slabs", "eur_columns", "eur_interlocked", "eur_interlayers", "eur_fields_05g",
    "eur_fields_08g", "mixed_sizes", "stackbuilder", "pally", "empty_pallet",
}  # fmt: skip
PACKAGES = {
    "empty_pallet": 0, "block_slip": 1, "block_tip": 1, "slabs": 5, "pally": 32, "eur_interlocked": 35,
    "eur_interlayers": 40, "mixed_sizes": 44,
}  # fmt: skip


@pytest.fixture(scope="module", params=sorted(EXPECTED))
def scene(request: pytest.FixtureRequest) -> Scene:
    return read_scene(find_scene(request.param))


def test_all_of_them_are_there() -> None:
    assert set(shipped_scenes()) >= EXPECTED
    assert shipped_scenes() == sorted(shipped_scenes())


@pytest.mark.parametrize("name", shipped_scenes())
def test_names_are_file_names_and_say_what_they_are_for(name: str) -> None:
    raw = json.loads(find_scene(name).read_text(encoding="utf-8"))
    assert raw["name"] == name
    assert len(raw["description"]) > 20
    validate_scene(raw)


def test_they_pass_their_integrity_check(scene: Scene) -> None:
    assert [finding for finding in check_integrity(scene) if finding.severity == "error"] == []


def test_they_hold_the_packages_they_promise(scene: Scene) -> None:
    count = sum(package.kind == "package" for package in scene.packages)
    assert count == PACKAGES.get(scene.name, 40)


def test_all_that_touches_has_a_friction(scene: Scene) -> None:
    table = friction_table(scene)
    pallet = scene.pallet_box
    for support in supports(scene):
        grounds = {-1: pallet.surface if pallet is not None else "", -2: "sled"}
        other = grounds.get(support.below) or scene.packages[support.below].surface
        assert frozenset((scene.packages[support.package].surface, other)) in table


def test_they_stand_on_their_own_once_resolved(scene: Scene) -> None:
    assert validate_scene(json.loads(scene.to_json())) == scene


def test_one_load_in_three_formats() -> None:
    """The same cartons at the same places, whichever way and in whichever order a file turns and lists them."""
    loads = {}
    for name in ("eur_columns", "stackbuilder", "pally"):
        scene = read_scene(find_scene(name), ["load.layers=5"])
        loads[name] = sorted(tuple(round(edge, 6) for edge in bounds(package)) for package in scene.packages)
        assert {package.mass_kg for package in scene.packages} == {10.0}
    assert loads["eur_columns"] == loads["stackbuilder"] == loads["pally"]
    assert len(loads["pally"]) == 40


def test_the_field_scenes_differ_in_their_level_alone() -> None:
    low, high = (read_scene(find_scene(f"eur_fields_{level}g")) for level in ("05", "08"))
    assert (low.sled.level_g, high.sled.level_g) == (0.5, 0.8)
    assert low.load == high.load
    assert low.force_fields == high.force_fields is not None
