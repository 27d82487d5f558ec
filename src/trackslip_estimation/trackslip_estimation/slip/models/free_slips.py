# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The thesis' kinematic sub-model (3.17)–(3.20), (3.23), with its errata applied, and a gyro bias.

    x, y, φ    position of the track-contact centre C, heading   m, m, rad (site frame)
    b_g        bias of the yaw-rate gyro                         rad/s
    i_L, i_R   longitudinal slip, v_j = r ω_j (1 − i_j)          1
    α          slip angle, tan α = v_y / v_x                     rad
    ω_L, ω_R   sprocket speeds, the input                        rad/s
    r, B       rolling radius, tread                             m

    v_x = (v_L + v_R)/2                      φ̇ = (v_R − v_L)/B
    ẋ = v_x (cos φ − sin φ tan α)            ẏ = v_x (sin φ + cos φ tan α)
    i̇_L, i̇_R, α̇, ḃ_g = 0 + noise

Noise densities are in continuous time, so that splitting a step does not change its noise.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_common.compiled import compiled
from trackslip_common.parameters import Parameters, parameter
from trackslip_common.record_types import Record, dtype_of
from trackslip_estimation.slip.models.model import COMMON, GYRO_BIAS, SIZE, Part, Prior
from trackslip_estimation.slip.motion import Motion, MotionState

if TYPE_CHECKING:
    from trackslip_estimation.slip.config import Config


CODE, NAME, ACTIVE = 0, "free_slips", 7
NOISE = "noise"  # field of ``ModelParameters``
LEFT_SLIP, RIGHT_SLIP, SLIP_ANGLE = range(4, 7)
PARTS = (
    *COMMON,
    Part("slips", slice(LEFT_SLIP, RIGHT_SLIP + 1), "1, 1", "longitudinal slip of the left and right track"),
    Part("slip_angle", slice(SLIP_ANGLE, SLIP_ANGLE + 1), "rad", "direction of the velocity, left of x"),
)


class FreeSlipsConstants(Record):
    """Multiplicative noise of the sprocket speeds (3.21), √s."""

    encoder: float


CONSTANTS = dtype_of(FreeSlipsConstants)


@dataclass(frozen=True, kw_only=True)
class SlipNoise(Parameters):
    """Initial uncertainty and process noise of the sub-model."""

    encoder: float = parameter("multiplicative noise of the sprocket speeds (3.21)", unit="√s", ge=0.0)
    slip_steady: float = parameter(
        "random walk of the slips while speeds are similar and steady (3.22)", unit="1/√s", ge=0.0
    )
    slip_moving: float = parameter(
        "random walk of the slips while speeds differ or change (3.22)", unit="1/√s", ge=0.0
    )
    slip_angle_steady: float = parameter(
        "random walk of the slip angle in straight motion", unit="rad/√s", ge=0.0
    )
    slip_angle_turning: float = parameter("random walk of the slip angle in turns", unit="rad/√s", ge=0.0)
    gyro_bias: float = parameter("random walk of the gyro bias", unit="rad/s/√s", ge=0.0)
    initial_slip: float = parameter("standard deviation of the slips at the start", gt=0.0)
    initial_slip_angle: float = parameter(
        "standard deviation of the slip angle at the start", unit="rad", gt=0.0
    )
    initial_gyro_bias: float = parameter(
        "standard deviation of the gyro bias at the start", unit="rad/s", gt=0.0
    )


def prior(n: SlipNoise, tread: float) -> Prior:
    """Prior with zero slips; independent of the tread."""
    del tread
    stddev = np.zeros(SIZE)
    stddev[LEFT_SLIP] = stddev[RIGHT_SLIP] = n.initial_slip
    stddev[SLIP_ANGLE], stddev[GYRO_BIAS] = n.initial_slip_angle, n.initial_gyro_bias
    return Prior(np.zeros(SIZE), stddev)


def process_noise_density(n: SlipNoise, motion: MotionState) -> FloatArray:
    """(SIZE,) per √s: (3.22) by the jump hypothesis."""
    slip = n.slip_moving if motion.are_slips_changing else n.slip_steady
    turning = motion.motion is Motion.TURNING or motion.changing
    angle = n.slip_angle_turning if turning else n.slip_angle_steady
    if motion.motion is Motion.STANDING:
        slip = angle = 0.0  # undefined at ω = 0: frozen
    density = np.zeros(SIZE)
    density[LEFT_SLIP] = density[RIGHT_SLIP] = slip
    density[SLIP_ANGLE], density[GYRO_BIAS] = angle, n.gyro_bias
    return density


def constants(n: SlipNoise) -> dict[str, float]:
    """The fields of ``CONSTANTS``."""
    return {"encoder": n.encoder}


@compiled
def twist(x: FloatArray, left: float, right: float, c: Config) -> tuple[float, float, float]:
    """v_x m/s, v_y m/s, φ̇ rad/s of C (3.17)–(3.19)."""
    v_left = c.rolling_radius * left * (1.0 - x[LEFT_SLIP])
    v_right = c.rolling_radius * right * (1.0 - x[RIGHT_SLIP])
    v_x = (v_left + v_right) / 2.0
    return v_x, v_x * math.tan(x[SLIP_ANGLE]), (v_right - v_left) / c.tread


@compiled
def twist_jacobian(x: FloatArray, left: float, right: float, c: Config) -> FloatArray:
    """(3, SIZE) derivative of ``twist`` by the state."""
    J = np.zeros((3, x.size))
    tan = math.tan(x[SLIP_ANGLE])
    J[0, LEFT_SLIP] = -c.rolling_radius * left / 2.0
    J[0, RIGHT_SLIP] = -c.rolling_radius * right / 2.0
    J[1, LEFT_SLIP], J[1, RIGHT_SLIP] = tan * J[0, LEFT_SLIP], tan * J[0, RIGHT_SLIP]
    J[1, SLIP_ANGLE] = twist(x, left, right, c)[0] * (1.0 + tan * tan)
    J[2, LEFT_SLIP] = c.rolling_radius * left / c.tread
    J[2, RIGHT_SLIP] = -c.rolling_radius * right / c.tread
    return J


@compiled
def twist_by_speed(x: FloatArray, c: Config) -> FloatArray:
    """(3, 2) derivative of ``twist`` by (ω_L, ω_R)."""
    left = c.rolling_radius * (1.0 - x[LEFT_SLIP])
    right = c.rolling_radius * (1.0 - x[RIGHT_SLIP])
    tan = math.tan(x[SLIP_ANGLE])
    return np.array(
        (
            (left / 2.0, right / 2.0),
            (tan * left / 2.0, tan * right / 2.0),
            (-left / c.tread, right / c.tread),
        )
    )


@compiled
def slips(x: FloatArray) -> FloatArray:
    """(3,) i_L, i_R, α: they are states."""
    return x[LEFT_SLIP : SLIP_ANGLE + 1].copy()


@compiled
def slips_jacobian(size: int) -> FloatArray:
    """(3, size) derivative of ``slips`` by the state."""
    S = np.zeros((3, size))
    S[0, LEFT_SLIP] = S[1, RIGHT_SLIP] = S[2, SLIP_ANGLE] = 1.0
    return S
