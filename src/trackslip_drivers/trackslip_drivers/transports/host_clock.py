# SPDX-License-Identifier: Apache-2.0
"""Reads the host's clock and the steady one together, for whichever thread asks."""

import threading
import time

from trackslip_drivers.stamping import HostTime

_TOGETHER_NS = 1_000_000  # two readings further apart were interrupted, and say nothing


class HostClock:
    """Steady time for arrivals and time-outs, stamps for messages."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        steady_ns = time.monotonic_ns()
        self._time = HostTime(time.time_ns() - steady_ns, steady_ns)

    @property
    def lead_ns(self) -> int:
        """How far stamps are ahead of the host's clock, since that was set back."""
        return self._time.lead_ns

    def look(self) -> bool:
        """Compare the clocks; whether the host's has jumped since the last look."""
        with self._lock:
            before_ns, host_ns, after_ns = time.monotonic_ns(), time.time_ns(), time.monotonic_ns()
            if after_ns - before_ns > _TOGETHER_NS or before_ns < self._time.looked_ns:
                return False
            return self._time.look(host_ns, before_ns)

    def steady(self, host_ns: int) -> int:
        """Steady time of an arrival; call ``look`` first."""
        with self._lock:
            return self._time.steady(host_ns)

    def stamp(self, steady_ns: int) -> int:
        """Time on the host's clock, as it goes into a message."""
        with self._lock:
            return self._time.stamp(steady_ns)
