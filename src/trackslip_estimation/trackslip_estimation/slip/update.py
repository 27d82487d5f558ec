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
from trackslip_estimation.kalman.linear_algebra import log_determinant as log_determinant_of
from trackslip_estimation.kalman.linear_algebra import root, weighted_square, wrap
from trackslip_estimation.slip.adaptation import learn_from_fix, learn_from_rate, repeats, shared_error
from trackslip_estimation.slip.alignment import (
    UNKNOWN_HEADING,
    forget_refused,
    insists,
    keep_refused,
    realign,
)
from trackslip_estimation.slip.gate import forget_ground, on_no_ground, other_ground, widen, width
from trackslip_estimation.slip.levers import stamp_shift, to_delayed, to_sensor, widen_swing_rate
from trackslip_estimation.slip.measurements import Outcome
from trackslip_estimation.slip.models.dispatch import has_velocity_errors
from trackslip_estimation.slip.models.model import GYRO_BIAS, GYRO_SCALE, SWING_RATE, YAW, X, Y
from trackslip_estimation.slip.models.speed import YAW_RATE_ERROR
from trackslip_estimation.slip.models.swing import may_swing, open_swing
from trackslip_estimation.slip.motion import Motion
from trackslip_estimation.slip.observation import (
    add_rounding,
    comparable_speeds,
    expected,
    jacobian,
    lean,
    observed,
)
from trackslip_estimation.slip.records import HEADING, POSE, YAW_RATE
from trackslip_estimation.slip.stands import count_fix, stands_still
from trackslip_estimation.slip.traction import along_heading, changed_slip, goes_on, widen_slip

FloatArray = NDArray[np.float64]

_MOST_LEAN = 0.9  # of the variance of a fix, as far as it states more than its own noise
_GATED, _STANDING = int(Outcome.GATED), int(Motion.STANDING)


@inlined
def use_slips(state: Any, measurement: Any, c: Any, update: Any) -> None:
    """Slips: used inside their gate, which widens while they and the state disagree."""
    kind = measurement.kind
    z, R = observed(measurement, state, c)
    left, right, _ = comparable_speeds(kind, state, c)
    limit, update.dof = c.gate_limits[z.size], z.size
    update.gate = limit * width_of(state, measurement, c)
    x, P, prior_P = state.mean[: c.size].copy(), state.covariance.copy(), update.prior_covariance
    add_rounding(kind, x, R, state, c)
    update.nis, update.log_determinant = correct(kind, x, P, (z, R), (left, right), c)
    if update.nis > update.gate:
        update.outcome = _GATED
        return
    if update.nis > limit:
        widen(kind, z, state.mean, prior_P, (left, right), c)
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
    x, P, prior_P = state.mean[: c.size].copy(), state.covariance.copy(), update.prior_covariance
    add_rounding(kind, x, R, state, c)
    nis, log_determinant = correct(kind, x, P, (z, R), (left, right), c)
    rate, variance = _rate_shown(state, source, (z[0], R[0, 0]), c)
    possible = np.isinf(limit) or not on_no_ground(rate, variance, (left, right), c)
    surprise, again = nis, False
    if possible and has_velocity_errors(c) and not state.coasting:
        surprise = _least_surprise(state, (z[0], stated, np.exp(log_determinant)), (left, right), c)
    streak = state.streaks[source]
    if (nis > limit or streak.count > 0) and other_ground(rate, state.mean, streak, (left, right), c):
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
            widen(kind, z, state.mean, prior_P, (left, right), c)
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
    innovation = rate - expected(YAW_RATE, state.mean, 1, speeds, c)[0]
    parts = state.adaptation.exposure * (1.0 + state.mean[GYRO_SCALE]) ** 2, stated
    return learn_from_rate(state.adaptation, innovation, S, parts, state.motion.motion == _STANDING, c)


@compiled
def width_of(state: Any, measurement: Any, c: Any) -> float:
    """How far the gate of a yaw rate, of slips or of a heading has widened."""
    silent_ns = measurement.stamp_ns - state.consistent_ns[measurement.source]
    return width(silent_ns, c.timeouts_ns[measurement.source], c.gate_relaxation)


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


