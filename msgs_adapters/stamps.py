"""Simulated time in nanoseconds to and from ROS time messages."""

from typing import Any

from builtin_interfaces.msg import Time
from rosgraph_msgs.msg import Clock

from config.errors import RefusedInput

NS_PER_S = 1_000_000_000
MAX_STAMP_NS = (1 << 31) * NS_PER_S - 1
"""The last time that builtin_interfaces/Time can hold: its seconds are an int32."""


def split_stamp(stamp_ns: int) -> tuple[int, int]:
    """Seconds and nanoseconds of a stamp.

    Raises:
        RefusedInput: the stamp is negative or past what a ROS time can hold.
    """
    if not 0 <= stamp_ns <= MAX_STAMP_NS:
        raise RefusedInput("stamp_ns", stamp_ns, f"must be from 0 to {MAX_STAMP_NS}")
    return divmod(stamp_ns, NS_PER_S)


def to_time_msg(stamp_ns: int) -> Any:
    """A ``builtin_interfaces/Time``; raises as `split_stamp`."""
    seconds, nanoseconds = split_stamp(stamp_ns)
    return Time(sec=seconds, nanosec=nanoseconds)


def to_ns(stamp: Any) -> int:
    """Nanoseconds of a ``builtin_interfaces/Time``."""
    return int(stamp.sec) * NS_PER_S + int(stamp.nanosec)


def to_clock(stamp_ns: int) -> Any:
    """A ``rosgraph_msgs/Clock``; raises as `split_stamp`."""
    return Clock(clock=to_time_msg(stamp_ns))


def interval_s(previous_stamp_ns: int | None, stamp_ns: int) -> float:
    """Time between two stamps [s], by the one formula for senders and readers; 0 without a previous one.

    Raises:
        RefusedInput: time does not advance.
    """
    if previous_stamp_ns is None:
        return 0.0
    if stamp_ns <= previous_stamp_ns:
        raise RefusedInput("stamp_ns", stamp_ns, f"must be after the stamp before, {previous_stamp_ns}")
    return (stamp_ns - previous_stamp_ns) / NS_PER_S
