# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The fields that are read of each message type; live conversions and the tables of a bag share them.

A record class lists the fields: name, type, and place in the message. ``message_reading.read`` makes a record
from a message object. ``dtype_of`` gives the numpy record of the same names, which ``trackslip_bags.tables``
fills directly from serialized messages. A new field of a message is one line here.
"""

from typing import Annotated, NamedTuple

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_common.message_reading import FieldPath, HasItems, JointItem, RecordClass, Stamp, Text
from trackslip_common.topics import LEFT_SPROCKET, RIGHT_SPROCKET, SWING_JOINT

PLANE_IN_6 = np.ix_((0, 1, 5), (0, 1, 5))  # x, y, yaw among x y z roll pitch yaw
_PLANE_IN_36 = tuple(np.arange(36).reshape(6, 6)[PLANE_IN_6].ravel().tolist())
_DIAGONAL_IN_36 = tuple(range(0, 36, 7))
_ALL_OF_9 = tuple(range(9))
_SLIPS_IN_9 = (0, 1, 3, 4)  # left and right among left, right, slip angle
ABSENT = -1.0  # first element of a covariance in Imu and MachineState: the vector is absent (REP-145)

StampNs = Annotated[int, Stamp()]
Plane = Annotated[FloatArray, FieldPath("pose.covariance", _PLANE_IN_36, (3, 3))]


class FrameFields(NamedTuple):
    """Fields of any message with a header."""

    frame: Annotated[str, Text("header.frame_id")]


class SprocketFields(NamedTuple):
    """Fields of sensor_msgs/JointState: sprockets."""

    stamp_ns: StampNs
    left_speed: Annotated[float, JointItem("velocity", LEFT_SPROCKET)]  # rad/s
    right_speed: Annotated[float, JointItem("velocity", RIGHT_SPROCKET)]
    has_positions: Annotated[bool, HasItems("position")]
    left_position: Annotated[float, JointItem("position", LEFT_SPROCKET)]  # rad, continuous
    right_position: Annotated[float, JointItem("position", RIGHT_SPROCKET)]


class SwingFields(NamedTuple):
    """Fields of sensor_msgs/JointState: angle of the upper structure."""

    stamp_ns: StampNs
    angle: Annotated[float, JointItem("position", SWING_JOINT)]  # rad


class ImuFields(NamedTuple):
    """Fields of sensor_msgs/Imu."""

    stamp_ns: StampNs
    rate_x: Annotated[float, FieldPath("angular_velocity.x")]  # rad/s
    rate_y: Annotated[float, FieldPath("angular_velocity.y")]
    rate_z: Annotated[float, FieldPath("angular_velocity.z")]
    variance_x: Annotated[
        float, FieldPath("angular_velocity_covariance", (0,))
    ]  # (rad/s)²; 0 unknown, −1 none
    variance_y: Annotated[float, FieldPath("angular_velocity_covariance", (4,))]
    variance_z: Annotated[float, FieldPath("angular_velocity_covariance", (8,))]
    acceleration_x: Annotated[float, FieldPath("linear_acceleration.x")]  # m/s², upward at rest
    acceleration_y: Annotated[float, FieldPath("linear_acceleration.y")]
    acceleration_z: Annotated[float, FieldPath("linear_acceleration.z")]
    acceleration_variance_x: Annotated[float, FieldPath("linear_acceleration_covariance", (0,))]  # −1: none
    acceleration_variance_y: Annotated[float, FieldPath("linear_acceleration_covariance", (4,))]  # (m/s²)²
    acceleration_variance_z: Annotated[float, FieldPath("linear_acceleration_covariance", (8,))]
    qx: Annotated[float, FieldPath("orientation.x")]
    qy: Annotated[float, FieldPath("orientation.y")]
    qz: Annotated[float, FieldPath("orientation.z")]
    qw: Annotated[float, FieldPath("orientation.w")]
    orientation_variance_x: Annotated[float, FieldPath("orientation_covariance", (0,))]  # −1: none
    orientation_variance_y: Annotated[float, FieldPath("orientation_covariance", (4,))]  # rad²; 0 unknown
    orientation_variance_z: Annotated[float, FieldPath("orientation_covariance", (8,))]


class OrientationFields(NamedTuple):
    """Fields of sensor_msgs/Imu: orientation."""

    stamp_ns: StampNs
    qx: Annotated[float, FieldPath("orientation.x")]
    qy: Annotated[float, FieldPath("orientation.y")]
    qz: Annotated[float, FieldPath("orientation.z")]
    qw: Annotated[float, FieldPath("orientation.w")]
    absent: Annotated[float, FieldPath("orientation_covariance", (0,))]  # −1: no orientation
    variance_z: Annotated[float, FieldPath("orientation_covariance", (8,))]  # rad², 0: unknown


class PoseFields(NamedTuple):
    """Fields of geometry_msgs/PoseWithCovarianceStamped, and of nav_msgs/Odometry: planar pose and z."""

    stamp_ns: StampNs
    x: Annotated[float, FieldPath("pose.pose.position.x")]  # m
    y: Annotated[float, FieldPath("pose.pose.position.y")]
    z: Annotated[float, FieldPath("pose.pose.position.z")]
    z_variance: Annotated[float, FieldPath("pose.covariance", (14,))]  # m²
    qx: Annotated[float, FieldPath("pose.pose.orientation.x")]
    qy: Annotated[float, FieldPath("pose.pose.orientation.y")]
    qz: Annotated[float, FieldPath("pose.pose.orientation.z")]
    qw: Annotated[float, FieldPath("pose.pose.orientation.w")]
    covariance: Plane  # of x, y, heading


class OdometryFields(NamedTuple):
    """Fields of nav_msgs/Odometry: planar part, height and orientation."""

    stamp_ns: StampNs
    x: Annotated[float, FieldPath("pose.pose.position.x")]  # m
    y: Annotated[float, FieldPath("pose.pose.position.y")]
    z: Annotated[float, FieldPath("pose.pose.position.z")]
    qx: Annotated[float, FieldPath("pose.pose.orientation.x")]
    qy: Annotated[float, FieldPath("pose.pose.orientation.y")]
    qz: Annotated[float, FieldPath("pose.pose.orientation.z")]
    qw: Annotated[float, FieldPath("pose.pose.orientation.w")]
    covariance: Plane  # of x, y, heading
    v_x: Annotated[float, FieldPath("twist.twist.linear.x")]  # m/s
    v_y: Annotated[float, FieldPath("twist.twist.linear.y")]
    yaw_rate: Annotated[float, FieldPath("twist.twist.angular.z")]  # rad/s
    twist_covariance: Annotated[FloatArray, FieldPath("twist.covariance", _PLANE_IN_36, (3, 3))]


class OdometryPoseFields(NamedTuple):
    """Fields of nav_msgs/Odometry as a source: whole pose, and variances of pose and twist."""

    stamp_ns: StampNs
    x: Annotated[float, FieldPath("pose.pose.position.x")]  # m
    y: Annotated[float, FieldPath("pose.pose.position.y")]
    z: Annotated[float, FieldPath("pose.pose.position.z")]
    qx: Annotated[float, FieldPath("pose.pose.orientation.x")]
    qy: Annotated[float, FieldPath("pose.pose.orientation.y")]
    qz: Annotated[float, FieldPath("pose.pose.orientation.z")]
    qw: Annotated[float, FieldPath("pose.pose.orientation.w")]
    pose_variances: Annotated[FloatArray, FieldPath("pose.covariance", _DIAGONAL_IN_36, (2, 3))]  # m², rad²
    twist_variances: Annotated[FloatArray, FieldPath("twist.covariance", _DIAGONAL_IN_36, (2, 3))]
    pose_absent: Annotated[float, FieldPath("pose.covariance", (0,))]  # −1: no pose
    twist_absent: Annotated[float, FieldPath("twist.covariance", (0,))]


class VelocityFields(NamedTuple):
    """Fields of geometry_msgs/TwistWithCovarianceStamped: horizontal part."""

    stamp_ns: StampNs
    v_x: Annotated[float, FieldPath("twist.twist.linear.x")]  # m/s
    v_y: Annotated[float, FieldPath("twist.twist.linear.y")]
    covariance: Annotated[
        FloatArray, FieldPath("twist.covariance", (0, 1, 6, 7), (2, 2))
    ]  # (m/s)²; 0 unknown
    absent: Annotated[float, FieldPath("twist.covariance", (0,))]  # −1: no velocity


class NavSatFields(NamedTuple):
    """Fields of sensor_msgs/NavSatFix."""

    stamp_ns: StampNs
    latitude: Annotated[float, FieldPath("latitude")]  # °
    longitude: Annotated[float, FieldPath("longitude")]
    altitude: Annotated[float, FieldPath("altitude")]  # m above the ellipsoid, nan where unknown
    status: Annotated[int, FieldPath("status.status")]  # −1: no fix
    covariance: Annotated[
        FloatArray, FieldPath("position_covariance", (0, 1, 3, 4), (2, 2))
    ]  # m², east and north
    covariance_type: Annotated[int, FieldPath("position_covariance_type")]  # 0: unknown
    altitude_variance: Annotated[float, FieldPath("position_covariance", (8,))]  # m²


class QuaternionFields(NamedTuple):
    """Fields of geometry_msgs/QuaternionStamped."""

    stamp_ns: StampNs
    qx: Annotated[float, FieldPath("quaternion.x")]
    qy: Annotated[float, FieldPath("quaternion.y")]
    qz: Annotated[float, FieldPath("quaternion.z")]
    qw: Annotated[float, FieldPath("quaternion.w")]


class MachineStateFields(NamedTuple):
    """Fields of trackslip_msgs/MachineState; the first element of a covariance is −1 for unknown values."""

    stamp_ns: StampNs
    x: Annotated[float, FieldPath("x")]  # m
    y: Annotated[float, FieldPath("y")]
    heading: Annotated[float, FieldPath("heading")]  # rad
    pose_covariance: Annotated[FloatArray, FieldPath("pose_covariance", _ALL_OF_9, (3, 3))]
    v_x: Annotated[float, FieldPath("v_x")]  # m/s
    v_y: Annotated[float, FieldPath("v_y")]
    yaw_rate: Annotated[float, FieldPath("yaw_rate")]  # rad/s
    twist_covariance: Annotated[FloatArray, FieldPath("twist_covariance", _ALL_OF_9, (3, 3))]
    left_slip: Annotated[float, FieldPath("left_slip")]  # 1
    right_slip: Annotated[float, FieldPath("right_slip")]
    slip_angle: Annotated[float, FieldPath("slip_angle")]  # rad
    slip_covariance: Annotated[FloatArray, FieldPath("slip_covariance", _ALL_OF_9, (3, 3))]
    motion_state: Annotated[int, FieldPath("motion_state")]
    roll: Annotated[float, FieldPath("roll")]  # rad
    pitch: Annotated[float, FieldPath("pitch")]  # nose down > 0
    height: Annotated[float, FieldPath("height")]  # m
    attitude_covariance: Annotated[FloatArray, FieldPath("attitude_covariance", _ALL_OF_9, (3, 3))]
    swing: Annotated[float, FieldPath("swing")]  # rad
    swing_rate: Annotated[float, FieldPath("swing_rate")]  # rad/s
    swing_covariance: Annotated[FloatArray, FieldPath("swing_covariance", (0, 1, 2, 3), (2, 2))]


class SlipFields(NamedTuple):
    """Fields of trackslip_msgs/TrackSlip."""

    stamp_ns: StampNs
    left_slip: Annotated[float, FieldPath("left_slip")]  # 1
    right_slip: Annotated[float, FieldPath("right_slip")]
    slip_angle: Annotated[float, FieldPath("slip_angle")]  # rad
    covariance: Annotated[FloatArray, FieldPath("covariance", _ALL_OF_9, (3, 3))]
    slips_covariance: Annotated[
        FloatArray, FieldPath("covariance", _SLIPS_IN_9, (2, 2))
    ]  # of the slips alone
    motion_state: Annotated[int, FieldPath("motion_state")]


class HydraulicsFields(NamedTuple):
    """Fields of trackslip_msgs/TrackHydraulics."""

    stamp_ns: StampNs
    left_pressure: Annotated[float, FieldPath("left_pressure")]  # Pa
    right_pressure: Annotated[float, FieldPath("right_pressure")]
    left_spool: Annotated[float, FieldPath("left_spool")]  # −1…1
    right_spool: Annotated[float, FieldPath("right_spool")]


class ForceFields(NamedTuple):
    """Fields of trackslip_msgs/TrackForces."""

    stamp_ns: StampNs
    left_thrust: Annotated[float, FieldPath("left_thrust")]  # N
    right_thrust: Annotated[float, FieldPath("right_thrust")]
    left_resistance: Annotated[float, FieldPath("left_resistance")]
    right_resistance: Annotated[float, FieldPath("right_resistance")]
    left_thrust_variance: Annotated[float, FieldPath("left_thrust_variance")]  # N²
    right_thrust_variance: Annotated[float, FieldPath("right_thrust_variance")]
    left_resistance_variance: Annotated[float, FieldPath("left_resistance_variance")]
    right_resistance_variance: Annotated[float, FieldPath("right_resistance_variance")]
    left_thrust_reserve: Annotated[float, FieldPath("left_thrust_reserve")]  # 1
    right_thrust_reserve: Annotated[float, FieldPath("right_thrust_reserve")]


class SoilFields(NamedTuple):
    """Fields of trackslip_msgs/SoilEstimate, without the classes, whose number differs between bags."""

    stamp_ns: StampNs
    mu_r: Annotated[float, FieldPath("mu_r")]  # 1
    mu_r_variance: Annotated[float, FieldPath("mu_r_variance")]
    mu_l: Annotated[float, FieldPath("mu_l")]
    mu_l_variance: Annotated[float, FieldPath("mu_l_variance")]
    shear_modulus: Annotated[float, FieldPath("shear_modulus")]  # m
    shear_modulus_lower: Annotated[float, FieldPath("shear_modulus_lower")]
    shear_modulus_upper: Annotated[float, FieldPath("shear_modulus_upper")]
    max_tractive_effort: Annotated[float, FieldPath("max_tractive_effort")]  # N
    max_tractive_effort_lower: Annotated[float, FieldPath("max_tractive_effort_lower")]
    max_tractive_effort_upper: Annotated[float, FieldPath("max_tractive_effort_upper")]
    identifiable: Annotated[bool, FieldPath("identifiable")]


class ReportFields(NamedTuple):
    """Fields of trackslip_msgs/MeasurementReport, from which the live estimator's journal is made."""

    stamp_ns: StampNs
    source: Annotated[str, Text("source")]
    sequence: Annotated[int, FieldPath("sequence")]
    outcome: Annotated[int, FieldPath("outcome")]


RECORDS: dict[str, RecordClass] = {
    "sensor_msgs/msg/JointState": SprocketFields,
    "sensor_msgs/msg/Imu": ImuFields,
    "geometry_msgs/msg/PoseWithCovarianceStamped": PoseFields,
    "geometry_msgs/msg/TwistWithCovarianceStamped": VelocityFields,
    "nav_msgs/msg/Odometry": OdometryFields,
    "sensor_msgs/msg/NavSatFix": NavSatFields,
    "geometry_msgs/msg/QuaternionStamped": QuaternionFields,
    "trackslip_msgs/msg/MachineState": MachineStateFields,
    "trackslip_msgs/msg/TrackSlip": SlipFields,
    "trackslip_msgs/msg/TrackHydraulics": HydraulicsFields,
    "trackslip_msgs/msg/TrackForces": ForceFields,
    "trackslip_msgs/msg/SoilEstimate": SoilFields,
    "trackslip_msgs/msg/MeasurementReport": ReportFields,
}
"""Message type → what is read of it."""
