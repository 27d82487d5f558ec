# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Noise of tracks, gyros and fixes on this machine and ground, estimated from innovations; compiled.

    s       track error: error of a track's speed over the ground, relative to it       1
    U       s² U/4 is the variance of m_v due to s, s² U/B² that of m_ω (``speed``)     (m/s)²
    E       envelope: the U already contained in the velocity errors, forgotten with τ  (m/s)²
    T       variance of m_ω, over s², added by the tracks since the last reading  (rad/s)²
    a, f    factors of the variance as stated by yaw rates and by a source's fixes      1
    ν, S    innovation and its covariance
    w       ln of the weight of a point mass

Point masses on a joint grid estimate s and a. Each yaw rate weighs them by its likelihood, with S computed
for each mass. Readings less than τ apart share one track error, so each of them has less weight. Separate
point masses estimate f by Student's t, so that outliers have little influence. The posterior mean of the
*variance* is used: it grows quickly and shrinks slowly. All weights are part of the state. Correlated
consecutive fixes cannot raise f beyond 8. A wrong pose also correlates its innovations; a larger f would keep
the fixes from correcting that pose.

The error of an input enters P with the input: where U exceeds E, P grows by the difference at once.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_common.compiled import compiled
from trackslip_common.parameters import Parameters, parameter
from trackslip_common.record_types import Record, dtype_of
from trackslip_estimation.kalman.linear_algebra import log_determinant, root, weighted_square
from trackslip_estimation.slip.models.speed import (
    SPEED_ERROR,
    YAW_RATE_ERROR,
    departure,
    squared_travel_ratio,
    track_exposure,
)

if TYPE_CHECKING:
    from trackslip_estimation.slip.config import Config
    from trackslip_estimation.slip.records import Adaptation, State


TRACK_ERRORS, RATE_FACTORS, FIX_FACTORS = 6, 3, 13  # point masses of s, a and f
_TRACK_RATIO = 3.0  # from one s to the next
_RATE_RATIO = 4.0  # from one a to the next
_FIX_STEP = 0.35  # of ln f; twice as large above the ``_USUAL`` masses
_FIX_BELOW, _USUAL = 2, 9  # numbers of masses with f below 1, and with f up to about 8
_CORRELATION_MEMORY = 0.95  # 20 fixes
_WHITE_CORRELATION = 0.4  # correlation of consecutive innovations, below which f may have any value
_FIX_PRIOR = 0.5  # standard deviation of ln f
_STUDENT_DOF = 8.0  # degrees of freedom of Student's t
_STUDENT_SCALE = (1.232, 1.210, 1.192)  # factors of d² for m = 1, 2, 3 by which Gaussian fixes give f = 1
_LARGEST_NIS = 25.0  # NIS under the largest s and a, at which larger innovations are clipped
_SHORTEST = 1e-3  # shortest time between fixes of a source, s
_NEGLIGIBLE = -20.0  # w relative to the largest, at which a mass is ignored


class AdaptationConstants(Record):
    """Point masses, and numbers of ``AdaptationParameters``."""

    track_variances: Annotated[FloatArray, TRACK_ERRORS]  # s²
    rate_factors: Annotated[FloatArray, RATE_FACTORS]  # a
    fix_factors: Annotated[FloatArray, FIX_FACTORS]  # f
    rate_prior: Annotated[FloatArray, RATE_FACTORS]  # w of a before any reading
    fix_prior: Annotated[FloatArray, FIX_FACTORS]  # w of f before any fix
    changing_weight: float
    forward: float
    sideways: float
    common_slip: float
    memory: float  # s
    fix_memory: float
    soft_gate: float


CONSTANTS = dtype_of(AdaptationConstants)


@dataclass(frozen=True, kw_only=True)
class AdaptationParameters(Parameters):
    """Parameters of the noise estimation."""

    least_track_error: float = parameter(
        "smallest error of a track, relative to its speed; up to 243 times as much is estimated",
        gt=0.0,
        le=0.01,
    )
    changing_weight: float = parameter(
        "weight of d² beside V² in the squared speed that the track error scales with", ge=0.0
    )
    forward: float = parameter("error of v, over that of two tracks with independent errors", ge=0.0)
    sideways: float = parameter("error of v_y, over that of two tracks with independent errors", ge=0.0)
    common_slip: float = parameter(
        "random walk of i₀ while driving, as a multiple of the track error", unit="1/√s", ge=0.0
    )
    memory: float = parameter(
        "driving time after which the weight of an innovation has decayed to 1/e", unit="s", gt=0.0
    )
    rate_odds: float = parameter(
        "ln of the prior odds of a gyro's stated noise, against twice that noise", ge=0.0
    )
    fix_memory: float = parameter(
        "weight of earlier fixes in the noise of a source that remains after one more fix", gt=0.0, lt=1.0
    )
    soft_gate: float = parameter(
        "multiple of the gate up to which altitudes are used with less weight, and fixes update their noise",
        ge=1.0,
    )


