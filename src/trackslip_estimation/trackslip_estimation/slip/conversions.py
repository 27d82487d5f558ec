# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Conversion between ROS messages and measurements or estimates; without logic.

``trackslip_common.message_fields`` declares the fields that are read, of messages of rclpy and of a bag.
``make`` builds a message from its type name and fields; live node and replay share it.
"""

import math
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_common.make import MessageFactory, header, set_stamp
from trackslip_common.message_fields import (
    ABSENT,
    PLANE_IN_6,
    FrameFields,
    ImuFields,
    OdometryPoseFields,
    OrientationFields,
    PoseFields,
    QuaternionFields,
    SlipFields,
    SprocketFields,
    SwingFields,
    VelocityFields,
)
from trackslip_common.message_reading import frame_number, read
from trackslip_common.orientations import heading_of
from trackslip_common.topics import SWING_JOINT, SWING_STDDEV_JOINT
from trackslip_estimation.slip.estimator import Estimate, Swing, Tilt
from trackslip_estimation.slip.measurements import (
    UNOBSERVED,
    HeadingFix,
    OdometryPose,
    PoseFix,
    Report,
    SlipFix,
    Sprockets,
    SwingAngle,
    VelocityFix,
    YawRate,
)
from trackslip_estimation.slip.mounting import quaternion_from_angles, rotate, rotate_variances, vertical_axis
from trackslip_estimation.slip.sources import (
    ODOMETRY_FIELDS,
    HeadingSource,
    OdometrySource,
    Rejection,
    VelocitySource,
    YawRateSource,
)


class Frames(NamedTuple):
    """Names of REP-105."""

    map: str
    odom: str
    base: str


_BLANK_36 = np.diag(np.full(6, UNOBSERVED)).ravel()
_PLANE_IN_36 = np.arange(36).reshape(6, 6)[PLANE_IN_6].ravel()
_TILT_IN_36 = np.arange(36).reshape(6, 6)[np.ix_((3, 4, 2), (3, 4, 2))].ravel()  # roll, pitch, z
_ALTITUDE_IN_36 = 14
_RATES_IN_36 = np.array((3, 4)) * 7  # variances about x and y
_ABSENT_9, _ABSENT_4 = np.full(9, ABSENT), np.full(4, ABSENT)
_FLAT, _NO_RATES = np.diag(np.full(3, UNOBSERVED)), np.full(2, UNOBSERVED)


def sprockets(message: Any, source: str) -> Sprockets:
    """From sensor_msgs/JointState. A missing joint or speed is nan, and the measurement is invalid."""
    m = read(SprocketFields, message)
    positions = (m.left_position, m.right_position) if m.has_positions else None
    return Sprockets(source, m.stamp_ns, m.left_speed, m.right_speed, positions)


def yaw_rate(message: Any, source: str, imu: YawRateSource) -> YawRate | Rejection:
    """From sensor_msgs/Imu, rotated by the mounting of ``imu``.

    A variance of zero means unknown, a first element of −1 absent (REP-145).
    """
    m = read(ImuFields, message)
    if m.variance_x == ABSENT:
        return Rejection.NO_RATE
    R, default = imu.mounting, imu.stddev**2
    stated = (m.variance_x, m.variance_y, m.variance_z)
    p, q, r = rotate(R, (m.rate_x, m.rate_y, m.rate_z))
    of_p, of_q, of_r = rotate_variances(R, [v if v != 0.0 else default for v in stated])
    a, of_a = (math.nan,) * 3, math.nan
    if m.acceleration_variance_x != ABSENT:
        x, y, z = rotate(R, (m.acceleration_x, m.acceleration_y, m.acceleration_z))
        a = (x, y, z)
        mean = (m.acceleration_variance_x + m.acceleration_variance_y + m.acceleration_variance_z) / 3.0
        of_a = mean if mean != 0.0 else imu.acceleration_stddev**2
    measurement = YawRate(source, m.stamp_ns, r, of_r, (p, q), (of_p, of_q), a, of_a)
    if not imu.use_orientation:
        return measurement
    up_x, up_y, up_z = rotate(R, vertical_axis(m.qx, m.qy, m.qz, m.qw))
    of_up = [m.orientation_variance_x, m.orientation_variance_y, m.orientation_variance_z]
    of_x, of_y, _ = rotate_variances(R, of_up) if m.orientation_variance_x != ABSENT else (ABSENT,) * 3
    return replace(measurement, up=(up_x, up_y, up_z), up_variances=(of_x, of_y))


def pose_fix(message: Any, source: str) -> PoseFix:
    """From geometry_msgs/PoseWithCovarianceStamped, the planar part and z."""
    m = read(PoseFields, message)
    pose = np.array((m.x, m.y, heading_of(m)))
    return PoseFix(source, m.stamp_ns, pose, m.covariance, m.z, m.z_variance)


def slip_fix(message: Any, source: str) -> SlipFix:
    """From trackslip_msgs/TrackSlip, except the slip angle."""
    m = read(SlipFields, message)
    return SlipFix(source, m.stamp_ns, np.array((m.left_slip, m.right_slip)), m.slips_covariance)


def heading_fix(message: Any, source: str, compass: HeadingSource) -> HeadingFix | Rejection:
    """From sensor_msgs/Imu, or geometry_msgs/QuaternionStamped, which has no variance.

    A variance of zero means unknown, a first element of −1 absent (REP-145).
    """
    if hasattr(message, "quaternion"):
        q = read(QuaternionFields, message)
        return HeadingFix(source, q.stamp_ns, compass.from_east(heading_of(q)), compass.stddev**2)
    m = read(OrientationFields, message)
    if m.absent == ABSENT:
        return Rejection.NO_ORIENTATION
    variance = m.variance_z if m.variance_z != 0.0 else compass.stddev**2
    return HeadingFix(source, m.stamp_ns, compass.from_east(heading_of(m)), variance)


def swing_angle(message: Any, source: str, variance: float) -> SwingAngle:
    """From sensor_msgs/JointState, without a variance. A missing joint is nan, and invalid."""
    m = read(SwingFields, message)
    return SwingAngle(source, m.stamp_ns, m.angle, variance)


def velocity_fix(message: Any, source: str, velocity_source: VelocitySource) -> VelocityFix | Rejection:
    """From geometry_msgs/TwistWithCovarianceStamped, at the instant of its velocity.

    A variance of zero means unknown, a first element of −1 absent.
    """
    m = read(VelocityFields, message)
    if m.absent == ABSENT:
        return Rejection.NO_VELOCITY
    covariance = m.covariance.copy()
    for i in range(2):
        if covariance[i, i] == 0.0:
            covariance[i, i] = velocity_source.stddev**2
    return VelocityFix(source, m.stamp_ns - velocity_source.latency_ns, np.array((m.v_x, m.v_y)), covariance)


def odometry_pose(message: Any, source: str, odometry_: OdometrySource) -> OdometryPose | Rejection:
    """From nav_msgs/Odometry of a laser or camera: its pose, and the variances that its parameters name.

    A variance of zero means unknown, a first element of −1 absent.
    """
    m, (name, absent, rejection) = read(OdometryPoseFields, message), ODOMETRY_FIELDS[odometry_.covariance]
    if absent and getattr(m, absent) == ABSENT:
        return rejection
    frame = frame_number(read(FrameFields, message).frame)
    variances = getattr(m, name) if name else np.zeros((2, 3))
    position, orientation = np.array((m.x, m.y, m.z)), np.array((m.qx, m.qy, m.qz, m.qw))
    return OdometryPose(source, m.stamp_ns, position, orientation, frame, variances)


def odometry(make: MessageFactory, estimate: Estimate, parent_frame: str, base_frame: str) -> Any:
    """nav_msgs/Odometry of an estimate."""
    message = blank_odometry(make, parent_frame, base_frame)
    fill_odometry(message, estimate)
    return message


def blank_odometry(make: MessageFactory, parent_frame: str, base_frame: str) -> Any:
    """nav_msgs/Odometry for ``fill_odometry``, which is several times faster than a new message."""
    message = make("nav_msgs/msg/Odometry", header=header(make, 0, parent_frame), child_frame_id=base_frame)
    message.pose.covariance, message.twist.covariance = _BLANK_36.copy(), _BLANK_36.copy()
    return message


def fill_odometry(message: Any, estimate: Estimate) -> None:
    """Fill the message with an estimate."""
    set_stamp(message, estimate.stamp_ns)
    pose, twist, tilt = message.pose.pose, message.twist.twist, estimate.outputs.tilt
    pose.position.x, pose.position.y, heading = estimate.pose.tolist()
    roll, pitch, pose.position.z = (0.0, 0.0, 0.0) if tilt is None else tilt.tilt.tolist()
    turn = pose.orientation
    turn.x, turn.y, turn.z, turn.w = quaternion_from_angles(roll, pitch, heading)
    twist.linear.x, twist.linear.y, twist.angular.z = estimate.outputs.twist.tolist()
    message.pose.covariance[_PLANE_IN_36] = estimate.pose_covariance.ravel()
    message.twist.covariance[_PLANE_IN_36] = estimate.outputs.twist_covariance.ravel()
    twist.angular.x, twist.angular.y = (0.0, 0.0) if tilt is None else tilt.rates[:2].tolist()
    of_tilt, of_rates = (_FLAT, _NO_RATES) if tilt is None else (tilt.covariance, tilt.rate_variances[:2])
    message.pose.covariance[_TILT_IN_36] = of_tilt.ravel()
    message.twist.covariance[_RATES_IN_36] = of_rates


def attitude(make: MessageFactory, estimate: Estimate, base_frame: str) -> Any:
    """sensor_msgs/Imu of an estimate that has a tilt."""
    message = blank_attitude(make, base_frame)
    if estimate.outputs.tilt is not None:
        fill_attitude(message, estimate, estimate.outputs.tilt)
    return message


def blank_attitude(make: MessageFactory, base_frame: str) -> Any:
    """sensor_msgs/Imu for ``fill_attitude``."""
    return make("sensor_msgs/msg/Imu", header=header(make, 0, base_frame))


def fill_attitude(message: Any, estimate: Estimate, tilt: Tilt) -> None:
    """Orientation of base_link in the map, rates without bias, and the IMU's forces along its axes."""
    set_stamp(message, estimate.stamp_ns)
    roll, pitch, _ = tilt.tilt.tolist()
    turn, yaw = message.orientation, float(estimate.pose[2])
    turn.x, turn.y, turn.z, turn.w = quaternion_from_angles(roll, pitch, yaw)
    covariance = np.zeros((3, 3))
    covariance[:2, :2], covariance[2, 2] = tilt.covariance[:2, :2], estimate.pose_covariance[2, 2]
    message.orientation_covariance = covariance.ravel()
    rates, force = message.angular_velocity, message.linear_acceleration
    rates.x, rates.y, rates.z = tilt.rates.tolist()
    message.angular_velocity_covariance = np.diag(tilt.rate_variances).ravel()
    force.x, force.y, force.z = tilt.force.tolist()
    message.linear_acceleration_covariance = np.diag(np.full(3, tilt.force_variance)).ravel()


