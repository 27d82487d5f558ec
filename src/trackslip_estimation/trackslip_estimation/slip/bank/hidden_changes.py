# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Odds of an earlier change of the motion, which the offset of a coarse receiver hides; compiled.

    b    offset of the receiver, as estimated by the branch                        (2,) m
    V    prior variance of b                                                       m²
    d    recent displacement, as predicted                                         (2,) m
    s    standard deviation of b due to the event: along d by slip, across d by bias   m

The offset absorbs time-correlated errors, so no fix contradicts the branch. The component of b in the
direction of s is N(0, V) if the receiver caused it, and N(0, V + s²) if slip or bias have changed. Sprockets
that failed cause an offset of any size in any direction.

Source: likelihood ratio of two zero-mean normal densities, Willsky & Jones (1976).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from trackslip_common.compiled import compiled
from trackslip_estimation.kalman.single_state import log_ratio
from trackslip_estimation.slip.bank.child import log_measurement_interval
from trackslip_estimation.slip.events import BIASED, FAILED, SLIPPED
from trackslip_estimation.slip.levers import is_heading_undetermined
from trackslip_estimation.slip.models.dispatch import has_velocity_errors
from trackslip_estimation.slip.models.model import X, Y
from trackslip_estimation.slip.records import GYROS, POSE, TRACKS
from trackslip_estimation.slip.source_faults import IS_HEALTHY, log_density_of_any_size
from trackslip_estimation.slip.source_offsets import (
    error_model,
    has_mostly_correlated_errors,
    pose_source_number,
)
from trackslip_estimation.slip.window import Window

if TYPE_CHECKING:
    from trackslip_estimation.slip.config import Config
    from trackslip_estimation.slip.records import State


@compiled
def log_odds_of_hidden_change(window: Window, p: int, k: int, event: int, c: Config) -> float:
    """ln of the odds that slip or bias changed earlier, or the sprockets failed (FAILED), against an offset.

    −∞ where fixes of this source, or this branch, cannot hide such a change.
    """
    m, before = window.measurements[k], window.states[p, k - 1]
    if m.kind != POSE or not (has_velocity_errors(c) and has_mostly_correlated_errors(before, m.source, c)):
        return -math.inf
    if not _can_have_changed(before, event, c):
        return -math.inf
    offset = before.offsets[pose_source_number(m.source, c)]
    errors, distance = error_model(offset, c), _recent_distance(window, m.source, k, c)
    is_observed = errors.observed >= errors.time and (event == FAILED or distance >= c.bank.least_distance)
    if before.fault[m.source] != IS_HEALTHY or not is_observed:
        return -math.inf
    if event == FAILED:
        odds = _log_odds_of_any_offset(before, m.source, offset.variance, c) + c.log_rates[FAILED, TRACKS]
    else:
        odds = _log_odds_of_change(window, before, m.source, k, event, c) + c.log_rates[event, m.source]
    return float(odds + log_measurement_interval(window, p, k, c))


@compiled
def _can_have_changed(before: State, event: int, c: Config) -> bool:
    """Whether what an event changes was sound before it, and shows the motion."""
    if event == BIASED:
        return bool(c.shows_motion[GYROS] == 1 and before.fault[GYROS] == IS_HEALTHY)
    if event == FAILED:
        return bool(before.fault[TRACKS] == IS_HEALTHY and not is_heading_undetermined(before))
    return True


@compiled
def _recent_distance(window: Window, source: int, k: int, c: Config) -> float:
    """Length of the recent displacement, m."""
    d = window.receivers[k, pose_source_number(source, c)].recent_displacement
    return math.hypot(d[X], d[Y])


@compiled
def _log_odds_of_any_offset(before: State, source: int, variance: float, c: Config) -> float:
    """ln of the density of the offset of a source, of any size, over that of N(0, ``variance``)."""
    first = c.offsets[source]
    squared = before.mean[first] ** 2 + before.mean[first + 1] ** 2
    any_size = log_density_of_any_size(max(squared, variance), c)
    return float(any_size + squared / (2.0 * variance) + math.log(2.0 * math.pi * variance))


@compiled
def _log_odds_of_change(window: Window, before: State, source: int, k: int, event: int, c: Config) -> float:
    """ln of the density of the offset after a change of slip or bias, over that without."""
    first, n = c.offsets[source], pose_source_number(source, c)
    east, north = window.receivers[k, n].recent_displacement
    distance, variance = math.hypot(east, north), before.offsets[n].variance
    offset = before.mean[first] * east + before.mean[first + 1] * north
    spread = c.events.slip_stddev * distance
    if event == BIASED:
        offset = before.mean[first + 1] * east - before.mean[first] * north
        spread = c.events.bias_stddev * c.receivers.longest_time / 2.0 * distance
    return log_ratio((offset / distance) ** 2, variance + spread**2, variance)


@compiled
def has_hidden_change(window: Window, p: int, k: int, c: Config) -> bool:
    """Whether an earlier change of the motion is likely enough for a child."""
    for event in (SLIPPED, BIASED, FAILED):
        if log_odds_of_hidden_change(window, p, k, event, c) > -c.bank.spawns:
            return True
    return False
