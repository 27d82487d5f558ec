# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Status texts of the attitude: the tilt of the machine, or why the ground counts as flat."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from trackslip_common.orientations import is_heading_known
from trackslip_common.units import GRAVITY
from trackslip_estimation.attitude.filter import GRAVITY_TOLERANCE, LEAST_UPWARD_FORCE
from trackslip_estimation.attitude.records import BIAS_X, BIAS_Y, HEIGHT, PITCH, ROLL, AttitudeRejection

if TYPE_CHECKING:
    from trackslip_estimation.attitude.records import Attitude

_LEAST_BIAS = 0.1  # m/s², least bias that is reported, if significant
_SIGNIFICANT = 3.0  # standard deviations
_UNKNOWN_HEIGHT_STDDEV = 100.0  # m, standard deviation of an unknown height


def attitude_text(a: Attitude, source: str | None) -> str:
    """Status of a record of ``ATTITUDE`` with the IMU's topic ``source``; None: no IMU is configured."""
    if source is None:
        return "flat: no IMU is configured; set use_attitude and yaw_rate_sources"
    if int(a["known"]) == 0:
        return f"flat: {_unknown_reason(a, source)}{_rejection_text(a, source)}"
    roll, pitch, height = (float(a["mean"][k]) for k in (ROLL, PITCH, HEIGHT))
    roll_stddev, pitch_stddev, height_stddev = (
        math.sqrt(float(a["covariance"][k, k])) for k in (ROLL, PITCH, HEIGHT)
    )
    tilt = f"roll {math.degrees(roll):.1f}° ± {math.degrees(roll_stddev):.1f}"
    tilt += f", pitch {math.degrees(pitch):.1f}° ± {math.degrees(pitch_stddev):.1f} (nose down positive)"
    height_text = (
        f"{height:.2f} m ± {height_stddev:.2f}"
        if height_stddev < _UNKNOWN_HEIGHT_STDDEV
        else "unknown until a fix has an altitude"
    )
    return f"{tilt}, height {height_text}{_bias_text(a, source)}{_rejection_text(a, source)}"


def _unknown_reason(a: Attitude, source: str) -> str:
    """Why the attitude is unknown."""
    if int(a["sample"]["swing_unknown"]) == 1:
        variance = float(a["sample"]["turn_variance"])
        accuracy = f" (± {math.degrees(math.sqrt(variance)):.0f}°)" if is_heading_known(variance) else ""
        return f"{source} is on the upper structure, whose swing angle is unknown{accuracy}"
    if int(a["seen"]) == 0:
        return f"no sample of {source} yet"
    if int(a["sample"]["use_force"]) == 0:
        return f"{source} has no orientation that can be used"
    if not np.isfinite(a["sample"]["force"]).all():
        return f"{source} has no accelerations"
    force = a["mean_force"]
    size = float(np.linalg.norm(force))
    if abs(size - GRAVITY) > GRAVITY_TOLERANCE:
        return f"accelerations of {source} are rejected: {size:.2f} m/s² on average, gravity is {GRAVITY:.2f}"
    if force[2] < LEAST_UPWARD_FORCE:
        x, y, z = (f"{value:.1f}" for value in force.tolist())
        measured = f"{source} measures gravity along ({x}, {y}, {z}) m/s²"
        return f"accelerations are rejected: {measured}, and not along z; set its mounting"
    return f"{source} is silent"


def _rejection_text(a: Attitude, source: str) -> str:
    """Why the last orientation was rejected; empty if it was not."""
    rejection = int(a["rejection"])
    words = AttitudeRejection(rejection).name.lower().replace("_", " ") if rejection else ""
    return f"; the orientation of {source} is rejected: {words}" if words else ""


def _bias_text(a: Attitude, source: str) -> str:
    """Significant mounting error or accelerometer bias, as estimated in turns on the spot; else empty."""
    for k, name in ((BIAS_X, "pitch"), (BIAS_Y, "roll")):
        bias, stddev = float(a["mean"][k]), math.sqrt(float(a["covariance"][k, k]))
        if abs(bias) > max(_LEAST_BIAS, _SIGNIFICANT * stddev):
            degrees = math.degrees(abs(bias) / GRAVITY)
            return (
                f"; {source} is tilted {degrees:.1f}° in {name}, or its accelerometer has a bias of that size"
            )
    return ""
