# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Update of the machine's height with the altitude of a fix; compiled. Arguments as in ``update``.

    z, R     altitude of the sensor above the origin of the map, its variance               m, m²
    l        place of the sensor in base_link, with the swing of the upper structure        m
    h = z_C − l_x sin θ + (l_y sin φ + l_z cos φ) cos θ
    ż, Δt    climb rate of C, and time since the last altitude that was used                m/s, s
    τ, T     correlation times of the error of a fix, and of an error of slip               s

An altitude corrects the height of the attitude filter and, through their correlation, tilt and biases. The
difference between the climb and the pitch along the distance driven shows the error of the pitch. An error of
slip has the same effect: it is modelled by inflating the variance of the height by that of ż times Δt max(2
T, Δt). The time-correlated share of R counts coth(Δt/2τ) times.

Inside its gate an altitude is used in full, up to the soft gate it is down-weighted. Beyond the soft gate it
is rejected, until several rejected altitudes agree over three timeouts of their source. Then the variance of
the height is inflated by the squared innovation, and the altitude is used.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_common.compiled import compiled
from trackslip_estimation.attitude.level import climb_rate_variance, set_level
from trackslip_estimation.attitude.records import HEIGHT, PITCH, ROLL, SIZE, AttitudeRejection
from trackslip_estimation.kalman.linear_algebra import sandwich
from trackslip_estimation.kalman.update import (
    correct,
    independent_observation,
    inflate_noise_to_gate,
    predicted_covariance,
)
from trackslip_estimation.slip.levers import swung_lever_arm, unknown_swing_variance
from trackslip_estimation.slip.measurements import UNOBSERVED
from trackslip_estimation.slip.models.dispatch import body_jacobian
from trackslip_estimation.slip.models.model import SWING
from trackslip_estimation.slip.source_offsets import error_model, pose_source_number, time_correlated_share
from trackslip_estimation.slip.validity import HIGHEST

if TYPE_CHECKING:
    from trackslip_estimation.attitude.records import Altitudes
    from trackslip_estimation.slip.config import Config
    from trackslip_estimation.slip.records import MeasurementRecord, State


_NONE, _GATED = int(AttitudeRejection.NO_ALTITUDE), int(AttitudeRejection.ALTITUDE_GATED)
_SLIP_TIME = 10.0  # s, T
_LEAST_AGREEING = 3  # least number of altitudes that agree, and of timeouts that they span
_SHORTEST, _LONGEST = 1e-3, 3600.0  # s, bounds of Δt


@compiled
def update_height(state: State, measurement: MeasurementRecord, c: Config) -> int:
    """Update the height with the altitude of a fix that was used.

    Returns the ``AttitudeRejection`` of a rejected altitude; 0 if it was used or is not requested.
    """
    source, a, variance = measurement.source, state.attitude, measurement.altitude_variance
    if c.use_altitude[source] == 0 or a.known == 0 or variance >= UNOBSERVED:
        return 0
    if not (abs(measurement.altitude) < HIGHEST and variance > 0.0):
        return _NONE
    dt = min(max((measurement.stamp_ns - a.altitudes.used_ns) * 1e-9, _SHORTEST), _LONGEST)
    expected, H = _predicted_altitude(state, source, c)
    innovation, limit = measurement.altitude - expected, c.gate_limits[1]
    stated, R = _altitude_variances(state, measurement, dt, c)
    spread = _rise_variance(state, c) * dt * max(2.0 * _SLIP_TIME, dt)
    predicted = predicted_covariance(a.covariance[:], H) + spread
    nis = innovation * innovation / (predicted[0, 0] + R)
    o = independent_observation(np.array((innovation,)), H, np.array(((R,),)))
    if nis > c.adaptation.soft_gate * limit:
        if not _is_persistent(a.altitudes, innovation, stated, measurement, c):
            return _GATED
        spread += innovation * innovation
    else:
        inflate_noise_to_gate(o.noise, o.innovation, predicted, limit)
    a.covariance[HEIGHT, HEIGHT] += spread
    correct(a.mean[:], a.covariance[:], o)
    set_level(a)
    a.altitudes.used_ns, a.altitudes.rejections = measurement.stamp_ns, 0
    return 0


@compiled
def _rise_variance(state: State, c: Config) -> float:
    """Variance of ż, (m/s)², by the uncertain velocity of C."""
    J = body_jacobian(state.mean[: c.size], state.speeds.left, state.speeds.right, state, c)
    return climb_rate_variance(state.attitude.level, sandwich(J, state.covariance[:]))


@compiled
def _predicted_altitude(state: State, source: int, c: Config) -> tuple[float, FloatArray]:
    """h, and its Jacobian (1, SIZE)."""
    x, y, _, _ = swung_lever_arm(state.mean[SWING], source, c)
    z, mean = c.levers[source, 2], state.attitude.mean
    sin, cos = math.sin(mean[ROLL]), math.cos(mean[ROLL])
    sin_pitch, cos_pitch = math.sin(mean[PITCH]), math.cos(mean[PITCH])
    H = np.zeros((1, SIZE))
    H[0, HEIGHT] = 1.0
    H[0, ROLL] = (y * cos - z * sin) * cos_pitch
    H[0, PITCH] = -x * cos_pitch - (y * sin + z * cos) * sin_pitch
    return mean[HEIGHT] - x * sin_pitch + (y * sin + z * cos) * cos_pitch, H


@compiled
def _altitude_variances(
    state: State, measurement: MeasurementRecord, dt: float, c: Config
) -> tuple[float, float]:
    """R as stated, with floor, noise factor and lever arm; and inflated for correlation over ``dt`` s."""
    source, level = measurement.source, state.attitude.level
    stated = max(measurement.altitude_variance, c.position_floor[source] ** 2)
    stated *= state.adaptation.fix_factors[source]
    squared_slope = level.downhill_x**2 + level.downhill_y**2
    stated += squared_slope * unknown_swing_variance(state.covariance, source, c)
    share = time_correlated_share(state, source, c)
    if share == 0.0:
        return stated, stated
    offset = state.offsets[pose_source_number(source, c)]
    time = error_model(offset, c).time
    return stated, stated * (1.0 - share + share / math.tanh(dt / (2.0 * time)))


@compiled
def _is_persistent(
    altitudes: Altitudes, innovation: float, stated: float, measurement: MeasurementRecord, c: Config
) -> bool:
    """Whether this altitude, outside the gate, completes a series of altitudes that agree."""
    difference = innovation - altitudes.innovation
    if altitudes.rejections == 0 or difference * difference > 2.0 * c.gate_limits[1] * stated:
        altitudes.rejections, altitudes.innovation = 0, innovation
        altitudes.rejected_ns = measurement.stamp_ns
    altitudes.rejections += 1
    lasted_ns = measurement.stamp_ns - altitudes.rejected_ns
    return bool(
        altitudes.rejections >= _LEAST_AGREEING
        and lasted_ns >= _LEAST_AGREEING * c.timeouts_ns[measurement.source]
    )
