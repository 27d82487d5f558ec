# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""A window of measurements in the order of their stamps, each with the state after it; compiled.

Late measurements are put in their place and what comes after them is done again, so that the state is a
function of the *set* of measurements, whatever the order in which they came. ``process.process`` makes them.

A state is *settled* once it is older than the window: nothing that may still come can change it. Entry 0 is
where the estimate started, or the last state that was settled.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from trackslip_common.clock_monitor import NEVER_NS, Clock
from trackslip_common.compiled import compiled
from trackslip_common.record_types import Record, Table, dtype_of, make_table
from trackslip_estimation.slip.correlated_errors import MASSES, RECEIVER, Masses, Receiver
from trackslip_estimation.slip.records import (
    BRANCH,
    ESTIMATE,
    EVENT,
    HEADING,
    MANUAL,
    MEASUREMENT,
    OLDER,
    ON_SWING,
    POSE,
    PRIOR,
    SPROCKETS,
    STATE,
    UPDATE,
    VELOCITY,
    Branch,
    EstimateRecord,
    EventRecord,
    MeasurementRecord,
    Prior,
    State,
    Update,
)

if TYPE_CHECKING:
    from trackslip_estimation.slip.config import Config

Records = NDArray[np.void]


class Status(Record):
    """Where a window stands."""

    started: bool  # else it holds only the sprocket samples of late
    frozen: bool  # poses are not wanted now
    count: int  # entries in use
    known: int  # of these, once started: how many have their state
    restarts: int  # since the clock went back, not those a user asked for
    published_ns: int  # stamp of the newest estimate
    divergences: int  # how often a state was not finite, and the estimate restarted
    scripted: bool  # one branch, whose events are those of the script
    played: int  # events of the script so far
    begun: int  # of these up to the first entry
    pooled: int  # entries of the pool in use, while children are made
    steps_left: int  # that further children may make
    clock: Clock


WINDOW = dtype_of(Status)

MOST_BRANCHES, POOL = 10, 64  # of the bank that stay; with children
SPARE = 8  # entries that a full window still has; the last one is where an arrival waits for its place


class Window(NamedTuple):
    """The records of one estimator."""

    status: Table[Status]  # (1,) of ``WINDOW``
    measurements: Table[MeasurementRecord]  # (capacity,) of ``MEASUREMENT``
    states: Table[State]  # (MOST_BRANCHES, capacity) of ``STATE``; the most probable branch first
    branches: Table[Branch]  # (MOST_BRANCHES, capacity) of ``BRANCH``
    counts: NDArray[np.int64]  # (capacity,) branches of each entry
    updates: Table[Update]  # (capacity,) of ``UPDATE``, of the first branch
    priors: Table[Prior]  # of ``PRIOR``: (capacity,) with a script, for the smoother; else (1,)
    trials: Table[Update]  # (MOST_BRANCHES,) of ``UPDATE``, of the others at the newest entry
    pool_states: Table[State]  # (POOL,) branches with children while they are weighed
    pool_branches: Table[Branch]
    pool_updates: Table[Update]
    receivers: Table[Receiver]  # (capacity, r) of ``RECEIVER``: errors of the fixes of each pose source
    masses: Table[Masses]  # (capacity, r) of ``MASSES``; of receivers whose fixes weigh them
    other: Table[EstimateRecord]  # (1,) of ``ESTIMATE``, of one branch while a mixture is made
    script: Table[EventRecord]  # (n,) of ``EVENT``

    @property
    def best(self) -> Records:
        """(capacity,) of ``STATE``, of the most probable branch."""
        return cast("Records", self.states[0])

    @property
    def count(self) -> int:  # type: ignore[override]  # of all tuples
        """Entries in use."""
        return int(self.status["count"][0])


