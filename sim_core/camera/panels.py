"""The print of a carton's panels: how sides, ends and flaps are laid out on the printing plates."""

import numpy as np

from sim_core.camera.artwork import (
    Plate,
    emblem,
    itf_elements,
    symbol_dry,
    symbol_fragile,
    symbol_recycle,
    symbol_stack,
    symbol_up,
)
from sim_core.camera.product import Product


def side_plates(product: Product, width: float, height: float, scale: float) -> tuple[Plate, Plate, Plate]:
    """Plates of a long side: first ink, second ink, holes."""
    first, second, holes = (Plate(width, height, scale) for _ in range(3))
    if min(width, height) < 0.045:
        _strip(first, product)
    else:
        (_block, _band, _emblem, _frame, _plain)[product.layout](first, second, product)
    return first, second, holes


def end_plates(product: Product, width: float, height: float, scale: float) -> tuple[Plate, Plate, Plate]:
    """Plates of a short side: first ink, second ink, holes."""
    first, second, holes = (Plate(width, height, scale) for _ in range(3))
    if min(width, height) < 0.045:
        _strip(first, product)
        return first, second, holes
    m, u = _margin(first), _unit(first)
    top = 0.16 * height
    if product.layout == 1:
        second.box(0.0, 0.30 * height, width, 0.30 * height)
        second.text(
            product.brand,
            0.5 * width,
            0.45 * height + 0.09 * u,
            0.18 * u,
            weight=900,
            align=0.5,
            widest=0.86 * width,
            value=0,
        )
    elif product.handholes:
        first.text(
            product.brand, 0.5 * width, 0.58 * height, 0.13 * u, weight=900, align=0.5, widest=0.8 * width
        )
    else:
        first.text(
            product.brand, 0.5 * width, top + 0.3 * u, 0.17 * u, weight=900, align=0.5, widest=0.84 * width
        )
        second.box(0.5 * width - 0.42 * (width - 2 * m), top + 0.35 * u, 0.84 * (width - 2 * m), 0.022 * u)
    if product.handholes and width > 0.16:
        _handhole(holes, 0.5 * width, 0.27 * height)
    # Tape hangs over the middle.
    room = 0.5 * width - m - (0.03 if product.tape and width > 0.16 else 0.008)
    line = min(0.055 * u, 0.016, (0.4 * height - m) / 6.2)
    _facts(first, product, m, height - m, line, room)
    if product.layout != 1:
        high = 0.66 * height if product.handholes else top + 0.42 * u
        size = min(0.16 * u, 0.05, (height - m - 7.5 * line - high) / 1.44)
        if size > 0.014:
            _symbols(first, product, 0.5 * width + 1.33 * size, high, size, 2)
    _barcode(first, product, width - m, height - m, room)
    return first, second, holes


def flap_plates(
    product: Product, length: float, width: float, scale: float, *, bottom: bool
) -> tuple[Plate, Plate, Plate]:
    """Plates of top or bottom, the seam across the picture: first ink, second ink, gaps."""
    first, second, gaps = (Plate(length, width, scale) for _ in range(3))
    if product.wrapped:
        gaps.stroke([(0.0, 0.46 * width), (length, 0.47 * width)], 0.001, value=90)
    else:
        # The inner flaps end here; the outer ones bend over their edge.
        for x in (0.5 * width, length - 0.5 * width):
            if 0.05 * length < x < 0.95 * length:
                gaps.box(x - 0.0015, 0.0, 0.003, width, value=16)
        gaps.box(0.0, 0.5 * width - 0.0009, length, 0.0018, value=215)
    if min(length, width) < 0.08:
        return first, second, gaps
    u = min(width, 0.6 * length)
    if bottom:
        radius = min(0.04, 0.14 * u)
        x, y = length - 1.6 * radius, 0.75 * width
        first.disc(x, y, radius)
        first.disc(x, y, 0.94 * radius, value=0)
        first.text("BOARD GRADE C 32", x, y - 0.5 * radius, 0.12 * radius, align=0.5, widest=1.3 * radius)
        first.text(
            f"{product.flute_m * 1e3:.1f} mm  5.2 kN/m",
            x,
            y + 0.6 * radius,
            0.12 * radius,
            align=0.5,
            widest=1.3 * radius,
        )
        symbol_recycle(first, x - 0.4 * radius, y - 0.42 * radius, 0.8 * radius)
        first.text(product.code, 0.06 * length, 0.9 * width, min(0.02, 0.06 * u), weight=500)
    else:
        size = min(0.028, 0.11 * u)
        first.text(
            product.brand, 0.04 * length, 0.06 * width + 1.2 * size, size, weight=900, widest=0.4 * length
        )
        first.text(product.code, 0.04 * length, 0.06 * width + 2.4 * size, 0.55 * size, weight=500)
        edge = min(0.05, 0.22 * u)
        symbol_up(first, length - 0.04 * length - edge, 0.1 * width, edge)
        if product.layout in (0, 2):
            second.box(0.0, 0.0, length, 0.035 * u)
            second.box(0.0, width - 0.035 * u, length, 0.035 * u)
    return first, second, gaps


