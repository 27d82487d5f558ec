# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Lever arms of sensors: position and velocity of a sensor relative to C; compiled.

    l, a       lever arm of a sensor and of the swing axis in base_link, at σ = 0                           m
    φ, σ, σ̇    heading of the machine, angle of the upper structure, its rate               rad, rad, rad/s
    p          horizontal lever arm along the heading and to its left, at the tilt of the machine: of l, or on
               the upper structure of a + R(σ) (l − a)                                      (2,), m
    p'         derivative by σ; zero below                                                  (2,), m
    R(φ) p     from C to the sensor, east and north                                         (2,), m
    x, P       mean and covariance of the state; c: record of ``config.CONFIG``

A sensor on the upper structure ("above") measures φ + σ, its gyro ω + σ̇.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_common.compiled import compiled
from trackslip_estimation.kalman.linear_algebra import wrap
from trackslip_estimation.kalman.single_state import add_state, limit_stddev
from trackslip_estimation.slip.events import ANY_HEADING
from trackslip_estimation.slip.models.dispatch import has_velocity_errors, horizontal_twist
from trackslip_estimation.slip.models.model import SWING, SWING_RATE, YAW, X, Y
from trackslip_estimation.slip.models.speed import COMMON_SLIP

if TYPE_CHECKING:
    from trackslip_estimation.attitude.records import ImuSample, Level
    from trackslip_estimation.slip.config import Config
    from trackslip_estimation.slip.records import State

UNKNOWN_HEADING = 1.0  # rad, standard deviation beyond which a heading is split into ``events.HEADINGS``
_ROUGH_HEADING = 0.2  # rad, standard deviation; 0.28 within a sector
_STUCK_STDDEVS = 2.0  # standard deviations of i₀ within which it is 1
_UNKNOWN_SWING = 0.5  # rad, standard deviation of σ beyond which σ counts as unknown
SwungArm = tuple[float, float, float, float]


class Lever(NamedTuple):
    """From C to a sensor."""

    east: float  # m
    north: float  # m
    jacobian: FloatArray  # (2, n) derivative of both by the state


@compiled
def is_heading_unknown(state: State) -> bool:
    """Whether the heading is unknown, and not split into sectors yet: the tracks have not moved."""
    return bool(not state.is_sector and state.covariance[YAW, YAW] > UNKNOWN_HEADING**2)


@compiled
def is_heading_undetermined(state: State) -> bool:
    """Whether the heading is unknown, or hardly known better than to a sector of the circle."""
    is_rough = state.is_sector and state.covariance[YAW, YAW] > _ROUGH_HEADING**2
    return bool(is_heading_unknown(state) or is_rough)


@compiled
def is_swing_unknown(P: FloatArray) -> bool:
    """Whether the angle of the upper structure is unknown."""
    return bool(P[SWING, SWING] > _UNKNOWN_SWING**2)


@compiled
def is_sum_known(P: FloatArray) -> bool:
    """Whether φ + σ is known better than σ: sensors on the upper structure measure the sum."""
    return bool(P[YAW, YAW] + 2.0 * P[YAW, SWING] < 0.0)


@compiled
def is_heading_unobservable(state: State, c: Config) -> bool:
    """Whether fixes do not show an uncertain heading: the machine does not move, though its tracks may."""
    return bool(is_heading_unknown(state) or (state.is_sector and is_direction_unknown(state, c)))


@compiled
def is_direction_unknown(state: State, c: Config) -> bool:
    """Whether both tracks slip by 100 %, as far as is known: the machine may move in either direction."""
    if not has_velocity_errors(c):
        return False
    ahead, variance = 1.0 - state.mean[COMMON_SLIP], state.covariance[COMMON_SLIP, COMMON_SLIP]
    return bool(ahead * ahead < _STUCK_STDDEVS**2 * variance)


@compiled
def unknown_heading_variance(state: State, source: int, c: Config) -> float:
    """Variance of C by axis, m², about the position of a sensor, where linearisation by the heading fails."""
    if not is_heading_unknown(state):
        return 0.0
    x, y, _, _ = swung_lever_arm(state.mean[SWING], source, c)
    return float(x * x + y * y)


@compiled
def unknown_swing_variance(P: FloatArray, source: int, c: Config) -> float:
    """Variance of a sensor's position by axis, m², where σ is unknown and linearisation fails; else 0."""
    x, y = c.levers[source, 0] - c.swing_axis[0], c.levers[source, 1] - c.swing_axis[1]
    return float(x * x + y * y) if is_swing_unknown(P) else 0.0