def make_window(capacity: int, receivers: int, script: Records | None = None) -> Window:
    """An empty one for so many sources of poses.

    ``script``: (n,) of ``EVENT``, by which it has one branch, and no event but these.
    """
    window = Window(
        make_table(Status, WINDOW, 1),
        make_table(MeasurementRecord, MEASUREMENT, capacity),
        make_table(State, STATE, MOST_BRANCHES, capacity),
        make_table(Branch, BRANCH, MOST_BRANCHES, capacity),
        np.zeros(capacity, np.int64),
        make_table(Update, UPDATE, capacity),
        make_table(Prior, PRIOR, 1 if script is None else capacity),
        make_table(Update, UPDATE, MOST_BRANCHES),
        make_table(State, STATE, POOL),
        make_table(Branch, BRANCH, POOL),
        make_table(Update, UPDATE, POOL),
        make_table(Receiver, RECEIVER, capacity, receivers),
        make_table(Masses, MASSES, capacity, receivers),
        make_table(EstimateRecord, ESTIMATE, 1),
        make_table(EventRecord, EVENT, 0) if script is None else cast("Table[EventRecord]", script),
    )
    window.status["scripted"] = script is not None
    window.status["published_ns"] = NEVER_NS
    return window


def make_like(window: Window, capacity: int) -> Window:
    """An empty one for the same estimator."""
    script = window.script if window.status["scripted"][0] else None
    return make_window(capacity, window.receivers.shape[1], script)


def enlarged(window: Window) -> Window:
    """The same with room for twice as many entries."""
    larger, count = make_like(window, 2 * len(window.measurements)), window.count
    larger.status[:] = window.status
    last = len(window.measurements)
    larger.measurements[:last] = window.measurements
    larger.updates[:count], larger.counts[:count] = window.updates[:count], window.counts[:count]
    if window.status["scripted"][0]:
        larger.priors[:count] = window.priors[:count]
    rows = int(window.counts[:count].max(initial=1))  # memory of the others was never touched
    larger.states[:rows, :count] = window.states[:rows, :count]
    larger.branches[:rows, :count] = window.branches[:rows, :count]
    larger.receivers[:count] = window.receivers[:count]
    known = window.receivers["known"][:count].any(axis=0)
    larger.masses[:count, known] = window.masses[:count, known]
    return larger


def copy_first(window: Window, other: Window) -> None:
    """The first entry of ``other``, with all that the next row is made from, becomes that of a window."""
    window.measurements[0], window.counts[0] = other.measurements[0], other.counts[0]
    rows = int(other.counts[0])  # memory of further ones was never touched
    window.states[:rows, 0], window.branches[:rows, 0] = other.states[:rows, 0], other.branches[:rows, 0]
    window.receivers[0], window.masses[0] = other.receivers[0], other.masses[0]


@compiled
def is_weighed(measurement: MeasurementRecord) -> bool:
    """Whether branches are weighed by a measurement."""
    kind = measurement.kind
    return bool((kind == POSE and measurement.source != MANUAL) or kind in (HEADING, ON_SWING, VELOCITY))


@compiled
def prior_of(window: Window, k: int) -> Prior:
    """What a scripted branch knew before measurement k; without a script, what the last step knew before."""
    return window.priors[k if window.status[0].scripted else 0]


@compiled
def copy_receivers(
    receivers: Table[Receiver], masses: Table[Masses], k: int, before: int, with_masses: bool
) -> None:
    """Those of entry k become those of the entry ``before``, with their masses or without."""
    for n in range(receivers.shape[1]):
        receivers[k, n] = receivers[before, n]
        if with_masses and receivers[k, n].known != 0:
            masses[k, n] = masses[before, n]


@compiled
def next_sample(measurements: Records, first: int, count: int) -> int:
    """Number of the first sprocket sample from ``first`` on; ``count`` where there is none."""
    k = first
    while k < count and measurements[k].kind != SPROCKETS:
        k += 1
    return k


@compiled
def last_sample(measurements: Records, before: int) -> int:
    """Number of the last sprocket sample before ``before``; −1 where there is none."""
    k = before - 1
    while k >= 0 and measurements[k].kind != SPROCKETS:
        k -= 1
    return k


@compiled
def precedes(a: MeasurementRecord, b: MeasurementRecord) -> bool:
    """The one order of all measurements: stamp, then kind, then source."""
    if a.stamp_ns != b.stamp_ns:
        return bool(a.stamp_ns < b.stamp_ns)
    if a.kind != b.kind:
        return bool(a.kind < b.kind)
    return bool(a.source < b.source)


@compiled
def is_same(a: MeasurementRecord, b: MeasurementRecord) -> bool:
    """Whether two measurements have the same place in it."""
    return not precedes(a, b) and not precedes(b, a)


