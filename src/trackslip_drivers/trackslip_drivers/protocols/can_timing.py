# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""When the frames of one sender were sent: its real cycle, what was lost, and what only came late.

A counter says how many cycles passed, but for whole turns of it. Where the silence before a frame may hide
such turns, the sender may as well have stalled, and be about to catch up: frames are held back until two of
them have come in their own time. The one that is least late by its count then shows the turns that were lost:
of a sender that only stalled, none. Without a counter nothing tells the frames of a burst after a silence
from one another: the last of them stands for all.

The cycle is measured: a DBC's own is believed only where the frames come like that. The time that has passed
for the sender is cycles counted times the cycle, so that the jitter of arrivals does not enter; without a
counter it is that between stamps.
"""

import math
import statistics
from collections import deque
from collections.abc import Callable
from enum import Enum
from typing import Any, NamedTuple

from trackslip_drivers.stamping import PeriodicStamps

_TURN_SHARE = 0.75  # of a turn of the counter: a silence longer than it expects may hide one more
_MOST_HELD = 300  # frames; more come at once only from a sender that has another cycle now
_PAUSE = 2.5  # cycles: a longer one may end in a burst, of a sender that does not count
_PROMPT = 0.5  # of a cycle: frames off by more say nothing of the cycle
_FEW = 8  # intervals that show a cycle
_SHORTEST_NS = 8_000_000  # that those take together: frames that had waited come at once
_LONGEST = 4  # cycles of an interval that counts
_BLOCK, _BLOCKS, _ENOUGH = (
    32,
    32,
    3,
)  # cycles of a block; blocks averaged; blocks that show more than intervals
_LASTING_NS = 1_000_000_000  # frames that come otherwise for so long have another cycle
_ROUGHLY = 0.25  # so near that of the DBC one interval must be to confirm it
_AS_STATED = 0.05  # a measured cycle so near that of the DBC is that of the DBC
_PATIENCE = 200  # frames
_STATED, _MEASURED, _UNCOUNTED = 1e-3, 0.02, 0.1  # tolerance of a cycle: two crystals; measured; guessed


class TimingEvent(Enum):
    """What befell a frame on its way; LOST counts frames that never came."""

    LOST = "lost"
    ALIVE_REPEATED = "alive counter repeated"
    BURST = "came at once with the next"


class Placed(NamedTuple):
    """When a frame was sent, and the time since the one before; then what was given with it."""

    stamp_ns: int
    elapsed_ns: int
    values: Any


class _Held(NamedTuple):
    number: int  # the sender's counter; 0 where there is none
    arrival_ns: int
    values: Any


class CycleMeter:
    """The cycle of a sender, from the times between its frames.

    Until there are some blocks of frames it is the median of the first intervals, once their mean is about
    that: the first frames may have waited, and come at once. A block is as long as its frames' arrivals say,
    whatever came late within it; one that a stall made longer is outvoted by the rest.

    Args:
        nominal_ns: as the DBC states it; 0 where it does not.
    """

    def __init__(self, nominal_ns: float) -> None:
        self._nominal_ns = nominal_ns
        self._restart()

    def _restart(self) -> None:
        self._first: deque[float] = deque(maxlen=2 * _FEW)  # ns a cycle, of the first intervals
        self._blocks: deque[float] = deque(maxlen=_BLOCKS)  # ns a cycle
        self._time_ns = self._cycles = 0  # of the block that is not full
        self._strange_ns, self._strange = 0, 0
        self.cycle_ns: float | None = None
        self.is_nominal = False

    def add(self, interval_ns: int, cycles: int) -> None:
        """An interval of some cycles; one with more than a few lost shows nothing, unless all are such."""
        if interval_ns < 0:
            self._time_ns = self._cycles = 0
            return
        is_long, each = not 1 <= cycles <= _LONGEST, interval_ns / max(cycles, 1)
        if self.cycle_ns is None:
            if not is_long:
                self._first.append(each)
                self.cycle_ns = self._by_first()
            return
        if not is_long and abs(each / self.cycle_ns - 1.0) <= _PROMPT:
            self._strange_ns, self._strange = 0, 0
        else:
            self._strange_ns, self._strange = self._strange_ns + interval_ns, self._strange + 1
        self._time_ns, self._cycles = self._time_ns + interval_ns, self._cycles + cycles
        if self._strange_ns > _LASTING_NS and self._strange >= _FEW:
            self._restart()
        elif is_long:
            self._time_ns = self._cycles = 0
        elif self._cycles >= _BLOCK:
            self._blocks.append(self._time_ns / self._cycles)
            self._time_ns = self._cycles = 0
            if len(self._blocks) >= _ENOUGH:
                middle = statistics.median(self._blocks)
                agreeing = [block for block in self._blocks if abs(block / middle - 1.0) <= _AS_STATED]
                self.cycle_ns = self._decide(statistics.fmean(agreeing), _AS_STATED, _FEW)

    def _by_first(self) -> float | None:
        """By the first intervals."""
        middle, total = statistics.median(self._first), sum(self._first)
        even = total >= _SHORTEST_NS and abs(total / len(self._first) - middle) <= _PROMPT * middle
        return self._decide(middle, _ROUGHLY, len(self._first) if even else 0)

    def _decide(self, measured_ns: float, tolerance: float, count: int) -> float | None:
        """The DBC's cycle where ``count`` measured ones agree with it, or theirs once they are enough."""
        self.is_nominal = self._nominal_ns > 0.0 and (
            abs(measured_ns - self._nominal_ns) <= tolerance * self._nominal_ns
        )
        if self.is_nominal:
            return self._nominal_ns
        return measured_ns if count >= _FEW and measured_ns > 0.0 else None


