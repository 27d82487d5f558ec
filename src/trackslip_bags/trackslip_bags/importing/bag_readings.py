# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Readings of other robots' messages: values by the names of columns (``role_values``)."""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from trackslip_bags.importing.mapping_topics import JOINT, SIDES, BagTopic, Joints
from trackslip_bags.importing.role_values import yaw_of
from trackslip_bags.importing.roles import (
    ACCELERATIONS,
    FIX,
    HYDRAULICS,
    IMU,
    JOINTS,
    ODOMETRY,
    POSE,
    QUATERNION,
    RATES,
    ROLES,
    VELOCITY,
)
from trackslip_bags.importing.samples import Values
from trackslip_common.arrays import IntArray
from trackslip_common.message_fields import PLANE_IN_6
from trackslip_common.topics import LEFT_SPROCKET, RIGHT_SPROCKET, SWING_JOINT
from trackslip_common.turns import unwrap_angles

_POSE_STAMPED = "geometry_msgs/msg/PoseStamped"
_TRANSFORMS = ("geometry_msgs/msg/TransformStamped", "tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
_TWIST = "geometry_msgs/msg/Twist"
_STAMPED_TWISTS = ("geometry_msgs/msg/TwistStamped", VELOCITY)
_QUATERNION_STAMPED = "geometry_msgs/msg/QuaternionStamped"
NO_JOINTS = "has none of the joints"
NO_FIX = "receiver without a fix"
OTHER_FRAME = "of another child frame"
_ZERO_9 = (0.0,) * 9
_DEFAULT_JOINTS = {
    key: Joints((name,), 1.0)
    for key, name in zip((*SIDES, JOINT), (LEFT_SPROCKET, RIGHT_SPROCKET, SWING_JOINT), strict=True)
}


class Reading(NamedTuple):
    """One reading of a message."""

    header: Any  # None where it has none
    values: dict[str, Any]  # numbers, or arrays, by column
    defect: str = ""  # reason to leave it out; empty: none
    child: str = ""  # frame of a transform


Reader = Callable[[Any, BagTopic], Iterator[Reading]]


def columns_of(readings: Sequence[Mapping[str, Any]]) -> Values:
    """(n, …) columns of the values of readings."""
    columns = {name: np.array([one[name] for one in readings], np.float64) for name in readings[0]}
    return {
        name: array.reshape(-1, 3, 3) if name.endswith("covariance") else array
        for name, array in columns.items()
    }


def sides_of(topic: BagTopic) -> dict[str, Joints]:
    """Joints of left and right, or of a swing."""
    keys = (JOINT,) if topic.role == "swing" else SIDES
    return {key: topic.joints.get(key, _DEFAULT_JOINTS[key]) for key in keys}


def joint_names(topic: BagTopic) -> list[str]:
    """Names of the joints of ``sides_of``."""
    return [name for side in sides_of(topic).values() for name in side.names]


def _read_joints(message: Any, topic: BagTopic) -> Iterator[Reading]:
    """Velocity of each joint of ``sides_of``, and position of each; nan where it has none."""
    at = {name: k for k, name in enumerate(message.name)}
    has_joints = all(name in at for name in joint_names(topic))
    has_values = False
    values: dict[str, list[float]] = {}
    for use, numbers in (("velocities", message.velocity), ("positions", message.position)):
        is_known = has_joints and topic.uses in ("both", use) and len(numbers) == len(at)
        values[use] = []
        for side in sides_of(topic).values():
            of_side = [float(numbers[at[name]]) if is_known else math.nan for name in side.names]
            has_values |= all(map(math.isfinite, of_side))
            values[use] += of_side
    defect = "" if has_values else "has no finite values" if has_joints else NO_JOINTS
    yield Reading(message.header, values, defect)


def joint_columns(columns: Values, stamps_ns: IntArray, topic: BagTopic) -> Values:
    """Speeds and angles of the sides, each the mean of its joints times the ratio, or the angle of a swing.

    The position of a joint of sprockets may restart after each turn.
    """
    speeds, angles = columns["velocities"], columns["positions"]
    if topic.role == "sprockets":
        pairs = zip(angles.T, speeds.T, strict=True)
        angles = np.column_stack([unwrap_angles(stamps_ns, *pair) for pair in pairs])
    of_sides: Values = {}
    begin = 0
    for key, side in sides_of(topic).items():
        end = begin + len(side.names)
        for what, joints in (("velocity", speeds), ("position", angles)):
            of_sides[f"{key}_{what}"] = np.mean(joints[:, begin:end], axis=1) * side.ratio
        begin = end
    return of_sides if topic.role == "sprockets" else {"angle": of_sides[f"{JOINT}_position"]}


def heading_columns(columns: Values, topic: BagTopic) -> Values:
    """Orientations in the convention of the mapping: the yaw alone, where it is not that of ROS."""
    if topic.convention == "enu" and topic.sign == 1.0:
        return columns
    yaw = topic.sign * yaw_of(np.column_stack([columns[name] for name in QUATERNION]))
    name = "heading" if topic.convention == "compass" else "yaw"
    return {name: yaw, "orientation_covariance": columns["orientation_covariance"]}


def _non_finite(numbers: Iterable[float]) -> str:
    """The defect of numbers; empty: none."""
    return "" if all(map(math.isfinite, numbers)) else "has no finite values"


def _read_twist(message: Any, topic: BagTopic) -> Iterator[Reading]:
    twist = message
    while hasattr(twist, "twist"):
        twist = twist.twist
    values = {"speed": float(twist.linear.x), "yaw_rate": float(twist.angular.z)}
    yield Reading(getattr(message, "header", None), values, _non_finite(values.values()))


def _read_velocity(message: Any, topic: BagTopic) -> Iterator[Reading]:
    """Velocity and its variances; 0 where the message has none."""
    variances, twist = [0.0, 0.0], message.twist
    if hasattr(twist, "covariance"):
        variances, twist = [float(twist.covariance[k]) for k in (0, 7)], twist.twist
    east, north = float(twist.linear.x), float(twist.linear.y)
    defect = (
        "states that it has no velocity" if variances[0] < 0.0 else _non_finite((east, north, *variances))
    )
    yield Reading(message.header, {"east": east, "north": north, "variances": variances}, defect)


def _measured(message: Any, field: str, names: tuple[str, ...]) -> dict[str, Any]:
    """Components of a field of an Imu, nan if its covariance marks it as unmeasured, and the covariance."""
    vector, covariance = getattr(message, field), getattr(message, f"{field}_covariance")
    is_measured = not covariance[0] < 0.0
    values: dict[str, Any] = {
        name: float(getattr(vector, axis)) if is_measured else math.nan
        for name, axis in zip(names, "xyzw", strict=False)
    }
    return values | {f"{field}_covariance": covariance if is_measured else _ZERO_9}


def _read_imu(message: Any, topic: BagTopic) -> Iterator[Reading]:
    """Rate, acceleration and orientation of the message, each with its covariance."""
    values = _measured(message, "angular_velocity", RATES)
    values |= _measured(message, "linear_acceleration", ACCELERATIONS)
    values |= _measured(message, "orientation", QUATERNION)
    defect = "" if message.angular_velocity_covariance[0] >= 0.0 else "states that it has no angular velocity"
    yield Reading(message.header, values, defect)


def _read_heading(message: Any, topic: BagTopic) -> Iterator[Reading]:
    """Quaternion, and its covariance; 0 where the message has none."""
    turn = message.quaternion if hasattr(message, "quaternion") else message.orientation
    covariance = getattr(message, "orientation_covariance", _ZERO_9)
    values = {name: float(getattr(turn, axis)) for name, axis in zip(QUATERNION, "xyzw", strict=True)}
    defect = "holds no orientation" if _non_finite(values.values()) or not any(values.values()) else ""
    defect = "states that it has no orientation" if covariance[0] < 0.0 else defect
    yield Reading(message.header, {**values, "orientation_covariance": covariance}, defect)


def _read_pose(message: Any, topic: BagTopic) -> Iterator[Reading]:
    """Pose and covariance; nan where the message has none."""
    pose, covariance = message.pose, np.full((3, 3), np.nan)
    if hasattr(pose, "covariance"):
        covariance, pose = np.asarray(pose.covariance, np.float64).reshape(6, 6)[PLANE_IN_6], pose.pose
    yield _pose_reading(message.header, pose.position, pose.orientation, covariance, topic)


def _read_transform(message: Any, topic: BagTopic) -> Iterator[Reading]:
    transforms = message.transforms if hasattr(message, "transforms") else [message]
    for one in transforms:
        motion, child = one.transform, one.child_frame_id.lstrip("/")
        is_other = topic.child_frame is not None and child != topic.child_frame.lstrip("/")
        unknown = np.full((3, 3), np.nan)
        reading = _pose_reading(one.header, motion.translation, motion.rotation, unknown, topic)
        yield reading._replace(defect=OTHER_FRAME if is_other else reading.defect, child=child)


def _pose_reading(header: Any, place: Any, turn: Any, covariance: Any, topic: BagTopic) -> Reading:
    yaw = math.nan
    if not topic.position_only:
        yaw = float(yaw_of(np.array([[getattr(turn, axis) for axis in "xyzw"]], np.float64))[0])
    values = {"x": float(place.x), "y": float(place.y), "yaw": yaw, "covariance": covariance}
    return Reading(header, values, _non_finite((values["x"], values["y"])))


def _read_fix(message: Any, topic: BagTopic) -> Iterator[Reading]:
    """Place with its covariance and the kind of this, and status."""
    values = {
        "latitude": math.radians(message.latitude),
        "longitude": math.radians(message.longitude),
        "altitude": float(message.altitude),
        "covariance": message.position_covariance,
        "kind": float(message.position_covariance_type),
        "status": float(message.status.status),
    }
    is_at_origin = message.latitude == message.longitude == 0.0
    has_no_fix = topic.role == "pose" and (message.status.status < 0 or is_at_origin)
    has_place = math.isfinite(message.latitude) and math.isfinite(message.longitude)
    yield Reading(message.header, values, "" if has_place and not has_no_fix else NO_FIX)


def _read_odometry(message: Any, topic: BagTopic) -> Iterator[Reading]:
    """Pose, and the variances of pose and of twist, six each."""
    place, turn = message.pose.pose.position, message.pose.pose.orientation
    values: dict[str, Any] = {axis: float(getattr(place, axis)) for axis in "xyz"}
    values |= {name: float(getattr(turn, axis)) for name, axis in zip(QUATERNION, "xyzw", strict=True)}
    defect = _non_finite(values.values())
    variances = [part.covariance[k] for part in (message.pose, message.twist) for k in range(0, 36, 7)]
    yield Reading(message.header, {**values, "variances": variances}, defect)


def _read_hydraulics(message: Any, topic: BagTopic) -> Iterator[Reading]:
    yield Reading(message.header, {n: float(getattr(message, n)) for n in ROLES["hydraulics"].fields})


READERS: Mapping[tuple[str, str], Reader] = {
    ("sprockets", JOINTS): _read_joints,
    **{("sprockets", name): _read_twist for name in (ODOMETRY, _TWIST, *_STAMPED_TWISTS)},
    ("imu", IMU): _read_imu,
    **{("heading", name): _read_heading for name in (IMU, _QUATERNION_STAMPED)},
    ("swing", JOINTS): _read_joints,
    **{("pose", name): _read_pose for name in (POSE, _POSE_STAMPED, ODOMETRY)},
    **{("pose", name): _read_transform for name in _TRANSFORMS},
    ("pose", FIX): _read_fix,
    ("fix", FIX): _read_fix,
    **{("velocity", name): _read_velocity for name in _STAMPED_TWISTS},
    ("odometry", ODOMETRY): _read_odometry,
    ("hydraulics", HYDRAULICS): _read_hydraulics,
}
"""(role, accepted message type) → reader."""
