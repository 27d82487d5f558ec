# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Thrust reserve of a track against the strength of its soil, to warn before it gets stuck. Compiled.

F, σ_F   thrust of the track and its standard deviation     N
F_max    maximal tractive effort of one track               N
"""

import math
from typing import NamedTuple

from trackslip_common.arrays import FloatArray
from trackslip_common.compiled import compiled

_LEAST = 1e-300  # N²


class Reserve(NamedTuple):
    """Thrust reserve of one track."""

    share: float  # mean of 1 − |F|/F_max: 1 unloaded, 0 at the limit of the soil
    exhausted: float  # probability that |F| exceeds the given share of F_max


@compiled
def thrust_reserve(
    thrust: float, variance: float, limits: FloatArray, probabilities: FloatArray, share: float
) -> Reserve:
    """Return the thrust reserve, given the marginal distribution of F_max.

    Args:
        thrust: F, N.
        variance: σ_F², N².
        limits: F_max of the cells (n,), N.
        probabilities: those of the cells (n,).
        share: share of F_max beyond which a track is in danger.
    """
    force, per_stddev = abs(thrust), 1.0 / math.sqrt(2.0 * max(variance, _LEAST))
    used = exhausted = 0.0
    for k in range(len(limits)):
        used += probabilities[k] * force / limits[k]
        exhausted += probabilities[k] * 0.5 * math.erfc((share * limits[k] - force) * per_stddev)
    return Reserve(1.0 - used, exhausted)
