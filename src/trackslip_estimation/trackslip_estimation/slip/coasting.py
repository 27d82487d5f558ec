# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The machine while its sprockets are silent: it may stand, go on, or turn, each as fast as it can; compiled.

    v̂, ω̂   fastest that it can drive and turn              m/s, rad/s
    τ       how long an unknown speed lasts                 s
    x, P    mean and covariance of the state

Before, the sprockets' last speeds are taken to go on, and have errors of v̂ √(t/τ) and ω̂ √(t/τ) more. Then
the pose is held where it was and its uncertainty grows as that of a random walk, by v̂ √(2 τ t). Where
velocity errors are states, all of speed and yaw rate is an error now. The speed is forgotten after each step.
The yaw rate is a first-order Gauss–Markov process of size ω̂ and time τ, so that a gyro that still works
carries the heading on, whatever else is measured between its readings.

An estimate may start before its first sample. Until that one the machine goes as it shows, or otherwise: back
from it speed and yaw rate may be random walks of v̂ √(t/τ) and ω̂ √(t/τ), which after a time t is a variance of
v̂² t³/3τ in the way.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from trackslip_common.compiled import compiled
from trackslip_common.vehicle import Kinematics
from trackslip_estimation.kalman.single_state import decay_state, replace_state
from trackslip_estimation.slip.models.dispatch import has_velocity_errors
from trackslip_estimation.slip.models.model import LASTS, YAW, X, Y
from trackslip_estimation.slip.models.speed import SPEED_ERROR, YAW_RATE_ERROR

if TYPE_CHECKING:
    from trackslip_estimation.slip.config import Config
    from trackslip_estimation.slip.records import State


@dataclass(frozen=True)
class MotionLimits:
    """What the machine can do at the most."""

    speed: float  # m/s
    yaw_rate: float  # rad/s


def motion_limits(vehicle: Kinematics, max_sprocket_speed: float) -> MotionLimits:
    """What the sprockets can do at the most."""
    fastest = vehicle.rolling_radius * max_sprocket_speed
    return MotionLimits(fastest, 2.0 * fastest / vehicle.tread)


@compiled
def begin_coast(state: State, rate: tuple[float, float], c: Config) -> None:
    """At the end of what is known; ``rate``: yaw rate and its variance."""
    if not has_velocity_errors(c):
        return
    reset_speed(state, c)
    replace_state(state.mean, state.covariance, YAW_RATE_ERROR, rate[0], rate[1])


@compiled
def reset_speed(state: State, c: Config) -> None:
    """Speed unknown: about zero, as wide as it can be."""
    if has_velocity_errors(c):
        replace_state(state.mean, state.covariance, SPEED_ERROR, 0.0, c.speed_limit**2)


@compiled
def decay_yaw_rate(state: State, dt: float, c: Config) -> None:
    """The yaw rate dt later: it goes to zero, as wide as it can be."""
    if has_velocity_errors(c):
        left = math.exp(-dt / LASTS)
        decay_state(state.mean, state.covariance, YAW_RATE_ERROR, left, c.yaw_rate_limit**2)


@compiled
def inflate(state: State, dt: float, c: Config) -> None:
    """What may have been driven in ``dt`` s, and turned where no state accounts for it."""
    P = state.covariance
    P[X, X] += 2.0 * LASTS * dt * c.speed_limit**2
    P[Y, Y] += 2.0 * LASTS * dt * c.speed_limit**2
    P[YAW, YAW] += 2.0 * LASTS * dt * c.unseen_yaw_rate**2


@compiled
def widen_start(state: State, reached_ns: int, c: Config) -> None:
    """What may have been driven otherwise than the first sample shows, from the state's stamp on."""
    P, start_ns = state.covariance, state.sample.stamp_ns
    before, after = (state.stamp_ns - start_ns) * 1e-9, (reached_ns - start_ns) * 1e-9
    grown = (after**3 - before**3) / (3.0 * LASTS)
    P[X, X] += grown * c.speed_limit**2
    P[Y, Y] += grown * c.speed_limit**2
    P[YAW, YAW] += grown * c.yaw_rate_limit**2
