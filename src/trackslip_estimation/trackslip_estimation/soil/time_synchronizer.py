# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Brings odometry, slips, swing and pressures of a stamp together, strictly in the order of stamps, compiled.

Each topic comes in its own time. A sample is given out once all that belongs to it is there: the pressures
before and after it, and where the weight swings where it is, or the certainty that they are not coming. So
what is made of the samples depends on the stamps alone, live as in a replay, as long as nothing is later than
``patience``.
"""

import math
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
    IS_HYDRAULICS,
    IS_ODOMETRY,
    IS_SWING,
    RESTARTED,
    SOIL_INPUT,
    SOURCES,
    TOO_LATE,
    UNPAIRED,
    VALUES,
    Rejection,
    copy_input,
    fault_of,
)
from trackslip_estimation.soil.stamp_clock import (
    BACK,
    CLOCK,
    FAR_AHEAD,
    IN_LINE,
    NEVER,
    follow,
    ns_of,
    start_again,
)

_MOST_HALVES = 200  # of pairs: 2 s at 100 Hz
_CAPACITY = 4096  # readings, and pairs that wait for them: 40 s at 100 Hz

_RING = np.dtype([("first", "i8"), ("count", "i8")])
SYNCHRONIZER = np.dtype(
    [
        ("reading_clock", CLOCK),
        ("pair_clock", CLOCK),
        ("swing_clock", CLOCK),
        ("readings", _RING),
        ("swings", _RING),
        ("pairs", _RING),
        ("halves", "i8"),
        ("done_ns", "i8"),  # stamp of the newest whole pair
        ("awaits_swings", "?"),  # whether they are waited for
        ("rejected", "i8", (len(SOURCES), len(Rejection))),  # how many
    ]
)
# Rows of the buffers: rings of readings, swings, and pairs that wait for them; halves of pairs, as they came
_READINGS, _SWINGS, _ODOMETRY, _SLIPS, _HALVES = range(5)
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

    patience: float = parameter(
        "how much later than the slips pressures and swing may come", unit="s", gt=0.0, le=10.0
    )
    longest_gap: float = parameter(
        "between two pressures, for the moment between them to have one", unit="s", gt=0.0
    )
    max_gap: float = parameter("stamps further ahead must be confirmed", unit="s", gt=0.0, le=600.0)
    jump_confirmations: int = parameter("stamps in a row that make another time believed", ge=2)


class TimeSynchronizer(NamedTuple):
    """Inputs in, in any order; samples out, in the order of their stamps. Bounded, whatever comes."""

    state: NDArray[Any]  # (1,) SYNCHRONIZER
    buffers: NDArray[Any]  # (5, n) SOIL_INPUT

    def rejected(self) -> Iterator[tuple[str, Rejection, int]]:
        """Source, reason, and how many."""
        for source, counts in zip(SOURCES, self.state["rejected"][0].tolist(), strict=True):
            for rejection, count in zip(Rejection, counts, strict=True):
                yield source, rejection, count


def new_synchronizer(awaits_swings: bool) -> TimeSynchronizer:
    """With nothing in it; ``awaits_swings``: whether a sample has a swing, too."""
    synchronizer = TimeSynchronizer(np.zeros(1, SYNCHRONIZER), np.zeros((5, _CAPACITY), SOIL_INPUT))
    state = synchronizer.state[0]
    state["done_ns"], state["awaits_swings"] = NEVER, awaits_swings
    for clock in ("reading_clock", "swing_clock", "pair_clock"):
        state[clock]["head_ns"] = NEVER
    return synchronizer


@compiled
def add(synchronizer: TimeSynchronizer, given: Any, p: Any) -> int:
    """Put one input in its place; ACCEPTED, or why it has none. After RESTARTED all begins anew."""
    state = synchronizer.state[0]
    rejection = fault_of(given)
    if rejection == ACCEPTED and given.source == IS_HYDRAULICS:
        rejection = _add_to(state.readings, state.reading_clock, synchronizer.buffers[_READINGS], given, p)
    elif rejection == ACCEPTED and given.source == IS_SWING:
        rejection = _add_to(state.swings, state.swing_clock, synchronizer.buffers[_SWINGS], given, p)
    elif rejection == ACCEPTED:
        rejection = _add_half(synchronizer, given, p)
    if rejection != ACCEPTED:
        state.rejected[given.source, rejection] += 1
    return rejection


@compiled
def is_ready(synchronizer: TimeSynchronizer, p: Any) -> bool:
    """Whether the oldest pair is there, and its pressures and swing are, or are not to come."""
    state = synchronizer.state[0]
    if state.pairs.count == 0:
        return False
    if state.pairs.count == _CAPACITY:
        return True
    stamp_ns = synchronizer.buffers[_ODOMETRY, state.pairs.first].stamp_ns
    there = _newest_ns(state.readings, synchronizer.buffers[_READINGS]) >= stamp_ns
    if state.awaits_swings:
        there = there and _newest_ns(state.swings, synchronizer.buffers[_SWINGS]) >= stamp_ns
    return bool(there or state.done_ns - stamp_ns >= ns_of(p.patience))


@compiled
def pop_oldest(synchronizer: TimeSynchronizer, p: Any, sample: Any) -> None:
    """Move the oldest pair into the sample, with its pressures and its swing."""
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
    _take_swing(synchronizer, sample)
    _drop_first(pairs)


@compiled
def _add_to(ring: Any, clock: Any, kept: NDArray[Any], given: Any, p: Any) -> int:
    """A reading or a swing, behind those before it."""
    newest_ns = _newest_ns(ring, kept)
    status = follow(clock, given.stamp_ns, newest_ns, p)
    if status == BACK:
        ring.count = 0
        start_again(clock, given.stamp_ns)
    elif status != IN_LINE:
        return AHEAD if status == FAR_AHEAD else TOO_LATE
    elif given.stamp_ns == newest_ns:
        return DUPLICATE
    horizon_ns = given.stamp_ns - 2 * ns_of(p.max_gap)
    while ring.count == _CAPACITY or (ring.count and kept[ring.first].stamp_ns < horizon_ns):
        _drop_first(ring)
    copy_input(given, kept[_place(ring, ring.count)])
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
    status = follow(state.pair_clock, given.stamp_ns, state.done_ns, p)
    if status == BACK:
        place = 0
    is_odometry = given.source == IS_ODOMETRY
    copy_input(given, synchronizer.buffers[_ODOMETRY if is_odometry else _SLIPS, place])
    copy_input(halves[k], synchronizer.buffers[_SLIPS if is_odometry else _ODOMETRY, place])
    _forget_half(synchronizer, k)
    if status == BACK:
        state.pairs.first = state.pairs.count = state.halves = 0
        start_again(state.pair_clock, given.stamp_ns)
    elif status != IN_LINE:
        return AHEAD if status == FAR_AHEAD else TOO_LATE
    elif given.stamp_ns == state.done_ns:
        return DUPLICATE
    state.done_ns = given.stamp_ns
    state.pairs.count += 1
    return RESTARTED if status == BACK else ACCEPTED


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
    if since_ns > gap_ns or gap_ns > ns_of(p.longest_gap):
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
def _take_swing(synchronizer: TimeSynchronizer, sample: Any) -> None:
    """That of the same stamp; where there is none it is not known."""
    state, swings = synchronizer.state[0], synchronizer.buffers[_SWINGS]
    ring = state.swings
    while ring.count and swings[ring.first].stamp_ns < sample.stamp_ns:
        _drop_first(ring)
    sample.swing, sample.swing_stddev = 0.0, math.inf
    if state.awaits_swings and ring.count and swings[ring.first].stamp_ns == sample.stamp_ns:
        sample.swing, sample.swing_stddev = swings[ring.first].swing, swings[ring.first].swing_stddev


@compiled
def _newest_ns(ring: Any, kept: NDArray[Any]) -> int:
    """Stamp of the last in a ring; NEVER where it is empty."""
    return int(kept[_place(ring, ring.count - 1)].stamp_ns) if ring.count else NEVER


@compiled
def _place(ring: Any, k: int) -> int:
    """Of the k-th in a ring."""
    return int((ring.first + k) % _CAPACITY)


@compiled
def _drop_first(ring: Any) -> None:
    ring.first = (ring.first + 1) % _CAPACITY
    ring.count -= 1
