# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""A window of measurements in the order of their stamps, each with the state after it; compiled.

A late measurement is inserted by its stamp, and the states after it are computed again. The state is thus a
function of the *set* of measurements, independent of their order of arrival. ``process.process`` computes the
states.

A state is *settled* once it is older than the window: no later arrival can change it. Entry 0 is the start of
the estimate, or the oldest entry still needed.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from trackslip_common.clock_monitor import NEVER_NS, Clock
from trackslip_common.compiled import compiled
from trackslip_common.record_types import Record, Table, dtype_of, make_table
from trackslip_estimation.slip.correlated_errors import MASSES, NO_FIX, RECEIVER, Masses, Receiver
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
    """Status of a window."""

    started: bool  # False: the window holds recent sprocket samples only
    frozen: bool  # whether poses and headings are rejected
    count: int  # number of entries in use
    known: int  # number of entries with a state, once started
    restarts: int  # number of restarts by a clock that went back
    published_ns: int  # stamp of the newest estimate
    divergences: int  # number of restarts by a state that was not finite
    scripted: bool  # whether there is one branch, with the events of the script
    played: int  # number of events of the script so far
    begun: int  # number of events of the script up to the first entry
    pooled: int  # entries of the pool in use while children are created
    share_left: float  # of the steps or the time that children may repeat
    clock: Clock


WINDOW = dtype_of(Status)

MOST_BRANCHES, POOL = 10, 128  # branches of a row, without and with children
SPARE = 8  # free entries of a full window; the last one holds an arrival before its insertion


class Window(NamedTuple):
    """The records of one estimator."""

    status: Table[Status]  # (1,) of ``WINDOW``
    measurements: Table[MeasurementRecord]  # (capacity,) of ``MEASUREMENT``
    states: Table[State]  # (MOST_BRANCHES, capacity) of ``STATE``; most probable branch first
    branches: Table[Branch]  # (MOST_BRANCHES, capacity) of ``BRANCH``
    counts: NDArray[np.int64]  # (capacity,) number of branches by entry
    updates: Table[Update]  # (capacity,) of ``UPDATE``, of the first branch
    priors: Table[Prior]  # of ``PRIOR``: (capacity,) with a script, for the smoother; else (1,)
    branch_updates: Table[Update]  # (MOST_BRANCHES,) of ``UPDATE``, of the other branches at the newest entry
    pool_states: Table[State]  # (POOL,) branches and children during the weighing
    pool_branches: Table[Branch]
    pool_updates: Table[Update]
    receivers: Table[Receiver]  # (capacity, r) of ``RECEIVER``: errors of the fixes of each pose source
    masses: Table[Masses]  # (capacity, r) of ``MASSES``, of receivers with fixes
    other: Table[EstimateRecord]  # (1,) of ``ESTIMATE``, of one branch during the merging of the mixture
    script: Table[EventRecord]  # (n,) of ``EVENT``

    @property
    def best(self) -> Records:
        """(capacity,) of ``STATE``, of the most probable branch."""
        return cast("Records", self.states[0])

    @property
    def count(self) -> int:  # type: ignore[override]  # of all tuples
        """Number of entries in use."""
        return int(self.status["count"][0])