@inlined
def use_pose(state: Any, measurement: Any, c: Any, update: Any) -> None:
    """Update with a pose: in full inside the gate g, with less weight up to the soft gate, not at all beyond.

    In between R grows until the innovation is as large as g allows. Silence widens P, never the gate; what is
    refused moves the pose where it agrees with others that were (``alignment``).
    """
    source = measurement.source
    z, stated = observed(measurement, state, c)
    m, limit = z.size, c.gate_limits[z.size]
    x, P = state.mean[: c.size].copy(), state.covariance.copy()
    shift = stamp_shift(state, source, c)
    to_sensor(x, P, state.attitude.level, source, 1.0, c)
    to_delayed(x, P, shift, 1.0)
    innovation, predicted = z - x[:m], P[:m, :m].copy()
    if m > YAW:
        innovation[YAW] = wrap(innovation[YAW])
    update.dof, update.gate = m, c.adaptation.soft_gate * limit
    finds_heading = state.aligning and (m <= YAW or c.above[source] == 1)
    known = repeats(measurement.stamp_ns - state.consistent_ns[source], c.correlation_times[source])
    R, alone = _noise(state, source, (innovation, predicted, stated), finds_heading, c)
    root_of_S = root(predicted + R)
    nis = weighted_square(root_of_S, innovation)
    refused = finds_heading or nis > update.gate
    shown = along_heading(state, innovation), predicted, known * R
    changed = (0.0, 0.0) if refused else changed_slip(state, source, shown, c)
    if changed[0] != 0.0:
        widen_slip(state, P, changed)
        widen_slip(state, update.prior_covariance, changed)
        predicted = P[:m, :m].copy()
        root_of_S = root(predicted + R)
        nis = weighted_square(root_of_S, innovation)
    update.nis, update.log_determinant = nis, log_determinant_of(root_of_S)
    inside = not refused and nis <= limit
    if inside:
        state.consistent_ns[source] = measurement.stamp_ns
    elif may_swing(state, source, c):
        forget_refused(state, False)  # how it swings is no way that was driven
        if refused and not finds_heading and width_of(state, measurement, c) > 1.0:
            open_swing(state.covariance, c)
    else:
        keep_refused(state, (x[X], x[Y]), (z[X], z[Y]), (R[X, X] + R[Y, Y]) / 2.0)
        heading_fits = m <= YAW or innovation[YAW] ** 2 <= limit * (predicted + R)[YAW, YAW]
        at_rest = heading_fits and insists(state, source, measurement.stamp_ns, c)
        if realign(state, at_rest, heading_fits and m > YAW, c):
            state.consistent_ns[source] = measurement.stamp_ns
            update.follows = False
            return
    if refused:
        update.outcome = _GATED
        return
    if nis > limit:
        R = R + (nis / limit - 1.0) * (predicted + R)
    share_lean(state, P, R, source, c)
    R = min(known, shared_error(predicted, R)) * R
    count_fix(state, source, alone, R, c)
    correct(measurement.kind, x, P, (z, R), (0.0, 0.0), c)
    state.runs[source].pulled += along_heading(state, innovation) - along_heading(state, z - x[:m])
    to_delayed(x, P, shift, -1.0)
    x[YAW] = wrap(x[YAW])
    to_sensor(x, P, state.attitude.level, source, -1.0, c)
    state.mean[: c.size], state.covariance[:] = x, P
    state.aligning = state.aligning and P[YAW, YAW] > UNKNOWN_HEADING**2
    if inside:
        forget_refused(state, True)


@inlined
def share_lean(state: Any, P: FloatArray, R: FloatArray, source: int, c: Any) -> None:
    """All fixes of an antenna have the same lean: no number of them tells it, and none need outweigh it.

    It is not in R, then, but beside P; what fixes of another lean had is in P from now on.
    """
    leans = lean(state, source, c)
    was = max(state.lean - leans, 0.0)
    for i in range(2):
        R[i, i] -= min(leans, _MOST_LEAN * R[i, i])
        P[i, i] += was
    state.lean = leans


@inlined
def _noise(
    state: Any,
    source: int,
    shown: tuple[FloatArray, FloatArray, FloatArray],
    finds_heading: bool,
    c: Any,
) -> tuple[FloatArray, bool]:
    """R of a fix, whose factor is learned from it; whether it counts alone, or as one more of its stand.

    ``shown``: its innovation, the covariance of that without R, and R as stated.
    """
    innovation, predicted, stated = shown
    factors, limit = state.adaptation.fix_factors, c.gate_limits[innovation.size]
    nis = weighted_square(root(predicted + factors[source] * stated), innovation)
    alone = not stands_still(state, source, c) or nis > limit
    inside = nis <= c.adaptation.soft_gate * limit
    same_side = goes_on(state.runs[source], along_heading(state, innovation))
    if has_velocity_errors(c) and not finds_heading and inside and alone and not same_side:
        learn_from_fix(state.adaptation, source, innovation, predicted, stated, c)
        if c.correlation_times[source] > 0.0:  # what follows it so smoothly does not show that it is small
            factors[source] = max(factors[source], 1.0)
    return factors[source] * stated, alone


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
