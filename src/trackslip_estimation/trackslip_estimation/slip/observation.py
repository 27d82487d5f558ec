# SPDX-License-Identifier: Apache-2.0
"""What each kind of measurement says of the state, compiled.

    z, R   measurement and its covariance, as used       (m,), (m, m)
    h, H   predicted measurement, its Jacobian           (m,), (m, n)
    l      place of a sensor beside C, seen from above   (2,), m
    c      record of ``config.CONFIG``

Yaw rate: z = s_g φ̇ + b_g. Pose: z = (x, y) of the sensor and, where its heading is used, φ. Slips: z = (i_L,
i_R). Heading: z = φ. Yaw rate and slips are predicted from sprocket speeds, whose rounding adds to R. A pose
or heading is that of δ σ_t before its stamp, σ_t being the stamp error of its source.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from trackslip_common.compiled import compiled
from trackslip_estimation.kalman.linear_algebra import sandwich
from trackslip_estimation.slip.models.dispatch import (
    body_jacobian,
    body_twist,
    horizontal_twist,
    slips,
    slips_jacobian,
    twist,
    twist_jacobian,
)
from trackslip_estimation.slip.models.model import FIX_DELAY, GYRO_BIAS, GYRO_SCALE, YAW, X, Y
from trackslip_estimation.slip.motion import rounding, steady_speeds
from trackslip_estimation.slip.records import HEADING, POSE, SLIPS, YAW_RATE

FloatArray = NDArray[np.float64]


@compiled
def observed(measurement: Any, state: Any, c: Any) -> tuple[FloatArray, FloatArray]:
    """z and R as the source's parameters want them: in true units, no better than its floors."""
    source, kind = measurement.source, measurement.kind
    if kind == YAW_RATE:
        scale = c.rate_scale[source]
        variance = measurement.noise[0, 0] / (scale * scale)
        if state.coasting:  # a gyro then shows nothing of its bias
            variance += c.unseen_yaw_rate**2
        return np.array((measurement.value[0] / scale,)), np.array(((variance,),))
    if kind == HEADING:
        variance = max(measurement.noise[0, 0], c.heading_floor[source] ** 2)
        return np.array((measurement.value[0] - compass_offset(state, source, c),)), np.array(((variance,),))
    if kind == SLIPS:
        return measurement.value[:2].copy(), measurement.noise[:2, :2].copy()
    rows = 3 if shows_heading(measurement, c) else 2
    z, R = measurement.value[:rows].copy(), measurement.noise[:rows, :rows].copy()
    for i in range(rows):
        floor = c.heading_floor[source] if i == YAW else c.position_floor[source]
        R[i, i] = max(R[i, i], floor * floor)
    for i in range(2):
        R[i, i] += c.levers[source, 2] ** 2 * state.attitude.level.lean_variance
    return z, R


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
    twist_ = twist(x, left, right, c)
    if kind == YAW_RATE:
        return np.array(((1.0 + x[GYRO_SCALE]) * twist_[2] + x[GYRO_BIAS],))
    return slips(x, twist_, left, right, c)[:2].copy()


@compiled
def jacobian(kind: int, x: FloatArray, rows: int, speeds: tuple[float, float], c: Any) -> FloatArray:
    """H."""
    if kind == POSE:
        return np.eye(rows, x.size)
    if kind == HEADING:
        return np.eye(1, x.size, YAW)
    left, right = speeds
    J = twist_jacobian(x, left, right, c)
    if kind == YAW_RATE:
        H: FloatArray = (1.0 + x[GYRO_SCALE]) * J[2:]
        H[0, GYRO_BIAS], H[0, GYRO_SCALE] = 1.0, twist(x, left, right, c)[2]
        return H
    return slips_jacobian(twist(x, left, right, c), J, left, right, c)[:2].copy()


