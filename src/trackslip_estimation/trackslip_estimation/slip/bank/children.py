# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Children of a branch that a measurement contradicts: in each one event happened; compiled.

Its prior is the rate of the event times the time in which it may have happened: since the source's
measurement before, or since the snapshot, from which the child makes its steps again. An event that is as
likely at every place, or for every angle, has the density of that.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from trackslip_common.compiled import compiled
from trackslip_estimation.slip.bank.lags import is_behind, log_odds_of_lag, log_time
from trackslip_estimation.slip.bank.pool import to_pool, update_of
from trackslip_estimation.slip.bank.script import remember
from trackslip_estimation.slip.events import (
    BIASED,
    FOLDED,
    HEADING_OFF,
    HEADING_WANDERS,
    HEADINGS,
    IS_MISCOUNTING,
    IS_OFFSET,
    IS_REPEATING,
    IS_SCATTERING,
    IS_SOUND,
    IS_STAYING,
    IS_STRAYING,
    LOST,
    MEASURED,
    MOVED,
    NOISE,
    OFFSET,
    OUTLIER,
    REPEATS,
    SCATTERS,
    SKIDDED,
    SLID,
    SLIPPED,
    SOUND,
    STAYS,
    STRAYS,
    SWUNG,
    TURNED,
    UNKNOWN_HEADING,
    WANDERS,
    apply_event,
    is_heading_off,
    is_steep,
    is_straying,
    is_trusted,
    log_rate,
    reach,
    strays,
    wander_stddev,
    wanders,
)
from trackslip_estimation.slip.faulty_sources import is_repeated, log_density_of_any_size, may_repeat
from trackslip_estimation.slip.measurements import Outcome
from trackslip_estimation.slip.models.dispatch import has_velocity_errors
from trackslip_estimation.slip.models.model import YAW, X, Y
from trackslip_estimation.slip.models.speed import COMMON_SLIP
from trackslip_estimation.slip.models.swing import may_swing
from trackslip_estimation.slip.motion import Motion
from trackslip_estimation.slip.own_errors import errs_by_place, is_correlated, number_of
from trackslip_estimation.slip.records import (
    GYROS,
    HEADING,
    HISTORY,
    MOST_SOURCES,
    OLDER,
    ON_SWING,
    POSE,
    TRACKS,
    VELOCITY,
)
from trackslip_estimation.slip.window import POOL, Window

if TYPE_CHECKING:
    from trackslip_estimation.slip.config import Config
    from trackslip_estimation.slip.records import MeasurementRecord, State, Update

_ANY_SHARE = math.log(HEADINGS)

_GATED, _STANDING = int(Outcome.GATED), int(Motion.STANDING)


@compiled
def propose(window: Window, k: int, c: Config) -> int:
    """Weigh the branches of row k, and put the children of those that it contradicts into the pool.

    Returns the number of branches and children; the branches are in the pool, too, if there is more than one
    or they have children.
    """
    count, spawns = window.counts[k], False
    for s in range(count):
        _pay(window, s, k, c)
        spawns = spawns or _wants_children(window, s, k, c)
    if count == 1 and not spawns:
        branch = window.branches[0, k]
        for snapshot in branch.snapshots:
            snapshot.weight -= branch.weight
        branch.weight = 0.0
        return 1
    status = window.status[0]
    status.pooled, status.steps_left = to_pool(window, k), c.bank.steps
    for p in range(count):
        if window.branches[p, k - 1].weight >= -c.bank.spawns and _wants_children(window, p, k, c):
            _have_children(window, p, k, c)
            window.pool_branches[p].cusum[:] = 0.0
    return int(status.pooled)


