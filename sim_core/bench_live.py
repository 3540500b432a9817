"""The sled's samples while the machine still moves: from one reading of its accelerometer to the next.

As ``bench_signal`` does for a recording, but for what only the end of a test can tell: the standstill before the motion
gives gravity and bias, the first moments of the rise the direction of the travel, and what is left of the speed when
the sled stands again is taken off then, and not over the motion.
"""

from collections import deque
from dataclasses import dataclass
from typing import Literal

import numpy as np

from config.errors import RefusedInput
from config.scene import direction_vector
from sim_core.bench_signal import (
    COASTING_SHARE,
    LEAST_CROSSING_MPS2,
    LONGEST_GAP_S,
    MOST_CROSSING_MPS2,
    WINDOW_S,
)
from sim_core.frames import Array

LEAST_WATCH_S = 0.25
"""So long the bench is only watched."""
LEAST_READINGS, REST_READINGS = 20, 5000
"""So many readings at rest are needed before a motion is looked for; and about so many of the last ones count."""
RISE_S = 0.05
"""So much of the motion must be seen before its direction is believed; samples are late by that once, then no more."""
STANDS_S = 0.1
"""The sled stands when it has not been accelerated for this long and has next to no speed."""
State = Literal["waiting", "rising", "moving", "standing"]


@dataclass(frozen=True, eq=False)
class LiveSample:
    """One sample of the sled.

    Attributes:
        index: running number, from 0.
        acceleration: mean over the interval, frame ``world`` [m/s²], shape [3]; 0 for the first.
    """

    index: int
    acceleration: Array


