# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The attitude filter: gyro and accelerometers of one IMU, with the speed of the tracks; compiled.

    φ, θ, z       roll, pitch (nose down positive), height of C                  rad, rad, m
    p, q, r       body rates, less their biases b_p, b_q                         rad/s
    f             specific force at the IMU, with biases b_x, b_y                m/s²
    u             velocity of the IMU, v + ω × l, in the machine's axes          m/s
    v_x, v_y      velocity of C along the ground                                 m/s
    σ             yaw angle of an IMU on the upper structure against base_link: p, q, f are its
                  readings, less its own biases, rotated by R(σ)                 rad

    φ̇ = p + tan θ (q sin φ + r cos φ)        θ̇ = q cos φ − r sin φ        ż = −v_x sin θ + v_y sin φ cos θ
    f_x = u̇_x + (ω × u)_x − g sin θ + b_x    f_y = u̇_y + (ω × u)_y + g sin φ cos θ + b_y

An extended Kalman filter of (φ, θ, z, b_p, b_q, b_x, b_y). f is a mean, and u̇ a difference, over a span of
samples (``span``): rounding errors of one span are cancelled by the next. A constant bias of an accelerometer
has the effect of a tilt. The bias is a state, and its variance remains in that of the tilt until turns
separate both: the ground does not turn with the machine.

The noise of the accelerometers is adapted: it is a mean of ν² − H P Hᵀ over the last seconds, at least the
stated variance. Where the machine is shaken, the gyro then dominates. The integral of the innovations is a
velocity that the tracks do not show: that of a slide, hardly faster than they were. Beyond it the tilt is
wrong, as after a wrong rate, and at least as uncertain.

Accelerations are used only while their mean is gravity from below: else the IMU has no accelerometers that
measure gravity, or is not mounted as stated. The orientation of the IMU, if requested, is used in
``orientation``.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_common.compiled import compiled
from trackslip_common.units import GRAVITY
from trackslip_estimation.attitude.level import set_level
from trackslip_estimation.attitude.orientation import SWING_UNKNOWN, update_with_orientation
from trackslip_estimation.attitude.records import (
    BIAS_P,
    BIAS_Q,
    BIAS_X,
    BIAS_Y,
    HEIGHT,
    PITCH,
    ROLL,
    SIZE,
)
from trackslip_estimation.attitude.span import (
    LEAST_SPAN_TIME,
    LONGEST_GAP,
    accumulate_rotation,
    add_sample,
    mean_acceleration,
    mean_tilt,
    reset_span,
)
from trackslip_estimation.attitude.start import initialise_from_gravity, initialise_tilt
from trackslip_estimation.kalman.propagate import propagate_covariance
from trackslip_estimation.kalman.update import correct, independent_observation, predicted_covariance

if TYPE_CHECKING:
    from trackslip_estimation.attitude.parameters import AttitudeConstants
    from trackslip_estimation.attitude.records import Attitude, ImuSample


GRAVITY_TOLERANCE = 1.0  # m/s², largest difference of the mean specific force from gravity
LEAST_UPWARD_FORCE = 0.5 * GRAVITY  # m/s², least mean specific force along z
_FASTER_SLIDE = 1.0  # m/s, by which a slide may be faster than the tracks were
_SLIDE_TIME = 10.0  # s, time constant of the velocity of a slide
_UNMEASURED_RATE_VARIANCE = 1.0  # (rad/s)², least variance of an axis that was not measured
_UNMEASURED_FORCE_VARIANCE = 1e6  # (m/s²)², least variance of a force that was not measured
_LEAST_VARIANCE = 1e-12  # (m/s²)², least variance of a force


@compiled
def is_gravity(a: Attitude) -> bool:
    """Whether the mean specific force is gravity, from below."""
    x, y, z = a.mean_force
    size = math.sqrt(x * x + y * y + z * z)
    return bool(abs(size - GRAVITY) <= GRAVITY_TOLERANCE and z >= LEAST_UPWARD_FORCE)


