# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Evidence and update of one branch by poses, headings, swing angles and velocities; compiled.

    ν, H, R   the observation (``observations``)                            (m,), (m, n), (m, m)
    S         covariance of the innovation, H P Hᵀ + R                      (m, m)
    p         share of the source's measurements that are outliers          1

Inside a branch a measurement is either sound or an outlier. The likelihood of a sound one is Student's t over
the noise-factor masses; an outlier has any size. The gate compares both: an outlier that is more likely is
not used. ``update.evidence`` is ln of the larger likelihood; the bank weighs the branch by it. Fixes of a
coarse receiver contain its offset (``correlated_errors``); a large innovation first inflates that offset's
variance.

Errors of a compass or an encoder are time-correlated. An angle that agrees with a branch raises its evidence
in proportion to the time since the previous angle, up to a second. An angle that disagrees counts in full.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_common.compiled import compiled, inlined
from trackslip_estimation.kalman.linear_algebra import log_determinant, root, weighted_square, wrap
from trackslip_estimation.kalman.update import (
    Observation,
    correct,
    inflate_noise_to_gate,
    predicted_covariance,
)
from trackslip_estimation.slip.adaptation import (
    correlated_inflation,
    largest_correlated_inflation,
    learn_from_fix,
    learn_from_speed,
    log_density,
    log_density_over_factors,
)
from trackslip_estimation.slip.correlated_errors import PRECISE, quality_of, student_inflation
from trackslip_estimation.slip.levers import lever, turn_about_sensor
from trackslip_estimation.slip.mean_speeds import MeanSpeeds
from trackslip_estimation.slip.measurements import Outcome
from trackslip_estimation.slip.models.dispatch import has_velocity_errors
from trackslip_estimation.slip.models.model import YAW, X, Y
from trackslip_estimation.slip.motion import Motion
from trackslip_estimation.slip.observations.heading import observe_heading
from trackslip_estimation.slip.observations.odometry import track_error_variances
from trackslip_estimation.slip.observations.pose import has_offset, observe_pose, stated_noise
from trackslip_estimation.slip.observations.swing import observe_swing
from trackslip_estimation.slip.observations.velocity import observe_velocity
from trackslip_estimation.slip.records import HEADING, ON_SWING, POSE, VELOCITY
from trackslip_estimation.slip.source_faults import (
    IS_HEALTHY,
    IS_IGNORED,
    IS_OFFSET,
    IS_REPEATING,
    IS_SCATTERING,
    IS_STAYING,
    IS_WANDERING,
    is_displacement_measured,
    log_density_of_outlier,
    log_density_of_scatter,
    weigh_repeat,
)
from trackslip_estimation.slip.source_offsets import (
    has_correlated_errors,
    has_mostly_correlated_errors,
    inflate_offset,
    latest_pose_source,
    pose_source_number,
    position_stddev,
    prepare_offset,
)
from trackslip_estimation.slip.standstill import inflate_repeated_fix, is_at_same_standstill
from trackslip_estimation.slip.wandering import weigh_wander

if TYPE_CHECKING:
    from trackslip_estimation.slip.config import Config
    from trackslip_estimation.slip.records import MeasurementRecord, Prior, State, Update


_GATED, _STANDING = int(Outcome.GATED), int(Motion.STANDING)
_LOG_TWO_PI = math.log(2.0 * math.pi)
_ANGLE_ERROR_TIME = 1.0  # correlation time of errors of a compass or an encoder, s
_PLACE_TIME = 1.0  # s over which fixes that stay are averaged: slower ones may creep


