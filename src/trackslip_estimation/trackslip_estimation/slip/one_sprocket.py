# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Speed of a track that its sprocket does not measure, from the other sprocket and a gyro; compiled.

    x            mean of the state
    ω_L, ω_R     sprocket speeds                                    rad/s
    ω(ω_L, ω_R)  yaw rate of the motion model, linear in both       rad/s
    ω_g          yaw rate by the latest reading of a gyro           rad/s

The missing speed is the one at which the model turns at ω_g. An encoder that fails, a track that spins or one
that is blocked are explained alike: the other track and the gyro determine the motion.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from trackslip_common.compiled import compiled
from trackslip_estimation.slip.models.dispatch import twist
from trackslip_estimation.slip.models.model import GYRO_BIAS, GYRO_SCALE, SWING_RATE
from trackslip_estimation.slip.models.speed import YAW_RATE_ERROR
from trackslip_estimation.slip.records import GYROS, MOST_SOURCES
from trackslip_estimation.slip.source_faults import IS_HEALTHY, IS_LEFT_FAILED

if TYPE_CHECKING:
    from trackslip_estimation.slip.config import Config
    from trackslip_estimation.slip.motion import SpeedsRecord
    from trackslip_estimation.slip.records import State

_LEAST_TURNING = 0.1  # yaw rate over that without slip, below which the missing speed is unknown


@compiled
def latest_rate(state: State, c: Config) -> float:
    """Yaw rate of the machine by its latest consistent gyro reading, rad/s; NaN: none within the timeout."""
    rate, latest_ns = math.nan, state.stamp_ns - c.sprocket_timeout_ns
    for source in range(MOST_SOURCES):
        last = state.readings[source]
        if c.is_gyro[source] == 0 or state.consistent_ns[source] <= latest_ns:
            continue
        latest_ns, index = state.consistent_ns[source], c.source_states[source]
        bias = state.mean[GYRO_BIAS if index < 0 else index]
        rate = (last.value / c.rate_scale[source] - bias) / (1.0 + state.mean[GYRO_SCALE])
        if c.above[source] == 1:
            rate -= state.mean[SWING_RATE]
    return float(rate if state.fault[GYROS] == IS_HEALTHY else math.nan)


@compiled
def set_missing_speed(state: State, speeds: SpeedsRecord, fault: int, c: Config) -> bool:
    """Set the speed of the track whose sprocket has the ``fault``; return whether it is known."""
    rate = latest_rate(state, c)
    x = state.mean[: c.size].copy()
    x[YAW_RATE_ERROR] = 0.0
    is_left = fault == IS_LEFT_FAILED
    measured = speeds.right if is_left else speeds.left
    straight = twist(x, measured, measured, c)[2]
    slope = twist(x, measured + 1.0, measured, c)[2] - straight  # by the left one
    if math.isnan(rate) or abs(slope) * c.tread < _LEAST_TURNING * c.rolling_radius:
        return False
    missing = measured + (rate - straight) / (slope if is_left else -slope)
    missing = min(max(missing, -c.max_sprocket_speed), c.max_sprocket_speed)
    speeds.left, speeds.right = (missing, measured) if is_left else (measured, missing)
    return True
