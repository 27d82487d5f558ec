# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Determines when each frame of a sender was sent, and counts lost frames.

A counter gives the cycles between frames modulo its range. A silence may hide whole turns of the counter; or
the sender stalled and is about to catch up. Frames after such a silence are held until the last two arrive
at their normal interval. The held frame that is least late by its count then gives the number of turns lost:
zero if the sender only stalled. Without a counter, the frames of a burst after a silence cannot be
distinguished, and the last of them is used.

The elapsed time of the sender is cycles counted times the cycle (``can_cycle``), so jitter of arrivals does
not enter. Without a counter it is the difference of stamps.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from enum import Enum
from itertools import accumulate
from typing import NamedTuple

from trackslip_common.tally import Tally
from trackslip_drivers.protocols.can_codec import Value
from trackslip_drivers.protocols.can_cycle import PROMPT_TOLERANCE, CycleMeter
from trackslip_drivers.stamping import PeriodicStamps

_TURN_SHARE = 0.75  # of a turn of the counter: lateness from which one more turn may be lost
_MAX_HELD_FRAMES = 300  # frames; a longer burst comes only from a sender whose cycle has changed
_PAUSE_CYCLES = 2.5  # cycles: a longer silence may end in a burst, if the sender has no counter
_PATIENCE = 200  # frames, of ``PeriodicStamps``
_NOMINAL_TOLERANCE = 1e-3  # relative, of the DBC's cycle
_MEASURED_TOLERANCE = 0.02  # relative, of a measured cycle
_UNCOUNTED_TOLERANCE = 0.1  # relative, of a cycle without a counter


class TimingEvent(Enum):
    """Events of a sender's frames; LOST counts frames that never arrived."""

    LOST = "lost"
    ALIVE_REPEATED = "alive counter repeated"
    BURST = "arrived in a burst"
    CUT_OFF = "waited for the next while the bus was reopened"


class Frame(NamedTuple):
    """One accepted frame with its time of sending."""

    name: str
    source: int  # J1939 address of the sender; else 0
    stamp_ns: int
    elapsed_ns: int  # sender's time since its previous frame of this id; 0 for the first
    values: Mapping[str, Value]  # signal → value in the DBC's unit, or a position's raw number


class _Arrival(NamedTuple):
    arrival_ns: int
    values: Mapping[str, Value]
    number: int = 0  # the sender's counter


class _HeldFrame(NamedTuple):
    """A held frame relative to the one before, by the counter without lost turns."""

    frame: _Arrival
    cycles: int
    late: float  # cycles by which the frame arrived later than that


class FrameTiming(ABC):
    """Determines the times of the frames of one id.

    Args:
        nominal_ns: the DBC's cycle; 0: not given.
        tally: counts events, under ``name``.
        name, source: of the frames.
        first_ns: arrival of the first frame.

    Attributes:
        seen_ns: arrival of the last frame seen.
    """

    def __init__(self, nominal_ns: float, tally: Tally, name: str, source: int, first_ns: int = 0) -> None:
        self.name, self.source = name, source
        self._meter = CycleMeter(nominal_ns)
        self._tally = tally
        self._accepted_ns: int | None = None  # arrival of the last frame accepted
        self.first_ns = self.seen_ns = first_ns
        self._stamp_ns = 0  # stamp of the last frame returned
        self._filter: PeriodicStamps | None = None
        self._filter_ns = 0.0

    @property
    def cycle_ns(self) -> float | None:
        """The sender's cycle; None while it is not known."""
        return self._meter.cycle_ns

    def resume(self) -> None:
        """Restart the stamps after the bus is reopened."""
        self._filter = None

    @abstractmethod
    def add(self, count: int | None, arrival_ns: int, values: Mapping[str, Value]) -> list[Frame]:
        """Add a frame that passed all checks; returns the frames whose times are known now."""

    def _timed_frame(self, frame: _Arrival, cycles: int | None) -> Frame:
        """The frame with its times; ``cycles`` since the last one: 0 if unknown, None without a counter."""
        cycle_ns = self._meter.cycle_ns
        stamp_ns = self._stamp(frame.arrival_ns, cycles)
        elapsed_ns = round(cycles * cycle_ns) if cycles and cycle_ns else stamp_ns - self._stamp_ns
        if self._accepted_ns is None:
            elapsed_ns = 0
        self._accepted_ns, self._stamp_ns = frame.arrival_ns, stamp_ns
        return Frame(self.name, self.source, stamp_ns, max(elapsed_ns, 0), frame.values)

    def _stamp(self, arrival_ns: int, cycles: int | None) -> int:
        """The arrival with its jitter filtered out, ns."""
        cycle_ns = self._meter.cycle_ns
        if not cycle_ns:
            return arrival_ns
        if self._filter is None or abs(cycle_ns / self._filter_ns - 1.0) > 0.1 * _MEASURED_TOLERANCE:
            tolerance = _NOMINAL_TOLERANCE if self._meter.is_nominal else _MEASURED_TOLERANCE
            tolerance = tolerance if cycles is not None else _UNCOUNTED_TOLERANCE
            self._filter, self._filter_ns = PeriodicStamps(cycle_ns, tolerance, _PATIENCE), cycle_ns
            if self._accepted_ns is not None:
                self._filter.filter(self._stamp_ns, 0)
        return self._filter.filter(arrival_ns, cycles)


