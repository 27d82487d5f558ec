# SPDX-License-Identifier: Apache-2.0
"""Thrust of both tracks from differential pressure (3.25), (3.27), with its variance.

    ΔP, b      differential pressure, offset of its transducer                Pa
    ω          sprocket speed                                                 rad/s
    F_d, F_b   thrust of ΔP − b, motor driving and motor driven               N
    π          probability that the motor drives: ΔP − b and ω have one sign  1
    F          π F_d + (1 − π) F_b                                            N
    σ²         what noise and offset make of F, and π (1 − π) (F_d − F_b)²    N²

Arrays (2,) are left, right. The error of the efficiency is apart: it scales all thrusts alike and does not
average.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trackslip_common.parameters import Parameters, parameter
from trackslip_common.vehicle import Vehicle
from trackslip_estimation.terramechanics.hydraulics import thrust_of_pressure

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class ThrustParameters(Parameters):
    """How far pressures and what is made of them can be trusted."""

    pressure_stddev: float = parameter("noise of a pressure", unit="Pa", gt=0.0)
    speed_stddev: float = parameter("of a sprocket speed, about which its sign is open", unit="rad/s", gt=0.0)
    efficiency_stddev: float = parameter("of η_m, relative: an error of all thrusts", ge=0.0, lt=1.0)
    offset_stddev: float = parameter("offset of a transducer, before it is learned", unit="Pa", gt=0.0)
    offset_limit: float = parameter("beyond it a standing pressure is trapped, no offset", unit="Pa", gt=0.0)
    offset_residue: float = parameter("what standing cannot tell from an offset", unit="Pa", gt=0.0)
    offset_drift: float = parameter("walk of an offset", unit="Pa/√s", ge=0.0)
    settling_time: float = parameter("standing with closed spools, before offsets show", unit="s", ge=0.0)
    closed_spool: float = parameter("spool position below which a valve is closed", gt=0.0, lt=1.0)
    unseen_walk: float = parameter("of a thrust while its pressure is not known", unit="N/√s", gt=0.0)


@dataclass(frozen=True, eq=False)
class Thrust:
    """Of both tracks; (2,) each."""

    force: FloatArray  # N
    variance: FloatArray  # N², without the error of the efficiency

    def total_variance(self, efficiency_stddev: float) -> FloatArray:
        """N², with the error of the efficiency."""
        return self.variance + np.square(efficiency_stddev * self.force)


class PressureOffsets:
    """Offsets of the two transducers: a walk that is seen while the machine stands."""

    def __init__(self, p: ThrustParameters) -> None:
        self._p = p
        self.mean = np.zeros(2)
        self._variance = np.full(2, p.offset_stddev**2)
        self._stood = 0.0  # s with closed spools

    @property
    def variance(self) -> FloatArray:
        """(2,) Pa²; a slope or a little trapped oil looks like an offset, however long it is looked at."""
        return self._variance + self._p.offset_residue**2

    def step(self, standing: FloatArray | None, dt: float) -> None:
        """``dt`` s later: the pressures (2,) of a machine that stands with closed spools, else None."""
        p = self._p
        self._variance = np.minimum(self._variance + p.offset_drift**2 * dt, p.offset_stddev**2)
        self._stood = 0.0 if standing is None else self._stood + dt
        if standing is None or self._stood < p.settling_time:
            return
        gain = self._variance / (self._variance + p.pressure_stddev**2)
        gain = np.where(np.abs(standing) <= p.offset_limit, gain, 0.0)
        self.mean = self.mean + gain * (standing - self.mean)
        self._variance = (1.0 - gain) * self._variance


class ThrustMeter:
    """Pressures to thrusts, with offsets that are learned on the way."""

    def __init__(self, p: ThrustParameters, vehicle: Vehicle) -> None:
        self._p = p
        self.offsets = PressureOffsets(p)
        self._driving, self._driven = (float(thrust_of_pressure(1.0, way, vehicle)) for way in (1.0, -1.0))
        self._largest = float(thrust_of_pressure(vehicle.relief_pressure, 1.0, vehicle))

    def measure(self, pressures: FloatArray, speeds: FloatArray) -> Thrust:
        """F and σ² of pressures (2,), Pa, at sprocket speeds (2,), rad/s; a speed may be nan."""
        corrected = pressures - self.offsets.mean
        variances = self.offsets.variance + self._p.pressure_stddev**2
        left, right = map(self._of_track, corrected.tolist(), variances.tolist(), speeds.tolist())
        return Thrust(np.array((left[0], right[0])), np.array((left[1], right[1])))

    def _of_track(self, pressure: float, variance: float, speed: float) -> tuple[float, float]:
        """F and σ² of one track."""
        forward = 0.5 if math.isnan(speed) else _below(speed / self._p.speed_stddev)
        positive = _below(pressure / math.sqrt(variance))
        drives = forward * positive + (1.0 - forward) * (1.0 - positive)
        slope = drives * self._driving + (1.0 - drives) * self._driven
        either = drives * (1.0 - drives) * ((self._driving - self._driven) * pressure) ** 2
        return slope * pressure, slope**2 * variance + either

    def unseen(self, before: Thrust | None, dt: float) -> Thrust:
        """``dt`` s after ``before`` without pressures: the same, less certain, up to what relief allows."""
        if before is None:
            return Thrust(np.zeros(2), np.full(2, self._largest**2))
        grown = before.variance + self._p.unseen_walk**2 * dt
        return Thrust(before.force, np.minimum(grown, self._largest**2))


def _below(z: float) -> float:
    """Probability that a standard normal variable lies below z."""
    return 0.5 * (1.0 + math.erf(z / math.sqrt(2.0)))
