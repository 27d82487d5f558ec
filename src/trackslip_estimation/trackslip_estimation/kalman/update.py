# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The update of an extended Kalman filter by one observation, whatever its source; compiled, in place.

x, P   mean and covariance of the state                  (k,), (k, k), k ≥ n
ν, H   innovation z − h(x), Jacobian of h                (m,), (m, n)
R, S   covariance of the noise, of the innovation        (m, m), (m, m)
C      covariance of the noise with the state            (m, n)
K      gain (H P + C) S⁻¹, transposed                    (m, n)
NIS    νᵀ S⁻¹ ν, χ² with m degrees of freedom if consistent

    P ← (I − K H) P (I − K H)ᵀ + K R Kᵀ − (I − K H) C Kᵀ − K Cᵀ (I − K H)ᵀ       (Joseph)

This form stays symmetric and positive for any gain. So a gain may exclude states: a *considered* state keeps
mean and variance (Schmidt). A *known* state keeps both, too, and the gain is that of a filter that knows it:
the observation corrects the other states as if the known one had no error.

Source: Gelb, Applied Optimal Estimation (1974), 4.2 and 4.5; Schmidt (1966).
"""

from typing import NamedTuple

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_common.compiled import compiled, inlined
from trackslip_estimation.kalman.linear_algebra import root, solve_in_place, used_size, weighted_square

_ROUNDING = 1e-12  # rounding error as a share of a variance


class Observation(NamedTuple):
    """A linearised measurement of the state."""

    innovation: FloatArray  # (m,) ν
    jacobian: FloatArray  # (m, n) H
    noise: FloatArray  # (m, m) R
    considered: int  # bits of considered states
    known: int  # bits of known states
    cross_covariance: FloatArray  # (m, n) C, or (0, n) if noise and state are uncorrelated


@compiled
def independent_observation(innovation: FloatArray, H: FloatArray, R: FloatArray) -> Observation:
    """An observation that corrects all states, with noise independent of the state."""
    return Observation(innovation, H, R, 0, 0, H[:0])


@compiled
def predicted_covariance(P: FloatArray, H: FloatArray) -> FloatArray:
    """(m, m) H P Hᵀ."""
    m, n = H.shape
    HP, S = _times_covariance(P, H, n), np.zeros((m, m))
    for i in range(m):
        for k in range(n):
            h = H[i, k]
            if h != 0.0:
                for j in range(m):
                    S[i, j] += h * HP[j, k]
    return S


@compiled
def inflate_noise_to_gate(R: FloatArray, innovation: FloatArray, predicted: FloatArray, limit: float) -> None:
    """Increase R until the NIS is at most ``limit``: the soft gate; ``predicted``: H P Hᵀ (m, m)."""
    nis = weighted_square(root(predicted + R), innovation)
    if nis > limit:
        R += (nis / limit - 1.0) * (predicted + R)


@compiled
def correct(x: FloatArray, P: FloatArray, o: Observation) -> None:
    """Update x and P with an observation; states beyond H stay as they are."""
    m, n, is_correlated = o.innovation.size, o.jacobian.shape[1], o.cross_covariance.shape[0] > 0
    if not is_correlated:
        n = used_size(P, n)
    B = _times_covariance(P, o.jacobian, n)
    K = B.copy()
    if is_correlated:
        K += o.cross_covariance
    _compute_gain(P, K, o)
    for i in range(m):
        for k in range(n):
            x[k] += K[i, k] * o.innovation[i]
        for j in range(n):
            for k in range(n):
                P[j, k] -= K[i, k] * B[i, j]
    _complete_covariance(P, K, o)


@inlined
def _compute_gain(P: FloatArray, K: FloatArray, o: Observation) -> None:
    """K (m, n), which is H P + C, becomes the gain, transposed."""
    H, is_correlated, S = o.jacobian, o.cross_covariance.shape[0] > 0, o.noise.copy()
    _condition_on_known_states(P, K, o.known)
    for i in range(S.shape[0]):
        for k in range(K.shape[1]):
            h = H[i, k]
            if h != 0.0:
                for j in range(S.shape[0]):
                    S[i, j] += h * K[j, k]
                    if is_correlated:
                        S[j, i] += h * o.cross_covariance[j, k]
    solve_in_place(root(S), K)
    unchanged = o.considered | o.known
    for k in range(K.shape[1]):
        if unchanged >> k & 1:
            for i in range(K.shape[0]):
                K[i, k] = 0.0


@inlined
def _condition_on_known_states(P: FloatArray, B: FloatArray, known: int) -> None:
    """B (m, n), which is H P, becomes H P given that some states are known."""
    n, used, count = B.shape[1], 0, 0
    for a in range(n):
        count += known >> a & 1
    rows, pivots = np.empty((count, n)), np.empty(count, np.int64)
    for a in range(n):
        if known >> a & 1 == 0:
            continue
        row = rows[used]
        for k in range(n):
            row[k] = P[a, k]
        for j in range(used):
            share = row[pivots[j]] / rows[j, pivots[j]]
            for k in range(n):
                row[k] -= rows[j, k] * share
        is_nonzero = row[a] > _ROUNDING * P[a, a]
        for i in range(B.shape[0]):
            share = B[i, a] / row[a] if is_nonzero else 0.0
            for k in range(n):
                B[i, k] -= row[k] * share
            B[i, a] = 0.0
        if is_nonzero:
            pivots[used] = a
            used += 1


@inlined
def _complete_covariance(P: FloatArray, K: FloatArray, o: Observation) -> None:
    """P, which is ((I − K H) P)ᵀ, becomes the covariance after the update."""
    m, n = K.shape
    rest, D, is_correlated = (
        _times_covariance(P, o.jacobian, n),
        o.cross_covariance,
        o.cross_covariance.shape[0] > 0,
    )
    if is_correlated:
        D = _remaining_cross_covariance(K, o)
    for i in range(m):
        for k in range(n):
            total = -rest[i, k]
            for j in range(m):
                total += K[j, k] * o.noise[j, i]
            rest[i, k] = total - 2.0 * D[i, k] if is_correlated else total
    for k in range(n):
        for j in range(k + 1):
            both = P[k, j] + P[j, k]
            for i in range(m):
                both += rest[i, k] * K[i, j] + rest[i, j] * K[i, k]
            P[k, j] = P[j, k] = both / 2.0


@compiled
def _remaining_cross_covariance(K: FloatArray, o: Observation) -> FloatArray:
    """(m, n) the rest of C after (I − K H)."""
    rest, H = o.cross_covariance.copy(), o.jacobian
    for i in range(K.shape[0]):
        for j in range(K.shape[0]):
            HC = 0.0  # entry of H Cᵀ
            for k in range(H.shape[1]):
                HC += H[j, k] * o.cross_covariance[i, k]
            for k in range(K.shape[1]):
                rest[i, k] -= K[j, k] * HC
    return rest


@compiled
def _times_covariance(P: FloatArray, H: FloatArray, n: int) -> FloatArray:
    """(m, n) H P of the first n states; zeros of H are skipped."""
    m = H.shape[0]
    product = np.zeros((m, n))
    for i in range(m):
        for k in range(n):
            h = H[i, k]
            if h != 0.0:
                for j in range(n):
                    product[i, j] += h * P[k, j]
    return product
