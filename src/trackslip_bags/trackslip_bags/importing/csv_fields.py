# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Conversion of the columns of a CSV log, in SI, to the values of each role's messages (``samples``)."""

import math

import numpy as np

from trackslip_bags.importing.local import LocalFrame
from trackslip_bags.importing.mapping_topics import CsvTopic
from trackslip_bags.importing.roles import QUATERNION, ROLES
from trackslip_bags.importing.samples import (
    Values,
    heading_values,
    level_quaternions,
    rates_of_positions,
    track_speeds,
    without_heading,
    yaw_of,
)
from trackslip_common.arrays import FloatArray, IntArray
from trackslip_estimation.slip.measurements import UNOBSERVED

_NO_FIX = 0  # quality of a GGA sentence
_STATUS_OF_QUALITY = {0: -1, 1: 0, 2: 1, 3: 0, 4: 2, 5: 2, 9: 2}  # NavSatStatus: none, fix, SBAS, GBAS
_DIAGONAL, _FULL = 2, 3  # kinds of covariance of a NavSatFix; 0: unknown


def values_of(
    columns: Values, spreads: Values, stamps_ns: IntArray, topic: CsvTopic, local: LocalFrame
) -> Values:
    """Values of the role's messages."""
    match topic.role:
        case "sprockets":
            return _sprocket_values(columns, stamps_ns, topic)
        case "imu":
            return _imu_values(columns, spreads)
        case "pose":
            return _pose_values(columns, spreads, local)
        case "fix":
            return _fix_values(columns, spreads)
        case "heading":
            return _heading_values(columns, spreads)
        case "velocity":
            return _velocity_values(columns, spreads)
        case "odometry":
            return _odometry_values(columns)
        case _:
            nothing = np.full(len(stamps_ns), np.nan)
            return {name: columns.get(name, nothing) for name in ROLES[topic.role].fields}


def _sprocket_values(columns: Values, stamps_ns: IntArray, topic: CsvTopic) -> Values:
    """Velocities as recorded, from a twist, or from positions."""
    positions = np.full((len(stamps_ns), 2), np.nan)
    if "left_position" in columns:
        positions = np.column_stack((columns["left_position"], columns["right_position"]))
    if "left_velocity" in columns:
        velocities = np.column_stack((columns["left_velocity"], columns["right_velocity"]))
    elif topic.geometry is not None and "speed" in columns:
        velocities = track_speeds(columns["speed"], columns["yaw_rate"], topic.geometry)
    else:
        velocities = rates_of_positions(positions, stamps_ns)
    return {"velocity": velocities, "position": positions}


def _imu_values(columns: Values, spreads: Values) -> Values:
    values: Values = {}
    count = len(next(iter(columns.values())))
    for key, name in (("rate", "angular_velocity"), ("acceleration", "linear_acceleration")):
        axes = [f"{name}_{axis}" for axis in "xyz"]
        nothing, covariance = np.full(count, np.nan), np.zeros((count, 3, 3))
        for k, axis in enumerate(axes):
            covariance[:, k, k] = spreads.get(axis, 0.0)
        values[key] = np.column_stack([columns.get(axis, nothing) for axis in axes])
        values[f"{key}_covariance"] = covariance
    values["orientation"] = np.full((count, 4), np.nan)
    values["orientation_covariance"] = np.zeros((count, 3, 3))
    return values


def _pose_values(columns: Values, spreads: Values, local: LocalFrame) -> Values:
    """Poses, with local east and north where latitude and longitude are given."""
    if "latitude" in columns:
        x, y = local.east_north(place_of(columns)).T
    else:
        x, y = columns["x"], columns["y"]
    yaw = _yaw(columns, len(x))
    covariance = np.zeros((len(x), 3, 3))
    for k, axis in enumerate(("x", "y", "yaw")):
        covariance[:, k, k] = spreads.get(axis, np.nan)
    covariance[:, 0, 1] = covariance[:, 1, 0] = spreads.get("xy", 0.0)
    return without_heading(np.column_stack((x, y, yaw)), covariance)


