# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""One state of a Gaussian: replaced, or decayed as a first-order Gauss–Markov process; compiled, in place.

x, P   mean and covariance of the state    (n,), (m, m), m ≥ n
"""

from trackslip_common.arrays import FloatArray
from trackslip_common.compiled import compiled


@compiled
def replace_state(x: FloatArray, P: FloatArray, k: int, mean: float, variance: float) -> None:
    """State k gets a mean and a variance of its own, uncorrelated."""
    x[k] = mean
    for j in range(P.shape[0]):
        P[k, j] = P[j, k] = 0.0
    P[k, k] = variance


@compiled
def decay_state(x: FloatArray, P: FloatArray, k: int, left: float, variance: float) -> None:
    """The share ``left`` of state k is left; ``variance`` is that of the process."""
    x[k] *= left
    for j in range(P.shape[0]):
        P[k, j] *= left
    for j in range(P.shape[0]):
        P[j, k] *= left
    P[k, k] += (1.0 - left * left) * variance


@compiled
def add_state(P: FloatArray, to: int, what: int, factor: float) -> None:
    """P, where to one number of the state another one is added, times a factor."""
    for j in range(P.shape[1]):
        P[to, j] += factor * P[what, j]
    for i in range(P.shape[0]):
        P[i, to] += factor * P[i, what]
