"""The shipped loads are what the table in their README says, sound and different; the public files are read."""

import re
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

import pytest

from config.errors import RefusedInput
from config.package import Package
from config.readers import read_pattern, vary_layers
from config.readers.pallet import Bounds, PatternPallet, bounds
from config.shipped import PATTERNS as LIBRARY

PATTERNS = Path(__file__).parents[2] / "config" / "patterns"
PUBLIC = Path(__file__).parents[2].parent / "shared" / "patterns"
MIXED_HEIGHTS = {"eur_mixed.nist.xml", "eur_mixed_halves.nist.xml"}
"""Loads with layers that reach through others, so that not any of them can be turned alone."""


class Row(NamedTuple):
    """What the README's table says about a load; figures of the whole load, mass in kg, height in mm."""

    packages: int
    sheets: int
    layers: int
    mass_kg: float
    height_mm: float
    in_line: str


def readme_table() -> dict[str, Row]:
    table: dict[str, Row] = {}
    for line in (PATTERNS / "README.md").read_text(encoding="utf-8").splitlines():
        names, *cells = (cell.strip() for cell in line.strip("|").split("|"))
        if len(cells) == 7 and names.startswith("`"):
            packages, *sheets = (int(figure) for figure in re.findall(r"\d+", cells[2]))
            mass_kg, height_mm = (float(cell.split()[0]) for cell in cells[4:6])
            row = Row(packages, sum(sheets), int(cells[3]), mass_kg, height_mm, cells[6])
            table |= dict.fromkeys(re.findall(r"`([^`]+)`", names), row)
    return table


TABLE = readme_table()


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


def layer_boxes(pallet: PatternPallet, number: int) -> list[Bounds]:
    return [bounds(p) for p in pallet.packages if p.kind == "package" and p.layer == number]


def stacks(pallet: PatternPallet) -> list[tuple[int, Bounds]]:
    """For each package, how many stand exactly in line down from it, itself counted, and what they fill.

    A sheet between two packages does not break the line: it has no bending stiffness in the twin.
    """
    found: list[tuple[int, Bounds]] = []
    gap = 0.003 + 1e-6
    for box in sorted((bounds(p) for p in pallet.packages if p.kind == "package"), key=lambda b: b.z_min):
        run, bottom = 1, box.z_min
        for below_run, below in found:
            if -1e-6 <= box.z_min - below.z_max <= gap and box[:4] == pytest.approx(below[:4], abs=1e-9):
                run, bottom = below_run + 1, below.z_min
        found.append((run, box._replace(z_min=bottom)))
    return found


def assert_sound(pallet: PatternPallet) -> None:
    boxes = [bounds(package) for package in pallet.packages]
    assert deepest_overlap(boxes) < 1e-9
    assert overhang(pallet, boxes) < 1e-9
    # Above one half, the centre lies inside the hull of what bears it: a line through the centre of a rectangle
    # halves it, so a support that lies wholly beyond such a line is at most one half.
    assert min(supported_share(box, boxes) for box in boxes) >= 0.6


def test_every_shipped_load_is_listed_and_found() -> None:
    files = {path.name for path in PATTERNS.iterdir() if path.suffix in (".xml", ".json")}
    assert set(LIBRARY.names()) == files == set(TABLE)
    assert LIBRARY.names() == sorted(files)
    for name in files:
        assert LIBRARY.find(name) == PATTERNS / name


