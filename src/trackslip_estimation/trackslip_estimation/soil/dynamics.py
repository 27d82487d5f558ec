# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Sub-model 2: resistance coefficients from thrusts and motion, (3.14), (3.24) corrected by erratum 3.

    x        v_x, φ̇, μ_r, μ_l                                        m/s, rad/s, 1, 1
    v_y      lateral speed at C, from the slip estimator              m/s
    F_j      thrust of a track                                        N
    s_j      expected sign of a track's ground speed                  1
    s        sense of the turn: 1 left, −1 right, 0 straight          1
    m, I_z, W, B, l   of ``Vehicle``

    N_j, G   load on a track, weight along the tracks: ``ground_load``; ½ W and 0 on level ground   N

    m (v̇_x − v_y φ̇) = F_L + F_R + G − μ_r (N_L s_L + N_R s_R)
    I_z φ̈ = ½ B [F_R − F_L − μ_r (N_R s_R − N_L s_L)] − s μ_l (N_L + N_R) l/3

The second equation holds in turns. In straight motion φ̇ is set to its measurement, and the mobilised μ_l is
held. Errors of F, I_z and the signs are process noise of the accelerations. They are time-correlated: the
noise density is their variance times their correlation time. For given signs the Kalman filter is linear.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_common.compiled import compiled
from trackslip_common.parameters import Parameters, parameter
from trackslip_common.record_types import Record, Table, dtype_of, make_table
from trackslip_estimation.kalman.linear_algebra import multiply_vector, sandwich
from trackslip_estimation.slip.motion import Motion
from trackslip_estimation.soil.tracks import frame_speeds

if TYPE_CHECKING:
    from trackslip_estimation.soil.ground_load import GroundLoad
    from trackslip_estimation.soil.interpolation import Sample
    from trackslip_estimation.soil.soil_parameters import SoilConfig
    from trackslip_estimation.soil.thrust import ThrustRecord

SPEED, RATE, MU_R, MU_L = range(4)
_SIZE, _MEASURED = 4, 2
_STRAIGHT, _TURNING = int(Motion.STRAIGHT), int(Motion.TURNING)
_ROUNDING = 1e-12  # (m/s)², (rad/s)²: keeps variances positive


class Dynamics(Record):
    """State x and its covariance."""

    mean: Annotated[FloatArray, _SIZE]
    covariance: Annotated[FloatArray, (_SIZE, _SIZE)]


DYNAMICS = dtype_of(Dynamics)


@dataclass(frozen=True, kw_only=True)
class DynamicsParameters(Parameters):
    """Initial state and noise of the filter."""

    mu_r: float = parameter("initial μ_r", ge=0.0)
    mu_r_stddev: float = parameter("initial and largest standard deviation of μ_r", gt=0.0)
    mu_l: float = parameter("initial mobilised μ_l", ge=0.0)
    mu_l_stddev: float = parameter("initial and largest standard deviation of μ_l", gt=0.0)
    mu_r_walk: float = parameter("random walk of μ_r while driving", unit="1/√s", gt=0.0)
    mu_l_walk: float = parameter("random walk of μ_l in turns", unit="1/√s", gt=0.0)
    unmeasured_walk: float = parameter(
        "random walk of μ_r and μ_l, driving without known thrusts", unit="1/√s", gt=0.0
    )
    yaw_inertia_stddev: float = parameter("relative standard deviation of I_z", ge=0.0, lt=1.0)
    acceleration_stddev: float = parameter(
        "standard deviation of the model error of v̇_x", unit="m/s²", gt=0.0
    )
    yaw_acceleration_stddev: float = parameter(
        "standard deviation of the model error of φ̈", unit="rad/s²", gt=0.0
    )
    error_time: float = parameter("correlation time of the errors of thrusts and model", unit="s", gt=0.0)
    twist_error_time: float = parameter(
        "correlation time of the errors of the estimated twist", unit="s", gt=0.0
    )
    fading_speed: float = parameter("ground speed below which its sign is uncertain", unit="m/s", gt=0.0)
    certain_sign: float = parameter(
        "absolute expected sign from which the sign of a track's speed is certain", gt=0.0, lt=1.0
    )
    longest_step: float = parameter(
        "longest time between two samples over which forces are known", unit="s", gt=0.0
    )


def new_dynamics(p: DynamicsParameters) -> Table[Dynamics]:
    """Return the initial state (1,)."""
    dynamics = make_table(Dynamics, DYNAMICS, 1)
    dynamics["mean"] = (0.0, 0.0, p.mu_r, p.mu_l)
    dynamics["covariance"] = np.diag((1.0, 1.0, p.mu_r_stddev**2, p.mu_l_stddev**2))
    return dynamics


