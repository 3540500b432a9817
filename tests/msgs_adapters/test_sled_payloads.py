"""The sled's fast payloads are those of the messages, byte for byte."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from config.errors import RefusedInput
from msgs_adapters.cdr import serialize
from msgs_adapters.convert import to_accel, to_imu, to_odometry
from msgs_adapters.sled_payloads import accel_payload, imu_payload, odometry_payload
from sim_core.frames import AccelerometerSample, SledSample

stamps = st.integers(0, 2**31 * 10**9 - 1)
vectors = st.tuples(*[st.floats(allow_nan=False, allow_infinity=False)] * 3).map(np.array)


@given(stamps, vectors, vectors, vectors)
def test_samples_are_those_of_the_messages(stamp_ns, acceleration, velocity, position):
    sample = SledSample(3, stamp_ns, 0.001, acceleration, velocity, position)
    assert accel_payload(sample) == serialize(to_accel(sample))
    assert odometry_payload(sample) == serialize(to_odometry(sample))


@given(stamps, vectors, st.floats(0.0, 1e9))
def test_readings_are_those_of_the_messages(stamp_ns, force, variance):
    reading = AccelerometerSample(stamp_ns, force, variance)
    assert imu_payload(reading) == serialize(to_imu(reading))


def test_a_stamp_before_time_is_refused():
    with pytest.raises(RefusedInput):
        imu_payload(AccelerometerSample(-1, np.zeros(3), 0.0))
