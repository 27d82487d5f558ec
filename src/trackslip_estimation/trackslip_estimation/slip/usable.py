# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Which measurements are such: numbers within reason, and covariances that are some; compiled."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trackslip_common.compiled import compiled
from trackslip_estimation.slip.increments import is_pose
from trackslip_estimation.slip.records import MANUAL, ODOMETRY, POSE, SLIPS, SPROCKETS

FloatArray = NDArray[np.float64]

_LARGEST = 1e9  # m, rad, rad/s: beyond it is no measurement, and its square no number to reckon with
_ROUNDING = 1e-9  # of a correlation of 1


@compiled
def is_usable(measurement: Any, c: Any) -> bool:
    """Whether its numbers are such, and none beyond reason."""
    if measurement.kind == SPROCKETS:
        left, right = measurement.left_angle, measurement.right_angle
        return (
            abs(measurement.left_speed) < _LARGEST
            and abs(measurement.right_speed) < _LARGEST
            and ((math.isnan(left) and math.isnan(right)) or (abs(left) < _LARGEST and abs(right) < _LARGEST))
        )
    if measurement.kind == ODOMETRY:
        return is_pose(measurement)
    rows = 1
    if measurement.kind == SLIPS:
        rows = 2
    elif measurement.kind == POSE:
        rows = 3 if measurement.source == MANUAL or c.use_heading[measurement.source] == 1 else 2
    return is_gaussian(measurement.value, measurement.noise, rows)


@compiled
def is_gaussian(mean: FloatArray, covariance: FloatArray, rows: int) -> bool:
    """Whether the first ``rows`` are numbers with a covariance: symmetric, no negative variance anywhere."""
    for i in range(rows):
        if not (abs(mean[i]) < _LARGEST and 0.0 < covariance[i, i] < _LARGEST**2):
            return False
    r = np.eye(3)
    for i in range(rows):
        for j in range(i):
            deviations = math.sqrt(covariance[i, i]) * math.sqrt(covariance[j, j])
            r[i, j], r[j, i] = covariance[i, j] / deviations, covariance[j, i] / deviations
            if not (abs(r[i, j] - r[j, i]) <= _ROUNDING and abs(r[i, j]) <= 1.0 + _ROUNDING):
                return False
    determinant = 1.0 + 2.0 * r[1, 0] * r[2, 0] * r[2, 1] - r[1, 0] ** 2 - r[2, 0] ** 2 - r[2, 1] ** 2
    return bool(determinant >= -_ROUNDING)
