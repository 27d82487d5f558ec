# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Motion resistance of a vehicle in straight motion; b is one track's width, forces are of both tracks.

b, s      width of one track, length of track in the soil     m
z_0       sinkage                                             m
n, k      exponent and modulus of sinkage (2.5)               1, Pa/m^n
R_c       resistance of the soil to compaction                N
R_b       bulldozing resistance                               N
R_l       drag of the soil that adheres to the track's sides  N
c, ϕ, γ   cohesion, friction angle, weight density            Pa, rad, N/m³
α         approach angle of the track to the ground           rad
K_c, K_γ  coefficients of passive earth pressure              1
k_r       coefficient of drag, 2 to 4 after Bekker            1
μ_r, R_j  coefficient of longitudinal resistance, its force on one track   1, N
"""

import math

import numpy as np
from numpy.typing import ArrayLike

from trackslip_common.arrays import FloatArray
from trackslip_estimation.terramechanics.domain import validate


def compaction_resistance(
    sinkage: ArrayLike, width: ArrayLike, modulus: ArrayLike, n: ArrayLike
) -> FloatArray:
    """R_c = 2 b k z_0^(n+1)/(n+1) in N, §2.5.4: the work of (2.5) per metre of travel.

    Args:
        sinkage: z_0 ≥ 0, m.
        width: b > 0, m.
        modulus: k > 0, Pa/m^n.
        n: > 0.

    Raises:
        InputError: an argument is out of range.
    """
    exponent = validate("n", n, gt=0.0) + 1.0
    k = validate("modulus", modulus, "Pa/m^n", gt=0.0)
    b = validate("width", width, "m", gt=0.0)
    return 2.0 * b * k * validate("sinkage", sinkage, "m", ge=0.0) ** exponent / exponent


def passive_earth_pressure(
    sinkage: ArrayLike, cohesion: ArrayLike, weight_density: ArrayLike, k_c: ArrayLike, k_gamma: ArrayLike
) -> FloatArray:
    """2 z_0 c K_c + γ z_0² K_γ in N per metre of width, the bracket of R_b in §2.5.4.

    Args:
        sinkage: z_0 ≥ 0, m.
        cohesion: c ≥ 0, Pa.
        weight_density: γ ≥ 0, N/m³.
        k_c: K_c ≥ 0.
        k_gamma: K_γ ≥ 0.

    Raises:
        InputError: an argument is out of range.
    """
    z = validate("sinkage", sinkage, "m", ge=0.0)
    cohesive = validate("cohesion", cohesion, "Pa", ge=0.0) * validate("k_c", k_c, ge=0.0)
    gravity = validate("weight_density", weight_density, "N/m³", ge=0.0) * validate(
        "k_gamma", k_gamma, ge=0.0
    )
    return 2.0 * z * cohesive + gravity * z**2


def bulldozing_resistance(
    earth_pressure: ArrayLike, width: ArrayLike, approach_angle: ArrayLike, friction_angle: ArrayLike
) -> FloatArray:
    """R_b = 2 b sin(α + ϕ)/(sin α cos ϕ) × ``passive_earth_pressure``, in N, §2.5.4.

    Args:
        earth_pressure: ≥ 0, N/m.
        width: b > 0, m.
        approach_angle: 0 < α < π, rad, with α + ϕ ≤ π.
        friction_angle: 0 ≤ ϕ < π/2, rad.

    Raises:
        InputError: an argument is out of range.
    """
    alpha = validate("approach_angle", approach_angle, "rad", gt=0.0, lt=math.pi)
    phi = validate("friction_angle", friction_angle, "rad", ge=0.0, lt=math.pi / 2)
    sum_of_angles = validate("approach_angle + friction_angle", alpha + phi, "rad", le=math.pi)
    b = validate("width", width, "m", gt=0.0)
    projection: FloatArray = np.sin(sum_of_angles) / (np.sin(alpha) * np.cos(phi))
    return 2.0 * b * projection * validate("earth_pressure", earth_pressure, "N/m", ge=0.0)


def drag_resistance(
    sinkage: ArrayLike, length: ArrayLike, cohesion: ArrayLike, coefficient: ArrayLike
) -> FloatArray:
    """R_l = 2 k_r z_0 s c in N, §2.5.4.

    Args:
        sinkage: z_0 ≥ 0, m.
        length: s > 0, m.
        cohesion: c ≥ 0, Pa.
        coefficient: k_r ≥ 0; Bekker gives 2 to 4.

    Raises:
        InputError: an argument is out of range.
    """
    side = validate("sinkage", sinkage, "m", ge=0.0) * validate("length", length, "m", gt=0.0)
    strength = validate("cohesion", cohesion, "Pa", ge=0.0)
    return 2.0 * validate("coefficient", coefficient, ge=0.0) * side * strength


def longitudinal_resistance(speed: ArrayLike, mu_r: ArrayLike, weight: ArrayLike) -> FloatArray:
    """R_j = ½ μ_r W sign(v_j) in N, of ONE track, (3.10); it acts against the motion, and is 0 at rest.

    Args:
        speed: v_j of the track's frame over the ground, m/s.
        mu_r: μ_r ≥ 0.
        weight: W ≥ 0 of the vehicle, N.

    Raises:
        InputError: an argument is out of range.
    """
    size = 0.5 * validate("mu_r", mu_r, ge=0.0) * validate("weight", weight, "N", ge=0.0)
    return size * np.sign(validate("speed", speed, "m/s"))
