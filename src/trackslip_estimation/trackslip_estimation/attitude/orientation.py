# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Update of the attitude filter with the orientation that an IMU sends; compiled.

    u          up vector along base_link, by orientation, mounting and swing                     1
    φ, θ       measured roll and pitch: atan2(u_y, u_z), atan2(−u_x, √(u_y² + u_z²))             rad
    R, S       stated covariance of both, covariance of the innovation                           rad²
    τ, Δt      correlation time of its error, time since the last orientation used               s

The heading of an orientation is not used. The gate uses R. Inside the gate R counts coth(Δt/2τ) times, since
the errors of successive orientations are correlated. Outside it an orientation is always rejected, however
long it persists: either its mounting is wrong, or the sensors behind it were shaken.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from trackslip_common.compiled import compiled
from trackslip_common.message_fields import ABSENT
from trackslip_estimation.attitude.records import PITCH, ROLL, SIZE, AttitudeRejection
from trackslip_estimation.attitude.start import initialise_tilt
from trackslip_estimation.kalman.linear_algebra import root, weighted_square, wrap
from trackslip_estimation.kalman.update import correct, independent_observation

if TYPE_CHECKING:
    from trackslip_estimation.attitude.parameters import AttitudeConstants
    from trackslip_estimation.attitude.records import Attitude

_NONE, _NO_COVARIANCE = int(AttitudeRejection.NO_ORIENTATION), int(AttitudeRejection.NO_COVARIANCE)
_NO_ROTATION, _GATED = int(AttitudeRejection.NO_ROTATION), int(AttitudeRejection.ORIENTATION_GATED)
SWING_UNKNOWN = int(AttitudeRejection.SWING_UNKNOWN)
_LEAST_VARIANCE = 1e-12  # rad², least variance of an orientation
_UNKNOWN_VARIANCE = math.pi**2  # rad², variance of an unknown angle
_NORM_TOLERANCE = 0.1  # tolerance of the squared norm of a quaternion
_LEAST_INTERVAL = 1e-3  # s, least Δt


@compiled
def update_with_orientation(a: Attitude, n: AttitudeConstants) -> int:
    """Update or initialise with the orientation of the new sample; return why it was not used, else 0."""
    imu, x, P = a.sample, a.mean[:], a.covariance[:]
    of_x, of_y = imu.up_variances
    if of_x == ABSENT:
        return _NONE
    if not (0.0 < of_x < _UNKNOWN_VARIANCE and 0.0 < of_y < _UNKNOWN_VARIANCE):
        return _NO_COVARIANCE
    size = math.sqrt(imu.up[0] ** 2 + imu.up[1] ** 2 + imu.up[2] ** 2)
    if not abs(size - 1.0) < _NORM_TOLERANCE:
        return _NO_ROTATION
    if imu.swing_unknown == 1:
        return SWING_UNKNOWN
    up_x = (imu.cos * imu.up[0] - imu.sin * imu.up[1]) / size
    up_y = (imu.sin * imu.up[0] + imu.cos * imu.up[1]) / size
    roll, pitch = math.atan2(up_y, imu.up[2] / size), -math.asin(min(max(up_x, -1.0), 1.0))
    R = imu.turn_variance * np.outer(np.array((up_x, up_y)), np.array((up_x, up_y)))
    of_x, of_y = max(of_x, _LEAST_VARIANCE), max(of_y, _LEAST_VARIANCE)
    R[ROLL, ROLL] += imu.cos**2 * of_x + imu.sin**2 * of_y
    R[PITCH, PITCH] += imu.sin**2 * of_x + imu.cos**2 * of_y
    inflation = 1.0
    if a.known == 0:
        initialise_tilt(a, roll, pitch, n)
    else:
        elapsed = max((imu.stamp_ns - a.oriented_ns) * 1e-9, _LEAST_INTERVAL)
        inflation = 1.0 / math.tanh(elapsed / (2.0 * n.orientation_time))
    innovation = np.array((wrap(roll - x[ROLL]), pitch - x[PITCH]))
    if weighted_square(root(P[: PITCH + 1, : PITCH + 1] + R), innovation) > n.gate:
        return _GATED
    correct(x, P, independent_observation(innovation, np.eye(PITCH + 1, SIZE), inflation * R))
    a.oriented_ns = imu.stamp_ns
    return 0
