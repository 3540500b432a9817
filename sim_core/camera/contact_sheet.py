"""Several tests on one picture: each before its start and where its load leans most."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from config.scene import Scene
from sim_core.camera.renderer import BenchRenderer
from sim_core.camera.shot import Shot
from sim_core.camera.taker import ShotTaker
from sim_core.run import run_test

Picture = NDArray[np.uint8]

_BAR_PX, _GAP_PX = 30, 8
_PAPER, _INK = (244, 244, 242), (30, 32, 36)


@dataclass(frozen=True, eq=False)
class SheetRow:
    """One test on the sheet.

    Attributes:
        words: its name and what came of it.
        pictures: RGB, all of one size.
    """

    words: str
    pictures: Sequence[Picture]


def sheet_row(scene: Scene) -> SheetRow:
    """Runs a test and draws it at its start, at its largest displacement, and at its end.

    Args:
        scene: a resolved scene that has a camera.

    Raises:
        RefusedInput: the load fails its integrity check, or the camera cannot see it.
    """
    taker = ShotTaker(scene)
    result = run_test(scene, observers=[taker])
    elastic = next(rule for rule in result.judge.rules() if rule.rule == "elastic")
    shots = taker.shots
    times = [(shot.stamp_ns - shots[0].stamp_ns) * 1.0e-9 for shot in shots]
    peak = min(range(len(times)), key=lambda k: abs(times[k] - (elastic.time_s or 0.0)))
    chosen: list[Shot] = [shots[0], shots[peak], shots[-1]]
    renderer = BenchRenderer(scene)
    try:
        pictures = [renderer.picture(shot) for shot in chosen]
    finally:
        renderer.close()
    worst = f", {elastic.worst_mm:.0f} mm" if elastic.worst_mm is not None else ""
    return SheetRow(f"{scene.name}: {result.judge.verdict()}{worst}", pictures)


def contact_sheet(rows: Sequence[SheetRow], *, columns: int = 2) -> Picture:
    """All rows on one RGB picture, so many tests side by side."""
    tiles = [_tile(row) for row in rows]
    blank = np.full_like(tiles[0], _PAPER[0])
    tiles += [blank] * (-len(tiles) % columns)
    lines = [np.hstack(tiles[start : start + columns]) for start in range(0, len(tiles), columns)]
    return np.vstack(lines)


def _tile(row: SheetRow) -> Picture:
    height, width = row.pictures[0].shape[:2]
    count = len(row.pictures)
    tile = np.empty((height + _BAR_PX + _GAP_PX, count * (width + _GAP_PX) + _GAP_PX, 3), np.uint8)
    tile[:] = _PAPER
    cv2.putText(tile, row.words, (_GAP_PX, _BAR_PX - 9), cv2.FONT_HERSHEY_SIMPLEX, 0.55, _INK, 1, cv2.LINE_AA)
    for number, picture in enumerate(row.pictures):
        left = _GAP_PX + number * (width + _GAP_PX)
        tile[_BAR_PX : _BAR_PX + height, left : left + width] = picture
    return tile
