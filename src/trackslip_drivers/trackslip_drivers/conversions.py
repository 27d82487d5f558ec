# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Converts the drivers' records to messages, built by ``make`` from a type name and fields.

``make`` builds rclpy messages in the nodes, and a bag's own without ROS. A driver creates each message once,
blank, and refills it for each sample: creation takes ten times as long.
"""

import array
import math
from typing import Any

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_common.make import MessageFactory, header, set_stamp
from trackslip_common.message_fields import ABSENT
from trackslip_common.topics import LEFT_SPROCKET, RIGHT_SPROCKET, SWING_JOINT
from trackslip_drivers.records import (
    FixSample,
    HeadingSample,
    HydraulicsSample,
    ImuSample,
    ScanSample,
    SprocketSample,
    SwingSample,
    Vector,
    VelocitySample,
)

_UNOBSERVED_VARIANCE = 1e6  # rad², variance of roll and pitch


def blank_joint_state(make: MessageFactory, frame_id: str) -> Any:
    """sensor_msgs/JointState of both sprockets for ``fill_joint_state``."""
    return _blank_joints(make, frame_id, LEFT_SPROCKET, RIGHT_SPROCKET)


def fill_joint_state(message: Any, sample: SprocketSample) -> Any:
    """The message filled with a sample; an unknown position is nan, as in ros2_control."""
    set_stamp(message, sample.stamp_ns)
    message.position[0], message.position[1] = sample.left_position, sample.right_position
    message.velocity[0], message.velocity[1] = sample.left_velocity, sample.right_velocity
    return message


def blank_swing(make: MessageFactory, frame_id: str) -> Any:
    """sensor_msgs/JointState for ``fill_swing``."""
    return _blank_joints(make, frame_id, SWING_JOINT)


def fill_swing(message: Any, sample: SwingSample) -> Any:
    """The message filled with a sample."""
    set_stamp(message, sample.stamp_ns)
    message.position[0], message.velocity[0] = sample.position, sample.velocity
    return message


def blank_track_hydraulics(make: MessageFactory, frame_id: str) -> Any:
    """trackslip_msgs/TrackHydraulics for ``fill_track_hydraulics``."""
    zeros = dict.fromkeys(HydraulicsSample._fields[1:], 0.0)
    return make("trackslip_msgs/msg/TrackHydraulics", header=header(make, 0, frame_id), **zeros)


def fill_track_hydraulics(message: Any, sample: HydraulicsSample) -> Any:
    """The message filled with a sample."""
    set_stamp(message, sample.stamp_ns)
    message.left_pressure, message.right_pressure = sample.left_pressure, sample.right_pressure
    message.left_spool, message.right_spool = sample.left_spool, sample.right_spool
    message.supply_pressure = sample.supply_pressure
    return message


def blank_imu(make: MessageFactory, frame_id: str, acceleration_stddev: float, rate_stddev: float) -> Any:
    """sensor_msgs/Imu for ``fill_imu``."""
    return make(
        "sensor_msgs/msg/Imu",
        header=header(make, 0, frame_id),
        orientation=make("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0, w=1.0),
        orientation_covariance=_absent_covariance(),
        angular_velocity=_zero_vector(make),
        angular_velocity_covariance=_isotropic(rate_stddev),
        linear_acceleration=_zero_vector(make),
        linear_acceleration_covariance=_isotropic(acceleration_stddev),
    )


def fill_imu(message: Any, sample: ImuSample) -> Any:
    """The message filled with a sample."""
    set_stamp(message, sample.stamp_ns)
    _fill_vector(message.angular_velocity, sample.angular_velocity)
    _fill_vector(message.linear_acceleration, sample.acceleration)
    return message


def blank_magnetic_field(make: MessageFactory, frame_id: str, stddev: float) -> Any:
    """sensor_msgs/MagneticField for ``fill_magnetic_field``."""
    return make(
        "sensor_msgs/msg/MagneticField",
        header=header(make, 0, frame_id),
        magnetic_field=_zero_vector(make),
        magnetic_field_covariance=_isotropic(stddev),
    )


def fill_magnetic_field(message: Any, sample: ImuSample) -> Any | None:
    """The message filled with a sample; None if the sample has no magnetic field."""
    if sample.magnetic_field is None:
        return None
    set_stamp(message, sample.stamp_ns)
    _fill_vector(message.magnetic_field, sample.magnetic_field)
    return message


def laser_scan(make: MessageFactory, sample: ScanSample, frame_id: str) -> Any:
    """sensor_msgs/LaserScan; ranges as in the sample (REP-117)."""
    return make(
        "sensor_msgs/msg/LaserScan",
        header=header(make, sample.stamp_ns, frame_id),
        angle_min=sample.angle_min,
        angle_max=sample.angle_min + sample.angle_increment * (len(sample.ranges) - 1),
        angle_increment=sample.angle_increment,
        time_increment=sample.time_increment,
        scan_time=sample.scan_time,
        range_min=sample.range_min,
        range_max=sample.range_max,
        ranges=array.array("f", sample.ranges.astype(np.float32).tobytes()),
    )


def nav_sat_fix(make: MessageFactory, sample: FixSample, frame_id: str) -> Any:
    """sensor_msgs/NavSatFix; its service is 0, as sentences of several systems do not state it."""
    return make(
        "sensor_msgs/msg/NavSatFix",
        header=header(make, sample.stamp_ns, frame_id),
        status=make("sensor_msgs/msg/NavSatStatus", status=int(sample.status), service=0),
        latitude=sample.latitude,
        longitude=sample.longitude,
        altitude=sample.altitude,
        position_covariance=np.diag(sample.variances).flatten(),
        position_covariance_type=int(sample.covariance_type),
    )


def heading(make: MessageFactory, sample: HeadingSample, frame_id: str) -> Any:
    """sensor_msgs/Imu with an orientation about the vertical alone: this message has a covariance for it.

    Rates and accelerations are absent (REP-145); an unknown accuracy is a covariance of zeros.
    """
    covariance = np.zeros((3, 3))
    if sample.stddev > 0.0:
        covariance[:] = np.diag((_UNOBSERVED_VARIANCE, _UNOBSERVED_VARIANCE, sample.stddev**2))
    half = sample.yaw / 2.0
    return make(
        "sensor_msgs/msg/Imu",
        header=header(make, sample.stamp_ns, frame_id),
        orientation=make("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=math.sin(half), w=math.cos(half)),
        orientation_covariance=covariance.ravel(),
        angular_velocity=_zero_vector(make),
        angular_velocity_covariance=_absent_covariance(),
        linear_acceleration=_zero_vector(make),
        linear_acceleration_covariance=_absent_covariance(),
    )


def velocity(make: MessageFactory, sample: VelocitySample, frame_id: str) -> Any:
    """geometry_msgs/TwistWithCovarianceStamped: x east, y north, as in GNSS receivers.

    An unknown accuracy is a variance of zero.
    """
    covariance = np.diag(np.full(6, _UNOBSERVED_VARIANCE))
    covariance[0, 0] = covariance[1, 1] = sample.stddev**2
    linear = make("geometry_msgs/msg/Vector3", x=sample.east, y=sample.north, z=0.0)
    twist = make("geometry_msgs/msg/Twist", linear=linear, angular=_zero_vector(make))
    return make(
        "geometry_msgs/msg/TwistWithCovarianceStamped",
        header=header(make, sample.stamp_ns, frame_id),
        twist=make("geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=covariance.ravel()),
    )


def _blank_joints(make: MessageFactory, frame_id: str, *names: str) -> Any:
    zeros = array.array("d", bytes(8 * len(names)))
    head = header(make, 0, frame_id)
    return make("sensor_msgs/msg/JointState", header=head, name=[*names], position=zeros, velocity=zeros[:])


def _zero_vector(make: MessageFactory) -> Any:
    return make("geometry_msgs/msg/Vector3", x=0.0, y=0.0, z=0.0)


def _fill_vector(vector: Any, values: Vector) -> None:
    vector.x, vector.y, vector.z = values


def _isotropic(stddev: float) -> FloatArray:
    """Covariance (9,) row-major, with equal variances."""
    return np.diag(np.full(3, stddev**2)).flatten()


def _absent_covariance() -> FloatArray:
    """Covariance (9,) of a quantity that is not measured (REP-145)."""
    return np.array((ABSENT, *[0.0] * 8))