class CountedFrames(FrameTiming):
    """Frames of a sender with a counter.

    Args:
        nominal_ns, tally, name, source, first_ns: see ``FrameTiming``.
        modulus: of the counter.
    """

    def __init__(
        self, nominal_ns: float, modulus: int, tally: Tally, name: str, source: int, first_ns: int = 0
    ) -> None:
        super().__init__(nominal_ns, tally, name, source, first_ns)
        self._modulus = modulus
        self._count: int | None = None
        self._held: list[_HeldFrame] = []

    def resume(self) -> None:
        """Also drop the frames held, and report them."""
        super().resume()
        if self._held:
            self._tally.add(self.name, TimingEvent.CUT_OFF, len(self._held))
        self._held, self._count = [], None

    def add(self, count: int | None, arrival_ns: int, values: Mapping[str, Value]) -> list[Frame]:
        """See ``FrameTiming``."""
        assert count is not None
        frame, timed = _Arrival(arrival_ns, values, count), list[Frame]()
        if self._held:
            last = self._held[-1].frame
            cycles, late = self._cycles_since(last.number, last.arrival_ns, count, arrival_ns)
            if not self._possible_turns(late):
                self._held.append(_HeldFrame(frame, cycles, late))
                return self._release_held() if self._has_caught_up() else []
            timed = self._release_held()
        if self._accepted_ns is None or self._count is None:
            return [self._accept_frame(frame, 0)]
        # A repeated count is timed from the last frame seen: a stuck counter never looks like a lost turn.
        since_ns = self.seen_ns if count == self._count else self._accepted_ns
        cycles, late = self._cycles_since(self._count, since_ns, count, arrival_ns)
        self.seen_ns = arrival_ns
        if self._possible_turns(late):
            self._held = [_HeldFrame(frame, cycles, late)]
        elif cycles:
            timed.append(self._accept_frame(frame, cycles))
        else:
            self._tally.add(self.name, TimingEvent.ALIVE_REPEATED)
        return timed

    def _cycles_since(self, before: int, before_ns: int, count: int, arrival_ns: int) -> tuple[int, float]:
        """(cycles between two frames by their counts, cycles by which the second arrived later than that)."""
        cycles, cycle_ns = (count - before) % self._modulus, self._meter.cycle_ns
        return cycles, (arrival_ns - before_ns) / cycle_ns - cycles if cycle_ns else 0.0

    def _possible_turns(self, late: float) -> int:
        """Turns of the counter that may be lost at a lateness in cycles."""
        return max(0, int(late / self._modulus + (1.0 - _TURN_SHARE)))

    def _lost_turns(self) -> int:
        """Lost turns of the counter, from the least late of the held frames."""
        return self._possible_turns(min(accumulate(held.late for held in self._held)))

    def _has_caught_up(self) -> bool:
        """Whether the held frames can be timed: no turn was lost, or the last two came normally."""
        times = [held.frame.arrival_ns for held in self._held[-3:]]
        min_interval_ns = PROMPT_TOLERANCE * (self._meter.cycle_ns or 0.0)
        is_prompt = len(times) == 3 and min(times[2] - times[1], times[1] - times[0]) >= min_interval_ns
        return is_prompt or not self._lost_turns() or len(self._held) >= _MAX_HELD_FRAMES

    def _release_held(self) -> list[Frame]:
        """Return the held frames with their times, the first of them after the lost turns."""
        turns, timed = self._lost_turns(), []
        for held in self._held:
            if held.cycles or turns:
                timed.append(self._accept_frame(held.frame, held.cycles + turns * self._modulus))
            else:
                self._tally.add(self.name, TimingEvent.ALIVE_REPEATED)
            turns = 0
        self._held = []
        return timed

    def _accept_frame(self, frame: _Arrival, cycles: int) -> Frame:
        """Time a frame ``cycles`` after the previous one (0: unknown); reports frames lost between."""
        if cycles > 1:
            self._tally.add(self.name, TimingEvent.LOST, cycles - 1)
        if cycles and self._accepted_ns is not None:
            self._meter.add(frame.arrival_ns - self._accepted_ns, cycles)
        self._count, self.seen_ns = frame.number, frame.arrival_ns
        return self._timed_frame(frame, cycles)


class UncountedFrames(FrameTiming):
    """Frames of a sender without a counter."""

    def __init__(self, nominal_ns: float, tally: Tally, name: str, source: int, first_ns: int = 0) -> None:
        super().__init__(nominal_ns, tally, name, source, first_ns)
        self._held: _Arrival | None = None

    def resume(self) -> None:
        """Also drop the frame held, and report it."""
        super().resume()
        if self._held:
            self._tally.add(self.name, TimingEvent.CUT_OFF)
        self._held = None

    def add(self, count: int | None, arrival_ns: int, values: Mapping[str, Value]) -> list[Frame]:
        """See ``FrameTiming``."""
        frame = _Arrival(arrival_ns, values)
        since_ns, self.seen_ns = arrival_ns - self.seen_ns, arrival_ns
        if self._accepted_ns is None:
            return [self._timed_frame(frame, None)]
        self._meter.add(since_ns, 1)
        cycle_ns = self._meter.cycle_ns
        if cycle_ns and 0 <= since_ns < PROMPT_TOLERANCE * cycle_ns:
            self._tally.add(self.name, TimingEvent.BURST)
            if self._held:
                self._held = frame
            return []
        timed = [] if self._held is None else [self._timed_frame(self._held, None)]
        self._held = frame if cycle_ns and since_ns > _PAUSE_CYCLES * cycle_ns else None
        return timed if self._held else [*timed, self._timed_frame(frame, None)]