def constants(p: AdaptationParameters) -> tuple[Any, ...]:
    """The fields of ``CONSTANTS``, in their order."""
    number = np.arange(FIX_FACTORS)
    ln_f = _FIX_STEP * (number - _FIX_BELOW + np.maximum(number - _USUAL + 1, 0))
    return (
        np.square(p.least_track_error * _TRACK_RATIO ** np.arange(TRACK_ERRORS)),
        _RATE_RATIO ** np.arange(RATE_FACTORS),
        np.exp(ln_f),
        -p.rate_odds * np.arange(RATE_FACTORS),
        -np.square(ln_f / _FIX_PRIOR) / 2.0,
        *(getattr(p, name) for name in (CONSTANTS.names or ())[5:]),
    )


def unknown_fix_factor() -> FloatArray:
    """(FIX_FACTORS,) weights of f before any fix."""
    return np.where(np.arange(FIX_FACTORS) < _USUAL, 1.0 / _USUAL, 0.0)


@compiled
def begin_adaptation(a: Adaptation, c: Config) -> None:
    """Initialise the record ``a`` of ``records.ADAPTATION``: s unknown, sensor noise as stated."""
    n = c.adaptation
    a.track_variance, a.rate_factor = n.track_variances.mean(), 1.0
    a.envelope = a.exposure = a.elapsed = a.speed_exposure = a.speed_elapsed = 0.0
    for i in range(TRACK_ERRORS):
        a.log_weights[i] = n.rate_prior
    a.fix_factors[:] = 1.0
    a.fix_log_weights[:] = 0.0
    a.fix_innovations[:] = 0.0
    a.fix_correlation[:] = 1.0


@compiled
def resume_adaptation(a: Adaptation, start: Adaptation) -> None:
    """Copy s, a and f of an earlier run from the record ``start`` of ``records.ADAPTATION``."""
    a.track_variance, a.rate_factor = start.track_variance, start.rate_factor
    for i in range(TRACK_ERRORS):
        a.log_weights[i] = start.log_weights[i]
    a.fix_factors[:] = start.fix_factors
    for k in range(start.fix_factors.size):
        a.fix_log_weights[k] = start.fix_log_weights[k]


@compiled
def add_track_error_noise(state: State, dt: float, c: Config) -> None:
    """Add to P the track errors that it does not contain yet; the tracks' speeds last for ``dt`` s."""
    a, P = state.adaptation, state.covariance
    U = track_exposure(state, c)
    speed_change = max(abs(state.speeds.left - a.left_speed), abs(state.speeds.right - a.right_speed))
    speed_change *= c.rolling_radius if departure(state, c) > 0.0 else 0.0  # first speeds: no change
    a.left_speed, a.right_speed = state.speeds.left, state.speeds.right
    by_change = c.adaptation.changing_weight * speed_change * speed_change
    missing = max(U - a.envelope, by_change * squared_travel_ratio(state.mean, state.covariance))
    P[SPEED_ERROR, SPEED_ERROR] += c.adaptation.forward**2 * a.track_variance * missing / 4.0
    P[YAW_RATE_ERROR, YAW_RATE_ERROR] += a.track_variance * missing / (c.tread * c.tread)
    decay = math.exp(-2.0 * dt / c.velocity_errors.time)
    a.envelope = decay * (a.envelope + missing) + (1.0 - decay) * U
    a.exposure = decay * (a.exposure + missing / (c.tread * c.tread)) + (1.0 - decay) * U / (
        c.tread * c.tread
    )
    a.speed_exposure = decay * (a.speed_exposure + missing) + (1.0 - decay) * U
    a.elapsed += dt
    a.speed_elapsed += dt


