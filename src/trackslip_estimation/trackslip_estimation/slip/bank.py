# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""A bank of competing explanations over one step; compiled.

Normally there is one branch. A measurement that contradicts it, or a CUSUM of its whitened innovations, makes
children: in each ONE event happened (``events``), just before that measurement or since the last consistent
one, and opened what it changes. A child runs through the same step from there. Branches that fall too far
behind the most probable one are pruned, those that have become alike are merged.

    w     ln of a branch's weight: rates of its events, and evidence of all measurements since
    row   of entry k of the window: its branches in the order of w, the most probable one first

Row k is a function of the rows before it and of the measurements up to the sample that closes entry k. So a
late measurement makes the rows after its place again, and replay equals live bit for bit.

Source: Gaussian sum filter with change points; Willsky & Jones (1976).
"""

import math
from typing import Any

import numpy as np

from trackslip_common.compiled import compiled, inlined
from trackslip_estimation.kalman.linear_algebra import wrap
from trackslip_estimation.slip.correlated_errors import MOST_SPREAD, add_fix, reset_receiver
from trackslip_estimation.slip.events import (
    AREA,
    FOLDED,
    HEADINGS,
    IS_IGNORED,
    IS_OFFSET,
    IS_REPEATING,
    IS_SCATTERING,
    IS_SOUND,
    MEASURED,
    MOVED,
    NOISE,
    NONE,
    OFFSET,
    OUTLIER,
    REPEATS,
    SCATTERS,
    SKIDDED,
    SLID,
    SLIPPED,
    SOUND,
    SWUNG,
    TURNED,
    UNKNOWN_HEADING,
    apply_event,
    is_steep,
    latest_pose_source,
    log_rate,
)
from trackslip_estimation.slip.fixes import log_density_of_any_size
from trackslip_estimation.slip.measurements import Outcome
from trackslip_estimation.slip.models.dispatch import has_velocity_errors
from trackslip_estimation.slip.models.model import SWING, YAW, X, Y
from trackslip_estimation.slip.models.speed import COMMON_SLIP
from trackslip_estimation.slip.models.swing import may_swing
from trackslip_estimation.slip.motion import Motion
from trackslip_estimation.slip.own_errors import is_correlated, number_of
from trackslip_estimation.slip.records import HEADING, HISTORY, MANUAL, MOST_SOURCES, ON_SWING, POSE
from trackslip_estimation.slip.sound import is_sound
from trackslip_estimation.slip.step import step
from trackslip_estimation.slip.window import MOST_BRANCHES, POOL, Window, copy_receivers, next_sample

_PRUNED, _SPAWNS = 10.0, 4.0  # w below the best that is pruned, or has no children
_LEAST_SOUND = 9.0  # w below the best that the last branch without a fault has at the least
_DRIFT, _LIMIT, _CALM = 0.5, 5.0, 1.5  # of the CUSUM, in standard deviations
_LARGEST = 3.0  # standard deviations of one innovation in the CUSUM
_LOOK_BACK = 8  # measurements, of which one began whatever shows now
LOOK_BACK_NS = 5_000_000_000
_STEPS = 2000  # that children may make at one measurement: 10 ms
_ALIKE = 0.05  # mean squared distance of two branches that are one
_SLIP_RANGE = -0.5, 1.0  # of i₀: tracks do not drive a machine backwards
_SLIP_EXCESS = 0.1  # standard deviation by which i₀ may leave it
_DRIVEN = 0.05  # m of the tracks, with which heading and slip show in the place
_OFTEN = 0.012  # share of outliers of a source that has had some recently
_SHORTEST = 0.01  # s, in which an event may have happened
_OF_CORRELATED = 6.0  # by which w of events of the machine is less where fixes err to one side
_SMALLEST = 1e-4  # m², squared size of a jump or an offset

_GATED, _STANDING = int(Outcome.GATED), int(Motion.STANDING)


@compiled
def is_weighed(measurement: Any) -> bool:
    """Whether branches are weighed by a measurement."""
    kind = measurement.kind
    return bool((kind == POSE and measurement.source != MANUAL) or kind in (HEADING, ON_SWING))


@inlined
def make_row(window: Window, k: int, closing: int, c: Any) -> None:
    """Row k from the row before it; ``closing``: entry of the next sprocket sample.

    First the branches there are make their step, then the children that these have run up to here. With a
    script there is one branch, whose events are those of the script.
    """
    measurements, entries, scripted = window.measurements, window.status[0].count, window.status[0].scripted
    count = jobs = window.counts[k - 1]
    window.counts[k] = count
    for s in range(count):
        window.states[s, k], window.branches[s, k] = window.states[s, k - 1], window.branches[s, k - 1]
        window.branches[s, k].first = k
    weighs, j, closes = is_weighed(measurements[k]) and not scripted, 0, closing
    while j < jobs:
        state = window.states[j, k] if j < count else window.pool_states[j]
        branch = window.branches[j, k] if j < count else window.pool_branches[j]
        update = window.updates[k] if j == 0 else window.trials[j] if j < count else window.pool_updates[j]
        if j < count:
            update.opened, update.renewed = NONE, 0
            if scripted:
                play_script(window, k, 0, c)
        for i in range(branch.first, k + 1):
            _take_errors(state, window.receivers[i - 1], c)
            if closes < i or i == branch.first:
                closes = closing if i == k else next_sample(measurements, i, entries)
            sample = measurements[closes if closes < entries else i]
            step(state, sample, measurements[i], c, update)
            if is_weighed(measurements[i]):
                branch.weight += update.evidence
        if j == 0:
            _follow_receivers(window, k, c)
        j += 1
        if j == count and weighs:
            jobs = propose(window, k, c)
    if scripted:
        play_script(window, k, 1, c)
        return
    if weighs:
        settle_row(window, k, jobs, c)
    keep_snapshots(window, k)
    split_unknown_heading(window, k, c)


@compiled
def _take_errors(state: Any, receivers: Any, c: Any) -> None:
    """What is known of the errors of fixes, for the next step."""
    for n in range(c.poses):
        offset, of = state.offsets[n], receivers[n]
        offset.f, offset.g, offset.time, offset.observed = of.f, of.g, of.time, of.observed


@compiled
def _follow_receivers(window: Window, k: int, c: Any) -> None:
    """What row k knows of the errors of fixes, by the way of the most probable branch before it.

    While it drives with an unknown heading there is no way to compare them with.
    """
    state, before, update = window.states[0, k], window.states[0, k - 1], window.updates[k]
    m = window.measurements[k]
    copy_receivers(window, k, k - 1)
    number = number_of(m.source, c) if is_weighed(m) else -1
    for n in range(c.poses):
        of = window.receivers[k, n]
        if of.known != 0:
            way = state.way[X] - before.way[X], state.way[Y] - before.way[Y]
            of.way[X] += way[X]
            of.way[Y] += way[Y]
            of.driven += math.hypot(way[X], way[Y])
        if n != number or state.fault[m.source] in (IS_REPEATING, IS_SCATTERING):
            continue
        P, spread = update.prior_covariance, heading_variance(window, k - 1)
        if update.coarse == 1 and (spread < MOST_SPREAD or math.hypot(of.way[X], of.way[Y]) < _DRIVEN):
            if has_velocity_errors(c):
                spread += P[COMMON_SLIP, COMMON_SLIP]
            add_fix(of, window.masses[k, n], update.shown, update.stated, spread, m.stamp_ns)
            if spread >= MOST_SPREAD:
                of.observed = 0.0
        elif of.known > 0:
            of.known, of.way[:], of.driven = 2, 0.0, 0.0


@compiled
def heading_variance(window: Window, k: int) -> float:
    """Of all branches of row k about the most probable one's heading, rad²."""
    total = variance = 0.0
    for s in range(window.counts[k]):
        w = math.exp(window.branches[s, k].weight - window.branches[0, k].weight)
        state = window.states[s, k]
        off = wrap(state.mean[YAW] - window.states[0, k].mean[YAW])
        total, variance = total + w, variance + w * (state.covariance[YAW, YAW] + off * off)
    return variance / total


