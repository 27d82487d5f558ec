# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""A bank of competing hypotheses over one step; compiled.

Normally there is one branch. A measurement that contradicts it, or a CUSUM of its whitened innovations,
creates children. In each child ONE event (``events``) happened, just before that measurement or since the
last consistent one; it resets or inflates the states that it changes. A child runs through the same step from
there. Branches much less probable than the best one are pruned; similar branches are merged.

    w     ln of a branch's weight: rates of its events, and evidence of all measurements since
    row   branches of entry k of the window in the order of w, the most probable one first

Row k is a function of the rows before it and of the measurements up to the sample that closes entry k. A late
measurement therefore recomputes the rows after its place, and replay equals live bit for bit.

Source: Gaussian sum filter with change points; Willsky & Jones (1976).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from trackslip_common.clock_monitor import NEVER_NS
from trackslip_common.compiled import compiled, inlined
from trackslip_estimation.slip.bank.child import add_sector_event
from trackslip_estimation.slip.bank.children import create_children, create_failure_children
from trackslip_estimation.slip.bank.plausibility import implausibility
from trackslip_estimation.slip.bank.pool import (
    copy_row_to_pool,
    fill_row_from_pool,
    merge_similar_branches,
    update_of,
)
from trackslip_estimation.slip.bank.receivers import (
    carry_receivers,
    compare_fix,
    copy_error_models,
    reset_receivers_after_turn,
)
from trackslip_estimation.slip.bank.script import apply_scripted_events
from trackslip_estimation.slip.correlated_errors import reset_receiver
from trackslip_estimation.slip.events import HEADINGS, NONE
from trackslip_estimation.slip.finite import is_finite_state
from trackslip_estimation.slip.levers import is_direction_unknown, is_heading_unknown
from trackslip_estimation.slip.models.speed import SLOWEST
from trackslip_estimation.slip.records import HEADING, MANUAL, OLDER, ON_SWING, POSE, YOUNGER
from trackslip_estimation.slip.source_faults import (
    IS_HEALTHY,
    IS_IGNORED,
    are_sources_consistent,
    is_trusted,
)
from trackslip_estimation.slip.source_offsets import latest_pose_source
from trackslip_estimation.slip.step import step
from trackslip_estimation.slip.weighing import contradiction_limit
from trackslip_estimation.slip.window import Window, is_weighed, next_sample, prior_of

if TYPE_CHECKING:
    from trackslip_estimation.slip.config import Config
    from trackslip_estimation.slip.records import Branch, State


@inlined
def make_rows(window: Window, first: int, count: int, c: Config) -> bool:
    """Compute rows from ``first`` up to ``count``, each from the previous one; return whether all are finite.

    The existing branches make their step first; then their children run up to this row. With a script there
    is one branch, with the events of the script.
    """
    measurements, states, branches = window.measurements, window.states, window.branches
    scripted, closing = window.status[0].scripted, -1
    for k in range(first, count):
        if closing < k:  # entry of the next sprocket sample
            closing = next_sample(measurements, k, count)
        existing = window.counts[k] = window.counts[k - 1]
        for s in range(existing):
            states[s, k], branches[s, k] = states[s, k - 1], branches[s, k - 1]
            branches[s, k].first = k
        total, j, sample_entry = existing, 0, -1
        changes_weights = is_weighed(measurements[k]) and not scripted
        prior = prior_of(window, k)
        while j < total:
            state = states[j, k] if j < existing else window.pool_states[j]
            branch = branches[j, k] if j < existing else window.pool_branches[j]
            update = update_of(window, j, k) if j < existing else window.pool_updates[j]
            if j < existing:
                update.event, update.reset_states = NONE, 0
                if scripted:
                    apply_scripted_events(window, k, 0, c)
            for i in range(branch.first, k + 1):
                copy_error_models(state, window, i - 1, c)
                if sample_entry < i or i == branch.first:
                    sample_entry = closing if i == k else next_sample(measurements, i, count)
                sample = measurements[sample_entry if sample_entry < count else i]
                step(state, sample, measurements[i], c, update, prior)
                branch.weight += update.evidence
            if j == 0:
                carry_receivers(window.receivers, window.masses, k, states[0, k - 1], state)
                if is_weighed(measurements[k]):
                    compare_fix(window, k, c)
            j += 1
            if j == existing and changes_weights:
                total = create_children(window, k, c)
            elif j == existing and not scripted and _is_measurement_rejected(window, k):
                total, changes_weights = create_failure_children(window, k, c), True
        if scripted:
            apply_scripted_events(window, k, 1, c)
        else:
            finish_row(window, k, total, changes_weights, c)
        if not is_finite_state(states[0, k], c.size):
            return False
    return True


