# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Propagation while the sprockets are silent: any speed and yaw rate of the machine; compiled.

    v̂, ω̂   standard deviations of unknown speed and yaw rate                m/s, rad/s
    τ       correlation time of an unknown speed                             s
    x, P    mean and covariance of the state

Up to the timeout the latest speeds are extrapolated; their errors grow by v̂ √(t/τ) and ω̂ √(t/τ). Then speed
and yaw rate are velocity errors (``models.speed``): first-order Gauss–Markov processes of standard deviations
v̂ and ω̂ and time τ, observed by fixes and gyro. Models without these states hold the pose; its standard
deviation grows as that of a random walk, by v̂ √(2 τ t) and ω̂ √(2 τ t).

An estimate may start before its first sample. Until then the machine has the speeds of that sample, and a
variance of the distance back to the start of v̂² t³/3τ.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from trackslip_common.compiled import compiled
from trackslip_common.vehicle import Kinematics
from trackslip_estimation.kalman.single_state import replace_state
from trackslip_estimation.slip.models.dispatch import has_velocity_errors
from trackslip_estimation.slip.models.model import SPEED_TIME, YAW, X, Y
from trackslip_estimation.slip.models.speed import SPEED_ERROR, YAW_RATE_ERROR

if TYPE_CHECKING:
    from trackslip_estimation.slip.config import Config
    from trackslip_estimation.slip.records import State

SIDEWAYS = 0.1  # lateral share of v̂


@dataclass(frozen=True)
class UnknownMotion:
    """Standard deviations of unknown speed and yaw rate."""

    speed: float  # v̂, m/s
    yaw_rate: float  # ω̂, rad/s


def unknown_motion(vehicle: Kinematics, max_sprocket_speed: float) -> UnknownMotion:
    """v̂ and ω̂ of speeds and yaw rates that are uniform up to what the sprockets reach."""
    fastest = vehicle.rolling_radius * max_sprocket_speed
    return UnknownMotion(fastest / math.sqrt(3.0), 2.0 * fastest / vehicle.tread / math.sqrt(3.0))


@compiled
def reset_velocity_errors(state: State, rate: tuple[float, float], c: Config) -> None:
    """Reset the velocity errors at the start of silence; ``rate``: yaw rate and its variance."""
    if has_velocity_errors(c):
        replace_state(state.mean, state.covariance, SPEED_ERROR, 0.0, c.unknown_speed**2)
        replace_state(state.mean, state.covariance, YAW_RATE_ERROR, rate[0], rate[1])


@compiled
def add_unknown_motion_noise(state: State, dt: float, c: Config) -> None:
    """Add process noise of ``dt`` s of unknown motion that no state models."""
    P, share = state.covariance, 1.0
    if has_velocity_errors(c):  # which model speed along the heading
        share = min(SIDEWAYS**2 + P[YAW, YAW], 1.0)
    P[X, X] += 2.0 * SPEED_TIME * dt * share * c.unknown_speed**2
    P[Y, Y] += 2.0 * SPEED_TIME * dt * share * c.unknown_speed**2
    P[YAW, YAW] += 2.0 * SPEED_TIME * dt * c.unmodelled_yaw_rate**2


@compiled
def inflate_start_pose(state: State, reached_ns: int, c: Config) -> None:
    """Inflate the covariance of the pose by the error of the first sample's speeds since the state."""
    P, start_ns = state.covariance, state.sample.stamp_ns
    before, after = (state.stamp_ns - start_ns) * 1e-9, (reached_ns - start_ns) * 1e-9
    grown = (after**3 - before**3) / (3.0 * SPEED_TIME)
    P[X, X] += grown * c.unknown_speed**2
    P[Y, Y] += grown * c.unknown_speed**2
    P[YAW, YAW] += grown * c.unknown_yaw_rate**2