@compiled
def begin_row(window: Window, k: int, c: Any) -> None:
    """One branch at entry k, where the estimate begins."""
    window.counts[k] = 1
    for n in range(c.poses):
        reset_receiver(window.receivers[k, n])
    _take_errors(window.states[0, k], window.receivers[k], c)
    branch = window.branches[0, k]
    branch.weight = branch.snapshot_weight = 0.0
    branch.events = 0
    branch.cusum[:] = 0.0
    branch.snapshot, branch.slot, branch.weighed = k, 0, 0
    branch.fresh = 0


@compiled
def add_first_fix(window: Window, c: Any) -> None:
    """A coarse fix with which the estimate begins is the first that its receiver's masses know."""
    state, m = window.states[0, 0], window.measurements[0]
    number = number_of(m.source, c) if is_weighed(m) else -1
    if number >= 0 and state.offsets[number].variance > 0.0:
        stddev = state.offsets[number].stddev
        add_fix(
            window.receivers[0, number], window.masses[0, number], state.mean[:YAW], stddev, 0.0, m.stamp_ns
        )


@compiled
def play_script(window: Window, k: int, after: int, c: Any) -> None:
    """The script's events before, or after, the step to measurement k, on the only branch."""
    script, status, m = window.script, window.status[0], window.measurements[k]
    state, update = window.states[0, k], window.updates[k]
    for s in range(len(state.fault)):
        if after == 1 and state.fault[s] == IS_IGNORED:
            state.fault[s] = IS_SOUND
    while status.played < script.size:
        e = script[status.played]
        if e.stamp_ns != m.stamp_ns or e.kind != m.kind or e.of != m.source or e.after != after:
            return
        update.opened = e.event
        update.renewed |= apply_event(state, e.event, e.source, e.part, e.value, c)
        status.played += 1


