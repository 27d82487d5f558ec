# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Outlines of the machine: ellipse, tracks, forward direction, upper structure, the laser's box."""

from contextlib import suppress

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_common.topics import ODOMETRY
from trackslip_common.vehicle import VehicleParameters
from trackslip_tools.live import inputs
from trackslip_tools.live.snapshot import Snapshot
from trackslip_tools.report.plan_shapes import (
    box_outline,
    ellipses,
    machine_size,
    rectangle,
    transform_points,
)

OUTLINE_NAMES = ("ellipse", "machine", "nose", "upper", "box")


def outlines_of(now: Snapshot, now_s: float, vehicle: VehicleParameters) -> dict[str, FloatArray]:
    """Name of ``OUTLINE_NAMES`` → (n, 2) outline; no points if unknown."""
    outlines = dict.fromkeys(OUTLINE_NAMES, np.empty((0, 2)))
    odometry = now.get(ODOMETRY, now_s)
    if odometry is not None:
        pose = inputs.pose_of(odometry)
        length, width = machine_size(vehicle)
        outlines["machine"] = rectangle(pose, (length, width), (0.0, 0.0))
        outlines["nose"] = transform_points(pose, np.array(((0.0, 0.0), (0.9 * length, 0.0))))
        with suppress(np.linalg.LinAlgError):  # invalid covariance
            outlines["ellipse"] = ellipses(pose[np.newaxis, :2], odometry.covariance[np.newaxis, :2, :2])[0]
        swing = now.get(inputs.SWING, now_s)
        if swing is not None:
            outlines["upper"] = _upper_structure_line(pose, swing.angle, vehicle)
    fix, sensors = now.get(inputs.BOX_POSE, now_s), vehicle.sensors
    if fix is not None and sensors is not None and sensors.box is not None:
        outlines["box"] = box_outline(sensors.box, inputs.pose_of(fix))
    return outlines


def _upper_structure_line(pose: FloatArray, angle: float, vehicle: VehicleParameters) -> FloatArray:
    """(2, 2) line from the swing axis in the direction of the upper structure."""
    upper = vehicle.upper_structure
    axis = np.array((upper.swing_axis_x, upper.swing_axis_y)) if upper is not None else np.zeros(2)
    reach = vehicle.kinematics.contact_length * np.array((np.cos(angle), np.sin(angle)))
    return transform_points(pose, np.array((axis, axis + reach)))
