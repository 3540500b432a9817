"""The EUMOS judge: live equals afterwards, displacements are those of geometry, limits hold at their edges."""

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from config.scene import Scene
from sim_core.frames import Array, PoseFrame, RuleState
from sim_core.geometry import yaw_quaternion
from sim_core.judge import EumosJudge, corner_name, verdict_of

MakeScene = Callable[..., Scene]
Box = Callable[..., dict[str, Any]]
START_NS = 1_000_000_000_000
# Coordinates of about 1 m have roundings of 1e-16 m, so differences have 1e-13 mm; corners take some ten of them.
ROUNDING_MM = 1.0e-11
# The judge takes distances within 1 nm for equal.
TIE_MM = 1.0e-6


def settled(scene: Scene) -> PoseFrame:
    pallet = scene.pallet_box
    half = pallet.size_m[2] / 2.0 if pallet is not None else 0.0
    turns = [yaw_quaternion(package.yaw_deg) for package in scene.packages]
    return PoseFrame(
        index=0,
        stamp_ns=START_NS,
        positions=np.array([(0.0, 0.0, half), *(package.position_m for package in scene.packages)]),
        orientations=np.array([(0.0, 0.0, 0.0, 1.0), *turns]),
    )


def frame_at(
    scene: Scene, index: int, moves: Sequence[Any] = (), turns: dict[int, Any] | None = None, hz: int = 240
) -> PoseFrame:
    """The settled load with packages moved (one vector each, in order) and turned (quaternion by row)."""
    first = settled(scene)
    for row, move in enumerate(moves, start=1):
        first.positions[row] += move
    for row, turn in (turns or {}).items():
        first.orientations[row] = turn
    return PoseFrame(index, START_NS + round(index * 1.0e9 / hz), first.positions, first.orientations)


def judged(scene: Scene, *frames: PoseFrame) -> EumosJudge:
    judge = EumosJudge(scene)
    judge.add(settled(scene))
    for frame in frames:
        judge.add(frame)
    return judge


def rule(judge: EumosJudge, name: str) -> RuleState:
    return next(state for state in judge.rules() if state.rule == name)


@pytest.fixture(scope="module")
def two(make_scene: MakeScene, box: Box) -> Scene:
    """Two cartons on each other on an EUR pallet: bottoms at 0.144 m and 0.394 m, load unit 0.644 m high."""
    return make_scene(box("low", layer=1), box("high", bottom=0.394, layer=2))


moves = st.lists(
    st.tuples(*2 * [st.tuples(*3 * [st.floats(-0.3, 0.3)])], *2 * [st.floats(-math.pi, math.pi)]),
    min_size=1,
    max_size=12,
)


def moving(scene: Scene, path: list[tuple[Any, ...]]) -> list[PoseFrame]:
    """Frames in which the first package turns about z and the second about y, both while they move."""
    return [
        frame_at(
            scene,
            k,
            [low, high],
            {
                1: (0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2)),
                2: (0.0, math.sin(pitch / 2), 0.0, math.cos(pitch / 2)),
            },
        )
        for k, (low, high, yaw, pitch) in enumerate(path, start=1)
    ]


def corners(centre: Array, size: Sequence[float], axis: str, angle: float) -> Array:
    """Corners of a box turned about one axis, by coordinates, shape [8, 3]."""
    cosine, sine = math.cos(angle), math.sin(angle)
    rows = []
    for corner in range(8):
        x, y, z = ((1 if corner >> k & 1 else -1) * size[k] / 2.0 for k in range(3))
        if axis == "z":
            x, y = cosine * x - sine * y, sine * x + cosine * y
        else:
            x, z = cosine * x + sine * z, cosine * z - sine * x
        rows.append((x, y, z))
    return np.array(rows) + centre


@settings(max_examples=60, deadline=None)
@given(path=moves)
def test_asking_at_every_frame_changes_nothing(two: Scene, path: list[tuple[Any, ...]]) -> None:
    asked, silent = judged(two), judged(two)
    for frame in moving(two, path):
        asked.add(frame)
        asked.rules(), asked.packages(), asked.verdict(), asked.series(), asked.moments()
        silent.add(frame)
    assert asked.rules() == silent.rules()
    assert asked.packages() == silent.packages()
    assert asked.series() == silent.series()
    assert [m.frame.index for m in asked.moments()] == [m.frame.index for m in silent.moments()]


