# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The pose of a sensor, valid δ σ_t before its stamp: x, y and, where its heading is used, φ; compiled.

    z    x, y of the sensor, m; heading of the machine, or of the upper structure it sits on, rad
    h    C + R(φ) p + b − δ σ_t d/dt (…),  φ + σ + ε − δ σ_t d/dt (…)
    δ    delay of all fixes, over the stamp errors σ_t                                   1
    b    offset of the source (``source_offsets``), where it has one                     (2,), m
    ε    yaw offset of the source                                                        rad

R is the covariance stated by the source, not below its floors. It includes the displacement of the sensor by
an unknown tilt or an unknown swing. With time-correlated errors, R is the part that is independent in each
fix.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_common.compiled import compiled
from trackslip_estimation.kalman.linear_algebra import wrap
from trackslip_estimation.kalman.update import Observation
from trackslip_estimation.slip.correlated_errors import quality_of
from trackslip_estimation.slip.levers import (
    horizontal_direction,
    lever,
    stamp_shift,
    unknown_swing_variance,
    unmodelled_tilt_variance,
)
from trackslip_estimation.slip.models.dispatch import has_velocity_errors
from trackslip_estimation.slip.models.model import FIX_DELAY, GYRO_BIAS, SWING, YAW, X, Y
from trackslip_estimation.slip.models.shear import is_shear_building_up
from trackslip_estimation.slip.source_faults import IS_OFFSET, has_repeated_heading
from trackslip_estimation.slip.source_offsets import (
    has_correlated_errors,
    is_unobserved_receiver,
    pose_source_number,
    position_stddev,
)
from trackslip_estimation.slip.validity import LEAST_VARIANCE

if TYPE_CHECKING:
    from trackslip_estimation.slip.config import Config
    from trackslip_estimation.slip.records import MeasurementRecord, State


@compiled
def is_heading_used(measurement: MeasurementRecord, state: State, c: Config) -> bool:
    """Whether the heading of a pose is used; above its ceiling it may be wrong by whole quarter turns."""
    source, ceiling = measurement.source, c.heading_ceiling[measurement.source]
    is_certain = measurement.noise[YAW, YAW] <= ceiling * ceiling
    return bool(c.use_heading[source] == 1 and is_certain and not has_repeated_heading(state, source))


@compiled
def raise_to_floors(R: FloatArray, rows: int, source: int, c: Config) -> None:
    """Raise the variances of a fix, of which ``rows`` are used, to the floors of its source; in place."""
    for i in range(rows):
        floor = c.heading_floor[source] if i == YAW else c.position_floor[source]
        R[i, i] = max(R[i, i], floor * floor, LEAST_VARIANCE)


@compiled
def stated_noise(measurement: MeasurementRecord, state: State, c: Config) -> FloatArray:
    """(m, m) covariance stated for a pose, with the displacement of its sensor by tilt and swing."""
    source, rows = measurement.source, 3 if is_heading_used(measurement, state, c) else 2
    R = measurement.noise[:rows, :rows].copy()
    raise_to_floors(R, rows, source, c)
    for i in range(YAW):
        R[i, i] += unmodelled_tilt_variance(state.attitude.level, source, c)
        if c.above[source] == 1:
            R[i, i] += unknown_swing_variance(state.covariance, source, c)
    return R


@compiled
def has_offset(state: State, source: int, c: Config) -> bool:
    """Whether the positions of a source contain its offset."""
    number = pose_source_number(source, c)
    return bool(number >= 0 and (state.fault[source] == IS_OFFSET or state.offsets[number].variance > 0.0))


@compiled
def observe_pose(state: State, measurement: MeasurementRecord, c: Config) -> Observation:
    """ν, H and R of a pose; m is 3 where its heading is used, else 2."""
    source, x, R = measurement.source, state.mean[: c.size], stated_noise(measurement, state, c)
    m, arm, shift = R.shape[0], lever(x, state.attitude.level, source, c), stamp_shift(state, source, c)
    H, nu = np.zeros((m, x.size)), np.zeros(m)
    H[:YAW], H[X, X], H[Y, Y] = arm.jacobian, 1.0, 1.0
    nu[X] = measurement.value[X] - x[X] - arm.east
    nu[Y] = measurement.value[Y] - x[Y] - arm.north
    if m > YAW:
        H[YAW, YAW] = 1.0
        nu[YAW] = measurement.value[YAW] - x[YAW]
        if c.above[source] == 1:
            H[YAW, SWING] = 1.0
            nu[YAW] -= horizontal_direction(x[SWING], state.attitude.level)
        index = c.yaw_offsets[source]
        if index >= 0:
            H[YAW, index] = 1.0
            nu[YAW] -= x[index]
    for i in range(m):
        H[i, FIX_DELAY] = -shift[i]
        nu[i] += shift[i] * x[FIX_DELAY]
    if has_offset(state, source, c):
        index = c.offsets[source]
        for axis in (X, Y):
            H[axis, index + axis] = 1.0
            nu[axis] -= x[index + axis]
    if m > YAW:
        nu[YAW] = wrap(nu[YAW])
    remove_correlated_noise(state, source, R, c)
    considered = 1 << GYRO_BIAS if is_unobserved_receiver(state, source, c) else 0
    return Observation(nu, H, R, considered | considered_delay(state, c), 0, H[:0])


@compiled
def remove_correlated_noise(state: State, source: int, R: FloatArray, c: Config) -> None:
    """Reduce R of a fix to the part that is not time-correlated; in place."""
    stddev = position_stddev(R)
    if not has_correlated_errors(state, source, stddev, c):
        return
    share = math.sqrt(state.offsets[pose_source_number(source, c)].errors[quality_of(stddev, c)].f)
    R[:YAW] *= share
    R[:, :YAW] *= share


@compiled
def considered_delay(state: State, c: Config) -> int:
    """Bit of δ while tracks start or reverse: the shear of the soil has the effect of a delay then."""
    return 1 << FIX_DELAY if has_velocity_errors(c) and is_shear_building_up(state, c) else 0
