# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Propagation of a covariance; compiled, in place."""

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_common.compiled import compiled


@compiled
def propagate_covariance(P: FloatArray, F: FloatArray, Q: FloatArray, coupled: int) -> None:
    """P ← F P Fᵀ + Q, where F (n, n) is diagonal below its first ``coupled`` rows, Q is process noise.

    P may be larger than F: the rest of P stays as it is.
    """
    n = F.shape[0]
    upper = np.zeros((coupled, n))  # of F P
    for i in range(coupled):
        for k in range(n):
            f = F[i, k]
            if f != 0.0:
                for j in range(n):
                    upper[i, j] += f * P[k, j]
    for i in range(coupled, n):
        for j in range(coupled, i + 1):
            P[i, j] = P[j, i] = F[i, i] * P[i, j] * F[j, j] + Q[i, j]
    for i in range(coupled):
        for j in range(coupled, n):
            P[i, j] = P[j, i] = upper[i, j] * F[j, j] + Q[i, j]
        for j in range(i + 1):
            total = Q[i, j]
            for k in range(n):
                total += upper[i, k] * F[j, k]
            P[i, j] = P[j, i] = total
