# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Time-correlated errors of a receiver's fixes, estimated against predicted displacements; compiled.

    z = p + b + n   a fix: position, offset, white noise                           (2,) m
    R               variance as stated by the receiver                             m²
    b               first-order Gauss–Markov process, variance g R, time τ         (2,) m
    n               white, variance f R
    r               measured minus predicted displacement since the first fix      (2,) m
    c, ċ            error of the predicted displacement, and its rate              (2,) m, m/s
    w               ln of the weight of a point mass

Point masses estimate f, g and τ. Each mass has a small Kalman filter of r = b + c + n. Its weight follows the
likelihood of its innovations under Student's t. Some masses have g = 0: their errors are white. One record
belongs to a source, not to a branch of the bank. The predicted displacement is that of the most probable
branch; its uncertainty includes that of the branch's speed.

A priori, errors of coarse fixes are time-correlated and errors of precise fixes are white. The noise factor
of the source also scales the white part of precise fixes (``adaptation``). If errors of precise fixes are
white but smaller than stated, the rest of R is treated as time-correlated: displacements cannot observe it.

Source: Gelb, Applied Optimal Estimation (1974), 4.5 (shaping filters); Magill (1965), multiple models.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated, NamedTuple

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_common.compiled import compiled
from trackslip_common.record_types import Record, Table, dtype_of
from trackslip_estimation.slip.models.model import MOST_SENSOR_ERRORS

if TYPE_CHECKING:
    from trackslip_estimation.slip.config import Config

MOST_RECEIVERS = MOST_SENSOR_ERRORS // 2  # sources of poses, each with an offset of two states
QUALITIES = 3  # of fixes: precise; float ambiguities; code only
PRECISE = 0
NO_FIX, FOLLOWED, INTERRUPTED = range(3)  # ``status`` of a receiver

_WHITE_F = np.exp(0.35 * (np.arange(13) - 2 + np.maximum(np.arange(13) - 8, 0)))
_F, _G, _TIMES = (0.01, 0.1, 0.4, 1.0, 3.0), (0.3, 1.0, 3.0, 10.0, 30.0), (10.0, 30.0, 100.0)
_WHITES = _WHITE_F.size
_GRID = np.array([(f, g, time) for f in _F for g in _G for time in _TIMES])
F = np.concatenate((_WHITE_F, _GRID[:, 0]))  # f of each mass
G = np.concatenate((np.zeros(_WHITES), _GRID[:, 1]))  # g
TIMES = np.concatenate((np.ones(_WHITES), _GRID[:, 2]))  # τ, s
COUNT = F.size
LOG_PRIOR = np.concatenate(
    (
        -1.0 - np.square(np.log(_WHITE_F) / 0.5) / 2.0,
        -np.square(np.log(_GRID[:, 1] / 4.0) / 1.2) / 2.0 - math.log(2.0 * len(_F) * len(_TIMES)),
    )
)

_ANY_WHITE = -1.0 - np.square(np.log(_WHITE_F) / 1.2) / 2.0
_LEAST_G = 1e-3
_STUDENT_DOF, _STUDENT_SCALE = 8.0, 1.21  # degrees of freedom of Student's t; see ``adaptation``
_UNKNOWN_DISPLACEMENT = 1e4  # initial variance of c, over R
_NEGLIGIBLE = -6.0  # w relative to the largest, at which a mass is ignored
_MOSTLY_WHITE = 0.5  # probability of white errors from which on errors are treated as white


class FixErrors(Record):
    """Error model of fixes of one quality."""

    f: float
    g: float  # 0: white errors
    time: float  # τ, s
    white: float  # probability of white errors
    observed: float  # time for which the source provided such fixes, s


class Receiver(Record):
    """Estimated errors of a source's fixes."""

    status: int  # without a fix; displacement since the last one known (FOLLOWED), or unknown
    stddev: float  # as stated by the last fix, m
    errors: Annotated[Table[FixErrors], QUALITIES]
    elapsed: float  # since the last update of the masses, s
    distance: float  # since the last update of the masses, m
    displacement: Annotated[FloatArray, 2]  # predicted since the last fix, m
    recent_displacement: Annotated[FloatArray, 2]  # predicted, decaying with the longest time of an offset, m
    last_position: Annotated[FloatArray, 2]  # measured by the last fix, m
    last_ns: int
    residual: Annotated[FloatArray, 2]  # r


RECEIVER = dtype_of(Receiver)


class Masses(Record):
    """Weights and filters of the point masses of a receiver."""

    weights: Annotated[FloatArray, (QUALITIES, COUNT)]  # w
    means: Annotated[FloatArray, (COUNT, 3, 2)]  # b, c, ċ by axis
    covariances: Annotated[FloatArray, (COUNT, 6)]  # bb, bc, bċ, cc, cċ, ċċ; the same for both axes


MASSES = dtype_of(Masses)


