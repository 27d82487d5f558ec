# SPDX-License-Identifier: Apache-2.0
"""The truth in the shape of an estimate, so that the same conversions publish both."""

import numpy as np

from trackslip_estimation.filters.model import Outputs
from trackslip_estimation.motion import Motion
from trackslip_estimation.slip_estimator import Estimate
from trackslip_sim.truth.record import Truth

_STANDING = 1e-3  # rad/s, both sprockets
_STRAIGHT = 0.02  # of the faster sprocket


def as_estimate(at: Truth, stamp_ns: int) -> Estimate:
    """One sample of the truth, certain of itself."""
    pose, twist, slips = (
        np.array([float(column[0]) for column in columns])
        for columns in (
            (at.x, at.y, at.yaw),
            (at.v_x, at.v_y, at.yaw_rate),
            (at.left_slip, at.right_slip, at.slip_angle),
        )
    )
    none = np.zeros((3, 3))
    return Estimate(stamp_ns, pose, none, Outputs(twist, none, slips, none), _motion(at))


def _motion(at: Truth) -> Motion:
    left, right = float(at.left_speed[0]), float(at.right_speed[0])
    fastest = max(abs(left), abs(right))
    if fastest < _STANDING:
        return Motion.STANDING
    return Motion.STRAIGHT if abs(right - left) < _STRAIGHT * fastest else Motion.TURNING
