"""The measurement put to the test: a simulated load is drawn, measured from pictures, and compared with its poses."""

import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from config.errors import RefusedInput
from config.scene import Scene
from sim_core.camera.layout import facing_packages, near_face, side_of
from sim_core.camera.moments import PictureMoments
from sim_core.camera.source import Picture
from sim_core.camera.taker import PictureTaker
from sim_core.frames import AccelerometerSample, Array, FilmFrame, PoseFrame, RuleState, SledSample
from sim_core.geometry import rotation_matrices
from sim_core.judge import Verdict
from sim_core.run import run_test
from sim_core.vision.measure import DisplacementMeasurer
from sim_core.vision.verdict import MeasuredTest

CHECKED_TO_M = 0.3
"""Displacements up to here count: farther, a load has long failed."""


@dataclass(frozen=True, eq=False)
class Trial:
    """A measured test beside its truth.

    Attributes:
        measured: what the pictures say.
        judged: the judge's rules, by the poses.
        verdict: the judge's, over rules (i) to (iii).
        displacement: measured, through the camera's pose as known at the end [m], shape [pictures, n, 5, 2].
        sigma: standard uncertainties [m], the same shape.
        truth: by the poses [m], the same shape.
        wall_s: time that each picture took to measure [s], shape [pictures].
    """

    measured: MeasuredTest
    judged: list[RuleState]
    verdict: Verdict
    displacement: Array
    sigma: Array
    truth: Array
    wall_s: Array

    @property
    def checked(self) -> NDArray[np.bool_]:
        """Which displacements count: tracked, not too far, not the first picture's; shape [pictures, n, 5, 2]."""
        near = np.abs(self.truth).max(axis=(2, 3), keepdims=True) < CHECKED_TO_M
        counts: NDArray[np.bool_] = np.isfinite(self.displacement) & near
        counts[0] = False
        return counts

    @property
    def rms_mm(self) -> float:
        """Root mean square error of one component [mm]."""
        return 1000.0 * float(np.sqrt(np.mean(self._errors**2)))

    @property
    def largest_mm(self) -> float:
        """Largest error of one component [mm]."""
        return 1000.0 * float(np.abs(self._errors).max())

    @property
    def coverage(self) -> float:
        """Share of errors within 1.96 standard uncertainties."""
        return float((np.abs(self._errors) < 1.96 * self.sigma[self.checked]).mean())

    @property
    def tracked_share(self) -> float:
        """Share of displacements that are measured at all."""
        return float(np.isfinite(self.displacement).mean())

    @property
    def agrees(self) -> bool:
        """Whether pictures and poses give the same verdict."""
        return self.measured.verdict == self.verdict

    @property
    def _errors(self) -> Array:
        return (self.displacement - self.truth)[self.checked]


def picture_trial(scene: Scene) -> Trial:
    """Runs a test, draws its pictures, measures them and compares.

    Args:
        scene: a resolved scene with a camera.

    Raises:
        RefusedInput: the scene has no camera, or its camera doesn't see what it should.
    """
    if scene.camera is None:
        raise RefusedInput("camera", None, "must be there for a trial of the measurement")
    measuring = _Measuring(scene)
    taker = PictureTaker(scene, [measuring.take])
    view = taker.source.view
    measuring.measurer = DisplacementMeasurer(scene, view.matrix, view.distortion, view.width, view.height)
    try:
        result = run_test(scene, observers=[measuring, taker])
    finally:
        taker.close()
    judged = [rule for rule in result.judge.rules() if rule.limit_mm is not None and rule.rule != "layers"]
    displacement, sigma = measuring.measurer.displacements()
    return Trial(
        measured=measuring.measurer.result(),
        judged=judged,
        verdict="fail" if any(rule.state == "fail" for rule in judged) else "pass",
        displacement=displacement,
        sigma=sigma,
        truth=true_displacements(scene, [measuring.frames[stamp] for stamp in measuring.stamps]),
        wall_s=np.array(measuring.wall_s),
    )


def true_displacements(scene: Scene, frames: list[PoseFrame]) -> Array:
    """What should be measured: displacement of faces' centres and corners, along right and up [m], shape [k, n, 5, 2].

    Args:
        scene: a resolved scene with a camera.
        frames: at the pictures' stamps; the first is the reference.
    """
    side, rows = side_of(scene), facing_packages(scene)
    corners = np.array([near_face(scene, row) for row in rows])
    points = np.concatenate((corners.mean(axis=1, keepdims=True), corners), axis=1)
    places = []
    for frame in frames:
        turned = points @ rotation_matrices(frame.orientations[rows]).transpose(0, 2, 1)
        places.append(turned + frame.positions[rows][:, None])
    moved = np.array(places) - places[0]
    return np.stack((moved @ side.right, moved[..., 2]), axis=-1)


class _Measuring:
    """Takes the pictures as they come, and keeps the poses for later."""

    __test__ = False

    def __init__(self, scene: Scene) -> None:
        self.measurer: DisplacementMeasurer | None = None
        self.frames: dict[int, PoseFrame] = {}
        self.stamps: list[int] = []
        self.wall_s: list[float] = []
        self._moments = PictureMoments(scene)

    def take(self, picture: Picture) -> None:
        """A picture of the camera."""
        assert self.measurer is not None
        pixels = picture.pixels
        began = time.perf_counter()
        self.measurer.take(picture.stamp_ns, pixels)
        self.wall_s.append(time.perf_counter() - began)
        self.stamps.append(picture.stamp_ns)

    def on_reading(self, reading: AccelerometerSample) -> None:
        """Not used."""

    def on_sample(self, sample: SledSample) -> None:
        """Not used."""

    def on_frame(self, frame: PoseFrame) -> None:
        """Keeps the poses that a picture is taken of."""
        if self._moments.number(frame.index) is not None:
            self.frames[frame.stamp_ns] = frame

    def on_film(self, frame: FilmFrame) -> None:
        """Not used."""

    def on_rules(self, stamp_ns: int, rules: list[RuleState]) -> None:
        """Not used."""
