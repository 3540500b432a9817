"""Sends a recording's messages when they are due: read ahead, on a clock that can halt, with how late each left."""

import math
import threading
import time
from array import array
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from typing import Literal

from msgs_adapters.topics import Topic
from recordings.playback import PlayedMessage

READ_AHEAD_MESSAGES = 4096
READ_AHEAD_BYTES = 64 * 2**20
NAP_S = 0.001
HURRY_S = 0.05
"""Behind its time by more than this, a message leaves as in a burst: not faster than its readers acknowledge."""
STEP_LIMIT_S = 5.0


class ReadAhead:
    """Reads a source in a thread of its own, no further ahead than a bounded number of messages and bytes.

    An iterator; an error of the source is raised after the messages that came before it.
    """

    def __init__(
        self,
        source: Generator[PlayedMessage, None, None],
        *,
        messages: int = READ_AHEAD_MESSAGES,
        size_bytes: int = READ_AHEAD_BYTES,
    ) -> None:
        self._source, self._messages, self._size_bytes = source, messages, size_bytes
        self._read: deque[PlayedMessage] = deque()
        self._bytes = 0
        self._changed = threading.Condition()
        self._ended = self._closed = False
        self._error: Exception | None = None
        self._thread = threading.Thread(target=self._read_all, name="read ahead", daemon=True)
        self._thread.start()

    def __iter__(self) -> Iterator[PlayedMessage]:
        return self

    def __next__(self) -> PlayedMessage:
        with self._changed:
            self._changed.wait_for(lambda: self._read or self._ended)
            if self._read:
                message = self._read.popleft()
                self._bytes -= len(message.payload)
                self._changed.notify()
                return message
        if self._error is not None:
            raise self._error
        raise StopIteration

    def close(self) -> None:
        """Ends the thread."""
        with self._changed:
            self._closed = True
            self._changed.notify()
        self._thread.join()

    def _has_room(self) -> bool:
        few = len(self._read) < self._messages and self._bytes < self._size_bytes
        return self._closed or few

    def _read_all(self) -> None:
        try:
            for message in self._source:
                with self._changed:
                    self._changed.wait_for(self._has_room)
                    if self._closed:
                        break
                    self._read.append(message)
                    self._bytes += len(message.payload)
                    self._changed.notify()
        except Exception as error:
            # Whatever it is, it belongs to whoever takes the messages.
            self._error = error
        finally:
            self._source.close()
            with self._changed:
                self._ended = True
                self._changed.notify()


class PlaybackClock:
    """Maps log time to wall time at a rate, with halts.

    Args:
        rate: seconds of the bag a second of wall time.
    """

    def __init__(self, rate: float) -> None:
        self._rate = rate
        self._at_ns, self._at_s = 0, 0.0
        self._halted = False

    def start(self, log_ns: int, now_s: float) -> None:
        """The bag's clock stands at a log time [ns] at this wall time [s]."""
        self._at_ns, self._at_s = log_ns, now_s

    def due_s(self, log_ns: int) -> float:
        """Wall time at which a log time [ns] is reached [s], if there is no further halt."""
        return self._at_s + (log_ns - self._at_ns) * 1e-9 / self._rate

    def halt(self, now_s: float) -> None:
        """Stands still from this wall time [s] on."""
        if not self._halted:
            self.start(self._at_ns + round((now_s - self._at_s) * 1e9 * self._rate), now_s)
        self._halted = True

    def advance(self, log_ns: int) -> None:
        """Moves the hand of a clock that stands still, never back."""
        self._at_ns = max(self._at_ns, log_ns)

    def go_on(self, now_s: float) -> None:
        """Runs again from this wall time [s] on."""
        if self._halted:
            self.start(self._at_ns, now_s)
        self._halted = False


class TimingErrors:
    """How late messages left, in bins of 2 % from a microsecond to three hours: memory doesn't grow."""

    _STEP = math.log(1.02)

    def __init__(self) -> None:
        self._bins = array("Q", [0]) * 1200
        self.count = 0
        self.max_s = 0.0

    def add(self, error_s: float) -> None:
        """Takes the time between due and sent [s]."""
        index = int(math.log(max(error_s, 1e-6) / 1e-6) / self._STEP)
        self._bins[min(index, len(self._bins) - 1)] += 1
        self.count += 1
        self.max_s = max(self.max_s, error_s)

    def quantile_s(self, share: float) -> float:
        """The error that this share of messages stays within [s], up to 2 % too large; 0 without any."""
        wanted, seen = share * self.count, 0
        for index, count in enumerate(self._bins):
            seen += count
            if count and seen >= wanted:
                return min(1e-6 * math.exp((index + 1) * self._STEP), self.max_s)
        return self.max_s


Send = Callable[[PlayedMessage, bool], None]


