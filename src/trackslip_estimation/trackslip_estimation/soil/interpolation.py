# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Pressures at the stamp of each machine state, interpolated linearly between two readings, compiled.

A state waits for a reading at or after its stamp, or for a state that is newer by ``patience``. Samples thus
depend on the stamps alone, live and in replay, as long as no reading is later than ``patience``.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, NamedTuple

import numpy as np

from trackslip_common.arrays import FloatArray, IntArray
from trackslip_common.clock_monitor import (
    CLOCK_LIMITS,
    NEVER_NS,
    Clock,
    ClockLimits,
    StampStatus,
    check_sample,
)
from trackslip_common.compiled import compiled
from trackslip_common.parameters import Parameters, parameter
from trackslip_common.record_types import Record, Table, dtype_of, make_table
from trackslip_estimation.soil.records import (
    ACCEPTED,
    AHEAD,
    DUPLICATE,
    IS_HYDRAULICS,
    IS_MACHINE_STATE,
    RESTARTED,
    SOIL_INPUT,
    SOURCES,
    TOO_LATE,
    InputValues,
    Rejection,
    SoilInputRecord,
    check_input,
    copy_input,
    copy_state,
)

_CAPACITY = 4096  # readings, and waiting states: 40 s at 100 Hz
_IN_LINE, _AHEAD, _BEHIND, _BACK = map(int, StampStatus)


class Queue(Record):
    """Ring buffer of inputs."""

    clock: Clock
    newest_ns: int
    first: int
    count: int


class Sample(InputValues):
    """Machine state with pressures and spools interpolated to its stamp."""

    has_pressures: int  # whether readings before and after the stamp exist
    reading: Annotated[FloatArray, 2]  # pressures of the newer reading, Pa, not interpolated
    dt: float  # s since the previous sample
    tracks: Annotated[FloatArray, 2]  # track speeds r ω, m/s; nan where the slip is 1


QUEUE, SAMPLE = dtype_of(Queue), dtype_of(Sample)


@dataclass(frozen=True, kw_only=True)
class InterpolationParameters(Parameters):
    """Waiting time of states for pressures, and limits of the stamps."""

    patience: float = parameter(
        "longest delay of pressures behind the machine state", unit="s", gt=0.0, le=10.0
    )
    longest_gap: float = parameter("longest time between two readings to interpolate over", unit="s", gt=0.0)
    max_gap: float = parameter("stamps further ahead than this must be confirmed", unit="s", gt=0.0, le=600.0)
    jump_confirmations: int = parameter("consecutive stamps that confirm a jump of the clock", ge=2)


class Interpolator(NamedTuple):
    """Queues of both sources, of bounded size; returns samples in the order of their stamps."""

    queues: Table[Queue]  # (2,), by source
    rows: Table[SoilInputRecord]  # (2, n), inputs of the queues
    rejected: IntArray  # (2, r), number of inputs by source and Rejection
    limits: Table[ClockLimits]  # (1,)

    def counts(self) -> Iterator[tuple[str, Rejection, int]]:
        """Yield source, reason and number of the rejected inputs."""
        for source, counts in zip(SOURCES, self.rejected.tolist(), strict=True):
            for rejection, count in zip(Rejection, counts, strict=True):
                yield source, rejection, count


def new_interpolator(p: InterpolationParameters) -> Interpolator:
    """Return an empty interpolator."""
    queues = make_table(Queue, QUEUE, len(SOURCES))
    queues["newest_ns"] = NEVER_NS
    rows = make_table(SoilInputRecord, SOIL_INPUT, len(SOURCES), _CAPACITY)
    limits = make_table(ClockLimits, CLOCK_LIMITS, 1)
    limits["gap_ns"], limits["confirmations"] = round(p.max_gap * 1e9), p.jump_confirmations
    return Interpolator(queues, rows, np.zeros((len(SOURCES), len(Rejection)), np.int64), limits)


