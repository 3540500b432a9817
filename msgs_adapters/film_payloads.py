"""Film frames to and from the bytes of PointCloud2, to the bit.

``wrap/strain`` is an organised cloud: a row is an element of the film, and the row's three points are its corners.
A point holds the fields ``FIELDS``, all FLOAT32: its place in frame ``sled`` [m], its place on the film unrolled [m],
and then, the same at the three corners, what the element says, see :class:`~sim_core.frames.FilmFrame`. A film of
1200 elements takes 160 kB, and a fraction of a millisecond either way.
"""

import struct

import numpy as np
from numpy.typing import NDArray

from config.errors import BrokenRecording
from msgs_adapters.cdr import ENCAPSULATION, align
from msgs_adapters.stamps import split_stamp
from msgs_adapters.topics import SLED_FRAME
from sim_core.frames import FilmFrame

FIELDS = ("x", "y", "z", "around", "up", "strain", "strain_around", "strain_up", "peak", "force", "torn")

_CORNERS = 3
_FLOAT32 = 7  # sensor_msgs/PointField
_STAMP = struct.Struct("<iI")
_COUNT = struct.Struct("<I")
_STAMP_OFFSET = len(ENCAPSULATION)
_POINT_BYTES = 4 * len(FIELDS)
_ROW_BYTES = _CORNERS * _POINT_BYTES
# Sums of three numbers below this are float32 still.
_TOO_LARGE = 1.0e30


def _cloud_head() -> tuple[bytes, NDArray[np.intp], int]:
    """What stands before the points, the places in it that are the same in every film, and that of the height.

    Stamp, height and size of the data differ from film to film, and padding from sender to sender.
    """
    head = bytearray(ENCAPSULATION + bytes(_STAMP.size))
    same = [0, 1]

    def add(part: bytes, *, aligned_to: int = 4) -> None:
        align(head, aligned_to)
        same.extend(range(len(head), len(head) + len(part)))
        head.extend(part)

    def add_text(text: str) -> None:
        add(_COUNT.pack(len(text) + 1) + text.encode() + b"\0")

    add_text(SLED_FRAME)
    align(head, 4)
    height_offset = len(head)
    head += bytes(_COUNT.size)
    add(_COUNT.pack(_CORNERS))
    add(_COUNT.pack(len(FIELDS)))
    for number, name in enumerate(FIELDS):
        add_text(name)
        add(_COUNT.pack(4 * number))
        add(bytes((_FLOAT32,)), aligned_to=1)
        add(_COUNT.pack(1))
    add(b"\0", aligned_to=1)
    add(_COUNT.pack(_POINT_BYTES) + _COUNT.pack(_ROW_BYTES))
    head += bytes(_COUNT.size)
    return bytes(head), np.array(same), height_offset


_CLOUD_HEAD, _SAME_BYTES, _HEIGHT_OFFSET = _cloud_head()
_SAME = np.frombuffer(_CLOUD_HEAD, np.uint8)[_SAME_BYTES]
_SIZE_OFFSET = len(_CLOUD_HEAD) - _COUNT.size
_IS_DENSE = b"\1\0\0\0"


def film_cloud_payload(frame: FilmFrame) -> bytes:
    """CDR bytes of the ``sensor_msgs/PointCloud2`` in frame ``sled`` that holds the film.

    Raises:
        RefusedInput: the stamp is not a ROS time.
    """
    points = np.empty((len(frame.corners), _CORNERS, len(FIELDS)), "<f4")
    points[:, :, :3], points[:, :, 3:5] = frame.corners, frame.unrolled
    points[:, :, 5:8] = frame.strains[:, np.newaxis]
    for column, values in enumerate((frame.peaks, frame.forces, frame.torn_s), start=8):
        points[:, :, column] = values[:, np.newaxis]
    head = bytearray(_CLOUD_HEAD)
    _STAMP.pack_into(head, _STAMP_OFFSET, *split_stamp(frame.stamp_ns))
    _COUNT.pack_into(head, _HEIGHT_OFFSET, len(points))
    _COUNT.pack_into(head, _SIZE_OFFSET, points.nbytes)
    return b"".join((head, points.tobytes(), _IS_DENSE))


def film_frame_from_payload(payload: bytes, index: int) -> FilmFrame:
    """The film frame whose ``film_cloud_payload`` this is, to the bit, also after another ROS node has copied it.

    Args:
        payload: CDR bytes of a PointCloud2 in frame ``sled`` with the fields ``FIELDS``.
        index: the number of its pose frame, which a PointCloud2 does not carry.

    Raises:
        BrokenRecording: the bytes are no such message, or hold numbers that no film can have.
    """
    start = len(_CLOUD_HEAD)
    head = np.frombuffer(payload[:start], np.uint8)
    try:
        if len(head) < start or not np.array_equal(head[_SAME_BYTES], _SAME):
            raise ValueError
        seconds, nanoseconds = _STAMP.unpack_from(payload, _STAMP_OFFSET)
        (count,) = _COUNT.unpack_from(payload, _HEIGHT_OFFSET)
        (size,) = _COUNT.unpack_from(payload, _SIZE_OFFSET)
        if size != count * _ROW_BYTES or len(payload) <= start + size:
            raise ValueError
        points = np.frombuffer(payload, "<f4", size // 4, start).reshape(count, _CORNERS, len(FIELDS))
    except (struct.error, ValueError):
        limit = (
            f"is not a PointCloud2 of FLOAT32 {' '.join(FIELDS)}, {_CORNERS} points a row, in '{SLED_FRAME}'"
        )
        raise BrokenRecording("wrap/strain", payload[:16].hex(), limit) from None
    element = points[:, 0, 5:]
    if not (np.abs(points) < _TOO_LARGE).all() or (points[:, :, 5:] != element[:, np.newaxis]).any():
        limit = f"must be numbers below {_TOO_LARGE:g}, those of an element the same at its corners"
        raise BrokenRecording("wrap/strain", "data", limit)
    # Each column of its own: what is cut out of a message must not keep it.
    strains, peaks, forces, torn_s = element[:, :3], element[:, 3], element[:, 4], element[:, 5]
    return FilmFrame(
        index=index,
        stamp_ns=seconds * 1_000_000_000 + nanoseconds,
        corners=points[:, :, :3].astype(np.float32),
        unrolled=points[:, :, 3:5].astype(np.float32),
        strains=strains.astype(np.float32),
        peaks=peaks.astype(np.float32),
        forces=forces.astype(np.float32),
        torn_s=torn_s.astype(np.float32),
    )