@compiled
def update_with_sample(a: Attitude, n: AttitudeConstants) -> int:
    """Update the record ``a`` of ``ATTITUDE`` with its new ``sample``; ``n``: ``CONSTANTS``.

    Returns the ``AttitudeRejection`` of the sample's orientation; 0 if it was used or is not requested.
    """
    imu = a.sample
    if imu.swing_unknown == 1 and a.seen == 0:
        a.rejection = SWING_UNKNOWN if imu.use_orientation == 1 else 0
        return int(a.rejection)
    imu.cos, imu.sin = math.cos(imu.turn), math.sin(imu.turn)
    dt = (imu.stamp_ns - a.stamp_ns) * 1e-9 if a.seen == 1 else 0.0
    if dt > LONGEST_GAP:
        _propagate_unmeasured_tilt(a, imu.stamp_ns, n)
    elif a.known == 1 and dt > 0.0:
        _propagate_tilt(a, _unbiased_rates(a), dt, True, n)
        _forget_uncertain_tilt(a, n)
    a.rejection = update_with_orientation(a, n) if imu.use_orientation == 1 else 0
    if _filter_force(a, dt, n) and is_gravity(a):
        if a.known == 0:
            initialise_from_gravity(a, n)
        rates = _unbiased_rates(a)
        u = _imu_velocity(imu, rates)
        force = specific_force(imu)
        add_sample(a, (force[0] + rates[2] * u[1], force[1] - rates[2] * u[0]), u)
        if a.span.time >= LEAST_SPAN_TIME or a.span.time == 0.0:
            _update_tilt(a, mean_acceleration(a, u), n)
            reset_span(a, _imu_velocity(imu, _unbiased_rates(a)))
    a.rates[0], a.rates[1], a.rates[2] = _unbiased_rates(a)
    a.stamp_ns, a.reached_ns, a.seen = imu.stamp_ns, imu.stamp_ns, 1
    set_level(a)
    return int(a.rejection)


@compiled
def propagate_silence(a: Attitude, stamp_ns: int, n: AttitudeConstants) -> None:
    """Propagate the attitude to a stamp at which its IMU has been silent for longer than ``LONGEST_GAP``."""
    if a.seen == 0 or (stamp_ns - a.stamp_ns) * 1e-9 <= LONGEST_GAP:
        return
    a.rates[:], a.sample.rate_variances[:] = 0.0, _UNMEASURED_RATE_VARIANCE
    a.sample.force_variance = _UNMEASURED_FORCE_VARIANCE
    _propagate_unmeasured_tilt(a, stamp_ns, n)
    set_level(a)


@compiled
def _propagate_unmeasured_tilt(a: Attitude, stamp_ns: int, n: AttitudeConstants) -> None:
    """Propagate roll and pitch to a stamp without their rates: the ground tilts the machine meanwhile."""
    if a.known == 1 and stamp_ns > a.reached_ns:
        _propagate_tilt(a, (0.0, 0.0, 0.0), (stamp_ns - a.reached_ns) * 1e-9, False, n)
        _forget_uncertain_tilt(a, n)
    a.reached_ns = stamp_ns


@compiled
def _forget_uncertain_tilt(a: Attitude, n: AttitudeConstants) -> None:
    """Let roll and pitch be unknown beyond ``lost``; their variance is that for the height meanwhile."""
    if max(a.covariance[ROLL, ROLL], a.covariance[PITCH, PITCH]) > n.lost**2:
        initialise_tilt(a, 0.0, 0.0, n)
        a.covariance[ROLL, ROLL] = a.covariance[PITCH, PITCH] = n.lost**2
        a.known = 0


@compiled
def _has_rates(imu: ImuSample) -> bool:
    """Whether the IMU measures the rates about x and y."""
    p, q = imu.rates[0], imu.rates[1]
    return (
        imu.swing_unknown == 0
        and math.isfinite(p + q)
        and 0.0 <= imu.rate_variances[0] < _UNMEASURED_RATE_VARIANCE
        and 0.0 <= imu.rate_variances[1] < _UNMEASURED_RATE_VARIANCE
    )


@compiled
def _unbiased_rates(a: Attitude) -> tuple[float, float, float]:
    """p, q, r without bias, rad/s; p and q are 0 if the IMU does not measure them."""
    imu, rates = a.sample, a.sample.rates
    if not _has_rates(imu):
        return 0.0, 0.0, rates[2]
    p, q = rates[0] - a.mean[BIAS_P], rates[1] - a.mean[BIAS_Q]
    return imu.cos * p - imu.sin * q, imu.sin * p + imu.cos * q, rates[2]


@compiled
def specific_force(imu: ImuSample) -> tuple[float, float, float]:
    """f along the axes of base_link, biases included, m/s²."""
    x, y, z = imu.force
    return imu.cos * x - imu.sin * y, imu.sin * x + imu.cos * y, z