@compiled
def clear_track_error(a: Adaptation) -> None:
    """Reset envelope and exposures while sprockets are silent: velocity errors then contain none of them."""
    a.envelope = a.exposure = a.elapsed = a.speed_exposure = a.speed_elapsed = 0.0


@compiled
def learn_from_rate(
    a: Adaptation, innovation: float, S: float, by_tracks: float, stated: float, is_standing: bool, c: Config
) -> float:
    """Update the weights of s and a with a yaw rate; return its NIS under the largest s and a.

    ``by_tracks``: part of S due to the tracks for s = 1, T; ``stated``: variance stated by the gyro, R.
    """
    n = c.adaptation
    rest = max(S - a.track_variance * by_tracks - a.rate_factor * stated, 0.0)
    largest = rest + by_tracks * n.track_variances[TRACK_ERRORS - 1]
    largest += stated * n.rate_factors[RATE_FACTORS - 1]
    squared = min(innovation * innovation, _LARGEST_NIS * largest)
    weight = min(a.elapsed / c.velocity_errors.time, 1.0)
    decay = 1.0 if is_standing else math.exp(-a.elapsed / n.memory)
    a.exposure = a.elapsed = 0.0
    best = -math.inf
    for i in range(TRACK_ERRORS):
        for j in range(RATE_FACTORS):
            variance = rest + by_tracks * n.track_variances[i] + stated * n.rate_factors[j]
            w = decay * a.log_weights[i, j] + (1.0 - decay) * n.rate_prior[j]
            a.log_weights[i, j] = w - weight * (math.log(variance) + squared / variance) / 2.0
            best = max(best, a.log_weights[i, j])
    _set_means(a, best, n)
    nis: float = innovation * innovation / largest
    return nis


@compiled
def learn_from_speed(
    a: Adaptation, innovation: float, S: float, by_tracks: float, is_standing: bool, c: Config
) -> None:
    """Update the weights of s with a speed; ``by_tracks``: part of S due to the tracks for s = 1."""
    n = c.adaptation
    rest = max(S - a.track_variance * by_tracks, 0.0)
    squared = min(innovation**2, _LARGEST_NIS * (rest + by_tracks * n.track_variances[TRACK_ERRORS - 1]))
    weight = min(a.speed_elapsed / c.velocity_errors.time, 1.0)
    decay = 1.0 if is_standing else math.exp(-a.speed_elapsed / n.memory)
    a.speed_exposure = a.speed_elapsed = 0.0
    best = -math.inf
    for i in range(TRACK_ERRORS):
        variance = rest + by_tracks * n.track_variances[i]
        likelihood = -weight * (math.log(variance) + squared / variance) / 2.0
        for j in range(RATE_FACTORS):
            a.log_weights[i, j] = decay * a.log_weights[i, j] + (1.0 - decay) * n.rate_prior[j] + likelihood
            best = max(best, a.log_weights[i, j])
    _set_means(a, best, n)


@compiled
def _set_means(a: Adaptation, best: float, n: AdaptationConstants) -> None:
    """Set s² and a to their weighted means; ``best``: the largest w."""
    total = track_variance = rate_factor = 0.0
    for i in range(TRACK_ERRORS):
        for j in range(RATE_FACTORS):
            a.log_weights[i, j] -= best
            if a.log_weights[i, j] > _NEGLIGIBLE:
                mass = math.exp(a.log_weights[i, j])
                total += mass
                track_variance += mass * n.track_variances[i]
                rate_factor += mass * n.rate_factors[j]
    a.track_variance, a.rate_factor = track_variance / total, rate_factor / total


@compiled
def correlated_inflation(elapsed_ns: int, time: float) -> float:
    """Inflation of R for fixes Δt apart whose errors have the correlation time τ_e, ``time``, s.

    (1 + ρ)/(1 − ρ), ρ = exp(−Δt/τ_e): n such fixes have the information of n independent ones over this.
    """
    if time == 0.0:
        return 1.0
    return 1.0 / math.tanh(max(elapsed_ns * 1e-9, _SHORTEST) / (2.0 * time))


@compiled
def largest_correlated_inflation(P: FloatArray, R: FloatArray) -> float:
    """Largest useful inflation of R for a fix whose error the estimate, of covariance P, may contain already.

    Let P = R + U, where R is the shared error. After a gain K the true variance is R + (1 − K)² U, and the
    filter has (1 − K) P. Both are equal for 1 − K = R/U. Where U is less than R, the fix has no information.
    """
    p, r = P[0, 0] + P[1, 1], R[0, 0] + R[1, 1]
    return p / (p - 2.0 * r) if p > 2.0 * r else math.inf


