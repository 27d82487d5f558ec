# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Update with the increments of a laser's or a camera's odometry; compiled.

    z, R    mean velocity of C over T along the machine's axes, mean yaw rate (``increments``)
    T       time between two poses of the source                                            s
    s_o     scale error of the source's lengths: a state of each source                     1
    m       velocity errors (``speed``)                                                     m/s, rad/s
    D       variance of the mean of m over T, given m at its end                            (3,)
    C       covariance of the pose with the error of variance D                             (3, n)
    f       factor of R (``adaptation``)                                                    1

The poses of a source drift and are never used; the increment between two poses is. It is compared with the
motion that the filter predicted over T. The prediction has the errors of the slow states and of the mean of
m. This mean is correlated with m at the end of T; the rest of it, of variance D, has moved the pose too.
Through C the update corrects the pose: a distance that the tracks slipped and a camera did not observe is
removed. A fix since the first pose has already corrected the pose; then there is no C.

Odometry and tracks do not observe s_o, only fixes do: s_o is a consider state. Inside the gate an increment
is used in full. Where only the largest track error explains it, it is down-weighted. Beyond that it is
rejected, until the source has disagreed for long enough (``gate``). Where the increments of a second or two
agree on a slip of both tracks beyond its uncertainty, the ground has changed: the variance of i₀ is inflated.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_common.compiled import compiled, inlined
from trackslip_estimation.kalman.linear_algebra import (
    copy_square,
    log_determinant,
    root,
    weighted_square,
    wrap,
)
from trackslip_estimation.kalman.update import (
    Observation,
    correct,
    inflate_noise_to_gate,
    predicted_covariance,
)
from trackslip_estimation.slip.adaptation import learn_from_fix, learn_from_speed
from trackslip_estimation.slip.gate import gate_limit
from trackslip_estimation.slip.mean_speeds import MeanSpeeds, mean_speeds_since, store_reading
from trackslip_estimation.slip.measurements import Outcome
from trackslip_estimation.slip.models import speed
from trackslip_estimation.slip.models.dispatch import body_jacobian, body_twist, has_velocity_errors
from trackslip_estimation.slip.models.model import SPEED_TIME, YAW, X, Y
from trackslip_estimation.slip.models.speed import COMMON_SLIP, SPEED_ERROR, YAW_RATE_ERROR
from trackslip_estimation.slip.motion import Motion
from trackslip_estimation.slip.observations.increments import increment, stated_variances
from trackslip_estimation.slip.source_faults import IS_FAILED
from trackslip_estimation.slip.validity import FASTEST, FASTEST_TURN

if TYPE_CHECKING:
    from trackslip_estimation.slip.config import Config
    from trackslip_estimation.slip.records import MeasurementRecord, OdometryRecord, Prior, State, Update


_GATED, _BEGUN, _STANDING = int(Outcome.GATED), int(Outcome.BEGUN), int(Motion.STANDING)
_MOST_SHARED = 0.7  # largest correlation of the position with an error of variance D


@compiled
def _reset_slip_evidence(before: OdometryRecord, since_ns: int) -> None:
    before.slip_weight = before.slip_sum = before.slip_distance = 0.0
    before.slip_ns = since_ns


@compiled
def begin_odometry(state: State) -> None:
    """Reset the records of odometry at the start of the estimate."""
    state.sprocket_angles[:], state.integrated_twist[:], state.fixed_ns = 0.0, 0.0, state.stamp_ns
    for k in range(state.odometry.size):
        state.odometry[k].known = False
        _reset_slip_evidence(state.odometry[k], state.stamp_ns)


@compiled
def integrate_motion(state: State, dt: float, c: Config) -> None:
    """Accumulate the motion predicted for the next ``dt`` s, before the step."""
    if c.odometries == 0:
        return
    left, right, x = state.speeds.left, state.speeds.right, state.mean.copy()
    if has_velocity_errors(c):
        share = speed.persistence(dt, state.motion.motion, c)[1]
        x[SPEED_ERROR] *= share
        x[YAW_RATE_ERROR] *= share
    v_x, v_y, rate = body_twist(x, left, right, state, c)
    state.integrated_twist[0] += v_x * dt
    state.integrated_twist[1] += v_y * dt
    state.integrated_twist[2] += rate * dt


