# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Outlines in the plane for reports and the live page: ellipses of uncertainty, and rectangles."""

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_common.vehicle import Box, VehicleParameters
from trackslip_tools.report.panel import SIGMAS

_ANGLES = np.linspace(0.0, 2.0 * np.pi, 33)
_CIRCLE = np.stack((np.cos(_ANGLES), np.sin(_ANGLES)))  # (2, 33)
_CORNERS = np.array(((1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0), (1.0, 1.0)))  # (5, 2)


def ellipses(positions: FloatArray, covariances: FloatArray) -> FloatArray:
    """(k, 33, 2) closed outlines of 2σ about (k, 2) positions; (k, 2, 2) positive definite covariances."""
    roots = np.linalg.cholesky(covariances)
    outlines = np.swapaxes(SIGMAS * roots @ _CIRCLE, 1, 2)
    return np.asarray(positions[:, np.newaxis] + outlines, dtype=np.float64)


def rectangle(pose: FloatArray, size: tuple[float, float], centre: tuple[float, float]) -> FloatArray:
    """(5, 2) closed outline of a rectangle, ``size`` along x and y, ``centre`` in the frame at ``pose``."""
    points = 0.5 * _CORNERS * np.array(size) + np.array(centre)
    return transform_points(pose, points)


def box_outline(box: Box, pose: FloatArray) -> FloatArray:
    """(5, 2) closed outline of the laser's box on a machine at ``pose``."""
    return rectangle(pose, (box.length, box.width), (box.x, box.y))


def machine_size(vehicle: VehicleParameters) -> tuple[float, float]:
    """Length and width over the tracks, m."""
    width = vehicle.kinematics.tread + (vehicle.mass.track_width if vehicle.mass else 0.0)
    return vehicle.kinematics.contact_length, width


def transform_points(pose: FloatArray, points: FloatArray) -> FloatArray:
    """(n, 2) points, transformed from the frame at ``pose`` (3,) x, y, heading to the frame of that pose."""
    c, s = np.cos(pose[2]), np.sin(pose[2])
    return np.asarray(pose[:2] + points @ np.array(((c, s), (-s, c))), dtype=np.float64)
