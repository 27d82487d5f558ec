# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Samples of a log as arrays, and the ROS messages that are made of them.

    sprockets    velocity (n, 2), position (n, 2): left, right                      rad/s, rad
    imu, heading rate, acceleration (n, 3), orientation (n, 4), each with a covariance (n, 3, 3)
    swing        angle (n,)                                                         rad
    pose         pose (n, 3): x, y, yaw; covariance (n, 3, 3)                       m, m, rad
    fix          place (n, 3): latitude, longitude, altitude; covariance (n, 3, 3);
                 kind, status (n,)                                                  rad, rad, m
    velocity     velocity (n, 2): east, north; variances (n, 2), 0: unknown         m/s
    odometry     place (n, 3), turn (n, 4): x, y, z, w; variances (n, 12) of pose and of twist   m, 1
    hydraulics   left_pressure … supply_pressure (n,)                               Pa, 1

Unknown values are nan. The covariance of an unknown quantity of an Imu then begins with −1 (REP-145); the
variance of an unknown heading of a pose is UNOBSERVED.
"""

import math
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from trackslip_bags.importing.mapping_topics import Geometry
from trackslip_bags.importing.roles import ROLES
from trackslip_bags.messages import header, make
from trackslip_common.arrays import BoolArray, FloatArray, IntArray
from trackslip_common.topics import LEFT_SPROCKET, RIGHT_SPROCKET, SWING_JOINT
from trackslip_estimation.slip.conversions import pose_with_covariance
from trackslip_estimation.slip.measurements import UNOBSERVED, PoseFix

Values = dict[str, FloatArray]

UNKNOWN = -1.0  # first element of a covariance whose quantity was not measured


@dataclass
class Samples:
    """Samples of one topic, in the order of the log."""

    topic: str
    role: str
    frames: list[str]  # frame of each sample, or one for all
    stamps_ns: IntArray  # (n,)
    log_times_ns: IntArray  # (n,)
    values: Values
    left_out: Counter[str] = field(default_factory=Counter)  # reason → count
    source: str = ""  # topic or file of origin

    def message(self, row: int) -> Any:
        """One sample as a message."""
        frame = self.frames[row if len(self.frames) > 1 else 0]
        stamp_ns = int(self.stamps_ns[row])
        values = {name: array[row] for name, array in self.values.items()}
        if self.role == "pose":
            return pose_with_covariance(
                make, PoseFix(self.topic, stamp_ns, values["pose"], values["covariance"]), frame
            )
        return make(
            ROLES[self.role].type_name, header=header(stamp_ns, frame), **_BUILDERS[self.role](values)
        )


class SelectedRows:
    """The rows, (n,) of bool, that become messages, and the reasons why others do not."""

    def __init__(self, rows: BoolArray) -> None:
        self.rows = rows.copy()
        self.left_out: Counter[str] = Counter()

    def reject(self, bad: Any, reason: str) -> None:
        """Leave out the rows ``bad``, (n,) of bool, and count them under ``reason``."""
        count = int((self.rows & bad).sum())
        if count:
            self.left_out[reason] += count
            self.rows &= ~bad


def track_speeds(speed: FloatArray, yaw_rate: FloatArray, geometry: Geometry) -> FloatArray:
    """(n, 2) sprocket speeds, rad/s, without slip, for speeds (n,) in m/s and yaw rates (n,) in rad/s."""
    half_difference = yaw_rate * geometry.tread / 2.0
    return np.column_stack((speed - half_difference, speed + half_difference)) / geometry.rolling_radius


def rates_of_positions(positions: FloatArray, stamps_ns: IntArray) -> FloatArray:
    """(n, 2) rad/s from (n, 2) rad: change over the time since the row before; the first as the second."""
    if len(positions) < 2:
        return np.zeros_like(positions)
    steps = np.diff(stamps_ns) * 1e-9
    with np.errstate(divide="ignore", invalid="ignore"):
        speeds = np.diff(positions, axis=0) / steps[:, np.newaxis]
    speeds = np.where(steps[:, np.newaxis] > 0.0, speeds, 0.0)
    return np.concatenate((speeds[:1], speeds))


def yaw_of(qx: FloatArray, qy: FloatArray, qz: FloatArray, qw: FloatArray) -> FloatArray:
    """(n,) rotation about z, rad; nan where there is no rotation (all zero)."""
    yaw = np.arctan2(2.0 * (qw * qz + qx * qy), 1.0 - 2.0 * (qy * qy + qz * qz))
    return np.where(qx * qx + qy * qy + qz * qz + qw * qw > 0.0, yaw, np.nan)


def level_quaternions(yaw: FloatArray) -> FloatArray:
    """(n, 4) quaternions x, y, z, w of (n,) rotations about z, rad."""
    level = np.zeros(len(yaw))
    return np.column_stack((level, level, np.sin(yaw / 2.0), np.cos(yaw / 2.0)))


def without_heading(pose: FloatArray, covariance: FloatArray) -> Values:
    """Poses (n, 3) and covariances (n, 3, 3); unknown headings get the variance UNOBSERVED."""
    missing = ~(np.isfinite(pose[:, 2]) & np.isfinite(covariance[:, 2, 2]))
    pose[missing, 2] = 0.0
    covariance[missing, 2, :] = covariance[missing, :, 2] = 0.0
    covariance[missing, 2, 2] = UNOBSERVED
    return {"pose": pose, "covariance": covariance}


def heading_values(turn: FloatArray, covariance: FloatArray) -> Values:
    """Values of an Imu with orientations (n, 4) x, y, z, w only; covariances of 0: unknown."""
    nothing, unknown = np.full((len(turn), 3), np.nan), np.zeros((len(turn), 3, 3))
    return {
        "rate": nothing,
        "rate_covariance": unknown,
        "acceleration": nothing,
        "acceleration_covariance": unknown,
        "orientation": turn,
        "orientation_covariance": covariance,
    }


def _sprocket_fields(values: Mapping[str, FloatArray]) -> dict[str, Any]:
    names = [LEFT_SPROCKET, RIGHT_SPROCKET]
    is_known = np.isfinite(values["position"]).all()
    return {"name": names, "position": values["position"] if is_known else [], "velocity": values["velocity"]}


def _imu_fields(values: Mapping[str, FloatArray]) -> dict[str, Any]:
    fields: dict[str, Any] = {}
    for name, key in (("angular_velocity", "rate"), ("linear_acceleration", "acceleration")):
        vector = np.nan_to_num(values[key], nan=0.0).tolist()
        fields[name] = make("geometry_msgs/msg/Vector3", **dict(zip("xyz", vector, strict=True)))
        fields[f"{name}_covariance"] = _imu_covariance(values[key], values[f"{key}_covariance"])
    turn = values["orientation"]
    w, *rest = (turn[3], *turn[:3]) if np.isfinite(turn).all() else (1.0, 0.0, 0.0, 0.0)
    fields["orientation"] = make(
        "geometry_msgs/msg/Quaternion", w=float(w), **dict(zip("xyz", map(float, rest), strict=True))
    )
    fields["orientation_covariance"] = _imu_covariance(turn, values["orientation_covariance"])
    return fields


def _imu_covariance(vector: FloatArray, covariance: FloatArray) -> list[float]:
    """Nine numbers; unmeasured axes have the variance UNOBSERVED; if all are unmeasured, the first is −1."""
    missing = np.isnan(vector)
    if missing.all():
        return [UNKNOWN] + [0.0] * 8
    filled = np.nan_to_num(covariance, nan=0.0).copy()
    if missing.any() and len(vector) == 3:
        filled[np.ix_(missing, missing)] = 0.0
        filled[missing, missing] = UNOBSERVED
    numbers: list[float] = filled.ravel().tolist()
    return numbers


def _fix_fields(values: Mapping[str, FloatArray]) -> dict[str, Any]:
    latitude, longitude, altitude = values["place"].tolist()
    status = make("sensor_msgs/msg/NavSatStatus", status=int(values["status"]), service=1)
    return {
        "status": status,
        "latitude": math.degrees(latitude),
        "longitude": math.degrees(longitude),
        "altitude": altitude,
        "position_covariance": values["covariance"].ravel(),
        "position_covariance_type": int(values["kind"]),
    }


def _swing_fields(values: Mapping[str, FloatArray]) -> dict[str, Any]:
    return {"name": [SWING_JOINT], "position": [float(values["angle"])]}


def _hydraulics_fields(values: Mapping[str, FloatArray]) -> dict[str, Any]:
    return {name: float(value) for name, value in values.items()}


def _velocity_fields(values: Mapping[str, FloatArray]) -> dict[str, Any]:
    v_x, v_y = values["velocity"].tolist()
    variances = np.full(6, UNOBSERVED)
    variances[:2] = values["variances"]
    linear = make("geometry_msgs/msg/Vector3", x=v_x, y=v_y, z=0.0)
    twist = make("geometry_msgs/msg/Twist", linear=linear)
    covariance = np.diag(variances).ravel()
    return {"twist": make("geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=covariance)}


def _odometry_fields(values: Mapping[str, FloatArray]) -> dict[str, Any]:
    place = make("geometry_msgs/msg/Point", **dict(zip("xyz", values["place"].tolist(), strict=True)))
    turn = make("geometry_msgs/msg/Quaternion", **dict(zip("xyzw", values["turn"].tolist(), strict=True)))
    pose = make("geometry_msgs/msg/Pose", position=place, orientation=turn)
    of_pose, of_twist = (np.diag(part).ravel() for part in np.split(values["variances"], 2))
    return {
        "pose": make("geometry_msgs/msg/PoseWithCovariance", pose=pose, covariance=of_pose),
        "twist": make("geometry_msgs/msg/TwistWithCovariance", covariance=of_twist),
    }


_BUILDERS: Mapping[str, Callable[[Mapping[str, FloatArray]], dict[str, Any]]] = {
    "sprockets": _sprocket_fields,
    "imu": _imu_fields,
    "heading": _imu_fields,
    "swing": _swing_fields,
    "fix": _fix_fields,
    "velocity": _velocity_fields,
    "odometry": _odometry_fields,
    "hydraulics": _hydraulics_fields,
}
