# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Errors that each source has of its own: numbers of the state from ``SENSOR_ERRORS`` on; compiled.

The first gyro's bias is that of the model, which what it learned keeps. Every further one has its own: while
its readings are used, the two change places in the state.

What lasts of a fix, with ``correlation_time`` τ, is its error of east and of north over what it states:

    z = p + √(λ R_xx) e_x, √(λ R_yy) e_y + white noise of (1 − λ) R
    e    first-order Gauss–Markov, of variance 1 and time τ     (2,), 1
    λ    share of the variance R that lasts                     1

Fixes ten times a second then tell of the motion between them what they do, and of the place no more than one
fix. When the standard deviation becomes another by more than ``_OTHER_QUALITY`` (ambiguities fixed, floating,
code alone), so does the error: e begins anew.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trackslip_common.compiled import compiled
from trackslip_estimation.slip.levers import add
from trackslip_estimation.slip.models.model import GYRO_BIAS, YAW, X, Y

FloatArray = NDArray[np.float64]

LASTING = 0.6  # λ: no receiver states it; from half to nearly all of it
_OTHER_QUALITY = 3.0


@compiled
def exchange_bias(state: Any, update: Any, own: int) -> None:
    """The bias at the place ``own`` for that of the first gyro, and back again; nothing where it is −1."""
    if own < 0:
        return
    _exchange(state.mean, state.covariance, own)
    _exchange(update.prior_mean, update.prior_covariance, own)


@compiled
def _exchange(x: FloatArray, P: FloatArray, own: int) -> None:
    x[GYRO_BIAS], x[own] = x[own], x[GYRO_BIAS]
    for j in range(x.size):
        P[GYRO_BIAS, j], P[own, j] = P[own, j], P[GYRO_BIAS, j]
    for i in range(x.size):
        P[i, GYRO_BIAS], P[i, own] = P[i, own], P[i, GYRO_BIAS]


@compiled
def lasts(source: int, c: Any) -> bool:
    """Whether a part of each fix's error is that of the one before."""
    own = c.own_errors[source]
    return bool(own >= 0 and c.error_times[own] > 0.0)


@compiled
def meet_quality(state: Any, update: Any, source: int, R: FloatArray, c: Any) -> None:
    """Where a fix of covariance R is of another quality than the one before, e begins anew."""
    stddev, before = math.sqrt((R[X, X] + R[Y, Y]) / 2.0), state.fix_stddevs[source]
    state.fix_stddevs[source] = stddev
    if before > 0.0 and max(stddev / before, before / stddev) > _OTHER_QUALITY:
        own = c.own_errors[source]
        update.renewed |= 3 << own
        _renew(state.mean, state.covariance, own)
        _renew(update.prior_mean, update.prior_covariance, own)


@compiled
def _renew(x: FloatArray, P: FloatArray, own: int) -> None:
    for i in (own, own + 1):
        x[i] = 0.0
        for j in range(x.size):
            P[i, j] = P[j, i] = 0.0
        P[i, i] = 1.0


@compiled
def to_erring(x: FloatArray, P: FloatArray, source: int, R: FloatArray, sign: float, c: Any) -> None:
    """The state with the place that a fix of covariance R shows but for its noise, for the place; or back."""
    if not lasts(source, c):
        return
    own = c.own_errors[source]
    for axis in (X, Y):
        stddev = sign * math.sqrt(LASTING * R[axis, axis])
        x[axis] += stddev * x[own + axis]
        add(P, axis, own + axis, stddev)


@compiled
def white(R: FloatArray, source: int, c: Any) -> FloatArray:
    """R of a fix without what lasts of it."""
    left = R.copy()
    if lasts(source, c):
        left[: Y + 1] *= math.sqrt(1.0 - LASTING)
        left[:, : Y + 1] *= math.sqrt(1.0 - LASTING)
    return left


@compiled
def begin_erring(x: FloatArray, P: FloatArray, source: int, c: Any) -> None:
    """x and P at the start, of which the place is that of a fix: what lasts of its error is in both."""
    R = P[: Y + 1, : Y + 1].copy()
    P[: Y + 1, : Y + 1] = white(R, source, c)
    to_erring(x[:], P[:], source, R, -1.0, c)


@compiled
def to_offset(x: FloatArray, P: FloatArray, source: int, sign: float, c: Any) -> None:
    """The state with the place, or heading, that a source with an offset shows; or back (−1)."""
    own = c.offsets[source]
    if own < 0:
        return
    if c.compass[source] == 1:
        x[YAW] += sign * x[own]
        add(P, YAW, own, sign)
        return
    for axis in (X, Y):
        x[axis] += sign * x[own + axis]
        add(P, axis, own + axis, sign)
