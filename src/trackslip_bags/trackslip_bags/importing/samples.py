# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Samples of a log as arrays, and the ROS messages that are made of them.

    sprockets    velocity (n, 2), position (n, 2): left, right                      rad/s, rad
    imu, heading angular_velocity, linear_acceleration (n, 3), orientation (n, 4): x, y, z, w;
                 of each a ..._covariance (n, 3, 3)
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
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

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

    def select(self, rows: IntArray) -> "Samples":
        """The samples of some rows, (m,) indices."""
        return replace(
            self,
            frames=[self.frames[k] for k in rows.tolist()] if len(self.frames) > 1 else self.frames,
            stamps_ns=self.stamps_ns[rows],
            log_times_ns=self.log_times_ns[rows],
            values={name: array[rows] for name, array in self.values.items()},
        )

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


def _sprocket_fields(values: Mapping[str, FloatArray]) -> dict[str, Any]:
    names = [LEFT_SPROCKET, RIGHT_SPROCKET]
    is_known = np.isfinite(values["position"]).all()
    return {"name": names, "position": values["position"] if is_known else [], "velocity": values["velocity"]}


def _imu_fields(values: Mapping[str, FloatArray]) -> dict[str, Any]:
    fields: dict[str, Any] = {}
    for name in ("angular_velocity", "linear_acceleration"):
        vector = np.nan_to_num(values[name], nan=0.0).tolist()
        fields[name] = make("geometry_msgs/msg/Vector3", **dict(zip("xyz", vector, strict=True)))
        fields[f"{name}_covariance"] = _imu_covariance(values[name], values[f"{name}_covariance"])
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
