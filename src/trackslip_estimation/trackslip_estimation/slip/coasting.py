# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The machine while its sprockets are silent: it may stand, go on, or turn, each as fast as it can; compiled.

    v̂, ω̂   standard deviations of a speed and a yaw rate that may be any    m/s, rad/s
    τ       how long an unknown speed lasts                                  s
    x, P    mean and covariance of the state

Before, the sprockets' last speeds are taken to go on, and have errors of v̂ √(t/τ) and ω̂ √(t/τ) more. Then
all of speed and yaw rate is a velocity error (``models.speed``): first-order Gauss–Markov processes of sizes
v̂ and ω̂ and time τ. Fixes show them, and a gyro that still works. Models without these states hold the pose
where it was; its uncertainty grows as that of a random walk, by v̂ √(2 τ t) and ω̂ √(2 τ t).

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
from trackslip_estimation.kalman.single_state import replace_state
from trackslip_estimation.slip.models.dispatch import has_velocity_errors
from trackslip_estimation.slip.models.model import SPEED_TIME, YAW, X, Y
from trackslip_estimation.slip.models.speed import SPEED_ERROR, YAW_RATE_ERROR

if TYPE_CHECKING:
    from trackslip_estimation.slip.config import Config
    from trackslip_estimation.slip.records import State

_SIDEWAYS = 0.1  # share of v̂ that an unseen machine may go aside


@dataclass(frozen=True)
class UnknownMotion:
    """Standard deviations of speed and yaw rate of a machine of which nothing is known."""

    speed: float  # v̂, m/s
    yaw_rate: float  # ω̂, rad/s


def unknown_motion(vehicle: Kinematics, max_sprocket_speed: float) -> UnknownMotion:
    """Any speed and yaw rate that the sprockets can do is as likely."""
    fastest = vehicle.rolling_radius * max_sprocket_speed
    return UnknownMotion(fastest / math.sqrt(3.0), 2.0 * fastest / vehicle.tread / math.sqrt(3.0))


@compiled
def begin_coast(state: State, rate: tuple[float, float], c: Config) -> None:
    """At the end of what is known; ``rate``: yaw rate and its variance. The speed may be any."""
    if has_velocity_errors(c):
        replace_state(state.mean, state.covariance, SPEED_ERROR, 0.0, c.unknown_speed**2)
        replace_state(state.mean, state.covariance, YAW_RATE_ERROR, rate[0], rate[1])


@compiled
def inflate(state: State, dt: float, c: Config) -> None:
    """What may have been driven in ``dt`` s, and turned, where no state accounts for it."""
    P, share = state.covariance, 1.0
    if has_velocity_errors(c):  # which know of speed along the heading, as far as that is known
        share = min(_SIDEWAYS**2 + P[YAW, YAW], 1.0)
    P[X, X] += 2.0 * SPEED_TIME * dt * share * c.unknown_speed**2
    P[Y, Y] += 2.0 * SPEED_TIME * dt * share * c.unknown_speed**2
    P[YAW, YAW] += 2.0 * SPEED_TIME * dt * c.unseen_yaw_rate**2


@compiled
def widen_start(state: State, reached_ns: int, c: Config) -> None:
    """What may have been driven otherwise than the first sample shows, from the state's stamp on."""
    P, start_ns = state.covariance, state.sample.stamp_ns
    before, after = (state.stamp_ns - start_ns) * 1e-9, (reached_ns - start_ns) * 1e-9
    grown = (after**3 - before**3) / (3.0 * SPEED_TIME)
    P[X, X] += grown * c.unknown_speed**2
    P[Y, Y] += grown * c.unknown_speed**2
    P[YAW, YAW] += grown * c.unknown_yaw_rate**2
