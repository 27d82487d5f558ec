# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Update with measured slips of both tracks; compiled.

    z    i_L, i_R, 1
    h    slips of both tracks by the state and the sprockets (``models``)

Slips are used inside their gate, which widens while they and the state disagree (``gate``). Slips that pass
only the widened gate indicate an error of the state: the covariance of the slips is inflated by ν νᵀ, or the
variance of i₀ by the squared mean of ν.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_common.compiled import compiled, inlined
from trackslip_estimation.kalman.linear_algebra import (
    copy_square,
    log_determinant,
    root,
    weighted_square,
    wrap,
)
from trackslip_estimation.kalman.update import (
    Observation,
    correct,
    independent_observation,
    predicted_covariance,
)
from trackslip_estimation.slip.gate import gate_limit
from trackslip_estimation.slip.measurements import Outcome
from trackslip_estimation.slip.models.dispatch import (
    has_velocity_errors,
    slips,
    slips_jacobian,
    twist,
    twist_jacobian,
)
from trackslip_estimation.slip.models.free_slips import LEFT_SLIP
from trackslip_estimation.slip.models.model import YAW
from trackslip_estimation.slip.models.speed import COMMON_SLIP
from trackslip_estimation.slip.motion import steady_speeds
from trackslip_estimation.slip.validity import LEAST_VARIANCE

if TYPE_CHECKING:
    from trackslip_estimation.slip.config import Config
    from trackslip_estimation.slip.records import MeasurementRecord, Prior, State, Update


_GATED = int(Outcome.GATED)


@compiled
def observe_slips(state: State, measurement: MeasurementRecord, c: Config) -> Observation:
    """ν (2,), H and R of the slips of both tracks, at steady speeds of the sprockets."""
    x, R = state.mean[: c.size], measurement.noise[:2, :2].copy()
    left, right, variance = steady_speeds(state.speeds, state.motion, c.motion_limits)
    for i in range(2):
        R[i, i] = max(R[i, i], LEAST_VARIANCE)
    if variance > 0.0:
        stddev = math.sqrt(variance)
        by_left = (_slips(x, left + stddev, right, c) - _slips(x, left - stddev, right, c)) / 2.0
        by_right = (_slips(x, left, right + stddev, c) - _slips(x, left, right - stddev, c)) / 2.0
        R += np.outer(by_left, by_left) + np.outer(by_right, by_right)
    J = twist_jacobian(x, left, right, c)
    H = slips_jacobian(x, twist(x, left, right, c), J, (left, right), c)[:2].copy()
    return independent_observation(measurement.value[:2] - _slips(x, left, right, c), H, R)


@compiled
def _slips(x: FloatArray, left: float, right: float, c: Config) -> FloatArray:
    """(2,) i_L, i_R."""
    return slips(x, twist(x, left, right, c), left, right, c)[:2].copy()


@inlined
def update_with_slips(
    state: State, measurement: MeasurementRecord, c: Config, update: Update, prior: Prior
) -> None:
    """Gate and update with slips (see the top of the module); arguments as in ``update``."""
    x, P, limit = state.mean[: c.size], state.covariance[:], c.gate_limits[2]
    o = observe_slips(state, measurement, c)
    L = root(predicted_covariance(P, o.jacobian) + o.noise)
    update.nis, update.log_determinant = weighted_square(L, o.innovation), log_determinant(L)
    update.dof, update.gate = 2, gate_limit(state, measurement, 2, c)
    if update.nis > update.gate:
        update.outcome = _GATED
        return
    if update.nis <= limit:
        state.consistent_ns[measurement.source] = measurement.stamp_ns
    else:
        _inflate_slips(P, o.innovation, c)
        copy_square(P, prior.covariance, c.size)
    correct(x, P, o)
    x[YAW] = wrap(x[YAW])


@compiled
def _inflate_slips(P: FloatArray, innovation: FloatArray, c: Config) -> None:
    """Inflate the covariance of slip in P by an innovation of both slips; all else stays."""
    if has_velocity_errors(c):
        P[COMMON_SLIP, COMMON_SLIP] += innovation.mean() ** 2
        return
    for i in range(innovation.size):
        for j in range(innovation.size):
            P[LEFT_SLIP + i, LEFT_SLIP + j] += innovation[i] * innovation[j]
