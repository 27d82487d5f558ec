# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Validity checks of measurements: finite, within physical limits, covariance positive definite; compiled.

    R     covariance of a measurement, the rows in use                (m, m)
    C     correlation matrix, R_ij / √(R_ii R_jj)                     (m, m)
    d_k   pivots of C = L D Lᵀ: conditional variance over variance

This module has all limits. Values beyond them are no measurement of a ground vehicle, and would cost the
filter digits: 64 bits hold numbers to 1e-16 of the largest.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_common.compiled import compiled
from trackslip_estimation.slip.measurements import UNOBSERVED, Fault
from trackslip_estimation.slip.records import (
    HEADING,
    MANUAL,
    ODOMETRY,
    ON_SWING,
    SLIPS,
    SPROCKETS,
    VELOCITY,
    YAW_RATE,
)

if TYPE_CHECKING:
    from trackslip_estimation.slip.config import Config
    from trackslip_estimation.slip.records import MeasurementRecord


FARTHEST = 1e8  # m, of a position; the circumference of the Earth is 4e7 m
HIGHEST = 1e5  # m, of an altitude
LARGEST_ANGLE = 1e3  # rad, of a heading
LARGEST_COUNT = 1e9  # rad, of a sprocket position: a year of driving is 3e8
FASTEST_TURN = 100.0  # rad/s; gyros reach 35
FASTEST = 100.0  # m/s, of anything
LARGEST_FORCE = 1e4  # m/s²
LARGEST_SLIP = 1e3
FARTHEST_STDDEV = 1e4  # m
LEAST_VARIANCE = 1e-12  # of any unit: no sensor is better than 1e-6
_LARGEST_ANGLE_VARIANCE = 1e6  # rad²; drivers send it for an unknown angle
_UNKNOWN_HEADING = 1e18  # rad², the largest variance that drivers send for an unknown heading
_LARGEST_SLIP_VARIANCE = 1e6
_LARGEST_ODOMETRY_VARIANCE = 1e12  # of a pose that drifts; only its growth is used
_SINGULAR = 1e-10  # least d_k
_ROUNDING = 1e-9  # of a correlation of 1
_UNIT = 0.01  # by which the norm of a quaternion, squared, may differ from 1

_NOT_FINITE, _OUT_OF_RANGE = int(Fault.NOT_FINITE), int(Fault.OUT_OF_RANGE)
_NOT_POSITIVE, _VARIANCE_OUT_OF_RANGE = int(Fault.VARIANCE_NOT_POSITIVE), int(Fault.VARIANCE_OUT_OF_RANGE)
_INDEFINITE, _NEARLY_SINGULAR = int(Fault.COVARIANCE_INDEFINITE), int(Fault.COVARIANCE_NEARLY_SINGULAR)
_NO_ROTATION = int(Fault.NO_ROTATION)


@compiled
def measurement_fault(measurement: MeasurementRecord, c: Config) -> int:
    """``Fault`` of a record of ``MEASUREMENT``; 0: valid."""
    z, R, kind = measurement.value, measurement.noise, measurement.kind
    if kind == SPROCKETS:
        return _sprocket_fault(measurement)
    if kind == ODOMETRY:
        return _odometry_fault(measurement)
    if kind == SLIPS:
        fault = max(_number_fault(z[0], LARGEST_SLIP), _number_fault(z[1], LARGEST_SLIP))
        return fault if fault > 0 else _covariance_fault(R, 2, _LARGEST_SLIP_VARIANCE)
    if kind == YAW_RATE:
        return max(_imu_fault(measurement), _variance_fault(R[0, 0], FASTEST_TURN**2))
    if kind in (HEADING, ON_SWING):
        return max(_number_fault(z[0], LARGEST_ANGLE), _variance_fault(R[0, 0], _LARGEST_ANGLE_VARIANCE))
    if kind == VELOCITY:
        rows = rows_of_velocity(measurement, c)
        fault = _number_fault(z[0], FASTEST)
        if rows > 1:
            fault = max(fault, _number_fault(z[1], FASTEST))
        return fault if fault > 0 else _covariance_fault(R, rows, FASTEST**2)
    return _pose_fault(measurement, c)


@compiled
def rows_of_velocity(measurement: MeasurementRecord, c: Config) -> int:
    """Rows of a velocity: 2, or 1 of a sensor in machine axes that does not measure the second axis."""
    is_one_axis = c.body_axes[measurement.source] == 1 and measurement.noise[1, 1] >= UNOBSERVED
    return 1 if is_one_axis else 2


