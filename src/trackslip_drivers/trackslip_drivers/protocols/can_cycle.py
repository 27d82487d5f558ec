# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The cycle of a sender, measured: a DBC's own is believed only where the frames come like that."""

import statistics
from collections import deque

PROMPT = 0.5  # of a cycle: frames off by more say nothing of the cycle
_FEW = 8  # intervals that show a cycle
_SHORTEST_NS = 8_000_000  # that those take together: frames that had waited come at once
_LONGEST = 4  # cycles of an interval that counts
_BLOCK = 32  # cycles
_BLOCKS = 32  # that are averaged
_ENOUGH = 3  # blocks that show more than intervals
_LASTING_NS = 1_000_000_000  # frames that come otherwise for so long have another cycle
_ROUGHLY = 0.25  # so near that of the DBC one interval must be to confirm it
_AS_STATED = 0.05  # a measured cycle so near that of the DBC is that of the DBC


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
        if not is_long and abs(each / self.cycle_ns - 1.0) <= PROMPT:
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
        even = total >= _SHORTEST_NS and abs(total / len(self._first) - middle) <= PROMPT * middle
        return self._decide(middle, _ROUGHLY, len(self._first) if even else 0)

    def _decide(self, measured_ns: float, tolerance: float, count: int) -> float | None:
        """The DBC's cycle where ``count`` measured ones agree with it, or theirs once they are enough."""
        self.is_nominal = self._nominal_ns > 0.0 and (
            abs(measured_ns - self._nominal_ns) <= tolerance * self._nominal_ns
        )
        if self.is_nominal:
            return self._nominal_ns
        return measured_ns if count >= _FEW and measured_ns > 0.0 else None
