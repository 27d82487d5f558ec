# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Measures the cycle time of a sender; the DBC's cycle is used only if the arrivals agree with it."""

import statistics
from collections import deque
from dataclasses import dataclass

PROMPT_TOLERANCE = 0.5  # of a cycle: a frame that deviates by more is early or late
_MIN_INTERVALS = 8  # intervals needed for a measured cycle
_MAX_CYCLES = 4  # cycles of an interval that is used
_BLOCK_CYCLES = 32  # cycles per block
_AVERAGED_BLOCKS = 32  # blocks averaged
_MIN_BLOCKS = 3  # blocks needed before their mean is used
_MIN_OBSERVATION_NS = 500_000_000  # in a shorter time only the DBC's cycle can be confirmed
_WINDOW_NS = 4_000_000_000  # when the recent intervals exceed this, their weight is halved
_SILENCE_NS = 2_000_000_000  # a longer interval is not caused by a stalled host
_MIN_FILLED_SHARE = 0.7  # least share of the time that the counted cycles must fill
_FILLED_MARGIN = 0.05  # share of the time: a new cycle may explain this much less than the present one
_CHANGE_NS = 1_000_000_000  # frames off the cycle for longer have another cycle
_CHANGE_AMID_STALLS_NS = 10_000_000_000  # the same where the pattern is that of a host that stalls repeatedly
_FIRST_TOLERANCE = 0.25  # relative tolerance for a single interval to confirm the DBC's cycle
_NOMINAL_TOLERANCE = 0.05  # relative tolerance for a measured cycle to be that of the DBC


@dataclass
class _Intervals:
    """Sums over intervals: their number, the cycles by frame count, and the time."""

    count: int = 0
    cycles: float = 0.0
    time_ns: float = 0.0

    def add(self, interval_ns: int, cycles: int) -> None:
        self.count += 1
        self.cycles += cycles
        self.time_ns += interval_ns

    def half_weight(self) -> "_Intervals":
        """The sums with half their weight."""
        return _Intervals(self.count, self.cycles / 2.0, self.time_ns / 2.0)

    def filled_share(self, cycle_ns: float) -> float:
        """Share of the summed time that the cycles would take at ``cycle_ns`` each."""
        return self.cycles * cycle_ns / max(self.time_ns, 1)


