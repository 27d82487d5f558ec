# SPDX-License-Identifier: Apache-2.0
"""From the 12-bit count of a sprocket's encoder to a continuous position and a velocity.

    n      raw count                                  0 … 4095
    k      belt ratio, encoder turns per sprocket turn 1
    q      one count at the sprocket, 2π/(4096 k)     rad
    T      the sender's cycle                         s
    N      readings in the velocity window            1

The velocity is the slope of a least-squares line through the last N positions over the *sender's* cycles, so
the jitter of arrival times does not enter. Quantisation (uniform, q²/12 per reading) gives it the variance
q²/(N (N² − 1) T²), averaged over speeds. It is the velocity of the middle of the window, (N − 1) T/2 before
the stamp. Distance is conserved: the velocities summed over a run give it.
"""

import math
from collections import deque
from dataclasses import dataclass
from enum import Enum

COUNTS = 1 << 12  # per turn of the encoder


class EncoderEvent(Enum):
    """Why a reading gave no motion."""

    STARTED = "first reading"
    RESTARTED = "restarted after silence"  # long enough for half a turn of the encoder
    JUMP = "jump"  # further than the sprocket can have turned


@dataclass(frozen=True)
class Motion:
    """One sprocket; positive drives forward."""

    position: float  # rad, continuous
    velocity: float  # rad/s


class SprocketEncoder:
    """Unwraps one encoder.

    Args:
        belt_ratio: encoder turns per sprocket turn k.
        max_speed: fastest the sprocket can turn, rad/s; it bounds what one reading can move.
        window: readings N in the velocity fit, at least 2.
        cycle_s: the sender's cycle T, s.
    """

    def __init__(self, belt_ratio: float, max_speed: float, window: int, cycle_s: float) -> None:
        self._rad_per_count = 2.0 * math.pi / (COUNTS * belt_ratio)
        self._counts_per_cycle = max_speed * cycle_s / self._rad_per_count
        self._cycle_s = cycle_s
        self._count: int | None = None  # the last raw count used
        self._unwrapped = 0
        self._now = 0  # cycles since the start
        self._silent = 0  # cycles since the last count used
        self._history: deque[tuple[int, int]] = deque(maxlen=window)  # (cycle, unwrapped count)

    def update(self, count: int, cycles: int) -> Motion | EncoderEvent:
        """One reading, ``cycles`` of the sender after the previous one given here.

        After a silence that could hide half a turn of the encoder the position goes on from where it was:
        what was turned meanwhile is unknown, and the event says so.
        """
        self._now += cycles
        self._silent += cycles
        if self._count is None:
            self._unwrapped = count
            return self._restart(count, EncoderEvent.STARTED)
        reach = self._counts_per_cycle * self._silent + 1.0  # one count of quantisation
        if reach >= COUNTS / 2:
            return self._restart(count, EncoderEvent.RESTARTED)
        moved = (count - self._count + COUNTS // 2) % COUNTS - COUNTS // 2
        if abs(moved) > reach:
            return EncoderEvent.JUMP
        self._unwrapped += moved
        self._commit(count)
        return Motion(self._unwrapped * self._rad_per_count, self._velocity())

    def _restart(self, count: int, event: EncoderEvent) -> EncoderEvent:
        self._history.clear()
        self._commit(count)
        return event

    def _commit(self, count: int) -> None:
        self._count = count
        self._silent = 0
        self._history.append((self._now, self._unwrapped))

    def _velocity(self) -> float:
        """Slope of the least-squares line through the window, rad/s."""
        cycles = 0
        for cycle, _ in self._history:
            cycles += cycle
        mean_cycle = cycles / len(self._history)
        products = squares = 0.0
        for cycle, unwrapped in self._history:
            products += (cycle - mean_cycle) * unwrapped
            squares += (cycle - mean_cycle) ** 2
        return products / squares * self._rad_per_count / self._cycle_s
