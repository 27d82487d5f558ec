# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Effect of the attitude on a motion along the ground (record ``LEVEL``); compiled."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from trackslip_common.arrays import FloatArray
from trackslip_common.compiled import compiled
from trackslip_estimation.attitude.records import BIAS_Q, PITCH, ROLL

if TYPE_CHECKING:
    from trackslip_estimation.attitude.records import Attitude, Level


_CORRELATION_TIMES = 1.0, 10.0  # s, correlation times of the errors of tilt and gyro bias


@compiled
def set_level(a: Attitude) -> None:
    """Set the ``level`` of the record ``a`` of ``ATTITUDE`` from its tilt and rates, in place."""
    level, P = a.level, a.covariance
    level.known = a.known
    roll, pitch = (a.mean[ROLL], a.mean[PITCH]) if a.known == 1 else (0.0, 0.0)
    sin, cos, sin_pitch, cos_pitch = math.sin(roll), math.cos(roll), math.sin(pitch), math.cos(pitch)
    level.forward, level.sideways, level.across = cos_pitch - 1.0, cos - 1.0, sin * sin_pitch
    level.turn, level.yaw_rate_offset = cos / cos_pitch - 1.0, a.rates[1] * sin / cos_pitch
    level.downhill_x, level.downhill_y = sin_pitch, -sin * cos_pitch
    level.lean_x, level.lean_y = cos * sin_pitch, -sin
    level.lean_variance = max(P[ROLL, ROLL], P[PITCH, PITCH]) if a.known == 1 else 0.0
    by_roll = (a.rates[1] * cos - a.rates[2] * sin) / cos_pitch
    tilt_time, bias_time = _CORRELATION_TIMES
    level.turn_variance = 0.0
    if a.known == 1:
        level.turn_variance = by_roll**2 * P[ROLL, ROLL] * tilt_time
        level.turn_variance += (sin / cos_pitch) ** 2 * P[BIAS_Q, BIAS_Q] * bias_time


@compiled
def climb_rate_variance(level: Level, covariance: FloatArray) -> float:
    """Variance of ż, (m/s)², from the ``covariance`` of v_x and v_y along the ground."""
    x, y = level.downhill_x, level.downhill_y
    return float(x * x * covariance[0, 0] + 2.0 * x * y * covariance[0, 1] + y * y * covariance[1, 1])
