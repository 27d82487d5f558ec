# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Gate and update, for each kind of measurement; compiled.

    state         record of ``STATE``, as predicted for the measurement's stamp; in place
    measurement   record of ``MEASUREMENT``
    c             record of ``config.CONFIG``
    update        record of ``UPDATE``: what became of the measurement
    g             limit of the gate, a χ² quantile

What is refused leaves mean and covariance as they were.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from trackslip_common.compiled import compiled, inlined
from trackslip_estimation.kalman import daf, ekf
from trackslip_estimation.kalman.linear_algebra import wrap
from trackslip_estimation.slip.adaptation import learn_from_rate
from trackslip_estimation.slip.gate import forget_ground, on_no_ground, other_ground, widen, width
from trackslip_estimation.slip.levers import widen_swing_rate
from trackslip_estimation.slip.measurements import Outcome
from trackslip_estimation.slip.models.dispatch import has_velocity_errors
from trackslip_estimation.slip.models.model import GYRO_BIAS, GYRO_SCALE, SWING_RATE, YAW
from trackslip_estimation.slip.models.speed import YAW_RATE_ERROR
from trackslip_estimation.slip.models.swing import may_swing
from trackslip_estimation.slip.motion import Motion
from trackslip_estimation.slip.observation import (
    add_rounding,
    comparable_speeds,
    expected,
    jacobian,
    observed,
)
from trackslip_estimation.slip.records import HEADING, POSE, YAW_RATE

FloatArray = NDArray[np.float64]

_GATED, _STANDING = int(Outcome.GATED), int(Motion.STANDING)


@inlined
def use_slips(state: Any, measurement: Any, c: Any, update: Any) -> None:
    """Slips: used inside their gate, which widens while they and the state disagree."""
    kind = measurement.kind
    z, R = observed(measurement, state, c)
    left, right, _ = comparable_speeds(kind, state, c)
    limit, update.dof = c.gate_limits[z.size], z.size
    update.gate = limit * width_of(state, measurement, c)
    x, P, prior_P = state.mean[: c.size].copy(), state.covariance.copy(), update.prior_covariance[:]
    add_rounding(kind, x, R, state, c)
    update.nis, update.log_determinant = correct(kind, x, P, (z, R), (left, right), c)
    if update.nis > update.gate:
        update.outcome = _GATED
        return
    if update.nis > limit:
        widen(kind, z, state.mean[:], prior_P, (left, right), c)
        x[:], P[:] = state.mean[: c.size], prior_P
        correct(kind, x, P, (z, R), (left, right), c)
    else:
        state.consistent_ns[measurement.source] = measurement.stamp_ns
    state.mean[: c.size], state.covariance[:] = x, P


@inlined
def use_rate(state: Any, measurement: Any, c: Any, update: Any) -> None:
    """A yaw rate: in full inside g; with less weight where only the largest noise that may be explains it.

    The state is in the coordinates of its gyro (``levers.to_gyro``).
    Beyond that it is refused, until several agree on other ground, or the gate has widened (``gate``).
    """
    kind, source = measurement.kind, measurement.source
    z, R = observed(measurement, state, c)
    stated = R[0, 0]
    R *= state.adaptation.rate_factor
    left, right, _ = comparable_speeds(kind, state, c)
    limit, update.dof = c.gate_limits[1], 1
    update.gate = limit * width_of(state, measurement, c)
    x, P, prior_P = state.mean[: c.size].copy(), state.covariance.copy(), update.prior_covariance[:]
    add_rounding(kind, x, R, state, c)
    nis, log_determinant = correct(kind, x, P, (z, R), (left, right), c)
    rate, variance = _rate_shown(state, source, (z[0], R[0, 0]), c)
    possible = np.isinf(limit) or not on_no_ground(rate, variance, (left, right), c)
    surprise, again = nis, False
    if possible and has_velocity_errors(c) and not state.coasting:
        surprise = _least_surprise(state, (z[0], stated, np.exp(log_determinant)), (left, right), c)
    streak = state.streaks[source]
    if (nis > limit or streak.count > 0) and other_ground(rate, state.mean[:], streak, (left, right), c):
        streak.count = 0
        forget_ground(prior_P, c)
        x[:], P[:] = state.mean[: c.size], prior_P
        nis, log_determinant = correct(kind, x, P, (z, R), (left, right), c)
        surprise = nis
    elif nis <= limit:
        streak.count = 0
    elif surprise <= limit:
        R += (nis / limit - 1.0) * np.exp(log_determinant)
        again = True
    update.nis, update.log_determinant = nis, log_determinant
    if surprise > update.gate or not possible:
        update.outcome, prior_P[:] = _GATED, state.covariance
        return
    if surprise > limit:
        if may_swing(state, source, c):  # it starts or stops faster than it should: no bias
            widen_swing_rate(prior_P, c.swing.fastest**2)
        else:
            widen(kind, z, state.mean[:], prior_P, (left, right), c)
        again = True
    if again:
        x[:], P[:] = state.mean[: c.size], prior_P
        correct(kind, x, P, (z, R), (left, right), c)
    state.consistent_ns[source] = measurement.stamp_ns
    state.mean[: c.size], state.covariance[:] = x, P