def make_window(capacity: int, receivers: int, script: Records | None = None) -> Window:
    """Make an empty window; ``receivers``: number of pose sources.

    ``script``: (n,) of ``EVENT``, the only events of the only branch.
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
    """Make an empty window of another capacity for the same estimator."""
    script = window.script if window.status["scripted"][0] else None
    return make_window(capacity, window.receivers.shape[1], script)


def enlarged_copy(window: Window) -> Window:
    """Copy a window to one of twice the capacity."""
    larger, count = make_like(window, 2 * len(window.measurements)), window.count
    larger.status[:] = window.status
    last = len(window.measurements)
    larger.measurements[:last] = window.measurements
    larger.updates[:count], larger.counts[:count] = window.updates[:count], window.counts[:count]
    if window.status["scripted"][0]:
        larger.priors[:count] = window.priors[:count]
    rows = int(window.counts[:count].max(initial=1))  # further rows are unused memory
    larger.states[:rows, :count] = window.states[:rows, :count]
    larger.branches[:rows, :count] = window.branches[:rows, :count]
    larger.receivers[:count] = window.receivers[:count]
    has_fixes = (window.receivers["status"][:count] != NO_FIX).any(axis=0)
    larger.masses[:count, has_fixes] = window.masses[:count, has_fixes]
    return larger


def copy_first_entry(window: Window, other: Window) -> None:
    """Copy the first entry of ``other`` to a window, with all input of the next row."""
    window.measurements[0], window.counts[0] = other.measurements[0], other.counts[0]
    rows = int(other.counts[0])  # further rows are unused memory
    window.states[:rows, 0], window.branches[:rows, 0] = other.states[:rows, 0], other.branches[:rows, 0]
    window.receivers[0], window.masses[0] = other.receivers[0], other.masses[0]


@compiled
def is_weighed(measurement: MeasurementRecord) -> bool:
    """Whether a measurement weighs branches."""
    kind = measurement.kind
    return bool((kind == POSE and measurement.source != MANUAL) or kind in (HEADING, ON_SWING, VELOCITY))


@compiled
def prior_of(window: Window, k: int) -> Prior:
    """Record of ``PRIOR`` for measurement k of a scripted window; without a script, of the latest step."""
    return window.priors[k if window.status[0].scripted else 0]


@compiled
def copy_receivers(
    receivers: Table[Receiver], masses: Table[Masses], k: int, before: int, with_masses: bool
) -> None:
    """Copy the receivers of entry ``before`` to entry k, and their masses if ``with_masses``."""
    for n in range(receivers.shape[1]):
        receivers[k, n] = receivers[before, n]
        if with_masses and receivers[k, n].status != NO_FIX:
            masses[k, n] = masses[before, n]


@compiled
def next_sample(measurements: Records, first: int, count: int) -> int:
    """Entry of the first sprocket sample from ``first`` on; ``count``: none."""
    k = first
    while k < count and measurements[k].kind != SPROCKETS:
        k += 1
    return k


@compiled
def last_sample(measurements: Records, before: int) -> int:
    """Entry of the last sprocket sample before entry ``before``; −1: none."""
    k = before - 1
    while k >= 0 and measurements[k].kind != SPROCKETS:
        k -= 1
    return k


@compiled
def precedes(a: MeasurementRecord, b: MeasurementRecord) -> bool:
    """Whether a precedes b in the order of measurements: by stamp, then kind, then source."""
    if a.stamp_ns != b.stamp_ns:
        return bool(a.stamp_ns < b.stamp_ns)
    if a.kind != b.kind:
        return bool(a.kind < b.kind)
    return bool(a.source < b.source)


@compiled
def is_same(a: MeasurementRecord, b: MeasurementRecord) -> bool:
    """Whether two measurements have the same stamp, kind and source."""
    return not precedes(a, b) and not precedes(b, a)


@compiled
def insertion_index(measurements: Records, count: int, measurement: MeasurementRecord) -> int:
    """Entry at which to insert a measurement: after those that precede it."""
    k = count
    while k > 0 and not precedes(measurements[k - 1], measurement):
        k -= 1
    return k


@compiled
def is_duplicate(measurements: Records, count: int, k: int, measurement: MeasurementRecord) -> bool:
    """Whether entry k, the insertion index of a measurement, already holds the same measurement."""
    return k < count and not precedes(measurement, measurements[k])


@compiled
def insert(window: Window, k: int) -> None:
    """Move the arrival from the last entry to entry k; rows from k on become unknown."""
    measurements, status = window.measurements, window.status[0]
    for i in range(status.count, k, -1):
        measurements[i] = measurements[i - 1]
    measurements[k] = measurements[measurements.size - 1]
    status.count += 1
    status.known = min(status.known, k)


@compiled
def remove_entries(window: Window, entries: int, whole: int) -> None:
    """Remove the first entries; of rows before ``whole`` keep only branches that snapshots refer to."""
    status, measurements, counts = window.status[0], window.measurements, window.counts
    receivers, masses = window.receivers, window.masses
    count, known = status.count - entries, status.known - entries
    for i in range(count):
        measurements[i] = measurements[i + entries]
    for i in range(known):
        counts[i] = counts[i + entries]
        copy_receivers(receivers, masses, i, i + entries, i + entries >= whole)
    _move_snapshot_branches(window, entries, whole)
    for i in range(whole - entries, known):
        window.updates[i] = window.updates[i + entries]
        if status.scripted:
            window.priors[i] = window.priors[i + entries]
        for s in range(counts[i]):
            _move_branch(window, s, i + entries, entries)
    status.count, status.known = count, known


@compiled
def _move_snapshot_branches(window: Window, entries: int, whole: int) -> None:
    """Move the branches that snapshots of row ``whole`` refer to by ``entries`` rows, oldest first."""
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
    """Move branch s of row k by ``entries`` rows to the front, with its snapshots."""
    window.states[s, k - entries], window.branches[s, k - entries] = (
        window.states[s, k],
        window.branches[s, k],
    )
    for snapshot in window.branches[s, k - entries].snapshots:
        snapshot.entry = max(snapshot.entry - entries, 0)


@compiled
def oldest_needed_entry(window: Window, k: int) -> int:
    """Oldest entry from which rows after k are computed."""
    oldest = k
    for s in range(window.counts[k]):
        oldest = min(oldest, window.branches[s, k].snapshots[OLDER].entry)
    return oldest


@compiled
def remove_unneeded_entries(window: Window) -> None:
    """Remove the entries that no further row needs."""
    status = window.status[0]
    last, status.begun = status.count - 1, status.played
    remove_entries(window, last if status.scripted else oldest_needed_entry(window, last), last)


@compiled
def horizon_ns(window: Window, c: Config) -> int:
    """Oldest stamp of a measurement in time, ns: that of entry 0, or the oldest one that is not settled."""
    status = window.status[0]
    if not status.started:
        return NEVER_NS
    first_ns = window.measurements[0].stamp_ns
    return int(max(first_ns, status.clock.head_ns - c.window_ns) if status.clock.running else first_ns)


@compiled
def is_full(window: Window) -> bool:
    """Whether there is no room for one more entry."""
    return bool(window.status[0].count + SPARE >= window.measurements.size)


@compiled
def remove_settled_entries(window: Window, c: Config) -> bool:
    """Remove settled entries that no row needs; return whether there is room again."""
    status = window.status[0]
    settled, kept_samples = 0, 0 if status.started else 2
    oldest_ns = status.clock.head_ns - c.window_ns
    while settled + 1 + kept_samples < status.count and window.measurements[settled + 1].stamp_ns < oldest_ns:
        settled += 1
    oldest = oldest_needed_entry(window, settled) if status.started else settled
    if oldest > 0:
        remove_entries(window, oldest, settled)
    return not is_full(window)