@compiled
def expected_signs(twist: FloatArray, covariance: FloatArray, p: SoilConfig) -> tuple[float, float]:
    """Return s_j, left and right, for a twist (3,) of covariance (3, 3); its variance is 1 − s_j²."""
    half = 0.5 * p.vehicle.tread
    common = covariance[0, 0] + half**2 * covariance[2, 2] + p.dynamics.fading_speed**2
    both = 2.0 * half * covariance[0, 2]
    left, right = frame_speeds(twist, p.vehicle.tread)
    return _expected_sign(left, common - both), _expected_sign(right, common + both)


@compiled
def _expected_sign(speed: float, variance: float) -> float:
    """Return E[sign v] of a Gaussian v."""
    return math.erf(speed / math.sqrt(2.0 * max(variance, _ROUNDING)))


@compiled
def step(dynamics: Dynamics, sample: Sample, thrust: ThrustRecord, load: GroundLoad, p: SoilConfig) -> None:
    """Propagate by ``sample.dt`` s, then update with ``sample.twist`` of the slip estimator."""
    dt, twist, covariance = sample.dt, sample.twist, sample.twist_covariance
    is_moving = sample.motion == _STRAIGHT or sample.motion == _TURNING
    is_held = _is_held_by_friction(sample, load, p)
    is_modelled = thrust.is_known and is_moving and 0.0 < dt <= p.dynamics.longest_step and not is_held
    measured, noise = np.empty(_MEASURED), np.empty((_MEASURED, _MEASURED))  # v_x, φ̇
    for i in range(_MEASURED):
        measured[i] = twist[2 * i]
        for j in range(_MEASURED):
            noise[i, j] = covariance[2 * i, 2 * j] + (_ROUNDING if i == j else 0.0)
    sense = math.copysign(1.0, sample.tracks[1] - sample.tracks[0])
    if sample.motion != _TURNING or not sense * measured[1] > 0.0:
        sense = 0.0
    first_followed = _MEASURED if sense != 0.0 else RATE
    if is_modelled:
        _predict(dynamics, sample, thrust, load, sense, p)
    else:
        first_followed = SPEED
        for k in range(MU_R, MU_L + 1):
            dynamics.covariance[k, k] += (
                p.dynamics.unmeasured_walk**2 * dt if is_moving and not is_held else 0.0
            )
    _set_measured_speeds(dynamics, first_followed, measured, noise)
    if is_modelled:
        inflation = max(p.dynamics.twist_error_time / dt, 1.0)
        for i in range(_MEASURED):
            for j in range(_MEASURED):
                noise[i, j] *= inflation
        _correct(dynamics, measured, noise)
    _bound_coefficients(dynamics, p.dynamics)


@compiled
def _is_held_by_friction(sample: Sample, load: GroundLoad, p: SoilConfig) -> bool:
    """Whether static friction of unknown size may hold the machine on a slope: a sign s_j is uncertain."""
    left, right = expected_signs(sample.twist, sample.twist_covariance, p)
    steep = abs(load.pull) > p.load.level_share * (load.normal[0] + load.normal[1])
    return bool(steep and min(abs(left), abs(right)) < p.dynamics.certain_sign)


