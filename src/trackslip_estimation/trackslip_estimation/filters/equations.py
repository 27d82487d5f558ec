# SPDX-License-Identifier: Apache-2.0
"""The non-linear functions of every model and their Jacobians, as the filters call them, compiled.

    x          state of the model that c.model names                 (n,)
    f, F       where the state is after dt seconds, its Jacobian     (n,), (n, n)
    Q          process noise of a step                               (n, n)
    h, H       predicted measurement of one kind, its Jacobian       (m,), (m, n)
    R          covariance of that measurement                        (m, m)
    ω_L, ω_R   sprocket speeds ``left`` and ``right``                rad/s
    c          ``model.CONSTANTS``

Noise densities are in continuous time, so that splitting a step does not change what it adds.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trackslip_estimation.compiled import compiled
from trackslip_estimation.filters import icr_model, slip_model, speed_model, turning_model
from trackslip_estimation.filters.linear_algebra import sandwich, times, wrap
from trackslip_estimation.filters.model import (
    FREE_SLIPS,
    FULL_POSE,
    POSITION,
    SPROCKETS,
    TURNING,
    YAW,
    YAW_RATE,
    X,
    Y,
)

FloatArray = NDArray[np.float64]


@compiled
def twist(x: FloatArray, left: float, right: float, c: Any) -> tuple[float, float, float]:
    """v_x m/s, v_y m/s, yaw rate rad/s of C."""
    if c.model == FREE_SLIPS:
        return slip_model.twist(x, left, right, c)
    return speed_model.twist(x)


@compiled
def twist_jacobian(x: FloatArray, left: float, right: float, c: Any) -> FloatArray:
    """(3, n) derivative of ``twist`` by the state."""
    if c.model == FREE_SLIPS:
        return slip_model.twist_jacobian(x, left, right, c)
    return speed_model.twist_jacobian(x)


@compiled
def move(x: FloatArray, left: float, right: float, dt: float, c: Any) -> FloatArray:
    """f: the heading halfway through the step turns the velocity into the site frame."""
    v_x, v_y, rate = twist(x, left, right, c)
    halfway = x[YAW] + rate * dt / 2.0
    cos, sin = math.cos(halfway), math.sin(halfway)
    moved = x.copy()
    moved[X] += (v_x * cos - v_y * sin) * dt
    moved[Y] += (v_x * sin + v_y * cos) * dt
    moved[YAW] = wrap(x[YAW] + rate * dt)
    return moved


@compiled
def _pose_by_twist(x: FloatArray, left: float, right: float, dt: float, c: Any) -> FloatArray:
    """(3, 3) derivative of the pose after the step by the twist."""
    v_x, v_y, rate = twist(x, left, right, c)
    halfway = x[YAW] + rate * dt / 2.0
    cos, sin = math.cos(halfway), math.sin(halfway)
    east, north = v_x * cos - v_y * sin, v_x * sin + v_y * cos
    return np.array(
        (
            (cos * dt, -sin * dt, -north * dt * dt / 2.0),
            (sin * dt, cos * dt, east * dt * dt / 2.0),
            (0.0, 0.0, dt),
        )
    )


@compiled
def transition(x: FloatArray, left: float, right: float, dt: float, c: Any) -> FloatArray:
    """F."""
    F = np.eye(x.size)
    F[X : YAW + 1] += times(_pose_by_twist(x, left, right, dt, c), twist_jacobian(x, left, right, c))
    moved = move(x, left, right, dt, c)
    F[X, YAW] -= moved[Y] - x[Y]
    F[Y, YAW] += moved[X] - x[X]
    return F


@compiled
def process_noise(
    x: FloatArray, left: float, right: float, dt: float, motion: int, changing: int, c: Any
) -> FloatArray:
    """Q: each state's walk, and for sprocket speeds that are inputs their noise (3.21)."""
    n = x.size
    Q = np.zeros((n, n))
    for i in range(n):
        Q[i, i] = c.walk[motion, changing, i] * dt
    if c.model == FREE_SLIPS and dt > 0.0:
        G = times(_pose_by_twist(x, left, right, dt, c), slip_model.twist_by_speed(x, c))
        speeds = np.array((((c.encoder * left) ** 2 / dt, 0.0), (0.0, (c.encoder * right) ** 2 / dt)))
        Q[X : YAW + 1, X : YAW + 1] += sandwich(G, speeds)
    return Q


@compiled
def expected(kind: int, x: FloatArray, left: float, right: float, c: Any) -> FloatArray:
    """h."""
    if kind == YAW_RATE:
        return np.array((twist(x, left, right, c)[2] + x[-1],))
    if kind == POSITION:
        return x[X : Y + 1].copy()
    if kind == FULL_POSE:
        return x[X : YAW + 1].copy()
    if c.model == TURNING:
        return turning_model.sprockets(x, left, right, c)
    return icr_model.sprockets(x, left, right, c)


@compiled
def jacobian(kind: int, x: FloatArray, left: float, right: float, c: Any) -> FloatArray:
    """H."""
    if kind == YAW_RATE:
        H = np.ascontiguousarray(twist_jacobian(x, left, right, c)[2:])
        H[0, -1] = 1.0
        return H
    if kind == POSITION:
        return np.eye(2, x.size)
    if kind == FULL_POSE:
        return np.eye(3, x.size)
    if c.model == TURNING:
        return turning_model.sprockets_jacobian(left, right, c)
    return icr_model.sprockets_jacobian(x, left, right, c)


@compiled
def noise(
    kind: int, R: FloatArray, left: float, right: float, stretch: float, counted: bool, c: Any
) -> FloatArray:
    """R with what the sprockets add: over ``stretch`` s, their positions ``counted`` in whole steps."""
    rounding = 0.0
    if counted and stretch > 0.0:  # of one track's speed, differenced from two rounded counts, (m/s)²
        rounding = 2.0 * (c.rolling_radius * c.encoder_resolution / stretch) ** 2 / 12.0
    if kind == SPROCKETS:
        if c.model == TURNING:
            return turning_model.sprockets_noise(left, right, stretch, rounding, c)
        return icr_model.sprockets_noise(left, right, stretch, rounding, c)
    if kind == YAW_RATE and c.model == FREE_SLIPS:  # φ̇ as predicted comes from the sprockets
        R = R + 2.0 * rounding / c.tread**2
    return R


@compiled
def outputs(
    x: FloatArray, P: FloatArray, left: float, right: float, c: Any
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Twist and slips, (3,) each, with their covariances, (3, 3) each: ``model.Outputs``."""
    if c.model == FREE_SLIPS:
        slips, S = slip_model.slips(x), slip_model.slips_jacobian()
    else:
        slips = speed_model.slips(x, left, right, c)
        S = speed_model.slips_jacobian(x, left, right, c)
    v_x, v_y, rate = twist(x, left, right, c)
    J = twist_jacobian(x, left, right, c)
    return np.array((v_x, v_y, rate)), sandwich(J, P), slips, sandwich(S, P)
