# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Motion between two poses of an odometry source, as a mean velocity of base_link; compiled.

    p, q     pose of the sensor in the source's own odom frame             m; x, y, z, w
    l, M     lever arm, rotation from the sensor's axes into base_link     m; x, y, z, w
    b, d     base_link in the odom frame                                   m; x, y, z, w
    θ        rotation vector of d₁* d₂                                     rad
    T        time from the first pose to the second                        s

    b = p − d l d*,  d = q M*        (v, ω) T = (R(−θ/2) d₁* (b₂ − b₁) d₁ (|θ|/2)/sin(|θ|/2), θ)

The result is exact for constant velocity and rates over T. The odom frame may have any orientation.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_common.compiled import compiled
from trackslip_estimation.slip.validity import LEAST_VARIANCE

if TYPE_CHECKING:
    from trackslip_estimation.slip.config import Config
    from trackslip_estimation.slip.records import MeasurementRecord, OdometryRecord


TWIST, POSE_GROWTH, DECLARED = range(3)  # origin of the covariance
_SMALL = 1e-9  # rad


@compiled
def increment(before: OdometryRecord, measurement: MeasurementRecord, T: float, c: Config) -> FloatArray:
    """(3,) v_x and v_y in m/s, yaw rate in rad/s; means over T, along the axes of base_link."""
    lever, mounting = c.levers[measurement.source], c.mountings[measurement.source]
    first = _base_orientation(before.orientation, mounting)
    second = _base_orientation(measurement.orientation, mounting)
    moved = measurement.value - _rotate(second, lever) - before.position + _rotate(first, lever)
    turn = _product(_conjugate(first), second)
    if turn[3] < 0.0:
        turn = -turn
    sine = math.sqrt(turn[0] ** 2 + turn[1] ** 2 + turn[2] ** 2)
    half = math.atan2(sine, turn[3])  # |θ|/2
    stretch = half / sine if sine > _SMALL else 1.0
    back = _conjugate(_half_rotation(turn))
    v = _rotate(back, _rotate(_conjugate(first), moved)) * stretch
    return np.array((v[0] / T, v[1] / T, 2.0 * stretch * turn[2] / T))


@compiled
def stated_variances(
    before: OdometryRecord, measurement: MeasurementRecord, T: float, c: Config
) -> FloatArray:
    """(3,) variances of an increment as stated by its source; declared by parameters where it states none."""
    source, noise = measurement.source, measurement.noise
    linear, angular, lever = np.zeros(3), np.zeros(3), c.levers[source]
    kind, declared = c.odometry_noise[source], c.odometry_variances[source]
    if kind == TWIST:
        linear, angular = _rotate_variances(c.mountings[source], noise)
    elif kind == POSE_GROWTH:
        for k in range(3):  # axes unknown: isotropic in the plane
            linear[k] = (noise[0, 0] + noise[0, 1] - before.noise[0, 0] - before.noise[0, 1]) / (2.0 * T * T)
            angular[k] = (noise[1, 2] - before.noise[1, 2]) / (T * T)
    for k in range(3):
        linear[k] = max(linear[k], LEAST_VARIANCE) if linear[k] > 0.0 else declared[0]
        angular[k] = max(angular[k], LEAST_VARIANCE) if angular[k] > 0.0 else declared[1]
    of_turn = angular[2]
    return np.array((linear[0] + lever[1] ** 2 * of_turn, linear[1] + lever[0] ** 2 * of_turn, of_turn))


@compiled
def _base_orientation(q: FloatArray, mounting: FloatArray) -> FloatArray:
    """d, normalised."""
    d = _product(q, _conjugate(mounting))
    return d / math.sqrt(d[0] ** 2 + d[1] ** 2 + d[2] ** 2 + d[3] ** 2)


@compiled
def _product(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.array(
        (
            a[3] * b[0] + a[0] * b[3] + a[1] * b[2] - a[2] * b[1],
            a[3] * b[1] - a[0] * b[2] + a[1] * b[3] + a[2] * b[0],
            a[3] * b[2] + a[0] * b[1] - a[1] * b[0] + a[2] * b[3],
            a[3] * b[3] - a[0] * b[0] - a[1] * b[1] - a[2] * b[2],
        )
    )


@compiled
def _conjugate(q: FloatArray) -> FloatArray:
    return np.array((-q[0], -q[1], -q[2], q[3]))


@compiled
def _half_rotation(q: FloatArray) -> FloatArray:
    """Half of the rotation q; q[3] ≥ 0."""
    half = np.array((q[0], q[1], q[2], q[3] + 1.0))
    return half / math.sqrt(half[0] ** 2 + half[1] ** 2 + half[2] ** 2 + half[3] ** 2)


@compiled
def _rotate(q: FloatArray, v: FloatArray) -> FloatArray:
    """(3,) q v q*."""
    turned = _product(_product(q, np.array((v[0], v[1], v[2], 0.0))), _conjugate(q))
    return turned[:3].copy()


@compiled
def _rotate_variances(mounting: FloatArray, noise: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(3,) of velocity and (3,) of rates along base_link, from rows of ``noise`` along the sensor's axes."""
    linear, angular, axis = np.zeros(3), np.zeros(3), np.zeros(3)
    for j in range(3):
        axis[:] = 0.0
        axis[j] = 1.0
        shares = _rotate(mounting, axis)
        for k in range(3):
            linear[k] += shares[k] ** 2 * noise[0, j]
            angular[k] += shares[k] ** 2 * noise[1, j]
    return linear, angular
