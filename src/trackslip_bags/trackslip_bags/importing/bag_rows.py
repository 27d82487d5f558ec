# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Conversion of messages of other robots to rows of numbers, one per reading, and of rows to values.

``READERS`` yield rows; ``values_of`` converts (n, k) rows to the values of the role's messages (``samples``).
"""

import math
from collections.abc import Callable, Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np

from trackslip_bags.importing.local import LocalFrame
from trackslip_bags.importing.mapping_topics import JOINT, NEEDS_GEOMETRY, SIDES, BagTopic, Joints
from trackslip_bags.importing.roles import FIX, HYDRAULICS, IMU, JOINTS, ODOMETRY, POSE, ROLES, VELOCITY
from trackslip_bags.importing.samples import (
    Values,
    heading_values,
    level_quaternions,
    rates_of_positions,
    track_speeds,
    without_heading,
    yaw_of,
)
from trackslip_common.arrays import BoolArray, FloatArray, IntArray
from trackslip_common.errors import InputError
from trackslip_common.message_fields import PLANE_IN_6
from trackslip_common.topics import LEFT_SPROCKET, RIGHT_SPROCKET, SWING_JOINT
from trackslip_common.turns import unwrap_angles

Row = tuple[float, ...]

_POSE_STAMPED = "geometry_msgs/msg/PoseStamped"
_TRANSFORMS = ("geometry_msgs/msg/TransformStamped", "tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
_TWIST = "geometry_msgs/msg/Twist"
_STAMPED_TWISTS = ("geometry_msgs/msg/TwistStamped", VELOCITY)
_QUATERNION_STAMPED = "geometry_msgs/msg/QuaternionStamped"
NO_JOINTS = "has none of the joints"
NO_FIX = "receiver without a fix"
OTHER_FRAME = "of another child frame"
_NAN_4, _ZERO_9 = (math.nan,) * 4, (0.0,) * 9
_DEFAULT_JOINTS = {
    key: Joints((name,), 1.0)
    for key, name in zip((*SIDES, JOINT), (LEFT_SPROCKET, RIGHT_SPROCKET, SWING_JOINT), strict=True)
}


class Reading(NamedTuple):
    """One reading of a message."""

    header: Any  # None where it has none
    row: Row
    defect: str = ""  # reason to leave it out; empty: none
    child: str = ""  # frame of a transform


Reader = Callable[[Any, BagTopic], Iterator[Reading]]


def sides_of(topic: BagTopic) -> list[Joints]:
    """Joints of left and right, or of a swing."""
    keys = (JOINT,) if topic.role == "swing" else SIDES
    return [topic.joints.get(key, _DEFAULT_JOINTS[key]) for key in keys]


def _read_joints(message: Any, topic: BagTopic) -> Iterator[Reading]:
    """Velocity of each joint of ``sides_of``, then position of each; nan where it has none."""
    sides = sides_of(topic)
    at = {name: k for k, name in enumerate(message.name)}
    row: list[float] = []
    has_values = False
    has_joints = all(name in at for side in sides for name in side.names)
    for values, use in ((message.velocity, "velocities"), (message.position, "positions")):
        is_known = has_joints and topic.uses in ("both", use) and len(values) == len(at)
        for side in sides:
            numbers = [float(values[at[name]]) if is_known else math.nan for name in side.names]
            has_values |= all(map(math.isfinite, numbers))
            row += numbers
    defect = "" if has_values else "has no finite values" if has_joints else NO_JOINTS
    yield Reading(message.header, tuple(row), defect)


def _read_twist(message: Any, topic: BagTopic) -> Iterator[Reading]:
    """Speed and yaw rate."""
    twist = message
    while hasattr(twist, "twist"):
        twist = twist.twist
    row = (float(twist.linear.x), float(twist.angular.z))
    finite = all(map(math.isfinite, row))
    yield Reading(getattr(message, "header", None), row, "" if finite else "has no finite values")


def _read_velocity(message: Any, topic: BagTopic) -> Iterator[Reading]:
    """x, y and their variances; 0 where the message has none."""
    covariance = np.zeros(36)
    twist = message.twist
    if hasattr(twist, "covariance"):
        covariance, twist = np.asarray(twist.covariance, np.float64), twist.twist
    row = (float(twist.linear.x), float(twist.linear.y), float(covariance[0]), float(covariance[7]))
    defect = "" if all(map(math.isfinite, row)) else "has no finite values"
    yield Reading(message.header, row, "states that it has no velocity" if row[2] < 0.0 else defect)


def _read_imu(message: Any, topic: BagTopic) -> Iterator[Reading]:
    """Rate, acceleration and orientation of the message, each with its covariance."""
    turn = message.orientation
    row = (
        *_vector_row(message.angular_velocity, message.angular_velocity_covariance),
        *_vector_row(message.linear_acceleration, message.linear_acceleration_covariance),
        *(_NAN_4 if message.orientation_covariance[0] < 0.0 else (turn.x, turn.y, turn.z, turn.w)),
        *(_ZERO_9 if message.orientation_covariance[0] < 0.0 else message.orientation_covariance),
    )
    defect = "" if message.angular_velocity_covariance[0] >= 0.0 else "states that it has no angular velocity"
    yield Reading(message.header, tuple(map(float, row)), defect)


def _read_heading(message: Any, topic: BagTopic) -> Iterator[Reading]:
    """Quaternion, and nine numbers of its covariance; 0 where the message has none."""
    turn = message.quaternion if hasattr(message, "quaternion") else message.orientation
    covariance = getattr(message, "orientation_covariance", _ZERO_9)
    row = tuple(map(float, (turn.x, turn.y, turn.z, turn.w, *covariance)))
    defect = "" if any(row[:4]) and all(map(math.isfinite, row[:4])) else "holds no orientation"
    yield Reading(message.header, row, "states that it has no orientation" if covariance[0] < 0.0 else defect)


def _vector_row(vector: Any, covariance: Any) -> Row:
    """Three components, nan where the covariance marks them as unmeasured, and nine numbers of it."""
    if covariance[0] < 0.0:
        return (math.nan,) * 3 + _ZERO_9
    return (vector.x, vector.y, vector.z, *covariance)


def _read_pose(message: Any, topic: BagTopic) -> Iterator[Reading]:
    """x, y, yaw and nine numbers of their covariance (nan where the message has none)."""
    pose, covariance = message.pose, np.full((3, 3), np.nan)
    if hasattr(pose, "covariance"):
        covariance, pose = np.asarray(pose.covariance, np.float64).reshape(6, 6)[PLANE_IN_6], pose.pose
    yield _pose_reading(message.header, pose.position, pose.orientation, covariance)


def _read_transform(message: Any, topic: BagTopic) -> Iterator[Reading]:
    transforms = message.transforms if hasattr(message, "transforms") else [message]
    for one in transforms:
        motion, child = one.transform, one.child_frame_id.lstrip("/")
        is_other = topic.child_frame is not None and child != topic.child_frame.lstrip("/")
        reading = _pose_reading(one.header, motion.translation, motion.rotation, np.full((3, 3), np.nan))
        yield reading._replace(defect=OTHER_FRAME if is_other else reading.defect, child=child)


def _pose_reading(header: Any, place: Any, turn: Any, covariance: FloatArray) -> Reading:
    yaw = yaw_of(*(np.array([float(getattr(turn, axis))]) for axis in "xyzw"))[0]
    position = (float(place.x), float(place.y))
    defect = "" if all(map(math.isfinite, position)) else "has no finite values"
    return Reading(header, (*position, float(yaw), *covariance.ravel().tolist()), defect)


def _read_fix(message: Any, topic: BagTopic) -> Iterator[Reading]:
    """Latitude, longitude (rad), altitude, nine numbers of covariance, its kind, status."""
    kind = int(message.position_covariance_type)
    row = (
        math.radians(message.latitude),
        math.radians(message.longitude),
        float(message.altitude),
        *map(float, message.position_covariance),
        float(kind),
        float(message.status.status),
    )
    is_at_origin = message.latitude == message.longitude == 0.0
    has_no_fix = topic.role == "pose" and (message.status.status < 0 or is_at_origin)
    finite = math.isfinite(row[0]) and math.isfinite(row[1])
    yield Reading(message.header, row, NO_FIX if has_no_fix or not finite else "")


def _read_odometry(message: Any, topic: BagTopic) -> Iterator[Reading]:
    """Place, quaternion, and the variances of pose and of twist, six each."""
    place, turn = message.pose.pose.position, message.pose.pose.orientation
    variances = [
        np.asarray(part.covariance, np.float64)[::7].tolist() for part in (message.pose, message.twist)
    ]
    row = (place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w, *variances[0], *variances[1])
    finite = all(map(math.isfinite, row[:7]))
    yield Reading(message.header, tuple(map(float, row)), "" if finite else "has no finite values")


def _read_hydraulics(message: Any, topic: BagTopic) -> Iterator[Reading]:
    yield Reading(message.header, tuple(float(getattr(message, n)) for n in ROLES["hydraulics"].fields))


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


def rejections(
    rows: FloatArray, topic: BagTopic, type_name: str, local: LocalFrame
) -> Iterator[tuple[str, BoolArray]]:
    """Reasons to leave out some of (n, k) complete rows; (n,) which.

    Raises:
        InputError: all of them are to be left out.
    """
    if topic.role != "pose":
        return
    covariance, remaining = _pose_covariance(rows, topic, type_name), np.ones(len(rows), np.bool_)
    for k, axis in enumerate(("x", "y")):
        missing = remaining & ~_is_variance(covariance[:, k, k])
        remaining &= ~missing
        if not remaining.any():
            raise InputError(_no_variance_text(topic, axis))
        yield f"no variance of {axis} above 0", missing
    if type_name == FIX:
        yield from local.rejections(rows[:, :3], remaining, f"{topic.where}: {topic.source}")


def values_of(
    rows: FloatArray, stamps_ns: IntArray, topic: BagTopic, type_name: str, local: LocalFrame
) -> Values:
    """Values of the role's messages, from (n, k) numbers.

    Raises:
        InputError: the variance of a pose, or the geometry of the vehicle, is stated nowhere.
    """
    match topic.role:
        case "sprockets" if type_name == JOINTS:
            return _joint_values(rows, stamps_ns, topic)
        case "sprockets":
            return _twist_values(rows, topic)
        case "swing":
            return {"angle": _side_means(rows[:, rows.shape[1] // 2 :], topic)[:, 0]}
        case "heading":
            return _heading_values(rows, topic)
        case "imu":
            return _imu_values(rows, topic)
        case "pose":
            return _pose_values(rows, topic, type_name, local)
        case "velocity":
            return _velocity_values(rows, topic)
        case "odometry":
            return {"place": rows[:, :3], "turn": rows[:, 3:7], "variances": rows[:, 7:]}
        case "fix":
            covariance = rows[:, 3:12].reshape(-1, 3, 3)
            return {
                "place": rows[:, :3],
                "covariance": covariance,
                "kind": rows[:, 12],
                "status": rows[:, 13],
            }
        case _:
            return dict(zip(ROLES["hydraulics"].fields, rows.T, strict=True))


def _twist_values(rows: FloatArray, topic: BagTopic) -> Values:
    """Sprocket speeds by speed and yaw rate."""
    if topic.geometry is None:
        raise InputError(f"{topic.where}: {NEEDS_GEOMETRY}")
    nothing = np.full((len(rows), 2), np.nan)
    return {"velocity": track_speeds(rows[:, 0], rows[:, 1], topic.geometry), "position": nothing}


def _joint_values(rows: FloatArray, stamps_ns: IntArray, topic: BagTopic) -> Values:
    """Sprocket speeds and angles by the joints; a joint's position may restart after each turn."""
    speeds, angles = np.split(rows, 2, axis=1)
    turned = [unwrap_angles(stamps_ns, *pair) for pair in zip(angles.T, speeds.T, strict=True)]
    velocity, position = _side_means(speeds, topic), _side_means(np.column_stack(turned), topic)
    if np.isnan(velocity).any() and np.isfinite(position).all():
        velocity = rates_of_positions(position, stamps_ns)
    return {"velocity": velocity, "position": position}