@compiled
def has_force(imu: ImuSample) -> bool:
    """Whether the IMU measures a specific force, with a variance."""
    x, y, z = imu.force
    return bool(math.isfinite(x + y + z) and 0.0 < imu.force_variance < _UNMEASURED_FORCE_VARIANCE)


@compiled
def _filter_force(a: Attitude, dt: float, n: AttitudeConstants) -> bool:
    """Low-pass the force; return whether it may correct the tilt."""
    force = specific_force(a.sample)
    if a.sample.use_force == 0 or a.sample.swing_unknown == 1 or not has_force(a.sample):
        return False
    share = 1.0 if a.seen == 0 or dt > LONGEST_GAP else -math.expm1(-dt / n.mean_time)
    for i in range(3):
        a.mean_force[i] += share * (force[i] - a.mean_force[i])
    return True


@compiled
def _imu_velocity(imu: ImuSample, rates: tuple[float, float, float]) -> tuple[float, float]:
    """u along x and y, m/s."""
    p, q, r = rates
    l_x, l_y, l_z = imu.lever
    return imu.velocity[0] - r * l_y + q * l_z, imu.velocity[1] + r * l_x - p * l_z


@compiled
def _propagate_tilt(
    a: Attitude, rates: tuple[float, float, float], dt: float, is_measured: bool, n: AttitudeConstants
) -> None:
    """Propagate roll and pitch over ``dt`` s with the mean rates at both ends, if measured."""
    x, P, imu = a.mean[:], a.covariance[:], a.sample
    weight = 0.5 if is_measured else 0.0
    p, q, r = (
        weight * (rates[0] + a.rates[0]),
        weight * (rates[1] + a.rates[1]),
        weight * (rates[2] + a.rates[2]),
    )
    roll, pitch = x[ROLL], x[PITCH]
    sin, cos, tan = math.sin(roll), math.cos(roll), math.tan(pitch)
    half_roll = roll + (p + tan * (q * sin + r * cos)) * dt / 2.0
    half_pitch = pitch + (q * cos - r * sin) * dt / 2.0
    sin, cos, tan = math.sin(half_roll), math.cos(half_roll), math.tan(half_pitch)
    roll_rate, pitch_rate = p + tan * (q * sin + r * cos), q * cos - r * sin
    F, Q = np.eye(SIZE), np.zeros((SIZE, SIZE))
    F[ROLL, ROLL] += tan * (q * cos - r * sin) * dt
    F[ROLL, PITCH] = (1.0 + tan * tan) * (q * sin + r * cos) * dt
    F[ROLL, BIAS_P] = -(imu.cos + tan * sin * imu.sin) * dt
    F[ROLL, BIAS_Q] = (imu.sin - tan * sin * imu.cos) * dt
    F[PITCH, ROLL] = -(q * sin + r * cos) * dt
    F[PITCH, BIAS_P], F[PITCH, BIAS_Q] = -cos * imu.sin * dt, -cos * imu.cos * dt
    for i in range(SIZE):
        Q[i, i] = n.walk[i] * dt
    roll_noise = pitch_noise = n.ground_rate**2 * n.scale_time
    if is_measured and _has_rates(imu):
        scale_noise = n.gyro_scale_stddev**2 * n.scale_time
        p_variance, q_variance = imu.rate_variances[0], imu.rate_variances[1]
        roll_noise = (imu.cos**2 * p_variance + imu.sin**2 * q_variance) * dt + scale_noise * roll_rate**2
        pitch_noise = (imu.sin**2 * p_variance + imu.cos**2 * q_variance) * dt + scale_noise * pitch_rate**2
    Q[ROLL, ROLL] += roll_noise * dt
    Q[PITCH, PITCH] += pitch_noise * dt
    x[ROLL] += roll_rate * dt
    x[PITCH] += pitch_rate * dt
    accumulate_rotation(a, roll_rate * dt, pitch_rate * dt)
    propagate_covariance(P, F, Q, PITCH + 1)


