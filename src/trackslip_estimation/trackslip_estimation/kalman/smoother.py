# SPDX-License-Identifier: Apache-2.0
"""Fixed-interval smoother (Rauch, Tung & Striebel) behind an extended Kalman filter, compiled.

x_k, P_k      mean and covariance by the filter, after measurement k          (n,), (n, n)
x⁻_k, P⁻_k    the same before that measurement, predicted from k − 1          (n,), (n, n)
F_k, Q_k      transition from k − 1 to k, process noise P⁻_k − F_k P_{k−1} F_kᵀ  (n, n)
x̂_k, P̂_k      mean and covariance given all measurements, later ones too      (n,), (n, n)
G_k           gain P_{k−1} F_kᵀ (P⁻_k)⁻¹                                      (n, n)

    x̂_{k−1} = x_{k−1} + G_k (x̂_k − x⁻_k)
    P̂_{k−1} = (I − G_k F_k) P_{k−1} (I − G_k F_k)ᵀ + G_k (P̂_k + Q_k) G_kᵀ

The covariance is the usual P + G (P̂ − P⁻) Gᵀ as a sum of positive terms. G comes from a Cholesky solve that
leaves out directions in which P⁻ has no variance: what is known for certain stays as it is.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trackslip_common.compiled import compiled
from trackslip_estimation.kalman.linear_algebra import apply, joseph, root, sandwich, solve, times, wrap
from trackslip_estimation.slip.filter import Filter, RecordArray
from trackslip_estimation.slip.models import dispatch as equations
from trackslip_estimation.slip.models.model import YAW, Gaussian
from trackslip_estimation.slip.motion import Motion, Speeds

FloatArray = NDArray[np.float64]


class Step(NamedTuple):
    """What the filter did between two measurements, and with the second."""

    predicted: Gaussian | None  # before the measurement; None: this state does not follow from the one before
    filtered: Gaussian  # after it
    speeds: Speeds  # of the sprockets in between
    motion: Motion
    dt: float  # s since the step before


def smooth(steps: Sequence[Step], filter_: Filter) -> list[Gaussian]:
    """The state after each step given all measurements up to the next break in the chain."""
    if not steps:
        return []
    means = np.array([step.filtered.mean for step in steps])
    covariances = np.array([step.filtered.covariance for step in steps])
    before = [step.filtered if step.predicted is None else step.predicted for step in steps]
    follows = np.array([step.predicted is not None for step in steps])
    inputs = np.array([(step.speeds.left, step.speeds.right, step.dt) for step in steps])
    motions = np.array([step.motion for step in steps], dtype=np.int64)
    smoothed = smooth_back(
        means,
        covariances,
        np.array([state.mean for state in before]),
        np.array([state.covariance for state in before]),
        _transitions(means, inputs, motions, filter_.constants),
        follows,
    )
    return [Gaussian(*state) for state in zip(*smoothed, strict=True)]


@compiled
def smooth_back(
    x: FloatArray,
    P: FloatArray,
    x_before: FloatArray,
    P_before: FloatArray,
    F: FloatArray,
    follows: NDArray[np.bool_],
) -> tuple[FloatArray, FloatArray]:
    """x̂ (k, n) and P̂ (k, n, n) of k steps; ``before`` is x⁻, P⁻. A step that does not follow begins anew.

    The third number of a state is a heading.
    """
    x_smoothed, P_smoothed = x.copy(), P.copy()
    for k in range(x.shape[0] - 1, 0, -1):
        if not follows[k]:
            continue
        G = np.ascontiguousarray(solve(root(P_before[k]), times(F[k], P[k - 1])).T)
        news = x_smoothed[k] - x_before[k]
        if news.size > YAW:
            news[YAW] = wrap(news[YAW])
        x_smoothed[k - 1] += apply(G, news)
        if news.size > YAW:
            x_smoothed[k - 1, YAW] = wrap(x_smoothed[k - 1, YAW])
        Q = P_before[k] - sandwich(F[k], P[k - 1])
        P_smoothed[k - 1] = joseph(P[k - 1], G, F[k], P_smoothed[k] + Q)
    return x_smoothed, P_smoothed


@compiled
def _transitions(
    x: FloatArray, inputs: FloatArray, motions: NDArray[np.int64], constants: RecordArray
) -> FloatArray:
    """(k, n, n) F of each step, about the state of the step before; ``inputs`` (k, 3): ω_L, ω_R, dt."""
    count, n = x.shape
    F = np.empty((count, n, n))
    F[0] = np.eye(n)
    for k in range(1, count):
        left, right, dt = inputs[k]
        F[k] = equations.transition(x[k - 1], left, right, dt, motions[k], constants[0])
    return F
