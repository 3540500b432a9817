"""Packages that are no cartons, as they look: crates, bundles in film, wooden cases, metal boxes, mats and sheets."""

import math
from collections.abc import Callable
from functools import lru_cache
from itertools import pairwise

import cv2
import numpy as np

from config.package import Package
from sim_core.camera.artwork import OVERSAMPLING, Plate, symbol_up
from sim_core.camera.carton import blend, stick_label
from sim_core.camera.product import Product, product_of
from sim_core.camera.surfaces import (
    Field,
    Picture,
    board,
    fold_heights,
    generator,
    noise,
    picture_shape,
    plywood,
    scratches,
    steel,
    tinted,
    wood,
)

Extent = tuple[float, float]
FaceOf = Callable[["Face"], Picture]

_VARIANTS = 4

_CRATE_COLOURS = ((44, 84, 142), (118, 121, 123), (50, 106, 74), (152, 52, 46), (196, 162, 58))
_PACK_COLOURS = ((186, 58, 50), (52, 98, 160), (214, 160, 56), (66, 122, 80), (112, 82, 132), (60, 62, 70))
_PACK_GROUNDS = ((214, 206, 190), (196, 208, 218), (222, 200, 160), (226, 224, 218))


class Face:
    """One face that is to be drawn.

    Attributes:
        name: ``side``, ``end``, ``top`` or ``bottom``.
        extent: width and height [m].
        shape: rows and columns.
        scale: resolution [px/m].
        product: what the package holds.
        rng: what this face differs by from others of the product.
        seed: the same, for pictures that take a seed.
        design: numbers that all packages of this product share, one generator for each face.
    """

    def __init__(self, name: str, extent: Extent, scale: float, product: Product, variant: int) -> None:
        self.name, self.extent, self.scale, self.product = name, extent, scale, product
        self.shape = picture_shape(*extent, scale)
        self.rng = generator("face", name, extent, product.code, product.brand, variant)
        self.seed = int(self.rng.integers(2**31))
        self.design = generator("container", product.code, product.brand)


def container_faces(package: Package, *, seed: int, pixels_per_m: float) -> tuple[Picture, ...] | None:
    """Faces of a package as ``print.carton_faces`` gives them; None for one that is a carton."""
    look = _sheet if package.kind == "interlayer" else _LOOKS.get(package.surface)
    if look is None:
        return None
    x, y, z = package.size_m
    longest = max(package.size_m)
    scale = picture_shape(longest, longest, pixels_per_m)[0] / longest
    product = product_of((max(x, y), min(x, y), z), package.mass_kg, package.surface, seed)
    across_x, across_y = ("end", "side") if x >= y else ("side", "end")
    named = ((across_x, y, z), (across_x, y, z), (across_y, x, z), (across_y, x, z))
    rng = generator("container", package.id, seed)
    shade = float(np.clip(1.0 + 0.025 * rng.standard_normal(), 0.9, 1.08))
    pictures = []
    for name, width, height in (*named, ("bottom", x, y), ("top", x, y)):
        drawn = _drawn(look, name, (width, height), scale, product, int(rng.integers(_VARIANTS)))
        picture = np.asarray(cv2.convertScaleAbs(drawn, alpha=shade), np.uint8)
        if look in _LABELLED and name == "side":
            stick_label(picture, product, scale, rng)
        pictures.append(picture)
    return tuple(pictures)


@lru_cache(maxsize=96)
def _drawn(look: FaceOf, name: str, extent: Extent, scale: float, product: Product, variant: int) -> Picture:
    """A face without what is only one package's; a product's packages share a few of them."""
    picture = look(Face(name, extent, scale, product, variant))
    picture.setflags(write=False)
    return picture


