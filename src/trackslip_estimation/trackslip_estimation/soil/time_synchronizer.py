# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Brings odometry, slips and pressures of one stamp together, strictly in the order of stamps, compiled.

Each topic comes in its own time. A sample is given out once all that belongs to it is there: the pressures
before and after it, or the certainty that they are not coming. So what is made of the samples depends on the
stamps alone, live as in a replay, as long as nothing is later than ``patience``.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from trackslip_common.compiled import compiled
from trackslip_common.parameters import Parameters, parameter
from trackslip_estimation.soil.records import (
    ACCEPTED,
    AHEAD,
    DUPLICATE,
    INVALID,
    IS_HYDRAULICS,
    IS_ODOMETRY,
    RESTARTED,
    SOIL_INPUT,
    SOURCES,
    TOO_LATE,
    UNPAIRED,
    VALUES,
    Rejection,
    copy_input,
    is_valid,
)

_NS_PER_S = 1e9
_MOST_HALVES = 200  # of pairs: 2 s at 100 Hz
_CAPACITY = 4096  # readings, and pairs that wait for them: 40 s at 100 Hz
_NEVER = np.iinfo(np.int64).min
_IN_LINE, _FAR_AHEAD, _BEHIND, _BACK = range(4)

_STREAK = np.dtype([("count", "i8"), ("last_ns", "i8")])  # stamps in a row that are out of line alike
_CLOCK = np.dtype([("head_ns", "i8"), ("ahead", _STREAK), ("behind", _STREAK)])
_RING = np.dtype([("first", "i8"), ("count", "i8")])
SYNCHRONIZER = np.dtype(
    [
        ("reading_clock", _CLOCK),
        ("pair_clock", _CLOCK),
        ("readings", _RING),
        ("pairs", _RING),
        ("halves", "i8"),
        ("done_ns", "i8"),  # stamp of the newest whole pair
        ("rejected", "i8", (len(SOURCES), len(Rejection))),  # how many
    ]
)
# Rows of the buffers: rings of readings, and of pairs that wait for them; halves of pairs, as they came
_READINGS, _ODOMETRY, _SLIPS, _HALVES = range(4)
SAMPLE = np.dtype(
    [
        *VALUES,  # pressures and spools are those at the stamp, between two readings …
        ("has_pressures", "i8"),  # … where there are two
        ("reading_ns", "i8"),  # stamp of the newer of the two, and its pressures as they came
        ("reading", "f8", 2),
        ("dt", "f8"),  # s since the sample before
        ("tracks", "f8", 2),  # track speeds r ω, m/s; nan where the slip is 1
    ]
)


@dataclass(frozen=True, kw_only=True)
class SynchronizerParameters(Parameters):
    """How long to wait for what belongs together."""

    patience: float = parameter("how much later than the slips pressures may come", unit="s", gt=0.0, le=10.0)
    longest_gap: float = parameter(
        "between two pressures, for the moment between them to have one", unit="s", gt=0.0
    )
    max_gap: float = parameter("stamps further ahead must be confirmed", unit="s", gt=0.0, le=600.0)
    jump_confirmations: int = parameter("stamps in a row that make another time believed", ge=2)


class TimeSynchronizer(NamedTuple):
    """Inputs in, in any order; samples out, in the order of their stamps. Bounded, whatever comes."""

    state: NDArray[Any]  # (1,) SYNCHRONIZER
    buffers: NDArray[Any]  # (4, n) SOIL_INPUT

    def rejected(self) -> Iterator[tuple[str, Rejection, int]]:
        """Source, reason, and how many."""
        for source, counts in zip(SOURCES, self.state["rejected"][0].tolist(), strict=True):
            for rejection, count in zip(Rejection, counts, strict=True):
                yield source, rejection, count


def new_synchronizer() -> TimeSynchronizer:
    """With nothing in it."""
    synchronizer = TimeSynchronizer(np.zeros(1, SYNCHRONIZER), np.zeros((4, _CAPACITY), SOIL_INPUT))
    state = synchronizer.state[0]
    state["done_ns"] = state["reading_clock"]["head_ns"] = state["pair_clock"]["head_ns"] = _NEVER
    return synchronizer


