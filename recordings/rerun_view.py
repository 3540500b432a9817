"""A test in rerun: what a viewer draws of each of the twin's messages, the same live and from a bag.

Everything stands on the timeline ``sim_time``, the simulated time since the first message.
"""

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
from rclpy.serialization import deserialize_message

from config.errors import BrokenRecording
from config.scene import RecordedSled, Scene, direction_vector
from msgs_adapters.camera_payloads import calibration_from_payload, jpeg_from_payload, picture_from_payload
from msgs_adapters.convert import accelerometer_sample, motion_from_odometry, progress_of, rule_states
from msgs_adapters.convert import sample_from_accel as acceleration_of
from msgs_adapters.film_payloads import film_frame_from_payload
from msgs_adapters.pose_payloads import pose_frame_from_payload
from msgs_adapters.stamps import to_ns
from msgs_adapters.topics import (
    CAMERA_COMPRESSED,
    CAMERA_IMAGE,
    CAMERA_INFO,
    EUMOS_REPORT,
    EUMOS_STATUS,
    PACKAGES_POSES,
    PHYSICS_PROGRESS,
    SLED_ACCELERATION,
    SLED_ACCELEROMETER,
    SLED_ODOMETRY,
    WRAP_STRAIN,
    Topic,
    message_class,
)
from recordings.bag_reader import BagReader
from recordings.judge_bag import scene_of_bag, topic_in_bag, topics_in_bag
from recordings.rerun_blueprint import (
    ACCELERATION,
    CAMERA,
    DISPLACEMENT,
    LOG,
    RULES,
    SLED,
    TIMELINE,
    blueprint,
)
from recordings.rerun_load import LoadDrawing
from sim_core.camera.jpeg import jpeg_of
from sim_core.camera.layout import side_of
from sim_core.frames import GRAVITY, Array, PoseFrame, RuleState
from sim_core.judge import EumosJudge

BAG_FRAMES_HZ = 60.0
BAND_COLOURS = (
    (169, 156, 240),
    (86, 180, 233),
    (94, 208, 189),
    (212, 207, 90),
    (240, 131, 107),
    (224, 127, 176),
)
"""From the lowest height band to the highest: those of the report's dark page."""
LIMITS = {
    "permanent": ("limit (i)", (214, 70, 70)),
    "permanent_on_pallet": ("limit (ii)", (230, 150, 60)),
    "elastic": ("limit (iii)", (150, 60, 60)),
}
_STATE_COLOURS = {"pass": 0x2E9E6BFF, "fail": 0xD64646FF, "unresolved": 0xD4B13FFF, "off": 0x6B737BFF}
_SLACK_NS = 1000


