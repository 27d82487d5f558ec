# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The hydraulic drive of one track: pressure, torque and thrust; flow and speed; valve and relief.

    ΔP       differential pressure over the travel motor     Pa
    T, F     torque at the sprocket, thrust at the track     N m, N
    ω        angular velocity of the sprocket                rad/s
    Q        flow through the motor                          m³/s
    V_m, n_g displacement per motor turn, gear ratio         m³, 1
    η_m, η_V mechanical and volumetric efficiency            1
    r        rolling radius                                  m
    C_d, A_v discharge coefficient, open area of the valve   1, m²
    ρ        density of the oil                              kg/m³

The side that supplies the power bears the losses. When the motor drives (ΔP and ω of one sign, or ω = 0)
the torque is η_m times the ideal one; when the track drives the motor it is 1/η_m times the ideal one.
"""

import math

import numpy as np
from numpy.typing import ArrayLike

from trackslip_common.arrays import FloatArray
from trackslip_common.vehicle import Vehicle
from trackslip_estimation.terramechanics.domain import validate


def torque(pressure: ArrayLike, speed: ArrayLike, vehicle: Vehicle) -> FloatArray:
    """T = η ΔP V_m n_g/(2π) in N m, (3.25), (3.27); η = η_m driving, 1/η_m braking.

    Args:
        pressure: ΔP, Pa.
        speed: ω, rad/s; only its sign matters.
        vehicle: supplies V_m, n_g, η_m.

    Raises:
        InputError: an argument is not finite.
    """
    dp = validate("pressure", pressure, "Pa")
    omega = validate("speed", speed, "rad/s")
    return dp * _swept_volume(vehicle) * _efficiency(dp, omega, vehicle.motor_efficiency)


def pressure_of_torque(moment: ArrayLike, speed: ArrayLike, vehicle: Vehicle) -> FloatArray:
    """ΔP in Pa that balances this torque: the inverse of ``torque``.

    Args:
        moment: T, N m.
        speed: ω, rad/s; only its sign matters.
        vehicle: supplies V_m, n_g, η_m.

    Raises:
        InputError: an argument is not finite.
    """
    t = validate("torque", moment, "N m")
    omega = validate("speed", speed, "rad/s")
    return t / (_swept_volume(vehicle) * _efficiency(t, omega, vehicle.motor_efficiency))


def thrust_of_pressure(pressure: ArrayLike, speed: ArrayLike, vehicle: Vehicle) -> FloatArray:
    """F = T/r in N of one track, (3.27).

    Args:
        pressure: ΔP, Pa.
        speed: ω, rad/s; only its sign matters.
        vehicle: supplies V_m, n_g, η_m, r.

    Raises:
        InputError: an argument is not finite.
    """
    return torque(pressure, speed, vehicle) / vehicle.rolling_radius


def pressure_of_thrust(force: ArrayLike, speed: ArrayLike, vehicle: Vehicle) -> FloatArray:
    """ΔP in Pa that this thrust of one track needs: the inverse of ``thrust_of_pressure``.

    Args:
        force: F, N.
        speed: ω, rad/s; only its sign matters.
        vehicle: supplies V_m, n_g, η_m, r.

    Raises:
        InputError: an argument is not finite.
    """
    return pressure_of_torque(validate("force", force, "N") * vehicle.rolling_radius, speed, vehicle)


def speed_of_flow(flow: ArrayLike, pressure: ArrayLike, vehicle: Vehicle) -> FloatArray:
    """ω = η 2π Q/(V_m n_g) in rad/s; η = η_V driving, 1/η_V braking (leakage follows the pressure).

    Args:
        flow: Q, m³/s.
        pressure: ΔP, Pa; only its sign matters, 0 counts as driving.
        vehicle: supplies V_m, n_g, η_V.

    Raises:
        InputError: an argument is not finite.
    """
    q = validate("flow", flow, "m³/s")
    dp = validate("pressure", pressure, "Pa")
    return q / _swept_volume(vehicle) * _efficiency(dp, q, vehicle.volumetric_efficiency)


def flow_of_speed(speed: ArrayLike, pressure: ArrayLike, vehicle: Vehicle) -> FloatArray:
    """Q in m³/s at this sprocket speed: the inverse of ``speed_of_flow``.

    Args:
        speed: ω, rad/s.
        pressure: ΔP, Pa; only its sign matters, 0 counts as driving.
        vehicle: supplies V_m, n_g, η_V.

    Raises:
        InputError: an argument is not finite.
    """
    omega = validate("speed", speed, "rad/s")
    dp = validate("pressure", pressure, "Pa")
    return omega * _swept_volume(vehicle) / _efficiency(dp, omega, vehicle.volumetric_efficiency)


def orifice_flow(
    pressure_drop: ArrayLike, area: ArrayLike, density: ArrayLike, discharge: ArrayLike
) -> FloatArray:
    """Q = C_d A_v √(2|Δp|/ρ) sign Δp in m³/s: turbulent flow through an open valve.

    Args:
        pressure_drop: Δp over the valve, Pa.
        area: A_v ≥ 0; spool position times its area gradient, m².
        density: ρ > 0, kg/m³.
        discharge: C_d, above 0 and at most 1.

    Raises:
        InputError: an argument is out of range.
    """
    drop = validate("pressure_drop", pressure_drop, "Pa")
    opening = validate("discharge", discharge, gt=0.0, le=1.0) * validate("area", area, "m²", ge=0.0)
    return (
        opening * np.sqrt(2.0 * np.abs(drop) / validate("density", density, "kg/m³", gt=0.0)) * np.sign(drop)
    )


def orifice_pressure_drop(
    flow: ArrayLike, area: ArrayLike, density: ArrayLike, discharge: ArrayLike
) -> FloatArray:
    """Δp = ½ ρ (Q/(C_d A_v))² sign Q in Pa: the inverse of ``orifice_flow``.

    Args:
        flow: Q, m³/s.
        area: A_v > 0, m²; a closed valve passes nothing at any pressure.
        density: ρ > 0, kg/m³.
        discharge: C_d, above 0 and at most 1.

    Raises:
        InputError: an argument is out of range.
    """
    q = validate("flow", flow, "m³/s")
    jet = q / (validate("discharge", discharge, gt=0.0, le=1.0) * validate("area", area, "m²", gt=0.0))
    return 0.5 * validate("density", density, "kg/m³", gt=0.0) * jet * np.abs(jet)


def relieved_pressure(pressure: ArrayLike, vehicle: Vehicle) -> FloatArray:
    """ΔP in Pa, limited by the relief valves to ± the relief pressure.

    Args:
        pressure: ΔP that the load requires, Pa.
        vehicle: supplies the relief pressure.

    Raises:
        InputError: an argument is not finite.
    """
    return np.clip(validate("pressure", pressure, "Pa"), -vehicle.relief_pressure, vehicle.relief_pressure)


def _swept_volume(vehicle: Vehicle) -> float:
    """V_m n_g/(2π): oil per radian of the sprocket, m³."""
    return vehicle.motor_displacement * vehicle.gear_ratio / (2.0 * math.pi)


def _efficiency(effort: FloatArray, motion: FloatArray, value: float) -> FloatArray:
    """η where effort and motion do not oppose each other (driving), else 1/η (braking)."""
    return np.where(np.sign(effort) * np.sign(motion) < 0.0, 1.0 / value, value)