@inlined
def _least_surprise(
    state: Any, shown: tuple[float, float, float], speeds: tuple[float, float], c: Any
) -> float:
    """NIS of a yaw rate with the largest noise that may be; how large that is, is learned from it.

    ``shown``: the rate, rad/s, its variance as stated, and that of its innovation.
    """
    rate, stated, S = shown
    innovation = rate - expected(YAW_RATE, state.mean[:], 1, speeds, c)[0]
    parts = state.adaptation.exposure * (1.0 + state.mean[GYRO_SCALE]) ** 2, stated
    return learn_from_rate(state.adaptation, innovation, S, parts, state.motion.motion == _STANDING, c)


@compiled
def width_of(state: Any, measurement: Any, c: Any) -> float:
    """How far the gate of a source that insists has widened."""
    source = measurement.source
    return width(state.refused_ns[source], c.timeouts_ns[source], c.gate_relaxation)


@compiled
def hear(state: Any, measurement: Any, c: Any) -> None:
    """A source outside its gate insists for longer by the time since its last measurement, not by silence."""
    source = measurement.source
    if state.consistent_ns[source] >= state.heard_ns[source]:
        state.refused_ns[source] = 0
    else:
        silent_ns = measurement.stamp_ns - state.heard_ns[source]
        state.refused_ns[source] += min(max(silent_ns, 0), c.timeouts_ns[source])
    state.heard_ns[source] = measurement.stamp_ns


@compiled
def _rate_shown(state: Any, source: int, measured: tuple[float, float], c: Any) -> tuple[float, float]:
    """The machine's yaw rate by a gyro alone, rad/s, and its variance with what the tracks may err by.

    ``measured``: what it shows, and the variance of that.
    """
    P, (shown, variance) = state.covariance, measured
    if c.above[source] == 1:
        shown -= state.mean[SWING_RATE]
    variance += P[GYRO_BIAS, GYRO_BIAS]
    if has_velocity_errors(c):
        variance += P[YAW_RATE_ERROR, YAW_RATE_ERROR]
    return (shown - state.mean[GYRO_BIAS]) / (1.0 + state.mean[GYRO_SCALE]), variance


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

    A yaw rate of a machine that moves leaves b_g and s_g as they were, and corrects the rest as if they
    were known (``ekf.correct_knowing``): tracks that turn more to one side than to the other, and at one
    speed more than at another, explain the same. Fixes show both through what they are correlated with;
    standing shows b_g.
    """
    z, R = measured
    if kind == YAW_RATE and has_velocity_errors(c):
        moves = speeds[0] != 0.0 or speeds[1] != 0.0
        given = jacobian(kind, x, 1, speeds, c), R
        known = (GYRO_BIAS if moves else GYRO_SCALE), GYRO_SCALE
        nis, log_determinant = ekf.correct_knowing(x, P, z - expected(kind, x, 1, speeds, c), given, known)
        x[YAW] = wrap(x[YAW])
        return nis, log_determinant
    if c.sigma_points:
        own = P[: x.size, : x.size].copy()
        points, weights = daf.sigma_points(x, own, c.kappa, c.active)
        Z = np.empty((weights.size, z.size))
        for i in range(weights.size):
            Z[i] = expected(kind, points[i], z.size, speeds, c)
            if kind == HEADING:
                Z[i, 0] = x[YAW] + wrap(Z[i, 0] - x[YAW])
        nis, log_determinant = daf.correct(x, own, (points, weights), measured, Z, YAW)
        P[: x.size, : x.size] = own
        return nis, log_determinant
    innovation = z - expected(kind, x, z.size, speeds, c)
    if kind == POSE and z.size > YAW:
        innovation[YAW] = wrap(innovation[YAW])
    nis, log_determinant = ekf.correct(x, P, innovation, jacobian(kind, x, z.size, speeds, c), R)
    x[YAW] = wrap(x[YAW])
    return nis, log_determinant
