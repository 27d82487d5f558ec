# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Which yaw rates and slips are used: a χ² gate that widens while source and state disagree; compiled.

    ν, S    innovation and its covariance
    d²      νᵀ S⁻¹ ν, used where d² ≤ w g
    g       χ² quantile; source and state are consistent where d² ≤ g
    w       1 until they have not been for the source's timeout, then ``relaxation`` per further timeout; of a
            silence no more than a timeout counts, and none where they agreed before

So a spike stays out, even the first reading after an outage, and a source that insists is believed in the
end: the time that takes grows with the logarithm of how far off it is. What passes only because the gate is
wide says that the state was wrong: its covariance is widened by what the innovation shows before the update,
that of the slips by ν νᵀ, or that of the gyro's bias by ν². A gyro is consistent at once, for now its bias
explains what it shows. Poses, headings and swing angles are weighed by ``bank``.

In a turn a gyro may show what the machine would do on other ground: a yaw rate from none to that without
slip. If several in a row do, and agree with each other, the ground has changed, and what was learned of
turning and slip counts for no more than at the start. What it would do on no ground, to turn against its
tracks, is never used: a gyro upside down shows that.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from trackslip_common.compiled import compiled
from trackslip_estimation.slip.models.dispatch import couple, has_velocity_errors, twist
from trackslip_estimation.slip.models.free_slips import LEFT_SLIP
from trackslip_estimation.slip.models.speed import COMMON_SLIP, FIRST, SECOND, YAW_RATE_ERROR

FloatArray = NDArray[np.float64]

_WIDEST = 100.0  # timeouts: beyond, the gate is open to anything finite
_DOUBT = 4.0  # standard deviations
_LAG = 0.1  # of the yaw rate without slip, by which the machine may still turn the other way
_PERSISTS = 0.5  # of its departure that a reading must share with the first of a streak
_ALIKE = 0.1  # of the yaw rate without slip, by which readings that agree may differ


@compiled
def width(refused_ns: int, timeout_ns: int, relaxation: float) -> float:
    """w."""
    if refused_ns <= timeout_ns:
        return 1.0
    widened: float = relaxation ** min(refused_ns / timeout_ns - 1.0, _WIDEST)
    return widened


@compiled
def on_no_ground(rate: float, variance: float, speeds: tuple[float, float], c: Any) -> bool:
    """Whether the machine would turn against its tracks, beyond what noise and bias explain."""
    without_slip = _without_slip(speeds, c)
    allowed = _DOUBT * np.sqrt(variance) + _LAG * abs(without_slip)
    return has_velocity_errors(c) and rate * np.sign(without_slip) < -allowed


@compiled
def other_ground(rate: float, x: FloatArray, streak: Any, speeds: tuple[float, float], c: Any) -> bool:
    """Whether some ground lets the machine turn so, and enough readings in a row show the same one.

    After the first, a reading counts that agrees with it and departs half as far at the least from the yaw
    rate by what the state x has learned of turning.
    """
    without_slip = _without_slip(speeds, c)
    if not (rate * without_slip > 0.0 and abs(rate) < abs(without_slip)) or not has_velocity_errors(c):
        streak.count = 0
        return False
    learned = twist(x, speeds[0], speeds[1], c)[2] - x[YAW_RATE_ERROR]
    efficiency, departure = rate / without_slip, (rate - learned) / without_slip
    alike = streak.count > 0 and abs(efficiency - streak.value) <= _ALIKE
    if not alike or departure * streak.departure < _PERSISTS * streak.departure**2:
        streak.count, streak.value, streak.departure = 1, efficiency, departure
    else:
        streak.count += 1
    return bool(streak.count >= c.gate_confirmations)


@compiled
def forget_ground(P: FloatArray, c: Any) -> None:
    """How the vehicle turns and slips is no better known than at the start."""
    P[FIRST, FIRST] += c.velocity_errors.first_variance
    P[SECOND, SECOND] += c.velocity_errors.second_variance
    couple(P, c.velocity_errors.first_variance, c)
    P[COMMON_SLIP, COMMON_SLIP] += c.velocity_errors.slip_variance


@compiled
def _without_slip(speeds: tuple[float, float], c: Any) -> float:
    """Yaw rate of the sprockets, rad/s."""
    rate: float = c.rolling_radius * (speeds[1] - speeds[0]) / c.tread
    return rate


@compiled
def widen_slips(P: FloatArray, innovation: FloatArray, c: Any) -> None:
    """P, widened by what an innovation of both slips shows; what else was learned stays."""
    if has_velocity_errors(c):
        P[COMMON_SLIP, COMMON_SLIP] += innovation.mean() ** 2
        return
    for i in range(innovation.size):
        for j in range(innovation.size):
            P[LEFT_SLIP + i, LEFT_SLIP + j] += innovation[i] * innovation[j]
