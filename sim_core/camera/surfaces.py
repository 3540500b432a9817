"""How the bench's materials look: sawn wood, concrete, steel, board, paper and the folds of stretch film, by seed."""

import hashlib
import math

import cv2
import numpy as np
from numpy.typing import NDArray

from config.errors import RefusedInput

Picture = NDArray[np.uint8]
Field = NDArray[np.float32]

LONGEST_SIDE_PX = 4096
"""Larger pictures are made coarser: graphics drivers take no larger textures everywhere."""
SHORTEST_SIDE_PX = 4


def generator(*key: object) -> np.random.Generator:
    """A random generator that depends on nothing but the key's words and numbers."""
    digest = hashlib.blake2b(repr(key).encode(), digest_size=16).digest()
    return np.random.default_rng(int.from_bytes(digest, "little"))


def picture_shape(width_m: float, height_m: float, pixels_per_m: float) -> tuple[int, int]:
    """Rows and columns of a picture of a surface.

    Raises:
        RefusedInput: a length or the resolution isn't a positive, finite number.
    """
    for field, value in (("width_m", width_m), ("height_m", height_m), ("pixels_per_m", pixels_per_m)):
        if not (math.isfinite(value) and value > 0.0):
            raise RefusedInput(field, value, "must be above 0 and finite")
    scale = min(pixels_per_m, LONGEST_SIDE_PX / max(width_m, height_m))
    rows, columns = (max(SHORTEST_SIDE_PX, round(scale * edge)) for edge in (height_m, width_m))
    return rows, columns


def noise(
    rng: np.random.Generator, shape: tuple[int, int], cell_px: tuple[float, float], octaves: int = 1
) -> Field:
    """Smooth noise of zero mean and about unit spread.

    Args:
        rng: drawn from.
        shape: rows and columns.
        cell_px: size of the largest blotches, down and across [px].
        octaves: how many times finer noise of half the size and 0.6 times the strength is added.
    """
    total = np.zeros(shape, np.float32)
    power = 0.0
    for octave in range(octaves):
        down, across = (max(1.0, cell / 2**octave) for cell in cell_px)
        grid = (math.ceil(shape[0] / down) + 3, math.ceil(shape[1] / across) + 3)
        coarse = rng.standard_normal(grid, np.float32)
        size = (max(shape[1], round(grid[1] * across)), max(shape[0], round(grid[0] * down)))
        fine = cv2.resize(coarse, size, interpolation=cv2.INTER_CUBIC)[: shape[0], : shape[1]]
        total += 0.6**octave * fine
        power += 0.36**octave
    total *= 1.3 / math.sqrt(power)
    return total


def tinted(shade: Field, colour: tuple[float, float, float]) -> Picture:
    """An RGB picture of a surface of one colour [0 to 255] whose brightness is multiplied by a field."""
    return np.asarray(cv2.merge([cv2.convertScaleAbs(shade, alpha=part) for part in colour]), np.uint8)


def fibres(rng: np.random.Generator, shape: tuple[int, int], scale: float) -> Field:
    """Brightness of paper about 1, from its cloudiness and its fibres and specks.

    Args:
        rng: drawn from.
        shape: rows and columns.
        scale: resolution [px/m].
    """
    field = 1.0 + 0.011 * noise(rng, shape, (1.6, 1.6)) + 0.013 * noise(rng, shape, (0.005 * scale,) * 2, 2)
    field += 0.014 * noise(rng, shape, (0.05 * scale,) * 2, 3)
    specks = np.full(shape, 128, np.uint8)
    count = round(2200.0 * shape[0] * shape[1] / scale**2)
    starts = rng.uniform(0.0, 1.0, (count, 2)) * (shape[1], shape[0])
    length = rng.gamma(2.0, 0.0011, count) * scale
    turn = rng.uniform(0.0, math.pi, count)
    ends = starts + length[:, None] * np.column_stack((np.cos(turn), np.sin(turn)))
    shades = rng.choice([98, 108, 114, 142, 150], count)
    for start, end, shade in zip(
        np.round(16 * starts).astype(int), np.round(16 * ends).astype(int), shades, strict=True
    ):
        cv2.line(specks, start.tolist(), end.tolist(), (int(shade),), 1, cv2.LINE_AA, 4)
    return np.asarray(field * (specks * np.float32(1.0 / 128.0)), np.float32)


