# SPDX-License-Identifier: Apache-2.0
"""Extended Kalman filter, compiled.

x, P   mean and covariance of the state      (n,), (n, n)
F, Q   transition Jacobian, process noise    (n, n), (n, n)
z, R   measurement and its covariance        (m,), (m, m)
h, H   predicted measurement, its Jacobian   (m,), (m, n)
ν, S   innovation z − h and its covariance   (m,), (m, m)
K      gain                                  (n, m)
NIS    νᵀ S⁻¹ ν, χ² with m degrees of freedom if all is honest
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from trackslip_common.compiled import compiled
from trackslip_estimation.kalman.linear_algebra import (
    apply,
    joseph,
    root,
    sandwich,
    solve,
    times,
    weighted_square,
    wrap,
)
from trackslip_estimation.slip.models.dispatch import expected, forward, jacobian, move
from trackslip_estimation.slip.models.model import FULL_POSE, YAW

FloatArray = NDArray[np.float64]


@compiled
def predict(
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
    """f(x) and P' = F P Fᵀ + Q."""
    F, Q = forward(x, P, left, right, dt, motion, changing, departure, c)
    return move(x, left, right, dt, motion, c), sandwich(F, P) + Q


@compiled
def correct(
    x: FloatArray, P: FloatArray, innovation: FloatArray, H: FloatArray, R: FloatArray
) -> tuple[FloatArray, FloatArray, float]:
    """x', P' and NIS; Joseph form, which keeps P symmetric and positive whatever the gain."""
    HP = times(H, P)
    root_of_S = root(times(HP, np.ascontiguousarray(H.T)) + R)
    K = np.ascontiguousarray(solve(root_of_S, HP).T)
    return x + apply(K, innovation), joseph(P, K, H, R), weighted_square(root_of_S, innovation)


@compiled
def update(
    kind: int, x: FloatArray, P: FloatArray, z: FloatArray, R: FloatArray, left: float, right: float, c: Any
) -> tuple[FloatArray, FloatArray, float]:
    """x', P' and NIS of a measurement of one kind."""
    innovation = z - expected(kind, x, left, right, c)
    if kind == FULL_POSE:
        innovation[YAW] = wrap(innovation[YAW])
    H = jacobian(kind, x, left, right, c)
    x, P, nis = correct(x, P, innovation, H, R)
    x[YAW] = wrap(x[YAW])
    return x, P, nis