class LiveSled:
    """Turns readings into samples as they come.

    Args:
        samples_hz: rate of the samples.
        direction: of the travel in frame ``sled``.
        lead_s: standstill before the motion that samples begin with [s].

    Attributes:
        state: ``waiting`` for a motion; ``rising``, its direction still unknown; ``moving``; ``standing`` again.
        start_s: time of sample 0 on the readings' clock [s]; None while waiting.
        left_mps: speed that was taken off when the sled stood [m/s].
    """

    def __init__(self, *, samples_hz: int, direction: str | float = "+x", lead_s: float = 0.1) -> None:
        self._rate, self._lead_s = samples_hz, lead_s
        x, y = direction_vector(direction)
        self._travel = np.array([x, y, 0.0])
        self.state: State = "waiting"
        self.start_s: float | None = None
        self.left_mps = 0.0
        # Readings that may belong to the motion already; older ones are at rest.
        self._readings: deque[tuple[float, Array]] = deque()
        self._rest, self._square_step, self._before = np.zeros(3), np.zeros(3), np.zeros(3)
        self._rest_count, self._square_away, self._since_s = 0, 0.0, np.inf
        self._axis = np.zeros(3)
        self._limit = self._onset_s = self._last_s = self._last = self._smooth = 0.0
        self._speed = self._peak_speed = 0.0
        self._quiet_since_s: float | None = None
        # Speed at the sample that was given out last, and number of the next.
        self._given_speed, self._next = 0.0, 0
        self._closing = 0.0

    def add(self, time_s: float, force: Array) -> list[LiveSample]:
        """Takes the next reading, specific force in the sensor's axes [m/s²]; gives the samples that it completes.

        Raises:
            RefusedInput: the sensor was silent too long while the sled moved, or time does not advance.
        """
        if self._readings and time_s <= self._readings[-1][0]:
            raise RefusedInput("sled/accelerometer", time_s, "time must advance from reading to reading")
        silent_s = time_s - self._readings[-1][0] if self._readings else 0.0
        if self.state in ("rising", "moving") and silent_s > LONGEST_GAP_S:
            raise RefusedInput(
                "sled/accelerometer",
                f"a gap of {1000.0 * silent_s:.1f} ms",
                f"must not be silent for more than {1000.0 * LONGEST_GAP_S:.0f} ms while the sled moves",
            )
        self._readings.append((time_s, force))
        if self.state == "waiting":
            self._since_s = min(self._since_s, time_s)
            self._look_for_motion(time_s)
            return []
        if self.state == "rising":
            return self._begin() if time_s >= self._onset_s + RISE_S else []
        self._readings.popleft()
        return self._advance(time_s, float((force - self._rest) @ self._axis))

    def next_standing(self) -> LiveSample:
        """The next sample of a sled that stands, whether or not readings come."""
        return self._sample(0.0)

    def _look_for_motion(self, time_s: float) -> None:
        while self._readings[0][0] < time_s - 3.0 * WINDOW_S:
            self._take_rest(self._readings.popleft()[1])
        if self._rest_count < LEAST_READINGS:
            return
        recent = [force for at_s, force in self._readings if at_s > time_s - WINDOW_S]
        away = float(np.linalg.norm(np.mean(recent, axis=0) - self._rest))
        noise = np.sqrt(0.5 * float(self._square_step.sum()))
        # A bench that hums is not a sled that moves.
        hum = min(4.0 * np.sqrt(self._square_away), MOST_CROSSING_MPS2)
        self._limit = max(LEAST_CROSSING_MPS2, 4.0 * noise / np.sqrt(len(recent)), hum)
        share = max(1.0 / self._rest_count, 1.0 / REST_READINGS)
        self._square_away += share * (min(away, self._limit) ** 2 - self._square_away)
        if away > self._limit and time_s > self._since_s + LEAST_WATCH_S:
            self.state = "rising"
            self._onset_s = time_s - 2.0 * WINDOW_S
            self.start_s = self._onset_s - self._lead_s

    def _take_rest(self, force: Array) -> None:
        """Mean, and mean square of the steps from reading to reading: over all, and the last thousands when long."""
        self._rest_count += 1
        share = max(1.0 / self._rest_count, 1.0 / REST_READINGS)
        self._rest = self._rest + share * (force - self._rest)
        if self._rest_count > 1:
            self._square_step = self._square_step + share * ((force - self._before) ** 2 - self._square_step)
        self._before = force

    def _begin(self) -> list[LiveSample]:
        """Finds the direction, and gives out what has been waiting for it."""
        self.state = "moving"
        moving = [(time_s, force - self._rest) for time_s, force in self._readings if time_s > self._onset_s]
        # The strongest count most: their noise is the smallest share.
        pull = np.sum([np.linalg.norm(moved) * moved for _, moved in moving], axis=0)
        self._axis = pull / np.linalg.norm(pull)
        self._last_s = self._onset_s
        samples = [
            sample for time_s, moved in moving for sample in self._advance(time_s, float(moved @ self._axis))
        ]
        self._readings = deque([self._readings[-1]])
        return samples

    def _advance(self, time_s: float, along: float) -> list[LiveSample]:
        """Integrates the line to a reading, and gives out the samples that end before it."""
        samples = []
        assert self.start_s is not None
        slope = (along - self._last) / (time_s - self._last_s)
        while (due_s := self.start_s + self._next / self._rate) <= time_s:
            past = max(0.0, due_s - self._last_s)
            samples.append(self._sample(self._speed + self._last * past + 0.5 * slope * past**2))
        if self.state == "moving":
            self._speed += 0.5 * (self._last + along) * (time_s - self._last_s)
            self._peak_speed = max(self._peak_speed, abs(self._speed))
            self._look_for_rest(time_s, along)
        self._last_s, self._last = time_s, along if self.state == "moving" else 0.0
        return samples

    def _sample(self, speed: float) -> LiveSample:
        if self.state == "standing":
            # What the drift left goes over as long as it took to see it.
            speed = self._given_speed - np.clip(self._given_speed, -self._closing, self._closing)
        change = speed - self._given_speed if self._next else 0.0
        self._given_speed = speed
        self._next += 1
        return LiveSample(self._next - 1, change * self._rate * self._travel)

    def _look_for_rest(self, time_s: float, along: float) -> None:
        """A running mean over the window that stays small, with next to no speed, is a sled that stands."""
        share = min(1.0, (time_s - self._last_s) / WINDOW_S)
        self._smooth += share * (along - self._smooth)
        is_quiet = abs(self._smooth) < self._limit and abs(self._speed) < COASTING_SHARE * self._peak_speed
        if not is_quiet:
            self._quiet_since_s = None
        elif self._quiet_since_s is None:
            self._quiet_since_s = time_s
        elif time_s - self._quiet_since_s > STANDS_S:
            self.state, self.left_mps = "standing", self._speed
            self._closing = abs(self._given_speed) / (STANDS_S * self._rate)
            self._speed = 0.0
