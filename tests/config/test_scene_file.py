"""From files to resolved scenes: overrides, palletising files, surfaces, and one line for each refusal."""

import json
import os
from collections.abc import Callable, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from config.errors import RefusedInput
from config.package import Package
from config.readers.pallet import bounds
from config.scene import CustomPallet, PackagesLoad, Scene
from config.scene_file import (
    find_scene,
    friction_table,
    read_scene,
    resolve_scene,
    scene_from_json,
    shipped_scenes,
    validate_scene,
)

PATTERNS = Path(__file__).parents[2] / "config" / "patterns"
RAW: dict[str, Any] = {
    "name": "t",
    "load": {
        "packages": [
            {"id": "a", "size_m": [0.4, 0.3, 0.25], "mass_kg": 10, "position_m": [0, 0, 0.269]},
            {"id": "b", "size_m": [0.4, 0.3, 0.25], "mass_kg": 12, "position_m": [0, 0, 0.519]},
        ]
    },
    "sled": {"profile": "eumos", "level_g": 0.5},
}
Refuse = Callable[..., str]


@pytest.fixture
def read(tmp_path: Path) -> Callable[..., Scene]:
    """Writes a scene file and reads it with overrides."""

    def reader(content: Any, *overrides: str) -> Scene:
        path = tmp_path / "scene.json"
        if isinstance(content, bytes):
            path.write_bytes(content)
        else:
            text = content if isinstance(content, str) else json.dumps(content)
            path.write_text(text, encoding="utf-8")
        return read_scene(path, overrides)

    return reader


@pytest.fixture
def refusal(read: Callable[..., Scene]) -> Refuse:
    """The one line with which a scene file and its overrides are refused."""

    def line(content: Any, *overrides: str) -> str:
        with pytest.raises(RefusedInput) as caught:
            read(content, *overrides)
        message = str(caught.value)
        assert message.splitlines() == [message]
        assert len(message) < 500
        return message

    return line


def around(pattern: str, **load: Any) -> dict[str, Any]:
    """A scene of a shipped palletising file, named by its absolute path."""
    return {**RAW, "load": {"file": str(PATTERNS / pattern), **load}}


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("", "is not JSON"),
        ("{", "line 1, column 2: is not JSON"),
        ('{"name": NaN}', "NaN: must be a finite number"),
        ('{"seed": -Infinity}', "-Infinity: must be a finite number"),
        ('{"name": "a", "name": "b"}', "name: the key stands twice"),
        ('{"load": {"file": 1, "file": 2}}', "file: the key stands twice"),
        ("[1, 2]", "list: must be a JSON object"),
        ("null", "NoneType: must be a JSON object"),
        ("[" * 100_000, "is not JSON that can be read"),
        ('{"seed": ' + "1" * 5000 + "}", "is not JSON that can be read"),
        (b"\xff\xfe{\x00}\x00", "must be UTF-8"),
        (b"\x89MCAP0\r\n", "must be UTF-8"),
        ("<Response", "not well-formed"),
        ("name: yaml", "is not JSON"),
    ],
)
def test_what_is_no_scene_is_refused(refusal: Refuse, content: str | bytes, said: str) -> None:
    assert said in refusal(content)


def test_a_byte_order_mark_is_no_matter(read: Callable[..., Scene]) -> None:
    assert read(b"\xef\xbb\xbf" + json.dumps(RAW).encode()).name == "t"


def test_a_huge_scene_is_refused_unread(tmp_path: Path) -> None:
    path = tmp_path / "huge.json"
    with path.open("wb") as file:
        os.truncate(file.fileno(), 2**30)
    with pytest.raises(RefusedInput, match="of 1073741824 bytes: at most 16777216 bytes"):
        read_scene(path)


