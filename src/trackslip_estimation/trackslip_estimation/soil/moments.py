# SPDX-License-Identifier: Apache-2.0
"""Brings odometry, slips and pressures of one stamp together, strictly in the order of stamps.

Each topic comes in its own time. A moment is given out once all that belongs to it is there: the pressures
before and after it, or the certainty that they are not coming. So what is made of the moments depends on the
stamps alone, live as in a replay, as long as nothing is later than ``patience``.
"""

from collections import deque
from dataclasses import dataclass
from typing import cast

import numpy as np
from numpy.typing import NDArray

from trackslip_common.clock_monitor import ClockMonitor, StampStatus
from trackslip_common.parameters import Parameters, parameter
from trackslip_common.tally import Tally
from trackslip_estimation.soil.records import Hydraulics, Odometry, Refusal, Slips, SoilInput

FloatArray = NDArray[np.float64]

_NS_PER_S = 1e9
_MOST_HALVES = 200  # of pairs: 2 s at 100 Hz


@dataclass(frozen=True, kw_only=True)
class MomentParameters(Parameters):
    """How long to wait for what belongs together."""

    patience: float = parameter("how much later than the slips pressures may come", unit="s", gt=0.0, le=10.0)
    longest_gap: float = parameter(
        "between two pressures, for the moment between them to have one", unit="s", gt=0.0
    )
    max_gap: float = parameter("stamps further ahead must be confirmed", unit="s", gt=0.0, le=600.0)
    jump_confirmations: int = parameter("stamps in a row that make another time believed", ge=2)


@dataclass(frozen=True, eq=False)
class Pressures:
    """Between two readings of the hydraulics, at the stamp of a moment; (2,) each: left, right."""

    values: FloatArray  # Pa
    spools: FloatArray
    latest: Hydraulics  # the newer of the two, as it came


@dataclass(frozen=True, eq=False)
class Moment:
    """What is known of one stamp."""

    stamp_ns: int
    odometry: Odometry
    slips: Slips
    pressures: Pressures | None


class Moments:
    """Inputs in, in any order; moments out, in the order of their stamps."""

    def __init__(self, p: MomentParameters, tally: Tally) -> None:
        self._patience_ns, self._longest_ns = round(p.patience * _NS_PER_S), round(p.longest_gap * _NS_PER_S)
        self._max_gap_ns, self._confirmations = round(p.max_gap * _NS_PER_S), p.jump_confirmations
        self._tally = tally
        self._hydraulics: deque[Hydraulics] = deque()
        self._hydraulic_time = self._new_clock()
        self.clear()

    def clear(self) -> None:
        """Forget the slips and their time."""
        self._halves: dict[int, Odometry | Slips] = {}
        self._waiting: deque[tuple[Odometry, Slips]] = deque()
        self._slip_time = self._new_clock()
        self._done_ns = -1  # stamp of the newest whole pair

    def add(self, given: SoilInput) -> Refusal | None:
        """Put one input in its place; why not, if it has none. After RESTARTED everything begins anew."""
        if not given.is_finite():
            refusal: Refusal | None = Refusal.INVALID
        elif isinstance(given, Hydraulics):
            refusal = self._add_hydraulics(given)
        else:
            refusal = self._add_half(given)
        if refusal is not None:
            self._tally.add(given.source, refusal)
        return refusal

    def ready(self) -> list[Moment]:
        """The moments that are whole by now."""
        found = []
        while self._waiting and self._is_decided(self._waiting[0][0].stamp_ns):
            odometry, slips = self._waiting.popleft()
            stamp_ns = odometry.stamp_ns
            found.append(Moment(stamp_ns, odometry, slips, self._pressures_at(stamp_ns)))
        return found

    def _new_clock(self) -> ClockMonitor:
        return ClockMonitor(self._max_gap_ns, self._confirmations)

    def _add_hydraulics(self, given: Hydraulics) -> Refusal | None:
        newest_ns = self._hydraulics[-1].stamp_ns if self._hydraulics else None
        status = self._hydraulic_time.sample(given.stamp_ns, newest_ns)
        if status is StampStatus.BACK:
            self._hydraulics.clear()
            self._hydraulic_time = self._new_clock()
            self._hydraulic_time.sample(given.stamp_ns, None)
        elif status is not StampStatus.IN_LINE:
            return Refusal.AHEAD if status is StampStatus.AHEAD else Refusal.TOO_LATE
        elif given.stamp_ns == newest_ns:
            return Refusal.DUPLICATE
        self._hydraulics.append(given)
        horizon_ns = given.stamp_ns - 2 * self._max_gap_ns
        while self._hydraulics[0].stamp_ns < horizon_ns:
            self._hydraulics.popleft()
        return None

    def _add_half(self, given: Odometry | Slips) -> Refusal | None:
        other = self._halves.get(given.stamp_ns)
        if other is None:
            return self._keep_half(given)
        if type(other) is type(given):
            return Refusal.DUPLICATE
        del self._halves[given.stamp_ns]
        pair = (given, other) if isinstance(given, Odometry) else (other, given)
        status = self._slip_time.sample(given.stamp_ns, self._done_ns if self._done_ns >= 0 else None)
        if status is StampStatus.BACK:
            self.clear()
            self._slip_time.sample(given.stamp_ns, None)
        elif status is not StampStatus.IN_LINE:
            return Refusal.AHEAD if status is StampStatus.AHEAD else Refusal.TOO_LATE
        elif given.stamp_ns == self._done_ns:
            return Refusal.DUPLICATE
        self._done_ns = given.stamp_ns
        self._waiting.append(cast("tuple[Odometry, Slips]", pair))
        return Refusal.RESTARTED if status is StampStatus.BACK else None

    def _keep_half(self, given: Odometry | Slips) -> Refusal | None:
        """Until its other half comes; those that wait too long are given up."""
        if given.stamp_ns == self._done_ns:
            return Refusal.DUPLICATE
        self._halves[given.stamp_ns] = given
        while len(self._halves) > _MOST_HALVES:
            oldest = self._halves.pop(next(iter(self._halves)))
            self._tally.add(oldest.source, Refusal.UNPAIRED)
        return None

    def _is_decided(self, stamp_ns: int) -> bool:
        """Whether the pressures of this stamp are there, or not to come."""
        there = bool(self._hydraulics) and self._hydraulics[-1].stamp_ns >= stamp_ns
        return there or self._done_ns - stamp_ns >= self._patience_ns

    def _pressures_at(self, stamp_ns: int) -> Pressures | None:
        """Linear between the readings before and after; None where either is missing or far."""
        readings = self._hydraulics
        while len(readings) > 1 and readings[1].stamp_ns <= stamp_ns:
            readings.popleft()
        if not readings or readings[0].stamp_ns > stamp_ns:
            return None
        before, after = readings[0], readings[min(1, len(readings) - 1)]
        gap_ns, since_ns = after.stamp_ns - before.stamp_ns, stamp_ns - before.stamp_ns
        if since_ns > gap_ns or gap_ns > self._longest_ns:
            return None
        share = since_ns / gap_ns if gap_ns else 0.0
        first, second = _numbers(before), _numbers(after)
        pressures, spools = np.split(first + share * (second - first), 2)
        return Pressures(pressures, spools, after if share else before)


def _numbers(of: Hydraulics) -> FloatArray:
    return np.array((of.left_pressure, of.right_pressure, of.left_spool, of.right_spool))
