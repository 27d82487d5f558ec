# SPDX-License-Identifier: Apache-2.0
"""What the models share that know how the vehicle turns: two equations for its speeds, and their misfits.

x, y, φ    position of the track-contact centre C, heading            m, m, rad (site frame)
m_v, m_ω   misfits: what v and ω are beyond a model's two equations   m/s, rad/s
a, b       how the vehicle turns: each model has its own pair
i₀         slip common to both tracks                                 1
x_I        centre of rotation ahead of C, v_y = −ω x_I                m
b_g        bias of the yaw-rate gyro                                  rad/s
v, ω       speed of C along x, yaw rate                               m/s, rad/s
i_L, i_R   1 − (v ∓ ω B/2)/(r ω_j), what follows for the slips        1
V, D       r (ω_L + ω_R)/2, r (ω_R − ω_L), from the sprockets         m/s
d          how far the sprockets' speeds depart from their mean       m/s
τ, σ       correlation time of the misfits, their size                s, m/s
ρ          e^(−dt/τ)                                                  1

Misfits are Ornstein–Uhlenbeck: ṁ = −m/τ + noise, of size σ in v and σ/B in ω. Measured on the shear truth, σ
is a small share of V and D while the machine goes steadily (in ω less than in v, as both tracks ring alike),
and a large share of d while its speed changes: the vehicle answers its tracks with a lag, rings on the soil,
and has the rest settled within tenths of a second. All this is larger on a soil that yields more, which i₀
tells: σ² grows with 1 + (i₀/i_y)². It is the jump hypothesis (3.22) in numbers. When the sprockets are silent
the motion is UNKNOWN; V and D are then 0, the misfits are the speeds themselves, and hold.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trackslip_common.compiled import compiled
from trackslip_common.parameters import Parameters, parameter
from trackslip_estimation.slip.models.model import POSE, Gaussian
from trackslip_estimation.slip.motion import Motion, MotionState

FloatArray = NDArray[np.float64]

SPEED_MISFIT, RATE_MISFIT, FIRST, SECOND, COMMON_SLIP, ROTATION_OFFSET, GYRO_BIAS = range(3, 10)
SIZE = 10
_SLOWEST = 0.02  # m/s of track or vehicle, below which slip and slip angle say nothing
_SILENT, _TURNING = int(Motion.UNKNOWN), int(Motion.TURNING)


@dataclass(frozen=True, kw_only=True)
class SpeedNoise(Parameters):
    """Initial uncertainty, process noise, and how well a model's two equations hold."""

    common_slip: float = parameter("common slip i₀, while driving", unit="1/√s", ge=0.0)
    rotation_offset: float = parameter("centre of rotation x_I, while turning", unit="m/√s", ge=0.0)
    gyro_bias: float = parameter("walk of the gyro bias", unit="rad/s/√s", ge=0.0)
    straight_misfit: float = parameter("share of V that the equations leave out, straight on", ge=0.0)
    turning_misfit: float = parameter("share of D that the equations leave out, in turns", ge=0.0)
    changing_misfit: float = parameter("share of d that the equations leave out", ge=0.0)
    standing_misfit: float = parameter("track speed that counts as none", unit="m/s", gt=0.0)
    yielding_slip: float = parameter("i₀ of a soil on which the misfits have twice the variance", gt=0.0)
    rate_misfit: float = parameter("steady misfit of ω times B, over that of v", ge=0.0)
    misfit_time: float = parameter("correlation time τ of the misfits", unit="s", gt=0.0)
    settling: float = parameter("how much faster x_I and the pair walk while speeds change", ge=1.0)
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
        deviations[SPEED_MISFIT], deviations[RATE_MISFIT] = n.standing_misfit, n.standing_misfit / self.tread
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
            "changing_misfit": n.changing_misfit,
            "standing_misfit": n.standing_misfit,
            "yielding_slip": n.yielding_slip,
            "rate_misfit": n.rate_misfit,
            "misfit_time": n.misfit_time,
            "slip_variance": n.initial_common_slip_stddev**2,
        }

    def walk(self, motion: MotionState) -> FloatArray:
        """How the vehicle turns shows in turns only, and changes there only; i₀ while driving."""
        n = self.noise
        walk = np.zeros(SIZE)
        walk[GYRO_BIAS] = n.gyro_bias
        if motion.motion is not Motion.STANDING:
            walk[COMMON_SLIP] = n.common_slip
        if motion.motion is Motion.TURNING:
            walk[ROTATION_OFFSET] = n.rotation_offset * self.hurry(motion)
        return walk

    def hurry(self, motion: MotionState) -> float:
        """How much faster than in steady turns that changes which shows in turns."""
        return self.noise.settling if motion.changing else 1.0