def _side_means(joints: FloatArray, topic: BagTopic) -> FloatArray:
    """(n, sides) of (n, joints), each side's mean times its ratio."""
    means, begin = [], 0
    for side in sides_of(topic):
        end = begin + len(side.names)
        means.append(sum(joints[:, begin:end].T) / len(side.names) * side.ratio)
        begin = end
    return np.column_stack(means)


def _heading_values(rows: FloatArray, topic: BagTopic) -> Values:
    covariance = rows[:, 4:].reshape(-1, 3, 3).copy()
    if "yaw" in topic.spreads:
        covariance[:, 2, :] = covariance[:, :, 2] = 0.0
        covariance[:, 2, 2] = _variance_of(topic.spreads["yaw"])
    if topic.convention == "enu" and topic.sign == 1.0:
        return heading_values(rows[:, :4], covariance)
    yaw = topic.sign * yaw_of(*rows[:, :4].T)
    yaw = math.pi / 2.0 - yaw if topic.convention == "compass" else yaw
    return heading_values(level_quaternions(yaw), covariance)


def _velocity_values(rows: FloatArray, topic: BagTopic) -> Values:
    variances = rows[:, 2:].copy()
    for k, axis in enumerate("xy"):
        if axis in topic.spreads:
            variances[:, k] = _variance_of(topic.spreads[axis])
    return {"velocity": rows[:, :2], "variances": variances}