@compiled
def swung_lever_arm(swing: float, source: int, c: Config) -> SwungArm:
    """x and y of a sensor's lever arm in base_link, and their derivatives by σ."""
    x, y = c.levers[source, 0], c.levers[source, 1]
    return _swung_point(x, y, swing, c) if c.above[source] == 1 else (x, y, 0.0, 0.0)


@compiled
def _swung_point(x: float, y: float, swing: float, c: Config) -> SwungArm:
    """x and y in base_link of a point above, and their derivatives by σ; ``x``, ``y``: at σ = 0."""
    cos, sin, ahead, left = np.cos(swing), np.sin(swing), x - c.swing_axis[0], y - c.swing_axis[1]
    by_x, by_y = -sin * ahead - cos * left, cos * ahead - sin * left
    return c.swing_axis[0] + by_y, c.swing_axis[1] - by_x, by_x, by_y


@compiled
def horizontal_lever_arm(level: Level, swing: float, source: int, c: Config) -> SwungArm:
    """p and p'; ``level``: tilt of the machine, record of ``attitude``."""
    z = c.levers[source, 2]
    x, y, by_x, by_y = swung_lever_arm(swing, source, c)
    ahead = x * (1.0 + level.forward) + y * level.across + z * level.lean_x
    by_ahead = by_x * (1.0 + level.forward) + by_y * level.across
    left = y * (1.0 + level.sideways) + z * level.lean_y
    return ahead, left, by_ahead, by_y * (1.0 + level.sideways)


@compiled
def lever(x: FloatArray, level: Level, source: int, c: Config) -> Lever:
    """R(φ) p with the correlated tilt error, and its derivatives.

    The error of an IMU is along the machine's axes; a slope that no IMU measures is along those of the site.
    """
    above, J, cos, sin = c.above[source] == 1, np.zeros((2, x.size)), np.cos(x[YAW]), np.sin(x[YAW])
    ahead, left, by_ahead, by_left = horizontal_lever_arm(level, x[SWING] if above else 0.0, source, c)
    slope_east = slope_north = 0.0
    if above:
        J[X, SWING], J[Y, SWING] = cos * by_ahead - sin * by_left, sin * by_ahead + cos * by_left
    if c.lean_errors >= 0 and c.levers[source, 2] != 0.0:
        e, stddev = c.lean_errors, c.levers[source, 2] * c.lean_stddevs[level.known]
        if level.known == 0:
            slope_east, slope_north = stddev * x[e], stddev * x[e + 1]
            J[X, e] = J[Y, e + 1] = stddev
        else:
            ahead += stddev * x[e]
            left += stddev * x[e + 1]
            J[X, e], J[Y, e] = cos * stddev, sin * stddev
            J[X, e + 1], J[Y, e + 1] = -sin * stddev, cos * stddev
    east, north = cos * ahead - sin * left, sin * ahead + cos * left
    J[X, YAW], J[Y, YAW] = -north, east
    return Lever(east + slope_east, north + slope_north, J)


@compiled
def to_sensor(x: FloatArray, P: FloatArray, level: Level, source: int, sign: float, c: Config) -> None:
    """Transform the pose of base_link into that of a sensor (``sign`` 1), or back (−1); in place."""
    above = c.above[source] == 1
    if above and sign < 0.0:
        _turn_heading(x, P, level, sign)
    to_sensor_position(x, P, level, source, sign, c)
    if above and sign > 0.0:
        _turn_heading(x, P, level, sign)


@compiled
def to_sensor_position(
    x: FloatArray, P: FloatArray, level: Level, source: int, sign: float, c: Config
) -> None:
    """Transform the position of base_link into that of a sensor (``sign`` 1), or back (−1); in place."""
    arm = lever(x, level, source, c)
    x[X] += sign * arm.east
    x[Y] += sign * arm.north
    _transform_position_covariance(P, arm.jacobian, sign)


@compiled
def decouple_unknown_angles(state: State, source: int, c: Config) -> None:
    """Set the covariance of an unobservable heading and the position of a sensor to 0, in place.

    Linearised at any heading, each error of the tilt would turn the machine about a high antenna, and each
    error of a slip of 100 % would move it along that heading. An unknown swing angle is decoupled too, and
    its variance limited to that of a uniform angle.
    """
    x, P, level = state.mean[: c.size], state.covariance[:], state.attitude.level
    is_unobservable, above = is_heading_unobservable(state, c), c.above[source] == 1
    if not (is_unobservable or P[SWING, SWING] > ANY_HEADING**2):
        return
    to_sensor_position(x, P, level, source, 1.0, c)
    if is_unobservable:
        P[YAW, :YAW] = P[:YAW, YAW] = 0.0
    if is_unobservable and above and is_swing_unknown(P):
        P[SWING, :YAW] = P[:YAW, SWING] = 0.0
    _limit_swing(P)
    to_sensor_position(x, P, level, source, -1.0, c)


