# SPDX-License-Identifier: Apache-2.0
"""Extended Kalman filter, generic over the model.

x, P   mean and covariance of the state      (n,), (n, n)
F, Q   transition Jacobian, process noise    (n, n), (n, n)
z, R   measurement and its covariance        (m,), (m, m)
h, H   predicted measurement, its Jacobian   (m,), (m, n)
ν, S   innovation z − h and its covariance   (m,), (m, m)
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


class Gaussian(NamedTuple):
    """Mean and covariance of the state."""

    mean: FloatArray  # (n,)
    covariance: FloatArray  # (n, n)


class Linearised(NamedTuple):
    """A measurement as the filter sees it at the present state."""

    innovation: FloatArray  # (m,) ν, angles wrapped
    jacobian: FloatArray  # (m, n) H
    noise: FloatArray  # (m, m) R


class Innovation(NamedTuple):
    """A measurement held against the prediction."""

    covariance: FloatArray  # (m, m) S
    nis: float  # νᵀ S⁻¹ ν, χ² with m degrees of freedom if all is honest


def wrap(angle: float) -> float:
    """The same angle in (−π, π]."""
    return float(-((-angle + np.pi) % (2.0 * np.pi) - np.pi))


def predict(state: Gaussian, mean: FloatArray, transition: FloatArray, noise: FloatArray) -> Gaussian:
    """P' = F P Fᵀ + Q, around the mean that the model has already moved on."""
    return Gaussian(mean, transition @ state.covariance @ transition.T + noise)


def weigh(state: Gaussian, measured: Linearised) -> Innovation:
    """S = H P Hᵀ + R and the normalised innovation squared."""
    covariance = measured.jacobian @ state.covariance @ measured.jacobian.T + measured.noise
    nis = float(measured.innovation @ np.linalg.solve(covariance, measured.innovation))
    return Innovation(covariance, nis)


def update(state: Gaussian, measured: Linearised, innovation: Innovation) -> Gaussian:
    """Joseph form, which keeps P symmetric and positive whatever the gain."""
    H = measured.jacobian
    gain = np.linalg.solve(innovation.covariance, H @ state.covariance).T
    keep = np.eye(state.mean.size) - gain @ H
    covariance = keep @ state.covariance @ keep.T + gain @ measured.noise @ gain.T
    return Gaussian(state.mean + gain @ measured.innovation, (covariance + covariance.T) / 2.0)
