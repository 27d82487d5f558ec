# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""What spool and sprocket speed say of the volumetric efficiency; a hint for diagnostics, no more. Compiled.

Q      flow through an opened valve, spool position times pump flow   m³/s
ω_1    sprocket speed of the whole pump flow, without leakage         rad/s
η_V    ω V_m n_g/(2π) / Q = ω/(spool ω_1) while the motor drives      1
"""

import math
from dataclasses import dataclass

from trackslip_common.arrays import FloatArray
from trackslip_common.compiled import compiled
from trackslip_common.parameters import Parameters, parameter


@dataclass(frozen=True, kw_only=True)
class FlowParameters(Parameters):
    """When a flow is seen, and for how long it counts."""

    open_spool: float = parameter(
        "spool position from which on a valve's edges do not matter", gt=0.0, lt=1.0
    )
    memory: float = parameter("of driving after which a flow counts for 1/e", unit="s", gt=0.0)


@compiled
def volumetric_efficiency(
    before: float,
    spools: FloatArray,
    speeds: FloatArray,
    full_flow_speed: float,
    dt: float,
    p: FlowParameters,
) -> float:
    """η_V over the last seconds of steady driving; nan before the first of them.

    After ``dt`` s more with these spools (2,) and sprocket speeds (2,). ``full_flow_speed``: ω_1.
    """
    if not (abs(spools[0]) >= p.open_spool and abs(spools[1]) >= p.open_spool):
        return before
    seen = float(0.5 * (speeds[0] / spools[0] + speeds[1] / spools[1]) / full_flow_speed)
    if not math.isfinite(seen):
        return before
    return seen if math.isnan(before) else before - math.expm1(-dt / p.memory) * (seen - before)
