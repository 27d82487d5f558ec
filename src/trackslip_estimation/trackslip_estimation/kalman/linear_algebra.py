# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Algebra of small matrices, compiled; each sum has a fixed order, so a replay repeats every bit.

A, B   any matrices
P, S   symmetric, positive (semi)definite
L      lower triangular root, L Lᵀ = P
"""

import math

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_common.compiled import compiled

_PIVOT_ROUNDING = 1e-14  # a pivot below this share of its diagonal is rounding


@compiled
def wrap(angle: float) -> float:
    """The same angle in (−π, π]."""
    return -((-angle + math.pi) % (2.0 * math.pi) - math.pi)


@compiled
def used_size(P: FloatArray, n: int) -> int:
    """Number of leading states, of n, up to the last that has a variance in P; the rest may be skipped."""
    while n > 0 and P[n - 1, n - 1] == 0.0:
        n -= 1
    return n


@compiled
def copy_square(A: FloatArray, B: FloatArray, n: int) -> None:
    """Copy the first n rows and columns of A into B."""
    for i in range(n):
        for j in range(n):
            B[i, j] = A[i, j]


@compiled
def multiply(A: FloatArray, B: FloatArray) -> FloatArray:
    """A B; zeros of A, frequent in Jacobians, are skipped."""
    product = np.zeros((A.shape[0], B.shape[1]))
    for i in range(A.shape[0]):
        for k in range(A.shape[1]):
            a = A[i, k]
            if a != 0.0:
                for j in range(B.shape[1]):
                    product[i, j] += a * B[k, j]
    return product


@compiled
def multiply_vector(A: FloatArray, v: FloatArray) -> FloatArray:
    """(m,) A v."""
    product = np.zeros(A.shape[0])
    for i in range(A.shape[0]):
        for k in range(A.shape[1]):
            product[i] += A[i, k] * v[k]
    return product


@compiled
def sandwich(A: FloatArray, P: FloatArray) -> FloatArray:
    """A P Aᵀ, exactly symmetric."""
    whole = multiply(A, np.ascontiguousarray(multiply(A, P).T))
    for i in range(whole.shape[0]):
        for j in range(i):
            whole[i, j] = whole[j, i] = (whole[i, j] + whole[j, i]) / 2.0
    return whole


@compiled
def root(P: FloatArray) -> FloatArray:
    """L by Cholesky; a direction without variance, or with a negative one by rounding, gets a zero column."""
    n = P.shape[0]
    L = np.zeros((n, n))
    for j in range(n):
        pivot = P[j, j]
        for k in range(j):
            pivot -= L[j, k] * L[j, k]
        if pivot <= _PIVOT_ROUNDING * P[j, j]:
            continue
        L[j, j] = math.sqrt(pivot)
        for i in range(j + 1, n):
            rest = P[i, j]
            for k in range(j):
                rest -= L[i, k] * L[j, k]
            L[i, j] = rest / L[j, j]
    return L


@compiled
def solve(L: FloatArray, B: FloatArray) -> FloatArray:
    """(L Lᵀ)⁻¹ B; zero along directions in which L is singular."""
    X = B.copy()
    solve_in_place(L, X)
    return X


@compiled
def solve_in_place(L: FloatArray, B: FloatArray) -> None:
    """B (n, k) becomes (L Lᵀ)⁻¹ B, as in ``solve``."""
    n = L.shape[0]
    for i in range(n):
        for k in range(i):
            for j in range(B.shape[1]):
                B[i, j] -= L[i, k] * B[k, j]
        for j in range(B.shape[1]):
            B[i, j] = B[i, j] / L[i, i] if L[i, i] > 0.0 else 0.0
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            for j in range(B.shape[1]):
                B[i, j] -= L[k, i] * B[k, j]
        for j in range(B.shape[1]):
            B[i, j] = B[i, j] / L[i, i] if L[i, i] > 0.0 else 0.0


@compiled
def weighted_square(L: FloatArray, v: FloatArray) -> float:
    """vᵀ (L Lᵀ)⁻¹ v."""
    total, solved = 0.0, v.copy().reshape((v.size, 1))
    solve_in_place(L, solved)
    for i in range(v.size):
        total += v[i] * solved[i, 0]
    return total


@compiled
def joseph(P: FloatArray, K: FloatArray, H: FloatArray, R: FloatArray) -> FloatArray:
    """(I − K H) P (I − K H)ᵀ + K R Kᵀ."""
    A = multiply(K, H)
    for i in range(A.shape[0]):
        for j in range(A.shape[1]):
            A[i, j] = (1.0 if i == j else 0.0) - A[i, j]  # I − K H
    covariance, noise = sandwich(A, P), sandwich(K, R)
    for i in range(covariance.shape[0]):
        for j in range(covariance.shape[1]):
            covariance[i, j] += noise[i, j]
    return covariance


@compiled
def log_determinant(L: FloatArray) -> float:
    """ln |L Lᵀ|."""
    total = 0.0
    for i in range(L.shape[0]):
        total += 2.0 * math.log(L[i, i])
    return total
