"""Line art of packaging: lettering, handling symbols, bar codes and shipping labels, drawn in metres."""

from collections.abc import Sequence
from functools import lru_cache
from itertools import product

import cv2
import numpy as np

from sim_core.camera.surfaces import Picture

OVERSAMPLING = 2
"""Art is drawn so many times finer than the face it goes on."""
CAP_HEIGHT = 0.75
"""Height of a capital letter in OpenCV's built-in typefaces, as a share of their size."""
_SHIFT = 5
_ITF_DIGITS = ("00110", "10001", "01001", "11000", "00101", "10100", "01100", "00011", "10010", "01010")
"""Wide elements (1) of the interleaved 2 of 5 code, digits 0 to 9 (ISO/IEC 16390)."""
_SYMBOLS = [
    [float(width) for width in widths]
    for widths in product(range(1, 5), repeat=6)
    if sum(widths) == 11 and sum(widths[::2]) % 2 == 0
]
"""Bar and space widths that Code 128 has for symbols: eleven modules, an even count of them dark."""

Point = tuple[float, float]


@lru_cache(maxsize=2)
def _typeface(name: str) -> cv2.FontFace:
    return cv2.FontFace(name)


def _advance(words: str, size: int, weight: int) -> int:
    """Width of a line of text [px]."""
    return int(cv2.getTextSize((0, 0), words, (0, 0), _typeface("sans"), max(size, 1), weight)[2])


