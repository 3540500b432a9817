"""Keeps a sender of pose frames within reach of the readers that answer: an acknowledged message is not yet taken."""

import threading
import time
from collections import deque
from collections.abc import Callable, Sequence

ANSWER_LIMIT_S = 120.0
"""The first picture of a wrapped load takes the longest."""
POLL_S = 0.1


class AnswerWindow:
    """Counts frames that were sent and that not every reader has answered; any thread may call it.

    The middleware acknowledges what has reached a reader's queue, which drops its oldest message when it is full. Only
    the reader's own answers tell what it has dealt with.

    Args:
        names: the topics of the answers.
        frames: how many frames may be unanswered.
    """

    def __init__(self, names: Sequence[str], frames: int) -> None:
        self._answered = dict.fromkeys(names, -1)
        self._frames = frames
        self._ahead: deque[int] = deque()
        self._changed = threading.Condition()

    def take(self, name: str, stamp_ns: int) -> None:
        """Takes an answer: its reader has dealt with everything up to a stamp [ns]."""
        with self._changed:
            self._answered[name] = max(self._answered[name], stamp_ns)
            until_ns = min(self._answered.values())
            while self._ahead and self._ahead[0] <= until_ns:
                self._ahead.popleft()
            self._changed.notify()

    def wait_for_room(self, stamp_ns: int, is_stopped: Callable[[], bool]) -> str | None:
        """Waits until the frame of a stamp [ns] may leave, or it is stopped; the silent topic when none answered."""
        deadline = time.monotonic() + ANSWER_LIMIT_S
        with self._changed:
            while len(self._ahead) >= self._frames and not is_stopped():
                self._changed.wait(POLL_S)
                if time.monotonic() > deadline:
                    return min(self._answered, key=self._answered.__getitem__)
            self._ahead.append(stamp_ns)
        return None

    def forget(self) -> None:
        """Begins anew with what is sent from now on."""
        with self._changed:
            self._ahead.clear()
            self._changed.notify()
