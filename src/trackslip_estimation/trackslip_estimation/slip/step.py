# SPDX-License-Identifier: Apache-2.0
"""The step of the slip estimator: propagate, predict the observation, gate, update; compiled.

    state         record of ``STATE``, at the measurement before; in place
    closing       record of ``MEASUREMENT``: the next sprocket sample, which closes the interval
    measurement   record of ``MEASUREMENT``
    c             record of ``config.CONFIG``
    update        record of ``UPDATE``: what became of the measurement

Live node, replay, tuning, studies and smoother all make this step, and no other.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from trackslip_common.compiled import compiled, inlined
from trackslip_estimation.kalman import daf, ekf
from trackslip_estimation.kalman.linear_algebra import log_determinant as log_determinant_of
from trackslip_estimation.kalman.linear_algebra import root, sandwich, weighted_square, wrap
from trackslip_estimation.slip.adaptation import learn_from_fix, learn_from_rate, lose_track, pass_time
from trackslip_estimation.slip.alignment import UNKNOWN_HEADING, keep_refused, realign
from trackslip_estimation.slip.coasting import begin_coast, inflate, reset_velocity
from trackslip_estimation.slip.gate import forget_ground, on_no_ground, other_ground, widen, width
from trackslip_estimation.slip.measurements import Outcome
from trackslip_estimation.slip.models.dispatch import (
    COUPLED,
    has_velocity_errors,
    linearize,
    move,
    twist,
    twist_jacobian,
)
from trackslip_estimation.slip.models.model import GYRO_BIAS, GYRO_SCALE, SIZE, YAW, X, Y
from trackslip_estimation.slip.models.speed import YAW_RATE_ERROR
from trackslip_estimation.slip.motion import Motion, update_motion
from trackslip_estimation.slip.observation import (
    add_rounding,
    comparable_speeds,
    expected,
    jacobian,
    observed,
    stamp_shift,
    to_delayed,
    to_sensor,
)
from trackslip_estimation.slip.records import MANUAL, POSE, SPROCKETS, YAW_RATE
from trackslip_estimation.slip.sprockets import interval_speeds, jumps, remember, set_speeds, stand_still

FloatArray = NDArray[np.float64]

_ACCEPTED, _GATED, _JUMPED = int(Outcome.ACCEPTED), int(Outcome.GATED), int(Outcome.JUMPED)
_UNKNOWN, _STANDING = int(Motion.UNKNOWN), int(Motion.STANDING)


@inlined
def step(state: Any, closing: Any, measurement: Any, c: Any, update: Any) -> None:
    """The state at the measurement's stamp, with the measurement used or not."""
    follow_sprockets(state, closing, measurement.stamp_ns, c)
    update.outcome, update.dof, update.follows = _ACCEPTED, 0, not state.coasting
    update.nis = update.gate = update.log_determinant = np.nan
    update.prior_mean[:], update.prior_covariance[:] = state.mean, state.covariance
    if measurement.kind == SPROCKETS:
        if jumps(state.sample, measurement, c):
            update.outcome = _JUMPED
        remember(state, measurement, c)
    elif measurement.source == MANUAL:
        place(state, measurement)
        update.follows = False
    elif measurement.kind == POSE:
        use_pose(state, measurement, c, update)
    else:
        use(state, measurement, c, update)


@inlined
def follow_sprockets(state: Any, closing: Any, stamp_ns: int, c: Any) -> None:
    """The state at ``stamp_ns``, as the sprockets and the model say; it coasts while they are silent."""
    if state.sample.seen and state.sample.stamp_ns == stamp_ns == state.stamp_ns:
        return  # at the sample: nothing passes
    known_ns, reached_ns = set_speeds(state, closing, stamp_ns, c), state.stamp_ns
    if known_ns >= reached_ns:
        dt = (known_ns - reached_ns) * 1e-9
        update_motion(state.motion, state.speeds, dt, c.motion_limits, c.encoder_resolution)
        propagate(state, dt, c)
        state.coasting, reached_ns = False, known_ns
    if known_ns < stamp_ns:
        coast(state, (stamp_ns - reached_ns) * 1e-9, c)
        if closing.kind == SPROCKETS and closing.stamp_ns == stamp_ns:
            interval_speeds(state.sample, closing, c, state.speeds)
    state.stamp_ns = stamp_ns


