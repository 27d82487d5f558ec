# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Transforms between the box in the laser frame and base_link in odom."""

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_common.vehicle import Box
from trackslip_estimation.box.parameters import BoxLocalizerParameters


class Frames:
    """Constant transforms; poses are (x, y, yaw), m and rad."""

    def __init__(self, p: BoxLocalizerParameters, box: Box) -> None:
        self._box_in_base: FloatArray = np.array([box.x, box.y])
        self._laser_in_odom: FloatArray = np.array([p.laser_x, p.laser_y])
        self._laser_yaw = p.laser_yaw
        self._odom_from_laser = _rotation(p.laser_yaw)

    def laser_from_odom(self, base: FloatArray) -> FloatArray:
        """Return the pose (3,) of the box in the laser frame from that of base_link in odom."""
        centre = base[:2] + _rotation(base[2]) @ self._box_in_base
        x, y = self._odom_from_laser.T @ (centre - self._laser_in_odom)
        return np.array([x, y, base[2] - self._laser_yaw])

    def odom_from_laser(self, box: FloatArray) -> FloatArray:
        """Return the pose (3,) of base_link in odom from that of the box in the laser frame."""
        yaw = box[2] + self._laser_yaw
        x, y = self._laser_in_odom + self._odom_from_laser @ box[:2] - _rotation(yaw) @ self._box_in_base
        return np.array([x, y, yaw])

    def covariance_in_odom(self, yaw: float, covariance: FloatArray) -> FloatArray:
        """Return the covariance (3, 3) of base_link in odom at ``yaw``, from that of the box."""
        jacobian = np.eye(3)
        jacobian[:2, :2] = self._odom_from_laser
        jacobian[:2, 2] = -_rotation(yaw + np.pi / 2.0) @ self._box_in_base
        return jacobian @ covariance @ jacobian.T


def _rotation(angle: float) -> FloatArray:
    """Return the rotation matrix (2, 2) of ``angle``, rad."""
    cos, sin = np.cos(angle), np.sin(angle)
    return np.array([[cos, -sin], [sin, cos]])
