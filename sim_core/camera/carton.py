"""A carton as it looks: the design that all cartons of a product share, and one carton's labels, tape and wear."""

import math
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np

from sim_core.camera.artwork import (
    OVERSAMPLING,
    Plate,
    code128_like_elements,
)
from sim_core.camera.panels import end_plates, flap_plates, side_plates
from sim_core.camera.product import Product, product_of
from sim_core.camera.surfaces import Field, Picture, crumples, fibres, flutes, generator, noise, picture_shape

Extent = tuple[float, float]
TAPE_WIDTH_M = 0.048
LABEL_PAPER = (244.0, 244.0, 240.0)


@dataclass(frozen=True, eq=False)
class CartonDesign:
    """What the cartons of a product share.

    Attributes:
        product: brand, inks and closure.
        scale: resolution [px/m].
        side: of the two long sides, RGB.
        end: of the two short sides, RGB.
        top: with the seam across the picture's width, RGB.
        bottom: the same from below.
    """

    product: Product
    scale: float
    side: Picture
    end: Picture
    top: Picture
    bottom: Picture


@lru_cache(maxsize=64)
def carton_design(
    length: float, width: float, height: float, mass_kg: float, surface: str, seed: int, pixels_per_m: float
) -> CartonDesign:
    """The design of all cartons of one size [m], mass and surface; length is along the seam of the flaps."""
    product = product_of((length, width, height), mass_kg, surface, seed)
    scale = picture_shape(max(length, width, height), max(length, width, height), pixels_per_m)[0] / max(
        length, width, height
    )
    rng = generator("design", product.code, seed)
    return CartonDesign(
        product=product,
        scale=scale,
        side=_printed(side_plates(product, length, height, OVERSAMPLING * scale), product, scale, rng),
        end=_printed(end_plates(product, width, height, OVERSAMPLING * scale), product, scale, rng),
        top=_printed(
            flap_plates(product, length, width, OVERSAMPLING * scale, bottom=False), product, scale, rng
        ),
        bottom=_printed(
            flap_plates(product, length, width, OVERSAMPLING * scale, bottom=True), product, scale, rng
        ),
    )


def carton_pictures(design: CartonDesign, identity: str, seed: int) -> dict[str, Picture]:
    """One carton's faces, by name: its own tape, label, shade and wear on the shared design.

    Returns:
        ``left`` and ``right``: the ends at the seam's two ends; ``front`` and ``back``: the long sides, front being the
        one below the top's picture; ``top``; ``bottom``: seen from below, with the back side's edge on top.
    """
    rng = generator("carton", identity, seed)
    product = design.product
    shade = 1.0 + 0.025 * rng.standard_normal()
    faces = {
        "left": design.end.copy(),
        "right": design.end.copy(),
        "front": design.side.copy(),
        "back": design.side.copy(),
        "top": design.top.copy(),
        "bottom": design.bottom.copy(),
    }
    texture = {
        name: _brightness(face.shape[:2], design.scale, shade, rng, name) for name, face in faces.items()
    }
    for name, face in faces.items():
        if product.wrapped:
            texture[name] *= crumples(rng, face.shape[:2], design.scale)
        cv2.multiply(face, cv2.merge([texture[name]] * 3), face, 1.0, cv2.CV_8U)
        _wear_edges(face, product, design.scale, rng)
    if product.tape:
        _tape_up(faces, product, design.scale, rng)
    for name in ("front", "right")[: product.label_side]:
        stick_label(faces[name], product, design.scale, rng)
    if rng.random() < 0.1:
        _write(faces["top" if rng.random() < 0.5 else "back"], design.scale, rng)
    return faces


