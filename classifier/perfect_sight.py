"""What one camera could know at best: the true movement, across its line of sight, of the packages that face it."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from classifier.examples import Example
from classifier.rows import Row, Rows
from classifier.side_by_side import side_by_side
from config.errors import PalletTwinError, RefusedInput
from msgs_adapters.pose_payloads import pose_frame_from_payload
from msgs_adapters.topics import PACKAGES_POSES
from recordings.bag_pictures import has_pictures, pictures_of_bag
from recordings.bag_reader import BagReader
from recordings.judge_bag import scene_of_bag, topic_in_bag
from sim_core.camera.layout import facing_packages, side_of
from sim_core.frames import Array, PoseFrame
from sim_core.geometry import box_corners, rotation_matrices
from sim_core.judge import TIE_M, TOPPLED_TILT_DEG

FORMAT = 1
"""Version of the features on disk; raise it when they change."""
FEATURES = ("largest share of a limit", "a facing package toppled or fell")
_LEAST, _MOST = 0.01, 10.0
"""Shares of a limit below and above these are all one."""


def sighted_features(
    examples: Sequence[Example], rows: Rows, *, workers: int = 1, on_row: Callable[[], None] | None = None
) -> Array:
    """Features of each test, shape [n, 2]; NaN where a recording lacks pictures, scene or poses.

    Args:
        examples: the tests.
        rows: where features are kept, by the digest of the bag.
        workers: processes that read bags; 1: this one.
        on_row: told after each test.
    """
    missing = {_key(example): example.bag for example in examples if _key(example) not in rows}
    for _ in range(len(examples) - len(missing)):
        if on_row is not None:
            on_row()
    for key, row in side_by_side(_sighted, missing, workers):
        rows.add(key, row)
        if on_row is not None:
            on_row()
    nothing = [np.nan] * len(FEATURES)
    return np.array([rows[_key(example)].get("features", nothing) for example in examples], dtype=float)


def _key(example: Example) -> str:
    return f"{FORMAT} sight {example.label.bag_sha256}"


def _sighted(bag: Path) -> Row:
    """A bag's features, or why it has none."""
    try:
        return {"features": sight_of_bag(bag)}
    except PalletTwinError as error:
        return {"refused": str(error)}


def sight_of_bag(bag: Path) -> list[float]:
    """Features of a bag, from its poses at the moments of its pictures.

    Raises:
        BrokenRecording: the bag is damaged, or has no scene or no poses.
        RefusedInput: it has no pictures.
    """
    with BagReader(bag) as reader:
        scene = scene_of_bag(reader)
        if not has_pictures(reader):
            raise RefusedInput("bag", str(bag), "must hold pictures: a recipe has no moments of them")
        stamps_ns = [picture.stamp_ns for picture in pictures_of_bag(reader)]
        messages = reader.messages([topic_in_bag(reader, PACKAGES_POSES.name)])
        frames = [pose_frame_from_payload(message.payload, number) for number, message in enumerate(messages)]
    known_ns = np.array([frame.stamp_ns for frame in frames])
    seen = [frames[int(np.abs(known_ns - stamp_ns).argmin())] for stamp_ns in stamps_ns]
    pallet = scene.pallet_box
    deck_m = pallet.size_m[2] if pallet is not None else 0.0
    sizes = [
        pallet.size_m if pallet is not None else (0.0, 0.0, 0.0),
        *(box.size_m for box in scene.packages),
    ]
    half = 0.5 * np.array(sizes)
    corners = np.array([box_corners(frame.positions, frame.orientations, half) for frame in seen])
    facing, normal = facing_packages(scene), side_of(scene).normal
    moved = (corners - corners[0])[:, facing]
    across = np.linalg.norm(moved - (moved @ normal)[..., None] * normal, axis=3)
    height_m, limits = float(corners[0, ..., 2].max()), scene.limits
    on_pallet = corners[0, facing, :, 2] <= deck_m + limits.base_height_m + TIE_M
    share = max(
        across.max() / (limits.elastic_fraction * height_m),
        across[-1].max() / (limits.permanent_fraction * height_m),
        across[-1][on_pallet].max(initial=0.0) / limits.base_permanent_m,
    )
    logarithm = float(np.log(np.clip(share, _LEAST, _MOST)))
    return [logarithm, float(_lost(seen[0], seen[-1], half)[facing].any())]


def _lost(first: PoseFrame, last: PoseFrame, half: Array) -> Array:
    """Which bodies have toppled or fallen between two frames, as the judge has it, shape [n]."""
    up = rotation_matrices(last.orientations)[:, 2, 2]
    tilts_deg = np.degrees(np.arccos(np.clip(up, -1.0, 1.0)))
    drop = first.positions[:, 2] - last.positions[:, 2]
    return np.asarray((tilts_deg > TOPPLED_TILT_DEG) | (drop > np.maximum(half[:, 2], 0.02)))
