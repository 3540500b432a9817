"""Displacement measured from the pictures that the network sees, as features for a plain baseline."""

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import cv2
import numpy as np

from classifier.clips import stamped_pictures_in
from classifier.examples import Example
from classifier.rows import Row, Rows
from classifier.side_by_side import side_by_side
from config.errors import PalletTwinError
from recordings.bag_pictures import calibration_of_bag
from recordings.bag_reader import BagReader
from recordings.judge_bag import scene_of_bag
from sim_core.frames import Array
from sim_core.judge import BAND_COUNT
from sim_core.vision.measure import DisplacementMeasurer
from sim_core.vision.verdict import MeasuredTest

FORMAT = 1
"""Version of the features on disk; raise it when they, or what is measured, change."""
RULES = ("permanent", "permanent_on_pallet", "elastic")
FEATURES = (
    *(f"{rule} of its limit" for rule in RULES),
    *(f"{kind} of band {band}" for kind in ("peak", "last") for band in range(BAND_COUNT)),
    "pictures in which packages are lost", "packages lost at the end", "rules without a measurement",
)  # fmt: skip
WIDTH_PX = 1920
"""To about which small pictures are enlarged: the measurement looks for targets of so many pixels."""
LEAST, MOST = 0.01, 10.0
"""Shares of a limit below and above these are all one."""


def measured_features(
    examples: Sequence[Example], rows: Rows, *, workers: int = 1, on_row: Callable[[], None] | None = None
) -> tuple[Array, list[str | None]]:
    """Features of each test, and why it could not be measured; tests that are there are not measured again.

    Args:
        examples: the tests.
        rows: where features are kept, by the digest of the bag.
        workers: processes that measure; 1: this one.
        on_row: told after each test.

    Returns:
        Features, shape [n, feature_count], NaN where a test was not measured; and the reason, or None.
    """
    missing = {_key(example): example.bag for example in examples if _key(example) not in rows}
    if on_row is not None:
        for _ in range(len(examples) - len(missing)):
            on_row()
    for key, row in side_by_side(_measured, missing, workers):
        rows.add(key, row)
        if on_row is not None:
            on_row()
    found = [rows[_key(example)] for example in examples]
    nothing = [np.nan] * len(FEATURES)
    return np.array([row.get("features", nothing) for row in found], dtype=float), [
        row.get("refused") for row in found
    ]


def features_of(measured: MeasuredTest, lost: Array, *, deck_m: float) -> list[float]:
    """Logarithms of measured displacements as shares of their limits, and how much was lost from sight.

    Args:
        measured: the test as its pictures show it.
        lost: whether each package is lost in each picture, shape [picture_count, package_count].
        deck_m: height of what the load stands on, above the sled's top: where the bands begin [m].
    """
    rules = {rule.rule: rule for rule in measured.rules}
    shares = [_share(rules[name].worst_mm, rules[name].limit_mm) for name in RULES]
    elastic, permanent = rules["elastic"].limit_mm, rules["permanent"].limit_mm
    bands = {round((band.low_m - deck_m) / (band.high_m - band.low_m)): band for band in measured.bands}
    peaks, lasts = [], []
    for number in range(BAND_COUNT):
        # A band that no visible corner is in moves like the one next to it.
        band = bands[min(bands, key=partial(_apart, number))]
        peaks.append(_share(band.elastic.worst_mm if band.elastic is not None else None, elastic))
        lasts.append(_share(band.permanent.worst_mm if band.permanent is not None else None, permanent))
    unknown = sum(rules[name].worst_mm is None for name in RULES)
    return [*shares, *peaks, *lasts, float(lost.mean()), float(lost[-1].mean()), float(unknown)]


def _share(worst_mm: float | None, limit_mm: float | None) -> float:
    """Logarithm of a displacement as a share of its limit; what is not seen counts as at the limit."""
    if worst_mm is None or not limit_mm:
        return 0.0
    return float(np.log(np.clip(worst_mm / limit_mm, LEAST, MOST)))


def _apart(number: int, other: int) -> int:
    return abs(number - other)


def _enlarged(matrix: Array, times: int) -> Array:
    """Intrinsics of a picture that many times as large; pixel centres have whole numbers in both."""
    larger = matrix * times
    larger[:2, 2] += 0.5 * (times - 1.0)
    larger[2] = matrix[2]
    return larger


def _key(example: Example) -> str:
    return f"{FORMAT} {example.label.bag_sha256}"


def _measured(bag: Path) -> Row:
    """A bag's features, or why it has none."""
    try:
        with BagReader(bag) as reader:
            scene, calibration = scene_of_bag(reader), calibration_of_bag(reader)
        times = max(1, round(WIDTH_PX / calibration.width))
        size = times * calibration.width, times * calibration.height
        measurer = DisplacementMeasurer(
            scene, _enlarged(calibration.matrix, times), calibration.distortion, *size
        )
        for stamp_ns, pixels in stamped_pictures_in(bag):
            larger = cv2.resize(pixels, size, interpolation=cv2.INTER_CUBIC) if times > 1 else pixels
            measurer.take(stamp_ns, np.asarray(larger, dtype=np.uint8))
        lost = np.array([[state != "tracked" for state in one.states] for one in measurer.measurements])
        pallet = scene.pallet_box
        deck_m = pallet.size_m[2] if pallet is not None else 0.0
        return {"features": features_of(measurer.result(), lost, deck_m=deck_m)}
    except PalletTwinError as error:
        return {"refused": str(error)}