def _margin(plate: Plate) -> float:
    return 0.05 * min(plate.width_m, plate.height_m) + 0.004


def _unit(plate: Plate) -> float:
    """Length that sizes of type go by [m]."""
    return min(plate.height_m, 0.75 * plate.width_m)


def _strip(plate: Plate, product: Product) -> None:
    """A low or narrow panel: one line of text."""
    w, h = plate.width_m, plate.height_m
    if h < 0.012 or w < 0.03:
        return
    plate.text(
        f"{product.brand}  {product.code}  {product.weight_text}",
        0.05 * w,
        0.68 * h,
        min(0.36 * h, 0.02),
        weight=800,
        widest=0.9 * w,
    )


def _symbols(plate: Plate, product: Product, right: float, top: float, size: float, count: int) -> None:
    """Handling symbols in a row that ends at the right, in a thin frame."""
    gap = 0.22 * size
    left = right - count * size - (count + 1) * gap
    plate.frame(left, top, right - left, size + 2 * gap, max(0.0011, 0.02 * size))
    for number in range(count):
        x, y = left + gap + number * (size + gap), top + gap
        if number == 3:
            symbol_stack(plate, x, y, size, product.stack)
        else:
            (symbol_up, symbol_fragile, symbol_dry)[number](plate, x, y, size)


def _barcode(plate: Plate, product: Product, right: float, bottom: float, widest: float) -> None:
    """The article's number as an ITF-14 bar code with bearer bars, its digits below."""
    # 152 mm is its nominal width; it stays in the lower part of a panel.
    width = min(widest, 0.152, (0.4 * plate.height_m - (plate.height_m - bottom)) / 0.41)
    if width < 0.03:
        return
    height, bearer, digits = 0.26 * width, 0.018 * width, 0.075 * width
    left, top = right - width, bottom - height - 1.9 * digits
    plate.frame(left, top, width, height, bearer)
    plate.bars(itf_elements(product.digits), left + 0.07 * width, top, 0.86 * width, height)
    d = product.digits
    number = f"{d[0]} {d[1:3]} {d[3:8]} {d[8:13]} {d[13]}"
    plate.text(number, left + 0.5 * width, bottom, digits, align=0.5, weight=500, widest=width)


def _handhole(plate: Plate, x: float, y: float) -> None:
    """A die-cut slot for the hand."""
    half, radius = 0.032, 0.0135
    # The lower lip is the cut board, seen from above.
    for grey, narrower in ((105, 0.0), (238, 0.0022)):
        r = radius - narrower
        plate.box(x - half, y - radius, 2 * half, radius + r, value=grey)
        plate.disc(x - half, y - radius + r, r, value=grey)
        plate.disc(x + half, y - radius + r, r, value=grey)


def _facts(plate: Plate, product: Product, x: float, bottom: float, size: float, widest: float) -> None:
    """Article, contents, number, size and mass, in four lines above the bottom."""
    lines = (
        (product.article, 800),
        (f"{product.contents}   ART. {product.code}", 600),
        (product.size_text, 500),
        (f"GROSS {product.weight_text}", 500),
    )
    longest = max(plate.text_width(line, size, weight) for line, weight in lines)
    size *= min(1.0, widest / longest)
    for number, (line, weight) in enumerate(lines):
        plate.text(line, x, bottom - 1.7 * size * (len(lines) - 1 - number), size, weight=weight)


def _symbol_count(width: float, size: float) -> int:
    return int(np.clip(width / (1.25 * size), 1, 4))


def _foot(first: Plate, product: Product) -> None:
    """The usual foot of a panel: facts on the left, bar code on the right unless a label goes there."""
    w, h, m, u = first.width_m, first.height_m, _margin(first), _unit(first)
    size = min(0.05 * u, 0.016, (0.38 * h - m) / 6.2)
    _facts(first, product, m, h - m, size, 0.45 * w)
    if product.label_side == 0:
        _barcode(first, product, w - m, h - m, 0.36 * w)


def _block(first: Plate, second: Plate, product: Product) -> None:
    """Large block letters on the upper left, a rule under them, symbols on the right."""
    w, h, m, u = first.width_m, first.height_m, _margin(first), _unit(first)
    size = min(0.19 * u, 0.06)
    count = _symbol_count(0.36 * w, size)
    _symbols(first, product, w - m, m, size, count)
    room = w - 3 * m - count * 1.25 * size
    capitals = 0.21 * u
    base = m + 0.24 * u
    used = first.text(product.brand, m, base, capitals, weight=900, widest=room)
    second.box(m, base + 0.045 * u, used, 0.03 * u)
    second.text(product.claim, m, base + 0.16 * u, 0.065 * u, weight=700, widest=room)
    if h > 0.75 * w:
        emblem(second, product.emblem, m, 0.36 * h, 0.45 * u)
    _foot(first, product)


