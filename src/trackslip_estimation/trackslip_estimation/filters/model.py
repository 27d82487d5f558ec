# SPDX-License-Identifier: Apache-2.0
"""What a motion model must tell a filter; the slip estimator runs on any of them."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from trackslip_estimation.filters.ekf import Gaussian, Linearised, wrap
from trackslip_estimation.motion import MotionState, Speeds

FloatArray = NDArray[np.float64]

X, Y, YAW = range(3)  # of every model's state: site frame, m, m, rad
POSE = slice(X, YAW + 1)


@dataclass(frozen=True, eq=False)
class Outputs:
    """What a model's state means, with covariances."""

    twist: FloatArray  # (3,) v_x m/s, v_y m/s, yaw rate rad/s at C
    twist_covariance: FloatArray  # (3, 3)
    slips: FloatArray  # (3,) left slip, right slip, slip angle rad
    slip_covariance: FloatArray  # (3, 3)


class Model(Protocol):
    """Motion and measurement equations over a state that begins with x, y, φ."""

    def initial(self, pose: FloatArray, pose_covariance: FloatArray) -> Gaussian:
        """A start with known pose (3,) and its covariance (3, 3)."""

    def predict(self, state: Gaussian, speeds: Speeds, dt: float, motion: MotionState) -> Gaussian:
        """The state ``dt`` s later."""

    def drive(self, state: Gaussian, speeds: Speeds) -> Gaussian:
        """What a sprocket sample says of the state, beyond driving the prediction."""

    def yaw_rate(self, state: Gaussian, speeds: Speeds, rate: float, variance: float) -> Linearised:
        """A gyro's rate, rad/s, held against the state."""

    def outputs(self, state: Gaussian, speeds: Speeds) -> Outputs:
        """Twist and slips."""


def pose_residual(state: Gaussian, pose: FloatArray, covariance: FloatArray, use_heading: bool) -> Linearised:
    """z = (x, y) and, where wanted, φ: the same for every model."""
    rows = YAW + 1 if use_heading else YAW
    innovation = (pose - state.mean[POSE])[:rows]
    if use_heading:
        innovation[YAW] = wrap(innovation[YAW])
    return Linearised(innovation, np.eye(state.mean.size)[:rows], covariance[:rows, :rows])


def rounding_variance(resolution: float, speeds: Speeds) -> float:
    """Variance of one sprocket speed differenced from two counts rounded to ``resolution`` rad, (rad/s)²."""
    if not speeds.differenced or speeds.stretch <= 0.0:
        return 0.0
    return 2.0 * (resolution / speeds.stretch) ** 2 / 12.0