@inlined
def weigh_and_update(
    state: State, measurement: MeasurementRecord, c: Config, update: Update, prior: Prior
) -> None:
    """Weigh the branch by a measurement, and update the state with it; arguments as in ``update``."""
    kind, source, fault = measurement.kind, measurement.source, state.fault[measurement.source]
    elapsed = (measurement.stamp_ns - state.weighed_ns[source]) * 1e-9
    if kind == POSE:
        stated = stated_noise(measurement, state, c)
        prepare_offset(state, update, prior, source, stated, fault == IS_OFFSET, c)
        update.stated = position_stddev(stated)
        update.coarse = 0 if quality_of(update.stated, c) == PRECISE else 1
    _set_repeat_distance(state, measurement, elapsed, update)
    o = observe_weighed(state, measurement, c)
    if kind == POSE:
        _set_measured_position(state, source, o, update, c)
    state.weighed_ns[source] = measurement.stamp_ns
    m, P = o.innovation.size, state.covariance[:]
    predicted = predicted_covariance(P, o.jacobian)
    log_outlier = log_density_of_outlier(measurement, o, predicted, c)
    if fault in (IS_REPEATING, IS_STAYING):
        weigh_repeat(kind, o, fault == IS_STAYING, c, update)
        _discount_correlated_angle(kind, elapsed, log_outlier, update)
        return
    if fault == IS_WANDERING:
        wander = state.offsets[pose_source_number(source, c)].wander
        weigh_wander(wander, o, predicted, elapsed, c, update)
        if m > YAW:
            _update_heading_only(state, o, predicted, c, update)
        return
    since_ns = measurement.stamp_ns - state.consistent_ns[source]
    inflation = correlated_inflation(since_ns, c.repeat_times[source])
    repeats_standstill = is_at_same_standstill(state, source, c)
    R = _weigh(state, measurement, o, predicted, log_outlier, repeats_standstill, c, update)
    _discount_correlated_angle(kind, elapsed, log_outlier, update)
    if kind == POSE or (kind == VELOCITY and c.body_axes[source] == 0):
        _set_whitened_innovation(state, o.innovation, predicted + R, update)
    if update.outcome == _GATED:
        return
    if kind == POSE and is_displacement_measured(fault) and update.nis <= update.gate:
        _learn_track_error(state, o.innovation, predicted + R, elapsed, c)
    if update.coarse == 1 and has_mostly_correlated_errors(state, source, c):
        share = student_inflation(update.nis, m)
        inflate_offset(state, P, source, share * np.diag(predicted + R), c)
        predicted = predicted_covariance(P, o.jacobian)
    inflate_noise_to_gate(R, o.innovation, predicted, c.gate_limits[m])
    if kind == POSE:
        R *= min(inflation, largest_correlated_inflation(predicted, R))
        inflate_repeated_fix(state, source, not repeats_standstill or update.nis > update.gate, R, c)
    _correct(
        state, measurement, Observation(o.innovation, o.jacobian, R, o.considered, 0, o.cross_covariance), c
    )
    if fault == IS_OFFSET or (kind != POSE and state.heading_fault[source] != IS_HEALTHY):
        update.outcome = _GATED


@compiled
def _update_heading_only(
    state: State, o: Observation, predicted: FloatArray, c: Config, update: Update
) -> None:
    """Update the heading with a fix whose position wanders; two antennas measure it independently."""
    S = predicted[YAW, YAW] + o.noise[YAW, YAW]
    nis = o.innovation[YAW] ** 2 / S
    if nis > c.gate_limits[1]:  # it contradicts the branch
        update.evidence -= _LOG_TWO_PI
        update.nis, update.dof, update.gate = nis, 1, c.gate_limits[1]
        return
    update.evidence -= (nis + math.log(S) + _LOG_TWO_PI) / 2.0
    R, x = o.noise[YAW:, YAW:].copy(), state.mean[: c.size]
    heading = Observation(
        o.innovation[YAW:].copy(), o.jacobian[YAW:].copy(), R, o.considered, 0, o.cross_covariance
    )
    correct(x, state.covariance[:], heading)
    x[YAW] = wrap(x[YAW])


@compiled
def _discount_correlated_angle(kind: int, elapsed: float, log_outlier: float, update: Update) -> None:
    """Lower the evidence of an angle that agrees, ``elapsed`` s after the previous one."""
    if kind in (HEADING, ON_SWING):
        uncounted = 1.0 - min(elapsed / _ANGLE_ERROR_TIME, 1.0)
        update.evidence -= uncounted * max(update.evidence - log_outlier, 0.0)


