# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Interface of the slip estimator to the attitude filter, which is part of its state; compiled.

One IMU measures the attitude (``config.tilt_source``). Its samples are processed in the order of stamps with
all other measurements. Samples of an IMU on the upper structure are rotated back by the swing angle, and left
out while that is unknown.

The height is the integral of the slope along the estimated path, including corrections by measurements. So an
unmodelled slip changes the height, too.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from trackslip_common.compiled import compiled
from trackslip_estimation.attitude.filter import (
    climb_rate,
    has_force,
    propagate_height,
    propagate_silence,
    specific_force,
    update_with_sample,
)
from trackslip_estimation.attitude.level import climb_rate_variance
from trackslip_estimation.attitude.records import HEIGHT, PITCH, ROLL
from trackslip_estimation.kalman.single_state import replace_state
from trackslip_estimation.kalman.update import correct, independent_observation
from trackslip_estimation.slip.levers import UNKNOWN_HEADING, is_swing_unknown, swing_lever
from trackslip_estimation.slip.measurements import UNOBSERVED
from trackslip_estimation.slip.models.dispatch import body_twist
from trackslip_estimation.slip.models.model import GYRO_SCALE, SWING, SWING_RATE, YAW, X, Y

if TYPE_CHECKING:
    from trackslip_estimation.attitude.records import Level
    from trackslip_estimation.slip.config import Config
    from trackslip_estimation.slip.records import EstimateRecord, MeasurementRecord, State


class Lean(NamedTuple):
    """Displacement of a point above C by the tilt, per m of height, ahead and to the left."""

    known: int  # 0 or 1
    x: float
    y: float
    variance: float  # of both


@compiled
def update_attitude(state: State, measurement: MeasurementRecord, bias: int, c: Config) -> int:
    """Update the attitude by a sample of its IMU; returns why its orientation was rejected, 0: used.

    ``bias``: number of the state that is the bias of its gyro.
    """
    imu, a, source = state.attitude.sample, state.attitude, measurement.source
    scale = c.rate_scale[source]
    r = (measurement.value[0] / scale - state.mean[bias]) / (1.0 + state.mean[GYRO_SCALE])
    imu.rates[0], imu.rates[1], imu.rates[2] = measurement.value[1], measurement.value[2], r
    factor = state.adaptation.rate_factor
    for k in range(3):
        imu.rate_variances[k] = factor * measurement.noise[(k + 1) % 3, (k + 1) % 3]
    imu.stamp_ns, imu.force[:] = measurement.stamp_ns, measurement.acceleration
    imu.force_variance, imu.lever[:] = measurement.acceleration_variance, c.tilt_lever
    imu.up[:], imu.up_variances[:] = measurement.up, measurement.up_variances
    imu.use_force, imu.use_orientation = c.tilt_acceleration, c.tilt_orientation
    v_x, v_y, rate = body_twist(state.mean[:], state.speeds.left, state.speeds.right, state, c)
    imu.velocity[0], imu.velocity[1] = v_x, v_y
    imu.turn, imu.turn_variance, imu.swing_unknown = 0.0, 0.0, 0
    if c.above[source] == 1:
        imu.turn, imu.turn_variance = state.mean[SWING], state.covariance[SWING, SWING]
        imu.swing_unknown = 1 if is_swing_unknown(state.covariance) else 0
        swing_lever(imu, state.mean[SWING_RATE], c)
        imu.rates[2] = rate  # the rate of the IMU contains the swing, before the state does
    imu.known_velocity = 0 if state.coasting else 1
    before = _lean_of(a.level)
    rejection = int(update_with_sample(a, c.attitude))
    _exchange_tilt_errors(state, before, c)
    return rejection


@compiled
def propagate_silent_tilt(state: State, stamp_ns: int, c: Config) -> None:
    """Propagate the attitude to a stamp at which its IMU has been silent for some time."""
    before = _lean_of(state.attitude.level)
    propagate_silence(state.attitude, stamp_ns, c.attitude)
    _exchange_tilt_errors(state, before, c)


@compiled
def _lean_of(level: Level) -> Lean:
    return Lean(level.known, level.lean_x, level.lean_y, level.lean_variance)