def _printed(
    plates: tuple[Plate, Plate, Plate], product: Product, scale: float, rng: np.random.Generator
) -> Picture:
    """Board with ink on it; light falls through the ink and off the board, so that they multiply."""
    shape = picture_shape(plates[0].width_m, plates[0].height_m, scale)
    ground = (
        np.ones((1, shape[1]), np.float32) if product.wrapped else flutes(shape[1], scale, product.flute_m)
    )
    picture = [np.tile(ground * np.float32(part), (shape[0], 1)) for part in product.liner]
    # Ink is thinner between the flutes, and on rough fibres.
    body = 0.95 + 0.035 * noise(rng, shape, (0.003 * scale, 0.003 * scale), 2) + 2.0 * (ground - 1.0)
    for plate, ink in zip(plates[:2], product.inks, strict=True):
        cover = plate.reduced(shape) * np.float32(1.0 / 255.0) * np.clip(body, 0.6, 1.0)
        for channel, passed in enumerate(ink):
            picture[channel] *= 1.0 - cover * np.float32(1.0 - passed)
    dark = 1.0 - plates[2].reduced(shape) * np.float32(0.82 / 255.0)
    picture = [part * dark for part in picture]
    return np.asarray(cv2.merge([cv2.convertScaleAbs(part) for part in picture]), np.uint8)


@lru_cache(maxsize=4)
def _sheets(scale: float) -> tuple[Field, Field, Field]:
    """Stocks that cartons cut their texture from: fibres, clouds of dirt of unit spread, and fraying of unit spread."""
    edge = min(1024, max(64, round(scale)))
    rng = generator("sheets", edge)
    stocks = (
        fibres(rng, (edge, edge), scale),
        noise(rng, (edge, edge), (0.12 * scale, 0.12 * scale), 4),
        noise(rng, (edge, edge), (0.014 * scale, 0.014 * scale), 4),
    )
    for stock in stocks:
        stock.setflags(write=False)
    return stocks


def _cut(stock: Field, shape: tuple[int, int], rng: np.random.Generator) -> Field:
    """A piece of a stock from a random place, mirrored where the stock ends."""
    missing = [max(0, wanted - had) for wanted, had in zip(shape, stock.shape, strict=True)]
    flipped = stock[:: int(rng.choice([-1, 1])), :: int(rng.choice([-1, 1]))]
    top, left = (
        int(rng.integers(0, had + more - wanted + 1))
        for had, more, wanted in zip(stock.shape, missing, shape, strict=True)
    )
    if any(missing):
        flipped = np.pad(flipped, ((0, missing[0]), (0, missing[1])), mode="symmetric")
    return flipped[top : top + shape[0], left : left + shape[1]]


def _edge_distance(shape: tuple[int, int], scale: float) -> tuple[Field, Field]:
    """Distance of each row and each column from the nearer border [m], shapes [rows, 1] and [1, columns]."""
    down, across = (
        (np.minimum(np.arange(count), np.arange(count)[::-1]) + 0.5).astype(np.float32) / np.float32(scale)
        for count in shape
    )
    return down[:, None], across[None, :]


def _brightness(
    shape: tuple[int, int], scale: float, shade: float, rng: np.random.Generator, name: str
) -> Field:
    """How bright a carton's board is from place to place: fibres, dirt, handling marks, rounded edges."""
    paper, clouds, _ = _sheets(scale)
    field = _cut(paper, shape, rng) * np.float32(shade)
    field *= 1.0 + 0.022 * _cut(clouds, shape, rng)
    down, across = _edge_distance(shape, scale)
    for reach, depth in ((0.003, 0.18), (0.03, 0.05)):
        field *= 1.0 - depth * np.exp(-down / reach)
        field *= 1.0 - depth * np.exp(-across / reach)
    if name not in ("top", "bottom"):
        # Dust gathers below.
        field *= np.linspace(1.01, 1.01 - rng.uniform(0.01, 0.06), shape[0], dtype=np.float32)[:, None]
    field *= _handling(shape, scale, rng) * np.float32(1.0 / 128.0)
    return field


