# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Least squares whose intervals hold although neighbouring errors are correlated.

    z = X β + e     measured, design, coefficients, errors      (n,), (n, p), (p,), (n,)

``fit_clustered``: errors may be correlated within a cluster (a second of data, a turn), not between clusters.
The covariance of β is the jackknife's: the scatter of β when each cluster in turn is left out.

``fit_increments``: z are increments between noisy readings of a random walk:

    Var z_k = q w_k + ρ (R_{k−1} + R_k)      Cov(z_k, z_{k+1}) = −ρ R_k

R are the variances stated in the readings, w_k the exposure of the walk (time, distance). ρ is found by
restricted maximum likelihood. The likelihood hardly separates a small walk from none, so it weights an
average of β over √q: a single best q would make the interval too narrow. The covariance is tridiagonal, so
all this is cheap.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.linalg import LinAlgError, cholesky_banded, solve_banded
from scipy.optimize import minimize
from scipy.special import stdtrit

from trackslip_common.arrays import BoolArray, FloatArray, IntArray

CONFIDENCE = 0.95
_NEGLIGIBLE_DIFFERENCE = 12.0  # of −2 log likelihood above its minimum
_GRID_SIZE = 24  # values of √q


class Fit(NamedTuple):
    """Estimate of β and its covariance."""

    values: FloatArray  # (p,)
    covariance: FloatArray  # (p, p)
    dof: int

    def half_width(self, index: int = 0) -> float:
        """Half the width of a coefficient's 95 % interval."""
        variance = float(self.covariance[index, index])
        return half_width(math.sqrt(variance), self.dof) if variance >= 0.0 else math.nan


class Increments(NamedTuple):
    """Differences of neighbouring readings, in order of time."""

    z: FloatArray  # (n,)
    variance_before: FloatArray  # (n,) stated variance of the earlier reading
    variance_after: FloatArray  # (n,) stated variance of the later reading
    walk: FloatArray  # (n,) w
    joined: BoolArray  # (n,) whether the earlier reading ends the increment before

    @staticmethod
    def of_parts(parts: "Sequence[Increments]") -> "Increments":
        """The increments of several parts, one after the other."""
        return Increments(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))


def half_width(stddev: float, dof: int) -> float:
    """Half the width of the 95 % interval of a mean."""
    return float(stdtrit(max(dof, 1), (1.0 + CONFIDENCE) / 2.0)) * stddev


def fit_clustered(X: FloatArray, z: FloatArray, clusters: IntArray) -> Fit | None:
    """Ordinary least squares; ``clusters`` (n,) numbers the cluster of each row. None: too few clusters."""
    names, cluster_of_row = np.unique(clusters, return_inverse=True)
    count, size = len(names), X.shape[1]
    if count <= size:
        return None
    products = np.zeros((count, size, size + 1))  # XᵀX and Xᵀz of each cluster
    for i in range(size):
        for k, column in enumerate((*X.T, z)):
            products[:, i, k] = np.bincount(cluster_of_row, X[:, i] * column, count)
    total = products.sum(axis=0)
    values = _solve_normal_equations(total[np.newaxis])
    without = _solve_normal_equations(total - products)
    if values is None or without is None:  # a single cluster determines a coefficient
        return None
    deviations = without - values
    return Fit(values[0], (count - 1) / count * deviations.T @ deviations, count - 1)


def fit_increments(X: FloatArray, data: Increments) -> Fit | None:
    """Generalised least squares with noise of unknown size; X (n, p). None: too few increments."""
    if len(data.z) <= X.shape[1] + 2:
        return None
    typical = float(np.median(data.variance_before + data.variance_after))
    start = np.log((0.1 * typical / max(float(np.median(data.walk)), 1e-9), 1.0))

    def cost(logs: FloatArray) -> float:
        solved = _fit_given_variances(X, data, *np.exp(np.clip(logs, -60.0, 60.0)))
        return math.inf if solved is None else solved[0]

    best = minimize(cost, start, method="Nelder-Mead", options={"xatol": 0.02, "fatol": 0.02, "maxiter": 200})
    q, rho = np.exp(np.clip(best.x, -60.0, 60.0))
    return _average_fits(X, data, math.sqrt(max(q, 1e-6 * np.exp(start[0]))), rho)


def _average_fits(X: FloatArray, data: Increments, size: float, rho: float) -> Fit | None:
    """Average over √q from 0 to where the likelihood is negligible; ``size`` is a √q of high likelihood."""
    lowest = _fit_given_variances(X, data, size**2, rho)
    if lowest is None:
        return None
    limit = lowest[0] + _NEGLIGIBLE_DIFFERENCE
    while (farther := _fit_given_variances(X, data, size**2, rho)) is not None and farther[0] <= limit:
        size *= 2.0
    fits = [_fit_given_variances(X, data, root**2, rho) for root in np.linspace(0.0, size, _GRID_SIZE)]
    solved = [fit for fit in fits if fit is not None]
    costs = np.array([fit[0] for fit in solved])
    weights = np.exp((costs.min() - costs) / 2.0)
    weights /= weights.sum()
    values = sum(w * fit[1] for w, fit in zip(weights, solved, strict=True))
    covariance = sum(
        w * (fit[2] + np.outer(fit[1] - values, fit[1] - values))
        for w, fit in zip(weights, solved, strict=True)
    )
    return Fit(np.asarray(values), np.asarray(covariance), len(data.z) - X.shape[1])


def _fit_given_variances(
    X: FloatArray, data: Increments, q: float, rho: float
) -> tuple[float, FloatArray, FloatArray] | None:
    """−2 log likelihood (restricted), β and its covariance; None for indefinite covariances."""
    diagonals = np.zeros((2, len(data.z)))
    diagonals[0] = q * data.walk + rho * (data.variance_before + data.variance_after)
    diagonals[1, :-1] = np.where(data.joined[1:], -rho * data.variance_before[1:], 0.0)
    try:
        L = cholesky_banded(diagonals, lower=True)
        whitened = solve_banded((1, 0), L, np.column_stack((X, data.z)))
        A = whitened[:, :-1].T @ whitened[:, :-1]
        covariance = np.linalg.inv(A)
    except (LinAlgError, np.linalg.LinAlgError, ValueError):
        return None
    values = covariance @ (whitened[:, :-1].T @ whitened[:, -1])
    residuals = whitened[:, -1] - whitened[:, :-1] @ values
    sign, logarithm = np.linalg.slogdet(A)
    cost = 2.0 * float(np.sum(np.log(L[0]))) + float(logarithm) + float(residuals @ residuals)
    return (cost, values, covariance) if sign > 0.0 and math.isfinite(cost) else None


def _solve_normal_equations(normal: FloatArray) -> FloatArray | None:
    """(c, p) A⁻¹ b, of A beside b (c, p, p + 1); None if an A is singular to within rounding."""
    A, b = normal[:, :, :-1], normal[:, :, -1]
    diagonals = np.diagonal(A, axis1=1, axis2=2)
    if not (diagonals > 0.0).all():
        return None
    scale = np.sqrt(diagonals)
    unit = A / scale[:, :, np.newaxis] / scale[:, np.newaxis, :]
    if (np.linalg.cond(unit) > 1e12).any():
        return None
    solved: FloatArray = np.linalg.solve(unit, (b / scale)[:, :, np.newaxis])[:, :, 0] / scale
    return solved
