# SPDX-License-Identifier: Apache-2.0
"""The truth in the messages that the estimators publish: what differs from sample to sample, as columns."""

import array
import math
from typing import Any

import numpy as np

from trackslip_common.make import Make, header
from trackslip_common.soils import soil
from trackslip_common.vehicle import Vehicle
from trackslip_estimation.slip.conversions import blank_odometry, in_six
from trackslip_estimation.slip.motion import Motion
from trackslip_estimation.soil.classes import limit_of
from trackslip_sim.machine.message_columns import Columns
from trackslip_sim.truth.record import Truth

_STANDING = 1e-3  # rad/s, both sprockets
_STRAIGHT = 0.02  # of the faster sprocket


def certain_odometry(make: Make, map_frame: str, base_frame: str) -> Any:
    """nav_msgs/Odometry with no variance in the plane, for ``odometry_columns``."""
    message = blank_odometry(make, map_frame, base_frame)
    message.pose.covariance, message.twist.covariance = in_six(np.zeros((3, 3))), in_six(np.zeros((3, 3)))
    return message


def stamped(make: Make, type_name: str, frame_id: str) -> Any:
    """A message with a header and nothing else in it."""
    return make(type_name, header=header(make, 0, frame_id))


def odometry_columns(truth: Truth) -> Columns:
    """Of nav_msgs/Odometry."""
    halves = (truth.yaw / 2.0).tolist()
    return {
        "pose.pose.position.x": truth.x,
        "pose.pose.position.y": truth.y,
        "pose.pose.orientation.z": np.array([math.sin(half) for half in halves]),
        "pose.pose.orientation.w": np.array([math.cos(half) for half in halves]),
        "twist.twist.linear.x": truth.v_x,
        "twist.twist.linear.y": truth.v_y,
        "twist.twist.angular.z": truth.yaw_rate,
    }


def track_slip_columns(truth: Truth) -> Columns:
    """Of trackslip_msgs/TrackSlip."""
    fastest = np.maximum(np.abs(truth.left_speed), np.abs(truth.right_speed))
    straight = np.abs(truth.right_speed - truth.left_speed) < _STRAIGHT * fastest
    moving = np.where(straight, int(Motion.STRAIGHT), int(Motion.TURNING))
    return {
        "left_slip": truth.left_slip,
        "right_slip": truth.right_slip,
        "slip_angle": truth.slip_angle,
        "motion_state": np.where(fastest < _STANDING, int(Motion.STANDING), moving),
    }


def swing_columns(truth: Truth) -> Columns:
    """Of sensor_msgs/JointState with the one joint."""
    wrapped = np.array([[math.remainder(angle, 2.0 * math.pi)] for angle in truth.swing.tolist()])
    return {"position": wrapped, "velocity": truth.swing_rate[:, np.newaxis]}


def track_forces_columns(truth: Truth, vehicle: Vehicle) -> Columns:
    """Of trackslip_msgs/TrackForces."""
    limits = np.array([limit_of(soil(name), vehicle) for name in truth.soil_names])[truth.soil_index]
    return {
        "left_thrust": truth.left_thrust,
        "right_thrust": truth.right_thrust,
        "left_resistance": truth.left_resistance,
        "right_resistance": truth.right_resistance,
        "left_thrust_reserve": 1.0 - np.abs(truth.left_thrust) / limits,
        "right_thrust_reserve": 1.0 - np.abs(truth.right_thrust) / limits,
    }


def soil_message(make: Make, at: Truth, stamp_ns: int, vehicle: Vehicle, frame_id: str) -> Any:
    """trackslip_msgs/SoilEstimate of the ground under C: intervals of no width, one class for certain."""
    ground = soil(at.soil_name())
    limit = limit_of(ground, vehicle)
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
