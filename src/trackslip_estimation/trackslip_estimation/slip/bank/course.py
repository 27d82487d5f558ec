# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""How strongly earlier fixes and velocities confirm a heading that a gyro carries; compiled.

    d    predicted displacement between two fixes along the heading                 m
    ν    innovation of the later fix along it, z = d + ν: measured displacement     m
    S    variance of the innovation, by axis                                        m²
    q    Σ d z/S, 0 to 100                                                          1
    θ    angle by which another explanation turns the heading                       rad

A heading that differs by ±θ predicts a displacement turned by ±θ. So ln of the odds against it grows at each
fix by (1 − cos θ) d z/S, on average over both signs; an outlier counts like ν of ``cusum_largest`` standard
deviations. A velocity to the east and north counts likewise, with d and z along the heading in m/s. A
displacement across the heading counts nothing: a centre of rotation on the other side explains it with the
reversed heading. Neither do tracks that do not grip: with a slip of 1 or more they may move the machine in
any direction.

A gyro measures all turns since, on the cab together with an encoder of the swing: what confirmed the heading
before still holds. Without their readings q is zero, and after ``look_back_time`` without a fix that agrees.
It decays in turns, in which a gyro may fail unseen: fixes hardly show a turn on the spot.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from trackslip_common.compiled import compiled
from trackslip_estimation.kalman.linear_algebra import wrap
from trackslip_estimation.slip.bank.event_effects import sector_angle
from trackslip_estimation.slip.bank.plausibility import is_gripping
from trackslip_estimation.slip.bank.pool import update_of
from trackslip_estimation.slip.levers import is_heading_unknown
from trackslip_estimation.slip.models.model import YAW, X, Y
from trackslip_estimation.slip.models.speed import SPEED_ERROR
from trackslip_estimation.slip.records import GYROS, MOST_SOURCES, OLDER, POSE, VELOCITY
from trackslip_estimation.slip.source_faults import (
    IS_HEALTHY,
    has_failed_unit,
    has_fault,
    is_displacement_measured,
)
from trackslip_estimation.slip.weighing import contradiction_limit
from trackslip_estimation.slip.window import Window

if TYPE_CHECKING:
    from trackslip_estimation.slip.config import Config
    from trackslip_estimation.slip.records import Branch, MeasurementRecord, State, Update

_MOST = 100.0  # q
_MEMORY = 2.0  # rad, of turns


@compiled
def update_course(window: Window, s: int, k: int, c: Config) -> None:
    """Add fix or velocity k to q of branch s, where the branch predicts it by tracks and gyro."""
    branch, state, update = window.branches[s, k], window.states[s, k], update_of(window, s, k)
    measurement = window.measurements[k]
    confirmed = _confirmed_by_fix(state, branch, update, c)
    if measurement.kind == VELOCITY:
        elapsed = (measurement.stamp_ns - window.states[s, k - 1].weighed_ns[measurement.source]) * 1e-9
        confirmed = _confirmed_by_velocity(state, measurement, elapsed, update, c)
    turn = wrap(state.mean[YAW] - branch.course_from[YAW])
    branch.course_from[YAW] = state.mean[YAW]
    if measurement.kind == POSE:
        branch.course_from[:2] = state.displacement
    branch.course *= math.exp(-abs(turn) / _MEMORY)
    is_measured = is_displacement_measured(state.fault[measurement.source])
    if is_measured and update.nis <= contradiction_limit(update.dof, c):
        branch.course = _remaining_course(branch, measurement.stamp_ns, c)
        branch.course_ns = measurement.stamp_ns
    if state.is_sector or is_heading_unknown(state) or not is_heading_carried(state, c):
        branch.course = 0.0
    elif _is_course_measured(state, measurement.source, c):
        branch.course = min(max(branch.course + confirmed, 0.0), _MOST)


@compiled
def _confirmed_by_fix(state: State, branch: Branch, update: Update, c: Config) -> float:
    """Part of q by the displacement since the previous fix."""
    P, cos, sin = state.covariance, math.cos(state.mean[YAW]), math.sin(state.mean[YAW])
    east = state.displacement[X] - branch.course_from[X]
    north = state.displacement[Y] - branch.course_from[Y]
    ahead, variance = cos * east + sin * north, update.stated * update.stated + (P[X, X] + P[Y, Y]) / 2.0
    return float(ahead * (ahead + _usual_innovation(update, variance, c)) / variance)


@compiled
def _confirmed_by_velocity(
    state: State, m: MeasurementRecord, elapsed: float, update: Update, c: Config
) -> float:
    """Part of q by an east-north velocity ``elapsed`` s after the previous one: its errors last for τ."""
    if c.body_axes[m.source] == 1 or update.dof < YAW:
        return 0.0
    variance = (m.noise[0, 0] + m.noise[1, 1]) / 2.0 + state.covariance[SPEED_ERROR, SPEED_ERROR]
    measured = math.cos(state.mean[YAW]) * m.value[X] + math.sin(state.mean[YAW]) * m.value[Y]
    ahead = measured - update.whitened[0] * math.sqrt(variance)
    share = min(elapsed / c.velocity_errors.time, 1.0)
    return float(share * ahead * (ahead + _usual_innovation(update, variance, c)) / variance)


@compiled
def _usual_innovation(update: Update, variance: float, c: Config) -> float:
    """Innovation of a variance along the heading, of at most the largest usual size."""
    most = c.bank.cusum_largest
    return float(min(max(update.whitened[0], -most), most) * math.sqrt(variance))


@compiled
def _is_course_measured(state: State, source: int, c: Config) -> bool:
    """Whether fixes of a source measure displacements, and the tracks determine their direction."""
    is_sound = is_displacement_measured(state.fault[source]) and not has_failed_unit(state)
    return bool(is_sound and is_gripping(state, c))


@compiled
def is_heading_carried(state: State, c: Config) -> bool:
    """Whether a gyro measures the yaw rate of the undercarriage, on the cab with an encoder of the swing."""
    if state.fault[GYROS] != IS_HEALTHY:
        return False
    on_undercarriage = on_cab = measures_swing = False
    for source in range(MOST_SOURCES):
        if state.stamp_ns - state.consistent_ns[source] < c.sprocket_timeout_ns:
            is_above = c.above[source] == 1
            on_undercarriage |= c.is_gyro[source] == 1 and not is_above
            on_cab |= c.is_gyro[source] == 1 and is_above
            measures_swing |= c.measures_swing[source] == 1 and not has_fault(state, source)
    return bool(on_undercarriage or (on_cab and measures_swing))


@compiled
def _remaining_course(branch: Branch, stamp_ns: int, c: Config) -> float:
    """q at a stamp: 0 if no fix has agreed for ``look_back_time``."""
    return float(branch.course if stamp_ns - branch.course_ns <= c.bank.look_back_time * 1e9 else 0.0)


@compiled
def log_odds_against_turn(window: Window, p: int, k: int, part: int, c: Config) -> float:
    """ln of the odds of the heading of branch p, up to its snapshot before k, against that of another sector.

    In its own sector, ``part`` 0: against one that is off by the standard deviation of a sector.
    """
    branch, (angle, variance) = window.branches[p, k - 1], sector_angle(part)
    snapshot_ns = window.measurements[branch.snapshots[OLDER].entry].stamp_ns
    against = 1.0 - math.cos(angle if part > 0 else math.sqrt(variance))
    return against * _remaining_course(branch, snapshot_ns, c)
