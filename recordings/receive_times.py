"""When messages reached the recorder, on the wall clock: kept beside the bag's simulated time, as metadata.

A bag's log times are simulated time, so that it plays in any tool as the test was. Each metadata record of this
name is about the messages since the one before it. Its keys are topics; a value is the sequence number of the
topic's first message in it, that message's reception in µs since 1970, and for each message that follows, in the
order of their sequence numbers, the µs since the one before: ``240 1700000000000000 4170 4161 4169``.
"""

from collections.abc import Iterable, Mapping

import numpy as np
from numpy.typing import NDArray

from config.errors import BrokenRecording

RECEIVE_TIMES_RECORD = "pallet-twin receive times"
BATCH_LIMIT = 65_536
"""Messages in one record at most."""

Receptions = tuple[NDArray[np.int64], NDArray[np.int64]]


class ReceiveTimes:
    """Collects what one record says."""

    def __init__(self) -> None:
        self._texts: dict[str, list[str]] = {}
        self._last_us: dict[str, int] = {}
        self._count = 0

    def __len__(self) -> int:
        return self._count

    def add(self, topic_name: str, sequence: int, receive_time_ns: int) -> None:
        """Takes the reception [ns since 1970] of a topic's next message."""
        time_us = receive_time_ns // 1000
        if topic_name in self._texts:
            self._texts[topic_name].append(str(time_us - self._last_us[topic_name]))
        else:
            self._texts[topic_name] = [str(sequence), str(time_us)]
        self._last_us[topic_name] = time_us
        self._count += 1

    def take(self) -> dict[str, str]:
        """The record's content, after which this is empty."""
        values = {name: " ".join(texts) for name, texts in self._texts.items()}
        self._texts, self._last_us, self._count = {}, {}, 0
        return values


def receive_times_of(records: Iterable[Mapping[str, str]], topic_name: str) -> Receptions:
    """Sequence numbers of a topic's messages and their receptions [ns since 1970], each of shape (n,).

    Raises:
        BrokenRecording: a record makes no sense.
    """
    sequences, times_ns = [np.empty(0, dtype=np.int64)], [np.empty(0, dtype=np.int64)]
    for record in records:
        if topic_name not in record:
            continue
        try:
            first, *steps = map(int, record[topic_name].split())
            times_ns.append(1000 * np.cumsum(np.array(steps, dtype=np.int64)))
            sequences.append(first + np.arange(len(steps), dtype=np.int64))
        except (ValueError, OverflowError):
            raise BrokenRecording(RECEIVE_TIMES_RECORD, topic_name, "is damaged") from None
    return np.concatenate(sequences), np.concatenate(times_ns)
