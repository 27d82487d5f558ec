# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""A χ² gate that widens while measurements are inconsistent, for yaw rates, slips and odometry; compiled.

    d²      NIS νᵀ S⁻¹ ν; the measurement is accepted where d² ≤ w g
    g       χ² quantile; source and state are consistent where d² ≤ g
    w       1 until the rejection time exceeds the source's timeout, then ``relaxation`` to the power of the
            further timeouts; a silence counts up to one timeout, and not after a consistent measurement

The gate rejects a spike, even as the first reading after an outage. It accepts a source that stays
inconsistent, after a time that grows with the logarithm of its error. The bank weighs poses, headings and
swing angles instead (``weighing``).

A branch that rejects a measurement assumes an outlier, at the cost of its weight, and gets children in which
sprockets, gyros or an odometry fail. So a branch in which the machine stands loses against one in which the
sprockets fail, if a gyro shows a rotation. Measurements within the gate change no weight: the noise of each
branch adapts to them.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from trackslip_common.compiled import compiled

if TYPE_CHECKING:
    from trackslip_estimation.slip.config import Config
    from trackslip_estimation.slip.records import MeasurementRecord, State

_WIDEST = 100.0  # further timeouts, at which w stops growing: the gate then accepts any finite d²


@compiled
def gate_factor(rejected_ns: int, timeout_ns: int, relaxation: float) -> float:
    """w, after a rejection time ``rejected_ns``."""
    if rejected_ns <= timeout_ns:
        return 1.0
    widened: float = relaxation ** min(rejected_ns / timeout_ns - 1.0, _WIDEST)
    return widened


@compiled
def gate_limit(state: State, measurement: MeasurementRecord, rows: int, c: Config) -> float:
    """Gate w g of a measurement with ``rows`` degrees of freedom."""
    source = measurement.source
    factor = gate_factor(state.rejected_ns[source], c.timeouts_ns[source], c.gate_relaxation)
    return float(c.gate_limits[rows] * factor)


@compiled
def update_rejection_time(state: State, measurement: MeasurementRecord, c: Config) -> None:
    """Add the time since the previous measurement, up to a timeout, to the rejection time, or reset it."""
    source = measurement.source
    if state.consistent_ns[source] >= state.received_ns[source]:
        state.rejected_ns[source] = 0
    else:
        elapsed_ns = measurement.stamp_ns - state.received_ns[source]
        state.rejected_ns[source] += min(max(elapsed_ns, 0), c.timeouts_ns[source])
    state.received_ns[source] = measurement.stamp_ns


@compiled
def log_probability_of_rejection(elapsed: float, c: Config) -> float:
    """ln of the probability of a rejection, ``elapsed`` s after the source's previous measurement.

    Velocity errors last for τ, so rejections within τ together count as one outlier.
    """
    return min(elapsed / c.velocity_errors.time, 1.0) * math.log(c.bank.initial_outlier_share)