@compiled
def _limit_swing(P: FloatArray) -> None:
    """Limit the variance of σ to that of a uniform angle; a known sum φ + σ stays; in place."""
    keeps_sum = is_sum_known(P)
    if keeps_sum:
        add_state(P, YAW, SWING, 1.0)
    limit_stddev(P, SWING, ANY_HEADING)
    if keeps_sum:
        add_state(P, YAW, SWING, -1.0)


@compiled
def turn_about_sensor(
    x: FloatArray, P: FloatArray, before: FloatArray, arm: Lever, level: Level, source: int, c: Config
) -> None:
    """Add the terms beyond first order to a correction, so that C turns about the sensor; in place.

    ``before``, ``arm``: state and lever before the correction. The measured position of the sensor stays,
    however far heading or upper structure turn.
    """
    after = lever(x, level, source, c)
    x[X] += arm.east - after.east
    x[Y] += arm.north - after.north
    for k in range(YAW, x.size):
        x[X] += arm.jacobian[X, k] * (x[k] - before[k])
        x[Y] += arm.jacobian[Y, k] * (x[k] - before[k])
    _transform_position_covariance(P, arm.jacobian - after.jacobian, 1.0)


@compiled
def _transform_position_covariance(P: FloatArray, J: FloatArray, sign: float) -> None:
    """Transform P for x and y that gain ``J`` (2, n) times the other states; in place."""
    for k in range(YAW, J.shape[1]):
        for axis in (X, Y):
            if J[axis, k] != 0.0:
                add_state(P, axis, k, sign * J[axis, k])


@compiled
def _turn_heading(x: FloatArray, P: FloatArray, level: Level, sign: float) -> None:
    """Transform φ into the horizontal φ + σ, or back; in place."""
    x[YAW] = wrap(x[YAW] + sign * horizontal_direction(x[SWING], level))
    add_state(P, YAW, SWING, sign)


@compiled
def unmodelled_tilt_variance(level: Level, source: int, c: Config) -> float:
    """Variance of a sensor's position by axis, m², by the part of the tilt error that is no state."""
    variance = max(level.lean_variance - c.lean_stddevs[1] ** 2, 0.0)
    return float(c.levers[source, 2] ** 2 * variance)


@compiled
def swing_lever(imu: ImuSample, swing_rate: float, c: Config) -> None:
    """Transform lever arm and velocity in the record of an IMU above by σ and σ̇; in place."""
    imu.lever[0], imu.lever[1], by_x, by_y = _swung_point(imu.lever[0], imu.lever[1], imu.turn, c)
    imu.velocity[0] += swing_rate * by_x
    imu.velocity[1] += swing_rate * by_y


@compiled
def horizontal_direction(angle: float, level: Level) -> float:
    """Horizontal direction, relative to the heading, of a vector along ``angle`` in base_link, rad."""
    if level.known == 0:
        return angle
    cos, sin = np.cos(angle), np.sin(angle)
    return float(np.arctan2(sin * (1.0 + level.sideways), cos * (1.0 + level.forward) + sin * level.across))


@compiled
def stamp_shift(state: State, source: int, c: Config) -> tuple[float, float, float]:
    """Change of a sensor's pose within its σ_t; zero while the speed is unknown."""
    seconds = 0.0 if state.coasting else c.stamp_errors[source]
    v_x, v_y, rate = horizontal_twist(state.mean[:], state.speeds.left, state.speeds.right, state, c)
    arm = horizontal_lever_arm(state.attitude.level, state.mean[SWING], source, c)
    v_x -= rate * arm[1]
    v_y += rate * arm[0]
    if c.above[source] == 1:
        v_x += state.mean[SWING_RATE] * arm[2]
        v_y += state.mean[SWING_RATE] * arm[3]
        rate += state.mean[SWING_RATE]
    cos, sin = np.cos(state.mean[YAW]), np.sin(state.mean[YAW])
    return (cos * v_x - sin * v_y) * seconds, (sin * v_x + cos * v_y) * seconds, rate * seconds
