# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Motion along tilted ground: the sliding that gravity adds, and the horizontal part; compiled.

    k        downhill speed over track speed, per sine of the slope               1
    U        mean of the absolute track speeds                                    m/s
    φ, θ     roll, pitch; level: the record of ``attitude`` with the functions of them used here
    T        |D| of a turn that is not gentle                                     m/s

    v_x += (k U + 1.0 T) sin θ        v_y −= (k U + 0.35 T) sin φ cos θ

Tracks hold a machine on a slope by sliding. Along the tracks the force is the weight times sin θ (they slip
more uphill); across them it is the weight times sin φ (the machine crabs downhill, without a turn). Far below
the strength of the soil the shear, and so k, is equal in both directions; k grows near the strength. In a
turn all of the shear is mobilised, and the machine slides downhill at any heading. This sliding hardly
depends on the soil: both factors are measured on the shear truth at 15°, on sand, sandy loam and dry clay;
± 0.5. The turning behaviour changes with the direction on the slope: κ, η and x_I have process noise there.
Near the strength the tracks spin uphill and roll downhill: the larger k is, the less it holds in another
direction (``inflate_downhill_slip``). The horizontal motion is

    v_x cos θ + v_y sin φ sin θ,  v_y cos φ        and        ψ̇ = (q sin φ + r cos φ)/cos θ
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from trackslip_common.arrays import FloatArray
from trackslip_common.compiled import compiled
from trackslip_estimation.slip.models.model import DOWNHILL, YAW, X, Y
from trackslip_estimation.slip.models.speed import ROTATION_OFFSET, TURN_STATE_1, TURN_STATE_2

if TYPE_CHECKING:
    from trackslip_estimation.attitude.records import Level
    from trackslip_estimation.slip.config import Config
    from trackslip_estimation.slip.records import State

Twist = tuple[float, float, float]

_STEEP = 0.1  # sine of a slope on which a machine may slide
_GENTLE = 0.05  # sine of a slope on which k has half of its process noise
_SLIDE_WALK = 0.05  # 1/√s, random walk of k, as a share of k
_SLIDE_LAG = 0.5  # s, correlation time of the error of its speed after a change of the tracks'
_TILT_TIME = 10.0  # s, correlation time of the tilt error that turns its direction
_GENTLE_TURN = 0.1  # |D| over U at which T is |D|/2
_AHEAD, _ASIDE = 1.0, 0.35  # factors of T along x and y
_DIRECTION_CHANGE = 0.1  # change of the sine of the slope driven down at which k is inflated
_RELATIVE_INFLATION = 0.5  # standard deviation added, as a share of k, per change over the sine of the slope
# random walks of κ, η, x_I in turns, per sine of the slope: 1/√s, 1/√s, m/√s
_TURN_STATE_WALKS = 0.5, 0.75, 0.25


@compiled
def add_slide_velocity(
    x: FloatArray, twist: Twist, speeds: tuple[float, float], level: Level, c: Config
) -> Twist:
    """The twist with the sliding that gravity adds; ``speeds`` are those of the sprockets, rad/s."""
    if level.known == 0:
        return twist
    slide, T = x[DOWNHILL] * track_speed(speeds, c), turn_speed(speeds, c)
    ahead, aside = slide + _AHEAD * T, slide + _ASIDE * T
    return twist[0] + ahead * level.downhill_x, twist[1] + aside * level.downhill_y, twist[2]


@compiled
def add_slide_jacobian(J: FloatArray, speeds: tuple[float, float], level: Level, c: Config) -> None:
    """Set the derivatives by k in J (3, n), the derivative of the twist; in place."""
    if level.known == 1:
        J[0, DOWNHILL] = track_speed(speeds, c) * level.downhill_x
        J[1, DOWNHILL] = track_speed(speeds, c) * level.downhill_y


@compiled
def track_speed(speeds: tuple[float, float], c: Config) -> float:
    """U, m/s."""
    U: float = c.rolling_radius * (abs(speeds[0]) + abs(speeds[1])) / 2.0
    return U


@compiled
def is_on_slope(state: State) -> bool:
    """Whether the known slope is steep enough for the machine to slide."""
    level = state.attitude.level
    return bool(level.known == 1 and level.downhill_x**2 + level.downhill_y**2 > _STEEP**2)