def test_paths_that_are_no_files_are_refused(tmp_path: Path) -> None:
    with pytest.raises(RefusedInput, match="must be a file"):
        read_scene(tmp_path)
    with pytest.raises(RefusedInput, match="No such file"):
        read_scene(tmp_path / "none.json")
    for name in ("none.json", "", "eur", "a" * 300, "eur_columns/"):
        with pytest.raises(RefusedInput, match=r"scene = "):
            read_scene(find_scene(name))


def test_scenes_are_found_by_name_or_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert find_scene("eur_columns").name == "eur_columns.json"
    mine = tmp_path / "eur_columns"
    mine.write_text(json.dumps(RAW), encoding="utf-8")
    assert find_scene("eur_columns") == Path("eur_columns")
    assert find_scene(str(mine)) == mine
    with pytest.raises(RefusedInput) as caught:
        find_scene("eur_colums")
    assert all(name in str(caught.value) for name in shipped_scenes())


@pytest.mark.parametrize(
    ("override", "path", "value"),
    [
        ("sled.level_g=0.6", "sled.level_g", 0.6),
        ("sled.direction=+y", "sled.direction", "+y"),
        ("sled.direction=45", "sled.direction", 45.0),
        ("load.packages.1.mass_kg=3", "load.packages.1.mass_kg", 3.0),
        ("load.packages.0.size_m.2=0.25", "load.packages.0.size_m.2", 0.25),
        ("force_fields.tension=2", "force_fields.tension", 2.0),
        ("force_fields={}", "force_fields.tension", 1.0),
        ("accelerometer.noise_mps2=0", "accelerometer.noise_mps2", 0.0),
        ('description="a = b"', "description", "a = b"),
        ("description=a = b", "description", "a = b"),
        ("description=", "description", ""),
        ("pallet.fixed=false", "pallet.fixed", False),
        ("seed=4294967295", "seed", 2**32 - 1),
    ],
)
def test_overrides(read: Callable[..., Scene], override: str, path: str, value: object) -> None:
    raw = {**RAW, "pallet": {"kind": "epal1"}}
    found: Any = json.loads(read(raw, override).to_json())
    for part in path.split("."):
        found = found[int(part)] if isinstance(found, list) else found[part]
    assert found == value


def test_overrides_come_in_order_and_may_end_a_part(read: Callable[..., Scene]) -> None:
    scene = read({**RAW, "force_fields": {}}, "sled.level_g=0.6", "sled.level_g=0.7", "force_fields=null")
    assert scene.sled.level_g == 0.7
    assert scene.force_fields is None
    assert (
        read(RAW, 'sled={"profile":"table","times_s":[0,1],"acceleration_mps2":[1,1]}').sled.profile
        == "table"
    )


@pytest.mark.parametrize(
    ("override", "said"),
    [
        ("sled.level_g", "KEY=VALUE"),
        ("=3", "KEY=VALUE"),
        ("sled.level=3", "sled.level = 3: unknown key"),
        ("wind.speed=3", "wind = {1 keys}: unknown key"),
        ("sled.level_g=NaN", "sled.level_g = NaN: must be a finite number"),
        ("sled.level_g=1e999", "sled.level_g = 1e999: must be a finite number"),
        ("sled.level_g=2.5", "sled.level_g = 2.5: must be less than or equal to 2"),
        ("sled.level_g=fast", "sled.level_g = fast: must be a valid number"),
        ("load.packages.0.position_m=[NaN,0,0]", "load.packages.0.position_m.0 = nan"),
        ("load.packages.2.mass_kg=1", "'2' must be a number from 0 to 1"),
        ("load.packages.-1.mass_kg=1", "'-1' must be a number"),
        ("load.packages.a.mass_kg=1", "'a' must be a number"),
        ("load.packages.²=1", "'²' must be a number"),
        ("name.first=1", "name holds a value, not a part"),
        ("sled.level_g.x=1", "sled.level_g holds a value, not a part"),
        ("load.packages.0.size_m.0.x=1", "load.packages.0.size_m.0 holds a value, not a part"),
        ("load.packages.0.size_m.0.x.y=1", "load.packages.0.size_m.0 holds a value, not a part"),
        ("seed=" + "1" * 5000, "seed = 111"),
        ("seed=" + "[" * 100_000, "seed = [[["),
        ("description=\udcff", "description = "),
    ],
)
def test_overrides_that_are_refused(refusal: Refuse, override: str, said: str) -> None:
    assert said in refusal(RAW, override)


