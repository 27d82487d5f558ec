# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The cycle of a sender, measured: a DBC's own is believed only where the frames come like that."""

import statistics
from collections import deque
from dataclasses import dataclass

PROMPT = 0.5  # of a cycle: frames off by more say nothing of the cycle
_FEW = 8  # intervals that show a cycle
_LONGEST = 4  # cycles of an interval that counts
_BLOCK = 32  # cycles
_BLOCKS = 32  # that are averaged
_ENOUGH = 3  # blocks that show more than intervals
_WATCHED_NS = 500_000_000  # a shorter time shows no cycle but that of the DBC
_RECENT_NS = 4_000_000_000  # a longer time counts half
_SILENCE_NS = 2_000_000_000  # a longer interval is no host's that stands still
_FILLED = 0.7  # of the time must be that of the frames that came
_WORSE = 0.05  # of the time, less of it explained than by the cycle before
_PERSISTENT_NS = 1_000_000_000  # frames that come otherwise for so long have another cycle
_STALLING_NS = 10_000_000_000  # unless the host stands still again and again: so long shows whether it does
_ROUGHLY = 0.25  # so near that of the DBC one interval must be to confirm it
_AS_STATED = 0.05  # a measured cycle so near that of the DBC is that of the DBC


@dataclass
class _Intervals:
    """Some of them, and the cycles that they are by the count of frames."""

    count: int = 0
    cycles: float = 0.0
    time_ns: float = 0.0

    def add(self, interval_ns: int, cycles: int) -> None:
        self.count += 1
        self.cycles += cycles
        self.time_ns += interval_ns

    def halved(self) -> "_Intervals":
        return _Intervals(self.count, self.cycles / 2.0, self.time_ns / 2.0)

    def filled_by(self, cycle_ns: float) -> float:
        """How much of their time so many cycles take."""
        return self.cycles * cycle_ns / max(self.time_ns, 1)


class CycleMeter:
    """The cycle of a sender, from the times between its frames.

    Until there are some blocks of frames it is the median of the first intervals, once their mean is about
    that: the first frames may have waited, and come at once. A block is as long as its frames' arrivals say,
    whatever came late within it; one that a stall made longer is outvoted by the rest.

    A host that stands still works off what has waited faster than it was sent. So a cycle is believed only
    if as many as frames came fill the time.

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
        self._early, self._late = _Intervals(), _Intervals()  # since a frame last came in its own time
        self._recent = _Intervals()
        self.cycle_ns: float | None = None
        self.is_nominal = False

    def add(self, interval_ns: int, cycles: int) -> None:
        """An interval of some cycles; one with more than a few lost shows nothing, unless all are such."""
        if interval_ns < 0:
            self._time_ns = self._cycles = 0
            return
        is_long, each = not 1 <= cycles <= _LONGEST, interval_ns / max(cycles, 1)
        counted = 1 if is_long else cycles
        if interval_ns < _SILENCE_NS:
            self._recent.add(interval_ns, counted)
            if self._recent.time_ns > _RECENT_NS:
                self._recent = self._recent.halved()
        if self.cycle_ns is None:
            if not is_long:
                self._first.append(each)
                self.cycle_ns = self._by_first()
            return
        is_prompt = not is_long and abs(each / self.cycle_ns - 1.0) <= PROMPT
        if not is_prompt:
            is_early = each < self.cycle_ns and not is_long
            (self._early if is_early else self._late).add(interval_ns, counted)
        elif self._early.count or self._late.count:
            self._early, self._late = _Intervals(), _Intervals()
        self._time_ns, self._cycles = self._time_ns + interval_ns, self._cycles + cycles
        if not is_prompt and self._is_another():
            self._restart()
        elif is_long:
            self._time_ns = self._cycles = 0
        elif self._cycles >= _BLOCK:
            self._blocks.append(self._time_ns / self._cycles)
            self._time_ns = self._cycles = 0
            middle = statistics.median_low(self._blocks)  # one of them: something agrees with it
            if len(self._blocks) >= _ENOUGH:
                agreeing = [block for block in self._blocks if abs(block - middle) <= _AS_STATED * middle]
                self.cycle_ns = self._decide(statistics.fmean(agreeing), _AS_STATED, _FEW)

    def _is_another(self) -> bool:
        """Whether frames have not fitted the cycle for so long that it is another one.

        Where most come too early, and most of the time passes before those that come too late, a host stands
        still, and catches up: that says nothing of the cycle, which fills the time then.
        """
        early, late = self._early, self._late
        unfit = _Intervals(early.count + late.count, early.cycles + late.cycles, early.time_ns + late.time_ns)
        stalls = early.count > late.count and late.time_ns > early.time_ns
        if unfit.time_ns <= (_STALLING_NS if stalls else _PERSISTENT_NS) or unfit.count < _FEW:
            return False
        if stalls and unfit.filled_by(self.cycle_ns or 0.0) >= _FILLED:
            self._early, self._late = _Intervals(), _Intervals()
            return False
        return True

    def _by_first(self) -> float | None:
        """By the first intervals; where they are uneven, that of the DBC if it fills the time."""
        middle, mean = statistics.median(self._first), statistics.fmean(self._first)
        if self._recent.time_ns < _WATCHED_NS:
            return self._decide(middle, _ROUGHLY, 0)
        if abs(self._recent.filled_by(self._nominal_ns) - 1.0) <= 1.0 - _FILLED:
            middle = self._nominal_ns
        is_even = abs(mean - middle) <= PROMPT * middle
        return self._decide(middle, _ROUGHLY, len(self._first) if is_even else 0)

    def _decide(self, measured_ns: float, tolerance: float, count: int) -> float | None:
        """The DBC's cycle where a measured one agrees with it, theirs if they are enough, else as before."""
        if self._nominal_ns > 0.0 and abs(measured_ns - self._nominal_ns) <= tolerance * self._nominal_ns:
            self.is_nominal = True
            return self._nominal_ns
        fills = self._recent.filled_by(measured_ns)
        if count < _FEW or fills < _FILLED:
            return self.cycle_ns
        if self.cycle_ns and abs(fills - 1.0) > abs(self._recent.filled_by(self.cycle_ns) - 1.0) + _WORSE:
            return self.cycle_ns
        self.is_nominal = False
        return measured_ns
