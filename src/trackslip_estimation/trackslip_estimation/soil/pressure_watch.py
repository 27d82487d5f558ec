# SPDX-License-Identifier: Apache-2.0
"""Tells pressures that cannot be true, by name: dropped, stuck, swapped, in another unit, beyond relief.

What is seen of each fault is gathered over time: for it a moment counts up, against it one counts down. From
the first doubt on no pressure is used; a fault is named once the doubt has lasted, and until it is gone.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from trackslip_common.parameters import Parameters, parameter
from trackslip_common.vehicle import Vehicle
from trackslip_estimation.slip.motion import Motion
from trackslip_estimation.soil.moments import Pressures

FloatArray = NDArray[np.float64]

_TYPICAL = 5e6  # Pa over a travel motor of a machine that drives: 20 to 80 bar on the four soils
_MOVING = (Motion.STRAIGHT, Motion.TURNING)


class PressureFault(Enum):
    """What is wrong, as diagnostics say it."""

    DROPPED = "hydraulics silent"
    LEFT_STUCK = "left pressure stuck"
    RIGHT_STUCK = "right pressure stuck"
    BEYOND_RELIEF = "pressure beyond the relief valve's"
    SWAPPED = "left and right pressure swapped"
    IN_KPA = "pressure in kPa instead of Pa"
    IN_PSI = "pressure in psi instead of Pa"
    IN_BAR = "pressure in bar instead of Pa"
    IN_MPA = "pressure in MPa instead of Pa"
    TOO_LOW = "too little pressure to drive, in any unit"


_UNITS: Mapping[PressureFault, float] = MappingProxyType(
    {
        PressureFault.IN_KPA: 1e3,
        PressureFault.IN_PSI: 6894.757,
        PressureFault.IN_BAR: 1e5,
        PressureFault.IN_MPA: 1e6,
    }
)  # Pa


@dataclass(frozen=True, kw_only=True)
class WatchParameters(Parameters):
    """When pressures are doubted."""

    naming_time: float = parameter("for which a doubt must last to be named a fault", unit="s", gt=0.0)
    grace_time: float = parameter("for which two equal readings are chance", unit="s", ge=0.0)
    relief_margin: float = parameter("over the relief pressure, as share of it", ge=0.0)
    least_pressure: float = parameter("sum of both that driving needs at the least", unit="Pa", gt=0.0)
    least_speed: float = parameter("track speed that counts as driving", unit="m/s", gt=0.0)
    telling_difference: float = parameter(
        "between both in a turn, beyond which it tells which is which", unit="Pa", gt=0.0
    )


class _Doubt:
    """Seconds for a fault, less those against it."""

    def __init__(self, grace: float, naming_time: float) -> None:
        self._grace, self._naming_time = grace, naming_time
        self._seconds = 0.0
        self.named = False

    def add(self, speaks_for: bool | None, dt: float) -> bool:
        """One more moment, None where it says nothing; whether there is doubt now."""
        if speaks_for is not None:
            change = dt if speaks_for else -dt
            self._seconds = min(max(self._seconds + change, 0.0), self._naming_time)
        self.named = self._seconds > 0.0 and (self.named or self._seconds >= self._naming_time)
        return self.named or (speaks_for is True and self._seconds > self._grace)

    def forget(self) -> None:
        """Nothing speaks for it any more."""
        self._seconds, self.named = 0.0, False


class PressureWatch:
    """Judges the pressures of one moment after the other."""

    def __init__(self, p: WatchParameters, vehicle: Vehicle) -> None:
        self._p = p
        self._highest = (1.0 + p.relief_margin) * vehicle.relief_pressure
        self._doubts = {fault: _Doubt(0.0, p.naming_time) for fault in PressureFault}
        for stuck in (PressureFault.LEFT_STUCK, PressureFault.RIGHT_STUCK):
            self._doubts[stuck] = _Doubt(p.grace_time, p.naming_time)
        self._before: Pressures | None = None

    @property
    def faults(self) -> tuple[PressureFault, ...]:
        """Those that stand."""
        return tuple(fault for fault, doubt in self._doubts.items() if doubt.named)

    def judge(
        self, pressures: Pressures | None, tracks: FloatArray, motion: Motion, dt: float
    ) -> PressureFault | None:
        """Why the pressures of this moment are not to be used; None where they are.

        ``tracks`` (2,): track speeds, m/s; ``dt``: s since the moment before.
        """
        missing = self._doubts[PressureFault.DROPPED].add(pressures is None, dt)
        if pressures is None:
            return PressureFault.DROPPED
        seen = {
            **self._stuck(pressures, tracks, dt),
            PressureFault.BEYOND_RELIEF: bool((np.abs(pressures.values) > self._highest).any()),
            **self._too_low(pressures, tracks, motion),
            PressureFault.SWAPPED: self._crossed(pressures, tracks, motion),
        }
        self._before = pressures
        doubted = [fault for fault, for_it in seen.items() if self._doubts[fault].add(for_it, dt)]
        if missing:
            doubted.insert(0, PressureFault.DROPPED)
        return doubted[0] if doubted else None

    def _stuck(self, now: Pressures, tracks: FloatArray, dt: float) -> dict[PressureFault, bool | None]:
        """A pressure that drives or brakes a track is never still; that of a standing one may be."""
        seen: dict[PressureFault, bool | None] = {}
        for fault, side in ((PressureFault.LEFT_STUCK, "left"), (PressureFault.RIGHT_STUCK, "right")):
            seen[fault] = None
            if self._before is None or now.latest.stamp_ns == self._before.latest.stamp_ns:
                continue
            name = f"{side}_pressure"
            if getattr(now.latest, name) != getattr(self._before.latest, name):
                self._doubts[fault].forget()
            elif (np.abs(tracks) > self._p.least_speed).any():
                seen[fault] = True
        return seen

    def _too_low(
        self, now: Pressures, tracks: FloatArray, motion: Motion
    ) -> dict[PressureFault, bool | None]:
        """Driving against rolling resistance needs pressure: what reads less is in a larger unit."""
        faults = (*_UNITS, PressureFault.TOO_LOW)
        if motion not in _MOVING or not (np.abs(tracks) > self._p.least_speed).all():
            return dict.fromkeys(faults)
        total = float(np.abs(now.values).sum())
        likely = _unit_of(0.5 * total) if total < self._p.least_pressure else None
        return {fault: fault is likely for fault in faults}

    def _crossed(self, now: Pressures, tracks: FloatArray, motion: Motion) -> bool | None:
        """The faster track of a turn slips more and pulls more, forwards and in reverse."""
        left, right = now.values
        if motion is not Motion.TURNING or abs(right - left) < self._p.telling_difference:
            return None
        return bool((right - left) * (tracks[1] - tracks[0]) < 0.0)


def _unit_of(reading: float) -> PressureFault:
    """The unit in which a reading is nearest to what is typical."""
    if reading <= 0.0:
        return PressureFault.TOO_LOW
    likely = min(_UNITS, key=lambda unit: abs(np.log(reading * _UNITS[unit] / _TYPICAL)))
    plausible = 0.1 < reading * _UNITS[likely] / _TYPICAL < 10.0
    return likely if plausible else PressureFault.TOO_LOW