@compiled
def quality_of(stddev: float, c: Config) -> int:
    """Quality of the receiver's solution by its stated standard deviation, m: one of ``QUALITIES``."""
    if stddev <= c.receivers.precise:
        return PRECISE
    return 1 if stddev < c.receivers.floating else 2


@compiled
def is_same_quality(stddev: float, other: float, c: Config) -> bool:
    """Whether two standard deviations belong to the same solution of a receiver, by their ratio."""
    return max(stddev, other) <= c.receivers.other_quality * min(stddev, other)


@compiled
def reset_receiver(s: Receiver, c: Config) -> None:
    """Reset the record ``s`` of ``RECEIVER`` to its priors."""
    s.status, s.stddev, s.elapsed, s.distance = NO_FIX, 0.0, 0.0, 0.0
    s.displacement[:] = s.recent_displacement[:] = s.residual[:] = s.last_position[:] = 0.0
    s.last_ns = 0
    for quality in range(QUALITIES):
        s.errors[quality].observed = 0.0
        _set_means(s.errors[quality], quality, _log_priors(quality, c), c)


@compiled
def _log_priors(quality: int, c: Config) -> FloatArray:
    """Prior w (COUNT,) of the masses for a quality of fixes."""
    priors = LOG_PRIOR.copy()
    if quality == PRECISE:  # ``adaptation`` estimates the size of white noise too
        priors[:_WHITES] = _ANY_WHITE
        priors[_WHITES:] -= c.receivers.white_odds
    return priors


class DisplacementError(NamedTuple):
    """Uncertainty of the predicted displacement between two fixes."""

    speed: float  # variance of the speed, (m/s)²
    direction: float  # variance of the direction, plus relative variance of the length, rad²


@compiled
def add_fix(
    s: Receiver,
    masses: Masses,
    position: FloatArray,
    stddev: float,
    displacement: DisplacementError,
    stamp_ns: int,
    c: Config,
) -> None:
    """Update the masses of a source with one more fix; ``position``: measured position (2,), m."""
    quality = quality_of(stddev, c)
    is_first = s.status != FOLLOWED
    changes_quality = s.status != NO_FIX and not is_same_quality(stddev, s.stddev, c)
    if s.status == NO_FIX:
        for q in range(QUALITIES):
            masses.weights[q] = _log_priors(q, c)
    if is_first:
        _begin_means(masses, stddev * stddev)
        s.residual[:] = s.recent_displacement[:] = s.elapsed = s.distance = 0.0
    else:
        elapsed = max((stamp_ns - s.last_ns) * 1e-9, 1e-3)
        decay = math.exp(-elapsed / c.receivers.longest_time)
        for axis in range(2):
            s.residual[axis] += position[axis] - s.last_position[axis] - s.displacement[axis]
            s.recent_displacement[axis] = decay * s.recent_displacement[axis] + s.displacement[axis]
        s.elapsed += elapsed
        s.errors[quality].observed += min(elapsed, c.receivers.longest_time)
    s.status, s.stddev, s.last_ns = FOLLOWED, stddev, stamp_ns
    s.displacement[:] = 0.0
    for axis in range(2):
        s.last_position[axis] = position[axis]
    if changes_quality:
        _reset_offsets(masses, stddev * stddev)
    if is_first:
        _set_means(s.errors[quality], quality, masses.weights[quality], c)
    elif s.elapsed >= (c.receivers.interval if s.errors[quality].white < _MOSTLY_WHITE else 0.0):
        _learn(s, masses, stddev, displacement, c)
        s.elapsed = s.distance = 0.0


@compiled
def _begin_means(masses: Masses, R: float) -> None:
    """Reset b to its prior, and c to an unknown error of the displacement."""
    for k in range(COUNT):
        masses.means[k, :, :] = 0.0
        masses.covariances[k, :] = 0.0
        masses.covariances[k, 0], masses.covariances[k, 3] = G[k] * R, _UNKNOWN_DISPLACEMENT * R


@compiled
def _reset_offsets(masses: Masses, R: float) -> None:
    """Reset b of all masses to its prior after the receiver changed its solution."""
    for k in range(COUNT):
        masses.means[k, 0, :] = 0.0
        masses.covariances[k, 0] = G[k] * R
        masses.covariances[k, 1] = masses.covariances[k, 2] = 0.0