def _handling(shape: tuple[int, int], scale: float, rng: np.random.Generator) -> Picture:
    """Scuffs, stains and a crease, 128 where there are none."""
    marks = np.full(shape, 128, np.uint8)
    area = shape[0] * shape[1] / scale**2
    extent = np.array([shape[1], shape[0]])
    for _ in range(rng.poisson(3.0 * area)):
        place, radii = rng.uniform(0, 1, 2) * extent, rng.uniform(0.004, 0.03, 2) * scale
        centre = (int(place[0]), int(place[1]))
        axes = (max(1, int(radii[0])), max(1, int(radii[1])))
        cv2.ellipse(
            marks, centre, axes, rng.uniform(0, 180), 0, 360, (int(rng.integers(115, 124)),), -1, cv2.LINE_AA
        )
    blur = max(1, round(0.007 * scale)) * 2 + 1
    marks = cv2.GaussianBlur(marks, (blur, blur), 0).astype(np.uint8, copy=False)
    for _ in range(rng.poisson(22.0 * area + 0.6)):
        start, turn = rng.uniform(0, 1, 2) * extent, rng.normal(0.0, 0.5) + rng.choice([0.0, math.pi / 2])
        run = rng.gamma(2.0, 0.018) * scale
        shade = int(rng.choice([106, 112, 118, 138, 146]))
        for _ in range(int(rng.integers(1, 4))):
            offset = start + rng.normal(0.0, 0.002 * scale, 2)
            end = offset + run * np.array([math.cos(turn), math.sin(turn)])
            cv2.line(marks, _fixed(offset), _fixed(end), (shade,), 1, cv2.LINE_AA, 4)
    if rng.random() < 0.4:
        start, end = rng.uniform(0, 1, 2) * extent, rng.uniform(0, 1, 2) * extent
        if rng.random() < 0.5:
            # A dented corner: the crease cuts it off.
            reach = rng.uniform(0.03, 0.08) * scale
            start = np.array(
                [0.0 if rng.random() < 0.5 else extent[0], 0.0 if rng.random() < 0.5 else extent[1]]
            )
            end = start + reach * np.array([0.0, 1.0 if start[1] == 0.0 else -1.0])
            start = start + rng.uniform(0.5, 1.0) * reach * np.array([1.0 if start[0] == 0.0 else -1.0, 0.0])
        for shift, shade in ((0.0, 108), (0.0015 * scale, 146)):
            cv2.line(marks, _fixed(start + shift), _fixed(end + shift), (shade,), 1, cv2.LINE_AA, 4)
    return marks


def _fixed(point: np.ndarray[tuple[int], np.dtype[np.float64]]) -> tuple[int, int]:
    """A point [px] in OpenCV's fixed numbers with four bits after the point."""
    return round(16 * float(point[0])), round(16 * float(point[1]))


def _wear_edges(face: Picture, product: Product, scale: float, rng: np.random.Generator) -> None:
    """Bares the bright fibres along worn edges and corners."""
    rows, columns = face.shape[:2]
    down, across = _edge_distance((rows, columns), scale)
    fray = _cut(_sheets(scale)[2], (rows, columns), rng)
    level = float(rng.uniform(0.15, 0.6))
    # Corners get more than edges do.
    corner = np.exp(-down / 0.007) * np.exp(-across / 0.007)
    near = np.exp(-down / 0.0016) + np.exp(-across / 0.0016) + 0.7 * corner
    worn = np.clip(near * (level + 0.55 * fray) - 0.32, 0.0, 0.6).astype(np.float32)
    blend(face, product.fibre, worn)


def blend(face: Picture, colour: tuple[float, float, float], share: Field) -> None:
    """Mixes a colour [0 to 255] into a face, in place, by a share of each pixel, shape [rows, columns]."""
    layer = cv2.merge([share] * 3)
    ground = face.astype(np.float32)
    ground += (np.array(colour, np.float32) - ground) * layer
    face[:] = ground + 0.5


