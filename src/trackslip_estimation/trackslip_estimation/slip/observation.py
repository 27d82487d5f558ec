# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""What each kind of measurement says of the state, compiled.

    z, R   measurement and its covariance, as used       (m,), (m, m)
    h, H   predicted measurement, its Jacobian           (m,), (m, n)
    c      record of ``config.CONFIG``

Yaw rate: z = s_g φ̇ + b_g. Pose: z = (x, y) of the sensor and, where its heading is used, φ. Slips: z = (i_L,
i_R). Heading: z = φ. Swing: z = σ. For a sensor off base_link, or above, the state is put in its coordinates
before (``levers``). Yaw rate and slips are predicted from sprocket speeds, whose rounding adds to R. A pose
or heading is that of δ σ_t before its stamp, σ_t being the stamp error of its source.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from trackslip_common.compiled import compiled
from trackslip_estimation.kalman.linear_algebra import sandwich
from trackslip_estimation.slip.levers import compass_offset, other_lean, unknown_arm
from trackslip_estimation.slip.models.dispatch import (
    body_jacobian,
    body_twist,
    horizontal_twist,
    slips,
    slips_jacobian,
    twist,
    twist_jacobian,
)
from trackslip_estimation.slip.models.model import GYRO_BIAS, GYRO_SCALE, SWING, YAW, X
from trackslip_estimation.slip.motion import rounding, steady_speeds
from trackslip_estimation.slip.records import HEADING, ON_SWING, POSE, SLIPS, YAW_RATE
from trackslip_estimation.slip.usable import LEAST_VARIANCE

FloatArray = NDArray[np.float64]


@compiled
def observed(measurement: Any, state: Any, c: Any) -> tuple[FloatArray, FloatArray]:
    """z and R as the source's parameters want them: in true units, no better than its floors."""
    source, kind = measurement.source, measurement.kind
    if kind == YAW_RATE:
        rate, variance = observed_rate(measurement, state, c)
        return np.array((rate,)), np.array(((variance,),))
    if kind == HEADING:
        variance = max(measurement.noise[0, 0], c.heading_floor[source] ** 2, LEAST_VARIANCE)
        return np.array((measurement.value[0] - compass_offset(state, source, c),)), np.array(((variance,),))
    if kind == ON_SWING:
        variance = max(measurement.noise[0, 0], LEAST_VARIANCE)
        return measurement.value[:1] - c.heading_offset[source], np.array(((variance,),))
    if kind == SLIPS:
        z, R = measurement.value[:2].copy(), measurement.noise[:2, :2].copy()
        for i in range(2):
            R[i, i] = max(R[i, i], LEAST_VARIANCE)
        return z, R
    rows = 3 if shows_heading(measurement, c) else 2
    z, R = measurement.value[:rows].copy(), measurement.noise[:rows, :rows].copy()
    raise_to_floors(R, rows, source, c)
    for i in range(2):
        R[i, i] += other_lean(state.attitude.level, source, c)
        if c.above[source] == 1:
            R[i, i] += unknown_arm(state.covariance, source, c)
    return z, R


@compiled
def observed_rate(measurement: Any, state: Any, c: Any) -> tuple[float, float]:
    """z and R of a yaw rate."""
    scale = c.rate_scale[measurement.source]
    variance = max(measurement.noise[0, 0] / (scale * scale), LEAST_VARIANCE)
    if state.coasting:  # a gyro then shows nothing of its bias
        variance += c.unseen_yaw_rate**2
    return measurement.value[0] / scale, variance


@compiled
def raise_to_floors(R: FloatArray, rows: int, source: int, c: Any) -> None:
    """The variances of a fix, of which ``rows`` are used, no less than the floors of its source."""
    for i in range(rows):
        floor = c.heading_floor[source] if i == YAW else c.position_floor[source]
        R[i, i] = max(R[i, i], floor * floor, LEAST_VARIANCE)


@compiled
def shows_heading(measurement: Any, c: Any) -> bool:
    """Whether the heading of a pose is used: a doubtful one may be wrong by whole quarter turns."""
    ceiling = c.heading_ceiling[measurement.source]
    return bool(c.use_heading[measurement.source] == 1 and measurement.noise[YAW, YAW] <= ceiling * ceiling)


@compiled
def comparable_speeds(kind: int, state: Any, c: Any) -> tuple[float, float, float]:
    """Left, right and interval of the speeds that predict a measurement.

    A gyro is compared with steady ones: their rounding would be in its innovation and its Jacobian both, and
    bias what it teaches of turning. So are slips.
    """
    if kind in (YAW_RATE, SLIPS):
        return steady_speeds(state.speeds, state.motion, c.motion_limits, c.encoder_resolution)
    return state.speeds.left, state.speeds.right, state.speeds.interval


@compiled
def expected(kind: int, x: FloatArray, rows: int, speeds: tuple[float, float], c: Any) -> FloatArray:
    """h."""
    left, right = speeds
    if kind == POSE:
        return x[X : X + rows].copy()
    if kind == HEADING:
        return x[YAW : YAW + 1].copy()
    if kind == ON_SWING:
        return x[SWING : SWING + 1].copy()
    if kind == YAW_RATE:
        return np.array((expected_rate(x, left, right, c),))
    return slips(x, twist(x, left, right, c), left, right, c)[:2].copy()


