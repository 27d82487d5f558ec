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

import math

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
    n, m = x.size, innovation.size
    PHt, S = _by_measurement(P, H), R.copy()
    for i in range(m):
        for k in range(n):
            h = H[i, k]
            if h != 0.0:
                for j in range(m):
                    S[i, j] += h * PHt[k, j]
    root_of_S = root(S)
    _apply(x, P, innovation, (solve(root_of_S, np.ascontiguousarray(PHt.T)), PHt), (H, R))
    return weighted_square(root_of_S, innovation), log_determinant(root_of_S)


@compiled
def correct_knowing(
    x: FloatArray,
    P: FloatArray,
    innovation: FloatArray,
    given: tuple[FloatArray, FloatArray],
    known: tuple[int, int],
) -> tuple[float, float]:
    """x and P given an innovation (1,), H and R (``given``) that are not to teach the states ``known``.

    The gain is that of a filter which knows them: what it corrects is what the innovation shows with these as
    they are. They keep mean and variance (Schmidt), and P has what is unknown of them. The same number twice:
    one state. Returns NIS and ln S.
    """
    H, R = given
    PHt, others = _by_measurement(P, H), H.copy()
    for k in known:
        others[0, k] = 0.0
    K = _by_measurement(P, others)  # then without what the known ones account for
    first, second = P[: x.size, known[0]].copy(), P[: x.size, known[1]].copy()
    if first[known[0]] > 0.0:
        second -= first * (second[known[0]] / first[known[0]])
        _explain(K, first, known[0])
    if second[known[1]] > _NOTHING * P[known[1], known[1]]:
        _explain(K, second, known[1])
    S, alone = R[0, 0], R[0, 0]
    for k in range(x.size):
        S += H[0, k] * PHt[k, 0]
        alone += others[0, k] * K[k, 0]
    for k in known:
        K[k, 0] = 0.0
    _apply(x, P, innovation, (np.ascontiguousarray(K.T) / alone, PHt), (H, R))
    return innovation[0] ** 2 / S, math.log(S)


@inlined
def _explain(K: FloatArray, column: FloatArray, known: int) -> None:
    """Takes from K (n, 1) what a state accounts for, of which the covariances with all (n,) are given."""
    share = K[known, 0] / column[known]
    for k in range(column.size):
        K[k, 0] -= share * column[k]


@inlined
def _apply(
    x: FloatArray,
    P: FloatArray,
    innovation: FloatArray,
    gain: tuple[FloatArray, FloatArray],
    given: tuple[FloatArray, FloatArray],
) -> None:
    """x and P corrected with a gain, Kᵀ (m, n); beside it P Hᵀ, and H and R."""
    (K, PHt), (H, R) = gain, given
    n, m = x.size, innovation.size
    for i in range(m):
        for k in range(n):
            x[k] += K[i, k] * innovation[i]
            for j in range(n):
                P[k, j] -= K[i, k] * PHt[j, i]
    rest = _by_measurement(P, H)  # of (I − K H) P
    for k in range(n):
        for i in range(m):
            total = -rest[k, i]
            for j in range(m):
                total += K[j, k] * R[j, i]
            rest[k, i] = total
    for k in range(n):
        for j in range(k + 1):
            both = P[k, j] + P[j, k]
            for i in range(m):
                both += rest[k, i] * K[i, j] + rest[j, i] * K[i, k]
            P[k, j] = P[j, k] = both / 2.0


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
    """(n, m) P Hᵀ; the zeros of H, of which it is full, cost nothing."""
    n = H.shape[1]
    product = np.zeros((n, H.shape[0]))
    for i in range(H.shape[0]):
        for k in range(n):
            h = H[i, k]
            if h != 0.0:
                for j in range(n):
                    product[j, i] += P[j, k] * h
    return product
