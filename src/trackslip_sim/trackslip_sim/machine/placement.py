# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Pose of the machine, and of sensors mounted on it."""

import math
from typing import NamedTuple

import numpy as np

from trackslip_common.arrays import FloatArray


def rotation_about_z(angle: float) -> FloatArray:
    """(3, 3) rotation about z by ``angle``, rad."""
    cos, sin = math.cos(angle), math.sin(angle)
    return np.array(((cos, -sin, 0.0), (sin, cos, 0.0), (0.0, 0.0, 1.0)))


def upper_poses(poses: FloatArray, swing: FloatArray, axis: tuple[float, float]) -> FloatArray:
    """(k, 3) x, y, heading of the upper structure's frame, which equals base_link at σ = 0.

    ``poses`` (k, 3) are those of base_link on level ground, ``swing`` (k,) is σ about the axis at (x, y), m.
    """
    x, y, yaw = poses.T
    axis_x, axis_y = axis
    cos, sin, upper_yaw = np.cos(yaw), np.sin(yaw), yaw + swing
    x = x + (cos - np.cos(upper_yaw)) * axis_x - (sin - np.sin(upper_yaw)) * axis_y
    y = y + (sin - np.sin(upper_yaw)) * axis_x + (cos - np.cos(upper_yaw)) * axis_y
    return np.stack((x, y, upper_yaw), axis=1)


class Placement(NamedTuple):
    """Pose of base_link in the site frame; angles ZYX as in REP-103."""

    x: float  # m
    y: float
    yaw: float  # rad
    z: float = 0.0
    pitch: float = 0.0
    roll: float = 0.0

    def rotation(self) -> FloatArray:
        """(3, 3) rotation from base_link to the site frame."""
        (c_r, s_r), (c_p, s_p), (c_y, s_y) = (
            (math.cos(angle), math.sin(angle)) for angle in (self.roll, self.pitch, self.yaw)
        )
        return np.array(
            (
                (c_y * c_p, c_y * s_p * s_r - s_y * c_r, c_y * s_p * c_r + s_y * s_r),
                (s_y * c_p, s_y * s_p * s_r + c_y * c_r, s_y * s_p * c_r - c_y * s_r),
                (-s_p, c_p * s_r, c_p * c_r),
            )
        )

    def to_site(self, x: float, y: float, z: float) -> tuple[float, float, float]:
        """A point of base_link, m, in the site frame."""
        east, north, up = (self.rotation() @ (x, y, z)).tolist()
        return self.x + east, self.y + north, self.z + up

    def rotated_about_z(self, angle: float, axis: tuple[float, float]) -> "Placement":
        """Placement of a frame: base_link rotated by ``angle``, rad, about its z axis through (x, y), m."""
        rotation, (along, across) = rotation_about_z(angle), axis
        x, y, z = self.to_site(*((along, across, 0.0) - rotation @ (along, across, 0.0)).tolist())
        R = self.rotation() @ rotation
        yaw = self.yaw + angle
        yaw += math.remainder(math.atan2(R[1, 0], R[0, 0]) - yaw, 2.0 * math.pi)
        return Placement(x, y, yaw, z, -math.asin(R[2, 0]), math.atan2(R[2, 1], R[2, 2]))

    def azimuth(self, direction: float) -> float:
        """Azimuth, rad, of a ``direction`` in the track plane, rad from x; within ±π of ``yaw``."""
        east, north, _ = (self.rotation() @ (math.cos(direction), math.sin(direction), 0.0)).tolist()
        return self.yaw + math.remainder(math.atan2(north, east) - self.yaw, 2.0 * math.pi)
