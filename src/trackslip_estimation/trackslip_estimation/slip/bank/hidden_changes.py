# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Odds of an earlier change of slip or gyro bias, which the offset of a coarse receiver hides; compiled.

    b    offset of the receiver, as estimated by the branch                        (2,) m
    V    prior variance of b                                                       m²
    d    recent displacement, as predicted                                         (2,) m
    s    standard deviation of b due to the event: along d by slip, across d by bias   m

The offset absorbs time-correlated errors, so no fix contradicts the branch. The component of b in the
direction of s is N(0, V) if the receiver caused it, and N(0, V + s²) if the event has happened.

Source: likelihood ratio of two zero-mean normal densities, Willsky & Jones (1976).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from trackslip_common.compiled import compiled
from trackslip_estimation.kalman.single_state import log_ratio
from trackslip_estimation.slip.bank.child import log_measurement_interval
from trackslip_estimation.slip.events import BIASED, SLIPPED
from trackslip_estimation.slip.models.dispatch import has_velocity_errors
from trackslip_estimation.slip.records import GYROS, POSE
from trackslip_estimation.slip.source_faults import IS_HEALTHY
from trackslip_estimation.slip.source_offsets import (
    error_model,
    has_mostly_correlated_errors,
    pose_source_number,
)
from trackslip_estimation.slip.window import Window

if TYPE_CHECKING:
    from trackslip_estimation.slip.config import Config


@compiled
def log_odds_of_hidden_change(window: Window, p: int, k: int, event: int, c: Config) -> float:
    """ln of the odds that slip or bias changed earlier, against an offset of the coarse receiver alone.

    −∞ where fixes of this source, or this branch, cannot hide such a change.
    """
    m, before = window.measurements[k], window.states[p, k - 1]
    if m.kind != POSE or not (has_velocity_errors(c) and has_mostly_correlated_errors(before, m.source, c)):
        return -math.inf
    if event == BIASED and (c.shows_motion[GYROS] == 0 or before.fault[GYROS] != IS_HEALTHY):
        return -math.inf
    n = pose_source_number(m.source, c)
    east, north = window.receivers[k, n].recent_displacement
    first, variance = c.offsets[m.source], before.offsets[n].variance
    distance, errors = math.hypot(east, north), error_model(before.offsets[n], c)
    is_observed = distance >= c.bank.least_distance and errors.observed >= errors.time
    if before.fault[m.source] != IS_HEALTHY or not is_observed:
        return -math.inf
    offset = before.mean[first] * east + before.mean[first + 1] * north
    spread = c.events.slip_stddev * distance
    if event == BIASED:
        offset = before.mean[first + 1] * east - before.mean[first] * north
        spread = c.events.bias_stddev * c.receivers.longest_time / 2.0 * distance
    odds = log_ratio((offset / distance) ** 2, variance + spread**2, variance)
    return float(odds + log_measurement_interval(window, p, k, c) + c.log_rates[event, m.source])


@compiled
def has_hidden_change(window: Window, p: int, k: int, c: Config) -> bool:
    """Whether an earlier change of slip or bias is likely enough for a child."""
    slipped = log_odds_of_hidden_change(window, p, k, SLIPPED, c)
    biased = log_odds_of_hidden_change(window, p, k, BIASED, c)
    return bool(max(slipped, biased) > -c.bank.spawns)