@compiled
def contradiction_limit(rows: int, c: Config) -> float:
    """NIS of ``rows`` degrees of freedom beyond which a measurement contradicts a branch: half its gate."""
    return float(c.gate_limits[rows] / 2.0)


@compiled
def observe_weighed(state: State, measurement: MeasurementRecord, c: Config) -> Observation:
    """Observation of a state by a pose, heading, swing angle or velocity."""
    if measurement.kind == POSE:
        return observe_pose(state, measurement, c)
    if measurement.kind == HEADING:
        return observe_heading(state, measurement, c)
    if measurement.kind == VELOCITY:
        return observe_velocity(state, measurement, c)
    return observe_swing(state, measurement, c)


@compiled
def _correct(state: State, measurement: MeasurementRecord, o: Observation, c: Config) -> None:
    """Update the state; a correction of its heading keeps the position of the sensor ``_pivot_source``."""
    x, P, level = state.mean[: c.size], state.covariance[:], state.attitude.level
    pivot = _pivot_source(state, measurement, c)
    if pivot < 0:
        correct(x, P, o)
    else:
        before, arm = x.copy(), lever(x, level, pivot, c)
        correct(x, P, o)
        turn_about_sensor(x, P, before, arm, level, pivot, c)
    x[YAW] = wrap(x[YAW])


@compiled
def _pivot_source(state: State, measurement: MeasurementRecord, c: Config) -> int:
    """Pose source whose sensor keeps its position while heading or swing is corrected; −1: none."""
    if measurement.kind == POSE:
        return int(measurement.source)
    if measurement.kind in (HEADING, VELOCITY):
        if c.poses == 0:
            return -1
        latest = latest_pose_source(state, c)
        return latest if c.above[latest] == c.above[measurement.source] else -1
    return int(c.swing_pose_source)


@compiled
def _set_measured_position(state: State, source: int, o: Observation, update: Update, c: Config) -> None:
    """Set ``update.measured_position``: base_link by a pose, without correction of the source's offset."""
    for axis in (X, Y):
        update.measured_position[axis] = o.innovation[axis] + state.mean[axis]
        if has_offset(state, source, c):
            update.measured_position[axis] += state.mean[c.offsets[source] + axis]


@compiled
def _learn_track_error(
    state: State, innovation: FloatArray, S: FloatArray, elapsed: float, c: Config
) -> None:
    """Update the track error with a fix's lateral innovation, if no gyro does; ``elapsed``: s since a fix."""
    if not has_velocity_errors(c) or state.coasting or not 0.0 < elapsed <= c.bank.longest_interval:
        return
    if state.adaptation.elapsed <= c.bank.longest_interval:  # by a recent yaw rate
        return
    cos, sin = math.cos(state.mean[YAW]), math.sin(state.mean[YAW])
    lateral = (cos * innovation[Y] - sin * innovation[X]) / elapsed
    variance = (sin * sin * S[X, X] - 2.0 * cos * sin * S[X, Y] + cos * cos * S[Y, Y]) / elapsed**2
    left, right = state.speeds.left, state.speeds.right
    _, sideways_variance, turn_variance = track_error_variances(state, MeanSpeeds(left, right, elapsed), c)
    distance = c.rolling_radius * (left + right) / 2.0 * elapsed
    by_tracks = sideways_variance + distance * distance * turn_variance / 3.0
    learn_from_speed(state.adaptation, lateral, variance, by_tracks, state.motion.motion == _STANDING, c)