def blank_swing(make: MessageFactory, base_frame: str) -> Any:
    """sensor_msgs/JointState for ``fill_swing``."""
    return make(
        "sensor_msgs/msg/JointState",
        header=header(make, 0, base_frame),
        name=[SWING_JOINT, SWING_STDDEV_JOINT],
        position=np.zeros(2),
        velocity=np.zeros(2),
    )


def fill_swing(message: Any, estimate: Estimate, swing: Swing) -> None:
    """Fill angle and rate of the upper structure, and their standard deviations as a second joint."""
    set_stamp(message, estimate.stamp_ns)
    of_angle, of_rate = np.sqrt(np.diag(swing.covariance)).tolist()
    message.position, message.velocity = np.array((swing.angle, of_angle)), np.array((swing.rate, of_rate))


def swing(make: MessageFactory, estimate: Estimate, base_frame: str) -> Any:
    """sensor_msgs/JointState of an estimate that has a swing."""
    message = blank_swing(make, base_frame)
    if estimate.outputs.swing is not None:
        fill_swing(message, estimate, estimate.outputs.swing)
    return message


def track_slip(make: MessageFactory, estimate: Estimate, base_frame: str) -> Any:
    """trackslip_msgs/TrackSlip of an estimate."""
    message = blank_track_slip(make, base_frame)
    fill_track_slip(message, estimate)
    return message


