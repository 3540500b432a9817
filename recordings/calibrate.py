"""Calibrates a scene by a recording: the sled's motion and the displacement from the bag, the fit from ``sim_core``."""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from config.errors import BrokenRecording, RefusedInput
from config.scene import RecordedSled, Scene
from config.scene_file import validate_scene
from msgs_adapters.convert import sample_from_accel
from msgs_adapters.measured_displacement import displacement_from_payload
from msgs_adapters.pose_payloads import pose_frame_from_payload
from msgs_adapters.topics import PACKAGES_POSES, VISION_DISPLACEMENT
from recordings.bag_reader import BagReader
from recordings.bench_acceleration import clock_fit
from recordings.judge_bag import topic_in_bag, topics_in_bag
from recordings.recorded_sled import sled_of_bag, sled_topic
from sim_core.bench_signal import source_lines
from sim_core.calibration import Calibration, calibrate
from sim_core.calibration_parameters import parameter_of, usual_parameters
from sim_core.calibration_search import OnProgress
from sim_core.frames import Array
from sim_core.load_test import LoadTest
from sim_core.residual import (
    DisplacementResidual,
    MeasuredDisplacement,
    Observed,
    centres,
    near_sides,
)

LEAST_SIGMA_M = 1.0e-4
"""Poses carry no uncertainty: it is taken from their scatter, and is never less than this."""


@dataclass(frozen=True)
class BagCalibration:
    """A scene calibrated by a bag.

    Attributes:
        fit: values, intervals and what is left.
        scene: the scene as given, with the fitted values.
        sled: what was found in the accelerometer's readings, in words; empty for a twin's own samples.
        displacement_topic: what was fitted to.
    """

    fit: Calibration
    scene: Scene
    sled: list[str]
    displacement_topic: str

    def entry(self) -> dict[str, Any]:
        """All of it but the scene, for a report."""
        return {
            "parameters": [asdict(parameter) for parameter in self.fit.parameters],
            "displacement": self.displacement_topic,
            "rms_mm": self.fit.rms_mm,
            "sigma_mm": self.fit.sigma_mm,
            "clock_offset_ms": self.fit.clock_offset_ms,
            "evaluations": self.fit.evaluations,
            "points": self.fit.points,
            "wall_s": self.fit.wall_s,
            "notes": self.fit.notes,
            "sled": self.sled,
        }


def calibrate_bag(
    bag: Path,
    scene: Scene,
    *,
    fit: Sequence[str] = (),
    sled: str = "",
    displacement: str = "",
    workers: int = 2,
    on_progress: OnProgress | None = None,
) -> BagCalibration:
    """Fits parameters of a scene to the displacement that a bag recorded, on the sled as the bag recorded it.

    Args:
        bag: the recording; it need not hold a scene.
        scene: a resolved scene of the load that was tested; its own sled is not used, but for the direction.
        fit: what to fit, see :func:`~sim_core.calibration_parameters.parameter_of`; nothing: what is usual.
        sled: topic of the sled's acceleration or accelerometer; none: as for a recorded sled.
        displacement: topic of the displacement; none: ``packages/poses``, else ``vision/displacement``.
        workers: processes that simulate.
        on_progress: see :func:`~sim_core.calibration.calibrate`.

    Raises:
        RefusedInput: scene and bag don't fit together, or nothing of it can be fitted.
        BrokenRecording: the bag is damaged, or lacks what is needed.
    """
    parameters = [parameter_of(text, scene) for text in fit] or usual_parameters(scene)
    bench = bench_of_bag(bag, scene, sled=sled, displacement=displacement)
    outcome = calibrate(bench.scene, bench.measured, parameters, workers=workers, on_progress=on_progress)
    fitted = scene
    for parameter, one in zip(parameters, outcome.parameters, strict=True):
        fitted = parameter.applied(fitted, one.value)
    return BagCalibration(outcome, fitted, bench.sled, bench.displacement_topic)


def compare_bag(bag: Path, scene: Scene, *, sled: str = "", displacement: str = "") -> dict[str, Any]:
    """Simulates a scene on the sled that a bag recorded, and says how far its load is from the measured one.

    Args:
        bag: the recording; it need not hold a scene.
        scene: a resolved scene of the load that was tested.
        sled: as for :func:`calibrate_bag`.
        displacement: as for :func:`calibrate_bag`.

    Returns:
        see :meth:`~sim_core.residual.DisplacementResidual.summary`; with ``displacement`` and ``sled`` as for a
        calibration.

    Raises:
        RefusedInput: scene and bag don't fit together.
        BrokenRecording: the bag is damaged, or lacks what is needed.
        EndedByMonitor: the simulation was ended.
    """
    bench = bench_of_bag(bag, scene, sled=sled, displacement=displacement)
    residual = DisplacementResidual(bench.scene, bench.measured.observed)
    test = LoadTest(bench.scene)
    try:
        for frame in test.frames():
            residual.add_simulated(frame.index / scene.sampling.poses_hz, frame)
    finally:
        test.close()
    measured = bench.measured
    for time_s, moved, sigma in zip(measured.times, measured.displacement, measured.sigma, strict=True):
        residual.add_measured(float(time_s), moved, sigma)
    residual.finish()
    return {**residual.summary(), "displacement": bench.displacement_topic, "sled": bench.sled}