@settings(max_examples=60, deadline=None)
@given(path=moves)
def test_peaks_never_fall_and_permanent_is_the_last_frame(two: Scene, path: list[tuple[Any, ...]]) -> None:
    judge = judged(two)
    start = [
        corners(p, q.size_m, "z", 0.0) for p, q in zip(settled(two).positions[1:], two.packages, strict=True)
    ]
    peaks = [0.0, 0.0]
    for frame, (_, _, yaw, pitch) in zip(moving(two, path), path, strict=True):
        before = [package.peak_mm for package in judge.packages()]
        worst_before = rule(judge, "elastic").worst_mm
        judge.add(frame)
        for k, (axis, angle) in enumerate((("z", yaw), ("y", pitch))):
            now = corners(frame.positions[k + 1], two.packages[k].size_m, axis, angle)
            distance = 1000.0 * float(np.linalg.norm(now - start[k], axis=1).max())
            package = judge.packages()[k]
            peaks[k] = max(peaks[k], distance)
            assert package.permanent_mm == pytest.approx(distance, abs=ROUNDING_MM)
            assert package.peak_mm == pytest.approx(peaks[k], abs=TIE_MM + ROUNDING_MM)
            assert package.peak_mm >= before[k]
        assert rule(judge, "elastic").worst_mm >= worst_before - TIE_MM
    assert rule(judge, "elastic").worst_mm == pytest.approx(max(peaks), abs=2.0 * TIE_MM)


@settings(max_examples=60, deadline=None)
@given(x=st.floats(-1.0, 1.0), y=st.floats(-1.0, 1.0), z=st.floats(-0.1, 0.1))
def test_a_translation_is_its_length_at_every_corner(two: Scene, x: float, y: float, z: float) -> None:
    judge = judged(two, frame_at(two, 1, [(0, 0, 0), (x, y, z)]), frame_at(two, 2))
    length_mm = 1000.0 * math.sqrt(x * x + y * y + z * z)
    low, high = judge.packages()
    assert (low.peak_mm, low.permanent_mm, high.permanent_mm) == (0.0, 0.0, 0.0)
    assert high.peak_mm == pytest.approx(length_mm, abs=TIE_MM + ROUNDING_MM)
    elastic = rule(judge, "elastic")
    assert elastic.worst_mm == pytest.approx(length_mm, abs=TIE_MM + ROUNDING_MM)
    if length_mm > 1.0e-3:
        # All eight corners are equally far out: the lowest number is named.
        assert (elastic.package, elastic.corner, elastic.time_s) == (
            "high",
            0,
            pytest.approx(1 / 240, abs=1e-9),
        )


@settings(max_examples=60, deadline=None)
@given(angle=st.floats(-math.pi, math.pi))
def test_a_turn_is_the_chord(two: Scene, angle: float) -> None:
    """A corner at a distance r from the axis moves by 2·r·sin(θ/2): here r = √(0.2² + 0.15²) = 0.25 m about z."""
    turn = (0.0, 0.0, math.sin(angle / 2.0), math.cos(angle / 2.0))
    judge = judged(two, frame_at(two, 1, turns={1: turn}))
    assert judge.packages()[0].permanent_mm == pytest.approx(
        500.0 * abs(math.sin(angle / 2.0)), abs=TIE_MM + ROUNDING_MM
    )
    assert judge.packages()[0].final_displacement_mm == (0.0, 0.0, 0.0)
    # arccos near 1 loses half the digits: √(2·2.2e-16) rad.
    assert judge.packages()[0].final_tilt_deg == pytest.approx(0.0, abs=math.degrees(3.0e-8))


@pytest.mark.parametrize("tilt_deg", [0.5, 5.0, 20.0, 80.0])
def test_on_the_pallet_only_low_corners_count(make_scene: MakeScene, box: Box, tilt_deg: float) -> None:
    """A tall box turned about the line through its base: base corners at r = 0.2 m, top ones at √(0.2² + 0.6²)."""
    scene = make_scene(box("tall", size=(0.4, 0.3, 0.6)))
    angle = math.radians(tilt_deg)
    centre = (0.3 * math.sin(angle), 0.0, 0.3 * math.cos(angle) - 0.3)
    judge = judged(
        scene, frame_at(scene, 1, [centre], {1: (0.0, math.sin(angle / 2), 0.0, math.cos(angle / 2))})
    )
    chord = 2000.0 * math.sin(angle / 2.0)
    low, anywhere = rule(judge, "permanent_on_pallet"), rule(judge, "permanent")
    assert low.worst_mm == pytest.approx(0.2 * chord, abs=TIE_MM + ROUNDING_MM)
    assert anywhere.worst_mm == pytest.approx(math.hypot(0.2, 0.6) * chord, abs=TIE_MM + ROUNDING_MM)
    assert (low.height_m, anywhere.height_m) == (pytest.approx(0.144), pytest.approx(0.744))
    assert judge.packages()[0].final_tilt_deg == pytest.approx(tilt_deg, abs=math.degrees(3.0e-8))
    assert (rule(judge, "damage").state == "fail") == (tilt_deg > 45.0)