@compiled
def twist(x: FloatArray, v: float, rate: float) -> tuple[float, float, float]:
    """v_x m/s, v_y m/s, ω rad/s of C, where a model's equations give ``v`` and ``rate``."""
    rate += x[RATE_MISFIT]
    return v + x[SPEED_MISFIT], -rate * x[ROTATION_OFFSET], rate


@compiled
def twist_jacobian(x: FloatArray, rate: float, J: FloatArray) -> FloatArray:
    """(3, 10) derivative of ``twist``; J has those of the equations in its first and last row."""
    J[0, SPEED_MISFIT] = J[2, RATE_MISFIT] = 1.0
    J[1] = -x[ROTATION_OFFSET] * J[2]
    J[1, ROTATION_OFFSET] -= rate + x[RATE_MISFIT]
    return J


@compiled
def persistence(dt: float, motion: int, c: Any) -> tuple[float, float]:
    """Share of a misfit that is left after dt, ρ, and the mean share over it, (1 − ρ) τ/dt."""
    a = dt / c.misfit_time
    if motion == _SILENT or a <= 0.0:
        return 1.0, 1.0
    return math.exp(-a), -math.expm1(-a) / a


@compiled
def misfit_growth(dt: float, motion: int, c: Any) -> tuple[float, float, float]:
    """What dt adds to a misfit of size 1: variance of its mean over dt, covariance with its end, variance."""
    a = dt / c.misfit_time
    if motion == _SILENT or a <= 0.0:
        return 0.0, 0.0, 0.0
    left = -math.expm1(-a)  # 1 − ρ
    if a < 1e-2:  # the closed form cancels
        mean = a * (2.0 / 3.0 - a / 2.0)
    else:
        mean = (2.0 * a - 4.0 * left + 1.0 - (1.0 - left) ** 2) / (a * a)
    return mean, left * left / a, 1.0 - (1.0 - left) ** 2


@compiled
def misfit_variances(
    x: FloatArray, P: FloatArray, left: float, right: float, motion: int, departure: float, c: Any
) -> tuple[float, float]:
    """Of m_v, (m/s)², and of m_ω, (rad/s)²; expected, as far as i₀ is known."""
    if motion == _TURNING:
        steady = c.turning_misfit * c.rolling_radius * (right - left)
    else:
        steady = c.straight_misfit * c.rolling_radius * (left + right) / 2.0
    changing = c.changing_misfit * c.rolling_radius * departure
    yielding = 1.0 + (x[COMMON_SLIP] ** 2 + P[COMMON_SLIP, COMMON_SLIP]) / float(c.yielding_slip) ** 2
    of_speed = (steady**2 + changing**2) * yielding + c.standing_misfit**2
    of_rate = ((c.rate_misfit * steady) ** 2 + changing**2) * yielding + c.standing_misfit**2
    return of_speed, of_rate / c.tread**2


@compiled
def slips(
    x: FloatArray, v_x: float, v_y: float, rate: float, left: float, right: float, c: Any
) -> FloatArray:
    """(3,) i_L, i_R, α from the twist and the sprockets; where a track stands, the common slip."""
    found = np.zeros(3)
    for side in range(2):
        track = c.rolling_radius * (left if side == 0 else right)
        sign = -1.0 if side == 0 else 1.0
        if abs(track) < _SLOWEST:
            found[side] = x[COMMON_SLIP]
        else:
            found[side] = 1.0 - (v_x + sign * rate * c.tread / 2.0) / track
    if abs(v_x) >= _SLOWEST:
        found[2] = math.atan(v_y / v_x)
    return found


@compiled
def slips_jacobian(v_x: float, v_y: float, J: FloatArray, left: float, right: float, c: Any) -> FloatArray:
    """(3, 10) derivative of ``slips``, by that of the twist, J (3, 10)."""
    S = np.zeros((3, SIZE))
    for side in range(2):
        track = c.rolling_radius * (left if side == 0 else right)
        sign = -1.0 if side == 0 else 1.0
        if abs(track) < _SLOWEST:
            S[side, COMMON_SLIP] = 1.0
        else:
            S[side] = -(J[0] + sign * c.tread / 2.0 * J[2]) / track
    if abs(v_x) >= _SLOWEST:
        S[2] = (v_x * J[1] - v_y * J[0]) / (v_x * v_x + v_y * v_y)
    return S
