"""Clips in batches, prepared by threads while the network works; the same batches in every run."""

import time
from collections import deque
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from classifier.augmentation import augmented, drawn_stretch, stretched
from classifier.clips import ClipCache
from classifier.examples import Example
from classifier.frames import network_input
from classifier.guidance import GUIDES, Guide, GuideCache, stretched_guide
from classifier.margins import MARGINS, margins_of
from classifier.training_config import TrainingConfig

_AHEAD = 1
"""Batches that wait for the network, beside those that each thread is at; more would only take memory."""


@dataclass(frozen=True, eq=False)
class Batch:
    """Clips for the network; short ones are filled up with their last frame.

    Attributes:
        frames: normalised, shape [batch, time, channels, size, size].
        critical: frame that changed most, of each, shape [batch].
        lengths: frames of each, shape [batch].
        failed: 1 for a failed test, 0 for a passed one, shape [batch].
        margins: how far each was from its limits, shape [batch, MARGINS]; NaN where that is not known.
        guide: what each frame is guided by, shape [batch, time, GUIDES]; NaN behind a clip's length; None without.
        loading_s: processor time that it took to prepare [s].
    """

    frames: Tensor
    critical: Tensor
    lengths: Tensor
    failed: Tensor
    margins: Tensor
    guide: Tensor | None
    loading_s: float

    @property
    def frame_count(self) -> int:
        """Frames of all clips, without what they are filled up with."""
        return int(self.lengths.sum())


class ClipBatches:
    """Gives examples as batches.

    Args:
        cache: where their clips are.
        batch: clips in each but the last.
        training: for the augmentation; None leaves the clips as they are.
        threads: that prepare batches; what they give does not depend on it.
        guides: where true displacement is; None for batches without it.
    """

    def __init__(
        self,
        cache: ClipCache,
        *,
        batch: int,
        training: TrainingConfig | None = None,
        threads: int = 1,
        guides: GuideCache | None = None,
    ) -> None:
        self._cache, self._batch, self._training, self._threads = cache, batch, training, threads
        self._guides = guides

    def batches(self, examples: Sequence[Example], *, epoch: int = 0) -> Iterator[Batch]:
        """The examples' batches, in order.

        Args:
            examples: in the order in which they are wanted.
            epoch: another one gives another augmentation.

        Raises:
            BrokenRecording: a clip is not there and its bag is damaged.
        """
        parts = deque(examples[first : first + self._batch] for first in range(0, len(examples), self._batch))
        ahead: deque[Future[Batch]] = deque()
        pool = ThreadPoolExecutor(self._threads, thread_name_prefix="clips")
        try:
            while parts or ahead:
                while parts and len(ahead) < _AHEAD + self._threads:
                    ahead.append(pool.submit(self._loaded, parts.popleft(), epoch))
                yield ahead.popleft().result()
        finally:
            pool.shutdown(cancel_futures=True)

    def _loaded(self, examples: Sequence[Example], epoch: int) -> Batch:
        began = time.thread_time()
        config = self._cache.config
        clips = [self._cache.clip(example) for example in examples]
        lengths = [len(clip.frames) for clip in clips]
        shape = (len(clips), max(lengths), config.channels, config.size_px, config.size_px)
        frames: NDArray[np.float32] = np.empty(shape, dtype=np.float32)
        guide: Guide = np.full((*shape[:2], GUIDES), np.nan, dtype=np.float32)
        failed: NDArray[np.float32] = np.empty(len(clips), dtype=np.float32)
        margins: NDArray[np.float32] = np.empty((len(clips), MARGINS), dtype=np.float32)
        for place, (example, clip) in enumerate(zip(examples, clips, strict=True)):
            pixels, factor = clip.frames, 1.0
            if self._training is not None and self._training.augmentation > 0.0:
                # By epoch and number, so that it hangs neither on the order nor on who prepares it.
                rng = np.random.default_rng([self._training.seed, epoch, example.number])
                pixels = augmented(pixels, rng, self._training)
                if config.mode == "motion":
                    factor = drawn_stretch(rng, self._training)
                    pixels = stretched(pixels, factor)
            frames[place, : lengths[place]] = network_input(pixels, config)
            known = margins_of(example.label).stretched(factor)
            failed[place], margins[place] = float(known.failed), known.figures()
            frames[place, lengths[place] :] = frames[place, lengths[place] - 1]
            if self._guides is not None:
                guide[place, : lengths[place]] = stretched_guide(
                    self._guides.guide(example)[clip.numbers], factor
                )
        return Batch(
            torch.from_numpy(frames),
            torch.tensor([clip.critical for clip in clips], dtype=torch.int64),
            torch.tensor(lengths, dtype=torch.int64),
            torch.from_numpy(failed),
            torch.from_numpy(margins),
            torch.from_numpy(guide) if self._guides is not None else None,
            time.thread_time() - began,
        )


def epoch_order(count: int, *, seed: int, epoch: int, rank: int = 0, ranks: int = 1) -> list[int]:
    """The order in which a process takes its examples in an epoch.

    Args:
        count: of all examples.
        seed: of the training.
        epoch: from 0.
        rank: of the process.
        ranks: how many processes there are. All take equally many: where they do not come out even, the first
            examples of the order are taken twice.
    """
    order = np.random.default_rng([seed, epoch]).permutation(count)
    whole = np.resize(order, -(-count // ranks) * ranks)
    return [int(index) for index in whole[rank::ranks]]
