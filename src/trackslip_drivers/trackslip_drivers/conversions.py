# SPDX-License-Identifier: Apache-2.0
"""From the drivers' records to messages, built through ``make`` from type name and fields.

``make`` makes rclpy messages in the nodes, and a bag's own where no ROS runs.
"""

import array
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trackslip_common.make import Make, header, set_stamp
from trackslip_common.topics import LEFT_SPROCKET, RIGHT_SPROCKET
from trackslip_drivers.records import HydraulicsSample, ImuSample, ScanSample, SprocketSample, Vector

_ABSENT = -1.0  # first element of the covariance of what is not measured (REP-145)


def joint_state(make: Make, sample: SprocketSample, frame_id: str) -> Any:
    """sensor_msgs/JointState of both sprockets."""
    message = blank_joint_state(make, frame_id)
    fill_joint_state(message, sample)
    return message


def blank_joint_state(make: Make, frame_id: str) -> Any:
    """sensor_msgs/JointState for ``fill_joint_state``, which is faster than to make one."""
    return make(
        "sensor_msgs/msg/JointState",
        header=header(make, 0, frame_id),
        name=[LEFT_SPROCKET, RIGHT_SPROCKET],
        position=array.array("d", (0.0, 0.0)),
        velocity=array.array("d", (0.0, 0.0)),
    )


def fill_joint_state(message: Any, sample: SprocketSample) -> None:
    """Put another sample into the message."""
    set_stamp(message, sample.stamp_ns)
    message.position[0], message.position[1] = sample.left_position, sample.right_position
    message.velocity[0], message.velocity[1] = sample.left_velocity, sample.right_velocity


def track_hydraulics(make: Make, sample: HydraulicsSample, frame_id: str) -> Any:
    """trackslip_msgs/TrackHydraulics."""
    return make(
        "trackslip_msgs/msg/TrackHydraulics",
        header=header(make, sample.stamp_ns, frame_id),
        left_pressure=sample.left_pressure,
        right_pressure=sample.right_pressure,
        left_spool=sample.left_spool,
        right_spool=sample.right_spool,
        supply_pressure=sample.supply_pressure,
    )


def imu(make: Make, sample: ImuSample, frame_id: str, acceleration_stddev: float, rate_stddev: float) -> Any:
    """sensor_msgs/Imu without orientation; a standard deviation of 0 leaves the covariance unknown."""
    absent = np.zeros(9)
    absent[0] = _ABSENT
    return make(
        "sensor_msgs/msg/Imu",
        header=header(make, sample.stamp_ns, frame_id),
        orientation=make("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0, w=1.0),
        orientation_covariance=absent,
        angular_velocity=_vector(make, sample.angular_velocity),
        angular_velocity_covariance=_isotropic(rate_stddev),
        linear_acceleration=_vector(make, sample.acceleration),
        linear_acceleration_covariance=_isotropic(acceleration_stddev),
    )


def magnetic_field(make: Make, sample: ImuSample, frame_id: str, stddev: float) -> Any | None:
    """sensor_msgs/MagneticField; None where the unit measured none."""
    if sample.magnetic_field is None:
        return None
    return make(
        "sensor_msgs/msg/MagneticField",
        header=header(make, sample.stamp_ns, frame_id),
        magnetic_field=_vector(make, sample.magnetic_field),
        magnetic_field_covariance=_isotropic(stddev),
    )


def laser_scan(make: Make, sample: ScanSample, frame_id: str) -> Any:
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


def _vector(make: Make, values: Vector) -> Any:
    x, y, z = values
    return make("geometry_msgs/msg/Vector3", x=x, y=y, z=z)


def _isotropic(stddev: float) -> NDArray[np.float64]:
    """(9,) row-major."""
    return np.diag(np.full(3, stddev**2)).flatten()