@compiled
def add_input(interpolator: Interpolator, record: SoilInputRecord) -> int:
    """Queue an input; return ACCEPTED or why not (RESTARTED: the clock of the states went back)."""
    source, rejection = record.source, check_input(record)
    if rejection == ACCEPTED:
        rejection = _append_input(
            interpolator.queues[source], interpolator.rows[source, :], interpolator.limits[0], record
        )
    if rejection == RESTARTED and source == IS_HYDRAULICS:
        return ACCEPTED
    if rejection != ACCEPTED:
        interpolator.rejected[source, rejection] += 1
    return rejection


@compiled
def is_ready(interpolator: Interpolator, p: InterpolationParameters) -> bool:
    """Whether the oldest state can be popped: pressures present, ``patience`` over, or queue full."""
    states, readings = interpolator.queues[IS_MACHINE_STATE], interpolator.queues[IS_HYDRAULICS]
    if states.count == 0:
        return False
    stamp_ns = interpolator.rows[IS_MACHINE_STATE, states.first].stamp_ns
    is_late = states.newest_ns - stamp_ns >= round(p.patience * 1e9)
    return bool(is_late or readings.newest_ns >= stamp_ns or states.count == _CAPACITY)


@compiled
def pop_oldest(interpolator: Interpolator, p: InterpolationParameters, sample: Sample) -> None:
    """Move the oldest state into the sample, with the pressures at its stamp."""
    states = interpolator.queues[IS_MACHINE_STATE]
    copy_state(interpolator.rows[IS_MACHINE_STATE, states.first], sample)
    _drop_first(states)
    readings, rows = interpolator.queues[IS_HYDRAULICS], interpolator.rows[IS_HYDRAULICS, :]
    sample.has_pressures = _interpolate(readings, rows, p, sample)


@compiled
def _append_input(
    queue: Queue, rows: Table[SoilInputRecord], limits: ClockLimits, record: SoilInputRecord
) -> int:
    """Append an input to its queue; RESTARTED where the clock of its source went back."""
    status = check_sample(queue.clock, limits, record.stamp_ns, queue.newest_ns, False)
    if status == _BACK:
        queue.count, queue.clock.running = 0, False
        check_sample(queue.clock, limits, record.stamp_ns, NEVER_NS, False)
    elif status != _IN_LINE:
        return AHEAD if status == _AHEAD else TOO_LATE
    elif record.stamp_ns == queue.newest_ns:
        return DUPLICATE
    if queue.count == _CAPACITY:
        _drop_first(queue)
    copy_input(record, rows[_ring_index(queue, queue.count)])
    queue.count, queue.newest_ns = queue.count + 1, record.stamp_ns
    return RESTARTED if status == _BACK else ACCEPTED


@compiled
def _interpolate(
    queue: Queue, readings: Table[SoilInputRecord], p: InterpolationParameters, sample: Sample
) -> bool:
    """Set pressures and spools at the stamp; False if a reading before or after is missing or too far."""
    while queue.count > 1 and readings[_ring_index(queue, 1)].stamp_ns <= sample.stamp_ns:
        _drop_first(queue)
    if queue.count == 0 or readings[queue.first].stamp_ns > sample.stamp_ns:
        return False
    before, after = readings[queue.first], readings[_ring_index(queue, min(1, queue.count - 1))]
    gap_ns, since_ns = after.stamp_ns - before.stamp_ns, sample.stamp_ns - before.stamp_ns
    if since_ns > gap_ns or gap_ns > round(p.longest_gap * 1e9):
        return False
    share = since_ns / gap_ns if gap_ns > 0 else 0.0
    newer = after if share > 0.0 else before
    for k in range(2):
        sample.reading[k] = newer.pressures[k]
        sample.pressures[k] = before.pressures[k] + share * (after.pressures[k] - before.pressures[k])
        sample.spools[k] = before.spools[k] + share * (after.spools[k] - before.spools[k])
    return True


@compiled
def _ring_index(queue: Queue, k: int) -> int:
    """Return the index in the ring of the k-th input of a queue."""
    return int((queue.first + k) % _CAPACITY)


@compiled
def _drop_first(queue: Queue) -> None:
    queue.first, queue.count = (queue.first + 1) % _CAPACITY, queue.count - 1