@compiled
def _correlation_with_last(a: Adaptation, source: int, innovation: FloatArray) -> float:
    """Update and return the correlation of a source's consecutive innovations: 0 if white, 1 at the start."""
    last, product, squares = a.fix_innovations[source], 0.0, 0.0
    for i in range(min(innovation.size, last.size)):
        product += last[i] * innovation[i]
        squares += (last[i] * last[i] + innovation[i] * innovation[i]) / 2.0
        last[i] = innovation[i]
    if squares > 0.0:
        decayed = _CORRELATION_MEMORY * a.fix_correlation[source]
        a.fix_correlation[source] = decayed + (1.0 - _CORRELATION_MEMORY) * product / squares
    correlation: float = a.fix_correlation[source]
    return correlation


@compiled
def learn_from_fix(
    a: Adaptation, source: int, innovation: FloatArray, P: FloatArray, R: FloatArray, c: Config
) -> None:
    """Update the weights of f of a source with an innovation (m,); P (m, m) predicted, R (m, m) stated."""
    n, w, m = c.adaptation, a.fix_log_weights[source], innovation.size
    scale = _STUDENT_SCALE[m - 1] / _STUDENT_DOF
    is_white = _correlation_with_last(a, source, innovation) < _WHITE_CORRELATION
    if not np.any(w):  # first fix: uniform up to ``_USUAL``, improbable beyond
        w[_USUAL:] = n.fix_prior[_USUAL:]
    best, likelihood = -math.inf, 0.0
    for j in range(FIX_FACTORS):
        if j < _USUAL or is_white:
            L = root(P + n.fix_factors[j] * R)
            nis = weighted_square(L, innovation)
            likelihood = -(log_determinant(L) + (_STUDENT_DOF + m) * math.log(1.0 + scale * nis)) / 2.0
        w[j] = n.fix_memory * w[j] + (1.0 - n.fix_memory) * n.fix_prior[j] + likelihood
        best = max(best, w[j])
    total = factor = 0.0
    for j in range(FIX_FACTORS):
        w[j] -= best
        mass = math.exp(w[j])
        total += mass
        factor += mass * n.fix_factors[j]
    a.fix_factors[source] = factor / total


@compiled
def log_density(L: FloatArray, innovation: FloatArray) -> float:
    """ln of the density of an innovation (m,) under Student's t; L (m, m): root of its covariance."""
    m = innovation.size
    scale = _STUDENT_SCALE[m - 1]
    nis = weighted_square(L, innovation)
    log_tail = (_STUDENT_DOF + m) * math.log(1.0 + scale / _STUDENT_DOF * nis)
    return -(log_determinant(L) + log_tail) / 2.0 - m * math.log(2.0 * math.pi / scale) / 2.0


@compiled
def log_density_over_factors(
    a: Adaptation, source: int, innovation: FloatArray, P: FloatArray, R: FloatArray, c: Config
) -> float:
    """ln of the density of an innovation (m,), averaged over f; P (m, m) predicted, R (m, m) stated."""
    n, w, m = c.adaptation, a.fix_log_weights[source], innovation.size
    scale = _STUDENT_SCALE[m - 1]
    is_known, highest_posterior, highest_prior = np.any(w), -math.inf, -math.inf
    log_posterior, log_prior = np.zeros(FIX_FACTORS), np.zeros(FIX_FACTORS)
    for j in range(FIX_FACTORS):
        log_prior[j] = w[j] if is_known else n.fix_prior[j]
        L = root(P + n.fix_factors[j] * R)
        nis = weighted_square(L, innovation)
        log_posterior[j] = (
            log_prior[j]
            - (log_determinant(L) + (_STUDENT_DOF + m) * math.log(1.0 + scale / _STUDENT_DOF * nis)) / 2.0
        )
        highest_posterior, highest_prior = (
            max(highest_posterior, log_posterior[j]),
            max(highest_prior, log_prior[j]),
        )
    total = mass = 0.0
    for j in range(FIX_FACTORS):
        total += math.exp(log_posterior[j] - highest_posterior)
        mass += math.exp(log_prior[j] - highest_prior)
    return (
        highest_posterior - highest_prior + math.log(total / mass) - m * math.log(2.0 * math.pi / scale) / 2.0
    )
