# SPDX-License-Identifier: Apache-2.0
"""The thesis' kinematic sub-model (3.17)–(3.20), (3.23), with its errata applied, and a gyro bias.

    x, y, φ    position of the track-contact centre C, heading   m, m, rad (site frame)
    i_L, i_R   longitudinal slip, v_j = r ω_j (1 − i_j)          1
    α          slip angle, tan α = v_y / v_x                     rad
    b_g        bias of the yaw-rate gyro                         rad/s
    ω_L, ω_R   sprocket speeds, the input                        rad/s
    r, B       rolling radius, tread                             m

    v_x = (v_L + v_R)/2                      φ̇ = (v_R − v_L)/B
    ẋ = v_x (cos φ − sin φ tan α)            ẏ = v_x (sin φ + cos φ tan α)
    i̇_L, i̇_R, α̇, ḃ_g = 0 + noise

Noise densities are in continuous time, so that splitting a step does not change what it adds.
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

LEFT_SLIP, RIGHT_SLIP, SLIP_ANGLE, GYRO_BIAS = range(3, 7)
SIZE = 7
SLIPS = slice(LEFT_SLIP, SLIP_ANGLE + 1)


@dataclass(frozen=True, kw_only=True)
class SlipNoise(Parameters):
    """Initial uncertainty and process noise of the sub-model."""

    encoder: float = parameter("multiplicative noise of the sprocket speeds (3.21)", unit="√s", ge=0.0)
    slip_steady: float = parameter("slip, speeds similar and steady (3.22)", unit="1/√s", ge=0.0)
    slip_moving: float = parameter("slip, speeds differ or change (3.22)", unit="1/√s", ge=0.0)
    slip_angle_steady: float = parameter("slip angle, straight", unit="rad/√s", ge=0.0)
    slip_angle_turning: float = parameter("slip angle, turning", unit="rad/√s", ge=0.0)
    gyro_bias: float = parameter("walk of the gyro bias", unit="rad/s/√s", ge=0.0)
    initial_slip: float = parameter("standard deviation of the slips at the start", gt=0.0)
    initial_slip_angle: float = parameter(
        "standard deviation of the slip angle at the start", unit="rad", gt=0.0
    )
    initial_gyro_bias: float = parameter(
        "standard deviation of the gyro bias at the start", unit="rad/s", gt=0.0
    )


@dataclass(frozen=True)
class SlipModel:
    """Motion and measurement equations for one vehicle (a ``model.Model``)."""

    rolling_radius: float  # m
    tread: float  # m
    encoder_resolution: float  # rad
    noise: SlipNoise

    def initial(self, pose: FloatArray, pose_covariance: FloatArray) -> Gaussian:
        """Unknown slips about zero."""
        mean = np.zeros(SIZE)
        mean[POSE] = pose
        noise = self.noise
        deviations = (
            noise.initial_slip,
            noise.initial_slip,
            noise.initial_slip_angle,
            noise.initial_gyro_bias,
        )
        covariance = np.diag((0.0, 0.0, 0.0, *np.square(deviations)))
        covariance[POSE, POSE] = pose_covariance
        return Gaussian(mean, covariance)

    def predict(self, state: Gaussian, speeds: Speeds, dt: float, motion: MotionState) -> Gaussian:
        """Driven by the sprockets."""
        mean, F, G = self.move(state.mean, speeds.left, speeds.right, dt)
        noise = self.process_noise(G, speeds.left, speeds.right, dt, motion)
        return ekf.predict(state, mean, F, noise)

    def drive(self, state: Gaussian, speeds: Speeds) -> Gaussian:
        """Nothing beyond the prediction."""
        return state

    def twist(self, x: FloatArray, left: float, right: float) -> FloatArray:
        """(3,) v_x m/s, v_y m/s, φ̇ rad/s of C (3.17)–(3.19)."""
        v_left = self.rolling_radius * left * (1.0 - x[LEFT_SLIP])
        v_right = self.rolling_radius * right * (1.0 - x[RIGHT_SLIP])
        v_x = (v_left + v_right) / 2.0
        return np.array((v_x, v_x * np.tan(x[SLIP_ANGLE]), (v_right - v_left) / self.tread))

    def twist_jacobian(self, x: FloatArray, left: float, right: float) -> FloatArray:
        """(3, 7) derivative of ``twist`` by the state."""
        J = np.zeros((3, SIZE))
        tan = np.tan(x[SLIP_ANGLE])
        J[0, LEFT_SLIP] = -self.rolling_radius * left / 2.0
        J[0, RIGHT_SLIP] = -self.rolling_radius * right / 2.0
        J[1] = tan * J[0]
        J[1, SLIP_ANGLE] = self.twist(x, left, right)[0] * (1.0 + tan * tan)
        J[2, LEFT_SLIP] = self.rolling_radius * left / self.tread
        J[2, RIGHT_SLIP] = -self.rolling_radius * right / self.tread
        return J

    def move(
        self, x: FloatArray, left: float, right: float, dt: float
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """One step of ``dt`` s: the new mean, F (7, 7), and G (7, 2) by the sprocket speeds.

        Midpoint rule: heading halfway through the step turns the velocity into the site frame.
        """
        v_x, v_y, rate = self.twist(x, left, right)
        halfway = x[YAW] + rate * dt / 2.0
        c, s = np.cos(halfway), np.sin(halfway)
        moved = x.copy()
        moved[X] += (v_x * c - v_y * s) * dt
        moved[Y] += (v_x * s + v_y * c) * dt
        moved[YAW] = wrap(x[YAW] + rate * dt)

        to_site = np.array(((c, -s, 0.0), (s, c, 0.0), (0.0, 0.0, 1.0))) * dt
        turn = np.array((-(v_x * s + v_y * c), v_x * c - v_y * s, 0.0)) * dt  # d/d halfway
        of_twist = to_site + np.outer(turn, (0.0, 0.0, dt / 2.0))
        F = np.eye(SIZE)
        F[POSE] += of_twist @ self.twist_jacobian(x, left, right)
        F[POSE, YAW] += turn
        G = np.zeros((SIZE, 2))
        G[POSE] = of_twist @ self._twist_by_speed(x)
        return moved, F, G

    def process_noise(
        self, G: FloatArray, left: float, right: float, dt: float, motion: MotionState
    ) -> FloatArray:
        """Q (7, 7) of a step of ``dt`` s: (3.21) through G, and (3.22) by the jump hypothesis."""
        noise = self.noise
        slip = noise.slip_moving if motion.slips_move else noise.slip_steady
        turning = motion.motion is Motion.TURNING or motion.changing
        angle = noise.slip_angle_turning if turning else noise.slip_angle_steady
        if motion.motion is Motion.STANDING:
            slip = angle = 0.0  # undefined at ω = 0: frozen
        walk = np.square((0.0, 0.0, 0.0, slip, slip, angle, noise.gyro_bias)) * dt
        if dt <= 0.0:
            return np.diag(walk)
        speed_variance = np.square((noise.encoder * left, noise.encoder * right)) / dt
        Q: FloatArray = (G * speed_variance) @ G.T + np.diag(walk)
        return Q

    def yaw_rate(self, state: Gaussian, speeds: Speeds, rate: float, variance: float) -> Linearised:
        """z = φ̇ + b_g; φ̇ as predicted carries the rounding of the sprocket positions."""
        left, right = speeds.left, speeds.right
        H = self.twist_jacobian(state.mean, left, right)[2:].copy()
        H[0, GYRO_BIAS] = 1.0
        predicted = self.twist(state.mean, left, right)[2] + state.mean[GYRO_BIAS]
        rounding = rounding_variance(self.encoder_resolution, speeds)
        noise = variance + 2.0 * rounding * (self.rolling_radius / self.tread) ** 2
        return Linearised(np.array((rate - predicted,)), H, np.array(((noise,),)))

    def outputs(self, state: Gaussian, speeds: Speeds) -> Outputs:
        """The slips are states; the twist follows from them and the sprockets."""
        x, P = state
        J = self.twist_jacobian(x, speeds.left, speeds.right)
        twist = self.twist(x, speeds.left, speeds.right)
        return Outputs(twist, J @ P @ J.T, x[SLIPS], P[SLIPS, SLIPS])

    def _twist_by_speed(self, x: FloatArray) -> FloatArray:
        """(3, 2) derivative of ``twist`` by (ω_L, ω_R)."""
        left = self.rolling_radius * (1.0 - x[LEFT_SLIP])
        right = self.rolling_radius * (1.0 - x[RIGHT_SLIP])
        tan = np.tan(x[SLIP_ANGLE])
        return np.array(
            (
                (left / 2.0, right / 2.0),
                (tan * left / 2.0, tan * right / 2.0),
                (-left / self.tread, right / self.tread),
            )
        )