@compiled
def expected_rate(x: FloatArray, left: float, right: float, c: Any) -> float:
    """h of a yaw rate."""
    rate: float = (1.0 + x[GYRO_SCALE]) * twist(x, left, right, c)[2] + x[GYRO_BIAS]
    return rate


@compiled
def jacobian(kind: int, x: FloatArray, rows: int, speeds: tuple[float, float], c: Any) -> FloatArray:
    """H."""
    if kind == POSE:
        return np.eye(rows, x.size)
    if kind == HEADING:
        return np.eye(1, x.size, YAW)
    if kind == ON_SWING:
        return np.eye(1, x.size, SWING)
    left, right = speeds
    if kind == YAW_RATE:
        return rate_jacobian(x, left, right, c).reshape((1, -1))
    J = twist_jacobian(x, left, right, c)
    return slips_jacobian(x, twist(x, left, right, c), J, (left, right), c)[:2].copy()


@compiled
def rate_jacobian(x: FloatArray, left: float, right: float, c: Any) -> FloatArray:
    """(n,) H of a yaw rate."""
    H: FloatArray = twist_jacobian(x, left, right, c)[2]
    for k in range(x.size):
        H[k] *= 1.0 + x[GYRO_SCALE]
    H[GYRO_BIAS], H[GYRO_SCALE] = 1.0, twist(x, left, right, c)[2]
    return H


@compiled
def rate_rounding(x: FloatArray, state: Any, c: Any) -> float:
    """What the rounding of the counts adds to the variance of a predicted yaw rate, (rad/s)²."""
    left, right, interval = comparable_speeds(YAW_RATE, state, c)
    if not state.speeds.differenced or interval <= 0.0 or c.encoder_resolution == 0.0:
        return 0.0
    e = rounding(interval, c.encoder_resolution)
    by_left = expected_rate(x, left + e, right, c) - expected_rate(x, left - e, right, c)
    by_right = expected_rate(x, left, right + e, c) - expected_rate(x, left, right - e, c)
    return (by_left * by_left + by_right * by_right) / 4.0


@compiled
def add_rounding(kind: int, x: FloatArray, R: FloatArray, state: Any, c: Any) -> None:
    """R of a yaw rate or of slips, with what the rounding of the counts adds to their prediction."""
    if kind == YAW_RATE:
        R[0, 0] += rate_rounding(x, state, c)
    left, right, interval = comparable_speeds(kind, state, c)
    if kind != SLIPS or not state.speeds.differenced or interval <= 0.0 or c.encoder_resolution == 0.0:
        return
    e, m = rounding(interval, c.encoder_resolution), R.shape[0]
    by_left = expected(kind, x, m, (left + e, right), c) - expected(kind, x, m, (left - e, right), c)
    by_right = expected(kind, x, m, (left, right + e), c) - expected(kind, x, m, (left, right - e), c)
    for i in range(m):
        for j in range(m):
            R[i, j] += (by_left[i] * by_left[j] + by_right[i] * by_right[j]) / 4.0


@compiled
def _outputs(state: Any, left: float, right: float, c: Any) -> FloatArray:
    """(6,) v_x, v_y, yaw rate; left slip, right slip, slip angle."""
    found, x = np.empty(6), state.mean
    twist_ = body_twist(x, left, right, state, c)
    found[0], found[1], found[2] = twist_
    found[3:] = slips(x, twist_, left, right, c)
    return found


@compiled
def fill_outputs(state: Any, c: Any, estimate: Any) -> None:
    """Twist and slips of a state, with covariances, into a record of ``ESTIMATE``."""
    x, P = state.mean[: c.size], state.covariance[:]
    left, right, interval = steady_speeds(state.speeds, state.motion, c.motion_limits, c.encoder_resolution)
    found = _outputs(state, left, right, c)
    twist_ = (found[0], found[1], found[2])
    J = body_jacobian(x, left, right, state, c)
    twist_covariance = sandwich(J, P)
    slip_covariance = sandwich(slips_jacobian(x, twist_, J, (left, right), c), P)
    if state.speeds.differenced and interval > 0.0 and c.encoder_resolution > 0.0:
        e = rounding(interval, c.encoder_resolution)
        by_left = (_outputs(state, left + e, right, c) - _outputs(state, left - e, right, c)) / 2.0
        by_right = (_outputs(state, left, right + e, c) - _outputs(state, left, right - e, c)) / 2.0
        for by in (by_left, by_right):
            twist_covariance += np.outer(by[:3], by[:3])
            slip_covariance += np.outer(by[3:], by[3:])
    estimate.twist[:], estimate.slips[:] = found[:3], found[3:]
    horizontal = horizontal_twist(x, left, right, state, c)
    for i in range(3):
        estimate.horizontal[i] = horizontal[i]
    estimate.twist_covariance[:], estimate.slip_covariance[:] = twist_covariance, slip_covariance
