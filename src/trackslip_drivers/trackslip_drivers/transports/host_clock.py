# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Reads the host's clock and the steady clock together; safe to call from any thread."""

import threading
import time

from trackslip_drivers.stamping import HostTime

_LONGEST_READING_NS = 1_000_000  # readings further apart were interrupted, and are not used


class HostClock:
    """Gives steady times of arrivals and time-outs, and stamps of messages."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        steady_ns = time.monotonic_ns()
        self._time = HostTime(time.time_ns() - steady_ns, steady_ns)

    @property
    def lead_ns(self) -> int:
        """Lead of stamps over the host's clock since that was set back, ns."""
        return self._time.lead_ns

    def arrival(self, host_ns: int, emptied_ns: int) -> tuple[int, bool]:
        """(steady time of an arrival, whether the host's clock has jumped since the last one).

        The arrival is after ``emptied_ns`` (steady), when the port was empty. An interrupted reading of the
        clocks does not update the offset; the arrival is before its end in any case.
        """
        has_jumped = False
        with self._lock:
            before_ns, now_ns, after_ns = time.monotonic_ns(), time.time_ns(), time.monotonic_ns()
            if after_ns - before_ns <= _LONGEST_READING_NS and before_ns >= self._time.updated_ns:
                has_jumped = self._time.update_offset(now_ns, before_ns)
                after_ns = before_ns
            return self._time.steady_time(host_ns, (emptied_ns, after_ns)), has_jumped

    def stamp(self, steady_ns: int) -> int:
        """Time on the host's clock, for a message."""
        with self._lock:
            return self._time.stamp(steady_ns)