@compiled
def _learn(s: Receiver, masses: Masses, stddev: float, displacement: DisplacementError, c: Config) -> None:
    """Predict, weigh and update all masses with r; a jump of precise fixes resets their filters instead."""
    quality, R = quality_of(stddev, c), stddev * stddev
    _predict(s, masses, R, displacement, c)
    S, nis = np.empty(COUNT), np.empty(COUNT)
    for k in range(COUNT):
        x, P, squared = masses.means[k], masses.covariances[k], 0.0
        S[k] = max(P[0] + 2.0 * P[1] + P[3], 0.0) + F[k] * R
        for axis in range(2):
            squared += (s.residual[axis] - x[0, axis] - x[1, axis]) ** 2
        nis[k] = squared / S[k]
    if quality == PRECISE and nis[masses.weights[quality].argmax()] > c.receivers.jump:
        _begin_means(masses, R)
        s.residual[:] = 0.0
        return
    w, priors, memory = masses.weights[quality], _log_priors(quality, c), c.receivers.memory
    for k in range(COUNT):
        log_tail = (_STUDENT_DOF + 2.0) / 2.0 * math.log(1.0 + _STUDENT_SCALE * nis[k] / _STUDENT_DOF)
        w[k] = memory * w[k] + (1.0 - memory) * priors[k] - math.log(S[k]) - log_tail
        inflation = student_inflation(nis[k], 2) * S[k] if nis[k] > 2.0 else 0.0
        _correct(masses.means[k], masses.covariances[k], s.residual, S[k], inflation, G[k] > 0.0)
    w -= w.max()
    if quality == PRECISE:  # the kind of errors may change at any time
        w[:] = np.maximum(w, priors - c.receivers.most_odds)
    _set_means(s.errors[quality], quality, w, c)


@compiled
def _predict(s: Receiver, masses: Masses, R: float, displacement: DisplacementError, c: Config) -> None:
    """Propagate b, c and ċ of all masses to the fix."""
    n, dt, squared = c.receivers, s.elapsed, (s.distance / s.elapsed) ** 2
    of_speed = 2.0 * displacement.speed * c.velocity_errors.time
    walk = dt * (squared * n.distance_error**2 + of_speed + n.displacement_walk**2)
    decay, rate_variance = (
        math.exp(-dt / n.direction_time),
        squared * (displacement.direction + n.direction_error**2),
    )
    for k in range(COUNT):
        x, P = masses.means[k], masses.covariances[k]
        rho = math.exp(-dt / TIMES[k]) if G[k] > 0.0 else 0.0
        for axis in range(2):
            x[0, axis], x[1, axis] = rho * x[0, axis], x[1, axis] + dt * x[2, axis]
            x[2, axis] *= decay
        P[3] += 2.0 * dt * P[4] + dt * dt * P[5] + walk
        P[0], P[1] = rho * rho * P[0] + (1.0 - rho * rho) * G[k] * R, rho * (P[1] + dt * P[2])
        P[4], P[2] = decay * (P[4] + dt * P[5]), rho * decay * P[2]
        P[5] = decay * decay * P[5] + (1.0 - decay * decay) * rate_variance


@compiled
def _correct(
    x: FloatArray, P: FloatArray, r: FloatArray, S: float, inflation: float, is_correlated: bool
) -> None:
    """Update b, c and ċ (3, 2) with r (2,); ``inflation`` adds to the variance S of r, of b if correlated."""
    S += inflation
    if is_correlated:
        P[0] += inflation
    hb, hc, hd = P[0] + P[1], P[1] + P[3], P[2] + P[4]
    for axis in range(2):
        nu = r[axis] - x[0, axis] - x[1, axis]
        x[0, axis] += hb / S * nu
        x[1, axis] += hc / S * nu
        x[2, axis] += hd / S * nu
    P[0] -= hb * hb / S
    P[1] -= hb * hc / S
    P[2] -= hb * hd / S
    P[3] -= hc * hc / S
    P[4] -= hc * hd / S
    P[5] -= hd * hd / S
    for i in (0, 3, 5):  # rounding, if c is 1e7 times as uncertain as a fix
        P[i] = max(P[i], 0.0)


@compiled
def student_inflation(nis: float, m: int) -> float:
    """Relative increase of S for an innovation (m,), under Student's t of four degrees of freedom."""
    return max((4.0 + nis) / (4.0 + m) - 1.0, 0.0)


@compiled
def _set_means(errors: FixErrors, quality: int, w: FloatArray, c: Config) -> None:
    """Set f, g and τ of a quality to weighted means; 1/τ is weighted with g too, since g/τ drives b."""
    best, total, f, g, driving, white = w.max(), 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(COUNT):
        if w[k] - best > _NEGLIGIBLE:
            mass = math.exp(w[k] - best)
            total, f, g = total + mass, f + mass * F[k], g + mass * G[k]
            driving += mass * G[k] / TIMES[k]
            white += mass if k < _WHITES else 0.0
    errors.f, errors.g, errors.white = f / total, max(g / total, _LEAST_G), white / total
    longest = c.receivers.longest_time
    errors.time = min(g / driving, longest) if driving > 0.0 else longest
    if quality == PRECISE:
        errors.f = max(errors.f, 1.0 - c.receivers.most_correlated)
        if errors.white >= _MOSTLY_WHITE:
            rest = 1.0 - errors.f
            errors.g = rest if rest > c.receivers.least_rest else 0.0
            errors.time = c.receivers.precise_time