texts = st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=12)
KEYS = ("sled", "load", "packages", "0", "1", "level_g", "size_m", "surfaces", "pairs", "name", "pallet", "")


@settings(max_examples=60, deadline=None)
@given(keys=st.lists(st.sampled_from(KEYS) | texts, max_size=6), value=texts | st.integers().map(str))
def test_no_override_ends_otherwise_than_in_a_scene_or_a_refusal(
    tmp_path_factory: pytest.TempPathFactory, keys: Sequence[str], value: str
) -> None:
    path = tmp_path_factory.getbasetemp() / "any.json"
    path.write_text(json.dumps(RAW), encoding="utf-8")
    try:
        read_scene(path, [f"{'.'.join(keys)}={value}"]).to_json()
    except RefusedInput as error:
        assert len(str(error).splitlines()) == 1


@pytest.mark.parametrize(
    ("pattern", "count", "sheets", "form"),
    [
        ("eur_columns.nist.xml", 40, 0, "nist"),
        ("eur_columns.stackbuilder.xml", 40, 0, "stackbuilder"),
        ("eur_columns.pally.json", 40, 0, "pally"),
        ("eur_columns_antislip.stackbuilder.xml", 40, 4, "stackbuilder"),
    ],
)
def test_a_palletising_file_becomes_the_load(
    read: Callable[..., Scene], pattern: str, count: int, sheets: int, form: str
) -> None:
    scene = read(around(pattern))
    kinds = [package.kind for package in scene.packages]
    assert (kinds.count("package"), kinds.count("interlayer")) == (count, sheets)
    assert isinstance(scene.load, PackagesLoad)
    source = scene.load.source
    assert source is not None
    assert (source.file, source.format, source.pallet_number) == (pattern, form, 1)
    assert len(source.sha256) == 64
    # The lowest packages stand on the deck of the pallet, 0.144 m up.
    assert min(p.position_m[2] - p.size_m[2] / 2 for p in scene.packages) == pytest.approx(0.144, abs=1e-9)
    assert {p.surface for p in scene.packages} == {"cardboard"} | ({"anti_slip"} if sheets else set())
    # It stands on its own: no file is needed any more.
    assert resolve_scene(scene, Path("/nowhere")) == scene
    assert scene_from_json(scene.to_json()) == scene


@pytest.mark.parametrize(
    "pattern", ["eur_columns.nist.xml", "eur_columns.stackbuilder.xml", "eur_columns.pally.json"]
)
def test_a_bare_palletising_file_is_tested_on_its_own_pallet(pattern: str) -> None:
    scene = read_scene(PATTERNS / pattern, ["sled.level_g=0.4"])
    assert scene.name == pattern.removesuffix(".xml").removesuffix(".json")
    assert scene.sled.level_g == 0.4
    assert len(scene.packages) == 40
    assert isinstance(scene.pallet, CustomPallet)
    assert scene.pallet.size_m[:2] == (1.2, 0.8)


def by_layer(scene: Scene) -> dict[int, list[Package]]:
    layers: dict[int, list[Package]] = {}
    for package in scene.packages:
        layers.setdefault(package.layer or 0, []).append(package)
    return layers


def places(packages: Sequence[Package], x: int = 1, y: int = 1) -> list[tuple[float, ...]]:
    return sorted(
        (round(x * p.position_m[0], 9) + 0.0, round(y * p.position_m[1], 9) + 0.0) for p in packages
    )