def _band(first: Plate, second: Plate, product: Product) -> None:
    """A solid band around the carton with the brand cut out of it."""
    w, h, m, u = first.width_m, first.height_m, _margin(first), _unit(first)
    second.box(0.0, 0.30 * h, w, 0.30 * h)
    mark = min(0.22 * h, 0.26 * w)
    cut = Plate(mark, mark, second.scale)
    emblem(cut, product.emblem, 0.0, 0.0, mark)
    y, x = 0.45 * h - 0.5 * mark, m
    rows, columns = (round(part * second.scale) for part in (y, x))
    under = second.mask[rows : rows + cut.mask.shape[0], columns : columns + cut.mask.shape[1]]
    under[:] = np.minimum(under, 255 - cut.mask[: under.shape[0], : under.shape[1]])
    second.text(
        product.brand,
        2 * m + mark,
        0.45 * h + 0.09 * u,
        0.19 * u,
        weight=900,
        face="italic",
        widest=w - 3.5 * m - mark,
        value=0,
    )
    size = min(0.17 * h, 0.17 * w, 0.06)
    _symbols(
        first,
        product,
        w - m,
        max(0.3 * h - 1.44 * size - 0.5 * m, 0.3 * m),
        size,
        _symbol_count(0.5 * w, size),
    )
    first.text(product.claim, m, 0.3 * h - 0.05 * u, 0.06 * u, weight=700, widest=0.4 * w)
    _foot(first, product)


def _emblem(first: Plate, second: Plate, product: Product) -> None:
    """A large emblem with the brand beside it."""
    w, h, m, u = first.width_m, first.height_m, _margin(first), _unit(first)
    mark = min(0.5 * u, 0.2)
    emblem(second, product.emblem, m, m, mark)
    room = w - 3 * m - mark
    first.text(product.brand, 2 * m + mark, m + 0.52 * mark, 0.34 * mark, weight=900, widest=room)
    first.text(product.claim, 2 * m + mark, m + 0.76 * mark, 0.12 * mark, weight=500, widest=room)
    second.box(2 * m + mark, m + 0.88 * mark, room, 0.04 * mark)
    size = min(0.14 * u, 0.05)
    _foot(first, product)
    if h > 2.5 * m + mark + 6.0 * size:
        _symbols(first, product, m + 4 * 1.22 * size + 0.3 * size, 1.7 * m + mark, size, 4)


def _frame(first: Plate, second: Plate, product: Product) -> None:
    """The brand centred between two rules, in a frame."""
    w, h, m, u = first.width_m, first.height_m, _margin(first), _unit(first)
    second.frame(0.5 * m, 0.5 * m, w - m, h - m, 0.012 * u + 0.001)
    base = m + 0.28 * u
    used = first.text(product.brand, 0.5 * w, base, 0.2 * u, weight=800, align=0.5, widest=0.8 * w)
    second.box(0.5 * (w - used), base + 0.05 * u, used, 0.014 * u)
    second.box(0.5 * (w - used), base + 0.08 * u, used, 0.006 * u)
    first.text(product.claim, 0.5 * w, base + 0.2 * u, 0.065 * u, weight=500, align=0.5, widest=0.7 * w)
    inset, line = 1.4 * m, min(0.045 * u, 0.015)
    if product.label_side == 0:
        _barcode(first, product, w - inset, h - inset, 0.34 * w)
    _facts(first, product, inset, h - inset, line, 0.4 * w)
    # Between the rules and the facts, where there is room.
    bottom = h - inset - 7.5 * line
    size = min(0.15 * u, 0.05, (bottom - base - 0.13 * u) / 1.44)
    if size > 0.018:
        _symbols(first, product, inset + 2.66 * size, bottom - 1.44 * size, size, 2)
    elif product.label_side and h > 0.08:
        size = min(5.0 * line, 0.05)
        _symbols(first, product, 0.62 * w, h - inset - 1.44 * size, size, 1)


def _plain(first: Plate, second: Plate, product: Product) -> None:
    """A plain industrial carton: number, facts and symbols, a small brand."""
    w, m, u = first.width_m, _margin(first), _unit(first)
    mark = min(0.16 * u, 0.06)
    emblem(second, product.emblem, m, m, mark)
    first.text(product.brand, 1.5 * m + mark, m + 0.8 * mark, 0.6 * mark, weight=800, widest=0.5 * w)
    first.text(product.code, m, m + mark + 0.26 * u, 0.15 * u, weight=500, widest=0.6 * w)
    size = min(0.2 * u, 0.06)
    _symbols(first, product, w - m, m, size, _symbol_count(0.33 * w, size))
    _foot(first, product)
