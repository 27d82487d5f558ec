# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Pressure and sinkage of a track, taken as a rigid plate.

p, z      normal pressure, sinkage                          Pa, m
b         smaller side of the plate: width of a track       m
n         exponent of sinkage                               1
k_c, k_ϕ  Bekker's moduli                                   N/m^(n+1), N/m^(n+2)
k         modulus of sinkage k_c/b + k_ϕ                    Pa/m^n
p_u, z_u  pressure and sinkage where unloading begins       Pa, m
k_u       stiffness while unloading and reloading           Pa/m
k_0, A_u  its value at the surface, its growth with z_u     Pa/m, Pa/m²
k'_c, k'_ϕ  Reece's dimensionless moduli                    1
γ_s       weight density of the soil                        N/m³
"""

import numpy as np
from numpy.typing import ArrayLike

from trackslip_common.arrays import FloatArray
from trackslip_common.errors import InputError
from trackslip_estimation.terramechanics.domain import validate


def bekker_modulus(k_c: ArrayLike, k_phi: ArrayLike, width: ArrayLike) -> FloatArray:
    """Modulus k = k_c/b + k_ϕ in Pa/m^n, of (2.5).

    Args:
        k_c: ≥ 0, N/m^(n+1).
        k_phi: ≥ 0, N/m^(n+2).
        width: b > 0, m.

    Raises:
        InputError: an argument is out of range.
    """
    cohesive = validate("k_c", k_c, "N/m^(n+1)", ge=0.0)
    frictional = validate("k_phi", k_phi, "N/m^(n+2)", ge=0.0)
    return cohesive / validate("width", width, "m", gt=0.0) + frictional


def bekker_pressure(sinkage: ArrayLike, modulus: ArrayLike, n: ArrayLike) -> FloatArray:
    """Pressure p = k zⁿ in Pa, (2.5).

    Args:
        sinkage: z ≥ 0, m.
        modulus: k > 0, Pa/m^n; ``bekker_modulus``.
        n: > 0.

    Raises:
        InputError: an argument is out of range.
    """
    k, exponent = _modulus_and_exponent(modulus, n)
    return k * validate("sinkage", sinkage, "m", ge=0.0) ** exponent


def bekker_sinkage(pressure: ArrayLike, modulus: ArrayLike, n: ArrayLike) -> FloatArray:
    """Sinkage z = (p/k)^(1/n) in m, the inverse of (2.5).

    Args:
        pressure: p ≥ 0, Pa.
        modulus: k > 0, Pa/m^n.
        n: > 0.

    Raises:
        InputError: an argument is out of range.
    """
    k, exponent = _modulus_and_exponent(modulus, n)
    return (validate("pressure", pressure, "Pa", ge=0.0) / k) ** (1.0 / exponent)


def unloading_stiffness(unloading_sinkage: ArrayLike, k_0: ArrayLike, a_u: ArrayLike) -> FloatArray:
    """Stiffness k_u = k_0 + A_u z_u in Pa/m, (2.7).

    Args:
        unloading_sinkage: z_u ≥ 0, m.
        k_0: ≥ 0, Pa/m.
        a_u: A_u ≥ 0, Pa/m².

    Raises:
        InputError: an argument is out of range.
    """
    z_u = validate("unloading_sinkage", unloading_sinkage, "m", ge=0.0)
    return validate("k_0", k_0, "Pa/m", ge=0.0) + validate("a_u", a_u, "Pa/m²", ge=0.0) * z_u


def unloading_pressure(
    sinkage: ArrayLike, unloading_sinkage: ArrayLike, unloading_pressure: ArrayLike, stiffness: ArrayLike
) -> FloatArray:
    """Pressure p = p_u − k_u (z_u − z) in Pa, (2.6), while the track unloads or loads again.

    Zero where the line falls below it: soil does not pull. Beyond z_u the soil is fresh: (2.5) holds there.

    Args:
        sinkage: 0 ≤ z ≤ z_u, m.
        unloading_sinkage: z_u, m.
        unloading_pressure: p_u ≥ 0, Pa.
        stiffness: k_u ≥ 0, Pa/m; ``unloading_stiffness``.

    Raises:
        InputError: an argument is out of range.
    """
    z = validate("sinkage", sinkage, "m", ge=0.0)
    z_u = validate("unloading_sinkage", unloading_sinkage, "m", ge=0.0)
    p_u = validate("unloading_pressure", unloading_pressure, "Pa", ge=0.0)
    if np.any(z > z_u):
        excess = float(np.max(z - z_u))
        raise InputError(
            f"sinkage = unloading_sinkage + {excess:g} m is refused; accepted: <= unloading_sinkage"
        )
    return np.maximum(p_u - validate("stiffness", stiffness, "Pa/m", ge=0.0) * (z_u - z), 0.0)


def reece_modulus(
    cohesion: ArrayLike, k_c: ArrayLike, weight_density: ArrayLike, k_phi: ArrayLike, width: ArrayLike
) -> FloatArray:
    """The bracket c k'_c + γ_s b k'_ϕ in Pa, of (2.8).

    Args:
        cohesion: c ≥ 0, Pa.
        k_c: k'_c ≥ 0.
        weight_density: γ_s ≥ 0, N/m³.
        k_phi: k'_ϕ ≥ 0.
        width: b > 0, m.

    Raises:
        InputError: an argument is out of range.
    """
    cohesive = validate("cohesion", cohesion, "Pa", ge=0.0) * validate("k_c", k_c, ge=0.0)
    surface = validate("weight_density", weight_density, "N/m³", ge=0.0) * validate(
        "width", width, "m", gt=0.0
    )
    return cohesive + surface * validate("k_phi", k_phi, ge=0.0)


def reece_pressure(sinkage: ArrayLike, width: ArrayLike, modulus: ArrayLike, n: ArrayLike) -> FloatArray:
    """Pressure p = (c k'_c + γ_s b k'_ϕ) (z/b)ⁿ in Pa, (2.8).

    Args:
        sinkage: z ≥ 0, m.
        width: b > 0, m.
        modulus: the bracket, > 0, Pa; ``reece_modulus``.
        n: > 0.

    Raises:
        InputError: an argument is out of range.
    """
    b = validate("width", width, "m", gt=0.0)
    return bekker_pressure(validate("sinkage", sinkage, "m", ge=0.0) / b, modulus, n)


def _modulus_and_exponent(modulus: ArrayLike, n: ArrayLike) -> tuple[FloatArray, FloatArray]:
    return validate("modulus", modulus, "Pa/m^n", gt=0.0), validate("n", n, gt=0.0)