def blank_track_slip(make: MessageFactory, base_frame: str) -> Any:
    """trackslip_msgs/TrackSlip for ``fill_track_slip``."""
    return make("trackslip_msgs/msg/TrackSlip", header=header(make, 0, base_frame))


def fill_track_slip(message: Any, estimate: Estimate) -> None:
    """Fill the message with slips, slip angle and state of motion of an estimate."""
    set_stamp(message, estimate.stamp_ns)
    message.left_slip, message.right_slip, message.slip_angle = estimate.outputs.slips.tolist()
    message.covariance = estimate.outputs.slip_covariance.flatten()
    message.motion_state = int(estimate.motion)


def machine_state(make: MessageFactory, estimate: Estimate, parent_frame: str, base_frame: str) -> Any:
    """trackslip_msgs/MachineState of an estimate."""
    message = blank_machine_state(make, parent_frame, base_frame)
    fill_machine_state(message, estimate)
    return message


def blank_machine_state(make: MessageFactory, parent_frame: str, base_frame: str) -> Any:
    """trackslip_msgs/MachineState for ``fill_machine_state``."""
    return make(
        "trackslip_msgs/msg/MachineState", header=header(make, 0, parent_frame), child_frame_id=base_frame
    )


def fill_machine_state(message: Any, estimate: Estimate) -> None:
    """Fill the message with an estimate."""
    set_stamp(message, estimate.stamp_ns)
    outputs = estimate.outputs
    message.x, message.y, message.heading = estimate.pose.tolist()
    message.pose_covariance = estimate.pose_covariance.ravel()
    message.v_x, message.v_y, message.yaw_rate = outputs.twist.tolist()
    message.twist_covariance = outputs.twist_covariance.ravel()
    message.left_slip, message.right_slip, message.slip_angle = outputs.slips.tolist()
    message.slip_covariance = outputs.slip_covariance.ravel()
    message.motion_state = int(estimate.motion)
    tilt = (0.0, 0.0, 0.0) if outputs.tilt is None else outputs.tilt.tilt.tolist()
    message.roll, message.pitch, message.height = tilt
    message.attitude_covariance = _ABSENT_9 if outputs.tilt is None else outputs.tilt.covariance.ravel()
    message.swing, message.swing_rate = (
        (0.0, 0.0) if outputs.swing is None else (outputs.swing.angle, outputs.swing.rate)
    )
    message.swing_covariance = _ABSENT_4 if outputs.swing is None else outputs.swing.covariance.ravel()


