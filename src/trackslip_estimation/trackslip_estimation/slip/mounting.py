# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Mounting of an IMU: rotation from its frame into base_link.

    v_base = R v_imu,  R = R_z(yaw) R_y(pitch) R_x(roll)

Numbers of one message and columns of a bag use the same sums, so that a replay repeats every bit. A sum
leaves out axes of factor 0: a nan of an absent axis does not spread.
"""

import math
from collections.abc import Sequence
from functools import cache
from typing import Any, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

Rotation: TypeAlias = tuple[
    tuple[float, float, float], tuple[float, float, float], tuple[float, float, float]
]
Number = TypeVar("Number", float, NDArray[np.float64])

_ROUNDING = 1e-12  # of the cosine of a right angle


@cache
def rotation(roll: float, pitch: float, yaw: float) -> Rotation | None:
    """R; None where it is the identity. Angles in rad."""
    if roll == pitch == yaw == 0.0:
        return None
    cr, cp, cy = (_round_near_integer(math.cos(angle)) for angle in (roll, pitch, yaw))
    sr, sp, sy = (_round_near_integer(math.sin(angle)) for angle in (roll, pitch, yaw))
    return (
        (cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr),
        (sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr),
        (-sp, cp * sr, cp * cr),
    )


def quaternion_from_angles(roll: float, pitch: float, yaw: float) -> tuple[float, float, float, float]:
    """x, y, z, w of ZYX angles in rad."""
    x, y, z, w = quaternion_from_half_angles(
        [(math.sin(a / 2.0), math.cos(a / 2.0)) for a in (roll, pitch, yaw)]
    )
    return x, y, z, w


def quaternion_from_half_angles(halves: Sequence[tuple[Any, Any]]) -> tuple[Any, Any, Any, Any]:
    """x, y, z, w of the sines and cosines of half of each angle: numbers, or columns."""
    (sr, cr), (sp, cp), (sy, cy) = halves
    return (
        cy * cp * sr - sy * sp * cr,
        cy * sp * cr + sy * cp * sr,
        sy * cp * cr - cy * sp * sr,
        cy * cp * cr + sy * sp * sr,
    )


def vertical_axis(x: Number, y: Number, z: Number, w: Number) -> list[Number]:
    """Vertical in the frame of the quaternion, times its norm squared."""
    return [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), w * w + z * z - x * x - y * y]


def rotate(R: Rotation | None, vector: Sequence[Number]) -> list[Number]:
    """R times a vector: numbers, or columns (n,)."""
    return list(vector) if R is None else [_weighted_sum(row, vector) for row in R]


def rotate_variances(R: Rotation | None, variances: Sequence[Number]) -> list[Number]:
    """Diagonal of R diag(variances) Rᵀ."""
    if R is None:
        return list(variances)
    return [_weighted_sum([factor * factor for factor in row], variances) for row in R]


def _weighted_sum(factors: Sequence[float], vector: Sequence[Number]) -> Number:
    first, *rest = [factor * value for factor, value in zip(factors, vector, strict=True) if factor != 0.0]
    for value in rest:
        first = first + value
    return first


def _round_near_integer(value: float) -> float:
    return round(value) + 0.0 if abs(value - round(value)) < _ROUNDING else value