def _sheet(face: Face) -> Picture:
    """An interlayer: plain board, dark and fluted at its edges."""
    width, height = face.extent
    if face.product.surface == "anti_slip":
        return _mat(face)
    picture = board(width, height, seed=face.seed, pixels_per_m=face.scale)
    if face.name in ("top", "bottom"):
        return picture
    rows, columns = picture.shape[:2]
    along = np.arange(columns, dtype=np.float32)[None, :] / np.float32(face.scale)
    down = np.linspace(-1.0, 1.0, rows, dtype=np.float32)[:, None]
    # The fluting's wave between two liners.
    wave = np.exp(-(((down - 0.7 * np.sin(2.0 * np.pi * along / 0.0065)) / 0.5) ** 2))
    depth = np.clip(0.5 + 0.3 * wave + 0.4 * np.abs(down) ** 6, 0.0, 1.0)
    depth *= 1.0 + 0.08 * noise(face.rng, (rows, columns), (rows, 0.02 * face.scale), 2)
    return np.asarray(picture * depth[:, :, None], np.uint8)


def _mat(face: Face) -> Picture:
    """Rubber granulate, pressed to a mat."""
    grains = noise(face.rng, face.shape, (0.003 * face.scale,) * 2, 2)
    coarse = noise(face.rng, face.shape, (0.007 * face.scale,) * 2)
    picture = tinted(np.clip(1.0 + 0.16 * grains + 0.08 * coarse, 0.3, 2.0), (56.0, 54.0, 55.0))
    for colour, level in (((120.0, 74.0, 60.0), 2.0), ((80.0, 96.0, 120.0), -2.0)):
        spots = np.clip(2.0 * (math.copysign(1.0, level) * coarse - abs(level)) + 1.0, 0.0, 0.7)
        blend(picture, colour, spots.astype(np.float32))
    return picture


def _crate(face: Face) -> Picture:
    """A moulded crate with ribs, a rim and, on its ends, handles; lit by how its surface slopes."""
    width, height = face.extent
    base = _CRATE_COLOURS[int(face.design.integers(len(_CRATE_COLOURS)))]
    relief = Plate(width, height, face.scale)
    relief.mask[:] = 90
    rim = min(0.035, 0.2 * height)
    if face.name in ("top", "bottom"):
        for inset, level in ((0.0, 190), (0.25 * rim, 120), (0.8 * rim, 170)):
            relief.box(inset, inset, width - 2 * inset, height - 2 * inset, value=level)
        for x in np.arange(0.06, width - 0.04, 0.055):
            relief.box(float(x), 1.6 * rim, 0.004, max(height - 3.2 * rim, 0.001), value=215)
        relief.box(1.6 * rim, 0.5 * height - 0.002, max(width - 3.2 * rim, 0.001), 0.004, value=215)
    else:
        for x in np.arange(0.03, width - 0.02, min(0.055, max(0.02, 0.2 * width))):
            relief.box(float(x), 0.0, 0.005, height, value=170)
        field_width = min(0.5 * width, 0.24)
        relief.box(
            0.5 * (width - field_width), 1.4 * rim, field_width, max(height - 2.6 * rim, 0.0), value=130
        )
        relief.box(0.0, 0.0, width, rim, value=215)
        relief.box(0.0, height - 0.7 * rim, width, 0.7 * rim, value=190)
    blurred = np.asarray(cv2.GaussianBlur(relief.reduced(face.shape), (3, 3), 0), np.float32)
    soft = blurred * np.float32(1.0 / 255.0)
    slope = np.gradient(soft, axis=0) + 0.8 * np.gradient(soft, axis=1)
    shade = 0.80 + 0.30 * soft + 1.1 * slope + 0.02 * noise(face.rng, face.shape, (0.2 * face.scale,) * 2, 3)
    # The mould's grain, and years of grime in it.
    shade += 0.02 * noise(face.rng, face.shape, (0.006 * face.scale,) * 2, 2)
    marks = np.full(face.shape, 128, np.uint8)
    scratches(marks, face.rng, face.scale, density=130.0, shades=(104, 114, 150, 176), spread=0.8)
    picture = tinted(np.asarray(shade * (marks / np.float32(128.0)), np.float32), base)
    handle = face.name == "end" and height > 0.12 and width > 0.18
    _print(picture, face, (236.0, 236.0, 232.0), 0.8, from_top=0.58 if handle else 0.3)
    if handle:
        slot = Plate(width, height, face.scale)
        slot.box(0.5 * width - 0.05, 1.7 * rim, 0.1, 0.028)
        blend(picture, (22.0, 22.0, 24.0), _share(slot, face, 0.92))
    return picture


