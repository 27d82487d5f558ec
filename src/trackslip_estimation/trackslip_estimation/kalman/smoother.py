# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Fixed-interval smoother (Rauch, Tung & Striebel) behind an extended Kalman filter, compiled.

x_k, P_k      mean and covariance by the filter, after measurement k          (n,), (n, n)
x⁻_k, P⁻_k    the same before that measurement, predicted from k − 1          (n,), (n, n)
F_k, Q_k      transition from k − 1 to k, process noise P⁻_k − F_k P_{k−1} F_kᵀ  (n, n)
x̂_k, P̂_k      mean and covariance given all measurements, later ones too      (n,), (n, n)
G_k           gain P_{k−1} F_kᵀ (P⁻_k)⁻¹                                      (n, n)

    x̂_{k−1} = x_{k−1} + G_k (x̂_k − x⁻_k)
    P̂_{k−1} = (I − G_k F_k) P_{k−1} (I − G_k F_k)ᵀ + G_k (P̂_k + Q_k) G_kᵀ

The covariance is the usual P + G (P̂ − P⁻) Gᵀ as a sum of positive terms. G comes from a Cholesky solve that
skips directions in which P⁻ has no variance: states that are known exactly stay as they are.
"""

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_common.compiled import compiled
from trackslip_estimation.kalman.linear_algebra import (
    joseph,
    multiply,
    multiply_vector,
    root,
    sandwich,
    solve,
    wrap,
)

Gaussian = tuple[FloatArray, FloatArray]


@compiled
def smooth_step(
    filtered: Gaussian, predicted: Gaussian, smoothed: Gaussian, F: FloatArray, angle: int
) -> Gaussian:
    """x̂_{k−1} and P̂_{k−1} from (x_{k−1}, P_{k−1}), (x⁻_k, P⁻_k), (x̂_k, P̂_k); ``angle`` as in ``daf``."""
    (x, P), (x_predicted, P_predicted), (x_smoothed, P_smoothed) = filtered, predicted, smoothed
    G = np.ascontiguousarray(solve(root(P_predicted), multiply(F, P)).T)
    correction = x_smoothed - x_predicted
    correction[angle] = wrap(correction[angle])
    x = x + multiply_vector(G, correction)
    x[angle] = wrap(x[angle])
    return x, joseph(P, G, F, P_smoothed + (P_predicted - sandwich(F, P)))
