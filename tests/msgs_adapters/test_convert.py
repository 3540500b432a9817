"""Records survive the way through ROS messages and their bytes; meanings follow the REPs."""

from dataclasses import asdict
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from hypothesis import given, settings
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message

from config.errors import RefusedInput
from config.package import Package
from msgs_adapters import convert
from msgs_adapters.cdr import serialize
from msgs_adapters.stamps import MAX_STAMP_NS, to_ns
from sim_core.frames import AccelerometerSample, PoseFrame, RuleState, SledSample

finite = st.floats(allow_nan=False, allow_infinity=False)
vectors = st.tuples(finite, finite, finite).map(np.array)
words = st.text(st.characters(codec="utf-8", exclude_characters="\0"), min_size=1, max_size=20)
maybe_number = st.none() | finite


def through_bytes(message: Any) -> Any:
    return deserialize_message(serialize(message), type(message))


@settings(max_examples=60, deadline=None)
@given(
    stamp_ns=st.integers(10**9, MAX_STAMP_NS),
    gap_ns=st.integers(1, 10**9),
    acceleration=vectors,
    velocity=vectors,
    position=vectors,
)
def test_a_sled_sample_survives_accel_and_odometry(
    stamp_ns: int, gap_ns: int, acceleration: np.ndarray, velocity: np.ndarray, position: np.ndarray
) -> None:
    sample = SledSample(4, stamp_ns, gap_ns / 1e9, acceleration, velocity, position)
    accel, odometry = through_bytes(convert.to_accel(sample)), through_bytes(convert.to_odometry(sample))
    carried = convert.sample_from_accel(accel, stamp_ns - gap_ns)
    rebuilt = convert.sled_sample(4, carried, convert.motion_from_odometry(odometry))
    for name, value in asdict(sample).items():
        np.testing.assert_array_equal(getattr(rebuilt, name), value, strict=True)


def test_frames_of_the_sled_messages_and_refusals() -> None:
    sample = SledSample(0, 10**9, 0.0, np.array([1.0, 2.0, 3.0]), np.zeros(3), np.zeros(3))
    accel, odometry = convert.to_accel(sample), convert.to_odometry(sample)
    assert accel.header.frame_id == odometry.header.frame_id == "world"
    assert odometry.child_frame_id == "sled"
    assert odometry.pose.pose.orientation.w == 1.0
    assert convert.sample_from_accel(accel, None).interval_s == 0.0
    with pytest.raises(RefusedInput, match="after the stamp before"):
        convert.sample_from_accel(accel, 10**9)
    accel.accel.linear.y = float("nan")
    with pytest.raises(RefusedInput, match="must be finite"):
        convert.sample_from_accel(accel, None)
    accel.header.frame_id = "sled"
    with pytest.raises(RefusedInput, match="frame_id"):
        convert.sample_from_accel(accel, None)
    later = convert.SledMotion(10**9 + 1, np.zeros(3), np.zeros(3))
    with pytest.raises(RefusedInput, match="must equal"):
        convert.sled_sample(0, convert.AccelerationSample(10**9, 0.0, np.zeros(3)), later)


@settings(max_examples=40, deadline=None)
@given(stamp_ns=st.integers(0, MAX_STAMP_NS), force=vectors, variance=st.floats(0, 1e6))
def test_an_accelerometer_sample_survives_imu(stamp_ns: int, force: np.ndarray, variance: float) -> None:
    message = through_bytes(convert.to_imu(AccelerometerSample(stamp_ns, force, variance)))
    assert message.orientation_covariance[0] == message.angular_velocity_covariance[0] == -1.0
    assert message.header.frame_id == "sled"
    np.testing.assert_array_equal(message.linear_acceleration_covariance.reshape(3, 3), variance * np.eye(3))
    rebuilt = convert.accelerometer_sample(message)
    assert (rebuilt.stamp_ns, rebuilt.variance) == (stamp_ns, variance)
    np.testing.assert_array_equal(rebuilt.specific_force, force, strict=True)