class Plate:
    """One colour's printing plate: 255 where it prints. Places in metres, from the upper left corner, y down.

    Attributes:
        width_m: [m].
        height_m: [m].
        scale: resolution of the plate [px/m].
        mask: shape [rows, columns].
    """

    def __init__(self, width_m: float, height_m: float, scale: float) -> None:
        self.width_m, self.height_m, self.scale = width_m, height_m, scale
        self.mask: Picture = np.zeros(
            (max(1, round(height_m * scale)), max(1, round(width_m * scale))), np.uint8
        )

    def polygon(self, points: Sequence[Point], *, value: int = 255) -> None:
        """Fills a polygon."""
        fixed = np.round(np.array(points) * self.scale * 2**_SHIFT - 2 ** (_SHIFT - 1)).astype(np.int32)
        cv2.fillPoly(self.mask, [fixed], (value,), cv2.LINE_AA, _SHIFT)

    def box(self, x: float, y: float, width: float, height: float, *, value: int = 255) -> None:
        """Fills a rectangle whose upper left corner is at x, y."""
        self.polygon([(x, y), (x + width, y), (x + width, y + height), (x, y + height)], value=value)

    def frame(
        self, x: float, y: float, width: float, height: float, line: float, *, value: int = 255
    ) -> None:
        """Draws a rectangle's outline inwards."""
        self.box(x, y, width, line, value=value)
        self.box(x, y + height - line, width, line, value=value)
        self.box(x, y, line, height, value=value)
        self.box(x + width - line, y, line, height, value=value)

    def stroke(self, points: Sequence[Point], line: float, *, value: int = 255) -> None:
        """Draws a line through the points."""
        fixed = np.round(np.array(points) * self.scale * 2**_SHIFT).astype(np.int32)
        thick = max(1, round(line * self.scale))
        cv2.polylines(self.mask, [fixed], False, (value,), thick, cv2.LINE_AA, _SHIFT)

    def arc(
        self, x: float, y: float, radii: Point, from_deg: float, to_deg: float, *, value: int = 255
    ) -> None:
        """Fills the segment of an ellipse between two directions, clockwise from the right."""
        turn = np.deg2rad(np.linspace(from_deg, to_deg, 48))
        self.polygon(
            [(x + radii[0] * float(np.cos(t)), y + radii[1] * float(np.sin(t))) for t in turn], value=value
        )

    def disc(self, x: float, y: float, radius: float, *, value: int = 255) -> None:
        """Fills a circle."""
        self.arc(x, y, (radius, radius), 0.0, 360.0, value=value)

    def text(
        self,
        words: str,
        x: float,
        y: float,
        capitals: float,
        *,
        weight: int = 600,
        align: float = 0.0,
        widest: float | None = None,
        face: str = "sans",
        value: int = 255,
    ) -> float:
        """Sets a line of text; gives its width [m].

        Args:
            words: the text.
            x: left end, middle or right end, by ``align``.
            y: of the baseline.
            capitals: height of a capital letter; smaller where the line would be wider than ``widest``.
            weight: 100 thin to 900 black.
            align: 0 left, 0.5 centred, 1 right.
            widest: the line's greatest width; the plate's without one.
            face: ``sans`` or ``italic``.
            value: 0 cuts the text out of what is printed.
        """
        typeface = _typeface(face)
        size = capitals * self.scale / CAP_HEIGHT
        room = (min(widest, self.width_m) if widest is not None else self.width_m) * self.scale
        width = _advance(words, round(size), weight)
        if width > room:
            size *= room / width
            width = _advance(words, int(size), weight)
        if size < 5.0:
            return 0.0
        left = round(x * self.scale - align * width)
        # A canvas of its own: OpenCV breaks lines at the right border.
        rows = self.mask.shape[0]
        top, bottom = round(y * self.scale - 1.1 * size), round(y * self.scale + 0.4 * size)
        line = np.zeros((bottom - top, int(width + 1.5 * size)), np.uint8)
        cv2.putText(line, words, (round(0.3 * size), round(1.1 * size)), (255,), typeface, int(size), weight)
        left -= round(0.3 * size)
        r0, r1 = max(0, top), min(rows, bottom)
        c0, c1 = max(0, left), min(self.mask.shape[1], left + line.shape[1])
        if r0 < r1 and c0 < c1:
            part = line[r0 - top : r1 - top, c0 - left : c1 - left]
            under = self.mask[r0:r1, c0:c1]
            under[:] = cv2.max(under, part) if value else cv2.subtract(under, part)
        return width / self.scale

    def text_width(self, words: str, capitals: float, weight: int) -> float:
        """Width of a line of text [m] at this height of capitals [m]."""
        return _advance(words, 100, weight) / 100.0 * capitals / CAP_HEIGHT

    def stamp(self, other: "Plate", x: float, y: float) -> None:
        """Adds another plate of the same resolution with its upper left corner at x, y."""
        top, left = round(y * self.scale), round(x * self.scale)
        r0, c0 = max(0, top), max(0, left)
        r1 = min(self.mask.shape[0], top + other.mask.shape[0])
        c1 = min(self.mask.shape[1], left + other.mask.shape[1])
        if r0 < r1 and c0 < c1:
            under = self.mask[r0:r1, c0:c1]
            under[:] = cv2.max(under, other.mask[r0 - top : r1 - top, c0 - left : c1 - left])

    def bars(self, elements: Sequence[float], x: float, y: float, width: float, height: float) -> None:
        """Draws a bar code of the given relative widths, bar and space by turns, sharp to a fraction of a pixel."""
        edges = np.concatenate(([0.0], np.cumsum(elements))) * width / float(np.sum(elements)) + x
        columns = np.arange(self.mask.shape[1] + 1) / self.scale
        covered = np.zeros(len(columns))
        for start, end in zip(edges[:-1:2], edges[1::2], strict=False):
            covered += np.clip(columns, start, end) - start
        ink = np.clip(np.diff(covered) * self.scale * 255.0, 0.0, 255.0).astype(np.uint8)
        top, bottom = round(y * self.scale), round((y + height) * self.scale)
        under = self.mask[max(0, top) : bottom]
        under[:] = np.maximum(under, ink)

    def reduced(self, shape: tuple[int, int]) -> Picture:
        """The plate as a picture of so many rows and columns."""
        return cv2.resize(self.mask, (shape[1], shape[0]), interpolation=cv2.INTER_AREA).astype(
            np.uint8, copy=False
        )


