# SPDX-License-Identifier: Apache-2.0
"""Sub-model 1b: not the slips are constant on a soil, but how the vehicle turns.

    x, y, φ   position of the track-contact centre C, heading            m, m, rad (site frame)
    v, ω      speed of C along x, yaw rate: states, not inputs           m/s, rad/s
    κ         turning efficiency, ω = κ D/B                              1
    η         speed lost in a turn, v = (1 − i₀) V − η |D|/2             1
    i₀        slip common to both tracks                                 1
    x_I       centre of rotation ahead of C, v_y = −ω x_I                m
    b_g       bias of the yaw-rate gyro                                  rad/s
    V, D      r (ω_L + ω_R)/2, r (ω_R − ω_L), from the sprockets         m/s
    i_L, i_R  1 − (v ∓ ω B/2)/(r ω_j), what follows for the slips        1
    τ         correlation time of what the two equations leave out       s

Sprockets and gyro are both *measurements* of v and ω. κ, η and x_I learn in turns only, i₀ while driving.
The equations are the same in left and right turns: outer and inner track keep their roles.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trackslip_common.parameters import Parameters, parameter
from trackslip_estimation.filters import ekf
from trackslip_estimation.filters.ekf import Gaussian, Linearised, wrap
from trackslip_estimation.filters.model import POSE, YAW, Outputs, X, Y, rounding_variance
from trackslip_estimation.motion import Motion, MotionState, Speeds

FloatArray = NDArray[np.float64]

SPEED, RATE, EFFICIENCY, LOSS, COMMON_SLIP, ROTATION_OFFSET, GYRO_BIAS = range(3, 10)
SIZE = 10
_TURNING = [EFFICIENCY, LOSS, ROTATION_OFFSET]
_SLOWEST = 0.02  # m/s of track or vehicle, below which slip and slip angle say nothing


@dataclass(frozen=True, kw_only=True)
class TurningNoise(Parameters):
    """Initial uncertainty, process noise, and how well the two equations hold."""

    acceleration: float = parameter("speed v", unit="m/s/√s", gt=0.0)
    yaw_acceleration: float = parameter("yaw rate ω", unit="rad/s/√s", gt=0.0)
    efficiency: float = parameter("turning efficiency κ, while turning", unit="1/√s", ge=0.0)
    loss: float = parameter("turn loss η, while turning", unit="1/√s", ge=0.0)
    common_slip: float = parameter("common slip i₀, while driving", unit="1/√s", ge=0.0)
    rotation_offset: float = parameter("centre of rotation x_I, while turning", unit="m/√s", ge=0.0)
    gyro_bias: float = parameter("walk of the gyro bias", unit="rad/s/√s", ge=0.0)
    straight_misfit: float = parameter("share of V that the equations leave out", ge=0.0)
    turning_misfit: float = parameter("share of D that the equations leave out", ge=0.0)
    misfit_time: float = parameter("correlation time τ of the misfits", unit="s", gt=0.0)
    standing_misfit: float = parameter("track speed that counts as none", unit="m/s", gt=0.0)
    initial_efficiency: float = parameter("κ before the first turn", gt=0.0, le=1.0)
    initial_efficiency_stddev: float = parameter("its standard deviation", gt=0.0)
    initial_loss: float = parameter("η before the first turn", ge=0.0, le=1.0)
    initial_loss_stddev: float = parameter("its standard deviation", gt=0.0)
    initial_common_slip_stddev: float = parameter("standard deviation of i₀ at the start", gt=0.0)
    initial_rotation_offset_stddev: float = parameter(
        "standard deviation of x_I at the start", unit="m", gt=0.0
    )
    initial_gyro_bias_stddev: float = parameter(
        "standard deviation of b_g at the start", unit="rad/s", gt=0.0
    )


@dataclass(frozen=True)
class TurningModel:
    """Motion and measurement equations for one vehicle (a ``model.Model``)."""

    rolling_radius: float  # m
    tread: float  # m
    encoder_resolution: float  # rad
    noise: TurningNoise

    def initial(self, pose: FloatArray, pose_covariance: FloatArray) -> Gaussian:
        """At rest, with typical turning and no slip."""
        n = self.noise
        mean = np.zeros(SIZE)
        mean[POSE] = pose
        mean[EFFICIENCY], mean[LOSS] = n.initial_efficiency, n.initial_loss
        deviations = np.zeros(SIZE)
        deviations[SPEED], deviations[RATE] = n.standing_misfit, n.standing_misfit / self.tread
        deviations[EFFICIENCY], deviations[LOSS] = n.initial_efficiency_stddev, n.initial_loss_stddev
        deviations[COMMON_SLIP] = n.initial_common_slip_stddev
        deviations[ROTATION_OFFSET] = n.initial_rotation_offset_stddev
        deviations[GYRO_BIAS] = n.initial_gyro_bias_stddev
        covariance = np.diag(np.square(deviations))
        covariance[POSE, POSE] = pose_covariance
        return Gaussian(mean, covariance)

    def predict(self, state: Gaussian, speeds: Speeds, dt: float, motion: MotionState) -> Gaussian:
        """Constant v, ω and parameters, each with its walk."""
        moved, F = self.move(state.mean, dt)
        return ekf.predict(state, moved, F, np.diag(np.square(self._walk(motion)) * dt))

    def move(self, x: FloatArray, dt: float) -> tuple[FloatArray, FloatArray]:
        """The mean ``dt`` s later, and F (10, 10); heading halfway turns the velocity into the site frame."""
        v_x, v_y = x[SPEED], -x[RATE] * x[ROTATION_OFFSET]
        halfway = x[YAW] + x[RATE] * dt / 2.0
        c, s = np.cos(halfway), np.sin(halfway)
        east, north = (v_x * c - v_y * s) * dt, (v_x * s + v_y * c) * dt
        moved = x.copy()
        moved[X] += east
        moved[Y] += north
        moved[YAW] = wrap(x[YAW] + x[RATE] * dt)
        F = np.eye(SIZE)
        F[X, YAW], F[Y, YAW] = -north, east
        F[X, SPEED], F[Y, SPEED] = c * dt, s * dt
        F[X, RATE] = -north * dt / 2.0 + x[ROTATION_OFFSET] * s * dt
        F[Y, RATE] = east * dt / 2.0 - x[ROTATION_OFFSET] * c * dt
        F[X, ROTATION_OFFSET], F[Y, ROTATION_OFFSET] = x[RATE] * s * dt, -x[RATE] * c * dt
        F[YAW, RATE] = dt
        return moved, F

    def drive(self, state: Gaussian, speeds: Speeds) -> Gaussian:
        """Both equations of the sub-model as measurements of v and ω."""
        if speeds.stretch <= 0.0:
            return state
        measured = self.sprockets(state.mean, speeds)
        return ekf.update(state, measured, ekf.weigh(state, measured))

    def sprockets(self, x: FloatArray, speeds: Speeds) -> Linearised:
        """0 = v − (1 − i₀) V + η |D|/2 and 0 = ω − κ D/B."""
        V, D = self._track_speeds(speeds)
        innovation = np.array(
            (
                (1.0 - x[COMMON_SLIP]) * V - x[LOSS] * abs(D) / 2.0 - x[SPEED],
                x[EFFICIENCY] * D / self.tread - x[RATE],
            )
        )
        H = np.zeros((2, SIZE))
        H[0, SPEED], H[0, COMMON_SLIP], H[0, LOSS] = 1.0, V, abs(D) / 2.0
        H[1, RATE], H[1, EFFICIENCY] = 1.0, -D / self.tread
        n = self.noise
        misfit = (n.straight_misfit * abs(V) + n.turning_misfit * abs(D)) ** 2 + n.standing_misfit**2
        rounding = self.rolling_radius**2 * rounding_variance(self.encoder_resolution, speeds)
        variance = misfit * n.misfit_time / speeds.stretch
        noise = np.diag((variance + rounding / 2.0, (variance + 2.0 * rounding) / self.tread**2))
        return Linearised(innovation, H, noise)

    def yaw_rate(self, state: Gaussian, speeds: Speeds, rate: float, variance: float) -> Linearised:
        """z = ω + b_g."""
        H = np.zeros((1, SIZE))
        H[0, RATE] = H[0, GYRO_BIAS] = 1.0
        innovation = np.array((rate - state.mean[RATE] - state.mean[GYRO_BIAS],))
        return Linearised(innovation, H, np.array(((variance,),)))

    def outputs(self, state: Gaussian, speeds: Speeds) -> Outputs:
        """Slips from v, ω and the sprockets; where a track stands, the common slip.

        The sprocket speeds are those that v and ω were just updated with: their rounding cancels.
        """
        x, P = state
        J = np.zeros((3, SIZE))  # of the twist
        J[0, SPEED] = J[2, RATE] = 1.0
        J[1, RATE], J[1, ROTATION_OFFSET] = -x[ROTATION_OFFSET], -x[RATE]
        twist = np.array((x[SPEED], -x[RATE] * x[ROTATION_OFFSET], x[RATE]))
        slips, S = np.zeros(3), np.zeros((3, SIZE))
        for side, (sprocket, sign) in enumerate(((speeds.left, -1.0), (speeds.right, 1.0))):
            track = self.rolling_radius * sprocket
            if abs(track) < _SLOWEST:
                slips[side], S[side, COMMON_SLIP] = x[COMMON_SLIP], 1.0
                continue
            slips[side] = 1.0 - (x[SPEED] + sign * x[RATE] * self.tread / 2.0) / track
            S[side, SPEED], S[side, RATE] = -1.0 / track, -sign * self.tread / 2.0 / track
        if abs(x[SPEED]) >= _SLOWEST:
            slips[2] = np.arctan(twist[1] / x[SPEED])
            S[2] = (x[SPEED] * J[1] - twist[1] * J[0]) / (x[SPEED] ** 2 + twist[1] ** 2)
        return Outputs(twist, J @ P @ J.T, slips, S @ P @ S.T)

    def _track_speeds(self, speeds: Speeds) -> tuple[float, float]:
        """V and D, m/s."""
        left, right = self.rolling_radius * speeds.left, self.rolling_radius * speeds.right
        return (left + right) / 2.0, right - left

    def _walk(self, motion: MotionState) -> FloatArray:
        """(10,) standard deviation per √s of each state."""
        n = self.noise
        walk = np.zeros(SIZE)
        walk[SPEED], walk[RATE], walk[GYRO_BIAS] = n.acceleration, n.yaw_acceleration, n.gyro_bias
        if motion.motion is not Motion.STANDING:
            walk[COMMON_SLIP] = n.common_slip
        if motion.motion is Motion.TURNING:
            walk[_TURNING] = n.efficiency, n.loss, n.rotation_offset
        return walk
