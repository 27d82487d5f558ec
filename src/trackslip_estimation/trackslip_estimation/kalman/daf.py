# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Distribution Approximation Filter (Julier & Uhlmann; thesis Fig. 4.3), the first unscented one; compiled.

Works in place.

x, P    mean and covariance of the state                             (n,), (n, n)
κ       scales the higher moments of the sigma points, n + κ > 0     1
χ_i     sigma points, x and x ± the columns of √((n + κ) P)          (2n + 1, n)
w_i     their weights, κ/(n + κ) and 1/(2 (n + κ))                   (2n + 1,)
X̃       departures of χ_i from their centre, as columns              (n, 2n + 1)

Steps 1 to 3 of the figure are the prediction. Measurements are linear in the state, or nearly: their update
is that of the EKF (``update``). Process noise is added to P' after the points have moved, not to P before
(step 1 of the figure): it is the noise of the whole step, and must not be propagated again. With κ < 0 the
centre has a negative weight; departures are then taken from the centre point, not from the mean (Julier's
repair). State ``angle`` is an angle: its departures are wrapped.
"""

import math

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_common.compiled import compiled
from trackslip_estimation.kalman.linear_algebra import multiply_vector, root, sandwich, wrap


@compiled
def sigma_points(x: FloatArray, P: FloatArray, kappa: float, size: int) -> tuple[FloatArray, FloatArray]:
    """Step 1: χ and w; only the first ``size`` states are uncertain."""
    spread = root(P) * math.sqrt(size + kappa)
    points, weights = np.empty((2 * size + 1, x.size)), np.full(2 * size + 1, 0.5 / (size + kappa))
    points[0], weights[0] = x, kappa / (size + kappa)
    for i in range(size):
        points[1 + i] = x + spread[:, i]
        points[1 + size + i] = x - spread[:, i]
    return points, weights


@compiled
def moments(points: FloatArray, weights: FloatArray, angle: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Step 2: the mean (k,), the departures (k, 2n + 1), and the weights of the departures."""
    departures = (points - points[0]).T.copy()
    if departures.shape[0] > angle:
        for i in range(weights.size):
            departures[angle, i] = wrap(departures[angle, i])
    shift = multiply_vector(departures, weights)
    mean = points[0] + shift
    if mean.size > angle:
        mean[angle] = wrap(mean[angle])
    if weights[0] >= 0.0:
        for i in range(weights.size):
            departures[:, i] -= shift
        return mean, departures, weights
    repaired = weights.copy()
    repaired[0] = 0.0
    return mean, departures, repaired


@compiled
def spread_covariance(departures: FloatArray, weights: FloatArray) -> FloatArray:
    """(k, k) of departures (k, 2n + 1): step 3."""
    return sandwich(departures, np.diag(weights))
