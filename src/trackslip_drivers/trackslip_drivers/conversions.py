# SPDX-License-Identifier: Apache-2.0
"""From the drivers' records to messages."""

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Vector3
from numpy.typing import NDArray
from sensor_msgs.msg import Imu, JointState, LaserScan, MagneticField
from std_msgs.msg import Header
from trackslip_msgs.msg import TrackHydraulics

from trackslip_common.topics import LEFT_SPROCKET, RIGHT_SPROCKET
from trackslip_drivers.records import HydraulicsSample, ImuSample, ScanSample, SprocketSample, Vector

_NS_PER_S = 1_000_000_000
_ABSENT = -1.0  # first element of the covariance of what is not measured (REP-145)


def joint_state(sample: SprocketSample, frame_id: str) -> JointState:
    """sensor_msgs/JointState of both sprockets."""
    return JointState(
        header=_header(sample.stamp_ns, frame_id),
        name=[LEFT_SPROCKET, RIGHT_SPROCKET],
        position=[sample.left_position, sample.right_position],
        velocity=[sample.left_velocity, sample.right_velocity],
    )


def track_hydraulics(sample: HydraulicsSample, frame_id: str) -> TrackHydraulics:
    """trackslip_msgs/TrackHydraulics."""
    return TrackHydraulics(
        header=_header(sample.stamp_ns, frame_id),
        left_pressure=sample.left_pressure,
        right_pressure=sample.right_pressure,
        left_spool=sample.left_spool,
        right_spool=sample.right_spool,
        supply_pressure=sample.supply_pressure,
    )


def imu(sample: ImuSample, frame_id: str, acceleration_stddev: float, rate_stddev: float) -> Imu:
    """sensor_msgs/Imu without orientation; a standard deviation of 0 leaves the covariance unknown."""
    absent = np.zeros(9)
    absent[0] = _ABSENT
    return Imu(
        header=_header(sample.stamp_ns, frame_id),
        orientation_covariance=absent,
        angular_velocity=_vector(sample.angular_velocity),
        angular_velocity_covariance=_isotropic(rate_stddev),
        linear_acceleration=_vector(sample.acceleration),
        linear_acceleration_covariance=_isotropic(acceleration_stddev),
    )


def magnetic_field(sample: ImuSample, frame_id: str, stddev: float) -> MagneticField | None:
    """sensor_msgs/MagneticField; None where the unit measured none."""
    if sample.magnetic_field is None:
        return None
    return MagneticField(
        header=_header(sample.stamp_ns, frame_id),
        magnetic_field=_vector(sample.magnetic_field),
        magnetic_field_covariance=_isotropic(stddev),
    )


def laser_scan(sample: ScanSample, frame_id: str) -> LaserScan:
    """sensor_msgs/LaserScan; ranges as in the sample (REP-117)."""
    return LaserScan(
        header=_header(sample.stamp_ns, frame_id),
        angle_min=sample.angle_min,
        angle_max=sample.angle_min + sample.angle_increment * (len(sample.ranges) - 1),
        angle_increment=sample.angle_increment,
        time_increment=sample.time_increment,
        scan_time=sample.scan_time,
        range_min=sample.range_min,
        range_max=sample.range_max,
        ranges=sample.ranges.astype(np.float32).tolist(),
    )


def _header(stamp_ns: int, frame_id: str) -> Header:
    sec, nanosec = divmod(stamp_ns, _NS_PER_S)
    return Header(stamp=Time(sec=sec, nanosec=nanosec), frame_id=frame_id)


def _vector(values: Vector) -> Vector3:
    x, y, z = values
    return Vector3(x=x, y=y, z=z)


def _isotropic(stddev: float) -> NDArray[np.float64]:
    """(9,) row-major."""
    return np.diag(np.full(3, stddev**2)).flatten()
