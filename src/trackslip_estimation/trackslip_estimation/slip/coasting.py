# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Propagation while the sprockets are silent: any speed and yaw rate of the machine; compiled.

    v̂, ω̂   standard deviations of unknown speed and yaw rate                m/s, rad/s
    q       random walk of an unknown speed                                  m/s/√s
    τ       correlation time of an unknown speed, 2 v̂²/q²                    s
    τ_p     that of a speed that is no state                                 s
    x, P    mean and covariance of the state

Up to the timeout the latest speeds are extrapolated; their errors grow by v̂ √(t/τ) and ω̂ √(t/τ). Then speed
and yaw rate are velocity errors (``models.speed``): first-order Gauss–Markov processes of standard deviations
v̂ and ω̂ and time τ, observed by fixes and gyro. They begin with the latest speeds, as a machine has inertia:
within a second its speed changes by q. Sideways it may move with a tenth of its speed. Models without these
states hold the pose; its standard deviation grows as that of a random walk, by v̂ √(2 τ_p t) and ω̂ √(2 τ_p t).

An estimate may start before its first sample. Until then the machine has the speeds of that sample, and a
variance of the distance back to the start of v̂² t³/3τ.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from trackslip_common.compiled import compiled
from trackslip_common.vehicle import Kinematics
from trackslip_estimation.kalman.linear_algebra import sandwich
from trackslip_estimation.kalman.single_state import replace_state
from trackslip_estimation.slip.models.dispatch import has_velocity_errors, twist, twist_jacobian
from trackslip_estimation.slip.models.model import SPEED_TIME, YAW, X, Y
from trackslip_estimation.slip.models.speed import SPEED_ERROR, YAW_RATE_ERROR

if TYPE_CHECKING:
    from trackslip_estimation.slip.config import Config
    from trackslip_estimation.slip.records import State

_SIDEWAYS = 0.1  # lateral share of an unknown speed
_SPEED_WALK = 0.5  # q, m/s/√s


@dataclass(frozen=True)
class UnknownMotion:
    """Standard deviations of unknown speed and yaw rate, and their correlation time."""

    speed: float  # v̂, m/s
    yaw_rate: float  # ω̂, rad/s
    time: float  # τ, s


def unknown_motion(vehicle: Kinematics, max_sprocket_speed: float) -> UnknownMotion:
    """v̂ and ω̂ of speeds and yaw rates that are uniform up to what the sprockets reach, and τ."""
    fastest = vehicle.rolling_radius * max_sprocket_speed
    speed = fastest / math.sqrt(3.0)
    return UnknownMotion(speed, 2.0 * speed / vehicle.tread, 2.0 * (speed / _SPEED_WALK) ** 2)


@compiled
def set_unknown_speeds(state: State, c: Config) -> None:
    """Set the velocity errors to the latest speeds at the start of silence; without a sample to any."""
    if not has_velocity_errors(c):
        return
    x, P, speed, rate = state.mean, state.covariance, 0.0, 0.0
    of_speed, of_rate = c.unknown_speed**2, c.unknown_yaw_rate**2
    if state.sample.known:
        left, right = state.speeds.left, state.speeds.right
        speed, _, rate = twist(x[:], left, right, c)
        covariance = sandwich(twist_jacobian(x[:], left, right, c), P[:])
        of_speed, of_rate = covariance[0, 0], covariance[2, 2]
    replace_state(x, P, SPEED_ERROR, speed, of_speed)
    replace_state(x, P, YAW_RATE_ERROR, rate, of_rate)


@compiled
def unknown_sideways_variance(state: State, c: Config) -> float:
    """Variance of an unknown speed to the left, (m/s)²."""
    squared = c.unknown_speed**2
    if has_velocity_errors(c):
        squared = state.mean[SPEED_ERROR] ** 2 + state.covariance[SPEED_ERROR, SPEED_ERROR]
    return float(_SIDEWAYS**2 * squared)


@compiled
def add_unknown_motion_noise(state: State, dt: float, c: Config) -> None:
    """Add process noise of ``dt`` s of unknown motion that no state models."""
    P, variance = state.covariance, c.unknown_speed**2
    if has_velocity_errors(c):  # which model the speed along the mean heading
        of_heading = min(P[YAW, YAW], 1.0) * P[SPEED_ERROR, SPEED_ERROR]
        variance = unknown_sideways_variance(state, c) + of_heading
    P[X, X] += 2.0 * SPEED_TIME * dt * variance
    P[Y, Y] += 2.0 * SPEED_TIME * dt * variance
    P[YAW, YAW] += 2.0 * SPEED_TIME * dt * c.unmodelled_yaw_rate**2


@compiled
def inflate_start_pose(state: State, reached_ns: int, c: Config) -> None:
    """Inflate the covariance of the pose by the error of the first sample's speeds since the state."""
    P, start_ns = state.covariance, state.sample.stamp_ns
    before, after = (state.stamp_ns - start_ns) * 1e-9, (reached_ns - start_ns) * 1e-9
    grown = (after**3 - before**3) / (3.0 * c.unknown_time)
    P[X, X] += grown * c.unknown_speed**2
    P[Y, Y] += grown * c.unknown_speed**2
    P[YAW, YAW] += grown * c.unknown_yaw_rate**2
