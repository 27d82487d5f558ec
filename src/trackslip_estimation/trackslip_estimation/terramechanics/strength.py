# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Shear strength of the soil, and the thrust it can bear.

c, ϕ    apparent cohesion, angle of internal shearing resistance   Pa, rad
p       normal pressure                                            Pa
τ_max   shear strength                                             Pa
A       contact area of both tracks, 2 b l                         m²
W       weight of the vehicle                                      N
F_max   maximal tractive effort of one track                       N
"""

import math

import numpy as np
from numpy.typing import ArrayLike

from trackslip_common.arrays import FloatArray
from trackslip_estimation.terramechanics.domain import validate


def shear_strength(pressure: ArrayLike, cohesion: ArrayLike, friction_angle: ArrayLike) -> FloatArray:
    """τ_max = c + p tan ϕ in Pa, (2.1) and (2.2); c = 0 is dry sand (2.3), ϕ = 0 plastic clay (2.4).

    Args:
        pressure: p ≥ 0, Pa.
        cohesion: c ≥ 0, Pa.
        friction_angle: 0 ≤ ϕ < π/2, rad.

    Raises:
        InputError: an argument is out of range.
    """
    p = validate("pressure", pressure, "Pa", ge=0.0)
    c = validate("cohesion", cohesion, "Pa", ge=0.0)
    phi = validate("friction_angle", friction_angle, "rad", ge=0.0, lt=math.pi / 2)
    return c + p * np.tan(phi)


def thrust_limit(
    cohesion: ArrayLike, friction_angle: ArrayLike, area: ArrayLike, weight: ArrayLike
) -> FloatArray:
    """F_max = ½ (A c + W tan ϕ) in N, of ONE track; (3.1) is the sum of both.

    Args:
        cohesion: c ≥ 0, Pa.
        friction_angle: 0 ≤ ϕ < π/2, rad.
        area: A = 2 b l > 0 of both tracks, m².
        weight: W ≥ 0 of the vehicle, N.

    Raises:
        InputError: an argument is out of range.
    """
    a = validate("area", area, "m²", gt=0.0)
    w = validate("weight", weight, "N", ge=0.0)
    return 0.5 * a * shear_strength(w / a, cohesion, friction_angle)