def wood(width_m: float, height_m: float, *, seed: int, pixels_per_m: float = 700.0) -> Picture:
    """Sawn pallet softwood with the grain along the width: RGB, shape [rows, columns, 3].

    A board is a cut through a log: a point's year ring is its distance from the pith over the rings' width. Knots push
    the rings aside.

    Raises:
        RefusedInput: a length or the resolution isn't a positive, finite number.
    """
    shape = picture_shape(width_m, height_m, pixels_per_m)
    rng = generator("wood", seed, shape)
    scale = shape[1] / width_m
    x = np.arange(shape[1], dtype=np.float32)[None, :] / np.float32(scale)
    y = np.arange(shape[0], dtype=np.float32)[:, None] / np.float32(scale)
    across = y + 0.0016 * noise(rng, shape, (0.06 * scale, 0.5 * scale), 3)
    knot_shade = np.ones(shape, np.float32)
    for _ in range(rng.poisson(1.4 + 14.0 * width_m * height_m)):
        _grow_knot(across, knot_shade, x, y, (width_m, height_m), rng)
    depth = rng.uniform(0.01, 0.05) + 0.007 * noise(rng, (1, shape[1]), (1.0, 0.7 * scale), 2)
    radius = np.hypot(across - height_m * np.float32(rng.uniform(-0.5, 1.5)), depth)
    rings = radius / np.float32(rng.uniform(0.0032, 0.0055))
    # Year rings darken slowly and end sharply; summer by summer they differ.
    late = (rings - np.floor(rings)) ** 2.2
    late *= 0.75 + 0.35 * np.sin(1.7 * np.floor(rings) + 0.3 * np.floor(rings) ** 1.5)
    pores = noise(rng, shape, (1.3, 0.05 * scale), 2)
    slant = rng.uniform(-0.25, 0.25)
    saw = np.sin(
        2.0 * np.pi * (x + slant * y) / rng.uniform(0.0055, 0.009) + noise(rng, shape, (0.1 * scale,) * 2)
    )
    saw *= np.clip(noise(rng, shape, (0.08 * scale, 0.15 * scale), 2), 0.0, 2.0)
    shade = knot_shade * (1.0 + 0.022 * pores + 0.020 * saw) * rng.uniform(0.92, 1.05)
    shade *= _checks(rng, shape, scale)
    grey = 0.42 + 0.17 * noise(rng, shape, (0.12 * scale, 0.5 * scale), 4) + rng.uniform(-0.15, 0.2)
    grey = np.clip(grey, 0.0, 0.8)
    dirt = 1.0 - 0.13 * np.clip(noise(rng, shape, (0.05 * scale, 0.12 * scale), 4) - 0.5, 0.0, 1.5)
    channels = []
    for fresh, old, taken in ((206.0, 152.0, 0.15), (171.0, 143.0, 0.25), (122.0, 128.0, 0.34)):
        colour = fresh + (old - fresh) * grey
        channels.append(cv2.convertScaleAbs(colour * (1.0 - taken * late) * shade * dirt))
    return np.asarray(cv2.merge(channels), np.uint8)


def _grow_knot(
    across: Field,
    shade: Field,
    x: Field,
    y: Field,
    extent: tuple[float, float],
    rng: np.random.Generator,
) -> None:
    """Bends the rings around a knot, and darkens it, both in place."""
    size = float(np.clip(rng.gamma(4.0, 0.0022), 0.003, 0.25 * extent[1] + 0.003))
    middle = rng.uniform(0.0, 1.0, 2) * extent
    along, aside = (x - np.float32(middle[0])) / size, (y - np.float32(middle[1])) / size
    bent = np.exp(-((along / 3.2) ** 2)) * np.exp(-((aside / 2.2) ** 2))
    across += np.float32(-0.9 * size) * bent * np.tanh(1.5 * aside)
    distance = np.sqrt((along / rng.uniform(1.0, 1.5)) ** 2 + aside**2)
    inside = np.clip(1.6 - 1.6 * distance, 0.0, 1.0)
    rim = np.exp(-(((distance - 0.95) / 0.16) ** 2))
    halo = np.exp(-((distance / 1.9) ** 2))
    rings = 0.06 * np.sin(14.0 * distance + 2.0 * rng.random())
    shade *= (
        (1.0 - np.clip(3.0 * inside, 0.0, 1.0) * (0.36 + rings)) * (1.0 - 0.3 * rim) * (1.0 - 0.14 * halo)
    )


