# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""A window of measurements in the order of their stamps, each with the state after it; compiled.

Late measurements are put in their place and what comes after them is done again, so that the state is a
function of the *set* of measurements, whatever the order in which they came. ``process.process`` makes them.

A state is *settled* once it is older than the window: nothing that may still come can change it. Entry 0 is
where the estimate started, or the last state that was settled.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from trackslip_common.clock_monitor import CLOCK, NEVER_NS
from trackslip_common.compiled import compiled
from trackslip_estimation.slip.records import MEASUREMENT, SPROCKETS, STATE, UPDATE

Records = NDArray[np.void]

WINDOW = np.dtype(
    [
        ("started", np.bool_),  # else it holds only the sprocket samples of late
        ("frozen", np.bool_),  # poses are not wanted now
        ("count", np.int64),  # entries in use
        ("known", np.int64),  # of these, once started: how many have their state
        ("restarts", np.int64),  # since the clock went back, not those a user asked for
        ("published_ns", np.int64),  # stamp of the newest estimate
        ("divergences", np.int64),  # how often a state was not finite, and the estimate began anew
        ("clock", CLOCK),
    ],
    align=True,
)
SPARE = 8  # entries that a full window still has; the last one is where an arrival waits for its place


class Window(NamedTuple):
    """The records of one estimator."""

    status: Records  # (1,) of ``WINDOW``
    measurements: Records  # (capacity,) of ``MEASUREMENT``
    states: Records  # (capacity,) of ``STATE``
    updates: Records  # (capacity,) of ``UPDATE``

    @property
    def count(self) -> int:  # type: ignore[override]  # of all tuples
        """Entries in use."""
        return int(self.status["count"][0])


def make_window(capacity: int) -> Window:
    """An empty one."""
    window = Window(
        np.zeros(1, WINDOW),
        np.zeros(capacity, MEASUREMENT),
        np.zeros(capacity, STATE),
        np.zeros(capacity, UPDATE),
    )
    window.status["published_ns"] = NEVER_NS
    return window


def enlarged(window: Window) -> Window:
    """The same with room for twice as many entries."""
    larger = make_window(2 * len(window.states))
    for old, new in zip(window, larger, strict=True):
        new[: len(old)] = old
    return larger


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
def precedes(a: Any, b: Any) -> bool:
    """The one order of all measurements: stamp, then kind, then source."""
    if a.stamp_ns != b.stamp_ns:
        return bool(a.stamp_ns < b.stamp_ns)
    if a.kind != b.kind:
        return bool(a.kind < b.kind)
    return bool(a.source < b.source)


@compiled
def is_same(a: Any, b: Any) -> bool:
    """Whether two measurements have the same place in it."""
    return not precedes(a, b) and not precedes(b, a)


@compiled
def place_of(measurements: Records, count: int, measurement: Any) -> int:
    """Where a measurement belongs; after those that precede it."""
    k = count
    while k > 0 and not precedes(measurements[k - 1], measurement):
        k -= 1
    return k


@compiled
def is_at(measurements: Records, count: int, k: int, measurement: Any) -> bool:
    """Whether the measurement, whose place is k, is there already."""
    return k < count and not precedes(measurement, measurements[k])


@compiled
def insert(window: Window, k: int) -> None:
    """Put the arrival, which waits in the last entry, into entry k; no state from there on is known."""
    measurements, states, updates = window.measurements, window.states, window.updates
    for i in range(window.status[0].count, k, -1):
        measurements[i], states[i], updates[i] = measurements[i - 1], states[i - 1], updates[i - 1]
    measurements[k] = measurements[measurements.size - 1]
    window.status[0].count += 1
    window.status[0].known = min(window.status[0].known, k)


@compiled
def drop(window: Window, entries: int) -> None:
    """Let the first entries go."""
    measurements, states, updates = window.measurements, window.states, window.updates
    count = window.status[0].count - entries
    for i in range(count):
        measurements[i], states[i] = measurements[i + entries], states[i + entries]
        updates[i] = updates[i + entries]
    window.status[0].count = count
    window.status[0].known -= entries


@compiled
def horizon_ns(window: Window, c: Any) -> int:
    """Measurements before this stamp come too late: the start, or what is settled."""
    status = window.status[0]
    if not status.started:
        return NEVER_NS
    first_ns = window.measurements[0].stamp_ns
    return int(max(first_ns, status.clock.head_ns - c.window_ns) if status.clock.running else first_ns)


@compiled
def is_full(window: Window) -> bool:
    """Whether there is no room for one more."""
    return bool(window.status[0].count + SPARE >= window.states.size)


@compiled
def trim(window: Window, c: Any) -> bool:
    """Let settled entries go, but for the one that the window stands on; whether there is room again."""
    status = window.status[0]
    settled, kept_samples = 0, 0 if status.started else 2
    oldest_ns = status.clock.head_ns - c.window_ns
    while settled + 1 + kept_samples < status.count and window.measurements[settled + 1].stamp_ns < oldest_ns:
        settled += 1
    if settled > 0:
        drop(window, settled)
    return not is_full(window)