class RerunView:
    """Draws one test into a rerun recording; a message comes as the bytes that it is.

    Displacement by height band comes from a judge of this view's own, which takes every frame that comes. Where the
    view joins late, displacement counts from the first frame that it gets.

    Args:
        scene: the resolved scene.
        recording: takes what is drawn.
        frames_hz: poses and film a simulated second that are drawn in 3-D, at most; all are judged.
        pictures_hz: pictures a simulated second, at most.
    """

    def __init__(
        self,
        scene: Scene,
        recording: rr.RecordingStream,
        *,
        frames_hz: float = BAG_FRAMES_HZ,
        pictures_hz: float = 30.0,
    ) -> None:
        self._scene, self._recording = scene, recording
        self._judge = EumosJudge(scene)
        self._first_ns: int | None = None
        self._now_ns = 0
        self._frame_ns: int | None = None
        self._waiting: PoseFrame | None = None
        self._frames, self._motions = _Thinning(frames_hz), _Thinning(frames_hz)
        self._films, self._pictures = _Thinning(frames_hz), _Thinning(pictures_hz)
        self._sampled: dict[str, list[tuple[float, float]]] = {"commanded": [], "accelerometer": []}
        self._series_rows = 0
        self._states: dict[str, str] = {}
        self._torn = 0
        self._has_camera = False
        self._direction = np.array([*_travel_direction(scene), 0.0])
        self._takers: dict[Topic, Callable[[bytes], None]] = {
            SLED_ACCELERATION: self._take_acceleration,
            SLED_ACCELEROMETER: self._take_reading,
            SLED_ODOMETRY: self._take_odometry,
            PACKAGES_POSES: self._take_poses,
            WRAP_STRAIN: self._take_film,
            CAMERA_INFO: self._take_calibration,
            CAMERA_COMPRESSED: self._take_jpeg,
            CAMERA_IMAGE: self._take_image,
            EUMOS_STATUS: self._take_status,
            EUMOS_REPORT: self._take_report,
            PHYSICS_PROGRESS: self._take_progress,
        }
        # Wall time says nothing here, and would be a second timeline to scrub on.
        recording.set_log_time_enabled(False)
        recording.set_log_tick_enabled(False)
        recording.send_blueprint(blueprint(scene))
        self._load = LoadDrawing(scene, recording)
        for name, colour in (("commanded", (86, 180, 233)), ("accelerometer", (240, 131, 107))):
            style = rr.SeriesLines(colors=colour, names=name, widths=1.5)
            recording.log(f"{ACCELERATION}/{name}", style, static=True)

    @property
    def topics(self) -> tuple[Topic, ...]:
        """What the view looks at, under relative names."""
        return tuple(self._takers)

    def take(self, topic: Topic, payload: bytes) -> None:
        """Draws a message.

        Args:
            topic: one of ``topics``.
            payload: its CDR bytes.

        Raises:
            BrokenRecording: the bytes are no such message, or do not fit the scene.
            RefusedInput: a value in it cannot be.
        """
        self._takers[topic](payload)

    def say(self, text: str, *, level: str = "INFO") -> None:
        """Adds a line to the log, at the newest frame's time: the sled's may be well ahead."""
        self._say_at(self._now_ns, text, level)

    def flush(self) -> None:
        """Draws the plots up to now, which are sent many points at a time."""
        for name, points in self._sampled.items():
            if points:
                times, values = np.array(points).T
                self._plot(f"{ACCELERATION}/{name}", times, values)
                points.clear()
        if self._judge.frame_count > self._series_rows:
            self._plot_displacement()

    def finish(self) -> None:
        """Draws what was thinned out at the end, and the plots."""
        if self._waiting is not None:
            self._draw_load(self._waiting)
        self.flush()

    def _say_at(self, stamp_ns: int, text: str, level: str) -> None:
        self._at(stamp_ns)
        self._recording.log(LOG, rr.TextLog(text, level=level))

    def _at(self, stamp_ns: int) -> None:
        """Sets the time of what is drawn next [ns]."""
        self._recording.set_time(TIMELINE, duration=np.timedelta64(self._since_first(stamp_ns), "ns"))

    def _since_first(self, stamp_ns: int) -> int:
        """Time since the first message [ns]; that one begins the log."""
        if self._first_ns is None:
            self._first_ns = self._now_ns = stamp_ns
            self.say(f"{self._scene.name}: {self._scene.description}".rstrip(": "))
        return stamp_ns - self._first_ns

    def _seconds(self, stamp_ns: int) -> float:
        return self._since_first(stamp_ns) * 1.0e-9

    def _take_acceleration(self, payload: bytes) -> None:
        sample = acceleration_of(_decoded(SLED_ACCELERATION, payload), None)
        along_g = float(sample.acceleration @ self._direction) / GRAVITY
        self._sampled["commanded"].append((self._seconds(sample.stamp_ns), along_g))

    def _take_reading(self, payload: bytes) -> None:
        reading = accelerometer_sample(_decoded(SLED_ACCELEROMETER, payload))
        along_g = float(reading.specific_force @ self._direction) / GRAVITY
        self._sampled["accelerometer"].append((self._seconds(reading.stamp_ns), along_g))

    def _take_odometry(self, payload: bytes) -> None:
        motion = motion_from_odometry(_decoded(SLED_ODOMETRY, payload))
        if self._motions.passes(motion.stamp_ns):
            self._at(motion.stamp_ns)
            self._recording.log(SLED, rr.Transform3D(translation=motion.position))

    def _take_poses(self, payload: bytes) -> None:
        frame = pose_frame_from_payload(payload, self._judge.frame_count)
        try:
            self._judge.add(frame)
        except ValueError as error:
            raise BrokenRecording("packages/poses", str(error), "must fit the scene") from None
        if self._frame_ns is None:
            self._frame_ns = frame.stamp_ns
            self._begin_displacement()
        self._now_ns, self._waiting = frame.stamp_ns, frame
        if self._frames.passes(frame.stamp_ns):
            self._draw_load(frame)

    def _draw_load(self, frame: PoseFrame) -> None:
        self._waiting = None
        self._at(frame.stamp_ns)
        self._load.draw(frame, self._scene.limits.permanent_fraction * self._judge.height_m)

    def _begin_displacement(self) -> None:
        """Names the bands and draws the limits, which the settled load fixes."""
        series = self._judge.series()
        edges = series.band_edges_m
        for band in series.bands:
            words = f"{edges[band]:.2f} to {edges[band + 1]:.2f} m"
            style = rr.SeriesLines(colors=BAND_COLOURS[band], names=words, widths=2.0)
            self._recording.log(f"{DISPLACEMENT}/band_{band}", style, static=True)
        self._limits_mm = {
            rule.rule: rule.limit_mm
            for rule in self._judge.rules()
            if rule.rule in LIMITS and rule.limit_mm is not None
        }
        for rule in self._limits_mm:
            words, colour = LIMITS[rule]
            style = rr.SeriesLines(colors=colour, names=words, widths=1.0)
            self._recording.log(f"{DISPLACEMENT}/limit_{rule}", style, static=True)

    def _plot_displacement(self) -> None:
        # Nothing is thinned, so that rows keep their numbers from one call to the next.
        assert self._frame_ns is not None
        series = self._judge.series(rate_hz=float("inf"))
        first, self._series_rows = self._series_rows, len(series.times_s)
        times = np.array(series.times_s[first:]) + self._seconds(self._frame_ns)
        for band, row in zip(series.bands, series.displacement_mm, strict=True):
            self._plot(f"{DISPLACEMENT}/band_{band}", times, np.array(row[first:]))
        ends = times[[0, -1]] if first == 0 else times[-1:]
        for rule, limit_mm in self._limits_mm.items():
            self._plot(f"{DISPLACEMENT}/limit_{rule}", ends, np.full(len(ends), limit_mm))

    def _plot(self, path: str, times: Array, values: Array) -> None:
        self._recording.send_columns(
            path,
            indexes=[rr.TimeColumn(TIMELINE, duration=np.round(times * 1.0e9).astype("timedelta64[ns]"))],
            columns=rr.Scalars.columns(scalars=values),
        )

    def _take_film(self, payload: bytes) -> None:
        frame = film_frame_from_payload(payload, self._judge.frame_count)
        self._judge.add_film(frame)
        is_torn = frame.torn_s >= 0.0
        if (count := int(is_torn.sum())) > self._torn:
            self._torn = count
            since_s = float(frame.torn_s[is_torn].min())
            words = f"film: {count} of {len(is_torn)} elements torn, the first at {since_s:.3f} s"
            self._say_at(frame.stamp_ns, words, "WARN")
        if self._films.passes(frame.stamp_ns):
            self._at(frame.stamp_ns)
            self._load.draw_film(frame)

    def _take_calibration(self, payload: bytes) -> None:
        if self._has_camera:
            return
        self._has_camera = True
        seen = calibration_from_payload(payload)
        self._recording.log(
            CAMERA,
            rr.Pinhole(image_from_camera=seen.matrix, resolution=[seen.width, seen.height]),
            static=True,
        )

    def _take_jpeg(self, payload: bytes) -> None:
        stamp_ns, jpeg = jpeg_from_payload(payload)
        if self._pictures.passes(stamp_ns):
            self._draw_picture(stamp_ns, jpeg)

    def _take_image(self, payload: bytes) -> None:
        stamp_ns, pixels = picture_from_payload(payload)
        if self._pictures.passes(stamp_ns):
            self._draw_picture(stamp_ns, jpeg_of(pixels))

    def _draw_picture(self, stamp_ns: int, jpeg: bytes) -> None:
        self._at(stamp_ns)
        self._recording.log(f"{CAMERA}/image", rr.EncodedImage(contents=jpeg, media_type="image/jpeg"))

    def _take_status(self, payload: bytes) -> None:
        message = _decoded(EUMOS_STATUS, payload)
        stamp_ns, rules = to_ns(message.header.stamp), rule_states(message)
        self._at(stamp_ns)
        self._recording.log(RULES, rr.TextDocument(_rules_table(rules), media_type="text/markdown"))
        for rule in rules:
            before = self._states.get(rule.rule)
            if before == rule.state:
                continue
            self._states[rule.rule] = rule.state
            path = f"{RULES}/{rule.rule}"
            if before is None:
                values, colours = list(_STATE_COLOURS), np.array(list(_STATE_COLOURS.values()), np.uint32)
                self._recording.log(path, rr.StateConfiguration(values=values, colors=colours), static=True)
            else:
                level = "ERROR" if rule.state == "fail" else "WARN"
                self._say_at(stamp_ns, f"{_short(rule)}: {rule.state}{_where(rule)}", level)
            self._recording.log(path, rr.StateChange(state=rule.state))

    def _take_report(self, payload: bytes) -> None:
        text = _decoded(EUMOS_REPORT, payload).data
        try:
            verdict = str(json.loads(text)["verdict"])
        except (ValueError, LookupError, TypeError):
            raise BrokenRecording("eumos/report", text, "holds no verdict") from None
        level = {"pass": "INFO", "fail": "ERROR"}.get(verdict, "WARN")
        self.say(f"verdict: {verdict}", level=level)

    def _take_progress(self, payload: bytes) -> None:
        progress = progress_of(_decoded(PHYSICS_PROGRESS, payload))
        if progress.error is not None:
            self.say(f"ended by: {progress.error}", level="CRITICAL")
        elif progress.finished:
            self.say(f"physics finished after {progress.frames} frames")