class PacedSender:
    """Sends a recording's messages in order, each when it is due, and can be halted, stepped and begun again.

    `run` belongs into a thread of its own; everything else may be called from others.

    Args:
        opening: latched messages, sent before the others.
        stream: gives the others anew for every pass.
        send: sends one message; its second argument says that it is in a hurry, so that it must watch its readers.
        start_ns: log time of the start [ns].
        rate: seconds of the bag a second of wall time, or None: as fast as ``send`` takes them.
        passes: how often it is played; 0: until it is stopped.
        step: a step ends with the next message of this topic and all of that time, or, when None, with all
            messages of the next time.
        halted: begins halted.
    """

    def __init__(
        self,
        opening: Sequence[PlayedMessage],
        stream: Callable[[], Generator[PlayedMessage, None, None]],
        send: Send,
        *,
        start_ns: int,
        rate: float | None = 1.0,
        passes: int = 1,
        step: Topic | None = None,
        halted: bool = False,
    ) -> None:
        self._opening, self._stream, self._send = opening, stream, send
        self._start_ns, self._rate, self._wanted, self._step = start_ns, rate, passes, step
        self._clock = PlaybackClock(rate or 1.0)
        self._changed = threading.Condition()
        self._halted, self._stopped, self._restarted = halted, False, False
        self._stepping: Literal["no", "begun", "to end"] = "no"
        self._step_end_ns = 0
        self.timing = TimingErrors()
        self.sent = self.passes = self.restarts = 0
        self.position_ns = start_ns
        self.is_over = False

    def send_opening(self) -> None:
        """Sends the latched messages."""
        for message in self._opening:
            self._send(message, False)
            self.sent += 1

    def run(self) -> None:
        """Plays all passes; the opening of the first one has been sent before.

        Raises:
            BrokenRecording: the recording is damaged; everything before the damage has been sent.
        """
        try:
            while not self._stopped and (not self._wanted or self.passes < self._wanted):
                if self.passes or self.restarts:
                    self.send_opening()
                self._restarted = False
                ahead = ReadAhead(self._stream())
                try:
                    if self._play(ahead):
                        self.passes += 1
                finally:
                    ahead.close()
                self.restarts += self._restarted
        finally:
            with self._changed:
                self.is_over, self._stepping = True, "no"
                self._changed.notify_all()

    def halt(self) -> str:
        """Stands still, mid-way between two messages too; says where."""
        with self._changed:
            self._halted = True
            self._clock.halt(time.monotonic())
            self._changed.notify_all()
            return f"halted at {self.position_s:.6f} s"

    def go_on(self) -> str:
        """Goes on from where it stands; says where."""
        with self._changed:
            self._halted = False
            self._clock.go_on(time.monotonic())
            self._changed.notify_all()
            return f"playing from {self.position_s:.6f} s"

    def step(self) -> tuple[bool, str]:
        """Sends one step while halted, and waits until it has left; whether it did, and what was sent."""
        with self._changed:
            if self.is_over:
                return False, "the recording is over"
            if not self._halted:
                return False, "only while it is halted"
            before, self._stepping = self.sent, "begun"
            self._changed.notify_all()
            self._changed.wait_for(lambda: self._stepping == "no", STEP_LIMIT_S)
            sent = self.sent - before
            return sent > 0, f"{sent} messages, at {self.position_s:.6f} s"

    def restart(self) -> str:
        """Begins again at the start."""
        with self._changed:
            if self.is_over:
                return "the recording is over"
            self._restarted = True
            self._changed.notify_all()
            return "begun again"

    def stop(self) -> None:
        """Ends `run` before the next message."""
        with self._changed:
            self._stopped = True
            self._changed.notify_all()

    @property
    def is_stopped(self) -> bool:
        """Whether somebody asked it to end."""
        return self._stopped

    @property
    def position_s(self) -> float:
        """Log time of the newest message sent, after the start [s]."""
        return (self.position_ns - self._start_ns) * 1e-9

    def _play(self, messages: Iterator[PlayedMessage]) -> bool:
        """One pass; False when it was stopped or begun again."""
        self.position_ns, is_first = self._start_ns, True
        with self._changed:
            self._end_step()
        for message in messages:
            if is_first:
                # Time runs once the first message has been read.
                self._clock.start(self._start_ns, time.monotonic())
                if self._halted:
                    self._clock.halt(time.monotonic())
                is_first = False
            is_hurried = self._wait_until_due(message)
            if is_hurried is None:
                return False
            self._send(message, is_hurried)
            self.sent += 1
            self.position_ns = message.log_time_ns
        return not self._stopped

    def _wait_until_due(self, message: PlayedMessage) -> bool | None:
        """Waits for a message's time; whether it is late for it, or None when it must not leave."""
        with self._changed:
            while not self._stopped and not self._restarted:
                if self._halted:
                    if self._is_in_step(message):
                        self._clock.advance(message.log_time_ns)
                        return False
                    self._changed.wait()
                    continue
                if self._rate is None:
                    return True
                late_s = time.monotonic() - self._clock.due_s(message.log_time_ns)
                if late_s >= 0.0:
                    self.timing.add(late_s)
                    return late_s > HURRY_S
                if late_s < -2.0 * NAP_S:
                    self._changed.wait(-late_s - NAP_S)
                else:
                    time.sleep(-late_s)
            return None

    def _is_in_step(self, message: PlayedMessage) -> bool:
        if self._stepping == "begun" and (self._step is None or message.topic == self._step):
            self._stepping, self._step_end_ns = "to end", message.log_time_ns
        if self._stepping == "to end" and message.log_time_ns > self._step_end_ns:
            self._end_step()
        return self._stepping != "no"

    def _end_step(self) -> None:
        if self._stepping == "to end":
            self._stepping = "no"
            self._changed.notify_all()
