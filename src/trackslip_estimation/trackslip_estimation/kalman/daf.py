# SPDX-License-Identifier: Apache-2.0
"""Distribution Approximation Filter (Julier & Uhlmann; thesis Fig. 4.3), the first unscented one, compiled.

x, P    mean and covariance of the state                             (n,), (n, n)
κ       scales the higher moments of the sigma points, n + κ > 0     1
χ_i     sigma points, x and x ± the columns of √((n + κ) P)          (2n + 1, n)
w_i     their weights, κ/(n + κ) and 1/(2 (n + κ))                   (2n + 1,)
Z_i     the measurement that each would give                         (2n + 1, m)
X̃, Z̃   departures of χ_i and Z_i from their centres, as columns     (n, 2n + 1), (m, 2n + 1)
z, R    measurement and its covariance                               (m,), (m, m)
S, K    covariance of the innovation, gain                           (m, m), (n, m)

Process noise joins P' after the points have moved, not P before (step 1 of the figure): it is what the whole
step adds, and must not be moved by it again. The points are drawn anew for each measurement, because several
may come between two steps. With κ < 0 the centre has a negative
weight; departures are then taken from the centre point, not from the mean (Julier's repair).
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trackslip_common.compiled import compiled
from trackslip_estimation.kalman.linear_algebra import (
    apply,
    root,
    sandwich,
    solve,
    times,
    weighted_square,
    wrap,
)
from trackslip_estimation.slip.models.dispatch import expected, move, process_noise
from trackslip_estimation.slip.models.model import YAW

FloatArray = NDArray[np.float64]


@compiled
def sigma_points(x: FloatArray, P: FloatArray, kappa: float) -> tuple[FloatArray, FloatArray]:
    """Step 1: χ and w."""
    n = x.size
    spread = root(P) * math.sqrt(n + kappa)
    points, weights = np.empty((2 * n + 1, n)), np.full(2 * n + 1, 0.5 / (n + kappa))
    points[0], weights[0] = x, kappa / (n + kappa)
    for i in range(n):
        points[1 + i] = x + spread[:, i]
        points[1 + n + i] = x - spread[:, i]
    return points, weights


@compiled
def moments(points: FloatArray, weights: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Steps 2 and 4: the mean (k,), the departures (k, 2n + 1), and the weights that go with them.

    The third number of a state, and of a measured pose, is the heading: departures take the short way.
    """
    departures = (points - points[0]).T.copy()
    if departures.shape[0] > YAW:
        for i in range(weights.size):
            departures[YAW, i] = wrap(departures[YAW, i])
    shift = apply(departures, weights)
    mean = points[0] + shift
    if mean.size > YAW:
        mean[YAW] = wrap(mean[YAW])
    if weights[0] >= 0.0:
        for i in range(weights.size):
            departures[:, i] -= shift
        return mean, departures, weights
    repaired = weights.copy()
    repaired[0] = 0.0
    return mean, departures, repaired


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
    """Steps 1 to 3: x' and P'."""
    points, weights = sigma_points(x, P, c.kappa)
    for i in range(weights.size):
        points[i] = move(points[i], left, right, dt, motion, c)
    mean, departures, weights = moments(points, weights)
    Q = process_noise(x, P, left, right, dt, motion, changing, departure, c)
    return mean, sandwich(departures, np.diag(weights)) + Q


@compiled
def update(
    kind: int, x: FloatArray, P: FloatArray, z: FloatArray, R: FloatArray, left: float, right: float, c: Any
) -> tuple[FloatArray, FloatArray, float]:
    """Steps 4 to 6, and the Kalman update: x', P' and NIS.

    P' = P − K S Kᵀ in a form that stays positive: (X̃ − K Z̃) w (X̃ − K Z̃)ᵀ + K R Kᵀ.
    """
    points, weights = sigma_points(x, P, c.kappa)
    seen = np.empty((weights.size, z.size))
    for i in range(weights.size):
        seen[i] = expected(kind, points[i], left, right, c)
    z_mean, z_departures, w = moments(seen, weights)
    x_departures = moments(points, weights)[1]
    root_of_S = root(sandwich(z_departures, np.diag(w)) + R)
    K = np.ascontiguousarray(solve(root_of_S, times(z_departures * w, x_departures.T.copy())).T)
    innovation = z - z_mean
    if z.size > YAW:
        innovation[YAW] = wrap(innovation[YAW])
    mean = x + apply(K, innovation)
    mean[YAW] = wrap(mean[YAW])
    P = sandwich(x_departures - times(K, z_departures), np.diag(w)) + sandwich(K, R)
    return mean, P, weighted_square(root_of_S, innovation)