def _checks(rng: np.random.Generator, shape: tuple[int, int], scale: float) -> Field:
    """Drying cracks along the grain and dents across it, as brightness."""
    marks = np.full(shape, 128, np.uint8)
    area = shape[0] * shape[1] / scale**2
    for _ in range(rng.poisson(14.0 * area + 0.8)):
        start = rng.uniform(0.0, 1.0, 2) * (shape[1], shape[0])
        steps = np.cumsum(rng.normal((0.012, 0.0), (0.004, 0.0004), (int(rng.integers(3, 18)), 2)), axis=0)
        line = np.round(16.0 * (start + steps * scale)).astype(np.int32)
        cv2.polylines(marks, [line], False, (int(rng.integers(48, 96)),), 1, cv2.LINE_AA, 4)
    scratches(marks, rng, scale, density=20.0, shades=(92, 104, 146), spread=1.2)
    return marks * np.float32(1.0 / 128.0)


def scratches(
    marks: Picture,
    rng: np.random.Generator,
    scale: float,
    *,
    density: float,
    shades: tuple[int, ...],
    spread: float,
    run_m: float = 0.03,
) -> None:
    """Draws straight scratches, so many a square metre, around the picture's horizontal."""
    rows, columns = marks.shape
    for _ in range(rng.poisson(density * rows * columns / scale**2)):
        start = rng.uniform(0.0, 1.0, 2) * (columns, rows)
        turn, run = rng.normal(0.0, spread), rng.gamma(2.0, 0.5 * run_m) * scale
        end = start + run * np.array([math.cos(turn), math.sin(turn)])
        ends = np.round(16.0 * np.array([start, end])).astype(int).tolist()
        cv2.line(marks, ends[0], ends[1], (int(rng.choice(shades)),), 1, cv2.LINE_AA, 4)


def concrete(width_m: float, height_m: float, *, seed: int, pixels_per_m: float = 700.0) -> Picture:
    """A hall's trowelled concrete floor, with hairline cracks and tyre marks: RGB, shape [rows, columns, 3].

    Raises:
        RefusedInput: a length or the resolution isn't a positive, finite number.
    """
    shape = picture_shape(width_m, height_m, pixels_per_m)
    rng = generator("concrete", seed, shape)
    scale = shape[1] / width_m
    shade = 1.0 + 0.035 * noise(rng, shape, (0.6 * scale,) * 2, 5) + 0.018 * noise(rng, shape, (1.5, 1.5))
    shade += 0.012 * noise(rng, shape, (0.02 * scale, 0.12 * scale), 2)
    grains = noise(rng, shape, (0.006 * scale,) * 2)
    shade -= 0.06 * np.clip(grains - 1.9, 0.0, 1.0)
    shade += 0.05 * np.clip(-grains - 2.2, 0.0, 1.0)
    marks = np.full(shape, 128, np.uint8)
    area = width_m * height_m
    for _ in range(rng.poisson(0.08 * area)):
        start = rng.uniform(0.0, 1.0, 2) * (shape[1], shape[0])
        bends = np.cumsum(rng.normal(0.0, 0.35, 60))
        walk = 0.012 * scale * np.column_stack((np.cos(bends), np.sin(bends)))
        line = np.round(16.0 * (start + np.cumsum(walk, axis=0))).astype(np.int32)
        cv2.polylines(marks, [line], False, (92,), 1, cv2.LINE_AA, 4)
    tyres = np.full(shape, 128, np.uint8)
    for _ in range(rng.poisson(0.1 * area)):
        centre = np.round(rng.uniform(-0.5, 1.5, 2) * (shape[1], shape[0])).astype(int).tolist()
        radius = round(rng.uniform(0.8, 3.0) * scale)
        begin = rng.uniform(0.0, 360.0)
        cv2.ellipse(
            tyres,
            centre,
            (radius, radius),
            0,
            begin,
            begin + 50,
            (112,),
            max(1, round(0.11 * scale)),
            cv2.LINE_AA,
        )
    blur = 2 * max(1, round(0.02 * scale)) + 1
    rubber = np.asarray(cv2.GaussianBlur(tyres, (blur, blur), 0), np.float32) - 128.0
    shade *= 1.0 + rubber / 128.0 * np.clip(0.85 + 0.16 * grains, 0.0, 1.3)
    return tinted(shade * (marks * np.float32(1.0 / 128.0)), (156.0, 153.0, 146.0))