def test_layers_are_kept_from_below_turned_and_mirrored(read: Callable[..., Scene]) -> None:
    pattern = "eur_interlocked.pally.json"
    plain = by_layer(read(around(pattern)))
    assert {layer: len(found) for layer, found in plain.items()} == dict.fromkeys(range(1, 6), 7)
    changed = by_layer(read(around(pattern, layers=3, rotate_layers=[2], mirror_layers=[3])))
    assert {layer: len(found) for layer, found in changed.items()} == dict.fromkeys(range(1, 4), 7)
    assert places(changed[1]) == places(plain[1])
    assert places(changed[2]) == places(plain[2], x=-1, y=-1) != places(plain[2])
    assert places(changed[3]) == places(plain[3], y=-1) != places(plain[3])
    # Every second layer is turned in the file; turned back, all layers are alike.
    assert places(changed[2]) == places(changed[1])
    notes = read(around(pattern, layers=3)).load
    assert isinstance(notes, PackagesLoad)
    assert notes.source is not None
    assert "kept the lowest 3 of 5 layers" in notes.source.notes


@pytest.mark.parametrize(
    ("load", "said"),
    [
        ({"layers": 6}, "layers = 6: 1 to 5"),
        ({"layers": 0}, "load.layers = 0: must be greater than or equal to 1"),
        ({"rotate_layers": [0]}, "rotate_layers = [0]: layers 1 to 5"),
        ({"mirror_layers": [2, 2]}, "mirror_layers = [2, 2]"),
        ({"pallet_number": 2}, "pallet_number = 2: one of 1"),
        ({"surface": "velvet"}, "load.packages.0.surface = velvet: unknown material; known: aluminium"),
        ({"layer": 2}, "load.layer = 2: unknown key"),
    ],
)
def test_a_load_that_the_file_cannot_give(refusal: Refuse, load: dict[str, Any], said: str) -> None:
    assert said in refusal(around("eur_columns.pally.json", **load))


def test_a_missing_palletising_file_is_named(refusal: Refuse) -> None:
    assert "gone.xml: no such file" in refusal({**RAW, "load": {"file": "gone.xml"}})
    assert "pallet.kind = file: needs load.file" in refusal({**RAW, "pallet": {"kind": "file"}})


