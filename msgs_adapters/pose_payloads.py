"""Pose frames to and from the bytes of PoseArray and TFMessage, without a Python object for each pose.

A PoseArray of 41 poses costs rclpy 300 µs to build and serialise and this module about 5 µs (`cdr` says why
the bytes differ in padding, and only there). tf2_msgs is not in the wheels at all.
"""

import struct
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from config.errors import BrokenRecording
from msgs_adapters.cdr import ENCAPSULATION, align, write_string
from msgs_adapters.stamps import split_stamp
from msgs_adapters.topics import PALLET_FRAME, SLED_FRAME, WORLD_FRAME, package_frame
from sim_core.frames import Array, PoseFrame

_STAMP = struct.Struct("<iI")
_COUNT = struct.Struct("<I")
_POSE_BYTES = 56
_STAMP_OFFSET = len(ENCAPSULATION)
_FRAME_OFFSET = _STAMP_OFFSET + _STAMP.size


def _header_after_stamp(frame_id: str) -> bytes:
    """What stands between the stamp and the pose count: it is the same in every message."""
    payload = bytearray(ENCAPSULATION + bytes(_STAMP.size))
    write_string(payload, frame_id)
    align(payload, 4)
    return bytes(payload[_FRAME_OFFSET:])


_AFTER_STAMP = _header_after_stamp(SLED_FRAME)


def pose_array_payload(frame: PoseFrame) -> bytes:
    """CDR bytes of the ``geometry_msgs/PoseArray`` in frame ``sled`` that holds the frame's poses.

    Raises:
        RefusedInput: the stamp is not a ROS time.
    """
    head = bytearray(ENCAPSULATION + _STAMP.pack(*split_stamp(frame.stamp_ns)) + _AFTER_STAMP)
    head += _COUNT.pack(len(frame.positions))
    if not len(frame.positions):
        return bytes(head)
    align(head, 8)
    return bytes(head) + _pose_rows(frame).tobytes()


def pose_frame_from_payload(payload: bytes, index: int) -> PoseFrame:
    """The pose frame whose ``pose_array_payload`` this is, or that any little-endian ROS node has sent.

    Args:
        payload: CDR bytes of a PoseArray in frame ``sled``.
        index: the frame's number, which a PoseArray does not carry.

    Raises:
        BrokenRecording: the bytes are no such message.
    """
    try:
        if payload[:2] != ENCAPSULATION[:2]:
            raise ValueError
        seconds, nanoseconds = _STAMP.unpack_from(payload, _STAMP_OFFSET)
        (frame_bytes,) = _COUNT.unpack_from(payload, _FRAME_OFFSET)
        frame_start = _FRAME_OFFSET + 4
        frame_id = payload[frame_start : frame_start + frame_bytes - 1].decode()
        (count,) = _COUNT.unpack_from(payload, _aligned(frame_start + frame_bytes, 4))
        start = _aligned(_aligned(frame_start + frame_bytes, 4) + 4, 8)
        poses = np.frombuffer(payload, "<f8", count * 7, start if count else 0).reshape(count, 7)
    except (struct.error, ValueError):
        raise BrokenRecording("packages/poses", payload[:16].hex(), "is not a PoseArray") from None
    if frame_id != SLED_FRAME:
        raise BrokenRecording("packages/poses.header.frame_id", frame_id, f"must be '{SLED_FRAME}'")
    if not np.isfinite(poses).all():
        pose = int(np.flatnonzero(~np.isfinite(poses).all(axis=1))[0])
        raise BrokenRecording(f"packages/poses.poses[{pose}]", poses[pose].tolist(), "must be finite")
    stamp_ns = seconds * 1_000_000_000 + nanoseconds
    return PoseFrame(index, stamp_ns, poses[:, :3].astype(np.float64), poses[:, 3:].astype(np.float64))


class TransformEncoder:
    """Writes pose frames as ``tf2_msgs/TFMessage``: world to sled, sled to pallet, sled to each package.

    The layout of the bytes depends on the names only, so it is laid out once and then filled.
    """

    def __init__(self, package_ids: Sequence[str]) -> None:
        pairs = [(WORLD_FRAME, SLED_FRAME), (SLED_FRAME, PALLET_FRAME)]
        pairs += [(SLED_FRAME, package_frame(package_id)) for package_id in package_ids]
        payload = bytearray(ENCAPSULATION + _COUNT.pack(len(pairs)))
        stamps, transforms = [], []
        for parent, child in pairs:
            align(payload, 4)
            stamps.append(len(payload))
            payload += bytes(_STAMP.size)
            write_string(payload, parent)
            write_string(payload, child)
            align(payload, 8)
            transforms.append(len(payload))
            payload += bytes(_POSE_BYTES)
        self._template = np.frombuffer(bytes(payload), np.uint8)
        self._stamp_bytes = _byte_indices(stamps, _STAMP.size)
        self._transform_bytes = _byte_indices(transforms, _POSE_BYTES)

    def encode(self, frame: PoseFrame, sled_position: Array) -> bytes:
        """CDR bytes of one TFMessage at the frame's stamp.

        Args:
            frame: poses in ``sled``.
            sled_position: the sled's travel in ``world`` at the same time [m], shape [3].

        Raises:
            RefusedInput: the stamp is not a ROS time.
        """
        sled = np.concatenate((sled_position, (0.0, 0.0, 0.0, 1.0)))[np.newaxis]
        rows = np.ascontiguousarray(np.concatenate((sled, _pose_rows(frame))), "<f8")
        payload = self._template.copy()
        payload[self._stamp_bytes] = np.frombuffer(_STAMP.pack(*split_stamp(frame.stamp_ns)), np.uint8)
        payload[self._transform_bytes] = rows.view(np.uint8)
        return payload.tobytes()


def _pose_rows(frame: PoseFrame) -> NDArray[np.float64]:
    """Position and orientation side by side, as a Pose and a Transform both hold them, shape [n, 7]."""
    return np.concatenate((frame.positions, frame.orientations), axis=1, dtype="<f8")


def _byte_indices(starts: list[int], length: int) -> NDArray[np.int64]:
    return np.asarray(starts)[:, np.newaxis] + np.arange(length)


def _aligned(offset: int, size: int) -> int:
    return offset + (_STAMP_OFFSET - offset) % size
