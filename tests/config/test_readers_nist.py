"""NIST pack lists: anchors and orientations worked out by hand, several pallets, and what is refused."""

from collections.abc import Callable
from pathlib import Path

import pytest

from config.errors import RefusedInput
from config.readers import PatternPallet, choose_pallet, read_pattern

ReadOnly = Callable[[str], PatternPallet]
Refuse = Callable[[str], RefusedInput]
Extents = Callable[..., tuple[float, ...]]


NIST_PACKAGE = "Response/PackList/PackPallets/PackPallet[1]/Packages/Package"


def nist_package(
    *, x: float, y: float, z: float, orientation: int = 1, sequence: int = 1, weight: float = 5000
) -> str:
    """An article of 400 x 300 x 200 mm; children deliberately out of the usual order."""
    return (
        f"<Package><Orientation>{orientation}</Orientation><PackSequence>{sequence}</PackSequence>"
        f"<PlacePosition><Y>{y}</Y><X>{x}</X><Z>{z}</Z></PlacePosition><Article><Weight>{weight}</Weight>"
        "<Height>200</Height><Width>300</Width><Length>400</Length><Type>1</Type><ID>77</ID></Article>"
        "<ParentLayer>1</ParentLayer></Package>"
    )


def nist_pallet(packages: str, *, number: int = 1) -> str:
    return (
        f"<PackPallet><PalletNumber>{number}</PalletNumber><Packages>{packages}</Packages>"
        "<Dimensions><Width>800</Width><MaxLoadHeight>1800</MaxLoadHeight><Length>1200</Length>"
        "<MaxLoadWeight>900000</MaxLoadWeight></Dimensions><Description>EUR</Description></PackPallet>"
    )


def nist_xml(*pallets: str) -> str:
    body = "".join(pallets)
    return f"<Response><PackList><OrderID>1</OrderID><PackPallets>{body}</PackPallets></PackList></Response>"


# An article of 400 x 300 x 200 mm whose top face has its centre at (600, 400).
@pytest.mark.parametrize(
    ("orientations", "edges"),
    [
        ((1, 3, 13, 15), (400, 300, 200)),
        ((2, 4, 14, 16), (300, 400, 200)),
        ((5, 7, 17, 19), (400, 200, 300)),
        ((6, 8, 18, 20), (200, 400, 300)),
        ((9, 11, 21, 23), (200, 300, 400)),
        ((10, 12, 22, 24), (300, 200, 400)),
    ],
)
def test_nist_orientations(
    extents_mm: Extents, read_only: ReadOnly, orientations: tuple[int, ...], edges: tuple[float, ...]
) -> None:
    along_x, along_y, height = edges
    expected = (600 - along_x / 2, 600 + along_x / 2, 400 - along_y / 2, 400 + along_y / 2, 0, height)
    for orientation in orientations:
        text = nist_xml(nist_pallet(nist_package(x=600, y=400, z=height, orientation=orientation)))
        pallet = read_only(text)
        assert extents_mm(pallet) == expected
        assert pallet.notes == (() if height == 200 else ("1 package lies on a side",))


def test_nist_place_position_is_the_centre_of_the_top_face(read_only: ReadOnly) -> None:
    pallet = read_only(nist_xml(nist_pallet(nist_package(x=200, y=150, z=200))))
    (package,) = pallet.packages
    assert package.position_m == (-0.4, -0.25, 0.1)
    assert package.mass_kg == 5.0
    assert package.id == "001-77"
    assert (pallet.size_m, pallet.max_height_m, pallet.max_mass_kg) == ((1.2, 0.8), 1.8, 900.0)
    assert pallet.deck_height_m is None


def test_nist_layers_of_a_mixed_load_are_distinct_bottom_heights(read_only: ReadOnly) -> None:
    low = nist_package(x=200, y=150, z=200, sequence=1) + nist_package(x=200, y=150, z=400, sequence=2)
    tall = nist_package(x=800, y=150, z=400, sequence=3, orientation=9)
    top = nist_package(x=800, y=150, z=600, sequence=4)
    pallet = read_only(nist_xml(nist_pallet(low + tall + top)))
    assert [package.layer for package in pallet.packages] == [1, 2, 1, 3]


GOOD_NIST = nist_xml(nist_pallet(nist_package(x=200, y=150, z=200)))