@compiled
def add(synchronizer: TimeSynchronizer, given: Any, p: Any) -> int:
    """Put one input in its place; ACCEPTED, or why it has none. After RESTARTED all begins anew."""
    if not is_valid(given):
        rejection = INVALID
    elif given.source == IS_HYDRAULICS:
        rejection = _add_reading(synchronizer, given, p)
    else:
        rejection = _add_half(synchronizer, given, p)
    if rejection != ACCEPTED:
        synchronizer.state[0].rejected[given.source, rejection] += 1
    return rejection


@compiled
def is_ready(synchronizer: TimeSynchronizer, p: Any) -> bool:
    """Whether the oldest pair is there, and its pressures are, or are not to come."""
    state = synchronizer.state[0]
    if state.pairs.count == 0:
        return False
    if state.pairs.count == _CAPACITY:
        return True
    stamp_ns = synchronizer.buffers[_ODOMETRY, state.pairs.first].stamp_ns
    readings = synchronizer.buffers[_READINGS]
    there = (
        state.readings.count > 0
        and readings[_place(state.readings, state.readings.count - 1)].stamp_ns >= stamp_ns
    )
    return bool(there or state.done_ns - stamp_ns >= _ns(p.patience))


@compiled
def pop_oldest(synchronizer: TimeSynchronizer, p: Any, sample: Any) -> None:
    """Move the oldest pair into the sample, with its pressures."""
    pairs = synchronizer.state[0].pairs
    odometry, slips = synchronizer.buffers[_ODOMETRY, pairs.first], synchronizer.buffers[_SLIPS, pairs.first]
    sample.stamp_ns = odometry.stamp_ns
    for i in range(3):
        sample.twist[i], sample.pose[i], sample.slips[i] = odometry.twist[i], odometry.pose[i], slips.slips[i]
        for j in range(3):
            sample.twist_covariance[i, j] = odometry.twist_covariance[i, j]
            sample.pose_covariance[i, j] = odometry.pose_covariance[i, j]
    for k in range(2):
        sample.tilt[k], sample.tilt_variance[k] = odometry.tilt[k], odometry.tilt_variance[k]
    sample.motion = slips.motion
    sample.has_pressures = _interpolate(synchronizer, p, sample)
    _drop_first(pairs)


@compiled
def _follow(clock: Any, stamp_ns: int, oldest_ns: int, p: Any) -> int:
    """Where a stamp lies; many in a row that are out of line, but in line with each other, are another time.

    ``oldest_ns``: older ones have no place; _NEVER where there is none.
    """
    gap_ns = _ns(p.max_gap)
    floor_ns = oldest_ns
    if clock.head_ns != _NEVER:
        floor_ns = max(floor_ns, clock.head_ns - gap_ns)
    if stamp_ns < floor_ns:
        clock.ahead.count = 0
        return _BACK if _extend(clock.behind, stamp_ns, gap_ns) >= p.jump_confirmations else _BEHIND
    clock.behind.count = 0
    is_far = clock.head_ns != _NEVER and stamp_ns > clock.head_ns + gap_ns
    if is_far and _extend(clock.ahead, stamp_ns, gap_ns) < p.jump_confirmations:
        return _FAR_AHEAD
    clock.ahead.count = 0
    clock.head_ns = max(clock.head_ns, stamp_ns)
    return _IN_LINE


@compiled
def _extend(streak: Any, stamp_ns: int, gap_ns: int) -> int:
    """How many there are by now; a stamp that does not follow on the last one begins anew."""
    follows = streak.count > 0 and 0 < stamp_ns - streak.last_ns <= gap_ns
    streak.count = streak.count + 1 if follows else 1
    streak.last_ns = stamp_ns
    return int(streak.count)


@compiled
def _start_again(clock: Any, stamp_ns: int) -> None:
    clock.head_ns = stamp_ns
    clock.ahead.count = clock.behind.count = 0


@compiled
def _add_reading(synchronizer: TimeSynchronizer, given: Any, p: Any) -> int:
    state = synchronizer.state[0]
    ring, readings = state.readings, synchronizer.buffers[_READINGS]
    newest_ns = readings[_place(ring, ring.count - 1)].stamp_ns if ring.count else _NEVER
    status = _follow(state.reading_clock, given.stamp_ns, newest_ns, p)
    if status == _BACK:
        ring.count = 0
        _start_again(state.reading_clock, given.stamp_ns)
    elif status != _IN_LINE:
        return AHEAD if status == _FAR_AHEAD else TOO_LATE
    elif given.stamp_ns == newest_ns:
        return DUPLICATE
    horizon_ns = given.stamp_ns - 2 * _ns(p.max_gap)
    while ring.count == _CAPACITY or (ring.count and readings[ring.first].stamp_ns < horizon_ns):
        _drop_first(ring)
    copy_input(given, readings[_place(ring, ring.count)])
    ring.count += 1
    return ACCEPTED


