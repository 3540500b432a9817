"""The shipped loads are sound, the twins agree, and the public files of both XML formats are read."""

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from xml.etree import ElementTree

import pytest

from config.package import Package
from config.readers import read_pattern, vary_layers
from config.readers.pallet import Bounds, PatternPallet, bounds

PATTERNS = Path(__file__).parents[2] / "config" / "patterns"
PUBLIC = Path(__file__).parents[2].parent / "shared" / "patterns"

# packages, interlayers, layers, mass in kg, height in mm
SHIPPED = {
    "eur_columns.nist.xml": (40, 0, 5, 400.0, 1250),
    "eur_columns.stackbuilder.xml": (40, 0, 5, 400.0, 1250),
    "eur_columns.pally.json": (40, 0, 5, 400.0, 1250),
    "eur_columns_antislip.stackbuilder.xml": (40, 4, 5, 402.4, 1262),
    "eur_interlocked.pally.json": (35, 0, 5, 350.0, 1250),
    "eur_mixed.nist.xml": (44, 0, 6, 376.0, 1200),
}


def pallet_of(name: str, folder: Path = PATTERNS) -> PatternPallet:
    (pallet,) = read_pattern(folder / name).pallets
    return pallet


def public(name: str) -> Path:
    path = PUBLIC / name
    if not path.is_file():
        pytest.skip(f"the public file {name} is not beside this checkout (../shared/patterns)")
    return path


def deepest_overlap(boxes: Sequence[Bounds]) -> float:
    return max(a.overlap(b) for i, a in enumerate(boxes) for b in boxes[:i])


def supported_share(box: Bounds, boxes: Sequence[Bounds]) -> float:
    """Share of a box's bottom that lies on the deck or on tops at the same height."""
    if abs(box.z_min) < 1e-6:
        return 1.0
    area = sum(
        (min(box.x_max, below.x_max) - max(box.x_min, below.x_min))
        * (min(box.y_max, below.y_max) - max(box.y_min, below.y_min))
        for below in boxes
        if abs(below.z_max - box.z_min) < 1e-6 and box.footprint_overlap(below) > 0
    )
    return area / ((box.x_max - box.x_min) * (box.y_max - box.y_min))


def overhang(pallet: PatternPallet, boxes: Sequence[Bounds]) -> float:
    half_length, half_width = pallet.size_m[0] / 2, pallet.size_m[1] / 2
    return max(
        max(
            -box.x_min - half_length, box.x_max - half_length, -box.y_min - half_width, box.y_max - half_width
        )
        for box in boxes
    )


def test_every_shipped_load_is_listed() -> None:
    assert {path.name for path in PATTERNS.iterdir() if path.suffix in (".xml", ".json")} == set(SHIPPED)


@pytest.mark.parametrize("name", sorted(SHIPPED))
def test_shipped_load_is_sound(name: str) -> None:
    pallet = pallet_of(name)
    boxes = [bounds(package) for package in pallet.packages]
    kinds = Counter(package.kind for package in pallet.packages)
    packages, interlayers, layers, mass_kg, height_mm = SHIPPED[name]
    assert (kinds["package"], kinds["interlayer"]) == (packages, interlayers)
    assert {p.layer for p in pallet.packages if p.kind == "package"} == set(range(1, layers + 1))
    assert sum(package.mass_kg for package in pallet.packages) == pytest.approx(mass_kg, abs=1e-9)
    assert max(box.z_max for box in boxes) == pytest.approx(height_mm / 1000, abs=1e-9)
    assert len({package.id for package in pallet.packages}) == len(boxes)
    assert pallet.size_m == (1.2, 0.8)
    assert deepest_overlap(boxes) < 1e-9
    assert overhang(pallet, boxes) < 1e-9
    # Nothing stands on less than four fifths of its bottom.
    assert min(supported_share(box, boxes) for box in boxes) > 0.8


def outline(packages: Sequence[Package]) -> list[tuple[float, ...]]:
    """Extents and mass of every package, rounded to 10 nm only so that the lists sort alike."""
    return sorted((*(round(v, 8) for v in bounds(package)), package.mass_kg) for package in packages)


def test_twins_of_three_formats_are_one_load() -> None:
    nist, stackbuilder, pally = (
        sorted(pallet_of(f"eur_columns.{end}").packages, key=lambda p: [round(v, 6) for v in p.position_m])
        for end in ("nist.xml", "stackbuilder.xml", "pally.json")
    )
    assert len(nist) == 40
    for a, b, c in zip(nist, stackbuilder, pally, strict=True):
        assert bounds(b) == pytest.approx(bounds(a), abs=1e-9)
        assert bounds(c) == pytest.approx(bounds(a), abs=1e-9)
        assert a.mass_kg == b.mass_kg == c.mass_kg == 10.0
        assert a.size_m == b.size_m == c.size_m == (0.4, 0.3, 0.25)
        assert a.layer == b.layer == c.layer