@compiled
def _exchange_tilt_errors(state: State, before: Lean, c: Config) -> None:
    """Exchange the errors of a known tilt for the slope of the ground, or back, as the tilt is lost or found.

    A tilt that is found measures the slope; one that is lost is the first estimate of it.
    """
    now = _lean_of(state.attitude.level)
    if c.lean_errors < 0 or now.known == before.known:
        return
    e, stddev, x, P = c.lean_errors, c.lean_stddevs[0], state.mean[: c.size], state.covariance[:]
    lean = now if now.known == 1 else before
    cos, sin = math.cos(x[YAW]), math.sin(x[YAW])
    slope = np.array((cos * lean.x - sin * lean.y, sin * lean.x + cos * lean.y))
    variance = lean.variance + min(P[YAW, YAW], UNKNOWN_HEADING**2) * (lean.x**2 + lean.y**2)
    if now.known == 1 and stddev > 0.0:
        H = np.zeros((2, x.size))
        H[X, e] = H[Y, e + 1] = stddev
        correct(x, P, independent_observation(slope - stddev * x[e : e + 2], H, variance * np.eye(2)))
    for axis in (X, Y):
        if now.known == 1 or stddev == 0.0:
            replace_state(x, P, e + axis, 0.0, 1.0)
        else:
            replace_state(x, P, e + axis, slope[axis] / stddev, variance / stddev**2)


@compiled
def propagate_height_by_twist(state: State, dt: float, c: Config) -> None:
    """Propagate the height over ``dt`` s with the speeds of the state."""
    if state.attitude.seen == 1 and dt > 0.0:  # also while the tilt is unknown
        v_x, v_y, _ = body_twist(state.mean[:], state.speeds.left, state.speeds.right, state, c)
        propagate_height(state.attitude, v_x, v_y, dt)


@compiled
def correct_height_by_position(state: State, east: float, north: float) -> None:
    """Correct the height by a correction of the position, m, along the ground."""
    if state.attitude.level.known == 1 and (east != 0.0 or north != 0.0):
        ahead, left = _displacement_on_ground(state, east, north)
        propagate_height(state.attitude, ahead, left, 1.0)


@compiled
def _displacement_on_ground(state: State, east: float, north: float) -> tuple[float, float]:
    """A horizontal displacement along the axes of the machine on the ground: ahead and to the left."""
    level = state.attitude.level
    cos, sin = math.cos(state.mean[YAW]), math.sin(state.mean[YAW])
    left = (cos * north - sin * east) / (1.0 + level.sideways)
    return (cos * east + sin * north - left * level.across) / (1.0 + level.forward), left


@compiled
def _height_variance_by_position(state: State) -> float:
    """Variance of the height, m², by the position error on the slope."""
    tilt, P = state.attitude.mean, state.covariance
    ahead, left = _displacement_on_ground(state, 1.0, 0.0)
    east = climb_rate(tilt, ahead, left)
    ahead, left = _displacement_on_ground(state, 0.0, 1.0)
    north = climb_rate(tilt, ahead, left)
    return float(east * east * P[X, X] + 2.0 * east * north * P[X, Y] + north * north * P[Y, Y])


@compiled
def fill_tilt(state: State, estimate: EstimateRecord) -> None:
    """Set the attitude of a record of ``ESTIMATE`` that has its twist.

    The height error includes the slope times the position error.
    """
    a, tilt = state.attitude, estimate.tilt
    tilt.known = a.known
    if a.known == 0:
        tilt.tilt[:], tilt.covariance[:], tilt.rates[:], tilt.rate_variances[:] = 0.0, 0.0, 0.0, 0.0
        tilt.force[:], tilt.force_variance = 0.0, 0.0
        estimate.rise, estimate.rise_variance = 0.0, 0.0
        return
    force, has_acceleration = specific_force(a.sample), has_force(a.sample)
    for i in range(3):
        variance = a.sample.rate_variances[i]
        tilt.tilt[i], tilt.rates[i] = a.mean[ROLL + i], a.rates[i]
        tilt.rate_variances[i] = variance if 0.0 <= variance < UNOBSERVED else UNOBSERVED
        tilt.force[i] = force[i] if has_acceleration else 0.0
        for j in range(3):
            tilt.covariance[i, j] = a.covariance[ROLL + i, ROLL + j]
    tilt.covariance[HEIGHT, HEIGHT] += _height_variance_by_position(state)
    tilt.force_variance = a.sample.force_variance if has_acceleration else UNOBSERVED
    v_x, v_y, P = estimate.twist[0], estimate.twist[1], a.covariance
    estimate.rise = climb_rate(a.mean, v_x, v_y)
    estimate.rise_variance = v_x**2 * P[PITCH, PITCH] + v_y**2 * P[ROLL, ROLL]
    estimate.rise_variance += climb_rate_variance(a.level, estimate.twist_covariance[:])