@compiled
def place_of(measurements: Records, count: int, measurement: MeasurementRecord) -> int:
    """Where a measurement belongs; after those that precede it."""
    k = count
    while k > 0 and not precedes(measurements[k - 1], measurement):
        k -= 1
    return k


@compiled
def is_at(measurements: Records, count: int, k: int, measurement: MeasurementRecord) -> bool:
    """Whether the measurement, whose place is k, is there already."""
    return k < count and not precedes(measurement, measurements[k])


@compiled
def insert(window: Window, k: int) -> None:
    """Put the arrival, which waits in the last entry, into entry k; no row from there on is known."""
    measurements, status = window.measurements, window.status[0]
    for i in range(status.count, k, -1):
        measurements[i] = measurements[i - 1]
    measurements[k] = measurements[measurements.size - 1]
    status.count += 1
    status.known = min(status.known, k)


@compiled
def drop(window: Window, entries: int, whole: int) -> None:
    """Remove the first entries, and of rows before ``whole`` all that no row from there on looks back to."""
    status, measurements, counts = window.status[0], window.measurements, window.counts
    receivers, masses = window.receivers, window.masses
    count, known = status.count - entries, status.known - entries
    for i in range(count):
        measurements[i] = measurements[i + entries]
    for i in range(known):
        counts[i] = counts[i + entries]
        copy_receivers(receivers, masses, i, i + entries, i + entries >= whole)
    _move_snapshots(window, entries, whole)
    for i in range(whole - entries, known):
        window.updates[i] = window.updates[i + entries]
        if status.scripted:
            window.priors[i] = window.priors[i + entries]
        for s in range(counts[i]):
            _move_branch(window, s, i + entries, entries)
    status.count, status.known = count, known


@compiled
def _move_snapshots(window: Window, entries: int, whole: int) -> None:
    """To where they are without the first entries: what row ``whole`` looks back to, the oldest first."""
    moved = entries - 1
    while True:
        oldest = whole
        for b in range(window.counts[whole]):
            for snapshot in window.branches[b, whole].snapshots:
                if moved < snapshot.entry < oldest:
                    oldest = snapshot.entry
        if oldest == whole:
            return
        for b in range(window.counts[whole]):
            for snapshot in window.branches[b, whole].snapshots:
                if snapshot.entry == oldest:
                    _move_branch(window, snapshot.slot, oldest, entries)
        moved = oldest


@compiled
def _move_branch(window: Window, s: int, k: int, entries: int) -> None:
    """Branch s of row k to where the row is without the first entries."""
    window.states[s, k - entries], window.branches[s, k - entries] = (
        window.states[s, k],
        window.branches[s, k],
    )
    for snapshot in window.branches[s, k - entries].snapshots:
        snapshot.entry = max(snapshot.entry - entries, 0)


@compiled
def oldest_needed(window: Window, k: int) -> int:
    """The oldest entry that rows from k on are made from."""
    oldest = k
    for s in range(window.counts[k]):
        oldest = min(oldest, window.branches[s, k].snapshots[OLDER].entry)
    return oldest


@compiled
def keep_tail(window: Window) -> None:
    """Remove the entries that no further row is made from."""
    status = window.status[0]
    last, status.begun = status.count - 1, status.played
    drop(window, last if status.scripted else oldest_needed(window, last), last)


@compiled
def horizon_ns(window: Window, c: Config) -> int:
    """Measurements before this stamp come too late: the start, or what is settled."""
    status = window.status[0]
    if not status.started:
        return NEVER_NS
    first_ns = window.measurements[0].stamp_ns
    return int(max(first_ns, status.clock.head_ns - c.window_ns) if status.clock.running else first_ns)


@compiled
def is_full(window: Window) -> bool:
    """Whether there is no room for one more."""
    return bool(window.status[0].count + SPARE >= window.measurements.size)


@compiled
def trim(window: Window, c: Config) -> bool:
    """Let settled entries go, but for the one that the window stands on; whether there is room again."""
    status = window.status[0]
    settled, kept_samples = 0, 0 if status.started else 2
    oldest_ns = status.clock.head_ns - c.window_ns
    while settled + 1 + kept_samples < status.count and window.measurements[settled + 1].stamp_ns < oldest_ns:
        settled += 1
    oldest = oldest_needed(window, settled) if status.started else settled
    if oldest > 0:
        drop(window, oldest, settled)
    return not is_full(window)