class CycleMeter:
    """Measures the cycle of a sender from the intervals between its frames.

    The first estimate is the median of the first intervals, if their mean is close to it (frames that waited
    arrive in bursts). Later it is the mean of the blocks of frames that agree with the median block. The
    length of a block is unaffected by late frames inside it; a block that a stall lengthened is left out.

    After a stall, a host processes waiting frames faster than they were sent. A measured cycle is therefore
    accepted only if cycle times number of frames fills the elapsed time.

    Args:
        nominal_ns: the DBC's cycle; 0: not given.
    """

    def __init__(self, nominal_ns: float) -> None:
        self._nominal_ns = nominal_ns
        self._restart()

    def _restart(self) -> None:
        self._first: deque[float] = deque(maxlen=2 * _MIN_INTERVALS)  # ns per cycle, first intervals
        self._blocks: deque[float] = deque(maxlen=_AVERAGED_BLOCKS)  # ns per cycle
        self._time_ns = self._cycles = 0  # of the incomplete block
        self._early, self._late = _Intervals(), _Intervals()  # since the last prompt frame
        self._recent = _Intervals()
        self.cycle_ns: float | None = None
        self.is_nominal = False

    def add(self, interval_ns: int, cycles: int) -> None:
        """Add an interval of some cycles; a long one counts only as late, a negative one drops the block."""
        if interval_ns < 0:
            self._time_ns = self._cycles = 0
            return
        is_long, per_cycle_ns = not 1 <= cycles <= _MAX_CYCLES, interval_ns / max(cycles, 1)
        counted = 1 if is_long else cycles
        if interval_ns < _SILENCE_NS:
            self._recent.add(interval_ns, counted)
            if self._recent.time_ns > _WINDOW_NS:
                self._recent = self._recent.half_weight()
        if self.cycle_ns is None:
            if not is_long:
                self._first.append(per_cycle_ns)
                self.cycle_ns = self._first_estimate()
            return
        is_prompt = not is_long and abs(per_cycle_ns / self.cycle_ns - 1.0) <= PROMPT_TOLERANCE
        if not is_prompt:
            is_early = per_cycle_ns < self.cycle_ns and not is_long
            (self._early if is_early else self._late).add(interval_ns, counted)
        elif self._early.count or self._late.count:
            self._early, self._late = _Intervals(), _Intervals()
        self._time_ns, self._cycles = self._time_ns + interval_ns, self._cycles + cycles
        if not is_prompt and self._has_cycle_changed():
            self._restart()
        elif is_long:
            self._time_ns = self._cycles = 0
        elif self._cycles >= _BLOCK_CYCLES:
            self._blocks.append(self._time_ns / self._cycles)
            self._time_ns = self._cycles = 0
            median = statistics.median_low(self._blocks)  # one of the blocks, so at least one agrees with it
            if len(self._blocks) >= _MIN_BLOCKS:
                agreeing = [
                    block for block in self._blocks if abs(block - median) <= _NOMINAL_TOLERANCE * median
                ]
                self.cycle_ns = self._choose_cycle(
                    statistics.fmean(agreeing), _NOMINAL_TOLERANCE, _MIN_INTERVALS
                )

    def _has_cycle_changed(self) -> bool:
        """Whether frames have been off the cycle for so long that the sender has another cycle.

        A stalling host gives many early frames and fewer late ones, with most of the time before the late
        ones. If the present cycle then fills the time, the cycle is kept.
        """
        early, late = self._early, self._late
        deviant = _Intervals(
            early.count + late.count, early.cycles + late.cycles, early.time_ns + late.time_ns
        )
        stalls = early.count > late.count and late.time_ns > early.time_ns
        if (
            deviant.time_ns <= (_CHANGE_AMID_STALLS_NS if stalls else _CHANGE_NS)
            or deviant.count < _MIN_INTERVALS
        ):
            return False
        if stalls and deviant.filled_share(self.cycle_ns or 0.0) >= _MIN_FILLED_SHARE:
            self._early, self._late = _Intervals(), _Intervals()
            return False
        return True

    def _first_estimate(self) -> float | None:
        """The cycle from the median of the first intervals, or the DBC's if that fills the recent time."""
        middle, mean = statistics.median(self._first), statistics.fmean(self._first)
        if self._recent.time_ns < _MIN_OBSERVATION_NS:
            return self._choose_cycle(middle, _FIRST_TOLERANCE, 0)
        if abs(self._recent.filled_share(self._nominal_ns) - 1.0) <= 1.0 - _MIN_FILLED_SHARE:
            middle = self._nominal_ns
        is_even = abs(mean - middle) <= PROMPT_TOLERANCE * middle
        return self._choose_cycle(middle, _FIRST_TOLERANCE, len(self._first) if is_even else 0)

    def _choose_cycle(self, measured_ns: float, tolerance: float, count: int) -> float | None:
        """The DBC's cycle if the measured one agrees; else the measured one if supported; else no change."""
        if self._nominal_ns > 0.0 and abs(measured_ns - self._nominal_ns) <= tolerance * self._nominal_ns:
            self.is_nominal = True
            return self._nominal_ns
        fills = self._recent.filled_share(measured_ns)
        if count < _MIN_INTERVALS or fills < _MIN_FILLED_SHARE:
            return self.cycle_ns
        if (
            self.cycle_ns
            and abs(fills - 1.0) > abs(self._recent.filled_share(self.cycle_ns) - 1.0) + _FILLED_MARGIN
        ):
            return self.cycle_ns
        self.is_nominal = False
        return measured_ns
