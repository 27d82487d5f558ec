# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Volumetric efficiency from spool positions and sprocket speeds, for diagnostics only. Compiled.

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
    """Conditions and memory of the estimate of η_V."""

    open_spool: float = parameter(
        "spool position from which the metering edges of a valve are negligible", gt=0.0, lt=1.0
    )
    memory: float = parameter("driving time after which the weight of a flow falls to 1/e", unit="s", gt=0.0)


@compiled
def volumetric_efficiency(
    before: float,
    spools: FloatArray,
    speeds: FloatArray,
    full_flow_speed: float,
    dt: float,
    p: FlowParameters,
) -> float:
    """Return η_V as an exponential average over driving with open valves; nan before the first such sample.

    ``before``: η_V before this sample of ``dt`` s with ``spools`` (2,) and sprocket ``speeds`` (2,), rad/s.
    ``full_flow_speed``: ω_1.
    """
    if not (abs(spools[0]) >= p.open_spool and abs(spools[1]) >= p.open_spool):
        return before
    measured = float(0.5 * (speeds[0] / spools[0] + speeds[1] / spools[1]) / full_flow_speed)
    if not math.isfinite(measured):
        return before
    return measured if math.isnan(before) else before - math.expm1(-dt / p.memory) * (measured - before)