@compiled
def finish_row(window: Window, k: int, total: int, changes_weights: bool, c: Config) -> None:
    """Prune row k of ``total`` branches and children if measurement k changed w; split unknown headings."""
    if changes_weights:
        prune_row(window, k, total, c)
        reset_receivers_after_turn(window, k, c)
    if window.measurements[k].source == MANUAL:
        for s in range(window.counts[k]):
            window.branches[s, k].course = 0.0  # no fix has confirmed the heading that a user set
    advance_snapshots(window, k, c)
    if is_moving_without_heading(window.states[0, k], c):
        split_unknown_heading(window, k, c)


@compiled
def _is_measurement_rejected(window: Window, k: int) -> bool:
    """Whether a branch of row k rejects measurement k, at the cost of its weight."""
    rejected = False
    for s in range(window.counts[k]):
        rejected = rejected or update_of(window, s, k).evidence != 0.0
    return rejected


@compiled
def begin_row(window: Window, k: int, c: Config) -> None:
    """Initialise row k with one branch, at the start of the estimate."""
    window.counts[k] = 1
    for n in range(c.poses):
        reset_receiver(window.receivers[k, n], c)
    copy_error_models(window.states[0, k], window, k, c)
    branch = window.branches[0, k]
    branch.weight, branch.events, branch.fresh = 0.0, 0, 0
    branch.cusum[:], branch.slip_cost, branch.turn_cost = 0.0, 0.0, 0.0
    branch.course, branch.course_ns, branch.course_from[:] = 0.0, NEVER_NS, 0.0
    _reset_snapshots(window, 0, k)


@compiled
def is_moving_without_heading(state: State, c: Config) -> bool:
    """Whether the tracks move the machine, and its heading is unknown: now a prediction depends on it.

    Tracks that creep may not move it: speeds at rest have offsets.
    """
    fastest = c.rolling_radius * max(abs(state.speeds.left), abs(state.speeds.right))
    moves = not state.coasting and fastest > SLOWEST
    return bool(moves and is_heading_unknown(state) and not is_direction_unknown(state, c))


@compiled
def split_unknown_heading(window: Window, k: int, c: Config) -> None:
    """Split the first branch of row k into one branch for each sector of the circle."""
    count = copy_row_to_pool(window, k)
    for part in range(1, HEADINGS):
        window.pool_states[count], window.pool_branches[count] = (
            window.pool_states[0],
            window.pool_branches[0],
        )
        window.pool_updates[count] = window.pool_updates[0]
        _set_sector(window, count, part, k, c)
        count += 1
    _set_sector(window, 0, 0, k, c)
    fill_row_from_pool(window, k, count, c)
    for s in range(window.counts[k]):
        if window.branches[s, k].fresh == 1:
            _reset_snapshots(window, s, k)


@compiled
def _set_sector(window: Window, h: int, part: int, k: int, c: Config) -> None:
    """Restrict the heading of branch h of the pool to sector ``part`` of the circle."""
    branch, source = window.pool_branches[h], latest_pose_source(window.pool_states[h], c)
    branch.weight -= math.log(HEADINGS)
    branch.fresh = 1
    add_sector_event(window, h, source, part, k, k, 1, c)


