# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Values of each role's messages (``samples``), from the columns of a table, a bag or a device's log.

Columns are named as the fields of ``ROLES``, in SI. Bags and devices also have columns of covariances, which
the variances that a mapping states replace:

    angular_velocity_covariance, linear_acceleration_covariance, orientation_covariance (n, 3, 3)
    covariance (n, 3, 3)   of a pose: x, y, yaw; of a fix: east, north, up (none where ``kind`` is 0)
    variances              of a velocity (n, 2), of pose and twist of an odometry (n, 12)
"""

import math
from collections.abc import Sequence

import numpy as np

from trackslip_bags.importing.fix_quality import status_of
from trackslip_bags.importing.local import place_of
from trackslip_bags.importing.mapping_topics import Geometry
from trackslip_bags.importing.roles import ACCELERATIONS, QUATERNION, RATES, ROLES
from trackslip_bags.importing.samples import Values
from trackslip_common.arrays import FloatArray, IntArray
from trackslip_estimation.slip.measurements import UNOBSERVED

_DIAGONAL, _FULL = 2, 3  # kinds of covariance of a NavSatFix; 0: unknown


def values_of(
    role: str,
    columns: Values,
    variances: Values,
    stamps_ns: IntArray,
    geometry: Geometry | None = None,
) -> Values:
    """Values of the role's messages.

    Args:
        role: name of the role.
        columns: (n, …) columns, as above.
        variances: (n,) by axis, SI; of two axes their covariance. Those that the mapping states.
        stamps_ns: (n,) of the rows.
        geometry: of the vehicle, for speeds over ground of sprockets.
    """
    match role:
        case "sprockets":
            return _sprocket_values(columns, stamps_ns, geometry)
        case "imu" | "heading":
            return _imu_values(columns, variances)
        case "pose":
            return _pose_values(columns, variances)
        case "fix":
            return _fix_values(columns, variances)
        case "velocity":
            return _velocity_values(columns, variances)
        case "odometry":
            return _odometry_values(columns)
        case _:
            nothing = np.full(len(stamps_ns), np.nan)
            return {name: columns.get(name, nothing) for name in ROLES[role].fields}


def _sprocket_values(columns: Values, stamps_ns: IntArray, geometry: Geometry | None) -> Values:
    """Velocities as recorded, from a twist, or from positions."""
    nothing = np.full(len(stamps_ns), np.nan)
    velocities, positions = (
        np.column_stack([columns.get(f"{side}_{what}", nothing) for side in ("left", "right")])
        for what in ("velocity", "position")
    )
    if geometry is not None and "speed" in columns:
        velocities = _track_speeds(columns["speed"], columns["yaw_rate"], geometry)
    elif np.isnan(velocities).any() and np.isfinite(positions).all():
        velocities = _rates_of_positions(positions, stamps_ns)
    return {"velocity": velocities, "position": positions}


def _track_speeds(speed: FloatArray, yaw_rate: FloatArray, geometry: Geometry) -> FloatArray:
    """(n, 2) sprocket speeds, rad/s, without slip, for speeds (n,) in m/s and yaw rates (n,) in rad/s."""
    half_difference = yaw_rate * geometry.tread / 2.0
    return np.column_stack((speed - half_difference, speed + half_difference)) / geometry.rolling_radius


def _rates_of_positions(positions: FloatArray, stamps_ns: IntArray) -> FloatArray:
    """(n, 2) rad/s from (n, 2) rad: change over the time since the row before; the first as the second."""
    if len(positions) < 2:
        return np.zeros_like(positions)
    steps = np.diff(stamps_ns) * 1e-9
    with np.errstate(divide="ignore", invalid="ignore"):
        speeds = np.diff(positions, axis=0) / steps[:, np.newaxis]
    speeds = np.where(steps[:, np.newaxis] > 0.0, speeds, 0.0)
    return np.concatenate((speeds[:1], speeds))


def _imu_values(columns: Values, variances: Values) -> Values:
    """Rates, accelerations and orientation of an Imu; a heading has the last alone.

    A variance of 0 is unknown: the source parameters state it.
    """
    count = _count(columns)
    nothing = np.full(count, np.nan)
    vectors = {
        "angular_velocity": (RATES, np.column_stack([columns.get(axis, nothing) for axis in RATES])),
        "linear_acceleration": (
            ACCELERATIONS,
            np.column_stack([columns.get(axis, nothing) for axis in ACCELERATIONS]),
        ),
        "orientation": (("roll", "pitch", "yaw"), _quaternions(columns)),
    }
    values: Values = {}
    for name, (axes, vector) in vectors.items():
        stated = columns.get(f"{name}_covariance", np.zeros((count, 3, 3)))
        values[name] = vector
        values[f"{name}_covariance"] = _with_variances(stated, variances, axes)
    return values


def _pose_values(columns: Values, variances: Values) -> Values:
    """Poses; an unknown heading has the variance UNOBSERVED."""
    pose = np.column_stack((columns["x"], columns["y"], _yaw(columns)))
    covariance = pose_covariance(columns, variances)
    missing = ~(np.isfinite(pose[:, 2]) & np.isfinite(covariance[:, 2, 2]))
    pose[missing, 2] = 0.0
    covariance[missing, 2, :] = covariance[missing, :, 2] = 0.0
    covariance[missing, 2, 2] = UNOBSERVED
    return {"pose": pose, "covariance": covariance}


def pose_covariance(columns: Values, variances: Values) -> FloatArray:
    """(n, 3, 3) covariances of x, y, yaw; nan where neither messages nor mapping state one."""
    stated = columns.get("covariance", np.full((_count(columns), 3, 3), np.nan)).copy()
    if "kind" in columns:
        stated[:, 2, :] = stated[:, :, 2] = np.nan  # up
        stated[columns["kind"] == 0.0] = np.nan
    stated[~(stated[:, 2, 2] > 0.0), 2, 2] = np.nan
    return _with_variances(stated, variances, ("x", "y", "yaw"))


def _with_variances(covariance: FloatArray, variances: Values, axes: Sequence[str]) -> FloatArray:
    """(n, 3, 3) covariances with the stated variances; an axis that has one is correlated as stated only."""
    covariance = covariance.copy()
    for k, axis in enumerate(axes):
        if axis in variances:
            covariance[:, k, :] = covariance[:, :, k] = 0.0
            covariance[:, k, k] = variances[axis]
    if "xy" in variances:
        covariance[:, 0, 1] = covariance[:, 1, 0] = variances["xy"]
    return covariance


def yaw_of(quaternions: FloatArray) -> FloatArray:
    """(n,) rotations about z, rad, of (n, 4) x, y, z, w; nan where there is no rotation (all zero)."""
    x, y, z, w = quaternions.T
    yaw = np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    return np.where((quaternions * quaternions).sum(axis=1) > 0.0, yaw, np.nan)


def _yaw(columns: Values) -> FloatArray:
    """(n,) yaw from east, counter-clockwise, rad; nan where unknown."""
    if "qw" in columns:
        return yaw_of(_quaternions(columns))
    if "heading" in columns:
        return math.pi / 2.0 - columns["heading"]  # of a compass: from north, clockwise
    return columns.get("yaw", np.full(_count(columns), np.nan))


def _quaternions(columns: Values) -> FloatArray:
    """(n, 4) quaternions x, y, z, w; nan where unknown."""
    if "qw" in columns:
        return np.column_stack([columns[name] for name in QUATERNION])
    half = _yaw(columns) / 2.0
    return np.column_stack((0.0 * half, 0.0 * half, np.sin(half), np.cos(half)))


def _fix_values(columns: Values, variances: Values) -> Values:
    place = place_of(columns)
    nothing = np.zeros(len(place))
    covariance, kind = columns.get("covariance", np.zeros((len(place), 3, 3))), columns.get("kind", nothing)
    if {"x", "y"} <= variances.keys():
        stated = {"z": np.full(len(place), UNOBSERVED), **variances}
        covariance = _with_variances(covariance, stated, "xyz")
        is_known = np.isfinite(covariance).all(axis=(1, 2))
        covariance[~is_known] = 0.0
        kind = np.where(is_known, float(_FULL if "xy" in variances else _DIAGONAL), 0.0)
    status = columns.get("status", nothing)
    if "quality" in columns:
        status = status_of(columns["quality"])
    status = np.nan_to_num(status, nan=-1.0)
    return {"place": place, "covariance": covariance, "kind": kind, "status": status}


def _velocity_values(columns: Values, variances: Values) -> Values:
    """Velocities, of a radar forward only; a variance of 0 is unknown: the source parameters state it."""
    if "forward" in columns:
        x, y = columns["forward"], np.zeros(len(columns["forward"]))
    elif "course" in columns:
        x, y = columns["speed"] * np.sin(columns["course"]), columns["speed"] * np.cos(columns["course"])
    else:
        x, y = columns["east"], columns["north"]
    own = columns.get("variances", np.zeros((len(x), 2)))
    of_axes = np.column_stack([variances.get(axis, own[:, k]) for k, axis in enumerate("xy")])
    of_axes = np.nan_to_num(of_axes, nan=0.0)
    if "forward" in columns:
        of_axes[:, 1] = UNOBSERVED
    return {"velocity": np.column_stack((x, y)), "variances": of_axes}


def _odometry_values(columns: Values) -> Values:
    """Odometry; variances of 0 are unknown."""
    level = np.zeros(len(columns["x"]))
    place = np.column_stack((columns["x"], columns["y"], columns.get("z", level)))
    variances = columns.get("variances", np.zeros((len(level), 12)))
    return {"place": place, "turn": _quaternions(columns), "variances": variances}


def _count(columns: Values) -> int:
    return len(next(iter(columns.values())))