def test_anti_slip_load_is_the_column_load_lifted_by_its_sheets() -> None:
    plain = pallet_of("eur_columns.stackbuilder.xml").packages
    lifted = pallet_of("eur_columns_antislip.stackbuilder.xml").packages
    boxes = [package for package in lifted if package.kind == "package"]
    for before, after in zip(plain, boxes, strict=True):
        assert after.layer == before.layer
        x, y, z = before.position_m
        assert after.position_m == pytest.approx((x, y, z + 0.003 * ((before.layer or 0) - 1)), abs=1e-9)
    sheets = [package for package in lifted if package.kind == "interlayer"]
    assert [(sheet.layer, sheet.surface) for sheet in sheets] == [(n, "anti_slip") for n in (1, 2, 3, 4)]


def joints_in_line(lower: Sequence[Bounds], upper: Sequence[Bounds]) -> int:
    """How many packages of the upper layer stand exactly on one of the lower layer."""
    return sum(any(box[:4] == pytest.approx(below[:4], abs=1e-9) for below in lower) for box in upper)


def test_interlocked_load_breaks_every_joint_and_turns_back_into_columns() -> None:
    pallet = pallet_of("eur_interlocked.pally.json")

    def layer(load: PatternPallet, number: int) -> list[Bounds]:
        return [bounds(package) for package in load.packages if package.layer == number]

    columns = vary_layers(pallet, rotate_layers=[2, 4])
    for number in (1, 2, 3, 4):
        assert joints_in_line(layer(pallet, number), layer(pallet, number + 1)) == 0
        assert joints_in_line(layer(columns, number), layer(columns, number + 1)) == 7
    # Each package of an upper layer bears on at least two below it.
    for box in layer(pallet, 2):
        assert sum(box.footprint_overlap(below) > 1e-6 for below in layer(pallet, 1)) >= 2
    assert outline(vary_layers(columns, rotate_layers=[2, 4]).packages) == outline(pallet.packages)


@pytest.mark.parametrize("name", sorted(name for name in SHIPPED if "stackbuilder" in name))
def test_our_stackbuilder_files_are_valid_under_the_public_schema(name: str) -> None:
    import xmlschema

    schema = xmlschema.XMLSchema(public("StackBuilderXMLExport.xsd"), allow="local")
    schema.validate(PATTERNS / name)


def test_public_nist_pack_list_is_read_as_it_stands() -> None:
    path = public("nist_packlist_R2.xml")
    pallet = pallet_of(path.name, path.parent)
    elements = list(ElementTree.parse(path).getroot().iter("Package"))
    assert len(elements) == len(pallet.packages) == 124
    assert pallet.size_m == (0.406, 0.305)
    assert (pallet.max_height_m, pallet.max_mass_kg) == (0.406, 166.667)

    def figure(element: ElementTree.Element, path: str) -> float:
        return float(element.findtext(path) or "nan")

    for element, package in zip(elements, pallet.packages, strict=True):
        along_x, along_y = figure(element, "Article/Length"), figure(element, "Article/Width")
        if element.findtext("Orientation") == "2":
            along_x, along_y = along_y, along_x
        x, y, top = (figure(element, f"PlacePosition/{axis}") for axis in "XYZ")
        expected = (x - along_x / 2, x + along_x / 2, y - along_y / 2, y + along_y / 2)
        shift = (203.0, 203.0, 152.5, 152.5)
        box = bounds(package)
        assert [v * 1000 + s for v, s in zip(box[:4], shift, strict=True)] == pytest.approx(
            expected, abs=1e-6
        )
        assert (box.z_max * 1000, box.z_min * 1000) == pytest.approx(
            (top, top - figure(element, "Article/Height"))
        )
        assert package.mass_kg == figure(element, "Article/Weight") / 1000

    boxes = [bounds(package) for package in pallet.packages]
    assert deepest_overlap(boxes) < 1e-9
    assert overhang(pallet, boxes) < 1e-9
    # As the file has it: package 120 stands on 48.9 % of its bottom, every other one on more than half.
    shares = sorted(supported_share(box, boxes) for box in boxes)
    assert shares[0] == pytest.approx(0.489, abs=1e-3)
    assert shares[1] > 0.5
    counts = Counter(package.layer for package in pallet.packages)
    assert [counts[n] for n in range(1, 8)] == [29, 18, 18, 15, 12, 15, 17]
