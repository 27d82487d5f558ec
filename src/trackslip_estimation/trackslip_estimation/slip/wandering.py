# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Evidence of fixes whose offset drifts, against a motion predicted without them; compiled.

    r      fix minus the position predicted without it                      (2,) m
    p, v   offset of the fixes, and its rate, a random walk                 (2,) m, m/s
    P      covariance of p and v, the same for both axes
    S      variance of r

While a branch assumes that a receiver wanders, no position of that receiver updates the state. The offset
starts at zero; v has a standard deviation of half of ``events.wander_speed``. A faster offset indicates a
motion that the tracks do not measure: each such fix lowers the evidence of the branch.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from trackslip_common.arrays import FloatArray
from trackslip_common.compiled import compiled
from trackslip_common.record_types import Record
from trackslip_estimation.kalman.constant_velocity import RateCovariance, propagate_rate_covariance
from trackslip_estimation.slip.measurements import Outcome
from trackslip_estimation.slip.models.model import YAW, X, Y

if TYPE_CHECKING:
    from trackslip_estimation.kalman.update import Observation
    from trackslip_estimation.slip.config import Config
    from trackslip_estimation.slip.records import Update

_GATED = int(Outcome.GATED)
_LOG_TWO_PI = math.log(2.0 * math.pi)


class Wander(Record):
    """Offset of a pose source."""

    east: float  # p, m
    north: float
    east_speed: float  # v, m/s
    north_speed: float
    variance: float  # of p, m²
    covariance: float  # of p and v, m²/s
    speed_variance: float  # (m/s)²
    predicted_variance: float  # variance by axis of the position predicted for the previous fix, m²


@compiled
def begin_wander(wander: Wander, P: FloatArray, c: Config) -> None:
    """Initialise the offset of a receiver whose fixes agreed so far with a state of covariance P."""
    wander.east = wander.north = wander.east_speed = wander.north_speed = wander.covariance = 0.0
    wander.variance = wander.predicted_variance = (P[X, X] + P[Y, Y]) / 2.0
    wander.speed_variance = c.events.wander_speed**2 / 4.0


@compiled
def weigh_wander(
    wander: Wander, o: Observation, predicted: FloatArray, dt: float, c: Config, update: Update
) -> None:
    """Update the offset with a fix ``dt`` s after the previous one; set its evidence.

    ``predicted``: H P Hᵀ (m, m).
    """
    _propagate(wander, dt, c)
    predicted_variance = (predicted[X, X] + predicted[Y, Y]) / 2.0
    wander.variance += max(predicted_variance - wander.predicted_variance, 0.0)
    wander.predicted_variance = predicted_variance
    S = wander.variance + (o.noise[X, X] + o.noise[Y, Y]) / 2.0
    gain, speed_gain = wander.variance / S, wander.covariance / S
    east, north = o.innovation[X] - wander.east, o.innovation[Y] - wander.north
    wander.east += gain * east
    wander.north += gain * north
    wander.east_speed += speed_gain * east
    wander.north_speed += speed_gain * north
    wander.speed_variance -= speed_gain * wander.covariance
    wander.covariance *= 1.0 - gain
    wander.variance *= 1.0 - gain
    update.dof, update.gate, update.outcome = YAW, c.gate_limits[YAW], _GATED
    update.nis, update.log_determinant = (east * east + north * north) / S, 2.0 * math.log(S)
    update.evidence = (
        -(update.nis + update.log_determinant) / 2.0 - _LOG_TWO_PI - _log_speed_penalty(wander, c)
    )


@compiled
def _propagate(wander: Wander, dt: float, c: Config) -> None:
    """Propagate p, v and P by ``dt`` s."""
    wander.east += wander.east_speed * dt
    wander.north += wander.north_speed * dt
    before = RateCovariance(wander.variance, wander.covariance, wander.speed_variance)
    wander.variance, wander.covariance, wander.speed_variance = propagate_rate_covariance(
        before, dt, c.events.wander_walk
    )


@compiled
def _log_speed_penalty(wander: Wander, c: Config) -> float:
    """Reduction of ln of the likelihood for an offset faster than ``events.wander_speed``."""
    excess = max(math.hypot(wander.east_speed, wander.north_speed) - c.events.wander_speed, 0.0)
    return excess * excess / (2.0 * wander.speed_variance)