def _yaw(columns: Values, count: int) -> FloatArray:
    """(n,) yaw from east, counter-clockwise, rad; nan where unknown."""
    if "qw" in columns:
        return yaw_of(*(columns[name] for name in QUATERNION))
    if "heading" in columns:
        return math.pi / 2.0 - columns["heading"]  # of a compass: from north, clockwise
    return columns.get("yaw", np.full(count, np.nan))


def _quaternions(columns: Values, count: int) -> FloatArray:
    """(n, 4) quaternions."""
    if "qw" in columns:
        return np.column_stack([columns[name] for name in QUATERNION])
    return level_quaternions(_yaw(columns, count))


def _heading_values(columns: Values, spreads: Values) -> Values:
    """Headings; a variance of 0 is unknown: the source parameters state it."""
    turn = _quaternions(columns, len(next(iter(columns.values()))))
    covariance = np.zeros((len(turn), 3, 3))
    covariance[:, 2, 2] = np.nan_to_num(spreads.get("yaw", covariance[:, 2, 2]), nan=0.0)
    return heading_values(turn, covariance)


def _fix_values(columns: Values, spreads: Values) -> Values:
    place = place_of(columns)
    covariance = np.zeros((len(place), 3, 3))
    is_known = np.full(len(place), "x" in spreads and "y" in spreads)
    for k, axis in enumerate("xyz"):
        covariance[:, k, k] = spreads.get(axis, UNOBSERVED)
    covariance[:, 0, 1] = covariance[:, 1, 0] = spreads.get("xy", 0.0)
    is_known &= np.isfinite(covariance).all(axis=(1, 2))
    covariance[~is_known] = 0.0
    status = columns.get("status", np.zeros(len(place)))
    if "quality" in columns:
        quality = np.nan_to_num(columns["quality"], nan=_NO_FIX).astype(int)
        status = np.array([_STATUS_OF_QUALITY.get(one, -1) for one in quality.tolist()], np.float64)
    kind = np.where(is_known, _FULL if "xy" in spreads else _DIAGONAL, 0)
    return {
        "place": place,
        "covariance": covariance,
        "kind": kind.astype(np.float64),
        "status": np.nan_to_num(status, nan=-1.0),
    }


def _velocity_values(columns: Values, spreads: Values) -> Values:
    """Velocities, of a radar forward only; a variance of 0 is unknown: the source parameters state it."""
    if "forward" in columns:
        x, y = columns["forward"], np.zeros(len(columns["forward"]))
    elif "course" in columns:
        x, y = columns["speed"] * np.sin(columns["course"]), columns["speed"] * np.cos(columns["course"])
    else:
        x, y = columns["east"], columns["north"]
    unknown = np.zeros(len(x))
    variance_x = np.nan_to_num(spreads.get("x", unknown), nan=0.0)
    variance_y = np.nan_to_num(spreads.get("y", unknown), nan=0.0)
    variance_y = np.full(len(x), UNOBSERVED) if "forward" in columns else variance_y
    return {"velocity": np.column_stack((x, y)), "variances": np.column_stack((variance_x, variance_y))}


def _odometry_values(columns: Values) -> Values:
    """Odometry; variances of 0 are unknown."""
    level = np.zeros(len(columns["x"]))
    turn = _quaternions(columns, len(level))
    place = np.column_stack((columns["x"], columns["y"], columns.get("z", level)))
    return {"place": place, "turn": turn, "variances": np.zeros((len(level), 12))}


def place_of(columns: Values) -> FloatArray:
    """(n, 3) latitude, longitude, altitude: rad, rad, m; nan for an unknown altitude."""
    nothing = np.full(len(columns["latitude"]), np.nan)
    return np.column_stack((columns["latitude"], columns["longitude"], columns.get("altitude", nothing)))