@inlined
def update_with_odometry(
    state: State, measurement: MeasurementRecord, c: Config, update: Update, prior: Prior
) -> None:
    """Gate and update with an increment (see the top of the module), and store its pose.

    Arguments as in ``update``.
    """
    source = measurement.source
    before = state.odometry[c.odometry_number[source]]
    since_ns = state.readings[source].stamp_ns
    T = (measurement.stamp_ns - since_ns) * 1e-9
    follows = before.known and before.frame == measurement.frame and before.coasting == state.coasting
    if state.fault[source] == IS_FAILED:
        update.outcome = _GATED
        _reset_slip_evidence(before, since_ns)
    elif follows and c.odometry_gap[source] >= T:
        z = increment(before, measurement, T, c)
        if max(abs(z[0]), abs(z[1])) < FASTEST and abs(z[2]) < FASTEST_TURN:
            _update_with_increment(
                state, z, np.diag(stated_variances(before, measurement, T, c)), measurement, c, update, prior
            )
        else:
            update.outcome = _GATED
    else:
        update.outcome = _BEGUN
    store_reading(state, source, measurement.stamp_ns)
    before.known, before.coasting = True, state.coasting
    before.frame, before.position[:] = measurement.frame, measurement.value
    before.orientation[:] = measurement.orientation
    before.noise[:], before.integrated_twist[:] = measurement.noise, state.integrated_twist
    before.errors[0] = state.covariance[SPEED_ERROR, SPEED_ERROR]
    before.errors[1] = state.covariance[YAW_RATE_ERROR, YAW_RATE_ERROR]


@compiled
def _update_with_increment(
    state: State,
    z: FloatArray,
    stated: FloatArray,
    measurement: MeasurementRecord,
    c: Config,
    update: Update,
    prior: Prior,
) -> None:
    """Gate and update; ``stated``: R (3, 3) as the source states it."""
    source, limit, P = measurement.source, c.gate_limits[3], state.covariance[:]
    before, factors = state.odometry[c.odometry_number[source]], state.adaptation.fix_factors
    speeds, since_ns = mean_speeds_since(state, source, measurement.stamp_ns), state.readings[source].stamp_ns
    speed_factor, rate_factor, variances = _mean_error_model(state, before, speeds, c)
    h, H = _predicted_increment(state, before, speeds, source, speed_factor, rate_factor, c)
    D = np.diag(variances)
    innovation = z - h
    if has_velocity_errors(c) and not state.coasting:
        error_variance = H[0, SPEED_ERROR] ** 2 * P[SPEED_ERROR, SPEED_ERROR] + D[0, 0]
        independent_variance = factors[source] * stated[0, 0] + error_variance * max(
            2.0 * c.velocity_errors.time / speeds.T, 1.0
        )
        _inflate_slip_on_agreement(state, before, since_ns, innovation[0], speeds, H, independent_variance, c)
        copy_square(P, prior.covariance, c.size)
    predicted = predicted_covariance(P, H) + D
    update.dof, update.gate = 3, gate_limit(state, measurement, 3, c)
    least_nis = _least_nis(state, source, innovation, predicted, stated, speeds, update.gate, c)
    R = factors[source] * stated
    L = root(predicted + R)
    update.nis, update.log_determinant = weighted_square(L, innovation), log_determinant(L)
    if least_nis > update.gate:
        update.outcome = _GATED
        return
    if least_nis > limit:
        prior.covariance[SPEED_ERROR, SPEED_ERROR] += innovation[0] ** 2
        prior.covariance[YAW_RATE_ERROR, YAW_RATE_ERROR] += innovation[2] ** 2
        copy_square(prior.covariance, P, c.size)
    else:
        inflate_noise_to_gate(R, innovation, predicted, limit)
    scale = c.source_states[source]
    C = _pose_noise_covariance(state, since_ns, speeds.T, variances)
    correct(state.mean[:], P, Observation(innovation, H, R + D, 1 << scale if scale >= 0 else 0, 0, C))
    state.mean[YAW] = wrap(state.mean[YAW])
    state.consistent_ns[source] = measurement.stamp_ns


