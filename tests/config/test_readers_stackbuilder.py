"""StackBuilder exports: units, reference corners, axes and interlayers by hand, and what is refused."""

from collections.abc import Callable

import pytest

from config.errors import RefusedInput
from config.readers import PatternPallet

ReadOnly = Callable[[str], PatternPallet]
Refuse = Callable[[str], RefusedInput]
Extents = Callable[..., tuple[float, ...]]


NAMESPACE = "http://plmpack.com/stackbuilder/StackBuilderXMLExport.xsd"
LOAD = "orderDocument/orderType/load"


def stackbuilder_xml(
    placements: str, *, unit: str = "mm|kg", base: float = 144.0, namespace: str = "", scale: float = 1.0
) -> str:
    """One item of 400 x 300 x 250 (times `scale`) and 10, one sheet of 1200 x 800 x 3 and 0.6."""
    attribute = f' xmlns="{namespace}"' if namespace else ""

    def item(number: int, length: float, width: float, height: float, weight: float) -> str:
        edges = f"<length>{length * scale}</length><width>{width * scale}</width>"
        edges += f"<height>{height * scale}</height>"
        return f"<item><id>{number}</id><name>i</name>{edges}<weight>{weight}</weight></item>"

    return (
        f"<orderDocument{attribute}><author>a</author><date>2025-01-01T00:00:00</date><unit>{unit}</unit>"
        f"<orderType><orderNumber>o</orderNumber><loadSpace><id>1</id><name>EUR</name>"
        f"<length>{1200 * scale}</length>"
        f"<width>{800 * scale}</width><maxLoadHeight>0</maxLoadHeight><maxLoadWeight>1000</maxLoadWeight>"
        f"<baseHeight>{base * scale}</baseHeight><maxLengthOverhang>0</maxLengthOverhang>"
        "<maxWidthOverhang>0</maxWidthOverhang></loadSpace>"
        f"<itemList>{item(1, 400, 300, 250, 10)}{item(2, 1200, 800, 3, 0.6)}</itemList>"
        "<orderLine><itemId>1</itemId><quantity>1</quantity></orderLine>"
        f"<load><loadSpaceId>1</loadSpaceId><statistics/>{placements}</load></orderType></orderDocument>"
    )


def placement(x: float, y: float, z: float, along: str = "", across: str = "", item: int = 1) -> str:
    axes = (f"<L>{along}</L>" if along else "") + (f"<W>{across}</W>" if across else "")
    return f"<placement><itemId>{item}</itemId><x>{x}</x><y>{y}</y><z>{z}</z>{axes}</placement>"


# From the corner (600, 400, 144) a box of 400 x 300 x 250 reaches 400 along L, 300 along W, 250 along L x W.
@pytest.mark.parametrize(
    ("along", "across", "corner_z", "expected"),
    [
        ("XP", "YP", 144, (600, 1000, 400, 700, 0, 250)),
        ("YP", "XN", 144, (300, 600, 400, 800, 0, 250)),
        ("XN", "YN", 144, (200, 600, 100, 400, 0, 250)),
        ("YN", "XP", 144, (600, 900, 0, 400, 0, 250)),
        # upside down: XP x YN = ZN, so the box hangs below its corner
        ("XP", "YN", 394, (600, 1000, 100, 400, 0, 250)),
        # on a side: the width upwards, XP x ZP = YN
        ("XP", "ZP", 144, (600, 1000, 150, 400, 0, 300)),
        # on its end: the length upwards, ZP x XP = YP
        ("ZP", "XP", 144, (600, 900, 400, 650, 0, 400)),
        # the length downwards, ZN x YP = XP
        ("ZN", "YP", 544, (600, 850, 400, 700, 0, 400)),
    ],
)
def test_stackbuilder_box_reaches_from_its_corner_along_its_axes(
    extents_mm: Extents,
    read_only: ReadOnly,
    along: str,
    across: str,
    corner_z: float,
    expected: tuple[float, ...],
) -> None:
    pallet = read_only(stackbuilder_xml(placement(600, 400, corner_z, along, across)))
    assert extents_mm(pallet) == expected
    assert pallet.notes == (("1 package lies on a side",) if "Z" in along + across else ())


def test_stackbuilder_keeps_the_own_edges_of_an_upright_box(read_only: ReadOnly) -> None:
    pallet = read_only(stackbuilder_xml(placement(300, 0, 0, "YP", "XN")))
    (package,) = pallet.packages
    assert package.size_m == (0.4, 0.3, 0.25)
    assert package.yaw_deg == 90.0
    assert package.position_m == (-0.45, -0.2, 0.125)


