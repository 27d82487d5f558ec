# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The tracks' instantaneous centres of rotation (Martínez & Mandow; Pentzer 2014) as states.

    y_L, y_R   lateral places of both centres, left of C    m     r ω_j (1 − i₀) = v − ω y_j

Other symbols: ``speed``. Without slip y_L = B/2 and y_R = −B/2. The model suits wheels, whose centres stay
constant. The centres of tracks swap with the sense of the turn, and grow without bound on weak soil.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_common.compiled import compiled
from trackslip_common.parameters import parameter
from trackslip_estimation.slip.models import speed
from trackslip_estimation.slip.models.model import Part, Prior
from trackslip_estimation.slip.models.speed import (
    COMMON_SLIP,
    TURN_STATE_1,
    TURN_STATE_2,
    SpeedNoise,
    noise_scale,
)
from trackslip_estimation.slip.motion import Motion, MotionState

if TYPE_CHECKING:
    from trackslip_estimation.slip.config import Config


CODE, NAME, ACTIVE = 2, "icr", speed.ACTIVE
LEFT_CENTRE, RIGHT_CENTRE = TURN_STATE_1, TURN_STATE_2
PARTS = (
    *speed.PARTS,
    Part("centres", slice(LEFT_CENTRE, RIGHT_CENTRE + 1), "m, m", "y_L and y_R, left of C"),
)
_LEAST_CENTRE_DISTANCE = 0.1  # m, least distance between the two centres


@dataclass(frozen=True, kw_only=True)
class IcrNoise(SpeedNoise):
    """Parameters of the ICR model."""

    centre: float = parameter("random walk of y_L and y_R, while turning", unit="m/√s", ge=0.0)
    initial_centre: float = parameter("y_L = −y_R before the first turn", unit="m", gt=0.0)
    initial_centre_stddev: float = parameter(
        "standard deviation of y_L and y_R before the first turn", unit="m", gt=0.0
    )


def prior(n: IcrNoise, tread: float) -> Prior:
    """Prior at rest, with typical centres and no slip."""
    start = speed.prior(n, tread)
    start.mean[LEFT_CENTRE], start.mean[RIGHT_CENTRE] = n.initial_centre, -n.initial_centre
    start.stddev[LEFT_CENTRE] = start.stddev[RIGHT_CENTRE] = n.initial_centre_stddev
    return start


def process_noise_density(n: IcrNoise, motion: MotionState) -> FloatArray:
    """(SIZE,) per √s: the centres walk in turns only."""
    density = speed.process_noise_density(n, motion)
    if motion.motion is Motion.TURNING:
        density[LEFT_CENTRE] = density[RIGHT_CENTRE] = n.centre * noise_scale(n, motion)
    return density


def velocity_error_constants(n: IcrNoise) -> dict[str, float]:
    """The fields of ``speed.CONSTANTS``."""
    return speed.constants(n, (n.initial_centre_stddev, n.initial_centre_stddev))


@compiled
def equations(x: FloatArray, left: float, right: float, c: Config) -> tuple[float, float]:
    """v in m/s and ω in rad/s without the velocity errors, from r ω_j (1 − i₀) = v − ω y_j."""
    radius = c.rolling_radius * (1.0 - x[COMMON_SLIP])
    rate = radius * (right - left) / max(x[LEFT_CENTRE] - x[RIGHT_CENTRE], _LEAST_CENTRE_DISTANCE)
    return radius * (left + right) / 2.0 + rate * (x[LEFT_CENTRE] + x[RIGHT_CENTRE]) / 2.0, rate


@compiled
def twist(x: FloatArray, left: float, right: float, c: Config) -> tuple[float, float, float]:
    """v_x m/s, v_y m/s, ω rad/s of C."""
    v, rate = equations(x, left, right, c)
    return speed.twist(x, v, rate)


@compiled
def twist_jacobian(x: FloatArray, left: float, right: float, c: Config) -> FloatArray:
    """(3, SIZE) derivative of ``twist`` by the state."""
    J = np.zeros((3, x.size))
    distance, middle = x[LEFT_CENTRE] - x[RIGHT_CENTRE], (x[LEFT_CENTRE] + x[RIGHT_CENTRE]) / 2.0
    rate = equations(x, left, right, c)[1]
    if distance > _LEAST_CENTRE_DISTANCE:
        J[2, LEFT_CENTRE], J[2, RIGHT_CENTRE] = -rate / distance, rate / distance
    J[2, COMMON_SLIP] = -c.rolling_radius * (right - left) / max(distance, _LEAST_CENTRE_DISTANCE)
    J[0] = middle * J[2]
    J[0, LEFT_CENTRE] += rate / 2.0
    J[0, RIGHT_CENTRE] += rate / 2.0
    J[0, COMMON_SLIP] -= c.rolling_radius * (left + right) / 2.0
    speed.complete_jacobian(x, rate, J)
    return J