@inlined
def _least_nis(
    state: State,
    source: int,
    innovation: FloatArray,
    predicted: FloatArray,
    stated: FloatArray,
    speeds: MeanSpeeds,
    gate: float,
    c: Config,
) -> float:
    """NIS with the largest possible track error; inside ``gate``, track error and noise factor are adapted.

    ``predicted``: covariance of the innovation without R; ``stated``: R as stated, (3, 3).
    """
    a = state.adaptation
    S, by_tracks = predicted + a.fix_factors[source] * stated, np.zeros(3)
    largest = S.copy()
    if has_velocity_errors(c) and not state.coasting:
        by_tracks[:] = track_error_variances(state, speeds, c)
        margin = c.adaptation.track_variances[-1] - a.track_variance
        for k in range(3):
            largest[k, k] += margin * by_tracks[k]
    least_nis = weighted_square(root(largest), innovation)
    if has_velocity_errors(c) and least_nis <= gate:
        is_standing = state.motion.motion == _STANDING
        learn_from_speed(a, innovation[0], S[0, 0], by_tracks[0], is_standing, c)
        if weighted_square(root(S), innovation) <= c.gate_limits[3]:
            learn_from_fix(a, source, innovation, predicted, stated, c)
    return least_nis


@compiled
def _inflate_slip_on_agreement(
    state: State,
    before: OdometryRecord,
    since_ns: int,
    innovation: float,
    speeds: MeanSpeeds,
    H: FloatArray,
    independent_variance: float,
    c: Config,
) -> None:
    """Inflate the covariance of i₀ and of the position where recent increments agree on another slip.

    ``innovation`` of the speed ahead, m/s; ``independent_variance``: variance of independent errors.
    """
    x, P, T = state.mean[:], state.covariance[:], speeds.T
    track_speed = c.rolling_radius * (speeds.left + speeds.right) / 2.0
    if abs(track_speed) < max(c.ground.slowest, abs(innovation)):  # possible on no ground
        return
    H_slow = H[:1].copy()
    H_slow[0, SPEED_ERROR] = H_slow[0, YAW_RATE_ERROR] = 0.0
    slow_variance = predicted_covariance(P, H_slow)[0, 0]
    decay = math.exp(-T / c.ground.increments_time)
    before.slip_weight = decay * before.slip_weight + track_speed * track_speed / independent_variance
    before.slip_sum = decay * before.slip_sum - track_speed * innovation / independent_variance
    before.slip_distance += track_speed * T
    error, variance = (
        before.slip_sum / before.slip_weight,
        1.0 / before.slip_weight + slow_variance / (track_speed * track_speed),
    )
    if error * error <= variance:
        before.slip_distance, before.slip_ns = 0.0, since_ns
    elif error * error > c.ground.significant**2 * variance:
        distance = before.slip_distance if state.fixed_ns < before.slip_ns else 0.0
        deviation, ahead = np.zeros(P.shape[0]), -error * distance
        deviation[COMMON_SLIP], deviation[X], deviation[Y] = (
            error,
            ahead * math.cos(x[YAW]),
            ahead * math.sin(x[YAW]),
        )
        P += np.outer(deviation, deviation)
        _reset_slip_evidence(before, since_ns)


@compiled
def _predicted_increment(
    state: State,
    before: OdometryRecord,
    speeds: MeanSpeeds,
    source: int,
    speed_factor: float,
    rate_factor: float,
    c: Config,
) -> tuple[FloatArray, FloatArray]:
    """h (3,) and H (3, n); ``speed_factor``, ``rate_factor``: of the means of m on m at the end of T."""
    index, h = c.source_states[source], (state.integrated_twist - before.integrated_twist) / speeds.T
    scale = 1.0 + (state.mean[index] if index >= 0 else 0.0)
    H = body_jacobian(state.mean[:], speeds.left, speeds.right, state, c)
    for i in range(3):
        if has_velocity_errors(c):
            H[i, SPEED_ERROR] *= speed_factor
            H[i, YAW_RATE_ERROR] *= rate_factor
        if i < YAW:
            for j in range(state.mean.size):
                H[i, j] *= scale
            if index >= 0:
                H[i, index] = h[i]
            h[i] *= scale
    return h, H