def test_a_pattern_is_found_by_its_path_first(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    mine = tmp_path / "eur_mixed.nist.xml"
    mine.write_bytes(b"<Response/>")
    assert LIBRARY.find(str(mine)) == mine
    monkeypatch.chdir(tmp_path)
    assert LIBRARY.find("eur_mixed.nist.xml") == Path("eur_mixed.nist.xml")


@pytest.mark.parametrize(
    "name", ["eur_columns", "eur_brick.pally.json", "", ".", "README.md", "a\0b", "x" * 5000]
)
def test_a_pattern_that_is_not_there_is_refused(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(RefusedInput) as caught:
        LIBRARY.find(name)
    assert (caught.value.field, caught.value.value) == ("pattern", name)


@pytest.mark.parametrize("name", sorted(TABLE))
def test_shipped_load_is_sound_and_as_the_readme_says(name: str) -> None:
    pallet, row = pallet_of(name), TABLE[name]
    kinds = Counter(package.kind for package in pallet.packages)
    assert (kinds["package"], kinds["interlayer"]) == (row.packages, row.sheets)
    assert {p.layer for p in pallet.packages if p.kind == "package"} == set(range(1, row.layers + 1))
    assert sum(package.mass_kg for package in pallet.packages) == pytest.approx(row.mass_kg, abs=1e-9)
    height = max(bounds(package).z_max for package in pallet.packages)
    assert height == pytest.approx(row.height_mm / 1000, abs=1e-9)
    assert len({package.id for package in pallet.packages}) == len(pallet.packages)
    assert (pallet.size_m, pallet.deck_height_m or 0.144) == ((1.2, 0.8), 0.144)
    assert_sound(pallet)
    aligned = sum(run > 1 for run, _ in stacks(pallet))
    assert f"{aligned} of {row.packages - len(layer_boxes(pallet, 1))}" == row.in_line
    # What a campaign counts on: the cost of a run, levels of 4 and more layers, sensible cartons.
    assert row.packages <= 48
    assert 4 <= row.layers <= 8
    assert 80 <= row.mass_kg <= 900
    assert 800 <= row.height_mm <= 1800
    assert all(2 <= p.mass_kg <= 25 for p in pallet.packages if p.kind == "package")


@pytest.mark.parametrize("name", sorted(TABLE))
def test_any_count_of_layers_from_four_stands_by_itself(name: str) -> None:
    pallet, row = pallet_of(name), TABLE[name]
    for layers in range(4, row.layers + 1):
        kept = vary_layers(pallet, layers=layers)
        assert {p.layer for p in kept.packages if p.kind == "package"} == set(range(1, layers + 1))
        assert_sound(kept)


@pytest.mark.parametrize("name", sorted(set(TABLE) - MIXED_HEIGHTS))
def test_any_layer_of_one_height_can_be_turned_or_mirrored(name: str) -> None:
    pallet = pallet_of(name)
    for layer in range(1, TABLE[name].layers + 1):
        assert_sound(vary_layers(pallet, rotate_layers=[layer]))
        assert_sound(vary_layers(pallet, mirror_layers=[layer]))
        assert_sound(vary_layers(pallet, rotate_layers=[layer], mirror_layers=[layer]))


@pytest.mark.parametrize("name", sorted(TABLE))
def test_no_column_tips_at_0_2_g(name: str) -> None:
    # A column of width w and height h tips at g w / h; one column is never held by its neighbours.
    for _, column in stacks(pallet_of(name)):
        width = min(column.x_max - column.x_min, column.y_max - column.y_min)
        assert width / (column.z_max - column.z_min) > 0.2


def test_the_loads_are_of_many_schemes() -> None:
    def plans(name: str) -> frozenset[tuple[tuple[float, ...], ...]]:
        """The ways in which the layers of a load are laid out, heights left aside."""
        pallet = pallet_of(name)
        return frozenset(
            tuple(sorted(tuple(round(v, 6) for v in box[:4]) for box in layer_boxes(pallet, number)))
            for number in range(1, TABLE[name].layers + 1)
        )

    assert len({plans(name) for name in TABLE}) >= 15
    loads = {name.partition(".")[0]: outline(pallet_of(name).packages) for name in sorted(TABLE)}
    assert len({tuple(load) for load in loads.values()}) == len(loads) >= 20


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

    columns = vary_layers(pallet, rotate_layers=[2, 4])
    for number in (1, 2, 3, 4):
        assert joints_in_line(layer_boxes(pallet, number), layer_boxes(pallet, number + 1)) == 0
        assert joints_in_line(layer_boxes(columns, number), layer_boxes(columns, number + 1)) == 7
    # Each package of an upper layer bears on at least two below it.
    for box in layer_boxes(pallet, 2):
        assert sum(box.footprint_overlap(below) > 1e-6 for below in layer_boxes(pallet, 1)) >= 2
    assert outline(vary_layers(columns, rotate_layers=[2, 4]).packages) == outline(pallet.packages)


@pytest.mark.parametrize("name", sorted(name for name in TABLE if "stackbuilder" in name))
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