@compiled
def has_heading(measurement: MeasurementRecord) -> bool:
    """Whether a pose has a heading: finite, with the variance of a known angle."""
    variance = measurement.noise[2, 2]
    return bool(abs(measurement.value[2]) < LARGEST_ANGLE and 0.0 < variance <= math.pi**2) and (
        _covariance_fault(measurement.noise, 3, FARTHEST_STDDEV**2) == 0
    )


@compiled
def _number_fault(value: float, largest: float) -> int:
    if not math.isfinite(value):
        return _NOT_FINITE
    return 0 if abs(value) < largest else _OUT_OF_RANGE


@compiled
def _optional_fault(value: float, largest: float) -> int:
    """Fault of an optional value of an IMU; not finite where it is absent."""
    return _OUT_OF_RANGE if math.isfinite(value) and not abs(value) < largest else 0


@compiled
def _variance_fault(variance: float, largest: float) -> int:
    if not math.isfinite(variance):
        return _NOT_FINITE
    if not variance > 0.0:
        return _NOT_POSITIVE
    return 0 if variance <= largest else _VARIANCE_OUT_OF_RANGE


@compiled
def _sprocket_fault(measurement: MeasurementRecord) -> int:
    left, right = measurement.left_angle, measurement.right_angle
    fault = max(
        _number_fault(measurement.left_speed, LARGEST_COUNT),
        _number_fault(measurement.right_speed, LARGEST_COUNT),
    )
    if fault == 0 and not (math.isnan(left) and math.isnan(right)):
        fault = max(_number_fault(left, LARGEST_COUNT), _number_fault(right, LARGEST_COUNT))
    return fault


@compiled
def _imu_fault(measurement: MeasurementRecord) -> int:
    fault = _number_fault(measurement.value[0], FASTEST_TURN)
    for k in range(3):
        if k > 0:
            fault = max(fault, _optional_fault(measurement.value[k], FASTEST_TURN))
        fault = max(fault, _optional_fault(measurement.acceleration[k], LARGEST_FORCE))
    return fault


@compiled
def _pose_fault(measurement: MeasurementRecord, c: Config) -> int:
    """Fault of a fix; its heading counts only where the source has one."""
    z, R, source = measurement.value, measurement.noise, measurement.source
    fault = max(_number_fault(z[0], FARTHEST), _number_fault(z[1], FARTHEST))
    fault = max(
        fault, _variance_fault(R[0, 0], FARTHEST_STDDEV**2), _variance_fault(R[1, 1], FARTHEST_STDDEV**2)
    )
    if fault > 0:
        return fault
    if source != MANUAL and c.use_heading[source] != 1:
        return _covariance_fault(R, 2, FARTHEST_STDDEV**2)
    fault = _number_fault(z[2], LARGEST_ANGLE)
    return fault if fault > 0 else _covariance_fault(R, 3, _UNKNOWN_HEADING)


@compiled
def _odometry_fault(measurement: MeasurementRecord) -> int:
    """Fault of an odometry pose and its variances; a variance of zero: unspecified."""
    norm = 0.0
    for k in range(3):
        fault = _number_fault(measurement.value[k], FARTHEST)
        for row in range(2):
            variance = measurement.noise[row, k]
            if variance != 0.0:
                fault = max(fault, _variance_fault(variance, _LARGEST_ODOMETRY_VARIANCE))
        if fault > 0:
            return fault
    for k in range(4):
        norm += measurement.orientation[k] ** 2
    return 0 if abs(norm - 1.0) < _UNIT else _NO_ROTATION


@compiled
def _covariance_fault(R: FloatArray, rows: int, largest: float) -> int:
    """Fault of the first ``rows`` of R: symmetric, positive definite, and not nearly singular."""
    for i in range(rows):
        fault = _variance_fault(R[i, i], largest)
        if fault > 0:
            return fault
    C = np.eye(3)
    for i in range(rows):
        for j in range(i):
            product = math.sqrt(R[i, i]) * math.sqrt(R[j, j])
            C[i, j], C[j, i] = R[i, j] / product, R[j, i] / product
            if not math.isfinite(C[i, j] + C[j, i]):
                return _NOT_FINITE
            if abs(C[i, j] - C[j, i]) > _ROUNDING:
                return _INDEFINITE
    minor = 1.0 - C[1, 0] ** 2
    determinant = minor - C[2, 0] ** 2 - C[2, 1] ** 2 + 2.0 * C[1, 0] * C[2, 0] * C[2, 1]
    largest_correlation = max(abs(C[1, 0]), max(abs(C[2, 0]), abs(C[2, 1])))
    if largest_correlation > 1.0 + _ROUNDING or determinant < -_ROUNDING:
        return _INDEFINITE
    return 0 if minor >= _SINGULAR and determinant >= _SINGULAR * minor else _NEARLY_SINGULAR