def _imu_values(rows: FloatArray, topic: BagTopic) -> Values:
    names, sizes = ("rate", "acceleration", "orientation"), (3, 3, 4)
    values: Values = {}
    begin = 0
    for name, size in zip(names, sizes, strict=True):
        values[name] = rows[:, begin : begin + size]
        values[f"{name}_covariance"] = rows[:, begin + size : begin + size + 9].reshape(-1, 3, 3)
        begin += size + 9
    for axis, spread in topic.spreads.items():
        key = "rate" if axis.startswith("angular") else "acceleration"
        k = "xyz".index(axis[-1])
        values[f"{key}_covariance"][:, k, k] = _variance_of(spread)
    return values


def _pose_values(rows: FloatArray, topic: BagTopic, type_name: str, local: LocalFrame) -> Values:
    """Poses and covariances; a heading without a value or a variance counts as missing."""
    covariance = _pose_covariance(rows, topic, type_name)
    if type_name == FIX:
        pose = np.column_stack((local.east_north(rows[:, :3]), np.full(len(rows), np.nan)))
    else:
        pose = rows[:, :3].copy()
    if topic.position_only:
        pose[:, 2] = np.nan
    has_heading = np.isfinite(pose[:, 2])
    has_variance = _is_variance(covariance[:, 2, 2])
    if has_heading.any() and not (has_heading & has_variance).any():
        raise InputError(_no_variance_text(topic, "yaw"))
    covariance[~has_variance, 2, 2] = np.nan
    return without_heading(pose, covariance)


