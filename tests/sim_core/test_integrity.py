"""The integrity check: what it refuses, what it only mentions, and what it lets pass."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from config.errors import RefusedInput
from config.scene import Scene
from sim_core.geometry import polygon_area
from sim_core.integrity import Finding, check_integrity, deepest_overlaps, require_integrity, supports

MakeScene = Callable[..., Scene]
Box = Callable[..., dict[str, Any]]


def found(scene: Scene, severity: str = "error") -> list[tuple[str, str]]:
    return [(f.check, f.subject) for f in check_integrity(scene) if f.severity == severity]


def only(scene: Scene, check: str) -> Finding:
    (finding,) = [f for f in check_integrity(scene) if f.check == check]
    return finding


def test_an_empty_pallet_and_one_package_are_fit(make_scene: MakeScene, box: Box) -> None:
    assert require_integrity(make_scene()) == []
    assert require_integrity(make_scene(pallet=None)) == []
    assert require_integrity(make_scene(box("a"))) == []
    assert require_integrity(make_scene(box("a", bottom=0.0), pallet=None)) == []


def test_boxes_that_touch_are_fit(make_scene: MakeScene, box: Box) -> None:
    grid = [
        box(f"{x}{y}{z}", x=0.4 * x, y=0.3 * y, bottom=0.144 + 0.25 * z)
        for x in (-1, 0, 1) for y in (-0.5, 0.5) for z in (0, 1, 2)
    ]  # fmt: skip
    assert check_integrity(make_scene(*grid)) == []


def test_an_overlap_names_the_two_and_its_depth(make_scene: MakeScene, box: Box) -> None:
    scene = make_scene(box("left"), box("right", x=0.35), box("far", x=-0.45))
    with pytest.raises(RefusedInput) as caught:
        require_integrity(scene)
    # 0.4 m of length, 0.35 m apart.
    assert str(caught.value) == "overlap of left and right = 50.00 mm: at most 1 mm"


def test_the_deepest_overlap_comes_first(make_scene: MakeScene, box: Box) -> None:
    scene = make_scene(box("a"), box("b", x=0.39), box("c", x=-0.2))
    depths = [(round(depth, 9), one.id, two.id) for depth, one, two in deepest_overlaps(scene.packages)]
    assert depths == [(0.2, "a", "c"), (0.01, "a", "b")]
    with pytest.raises(RefusedInput, match=r"a and c = 200\.00 mm: at most 1 mm \(1 more\)"):
        require_integrity(scene)


@pytest.mark.parametrize(("depth_mm", "severity"), [(0.5, "note"), (0.999, "note"), (1.001, "error")])
def test_an_overlap_of_a_millimetre_is_the_limit(
    make_scene: MakeScene, box: Box, depth_mm: float, severity: str
) -> None:
    finding = only(make_scene(box("a"), box("b", x=0.4 - depth_mm / 1000.0)), "overlap")
    assert finding.severity == severity
    assert finding.value.endswith(f"{depth_mm:.2f} mm")


@settings(max_examples=60, deadline=None)
@given(x=st.floats(-0.5, 0.5), y=st.floats(-0.5, 0.5), z=st.floats(-0.3, 0.3))
def test_overlap_is_refused_exactly_above_a_millimetre(
    make_scene: MakeScene, box: Box, x: float, y: float, z: float
) -> None:
    """Two equal boxes overlap by their edge minus their distance, along the axis where that is least."""
    scene = make_scene(box("a", bottom=1.0), box("b", x=x, y=y, bottom=1.0 + z), pallet=None)
    depth = min(0.4 - abs(x), 0.3 - abs(y), 0.25 - abs(z))
    if abs(depth - 0.001) > 1.0e-9:
        assert (("overlap", "a and b") in found(scene)) == (depth > 0.001)


def test_turned_packages_are_measured_as_they_stand(make_scene: MakeScene, box: Box) -> None:
    assert found(make_scene(box("a"), box("b", x=0.35, yaw_deg=90.0))) == []
    # Turned by 45°, the corner of the second reaches (0.4 + 0.3)/2·√½ = 0.247 m towards the first's face at 0.2 m.
    assert found(make_scene(box("a"), box("b", x=0.45, yaw_deg=45.0))) == []
    turned = make_scene(box("a"), box("b", x=0.44, yaw_deg=45.0))
    assert only(turned, "overlap").value == f"{1000 * (0.2 + 0.7 / 2 * 0.5**0.5 - 0.44):.2f} mm"


def test_a_package_inside_the_pallet_is_an_overlap(make_scene: MakeScene, box: Box) -> None:
    """The height counted from the deck instead of from the sled: the box stands in the pallet."""
    assert found(make_scene(box("a", bottom=0.0))) == [("overlap", "pallet and a")]
    assert found(make_scene(box("a", bottom=0.094))) == [("overlap", "pallet and a"), ("support", "a")]


@pytest.mark.parametrize("gap_mm", [2.5, 10.0, 300.0])
def test_a_floating_package_is_refused(make_scene: MakeScene, box: Box, gap_mm: float) -> None:
    scene = make_scene(box("a"), box("b", bottom=0.394 + gap_mm / 1000.0))
    with pytest.raises(RefusedInput, match=f"support of b = {gap_mm} mm above what is below it: must stand"):
        require_integrity(scene)


def test_a_gap_of_rounding_is_no_gap(make_scene: MakeScene, box: Box) -> None:
    assert check_integrity(make_scene(box("a"), box("b", bottom=0.3955))) == []


def test_a_centre_outside_its_support_is_refused(make_scene: MakeScene, box: Box) -> None:
    scene = make_scene(box("below"), box("above", x=0.25, bottom=0.394))
    with pytest.raises(RefusedInput, match=r"support of above = centre 50\.0 mm outside its support"):
        require_integrity(scene)
    assert found(make_scene(box("below"), box("above", x=0.19, bottom=0.394))) == []


def test_a_bridge_stands_on_both_its_piers(make_scene: MakeScene, box: Box) -> None:
    pier = {"size": (0.1, 0.3, 0.25)}
    piers = box("west", x=-0.15, **pier), box("east", x=0.15, **pier)
    scene = make_scene(*piers, box("bridge", bottom=0.394))
    assert found(scene) == []
    # A quarter of the bridge's 0.4 m lies on each pier.
    assert sorted((s.below, round(s.area_m2, 9)) for s in supports(scene) if s.package == 2) == [
        (0, 0.03),
        (1, 0.03),
    ]
    assert found(make_scene(*piers, box("bridge", bottom=0.394, size=(0.7, 0.3, 0.2))), "warning") == [
        ("support", "bridge")
    ]


def test_supports_say_what_stands_on_what(make_scene: MakeScene, box: Box) -> None:
    scene = make_scene(box("a", x=-0.2), box("b", x=0.2), box("c", bottom=0.394))
    standing = [
        (s.package, s.below, round(s.area_m2, 9), round(polygon_area(s.patch), 9)) for s in supports(scene)
    ]
    assert standing == [(0, -1, 0.12, 0.12), (1, -1, 0.12, 0.12), (2, 0, 0.06, 0.06), (2, 1, 0.06, 0.06)]
    bare = make_scene(box("a", bottom=0.0), pallet=None)
    assert [(s.package, s.below) for s in supports(bare)] == [(0, -2)]


def test_a_package_off_the_pallet_is_refused(make_scene: MakeScene, box: Box) -> None:
    assert ("position", "a") in found(make_scene(box("a", x=0.7)))
    assert only(make_scene(box("a", x=0.7)), "position").value == "centre 100.0 mm off the pallet"
    assert ("position", "a") in found(make_scene(box("a", y=-1.0, bottom=0.0)))


@pytest.mark.parametrize(("x", "severity"), [(0.4, None), (0.43, "note"), (0.46, "warning")])
def test_overhang_is_mentioned(make_scene: MakeScene, box: Box, x: float, severity: str | None) -> None:
    findings = check_integrity(make_scene(box("a", x=x)))
    assert [(f.severity, f.check) for f in findings] == ([] if severity is None else [(severity, "overhang")])
    if findings:
        assert findings[0].value == f"{1000 * (x - 0.4):.1f} mm beyond the pallet's edge"


@pytest.mark.parametrize(
    ("change", "check"),
    [
        # 0.03 m³: 3 g where 3 kg were meant, and 30 t.
        ({"mass": 0.003}, "density"),
        ({"mass": 300.0}, "density"),
        # Metres typed as millimetres / 10: 4 m long, and 4 mm thin.
        ({"size": (4.0, 0.3, 0.25), "mass": 100.0}, "size"),
        ({"size": (0.4, 0.3, 0.004), "mass": 1.0}, "size"),
    ],
)
def test_slips_of_units_are_mentioned(
    make_scene: MakeScene, box: Box, change: dict[str, Any], check: str
) -> None:
    assert (check, "a") in found(make_scene(box("a", bottom=0.0, **change), pallet=None), "warning")


def test_more_than_the_pallet_may_carry_is_mentioned(make_scene: MakeScene, box: Box) -> None:
    heavy = [box(f"b{k}", bottom=0.144 + 0.25 * k, mass=200.0) for k in range(8)]
    finding = only(make_scene(*heavy), "mass")
    assert (finding.severity, finding.value) == ("warning", "1600 kg")
    assert check_integrity(make_scene(*heavy[:7])) == []


def test_the_smallest_box_does_not_break_the_check(make_scene: MakeScene, box: Box) -> None:
    dust = make_scene(box("dust", size=(1.0e-300,) * 3, mass=1.0e-300))
    assert ("support", "dust") in found(dust)


def test_missing_friction_is_refused_where_it_is_needed(make_scene: MakeScene, box: Box) -> None:
    rare = box("a", surface="aluminium"), box("b", bottom=0.394, surface="steel")
    assert found(make_scene(*rare)) == [("friction", "aluminium on steel")]
    with pytest.raises(
        RefusedInput, match="friction of aluminium on steel = missing: add the pair to surfaces"
    ):
        require_integrity(make_scene(*rare))
    told = {"pairs": [{"between": ["steel", "aluminium"], "friction": 0.2}]}
    assert found(make_scene(*rare, surfaces=told)) == []
    # Side by side they don't bear each other: nothing is missing yet.
    apart = box("a", surface="aluminium"), box("b", x=0.4, surface="cardboard")
    assert found(make_scene(*apart)) == []


def test_a_profile_that_cannot_be_built_is_refused_with_the_load(make_scene: MakeScene, box: Box) -> None:
    backwards = {"profile": "eumos", "level_g": 0.1, "deceleration_g": 2.0, "fall_s": 0.5}
    with pytest.raises(RefusedInput, match=r"sled\.fall_s"):
        require_integrity(make_scene(box("a"), sled=backwards))
    with pytest.raises(RefusedInput, match=r"sled\.bag"):
        require_integrity(make_scene(box("a"), sled={"profile": "recorded"}))


def test_errors_come_first(make_scene: MakeScene, box: Box) -> None:
    scene = make_scene(box("light", mass=0.01, x=-0.4), box("floating", bottom=1.0, x=0.43))
    severities = [finding.severity for finding in check_integrity(scene)]
    assert severities == sorted(severities, key=["error", "warning", "note"].index)
    assert set(severities) == {"error", "warning", "note"}


def test_a_load_of_500_packages_is_checked_whole(make_scene: MakeScene, box: Box) -> None:
    places = np.array(np.meshgrid(np.arange(10), np.arange(10), np.arange(5))).reshape(3, -1).T
    load = [
        box(
            f"b{k}",
            x=0.1 * x - 0.45,
            y=0.07 * y - 0.315,
            bottom=0.144 + 0.1 * z,
            size=(0.1, 0.07, 0.1),
            mass=0.5,
        )
        for k, (x, y, z) in enumerate(places.tolist())
    ]
    scene = make_scene(*load)
    assert check_integrity(scene) == []
    assert len(supports(scene)) == 500
    # The fifth of its column, with nothing on top.
    lifted = {**load[79], "position_m": (*load[79]["position_m"][:2], 0.75)}
    assert found(make_scene(*load[:79], lifted, *load[80:])) == [("support", "b79")]
