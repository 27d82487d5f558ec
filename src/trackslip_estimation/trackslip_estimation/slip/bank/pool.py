# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The pool: branches of one row and their children, merged where alike, pruned where improbable; compiled."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from trackslip_common.compiled import compiled
from trackslip_estimation.kalman.linear_algebra import wrap
from trackslip_estimation.slip.models.model import SWING, YAW, X, Y
from trackslip_estimation.slip.models.speed import COMMON_SLIP
from trackslip_estimation.slip.records import MOST_SOURCES
from trackslip_estimation.slip.source_faults import IS_HEALTHY, IS_OFFSET, has_no_fault
from trackslip_estimation.slip.window import MOST_BRANCHES, Window

if TYPE_CHECKING:
    from trackslip_estimation.slip.config import Config
    from trackslip_estimation.slip.records import State, Update


@compiled
def update_of(window: Window, s: int, k: int) -> Update:
    """Record of ``UPDATE`` of branch s of the newest row k."""
    return window.updates[k] if s == 0 else window.branch_updates[s]


@compiled
def copy_row_to_pool(window: Window, k: int) -> int:
    """Copy the branches of row k to the pool, to which children may be added; return their number."""
    status = window.status[0]
    status.pooled, status.share_left = window.counts[k], 1.0
    for s in range(window.counts[k]):
        window.pool_states[s], window.pool_branches[s] = window.states[s, k], window.branches[s, k]
        window.pool_updates[s] = update_of(window, s, k)
    return int(window.counts[k])


@compiled
def fill_row_from_pool(window: Window, k: int, count: int, c: Config) -> None:
    """Fill row k with the most probable branches of the pool, in order; the first one has weight 0.

    The most probable branch without a fault stays, with a weight of at least −``least_healthy``.
    """
    best = window.pool_branches[_most_probable_branch(window, count)].weight
    healthy = _most_probable_healthy_branch(window, count, c)
    if healthy >= 0:
        least = best - c.bank.least_healthy
        window.pool_branches[healthy].weight = max(window.pool_branches[healthy].weight, least)
    kept = 0
    while kept < MOST_BRANCHES:
        h = _most_probable_branch(window, count)
        if kept == MOST_BRANCHES - 1 and healthy >= 0 and window.pool_branches[healthy].weight > -math.inf:
            h = healthy
        weight = window.pool_branches[h].weight
        if weight < best - c.bank.pruned or weight == -math.inf:
            break
        branch = window.branches[kept, k]
        window.states[kept, k], window.branches[kept, k] = window.pool_states[h], window.pool_branches[h]
        branch.weight = weight - best
        for snapshot in branch.snapshots:
            snapshot.weight -= best
        if kept == 0:
            window.updates[k] = window.pool_updates[h]
        else:
            window.branch_updates[kept] = window.pool_updates[h]
        window.pool_branches[h].weight = -math.inf
        kept += 1
    window.counts[k] = kept


@compiled
def _most_probable_healthy_branch(window: Window, count: int, c: Config) -> int:
    """Number of the most probable branch of the pool in which no source is at fault; −1: none.

    A source that contradicts a branch for longer than a fault lasts is at fault, assumed or not.
    """
    heaviest = -1
    for h in range(count):
        weight = window.pool_branches[h].weight
        heavier = heaviest < 0 or weight > window.pool_branches[heaviest].weight
        state = window.pool_states[h]
        if weight > -math.inf and heavier and has_no_fault(state) and _agreed_lately(state, c):
            heaviest = h
    return heaviest


@compiled
def _agreed_lately(state: State, c: Config) -> bool:
    """Whether each source agreed with a state within ``fault_time`` before its latest measurement."""
    for source in range(MOST_SOURCES):
        if state.weighed_ns[source] - state.consistent_ns[source] > c.events.fault_time * 1e9:
            return False
    return True


@compiled
def _most_probable_branch(window: Window, count: int) -> int:
    """Number of the most probable branch of the pool."""
    heaviest = 0
    for h in range(1, count):
        if window.pool_branches[h].weight > window.pool_branches[heaviest].weight:
            heaviest = h
    return heaviest


@compiled
def merge_similar_branches(window: Window, count: int, c: Config) -> None:
    """Merge similar branches of the pool: the more probable one gets the weight of both."""
    branches = window.pool_branches
    for a in range(count):
        for b in range(count):
            if a == b or branches[a].weight == -math.inf or branches[a].weight < branches[b].weight:
                continue
            if branches[b].weight > -math.inf and _are_close(window.pool_states[a], window.pool_states[b], c):
                branches[a].weight += math.log1p(math.exp(branches[b].weight - branches[a].weight))
                branches[b].weight = -math.inf


@compiled
def _are_close(a: State, b: State, c: Config) -> bool:
    """Whether two states assume the same faults, and their distance is within ``merge_distance``."""
    total, n = 0.0, 0
    for k in range(MOST_SOURCES):
        ratio = a.adaptation.fix_factors[k] / b.adaptation.fix_factors[k]
        same_faults = a.fault[k] == b.fault[k] and a.heading_fault[k] == b.heading_fault[k]
        if not same_faults or ratio > 2.0 or ratio < 0.5:
            return False
        if a.fault[k] == IS_OFFSET:
            for i in range(c.offsets[k], c.offsets[k] + 2):
                total, n = total + _distance(a, b, i), n + 1
        if a.heading_fault[k] != IS_HEALTHY:
            total, n = total + _distance(a, b, c.yaw_offsets[k]), n + 1
    for i in (X, Y, YAW, COMMON_SLIP, SWING):
        if i == SWING and not c.swings:
            continue
        total, n = total + _distance(a, b, i), n + 1
    return total < c.bank.merge_distance * n


@compiled
def _distance(a: State, b: State, i: int) -> float:
    """Squared difference of state i, over the sum of its variances; infinite if these differ fourfold."""
    d = a.mean[i] - b.mean[i]
    if i in (YAW, SWING):
        d = wrap(d)
    of_a, of_b = a.covariance[i, i], b.covariance[i, i]
    if of_a > 4.0 * of_b or of_b > 4.0 * of_a:
        return np.inf
    return float(d * d / max(of_a + of_b, 1e-12))
