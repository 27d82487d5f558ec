# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Changes that a coarse receiver hides: whether slip or gyro bias changed a while ago; compiled.

    b    offset of the receiver, as the branch has it                              (2,) m
    V    its variance a priori                                                     m²
    d    way of late, as predicted                                                 (2,) m
    s    what the event may have made of it: of d by a slip, across d by a bias    m

An offset follows whatever lasts, so that nothing contradicts. Along s it is N(0, V) if it is the receiver's
own, and N(0, V + s²) if the event has happened.

Source: likelihood ratio of two zero-mean normal densities, Willsky & Jones (1976).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from trackslip_common.compiled import compiled
from trackslip_estimation.kalman.single_state import log_ratio
from trackslip_estimation.slip.bank.child import log_time
from trackslip_estimation.slip.events import BIASED, SLIPPED
from trackslip_estimation.slip.models.dispatch import has_velocity_errors
from trackslip_estimation.slip.records import GYROS, POSE
from trackslip_estimation.slip.source_faults import IS_HEALTHY
from trackslip_estimation.slip.source_offsets import errors_of, is_correlated, number_of
from trackslip_estimation.slip.window import Window

if TYPE_CHECKING:
    from trackslip_estimation.slip.config import Config


@compiled
def log_odds_of_lag(window: Window, p: int, k: int, event: int, c: Config) -> float:
    """ln of the odds that slip or bias changed a while ago, and not that fixes of a coarse receiver went off.

    −∞ where this source's fixes, or this branch, cannot hide such a change.
    """
    m, before = window.measurements[k], window.states[p, k - 1]
    if m.kind != POSE or not (has_velocity_errors(c) and is_correlated(before, m.source, c)):
        return -math.inf
    if event == BIASED and (c.shows_motion[GYROS] == 0 or before.fault[GYROS] != IS_HEALTHY):
        return -math.inf
    n = number_of(m.source, c)
    east, north = window.receivers[k, n].recent_displacement
    own, usual = c.offsets[m.source], before.offsets[n].variance
    distance, found = math.hypot(east, north), errors_of(before.offsets[n], c)
    is_observed = distance >= c.bank.least_distance and found.observed >= found.time
    if before.fault[m.source] != IS_HEALTHY or not is_observed:
        return -math.inf
    off = before.mean[own] * east + before.mean[own + 1] * north
    spread = c.events.slip_stddev * distance
    if event == BIASED:
        off = before.mean[own + 1] * east - before.mean[own] * north
        spread = c.events.bias_stddev * c.receivers.longest_time / 2.0 * distance
    odds = log_ratio((off / distance) ** 2, usual + spread**2, usual)
    return float(odds + log_time(window, p, k, c) + c.log_rates[event, m.source])


@compiled
def is_behind(window: Window, p: int, k: int, c: Config) -> bool:
    """Whether what changed a while ago may have become an offset of a receiver."""
    slipped, biased = log_odds_of_lag(window, p, k, SLIPPED, c), log_odds_of_lag(window, p, k, BIASED, c)
    return bool(max(slipped, biased) > -c.bank.spawns)
