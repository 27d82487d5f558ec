# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Estimated errors of fixes, one record for each row and source of the bank; compiled.

A record belongs to a row, not to a branch: fixes are compared with the displacement of the most probable
branch (``correlated_errors``).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from trackslip_common.clock_monitor import NEVER_NS
from trackslip_common.compiled import compiled
from trackslip_estimation.kalman.linear_algebra import wrap
from trackslip_estimation.slip.correlated_errors import (
    INTERRUPTED,
    NO_FIX,
    QUALITIES,
    DisplacementError,
    add_fix,
    reset_receiver,
)
from trackslip_estimation.slip.events import TURNED
from trackslip_estimation.slip.levers import is_swing_unknown
from trackslip_estimation.slip.measurements import Outcome
from trackslip_estimation.slip.models.dispatch import has_velocity_errors
from trackslip_estimation.slip.models.model import YAW, X, Y
from trackslip_estimation.slip.models.speed import COMMON_SLIP, SPEED_ERROR
from trackslip_estimation.slip.records import HISTORY, POSE
from trackslip_estimation.slip.source_faults import (
    IS_IGNORED,
    IS_REPEATING,
    IS_SCATTERING,
    IS_STAYING,
    has_failed_unit,
    is_trusted,
)
from trackslip_estimation.slip.source_offsets import has_position_dependent_errors, pose_source_number
from trackslip_estimation.slip.window import Window, copy_receivers, is_weighed, prior_of

if TYPE_CHECKING:
    from trackslip_common.record_types import Table
    from trackslip_estimation.slip.config import Config
    from trackslip_estimation.slip.correlated_errors import Masses, Receiver
    from trackslip_estimation.slip.records import Branch, State, Update


_GATED = int(Outcome.GATED)


@compiled
def copy_error_models(state: State, window: Window, k: int, c: Config) -> None:
    """Copy the error models of fixes from row k to a state, for its next step."""
    for n in range(c.poses):
        offset, of = state.offsets[n], window.receivers[k, n]
        for quality in range(QUALITIES):
            offset.errors[quality] = of.errors[quality]


@compiled
def carry_receivers(
    receivers: Table[Receiver], masses: Table[Masses], k: int, before: State, state: State
) -> None:
    """Copy the receivers of row k − 1 to row k, and add the displacement between both rows."""
    copy_receivers(receivers, masses, k, k - 1, True)
    for n in range(receivers.shape[1]):
        of = receivers[k, n]
        if of.status != NO_FIX:
            east = state.displacement[X] - before.displacement[X]
            north = state.displacement[Y] - before.displacement[Y]
            of.displacement[X] += east
            of.displacement[Y] += north
            of.distance += math.hypot(east, north)


@compiled
def compare_fix(window: Window, k: int, c: Config) -> None:
    """Update the receiver of row k with fix k, against the displacement of the most probable branch.

    The displacement is unusable if it was driven with an unknown heading. So is a precise fix while an event
    holds its offset, and any fix of a receiver on an upper structure of unknown angle.
    """
    m, state, update = window.measurements[k], window.states[0, k], window.updates[k]
    n = pose_source_number(m.source, c)
    if n < 0 or not _is_usable_for_error_model(state, update, m.source, c):
        return
    of, heading = window.receivers[k, n], heading_variance(window, k - 1)
    is_off = update.coarse == 0 and not is_trusted(state, m.source, POSE)
    is_off = is_off or (c.above[m.source] == 1 and is_swing_unknown(prior_of(window, k).covariance))
    distance = math.hypot(of.displacement[X], of.displacement[Y])
    if is_off or (heading >= c.receivers.most_spread and distance >= c.bank.least_distance):
        if of.status != NO_FIX:
            of.status, of.displacement[:], of.distance = INTERRUPTED, 0.0, 0.0
        return
    P, displacement = prior_of(window, k).covariance, DisplacementError(0.0, heading)
    if has_velocity_errors(c):
        displacement = DisplacementError(P[SPEED_ERROR, SPEED_ERROR], heading + P[COMMON_SLIP, COMMON_SLIP])
    add_fix(of, window.masses[k, n], update.measured_position, update.stated, displacement, m.stamp_ns, c)
    if displacement.direction >= c.receivers.most_spread:
        for quality in range(QUALITIES):
            of.errors[quality].observed = 0.0


@compiled
def _is_usable_for_error_model(state: State, update: Update, source: int, c: Config) -> bool:
    """Whether a fix is usable for the errors of its receiver: fix, tracks, gyros and odometry have no fault.

    A precise fix is unusable as an outlier, or if errors of its source depend on the position.
    """
    fault = state.fault[source]
    if has_failed_unit(state) or fault in (IS_REPEATING, IS_STAYING, IS_SCATTERING):
        return False
    is_outlier = update.outcome == _GATED and (fault == IS_IGNORED or is_trusted(state, source, POSE))
    return bool(update.coarse == 1 or not (is_outlier or has_position_dependent_errors(source, c)))


@compiled
def reset_receivers_after_turn(window: Window, k: int, c: Config) -> None:
    """Reset the receivers of row k if the heading was found wrong: their displacements were wrong too."""
    if _heading_reset_ns(window.branches[0, k]) > _heading_reset_ns(window.branches[0, k - 1]):
        for n in range(c.poses):
            reset_receiver(window.receivers[k, n], c)


@compiled
def _heading_reset_ns(branch: Branch) -> int:
    """Stamp of the latest measurement by which a branch found its heading wrong; NEVER_NS: none."""
    last_ns = NEVER_NS
    for n in range(min(branch.events, HISTORY)):
        e = branch.history[n]
        if e.event == TURNED and e.after == 0:
            last_ns = max(last_ns, e.decided_ns)
    return int(last_ns)


@compiled
def heading_variance(window: Window, k: int) -> float:
    """Variance of the headings of all branches of row k about that of the most probable one, rad²."""
    total = variance = 0.0
    for s in range(window.counts[k]):
        w = math.exp(window.branches[s, k].weight - window.branches[0, k].weight)
        state = window.states[s, k]
        off = wrap(state.mean[YAW] - window.states[0, k].mean[YAW])
        total, variance = total + w, variance + w * (state.covariance[YAW, YAW] + off * off)
    return variance / total


@compiled
def add_first_fix(window: Window, c: Config) -> None:
    """Initialise the masses with the fix that starts the estimate, if its errors are time-correlated."""
    state, m = window.states[0, 0], window.measurements[0]
    number = pose_source_number(m.source, c) if is_weighed(m) else -1
    if number >= 0 and state.offsets[number].variance > 0.0:
        of, masses = window.receivers[0, number], window.masses[0, number]
        add_fix(
            of,
            masses,
            state.mean[:YAW],
            state.offsets[number].stddev,
            DisplacementError(0.0, 0.0),
            m.stamp_ns,
            c,
        )
