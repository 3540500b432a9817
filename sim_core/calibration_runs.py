"""Simulations of one scene by the values of its fitted parameters: each is run once, in this process or in several."""

from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from types import TracebackType
from typing import Self

import numpy as np

from config.errors import EndedByMonitor
from config.scene import Scene
from config.scene_file import scene_from_json
from sim_core.calibration_parameters import Parameter
from sim_core.frames import Array
from sim_core.load_test import LoadTest
from sim_core.residual import Observed

Run = tuple[Array, Array]
"""Times since sample 0 [s], shape [m], and displacement [m], shape [m, k, p, c]."""


def simulated_displacement(scene: Scene, observed: Observed) -> Run:
    """Times since sample 0 [s], shape [m], and displacement [m], shape [m, k, p, c], of one run.

    A run that a monitor ends keeps what it has until then; one that does not stand has one frame, or none.
    """
    test = LoadTest(scene)
    times: list[float] = []
    places: list[Array] = []
    try:
        for frame in test.frames():
            times.append(frame.index / scene.sampling.poses_hz)
            places.append(observed.places(frame))
    except EndedByMonitor:
        pass
    finally:
        test.close()
    if not places:
        return np.zeros(0), np.zeros((0, *observed.shape))
    return np.array(times), np.array(places) - places[0]


class Runs:
    """Simulations by parameter values, remembered, in this process or in several."""

    def __init__(
        self, scene: Scene, observed: Observed, parameters: Sequence[Parameter], workers: int
    ) -> None:
        self.scene, self.parameters, self.observed = scene, parameters, observed
        self.count = 0
        self._known: dict[bytes, Run] = {}
        self._pool = ProcessPoolExecutor(workers, mp_context=get_context("spawn")) if workers > 1 else None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._pool is not None:
            self._pool.shutdown(cancel_futures=True)

    def of(self, points: Sequence[Array]) -> list[Run]:
        """Times and displacement for each set of fit values."""
        new = {point.tobytes(): point for point in points if point.tobytes() not in self._known}
        runs = self.scenes([self.scene_of(point) for point in new.values()])
        self._known.update(zip(new, runs, strict=True))
        return [self._known[point.tobytes()] for point in points]

    def scene_of(self, point: Array) -> Scene:
        """The scene with the values that the fit's stand for."""
        scene = self.scene
        for parameter, x in zip(self.parameters, point, strict=True):
            scene = parameter.applied(scene, parameter.value(float(x)))
        return scene

    def scenes(self, scenes: Sequence[Scene]) -> list[Run]:
        """Times and displacement of whole scenes."""
        self.count += len(scenes)
        if self._pool is None:
            return [simulated_displacement(scene, self.observed) for scene in scenes]
        waiting = [self._pool.submit(_run_json, scene.to_json(), self.observed) for scene in scenes]
        return [future.result() for future in waiting]


def _run_json(scene_json: str, observed: Observed) -> Run:
    return simulated_displacement(scene_from_json(scene_json), observed)