def test_paths_start_from_the_scene_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "there").mkdir()
    (tmp_path / "there" / "load.xml").write_bytes((PATTERNS / "eur_columns.nist.xml").read_bytes())
    scene = tmp_path / "there" / "scene.json"
    scene.write_text(json.dumps({**RAW, "load": {"file": "load.xml"}}), encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    assert len(read_scene(Path("there/scene.json")).packages) == 40
    assert len(read_scene(Path("there/load.xml")).packages) == 40


@pytest.mark.parametrize("clearance", [0.0, 0.001, 0.02])
def test_clearance_is_taken_off_the_sides_and_nothing_else(
    read: Callable[..., Scene], clearance: float
) -> None:
    file = read(around("eur_columns_antislip.stackbuilder.xml", clearance_m=0))
    scene = read(around("eur_columns_antislip.stackbuilder.xml", clearance_m=clearance))
    for before, after in zip(file.packages, scene.packages, strict=True):
        trim = 0.0 if before.kind == "interlayer" else clearance
        length, width, height = before.size_m
        assert after.size_m == pytest.approx((length - trim, width - trim, height), abs=1e-15)
        assert after.position_m == before.position_m
        assert after.mass_kg == before.mass_kg
    # Cartons that touch in the file: along a row, one after the other, the gap is the clearance.
    layer = [p for p in scene.packages if p.layer == 1 and p.kind == "package"]
    row = sorted(
        (p for p in layer if p.position_m[1] == layer[0].position_m[1]), key=lambda p: p.position_m[0]
    )
    gaps = [bounds(right).x_min - bounds(left).x_max for left, right in pairwise(row)]
    assert gaps == pytest.approx([clearance] * (len(row) - 1), abs=1e-12)
    assert len(gaps) >= 2


def test_clearance_that_leaves_nothing_is_refused(
    read: Callable[..., Scene], refusal: Refuse, tmp_path: Path
) -> None:
    text = (PATTERNS / "eur_columns.nist.xml").read_text(encoding="utf-8")
    small = tmp_path / "small.xml"
    small.write_text(text.replace("<Width>300</Width>", "<Width>70</Width>"), encoding="utf-8")
    scene = {**RAW, "load": {"file": "small.xml", "clearance_m": 0.02}}
    assert "load.clearance_m = 0.02: must be under a quarter of the smallest edge" in refusal(scene)


def test_the_pallet_of_the_file_and_the_deck_it_raises_the_load_to(read: Callable[..., Scene]) -> None:
    for pallet, deck in [
        ({"kind": "file"}, 0.144),
        ({"kind": "file", "height_m": 0.2}, 0.2),
        ({"size_m": [1.3, 0.9, 0.05], "mass_kg": 9}, 0.05),
        (None, 0.0),
    ]:
        scene = read({**around("eur_columns.nist.xml"), "pallet": pallet})
        assert min(p.position_m[2] - p.size_m[2] / 2 for p in scene.packages) == pytest.approx(deck, abs=1e-9)
        if pallet is None:
            assert scene.pallet is None
        else:
            assert isinstance(scene.pallet, CustomPallet)
            assert scene.pallet.size_m[2] == deck


def test_unknown_materials_are_refused_with_the_known_ones(refusal: Refuse) -> None:
    said = refusal(RAW, "load.packages.1.surface=velvet")
    assert said.startswith("load.packages.1.surface = velvet: unknown material; known: ")
    assert "cardboard" in said
    assert "pallet.surface = ice" in refusal(RAW, 'pallet={"size_m":[1,1,0.144],"mass_kg":9,"surface":"ice"}')


def table_of(**parts: Any) -> dict[tuple[str, ...], float]:
    scene = resolve_scene(validate_scene({**RAW, **parts}), Path())
    return {tuple(sorted(pair)): friction for pair, friction in friction_table(scene).items()}


def test_frictions_come_from_the_scene_before_the_library() -> None:
    library = {("cardboard",): 0.5, ("cardboard", "sled"): 0.5, ("cardboard", "wood"): 0.5}
    assert table_of() == library
    own = {
        "pairs": [
            {"between": ["wood", "cardboard"], "friction": 0.2},
            {"between": ["steel", "plastic"], "friction": 9},
        ]
    }
    assert table_of(surfaces=own) == {**library, ("cardboard", "wood"): 0.2}


def test_a_surface_that_nothing_has_is_taken_for_a_slip_of_the_pen() -> None:
    with pytest.raises(RefusedInput, match=r"surfaces\.pairs\.0 = cardbord: nothing here has this surface"):
        table_of(surfaces={"pairs": [{"between": ["cardbord", "cardboard"], "friction": 0.45}]})


def test_only_a_pallet_that_can_slide_needs_friction_on_the_sled() -> None:
    assert ("sled", "wood") not in table_of()
    assert table_of(pallet={"kind": "epal1", "fixed": False})[("sled", "wood")] == 0.45
    assert ("cardboard", "wood") not in table_of(pallet=None)


def test_a_pair_that_nobody_names_is_absent() -> None:
    boxes = [
        {**RAW["load"]["packages"][0], "surface": "steel"},
        {**RAW["load"]["packages"][1], "surface": "aluminium"},
    ]
    table = table_of(load={"packages": boxes})
    assert ("aluminium", "steel") not in table
    assert table[("steel", "wood")] == 0.3
    fresh = {"pairs": [{"between": ["velvet", "wood"], "friction": 0.9}]}
    velvet = [{**RAW["load"]["packages"][0], "surface": "velvet"}]
    assert table_of(load={"packages": velvet}, surfaces=fresh) == {("velvet", "wood"): 0.9}