def _bundle(face: Face) -> Picture:
    """Rows of packs in film: their print, dimmed by haze and streaked by the film's folds."""
    width, height = face.extent
    columns = max(1, round(width / min(0.11, max(0.5 * width, 0.03))))
    rows = max(1, round(height / min(0.16, max(0.5 * height, 0.03))))
    cell = (width / columns, height / rows)
    scale = OVERSAMPLING * face.scale
    plain, first, second = (Plate(width, height, scale) for _ in range(3))
    kind = int(face.design.integers(3))
    colour, other = (_PACK_COLOURS[int(number)] for number in face.design.permutation(len(_PACK_COLOURS))[:2])
    ground = _PACK_GROUNDS[int(face.design.integers(len(_PACK_GROUNDS)))]
    for row in range(rows):
        for column in range(columns):
            x, y = (column + 0.02) * cell[0], (row + 0.015) * cell[1]
            w, h = 0.96 * cell[0], 0.97 * cell[1]
            plain.box(x, y, w, h)
            if face.name in ("top", "bottom"):
                first.frame(x, y, w, h, 0.05 * min(w, h), value=150)
                second.disc(x + 0.5 * w, y + 0.5 * h, 0.2 * min(w, h))
                continue
            first.box(x, y + (0.1, 0.5, 0.0)[kind] * h, w, (0.4, 0.5, 0.3)[kind] * h)
            middle, widest = x + 0.5 * w, 0.85 * w
            name_y = y + (0.35, 0.8, 0.2)[kind] * h
            first.text(
                face.product.brand, middle, name_y, 0.13 * h, weight=900, align=0.5, widest=widest, value=0
            )
            second.disc(middle, y + (0.72, 0.25, 0.62)[kind] * h, 0.15 * min(w, h))
            second.text(face.product.article, middle, y + 0.95 * h, 0.06 * h, align=0.5, widest=widest)
    picture = tinted(1.0 + 0.1 * noise(face.rng, face.shape, (0.01 * face.scale,) * 2), (58.0, 56.0, 54.0))
    blend(picture, ground, _share(plain, face, 1.0))
    blend(picture, colour, _share(first, face, 0.95))
    blend(picture, other, _share(second, face, 0.9))
    _film_over(picture, face)
    return picture


def _film_over(picture: Picture, face: Face) -> None:
    """Haze and the bright and dark streaks of folds, in place."""
    heights = fold_heights(*face.extent, seed=face.seed, pixels_per_m=face.scale)
    slope = np.gradient(heights, axis=1) * face.scale if heights.shape[1] > 1 else heights
    slope = slope / max(float(np.std(slope)), 1.0e-9)
    haze = np.clip(0.10 + 0.05 * noise(face.rng, face.shape, (0.15 * face.scale,) * 2, 3), 0.02, 0.3)
    bright = np.clip(slope - 1.2, 0.0, 2.5) * 0.16
    blend(picture, (226.0, 230.0, 234.0), np.clip(haze + bright, 0.0, 0.75).astype(np.float32))
    blend(picture, (40.0, 42.0, 46.0), np.clip(0.1 * (-slope - 1.2), 0.0, 0.3).astype(np.float32))