@dataclass(frozen=True)
class BenchTest:
    """What a bag recorded of a bench's test.

    Attributes:
        scene: the load on the sled as it was recorded.
        measured: displacement.
        displacement_topic: where that was.
        sled: what was found in the accelerometer's readings, in words.
    """

    scene: Scene
    measured: MeasuredDisplacement
    displacement_topic: str
    sled: list[str]


def bench_of_bag(bag: Path, scene: Scene, *, sled: str = "", displacement: str = "") -> BenchTest:
    """Puts a scene's load on the sled that a bag recorded, beside the displacement that it recorded.

    Args:
        bag: the recording.
        scene: a resolved scene of the load.
        sled: as for :func:`calibrate_bag`.
        displacement: as for :func:`calibrate_bag`.

    Raises:
        RefusedInput: scene and bag don't fit together.
        BrokenRecording: the bag is damaged, or lacks what is needed.
    """
    topic = sled or (scene.sled.topic if isinstance(scene.sled, RecordedSled) else "")
    with BagReader(bag) as reader:
        asked = RecordedSled(profile="recorded", topic=topic, direction=scene.sled.direction)
        found = sled_of_bag(reader, asked, scene.sampling.samples_hz)
        recorded = {"profile": "recorded", "bag": bag.name, **found}
        moving = validate_scene({**scene.model_dump(), "sled": recorded})
        assert isinstance(moving.sled, RecordedSled)
        source = moving.sled.source
        start_ns = source.start_ns if source is not None else _first_stamp(reader, topic)
        name = _displacement_topic(reader, displacement)
        measured = measured_of_bag(reader, name, moving, start_ns=start_ns)
    return BenchTest(moving, measured, name, source_lines(source) if source is not None else [])


def write_calibrated(path: Path, calibrated: BagCalibration) -> None:
    """Writes the scene with the fitted values as a scene file, whole or not at all."""
    scratch = path.with_name(path.name + ".part")
    raw = calibrated.scene.model_dump(mode="json", exclude_none=True)
    # Without one the scene would be given its usual pallet again.
    raw["pallet"] = calibrated.scene.model_dump(mode="json")["pallet"]
    scratch.write_text(json.dumps(raw, indent=1) + "\n", encoding="utf-8")
    scratch.replace(path)


def calibration_lines(calibrated: BagCalibration) -> list[str]:
    """The result in words, a line each."""
    fit = calibrated.fit
    lines = [
        f"{one.key} = {one.value:.4g}  (95 %: {one.low:.4g} to {one.high:.4g}"
        + ("" if one.start is None else f"; the scene had {one.start:.4g}")
        + ("" if one.is_resolved else "; NOT RESOLVED")
        + ")"
        for one in fit.parameters
    ]
    lines.append(
        f"{fit.rms_mm:.2f} mm rms is left of {fit.points} values of {calibrated.displacement_topic}"
        f" ({fit.sigma_mm:.2f} mm is their own uncertainty); clocks {fit.clock_offset_ms:+.1f} ms apart;"
        f" {fit.evaluations} simulations in {fit.wall_s:.0f} s"
    )
    return [*lines, *fit.notes]


