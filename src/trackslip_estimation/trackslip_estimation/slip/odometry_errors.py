# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""By how much odometry and tracks may differ; compiled. Symbols as in ``odometry``."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trackslip_common.compiled import compiled
from trackslip_estimation.slip.models import speed
from trackslip_estimation.slip.models.dispatch import body_twist, has_velocity_errors
from trackslip_estimation.slip.models.model import LASTS, YAW, X, Y
from trackslip_estimation.slip.motion import rounding

FloatArray = NDArray[np.float64]
_MOST_SHARED = 0.7  # correlation of the place with what is open of two speeds


@compiled
def unseen_errors(
    state: Any, before: Any, drive: tuple[float, float, float], c: Any
) -> tuple[tuple[float, float], FloatArray]:
    """By how much the means of both velocity errors over T err as they do at its end, and D (3,).

    Where the sprockets are silent the machine may go as fast as it can.
    """
    (left, right, T), D = drive, np.zeros(3)
    if state.coasting:
        D[0] = D[1] = 2.0 * LASTS * c.speed_limit**2 / T
        return (0.0, 1.0), D
    if not has_velocity_errors(c):
        return (0.0, 0.0), D
    variances = speed.error_variances(state.mean[:], state.covariance[:], state, c)
    kept, mean = speed.persistence(T, state.motion.motion, c)
    of_mean, of_both, of_end = speed.error_growth(T, state.motion.motion, c)
    ahead, D[0] = _split(before.errors[0], variances[0], (kept, mean), (of_mean, of_both, of_end))
    turned, D[2] = _split(before.errors[1], variances[1], (kept, mean), (of_mean, of_both, of_end))
    D[1] = state.adaptation.track_variance * _sideways(left, right, T, c)
    return (ahead, turned), D


@compiled
def _split(
    first: float, own: float, persistence: tuple[float, float], growth: tuple[float, float, float]
) -> tuple[float, float]:
    """Of the mean over T of an error that had the variance ``first``: factor of that at its end; the rest."""
    (kept, mean), (of_mean, of_both, of_end) = persistence, growth
    both, end = kept * mean * first + of_both * own, kept * kept * first + of_end * own
    factor = both / end if end > 0.0 else 0.0
    return factor, max(mean * mean * first + of_mean * own - factor * both, 0.0)


@compiled
def _sideways(left: float, right: float, T: float, c: Any) -> float:
    """Variance of the mean of v_y over T, by the tracks for a track error of 1 (``speed``), (m/s)²."""
    squares: float = c.rolling_radius**2 * (left * left + right * right)
    return float(c.adaptation.sideways**2 * squares / 4.0 * 2.0 * c.velocity_errors.time / T)


@compiled
def by_track_error(state: Any, drive: tuple[float, float, float], c: Any) -> FloatArray:
    """(3,) what of S is the tracks', for a track error of 1."""
    left, right, T = drive
    share = speed.persistence(T, state.motion.motion, c)[1]
    of_mean = speed.error_growth(T, state.motion.motion, c)[0]
    U = speed.track_exposure(state, c)
    ahead = c.adaptation.forward**2 / 4.0 * (share**2 * state.adaptation.speed_exposure + of_mean * U)
    return np.array((ahead, _sideways(left, right, T, c), of_mean * U / c.tread**2))


@compiled
def add_count_rounding(state: Any, drive: tuple[float, float, float], c: Any, D: FloatArray) -> None:
    """What the rounding of the counts adds to the expected means."""
    if not state.speeds.differenced or c.encoder_resolution == 0.0:
        return
    left, right, T = drive
    e, x = rounding(T, c.encoder_resolution), state.mean[:]
    for on_left, on_right in ((e, 0.0), (0.0, e)):
        more = np.array(body_twist(x, left + on_left, right + on_right, state, c))
        less = np.array(body_twist(x, left - on_left, right - on_right, state, c))
        D += np.outer(more - less, more - less) / 4.0


@compiled
def shared_with_pose(state: Any, since_ns: int, T: float, open_: FloatArray) -> FloatArray:
    """C: the pose has moved by T times what ``open_`` (3,) are the variances of; none where a fix came since.

    A gyro may have shown what the yaw rate leaves open: that has none. The place shares no more than it errs
    by.
    """
    C, P = np.zeros((state.mean.size, 3)), state.covariance
    if state.fixed_ns <= since_ns:
        cos, sin = math.cos(state.mean[YAW]), math.sin(state.mean[YAW])
        for k, (x, y) in enumerate(((cos, sin), (-sin, cos))):
            along = max(x * x * P[X, X] + 2.0 * x * y * P[X, Y] + y * y * P[Y, Y], 0.0)
            shared = min(T * open_[k], _MOST_SHARED * math.sqrt(along * open_[k]))
            C[X, k], C[Y, k] = x * shared, y * shared
    return C
