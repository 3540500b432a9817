"""The scene model: what it refuses by name, what it means, and that it survives a round trip."""

import json
import math
import subprocess
import sys
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from config.errors import RefusedInput
from config.materials import material_library
from config.scene import Scene, direction_vector
from config.scene_file import scene_from_json, validate_scene

EUMOS = {"profile": "eumos", "level_g": 0.5}


def package(**changes: Any) -> dict[str, Any]:
    return {"id": "a", "size_m": [0.4, 0.3, 0.25], "mass_kg": 10, "position_m": [0, 0, 0.269], **changes}


def raw(*packages: dict[str, Any], **parts: Any) -> dict[str, Any]:
    return {"name": "t", "load": {"packages": packages or [package()]}, "sled": EUMOS, **parts}


def sled(**changes: Any) -> dict[str, Any]:
    return raw(sled={**EUMOS, **changes})


def table(times: list[float], values: list[float]) -> dict[str, Any]:
    return raw(sled={"profile": "table", "times_s": times, "acceleration_mps2": values})


NAN, INF = math.nan, math.inf
REFUSED: list[tuple[Any, str, str]] = [
    (raw(package(mass_kg=0)), "load.packages.0.mass_kg = 0", "greater than 0"),
    (raw(package(mass_kg=-3)), "load.packages.0.mass_kg = -3", "greater than 0"),
    (raw(package(mass_kg=NAN)), "load.packages.0.mass_kg = nan", "greater than 0|finite"),
    (raw(package(mass_kg=INF)), "load.packages.0.mass_kg = inf", "less than or equal|finite"),
    (raw(package(mass_kg="10 kg")), "load.packages.0.mass_kg = 10 kg", "number"),
    (raw(package(mass_kg=10**400)), "load.packages.0.mass_kg = 1000", "number"),
    (raw(package(size_m=[0.4, 0, 0.2])), "load.packages.0.size_m.1 = 0", "greater than 0"),
    (raw(package(size_m=[0.4, 0.3, -0.2])), "load.packages.0.size_m.2 = -0.2", "greater than 0"),
    (raw(package(size_m=[NAN, 0.3, 0.2])), "load.packages.0.size_m.0 = nan", "greater than 0|finite"),
    (raw(package(size_m=[400, 300, 250])), "load.packages.0.size_m.0 = 400", "millimetres"),
    (raw(package(size_m=[0.4, 0.3])), "load.packages.0.size_m", "required"),
    (raw(package(position_m=[0, INF, 0])), "load.packages.0.position_m.1 = inf", "finite"),
    (raw(package(yaw_deg=NAN)), "load.packages.0.yaw_deg = nan", "finite"),
    (raw(package(colour="red")), "load.packages.0.colour = red", "unknown key"),
    (raw(package(id="")), "load.packages.0.id = ", "at least 1 character"),
    (raw(package(id="pallet")), "load = {1 keys}", "'pallet' is taken"),
    (raw(package(), package()), "load = {1 keys}", "'a' must be unique"),
    (raw(package(id="\ud800")), "load.packages.0.id", "unicode"),
    (raw(description="\ud800"), "description", "unicode"),
    (raw(weight=3), "weight = 3", "unknown key"),
    (raw(name=""), "name = ", "at least 1 character"),
    (raw(name="../../etc"), "name = ../../etc", "match"),
    (raw(seed=-1), "seed = -1", "greater than or equal to 0"),
    (raw(seed=0.5), "seed = 0.5", "integer"),
    ({"name": "t", "load": {}}, "sled = missing", "is required"),
    (sled(level_g=2.0001), "sled.level_g = 2.0001", "less than or equal to 2"),
    (sled(level_g=-0.1), "sled.level_g = -0.1", "greater than or equal to 0"),
    (sled(level_g=NAN), "sled.level_g = nan", "finite"),
    (sled(plateau_s=0), "sled.plateau_s = 0", "greater than or equal to 0.3"),
    (sled(rise_s=0.06), "sled.rise_s = 0.06", "less than or equal to 0.05"),
    (sled(deceleration_g=0), "sled.deceleration_g = 0", "greater than 0"),
    (sled(direction="up"), "sled.direction", r"'\+x', '-x', '\+y' or '-y'"),
    (sled(direction=361.0), "sled.direction", "'-y'"),
    (sled(level=0.5), "sled.level = 0.5", "unknown key"),
    (raw(sled={"profile": "sine"}), "sled.profile = sine", "'eumos', 'table', 'recorded'"),
    (table([0, 1], [1]), "sled.acceleration_mps2", "at least 2"),
    (table([0, 1, 2], [1, 1]), "sled = {3 keys}", "3 points and acceleration_mps2 2"),
    (table([1, 0], [1, 1]), "sled = {3 keys}", "never fall"),
    (table([-1, 0], [1, 1]), "sled = {3 keys}", "start at 0"),
    (table([0, 61], [1, 1]), "sled = {3 keys}", "60 s"),
    (table([0, 1], [1, 1001]), "sled = {3 keys}", "1000 m/s²"),
    (table([0, NAN], [1, 1]), "sled.times_s.1 = nan", "finite"),
    (raw(pallet={"kind": "epal2"}), "pallet.kind = epal2", "'epal1'"),
    (raw(pallet={"size_m": [1.2, 0.8, 0.1], "mass_kg": 0}), "pallet.mass_kg = 0", "greater than 0"),
    (raw(pallet={"size_m": [1200, 800, 144], "mass_kg": 25}), "pallet.size_m.0 = 1200", "millimetres"),
    (raw(load={"file": "a.xml", "packages": []}), "load.packages = []", "unknown key"),
    (raw(load={"file": "a.xml", "clearance_m": 0.03}), "load.clearance_m = 0.03", "0.02"),
    (raw(load=[]), "load = []", "dictionary"),
    (
        raw(surfaces={"pairs": [{"between": ["a", "b"], "friction": -1}]}),
        "surfaces.pairs.0.friction = -1",
        "0",
    ),
    (raw(force_fields={"distance_m": 0.0}), "force_fields.distance_m = 0.0", "0.005"),
    (raw(force_fields={"tension": INF}), "force_fields.tension = inf", "finite|1000000000"),
    (raw(accelerometer={"rate_hz": 0}), "accelerometer.rate_hz = 0", "10"),
    (raw(limits={"permanent_fraction": 0}), "limits.permanent_fraction = 0", "greater than 0"),
    (raw(sampling={"samples_hz": 1000}), "sampling = {1 keys}", "multiple of poses_hz 240"),
    (raw(solver={"iterations": 0}), "solver.iterations = 0", "1"),
    (raw(solver={"time_step_s": 0.0021}), "scene = ", "whole number of sled samples"),
    ([], "scene = []", "dictionary"),
    (None, "scene = None", "dictionary"),
]