@compiled
def _update_tilt(a: Attitude, motion: tuple[float, float], n: AttitudeConstants) -> None:
    """Update with both horizontal axes of a span that ends here; ``motion``: its u̇, m/s²."""
    x, force, h, imu = a.mean, specific_force(a.sample), np.zeros(SIZE), a.sample
    speed = math.hypot(a.span.velocity[0], a.span.velocity[1])
    a.fastest = max(a.fastest * (1.0 - a.span.time / _SLIDE_TIME), speed)
    spread = 0.0 if a.span.known == 1 else n.unknown_acceleration**2
    spread += imu.turn_variance * (force[0] * force[0] + force[1] * force[1])
    pitch = mean_tilt(a)[1]
    h[PITCH], h[BIAS_X], h[BIAS_Y] = -GRAVITY * math.cos(pitch), imu.cos, -imu.sin
    bias = imu.cos * x[BIAS_X] - imu.sin * x[BIAS_Y]
    _update_axis(a, 0, a.span.force[0] - motion[0] + GRAVITY * math.sin(pitch) - bias, h, spread, n)
    roll, pitch = mean_tilt(a)
    up, aside = math.cos(roll), math.sin(roll)
    h[PITCH], h[BIAS_X] = -GRAVITY * aside * math.sin(pitch), imu.sin
    h[ROLL], h[BIAS_Y] = GRAVITY * up * math.cos(pitch), imu.cos
    bias = imu.sin * x[BIAS_X] + imu.cos * x[BIAS_Y]
    _update_axis(a, 1, a.span.force[1] - motion[1] - GRAVITY * aside * math.cos(pitch) - bias, h, spread, n)


@compiled
def _update_axis(
    a: Attitude, axis: int, innovation: float, h: FloatArray, spread: float, n: AttitudeConstants
) -> None:
    """Update with one axis; its noise is adapted to the part of ν² that the tilt does not explain."""
    P, dt = a.covariance[:], a.span.time
    _open_tilt(a, PITCH if axis == 0 else ROLL, innovation)
    stated = max(a.sample.force_variance, _LEAST_VARIANCE) / a.span.samples
    H = h.reshape((1, SIZE))
    predicted = predicted_covariance(P, H)[0, 0]
    noise = max(a.noise[axis], stated)
    share = noise / (predicted + noise + spread)
    measured = min(innovation * innovation, n.outlier_nis * (predicted + noise)) - predicted
    a.noise[axis] = max(a.noise[axis] + share * (measured - a.noise[axis]) / (a.noise_count[axis] + 1.0), 0.0)
    R, longest = max(a.noise[axis], stated), 1.0
    if dt > 0.0:
        R, longest = R * max(n.correlation_time / dt, 1.0), max(n.noise_time / dt, 1.0)
    a.noise_count[axis] = min(a.noise_count[axis] + share, longest)
    R = max(R + spread, innovation * innovation / n.outlier_nis - predicted)
    correct(a.mean[:], P, independent_observation(np.array((innovation,)), H, np.array(((R,),))))


@compiled
def _open_tilt(a: Attitude, k: int, innovation: float) -> None:
    """Open the variance of roll or pitch ``k`` to the error that no slide explains."""
    span = a.span
    gain = span.time if span.known == 1 and abs(innovation) < GRAVITY else 0.0  # else it is no tilt
    a.slide[k] += gain * innovation - span.time / _SLIDE_TIME * a.slide[k]
    if abs(a.slide[k]) > _FASTER_SLIDE + a.fastest:
        error = a.slide[k] / (_SLIDE_TIME * GRAVITY)
        a.covariance[k, k] = max(a.covariance[k, k], error * error)


@compiled
def climb_rate(x: FloatArray, v_x: float, v_y: float) -> float:
    """ż, m/s, at these speeds along the ground."""
    return float(-v_x * math.sin(x[PITCH]) + v_y * math.sin(x[ROLL]) * math.cos(x[PITCH]))


@compiled
def propagate_height(a: Attitude, v_x: float, v_y: float, dt: float) -> None:
    """Propagate the height over ``dt`` s at these speeds along the ground."""
    x, P = a.mean, a.covariance
    sin, cos = math.sin(x[ROLL]), math.cos(x[ROLL])
    sin_pitch, cos_pitch = math.sin(x[PITCH]), math.cos(x[PITCH])
    x[HEIGHT] += climb_rate(x, v_x, v_y) * dt
    by_roll = v_y * cos * cos_pitch * dt
    by_pitch = -(v_x * cos_pitch + v_y * sin * sin_pitch) * dt
    for j in range(SIZE):
        P[HEIGHT, j] += by_roll * P[ROLL, j] + by_pitch * P[PITCH, j]
    for i in range(SIZE):
        P[i, HEIGHT] += by_roll * P[i, ROLL] + by_pitch * P[i, PITCH]