def measured_of_bag(
    reader: BagReader, topic_name: str, scene: Scene, *, start_ns: int
) -> MeasuredDisplacement:
    """The displacement on a topic of a bag, from the load at rest, on the sled's time.

    Args:
        reader: the open bag.
        topic_name: absolute, of poses or of measured displacement.
        scene: the load that moved, on the sled that the bag recorded.
        start_ns: of sample 0 of that sled, on the recording's clock [ns].

    Raises:
        BrokenRecording: nothing on it, or other packages than the scene's.
    """
    read = _poses if reader.topics[topic_name].topic.type_name == PACKAGES_POSES.type_name else _clouds
    stamps, logs, observed, places, sigma = read(reader, topic_name, scene)
    on_sensor = np.array(stamps, np.int64)
    fit = clock_fit(on_sensor, np.array(logs, np.int64))
    on_bag = fit.moved(on_sensor) if fit is not None else on_sensor
    times = (on_bag - start_ns) / 1.0e9
    assert isinstance(scene.sled, RecordedSled)
    moving = np.flatnonzero(np.any(scene.sled.samples_mps2, axis=1))
    moves_s = (moving[0] - 1) / scene.sampling.samples_hz if len(moving) else 0.0
    rests = times <= moves_s
    rests[0] = True
    reference = np.full(places.shape[1:], np.nan)
    seen = np.isfinite(places[rests])
    counts = seen.sum(axis=0)
    np.divide(np.where(seen, places[rests], 0.0).sum(axis=0), counts, out=reference, where=counts > 0)
    displacement = places - reference
    if sigma is None:
        sigma = np.full(displacement.shape, max(LEAST_SIGMA_M, _scatter(displacement)))
    # The noise of the load at rest is in every displacement from it.
    sigma = sigma * np.sqrt(1.0 + 1.0 / max(1, int(rests.sum())))
    after = times >= 0.0
    return MeasuredDisplacement(observed, times[after], displacement[after], sigma[after])


def _scatter(displacement: Array) -> float:
    """Standard deviation of the noise of evenly timed places [m]: motion has next to no third differences.

    Those of white noise σ have a standard deviation of σ·√(1 + 9 + 9 + 1).
    """
    if len(displacement) < 10:
        return LEAST_SIGMA_M
    return float(1.4826 * np.median(np.abs(np.diff(displacement, n=3, axis=0))) / np.sqrt(20.0))


_Read = tuple[list[int], list[int], Observed, Array, Array | None]


def _poses(reader: BagReader, topic_name: str, scene: Scene) -> _Read:
    observed = centres(scene)
    stamps, logs, places = [], [], []
    for index, message in enumerate(reader.messages([topic_name])):
        frame = pose_frame_from_payload(message.payload, index)
        if len(frame.positions) != len(scene.packages) + 1:
            limit = f"must be {len(scene.packages) + 1}, the pallet and the scene's packages"
            raise BrokenRecording("packages/poses", f"{len(frame.positions)} poses", limit)
        stamps.append(frame.stamp_ns)
        logs.append(message.log_time_ns)
        places.append(observed.places(frame))
    return stamps, logs, observed, _stacked(topic_name, places), None


def _clouds(reader: BagReader, topic_name: str, scene: Scene) -> _Read:
    stamps, logs, displacement, sigma = [], [], [], []
    rows = None
    for message in reader.messages([topic_name]):
        cloud = displacement_from_payload(message.payload)
        if rows is None:
            rows = cloud.rows
            if not len(rows) or rows.max() > len(scene.packages) or rows.min() < 1:
                raise BrokenRecording(topic_name, rows.tolist(), "must be rows of the scene's packages")
        if not np.array_equal(rows, cloud.rows):
            raise BrokenRecording(
                topic_name, cloud.rows.tolist(), "must be the same packages in every message"
            )
        stamps.append(cloud.stamp_ns)
        logs.append(message.log_time_ns)
        displacement.append(cloud.displacement)
        sigma.append(cloud.sigma)
    moved = _stacked(topic_name, displacement)
    assert rows is not None
    # What is not seen weighs nothing; no picture is better than the least.
    known = np.nan_to_num(np.array(sigma), nan=1.0)
    return stamps, logs, near_sides(scene, rows), moved, np.maximum(known, LEAST_SIGMA_M)


def _stacked(topic_name: str, rows: list[Array]) -> Array:
    if not rows:
        raise BrokenRecording("topic", topic_name, "holds no message")
    return np.array(rows)


def _displacement_topic(reader: BagReader, wanted: str) -> str:
    kinds = (PACKAGES_POSES.type_name, VISION_DISPLACEMENT.type_name)
    if wanted:
        name = wanted if wanted in reader.topics else topic_in_bag(reader, wanted.lstrip("/"))
        if reader.topics[name].topic.type_name not in kinds:
            raise RefusedInput("displacement", name, f"must be {kinds[0]} or {kinds[1]}")
        return name
    for topic in (PACKAGES_POSES, VISION_DISPLACEMENT):
        if topics_in_bag(reader, topic.name):
            return topic_in_bag(reader, topic.name)
    limit = f"must hold {PACKAGES_POSES.name} or {VISION_DISPLACEMENT.name}"
    raise BrokenRecording("bag", str(reader.path), limit)


def _first_stamp(reader: BagReader, topic: str) -> int:
    for message in reader.messages([sled_topic(reader, topic)]):
        return sample_from_accel(message.decode(), None).stamp_ns
    raise BrokenRecording("sled/acceleration", 0, "at least two samples are needed")
