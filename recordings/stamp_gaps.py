"""Counts the messages that a regular topic lacks, from holes in its stamps, without being told its rate."""

from statistics import median

SAMPLE_COUNT = 32
_LEAST_INTERVALS = 5
_TOLERANCE = 0.2
_MOST_IRREGULAR = 0.1


class StampGaps:
    """Takes a topic's stamps in order; knows the period after some, and counts what is missing between them.

    A topic is regular when at least nine of ten intervals are whole multiples of the median one, to a fifth.
    """

    def __init__(self) -> None:
        self._first: list[int] = []
        self._last_ns: int | None = None
        self._period_ns = 0.0
        self._count = self._irregular = self._missing = 0

    def add(self, stamp_ns: int) -> None:
        """Takes the next stamp [ns]; one that went back begins anew."""
        if self._last_ns is not None and stamp_ns >= self._last_ns:
            self._first.append(stamp_ns - self._last_ns)
            if len(self._first) >= SAMPLE_COUNT:
                self._count_intervals()
        self._last_ns = stamp_ns

    @property
    def missing(self) -> int:
        """How many messages are missing; 0 for a topic that is not regular."""
        self._count_intervals()
        is_regular = self._count >= _LEAST_INTERVALS and self._irregular <= _MOST_IRREGULAR * self._count
        return self._missing if is_regular else 0

    def _count_intervals(self) -> None:
        intervals, self._first = self._first, []
        if not self._period_ns and intervals:
            self._period_ns = float(median(intervals))
        for interval_ns in intervals:
            self._count += 1
            multiple = interval_ns / self._period_ns if self._period_ns else 0.0
            if multiple < 0.5 or abs(multiple - round(multiple)) > _TOLERANCE:
                self._irregular += 1
            else:
                self._missing += round(multiple) - 1