@pytest.mark.parametrize(("scene", "field_and_value", "limit"), REFUSED)
def test_a_wrong_value_is_named_with_its_limit(scene: Any, field_and_value: str, limit: str) -> None:
    with pytest.raises(RefusedInput, match=limit) as caught:
        validate_scene(scene)
    message = str(caught.value)
    assert message.startswith(field_and_value)
    assert message.splitlines() == [message]
    assert len(message) < 400
    assert caught.value.exit_code == 2


def test_of_several_faults_the_first_is_named_and_the_rest_counted() -> None:
    with pytest.raises(RefusedInput, match=r"mass_kg = 0: .* \(2 more like this\)"):
        validate_scene(raw(package(mass_kg=0, yaw_deg=NAN, x=1)))


edges = st.floats(0.01, 5.0)
placed = st.fixed_dictionaries(
    {
        "size_m": st.tuples(edges, edges, edges),
        "mass_kg": st.floats(1.0e-3, 5000.0),
        "position_m": st.tuples(*3 * [st.floats(-1.0e2, 1.0e2)]),
    },
    optional={
        "yaw_deg": st.floats(-1.0e6, 1.0e6),
        "layer": st.integers(1, 99),
        "kind": st.just("interlayer"),
    },
)
sleds = st.one_of(
    st.fixed_dictionaries(
        {"profile": st.just("eumos"), "level_g": st.floats(0.0, 2.0)},
        optional={
            "direction": st.sampled_from(["+x", "-y"]) | st.floats(-360.0, 360.0),
            "fall_s": st.just(0),
        },
    ),
    st.fixed_dictionaries(
        {
            "profile": st.just("table"),
            "times_s": st.lists(st.floats(0.0, 60.0), min_size=3, max_size=3).map(sorted),
            "acceleration_mps2": st.lists(st.floats(-1000.0, 1000.0), min_size=3, max_size=3),
        }
    ),
    st.fixed_dictionaries(
        {
            "profile": st.just("recorded"),
            "samples_mps2": st.lists(st.tuples(*3 * [st.floats(-99.0, 99.0)]), max_size=4),
        }
    ),
)
scenes = st.fixed_dictionaries(
    {
        "name": st.from_regex(r"\A[A-Za-z0-9][A-Za-z0-9_.-]{0,20}\Z"),
        "load": st.lists(placed, max_size=4).map(
            lambda boxes: {"packages": [{"id": f"p{k}", **box} for k, box in enumerate(boxes)]}
        ),
        "sled": sleds,
    },
    optional={
        "description": st.text(max_size=40),
        "pallet": st.sampled_from(
            [None, {"kind": "epal1"}, {"size_m": [1, 1, 0.1], "mass_kg": 9, "fixed": False}]
        ),
        "force_fields": st.just({"tension": 2.5}),
        "accelerometer": st.just({"rate_hz": 500}),
        "limits": st.just({"layer_fraction": 0.02}),
        "seed": st.integers(0, 2**32 - 1),
    },
)