def _case(face: Face) -> Picture:
    """A nailed case of sawn boards with a frame around each side."""
    width, height = face.extent
    count = max(1, round(height / 0.095))
    edges = np.round(np.linspace(0, face.shape[0], count + 1)).astype(int)
    picture = np.zeros((*face.shape, 3), np.uint8)
    for number, (top, bottom) in enumerate(pairwise(edges)):
        plank = wood(width, height / count, seed=face.seed + number, pixels_per_m=face.scale)
        picture[top:bottom] = cv2.resize(plank, (face.shape[1], bottom - top), interpolation=cv2.INTER_AREA)
        if number:
            picture[top] = picture[top] // 3
    batten = min(0.07, 0.2 * width)
    upright = wood(height, batten, seed=face.seed + 99, pixels_per_m=face.scale)
    wide = round(batten * face.scale)
    if wide > 3 and face.name in ("side", "end"):
        for left in (0, face.shape[1] - wide):
            turned = cv2.resize(np.rot90(upright), (wide, face.shape[0]), interpolation=cv2.INTER_AREA)
            picture[:, left : left + wide] = turned
            shadow = left + wide if left == 0 else left - 1
            picture[:, shadow : shadow + 1] = picture[:, shadow : shadow + 1] // 2
            for top, bottom in pairwise(edges):
                for share in (0.3, 0.7):
                    place = (
                        round(left + (0.3 + 0.4 * face.rng.random()) * wide),
                        round(top + share * (bottom - top)),
                    )
                    cv2.circle(
                        picture, place, max(1, round(0.0022 * face.scale)), (62, 56, 52), -1, cv2.LINE_AA
                    )
    _print(picture, face, (42.0, 38.0, 36.0), 0.75, inset=batten)
    return picture


def _panel(face: Face) -> Picture:
    """A box of film-faced plywood."""
    picture = plywood(*face.extent, seed=face.seed, pixels_per_m=face.scale)
    _print(picture, face, (226.0, 222.0, 212.0), 0.75)
    return picture


def _metal(face: Face) -> Picture:
    """A sheet metal box with its seams."""
    picture = steel(*face.extent, seed=face.seed, pixels_per_m=face.scale)
    seams = Plate(*face.extent, face.scale)
    inset = 0.08 * min(face.extent)
    seams.frame(inset, inset, face.extent[0] - 2 * inset, face.extent[1] - 2 * inset, 0.003)
    blend(picture, (92.0, 95.0, 99.0), _share(seams, face, 0.7))
    _print(picture, face, (38.0, 40.0, 44.0), 0.8, inset=inset)
    return picture


def _rubber(face: Face) -> Picture:
    picture = _mat(face)
    _print(picture, face, (214.0, 212.0, 206.0), 0.8)
    return picture


def _share(plate: Plate, face: Face, opacity: float) -> Field:
    return plate.reduced(face.shape) * np.float32(opacity / 255.0)


def _print(
    picture: Picture,
    face: Face,
    colour: tuple[float, float, float],
    opacity: float,
    *,
    inset: float = 0.0,
    from_top: float = 0.3,
) -> None:
    """Stencils brand, number, size and mass on a face, in place; on top and bottom the number only."""
    width, height = face.extent
    room = width - 2.0 * inset - 0.04
    if min(room, height) < 0.02:
        return
    plate = Plate(width, height, OVERSAMPLING * face.scale)
    product = face.product
    if face.name in ("top", "bottom"):
        size = min(0.03, 0.15 * height)
        plate.text(
            f"{product.brand} {product.code}",
            0.5 * width,
            0.5 * height,
            size,
            weight=800,
            align=0.5,
            widest=0.7 * room,
        )
    else:
        left, size = inset + 0.02, min(0.13, 0.3 * (1.0 - from_top)) * min(height, 0.4)
        plate.text(product.brand, left, from_top * height, size, weight=800, widest=0.6 * room)
        for number, line in enumerate((product.code, product.size_text, product.weight_text)):
            plate.text(
                line, left, from_top * height + (1.0 + number) * 0.75 * size, 0.42 * size, widest=0.6 * room
            )
        edge = min(0.2 * height, 0.06)
        if 0.05 * height + edge + inset < height and room > 0.2:
            symbol_up(plate, width - inset - 0.02 - edge, 0.13 * height, edge)
    rough = np.clip(opacity + 0.12 * noise(face.rng, face.shape, (0.006 * face.scale,) * 2, 3), 0.0, 0.95)
    blend(picture, colour, _share(plate, face, 1.0) * rough.astype(np.float32))


_LOOKS: dict[str, FaceOf] = {
    "plastic": _crate,
    "shrink_film": _bundle,
    "stretch_film": _bundle,
    "wood": _case,
    "plywood": _panel,
    "sled": _panel,
    "steel": _metal,
    "aluminium": _metal,
    "anti_slip": _rubber,
}
"""How a package of each surface looks; one of board or paper is a carton."""
_LABELLED = (_crate, _panel, _metal)
