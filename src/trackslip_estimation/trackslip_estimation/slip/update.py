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
from trackslip_estimation.slip.gate import forget_ground, on_no_ground, other_ground, widen_slips, width
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
    expected_rate,
    jacobian,
    observed,
    observed_rate,
    rate_jacobian,
    rate_rounding,
)
from trackslip_estimation.slip.records import HEADING, YAW_RATE

FloatArray = NDArray[np.float64]

_GATED, _STANDING = int(Outcome.GATED), int(Motion.STANDING)


@inlined
def use_slips(state: Any, measurement: Any, c: Any, update: Any) -> None:
    """Slips: used inside their gate, which widens while they and the state disagree."""
    kind, x, P = measurement.kind, state.mean[: c.size], state.covariance[:]
    prior_x, prior_P = update.prior_mean[: c.size], update.prior_covariance[:]
    z, R = observed(measurement, state, c)
    left, right, _ = comparable_speeds(kind, state, c)
    limit, update.dof = c.gate_limits[z.size], z.size
    update.gate = limit * width_of(state, measurement, c)
    add_rounding(kind, x, R, state, c)
    update.nis, update.log_determinant = correct(kind, x, P, (z, R), (left, right), c)
    if update.nis <= limit:
        state.consistent_ns[measurement.source] = measurement.stamp_ns
        return
    if update.nis > update.gate:
        update.outcome = _GATED
    else:
        widen_slips(prior_P, z - expected(kind, prior_x, z.size, (left, right), c), c)
    x[:], P[:] = prior_x, prior_P
    if update.outcome != _GATED:
        correct(kind, x, P, (z, R), (left, right), c)


@inlined
def use_rate(state: Any, measurement: Any, c: Any, update: Any) -> None:
    """A yaw rate: in full inside g; with less weight where only the largest noise that may be explains it.

    The state is in the coordinates of its gyro (``levers.to_gyro``).
    Beyond that it is refused, until several agree on other ground, or the gate has widened (``gate``).
    """
    source, x, P = measurement.source, state.mean[: c.size], state.covariance[:]
    left, right, _ = comparable_speeds(YAW_RATE, state, c)
    rate, stated = observed_rate(measurement, state, c)
    variance = state.adaptation.rate_factor * stated + rate_rounding(x, state, c)
    limit, update.dof = c.gate_limits[1], 1
    update.gate = limit * width_of(state, measurement, c)
    shown, of_shown = _rate_shown(state, source, (rate, variance), c)
    possible = np.isinf(limit) or not on_no_ground(shown, of_shown, (left, right), c)
    H, innovation = rate_jacobian(x, left, right, c), rate - expected_rate(x, left, right, c)
    S = variance + ekf.variance_of(P, H)
    surprise = nis = innovation * innovation / S
    if possible and has_velocity_errors(c) and not state.coasting:
        surprise = _least_surprise(state, (innovation, stated, S), c)
    streak = state.streaks[source]
    forgets = nis > limit or streak.count > 0
    forgets = forgets and other_ground(shown, x, streak, (left, right), c)
    if forgets:
        streak.count = 0
        forget_ground(P, c)
        S = variance + ekf.variance_of(P, H)
        surprise = nis = innovation * innovation / S
    elif nis <= limit:
        streak.count = 0
    elif surprise <= limit:
        variance += (nis / limit - 1.0) * S
    update.nis, update.log_determinant = nis, np.log(S)
    if surprise > update.gate or not possible:
        update.outcome, P[:] = _GATED, update.prior_covariance
        return
    if surprise > limit:
        _doubt_rate(state, source, innovation, c)
    if forgets or surprise > limit:
        update.prior_covariance[:] = P
    ekf.correct_knowing(x, P, innovation, (H, variance), not_taught(left, right, c))
    x[YAW] = wrap(x[YAW])
    state.consistent_ns[source] = measurement.stamp_ns


@inlined
def _doubt_rate(state: Any, source: int, innovation: float, c: Any) -> None:
    """P, widened where a yaw rate passes only because the gate is wide."""
    if may_swing(state, source, c):  # it starts or stops faster than it should: no bias
        widen_swing_rate(state.covariance[:], c.swing.fastest**2)
    else:
        state.covariance[GYRO_BIAS, GYRO_BIAS] += innovation * innovation


@compiled
def not_taught(left: float, right: float, c: Any) -> tuple[int, int]:
    """States that a yaw rate leaves as they were, and corrects the rest as if they were known; −1: none.

    Of a machine that moves b_g and s_g: tracks that turn more to one side than to the other, and at one speed
    more than at another, explain the same. Fixes show both through what they are correlated with; standing
    shows b_g.
    """
    if not has_velocity_errors(c):
        return -1, -1
    moves = left != 0.0 or right != 0.0
    return (GYRO_BIAS if moves else GYRO_SCALE), GYRO_SCALE


@inlined
def _least_surprise(state: Any, shown: tuple[float, float, float], c: Any) -> float:
    """NIS of a yaw rate with the largest noise that may be; how large that is, is learned from it.

    ``shown``: its innovation, rad/s, its variance as stated, and that of its innovation.
    """
    innovation, stated, S = shown
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
    """x and P given z and R (``measured``), which sprocket ``speeds`` predict; returns NIS and ln |S|."""
    z = measured[0]
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
    if z.size > YAW:
        innovation[YAW] = wrap(innovation[YAW])
    nis, log_determinant = ekf.correct(x, P, innovation, jacobian(kind, x, z.size, speeds, c), measured[1])
    x[YAW] = wrap(x[YAW])
    return nis, log_determinant
