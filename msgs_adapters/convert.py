"""The twin's records to and from ROS messages, but for poses, which are hot and stand in `pose_payloads`."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, cast

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import Accel, AccelStamped, Point, Pose, Quaternion, Vector3
from nav_msgs.msg import Odometry
from sensor_msgs.msg import Imu
from std_msgs.msg import ColorRGBA, Float64, Header, String
from visualization_msgs.msg import Marker, MarkerArray

from config.errors import RefusedInput
from config.package import Package
from msgs_adapters.colours import PALLET_COLOUR, package_colour
from msgs_adapters.stamps import interval_s, to_ns, to_time_msg
from msgs_adapters.topics import SLED_FRAME, WORLD_FRAME
from sim_core.frames import AccelerometerSample, Array, PoseFrame, RuleState, SledSample

# Messages are typed Any: the generated modules carry no type information.


@dataclass(frozen=True)
class AccelerationSample:
    """What a step of the physics needs of a sled sample, and all that an AccelStamped carries.

    Attributes:
        stamp_ns: simulated time [ns].
        interval_s: time since the sample before [s]; 0 for the first.
        acceleration: mean acceleration over the interval, frame ``world`` [m/s²], shape [3].
    """

    stamp_ns: int
    interval_s: float
    acceleration: Array


@dataclass(frozen=True)
class SledMotion:
    """What an Odometry carries of a sled sample: position [m] and velocity [m/s] in ``world``, shape [3]."""

    stamp_ns: int
    position: Array
    velocity: Array


@dataclass(frozen=True)
class Progress:
    """How far the physics has come.

    Attributes:
        samples: sled samples taken in.
        frames: pose frames given out.
        finished: no frame will follow.
        error: why the run was ended, where it was.
        values: whatever else is worth showing; the names above are taken.
    """

    samples: int
    frames: int
    finished: bool = False
    error: str | None = None
    values: Mapping[str, str] = field(default_factory=dict)


def to_accel(sample: SledSample) -> Any:
    """A ``geometry_msgs/AccelStamped`` in frame ``world``; velocity and position go into the odometry."""
    return AccelStamped(
        header=_header(sample.stamp_ns, WORLD_FRAME), accel=Accel(linear=_vector(sample.acceleration))
    )


def sample_from_accel(message: Any, previous_stamp_ns: int | None) -> AccelerationSample:
    """The acceleration that a message carries, with its interval.

    Args:
        message: an AccelStamped in frame ``world``.
        previous_stamp_ns: stamp of the message before; none for the first.

    Raises:
        RefusedInput: a value is not finite, another frame, or time does not advance.
    """
    _require_frame("sled/acceleration", message.header, WORLD_FRAME)
    stamp_ns = to_ns(message.header.stamp)
    acceleration = _array("sled/acceleration.accel.linear", message.accel.linear)
    return AccelerationSample(stamp_ns, interval_s(previous_stamp_ns, stamp_ns), acceleration)


def to_odometry(sample: SledSample) -> Any:
    """A ``nav_msgs/Odometry`` of frame ``sled`` in ``world``; the sled does not turn, so twists are equal."""
    message = Odometry(header=_header(sample.stamp_ns, WORLD_FRAME), child_frame_id=SLED_FRAME)
    message.pose.pose.position = _point(sample.position)
    message.twist.twist.linear = _vector(sample.velocity)
    return message


def motion_from_odometry(message: Any) -> SledMotion:
    """The sled's position and velocity.

    Raises:
        RefusedInput: a value is not finite, or other frames.
    """
    _require_frame("sled/odometry", message.header, WORLD_FRAME)
    if message.child_frame_id != SLED_FRAME:
        raise RefusedInput("sled/odometry.child_frame_id", message.child_frame_id, f"must be '{SLED_FRAME}'")
    return SledMotion(
        to_ns(message.header.stamp),
        _array("sled/odometry.pose", message.pose.pose.position),
        _array("sled/odometry.twist", message.twist.twist.linear),
    )


def sled_sample(index: int, acceleration: AccelerationSample, motion: SledMotion) -> SledSample:
    """The sample that was sent as two messages.

    Raises:
        RefusedInput: the two stamps differ.
    """
    if acceleration.stamp_ns != motion.stamp_ns:
        limit = f"must equal the acceleration's, {acceleration.stamp_ns}"
        raise RefusedInput("sled/odometry.stamp_ns", motion.stamp_ns, limit)
    return SledSample(
        index,
        motion.stamp_ns,
        acceleration.interval_s,
        acceleration.acceleration,
        motion.velocity,
        motion.position,
    )


def to_imu(sample: AccelerometerSample) -> Any:
    """A ``sensor_msgs/Imu`` in frame ``sled`` that reports specific force only (REP-145)."""
    message = Imu(
        header=_header(sample.stamp_ns, SLED_FRAME), linear_acceleration=_vector(sample.specific_force)
    )
    message.orientation_covariance[0] = -1.0
    message.angular_velocity_covariance[0] = -1.0
    message.linear_acceleration_covariance[[0, 4, 8]] = sample.variance
    return message


def accelerometer_sample(message: Any) -> AccelerometerSample:
    """The reading that an Imu carries, whatever its frame: a real sensor names its own.

    Raises:
        RefusedInput: a value is not finite, or the sensor says that it does not report acceleration.
    """
    variance = float(message.linear_acceleration_covariance[0])
    if not 0.0 <= variance < np.inf:
        limit = "must be a variance: -1 stands for an acceleration that is not reported"
        raise RefusedInput("sled/accelerometer.linear_acceleration_covariance[0]", variance, limit)
    force = _array("sled/accelerometer.linear_acceleration", message.linear_acceleration)
    return AccelerometerSample(to_ns(message.header.stamp), force, variance)


def to_markers(
    frame: PoseFrame, packages: Sequence[Package], pallet_size_m: tuple[float, float, float] | None
) -> Any:
    """A ``visualization_msgs/MarkerArray`` of one cube a package, coloured by layer, and one for the pallet.

    Ids are the rows of the frame, so id 0 is the pallet; without a pallet there is no such marker.
    """
    boxes = [(pallet_size_m, PALLET_COLOUR)] + [(p.size_m, package_colour(p)) for p in packages]
    markers = [
        Marker(
            header=_header(frame.stamp_ns, SLED_FRAME),
            ns="packages",
            id=row,
            type=Marker.CUBE,
            action=Marker.ADD,
            pose=Pose(position=_point(position), orientation=_quaternion(orientation)),
            scale=_vector(np.asarray(size_m)),
            color=_colour(colour),
        )
        for row, ((size_m, colour), position, orientation) in enumerate(
            zip(boxes, frame.positions, frame.orientations, strict=True)
        )
        if size_m is not None
    ]
    return MarkerArray(markers=markers)


def to_string(text: str) -> Any:
    """A ``std_msgs/String``."""
    return String(data=text)


def to_float(value: float) -> Any:
    """A ``std_msgs/Float64``."""
    return Float64(data=value)


_LEVELS = {
    "pass": DiagnosticStatus.OK,
    "off": DiagnosticStatus.OK,
    "unresolved": DiagnosticStatus.WARN,
    "fail": DiagnosticStatus.ERROR,
}
_RULE_NUMBERS = ("limit_mm", "worst_mm", "margin_mm", "time_s", "height_m", "error_mm")
_RULE_PREFIX = "eumos: "


def to_diagnostics(stamp_ns: int, rules: Sequence[RuleState]) -> Any:
    """A ``diagnostic_msgs/DiagnosticArray`` with one status a rule; numbers are written to the last bit."""
    statuses = []
    for rule in rules:
        values = {"state": rule.state, "title": rule.title}
        fields = {name: getattr(rule, name) for name in (*_RULE_NUMBERS, "package", "corner")}
        values |= {name: str(value) for name, value in fields.items() if value is not None}
        statuses.append(_status(_RULE_PREFIX + rule.rule, _LEVELS[rule.state], _sentence(rule), values))
    # EUMOS states carry no frame: they concern the whole load.
    return DiagnosticArray(header=_header(stamp_ns, ""), status=statuses)


def rule_states(message: Any) -> list[RuleState]:
    """The rules that a DiagnosticArray carries; statuses of others are passed over.

    Raises:
        RefusedInput: a value is missing or no number.
    """
    return [_rule_state(status) for status in message.status if status.name.startswith(_RULE_PREFIX)]


def to_progress(progress: Progress) -> Any:
    """A ``diagnostic_msgs/DiagnosticStatus`` of the physics."""
    values = {
        "samples": str(progress.samples),
        "frames": str(progress.frames),
        "finished": str(progress.finished).lower(),
        **progress.values,
    }
    if progress.error is not None:
        return _status("physics", DiagnosticStatus.ERROR, progress.error, values)
    return _status("physics", DiagnosticStatus.OK, "finished" if progress.finished else "running", values)


def progress_of(message: Any) -> Progress:
    """The progress that a DiagnosticStatus carries.

    Raises:
        RefusedInput: a value is missing or no number.
    """
    values = {pair.key: pair.value for pair in message.values}
    counts = [_number("physics/progress", values, name, int) for name in ("samples", "frames")]
    return Progress(
        samples=int(counts[0]),
        frames=int(counts[1]),
        finished=values.get("finished") == "true",
        error=message.message if message.level == DiagnosticStatus.ERROR else None,
        values={k: v for k, v in values.items() if k not in ("samples", "frames", "finished")},
    )


def _sentence(rule: RuleState) -> str:
    if rule.worst_mm is None:
        return rule.state
    limit = "" if rule.limit_mm is None else f" of {rule.limit_mm:.1f}"
    where = "" if rule.package is None else f" at package {rule.package}"
    return f"{rule.state}: {rule.worst_mm:.1f}{limit} mm{where}"


def _rule_state(status: Any) -> RuleState:
    where = f"eumos/status.{status.name}"
    values = {pair.key: pair.value for pair in status.values}
    if values.get("state") not in _LEVELS:
        raise RefusedInput(f"{where}.state", values.get("state"), f"must be one of {', '.join(_LEVELS)}")
    numbers = {
        name: _number(where, values, name, float) if name in values else None for name in _RULE_NUMBERS
    }
    return RuleState(
        rule=status.name.removeprefix(_RULE_PREFIX),
        title=values.get("title", ""),
        state=cast(Literal["pass", "fail", "unresolved", "off"], values["state"]),
        package=values.get("package"),
        corner=int(_number(where, values, "corner", int)) if "corner" in values else None,
        **numbers,
    )


def _number(where: str, values: Mapping[str, str], name: str, kind: type[int] | type[float]) -> float:
    try:
        return kind(values[name])
    except (KeyError, ValueError):
        raise RefusedInput(f"{where}.{name}", values.get(name), "must be a number") from None


def _status(name: str, level: bytes, message: str, values: Mapping[str, str]) -> Any:
    pairs = [KeyValue(key=key, value=value) for key, value in values.items()]
    return DiagnosticStatus(name=name, level=level, message=message, hardware_id="sled bench", values=pairs)


def _header(stamp_ns: int, frame_id: str) -> Any:
    return Header(stamp=to_time_msg(stamp_ns), frame_id=frame_id)


def _vector(values: Array) -> Any:
    x, y, z = values.tolist()
    return Vector3(x=x, y=y, z=z)


def _point(values: Array) -> Any:
    x, y, z = values.tolist()
    return Point(x=x, y=y, z=z)


def _quaternion(values: Array) -> Any:
    x, y, z, w = values.tolist()
    return Quaternion(x=x, y=y, z=z, w=w)


def _colour(rgb: tuple[float, float, float]) -> Any:
    red, green, blue = rgb
    return ColorRGBA(r=red, g=green, b=blue, a=1.0)


def _array(where: str, vector: Any) -> Array:
    values = np.array([vector.x, vector.y, vector.z])
    if not np.isfinite(values).all():
        raise RefusedInput(where, values.tolist(), "must be finite")
    return values


def _require_frame(where: str, header: Any, frame: str) -> None:
    if header.frame_id != frame:
        raise RefusedInput(f"{where}.header.frame_id", header.frame_id, f"must be '{frame}'")