def steel(width_m: float, height_m: float, *, seed: int, pixels_per_m: float = 700.0) -> Picture:
    """Brushed steel in use, the strokes along the width: RGB, shape [rows, columns, 3].

    Raises:
        RefusedInput: a length or the resolution isn't a positive, finite number.
    """
    shape = picture_shape(width_m, height_m, pixels_per_m)
    rng = generator("steel", seed, shape)
    scale = shape[1] / width_m
    shade = (
        1.0 + 0.028 * noise(rng, shape, (1.2, 0.12 * scale), 2) + 0.02 * noise(rng, shape, (3.0, 0.5 * scale))
    )
    shade += 0.025 * noise(rng, shape, (0.3 * scale,) * 2, 4)
    shade -= 0.07 * np.clip(noise(rng, shape, (0.06 * scale,) * 2, 4) - 1.3, 0.0, 1.0)
    marks = np.full(shape, 128, np.uint8)
    scratches(marks, rng, scale, density=45.0, shades=(104, 112, 146, 158), spread=0.5, run_m=0.06)
    return tinted(shade * (marks * np.float32(1.0 / 128.0)), (148.0, 151.0, 154.0))


def plywood(width_m: float, height_m: float, *, seed: int, pixels_per_m: float = 700.0) -> Picture:
    """Film-faced plywood with its wire-mesh grip, scratched down to the wood: RGB, shape [rows, columns, 3].

    Raises:
        RefusedInput: a length or the resolution isn't a positive, finite number.
    """
    shape = picture_shape(width_m, height_m, pixels_per_m)
    rng = generator("plywood", seed, shape)
    scale = shape[1] / width_m
    x = np.arange(shape[1], dtype=np.float32)[None, :] / np.float32(scale)
    y = np.arange(shape[0], dtype=np.float32)[:, None] / np.float32(scale)
    pitch = 2.0 * np.pi / 0.0065
    # A mesh finer than three pixels would make a moiré.
    mesh = 0.05 if 0.0065 * scale > 3.0 else 0.0
    shade = 1.0 + mesh * np.cos(pitch * (x + y)) * np.cos(pitch * (x - y))
    shade = shade + 0.05 * noise(rng, shape, (0.25 * scale,) * 2, 4) + 0.02 * noise(rng, shape, (1.5, 1.5))
    marks = np.full(shape, 64, np.uint8)
    scratches(marks, rng, scale, density=60.0, shades=(52, 76, 90, 120), spread=0.7, run_m=0.07)
    dust = np.clip(noise(rng, shape, (0.15 * scale,) * 2, 5), 0.0, 2.0)
    worn = np.clip(noise(rng, shape, (0.02 * scale, 0.06 * scale), 3) - 1.9, 0.0, 1.0)
    shade = shade * (marks * np.float32(1.0 / 64.0))
    film, under, grey = (86.0, 61.0, 47.0), (166.0, 130.0, 92.0), (150.0, 142.0, 130.0)
    channels = []
    for face, wood_below, dusty in zip(film, under, grey, strict=True):
        colour = face * shade + 0.11 * dust * (dusty - face)
        channels.append(cv2.convertScaleAbs(colour + worn * (wood_below - colour)))
    return np.asarray(cv2.merge(channels), np.uint8)


def kraft_paper(width_m: float, height_m: float, *, seed: int, pixels_per_m: float = 700.0) -> Picture:
    """Brown kraft paper, a little crumpled: RGB, shape [rows, columns, 3].

    Raises:
        RefusedInput: a length or the resolution isn't a positive, finite number.
    """
    shape = picture_shape(width_m, height_m, pixels_per_m)
    rng = generator("kraft_paper", seed, shape)
    scale = shape[1] / width_m
    shade = fibres(rng, shape, scale) * crumples(rng, shape, scale)
    shade += 0.012 * noise(rng, shape, (1.5, 0.06 * scale), 2)
    return tinted(shade, (192.0, 153.0, 108.0))


def crumples(rng: np.random.Generator, shape: tuple[int, int], scale: float) -> Field:
    """Brightness about 1 of paper that has been folded and smoothed again."""
    shade = np.ones(shape, np.float32)
    for cell, depth in ((0.16, 0.05), (0.06, 0.025)):
        bent = noise(rng, shape, (cell * scale, cell * scale), 2)
        # A ridge is bright on one side and dark on the other.
        for side, sign in ((0.0, 1.0), (0.16, -1.0)):
            shade += np.float32(sign * depth) * np.exp(-(((bent - side) / np.float32(0.07)) ** 2))
        shade += np.float32(0.25 * depth) * bent
    return shade