@compiled
def _pay(window: Window, s: int, k: int, c: Config) -> None:
    """What branch s of row k pays for a fault that lasts and for a slip that no track has; its CUSUM."""
    measurement = window.measurements[k]
    branch, state, update = window.branches[s, k], window.states[s, k], update_of(window, s, k)
    source, fault = measurement.source, state.fault[measurement.source]
    branch.fresh = 0
    if fault != IS_SOUND:
        elapsed_ns = measurement.stamp_ns - window.states[s, k - 1].last_ns[source]
        branch.weight -= elapsed_ns * 1e-9 / c.events.fault_time
    for unit in range(MOST_SOURCES):
        if measurement.kind in (POSE, VELOCITY) and is_straying(state.fault[unit]):
            elapsed_ns = measurement.stamp_ns - window.states[s, k - 1].last_ns[source]
            branch.weight -= elapsed_ns * 1e-9 / c.events.fault_time
    follows = measurement.kind == POSE and (fault == IS_OFFSET or is_trusted(fault, POSE))
    if measurement.kind == VELOCITY:  # one of a machine that stands shows no slip
        follows = fault == IS_SOUND and state.motion.motion != _STANDING
    if follows and not is_correlated(state, source, c):
        for i in range(4):
            e = update.whitened[i // 2] * (1.0 - 2.0 * (i % 2))
            branch.cusum[i] = max(branch.cusum[i] + min(e, c.bank.cusum_largest) - c.bank.cusum_drift, 0.0)
    branch.weight -= outside_range(state, c)


@compiled
def outside_range(state: State, c: Config) -> float:
    """By how much less likely a branch is whose i₀ no track can have."""
    if not has_velocity_errors(c) or state.fault[TRACKS] == IS_MISCOUNTING:
        return 0.0
    low, high = c.bank.least_slip, c.bank.most_slip
    excess = max(state.mean[COMMON_SLIP] - high, low - state.mean[COMMON_SLIP], 0.0)
    variance = c.bank.slip_excess**2 + state.covariance[COMMON_SLIP, COMMON_SLIP]
    return float(excess * excess / (2.0 * variance))


@compiled
def _contradicts(window: Window, s: int, k: int, c: Config) -> bool:
    """Whether measurement k is not what branch s predicts."""
    before, update = window.states[s, k - 1], update_of(window, s, k)
    limit, m = c.gate_limits[update.dof] / 2.0, window.measurements[k]
    is_gated = update.outcome == _GATED and is_trusted(before.fault[m.source], m.kind)
    return bool(update.nis > limit or is_gated)


@compiled
def _wants_children(window: Window, s: int, k: int, c: Config) -> bool:
    """Whether branch s of row k has children."""
    measurement, before, branch = window.measurements[k], window.states[s, k - 1], window.branches[s, k]
    fault, update = before.fault[measurement.source], update_of(window, s, k)
    if fault == IS_SCATTERING:
        return bool(update.nis <= c.gate_limits[1] or measurement.kind == POSE)
    if _contradicts(window, s, k, c) or _may_fold(window, s, k, c):
        return True
    if is_behind(window, s, k, c):
        return True
    if strays(before) and measurement.kind in (POSE, VELOCITY):
        return True
    if wanders(before, measurement.source, c):
        return True
    if measurement.kind == POSE and outside_range(before, c) > 0.0:
        return True
    if measurement.kind in (POSE, VELOCITY) and is_trusted(fault, measurement.kind):
        moves = before.motion.motion != _STANDING
        return bool((is_repeated(update, c) and moves) or branch.cusum.max() > c.bank.cusum_limit)
    return False


@compiled
def _may_fold(window: Window, s: int, k: int, c: Config) -> bool:
    """Whether an offset of the measurement's source is tried as a jump, again each fault time."""
    source, before = window.measurements[k].source, window.states[s, k - 1]
    fault = before.fault[source]
    is_place = fault == IS_OFFSET and number_of(source, c) >= 0 and not wanders(before, source, c)
    if s != 0 or not (is_place or is_heading_off(fault)):
        return False
    since_ns, period_ns = before.fault_ns[source], c.events.fault_time * 1e9
    for other in range(MOST_SOURCES):
        alike = c.yaw_offsets[other] >= 0 and c.of_swing[other] == c.of_swing[source]
        shows = number_of(other, c) >= 0 if is_place else alike
        if other != source and shows and before.consistent_ns[other] > since_ns:
            return False  # it shows no jump
    first, last = before.last_ns[source] - since_ns, window.measurements[k].stamp_ns - since_ns
    return bool(math.floor(last / period_ns) > math.floor(first / period_ns))


@compiled
def _have_children(window: Window, p: int, k: int, c: Config) -> None:
    """Children of branch p at measurement k."""
    m, before, update = window.measurements[k], window.states[p, k - 1], update_of(window, p, k)
    source, fault, now = m.source, before.fault[m.source], log_time(window, p, k, c)
    contradicts = _contradicts(window, p, k, c)
    if fault == IS_SCATTERING:
        ended = now + log_rate(SOUND, source, c)
        _child(window, p, k, SOUND, source, 0, False, ended, c)
        if m.kind == POSE:  # nobody saw meanwhile whether the machine was moved
            scattered = math.log(max((m.stamp_ns - before.fault_ns[source]) * 1e-9, c.bank.shortest_time))
            moved = scattered + log_rate(MOVED, source, c) + _log_any_size(m, before, c)
            _child(window, p, k, MOVED, source, 0, False, ended + moved, c)
        return
    if fault != IS_SOUND and (contradicts or wanders(before, source, c)):
        _child(window, p, k, SOUND, source, 0, False, now + log_rate(SOUND, source, c), c)
    if _may_fold(window, p, k, c):  # as a jump it would not have paid for its duration
        age = (m.stamp_ns - before.fault_ns[source]) * 1e-9 / c.events.fault_time
        prior = age + log_rate(MOVED, source, c) - log_rate(OFFSET, source, c)
        _child(window, p, k, FOLDED, source, 0, False, prior, c)
    for unit in range(MOST_SOURCES):
        if m.kind in (POSE, VELOCITY) and is_straying(before.fault[unit]):
            ended = _log_since(window, p, k, c) + log_rate(SOUND, unit, c)
            _child(window, p, k, SOUND, unit, 0, True, ended, c)
    for event in (SLIPPED, BIASED):
        odds = log_odds_of_lag(window, p, k, event, c)
        if odds > -c.bank.spawns:
            _child(window, p, k, event, source, 0, False, odds, c)
    if m.kind != POSE:
        if contradicts:
            _have_angle_children(window, p, k, c)
        shows = fault == IS_SOUND and window.branches[p, k].cusum.max() > c.bank.cusum_limit
        if m.kind == VELOCITY and (contradicts or shows):
            _have_earlier_children(window, p, k, contradicts, False, c)
        return
    if is_trusted(fault, POSE) and before.motion.motion != _STANDING:
        if is_repeated(update, c):
            _child(window, p, k, REPEATS, source, 0, False, now + log_rate(REPEATS, source, c), c)
        if contradicts and may_repeat(update, c) and _tracks_are_known(before):
            _child(window, p, k, STAYS, source, 0, False, now + log_rate(STAYS, source, c), c)
    implausible = outside_range(before, c) > 0.0
    shows = is_trusted(fault, POSE) and window.branches[p, k].cusum.max() > c.bank.cusum_limit
    if contradicts:
        _jump(window, p, k, c)
    if contradicts or implausible or shows:
        _have_earlier_children(window, p, k, contradicts, implausible, c)


@compiled
def _tracks_are_known(before: State) -> bool:
    """Whether the sprockets show what the tracks do, and are not just taken to go on."""
    return bool(before.unheard == 0.0 and not before.coasting)


@compiled
def _log_since(window: Window, p: int, k: int, c: Config) -> float:
    """ln of the time since the snapshot of branch p."""
    snapshot = window.branches[p, k].snapshots[OLDER]
    elapsed_ns = window.measurements[k].stamp_ns - window.states[snapshot.slot, snapshot.entry].stamp_ns
    return math.log(max(elapsed_ns * 1e-9, c.bank.shortest_time))


@compiled
def _correlated_penalty(window: Window, p: int, k: int, c: Config) -> float:
    """By which w of events of the machine is less, where fixes of the source err to one side."""
    errs_aside = is_correlated(window.states[p, k - 1], window.measurements[k].source, c)
    return float(c.bank.correlated_penalty if errs_aside else 0.0)


@compiled
def _jump(window: Window, p: int, k: int, c: Config) -> None:
    """Children in which the source, or the machine, jumped just before a fix that contradicts branch p."""
    m, before, update = window.measurements[k], window.states[p, k - 1], update_of(window, p, k)
    source, now = m.source, log_time(window, p, k, c)
    size = _log_any_size(m, before, c)
    if is_trusted(before.fault[source], POSE):
        if update.outcome != _GATED:
            _child(window, p, k, OUTLIER, source, 0, False, 0.0, c)
        if before.rests_on != source:
            _child(window, p, k, SCATTERS, source, 0, False, now + log_rate(SCATTERS, source, c), c)
            _child(window, p, k, OFFSET, source, 0, False, now + size + log_rate(OFFSET, source, c), c)
            if update.dof > YAW and before.fault[source] == IS_SOUND:
                _have_heading_off(window, p, k, now, c)
    moved = now + log_rate(MOVED, source, c)
    if before.rests_on == source:  # on one fix, which is as likely to be the outlier as this one
        moved = max(moved, math.log(before.outlier_share[source]))
    _child(window, p, k, MOVED, source, 0, False, size + moved, c)
    if _driven_since(window, p, k) > c.bank.least_driven and update.stated <= c.events.skid_stddev:
        prior = now + log_rate(SKIDDED, source, c) - _correlated_penalty(window, p, k, c)
        _child(window, p, k, SKIDDED, source, 0, False, prior, c)


@compiled
def _have_heading_off(window: Window, p: int, k: int, now: float, c: Config) -> None:
    """Children in which the headings of the source are off, where they have an offset."""
    source = window.measurements[k].source
    if c.yaw_offsets[source] >= 0:
        for event in (HEADING_OFF, HEADING_WANDERS):
            _child(window, p, k, event, source, 0, False, now + log_rate(event, source, c), c)


@compiled
def _log_any_size(m: MeasurementRecord, before: State, c: Config) -> float:
    """ln of the density of a jump of any size to a fix, over that of the place that the event opens."""
    squared = _squared_jump(m, before)
    any_size = log_density_of_any_size(max(squared, c.bank.least_jump**2), c)
    return any_size + math.log(2.0 * math.pi * reach(squared) ** 2)


@compiled
def _squared_jump(m: MeasurementRecord, before: State) -> float:
    """Squared distance of a fix from where the machine was before it, m²."""
    return float((m.value[X] - before.mean[X]) ** 2 + (m.value[Y] - before.mean[Y]) ** 2)


@compiled
def _have_earlier_children(
    window: Window, p: int, k: int, contradicts: bool, implausible: bool, c: Config
) -> None:
    """Children in which an event happened since the snapshot, and shows in a fix or a velocity now."""
    m, before, update = window.measurements[k], window.states[p, k - 1], update_of(window, p, k)
    e, source, drove = window.branches[p, k], m.source, _driven_since(window, p, k) > c.bank.least_driven
    since = _log_since(window, p, k, c)
    penalty = _correlated_penalty(window, p, k, c)
    if drove and has_velocity_errors(c):
        _child(window, p, k, SLIPPED, source, 0, True, since + log_rate(SLIPPED, source, c) - penalty, c)
    is_first = window.branches[p, k - 1].snapshots[OLDER].weighed == 0 and e.cusum.max() <= c.bank.cusum_limit
    if is_first and not implausible and before.outlier_share[source] > c.bank.often_outliers:
        return  # as a rule it is an outlier; what began earlier shows in the next one too
    if contradicts and may_swing(before, source, c):
        for part in range(HEADINGS):
            _child(
                window, p, k, SWUNG, source, part, True, since + log_rate(SWUNG, source, c) - _ANY_SHARE, c
            )
    turning = drove and _tracks_are_known(before)
    is_place = m.kind == POSE and is_trusted(before.fault[source], POSE)
    if is_place and turning and may_repeat(update, c):
        _child(window, p, k, STAYS, source, 0, True, since + log_rate(STAYS, source, c), c)
    if is_place and _may_wander(source, update, c):
        _child(window, p, k, WANDERS, source, 0, True, since + log_rate(WANDERS, source, c), c)
    for other in range(MOST_SOURCES):
        if before.fault[other] == IS_SOUND and _fixes_decide(before, m, c):
            _have_wrong_source(window, p, k, other, since - penalty, c)
    if has_velocity_errors(c):
        _have_stray_children(window, p, k, since - penalty, c)
    if before.fault[source] not in (IS_REPEATING, IS_STAYING) and update.coarse == 0:
        _child(window, p, k, NOISE, source, 0, True, since + log_rate(NOISE, source, c), c)
    if is_steep(before) and has_velocity_errors(c):
        _child(window, p, k, SLID, source, 0, True, since + log_rate(SLID, source, c), c)
    shows_heading = (contradicts and update.dof > YAW) or ((contradicts or implausible) and drove)
    if shows_heading:
        prior = since + log_rate(TURNED, source, c) - _ANY_SHARE - penalty
        for part in range(HEADINGS):
            _child(window, p, k, TURNED, source, part, True, prior, c)


@compiled
def _may_wander(source: int, update: Update, c: Config) -> bool:
    """Whether fixes of a source may begin to wander: a laser's do not, a coarse receiver's always do."""
    return bool(update.coarse == 0 and not errs_by_place(source, c))


@compiled
def _have_wrong_source(window: Window, p: int, k: int, source: int, since: float, c: Config) -> None:
    """A child in which another source has shown wrong headings, or velocities, since the snapshot."""
    if c.yaw_offsets[source] >= 0:
        prior = since + log_rate(HEADING_WANDERS, source, c)
        _child(window, p, k, HEADING_WANDERS, source, 0, True, prior, c)
    elif c.offsets[source] >= 0 and number_of(source, c) < 0:
        _child(window, p, k, OFFSET, source, 0, True, since + log_rate(OFFSET, source, c), c)


@compiled
def _fixes_decide(before: State, m: MeasurementRecord, c: Config) -> bool:
    """Whether fixes decide between wrong velocities or headings, and tracks that slip or a turned machine."""
    is_fixed = m.stamp_ns - before.fixed_ns < c.bank.look_back_time * 1e9
    return bool(is_fixed and not _heading_is_open(before))


@compiled
def _heading_is_open(before: State) -> bool:
    """Whether the heading is unknown, or a share of the circle."""
    return bool(before.is_sector or before.covariance[YAW, YAW] > UNKNOWN_HEADING**2)


@compiled
def _have_stray_children(window: Window, p: int, k: int, since: float, c: Config) -> None:
    """Children in which sprockets, gyros or an odometry have not shown the motion; ``since``: ln of the time.

    While the heading is unknown nothing tells them from it.
    """
    before = window.states[p, k - 1]
    if _heading_is_open(before) or math.isinf(c.gate_limits[1]):  # then all that comes is used
        return
    for unit in range(MOST_SOURCES):
        if c.shows_motion[unit] == 1 and before.fault[unit] != IS_STRAYING:
            prior = since + log_rate(STRAYS, unit, c) if before.fault[unit] == IS_SOUND else 0.0
            _child(window, p, k, STRAYS, unit, 0, True, prior, c)
    if before.fault[TRACKS] == IS_SOUND:
        _child(window, p, k, STRAYS, TRACKS, LOST, True, since + log_rate(STRAYS, TRACKS, c), c)
    if c.shows_motion[GYROS] == 1 and before.fault[GYROS] == IS_SOUND:
        _child(window, p, k, BIASED, GYROS, 0, True, since + log_rate(BIASED, GYROS, c), c)


@compiled
def _driven_since(window: Window, p: int, k: int) -> float:
    """By the tracks since the snapshot of branch p of row k − 1, m."""
    snapshot = window.branches[p, k - 1].snapshots[OLDER]
    return float(window.states[p, k - 1].ran - window.states[snapshot.slot, snapshot.entry].ran)


@compiled
def _have_angle_children(window: Window, p: int, k: int, c: Config) -> None:
    """Children of branch p at a heading, a swing angle or a velocity that contradicts it."""
    m, before, update = window.measurements[k], window.states[p, k - 1], update_of(window, p, k)
    source, now = m.source, log_time(window, p, k, c)
    if before.fault[source] == IS_SOUND:
        if update.outcome != _GATED:
            _child(window, p, k, OUTLIER, source, 0, False, 0.0, c)
        _child(window, p, k, SCATTERS, source, 0, False, now + log_rate(SCATTERS, source, c), c)
        _have_heading_off(window, p, k, now, c)
        if m.kind == VELOCITY and _fixes_decide(before, m, c):
            _child(window, p, k, OFFSET, source, 0, False, now + log_rate(OFFSET, source, c), c)
    if m.kind == ON_SWING or (m.kind == HEADING and may_swing(before, source, c)):
        _child(window, p, k, SWUNG, source, MEASURED, False, now + log_rate(MOVED, source, c), c)
    if m.kind == HEADING:
        _child(window, p, k, TURNED, source, MEASURED, False, now + log_rate(MOVED, source, c), c)


@compiled
def _child(
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
    """A child of branch p in the pool: an event was just before measurement k, or ``since`` the snapshot.

    There is none where the pool is full, or children have made steps enough.
    """
    status, before, m = window.status[0], window.branches[p, k - 1], window.measurements[k]
    snapshot = before.snapshots[OLDER]
    first, h = snapshot.entry + 1 if since else k, status.pooled
    if status.steps_left < k + 1 - first or h == POOL:
        return
    status.pooled, status.steps_left = h + 1, status.steps_left - (k + 1 - first)
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
    value = m.value[0]
    if event == SKIDDED:
        value = c.events.skid_share * _driven_since(window, p, k)
    elif event == WANDERS:
        dt = max((m.stamp_ns - window.states[p, k - 1].last_ns[source]) * 1e-9, c.bank.shortest_time)
        value = wander_stddev(state, source, dt, c)
    elif event in (SLIPPED, BIASED):
        value = 0.0 if since else c.receivers.longest_time
    elif event == OFFSET and number_of(source, c) < 0:
        value = c.events.velocity_stddev
    elif m.kind == POSE and event in (OFFSET, MOVED):
        value = reach(_squared_jump(m, window.states[p, k - 1]))
    remember(branch, event, source, part, value, m, window.measurements[first], 0)
    update.opened = event
    update.renewed = apply_event(state, event, source, part, value, c)