@pytest.mark.parametrize(
    ("old", "new", "field", "said"),
    [
        ("<Weight>5000</Weight>", "<Weight>-1</Weight>", f"{NIST_PACKAGE}/Article/Weight", "-1"),
        ("<Weight>5000</Weight>", "<Weight>0</Weight>", f"{NIST_PACKAGE}/Article/Weight", "0"),
        ("<Weight>5000</Weight>", "<Weight>NaN</Weight>", f"{NIST_PACKAGE}/Article/Weight", "NaN"),
        ("<Weight>5000</Weight>", "<Weight>1e999</Weight>", f"{NIST_PACKAGE}/Article/Weight", "1e999"),
        ("<Weight>5000</Weight>", "<Weight>heavy</Weight>", f"{NIST_PACKAGE}/Article/Weight", "heavy"),
        ("<Weight>5000</Weight>", "", f"{NIST_PACKAGE}/Article", "Weight"),
        ("<Height>200</Height>", "<Height>0</Height>", f"{NIST_PACKAGE}/Article/Height", "0"),
        ("<Height>200</Height>", "<Height/>", f"{NIST_PACKAGE}/Article/Height", "(empty)"),
        (
            "<Orientation>1</Orientation>",
            "<Orientation>25</Orientation>",
            f"{NIST_PACKAGE}/Orientation",
            "24",
        ),
        ("<X>200</X>", "<X>INF</X>", f"{NIST_PACKAGE}/PlacePosition/X", "INF"),
        ("<Width>800</Width>", "<Width>-800</Width>", "PackPallet/Dimensions/Width", "-800"),
        ("<PalletNumber>1</PalletNumber>", "", "PackPallets/PackPallet", "PalletNumber"),
    ],
)
def test_nist_violations_name_the_element(refuse: Refuse, old: str, new: str, field: str, said: str) -> None:
    assert old in GOOD_NIST
    error = refuse(GOOD_NIST.replace(old, new))
    assert error.field.replace("[1]", "").endswith(field.replace("[1]", ""))
    assert said in str(error)


def test_nist_violation_in_the_third_package_says_so(refuse: Refuse) -> None:
    packages = [
        nist_package(x=200, y=150, z=200 * n, sequence=n, weight=0 if n == 3 else 500) for n in (1, 2, 3)
    ]
    error = refuse(nist_xml(nist_pallet("".join(packages))))
    assert error.field.endswith("Package[3]/Article/Weight")


def test_nist_numbers_given_twice(refuse: Refuse) -> None:
    package = nist_package(x=200, y=150, z=200)
    error = refuse(nist_xml(nist_pallet(package + package)))
    assert error.field == f"{NIST_PACKAGE}[2]/PackSequence"
    error = refuse(nist_xml(nist_pallet(package), nist_pallet(package)))
    assert error.field.endswith("PackPallet[2]/PalletNumber")


@pytest.mark.parametrize("text", [nist_xml(), nist_xml(nist_pallet(""))])
def test_pack_list_without_packages(refuse: Refuse, text: str) -> None:
    assert "the pack list holds no package" in str(refuse(text))


def test_absurd_count(refuse: Refuse) -> None:
    assert "at most 5000" in str(refuse(nist_xml(nist_pallet(nist_package(x=200, y=150, z=200) * 5001))))


def test_location_hints_are_not_followed(read_only: ReadOnly) -> None:
    hint = 'xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance" xsi:noNamespaceSchemaLocation="missing.xsd"'
    assert len(read_only(GOOD_NIST.replace("<Response>", f"<Response {hint}>")).packages) == 1


def test_choose_pallet(tmp_path: Path) -> None:
    path = tmp_path / "three.xml"
    package = nist_package(x=200, y=150, z=200)
    path.write_text(
        nist_xml(nist_pallet(package, number=3), nist_pallet(package, number=5), nist_pallet("", number=8))
    )
    file = read_pattern(path)
    assert choose_pallet(file, 5) is file.pallets[1]
    with pytest.raises(RefusedInput, match=r"pallet_number = none: .*3, 5, 8"):
        choose_pallet(file, None)
    with pytest.raises(RefusedInput, match="pallet_number = 4: one of 3, 5, 8"):
        choose_pallet(file, 4)
    with pytest.raises(RefusedInput, match="pallet_number = 8: the pack list holds no package"):
        choose_pallet(file, 8)
    path.write_text(GOOD_NIST)
    single = read_pattern(path)
    assert choose_pallet(single, None) is single.pallets[0]
