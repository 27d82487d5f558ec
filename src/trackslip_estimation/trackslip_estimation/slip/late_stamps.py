# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Whether the stamps of fixes err by more than their sources say; compiled.

    δ    delay of all fixes, over the stamp error σ_t, and its variance P         1
    m    its mean before any fix showed it                                        1
    v    its variance, had no fix shown it; it walks                              1
    w    the same, if stamps are late or early by ``events.late_stddev``          1

All fixes together are a measurement of δ − m with the variance R: 1/R = 1/P − 1/v. It is (δ − m) R/P, and of
N(0, R + w) if stamps are late, of N(0, R + v) if not. So no fix has to contradict: where stamps are late, δ
goes further than v lets it, slowly.

Source: Bayes factor of two normal priors, Kass & Raftery (1995).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from trackslip_common.compiled import compiled
from trackslip_estimation.kalman.single_state import exchange_prior, log_ratio
from trackslip_estimation.slip.models.dispatch import has_velocity_errors
from trackslip_estimation.slip.models.model import FIX_DELAY

if TYPE_CHECKING:
    from trackslip_estimation.slip.config import Config
    from trackslip_estimation.slip.records import State

_SHOWN = 0.8  # of v, which fixes leave at the most: before, any noise of theirs puts δ anywhere


@compiled
def begin_delay(state: State, c: Config) -> None:
    """No fix has shown the delay."""
    state.delay_variance = c.prior_variance[FIX_DELAY]


@compiled
def propagate_delay(state: State, dt: float, c: Config) -> None:
    """v, dt s later."""
    state.delay_variance += c.process_noise[0, 0, FIX_DELAY] * dt  # the same in any motion


@compiled
def log_odds_of_delay(state: State, source: int, c: Config) -> float:
    """ln of the odds that stamps of a source err by more than σ_t; −∞: they may already, or none shows it."""
    v, w, P = state.delay_variance, _late_variance(source, c), state.covariance[FIX_DELAY, FIX_DELAY]
    if not has_velocity_errors(c) or v >= w / 4.0 or not 0.0 < P < _SHOWN * v:
        return -math.inf
    R = 1.0 / (1.0 / P - 1.0 / v)
    shown = (state.mean[FIX_DELAY] - c.prior_mean[FIX_DELAY]) * R / P
    return float(log_ratio(shown * shown, R + w, R + v) + math.log(c.events.late_share))


@compiled
def open_delay(state: State, source: int, c: Config) -> None:
    """The variance of δ was w before any fix; what fixes have shown stays."""
    x, w, mean = state.mean[: c.size], _late_variance(source, c), c.prior_mean[FIX_DELAY]
    x[FIX_DELAY] -= mean
    exchange_prior(x, state.covariance[:], FIX_DELAY, state.delay_variance, w)
    x[FIX_DELAY] += mean
    state.delay_variance = w


@compiled
def _late_variance(source: int, c: Config) -> float:
    """w; 0 where stamps of a source have no error."""
    error = c.stamp_errors[source]
    return (c.events.late_stddev / error) ** 2 if error > 0.0 else 0.0