@compiled
def coast(state: Any, dt: float, c: Any) -> None:
    """``dt`` s of silence later. Beyond the largest gap nothing grows: the pose is lost."""
    dt = min(dt, c.max_gap)
    if not state.coasting:
        left, right = state.speeds.left, state.speeds.right
        rate = twist(state.mean, left, right, c)[2]
        variance = sandwich(twist_jacobian(state.mean, left, right, c), state.covariance)[2, 2]
        begin_coast(state, (rate, variance), dt, c)
    stand_still(state.speeds)
    lose_track(state.adaptation)
    state.refused_count = 0  # they compare over what was driven
    motion = state.motion
    motion.motion, motion.changing = _UNKNOWN, True
    motion.left = motion.right = motion.left_mean = motion.right_mean = motion.departure = 0.0
    propagate(state, dt, c)
    inflate(state, dt, c)
    reset_velocity(state, c)
    state.coasting = True


@compiled
def propagate(state: Any, dt: float, c: Any) -> None:
    """Mean and covariance after ``dt`` s of the state's own speeds and motion."""
    x, P = state.mean, state.covariance
    if has_velocity_errors(c):
        pass_time(state, dt, c)
    moved, F, Q = linearize(x, P, state, dt, c)
    if not c.sigma_points:
        x[:] = moved
        ekf.propagate_covariance(P, F, Q, COUPLED)
        return
    points, weights = daf.sigma_points(x, P, c.kappa, c.active)
    for i in range(weights.size):
        points[i] = move(points[i], state, dt, c)
    mean, departures, weights = daf.moments(points, weights, YAW)
    x[:] = mean
    P[:] = daf.spread_covariance(departures, weights) + Q


@compiled
def place(state: Any, manual: Any) -> None:
    """A manual pose for the estimated one; what else was learned stays."""
    x, P = state.mean, state.covariance
    for i in range(3):
        x[i] = manual.value[i]
        for j in range(SIZE):
            P[i, j] = P[j, i] = 0.0
    P[:3, :3] = manual.noise
    state.aligning, state.refused_count = P[YAW, YAW] > UNKNOWN_HEADING**2, 0


@inlined
def use(state: Any, measurement: Any, c: Any, update: Any) -> None:
    """Gate and update with a yaw rate or slips; what is refused leaves mean and covariance as they were."""
    source, kind = measurement.source, measurement.kind
    z, R = observed(measurement, state.coasting, c)
    left, right, _ = comparable_speeds(kind, state, c)
    limit = c.gate_limits[z.size]
    silent_ns = measurement.stamp_ns - state.consistent_ns[source]
    gate = limit * width(silent_ns, c.timeouts_ns[source], c.gate_relaxation)
    update.dof, update.gate = z.size, gate
    adapts, stated = kind == YAW_RATE and has_velocity_errors(c), R[0, 0]
    if adapts:
        R *= state.adaptation.rate_factor
    x, P = state.mean.copy(), state.covariance.copy()
    add_rounding(kind, x, R, state, c)
    prior_x, prior_P = x.copy(), P.copy()
    nis, log_determinant = correct(kind, x, P, (z, R), (left, right), c)
    surprise = nis  # under the noise that may be, where that is being found
    if adapts and not state.coasting:
        innovation = z[0] - expected(kind, prior_x, 1, (left, right), c)[0]
        parts = state.adaptation.exposure * (1.0 + prior_x[GYRO_SCALE]) ** 2, stated
        stands, S = state.motion.motion == _STANDING, np.exp(log_determinant)
        surprise = learn_from_rate(state.adaptation, innovation, S, parts, stands, c)
    accepted = surprise <= gate
    if kind == YAW_RATE and np.isfinite(limit):
        rate = (z[0] - prior_x[GYRO_BIAS]) / (1.0 + prior_x[GYRO_SCALE])
        variance = R[0, 0] + prior_P[GYRO_BIAS, GYRO_BIAS]
        if adapts:  # what the tracks may err by
            variance += prior_P[YAW_RATE_ERROR, YAW_RATE_ERROR]
        if surprise <= limit:
            state.streaks[source].count = 0
        elif other_ground(rate, state.streaks[source], (left, right), c):
            forget_ground(prior_P, c)
            x[:], P[:] = prior_x, prior_P
            nis, log_determinant = correct(kind, x, P, (z, R), (left, right), c)
            surprise = nis
            accepted = nis <= gate
        accepted = accepted and not on_no_ground(rate, variance, (left, right), c)
    update.nis, update.log_determinant = nis, log_determinant
    if not accepted:
        update.outcome = _GATED
        return
    if surprise > limit:
        widen(kind, z, prior_x, prior_P, (left, right), c)
        x[:], P[:] = prior_x, prior_P
        correct(kind, x, P, (z, R), (left, right), c)
    elif nis > limit:  # only the largest noise that may be explains it: it weighs less
        R += (nis / limit - 1.0) * np.exp(log_determinant)
        x[:], P[:] = prior_x, prior_P
        correct(kind, x, P, (z, R), (left, right), c)
    if surprise <= limit or kind == YAW_RATE:
        state.consistent_ns[source] = measurement.stamp_ns
    update.prior_mean[:], update.prior_covariance[:] = prior_x, prior_P
    state.mean[:], state.covariance[:] = x, P