class FrameTiming:
    """Places the frames of one id.

    Args:
        nominal_ns: cycle that the DBC states; 0 where it does not.
        modulus: where the sender's counter goes round; 0 where there is none.
        count: called with what befell frames, and how many.
    """

    def __init__(self, nominal_ns: float, modulus: int, count: Callable[[TimingEvent, int], None]) -> None:
        self._meter = CycleMeter(nominal_ns)
        self._modulus = modulus
        self._tell = count
        self._count: int | None = None
        self._accepted_ns: int | None = None  # arrival of the last frame accepted
        self._seen_ns = 0  # and seen
        self._stamp_ns = 0  # of the last one placed
        self._held: list[_Held] = []
        self._before = _Held(0, 0, None)  # what those held come after
        self._late = self._least = 0.0  # the last of them and the least late one, cycles
        self._filter: PeriodicStamps | None = None
        self._filter_ns = 0.0

    @property
    def cycle_ns(self) -> float | None:
        """The sender's cycle; None while it is not known."""
        return self._meter.cycle_ns

    def resume(self) -> None:
        """The frames before are continued by time alone."""
        self._held = []
        self._count = self._filter = None

    def add(self, count: int | None, arrival_ns: int, values: Any) -> list[Placed]:
        """A frame that passed all checks; returns those whose times are known now."""
        return self._counted(count, arrival_ns, values) if self._modulus else self._timed(arrival_ns, values)

    def _counted(self, count: int | None, arrival_ns: int, values: Any) -> list[Placed]:
        assert count is not None
        frame, placed = _Held(count, arrival_ns, values), []
        if self._held:
            if not self._turns(self._excess(frame, self._held[-1])):
                self._hold(frame, self._held[-1])
                return self._settle() if self._has_caught_up() else []
            placed = self._settle()
        if self._accepted_ns is None or self._count is None:
            return [self._accept(frame, 0)]
        cycles = (count - self._count) % self._modulus
        # A sender stuck at one count keeps being seen, so its silence never grows to a turn.
        self._before = _Held(self._count, self._seen_ns if cycles == 0 else self._accepted_ns, None)
        self._seen_ns = arrival_ns
        if self._turns(self._excess(frame, self._before)):
            self._late, self._least = 0.0, math.inf
            self._hold(frame, self._before)
        elif cycles:
            placed.append(self._accept(frame, cycles))
        else:
            self._tell(TimingEvent.ALIVE_REPEATED, 1)
        return placed

    def _excess(self, frame: _Held, before: _Held) -> float:
        """By how many cycles a frame comes later than the counts have it, if no turn of them passed."""
        if not self._meter.cycle_ns:
            return 0.0
        cycles = (frame.number - before.number) % self._modulus
        return (frame.arrival_ns - before.arrival_ns) / self._meter.cycle_ns - cycles

    def _turns(self, excess: float) -> int:
        """Of the counter, in so many cycles."""
        return max(0, int(excess / self._modulus + (1.0 - _TURN_SHARE)))

    def _hold(self, frame: _Held, before: _Held) -> None:
        self._held.append(frame)
        self._late += self._excess(frame, before)
        self._least = min(self._least, self._late)

    def _has_caught_up(self) -> bool:
        """Whether nothing was lost, or the last two of the frames held came in their own time."""
        times = [frame.arrival_ns for frame in self._held[-3:]]
        apart = _PROMPT * (self._meter.cycle_ns or 0.0)
        is_prompt = len(times) == 3 and min(times[2] - times[1], times[1] - times[0]) >= apart
        return is_prompt or not self._turns(self._least) or len(self._held) >= _MOST_HELD

    def _settle(self) -> list[Placed]:
        """Place the frames held, after as many turns as the least late of them shows."""
        frames, self._held = self._held, []
        turns, placed, before = self._turns(self._least), [], self._before
        for frame in frames:
            step = (frame.number - before.number) % self._modulus
            before = frame
            if step or turns:
                placed.append(self._accept(frame, step + turns * self._modulus))
            else:
                self._tell(TimingEvent.ALIVE_REPEATED, 1)
            turns = 0
        return placed

    def _accept(self, frame: _Held, cycles: int) -> Placed:
        """A frame of a sender that counts, ``cycles`` after the one before; 0 if unknown."""
        if cycles > 1:
            self._tell(TimingEvent.LOST, cycles - 1)
        if cycles and self._accepted_ns is not None:
            self._meter.add(frame.arrival_ns - self._accepted_ns, cycles)
        cycle_ns = self._meter.cycle_ns
        stamp_ns = self._stamp(frame.arrival_ns, cycles)
        elapsed_ns = round(cycles * cycle_ns) if cycles and cycle_ns else stamp_ns - self._stamp_ns
        if self._accepted_ns is None:
            elapsed_ns = 0
        self._count, self._accepted_ns, self._seen_ns = frame.number, frame.arrival_ns, frame.arrival_ns
        self._stamp_ns = stamp_ns
        return Placed(stamp_ns, max(elapsed_ns, 0), frame.values)

    def _timed(self, arrival_ns: int, values: Any) -> list[Placed]:
        frame = _Held(0, arrival_ns, values)
        if self._accepted_ns is None:
            self._seen_ns = arrival_ns
            return [self._accept(frame, 0)]
        since_ns = arrival_ns - self._seen_ns
        self._seen_ns = arrival_ns
        self._meter.add(since_ns, 1)
        cycle_ns = self._meter.cycle_ns
        if cycle_ns and 0 <= since_ns < _PROMPT * cycle_ns:
            self._tell(TimingEvent.BURST, 1)
            if self._held:
                self._held = [frame]
            return []
        placed = [self._accept_timed(held) for held in self._held]
        self._held = []
        if cycle_ns and since_ns > _PAUSE * cycle_ns:
            self._held = [frame]
            return placed
        return [*placed, self._accept_timed(frame)]

    def _accept_timed(self, frame: _Held) -> Placed:
        stamp_ns = self._stamp(frame.arrival_ns, None)
        elapsed_ns = stamp_ns - self._stamp_ns
        self._accepted_ns, self._stamp_ns = frame.arrival_ns, stamp_ns
        return Placed(stamp_ns, max(elapsed_ns, 0), frame.values)

    def _stamp(self, arrival_ns: int, cycles: int | None) -> int:
        """The arrival without its jitter."""
        cycle_ns = self._meter.cycle_ns
        if not cycle_ns:
            return arrival_ns
        if self._filter is None or abs(cycle_ns / self._filter_ns - 1.0) > 0.1 * _MEASURED:
            tolerance = _STATED if self._meter.is_nominal else _MEASURED
            tolerance = tolerance if cycles is not None else _UNCOUNTED
            self._filter, self._filter_ns = PeriodicStamps(cycle_ns, tolerance, _PATIENCE), cycle_ns
            if self._accepted_ns is not None:
                self._filter.filter(self._stamp_ns, 0)
        return self._filter.filter(arrival_ns, cycles)