def test_a_package_above_20_cm_is_not_on_the_pallet(two: Scene) -> None:
    judge = judged(two, frame_at(two, 1, [(0.0, 0.001, 0.0), (0.3, 0.0, 0.0)]))
    low = rule(judge, "permanent_on_pallet")
    assert (low.package, low.state) == ("low", "pass")
    assert low.worst_mm == pytest.approx(1.0, abs=TIE_MM)
    assert rule(judge, "permanent").state == "fail"


def boundary(make_scene: MakeScene, box: Box, shift: float) -> EumosJudge:
    """A load unit 0.5 m high, all limits at 2⁻⁵ m, everything a sum of powers of two: no rounding at all."""
    scene = make_scene(
        box("a", bottom=0.0, size=(0.5, 0.25, 0.5)),
        pallet=None,
        limits={"permanent_fraction": 0.0625, "elastic_fraction": 0.0625, "base_permanent_m": 0.03125},
    )
    return judged(scene, frame_at(scene, 1, [(shift, 0.0, 0.0)]))


def test_at_the_limit_only_the_rule_of_less_than_fails(make_scene: MakeScene, box: Box) -> None:
    at = boundary(make_scene, box, 0.03125)
    assert [(r.rule, r.state) for r in at.rules()] == [
        ("permanent", "pass"), ("permanent_on_pallet", "fail"), ("elastic", "pass"), ("damage", "pass")
    ]  # fmt: skip
    assert {r.margin_mm for r in at.rules() if r.rule != "damage"} == {0.0}
    below = boundary(make_scene, box, 0.03125 - 2.0**-20)
    assert {r.state for r in below.rules()} == {"pass"}
    assert below.verdict() == "pass"
    above = boundary(make_scene, box, 0.03125 + 2.0**-20)
    assert [r.state for r in above.rules()] == ["fail", "fail", "fail", "pass"]
    assert rule(above, "elastic").margin_mm == -1000.0 * 2.0**-20


def test_limits_are_fractions_of_the_height_above_the_sled(two: Scene) -> None:
    judge = judged(two)
    assert judge.height_m == pytest.approx(0.644)
    assert [rule(judge, name).limit_mm for name in ("permanent", "permanent_on_pallet", "elastic")] == [
        pytest.approx(32.2), pytest.approx(40.0), pytest.approx(64.4)
    ]  # fmt: skip


def test_a_peak_that_returns_breaks_the_elastic_rule_alone(two: Scene) -> None:
    judge = judged(two, frame_at(two, 1, [(0, 0, 0), (0.08, 0, 0)]), frame_at(two, 2))
    assert [r.state for r in judge.rules()] == ["pass", "pass", "fail", "pass"]
    worst = next(m for m in judge.moments() if m.name == "worst")
    assert (worst.frame.index, worst.time_s) == (1, pytest.approx(1 / 240, abs=1e-9))
    assert [m.name for m in judge.moments()] == ["settled", "worst", "end"]


def test_a_fallen_package_is_named(two: Scene) -> None:
    """Half of its height of 0.25 m is the limit of a drop."""
    assert rule(judged(two, frame_at(two, 1, [(0, 0, 0), (0, 0, -0.12)])), "damage").state == "pass"
    fallen = rule(judged(two, frame_at(two, 1, [(0, 0, 0), (0.5, 0, -0.13)])), "damage")
    assert (fallen.state, fallen.package, fallen.limit_mm) == ("fail", "high", None)


def test_a_toppled_package_that_stands_up_again_is_not_damaged(two: Scene) -> None:
    quarter = (0.0, math.sqrt(0.5), 0.0, math.sqrt(0.5))
    over = frame_at(two, 1, turns={2: quarter})
    assert rule(judged(two, over), "damage").package == "high"
    assert rule(judged(two, over, frame_at(two, 2)), "damage").state == "pass"


def test_layers_are_judged_against_each_other_when_asked(make_scene: MakeScene, box: Box, two: Scene) -> None:
    assert [r.rule for r in judged(two).rules()] == ["permanent", "permanent_on_pallet", "elastic", "damage"]
    boxes = [box("a", x=-0.2, layer=1), box("b", x=0.2, layer=1), box("c", bottom=0.394, layer=2)]
    scene = make_scene(*boxes, limits={"layer_fraction": 0.02})
    # Layer 1 moves by (10 + 2)/2 mm on average, layer 2 by 20 mm; later all move together.
    judge = judged(scene, frame_at(scene, 1, [(0.01, 0, 0), (0.002, 0, 0), (0.02, 0, 0)]))
    assert rule(judge, "layers").worst_mm == pytest.approx(14.0, abs=ROUNDING_MM)
    assert rule(judge, "layers").limit_mm == pytest.approx(12.88)
    assert rule(judge, "layers").state == "fail"
    judge.add(frame_at(scene, 2, 3 * [(0.3, 0, 0)]))
    assert rule(judge, "layers").worst_mm == pytest.approx(14.0, abs=ROUNDING_MM)


