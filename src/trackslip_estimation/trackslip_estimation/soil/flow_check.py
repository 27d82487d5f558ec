# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""What spool and sprocket speed say of the volumetric efficiency; a hint for diagnostics, no more. Compiled.

Q      flow through an opened valve, spool position times pump flow   m³/s
ω_1    sprocket speed of the whole pump flow, without leakage         rad/s
η_V    ω V_m n_g/(2π) / Q = ω/(spool ω_1) while the motor drives      1
"""

import math

import numpy as np
from numpy.typing import NDArray

from trackslip_common.compiled import compiled

FloatArray = NDArray[np.float64]

_OPEN = 0.1  # of the spool's way: below it the valve's edges matter
_MEMORY = 10.0  # s


@compiled
def volumetric_efficiency(
    before: float, spools: FloatArray, speeds: FloatArray, full_flow_speed: float, dt: float
) -> float:
    """η_V over the last seconds of steady driving; nan before the first of them.

    After ``dt`` s more with these spools (2,) and sprocket speeds (2,). ``full_flow_speed``: ω_1.
    """
    if not (abs(spools[0]) >= _OPEN and abs(spools[1]) >= _OPEN):
        return before
    seen = float(0.5 * (speeds[0] / spools[0] + speeds[1] / spools[1]) / full_flow_speed)
    if not math.isfinite(seen):
        return before
    return seen if math.isnan(before) else before - math.expm1(-dt / _MEMORY) * (seen - before)