@inlined
def use_pose(state: Any, measurement: Any, c: Any, update: Any) -> None:
    """Update with a pose: in full inside the gate g, with less weight up to the soft gate, not at all beyond.

    In between R grows until the innovation is as large as g allows. Silence widens P, never the gate; what is
    refused moves the pose where it agrees with others that were (``alignment``).
    """
    source = measurement.source
    z, R = observed(measurement, state.coasting, c)
    m, limit = z.size, c.gate_limits[z.size]
    x, P = state.mean.copy(), state.covariance.copy()
    shift = stamp_shift(state, source, c)
    to_sensor(x, P, c.levers[source], 1.0)
    to_delayed(x, P, shift, 1.0)
    innovation, predicted = z - x[:m], P[:m, :m].copy()
    if m > YAW:
        innovation[YAW] = wrap(innovation[YAW])
    stated, finds_heading = R, state.aligning and m <= YAW
    R = state.adaptation.fix_factors[source] * stated
    update.dof, update.gate = m, c.adaptation.soft_gate * limit
    nis = weighted_square(root(predicted + R), innovation)
    if has_velocity_errors(c) and not finds_heading and nis <= update.gate:
        learn_from_fix(state.adaptation, source, innovation, predicted, stated, c)
        R = state.adaptation.fix_factors[source] * stated
    root_of_S = root(predicted + R)
    nis = weighted_square(root_of_S, innovation)
    update.nis, update.log_determinant = nis, log_determinant_of(root_of_S)
    refused = finds_heading or nis > update.gate
    if refused or nis > limit:
        keep_refused(state, (x[X], x[Y]), (z[X], z[Y]), (R[X, X] + R[Y, Y]) / 2.0)
        if realign(state, c):
            state.consistent_ns[source] = measurement.stamp_ns
            update.follows = False
            return
    else:
        state.refused_count = 0
        state.consistent_ns[source] = measurement.stamp_ns
    if refused:
        update.outcome = _GATED
        return
    if nis > limit:
        R = R + (nis / limit - 1.0) * (predicted + R)
    correct(POSE, x, P, (z, R), (0.0, 0.0), c)
    to_delayed(x, P, shift, -1.0)
    x[YAW] = wrap(x[YAW])
    to_sensor(x, P, c.levers[source], -1.0)
    state.mean[:], state.covariance[:] = x, P
    state.aligning = state.aligning and P[YAW, YAW] > UNKNOWN_HEADING**2


@compiled
def correct(
    kind: int,
    x: FloatArray,
    P: FloatArray,
    measured: tuple[FloatArray, FloatArray],
    speeds: tuple[float, float],
    c: Any,
) -> tuple[float, float]:
    """x and P given z and R (``measured``), which sprocket ``speeds`` predict; returns NIS and ln |S|.

    A yaw rate leaves s_g as it was (Schmidt): it cannot show it, for κ and ε explain the same, and what would
    seem to be learned is their errors. Fixes show s_g through what it is correlated with.
    """
    z, R = measured
    scale, scale_variance = x[GYRO_SCALE], P[GYRO_SCALE, GYRO_SCALE]
    if c.sigma_points:
        points, weights = daf.sigma_points(x, P, c.kappa, c.active)
        Z = np.empty((weights.size, z.size))
        for i in range(weights.size):
            Z[i] = expected(kind, points[i], z.size, speeds, c)
        nis, log_determinant = daf.correct(x, P, (points, weights), measured, Z, YAW)
        if kind == YAW_RATE:
            x[GYRO_SCALE], P[GYRO_SCALE, GYRO_SCALE] = scale, scale_variance
        return nis, log_determinant
    innovation = z - expected(kind, x, z.size, speeds, c)
    if kind == POSE and z.size > YAW:
        innovation[YAW] = wrap(innovation[YAW])
    nis, log_determinant = ekf.correct(x, P, innovation, jacobian(kind, x, z.size, speeds, c), R)
    x[YAW] = wrap(x[YAW])
    if kind == YAW_RATE:
        x[GYRO_SCALE], P[GYRO_SCALE, GYRO_SCALE] = scale, scale_variance
    return nis, log_determinant
