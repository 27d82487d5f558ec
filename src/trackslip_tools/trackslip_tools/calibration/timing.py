# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Calibrates the clock of the gyro against that of the sprockets.

z, Δ     rate of the gyro, difference of the sprocket angles, right less left   rad/s, rad
δ        delay of the gyro's stamps                                             s

    z(t) = a Δ̇(t − δ) + b

The best fit is the maximum of the cross-correlation of z and Δ̇, between samples too. On weak ground the
yaw rate does not follow the tracks, and the delay cannot be found.
"""

from collections.abc import Sequence

import numpy as np

from trackslip_estimation.slip.motion import Motion
from trackslip_tools.calibration.finding import Finding, empty_finding, make_finding
from trackslip_tools.calibration.recording import Recording
from trackslip_tools.calibration.regression import Fit, fit_clustered
from trackslip_tools.calibration.spans import are_covered, block_numbers, motion_spans

GROUND_LAG = 0.03  # s, largest lag of the yaw rate behind the tracks on firm ground
_SHORTEST_TURN = 1.5  # s, of a turn
_SEARCH_RANGE = 0.5  # s, range of the search
_SEARCH_STEP = 0.02  # s
_WINDOW = 0.05  # s, half of the span for sprocket speeds: a count is 5e-4 rad
_BLOCK_LENGTH = 5.0  # s in which errors of the yaw rate may be correlated: about a turn
_ITERATIONS = 4  # Gauss–Newton steps
_LARGEST_UNEXPLAINED = 0.05  # largest unexplained share of the yaw rate's variance
_NO_TURNS = "no turns with the gyro recorded"


def gyro_delay(recordings: Sequence[Recording]) -> Finding:
    """Delay of the gyro's stamps against the sprockets'.

    Firm ground adds a lag of up to ``GROUND_LAG``: half of it is subtracted, and the interval covers all of
    it.
    """
    turning = _recordings_with_turns(recordings)
    if not turning:
        return empty_finding(_NO_TURNS, "s")
    delays = np.arange(-_SEARCH_RANGE, _SEARCH_RANGE + _SEARCH_STEP / 2.0, _SEARCH_STEP)
    delay = float(delays[int(np.argmin([_fit_to_sprockets(turning, float(delay))[2] for delay in delays]))])
    for _ in range(_ITERATIONS):
        fit, step, unexplained = _fit_to_sprockets(turning, delay)
        delay += step
    if fit is None or not fit.values[0]:
        return empty_finding("the drive is too short", "s")
    if unexplained > _LARGEST_UNEXPLAINED:
        return empty_finding(
            f"yaw rate and tracks correlate too weakly: {unexplained:.0%} of its variance is unexplained", "s"
        )
    spread = fit.half_width(1) / abs(float(fit.values[0])) + GROUND_LAG / 2.0
    return make_finding(
        delay - GROUND_LAG / 2.0, spread, "s", f"{len(turning)} drives, {unexplained:.1%} unexplained"
    )


def gyro_sense(recordings: Sequence[Recording]) -> Finding:
    """a, positive if the unit is mounted upright: a machine turns in the direction of its tracks."""
    turning = _recordings_with_turns(recordings)
    fit = _fit_to_sprockets(turning, 0.0)[0] if turning else None
    if fit is None:
        return empty_finding(_NO_TURNS, "1")
    return make_finding(fit.values[0], fit.half_width(), "1", "by the sense of the tracks")


def _recordings_with_turns(recordings: Sequence[Recording]) -> list[Recording]:
    return [r for r in recordings if motion_spans(r, Motion.TURNING, _SHORTEST_TURN) and len(r.gyro.t) > 3]


def _fit_to_sprockets(recordings: Sequence[Recording], delay: float) -> tuple[Fit | None, float, float]:
    """Fit of a, a δ' and b; step δ' from ``delay``; unexplained share of variance."""
    rows, rates, clusters = [], [], []
    for k, recording in enumerate(recordings):
        t, z = recording.gyro.t, recording.gyro.values[:, 2]
        sprocket_times = t - delay
        margin = _SEARCH_RANGE + 2.0 * _WINDOW
        is_covered = are_covered(recording.sprockets.t, t - margin, t + margin)
        angles = [
            np.interp(sprocket_times + step * _WINDOW, recording.sprockets.t, recording.angle_difference)
            for step in range(-2, 3)
        ]
        rate = (angles[3] - angles[1]) / (2.0 * _WINDOW)
        change = (angles[4] - 2.0 * angles[2] + angles[0]) / (2.0 * _WINDOW) ** 2
        intercepts = np.zeros((len(t), len(recordings)))
        intercepts[:, k] = 1.0
        rows.append(np.column_stack((rate, -change, intercepts))[is_covered])
        rates.append(z[is_covered])
        clusters.append(block_numbers(t[is_covered], _BLOCK_LENGTH, k))
    X, rate = np.concatenate(rows), np.concatenate(rates)
    fit = fit_clustered(X, rate, np.concatenate(clusters))
    if fit is None:
        return None, 0.0, float("inf")
    return fit, float(fit.values[1] / fit.values[0]), float(np.var(rate - X @ fit.values) / np.var(rate))
