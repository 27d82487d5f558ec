# SPDX-License-Identifier: Apache-2.0
"""Sub-model 2: coefficients of resistance from thrusts and motion, (3.14), (3.24) as errata 3 has them.

    x        v_x, φ̇, μ_r, μ_l                                        m/s, rad/s, 1, 1
    v_y      lateral speed at C, from the slip estimator              m/s
    F_j      thrust of a track                                        N
    s_j      expected sign of a track's ground speed                  1
    s        sense of the turn: 1 left, −1 right                      1
    m, I_z, W, B, l   of ``Vehicle``

    m (v̇_x − v_y φ̇) = F_L + F_R − ½ μ_r W (s_L + s_R)
    I_z φ̈ = ½ B [F_R − F_L − ½ μ_r W (s_R − s_L)] − s μ_l W l/3

The second line holds in turns. In straight motion φ̇ follows what is measured, and μ_l, the mobilised value,
is held. What is not known of F, I_z and the signs is noise of the accelerations; it lasts, so that its
density is its variance times the time for which it does. With given signs all is linear: a Kalman filter.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trackslip_common.parameters import Parameters, parameter
from trackslip_common.vehicle import Vehicle
from trackslip_estimation.slip.motion import Motion
from trackslip_estimation.soil.dynamics_kernel import MU_L, MU_R, RATE, SPEED, Numbers, correct, predict
from trackslip_estimation.soil.thrust import Thrust
from trackslip_estimation.soil.tracks import frame_speeds

FloatArray = NDArray[np.float64]

_MOTION, _MU = slice(SPEED, RATE + 1), slice(MU_R, MU_L + 1)
_LONGEST_STEP = 0.5  # s: over a longer one the forces are not known
_ROUNDING = 1e-12  # (m/s)², (rad/s)²: nothing is measured better


@dataclass(frozen=True, kw_only=True)
class DynamicsParameters(Parameters):
    """Noise and start of the filter."""

    mu_r: float = parameter("μ_r at the start", ge=0.0)
    mu_r_stddev: float = parameter("its standard deviation, and the largest", gt=0.0)
    mu_l: float = parameter("mobilised μ_l at the start", ge=0.0)
    mu_l_stddev: float = parameter("its standard deviation, and the largest", gt=0.0)
    mu_r_walk: float = parameter("walk of μ_r while driving", unit="1/√s", gt=0.0)
    mu_l_walk: float = parameter("walk of μ_l in turns", unit="1/√s", gt=0.0)
    unseen_walk: float = parameter("of both, driving without known thrusts", unit="1/√s", gt=0.0)
    yaw_inertia_stddev: float = parameter("of I_z, relative", ge=0.0, lt=1.0)
    acceleration_stddev: float = parameter("what the model leaves out of v̇_x", unit="m/s²", gt=0.0)
    yaw_acceleration_stddev: float = parameter("the same of φ̈", unit="rad/s²", gt=0.0)
    error_time: float = parameter("for which errors of thrusts and model last", unit="s", gt=0.0)
    twist_error_time: float = parameter("for which errors of the estimated twist last", unit="s", gt=0.0)
    fading_speed: float = parameter("ground speed about which its sign is open", unit="m/s", gt=0.0)


class Dynamics:
    """Two process models, straight and turning, for one state."""

    def __init__(self, p: DynamicsParameters, vehicle: Vehicle) -> None:
        self._p, self._vehicle = p, vehicle
        self._numbers = Numbers(
            mass=vehicle.mass,
            yaw_inertia=vehicle.yaw_inertia,
            weight=vehicle.weight,
            half_tread=0.5 * vehicle.tread,
            lever=vehicle.contact_length / 3.0,
            inertia_stddev=p.yaw_inertia_stddev,
            acceleration_stddev=p.acceleration_stddev,
            yaw_acceleration_stddev=p.yaw_acceleration_stddev,
            mu_r_walk=p.mu_r_walk,
            mu_l_walk=p.mu_l_walk,
            error_time=p.error_time,
        )
        self._mean = np.array((0.0, 0.0, p.mu_r, p.mu_l))
        self._covariance = np.diag((1.0, 1.0, p.mu_r_stddev**2, p.mu_l_stddev**2))

    @property
    def mu(self) -> FloatArray:
        """(2,) μ_r, μ_l."""
        return self._mean[_MU]

    @property
    def mu_covariance(self) -> FloatArray:
        """(2, 2)."""
        return self._covariance[_MU, _MU]

    def signs(self, twist: FloatArray, covariance: FloatArray) -> FloatArray:
        """(2,) s_j for a twist (3,) and its covariance (3, 3); its variance is 1 − s_j²."""
        half = 0.5 * self._vehicle.tread
        common = float(covariance[0, 0] + half**2 * covariance[2, 2]) + self._p.fading_speed**2
        both = 2.0 * half * float(covariance[0, 2])
        left, right = frame_speeds(twist, self._vehicle)
        return np.array((_expected_sign(left, common - both), _expected_sign(right, common + both)))

    def step(
        self,
        dt: float,
        motion: Motion,
        twist: FloatArray,
        twist_covariance: FloatArray,
        turn: float,
        thrust: Thrust | None,
    ) -> None:
        """``dt`` s on, to where the slip estimator says ``twist`` (3,); ``thrust`` None: not known.

        ``turn``: speed of the right track over that of the left; only its sign matters.
        """
        measured = twist[::2].copy()  # v_x, φ̇
        noise = twist_covariance[::2, ::2] + _ROUNDING * np.eye(2)
        moves = motion in (Motion.STRAIGHT, Motion.TURNING)
        if thrust is None or not moves or not 0.0 < dt <= _LONGEST_STEP:
            walk = self._p.unseen_walk**2 * dt if moves else 0.0
            self._restart(measured, noise, walk)
            return
        sense = math.copysign(1.0, turn)
        turns = motion is Motion.TURNING and sense * measured[1] > 0.0
        self._mean, self._covariance = predict(
            self._mean,
            self._covariance,
            dt,
            float(twist[1] * twist[2]),
            self.signs(twist, twist_covariance),
            thrust.force,
            thrust.variance,
            sense if turns else 0.0,
            self._numbers,
        )
        if not turns:
            self._follow(RATE, RATE + 1, measured[1:], noise[1:, 1:])
        noise *= max(self._p.twist_error_time / dt, 1.0)
        self._mean, self._covariance = correct(self._mean, self._covariance, measured, noise)
        self._bound()

    def _restart(self, measured: FloatArray, noise: FloatArray, walk: float) -> None:
        """Speeds as measured; the coefficients held, ``walk`` more uncertain each."""
        self._follow(SPEED, RATE + 1, measured, noise)
        for k in (MU_R, MU_L):
            self._covariance[k, k] += walk
        self._bound()

    def _follow(self, first: int, end: int, measured: FloatArray, noise: FloatArray) -> None:
        """No model of these states: they are what is measured, and tell nothing else."""
        self._mean[first:end] = measured
        self._covariance[first:end, :] = self._covariance[:, first:end] = 0.0
        self._covariance[first:end, first:end] = noise

    def _bound(self) -> None:
        """Resistance never pushes, and nobody knows less than at the start."""
        for k, largest in ((MU_R, self._p.mu_r_stddev), (MU_L, self._p.mu_l_stddev)):
            self._mean[k] = max(self._mean[k], 0.0)
            if self._covariance[k, k] > largest**2:
                shrink = largest / math.sqrt(self._covariance[k, k])
                self._covariance[k, :] *= shrink
                self._covariance[:, k] *= shrink


def _expected_sign(speed: float, variance: float) -> float:
    """E[sign v] of a Gaussian v."""
    return math.erf(speed / math.sqrt(2.0 * max(variance, _ROUNDING)))
