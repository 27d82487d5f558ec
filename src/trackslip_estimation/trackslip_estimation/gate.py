# SPDX-License-Identifier: Apache-2.0
"""The gate on innovations: a χ² probability, wider the longer a source and the state have not agreed.

    ν, S    innovation and its covariance
    d²      νᵀ S⁻¹ ν, taken where d² ≤ w g
    g       χ² quantile; source and state agree where d² ≤ g
    w       1 until they have not agreed for the source's timeout, then ``relaxation`` per further timeout

So a spike stays out, and a source that insists, or comes back after an outage, is believed in the end: the
time that takes grows with the logarithm of how far off it is. What passes only because the gate is wide says
that the state was wrong: its covariance is widened by what the innovation shows before the update. For poses
the gate stays wide until they agree again: a state that goes wrong all the time is put right all the time.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from trackslip_estimation.filters.model import POSE, Gaussian

FloatArray = NDArray[np.float64]

_WIDEST = 100.0  # timeouts: beyond, the gate is open to anything finite


class Gate:
    """χ² limits by degrees of freedom."""

    def __init__(self, probability: float, relaxation: float) -> None:
        self.limits = {dof: float(chi2.ppf(probability, dof)) for dof in (1, 2, 3)}
        self._relaxation = relaxation

    def width(self, apart_ns: int, timeout_ns: int) -> float:
        """w, where the two have not agreed for so long."""
        if apart_ns <= timeout_ns:
            return 1.0
        return float(self._relaxation ** min(apart_ns / timeout_ns - 1.0, _WIDEST))


def admit_pose(state: Gaussian, innovation: FloatArray) -> Gaussian:
    """P + ν νᵀ: the pose may be as wrong as the fix says, by ν (3,); what else was learned stays."""
    surprise = np.zeros(state.mean.size)
    surprise[POSE] = innovation
    return Gaussian(state.mean, state.covariance + np.outer(surprise, surprise))


def admit_bias(state: Gaussian, innovation: float) -> Gaussian:
    """P + ν² at the bias of the gyro, the last of every model's states."""
    covariance = state.covariance.copy()
    covariance[-1, -1] += innovation**2
    return Gaussian(state.mean, covariance)