def _tape_up(faces: dict[str, Picture], product: Product, scale: float, rng: np.random.Generator) -> None:
    """Tapes the seams of top and bottom, over the ends."""
    for name, at_top in (("top", True), ("bottom", False)):
        aside = float(rng.normal(0.0, 0.003))
        drops = rng.uniform(0.045, 0.075, 2)
        rows = faces[name].shape[0]
        span = _tape_span(rows, 0.5 * rows - aside * scale, scale)
        _lay_tape(faces[name][span[0] : span[1]], product, scale, rng, torn=None)
        for end, sign, drop in (("left", -1.0, drops[0]), ("right", 1.0, drops[1])):
            face = faces[end]
            columns = face.shape[1]
            left, right = _tape_span(columns, 0.5 * columns + sign * aside * scale, scale)
            length = min(round(drop * scale), face.shape[0] // 2)
            strip = face[:length, left:right] if at_top else face[face.shape[0] - length :, left:right]
            _lay_tape(np.swapaxes(strip, 0, 1), product, scale, rng, torn=at_top)


def _tape_span(count: int, middle: float, scale: float) -> tuple[int, int]:
    half = min(0.5 * TAPE_WIDTH_M * scale, 0.3 * count)
    return max(0, round(middle - half)), min(count, round(middle + half))


def _lay_tape(
    strip: Picture, product: Product, scale: float, rng: np.random.Generator, *, torn: bool | None
) -> None:
    """Lays tape on a strip, in place: rows across the tape, columns along it.

    Args:
        strip: view of a face.
        product: names the tape's colour and opacity.
        scale: resolution [px/m].
        rng: drawn from.
        torn: which end is cut off by the dispenser's teeth: the last one (True), the first, or none.
    """
    rows, columns = strip.shape[:2]
    if rows < 2 or columns < 2:
        return
    streaks = noise(rng, (rows, columns), (0.008 * scale, 0.4 * scale), 3)
    bubbles = np.clip(noise(rng, (rows, columns), (0.005 * scale, 0.009 * scale), 2) - 1.7, 0.0, 1.0)
    share = np.full((rows, columns), product.tape_opacity, np.float32) + 0.05 * streaks
    share[[0, -1]] += 0.12
    if torn is not None:
        teeth = 0.0012 * scale * (1.0 + np.abs((np.arange(rows) / (0.0022 * scale)) % 2.0 - 1.0))
        distance = np.arange(columns)[::-1] if torn else np.arange(columns)
        share *= np.clip(distance[None, :] - teeth[:, None] + 1.0, 0.0, 1.0)
    share = np.clip(share, 0.0, 0.95).astype(np.float32)
    gloss = 1.0 + 0.025 * streaks + 0.12 * bubbles - 0.10 * (np.abs(np.linspace(-1, 1, rows)) > 0.94)[:, None]
    ground = strip.astype(np.float32)
    layer = np.array(product.tape_colour, np.float32) * gloss[:, :, None]
    ground += (layer - ground) * share[:, :, None]
    strip[:] = np.clip(ground, 0.0, 255.0)


@lru_cache(maxsize=64)
def _label_art(product: Product, scale: float) -> Plate:
    """A shipping label's fixed part."""
    width, height = product.label_m
    plate = Plate(width, height, scale)
    m = 0.045 * width
    plate.frame(m, m, width - 2 * m, height - 2 * m, 0.0008)
    u = height
    plate.text(product.brand, 2 * m, 0.145 * u, 0.065 * u, weight=900, widest=0.55 * width)
    plate.text("FROM: " + product.origin, 2 * m, 0.21 * u, 0.026 * u, widest=0.6 * width)
    plate.box(width - m - 0.2 * width, m, 0.2 * width, 0.19 * u)
    plate.text(
        product.route,
        width - m - 0.1 * width,
        m + 0.13 * u,
        0.08 * u,
        weight=900,
        align=0.5,
        widest=0.17 * width,
        value=0,
    )
    plate.box(m, 0.235 * u, width - 2 * m, 0.0008)
    plate.text("SHIP TO", 2 * m, 0.28 * u, 0.022 * u)
    for number, line in enumerate(product.address):
        plate.text(line, 2 * m, (0.33 + 0.052 * number) * u, 0.032 * u, weight=700, widest=0.8 * width)
    plate.box(m, 0.5 * u, width - 2 * m, 0.0008)
    plate.text(f"ART {product.code}", 2 * m, 0.56 * u, 0.036 * u, weight=800, widest=0.5 * width)
    plate.text(product.weight_text, width - 2 * m, 0.56 * u, 0.03 * u, align=1.0, widest=0.38 * width)
    plate.box(m, 0.59 * u, width - 2 * m, 0.0008)
    return plate


def _label(product: Product, scale: float, rng: np.random.Generator) -> Picture:
    """The label of one carton: the product's, with a bar code and a serial number of its own."""
    art = _label_art(product, OVERSAMPLING * scale)
    plate = Plate(art.width_m, art.height_m, art.scale)
    plate.mask[:] = art.mask
    width, height = art.width_m, art.height_m
    serial = f"(00) {rng.integers(10**8, 10**9)} {rng.integers(10**8, 10**9)}"
    plate.bars(code128_like_elements(rng, 12), 0.1 * width, 0.62 * height, 0.8 * width, 0.24 * height)
    plate.text(serial, 0.5 * width, 0.92 * height, 0.035 * height, align=0.5, widest=0.8 * width)
    shape = picture_shape(width, height, scale)
    dark = plate.reduced(shape)
    paper = [np.clip(part - (part - 28.0) * (dark / 255.0), 0, 255).astype(np.uint8) for part in LABEL_PAPER]
    return np.asarray(cv2.merge(paper), np.uint8)


def stick_label(face: Picture, product: Product, scale: float, rng: np.random.Generator) -> None:
    """Sticks a label on a face, in place: a little askew, with the shadow of its edge; nothing where it has no room."""
    label = _label(product, scale, rng)
    rows, columns = face.shape[:2]
    height, width = label.shape[:2]
    room = 0.012 * scale
    if height + 2 * room > rows or width + 2 * room > columns:
        return
    x, y = product.label_place
    centre = np.array([x * columns, y * rows]) + rng.normal(0.0, 0.004 * scale, 2)
    low, high = (
        np.array([width, height]) / 2 + room,
        np.array([columns, rows]) - np.array([width, height]) / 2 - room,
    )
    centre = np.clip(centre, low, high)
    turn = float(np.deg2rad(np.clip(rng.normal(0.0, 0.9), -2.5, 2.5)))
    cos, sin = math.cos(turn), math.sin(turn)
    matrix = np.array([[cos, -sin, 0.0], [sin, cos, 0.0]])
    matrix[:, 2] = centre - matrix[:, :2] @ (np.array([width - 1, height - 1]) / 2)
    size = (columns, rows)
    alpha = cv2.warpAffine(np.full((height, width), 255, np.uint8), matrix, size)
    shadow = cv2.GaussianBlur(alpha, (5, 5), 0)
    shifted = np.array([[1.0, 0.0, 0.7], [0.0, 1.0, 0.9]])
    shadow = cv2.warpAffine(shadow, shifted, size)
    moved = cv2.warpAffine(label, matrix, size, borderMode=cv2.BORDER_REPLICATE)
    ground = face * (1.0 - shadow * np.float32(0.28 / 255.0))[:, :, None]
    ground += (moved - ground) * (alpha * np.float32(1.0 / 255.0))[:, :, None]
    face[:] = ground + 0.5


def _write(face: Picture, scale: float, rng: np.random.Generator) -> None:
    """A number written with a marker pen."""
    words = (
        f"{rng.integers(1, 60)}/{rng.integers(1, 99)}"
        if rng.random() < 0.6
        else f"{rng.choice(list('ABCKXR'))}{rng.integers(1, 30)}"
    )
    size = 0.034 * scale / 22.0
    thick = max(1, round(0.0035 * scale))
    (width, _), _ = cv2.getTextSize(words, cv2.FONT_HERSHEY_SCRIPT_SIMPLEX, size, thick)
    rows, columns = face.shape[:2]
    if width > 0.8 * columns or 0.09 * scale > rows:
        return
    place = (
        int(rng.uniform(0.05 * columns, columns - width - 0.05 * columns)),
        int(rng.uniform(0.06 * scale, 0.4 * rows + 0.03 * scale)),
    )
    pen = np.zeros((rows, columns), np.uint8)
    cv2.putText(pen, words, place, cv2.FONT_HERSHEY_SCRIPT_SIMPLEX, size, (220,), thick, cv2.LINE_AA)
    blend(face, (38.0, 38.0, 52.0), pen * np.float32(1.0 / 255.0))
