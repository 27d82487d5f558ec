# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Silence after which a source is lost: its timeout, or three of its periods if these are longer.

T      timeout of the source
P      usual period of the source: median of the intervals between its messages
T_l    max(T, 3 P), silence after which the source is lost

A receiver of 1 Hz with a timeout of 1 s is not lost between two fixes. All times have one unit.
"""

from collections import deque

import numpy as np
from numpy.typing import NDArray

_PERIODS = 3.0
_LATEST = 9  # number of latest intervals, so that P follows a changed rate


def silence_limit(timeout: float, period: float) -> float:
    """T_l of T and P; the timeout where the period is nan."""
    return max(timeout, _PERIODS * period) if period > 0.0 else timeout


def usual_period(times: NDArray[np.float64]) -> float:
    """P of (n,) times of messages; nan if fewer than two differ."""
    intervals = np.diff(np.sort(times))
    intervals = intervals[intervals > 0.0]
    return float(np.median(intervals)) if len(intervals) else float("nan")


class SilenceMonitor:
    """Measures the period of one source, and from it the silence after which the source is lost."""

    def __init__(self) -> None:
        self._last: float | None = None
        self._intervals: deque[float] = deque(maxlen=_LATEST)

    def add(self, time: float) -> None:
        """Add a message, whether it is used or not."""
        if self._last is not None and time > self._last:
            self._intervals.append(time - self._last)
        self._last = time

    def limit(self, timeout: float) -> float:
        """T_l. After one message the period is unknown, and the timeout is taken for it."""
        if self._last is None:
            return timeout
        return silence_limit(timeout, float(np.median(self._intervals)) if self._intervals else timeout)

    def is_silent(self, time: float, timeout: float) -> bool:
        """Whether the last message is older than T_l; not before the first one."""
        return self._last is not None and time - self._last > self.limit(timeout)