class _Thinning:
    """Lets through the first of what comes, and then what is at least a period after the last [ns]."""

    def __init__(self, rate_hz: float) -> None:
        self._period_ns = 1.0e9 / rate_hz
        self._due_ns = -np.inf

    def passes(self, stamp_ns: int) -> bool:
        if stamp_ns + _SLACK_NS < self._due_ns:
            return False
        # On a grid, so that rates that do not divide come out right on average.
        is_on_grid = stamp_ns - self._due_ns < self._period_ns
        self._due_ns = (self._due_ns if is_on_grid else stamp_ns) + self._period_ns
        return True


def view_bag(path: Path, recording: rr.RecordingStream) -> Scene:
    """Draws a bag into a recording, and gives its scene.

    Raises:
        BrokenRecording: it is damaged, or holds no scene or no poses.
    """
    with BagReader(path) as reader:
        scene = scene_of_bag(reader)
        topic_in_bag(reader, PACKAGES_POSES.name)
        view = RerunView(scene, recording)
        names = {name: topic for topic in view.topics for name in topics_in_bag(reader, topic.name)}
        if any(topic == CAMERA_IMAGE for topic in names.values()):
            names = {name: topic for name, topic in names.items() if topic != CAMERA_COMPRESSED}
        for message in reader.messages(names):
            view.take(names[message.topic_name], message.payload)
        view.finish()
    return scene