def board(width_m: float, height_m: float, *, seed: int, pixels_per_m: float = 700.0) -> Picture:
    """Corrugated board without print, the flutes upright: RGB, shape [rows, columns, 3].

    Raises:
        RefusedInput: a length or the resolution isn't a positive, finite number.
    """
    shape = picture_shape(width_m, height_m, pixels_per_m)
    rng = generator("board", seed, shape)
    scale = shape[1] / width_m
    shade = fibres(rng, shape, scale) + 0.02 * noise(rng, shape, (0.2 * scale,) * 2, 3)
    return tinted(shade * flutes(shape[1], scale, 0.0065), (186.0, 149.0, 108.0))


def flutes(columns: int, scale: float, pitch_m: float) -> Field:
    """Brightness about 1 across the flutes of corrugated board, shape [1, columns]; 1 where pixels can't show them."""
    if pitch_m * scale < 2.5:
        return np.ones((1, columns), np.float32)
    along = np.arange(columns, dtype=np.float32) / np.float32(scale * pitch_m)
    return np.asarray(1.0 + 0.016 * np.sin(2.0 * np.pi * along), np.float32)[None, :]


def fold_heights(width_m: float, height_m: float, *, seed: int, pixels_per_m: float = 700.0) -> Field:
    """Folds of stretch film as heights about 0 [m], shape [rows, columns]; the left edge continues the right one.

    Film that is pulled around a load lies in long, nearly upright folds, some of them aslant, with a sharp crest.

    Raises:
        RefusedInput: a length or the resolution isn't a positive, finite number.
    """
    shape = picture_shape(width_m, height_m, pixels_per_m)
    rng = generator("folds", seed, shape)
    scale = shape[1] / width_m
    heights = np.zeros(shape, np.float32)
    for cell, length, slant, strength in (
        (0.16, 1.5, 0.06, 9.0e-4),
        (0.06, 0.8, 0.12, 4.5e-4),
        (0.045, 0.7, -0.22, 3.5e-4),
        (0.016, 0.4, 0.05, 1.2e-4),
    ):
        field = _ring_noise(rng, shape, (length * scale, cell * scale))
        crest = np.exp(-3.0 * np.abs(field)) - np.float32(0.4)
        # Folds come and go around the load.
        crest *= np.clip(0.7 + 0.6 * _ring_noise(rng, shape, (0.6 * scale, 0.3 * scale)), 0.05, 2.0)
        heights += np.float32(strength) * _sheared(crest, slant)
    return heights


def _ring_noise(rng: np.random.Generator, shape: tuple[int, int], cell_px: tuple[float, float]) -> Field:
    """Smooth noise of about unit spread whose right border continues at the left one."""
    rows, columns = (max(2, round(count / cell)) for count, cell in zip(shape, cell_px, strict=True))
    coarse = rng.standard_normal((rows + 2, columns), np.float32)
    margin = 3
    ring = np.take(coarse, np.arange(-margin, columns + margin), axis=1, mode="wrap")
    # Pixel k of the ring samples the grid at the same phase on both borders.
    across = (np.arange(shape[1], dtype=np.float32) + 0.5) * columns / shape[1] - 0.5 + margin
    down = (np.arange(shape[0], dtype=np.float32) + 0.5) * rows / shape[0] + 0.5
    lines, places = np.broadcast_to(down[:, None], shape), np.broadcast_to(across[None, :], shape)
    smooth = cv2.remap(
        ring,
        np.ascontiguousarray(places),
        np.ascontiguousarray(lines),
        cv2.INTER_CUBIC,
        borderMode=cv2.BORDER_REFLECT,
    )
    return np.asarray(smooth * np.float32(1.25), np.float32)


def _sheared(field: Field, slant: float) -> Field:
    """Each row moved around the ring by its place times the slant."""
    rows, columns = field.shape
    across = (
        np.arange(columns, dtype=np.float32)[None, :] + slant * np.arange(rows, dtype=np.float32)[:, None]
    ) % columns
    down = np.ascontiguousarray(np.broadcast_to(np.arange(rows, dtype=np.float32)[:, None], field.shape))
    ring = np.concatenate((field, field[:, :1]), axis=1)
    moved = cv2.remap(
        ring, across.astype(np.float32), down, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    return np.asarray(moved, np.float32)
