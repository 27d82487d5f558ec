# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Stamps (times of measurement) from arrival times: jitter removed, clocks checked, in order.

    r_k, s_k  raw and filtered stamp of reading k: its arrival minus all known delays                   ns
    t_k       true stamp; r_k = t_k + d_k with a delay d_k ≥ 0                                          ns
    n_k       sender's cycles between readings k−1 and k                                                1
    P, ρ      sender's period on the host's clock is at most P (1 + ρ)                                  ns, 1

    s_k = min(r_k, s_{k−1} + n_k P (1 + ρ))

The result is never worse than raw: t_k ≤ s_k ≤ r_k by induction, as s_{k−1} ≥ t_{k−1} and
n_k P (1 + ρ) ≥ t_k − t_{k−1}. One prompt reading thus corrects all late ones that follow. If the sender does
not count its cycles, n_k is the nearest whole number, which is right while the error of s_{k−1} is below half
a period.

Arrivals are on the steady clock, which is never set. Only the final stamp is converted to the host's clock.
"""

from dataclasses import dataclass
from enum import Enum

_LONGEST_GAP = 12  # cycles; beyond, the sender may have restarted, or its 4-bit count may have wrapped

_DAY_NS = 86_400_000_000_000
_LONGEST_SILENCE_NS = 3_600_000_000_000  # of a sender whose clock is assumed to have continued
_SAME_READING_NS = 500_000_000  # between messages of one reading: half of the longest usual period

_JUMP_NS = 20_000_000  # change of the host's clock that exceeds any slewing
_SLEW_LIMIT = 1e-3  # relative to the time between checks; ntpd and chronyd stay below
_SUSPENSION_NS = 400_000_000  # between two steps of reading, which take no longer than 0.1 s
_PROMPTNESS_NS = 20_000_000  # greatest lateness of a prompt read


class StampEvent(Enum):
    """Events of a stamp or a clock."""

    SHIFTED = "stamp shifted to keep the order"
    CLOCK_JUMPED = "jumped"
    DELAYED = "delayed while the host was suspended"


class PeriodicStamps:
    """The filter above, for one kind of reading of one sender.

    Args:
        period_ns: P.
        tolerance: ρ, of sender and host together.
        patience: after this many consecutive readings later than modelled, the next raw stamp is used: the
            period may be longer, or the sender may have restarted.
    """

    def __init__(self, period_ns: float, tolerance: float, patience: int) -> None:
        self._period_ns = period_ns
        self._step_ns = period_ns * (1.0 + tolerance)
        self._patience = patience
        self._last_ns: float | None = None
        self._late = 0

    def filter(self, raw_ns: int, cycles: int | None = None) -> int:
        """The stamp of one reading; ``cycles`` is n_k: 0 if unknown, as after a start; None: not counted."""
        if self._last_ns is None or self._late >= self._patience:
            return self._restart_from(raw_ns)
        if cycles is None:
            cycles = max(1, round((raw_ns - self._last_ns) / self._period_ns))
        if not 0 < cycles <= _LONGEST_GAP:
            return self._restart_from(raw_ns)
        modelled_ns = self._last_ns + cycles * self._step_ns
        if raw_ns <= modelled_ns:
            return self._restart_from(raw_ns)
        self._late += 1
        self._last_ns = modelled_ns
        return round(modelled_ns)

    def restart(self) -> None:
        """Restart: the next reading may not continue the previous ones."""
        self._last_ns = None

    def _restart_from(self, raw_ns: int) -> int:
        self._last_ns = raw_ns
        self._late = 0
        return raw_ns


class SenderClock:
    """The filter for a sender that states the time u_k of each reading, on its own clock.

    s_k = min(r_k, s_{k−1} + (u_k − u_{k−1}) (1 + ρ)): the sender's clock replaces n_k P. Only differences of
    its time of day are used, so an offset, midnight, a wrong week and a wrong year have no effect. If the
    clock goes back (a leap second, a correction), the filter restarts; if it goes ahead, r_k is the smaller.
    A backlog that arrives at once keeps its times of measurement.

    Args:
        tolerance: ρ, of both clocks together.
        patience: after this many consecutive readings later than modelled, the model is shifted to the least
            late of them.

    Attributes:
        unchanged_ns: time for which the sender has stated the time of its latest reading.
    """

    def __init__(self, tolerance: float, patience: int) -> None:
        self.unchanged_ns = 0
        self._pace = 1.0 + tolerance
        self._patience = patience
        self._first_ns = 0  # arrival of the first message with the time of the latest reading
        self._stated_ns: int | None = None  # of the last reading, as the times below
        self._raw_ns = self._last_ns = 0
        self._late, self._least_late_ns = 0, _DAY_NS

    def restart(self) -> None:
        """Restart: the next reading may not continue the previous ones."""
        self._stated_ns = None

    def filter(self, raw_ns: int, stated_ns: int) -> int:
        """The stamp of a reading that the sender states to be of ``stated_ns``, time of day."""
        if stated_ns != self._stated_ns:
            self._first_ns = raw_ns
        self.unchanged_ns = raw_ns - self._first_ns
        if self._stated_ns is None:
            return self._restart_from(raw_ns, stated_ns)
        elapsed_ns = (stated_ns - self._stated_ns + _DAY_NS // 2) % _DAY_NS - _DAY_NS // 2
        if elapsed_ns == 0 and raw_ns - self._raw_ns < _SAME_READING_NS:  # another message of the reading
            self._last_ns = min(self._last_ns, raw_ns)
            return self._last_ns
        modelled_ns = self._last_ns + round(elapsed_ns * self._pace)
        if not 0 < elapsed_ns < _LONGEST_SILENCE_NS or raw_ns <= modelled_ns:
            return self._restart_from(raw_ns, stated_ns)
        if raw_ns - self._raw_ns > elapsed_ns // 2:  # else the sender is catching up
            self._late += 1
            self._least_late_ns = min(self._least_late_ns, raw_ns - modelled_ns)
        self._stated_ns, self._raw_ns, self._last_ns = stated_ns, raw_ns, modelled_ns
        if self._late >= self._patience:
            return self._restart_from(modelled_ns + self._least_late_ns, stated_ns)
        return modelled_ns

    def _restart_from(self, stamp_ns: int, stated_ns: int) -> int:
        self._stated_ns, self._raw_ns, self._last_ns = stated_ns, stamp_ns, stamp_ns
        self._late, self._least_late_ns = 0, _DAY_NS
        return stamp_ns


class BacklogDetector:
    """Detects reads of data that are late because the host was suspended, stopped or starved.

    The arrival of such bytes is unknown, and one read does not return all of them. The backlog ends with a
    read of no more than the line carries since the previous read.
    """

    def __init__(self) -> None:
        self._last_read_ns: int | None = None
        self._is_waiting = False

    def is_backlog(self, transfer_ns: int, arrival_ns: int) -> bool:
        """Whether a read is part of a backlog; ``transfer_ns``: time of its bytes on the line (0: none)."""
        since_ns = 0 if self._last_read_ns is None else arrival_ns - self._last_read_ns
        self._last_read_ns = arrival_ns
        is_late = since_ns >= _SUSPENSION_NS or (self._is_waiting and transfer_ns > since_ns + _PROMPTNESS_NS)
        self._is_waiting = is_late and transfer_ns > 0
        return self._is_waiting


class ReadMonitor:
    """Records when a port was last empty, and whether its reader was suspended since.

    Data read now arrived after ``emptied_ns``; if the reader was suspended, they may be late by any time.
    Each step of reading is registered, so a delay anywhere is detected.

    Args:
        opening_ns: steady time before the port was opened.

    Attributes:
        emptied_ns: steady time at which the port was empty.
        was_suspended: data read now may be late by an unknown time, unless they have their own stamp.
    """

    def __init__(self, opening_ns: int) -> None:
        self.emptied_ns = opening_ns
        self.was_suspended = False
        self._step_ns: int | None = None

    def record_step(self, now_ns: int) -> None:
        """Register that the port is about to be read, or has been."""
        if self._step_ns is not None:
            self.was_suspended |= now_ns - self._step_ns >= _SUSPENSION_NS
        self._step_ns = now_ns

    def record_empty_port(self) -> None:
        """Register that the port was empty at the last step."""
        if self._step_ns is not None:
            self.emptied_ns, self.was_suspended = self._step_ns, False

    def can_be_delayed(self, arrived_ns: int, now_ns: int) -> bool:
        """Whether data that seem to have arrived just before ``now_ns`` (both steady) may be late."""
        return self.was_suspended and now_ns - arrived_ns < _PROMPTNESS_NS


@dataclass
class HostTime:
    """The host's clock relative to the steady clock; the host's clock may be set at any time.

    A step forward is followed. After a step backward, stamps stay ahead of the host's clock by ``lead_ns``,
    until that clock is set forward again or the driver is activated again. Slewing is followed.
    """

    offset_ns: int  # host's clock minus steady clock, at the last check
    updated_ns: int  # steady time of that check
    lead_ns: int = 0

    def update_offset(self, host_ns: int, steady_ns: int) -> bool:
        """Update the offset from both clocks, read together; returns whether the host's clock has jumped."""
        change_ns = host_ns - steady_ns - self.offset_ns
        jumped = abs(change_ns) > _JUMP_NS + _SLEW_LIMIT * (steady_ns - self.updated_ns)
        self.offset_ns += change_ns
        self.updated_ns = steady_ns
        if jumped:
            self.lead_ns = max(0, self.lead_ns - change_ns)
        return jumped

    def steady_time(self, host_ns: int, between_ns: tuple[int, int]) -> int:
        """Steady time of an arrival, stamped by the host's clock between two steady times.

        A stamp before the first of them is from before a change of the clock, or from another clock: the
        second one is returned.
        """
        earliest_ns, now_ns = between_ns
        steady_ns = min(host_ns - self.offset_ns, now_ns)
        return steady_ns if steady_ns > earliest_ns - _JUMP_NS else now_ns

    def stamp(self, steady_ns: int) -> int:
        """The stamp of a message, on the host's clock."""
        return steady_ns + self.offset_ns + self.lead_ns


class MonotonicStamps:
    """Makes the stamps of one topic strictly increasing."""

    def __init__(self) -> None:
        self._last_ns: int | None = None

    def next_stamp(self, stamp_ns: int) -> int:
        """The stamp, or the earliest one after the last."""
        if self._last_ns is not None:
            stamp_ns = max(stamp_ns, self._last_ns + 1)
        self._last_ns = stamp_ns
        return stamp_ns
