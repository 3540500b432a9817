"""The sled's messages as bytes, straight from numbers: a thousand a second leave, and all but the numbers stays.

``serialize`` makes the message once, with zeros; where its numbers stand in the bytes is found by writing others.
A reading takes 16 µs as a message and 2 µs here; the bytes are the same.
"""

import struct
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np

from msgs_adapters.cdr import ENCAPSULATION, serialize
from msgs_adapters.convert import to_accel, to_imu, to_odometry
from msgs_adapters.stamps import split_stamp
from sim_core.frames import AccelerometerSample, Array, SledSample

_STAMP = struct.Struct("<iI")
_VECTOR = struct.Struct("<3d")
_NUMBER = struct.Struct("<d")
# No number of a message is this one by itself.
_MARK = 1.2345678901234567e-89


def accel_payload(sample: SledSample) -> bytes:
    """CDR bytes of ``to_accel``.

    Raises:
        RefusedInput: the stamp is not a ROS time.
    """
    template, (place,) = _template("accel")
    return _filled(template, sample.stamp_ns, ((place, sample.acceleration),))


def odometry_payload(sample: SledSample) -> bytes:
    """CDR bytes of ``to_odometry``.

    Raises:
        RefusedInput: the stamp is not a ROS time.
    """
    template, (position, velocity) = _template("odometry")
    return _filled(template, sample.stamp_ns, ((position, sample.position), (velocity, sample.velocity)))


def imu_payload(reading: AccelerometerSample) -> bytes:
    """CDR bytes of ``to_imu``.

    Raises:
        RefusedInput: the stamp is not a ROS time.
    """
    template, (force, *variances) = _template("imu")
    payload = bytearray(_filled(template, reading.stamp_ns, ((force, reading.specific_force),)))
    for place in variances:
        _NUMBER.pack_into(payload, place, reading.variance)
    return bytes(payload)


def _filled(template: bytes, stamp_ns: int, vectors: tuple[tuple[int, Array], ...]) -> bytes:
    payload = bytearray(template)
    _STAMP.pack_into(payload, len(ENCAPSULATION), *split_stamp(stamp_ns))
    for place, vector in vectors:
        _VECTOR.pack_into(payload, place, *vector)
    return bytes(payload)


@cache
def _template(kind: str) -> tuple[bytes, tuple[int, ...]]:
    """The bytes with zeros for numbers, and where each vector or number begins."""
    zero, mark = np.zeros(3), np.array([_MARK, 0.0, 0.0])

    def sled(*, acceleration: Array = zero, velocity: Array = zero, position: Array = zero) -> SledSample:
        return SledSample(0, 0, 0.0, acceleration, velocity, position)

    makers: dict[str, tuple[Callable[[Any], Any], Any, tuple[Any, ...]]] = {
        "accel": (to_accel, sled(), (sled(acceleration=mark),)),
        "odometry": (to_odometry, sled(), (sled(position=mark), sled(velocity=mark))),
        "imu": (
            to_imu,
            AccelerometerSample(0, zero, 0.0),
            (AccelerometerSample(0, mark, 0.0), AccelerometerSample(0, zero, _MARK)),
        ),
    }
    make, empty, marked = makers[kind]
    sought = _NUMBER.pack(_MARK)
    places: list[int] = []
    for sample in marked:
        content = serialize(make(sample))
        place = content.find(sought)
        while place >= 0:
            places.append(place)
            place = content.find(sought, place + 1)
    return serialize(make(empty)), tuple(places)
