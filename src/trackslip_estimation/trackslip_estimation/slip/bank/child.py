# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Create a child of a branch, in which one event happened; compiled.

The prior of a child is the rate of the event times the time in which it may have happened. This is the time
since the source's previous measurement, or since the snapshot, from which the child repeats the steps. The
prior of an event with a uniform position or angle includes that uniform density.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from trackslip_common.compiled import compiled
from trackslip_estimation.slip.bank.event_effects import apply_event
from trackslip_estimation.slip.bank.script import record_event
from trackslip_estimation.slip.events import BIASED, MOVED, OFFSET, SKIDDED, SLIPPED, TURNED
from trackslip_estimation.slip.models.model import YAW, X, Y
from trackslip_estimation.slip.records import HISTORY, OLDER, POSE
from trackslip_estimation.slip.source_faults import unknown_position_stddev
from trackslip_estimation.slip.source_offsets import pose_source_number
from trackslip_estimation.slip.window import POOL, Window

if TYPE_CHECKING:
    from trackslip_estimation.slip.config import Config
    from trackslip_estimation.slip.records import MeasurementRecord, State


@compiled
def log_measurement_interval(window: Window, p: int, k: int, c: Config) -> float:
    """ln of the time since the source's previous measurement, s."""
    m = window.measurements[k]
    elapsed_ns = m.stamp_ns - window.states[p, k - 1].weighed_ns[m.source]
    return math.log(max(elapsed_ns * 1e-9, c.bank.shortest_time))


@compiled
def log_time_since_snapshot(window: Window, p: int, k: int, c: Config) -> float:
    """ln of the time since the snapshot of branch p, s."""
    snapshot = window.branches[p, k].snapshots[OLDER]
    elapsed_ns = window.measurements[k].stamp_ns - window.states[snapshot.slot, snapshot.entry].stamp_ns
    return math.log(max(elapsed_ns * 1e-9, c.bank.shortest_time))


@compiled
def distance_since_snapshot(window: Window, p: int, k: int) -> float:
    """Track distance since the snapshot of branch p of row k − 1, m."""
    snapshot = window.branches[p, k - 1].snapshots[OLDER]
    then = window.states[snapshot.slot, snapshot.entry]
    return float(window.states[p, k - 1].track_distance - then.track_distance)


@compiled
def squared_jump(m: MeasurementRecord, before: State) -> float:
    """Squared distance of a fix from the position of the previous state, m²."""
    return float((m.value[X] - before.mean[X]) ** 2 + (m.value[Y] - before.mean[Y]) ** 2)


@compiled
def add_child_at_measurement(
    window: Window, p: int, k: int, event: int, source: int, log_odds: float, c: Config
) -> None:
    """Add a child with an event just before measurement k; ``log_odds``: further term of its prior."""
    prior = log_measurement_interval(window, p, k, c) + c.log_rates[event, source] + log_odds
    add_child(window, p, k, event, source, 0, False, prior, c)


@compiled
def add_child_since_snapshot(
    window: Window, p: int, k: int, event: int, source: int, part: int, log_odds: float, c: Config
) -> None:
    """Add a child with an event since the snapshot; ``part`` as in ``EventRecord``, ``log_odds`` as above."""
    prior = log_time_since_snapshot(window, p, k, c) + c.log_rates[event, source] + log_odds
    add_child(window, p, k, event, source, part, True, prior, c)