@compiled
def _predict(
    dynamics: Dynamics, sample: Sample, thrust: ThrustRecord, load: GroundLoad, sense: float, p: SoilConfig
) -> None:
    """Propagate mean and covariance over dt with both equations of the model."""
    n, vehicle, dt = p.dynamics, p.vehicle, sample.dt
    half_tread, lever = 0.5 * vehicle.tread, vehicle.contact_length / 3.0
    left, right = expected_signs(sample.twist, sample.twist_covariance, p)
    N_left, N_right = load.normal[0], load.normal[1]
    F, push = np.eye(_SIZE), np.zeros(_SIZE)
    F[SPEED, MU_R] = -(N_left * left + N_right * right) / vehicle.mass * dt
    crosswise = sample.twist[1] * sample.twist[2]
    push[SPEED] = ((thrust.force[0] + thrust.force[1] + load.pull) / vehicle.mass + crosswise) * dt
    if sense != 0.0:
        F[RATE, MU_R] = -half_tread * (N_right * right - N_left * left) / vehicle.yaw_inertia * dt
        F[RATE, MU_L] = -sense * (N_left + N_right) * lever / vehicle.yaw_inertia * dt
        push[RATE] = half_tread * (thrust.force[1] - thrust.force[0]) / vehicle.yaw_inertia * dt
    mean = dynamics.mean.copy()
    predicted = multiply_vector(F, mean)
    for i in range(_SIZE):
        predicted[i] += push[i]
    # An uncertain sign adds variance to the resistance.
    sign_variance_left, sign_variance_right = 1.0 - left**2, 1.0 - right**2
    L = thrust.variance[0] + (mean[MU_R] * N_left) ** 2 * sign_variance_left
    R = thrust.variance[1] + (mean[MU_R] * N_right) ** 2 * sign_variance_right
    per_force, per_moment = 1.0 / vehicle.mass, half_tread / vehicle.yaw_inertia
    correlation = n.error_time * dt
    Q = np.zeros((_SIZE, _SIZE))
    Q[SPEED, SPEED] = (per_force**2 * (L + R) + n.acceleration_stddev**2) * correlation
    Q[MU_R, MU_R] = n.mu_r_walk**2 * dt
    if sense != 0.0:
        inertia = (n.yaw_inertia_stddev * (predicted[RATE] - mean[RATE]) / dt) ** 2
        Q[RATE, RATE] = (per_moment**2 * (L + R) + inertia + n.yaw_acceleration_stddev**2) * correlation
        Q[SPEED, RATE] = Q[RATE, SPEED] = per_force * per_moment * (R - L) * correlation
        Q[MU_L, MU_L] = n.mu_l_walk**2 * dt
    _set_state(dynamics, predicted, sandwich(F, dynamics.covariance.copy()), Q)


@compiled
def _correct(dynamics: Dynamics, measured: FloatArray, noise: FloatArray) -> None:
    """Update with measured v_x and φ̇ (2,) of covariance (2, 2)."""
    mean, covariance = dynamics.mean.copy(), dynamics.covariance.copy()
    S00, S01 = covariance[0, 0] + noise[0, 0], covariance[0, 1] + noise[0, 1]
    S10, S11 = covariance[1, 0] + noise[1, 0], covariance[1, 1] + noise[1, 1]
    determinant = S00 * S11 - S01 * S10
    gain, complement, corrected = np.empty((_SIZE, _MEASURED)), np.eye(_SIZE), np.empty(_SIZE)
    for i in range(_SIZE):
        of_speed, of_rate = covariance[i, SPEED], covariance[i, RATE]
        gain[i, 0] = (of_speed * S11 - of_rate * S10) / determinant
        gain[i, 1] = (of_rate * S00 - of_speed * S01) / determinant
        complement[i, SPEED] -= gain[i, 0]
        complement[i, RATE] -= gain[i, 1]
        corrected[i] = mean[i] + (gain[i, 0] * (measured[0] - mean[0]) + gain[i, 1] * (measured[1] - mean[1]))
    _set_state(dynamics, corrected, sandwich(complement, covariance), sandwich(gain, noise))


@compiled
def _set_state(dynamics: Dynamics, mean: FloatArray, covariance: FloatArray, noise: FloatArray) -> None:
    """Set the mean, and the covariance to ``covariance`` + ``noise``."""
    for i in range(_SIZE):
        dynamics.mean[i] = mean[i]
        for j in range(_SIZE):
            dynamics.covariance[i, j] = covariance[i, j] + noise[i, j]


@compiled
def _set_measured_speeds(dynamics: Dynamics, first: int, measured: FloatArray, noise: FloatArray) -> None:
    """Set the states from ``first`` to φ̇ to their measurements, uncorrelated with the other states."""
    for i in range(first, _MEASURED):
        dynamics.mean[i] = measured[i]
        for j in range(_SIZE):
            is_measured = first <= j < _MEASURED
            dynamics.covariance[i, j] = dynamics.covariance[j, i] = noise[i, j] if is_measured else 0.0


@compiled
def _bound_coefficients(dynamics: Dynamics, n: DynamicsParameters) -> None:
    """Bound μ_r and μ_l below by 0, and their standard deviations above by the initial ones."""
    for k, largest in ((MU_R, n.mu_r_stddev), (MU_L, n.mu_l_stddev)):
        dynamics.mean[k] = max(dynamics.mean[k], 0.0)
        if dynamics.covariance[k, k] > largest**2:
            shrink = largest / math.sqrt(dynamics.covariance[k, k])
            for i in range(_SIZE):
                dynamics.covariance[k, i] *= shrink
                dynamics.covariance[i, k] *= shrink
