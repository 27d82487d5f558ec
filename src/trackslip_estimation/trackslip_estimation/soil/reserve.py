# SPDX-License-Identifier: Apache-2.0
"""How near a track is to the limit of its soil: the early warning of getting stuck.

F, σ_F   thrust of the track and its standard deviation     N
F_max    maximal tractive effort of one track               N
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

FloatArray = NDArray[np.float64]


class Reserve(NamedTuple):
    """Of one track."""

    share: float  # 1 − |F|/F_max, its mean: 1 unloaded, 0 at the limit of the soil
    exhausted: float  # probability that |F| exceeds the share of F_max asked about


def thrust_reserve(
    thrust: float, variance: float, log_limits: FloatArray, probabilities: FloatArray, share: float
) -> Reserve:
    """What is left of the strength, given the marginal of F_max.

    Args:
        thrust: F, N.
        variance: σ_F², N².
        log_limits: ln F_max of the cells (n,).
        probabilities: of the cells (n,).
        share: of F_max, beyond which a track is in danger.
    """
    limits = np.exp(log_limits)
    beyond = ndtr((abs(thrust) - share * limits) / np.sqrt(max(variance, np.finfo(float).tiny)))
    return Reserve(
        float(1.0 - abs(thrust) * np.sum(probabilities / limits)), float(np.sum(probabilities * beyond))
    )