@compiled
def _add_half(synchronizer: TimeSynchronizer, given: Any, p: Any) -> int:
    state, halves = synchronizer.state[0], synchronizer.buffers[_HALVES]
    k = state.halves - 1  # the newest are the likeliest
    while k >= 0 and halves[k].stamp_ns != given.stamp_ns:
        k -= 1
    if k < 0:
        return _keep_half(synchronizer, given)
    if halves[k].source == given.source:
        return DUPLICATE
    place = _place(state.pairs, state.pairs.count)
    status = _follow(state.pair_clock, given.stamp_ns, state.done_ns, p)
    if status == _BACK:
        place = 0
    is_odometry = given.source == IS_ODOMETRY
    copy_input(given, synchronizer.buffers[_ODOMETRY if is_odometry else _SLIPS, place])
    copy_input(halves[k], synchronizer.buffers[_SLIPS if is_odometry else _ODOMETRY, place])
    _forget_half(synchronizer, k)
    if status == _BACK:
        state.pairs.first = state.pairs.count = state.halves = 0
        _start_again(state.pair_clock, given.stamp_ns)
    elif status != _IN_LINE:
        return AHEAD if status == _FAR_AHEAD else TOO_LATE
    elif given.stamp_ns == state.done_ns:
        return DUPLICATE
    state.done_ns = given.stamp_ns
    state.pairs.count += 1
    return RESTARTED if status == _BACK else ACCEPTED


@compiled
def _keep_half(synchronizer: TimeSynchronizer, given: Any) -> int:
    """Until its other half comes; those that wait too long are given up."""
    state = synchronizer.state[0]
    if given.stamp_ns == state.done_ns:
        return DUPLICATE
    copy_input(given, synchronizer.buffers[_HALVES, state.halves])
    state.halves += 1
    if state.halves > _MOST_HALVES:
        synchronizer.state[0].rejected[synchronizer.buffers[_HALVES, 0].source, UNPAIRED] += 1
        _forget_half(synchronizer, 0)
    return ACCEPTED


@compiled
def _forget_half(synchronizer: TimeSynchronizer, place: int) -> None:
    state = synchronizer.state[0]
    for k in range(place, state.halves - 1):
        copy_input(synchronizer.buffers[_HALVES, k + 1], synchronizer.buffers[_HALVES, k])
    state.halves -= 1


@compiled
def _interpolate(synchronizer: TimeSynchronizer, p: Any, sample: Any) -> bool:
    """Linear between the readings before and after; False where either is missing or far."""
    ring, readings = synchronizer.state[0].readings, synchronizer.buffers[_READINGS]
    while ring.count > 1 and readings[_place(ring, 1)].stamp_ns <= sample.stamp_ns:
        _drop_first(ring)
    if ring.count == 0 or readings[ring.first].stamp_ns > sample.stamp_ns:
        return False
    before, after = readings[ring.first], readings[_place(ring, min(1, ring.count - 1))]
    gap_ns, since_ns = after.stamp_ns - before.stamp_ns, sample.stamp_ns - before.stamp_ns
    if since_ns > gap_ns or gap_ns > _ns(p.longest_gap):
        return False
    share = since_ns / gap_ns if gap_ns > 0 else 0.0
    newer = after if share > 0.0 else before
    sample.reading_ns = newer.stamp_ns
    for k in range(2):
        sample.reading[k] = newer.pressures[k]
        sample.pressures[k] = before.pressures[k] + share * (after.pressures[k] - before.pressures[k])
        sample.spools[k] = before.spools[k] + share * (after.spools[k] - before.spools[k])
    return True


@compiled
def _place(ring: Any, k: int) -> int:
    """Of the k-th in a ring."""
    return int((ring.first + k) % _CAPACITY)


@compiled
def _drop_first(ring: Any) -> None:
    ring.first = (ring.first + 1) % _CAPACITY
    ring.count -= 1


@compiled
def _ns(seconds: float) -> int:
    return round(seconds * _NS_PER_S)
