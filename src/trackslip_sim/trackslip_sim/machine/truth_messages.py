# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The truth as messages of the estimators' types: columns of the fields that vary."""

import array
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_common.make import MessageFactory, header
from trackslip_common.soils import soil
from trackslip_common.vehicle import Vehicle
from trackslip_drivers.conversions import blank_imu
from trackslip_estimation.slip.conversions import blank_odometry
from trackslip_estimation.slip.motion import Motion
from trackslip_estimation.slip.mounting import quaternion_from_half_angles
from trackslip_estimation.soil.classes import soil_thrust_limit
from trackslip_sim.machine.emulation import FORCES_NS, SITE_FRAME, TRUTH_NS
from trackslip_sim.machine.message_columns import Columns
from trackslip_sim.truth.record import Truth

_MIN_SPEED = 1e-3  # rad/s, limit of both sprockets at standstill
_MIN_TURN_SHARE = 0.02  # of the faster sprocket: largest difference in straight motion


class TruthTopic(NamedTuple):
    """A topic of the truth; its messages differ only in numbers."""

    period_ns: int
    blank: Any  # message
    columns: Callable[[Truth], Columns]


def truth_topics(make: MessageFactory, vehicle: Vehicle, body_frame: str) -> dict[str, TruthTopic]:
    """Topics of the truth of every machine, live and offline; without swing and soil."""
    slip, forces = (
        make(f"trackslip_msgs/msg/{name}", header=header(make, 0, body_frame))
        for name in ("TrackSlip", "TrackForces")
    )
    return {
        "truth/odometry": TruthTopic(TRUTH_NS, _odometry(make, body_frame), _odometry_columns),
        "truth/track_slip": TruthTopic(TRUTH_NS, slip, _slip_columns),
        "truth/track_forces": TruthTopic(FORCES_NS, forces, lambda truth: _forces_columns(truth, vehicle)),
        "truth/attitude": TruthTopic(FORCES_NS, _attitude(make, body_frame), _attitude_columns),
    }


def _odometry(make: MessageFactory, base_frame: str) -> Any:
    """A blank nav_msgs/Odometry with zero covariances."""
    message = blank_odometry(make, SITE_FRAME, base_frame)
    message.pose.covariance, message.twist.covariance = np.zeros(36), np.zeros(36)
    return message


def _attitude(make: MessageFactory, base_frame: str) -> Any:
    """A blank sensor_msgs/Imu with zero variances and without acceleration."""
    message = blank_imu(make, base_frame, acceleration_stddev=0.0, rate_stddev=0.0)
    message.orientation_covariance[0], message.linear_acceleration_covariance[0] = 0.0, -1.0
    return message


def _odometry_columns(truth: Truth) -> Columns:
    """Columns of nav_msgs/Odometry; twists in base_link."""
    return {
        "pose.pose.position.x": truth.x,
        "pose.pose.position.y": truth.y,
        "pose.pose.position.z": truth.z,
        **_orientation(truth, "pose.pose.orientation"),
        "twist.twist.linear.x": truth.v_x,
        "twist.twist.linear.y": truth.v_y,
        **_rates(truth, "twist.twist.angular"),
    }


def _attitude_columns(truth: Truth) -> Columns:
    """Columns of sensor_msgs/Imu: orientation and rates of base_link."""
    return {**_orientation(truth, "orientation"), **_rates(truth, "angular_velocity")}


def _rates(truth: Truth, field: str) -> Columns:
    return {f"{field}.x": truth.roll_rate, f"{field}.y": truth.pitch_rate, f"{field}.z": truth.yaw_rate}


def _orientation(truth: Truth, field: str) -> Columns:
    """The quaternion of Rz(yaw) Ry(pitch) Rx(roll)."""
    quaternion = quaternion_from_half_angles(
        [
            (_of_half_angles(math.sin, angles), _of_half_angles(math.cos, angles))
            for angles in (truth.roll, truth.pitch, truth.yaw)
        ]
    )
    return {f"{field}.{axis}": column for axis, column in zip("xyzw", quaternion, strict=True)}


def _of_half_angles(function: Callable[[float], float], angles: FloatArray) -> FloatArray:
    """``function`` of half of each angle as in live messages; numpy's functions differ in the last bit."""
    return np.array([function(half) for half in (angles / 2.0).tolist()])


def _slip_columns(truth: Truth) -> Columns:
    """Columns of trackslip_msgs/TrackSlip."""
    fastest = np.maximum(np.abs(truth.left_speed), np.abs(truth.right_speed))
    straight = np.abs(truth.right_speed - truth.left_speed) < _MIN_TURN_SHARE * fastest
    moving = np.where(straight, int(Motion.STRAIGHT), int(Motion.TURNING))
    return {
        "left_slip": truth.left_slip,
        "right_slip": truth.right_slip,
        "slip_angle": truth.slip_angle,
        "motion_state": np.where(fastest < _MIN_SPEED, int(Motion.STANDING), moving),
    }


def swing_columns(truth: Truth) -> Columns:
    """Columns of sensor_msgs/JointState with one joint."""
    wrapped = np.array([[math.remainder(angle, 2.0 * math.pi)] for angle in truth.swing.tolist()])
    return {"position": wrapped, "velocity": truth.swing_rate[:, np.newaxis]}


def _forces_columns(truth: Truth, vehicle: Vehicle) -> Columns:
    """Columns of trackslip_msgs/TrackForces; the load of a track sets its thrust limit."""
    grounds = [soil(name) for name in truth.soil_names]
    adhesion, friction = (
        np.array(values)[truth.soil_index]
        for values in (
            [ground.cohesion * vehicle.track_width * vehicle.contact_length for ground in grounds],
            [math.tan(ground.friction_angle) for ground in grounds],
        )
    )
    left_limit, right_limit = adhesion + friction * truth.left_load, adhesion + friction * truth.right_load
    return {
        "left_thrust": truth.left_thrust,
        "right_thrust": truth.right_thrust,
        "left_resistance": truth.left_resistance,
        "right_resistance": truth.right_resistance,
        "left_thrust_reserve": 1.0 - np.abs(truth.left_thrust) / left_limit,
        "right_thrust_reserve": 1.0 - np.abs(truth.right_thrust) / right_limit,
    }


def soil_message(make: MessageFactory, at: Truth, stamp_ns: int, vehicle: Vehicle, frame_id: str) -> Any:
    """trackslip_msgs/SoilEstimate of the ground under C: zero-width intervals, one class of probability 1."""
    ground = soil(at.soil_name())
    limit = soil_thrust_limit(ground, vehicle)
    mobilised = float(at.turning_moment[0]) * 3.0 / (vehicle.weight * vehicle.contact_length)  # (3.8)
    modulus = ground.value("shear_modulus")
    return make(
        "trackslip_msgs/msg/SoilEstimate",
        header=header(make, stamp_ns, frame_id),
        mu_r=ground.value("mu_r"),
        mu_r_variance=0.0,
        mu_l=mobilised,
        mu_l_variance=0.0,
        shear_modulus=modulus,
        shear_modulus_lower=modulus,
        shear_modulus_upper=modulus,
        max_tractive_effort=limit,
        max_tractive_effort_lower=limit,
        max_tractive_effort_upper=limit,
        identifiable=True,
        reason="",
        class_names=[ground.name],
        class_probabilities=array.array("d", (1.0,)),
    )
