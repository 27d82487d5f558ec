# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""From the numbers of a robot's messages, a row each, to the values of each role's messages (``samples``)."""

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from trackslip_bags.importing.bag_fields import sides_of
from trackslip_bags.importing.local import LocalFrame, Rows
from trackslip_bags.importing.mapping_topics import NEEDS_GEOMETRY, BagTopic
from trackslip_bags.importing.roles import FIX, JOINTS, ROLES
from trackslip_bags.importing.samples import (
    FloatArray,
    IntArray,
    Values,
    differences,
    headings,
    track_speeds,
    without_heading,
    yaw_of,
)
from trackslip_common.errors import InputError
from trackslip_common.turns import continuous


def refusals(
    rows: FloatArray, topic: BagTopic, type_name: str, local: LocalFrame
) -> Iterator[tuple[str, Rows]]:
    """Reasons to leave out some of (n, k) rows that hold the numbers they should; (n,) which.

    Raises:
        InputError: all of them are to be left out.
    """
    if topic.role != "pose":
        return
    covariance, left = _pose_covariance(rows, topic, type_name), np.ones(len(rows), np.bool_)
    for k, axis in enumerate(("x", "y")):
        missing = left & ~_is_variance(covariance[:, k, k])
        left &= ~missing
        if not left.any():
            raise InputError(_no_variance(topic, axis))
        yield f"no variance of {axis} above 0", missing
    if type_name == FIX:
        at = np.flatnonzero(left)
        for reason, refused in local.refusals(rows[at, :3], f"{topic.where}: {topic.source}"):
            yield reason, np.isin(np.arange(len(rows)), at[refused])


def values_of(
    rows: FloatArray, stamps_ns: IntArray, topic: BagTopic, type_name: str, local: LocalFrame
) -> Values:
    """What the role's messages are made of, from (n, k) numbers.

    Raises:
        InputError: neither mapping nor messages say how sure a pose is, or how large the vehicle.
    """
    match topic.role:
        case "sprockets" if type_name == JOINTS:
            return _joint_values(rows, stamps_ns, topic)
        case "sprockets":
            return _twist_values(rows, topic)
        case "swing":
            return {"angle": _means(rows[:, rows.shape[1] // 2 :], topic)[:, 0]}
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
    """Of speed and yaw rate."""
    if topic.geometry is None:
        raise InputError(f"{topic.where}: {NEEDS_GEOMETRY}")
    nothing = np.full((len(rows), 2), np.nan)
    return {"velocity": track_speeds(rows[:, 0], rows[:, 1], topic.geometry), "position": nothing}


def _joint_values(rows: FloatArray, stamps_ns: IntArray, topic: BagTopic) -> Values:
    """Of each joint's velocity and position, which may restart after each of its turns."""
    speeds, angles = np.split(rows, 2, axis=1)
    turned = [continuous(stamps_ns, *pair) for pair in zip(angles.T, speeds.T, strict=True)]
    velocity, position = _means(speeds, topic), _means(np.column_stack(turned), topic)
    if np.isnan(velocity).any() and np.isfinite(position).all():
        velocity = differences(position, stamps_ns)
    return {"velocity": velocity, "position": position}


def _means(joints: FloatArray, topic: BagTopic) -> FloatArray:
    """(n, sides) of (n, joints), each side's mean times its ratio."""
    found, begin = [], 0
    for side in sides_of(topic):
        end = begin + len(side.names)
        found.append(sum(joints[:, begin:end].T) / len(side.names) * side.ratio)
        begin = end
    return np.column_stack(found)


def _heading_values(rows: FloatArray, topic: BagTopic) -> Values:
    covariance = rows[:, 4:].reshape(-1, 3, 3).copy()
    if "yaw" in topic.spreads:
        covariance[:, 2, :] = covariance[:, :, 2] = 0.0
        covariance[:, 2, 2] = _variance(topic.spreads["yaw"])
    if topic.convention == "enu" and topic.sign == 1.0:
        return headings(rows[:, :4], covariance)
    yaw = topic.sign * yaw_of(*rows[:, :4].T)
    yaw = math.pi / 2.0 - yaw if topic.convention == "compass" else yaw
    level = np.zeros(len(yaw))
    return headings(np.column_stack((level, level, np.sin(yaw / 2.0), np.cos(yaw / 2.0))), covariance)


def _velocity_values(rows: FloatArray, topic: BagTopic) -> Values:
    variances = rows[:, 2:].copy()
    for k, axis in enumerate("xy"):
        if axis in topic.spreads:
            variances[:, k] = _variance(topic.spreads[axis])
    return {"velocity": rows[:, :2], "variances": variances}


def _imu_values(rows: FloatArray, topic: BagTopic) -> Values:
    names, sizes = ("rate", "acceleration", "orientation"), (3, 3, 4)
    found: Values = {}
    begin = 0
    for name, size in zip(names, sizes, strict=True):
        found[name] = rows[:, begin : begin + size]
        found[f"{name}_covariance"] = rows[:, begin + size : begin + size + 9].reshape(-1, 3, 3)
        begin += size + 9
    for axis, spread in topic.spreads.items():
        key = "rate" if axis.startswith("angular") else "acceleration"
        k = "xyz".index(axis[-1])
        found[f"{key}_covariance"][:, k, k] = _variance(spread)
    return found


def _pose_values(rows: FloatArray, topic: BagTopic, type_name: str, local: LocalFrame) -> Values:
    """A heading that is not known, or not how well, is none."""
    covariance = _pose_covariance(rows, topic, type_name)
    if type_name == FIX:
        pose = np.column_stack((local.east_north(rows[:, :3]), np.full(len(rows), np.nan)))
    else:
        pose = rows[:, :3].copy()
    if topic.position_only:
        pose[:, 2] = np.nan
    headed = np.isfinite(pose[:, 2])
    known = _is_variance(covariance[:, 2, 2])
    if headed.any() and not (headed & known).any():
        raise InputError(_no_variance(topic, "yaw"))
    covariance[~known, 2, 2] = np.nan
    return without_heading(pose, covariance)


def _pose_covariance(rows: FloatArray, topic: BagTopic, type_name: str) -> FloatArray:
    """(n, 3, 3) of the messages, and what the mapping states over it; nan where neither does."""
    covariance = rows[:, 3:12].reshape(-1, 3, 3).copy()
    if type_name == FIX:
        covariance[:, 2, :] = covariance[:, :, 2] = np.nan
        covariance[rows[:, 12] == 0.0] = np.nan
    for axis, spread in topic.spreads.items():
        k, m = {"x": (0, 0), "y": (1, 1), "yaw": (2, 2), "xy": (0, 1)}[axis]
        if axis in ("x", "y"):
            covariance[:, k, :] = covariance[:, :, k] = 0.0
        covariance[:, k, m] = covariance[:, m, k] = _variance(spread)
    return covariance


def _is_variance(values: FloatArray) -> Rows:
    """(n,) whether they are finite and above 0."""
    found: Rows = np.isfinite(values) & (values > 0.0)
    return found


def _no_variance(topic: BagTopic, axis: str) -> str:
    accepted = f"stddev: {{{axis}: …}}{', or position_only: true' if axis == 'yaw' else ''}"
    return f"{topic.where}: {topic.source} states no variance of {axis} that is above 0; accepted: {accepted}"


def _variance(spread: Any) -> float:
    value = float(spread.value)
    return value * value if spread.is_stddev else value