@compiled
def add_rounding(kind: int, x: FloatArray, R: FloatArray, state: Any, c: Any) -> None:
    """R of a yaw rate or of slips, with what the rounding of the counts adds to their prediction."""
    if kind in (POSE, HEADING) or not state.speeds.differenced:
        return
    left, right, interval = comparable_speeds(kind, state, c)
    if interval <= 0.0 or c.encoder_resolution == 0.0:
        return
    e, m = rounding(interval, c.encoder_resolution), R.shape[0]
    by_left = expected(kind, x, m, (left + e, right), c) - expected(kind, x, m, (left - e, right), c)
    by_right = expected(kind, x, m, (left, right + e), c) - expected(kind, x, m, (left, right - e), c)
    R += (np.outer(by_left, by_left) + np.outer(by_right, by_right)) / 4.0


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
    x, P = state.mean, state.covariance
    left, right, interval = steady_speeds(state.speeds, state.motion, c.motion_limits, c.encoder_resolution)
    found = _outputs(state, left, right, c)
    twist_ = (found[0], found[1], found[2])
    J = body_jacobian(x, left, right, state, c)
    twist_covariance = sandwich(J, P)
    slip_covariance = sandwich(slips_jacobian(twist_, J, left, right, c), P)
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


@compiled
def sensor_place(state: Any, source: int, c: Any) -> FloatArray:
    """(2,) l: how far a sensor is ahead of C and to its left, seen from above, as the machine leans."""
    x, y, z = c.levers[source]
    level = state.attitude.level
    ahead = x * (1.0 + level.forward) + y * level.across + z * level.lean_x
    return np.array((ahead, y * (1.0 + level.sideways) + z * level.lean_y))


@compiled
def compass_offset(state: Any, source: int, c: Any) -> float:
    """Direction that a compass shows, from that of the machine, seen from above, rad."""
    offset, level = c.heading_offset[source], state.attitude.level
    if level.tilted == 0:
        return float(offset)
    cos, sin = np.cos(offset), np.sin(offset)
    return float(np.arctan2(sin * (1.0 + level.sideways), cos * (1.0 + level.forward) + sin * level.across))


@compiled
def to_sensor(x: FloatArray, P: FloatArray, lever: FloatArray, sign: float) -> None:
    """The state with a sensor's place for that of base_link (``sign`` 1), or back again (−1); in place."""
    if lever[0] == 0.0 and lever[1] == 0.0:
        return
    cos, sin = np.cos(x[YAW]), np.sin(x[YAW])
    east = sign * (cos * lever[0] - sin * lever[1])
    north = sign * (sin * lever[0] + cos * lever[1])
    x[X] += east
    x[Y] += north
    for j in range(x.size):
        P[X, j] -= north * P[YAW, j]
        P[Y, j] += east * P[YAW, j]
    for i in range(x.size):
        P[i, X] -= north * P[i, YAW]
        P[i, Y] += east * P[i, YAW]


@compiled
def to_delayed(x: FloatArray, P: FloatArray, shift: tuple[float, float, float], sign: float) -> None:
    """The state with the pose of δ σ_t ago for that of now (``sign`` 1), or back again (−1); in place.

    ``shift`` is how the pose changes in σ_t: m, m, rad.
    """
    for i in range(YAW + 1):
        x[i] -= sign * shift[i] * x[FIX_DELAY]
        for j in range(x.size):
            P[i, j] -= sign * shift[i] * P[FIX_DELAY, j]
    for i in range(x.size):
        for j in range(YAW + 1):
            P[i, j] -= sign * shift[j] * P[i, FIX_DELAY]


@compiled
def stamp_shift(state: Any, source: int, c: Any) -> tuple[float, float, float]:
    """How the pose of a source's sensor changes in its σ_t; nothing while nobody knows how fast it does."""
    seconds = 0.0 if state.coasting else c.stamp_errors[source]
    v_x, v_y, rate = horizontal_twist(state.mean, state.speeds.left, state.speeds.right, state, c)
    place = sensor_place(state, source, c)
    v_x -= rate * place[1]
    v_y += rate * place[0]
    cos, sin = np.cos(state.mean[YAW]), np.sin(state.mean[YAW])
    return (cos * v_x - sin * v_y) * seconds, (sin * v_x + cos * v_y) * seconds, rate * seconds