@settings(max_examples=60, deadline=None)
@given(source=scenes)
def test_json_to_scene_and_back(source: dict[str, Any]) -> None:
    scene = validate_scene(source)
    text = scene.to_json()
    again = scene_from_json(text)
    assert again == scene
    assert again.to_json() == text
    assert again.sha256 == scene.sha256
    # Through any other JSON writer too, whatever its order and spacing.
    shuffled = json.dumps(dict(reversed(json.loads(text).items())), indent=2)
    assert scene_from_json(shuffled).sha256 == scene.sha256


def test_the_digest_is_of_what_the_scene_means() -> None:
    plain = validate_scene(raw())
    spelt_out = validate_scene(
        raw(package(mass_kg=10.0, surface="cardboard"), pallet={"kind": "epal1", "fixed": True}, seed=0)
    )
    assert plain.sha256 == spelt_out.sha256
    assert plain.sha256 != validate_scene(raw(package(mass_kg=10.000001))).sha256
    code = "import sys; from config.scene_file import scene_from_json as f; print(f(sys.stdin.read()).sha256)"
    other = subprocess.run(
        [sys.executable, "-c", code], input=json.dumps(raw()), capture_output=True, text=True, check=True
    )
    assert other.stdout.strip() == plain.sha256


@pytest.mark.parametrize(
    ("samples_hz", "poses_hz", "step", "expected"),
    [
        (960, 240, None, (1, 2)),
        (480, 240, None, (1, 1)),
        (240, 240, None, (2, 1)),
        (960, 240, 1 / 960, (1, 1)),
        (960, 240, 1 / 4800, (5, 1)),
        (960, 240, 1 / 240, (1, 4)),
        (1000, 250, 0.002, (1, 2)),
        (1000, 250, 0.004, (1, 4)),
        (1000, 100, 0.0002, (5, 1)),
        (8000, 1000, 1 / 1000, (1, 8)),
        (60, 60, 1e-5 * 5 / 3, (1000, 1)),
    ],
)
def test_steps_and_samples(
    samples_hz: int, poses_hz: int, step: float | None, expected: tuple[int, int]
) -> None:
    scene = validate_scene(
        raw(sampling={"samples_hz": samples_hz, "poses_hz": poses_hz}, solver={"time_step_s": step})
    )
    steps, samples = scene.steps_and_samples()
    assert (steps, samples) == expected
    # The step in use is the exact fraction, so that no rounding of the file's figure adds up.
    assert scene.time_step_s == samples / (steps * samples_hz)
    assert scene.time_step_s == pytest.approx(step or 1 / 480, rel=1.0e-6)


@pytest.mark.parametrize(
    ("samples_hz", "poses_hz", "step"),
    [
        (1000, 250, None),
        (960, 240, 1 / 640),
        (960, 240, 1 / 320),
        (960, 240, 1 / 120),
        (960, 480, 1 / 240),
        (960, 240, 0.001),
    ],
)
def test_steps_that_fit_no_samples_are_refused(samples_hz: int, poses_hz: int, step: float | None) -> None:
    with pytest.raises(RefusedInput, match=r"solver\.time_step_s"):
        validate_scene(
            raw(sampling={"samples_hz": samples_hz, "poses_hz": poses_hz}, solver={"time_step_s": step})
        )