@inlined
def _weigh(
    state: State,
    measurement: MeasurementRecord,
    o: Observation,
    predicted: FloatArray,
    log_outlier: float,
    repeats_standstill: bool,
    c: Config,
    update: Update,
) -> FloatArray:
    """Fill ``update``, with the outcome GATED if the measurement is not used; return its R (m, m).

    A fix that ``repeats_standstill`` within its gate is not learned from. ``predicted``: H P Hᵀ (m, m);
    ``log_outlier``: ln of the density of an outlier.
    """
    source, m, a = measurement.source, o.innovation.size, state.adaptation
    limit, share, fault = c.gate_limits[m], state.outlier_share[source], state.fault[source]
    coarse = update.coarse == 1
    R = o.noise.copy() if coarse else a.fix_factors[source] * o.noise
    L = root(predicted + R)
    update.dof, update.gate = m, limit
    update.nis, update.log_determinant = weighted_square(L, o.innovation), log_determinant(L)
    if fault == IS_SCATTERING:
        update.evidence, update.outcome = log_density_of_scatter(measurement, o, predicted, c), _GATED
        return R
    density = log_density(L, o.innovation)
    if not coarse:
        density = log_density_over_factors(a, source, o.innovation, predicted, o.noise, c)
    evidence, outlier = math.log(1.0 - share) + density, math.log(share) + log_outlier
    is_outlier = fault == IS_IGNORED or (outlier > evidence and not np.isinf(limit))
    contribution = c.bank.outlier_share if is_outlier else c.bank.healthy_share
    state.outlier_share[source] += c.bank.share_memory * (contribution - share)
    if is_outlier:
        update.evidence, update.outcome = outlier, _GATED
        return R
    is_independent = not repeats_standstill or update.nis > limit
    is_learned = is_independent and has_velocity_errors(c) and update.nis <= c.adaptation.soft_gate * limit
    if is_learned and not coarse:
        learn_from_fix(a, source, o.innovation, predicted, o.noise, c)
        number = pose_source_number(source, c)
        is_correlated = number >= 0 and (
            state.offsets[number].variance > 0.0 or has_correlated_errors(state, source, update.stated, c)
        )
        if is_correlated or c.repeat_times[source] > 0.0:  # small innovations do not imply small errors
            a.fix_factors[source] = max(a.fix_factors[source], 1.0)
        R = a.fix_factors[source] * o.noise
    update.evidence = evidence
    if update.nis <= contradiction_limit(m, c):
        state.consistent_ns[source] = measurement.stamp_ns
        if measurement.kind == POSE:
            state.sole_fix_source, state.sole_fix_heading = -1, False
    return R


@compiled
def _set_repeat_distance(
    state: State, measurement: MeasurementRecord, elapsed: float, update: Update
) -> None:
    """Set the squared distances of a measurement from the source's previous one, and store it as the last.

    Fixes of a source that stays are compared with their mean over ``_PLACE_TIME``: those of a machine that
    moves again leave it. ``elapsed``: s since the previous one.
    """
    last, z = state.last_value[measurement.source], measurement.value
    update.squared_repeat_distance = (z[X] - last[X]) ** 2 + (z[Y] - last[Y]) ** 2
    update.squared_repeat_angle, last[YAW] = wrap(z[YAW] - last[YAW]) ** 2, z[YAW]
    if state.fault[measurement.source] == IS_STAYING:
        share = -math.expm1(-elapsed / _PLACE_TIME)
        last[X] += share * (z[X] - last[X])
        last[Y] += share * (z[Y] - last[Y])
    else:
        last[X], last[Y] = z[X], z[Y]


@compiled
def _set_whitened_innovation(state: State, innovation: FloatArray, S: FloatArray, update: Update) -> None:
    """Set the whitened innovation of a position or velocity along and across the heading, for the CUSUM."""
    cos, sin = math.cos(state.mean[YAW]), math.sin(state.mean[YAW])
    along = cos * cos * S[X, X] + 2.0 * cos * sin * S[X, Y] + sin * sin * S[Y, Y]
    across = sin * sin * S[X, X] - 2.0 * cos * sin * S[X, Y] + cos * cos * S[Y, Y]
    update.whitened[0] = (cos * innovation[X] + sin * innovation[Y]) / math.sqrt(along)
    update.whitened[1] = (cos * innovation[Y] - sin * innovation[X]) / math.sqrt(across)
