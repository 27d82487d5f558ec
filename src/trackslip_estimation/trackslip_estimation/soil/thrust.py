# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Thrust of both tracks from differential pressure (3.25), (3.27), with its variance, compiled.

    ΔP, b      differential pressure, offset of its transducer                Pa
    ω          sprocket speed                                                 rad/s
    F_d, F_b   thrust of ΔP − b, motor driving and motor driven               N
    π          probability that the motor drives: ΔP − b and ω have one sign  1
    F          π F_d + (1 − π) F_b                                            N
    σ²         variance of F by noise and offset + π (1 − π) (F_d − F_b)²    N²

Arrays (2,) are left, right. σ² excludes the error of the efficiency: it scales all thrusts alike and does not
average out.
"""

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_common.compiled import compiled
from trackslip_common.parameters import Parameters, parameter
from trackslip_common.record_types import Record, Table, dtype_of, make_table
from trackslip_common.vehicle import Vehicle
from trackslip_estimation.terramechanics.hydraulics import speed_of_flow, thrust_of_pressure

_NOISE_READINGS = 100  # number of readings over which their noise is a mean


class Transducers(Record):
    """What the readings show of both pressure transducers."""

    offset: Annotated[FloatArray, 2]  # Pa
    offset_variance: Annotated[FloatArray, 2]  # Pa²
    standstill_time: float  # s, with closed spools
    readings: Annotated[FloatArray, (2, 2)]  # of each, the newest and the one before, Pa; nan before
    noise: Annotated[FloatArray, 2]  # measured variance, Pa²


class ThrustRecord(Record):
    """Thrusts of both tracks."""

    is_known: int  # 1 from present pressures, 0 held
    force: Annotated[FloatArray, 2]  # N
    variance: Annotated[FloatArray, 2]  # N², without the error of the efficiency


class Motor(Record):
    """Constants of the travel motor of each track."""

    driving: float  # N of thrust per Pa, while the motor drives
    driven: float  # N of thrust per Pa, while the track drives the motor
    largest_thrust: float  # N, at the pressure of the relief valve
    full_flow_speed: float  # rad/s of the sprocket at the whole flow, without leakage


TRANSDUCERS, THRUST, MOTOR = dtype_of(Transducers), dtype_of(ThrustRecord), dtype_of(Motor)


@dataclass(frozen=True, kw_only=True)
class ThrustParameters(Parameters):
    """Errors of pressures, offsets and thrusts."""

    pressure_stddev: float = parameter(
        "noise of a pressure; the estimator takes a larger one from its readings", unit="Pa", gt=0.0
    )
    speed_stddev: float = parameter(
        "standard deviation of a sprocket speed; sets how certain its sign is", unit="rad/s", gt=0.0
    )
    efficiency_stddev: float = parameter(
        "relative standard deviation of η_m, common to all thrusts", ge=0.0, lt=1.0
    )
    offset_stddev: float = parameter(
        "initial standard deviation of the offset of a transducer", unit="Pa", gt=0.0
    )
    offset_limit: float = parameter(
        "largest offset; a larger pressure at standstill is trapped oil", unit="Pa", gt=0.0
    )
    offset_residue: float = parameter(
        "residual error of an offset that standstill does not reveal", unit="Pa", gt=0.0
    )
    persist_time: float = parameter(
        "standstill after which a pressure far from the known offset becomes the new offset", unit="s", gt=0.0
    )
    far_offset: float = parameter("standard deviations from the known offset that count as far", gt=0.0)
    offset_drift: float = parameter("random walk of an offset", unit="Pa/√s", ge=0.0)
    settling_time: float = parameter(
        "standstill with closed spools before offsets are estimated", unit="s", ge=0.0
    )
    closed_spool: float = parameter("spool position below which a valve is closed", gt=0.0, lt=1.0)
    unmeasured_walk: float = parameter(
        "random walk of a thrust while its pressure is unknown", unit="N/√s", gt=0.0
    )


def motor_of(vehicle: Vehicle) -> Table[Motor]:
    """Return the motor constants (1,) of a vehicle."""
    driving, driven = (float(thrust_of_pressure(1.0, sign, vehicle)) for sign in (1.0, -1.0))
    largest = float(thrust_of_pressure(vehicle.relief_pressure, 1.0, vehicle))
    full_flow = float(speed_of_flow(vehicle.pump_flow, 1.0, vehicle)) / vehicle.volumetric_efficiency
    motor = make_table(Motor, MOTOR, 1)
    motor["driving"], motor["driven"] = driving, driven
    motor["largest_thrust"], motor["full_flow_speed"] = largest, full_flow
    return motor


def new_transducers(p: ThrustParameters) -> Table[Transducers]:
    """Return the transducers (1,) before the first standstill."""
    transducers = make_table(Transducers, TRANSDUCERS, 1)
    transducers["offset_variance"], transducers["readings"] = p.offset_stddev**2, np.nan
    return transducers


def unknown_thrust(motor: Motor) -> Table[ThrustRecord]:
    """Return the thrust (1,) before the first pressure."""
    thrust = make_table(ThrustRecord, THRUST, 1)
    thrust["variance"] = motor["largest_thrust"] ** 2
    return thrust


@compiled
def update_offsets(
    transducers: Transducers, pressures: FloatArray, is_standing: bool, dt: float, p: ThrustParameters
) -> bool:
    """Propagate the offsets, random walks, by ``dt`` s; update them at standstill with closed spools.

    Return whether a pressure was rejected. One that is too large, or far from the known offset, is oil under
    load. A far one inflates the variance of the offset, so that it is accepted if it persists.
    """
    transducers.standstill_time = transducers.standstill_time + dt if is_standing else 0.0
    is_rejected = False
    for k in range(2):
        variance = min(transducers.offset_variance[k] + p.offset_drift**2 * dt, p.offset_stddev**2)
        if is_standing and transducers.standstill_time >= p.settling_time:
            innovation_variance = variance + p.pressure_stddev**2
            scaled_square = (pressures[k] - transducers.offset[k]) ** 2 / p.far_offset**2
            if abs(pressures[k]) > p.offset_limit:
                is_rejected = True
            elif scaled_square > innovation_variance:
                is_rejected = True
                variance += scaled_square * dt / p.persist_time
            else:
                gain = variance / innovation_variance
                transducers.offset[k] += gain * (pressures[k] - transducers.offset[k])
                variance *= 1.0 - gain
        transducers.offset_variance[k] = variance
    return is_rejected


@compiled
def update_noise(transducers: Transducers, reading: FloatArray, p: ThrustParameters) -> None:
    """Update the noise with the newest reading (2,), Pa: a second difference of white noise has 6 σ².

    Ripple of the pump is noise as well. What a motion adds counts as three standard deviations at most.
    """
    for k in range(2):
        newest, before = transducers.readings[k]
        if reading[k] == newest:
            continue
        transducers.readings[k, 0], transducers.readings[k, 1] = reading[k], newest
        square = (reading[k] - 2.0 * newest + before) ** 2 / 6.0
        if math.isfinite(square):
            most = 9.0 * max(transducers.noise[k], p.pressure_stddev**2)
            transducers.noise[k] += (min(square, most) - transducers.noise[k]) / _NOISE_READINGS


@compiled
def measure_thrust(
    thrust: ThrustRecord,
    pressures: FloatArray,
    speeds: FloatArray,
    transducers: Transducers,
    p: ThrustParameters,
    motor: Motor,
) -> None:
    """Set F and σ² from pressures (2,), Pa, and sprocket speeds (2,), rad/s; a speed may be nan."""
    thrust.is_known = True
    for k in range(2):
        # At standstill a slope or a little trapped oil is indistinguishable from an offset.
        variance = transducers.offset_variance[k] + p.offset_residue**2
        variance += max(p.pressure_stddev**2, transducers.noise[k])
        pressure = pressures[k] - transducers.offset[k]
        forward = 0.5 if math.isnan(speeds[k]) else _normal_cdf(speeds[k] / p.speed_stddev)
        positive = _normal_cdf(pressure / math.sqrt(variance))
        drives = forward * positive + (1.0 - forward) * (1.0 - positive)
        slope = drives * motor.driving + (1.0 - drives) * motor.driven
        direction_variance = drives * (1.0 - drives) * ((motor.driving - motor.driven) * pressure) ** 2
        thrust.force[k] = slope * pressure
        thrust.variance[k] = slope**2 * variance + direction_variance


@compiled
def hold_thrust(thrust: ThrustRecord, dt: float, p: ThrustParameters, motor: Motor) -> None:
    """Hold the thrusts for ``dt`` s; inflate their variances up to that of the relief pressure."""
    thrust.is_known = False
    for k in range(2):
        thrust.variance[k] = min(thrust.variance[k] + p.unmeasured_walk**2 * dt, motor.largest_thrust**2)


@compiled
def _normal_cdf(z: float) -> float:
    """Return the probability that a standard normal variable lies below z."""
    return 0.5 * (1.0 + math.erf(z / math.sqrt(2.0)))