@compiled
def _remember(
    branch: Any, event: int, source: int, part: int, value: float, decides: Any, steps: Any, after: int
) -> None:
    """One more event of a branch, which explains ``decides`` and opens states at the step to ``steps``."""
    e = branch.history[branch.events % HISTORY]
    e.event, e.source, e.part, e.value, e.decided_ns = event, source, part, value, decides.stamp_ns
    e.stamp_ns, e.kind, e.of, e.after = steps.stamp_ns, steps.kind, steps.source, after
    branch.events += 1


@compiled
def split_unknown_heading(window: Window, k: int, c: Any) -> None:
    """A first branch of row k that drives with an unknown heading becomes one for each share of the circle.

    At rest nothing depends on the heading.
    """
    state = window.states[0, k]
    if state.is_sector or state.covariance[YAW, YAW] <= UNKNOWN_HEADING**2 or not _drives(state):
        return
    count = _to_pool(window, k)
    for part in range(1, HEADINGS):
        window.pool_states[count], window.pool_branches[count] = (
            window.pool_states[0],
            window.pool_branches[0],
        )
        window.pool_updates[count] = window.pool_updates[0]
        _take_sector(window, count, part, k, c)
        count += 1
    _take_sector(window, 0, 0, k, c)
    _from_pool(window, k, count)
    for s in range(window.counts[k]):
        if window.branches[s, k].fresh == 1:
            _keep_snapshot(window, s, k)


@compiled
def _drives(state: Any) -> bool:
    """Whether the tracks move, as far as it is known."""
    return bool(not state.coasting and (state.speeds.left != 0.0 or state.speeds.right != 0.0))


@compiled
def _take_sector(window: Window, h: int, part: int, k: int, c: Any) -> None:
    """Branch h of the pool gets a share of the circle for its heading."""
    state, branch, measurement = window.pool_states[h], window.pool_branches[h], window.measurements[k]
    source = latest_pose_source(state, c)
    apply_event(state, TURNED, source, part, 0.0, c)
    branch.weight -= math.log(HEADINGS)
    branch.fresh = 1
    _remember(branch, TURNED, source, part, 0.0, measurement, measurement, 1)


