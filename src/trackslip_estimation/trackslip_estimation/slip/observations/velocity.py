# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The horizontal velocity of a sensor, as a GNSS receiver's Doppler or a ground radar measures it; compiled.

    z    velocity along east and north, or along the axes of a radar                  (2,) or (1,), m/s
    u    velocity of the sensor along the heading and to its left: v + ω × p, with the swing of a sensor
         mounted above, and with the rates of roll and pitch                          (2,), m/s
    h    q R(φ) u; of a radar R(−mounting) u
    q    e^(−σ²/2), σ² the variance of the heading

q R(φ) u is the mean of a rotation by a Gaussian angle, and its derivative gives the covariance with the state
(exact moments). R includes the variance of the rotation beyond H, so an uncertain heading is not mistaken for
slip. R also includes the rounding of the counts, and the sideways motion that is not a state.

A velocity measures slip and, while the machine moves, the heading. With an unknown heading, the direction of
motion selects the branch of the bank, and the sign of the sprockets forward or backward.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_common.compiled import compiled
from trackslip_estimation.kalman.update import Observation
from trackslip_estimation.slip.coasting import unknown_sideways_variance
from trackslip_estimation.slip.levers import horizontal_lever_arm, is_heading_unobservable, swung_lever_arm
from trackslip_estimation.slip.models import slope
from trackslip_estimation.slip.models.dispatch import (
    body_jacobian,
    body_twist,
    has_velocity_errors,
    horizontal_twist,
)
from trackslip_estimation.slip.models.model import SWING, SWING_RATE, YAW
from trackslip_estimation.slip.motion import steady_speeds
from trackslip_estimation.slip.source_faults import IS_OFFSET
from trackslip_estimation.slip.validity import LEAST_VARIANCE, rows_of_velocity

if TYPE_CHECKING:
    from trackslip_estimation.slip.config import Config
    from trackslip_estimation.slip.records import MeasurementRecord, State


class Rotation(NamedTuple):
    """Rotation from the machine's axes into those of the measurement."""

    cos: float
    sin: float
    mean: float  # q
    along: float  # variance beyond H along the rotated velocity, over its square
    across: float  # the same across it


@compiled
def observe_velocity(state: State, measurement: MeasurementRecord, c: Config) -> Observation:
    """ν (m,), H and R of a velocity at steady sprocket speeds; m is 1 if only one axis is measured."""
    source, x, m = measurement.source, state.mean[: c.size], rows_of_velocity(measurement, c)
    left, right, variance = steady_speeds(state.speeds, state.motion, c.motion_limits)
    rotation = _rotation(state, source, c)
    u, w = _velocity(state, left, right, source, c), np.empty(2)
    w[0], w[1] = rotation.cos * u[0] - rotation.sin * u[1], rotation.sin * u[0] + rotation.cos * u[1]
    D, H = _jacobian(state, left, right, source, c), np.empty((2, x.size))
    H[0], H[1] = rotation.cos * D[0] - rotation.sin * D[1], rotation.sin * D[0] + rotation.cos * D[1]
    if c.body_axes[source] == 0:
        H[0, YAW] -= w[1]
        H[1, YAW] += w[0]
    elif c.above[source] == 1:
        H[0, SWING] += w[1]
        H[1, SWING] -= w[0]
    R = measurement.noise[:m, :m].copy()
    for i in range(m):
        R[i, i] = max(R[i, i], c.velocity_floor[source] ** 2, LEAST_VARIANCE)
    vector = np.empty(2)
    vector[0], vector[1] = -rotation.sin, rotation.cos
    R += (_sideways_variance(state, left, right, c) * np.outer(vector, vector))[:m, :m]
    if state.coasting and not has_velocity_errors(c):
        R += c.unknown_speed**2 * np.eye(m)
    vector[0], vector[1] = -w[1], w[0]
    R += (rotation.along * np.outer(w, w) + rotation.across * np.outer(vector, vector))[:m, :m]
    if variance > 0.0:
        stddev = math.sqrt(variance)
        for on_left, on_right in ((stddev, 0.0), (0.0, stddev)):
            plus = _velocity(state, left + on_left, right + on_right, source, c)
            by = (plus - _velocity(state, left - on_left, right - on_right, source, c)) / 2.0
            vector[0], vector[1] = (
                rotation.cos * by[0] - rotation.sin * by[1],
                rotation.sin * by[0] + rotation.cos * by[1],
            )
            R += np.outer(vector, vector)[:m, :m]
    nu, H = measurement.value[:m] - rotation.mean * w[:m], rotation.mean * H[:m].copy()
    if state.fault[source] == IS_OFFSET:
        for axis in range(m):
            H[axis, c.offsets[source] + axis] = 1.0
            nu[axis] -= x[c.offsets[source] + axis]
    # at rest the noise of the yaw rate moves the lever
    considered = 1 << YAW if is_heading_unobservable(state, c) else 0
    return Observation(nu, H, R, considered, 0, H[:0])


