# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Operations on one state of a Gaussian: replace, decay, add, limit, change its prior; compiled, in place.

The decay is that of a first-order Gauss–Markov process.

x, P   mean and covariance of the state    (n,), (m, m), m ≥ n
"""

import math

from trackslip_common.arrays import FloatArray
from trackslip_common.compiled import compiled


@compiled
def replace_state(x: FloatArray, P: FloatArray, k: int, mean: float, variance: float) -> None:
    """Give state k a new mean and variance, uncorrelated with the others."""
    x[k] = mean
    for j in range(P.shape[0]):
        P[k, j] = P[j, k] = 0.0
    P[k, k] = variance


@compiled
def decay_state(x: FloatArray, P: FloatArray, k: int, share: float, variance: float) -> None:
    """Decay state k to a ``share`` of itself; ``variance`` is that of the Gauss–Markov process."""
    x[k] *= share
    for j in range(P.shape[0]):
        P[k, j] *= share
    for j in range(P.shape[0]):
        P[j, k] *= share
    P[k, k] += (1.0 - share * share) * variance


@compiled
def add_state(P: FloatArray, to: int, added: int, factor: float) -> None:
    """Transform P for a state ``to`` that gains ``factor`` times state ``added``; in place."""
    for j in range(P.shape[1]):
        P[to, j] += factor * P[added, j]
    for i in range(P.shape[0]):
        P[i, to] += factor * P[i, added]


@compiled
def limit_stddev(P: FloatArray, k: int, largest: float) -> None:
    """Limit the standard deviation of state k, of an angle to that of a uniform one; correlations stay."""
    if P[k, k] > largest * largest:
        share = largest / math.sqrt(P[k, k])
        for j in range(P.shape[0]):
            P[k, j] *= share
        for j in range(P.shape[0]):
            P[j, k] *= share


@compiled
def replace_prior_variance(x: FloatArray, P: FloatArray, k: int, before: float, now: float) -> None:
    """x and P as if the prior variance of state k, of prior mean 0, had been ``now`` and not ``before``.

    This is a measurement of zero with the variance 1/(1/now − 1/before), negative where the prior widens.
    """
    information = 1.0 / now - 1.0 / before
    if abs(information) * before < 1e-6:
        return
    S = P[k, k] + 1.0 / information
    if information < 0.0 and 1e-3 * before > -S:  # the prior has no information left to remove
        return
    row, mean = P[k, :].copy(), x[k]
    for i in range(x.size):
        x[i] -= row[i] / S * mean
        for j in range(x.size):
            P[i, j] -= row[i] * row[j] / S


@compiled
def log_ratio(squared: float, wide: float, narrow: float) -> float:
    """ln of the density of a number by N(0, ``wide``) over that by N(0, ``narrow``), given its square."""
    return (squared * (1.0 / narrow - 1.0 / wide) - math.log(wide / narrow)) / 2.0