@compiled
def propose(window: Window, k: int, c: Any) -> int:
    """Weigh the branches of row k, and put the children of those that it contradicts into the pool.

    Returns the number of branches and children; the branches are in the pool, too, if there is more than one
    or they have children.
    """
    measurement, count = window.measurements[k], window.counts[k]
    spawns = False
    for s in range(count):
        branch, state, update = window.branches[s, k], window.states[s, k], _update(window, s, k)
        fault = state.fault[measurement.source]
        branch.fresh = 0
        if fault != IS_SOUND:
            elapsed_ns = measurement.stamp_ns - window.states[s, k - 1].last_ns[measurement.source]
            branch.weight -= elapsed_ns * 1e-9 / c.events.fault_time
        if (
            measurement.kind == POSE
            and fault in (IS_SOUND, IS_OFFSET)
            and not is_correlated(state, measurement.source, c)
        ):
            for i in range(4):
                e = update.whitened[i // 2] * (1.0 - 2.0 * (i % 2))
                branch.cusum[i] = max(branch.cusum[i] + min(e, _LARGEST) - _DRIFT, 0.0)
        branch.weight -= _outside_range(state, c)
        spawns = spawns or _wants_children(window, s, k, update, c)
    if count == 1 and not spawns:
        branch = window.branches[0, k]
        branch.snapshot_weight -= branch.weight
        branch.weight = 0.0
        return 1
    born = _to_pool(window, k), _STEPS
    for p in range(count):
        if window.branches[p, k - 1].weight < -_SPAWNS:
            continue
        update = _update(window, p, k)
        if _wants_children(window, p, k, update, c):
            born = _have_children(window, p, k, update, born, c)
            window.pool_branches[p].cusum[:] = 0.0
    return born[0]


@compiled
def _update(window: Window, s: int, k: int) -> Any:
    """Record of ``UPDATE`` of branch s of row k, the newest one."""
    return window.updates[k] if s == 0 else window.trials[s]


@compiled
def settle_row(window: Window, k: int, jobs: int, c: Any) -> None:
    """Row k of the branches and children that ran, ``jobs`` in all: merged and pruned."""
    measurement, count = window.measurements[k], window.counts[k]
    if jobs > 1:
        for h in range(jobs):
            if not is_sound(window.pool_states[h], c.size) or math.isnan(window.pool_branches[h].weight):
                window.pool_branches[h].weight = -math.inf
        for h in range(count, jobs):
            branch, state = window.pool_branches[h], window.pool_states[h]
            branch.weight -= _outside_range(state, c)
            branch.cusum[:] = 0.0
            if state.fault[measurement.source] == IS_IGNORED:  # that one measurement
                state.fault[measurement.source], branch.fresh = IS_SOUND, 0
        _merge(window, jobs, c)
        _from_pool(window, k, jobs)
    _move_snapshots(window, k, c)


@compiled
def _outside_range(state: Any, c: Any) -> float:
    """By how much less likely a branch is whose i₀ no track can have."""
    if not has_velocity_errors(c):
        return 0.0
    low, high = _SLIP_RANGE
    excess = max(state.mean[COMMON_SLIP] - high, low - state.mean[COMMON_SLIP], 0.0)
    variance = _SLIP_EXCESS**2 + state.covariance[COMMON_SLIP, COMMON_SLIP]
    return float(excess * excess / (2.0 * variance))


@compiled
def _contradicts(window: Window, s: int, k: int, update: Any, c: Any) -> bool:
    """Whether measurement k is not what branch s predicts."""
    before = window.states[s, k - 1]
    limit, fault = c.gate_limits[update.dof] / 2.0, before.fault[window.measurements[k].source]
    return bool(update.nis > limit or (fault == IS_SOUND and update.outcome == _GATED))


@compiled
def _wants_children(window: Window, s: int, k: int, update: Any, c: Any) -> bool:
    """Whether branch s of row k has children."""
    measurement, before, branch = window.measurements[k], window.states[s, k - 1], window.branches[s, k]
    fault = before.fault[measurement.source]
    if fault == IS_SCATTERING:
        return bool(update.nis <= c.gate_limits[1] or measurement.kind == POSE)
    if _contradicts(window, s, k, update, c) or _may_fold(window, s, k, c):
        return True
    if measurement.kind == POSE and _outside_range(before, c) > 0.0:
        return True
    if measurement.kind == POSE and fault == IS_SOUND:
        moves = before.motion.motion != _STANDING
        return bool((update.repeated == 1 and moves) or branch.cusum.max() > _LIMIT)
    return False


@compiled
def _may_fold(window: Window, s: int, k: int, c: Any) -> bool:
    """Whether an offset of the measurement's source is tried as a jump, again each fault time."""
    source, before = window.measurements[k].source, window.states[s, k - 1]
    if s != 0 or before.fault[source] != IS_OFFSET or c.offsets[source] < 0:
        return False
    since_ns, period_ns = before.fault_ns[source], c.events.fault_time * 1e9
    for other in range(MOST_SOURCES):
        of_same_kind = c.offsets[other] >= 0 and c.compass[other] == c.compass[source]
        if other != source and of_same_kind and before.consistent_ns[other] > since_ns:
            return False  # it shows no jump
    first, last = before.last_ns[source] - since_ns, window.measurements[k].stamp_ns - since_ns
    return bool(math.floor(last / period_ns) > math.floor(first / period_ns))


@compiled
def _have_children(
    window: Window, p: int, k: int, update: Any, born: tuple[int, int], c: Any
) -> tuple[int, int]:
    """Children of branch p at measurement k; ``born`` as in ``_child``."""
    m, before = window.measurements[k], window.states[p, k - 1]
    source, fault = m.source, before.fault[m.source]
    contradicts = _contradicts(window, p, k, update, c)
    elapsed = max((m.stamp_ns - before.last_ns[source]) * 1e-9, _SHORTEST)
    now, e = math.log(elapsed), window.branches[p, k]
    if fault == IS_SCATTERING:
        return _child(window, p, k, SOUND, 0, False, now + log_rate(SOUND, source, c), born, c)
    if fault != IS_SOUND and contradicts:
        prior = now + log_rate(SOUND, source, c)
        born = _child(window, p, k, SOUND, 0, False, prior, born, c)
    if _may_fold(window, p, k, c):  # as a jump it would not have paid for its duration
        age = (m.stamp_ns - before.fault_ns[source]) * 1e-9 / c.events.fault_time
        prior = age + log_rate(MOVED, source, c) - log_rate(OFFSET, source, c)
        born = _child(window, p, k, FOLDED, 0, False, prior, born, c)
    if m.kind != POSE:
        return _have_angle_children(window, p, k, update, born, c)
    moves = before.motion.motion != _STANDING
    drove = _driven_since(window, p, k) > _DRIVEN
    if fault == IS_SOUND and update.repeated == 1 and moves:
        prior = now + log_rate(REPEATS, source, c)
        born = _child(window, p, k, REPEATS, 0, False, prior, born, c)
    implausible = _outside_range(before, c) > 0.0
    if not contradicts and not implausible and (fault != IS_SOUND or e.cusum.max() <= _LIMIT):
        return born
    since = math.log(max((m.stamp_ns - window.states[e.slot, e.snapshot].stamp_ns) * 1e-9, _SHORTEST))
    penalty = _OF_CORRELATED if is_correlated(before, source, c) else 0.0
    if contradicts:
        squared = (m.value[X] - before.mean[X]) ** 2 + (m.value[Y] - before.mean[Y]) ** 2
        size = math.log(AREA) + log_density_of_any_size(max(squared, _SMALLEST))
        if fault == IS_SOUND:
            if update.outcome != _GATED:
                born = _child(window, p, k, OUTLIER, 0, False, 0.0, born, c)
            prior = now + log_rate(SCATTERS, source, c)
            born = _child(window, p, k, SCATTERS, 0, False, prior, born, c)
            prior = now + size + log_rate(OFFSET, source, c)
            born = _child(window, p, k, OFFSET, 0, False, prior, born, c)
        moved = now + log_rate(MOVED, source, c)
        if before.rests_on == source:  # that fix may have been an outlier
            moved = max(moved, math.log(before.outlier_share[source]))
        prior = size + moved
        born = _child(window, p, k, MOVED, 0, False, prior, born, c)
        if drove and update.stated <= c.events.skid_stddev:
            prior = now + log_rate(SKIDDED, source, c) - penalty
            born = _child(window, p, k, SKIDDED, 0, False, prior, born, c)
    if drove and has_velocity_errors(c):
        prior = since + log_rate(SLIPPED, source, c) - penalty
        born = _child(window, p, k, SLIPPED, 0, True, prior, born, c)
    is_first = window.branches[p, k - 1].weighed == 0 and e.cusum.max() <= _LIMIT
    if is_first and not implausible and before.outlier_share[source] > _OFTEN:
        return born  # as a rule it is an outlier; what began earlier shows in the next one too
    if contradicts and may_swing(before, source, c):
        prior = since + log_rate(SWUNG, source, c) - math.log(HEADINGS)
        for part in range(HEADINGS):
            born = _child(window, p, k, SWUNG, part, True, prior, born, c)
    if fault != IS_REPEATING and update.coarse == 0:
        prior = since + log_rate(NOISE, source, c)
        born = _child(window, p, k, NOISE, 0, True, prior, born, c)
    if is_steep(before) and has_velocity_errors(c):
        prior = since + log_rate(SLID, source, c)
        born = _child(window, p, k, SLID, 0, True, prior, born, c)
    if (contradicts and update.dof > YAW) or (
        (contradicts or implausible) and drove
    ):  # else it shows in nothing
        prior = since + log_rate(TURNED, source, c) - math.log(HEADINGS) - penalty
        for part in range(HEADINGS):
            born = _child(window, p, k, TURNED, part, True, prior, born, c)
    return born


@compiled
def _driven_since(window: Window, p: int, k: int) -> float:
    """By the tracks since the snapshot of branch p of row k − 1, m."""
    branch = window.branches[p, k - 1]
    return float(window.states[p, k - 1].ran - window.states[branch.slot, branch.snapshot].ran)


@compiled
def _have_angle_children(
    window: Window, p: int, k: int, update: Any, born: tuple[int, int], c: Any
) -> tuple[int, int]:
    """Children of branch p at a heading or an angle of the upper structure that contradicts it."""
    m, before = window.measurements[k], window.states[p, k - 1]
    source, fault = m.source, before.fault[m.source]
    if not _contradicts(window, p, k, update, c):
        return born
    now = math.log(max((m.stamp_ns - before.last_ns[source]) * 1e-9, _SHORTEST))
    if fault == IS_SOUND:
        if update.outcome != _GATED:
            born = _child(window, p, k, OUTLIER, 0, False, 0.0, born, c)
        prior = now + log_rate(SCATTERS, source, c)
        born = _child(window, p, k, SCATTERS, 0, False, prior, born, c)
        if c.offsets[source] >= 0:
            prior = now + log_rate(OFFSET, source, c)
            born = _child(window, p, k, OFFSET, 0, False, prior, born, c)
    if m.kind == ON_SWING or may_swing(before, source, c):
        prior = now + log_rate(MOVED, source, c)
        born = _child(window, p, k, SWUNG, MEASURED, False, prior, born, c)
    if m.kind == HEADING:
        prior = now + log_rate(MOVED, source, c)
        born = _child(window, p, k, TURNED, MEASURED, False, prior, born, c)
    return born


@compiled
def _child(
    window: Window,
    p: int,
    k: int,
    event: int,
    part: int,
    since: bool,
    log_prior: float,
    born: tuple[int, int],
    c: Any,
) -> tuple[int, int]:
    """A child of branch p in the pool: an event was just before measurement k, or ``since`` the snapshot.

    ``born``: pool entries in use, and steps that children may still make; returned with this one.
    """
    count, steps = born
    before, m = window.branches[p, k - 1], window.measurements[k]
    first = before.snapshot + 1 if since else k
    if steps < k + 1 - first or count == POOL:
        return born
    state, branch, update = window.pool_states[count], window.pool_branches[count], window.pool_updates[count]
    window.pool_branches[count] = before
    if since:
        window.pool_states[count] = window.states[before.slot, before.snapshot]
        branch.weight = before.snapshot_weight + log_prior
        snapshot_ns = window.measurements[before.snapshot].stamp_ns
        while branch.events > 0 and branch.history[(branch.events - 1) % HISTORY].decided_ns > snapshot_ns:
            branch.events -= 1
    else:
        window.pool_states[count] = window.states[p, k - 1]
        branch.weight = before.weight + log_prior
    branch.first, branch.fresh = first, 1
    value = m.value[0]
    if event == SKIDDED:
        value = c.events.skid_share * _driven_since(window, p, k)
    _remember(branch, event, m.source, part, value, m, window.measurements[first], 0)
    update.opened = event
    update.renewed = apply_event(state, event, m.source, part, value, c)
    return count + 1, steps - (k + 1 - first)


@compiled
def _to_pool(window: Window, k: int) -> int:
    """The branches of row k, in the pool; how many."""
    for s in range(window.counts[k]):
        window.pool_states[s], window.pool_branches[s] = window.states[s, k], window.branches[s, k]
        window.pool_updates[s] = _update(window, s, k)
    return int(window.counts[k])


@compiled
def _from_pool(window: Window, k: int, count: int) -> None:
    """Row k: the most probable branches of the pool in their order, the first one's weight 0."""
    best, kept, sound = (
        window.pool_branches[_heaviest(window, count)].weight,
        0,
        _heaviest_sound(window, count),
    )
    while kept < MOST_BRANCHES:
        h = _heaviest(window, count)
        if kept == MOST_BRANCHES - 1 and sound >= 0:
            h = sound
        if h == sound:
            window.pool_branches[h].weight = max(window.pool_branches[h].weight, best - _LEAST_SOUND)
            sound = -1
        weight = window.pool_branches[h].weight
        if weight < best - _PRUNED or weight == -math.inf:
            break
        branch = window.branches[kept, k]
        window.states[kept, k], window.branches[kept, k] = window.pool_states[h], window.pool_branches[h]
        branch.weight, branch.snapshot_weight = weight - best, branch.snapshot_weight - best
        if kept == 0:
            window.updates[k] = window.pool_updates[h]
        else:
            window.trials[kept] = window.pool_updates[h]
        window.pool_branches[h].weight = -math.inf
        kept += 1
    window.counts[k] = kept
    if sound >= 0:  # it is far behind, and stays
        _keep_sound(window, k, sound, best)


@compiled
def _keep_sound(window: Window, k: int, h: int, best: float) -> None:
    """Append branch h of the pool to row k, whatever its weight: in it no source is at fault."""
    s = min(window.counts[k], MOST_BRANCHES - 1)
    branch = window.branches[s, k]
    window.states[s, k], window.branches[s, k] = window.pool_states[h], window.pool_branches[h]
    window.trials[s] = window.pool_updates[h]
    branch.weight, branch.snapshot_weight = -_LEAST_SOUND, max(branch.snapshot_weight - best, -_LEAST_SOUND)
    window.counts[k] = s + 1


@compiled
def _heaviest_sound(window: Window, count: int) -> int:
    """The most probable branch of the pool in which no source is at fault; −1: there is none."""
    heaviest = -1
    for h in range(count):
        weight, faults = window.pool_branches[h].weight, 0
        for k in range(MOST_SOURCES):
            faults += 1 if window.pool_states[h].fault[k] != IS_SOUND else 0
        heavier = heaviest < 0 or weight > window.pool_branches[heaviest].weight
        if faults == 0 and weight > -math.inf and heavier:
            heaviest = h
    return heaviest


@compiled
def _heaviest(window: Window, count: int) -> int:
    """The most probable branch of the pool."""
    heaviest = 0
    for h in range(1, count):
        if window.pool_branches[h].weight > window.pool_branches[heaviest].weight:
            heaviest = h
    return heaviest


@compiled
def _merge(window: Window, count: int, c: Any) -> None:
    """Of two branches of the pool that are alike, the more probable one, with the weight of both."""
    branches = window.pool_branches
    for a in range(count):
        for b in range(count):
            if a == b or branches[a].weight == -math.inf or branches[a].weight < branches[b].weight:
                continue
            if branches[b].weight > -math.inf and _are_alike(window.pool_states[a], window.pool_states[b], c):
                branches[a].weight += math.log1p(math.exp(branches[b].weight - branches[a].weight))
                branches[b].weight = -math.inf


@compiled
def _are_alike(a: Any, b: Any, c: Any) -> bool:
    """Whether two states make the same assumptions of the sources, and differ by little."""
    total, n = 0.0, 0
    for k in range(MOST_SOURCES):
        ratio = a.adaptation.fix_factors[k] / b.adaptation.fix_factors[k]
        if a.fault[k] != b.fault[k] or ratio > 2.0 or ratio < 0.5:
            return False
        if a.fault[k] == IS_OFFSET and c.offsets[k] >= 0:
            for i in range(c.offsets[k], c.offsets[k] + (1 if c.compass[k] == 1 else 2)):
                distance = _distance(a, b, i)
                total, n = total + distance, n + 1
    for i in (X, Y, YAW, COMMON_SLIP, SWING):
        if i == SWING and not c.swings:
            continue
        total, n = total + _distance(a, b, i), n + 1
    return total < _ALIKE * n


@compiled
def _distance(a: Any, b: Any, i: int) -> float:
    """Squared distance of state i, over the sum of its variances; infinite where these differ much."""
    d = a.mean[i] - b.mean[i]
    if i in (YAW, SWING):
        d = wrap(d)
    of_a, of_b = a.covariance[i, i], b.covariance[i, i]
    if of_a > 4.0 * of_b or of_b > 4.0 * of_a:
        return np.inf
    return float(d * d / max(of_a + of_b, 1e-12))


@compiled
def _move_snapshots(window: Window, k: int, c: Any) -> None:
    """Branches that agree with measurement k, or have looked back for long enough, look back to it only."""
    measurement = window.measurements[k]
    for s in range(window.counts[k]):
        branch, state = window.branches[s, k], window.states[s, k]
        update = _update(window, s, k)
        branch.weighed += 1
        agrees = branch.cusum.max() < _CALM and update.nis <= c.gate_limits[update.dof] / 2.0
        agrees = agrees and state.fault[measurement.source] == IS_SOUND and measurement.kind == POSE
        if branch.fresh == 1 or agrees or branch.weighed >= _LOOK_BACK:
            _keep_snapshot(window, s, k)


@compiled
def _keep_snapshot(window: Window, s: int, k: int) -> None:
    branch = window.branches[s, k]
    branch.snapshot, branch.slot, branch.weighed = k, s, 0
    branch.snapshot_weight = branch.weight


@compiled
def keep_snapshots(window: Window, k: int) -> None:
    """No branch looks back further than ``LOOK_BACK_NS``."""
    stamp_ns = window.measurements[k].stamp_ns
    for s in range(window.counts[k]):
        branch = window.branches[s, k]
        if stamp_ns - window.measurements[branch.snapshot].stamp_ns > LOOK_BACK_NS:
            _keep_snapshot(window, s, k)


@compiled
def probability_of_best(window: Window, k: int) -> float:
    """Posterior probability of the first branch of row k."""
    total = 0.0
    for s in range(window.counts[k]):
        total += math.exp(window.branches[s, k].weight)
    return math.exp(window.branches[0, k].weight) / total
