# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Where sensors sit, and what the machine's motion does to them: the one place that turns levers; compiled.

    l, a       place of a sensor and of the swing axis in base_link, the upper structure looking forward   m
    φ, σ, σ̇    heading of the machine, angle of the upper structure, its rate               rad, rad, rad/s
    p          place of the sensor beside C along the heading and to its left, seen from above, as the machine
               leans: l, or above a + R(σ) (l − a)                                          (2,), m
    p'         its derivative by σ; zero below                                              (2,), m
    x, P       mean and covariance of the state; c: record of ``config.CONFIG``

A sensor above sees φ + σ, its gyro ω + σ̇. Instead of another observation for each kind of sensor the state
is put in the coordinates of the sensor, and back after the update: there every sensor is at base_link.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from trackslip_common.compiled import compiled
from trackslip_estimation.kalman.linear_algebra import wrap
from trackslip_estimation.slip.models.dispatch import horizontal_twist
from trackslip_estimation.slip.models.model import FIX_DELAY, SWING, SWING_RATE, YAW, X, Y
from trackslip_estimation.slip.models.speed import YAW_RATE_ERROR

FloatArray = NDArray[np.float64]
UNKNOWN_SWING = 0.5  # rad, standard deviation of σ beyond which there is none
Place = tuple[float, float, float, float]


@compiled
def arm_of(source: int, c: Any) -> tuple[float, float]:
    """l − a of a sensor above, from the swing axis to it, seen from above."""
    return c.levers[source, 0] - c.swing_axis[0], c.levers[source, 1] - c.swing_axis[1]


@compiled
def unknown_arm(P: FloatArray, source: int, c: Any) -> float:
    """Variance of its place along an axis, m², where nobody knows σ: no derivative goes round a circle."""
    x, y = arm_of(source, c)
    known = P[SWING, SWING] <= UNKNOWN_SWING**2
    return 0.0 if known else float(x * x + y * y)


@compiled
def swung_place(swing: float, source: int, c: Any) -> Place:
    """x and y of its place in base_link, and their derivatives by σ."""
    x, y = c.levers[source, 0], c.levers[source, 1]
    return _swung(x, y, swing, c) if c.above[source] == 1 else (x, y, 0.0, 0.0)


@compiled
def _swung(x: float, y: float, swing: float, c: Any) -> Place:
    """x and y in base_link of a place above, and their derivatives by σ; ``x``, ``y``: looking forward."""
    cos, sin, ahead, left = np.cos(swing), np.sin(swing), x - c.swing_axis[0], y - c.swing_axis[1]
    by_x, by_y = -sin * ahead - cos * left, cos * ahead - sin * left
    return c.swing_axis[0] + by_y, c.swing_axis[1] - by_x, by_x, by_y


@compiled
def sensor_place(level: Any, swing: float, source: int, c: Any) -> Place:
    """p and p'; ``level``: the record of ``attitude`` that says how the machine leans."""
    z = c.levers[source, 2]
    x, y, by_x, by_y = swung_place(swing, source, c)
    ahead = x * (1.0 + level.forward) + y * level.across + z * level.lean_x
    by_ahead = by_x * (1.0 + level.forward) + by_y * level.across
    left = y * (1.0 + level.sideways) + z * level.lean_y
    return ahead, left, by_ahead, by_y * (1.0 + level.sideways)


@compiled
def swing_lever(imu: Any, swing_rate: float, c: Any) -> None:
    """Place and velocity of an IMU above, into its record, which has σ and what they would be below."""
    imu.lever[0], imu.lever[1], by_x, by_y = _swung(imu.lever[0], imu.lever[1], imu.turn, c)
    imu.velocity[0] += swing_rate * by_x
    imu.velocity[1] += swing_rate * by_y


@compiled
def seen_from_above(angle: float, level: Any) -> float:
    """Direction against the heading of what points along ``angle`` in base_link, rad."""
    if level.tilted == 0:
        return angle
    cos, sin = np.cos(angle), np.sin(angle)
    return float(np.arctan2(sin * (1.0 + level.sideways), cos * (1.0 + level.forward) + sin * level.across))


@compiled
def compass_offset(state: Any, source: int, c: Any) -> float:
    """Direction that a compass shows, from that of the machine, seen from above, rad."""
    offset = c.heading_offset[source]
    if c.above[source] == 1:
        offset += state.mean[SWING]
    return seen_from_above(offset, state.attitude.level)


@compiled
def to_sensor(x: FloatArray, P: FloatArray, level: Any, source: int, sign: float, c: Any) -> None:
    """The state with a sensor's pose for that of base_link (``sign`` 1), or back again (−1); in place."""
    above = c.above[source] == 1
    if above and sign < 0.0:
        _turn_heading(x, P, level, sign)
    if c.lean_errors >= 0 and c.levers[source, 2] != 0.0:
        _lean(x, P, sign * c.levers[source, 2] * c.lean_stddev, c.lean_errors)
    move_place(x, P, sensor_place(level, x[SWING] if above else 0.0, source, c), sign)
    if above and sign > 0.0:
        _turn_heading(x, P, level, sign)


