# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Odds that stamps of fixes have larger errors than configured; compiled.

    δ    delay of all fixes, over the stamp error σ_t, and its variance P         1
    m    prior mean of δ                                                          1
    v    variance of δ without the information of fixes; a random walk            1
    w    prior variance of δ if stamps are late or early by ``events.late_stddev``   1

All fixes together measure δ − m with the variance R: 1/R = 1/P − 1/v. The measured value is (δ − m) R/P. Its
distribution is N(0, R + w) if stamps are late or early, otherwise N(0, R + v). No single fix needs to exceed
its gate: wrong stamps shift δ slowly beyond the range of v.

Source: Bayes factor of two normal priors, Kass & Raftery (1995).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from trackslip_common.compiled import compiled
from trackslip_estimation.kalman.single_state import log_ratio, replace_prior_variance
from trackslip_estimation.slip.models.dispatch import has_velocity_errors
from trackslip_estimation.slip.models.model import FIX_DELAY

if TYPE_CHECKING:
    from trackslip_estimation.slip.config import Config
    from trackslip_estimation.slip.records import State

_LARGEST_RATIO = 0.8  # largest P, over v; above it noise of the fixes dominates δ


@compiled
def reset_delay(state: State, c: Config) -> None:
    """Set v to the prior variance of δ."""
    state.delay_variance = c.prior_variance[FIX_DELAY]


@compiled
def propagate_delay(state: State, dt: float, c: Config) -> None:
    """Propagate v by ``dt`` s."""
    state.delay_variance += c.process_noise[0, 0, FIX_DELAY] * dt  # the same in any motion


@compiled
def log_odds_of_delay(state: State, source: int, c: Config) -> float:
    """ln of the odds of stamp errors of a source beyond σ_t; −∞: v allows for them, or δ is not observed."""
    v, w, P = state.delay_variance, _late_variance(source, c), state.covariance[FIX_DELAY, FIX_DELAY]
    if not has_velocity_errors(c) or v >= w / 4.0 or not 0.0 < P < _LARGEST_RATIO * v:
        return -math.inf
    R = 1.0 / (1.0 / P - 1.0 / v)
    measured = (state.mean[FIX_DELAY] - c.prior_mean[FIX_DELAY]) * R / P
    return float(log_ratio(measured * measured, R + w, R + v) + math.log(c.events.late_share))


@compiled
def inflate_delay(state: State, source: int, c: Config) -> None:
    """Replace the prior variance v of δ by w; the information of fixes is kept."""
    x, w, mean = state.mean[: c.size], _late_variance(source, c), c.prior_mean[FIX_DELAY]
    x[FIX_DELAY] -= mean
    replace_prior_variance(x, state.covariance[:], FIX_DELAY, state.delay_variance, w)
    x[FIX_DELAY] += mean
    state.delay_variance = w


@compiled
def _late_variance(source: int, c: Config) -> float:
    """w; 0 where the stamp error σ_t of a source is 0."""
    error = c.stamp_errors[source]
    return (c.events.late_stddev / error) ** 2 if error > 0.0 else 0.0
