# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""How likely measurements of a source at fault are: outliers, scatter, repeats; compiled."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from trackslip_common.compiled import compiled
from trackslip_common.record_types import FloatArray
from trackslip_estimation.kalman.update import Observation
from trackslip_estimation.slip.events import AREA
from trackslip_estimation.slip.measurements import Outcome
from trackslip_estimation.slip.models.model import YAW, X, Y
from trackslip_estimation.slip.records import POSE, VELOCITY

if TYPE_CHECKING:
    from trackslip_estimation.slip.config import Config
    from trackslip_estimation.slip.records import Update

_GATED = int(Outcome.GATED)
_LOG_TURN = math.log(2.0 * math.pi)


@compiled
def log_density_of_any_size(squared: float, c: Config) -> float:
    """ln of the density of a place (2,) that errs by ``squared`` m², any logarithm of which is as likely."""
    return -math.log(2.0 * math.pi * c.bank.outlier_sizes * squared)


@compiled
def density_of_outlier(kind: int, o: Observation, predicted: FloatArray, c: Config) -> float:
    """ln of the density of an outlier: any angle, or a place or a velocity off by no less than expected."""
    if kind not in (POSE, VELOCITY):
        return -_LOG_TURN
    squared, expected, m = 0.0, 0.0, o.innovation.size
    for axis in range(min(m, YAW)):
        squared += o.innovation[axis] ** 2
        expected += predicted[axis, axis] + o.noise[axis, axis]
    if m == 1:
        return -math.log(2.0 * c.bank.outlier_sizes * math.sqrt(max(squared, expected)))
    return log_density_of_any_size(max(squared, expected), c) - (_LOG_TURN if m > YAW else 0.0)


@compiled
def density_of_scatter(kind: int, innovation: FloatArray, c: Config) -> float:
    """ln of the density of a measurement of a source that scatters: any place, angle or speed.

    Places are those of an area; farther ones err by any size.
    """
    m = innovation.size
    if kind == VELOCITY:
        return -math.log(math.pi * c.unknown_speed**2 if m > 1 else 2.0 * c.unknown_speed)
    if kind != POSE:
        return -_LOG_TURN
    squared = innovation[X] ** 2 + innovation[Y] ** 2
    place = log_density_of_any_size(squared, c) if squared > AREA else -math.log(AREA)
    return place - (_LOG_TURN if m > YAW else 0.0)


@compiled
def is_repeated(update: Update, c: Config) -> bool:
    """Whether a fix is the one before, but for the rounding of a map projection."""
    return bool(update.again <= c.gate_limits[YAW] * c.bank.repeat_stddev**2)


@compiled
def may_repeat(update: Update, c: Config) -> bool:
    """Whether a fix differs from the one before by no more than the noise that both state."""
    return bool(update.again <= 2.0 * c.gate_limits[YAW] * update.stated**2)


@compiled
def weigh_repeat(m: int, stays: bool, c: Config, update: Update) -> None:
    """Evidence of a source that repeats itself, or ``stays`` where it was, by the distance to its fix before.

    No fix tells a source that stays, and jitters on, from a machine that is stuck: such a fix is *tied*, as
    likely as in the most probable branch that may use it (``bank.rows``).
    """
    limit, stddev = c.gate_limits[YAW], c.bank.repeat_stddev
    if stays:
        update.tied, stddev = int(may_repeat(update, c)), math.sqrt(2.0) * update.stated
    update.dof, update.gate, update.nis = YAW, limit, update.again / stddev**2
    squared = update.nis if update.nis <= limit else 2.0 * math.sqrt(limit * update.nis) - limit
    heading = _LOG_TURN if m > YAW else 0.0
    update.evidence = -(squared + 4.0 * math.log(stddev)) / 2.0 - _LOG_TURN - heading
    update.outcome = _GATED
