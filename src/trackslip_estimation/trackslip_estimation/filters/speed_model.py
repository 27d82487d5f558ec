# SPDX-License-Identifier: Apache-2.0
"""What the models share whose states are speeds: sprockets and gyro are both *measurements* of v and ω.

x, y, φ    position of the track-contact centre C, heading            m, m, rad (site frame)
v, ω       speed of C along x, yaw rate: states, not inputs           m/s, rad/s
a, b       how the vehicle turns: each model has its own pair
i₀         slip common to both tracks                                 1
x_I        centre of rotation ahead of C, v_y = −ω x_I                m
b_g        bias of the yaw-rate gyro                                  rad/s
i_L, i_R   1 − (v ∓ ω B/2)/(r ω_j), what follows for the slips        1
V, D       r (ω_L + ω_R)/2, r (ω_R − ω_L), from the sprockets         m/s
τ          correlation time of what a model's equations leave out     s
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trackslip_common.parameters import Parameters, parameter
from trackslip_estimation.compiled import compiled
from trackslip_estimation.filters.model import POSE, Gaussian
from trackslip_estimation.motion import Motion, MotionState

FloatArray = NDArray[np.float64]

SPEED, RATE, FIRST, SECOND, COMMON_SLIP, ROTATION_OFFSET, GYRO_BIAS = range(3, 10)
SIZE = 10
_SLOWEST = 0.02  # m/s of track or vehicle, below which slip and slip angle say nothing


@dataclass(frozen=True, kw_only=True)
class SpeedNoise(Parameters):
    """Initial uncertainty, process noise, and how well a model's two equations hold."""

    acceleration: float = parameter("speed v", unit="m/s/√s", gt=0.0)
    yaw_acceleration: float = parameter("yaw rate ω", unit="rad/s/√s", gt=0.0)
    common_slip: float = parameter("common slip i₀, while driving", unit="1/√s", ge=0.0)
    rotation_offset: float = parameter("centre of rotation x_I, while turning", unit="m/√s", ge=0.0)
    gyro_bias: float = parameter("walk of the gyro bias", unit="rad/s/√s", ge=0.0)
    straight_misfit: float = parameter("share of V that the equations leave out", ge=0.0)
    turning_misfit: float = parameter("share of D that the equations leave out", ge=0.0)
    misfit_time: float = parameter("correlation time τ of the misfits", unit="s", gt=0.0)
    standing_misfit: float = parameter("track speed that counts as none", unit="m/s", gt=0.0)
    initial_common_slip_stddev: float = parameter("standard deviation of i₀ at the start", gt=0.0)
    initial_rotation_offset_stddev: float = parameter(
        "standard deviation of x_I at the start", unit="m", gt=0.0
    )
    initial_gyro_bias_stddev: float = parameter(
        "standard deviation of b_g at the start", unit="rad/s", gt=0.0
    )


@dataclass(frozen=True)
class SpeedModel:
    """Numbers of such a model for one vehicle, but for its own pair of states."""

    rolling_radius: float  # m
    tread: float  # m
    encoder_resolution: float  # rad
    noise: SpeedNoise

    def initial(self, pose: FloatArray, pose_covariance: FloatArray) -> Gaussian:
        """At rest, with no slip."""
        n = self.noise
        mean = np.zeros(SIZE)
        mean[POSE] = pose
        deviations = np.zeros(SIZE)
        deviations[SPEED], deviations[RATE] = n.standing_misfit, n.standing_misfit / self.tread
        deviations[COMMON_SLIP] = n.initial_common_slip_stddev
        deviations[ROTATION_OFFSET] = n.initial_rotation_offset_stddev
        deviations[GYRO_BIAS] = n.initial_gyro_bias_stddev
        covariance = np.diag(np.square(deviations))
        covariance[POSE, POSE] = pose_covariance
        return Gaussian(mean, covariance)

    def constants(self) -> dict[str, float]:
        """What the compiled equations need."""
        n = self.noise
        return {
            "rolling_radius": self.rolling_radius,
            "tread": self.tread,
            "encoder_resolution": self.encoder_resolution,
            "straight_misfit": n.straight_misfit,
            "turning_misfit": n.turning_misfit,
            "standing_misfit": n.standing_misfit,
            "misfit_time": n.misfit_time,
        }

    def walk(self, motion: MotionState) -> FloatArray:
        """How the vehicle turns shows in turns only, and changes there only; i₀ while driving."""
        n = self.noise
        walk = np.zeros(SIZE)
        walk[SPEED], walk[RATE], walk[GYRO_BIAS] = n.acceleration, n.yaw_acceleration, n.gyro_bias
        if motion.motion is not Motion.STANDING:
            walk[COMMON_SLIP] = n.common_slip
        if motion.motion is Motion.TURNING:
            walk[ROTATION_OFFSET] = n.rotation_offset
        return walk


@compiled
def twist(x: FloatArray) -> tuple[float, float, float]:
    """v_x m/s, v_y m/s, ω rad/s of C."""
    return x[SPEED], -x[RATE] * x[ROTATION_OFFSET], x[RATE]


@compiled
def twist_jacobian(x: FloatArray) -> FloatArray:
    """(3, 10) derivative of ``twist`` by the state."""
    J = np.zeros((3, SIZE))
    J[0, SPEED] = J[2, RATE] = 1.0
    J[1, RATE], J[1, ROTATION_OFFSET] = -x[ROTATION_OFFSET], -x[RATE]
    return J


@compiled
def misfit_variance(left: float, right: float, stretch: float, c: Any) -> float:
    """What a model's equations leave out of a speed over a stretch of time, (m/s)²."""
    V, D = c.rolling_radius * (left + right) / 2.0, c.rolling_radius * (right - left)
    misfit: float = (c.straight_misfit * abs(V) + c.turning_misfit * abs(D)) ** 2 + c.standing_misfit**2
    return misfit * float(c.misfit_time) / stretch


@compiled
def slips(x: FloatArray, left: float, right: float, c: Any) -> FloatArray:
    """(3,) i_L, i_R, α from v, ω and the sprockets; where a track stands, the common slip."""
    found = np.zeros(3)
    for side in range(2):
        track = c.rolling_radius * (left if side == 0 else right)
        sign = -1.0 if side == 0 else 1.0
        if abs(track) < _SLOWEST:
            found[side] = x[COMMON_SLIP]
        else:
            found[side] = 1.0 - (x[SPEED] + sign * x[RATE] * c.tread / 2.0) / track
    if abs(x[SPEED]) >= _SLOWEST:
        found[2] = math.atan(-x[RATE] * x[ROTATION_OFFSET] / x[SPEED])
    return found


@compiled
def slips_jacobian(x: FloatArray, left: float, right: float, c: Any) -> FloatArray:
    """(3, 10) derivative of ``slips`` by the state.

    The sprocket speeds are those that v and ω were just updated with: their rounding cancels.
    """
    S = np.zeros((3, SIZE))
    for side in range(2):
        track = c.rolling_radius * (left if side == 0 else right)
        sign = -1.0 if side == 0 else 1.0
        if abs(track) < _SLOWEST:
            S[side, COMMON_SLIP] = 1.0
        else:
            S[side, SPEED], S[side, RATE] = -1.0 / track, -sign * c.tread / 2.0 / track
    if abs(x[SPEED]) >= _SLOWEST:
        v_x, v_y, _ = twist(x)
        J = twist_jacobian(x)
        S[2] = (v_x * J[1] - v_y * J[0]) / (v_x * v_x + v_y * v_y)
    return S