@compiled
def turn_speed(speeds: tuple[float, float], c: Config) -> float:
    """T, m/s; nearly zero for a |D| within the rounding of the counts."""
    D, U = c.rolling_radius * abs(speeds[1] - speeds[0]), track_speed(speeds, c)
    return D * D / (D + _GENTLE_TURN * U) if D > 0.0 else 0.0


@compiled
def horizontal_part(twist: Twist, level: Level) -> Twist:
    """Speeds along the heading and to its left, m/s, and rate of the heading, rad/s."""
    if level.known == 0:
        return twist
    v_x, v_y, r = twist
    ahead = v_x * (1.0 + level.forward) + v_y * level.across
    return ahead, v_y * (1.0 + level.sideways), r * (1.0 + level.turn) + level.yaw_rate_offset


@compiled
def horizontal_jacobian(J: FloatArray, level: Level) -> None:
    """Turn J (3, n) of the twist into the derivative of ``horizontal_part``, in place."""
    if level.known == 0:
        return
    for k in range(J.shape[1]):
        J[0, k] = J[0, k] * (1.0 + level.forward) + J[1, k] * level.across
        J[1, k] *= 1.0 + level.sideways
        J[2, k] *= 1.0 + level.turn


@compiled
def inflate_downhill_slip(state: State) -> None:
    """Inflate the variance of k where the slope along the direction of travel changes; more for larger k."""
    V, level = state.speeds.left + state.speeds.right, state.attitude.level
    if V == 0.0 or level.known == 0:
        return
    down = math.copysign(level.downhill_x, V * level.downhill_x)
    change = abs(down - state.learned_downhill)
    if change < _DIRECTION_CHANGE:
        return
    steep = math.sqrt(level.downhill_x**2 + level.downhill_y**2 + _GENTLE**2)
    state.covariance[DOWNHILL, DOWNHILL] += (_RELATIVE_INFLATION * state.mean[DOWNHILL] * change / steep) ** 2
    state.learned_downhill = down


@compiled
def add_slope_noise(Q: FloatArray, dt: float, is_turning: bool, k: float, level: Level) -> None:
    """Add noise of the heading by errors of roll and gyro to Q, of k, and of κ, η and x_I in turns.

    The noise of k grows with k, as the speed of a slide changes by a share of it. It is scaled down on level
    ground, where k is not observable.
    """
    slope = level.downhill_x**2 + level.downhill_y**2
    if Q[DOWNHILL, DOWNHILL] > 0.0:  # not at standstill
        Q[DOWNHILL, DOWNHILL] += (_SLIDE_WALK * k) ** 2 * dt
    Q[DOWNHILL, DOWNHILL] *= slope / (slope + _GENTLE**2)
    Q[YAW, YAW] += level.turn_variance * dt
    if is_turning and level.known == 1:
        of_first, of_second, of_offset = _TURN_STATE_WALKS
        Q[TURN_STATE_1, TURN_STATE_1] += of_first**2 * slope * dt
        Q[TURN_STATE_2, TURN_STATE_2] += of_second**2 * slope * dt
        Q[ROTATION_OFFSET, ROTATION_OFFSET] += of_offset**2 * slope * dt


@compiled
def add_slide_noise(Q: FloatArray, heading: float, dt: float, state: State, c: Config) -> None:
    """Add the position error of a slide to Q: while it follows the tracks, and by errors of the tilt."""
    level, k, speeds = state.attitude.level, state.mean[DOWNHILL], state.speeds
    change = k * c.rolling_radius * state.motion.departure
    cos, sin = math.cos(heading), math.sin(heading)
    east = change * (cos * level.downhill_x - sin * level.downhill_y)
    north = change * (sin * level.downhill_x + cos * level.downhill_y)
    squared_time = 2.0 * _SLIDE_LAG * dt
    per_slope = k * track_speed((speeds.left, speeds.right), c)
    by_tilt = 2.0 * _TILT_TIME * dt * per_slope * per_slope * level.lean_variance
    Q[X, X] += squared_time * east * east + by_tilt
    Q[Y, Y] += squared_time * north * north + by_tilt
    Q[X, Y] += squared_time * east * north
    Q[Y, X] += squared_time * east * north
