# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Inputs of the soil estimator from a true drive: hydraulics, and slips with time-correlated errors.

v_x, v_y, φ̇   twist: true, and estimated with time-correlated errors             m/s, rad/s
r ω_j          track speeds, without error                                        m/s
i_j            1 − v_j/(r ω_j) with the estimated v_j                             1
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_common.vehicle import Vehicle
from trackslip_estimation.slip.motion import MotionParameters, MotionState, Speeds, classify
from trackslip_estimation.soil.records import Hydraulics, MachineState, PoseWithCovariance, SoilInput
from trackslip_estimation.soil.tracks import frame_speeds
from trackslip_sim.truth.record import Truth

START_NS = 10_000_000_000
_PERIOD_NS = 10_000_000
_HYDRAULICS_DELAY_NS = 4_000_000  # after the slips, as in separate frames
_MIN_TRACK_SPEED = 0.005  # m/s, track speed below which slip is 0


@dataclass(frozen=True)
class InputErrors:
    """Errors of the inputs."""

    pressure_stddev: float = 3.0e4  # Pa
    offsets: tuple[float, float] = (0.0, 0.0)  # Pa, of the left and right transducer
    speed_stddev: float = 0.003  # m/s, of v_x and v_y
    yaw_rate_stddev: float = 0.003  # rad/s
    position_stddev: float = 0.003  # m
    error_time: float = 0.5  # s, correlation time of the errors of twist and position
    swing_stddev: float | None = None  # rad, stated with the true swing; None: swing unknown


def soil_inputs(
    truth: Truth, vehicle: Vehicle, limits: MotionParameters, errors: InputErrors
) -> Iterator[SoilInput]:
    """Machine states and hydraulics at 100 Hz each, in the order of arrival."""
    rng = np.random.default_rng(0)
    step = _PERIOD_NS * 1e-9
    at = truth.interpolate(np.arange(round(truth.duration / step)) * step)
    later = truth.interpolate(at.t + _HYDRAULICS_DELAY_NS * 1e-9)
    twists = np.stack((at.v_x, at.v_y, at.yaw_rate), axis=-1)
    tracks = np.stack((at.left_speed, at.right_speed), axis=-1) * vehicle.rolling_radius
    poses = np.stack((at.x, at.y, at.yaw), axis=-1)
    deviations = np.array((errors.speed_stddev, errors.speed_stddev, errors.yaw_rate_stddev))
    decay, state = math.exp(-step / errors.error_time), MotionState()
    renewal = math.sqrt(1.0 - decay**2)
    error = deviations * rng.standard_normal(3)
    position_error = errors.position_stddev * rng.standard_normal(2)
    covariance = np.diag((errors.position_stddev**2, errors.position_stddev**2, 0.0))
    for k in range(len(at)):
        stamp_ns = START_NS + k * _PERIOD_NS
        error = decay * error + renewal * deviations * rng.standard_normal(3)
        position_error = decay * position_error + renewal * errors.position_stddev * rng.standard_normal(2)
        speeds = Speeds(float(at.left_speed[k]), float(at.right_speed[k]))
        state = classify(state, speeds, step, limits)
        twist = twists[k] + (error if np.abs(tracks[k]).max() > _MIN_TRACK_SPEED else 0.0)
        pose = PoseWithCovariance(poses[k] + np.append(position_error, 0.0), covariance)
        yield MachineState(
            stamp_ns,
            twist,
            np.diag(np.square(deviations)),
            pose,
            np.append(_slips(twist, tracks[k], vehicle), 0.0),
            state.motion,
            swing=0.0 if errors.swing_stddev is None else float(at.swing[k]),
            swing_variance=math.inf if errors.swing_stddev is None else errors.swing_stddev**2,
        )
        left, right = errors.pressure_stddev * rng.standard_normal(2) + errors.offsets
        yield Hydraulics(
            stamp_ns + _HYDRAULICS_DELAY_NS,
            float(later.left_pressure[k] + left),
            float(later.right_pressure[k] + right),
            float(later.left_spool[k]),
            float(later.right_spool[k]),
        )


def _slips(twist: FloatArray, tracks: FloatArray, vehicle: Vehicle) -> FloatArray:
    """Slips (2,) of left and right track; 0 at standstill of a track."""
    is_moving = np.abs(tracks) > _MIN_TRACK_SPEED
    frames = np.array(frame_speeds(twist, vehicle.tread))
    share: FloatArray = np.divide(frames, tracks, out=np.ones(2), where=is_moving)
    return 1.0 - share
