# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Checks whether stamps continue, from stamps and counts alone, so that a replay gives the same result.

The samples of one source are the clock: sprockets for the slip estimator, machine states and pressures for
the soil estimator, scans for the box localizer. A sample out of line is a bad stamp; many consecutive ones
that agree with each other are a change of time. Agreeing stamps are no further apart than the gap, or come at
equal steps. Once such slow samples are confirmed, steps up to twice theirs are in line until they get faster.

Other sources advance the clock only while the first is silent: when their stamps, in sequence, span its
timeout without a sample of it.

After a step back into the history, new samples look like late data. Late data agree with the history; new
samples have sprocket positions that the history has at other stamps.

``CLOCK`` is the whole state: compiled code keeps it in a record; ``ClockMonitor`` is for Python.
"""

from enum import IntEnum

import numpy as np

from trackslip_common.compiled import compiled
from trackslip_common.record_types import Record, Table, dtype_of, make_table


class StampStreak(Record):
    """Consecutive stamps."""

    count: int
    first_ns: int
    last_ns: int


class Clock(Record):
    """State of a clock."""

    running: bool  # whether there was a sample
    head_ns: int  # newest stamp in line
    pace_ns: int  # two steps of samples that are slower than the gap; else 0
    ahead: StampStreak
    ahead_step_ns: int  # last step of ``ahead``
    behind: StampStreak
    late: StampStreak
    others: StampStreak  # of other sources, since the last sample


class ClockLimits(Record):
    """Limits of a clock."""

    gap_ns: int
    confirmations: int
    silence_ns: int


CLOCK, CLOCK_LIMITS = dtype_of(Clock), dtype_of(ClockLimits)
NEVER_NS = -(2**62)  # before all stamps


class StampStatus(IntEnum):
    """Position of a stamp relative to the clock."""

    IN_LINE = 0
    AHEAD = 1  # further ahead than the gap, and not (yet) confirmed
    BEHIND = 2  # before the history, and not (yet) confirmed
    BACK = 3  # the clock has gone back: everything restarts


_ADVANCING_COUNT = 3  # consecutive measurements that advance the clock
_EQUAL_STEP_RATIO = 2  # ratio below which two steps count as equal
_IN_LINE, _AHEAD, _BEHIND, _BACK = map(int, StampStatus)


@compiled
def _extend_streak(streak: StampStreak, stamp_ns: int, gap_ns: int, counts: bool) -> int:
    """Length of the streak with this stamp; a stamp that does not follow the last one restarts it."""
    if not 0 < stamp_ns - streak.last_ns <= gap_ns:
        streak.count, streak.first_ns = 0, stamp_ns
    streak.count, streak.last_ns = streak.count + (1 if counts else 0), stamp_ns
    return int(streak.count)


@compiled
def check_sample(clock: Clock, limits: ClockLimits, stamp_ns: int, oldest_ns: int, contradicts: bool) -> int:
    """Status of a sample of the source that is the clock.

    ``oldest_ns``: start of the history (``NEVER_NS``: there is none); ``contradicts``: whether the sample
    differs from the history at its stamp.
    """
    clock.others.count = 0
    if not clock.running:
        clock.pace_ns = 0
    gap_ns = max(limits.gap_ns, clock.pace_ns)
    if (clock.running and stamp_ns < max(oldest_ns, clock.head_ns - gap_ns)) or stamp_ns < oldest_ns:
        _end_streak_ahead(clock)
        confirmed = _extend_streak(clock.behind, stamp_ns, gap_ns, True) >= limits.confirmations
        return _BACK if confirmed else _BEHIND
    clock.behind.count = 0
    if not clock.running or stamp_ns > clock.head_ns:
        clock.late.count = 0
    elif _extend_streak(clock.late, stamp_ns, gap_ns, contradicts) >= limits.confirmations:
        return _BACK
    if clock.running and stamp_ns > clock.head_ns + gap_ns:
        if _extend_streak_ahead(clock, stamp_ns, gap_ns) < limits.confirmations:
            return _AHEAD
        clock.pace_ns = _EQUAL_STEP_RATIO * clock.ahead_step_ns if clock.ahead_step_ns > limits.gap_ns else 0
    elif 0 < stamp_ns - clock.head_ns <= limits.gap_ns:
        clock.pace_ns = 0
    clock.head_ns = max(clock.head_ns, stamp_ns) if clock.running else stamp_ns
    clock.running = True
    _end_streak_ahead(clock)
    return _IN_LINE


@compiled
def _extend_streak_ahead(clock: Clock, stamp_ns: int, gap_ns: int) -> int:
    """Length of the streak ahead: stamps no further apart than the gap, or at equal steps."""
    step_ns = stamp_ns - clock.ahead.last_ns
    is_equal = (
        step_ns < _EQUAL_STEP_RATIO * clock.ahead_step_ns
        and clock.ahead_step_ns < _EQUAL_STEP_RATIO * step_ns
    )
    clock.ahead_step_ns = step_ns
    return _extend_streak(clock.ahead, stamp_ns, max(gap_ns, step_ns) if is_equal else gap_ns, True)


@compiled
def _end_streak_ahead(clock: Clock) -> None:
    """End the streak ahead: the next stamp ahead is its first, one step from the head."""
    clock.ahead.count, clock.ahead.last_ns, clock.ahead_step_ns = 0, clock.head_ns, 0


@compiled
def check_other(clock: Clock, limits: ClockLimits, stamp_ns: int) -> int:
    """Status of a measurement of another source."""
    if not clock.running or stamp_ns <= clock.head_ns:
        return _IN_LINE
    streak = clock.others
    # stamps of several sources may be out of order
    if not -limits.gap_ns <= stamp_ns - streak.last_ns <= 0 or streak.count == 0:
        _extend_streak(streak, stamp_ns, limits.gap_ns, True)
    is_advancing = streak.count >= _ADVANCING_COUNT and stamp_ns - streak.first_ns >= limits.silence_ns
    if is_advancing:
        clock.head_ns = stamp_ns
    return _IN_LINE if is_advancing or stamp_ns <= clock.head_ns + limits.gap_ns else _AHEAD


@compiled
def _check_sample(
    clock: Table[Clock], limits: Table[ClockLimits], stamp_ns: int, oldest_ns: int, contradicts: bool
) -> int:
    return check_sample(clock[0], limits[0], stamp_ns, oldest_ns, contradicts)


@compiled
def _check_other(clock: Table[Clock], limits: Table[ClockLimits], stamp_ns: int) -> int:
    return check_other(clock[0], limits[0], stamp_ns)


class ClockMonitor:
    """Checks stamps one by one, for Python."""

    def __init__(self, gap_ns: int, confirmations: int, silence_ns: int = 500_000_000) -> None:
        self._clock = make_table(Clock, CLOCK, 1)
        self._limits = make_table(ClockLimits, CLOCK_LIMITS, 1)
        self._limits[:] = np.array((gap_ns, confirmations, silence_ns), CLOCK_LIMITS)

    @property
    def head_ns(self) -> int | None:
        """Newest stamp in line; None before the first sample."""
        return int(self._clock["head_ns"][0]) if self._clock["running"][0] else None

    def check_sample(
        self, stamp_ns: int, oldest_ns: int | None = None, *, contradicts: bool = False
    ) -> StampStatus:
        """Status of a sample of the source that is the clock; see ``check_sample``."""
        horizon_ns = NEVER_NS if oldest_ns is None else oldest_ns
        return StampStatus(_check_sample(self._clock, self._limits, stamp_ns, horizon_ns, contradicts))

    def check_increasing_sample(self, stamp_ns: int) -> StampStatus:
        """The same for a source whose stamps increase strictly."""
        return self.check_sample(stamp_ns, None if self.head_ns is None else self.head_ns + 1)

    def check_other(self, stamp_ns: int) -> StampStatus:
        """Status of a measurement of another source; see ``check_other``."""
        return StampStatus(_check_other(self._clock, self._limits, stamp_ns))
