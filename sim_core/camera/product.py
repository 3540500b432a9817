"""What is packed, by seed: brand, article, inks, board, closure and label of all cartons of one product."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sim_core.camera.surfaces import generator

Colour = tuple[float, float, float]

_HEADS = ("Nor", "Val", "Bel", "Kor", "Lum", "Ost", "Fen", "Mar", "Sol", "Tar", "Gal", "Vin", "Hel", "Dro")
_TAILS = ("dano", "vika", "tera", "mora", "linga", "ster", "berg", "quist", "onda", "pex", "field", "ario")
_SECTORS = (
    ("FINE FOODS", ("Penne rigate", "Chopped tomatoes", "Basmati rice", "Sweet corn", "Red lentils"), True),
    ("HOME CARE", ("Laundry powder", "Dishwasher tabs", "Floor cleaner", "Fabric softener"), True),
    ("PAPER", ("Copy paper A4 80 g", "Hand towels 2-ply", "Envelopes C5", "Till rolls 80 mm"), False),
    ("TOOLS & FIXINGS", ("Wood screws 4.5 × 60", "Anchor bolts M12", "Angle brackets", "Cable ties"), False),
    ("BEVERAGES", ("Apple juice", "Mineral water", "Tonic 0.2 l", "Iced tea lemon"), False),
    ("PET FOOD", ("Dry food chicken", "Cat menu salmon", "Dog biscuits"), True),
)
_TOWNS = ("Delmhorst", "Varnby", "Ostrowin", "Sanvaro", "Brekkum", "Lindwald")
_STREETS = ("Harbour Road", "Mill Lane", "Industrial Way", "Station Street")
_TAPES: tuple[tuple[Colour, float], ...] = (
    ((205.0, 180.0, 140.0), 0.22),
    ((158.0, 112.0, 66.0), 0.86),
    ((226.0, 224.0, 216.0), 0.8),
)
"""Colour and opacity of clear, brown and white tape."""
BLACK: Colour = (0.17, 0.16, 0.17)
_INKS: tuple[Colour, ...] = (
    (0.12, 0.26, 0.54),
    (0.72, 0.15, 0.14),
    (0.13, 0.38, 0.25),
    (0.86, 0.42, 0.12),
    (0.36, 0.20, 0.13),
    (0.10, 0.40, 0.55),
)
"""How much red, green and blue a flexo ink lets through."""


@dataclass(frozen=True)
class Product:
    """What is packed, and how its carton is made.

    Attributes:
        surface: of the package.
        brand: an invented word.
        claim: the brand's trade.
        article: what is inside.
        code: article number.
        digits: the fourteen digits of its bar code, the last one their check digit.
        contents: count of units inside.
        size_text: the carton's size [mm], to a millimetre.
        weight_text: the carton's mass [kg].
        origin: the sender on a label.
        address: the receiver's lines on a label.
        route: sorting code on a label.
        layout: of the print, a number from 0.
        emblem: a number from 0.
        inks: of the first and the second plate, share of light that passes, RGB.
        liner: colour of the board, RGB [0 to 255].
        fibre: colour of its bared fibres.
        flute_m: pitch of its corrugation [m].
        wrapped: paper without corrugation.
        tape: whether the flaps are taped; glued otherwise.
        tape_colour: RGB [0 to 255].
        tape_opacity: 0 clear to 1.
        handholes: whether the ends have them.
        stack: how many more cartons may stand on one.
        label_side: how many sides carry a label.
        label_m: width and height of it [m].
        label_place: of its centre, as shares of the side from the upper left.
    """

    surface: str
    brand: str
    claim: str
    article: str
    code: str
    digits: str
    contents: str
    size_text: str
    weight_text: str
    origin: str
    address: tuple[str, ...]
    route: str
    layout: int
    emblem: int
    inks: tuple[Colour, Colour]
    liner: Colour
    fibre: Colour
    flute_m: float
    wrapped: bool
    tape: bool
    tape_colour: Colour
    tape_opacity: float
    handholes: bool
    stack: int
    label_side: int
    label_m: tuple[float, float]
    label_place: tuple[float, float]


def product_of(size_m: tuple[float, float, float], mass_kg: float, surface: str, seed: int) -> Product:
    """The product that is packed in cartons of this size (along the seam, across it, upright), mass and surface."""
    # A gap that a reader cuts off a carton, or a quarter turn, doesn't make another product of it.
    rounded = sorted(round(edge / 0.005) for edge in size_m)
    rng = generator("product", rounded, round(mass_kg, 1), surface, seed)
    claim, articles, weighed = _SECTORS[int(rng.integers(len(_SECTORS)))]
    digits = "".join(str(digit) for digit in [1, *rng.integers(0, 10, 12)])
    liner, fibre = _board(rng, surface)
    tape_colour, tape_opacity = _TAPES[int(rng.choice(3, p=[0.5, 0.38, 0.12]))]
    town = f"{rng.integers(10000, 99999)} {_pick(rng, _TOWNS)}"
    return Product(
        surface=surface,
        brand=(_pick(rng, _HEADS) + _pick(rng, _TAILS)).upper(),
        claim=claim,
        article=_pick(rng, articles),
        code=f"{_pick(rng, 'ABDKLMPRTX')}{rng.integers(10, 99)}-{rng.integers(1000, 9999)}",
        digits=digits + check_digit(digits),
        contents=_contents(mass_kg, rng) if weighed else f"{int(rng.choice([6, 12, 20, 24, 50]))} PCS",
        size_text=" × ".join(_millimetres(edge) for edge in size_m) + " mm",
        weight_text=f"{mass_kg:.1f} kg" if mass_kg >= 0.1 else f"{1000.0 * mass_kg:.0f} g",
        origin=f"{rng.integers(1, 99)} {_pick(rng, _STREETS)}, {_pick(rng, _TOWNS)}",
        address=("Distribution Centre", f"{_pick(rng, _STREETS)} {rng.integers(1, 200)}", town),
        route=f"{_pick(rng, 'ABCDEFGH')}{rng.integers(1, 9)}",
        layout=int(rng.integers(5)),
        emblem=int(rng.integers(5)),
        inks=_ink_pair(rng),
        liner=liner,
        fibre=fibre,
        flute_m=0.0078 if mass_kg > 12.0 else 0.0065,
        wrapped=surface == "kraft_paper",
        tape=bool(rng.random() < 0.8),
        tape_colour=tape_colour,
        tape_opacity=tape_opacity,
        handholes=bool(rng.random() < 0.35) and mass_kg > 4.0 and size_m[2] > 0.18,
        stack=int(rng.integers(3, 9)),
        label_side=int(rng.choice(3, p=[0.3, 0.5, 0.2])),
        label_m=_label_size(size_m[0], size_m[2]),
        label_place=(0.78, 0.62),
    )


def _pick(rng: np.random.Generator, choices: Sequence[str]) -> str:
    return choices[int(rng.integers(len(choices)))]


def _board(rng: np.random.Generator, surface: str) -> tuple[Colour, Colour]:
    """Colours of a batch of board and of its bared fibres: brown kraft, or white on brown."""
    white = bool(rng.random() < 0.22) and surface != "kraft_paper"
    red, green, blue = (222.0, 221.0, 214.0) if white else (184.0, 149.0, 110.0)
    batch = 1.0 + 0.03 * float(rng.standard_normal())
    warmth = 0.013 * float(rng.standard_normal())
    liner = (red * batch * (1.0 + warmth), green * batch, blue * batch * (1.0 - warmth))
    return liner, (198.0, 174.0, 142.0) if white else (219.0, 192.0, 156.0)


def _ink_pair(rng: np.random.Generator) -> tuple[Colour, Colour]:
    """Inks of the two plates: black and a colour, either first, or one ink for both."""
    coloured = _INKS[int(rng.integers(len(_INKS)))]
    pair = (BLACK, coloured) if rng.random() < 0.55 else (coloured, BLACK)
    return (pair[0], pair[0]) if rng.random() < 0.35 else pair


def _label_size(length: float, height: float) -> tuple[float, float]:
    """Width and height [m] of the largest usual label that leaves most of a side free."""
    for width, tall in ((0.105, 0.148), (0.1, 0.1), (0.1, 0.07), (0.06, 0.04)):
        if width < 0.45 * length and tall < 0.7 * height:
            return width, tall
    return 0.04, 0.025


def check_digit(digits: str) -> str:
    """Check digit of a GTIN without it: weights 3 and 1 by turns from the right (GS1 General Specifications)."""
    total = sum(int(digit) * (3 if place % 2 == 0 else 1) for place, digit in enumerate(reversed(digits)))
    return str(-total % 10)


def _millimetres(edge: float) -> str:
    """An edge as it is printed: that of the catalogue, where a reader's clearance made it 1 mm shorter."""
    exact, usual = round(1000.0 * edge), 5 * round(200.0 * edge)
    return str(usual if usual >= 20 and abs(usual - exact) <= 1 else exact)


def _contents(mass_kg: float, rng: np.random.Generator) -> str:
    """How many units of which mass fill the carton."""
    for grams in rng.permutation([250, 400, 500, 750, 1000]):
        count = int(950.0 * mass_kg / grams)
        if 4 <= count <= 60:
            return f"{count - count % 2} × {grams} g" if grams < 1000 else f"{count - count % 2} × 1 kg"
    return f"NET {0.95 * mass_kg:.1f} kg"
