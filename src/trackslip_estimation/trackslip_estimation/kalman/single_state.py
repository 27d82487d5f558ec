# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""One state of a Gaussian: replaced, decayed, added to another one, or of another prior; compiled, in place.

It decays as a first-order Gauss–Markov process. Two variances of it are compared by their Bayes factor.

x, P   mean and covariance of the state    (n,), (m, m), m ≥ n
"""

import math

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


@compiled
def exchange_prior(x: FloatArray, P: FloatArray, k: int, before: float, now: float) -> None:
    """x and P as if the variance of state k, whose mean was 0, had been ``now`` a priori and not ``before``.

    A measurement of zero with the variance 1/(1/now − 1/before), which is negative where the prior widens.
    """
    more = 1.0 / now - 1.0 / before
    if abs(more) * before < 1e-6:
        return
    S = P[k, k] + 1.0 / more
    if more < 0.0 and 1e-3 * before > -S:  # nothing is left of the prior to take away
        return
    shared, mean = P[k, :].copy(), x[k]
    for i in range(x.size):
        x[i] -= shared[i] / S * mean
        for j in range(x.size):
            P[i, j] -= shared[i] * shared[j] / S


@compiled
def log_ratio(squared: float, wide: float, narrow: float) -> float:
    """ln of the density of a number by N(0, ``wide``) over that by N(0, ``narrow``), given its square."""
    return (squared * (1.0 / narrow - 1.0 / wide) - math.log(wide / narrow)) / 2.0
