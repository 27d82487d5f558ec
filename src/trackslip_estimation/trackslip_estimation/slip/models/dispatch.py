# SPDX-License-Identifier: Apache-2.0
"""The non-linear functions of every model and their Jacobians, as the filters call them, compiled.

    x          state of the model that c.model names                 (n,)
    f, F       where the state is after dt seconds, its Jacobian     (n,), (n, n)
    Q          process noise of a step                               (n, n)
    h, H       predicted measurement of one kind, its Jacobian       (m,), (m, n)
    R          covariance of that measurement                        (m, m)
    ω_L, ω_R   sprocket speeds ``left`` and ``right``                rad/s
    d          their ``departure`` from their recent mean            rad/s
    c          ``model.CONSTANTS``

Noise densities are in continuous time, so that splitting a step does not change what it adds.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trackslip_common.compiled import compiled
from trackslip_estimation.kalman.linear_algebra import sandwich, times, wrap
from trackslip_estimation.slip.models import free_slips as slip_model
from trackslip_estimation.slip.models import icr as icr_model
from trackslip_estimation.slip.models import speed as speed_model
from trackslip_estimation.slip.models import turning as turning_model
from trackslip_estimation.slip.models.model import (
    FREE_SLIPS,
    SLIPS,
    TURNING,
    YAW,
    YAW_RATE,
    X,
    Y,
)
from trackslip_estimation.slip.models.speed import RATE_MISFIT, SPEED_MISFIT

FloatArray = NDArray[np.float64]

MISFITS = slice(SPEED_MISFIT, RATE_MISFIT + 1)


@compiled
def twist(x: FloatArray, left: float, right: float, c: Any) -> tuple[float, float, float]:
    """v_x m/s, v_y m/s, yaw rate rad/s of C."""
    if c.model == FREE_SLIPS:
        return slip_model.twist(x, left, right, c)
    if c.model == TURNING:
        v, rate = turning_model.equations(x, left, right, c)
    else:
        v, rate = icr_model.equations(x, left, right, c)
    return speed_model.twist(x, v, rate)


@compiled
def twist_jacobian(x: FloatArray, left: float, right: float, c: Any) -> FloatArray:
    """(3, n) derivative of ``twist`` by the state."""
    if c.model == FREE_SLIPS:
        return slip_model.twist_jacobian(x, left, right, c)
    if c.model == TURNING:
        rate, J = (
            turning_model.equations(x, left, right, c)[1],
            turning_model.equations_jacobian(left, right, c),
        )
    else:
        rate, J = icr_model.equations(x, left, right, c)[1], icr_model.equations_jacobian(x, left, right, c)
    return speed_model.twist_jacobian(x, rate, J)


@compiled
def _meanwhile(x: FloatArray, dt: float, motion: int, c: Any) -> FloatArray:
    """The state with its misfits as they are on average over the step."""
    mean = x.copy()
    if c.model != FREE_SLIPS:
        mean[MISFITS] *= speed_model.persistence(dt, motion, c)[1]
    return mean


@compiled
def move(x: FloatArray, left: float, right: float, dt: float, motion: int, c: Any) -> FloatArray:
    """f: the heading halfway through the step turns the velocity into the site frame."""
    v_x, v_y, rate = twist(_meanwhile(x, dt, motion, c), left, right, c)
    halfway = x[YAW] + rate * dt / 2.0
    cos, sin = math.cos(halfway), math.sin(halfway)
    moved = x.copy()
    moved[X] += (v_x * cos - v_y * sin) * dt
    moved[Y] += (v_x * sin + v_y * cos) * dt
    moved[YAW] = wrap(x[YAW] + rate * dt)
    if c.model != FREE_SLIPS:
        moved[MISFITS] *= speed_model.persistence(dt, motion, c)[0]
    return moved


@compiled
def forward(
    x: FloatArray,
    P: FloatArray,
    left: float,
    right: float,
    dt: float,
    motion: int,
    changing: int,
    departure: float,
    c: Any,
) -> tuple[FloatArray, FloatArray]:
    """F and Q of a step, worked out together.

    Q has each state's walk and the misfits', and for sprocket speeds that are inputs their noise (3.21).
    P, what is known of x, or zeros, matters where Q depends on x.
    """
    n = x.size
    F, Q = np.eye(n), np.zeros((n, n))
    for i in range(n):
        Q[i, i] = c.walk[motion, changing, i] * dt
    if dt <= 0.0:
        return F, Q
    mean = _meanwhile(x, dt, motion, c)
    v_x, v_y, rate = twist(mean, left, right, c)
    halfway = x[YAW] + rate * dt / 2.0
    cos, sin = math.cos(halfway) * dt, math.sin(halfway) * dt
    east, north = v_x * cos - v_y * sin, v_x * sin + v_y * cos
    way = np.array(((cos, -sin, -north * dt / 2.0), (sin, cos, east * dt / 2.0), (0.0, 0.0, dt)))
    G = times(way, twist_jacobian(mean, left, right, c))  # pose by state, through the mean twist
    F[X : YAW + 1] += G
    F[X, YAW] -= north
    F[Y, YAW] += east
    if c.model == FREE_SLIPS:
        S = times(way, slip_model.twist_by_speed(x, c))
        speeds = np.array((((c.encoder * left) ** 2 / dt, 0.0), (0.0, (c.encoder * right) ** 2 / dt)))
        Q[X : YAW + 1, X : YAW + 1] += sandwich(S, speeds)
        return F, Q
    left_over, share = speed_model.persistence(dt, motion, c)
    meanwhile, both, after = speed_model.misfit_growth(dt, motion, c)
    variances = speed_model.misfit_variances(x, P, left, right, motion, departure, c)
    for k in range(SPEED_MISFIT, RATE_MISFIT + 1):
        own = variances[k - SPEED_MISFIT]
        for i in range(YAW + 1):
            for j in range(YAW + 1):
                Q[i, j] += G[i, k] * G[j, k] * own * meanwhile
            Q[i, k] = Q[k, i] = G[i, k] * own * both
            F[i, k] = G[i, k] * share
        Q[k, k] += own * after
        F[k, k] = left_over
    return F, Q


@compiled
def transition(x: FloatArray, left: float, right: float, dt: float, motion: int, c: Any) -> FloatArray:
    """F."""
    return forward(x, np.zeros((x.size, x.size)), left, right, dt, motion, 0, 0.0, c)[0]


@compiled
def process_noise(
    x: FloatArray,
    P: FloatArray,
    left: float,
    right: float,
    dt: float,
    motion: int,
    changing: int,
    departure: float,
    c: Any,
) -> FloatArray:
    """Q."""
    return forward(x, P, left, right, dt, motion, changing, departure, c)[1]


@compiled
def size(kind: int) -> int:
    """m: how many numbers a measurement of one kind has; all kinds but one are numbered so."""
    return 2 if kind == SLIPS else kind


@compiled
def expected(kind: int, x: FloatArray, left: float, right: float, c: Any) -> FloatArray:
    """h."""
    if kind == YAW_RATE:
        return np.array((twist(x, left, right, c)[2] + x[-1],))
    if kind == SLIPS:
        return _told(x, left, right, c)[3:5].copy()
    return x[X : X + size(kind)].copy()


@compiled
def jacobian(kind: int, x: FloatArray, left: float, right: float, c: Any) -> FloatArray:
    """H."""
    if kind == YAW_RATE:
        H = np.ascontiguousarray(twist_jacobian(x, left, right, c)[2:])
        H[0, -1] = 1.0
        return H
    if kind == SLIPS:
        J = twist_jacobian(x, left, right, c)
        return slips_jacobian(_told(x, left, right, c), J, left, right, c)[:2].copy()
    return np.eye(size(kind), x.size)


@compiled
def _rounding(stretch: float, counted: bool, c: Any) -> float:
    """Standard deviation of a sprocket speed differenced from two rounded counts, rad/s."""
    if counted and stretch > 0.0:
        return math.sqrt(2.0 / 12.0) * float(c.encoder_resolution) / stretch
    return 0.0


@compiled
def noise(
    kind: int, x: FloatArray, R: FloatArray, left: float, right: float, stretch: float, counted: bool, c: Any
) -> FloatArray:
    """R; yaw rate and slips are predicted from speeds over ``stretch`` s, ``counted`` in whole steps."""
    e = _rounding(stretch, counted, c)
    if kind not in (YAW_RATE, SLIPS) or e == 0.0:
        return R
    by_left = expected(kind, x, left + e, right, c) - expected(kind, x, left - e, right, c)
    by_right = expected(kind, x, left, right + e, c) - expected(kind, x, left, right - e, c)
    return R + (np.outer(by_left, by_left) + np.outer(by_right, by_right)) / 4.0


@compiled
def _told(x: FloatArray, left: float, right: float, c: Any) -> FloatArray:
    """(6,) v_x, v_y, yaw rate; left slip, right slip, slip angle."""
    v_x, v_y, rate = twist(x, left, right, c)
    told = np.empty(6)
    told[0], told[1], told[2] = v_x, v_y, rate
    if c.model == FREE_SLIPS:
        told[3:] = slip_model.slips(x)
    else:
        told[3:] = speed_model.slips(x, v_x, v_y, rate, left, right, c)
    return told


@compiled
def slips_jacobian(told: FloatArray, J: FloatArray, left: float, right: float, c: Any) -> FloatArray:
    """(3, n) derivative of the slips that are told, by that of the twist."""
    if c.model == FREE_SLIPS:
        return slip_model.slips_jacobian()
    return speed_model.slips_jacobian(told[0], told[1], J, left, right, c)


@compiled
def outputs(
    x: FloatArray, P: FloatArray, left: float, right: float, stretch: float, counted: bool, c: Any
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Twist and slips, (3,) each, with their covariances, (3, 3) each: ``model.Outputs``."""
    told = _told(x, left, right, c)
    J = twist_jacobian(x, left, right, c)
    S = slips_jacobian(told, J, left, right, c)
    twist_covariance, slip_covariance = sandwich(J, P), sandwich(S, P)
    e = _rounding(stretch, counted, c)
    if e > 0.0:
        by_left = (_told(x, left + e, right, c) - _told(x, left - e, right, c)) / 2.0
        by_right = (_told(x, left, right + e, c) - _told(x, left, right - e, c)) / 2.0
        twist_covariance += np.outer(by_left[:3], by_left[:3]) + np.outer(by_right[:3], by_right[:3])
        slip_covariance += np.outer(by_left[3:], by_left[3:]) + np.outer(by_right[3:], by_right[3:])
    return told[:3].copy(), twist_covariance, told[3:].copy(), slip_covariance
