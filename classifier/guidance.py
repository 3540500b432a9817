"""How far a test's load truly stood from its place at each picture: what training, and training alone, is guided by."""

import os
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from classifier.clips import require_digest, stamped_pictures_in
from classifier.examples import Example
from classifier.side_by_side import side_by_side
from config.errors import BrokenRecording, RefusedInput
from recordings.bag_pictures import has_pictures, pictures_of_bag
from recordings.bag_reader import BagReader
from recordings.judge_bag import judge_bag
from sim_core.judge import BAND_COUNT

Guide = NDArray[np.float32]

FORMAT = 1
"""Version of the figures on disk; raise it when they change."""
GUIDES = 1 + BAND_COUNT
"""Figures of each picture: any part of the load, then each height band from below."""
_LEAST, _MOST = 0.05, 8.0
"""Shares of the limit below and above which displacement is all one."""


class GuideCache:
    """True displacement in a folder, each bag's made once; several processes can fill and read it at once.

    Args:
        folder: made when it is first written to.
    """

    def __init__(self, folder: Path) -> None:
        self._own = folder / f"guide-{FORMAT}"

    def prepare(
        self,
        examples: Sequence[Example],
        *,
        workers: int = 1,
        on_progress: Callable[[int, int, object], None] | None = None,
    ) -> None:
        """Makes all figures that are not yet there.

        Args:
            examples: whose figures are wanted.
            workers: processes; 1 makes them here.
            on_progress: told how many are there, of how many, and a word on it.

        Raises:
            BrokenRecording: see ``guide_of_bag``.
            RefusedInput: the folder cannot be written, or a worker died.
        """
        missing = {
            example.label.bag_sha256: example for example in examples if not self._path(example).is_file()
        }
        done = len(examples) - len(missing)
        for _, refused in side_by_side(partial(_made, self), missing, workers):
            if refused is not None:
                raise BrokenRecording(*refused)
            done += 1
            if on_progress is not None:
                on_progress(done, len(examples), "true displacement")

    def guide(self, example: Example) -> Guide:
        """Figures of a test's pictures, shape [picture_count, GUIDES]; made where they are not on disk.

        Raises:
            BrokenRecording: see ``guide_of_bag``.
            RefusedInput: the folder cannot be written.
        """
        path = self._path(example)
        try:
            return np.asarray(np.load(path), dtype=np.float32)
        except (OSError, ValueError, EOFError):
            pass
        require_digest(example.bag, example.label.bag_sha256)
        found = guide_of_bag(example.bag)
        try:
            self._own.mkdir(parents=True, exist_ok=True)
            scratch = path.with_suffix(f".{os.getpid()}.part")
            with scratch.open("wb") as file:
                np.save(file, found)
            scratch.replace(path)
        except OSError as error:
            what = error.strerror or "cannot be written"
            raise RefusedInput("--cache", str(self._own), f"{what}; name another folder") from None
        return found

    def _path(self, example: Example) -> Path:
        return self._own / f"{example.label.bag_sha256}.npy"


def guide_of_bag(bag: Path) -> Guide:
    """Logarithms of true displacement at each picture, as shares of the permanent limit, shape [picture_count, GUIDES].

    Args:
        bag: of a test, with its poses and its pictures.

    Raises:
        BrokenRecording: the bag is damaged, or lacks poses or pictures.
    """
    scene, judge = judge_bag(bag)
    with BagReader(bag) as reader:
        # Stamps alone need no decoding, but those of a recipe are known only once it is drawn.
        recorded = [picture.stamp_ns for picture in pictures_of_bag(reader)] if has_pictures(reader) else []
    stamps_ns = np.array(recorded or [stamp_ns for stamp_ns, _ in stamped_pictures_in(bag)])
    series = judge.series(rate_hz=np.inf)
    moments_ns = judge.moments()[0].frame.stamp_ns + 1.0e9 * np.array(series.times_s)
    nearest = np.abs(stamps_ns[:, None] - moments_ns).argmin(axis=1)
    # A band without corners moves as the one below it; the lowest always has some.
    rows = np.searchsorted(series.bands, np.arange(BAND_COUNT), side="right") - 1
    bands = np.array(series.displacement_mm)[np.maximum(rows, 0)][:, nearest].T
    limit_mm = 1000.0 * scene.limits.permanent_fraction * judge.height_m
    shares = np.column_stack((bands.max(axis=1), bands)) / limit_mm
    return np.log(np.clip(shares, 0.0, _MOST) + _LEAST).astype(np.float32)


def stretched_guide(guide: Guide, factor: float) -> Guide:
    """The same figures, had the load moved that many times as far."""
    if factor == 1.0:
        return guide
    return np.log(np.clip((np.exp(guide) - _LEAST) * factor, 0.0, _MOST) + _LEAST).astype(np.float32)


def _made(cache: GuideCache, example: Example) -> tuple[str, str, str] | None:
    """In a worker: what refuses it comes back as a value, since errors of three parts do not travel."""
    try:
        cache.guide(example)
    except BrokenRecording as broken:
        return broken.field, str(broken.value), broken.limit
    return None