def _pose_covariance(rows: FloatArray, topic: BagTopic, type_name: str) -> FloatArray:
    """(n, 3, 3) covariances of the messages, overridden by the mapping; nan where neither states one."""
    covariance = rows[:, 3:12].reshape(-1, 3, 3).copy()
    if type_name == FIX:
        covariance[:, 2, :] = covariance[:, :, 2] = np.nan
        covariance[rows[:, 12] == 0.0] = np.nan
    for axis, spread in topic.spreads.items():
        k, m = {"x": (0, 0), "y": (1, 1), "yaw": (2, 2), "xy": (0, 1)}[axis]
        if axis in ("x", "y"):
            covariance[:, k, :] = covariance[:, :, k] = 0.0
        covariance[:, k, m] = covariance[:, m, k] = _variance_of(spread)
    return covariance


def _is_variance(values: FloatArray) -> BoolArray:
    """(n,) whether values are finite and above 0."""
    is_variance: BoolArray = np.isfinite(values) & (values > 0.0)
    return is_variance


def _no_variance_text(topic: BagTopic, axis: str) -> str:
    accepted = f"stddev: {{{axis}: …}}{', or position_only: true' if axis == 'yaw' else ''}"
    return f"{topic.where}: {topic.source} states no variance of {axis} that is above 0; accepted: {accepted}"


def _variance_of(spread: Any) -> float:
    value = float(spread.value)
    return value * value if spread.is_stddev else value