def pose_with_covariance(make: MessageFactory, fix: PoseFix, frame: str) -> Any:
    """geometry_msgs/PoseWithCovarianceStamped of a fix."""
    pose, covariance = planar_pose_message(make, fix.pose), covariance_6x6(fix.covariance)
    pose.position.z, covariance[_ALTITUDE_IN_36] = fix.altitude, fix.altitude_variance
    return make(
        "geometry_msgs/msg/PoseWithCovarianceStamped",
        header=header(make, fix.stamp_ns, frame),
        pose=make("geometry_msgs/msg/PoseWithCovariance", pose=pose, covariance=covariance),
    )


def measurement_report(make: MessageFactory, report: Report, sequence: int) -> Any:
    """trackslip_msgs/MeasurementReport."""
    message = blank_measurement_report(make, report.source)
    fill_measurement_report(message, report, sequence)
    return message


def blank_measurement_report(make: MessageFactory, source: str) -> Any:
    """trackslip_msgs/MeasurementReport on a source, for ``fill_measurement_report``."""
    return make("trackslip_msgs/msg/MeasurementReport", header=header(make, 0, ""), source=source)


def fill_measurement_report(message: Any, report: Report, sequence: int) -> None:
    """Fill the message with a report on the same source."""
    set_stamp(message, report.stamp_ns)
    message.sequence, message.outcome = sequence, int(report.outcome)
    message.nis, message.gate, message.dof = report.nis, report.gate, report.dof


def planar_pose_message(make: MessageFactory, pose: FloatArray) -> Any:
    """geometry_msgs/Pose of (3,) x, y, heading."""
    x, y, heading = (float(v) for v in pose)
    orientation = make(
        "geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=math.sin(heading / 2.0), w=math.cos(heading / 2.0)
    )
    position = make("geometry_msgs/msg/Point", x=x, y=y, z=0.0)
    return make("geometry_msgs/msg/Pose", position=position, orientation=orientation)


def covariance_6x6(covariance: FloatArray) -> FloatArray:
    """(36,) row-major 6×6 covariance of a planar (3, 3); the other variances are ``UNOBSERVED``."""
    six = _BLANK_36.copy()
    six[_PLANE_IN_36] = covariance.ravel()
    return six