@compiled
def other_lean(level: Any, source: int, c: Any) -> float:
    """Variance of a sensor's place along an axis, m², as the tilt errs by more than its lasting error."""
    more = max(level.lean_variance - c.lean_stddev**2, 0.0)
    return float(c.levers[source, 2] ** 2 * more)


@compiled
def _lean(x: FloatArray, P: FloatArray, stddev: float, errors: int) -> None:
    """A place with what it is off by ahead and to the left: ``stddev`` m times the two at ``errors``."""
    cos, sin = np.cos(x[YAW]) * stddev, np.sin(x[YAW]) * stddev
    east, north = cos * x[errors] - sin * x[errors + 1], sin * x[errors] + cos * x[errors + 1]
    x[X] += east
    x[Y] += north
    add(P, X, YAW, -north)
    add(P, Y, YAW, east)
    add(P, X, errors, cos)
    add(P, X, errors + 1, -sin)
    add(P, Y, errors, sin)
    add(P, Y, errors + 1, cos)


@compiled
def move_place(x: FloatArray, P: FloatArray, place: Place, sign: float) -> None:
    """The state with the place p (``place``: p, p') for that of base_link, or back again; in place."""
    if place[0] == 0.0 and place[1] == 0.0 and place[2] == 0.0 and place[3] == 0.0:
        return
    cos, sin = np.cos(x[YAW]), np.sin(x[YAW])
    east = sign * (cos * place[0] - sin * place[1])
    north = sign * (sin * place[0] + cos * place[1])
    x[X] += east
    x[Y] += north
    for j in range(x.size):
        P[X, j] -= north * P[YAW, j]
        P[Y, j] += east * P[YAW, j]
    for i in range(x.size):
        P[i, X] -= north * P[i, YAW]
        P[i, Y] += east * P[i, YAW]
    if place[2] == 0.0 and place[3] == 0.0:
        return
    east = sign * (cos * place[2] - sin * place[3])
    north = sign * (sin * place[2] + cos * place[3])
    for j in range(x.size):
        P[X, j] += east * P[SWING, j]
        P[Y, j] += north * P[SWING, j]
    for i in range(x.size):
        P[i, X] += east * P[i, SWING]
        P[i, Y] += north * P[i, SWING]


@compiled
def _turn_heading(x: FloatArray, P: FloatArray, level: Any, sign: float) -> None:
    """φ + σ, seen from above, for φ, or back again; in place."""
    x[YAW] = wrap(x[YAW] + sign * seen_from_above(x[SWING], level))
    add(P, YAW, SWING, sign)


@compiled
def turn_heading(x: FloatArray, P: FloatArray, source: int, sign: float, c: Any) -> None:
    """φ + σ for φ where a compass sits above, or back again; in place."""
    if c.above[source] == 1:
        x[YAW] = wrap(x[YAW] + sign * x[SWING])
        add(P, YAW, SWING, sign)


@compiled
def to_gyro(x: FloatArray, P: FloatArray, sign: float) -> None:
    """The state with the yaw rate of a gyro above for that of the machine, or back again; in place."""
    x[YAW_RATE_ERROR] += sign * x[SWING_RATE]
    add(P, YAW_RATE_ERROR, SWING_RATE, sign)


@compiled
def widen_swing_rate(P: FloatArray, variance: float) -> None:
    """σ̇ is less well known, in the coordinates of a gyro above."""
    for i in (YAW_RATE_ERROR, SWING_RATE):
        for j in (YAW_RATE_ERROR, SWING_RATE):
            P[i, j] += variance


@compiled
def add(P: FloatArray, to: int, what: int, factor: float) -> None:
    """P, where to a number of the state another one is added, times a factor."""
    for j in range(P.shape[1]):
        P[to, j] += factor * P[what, j]
    for i in range(P.shape[0]):
        P[i, to] += factor * P[i, what]


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
    v_x, v_y, rate = horizontal_twist(state.mean[:], state.speeds.left, state.speeds.right, state, c)
    place = sensor_place(state.attitude.level, state.mean[SWING], source, c)
    v_x -= rate * place[1]
    v_y += rate * place[0]
    if c.above[source] == 1:
        v_x += state.mean[SWING_RATE] * place[2]
        v_y += state.mean[SWING_RATE] * place[3]
        rate += state.mean[SWING_RATE]
    cos, sin = np.cos(state.mean[YAW]), np.sin(state.mean[YAW])
    return (cos * v_x - sin * v_y) * seconds, (sin * v_x + cos * v_y) * seconds, rate * seconds
