# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Errors that each source has of its own: numbers of the state from ``SENSOR_ERRORS`` on; compiled.

The first gyro's bias is that of the model, which what it learned keeps. Every further one has its own: while
its readings are used, the two change places in the state.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from trackslip_common.compiled import compiled
from trackslip_estimation.slip.models.model import GYRO_BIAS

FloatArray = NDArray[np.float64]


@compiled
def exchange_bias(state: Any, update: Any, own: int) -> None:
    """The bias at the place ``own`` for that of the first gyro, and back again; nothing where it is −1."""
    if own < 0:
        return
    _exchange(state.mean, state.covariance, own)
    _exchange(update.prior_mean, update.prior_covariance, own)


@compiled
def _exchange(x: FloatArray, P: FloatArray, own: int) -> None:
    x[GYRO_BIAS], x[own] = x[own], x[GYRO_BIAS]
    for j in range(x.size):
        P[GYRO_BIAS, j], P[own, j] = P[own, j], P[GYRO_BIAS, j]
    for i in range(x.size):
        P[i, GYRO_BIAS], P[i, own] = P[i, own], P[i, GYRO_BIAS]
