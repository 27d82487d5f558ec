# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Extended Kalman filter, compiled; works in place.

x, P   mean and covariance of the state                  (n,), (n, n)
F, Q   transition Jacobian, process noise                (n, n), (n, n)
ν, H   innovation z − h(x), Jacobian of h                (m,), (m, n)
R, S   covariance of the measurement, of the innovation  (m, m), (m, m)
K      gain P Hᵀ S⁻¹                                     (n, m)
NIS    νᵀ S⁻¹ ν, χ² with m degrees of freedom if consistent
"""

import numpy as np
from numpy.typing import NDArray

from trackslip_common.compiled import compiled, inlined
from trackslip_estimation.kalman.linear_algebra import (
    joseph,
    log_determinant,
    root,
    sandwich,
    solve,
    times,
    weighted_square,
)

FloatArray = NDArray[np.float64]

_NOTHING = 1e-12  # share of a variance that is rounding


@compiled
def propagate_covariance(P: FloatArray, F: FloatArray, Q: FloatArray, coupled: int) -> None:
    """P ← F P Fᵀ + Q, where F is diagonal below its first ``coupled`` rows.

    P may be larger than F: then the rest of it stays as it is.
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


@compiled
def correct(
    x: FloatArray, P: FloatArray, innovation: FloatArray, H: FloatArray, R: FloatArray
) -> tuple[float, float]:
    """x and P given the innovation; returns NIS and ln |S|.

    P ← (I − K H) P (I − K H)ᵀ + K R Kᵀ (Joseph), which stays symmetric and positive whatever the gain. P may
    be larger than x: then the rest of it stays as it is.
    """
    return correct_keeping(x, P, innovation, (H, R), -1)


@compiled
def correct_keeping(
    x: FloatArray, P: FloatArray, innovation: FloatArray, given: tuple[FloatArray, FloatArray], kept: int
) -> tuple[float, float]:
    """As ``correct``, by H and R (``given``); the number ``kept`` stays as it is (Schmidt); −1: none does."""
    H, R = given
    n, m = x.size, innovation.size
    HP, S = _by_measurement(P, H), R.copy()
    for i in range(m):
        for k in range(n):
            h = H[i, k]
            if h != 0.0:
                for j in range(m):
                    S[i, j] += h * HP[j, k]
    root_of_S = root(S)
    K = solve(root_of_S, HP)
    if kept >= 0:
        K[:, kept] = 0.0
    for i in range(m):
        for k in range(n):
            x[k] += K[i, k] * innovation[i]
            for j in range(n):
                P[k, j] -= K[i, k] * HP[i, j]
    rest = _by_measurement(P, H)  # of (I − K H) P
    for i in range(m):
        for k in range(n):
            total = -rest[i, k]
            for j in range(m):
                total += K[j, k] * R[j, i]
            rest[i, k] = total
    for k in range(n):
        for j in range(k + 1):
            both = P[k, j] + P[j, k]
            for i in range(m):
                both += rest[i, k] * K[i, j] + rest[i, j] * K[i, k]
            P[k, j] = P[j, k] = both / 2.0
    return weighted_square(root_of_S, innovation), log_determinant(root_of_S)


@compiled
def variance_of(P: FloatArray, H: FloatArray) -> float:
    """H P Hᵀ of one number, H (n,)."""
    total = 0.0
    for i in range(H.size):
        if H[i] != 0.0:
            for j in range(H.size):
                total += H[i] * H[j] * P[i, j]
    return total


@compiled
def correct_knowing(
    x: FloatArray, P: FloatArray, innovation: float, given: tuple[FloatArray, float], known: tuple[int, int]
) -> None:
    """x and P given one number, H (n,) and R (``given``) that are not to teach the states ``known``.

    The gain is that of a filter which knows them: what it corrects is what the innovation shows with these as
    they are. They keep mean and variance (Schmidt), and P has what is unknown of them. The same number twice:
    one state; −1: none.
    """
    (H, R), n, v = given, x.size, _shared_with(P, given[0])
    K = v.copy()
    if known[0] >= 0:
        _take_as_known(P, H, K, known)
    alone = R
    S = R
    for k in range(n):
        alone += H[k] * K[k]
        S += H[k] * v[k]
    for k in range(n):
        K[k] /= alone
        x[k] += K[k] * innovation
        v[k] -= 0.5 * S * K[k]
    for k in range(n):
        for j in range(k + 1):
            P[k, j] = P[j, k] = P[k, j] - K[k] * v[j] - v[k] * K[j]


@inlined
def _take_as_known(P: FloatArray, H: FloatArray, K: FloatArray, known: tuple[int, int]) -> None:
    """K, P Hᵀ (n,), becomes what it would be if two states were known."""
    one, other = known
    first, second = P[one, : H.size].copy(), P[other, : H.size].copy()
    K -= H[one] * first
    if other != one:
        K -= H[other] * second
    if first[one] > 0.0:
        second -= first * (second[one] / first[one])
        K -= first * (K[one] / first[one])
    if second[other] > _NOTHING * P[other, other]:
        K -= second * (K[other] / second[other])
    K[one] = K[other] = 0.0


@compiled
def _shared_with(P: FloatArray, H: FloatArray) -> FloatArray:
    """(n,) P Hᵀ, H (n,); its zeros cost nothing."""
    product = np.zeros(H.size)
    for k in range(H.size):
        if H[k] != 0.0:
            for j in range(H.size):
                product[j] += P[j, k] * H[k]
    return product


@compiled
def correct_shared(
    x: FloatArray,
    P: FloatArray,
    given: tuple[FloatArray, FloatArray],
    H: FloatArray,
    C: FloatArray,
    kept: int,
) -> None:
    """x and P given an innovation (m,) and R (m, m), whose errors have the covariance C (n, m) with x.

    K = (P Hᵀ + C) S⁻¹ and P ← (I − K H) P (I − K H)ᵀ + K R Kᵀ − C Kᵀ − K Cᵀ, where H C = 0.
    ``kept``: number of the state that stays as it was, with its variance (Schmidt); −1: none does.
    """
    innovation, R = given
    shared = times(P, np.ascontiguousarray(H.T)) + C
    S = sandwich(H, P) + R
    K = np.ascontiguousarray(solve(root(S), np.ascontiguousarray(shared.T)).T)
    if kept >= 0:
        K[kept] = 0.0
    after, by_C = joseph(P, K, H, R), times(C, np.ascontiguousarray(K.T))
    x += times(K, innovation.copy().reshape((-1, 1)))[:, 0]
    for i in range(x.size):
        for j in range(x.size):
            P[i, j] = after[i, j] - by_C[i, j] - by_C[j, i]


@compiled
def _by_measurement(P: FloatArray, H: FloatArray) -> FloatArray:
    """(m, n) P Hᵀ, transposed."""
    product = np.empty(H.shape)
    for i in range(H.shape[0]):
        product[i] = _shared_with(P, H[i])
    return product
