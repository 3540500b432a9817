"""A recording measured by its pictures, beside the truth where it holds poses."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from config.scene import Scene
from msgs_adapters.pose_payloads import pose_frame_from_payload
from msgs_adapters.topics import PACKAGES_POSES
from recordings.bag_pictures import calibration_of_bag, pictures_of_bag
from recordings.bag_reader import BagReader
from recordings.judge_bag import scene_of_bag, topics_in_bag
from recordings.live_measurement import LiveMeasurement, measured_entry
from sim_core.camera.source import Picture
from sim_core.frames import PoseFrame
from sim_core.judge import EumosJudge
from sim_core.report import Report, judgement
from sim_core.vision.annotate import annotated
from sim_core.vision.measure import DisplacementMeasurer
from sim_core.vision.trial import true_displacements
from sim_core.vision.verdict import COVERAGE


@dataclass(frozen=True)
class Comparison:
    """Measured against true displacement, over all points of all pictures that were tracked.

    Attributes:
        points: how many, each with two components.
        rms_error_mm: root of the mean square of the error of a component [mm].
        largest_error_mm: largest error of a component [mm].
        coverage: share of the errors inside the expanded uncertainty, 95 % meant.
        verdict: that of the judge, from the poses.
        rules: the judge's entries.
    """

    points: int
    rms_error_mm: float
    largest_error_mm: float
    coverage: float
    verdict: str
    rules: list[Report]


@dataclass(frozen=True)
class MeasuredBag:
    """What a recording's pictures say.

    Attributes:
        scene: the recording's.
        entry: see :func:`~recordings.live_measurement.measured_entry`.
        truth: beside what its poses say; None where it holds none.
    """

    scene: Scene
    entry: Report
    truth: Comparison | None


def measure_bag(
    path: Path, *, video: Path | None = None, on_picture: Callable[[int, int, object], None] | None = None
) -> MeasuredBag:
    """Measures displacement from a recording's pictures and calibration alone.

    Args:
        path: the recording.
        video: where to write an annotated MP4, or None.
        on_picture: called with pictures measured, how many there are, and the last one's number.

    Raises:
        BrokenRecording: it is damaged, or lacks scene, pictures or calibration.
        RefusedInput: the pictures show too few targets, or no package faces the camera.
    """
    with BagReader(path) as reader:
        scene = scene_of_bag(reader)
        live = LiveMeasurement(scene, calibration_of_bag(reader))
        count = sum(
            recorded.message_count
            for name, recorded in reader.topics.items()
            if name.endswith(("/camera/image_raw/compressed", "/camera/image_raw"))
        )

        def measured() -> Iterator[Picture]:
            for picture in pictures_of_bag(reader):
                measurement, _ = live.take(picture.stamp_ns, picture.pixels)
                if on_picture is not None:
                    on_picture(picture.index + 1, count, picture.index)
                if video is not None:
                    pixels = annotated(picture.pixels, live.measurer, measurement)
                    yield Picture(picture.index, picture.stamp_ns, pixels=pixels)

        if video is not None:
            from sim_core.camera.moments import PictureMoments
            from sim_core.camera.video import write_video

            write_video(measured(), video, rate_hz=PictureMoments(scene).rate_hz)
        else:
            for _ in measured():
                pass
        entry = measured_entry(live.measurer.result())
        return MeasuredBag(scene, entry, _compared(reader, scene, live.measurer))


def _compared(reader: BagReader, scene: Scene, measurer: DisplacementMeasurer) -> Comparison | None:
    names = topics_in_bag(reader, PACKAGES_POSES.name)
    if not names:
        return None
    judge = EumosJudge(scene)
    stamps = [measured.stamp_ns for measured in measurer.measurements]
    wanted, frames = set(stamps), dict[int, PoseFrame]()
    for message in reader.messages(names):
        frame = pose_frame_from_payload(message.payload, judge.frame_count)
        judge.add(frame)
        if frame.stamp_ns in wanted:
            frames[frame.stamp_ns] = frame
    if stamps[0] not in frames:
        return None
    posed = [index for index, stamp in enumerate(stamps) if stamp in frames]
    displacement, sigma = (values[posed] for values in measurer.displacements())
    error = displacement - true_displacements(scene, [frames[stamps[index]] for index in posed])
    seen = np.isfinite(error)
    seen[0] = False
    if not seen.any():
        return None
    judged = judgement(scene, judge)
    return Comparison(
        points=int(seen.sum()) // 2,
        rms_error_mm=float(1000.0 * np.sqrt(np.mean(error[seen] ** 2))),
        largest_error_mm=float(1000.0 * np.abs(error[seen]).max()),
        coverage=float(np.mean(np.abs(error[seen]) <= COVERAGE * sigma[seen])),
        verdict=judged["verdict"],
        rules=judged["rules"],
    )
