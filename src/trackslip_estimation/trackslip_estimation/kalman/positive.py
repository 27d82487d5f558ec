# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Keeps a covariance symmetric and positive definite after its update; compiled, in place.

P      covariance after an update                          (n, n)
P⁻     covariance before it                                (n, n)
d_k    pivots of the factorisation L D Lᵀ of P, the variance of each state given those before it
ε_k    least pivot: rounding error of the variance of a state

An update subtracts from P⁻. The difference has a rounding error of about 1e-16 of P⁻: where the difference is
smaller, P may have a negative eigenvalue. The factorisation then has a pivot below ε_k. In that case the
variance of this state is raised until its pivot is ε_k. Its covariance with later states is reduced to the
part that earlier states explain (a modified Cholesky factorisation, after Gill & Murray). So the estimate is
no more certain than numbers of 64 bits can represent. A positive definite P stays as it is.
"""

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_common.compiled import compiled
from trackslip_estimation.kalman.linear_algebra import used_size

_LEAST_PIVOT_SHARE = 1e-12  # ε_k, as a share of a state's variance
_LEAST_PRIOR_SHARE = 1e-14  # ε_k, as a share of its variance before the update


@compiled
def make_positive(P: FloatArray, before: FloatArray, n: int) -> None:
    """Make the first ``n`` states of P positive definite and exactly symmetric, where they are not.

    ``before``: P⁻. Numbers that are not finite stay so.
    """
    n = max(used_size(P, n), used_size(before, n))
    U = np.empty((n, n))  # D Lᵀ
    for i in range(n):
        for j in range(i, n):
            both = 0.5 * (P[i, j] + P[j, i])
            P[i, j] = P[j, i] = U[i, j] = both
    for k in range(n):
        variance = P[k, k]
        least = max(_LEAST_PIVOT_SHARE * variance, _LEAST_PRIOR_SHARE * before[k, k])
        if not U[k, k] > least:
            P[k, k] += least - U[k, k]
            for j in range(k + 1, n):
                P[k, j] = P[j, k] = P[k, j] - U[k, j]
            continue
        over = 1.0 / U[k, k]
        for i in range(k + 1, n):
            share = U[k, i] * over
            if share != 0.0:
                for j in range(i, n):
                    U[i, j] -= share * U[k, j]
