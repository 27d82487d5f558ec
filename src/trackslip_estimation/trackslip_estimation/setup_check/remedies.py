# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Remedies: the line of the roles, mapping or parameter file that undoes a mistake, with its new value."""

import math

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_estimation.setup_check.log import Compass, Gyro, group_of
from trackslip_estimation.slip.mounting import rotation as rotation_rows

SWAP_TRACKS = (
    "Exchange left and right: in the mapping the columns of left_velocity and right_velocity (left_position "
    "and right_position; of a bag the joints left and right), in the roles file left_… and right_…"
)


def parameter(name: str, value: float | str) -> str:
    """A line for the parameters of the slip estimator, with a dotted name."""
    return f"slip_estimator.{name}={value if isinstance(value, str) else f'{value:g}'}"


def track_sign(*sides: str) -> str:
    """Remedy for the sign of one side or both."""
    names = " and ".join(f"{side}_velocity" for side in sides)
    roles = ", ".join(f"{side}_position" for side in sides)
    return (
        f"Turn the sign: in the mapping 'scale: -1' at {names} (of a joint "
        f"'sign: -1'), in the roles file {roles}: sign: -1"
    )


def gyro_sign(gyro: Gyro) -> str:
    """Remedy that inverts the stated sign."""
    return f"Set {parameter(f'{group_of(gyro.name)}.sign', -gyro.sign)}"


def gyro_scale(gyro: Gyro, factor: float) -> str:
    """Remedy for a wrong unit; ``factor``: reading over true rate."""
    return (
        f"State the gyro's own unit in the mapping (angular_velocity_z: unit), or set "
        f"{parameter(f'{group_of(gyro.name)}.scale', gyro.scale * factor)}"
    )


def heading_convention(compass: Compass, *, is_from_north: bool) -> str:
    """Remedy for headings from north, clockwise, or else for headings of the opposite sign than stated."""
    group = group_of(compass.name)
    renamed = "call the column 'heading' instead of 'yaw' in the mapping, or 'yaw' where it is 'heading'"
    if compass.of_poses:
        return renamed.capitalize() if is_from_north else "Turn its sign: in the mapping 'scale: -1' at yaw"
    if not is_from_north:
        return f"Set {parameter(f'{group}.sign', -compass.sign)}; of an imported log, sign: -1 in its mapping"
    other = "compass" if compass.convention == "enu" else "enu"
    return f"Set {parameter(f'{group}.convention', other)}; of an imported log, {renamed}"


def mounting(gyro: Gyro, correction: FloatArray) -> str:
    """Remedy for a wrong mounting; ``correction`` (3, 3) rotates vectors from stated to true axes."""
    roll, pitch, yaw = euler_angles(correction @ rotation(*gyro.mounting))
    group = group_of(gyro.name)
    names = (("roll", roll), ("pitch", pitch), ("yaw", yaw))
    return "Set " + " ".join(parameter(f"{group}.mounting_{name}", round(value, 4)) for name, value in names)


def rotation(roll: float, pitch: float, yaw: float) -> FloatArray:
    """(3, 3) R_z(yaw) R_y(pitch) R_x(roll)."""
    rows = rotation_rows(roll, pitch, yaw)
    return np.eye(3) if rows is None else np.array(rows)


def euler_angles(R: FloatArray) -> tuple[float, float, float]:
    """Roll, pitch, yaw of a rotation (3, 3), rad."""
    pitch = math.asin(float(np.clip(-R[2, 0], -1.0, 1.0)))
    if abs(abs(pitch) - math.pi / 2.0) < 1e-6:
        return math.atan2(math.copysign(1.0, pitch) * float(R[0, 1]), float(R[1, 1])), pitch, 0.0
    roll = math.atan2(float(R[2, 1]), float(R[2, 2]))
    return roll, pitch, math.atan2(float(R[1, 0]), float(R[0, 0]))