@compiled
def _mean_error_model(
    state: State, before: OdometryRecord, speeds: MeanSpeeds, c: Config
) -> tuple[float, float, FloatArray]:
    """Factors ``speed_factor`` and ``rate_factor`` of ``_predicted_increment``, and D (3,).

    While the sprockets are silent, D is that of an unknown speed.
    """
    T, D = speeds.T, np.zeros(3)
    if state.coasting:
        D[0] = D[1] = 2.0 * SPEED_TIME * c.unknown_speed**2 / T
        return 0.0, 1.0, D
    if not has_velocity_errors(c):
        return 0.0, 0.0, D
    variances = speed.error_variances(state.mean[:], state.covariance[:], state, c)
    persistence = speed.persistence(T, state.motion.motion, c)
    growth = speed.error_growth(T, state.motion.motion, c)
    speed_factor, D[0] = _regress_mean_on_end(before.errors[0], variances[0], persistence, growth)
    rate_factor, D[2] = _regress_mean_on_end(before.errors[1], variances[1], persistence, growth)
    D[1] = state.adaptation.track_variance * _sideways_variance(speeds, c)
    return speed_factor, rate_factor, D


@compiled
def _regress_mean_on_end(
    first: float, variance: float, persistence: tuple[float, float], growth: tuple[float, float, float]
) -> tuple[float, float]:
    """Regression of the mean of an error over T on its value at the end: factor and residual variance.

    ``first``: variance at the start of T; ``variance``: variance of the process.
    """
    (rho, mean), (of_mean, of_both, of_end) = persistence, growth
    both, end = rho * mean * first + of_both * variance, rho * rho * first + of_end * variance
    factor = both / end if end > 0.0 else 0.0
    return factor, max(mean * mean * first + of_mean * variance - factor * both, 0.0)


@compiled
def _sideways_variance(speeds: MeanSpeeds, c: Config) -> float:
    """Variance of the mean of v_y over T for a track error of 1 (``speed``), (m/s)²."""
    squares: float = c.rolling_radius**2 * (speeds.left * speeds.left + speeds.right * speeds.right)
    return float(c.adaptation.sideways**2 * squares / 4.0 * 2.0 * c.velocity_errors.time / speeds.T)


@compiled
def track_error_variances(state: State, speeds: MeanSpeeds, c: Config) -> FloatArray:
    """(3,) part of the diagonal of S by the tracks, for a track error of 1."""
    mean_share = speed.persistence(speeds.T, state.motion.motion, c)[1]
    of_mean = speed.error_growth(speeds.T, state.motion.motion, c)[0]
    U = speed.track_exposure(state, c)
    ahead = c.adaptation.forward**2 / 4.0 * (mean_share**2 * state.adaptation.speed_exposure + of_mean * U)
    return np.array((ahead, _sideways_variance(speeds, c), of_mean * U / c.tread**2))


@compiled
def _pose_noise_covariance(state: State, since_ns: int, T: float, D: FloatArray) -> FloatArray:
    """C: errors of variance ``D`` (3,) have moved the pose by T times themselves; (0, n) after a fix.

    The yaw rate has no covariance, since a gyro may have observed its error. The covariance with the position
    is bounded by the uncertainty of the position.
    """
    n, P = state.mean.size, state.covariance
    if state.fixed_ns > since_ns:
        return np.zeros((0, n))
    C, cos, sin = np.zeros((3, n)), math.cos(state.mean[YAW]), math.sin(state.mean[YAW])
    for k, (x, y) in enumerate(((cos, sin), (-sin, cos))):
        variance = max(x * x * P[X, X] + 2.0 * x * y * P[X, Y] + y * y * P[Y, Y], 0.0)
        covariance = min(T * D[k], _MOST_SHARED * math.sqrt(variance * D[k]))
        C[k, X], C[k, Y] = x * covariance, y * covariance
    return C