def itf_elements(digits: str) -> list[float]:
    """Widths of bars and spaces of an interleaved 2 of 5 code, the one printed on board (an even count of digits)."""
    elements = [1.0, 1.0, 1.0, 1.0]
    for first, second in zip(digits[::2], digits[1::2], strict=True):
        for bar, space in zip(_ITF_DIGITS[int(first)], _ITF_DIGITS[int(second)], strict=True):
            elements += [2.5 if bar == "1" else 1.0, 2.5 if space == "1" else 1.0]
    return [*elements, 2.5, 1.0, 1.0]


def code128_like_elements(rng: np.random.Generator, symbols: int) -> list[float]:
    """Widths of bars and spaces that look like Code 128: symbols of three bars in eleven modules; they say nothing."""
    elements = [2.0, 1.0, 1.0, 2.0, 3.0, 2.0]
    for number in rng.integers(len(_SYMBOLS), size=symbols):
        elements += _SYMBOLS[number]
    return [*elements, 2.0, 3.0, 3.0, 1.0, 1.0, 1.0, 2.0]


def symbol_up(plate: Plate, x: float, y: float, size: float) -> None:
    """ISO 780's "this way up": two arrows on a line, in a square of the size [m]."""
    for middle in (0.28, 0.72):
        plate.polygon(
            [
                (x + size * (middle + across), y + size * down)
                for across, down in (
                    (0.0, 0.04),
                    (0.17, 0.36),
                    (0.07, 0.36),
                    (0.07, 0.78),
                    (-0.07, 0.78),
                    (-0.07, 0.36),
                    (-0.17, 0.36),
                )
            ]
        )
    plate.box(x + 0.06 * size, y + 0.86 * size, 0.88 * size, 0.09 * size)


def symbol_fragile(plate: Plate, x: float, y: float, size: float) -> None:
    """ISO 780's wine glass, with its crack."""
    outline = [(0.24, 0.04), (0.76, 0.04), (0.76, 0.3), (0.7, 0.46), (0.55, 0.56), (0.55, 0.84), (0.74, 0.9)]
    outline += [(0.74, 0.96), (0.26, 0.96), (0.26, 0.9), (0.45, 0.84), (0.45, 0.56), (0.3, 0.46), (0.24, 0.3)]
    plate.polygon([(x + size * u, y + size * v) for u, v in outline])
    crack = [(0.52, 0.04), (0.44, 0.16), (0.54, 0.22), (0.47, 0.34), (0.51, 0.22), (0.4, 0.17), (0.47, 0.04)]
    plate.polygon([(x + size * u, y + size * v) for u, v in crack], value=0)


def symbol_dry(plate: Plate, x: float, y: float, size: float) -> None:
    """ISO 780's umbrella in the rain."""
    plate.arc(x + 0.5 * size, y + 0.56 * size, (0.42 * size, 0.34 * size), 180.0, 360.0)
    for middle in (0.22, 0.5, 0.78):
        plate.arc(x + middle * size, y + 0.565 * size, (0.14 * size, 0.06 * size), 180.0, 360.0, value=0)
    hook = [(0.5, 0.5), (0.5, 0.84), (0.47, 0.9), (0.41, 0.9), (0.38, 0.84)]
    plate.stroke([(x + size * u, y + size * v) for u, v in hook], 0.05 * size)
    for u, v in ((0.14, 0.16), (0.32, 0.06), (0.68, 0.06), (0.86, 0.16), (0.06, 0.34), (0.94, 0.34)):
        plate.stroke(
            [(x + size * u, y + size * v), (x + size * (u - 0.03), y + size * (v + 0.09))], 0.03 * size
        )


def symbol_stack(plate: Plate, x: float, y: float, size: float, layers: int) -> None:
    """ISO 780's stacking limit: a box, its limit above it and n layers."""
    plate.box(x + 0.08 * size, y + 0.9 * size, 0.84 * size, 0.06 * size)
    plate.box(x + 0.22 * size, y + 0.62 * size, 0.56 * size, 0.24 * size)
    plate.frame(x + 0.22 * size, y + 0.34 * size, 0.56 * size, 0.24 * size, 0.05 * size)
    plate.text(str(layers), x + 0.5 * size, y + 0.54 * size, 0.15 * size, weight=800, align=0.5)
    plate.box(x + 0.08 * size, y + 0.04 * size, 0.84 * size, 0.06 * size)
    plate.stroke([(x + 0.5 * size, y + 0.12 * size), (x + 0.5 * size, y + 0.3 * size)], 0.05 * size)