@compiled
def prune_row(window: Window, k: int, total: int, c: Config) -> None:
    """Merge and prune the ``total`` branches and children into row k; move its snapshots."""
    measurement, count = window.measurements[k], window.counts[k]
    if total > 1 or not is_weighed(measurement):
        _equalize_tied_evidence(window, count, measurement.source)
        for h in range(total):
            branch, state = window.pool_branches[h], window.pool_states[h]
            if not is_finite_state(state, c.size) or math.isnan(branch.weight):
                branch.weight = -math.inf
        for h in range(count, total):
            branch, state = window.pool_branches[h], window.pool_states[h]
            branch.weight -= implausibility(state, c)
            branch.cusum[:] = 0.0
            if state.fault[measurement.source] == IS_IGNORED:  # only for this measurement
                state.fault[measurement.source], branch.fresh = IS_HEALTHY, 0
        merge_similar_branches(window, total, c)
        fill_row_from_pool(window, k, total, c)
    else:
        _normalize_sole_branch(window.branches[0, k])
    _move_snapshots(window, k, c)


@compiled
def _normalize_sole_branch(branch: Branch) -> None:
    """Set the weight of the only branch of a row to 0."""
    for snapshot in branch.snapshots:
        snapshot.weight -= branch.weight
    branch.weight = 0.0


@compiled
def _equalize_tied_evidence(window: Window, count: int, source: int) -> None:
    """Give tied measurements the evidence of the most probable branch that may use them: equal odds."""
    best = -1
    for h in range(count):
        heavier = best < 0 or window.pool_branches[h].weight > window.pool_branches[best].weight
        if window.pool_states[h].fault[source] == IS_HEALTHY and heavier:
            best = h
    for h in range(count):
        update = window.pool_updates[h]
        if best >= 0 and update.tied == 1:
            window.pool_branches[h].weight += window.pool_updates[best].evidence - update.evidence


@compiled
def _move_snapshots(window: Window, k: int, c: Config) -> None:
    """Move the snapshots of branches consistent with fix k, and of those that explain angle k, to row k.

    A branch that explains a fix or a velocity keeps the snapshots of its parent. If a later fix contradicts
    it, its children start before its own event: what was pruned comes back. So does a branch that the latest
    heading or velocity contradicts: the fix agrees with its position, not with its motion.
    """
    measurement = window.measurements[k]
    for s in range(window.counts[k]):
        branch, state = window.branches[s, k], window.states[s, k]
        update = update_of(window, s, k)
        if measurement.kind == POSE:  # only fixes observe how far the machine has moved since the snapshot
            for snapshot in branch.snapshots:
                snapshot.fixes += 1
        agrees = branch.cusum.max() < c.bank.cusum_calm and update.nis <= contradiction_limit(update.dof, c)
        agrees = agrees and is_trusted(state, measurement.source, POSE) and measurement.kind == POSE
        agrees = agrees and are_sources_consistent(state)
        if agrees or (branch.fresh == 1 and measurement.kind in (HEADING, ON_SWING)):
            _reset_snapshots(window, s, k)


@compiled
def _reset_snapshots(window: Window, s: int, k: int) -> None:
    """Set the snapshots of branch s to row k, from which its children start."""
    branch = window.branches[s, k]
    for snapshot in branch.snapshots:
        snapshot.entry, snapshot.slot, snapshot.weight, snapshot.fixes = k, s, branch.weight, 0
        snapshot.turn_cost = branch.turn_cost


@compiled
def advance_snapshots(window: Window, k: int, c: Config) -> None:
    """Replace the older snapshot after half of ``look_back_time``, or of ``look_back`` fixes."""
    stamp_ns, longest_ns = window.measurements[k].stamp_ns, c.bank.look_back_time * 1e9
    for s in range(window.counts[k]):
        branch = window.branches[s, k]
        younger = branch.snapshots[YOUNGER]
        age_ns = stamp_ns - window.measurements[younger.entry].stamp_ns
        if age_ns > longest_ns / 2.0 or younger.fixes >= c.bank.look_back / 2.0:
            branch.snapshots[OLDER] = younger
            younger.entry, younger.slot, younger.weight, younger.fixes = k, s, branch.weight, 0


@compiled
def probability_of_best(window: Window, k: int) -> float:
    """Posterior probability of the first branch of row k."""
    total = 0.0
    for s in range(window.counts[k]):
        total += math.exp(window.branches[s, k].weight)
    return math.exp(window.branches[0, k].weight) / total