@pytest.mark.parametrize("names", [["low"], ["low", "high"]])
@pytest.mark.parametrize("peak_at", [1, 37, 98])
def test_the_series_is_thinned_but_keeps_the_peak(
    make_scene: MakeScene, box: Box, names: list[str], peak_at: int
) -> None:
    boxes = [box(name, bottom=0.144 + 0.25 * k) for k, name in enumerate(names)]
    scene = make_scene(*boxes)
    frames = [
        frame_at(scene, k, len(names) * [(0.123 if k == peak_at else 0.0, 0.0, 0.0)], hz=960)
        for k in range(1, 100)
    ]
    series = judged(scene, *frames).series(rate_hz=60.0)
    assert [max(row) for row in series.displacement_mm] == [pytest.approx(123.0, abs=ROUNDING_MM)] * len(
        series.bands
    )
    # 99 intervals of 1/960 s hold 6 of 1/60 s; beside them stand the peak and the last frame.
    assert series.times_s[0] == 0.0
    assert series.times_s[-1] == pytest.approx(99 / 960, abs=1e-9)
    assert 7 <= len(series.times_s) <= 9
    assert series.times_s == sorted(set(series.times_s))
    assert all(len(row) == len(series.times_s) for row in series.displacement_mm)


def test_bands_reach_from_the_deck_to_the_top(two: Scene) -> None:
    """Six bands of 0.5 m: corners at 0.144, 0.394 and 0.644 m; a corner on an edge belongs to the band below."""
    series = judged(two, frame_at(two, 1, [(0.01, 0, 0), (0.02, 0, 0)])).series()
    assert series.band_edges_m == pytest.approx([0.144 + k * 0.5 / 6 for k in range(7)])
    assert series.bands == [0, 2, 5]
    assert [row[-1] for row in series.displacement_mm] == pytest.approx([10.0, 20.0, 20.0])


def test_an_empty_pallet_passes(make_scene: MakeScene) -> None:
    scene = make_scene()
    judge = judged(scene, frame_at(scene, 1))
    assert judge.verdict() == "pass"
    assert judge.packages() == []
    assert judge.series().displacement_mm == []
    assert judge.height_m == pytest.approx(0.144)


def test_another_number_of_poses_is_refused(two: Scene) -> None:
    judge = judged(two)
    long = settled(two)
    for count in (0, 2, 4):
        rows = np.resize(long.positions, (count, 3)), np.resize(long.orientations, (count, 4))
        with pytest.raises(ValueError, match=f"{count} poses, the scene 3 bodies"):
            judge.add(PoseFrame(1, START_NS, *rows))
    assert judge.frame_count == 1
    assert judge.verdict() == "pass"


def test_no_frame_is_no_answer(two: Scene) -> None:
    with pytest.raises(ValueError, match="no frame"):
        EumosJudge(two).rules()


def state(value: Any) -> RuleState:
    return RuleState("r", "rule", value, None, None, None)


@pytest.mark.parametrize(
    ("states", "verdict"),
    [
        ([], "pass"),
        (["pass", "off"], "pass"),
        (["pass", "unresolved", "off"], "unresolved"),
        (["unresolved", "fail", "pass"], "fail"),
    ],
)
def test_the_verdict_of_states(states: list[str], verdict: str) -> None:
    assert verdict_of([state(value) for value in states]) == verdict


def test_corner_names() -> None:
    assert corner_name(0) == "-x -y -z"
    assert corner_name(5) == "+x -y +z"


def test_layers_follow_from_heights_where_no_package_names_its_own(make_scene: MakeScene, box: Box) -> None:
    scene = make_scene(box("low"), box("top", bottom=0.144 + 0.25), limits={"layer_fraction": 0.02})
    judge = EumosJudge(scene)
    positions = np.array([(0.0, 0.0, 0.072), *(package.position_m for package in scene.packages)])
    turns = np.tile([0.0, 0.0, 0.0, 1.0], (3, 1))
    judge.add(PoseFrame(0, 10**9, positions, turns))
    positions = positions.copy()
    positions[2, 0] += 0.05
    judge.add(PoseFrame(1, 2 * 10**9, positions, turns))
    rules = {rule.rule: rule for rule in judge.rules()}
    assert rules["layers"].worst_mm == pytest.approx(50.0)
    assert rules["layers"].state == "fail"