@pytest.mark.parametrize("lowest", [0.0, 144.0])
def test_stackbuilder_heights_may_start_at_the_floor_or_at_the_deck(
    read_only: ReadOnly, lowest: float
) -> None:
    text = stackbuilder_xml(placement(0, 0, lowest, "XP", "YP") + placement(0, 0, lowest + 250, "XP", "YP"))
    pallet = read_only(text)
    assert [package.position_m[2] for package in pallet.packages] == [0.125, 0.375]
    assert pallet.deck_height_m == 0.144
    assert pallet.max_height_m is None
    assert pallet.max_mass_kg == 1000.0


@pytest.mark.parametrize(
    ("unit", "metre", "kilogram"),
    [("mm|kg", 1e-3, 1.0), ("cm|kg", 1e-2, 1.0), ("m|kg", 1.0, 1.0), ("in|lb", 0.0254, 0.45359237)],
)
def test_stackbuilder_units(read_only: ReadOnly, unit: str, metre: float, kilogram: float) -> None:
    # Figures are scaled down by 1000, so that 0.4 is the length in every unit.
    (package,) = read_only(stackbuilder_xml(placement(0, 0, 0, "XP", "YP"), unit=unit, scale=0.001)).packages
    assert package.size_m == pytest.approx((0.4 * metre, 0.3 * metre, 0.25 * metre), abs=1e-9)
    assert package.mass_kg == pytest.approx(10 * kilogram, abs=1e-9)


def test_stackbuilder_interlayers_and_namespace(extents_mm: Extents, read_only: ReadOnly) -> None:
    boxes = placement(0, 0, 3, "XP", "YP") + placement(0, 0, 256, "XP", "YP")
    sheets = "".join(placement(0, 0, z, item=2) for z in (0, 253, 506))
    pallet = read_only(stackbuilder_xml(boxes + sheets, namespace=NAMESPACE))
    found = [(p.id, p.kind, p.surface, p.layer, p.position_m[2]) for p in pallet.packages]
    assert found == [
        ("L1-01", "package", "cardboard", 1, 0.128),
        ("L2-01", "package", "cardboard", 2, 0.381),
        ("I0-1", "interlayer", "anti_slip", None, 0.0015),
        ("I1-1", "interlayer", "anti_slip", 1, 0.2545),
        ("I2-1", "interlayer", "anti_slip", 2, 0.5075),
    ]
    assert extents_mm(pallet, 2) == (0, 1200, 0, 800, 0, 3)


GOOD = stackbuilder_xml(placement(0, 0, 0, "XP", "YP"))


@pytest.mark.parametrize(
    ("old", "new", "field", "said"),
    [
        ("<unit>mm|kg</unit>", "<unit>ft|lb</unit>", "orderDocument/unit", "ft|lb"),
        ("<unit>mm|kg</unit>", "", "orderDocument/unit", "mm|kg, cm|kg, m|kg, in|lb"),
        ("<weight>10</weight>", "<weight>0</weight>", "itemList/item[1]/weight", "0"),
        ("<length>400.0</length>", "<length>-4</length>", "itemList/item[1]/length", "-4"),
        ("<length>400.0</length>", "<length>40000</length>", f"{LOAD}/placement[1]: size_m[0]", "10"),
        ("<itemId>1</itemId><x>", "<itemId>7</itemId><x>", f"{LOAD}/placement[1]/itemId", "one of 1, 2"),
        ("<W>YP</W>", "<W>XN</W>", f"{LOAD}/placement[1]/W", "perpendicular"),
        ("<W>YP</W>", "<W>Q</W>", "placement/W", "Q"),
        ("<W>YP</W>", "", f"{LOAD}/placement[1]/W", "L and W"),
        ("<L>XP</L><W>YP</W>", "", f"{LOAD}/placement[1]", "cylinders"),
        ("<z>0</z>", "<z>125</z>", f"{LOAD}/placement", "baseHeight, 144.0 mm"),
        ("<author>a</author>", "", "orderDocument", "author"),
        ("<length>1200.0</length>", "<length>99999</length>", "orderDocument/orderType/loadSpace", "10 m"),
    ],
)
def test_stackbuilder_violations(refuse: Refuse, old: str, new: str, field: str, said: str) -> None:
    text = GOOD.replace("<length>400<", "<length>400.0<").replace("<length>1200<", "<length>1200.0<", 1)
    assert old in text
    error = refuse(text.replace(old, new, 1))
    assert error.field.endswith(field)
    assert said in str(error)


@pytest.mark.parametrize("placements", ["", placement(0, 0, 0, item=2)])
def test_load_without_packages(refuse: Refuse, placements: str) -> None:
    assert "the pack list holds no package" in str(refuse(stackbuilder_xml(placements)))


def test_absurd_count(refuse: Refuse) -> None:
    assert "at most 5000" in str(refuse(stackbuilder_xml(placement(0, 0, 0, "XP", "YP") * 5001)))
