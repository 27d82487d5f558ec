# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""A χ² gate that widens while source and state disagree, for yaw rates, slips and odometry; compiled.

    d²      νᵀ S⁻¹ ν, used where d² ≤ w g
    g       χ² quantile; source and state are consistent where d² ≤ g
    w       1 until they have not been for the source's timeout, then ``relaxation`` per further timeout; of a
            silence no more than a timeout counts, and none where they agreed before

So a spike stays out, even the first reading after an outage, and a source that insists is believed in the
end: the time that takes grows with the logarithm of how far off it is. Poses, headings and swing angles are
weighed by the bank (``weighing``).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from trackslip_common.compiled import compiled

if TYPE_CHECKING:
    from trackslip_estimation.slip.config import Config
    from trackslip_estimation.slip.records import MeasurementRecord, State

_WIDEST = 100.0  # timeouts: beyond, the gate is open to anything finite


@compiled
def width(refused_ns: int, timeout_ns: int, relaxation: float) -> float:
    """w."""
    if refused_ns <= timeout_ns:
        return 1.0
    widened: float = relaxation ** min(refused_ns / timeout_ns - 1.0, _WIDEST)
    return widened


@compiled
def limit_of(state: State, measurement: MeasurementRecord, rows: int, c: Config) -> float:
    """w g of a measurement of so many rows."""
    source = measurement.source
    wide = width(state.refused_ns[source], c.timeouts_ns[source], c.gate_relaxation)
    return float(c.gate_limits[rows] * wide)


@compiled
def note_reception(state: State, measurement: MeasurementRecord, c: Config) -> None:
    """A source outside its gate insists for longer by the time since its last measurement, not by silence."""
    source = measurement.source
    if state.consistent_ns[source] >= state.received_ns[source]:
        state.refused_ns[source] = 0
    else:
        silent_ns = measurement.stamp_ns - state.received_ns[source]
        state.refused_ns[source] += min(max(silent_ns, 0), c.timeouts_ns[source])
    state.received_ns[source] = measurement.stamp_ns