def _decoded(topic: Topic, payload: bytes) -> Any:
    try:
        return deserialize_message(payload, message_class(topic.type_name))
    except (RuntimeError, ValueError, MemoryError):
        raise BrokenRecording(topic.name, payload[:16].hex(), f"is no {topic.type_name}") from None


def _travel_direction(scene: Scene) -> tuple[float, float]:
    """Unit vector (x, y) that accelerations are drawn along: that of the travel, or nearly for a recorded sled."""
    if isinstance(scene.sled, RecordedSled):
        right = side_of(scene).right
        return float(right[0]), float(right[1])
    return direction_vector(scene.sled.direction)


def _rules_table(rules: Sequence[RuleState]) -> str:
    """The rules as they stand, as Markdown."""
    lines = ["| rule | state | worst | limit |", "|---|---|---:|---:|"]
    for rule in rules:
        worst, limit = (
            "" if value is None else f"{value:.1f} mm" for value in (rule.worst_mm, rule.limit_mm)
        )
        lines.append(f"| {_short(rule)} | **{rule.state}** | {worst} | {limit} |")
    return "\n".join(lines)


def _short(rule: RuleState) -> str:
    return rule.rule.replace("_", " ")


def _where(rule: RuleState) -> str:
    worst = "" if rule.worst_mm is None or rule.limit_mm is None else (
        f", {rule.worst_mm:.1f} mm of {rule.limit_mm:.1f}"
    )  # fmt: skip
    return worst + ("" if rule.package is None else f" at {rule.package}")
