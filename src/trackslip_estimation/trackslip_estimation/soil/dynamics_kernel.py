# SPDX-License-Identifier: Apache-2.0
"""The Kalman filter of ``dynamics``, compiled; see there for the symbols."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trackslip_common.compiled import compiled
from trackslip_estimation.kalman import linear_algebra
from trackslip_estimation.kalman.linear_algebra import apply, sandwich

FloatArray = NDArray[np.float64]

SPEED, RATE, MU_R, MU_L = range(4)
_SIZE, _SEEN = 4, 2


class Numbers(NamedTuple):
    """Of vehicle and noise; SI units."""

    mass: float
    yaw_inertia: float
    weight: float
    half_tread: float
    lever: float  # l/3, m
    inertia_stddev: float  # relative
    acceleration_stddev: float
    yaw_acceleration_stddev: float
    mu_r_walk: float
    mu_l_walk: float
    error_time: float


@compiled
def predict(
    mean: FloatArray,
    covariance: FloatArray,
    dt: float,
    crosswise: float,
    signs: FloatArray,
    forces: FloatArray,
    variances: FloatArray,
    sense: float,
    n: Numbers,
) -> tuple[FloatArray, FloatArray]:
    """Both lines of the model over dt; ``crosswise`` is v_y φ̇, ``sense`` 0 in straight motion."""
    F = np.eye(_SIZE)
    F[SPEED, MU_R] = -0.5 * n.weight * (signs[0] + signs[1]) / n.mass * dt
    push = np.zeros(_SIZE)
    push[SPEED] = ((forces[0] + forces[1]) / n.mass + crosswise) * dt
    if sense != 0.0:
        F[RATE, MU_R] = -0.5 * n.half_tread * n.weight * (signs[1] - signs[0]) / n.yaw_inertia * dt
        F[RATE, MU_L] = -sense * n.weight * n.lever / n.yaw_inertia * dt
        push[RATE] = n.half_tread * (forces[1] - forces[0]) / n.yaw_inertia * dt
    after = apply(F, mean) + push
    # A sign that is not certain leaves the resistance open.
    L, R = variances + (0.5 * mean[MU_R] * n.weight) ** 2 * (1.0 - signs**2)
    by_speed, by_rate = 1.0 / n.mass, n.half_tread / n.yaw_inertia
    lasting = n.error_time * dt
    Q = np.zeros((_SIZE, _SIZE))
    Q[SPEED, SPEED] = (by_speed**2 * (L + R) + n.acceleration_stddev**2) * lasting
    Q[MU_R, MU_R] = n.mu_r_walk**2 * dt
    if sense != 0.0:
        inertia = (n.inertia_stddev * (after[RATE] - mean[RATE]) / dt) ** 2
        Q[RATE, RATE] = (by_rate**2 * (L + R) + inertia + n.yaw_acceleration_stddev**2) * lasting
        Q[SPEED, RATE] = Q[RATE, SPEED] = by_speed * by_rate * (R - L) * lasting
        Q[MU_L, MU_L] = n.mu_l_walk**2 * dt
    return after, sandwich(F, covariance) + Q


@compiled
def correct(
    mean: FloatArray, covariance: FloatArray, measured: FloatArray, noise: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """v_x and φ̇ (2,) as measured, with covariance (2, 2)."""
    S = covariance[:_SEEN, :_SEEN] + noise
    determinant = S[0, 0] * S[1, 1] - S[0, 1] * S[1, 0]
    gain = np.empty((_SIZE, _SEEN))
    keep = np.eye(_SIZE)
    for i in range(_SIZE):
        of_speed, of_rate = covariance[i, SPEED], covariance[i, RATE]
        gain[i, 0] = (of_speed * S[1, 1] - of_rate * S[1, 0]) / determinant
        gain[i, 1] = (of_rate * S[0, 0] - of_speed * S[0, 1]) / determinant
        keep[i, SPEED] -= gain[i, 0]
        keep[i, RATE] -= gain[i, 1]
    after = mean + apply(gain, measured - mean[:_SEEN])
    return after, sandwich(keep, covariance) + sandwich(gain, noise)
