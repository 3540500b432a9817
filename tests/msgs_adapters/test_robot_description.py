"""The URDF names every package's frame, whatever characters its id has."""

from xml.etree import ElementTree

from hypothesis import given, settings
from hypothesis import strategies as st

from config.package import Package
from msgs_adapters.robot_description import robot_description
from msgs_adapters.topics import package_frame

ids = st.text(st.characters(codec="utf-8"), min_size=1, max_size=20)


@settings(max_examples=60, deadline=None)
@given(st.lists(ids, unique=True, max_size=5), st.booleans())
def test_one_link_a_package_with_its_box(names: list[str], with_pallet: bool) -> None:
    packages = [
        Package(id=name, size_m=(0.4, 0.3, 0.25), mass_kg=1.0, position_m=(0.0, 0.0, 0.1)) for name in names
    ]
    robot = ElementTree.fromstring(robot_description(packages, (1.2, 0.8, 0.144) if with_pallet else None))
    boxes = ["pallet"] * with_pallet + [package_frame(name) for name in names]
    assert [link.get("name") for link in robot.iter("link")] == ["sled", *boxes]
    assert [child.get("link") for child in robot.iter("child")] == boxes
    assert {parent.get("link") for parent in robot.iter("parent")} <= {"sled"}
    sizes = [box.get("size") for box in robot.iter("box")]
    assert sizes == ["1.2 0.8 0.144"] * with_pallet + ["0.4 0.3 0.25"] * len(names)
