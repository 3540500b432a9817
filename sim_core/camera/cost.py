"""What a picture costs: shots of one test, drawn at several sizes with and without shadows and film, in turn."""

import json
import os
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from config.camera import Camera
from config.errors import RefusedInput
from config.scene import Scene
from config.scene_file import find_scene, read_scene
from sim_core.camera.renderer import BenchRenderer
from sim_core.camera.shot import Shot
from sim_core.camera.taker import ShotTaker
from sim_core.run import run_test
from sim_core.work_precision import with_setting

SCENE = "eur_camera"
SIZES = ((1920, 1080), (960, 540), (480, 270))
BARS_S = {(1920, 1080): 0.25, (480, 270): 0.03}
"""What a picture with film and shadows may take in the median, by its size [s]."""
PICTURES, WARM_UP = 40, 2
MOVING_MPS = 0.1
BUSY = 1.2
"""Wall time so many times the processor time: other work got in between."""

Drawn = Literal["film and shadows", "film, no shadows", "no film, shadows"]
DRAWN: tuple[Drawn, ...] = ("film and shadows", "film, no shadows", "no film, shadows")


@dataclass(frozen=True)
class CostRow:
    """Pictures of one size, drawn one way.

    Attributes:
        width_px: of the picture [px].
        height_px: of the picture [px].
        drawn: with what.
        pictures: how many were timed.
        median_s: wall time of a picture [s].
        low_s: its 5th percentile [s].
        high_s: its 95th percentile [s].
        processor_s: processor time of a picture over all threads, median [s].
        share: median over the pictures of the wall time by that of the same picture with film and shadows.
    """

    width_px: int
    height_px: int
    drawn: Drawn
    pictures: int
    median_s: float
    low_s: float
    high_s: float
    processor_s: float
    share: float

    @property
    def bar_s(self) -> float | None:
        """What the median may be [s]; None where nothing is asked."""
        return BARS_S.get((self.width_px, self.height_px)) if self.drawn == DRAWN[0] else None

    @property
    def state(self) -> Literal["inside", "over", "unresolved"] | None:
        """Where the median is by its bar; None without one.

        Over it on a busy machine, or with the 5th percentile inside, it is ``unresolved``: that may be other work.
        """
        if self.bar_s is None:
            return None
        if self.median_s <= self.bar_s:
            return "inside"
        return "unresolved" if self.low_s <= self.bar_s or self.median_s > BUSY * self.processor_s else "over"


@dataclass(frozen=True)
class CameraCost:
    """What pictures cost on this machine.

    Attributes:
        scene: name of the scene whose shots were drawn.
        packages: how many it has.
        drawn_by: what drew.
        processors: of the machine.
        rows: one for each size and way of drawing.
    """

    scene: str
    packages: int
    drawn_by: str
    processors: int
    rows: tuple[CostRow, ...]


def measure_cost(
    scene: Scene | None = None,
    *,
    sizes: Sequence[tuple[int, int]] = SIZES,
    pictures: int = PICTURES,
    on_progress: Callable[[int, int, object], None] | None = None,
) -> CameraCost:
    """Runs a test once and times its pictures.

    Every picture is drawn at each size and each way before the next one is, so that other work on the machine hits
    all rows alike. The first pictures, which compile shaders and fill caches, do not count.

    Args:
        scene: with a camera and a film; absent: ``eur_camera`` at 0.5 g.
        sizes: widths and heights of the pictures [px].
        pictures: timed a row.
        on_progress: called with pictures done, how many there are, and the last one's number.

    Raises:
        RefusedInput: the scene has no camera or no film, its sled does not move, or nothing is to be timed.
    """
    scene = scene if scene is not None else read_scene(find_scene(SCENE))
    if scene.camera is None or scene.film is None:
        raise RefusedInput("scene", scene.name, "must have a camera and a film for its pictures' cost")
    if pictures < 1 or not sizes:
        raise RefusedInput("pictures", pictures, "at least 1, of one size or more")
    scene = with_setting(scene)[0]
    shots = _moving_shots(scene, WARM_UP + pictures)
    drawings = [_Drawings(scene, width, height) for width, height in sizes]
    try:
        spent = []
        for number, shot in enumerate(shots, start=1):
            spent.append([drawing.spent(shot) for drawing in drawings])
            if on_progress is not None:
                on_progress(number, len(shots), number)
        drawn_by = drawings[0].described
    finally:
        for drawing in drawings:
            drawing.close()
    # [picture, size, way of drawing, wall or processor]
    times = np.array(spent[WARM_UP:])
    rows = []
    for place, (width, height) in enumerate(sizes):
        for way, drawn in enumerate(DRAWN):
            wall, processor = times[:, place, way].T
            low, median, high = np.percentile(wall, (5.0, 50.0, 95.0)).tolist()
            rows.append(
                CostRow(
                    width_px=width, height_px=height, drawn=drawn, pictures=len(wall), median_s=median, low_s=low,
                    high_s=high, processor_s=float(np.median(processor)),
                    share=float(np.median(wall / times[:, place, 0, 0])),
                )
            )  # fmt: skip
    return CameraCost(scene.name, len(scene.packages), drawn_by, os.cpu_count() or 1, tuple(rows))


def write_cost(cost: CameraCost, path: Path) -> None:
    """Writes the cost as JSON."""
    scratch = path.with_name(path.name + ".part")
    scratch.write_text(json.dumps(asdict(cost), indent=1) + "\n", encoding="utf-8")
    scratch.replace(path)


class _Drawings:
    """Renderers of one size, with shadows and without; a picture without film is one of them with its film left out."""

    def __init__(self, scene: Scene, width_px: int, height_px: int) -> None:
        assert scene.camera is not None
        size = {"width_px": width_px, "height_px": height_px}
        dark = {"light": scene.camera.light.model_copy(update={"shadows": False})}
        cameras: list[Camera] = [scene.camera.model_copy(update={**size, **more}) for more in ({}, dark)]
        self._full, self._shadowless = (
            BenchRenderer(scene.model_copy(update={"camera": camera})) for camera in cameras
        )
        self.described = self._full.described

    def spent(self, shot: Shot) -> list[tuple[float, float]]:
        """Wall and processor time of one picture [s], for each of ``DRAWN``."""
        ways = ((self._full, shot), (self._shadowless, shot), (self._full, replace(shot, film=None)))
        spent = []
        for renderer, own in ways:
            began, began_processor = time.perf_counter(), time.process_time()
            renderer.picture(own)
            spent.append((time.perf_counter() - began, time.process_time() - began_processor))
        return spent

    def close(self) -> None:
        """Gives the graphics back."""
        self._full.close()
        self._shadowless.close()


def _moving_shots(scene: Scene, count: int) -> list[Shot]:
    """So many shots from the sled's travel, evenly spread; some of them twice where there are too few."""
    taker = ShotTaker(scene)
    run_test(scene, observers=[taker])
    moving = [shot for shot in taker.shots if np.linalg.norm(shot.velocity) > MOVING_MPS]
    if not moving:
        raise RefusedInput("sled", scene.name, f"must travel at {MOVING_MPS:g} m/s or more")
    return [moving[k] for k in np.linspace(0, len(moving) - 1, count).round().astype(int)]