def test_an_imu_that_reports_no_acceleration_is_refused() -> None:
    message = convert.to_imu(AccelerometerSample(0, np.zeros(3), 0.0))
    message.linear_acceleration_covariance[0] = -1.0
    with pytest.raises(RefusedInput, match="not reported"):
        convert.accelerometer_sample(message)


def package(name: str, layer: int) -> Package:
    return Package(id=name, size_m=(0.4, 0.3, 0.2), mass_kg=1.0, position_m=(0.0, 0.0, 0.1), layer=layer)


def test_markers_are_cubes_of_the_packages_where_the_poses_are() -> None:
    packages = [package("a", layer=1), package("b", layer=2), package("c", layer=1)]
    rng = np.random.default_rng(3)
    frame = PoseFrame(0, 10**9, rng.normal(size=(4, 3)), rng.normal(size=(4, 4)))
    markers = convert.to_markers(frame, packages, (1.2, 0.8, 0.144)).markers
    assert [(m.ns, m.id, m.type, m.action) for m in markers] == [("packages", i, 1, 0) for i in range(4)]
    assert (markers[0].scale.x, markers[0].scale.y, markers[0].scale.z) == (1.2, 0.8, 0.144)
    assert (markers[2].scale.x, markers[2].pose.position.y) == (0.4, frame.positions[2, 1])
    assert markers[3].pose.orientation.w == frame.orientations[3, 3]
    assert all(m.color.a == 1.0 and m.header.frame_id == "sled" for m in markers)
    assert markers[1].color == markers[3].color != markers[2].color
    assert [m.id for m in convert.to_markers(frame, packages, None).markers] == [1, 2, 3]
    with pytest.raises(ValueError, match="zip"):
        convert.to_markers(frame, packages[:2], None)


@settings(max_examples=60, deadline=None)
@given(
    rules=st.lists(
        st.builds(
            RuleState,
            rule=words,
            title=words,
            state=st.sampled_from(["pass", "fail", "unresolved", "off"]),
            limit_mm=maybe_number,
            worst_mm=maybe_number,
            margin_mm=maybe_number,
            package=st.none() | words,
            corner=st.none() | st.integers(0, 7),
            time_s=maybe_number,
            height_m=maybe_number,
            error_mm=maybe_number,
        ),
        max_size=4,
    )
)
def test_rule_states_survive_diagnostics(rules: list[RuleState]) -> None:
    message = through_bytes(convert.to_diagnostics(5 * 10**9, rules))
    assert convert.rule_states(message) == rules
    assert to_ns(message.header.stamp) == 5 * 10**9


def test_levels_say_how_a_rule_stands() -> None:
    levels = {"pass": b"\0", "off": b"\0", "unresolved": b"\1", "fail": b"\2"}
    for state, level in levels.items():
        rule = RuleState("permanent", "Permanent", state, 40.0, 41.5, -1.5, package="a")  # type: ignore[arg-type]
        (status,) = convert.to_diagnostics(0, [rule]).status
        assert status.level == level
        assert status.name == "eumos: permanent"
        assert status.message == f"{state}: 41.5 of 40.0 mm at package a"
    (status,) = convert.to_diagnostics(0, [rule]).status
    status.values[0].value = "maybe"
    with pytest.raises(RefusedInput, match="must be one of"):
        convert.rule_states(DiagnosticArray(status=[status]))


@settings(max_examples=40, deadline=None)
@given(
    samples=st.integers(0, 10**6),
    frames=st.integers(0, 10**6),
    finished=st.booleans(),
    error=st.none() | words,
    values=st.dictionaries(words.filter(lambda k: k not in ("samples", "frames", "finished")), words),
)
def test_progress_survives(
    samples: int, frames: int, finished: bool, error: str | None, values: dict[str, str]
) -> None:
    progress = convert.Progress(samples, frames, finished, error, values)
    assert convert.progress_of(through_bytes(convert.to_progress(progress))) == progress


def test_progress_without_counts_is_refused() -> None:
    with pytest.raises(RefusedInput, match="samples"):
        convert.progress_of(DiagnosticStatus())
