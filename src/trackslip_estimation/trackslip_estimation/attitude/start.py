# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Initialisation of the attitude filter: without samples, and with the first known tilt; compiled.

a   record of ``ATTITUDE``
n   record of ``CONSTANTS``
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from trackslip_common.clock_monitor import NEVER_NS
from trackslip_common.compiled import compiled
from trackslip_estimation.attitude.level import set_level
from trackslip_estimation.attitude.records import BIAS_X, BIAS_Y, PITCH, ROLL, SIZE

if TYPE_CHECKING:
    from trackslip_estimation.attitude.parameters import AttitudeConstants
    from trackslip_estimation.attitude.records import Attitude

_INITIAL_NOISE = 1.0  # (m/s²)², noise of the accelerometers before the first sample


@compiled
def reset_attitude(a: Attitude) -> None:
    """Reset the attitude to unknown, without any sample."""
    a.known = a.seen = a.stamp_ns = a.reached_ns = a.rejection = 0
    a.oriented_ns = NEVER_NS
    a.mean[:], a.covariance[:] = 0.0, 0.0
    a.rates[:], a.mean_force[:], a.sample.force[:], a.span.begun = 0.0, 0.0, np.nan, 0
    a.altitudes.used_ns, a.altitudes.rejections = NEVER_NS, 0
    set_level(a)


@compiled
def initialise_tilt(a: Attitude, roll: float, pitch: float, n: AttitudeConstants) -> None:
    """Initialise roll and pitch, rad, with their prior variance; height and biases keep their estimates."""
    x, P = a.mean, a.covariance
    for i in range(SIZE):
        if P[BIAS_X, BIAS_X] == 0.0 and i != BIAS_X:
            P[i, i] = n.initial[i] ** 2
        for j in range(PITCH + 1):
            P[i, j] = P[j, i] = 0.0
    P[BIAS_X, BIAS_X] = max(P[BIAS_X, BIAS_X], n.initial[BIAS_X] ** 2)
    P[ROLL, ROLL], P[PITCH, PITCH] = n.initial[ROLL] ** 2, n.initial[PITCH] ** 2
    x[ROLL], x[PITCH] = roll, pitch
    a.noise[:], a.noise_count[:], a.known = _INITIAL_NOISE, 1.0, 1
    a.slide[:], a.fastest = 0.0, 0.0


@compiled
def initialise_from_gravity(a: Attitude, n: AttitudeConstants) -> None:
    """Initialise roll and pitch from the mean specific force."""
    x = a.mean
    f_x, f_y, f_z = a.mean_force
    cos, sin = a.sample.cos, a.sample.sin
    roll = math.atan2(f_y - (sin * x[BIAS_X] + cos * x[BIAS_Y]), f_z)
    pitch = math.atan2((cos * x[BIAS_X] - sin * x[BIAS_Y]) - f_x, math.sqrt(f_y * f_y + f_z * f_z))
    initialise_tilt(a, roll, pitch, n)