@given(rate=st.sampled_from([60, 480, 960, 1000]), fine=st.integers(1, 12), coarse=st.integers(1, 12))
def test_any_whole_fraction_or_multiple_fits(rate: int, fine: int, coarse: int) -> None:
    finer = validate_scene(
        raw(sampling={"samples_hz": rate, "poses_hz": 1}, solver={"time_step_s": 1 / (fine * rate)})
    )
    assert finer.steps_and_samples() == (fine, 1)
    if rate % coarse == 0 and coarse / rate <= 0.02:
        coarser = validate_scene(
            raw(
                sampling={"samples_hz": rate, "poses_hz": rate // coarse},
                solver={"time_step_s": coarse / rate},
            )
        )
        assert coarser.steps_and_samples() == (1, coarse)


@pytest.mark.parametrize(
    ("direction", "vector"),
    [
        ("+x", (1, 0)), ("-x", (-1, 0)), ("+y", (0, 1)), ("-y", (0, -1)),
        (0.0, (1, 0)), (90.0, (0, 1)), (180.0, (-1, 0)), (270.0, (0, -1)), (360.0, (1, 0)),
        (-90.0, (0, -1)), (-180.0, (-1, 0)), (-360.0, (1, 0)),
    ],
)  # fmt: skip
def test_quarter_turns_are_exact(direction: str | float, vector: tuple[int, int]) -> None:
    assert direction_vector(direction) == vector


@given(direction=st.floats(-360.0, 360.0))
def test_directions_are_unit_vectors_from_x_towards_y(direction: float) -> None:
    x, y = direction_vector(direction)
    assert math.hypot(x, y) == pytest.approx(1.0, abs=1.0e-15)
    # The turn from the given angle, by the cross product; an angle of 2π rounds at 4e-16.
    assert x * math.sin(math.radians(direction)) - y * math.cos(math.radians(direction)) == pytest.approx(
        0.0, abs=2.0e-15
    )


def test_the_pallet_as_a_box() -> None:
    epal = validate_scene(raw()).pallet_box
    kind = material_library().pallets["epal1"]
    assert epal is not None
    assert (epal.size_m, epal.mass_kg, epal.surface, epal.fixed) == (kind.size_m, 25.0, "wood", True)
    assert validate_scene(raw(pallet=None)).pallet_box is None
    own = validate_scene(raw(pallet={"size_m": [1, 2, 0.2], "mass_kg": 7, "surface": "plastic"})).pallet_box
    assert own is not None
    assert (own.size_m, own.surface) == ((1.0, 2.0, 0.2), "plastic")


def test_what_is_not_fetched_yet_has_no_packages() -> None:
    scene = validate_scene(raw(load={"file": "a.xml"}, pallet={"kind": "file"}))
    with pytest.raises(TypeError, match="load is not resolved"):
        _ = scene.packages
    with pytest.raises(TypeError, match="pallet is not resolved"):
        _ = scene.pallet_box


def test_scenes_do_not_change() -> None:
    scene = validate_scene(raw())
    with pytest.raises(ValueError, match="frozen"):
        scene.seed = 1


def test_the_schema_is_json_and_lists_the_parts() -> None:
    schema = json.loads(json.dumps(Scene.model_json_schema(), allow_nan=False))
    assert set(schema["properties"]) == {
        "name", "description", "load", "pallet", "surfaces", "sled", "force_fields", "accelerometer", "limits",
        "sampling", "solver", "seed", "wrap", "camera",
    }  # fmt: skip
    assert set(schema["required"]) == {"name", "load", "sled"}
    assert schema["additionalProperties"] is False
    definitions = schema["$defs"]
    assert {"PackagesLoad", "FileLoad", "Package", "EumosSled", "TableSled", "RecordedSled"} <= set(
        definitions
    )
    assert definitions["EumosSled"]["properties"]["level_g"]["maximum"] == 2.0
    assert definitions["EumosSled"]["properties"]["plateau_s"]["minimum"] == 0.3
    references = [part["$ref"] for part in _objects(schema) if "$ref" in part]
    assert references
    assert {reference.removeprefix("#/$defs/") for reference in references} <= set(definitions)


def _objects(value: Any) -> list[dict[str, Any]]:
    children = value.values() if isinstance(value, dict) else value if isinstance(value, list) else []
    own = [value] if isinstance(value, dict) else []
    return own + [found for child in children for found in _objects(child)]
