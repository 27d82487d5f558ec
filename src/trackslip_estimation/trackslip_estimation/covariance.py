# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Validity of covariances."""

import math

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_common.compiled import compiled

ROUNDING = 1e-9  # of a correlation of 1


def is_covariance(P: FloatArray) -> bool:
    """Whether P (n, n) is finite, symmetric and positive semidefinite.

    Rounding may make correlations asymmetric by 1e-9, and eigenvalues of their matrix −1e-9. That matrix must
    have a Cholesky factor after 1e-9 is added to its diagonal.
    """
    n = P.shape[0]
    L = np.zeros((n, n))
    for i in range(n):
        if not 0.0 <= P[i, i] < math.inf:
            return False
        for j in range(i):
            largest = (1.0 + ROUNDING) * math.sqrt(P[i, i]) * math.sqrt(P[j, j])
            if not abs(P[i, j]) <= largest or not abs(P[i, j] - P[j, i]) <= ROUNDING * largest:
                return False
            rest = P[i, j]
            for k in range(j):
                rest -= L[i, k] * L[j, k]
            if rest != 0.0:
                L[i, j] = rest / L[j, j] if L[j, j] > 0.0 else math.inf
        pivot = (1.0 + ROUNDING) * P[i, i]
        for k in range(i):
            pivot -= L[i, k] ** 2
        if not pivot >= 0.0:
            return False
        L[i, i] = math.sqrt(pivot)
    return True


is_covariance_compiled = compiled(is_covariance)  # for kernels
