"""Stamps survive ROS time, and impossible ones are refused."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from config.errors import RefusedInput
from msgs_adapters.stamps import MAX_STAMP_NS, interval_s, to_clock, to_ns, to_time_msg


@settings(max_examples=60, deadline=None)
@given(st.integers(0, MAX_STAMP_NS))
def test_round_trip(stamp_ns: int) -> None:
    assert to_ns(to_time_msg(stamp_ns)) == stamp_ns
    assert to_ns(to_clock(stamp_ns).clock) == stamp_ns


@pytest.mark.parametrize("stamp_ns", [-1, MAX_STAMP_NS + 1])
def test_what_a_ros_time_cannot_hold_is_refused(stamp_ns: int) -> None:
    with pytest.raises(RefusedInput, match="stamp_ns"):
        to_time_msg(stamp_ns)


def test_intervals() -> None:
    assert interval_s(None, 5) == 0.0
    assert interval_s(1_000_000_000, 1_002_000_000) == 0.002
    with pytest.raises(RefusedInput, match="after the stamp before"):
        interval_s(7, 7)