@compiled
def _rotation(state: State, source: int, c: Config) -> Rotation:
    if c.body_axes[source] == 1:
        angle = -c.heading_offset[source]
        if c.above[source] == 1:
            angle -= state.mean[SWING]
        return Rotation(math.cos(angle), math.sin(angle), 1.0, 0.0, 0.0)
    angle, variance = state.mean[YAW], state.covariance[YAW, YAW]
    q = math.exp(-variance / 2.0)
    along = (1.0 - q * q) ** 2 / 2.0
    across = max((1.0 - q**4) / 2.0 - variance * q * q, 0.0)
    return Rotation(math.cos(angle), math.sin(angle), q, along, across)


@compiled
def _velocity(state: State, left: float, right: float, source: int, c: Config) -> FloatArray:
    """u (2,): along the ground if it is measured along axes of the machine, else horizontal."""
    x, level, u = state.mean[: c.size], state.attitude.level, np.empty(2)
    if c.body_axes[source] == 1:
        v_x, v_y, rate = body_twist(x, left, right, state, c)
        ahead, aside, by_ahead, by_aside = swung_lever_arm(x[SWING] if c.swings else 0.0, source, c)
    else:
        v_x, v_y, rate = horizontal_twist(x, left, right, state, c)
        ahead, aside, by_ahead, by_aside = horizontal_lever_arm(
            level, x[SWING] if c.swings else 0.0, source, c
        )
    u[0], u[1] = v_x - rate * aside, v_y + rate * ahead
    if c.above[source] == 1:
        u[0] += x[SWING_RATE] * by_ahead
        u[1] += x[SWING_RATE] * by_aside
    p, q = state.attitude.rates[0], state.attitude.rates[1]
    if state.attitude.known == 1 and math.isfinite(p + q):
        u[0] += q * c.levers[source, 2]
        u[1] -= p * c.levers[source, 2]
    return u


@compiled
def _jacobian(state: State, left: float, right: float, source: int, c: Config) -> FloatArray:
    """(2, n) derivative of u by the state."""
    x, level = state.mean[: c.size], state.attitude.level
    J, D = body_jacobian(x, left, right, state, c), np.empty((2, x.size))
    swing = x[SWING] if c.swings else 0.0
    x_swung, y_swung, _, _ = swung_lever_arm(swing, source, c)
    forward, sideways, across = level.forward, level.sideways, level.across
    if c.body_axes[source] == 1:
        rate = body_twist(x, left, right, state, c)[2]
        ahead, aside, by_ahead, by_aside = swung_lever_arm(swing, source, c)
        forward = sideways = across = 0.0
    else:
        rate = horizontal_twist(x, left, right, state, c)[2]
        ahead, aside, by_ahead, by_aside = horizontal_lever_arm(level, swing, source, c)
        slope.horizontal_jacobian(J, level)
    D[0], D[1] = J[0] - aside * J[2], J[1] + ahead * J[2]
    if c.above[source] == 1:
        from_axis = x_swung - c.swing_axis[0], y_swung - c.swing_axis[1]
        bend_ahead = -from_axis[0] * (1.0 + forward) - from_axis[1] * across
        bend_aside = -from_axis[1] * (1.0 + sideways)
        D[0, SWING] += x[SWING_RATE] * bend_ahead - rate * by_aside
        D[1, SWING] += x[SWING_RATE] * bend_aside + rate * by_ahead
        D[0, SWING_RATE] += by_ahead
        D[1, SWING_RATE] += by_aside
    return D


@compiled
def _sideways_variance(state: State, left: float, right: float, c: Config) -> float:
    """Variance of the speed of C to the left that is not a state, (m/s)²."""
    if state.coasting:
        return unknown_sideways_variance(state, c)
    if not has_velocity_errors(c):
        return 0.0
    squares = c.rolling_radius**2 * (left * left + right * right) / 4.0
    return float(c.adaptation.sideways**2 * state.adaptation.track_variance * squares)
