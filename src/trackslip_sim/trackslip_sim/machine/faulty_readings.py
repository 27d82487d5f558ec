# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Faults of measurement: stuck sensors, additional noise, occlusion."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_drivers.records import HydraulicsSample, ImuSample, SprocketSample, Vector
from trackslip_sim.machine import faults as f
from trackslip_sim.machine.faults import Faults
from trackslip_sim.machine.sensors import MachineSensors

T = TypeVar("T")

_OCCLUSION_RANGE = 0.5  # m, distance of an occlusion
_POLLUTION_BIT = 0x80  # bit of the scanner's status


@dataclass(frozen=True)
class FullScales:
    """Full scale of each quantity, to which the shares of noise refer."""

    pressure: float  # Pa
    acceleration: float  # m/s²
    rate: float  # rad/s
    field: float  # T
    range: float  # m


class FaultyReadings:
    """The readings of ``sensors`` and ``scan`` with the faults active at their stamp."""

    def __init__(
        self,
        faults: Faults,
        sensors: MachineSensors,
        scan: Callable[[int], FloatArray],
        full_scales: FullScales,
        seed: int,
    ) -> None:
        self._faults = faults
        self._sensors = sensors
        self._scan = scan
        self._full_scales = full_scales
        self._random = np.random.default_rng(seed)
        self._stuck_readings: dict[str, object] = {}

    def sprockets(self, stamp_ns: int) -> SprocketSample:
        """Encoder readings, possibly stuck; encoders have no noise."""
        return self._current_or_stuck("sprockets", f.CAN, stamp_ns, self._sensors.sprockets)

    def hydraulics(self, stamp_ns: int) -> HydraulicsSample:
        """Hydraulics; a fault adds noise to the pressures."""
        sample = self._current_or_stuck("hydraulics", f.CAN, stamp_ns, self._sensors.hydraulics)
        noise = self._noise(f.CAN, stamp_ns, 3)
        if noise is None:
            return sample
        left, right, supply = noise * self._full_scales.pressure
        return sample._replace(
            left_pressure=sample.left_pressure + float(left),
            right_pressure=sample.right_pressure + float(right),
            supply_pressure=sample.supply_pressure + float(supply),
        )

    def imu(self, stamp_ns: int) -> ImuSample:
        """Inertial readings; a fault adds noise to all channels."""
        sample = self._current_or_stuck("imu", f.WATSON, stamp_ns, self._sensors.imu)
        noise = self._noise(f.WATSON, stamp_ns, 9)
        if noise is None:
            return sample
        field = sample.magnetic_field
        return sample._replace(
            acceleration=_add_noise(sample.acceleration, noise[0:3] * self._full_scales.acceleration),
            angular_velocity=_add_noise(sample.angular_velocity, noise[3:6] * self._full_scales.rate),
            magnetic_field=None if field is None else _add_noise(field, noise[6:9] * self._full_scales.field),
        )

    def ranges(self, stamp_ns: int) -> FloatArray:
        """Ranges (361,), m; nan where glare hides the target."""
        ranges = self._current_or_stuck("ranges", f.SICK, stamp_ns, self._scan)
        noise = self._noise(f.SICK, stamp_ns, len(ranges))
        ranges = np.maximum(ranges if noise is None else ranges + noise * self._full_scales.range, 0.0)
        if occlusion := self._faults.active_fault(f.SICK, f.OCCLUSION, stamp_ns):
            angles = np.linspace(-np.pi / 2.0, np.pi / 2.0, len(ranges))
            ranges = np.where(
                np.abs(angles) <= occlusion.value / 2.0, np.minimum(ranges, _OCCLUSION_RANGE), ranges
            )
        if glare := self._faults.active_fault(f.SICK, f.GLARE, stamp_ns):
            ranges = np.where(self._random.random(len(ranges)) < glare.value, np.nan, ranges)
        return ranges

    def status(self, stamp_ns: int) -> int:
        """The status byte of the scanner."""
        return _POLLUTION_BIT if self._faults.active_fault(f.SICK, f.POLLUTION, stamp_ns) else 0

    def _current_or_stuck(self, name: str, sensor: str, stamp_ns: int, read: Callable[[int], T]) -> T:
        """The current reading, or while stuck the reading at the begin of the fault."""
        if self._faults.active_fault(sensor, f.STUCK, stamp_ns) is None:
            self._stuck_readings.pop(name, None)
            return read(stamp_ns)
        if name not in self._stuck_readings:
            self._stuck_readings[name] = read(stamp_ns)
        return self._stuck_readings[name]  # type: ignore[return-value]  # each name holds one type

    def _noise(self, sensor: str, stamp_ns: int, count: int) -> FloatArray | None:
        """(count,) additional noise as a share of full scale; None without the fault."""
        fault = self._faults.active_fault(sensor, f.NOISE, stamp_ns)
        return None if fault is None else fault.value * self._random.standard_normal(count)


def _add_noise(vector: Vector, noise: FloatArray) -> Vector:
    x, y, z = (value + float(extra) for value, extra in zip(vector, noise, strict=True))
    return x, y, z
