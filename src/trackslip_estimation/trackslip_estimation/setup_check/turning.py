# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Regression of the turn by a sensor on both tracks: a likelihood for each assignment of signs.

Y, T     turn by a gyro or compass in a window, length of the window             rad, s
x_l, x_r track distance in a window over the tread                               rad
κ, b     turning efficiency, 0.1 … 1.15; bias                                    1, rad/s

    Y = κ (s_l x_l + s_r x_r) + b T + e     healthy: s_l = −1, s_r = +1

Tracks slip independently: σ² = σ₀² + 0.1² (x_l² + x_r²). One window in twenty is an outlier (a stuck track, a
shock), so that no window outweighs all others.
"""

from typing import NamedTuple

import numpy as np

from trackslip_common.arrays import BoolArray, FloatArray
from trackslip_estimation.setup_check.grid import WINDOW

PATTERNS = np.array(((-1.0, 1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, -1.0)))  # s_l, s_r
EFFICIENCIES = np.geomspace(0.1, 1.15, 18)
SLIP = 0.1  # standard deviation of the slip of one track about its usual slip, times κ
OUTLIERS = 0.05  # share of windows
_BIAS_STDDEV = np.radians(2.0)  # rad/s, of a gyro without a fault
_NOISE = 0.03  # rad in a window: delays, quantisation
_TURNING = np.radians(3.0)  # in a window
_LEAST_ANGLE = np.radians(15.0)  # of a turn
LEAST_TURNS = 3
_STILL = 0.02  # motion of a window at standstill, share of the largest ones


class TurnFit(NamedTuple):
    """Likelihoods of one sensor."""

    logs: FloatArray  # (4,) ln likelihood ratio of each of ``PATTERNS`` over no relation
    efficiencies: FloatArray  # (4,) κ of each
    bias: float  # of the sensor, rad/s


def fit_turns(turn: FloatArray, x: FloatArray, scale: float = 1.0) -> TurnFit:
    """Fit of ``turn`` (w,) to ``x`` (w, 2) in windows; ``scale``: reading per rad."""
    y, x = known_windows(turn, x)
    y = y / scale
    if len(y) < 3:
        return TurnFit(np.zeros(4), np.full(4, np.nan), 0.0)
    none = _unrelated_log(y, x)
    candidates = PATTERNS @ x.T  # (4, w)
    ks = EFFICIENCIES[:, np.newaxis, np.newaxis]
    residuals = y - ks * candidates  # (k, 4, w)
    if has_standstill(x):
        biases = np.full(residuals.shape[:2], median_bias(y, x) * WINDOW)
    else:
        biases = np.median(residuals, axis=2)
    variance = _NOISE**2 + SLIP**2 * np.sum(x**2, axis=1)
    residuals -= biases[:, :, np.newaxis]
    logs = log_mixture_density(residuals, variance, _outlier_width(y)).sum(axis=2)  # (k, 4)
    if not has_standstill(x):  # an even turn is no bias
        logs -= 0.5 * (biases / (_BIAS_STDDEV * WINDOW)) ** 2
    best = np.argmax(logs, axis=0)
    indices = np.arange(4)
    log_ratios = logs[best, indices] - none
    by_tracks = float(biases[best, indices][int(np.argmax(log_ratios))]) / WINDOW
    bias = min(by_tracks, median_bias(y, x), key=abs)  # the more usual one: turns may be independent
    return TurnFit(log_ratios, EFFICIENCIES[best], bias * scale)


def turn_scale(turn: FloatArray, x: FloatArray) -> float:
    """Turn by the sensor over turn by the tracks, by the pattern that explains it best; nan: few turns."""
    y, x = known_windows(turn, x)
    if len(y) < 3:
        return float("nan")
    y = y - median_bias(y, x) * WINDOW
    best, scale = -1.0, float("nan")
    for pattern in PATTERNS[[0, 2]]:
        turned = x @ pattern
        large = np.abs(turned) > max(0.1, 0.3 * float(np.abs(turned).max(initial=0.0)))
        if large.sum() < 2:
            continue
        ratio = y[large] / turned[large]
        middle = float(np.median(ratio))
        spread = robust_stddev(ratio - middle) + 1e-12
        if abs(middle) / spread > best:
            best, scale = abs(middle) / spread, abs(middle)
    return scale


def known_windows(y: FloatArray, x: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The values y (w,) and x (w, k) of the windows in which all are finite."""
    is_known = np.isfinite(y) & np.isfinite(x).all(axis=1)
    return y[is_known], x[is_known]


def robust_stddev(deviations: FloatArray) -> float:
    """Standard deviation by the median of the sizes of deviations (…), as of a normal distribution."""
    return 1.4826 * float(np.median(np.abs(deviations)))


def median_bias(y: FloatArray, x: FloatArray) -> float:
    """Median rate of known windows at standstill, rad/s; without standstill, of all: turns cancel."""
    still = standstill_windows(x)
    return float(np.median(y[still] if has_standstill(x) else y)) / WINDOW if len(y) else 0.0


def has_standstill(x: FloatArray) -> bool:
    """Whether the tracks x (w, 2) are at standstill in two windows at least."""
    return bool(standstill_windows(x).sum() >= 2)


def standstill_windows(x: FloatArray) -> BoolArray:
    """(w,) windows in which neither track moves; x (w, 2)."""
    moved = np.abs(x).max(axis=1)
    is_still: BoolArray = (
        moved <= max(_STILL * float(np.percentile(moved, 95)), 1e-9) if len(moved) else moved > 0.0
    )
    return is_still


def log_mixture_density(residuals: FloatArray, variance: FloatArray, width: float) -> FloatArray:
    """Ln density of residuals: normal, with one outlier in twenty, uniform within ``width``."""
    usual = (1.0 - OUTLIERS) * np.exp(-0.5 * residuals**2 / variance) / np.sqrt(2.0 * np.pi * variance)
    return np.asarray(np.log(usual + OUTLIERS / width))


def _outlier_width(y: FloatArray) -> float:
    return 2.0 * max(float(np.abs(y).max(initial=0.0)), 1.0)


def _unrelated_log(y: FloatArray, x: FloatArray) -> float:
    """Ln likelihood of turns that are independent of the tracks."""
    y = y - median_bias(y, x) * WINDOW
    variance = np.full(len(y), _NOISE**2 + float(np.mean(y**2)))
    return float(log_mixture_density(y, variance, _outlier_width(y)).sum())


def count_turns(turn: FloatArray) -> int:
    """Number of turns of 15° or more in one sense, of (w,) turns in windows."""
    count, total = 0, 0.0
    for window_turn in np.where(np.isfinite(turn), turn, 0.0):
        if abs(window_turn) < _TURNING or window_turn * total < 0.0:
            count += abs(total) >= _LEAST_ANGLE
            total = 0.0
        if abs(window_turn) >= _TURNING:
            total += float(window_turn)
            if abs(total) >= np.radians(180.0):  # each half turn counts
                count, total = count + 1, 0.0
    return int(count + (abs(total) >= _LEAST_ANGLE))
