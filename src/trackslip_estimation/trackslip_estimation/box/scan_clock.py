# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Which stamps of scans are in line: by the clock monitor, at whatever pace scans come.

Scans thinned to one in ten seconds are no clock set ahead: stamps further apart than the gap are refused
until as many as confirm a jump have come at like steps. From then on, until scans come faster, the gap is two
of these steps.
"""

from trackslip_common.clock_monitor import ClockMonitor, StampStatus

ALIKE = 2.0  # ratio of steps up to which they agree


class ScanClock:
    """Checks stamps as they come, each of which must be later than the one before."""

    def __init__(self, gap_ns: int, confirmations: int) -> None:
        self._gap_ns = gap_ns
        self._confirmations = confirmations
        self._monitor = ClockMonitor(gap_ns, confirmations)
        self._slow = False  # whether the monitor's gap is longer than ours
        self._last_ns = 0  # stamp, whatever was made of it
        self._step_ns = 0
        self._alike = 0  # steps in a row

    def check(self, stamp_ns: int) -> StampStatus:
        """Where a scan's stamp lies."""
        head_ns = self._monitor.head_ns
        step_ns = stamp_ns - self._last_ns
        agrees = step_ns < ALIKE * self._step_ns < ALIKE**2 * step_ns
        self._alike = self._alike + 1 if agrees else 1
        self._last_ns, self._step_ns = stamp_ns, step_ns
        status = self._monitor.sample(stamp_ns, None if head_ns is None else head_ns + 1)
        if status is StampStatus.AHEAD and self._alike >= self._confirmations:
            return self._restarted(stamp_ns, round(ALIKE * step_ns))
        if status is StampStatus.IN_LINE and self._slow and step_ns <= self._gap_ns:
            return self._restarted(stamp_ns, self._gap_ns)
        return status

    def _restarted(self, stamp_ns: int, gap_ns: int) -> StampStatus:
        """From this stamp on with another gap."""
        self._slow = gap_ns > self._gap_ns
        self._monitor = ClockMonitor(gap_ns, self._confirmations)
        return self._monitor.sample(stamp_ns)