def symbol_recycle(plate: Plate, x: float, y: float, size: float) -> None:
    """Three bent arrows around a triangle."""
    middle = np.array([x + 0.5 * size, y + 0.56 * size])
    corners = [
        middle + 0.48 * size * np.array([np.sin(t), -np.cos(t)]) for t in np.deg2rad([0.0, 120.0, 240.0])
    ]
    for here, there in zip(corners, corners[1:] + corners[:1], strict=True):
        along = (there - here) / np.linalg.norm(there - here)
        inward = np.array([-along[1], along[0]])
        start, end = here + 0.16 * size * along, there - 0.3 * size * along
        band = 0.13 * size * inward
        plate.polygon([tuple(p) for p in (start, end, end + band, start + band)])
        tip = end + 0.17 * size * along + 0.5 * band
        plate.polygon([tuple(p) for p in (end - 0.6 * band, tip, end + 1.6 * band)])


def emblem(plate: Plate, kind: int, x: float, y: float, size: float) -> None:
    """A brand's emblem in a square of the size [m]: sun over hills, drop, hexagon, leaf or globe, by number."""
    cx, cy, r = x + 0.5 * size, y + 0.5 * size, 0.5 * size
    if kind == 0:
        plate.disc(cx, cy, r)
        plate.disc(cx + 0.3 * r, cy - 0.3 * r, 0.28 * r, value=0)
        hills = [
            (-0.95, 0.5),
            (-0.35, -0.25),
            (0.0, 0.2),
            (0.3, -0.05),
            (0.95, 0.5),
            (0.8, 0.58),
            (-0.8, 0.58),
        ]
        plate.polygon([(cx + r * u, cy + r * v) for u, v in hills], value=0)
    elif kind == 1:
        plate.disc(cx, cy + 0.3 * r, 0.66 * r)
        plate.polygon([(cx, cy - r), (cx + 0.6 * r, cy + 0.05 * r), (cx - 0.6 * r, cy + 0.05 * r)])
        plate.arc(cx, cy + 0.3 * r, (0.42 * r, 0.42 * r), 20.0, 110.0, value=0)
    elif kind == 2:
        corners = np.deg2rad(np.arange(30.0, 390.0, 60.0))
        for share, value in ((1.0, 255), (0.78, 0), (0.62, 255), (0.28, 0)):
            plate.polygon(
                [(cx + share * r * float(np.cos(t)), cy + share * r * float(np.sin(t))) for t in corners],
                value=value,
            )
    elif kind == 3:
        bend = np.linspace(0.0, np.pi, 24)
        for side in (-1.0, 1.0):
            plate.polygon(
                [(cx + side * 0.62 * r * float(np.sin(t)) ** 1.6, cy - r * float(np.cos(t))) for t in bend]
            )
        plate.stroke([(cx, cy - 0.7 * r), (cx, cy + r)], 0.09 * size, value=0)
        for rise in (-0.2, 0.15, 0.5):
            for side in (-1.0, 1.0):
                plate.stroke(
                    [(cx, cy + rise * r), (cx + side * 0.42 * r, cy + (rise - 0.3) * r)], 0.04 * size, value=0
                )
    else:
        plate.disc(cx, cy, r)
        for share in (0.45, 0.0):
            plate.arc(cx, cy, ((share + 0.06) * r, 0.94 * r), 0.0, 360.0, value=0)
            plate.arc(cx, cy, (max(share - 0.03, 0.0) * r, 0.94 * r), 0.0, 360.0)
        for rise in (-0.4, 0.0, 0.4):
            plate.box(cx - r, cy + (rise - 0.03) * r, 2.0 * r, 0.06 * r, value=0)
