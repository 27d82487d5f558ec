# SPDX-License-Identifier: Apache-2.0
"""What spool and sprocket speed say of the volumetric efficiency; a hint for diagnostics, no more.

Q      flow through an opened valve, spool position times pump flow   m³/s
η_V    ω V_m n_g/(2π) / Q while the motor drives                       1
"""

import math

import numpy as np
from numpy.typing import NDArray

from trackslip_common.vehicle import Vehicle
from trackslip_estimation.terramechanics.hydraulics import speed_of_flow

FloatArray = NDArray[np.float64]

_OPEN = 0.1  # of the spool's way: below it the valve's edges matter
_MEMORY = 10.0  # s


class FlowCheck:
    """η_V as seen over the last seconds of straight driving; None before the first of them."""

    def __init__(self, vehicle: Vehicle) -> None:
        self._vehicle = vehicle
        self.efficiency: float | None = None

    def add(self, spools: FloatArray, speeds: FloatArray, dt: float) -> None:
        """``dt`` s of steady driving with these spools (2,) and sprocket speeds (2,)."""
        expected = speed_of_flow(spools * self._vehicle.pump_flow, spools, self._vehicle)
        if not np.isfinite(speeds).all() or (np.abs(spools) < _OPEN).any():
            return
        seen = self._vehicle.volumetric_efficiency * float(np.mean(speeds / expected))
        share = 1.0 if self.efficiency is None else -math.expm1(-dt / _MEMORY)
        self.efficiency = (self.efficiency or 0.0) + share * (seen - (self.efficiency or 0.0))