@compiled
def add_child(
    window: Window,
    p: int,
    k: int,
    event: int,
    source: int,
    part: int,
    since: bool,
    log_prior: float,
    c: Config,
) -> None:
    """Add to the pool a child of branch p: an event just before measurement k, or ``since`` the snapshot.

    Nothing is added if the pool is full, or if the child would repeat more than the share that is left.
    """
    status, before, m = window.status[0], window.branches[p, k - 1], window.measurements[k]
    snapshot = before.snapshots[OLDER]
    first, h = snapshot.entry + 1 if since else k, status.pooled
    share = _share(m.stamp_ns - window.measurements[first - 1].stamp_ns, k + 1 - first, c) if since else 0.0
    if share > status.share_left or h == POOL:
        return
    status.pooled, status.share_left = h + 1, status.share_left - share
    state, branch, update = window.pool_states[h], window.pool_branches[h], window.pool_updates[h]
    window.pool_branches[h] = before
    if since:
        window.pool_states[h] = window.states[snapshot.slot, snapshot.entry]
        branch.weight = snapshot.weight + log_prior
        snapshot_ns = window.measurements[snapshot.entry].stamp_ns
        while branch.events > 0 and branch.history[(branch.events - 1) % HISTORY].decided_ns > snapshot_ns:
            branch.events -= 1
    else:
        window.pool_states[h] = window.states[p, k - 1]
        branch.weight = before.weight + log_prior
    branch.first, branch.fresh = first, 1
    if event in (TURNED, BIASED):
        branch.course = 0.0
    value = _event_value(window, p, k, event, source, since, c)
    e = record_event(branch, event, source, part, value, m, window.measurements[first], 0)
    update.event = event
    update.reset_states = apply_event(state, e, c)


@compiled
def add_sector_event(
    window: Window, h: int, source: int, part: int, k: int, first: int, after: int, c: Config
) -> None:
    """Restrict the heading of branch h of the pool to a sector of the circle at measurement k.

    It is restricted before (0) or ``after`` (1) the step to measurement ``first``.
    """
    _add_event(window, h, TURNED, source, part, 0.0, k, first, after, c)


@compiled
def add_angle_child(
    window: Window,
    p: int,
    k: int,
    event: int,
    part: int,
    angle_event: int,
    angle_part: int,
    log_prior: float,
    c: Config,
) -> None:
    """Add to the pool a child of branch p with an event just before fix k, which concerns its heading too.

    ``event`` and ``part`` concern the positions, ``angle_event`` and ``angle_part`` the headings.
    """
    h, m = window.status[0].pooled, window.measurements[k]
    add_child(window, p, k, event, m.source, part, False, log_prior, c)
    if window.status[0].pooled > h:
        _add_event(window, h, angle_event, m.source, angle_part, m.value[YAW], k, k, 0, c)


@compiled
def _add_event(
    window: Window,
    h: int,
    event: int,
    source: int,
    part: int,
    value: float,
    k: int,
    first: int,
    after: int,
    c: Config,
) -> None:
    """Add to branch h of the pool another event that explains measurement k, in the step to ``first``."""
    step, explained = window.measurements[first], window.measurements[k]
    e = record_event(window.pool_branches[h], event, source, part, value, explained, step, after)
    window.pool_updates[h].reset_states |= apply_event(window.pool_states[h], e, c)
    if event == TURNED:
        window.pool_branches[h].course = 0.0


@compiled
def _share(repeated_ns: int, steps: int, c: Config) -> float:
    """Share of what the children of one measurement may repeat: of its time or of its steps, if smaller."""
    return float(min(repeated_ns * 1e-9 / c.bank.child_time, steps / c.bank.steps))


@compiled
def _event_value(window: Window, p: int, k: int, event: int, source: int, since: bool, c: Config) -> float:
    """Field ``value`` of the ``EventRecord`` of an event at measurement k."""
    m, before = window.measurements[k], window.states[p, k - 1]
    if event == SKIDDED:
        seconds = math.exp(log_time_since_snapshot(window, p, k, c))
        return (
            c.events.skid_share
            * distance_since_snapshot(window, p, k)
            * min(c.events.skid_time / seconds, 1.0)
        )
    if event in (SLIPPED, BIASED):
        return 0.0 if since else float(c.receivers.longest_time)
    if event == OFFSET and pose_source_number(source, c) < 0:
        return float(c.events.velocity_stddev)
    if m.kind == POSE and event in (OFFSET, MOVED):
        return unknown_position_stddev(squared_jump(m, before))
    return float(m.value[0])
