# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Heading, roll and pitch from the quaternion ``qx qy qz qw`` of one record, or of the rows of a table."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trackslip_common.arrays import FloatArray

_UNIT = 0.1  # by which the norm of a quaternion, squared, may differ from 1; some are typed by hand
UNKNOWN_STDDEV = 1.8  # rad; a uniform heading has π/√3 = 1.81


def is_heading_known(variance: Any) -> Any:
    """Whether a heading with this variance, rad², is known; elementwise for an array."""
    return variance <= UNKNOWN_STDDEV**2


def heading_text(heading: float, variance: float, sigmas: float = 1.0) -> str:
    """Text such as "12.0° ± 0.5", ± ``sigmas`` standard deviations; "unknown" for an unknown heading."""
    if not is_heading_known(variance):
        return "unknown"
    return f"{math.degrees(heading):.1f}° ± {math.degrees(sigmas * math.sqrt(max(variance, 0.0))):.1f}"


def heading_of(pose: Any) -> float:
    """Rotation about z, rad in (−π, π], of an object with the quaternion ``qx qy qz qw``.

    nan if that is no rotation: drivers leave it at zeros where they have no orientation.
    """
    norm = pose.qx * pose.qx + pose.qy * pose.qy + pose.qz * pose.qz + pose.qw * pose.qw
    if not abs(norm - 1.0) < _UNIT:
        return math.nan
    sine = 2.0 * (pose.qw * pose.qz + pose.qx * pose.qy)
    return math.atan2(sine, 1.0 - 2.0 * (pose.qy * pose.qy + pose.qz * pose.qz))


def tilt_of(pose: Any) -> tuple[float, float]:
    """Roll and pitch (ZYX, nose down > 0), rad, of an object with the quaternion ``qx qy qz qw``."""
    up = 1.0 - 2.0 * (pose.qx * pose.qx + pose.qy * pose.qy)
    roll = math.atan2(2.0 * (pose.qw * pose.qx + pose.qy * pose.qz), up)
    sine = 2.0 * (pose.qw * pose.qy - pose.qz * pose.qx)
    return roll, math.asin(min(max(sine, -1.0), 1.0))


def tilts_of(rows: NDArray[np.void]) -> FloatArray:
    """(n, 2) ``tilt_of`` of rows with the same fields, equal to the last bit."""
    x, y, z, w = (rows[name] for name in ("qx", "qy", "qz", "qw"))
    with np.errstate(over="ignore", invalid="ignore"):  # as with Python's floats
        pairs = (2.0 * (w * x + y * z)).tolist(), (1.0 - 2.0 * (x * x + y * y)).tolist()
        sines = np.clip(2.0 * (w * y - z * x), -1.0, 1.0).tolist()
    return np.column_stack((_elementwise(math.atan2, *pairs), _elementwise(math.asin, sines)))


def headings_of(rows: NDArray[np.void]) -> FloatArray:
    """(n,) ``heading_of`` of rows with the same fields, equal to the last bit."""
    x, y, z, w = (rows[name] for name in ("qx", "qy", "qz", "qw"))
    with np.errstate(over="ignore", invalid="ignore"):  # as with Python's floats
        sines, cosines = 2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)
        is_rotation = np.abs(x * x + y * y + z * z + w * w - 1.0) < _UNIT
    return np.where(is_rotation, _elementwise(math.atan2, sines.tolist(), cosines.tolist()), math.nan)


def poses_of(rows: NDArray[np.void]) -> FloatArray:
    """(n, 3) x, y, heading of rows with a planar pose."""
    return np.column_stack((rows["x"], rows["y"], headings_of(rows)))


def wrap_angles(angles: FloatArray) -> FloatArray:
    """(n,) angles wrapped to (−π, π]."""
    return np.asarray(np.angle(np.exp(1j * angles)))


def _elementwise(function: Callable[..., float], *arguments: list[float]) -> FloatArray:
    """(n,) values of a function of ``math``, as numpy's own differ in the last bit."""
    return np.fromiter(map(function, *arguments), np.float64, len(arguments[0]))
