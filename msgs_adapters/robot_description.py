"""The load as URDF, so that viewers draw its boxes where the frames of /tf are."""

from collections.abc import Sequence
from xml.etree.ElementTree import Element, SubElement, indent, tostring

from config.package import Package
from msgs_adapters.colours import PALLET_COLOUR, Colour, package_colour
from msgs_adapters.topics import PALLET_FRAME, SLED_FRAME, package_frame

Size = tuple[float, float, float]


def robot_description(packages: Sequence[Package], pallet_size_m: Size | None) -> str:
    """URDF with root link ``sled`` and one link a package and one for the pallet, each on a floating joint.

    Links carry the names of the frames in /tf.

    Args:
        packages: the load in scene order.
        pallet_size_m: the pallet's outer edge lengths [m]; none when packages stand on the sled itself.
    """
    robot = Element("robot", name="load_unit")
    SubElement(robot, "link", name=SLED_FRAME)
    if pallet_size_m is not None:
        _add_box(robot, PALLET_FRAME, pallet_size_m, PALLET_COLOUR)
    for package in packages:
        _add_box(robot, package_frame(package.id), package.size_m, package_colour(package))
    indent(robot)
    return tostring(robot, encoding="unicode")


def _add_box(robot: Element, name: str, size_m: Size, colour: Colour) -> None:
    link = SubElement(robot, "link", name=name)
    # No collision shapes: viewers would draw them over the visual ones.
    visual = SubElement(link, "visual")
    SubElement(SubElement(visual, "geometry"), "box", size=" ".join(map(str, size_m)))
    material = SubElement(visual, "material", name=f"{name}_colour")
    SubElement(material, "color", rgba=" ".join(map(str, (*colour, 1.0))))
    joint = SubElement(robot, "joint", name=f"{name}_joint", type="floating")
    SubElement(joint, "parent", link=SLED_FRAME)
    SubElement(joint, "child", link=name)
