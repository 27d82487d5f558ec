# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Stated headings against the turn of the gyro or tracks, and against the course of the fixes.

Δψ = s Δψ_g + e         s = 1, or −1 for a heading of the opposite sense
γ = course − ψ − π [reverse]      0 for a heading of the machine, forward
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trackslip_common.arrays import FloatArray
from trackslip_estimation.setup_check.finding import PRIOR
from trackslip_estimation.setup_check.grid import LONGEST_GAP, Grid
from trackslip_estimation.setup_check.log import Array, Compass, ComplexArray, Fixes
from trackslip_estimation.setup_check.turning import log_mixture_density

_HEADING_NOISE = 0.05  # rad, of a difference of headings in a window
_TURN_SHARE = 0.1  # standard deviation, share of the turn
_LEAST_WINDOWS = 3
_COURSE_STDDEV = 0.3  # rad, standard deviation of γ: sideways motion, noise of fixes
_LEAST_STEP = 0.3  # m in a window
_LONGEST_STEP = 2.0 * LONGEST_GAP + 1e-3  # s between readings that are interpolated; stamps are rounded
_MOST_TURN = 0.35  # rad in a window, largest turn of a straight step
_DEGREES = float(np.degrees(1.0))
_STEP_NOISE = 0.03  # rad, of a difference of neighbouring headings
_LEAST_STEP_TURN, _MOST_STEP_TURN = 0.02, 0.5  # rad from one heading to the next
_LEAST_STEPS = 8
_CORRELATION = 0.85  # of headings in another unit with the turn
_LEAST_NOISES = 6.0  # standard deviations of a fix in a step


class Courses(NamedTuple):
    """Straight steps with a heading."""

    courses: FloatArray  # (n,) rad, direction in which the fixes move
    headings: FloatArray  # (n,) rad, stated
    windows: NDArray[np.int64]  # (n,) indices of the windows of the grid
    curves: FloatArray  # (n,) turn over length of the step, rad/m


def heading_at(compass: Compass, t: FloatArray) -> FloatArray:
    """(n,) headings at times t, rad; nan where no heading is near."""
    is_finite = np.isfinite(compass.headings)
    return _interpolate(t, compass.t[is_finite], np.unwrap(compass.headings[is_finite]))


def place_at(fixes: Fixes, t: FloatArray) -> ComplexArray:
    """(n,) places at times t, m; nan where no fix is near."""
    return _interpolate(t, fixes.t, fixes.complex_places)


def _interpolate(t: FloatArray, times: FloatArray, values: Array) -> Array:
    """(n,) values at times t, of (m,) values at ``times``; nan where these are too far apart."""
    if len(times) < 2:
        return np.full(len(t), np.nan, values.dtype)
    after = np.clip(np.searchsorted(times, t), 1, len(times) - 1)
    is_near = (times[after] - times[after - 1] <= _LONGEST_STEP) & (t >= times[0]) & (t <= times[-1])
    return np.asarray(np.where(is_near, np.interp(t, times, values), np.nan))


def window_displacements(fixes: Fixes, grid: Grid) -> ComplexArray:
    """(w,) displacements in windows, m; nan where there is no fix."""
    return np.asarray(np.diff(place_at(fixes, grid.window_edges)))


def turn_logs(heading_turns: FloatArray, machine_turns: FloatArray) -> FloatArray:
    """(3,) ln likelihood: headings turn with the machine, against it, independently; (w,) rad in windows.

    Zeros where fewer than three windows show both.
    """
    usable = np.isfinite(heading_turns) & np.isfinite(machine_turns)
    y, x = heading_turns[usable], machine_turns[usable]
    if len(y) < _LEAST_WINDOWS:
        return np.zeros(3)
    variance = _HEADING_NOISE**2 + (_TURN_SHARE * x) ** 2
    width = 2.0 * max(float(np.abs(y).max()), 1.0)
    independent_variance = np.full(len(y), _HEADING_NOISE**2 + float(np.mean(y**2)))
    logs = (
        log_mixture_density(y - x, variance, width),
        log_mixture_density(y + x, variance, width),
        log_mixture_density(y, independent_variance, width),
    )
    return np.asarray(np.sum(logs, axis=1))


def straight_courses(grid: Grid, fixes: Fixes, compass: Compass) -> Courses:
    """Steps between fixes over windows in which the headings hardly turn."""
    edges, steps = grid.window_edges, window_displacements(fixes, grid)
    turns, distance = np.diff(heading_at(compass, edges)), np.abs(steps)
    middle = heading_at(compass, (edges[1:] + edges[:-1]) / 2.0)
    is_far = distance > max(_LEAST_STEP, _LEAST_NOISES * fixes.noise)
    index = np.flatnonzero(is_far & (np.abs(turns) < _MOST_TURN) & np.isfinite(middle))
    return Courses(np.angle(steps[index]), middle[index], index, turns[index] / distance[index])


def direction_log(differences: FloatArray) -> float:
    """Ln likelihood of course less heading (n,), rad: around 0, or, with the prior of a mistake, elsewhere.

    The other direction has a uniform prior.
    """
    elsewhere = _log_around(mean_direction(differences), differences)
    elsewhere -= float(
        np.log(2.0 * np.pi * np.sqrt(len(differences)) / _COURSE_STDDEV / np.sqrt(2.0 * np.pi))
    )
    return float(np.logaddexp(_log_around(0.0, differences), elsewhere - PRIOR))


def _log_around(middle: float, differences: FloatArray) -> float:
    """Ln likelihood that directions (n,), rad, lie around ``middle``."""
    residuals = wrap_angles(differences - middle)
    variance = np.full(len(residuals), _COURSE_STDDEV**2)
    return float(log_mixture_density(residuals, variance, 2.0 * np.pi).sum())


def mean_direction(angles: FloatArray) -> float:
    """Robust mean of directions, rad: that around which most lie."""
    middle = float(np.angle(np.mean(np.exp(1j * angles))))
    for _ in range(5):
        residuals = wrap_angles(angles - middle)
        usual = np.abs(residuals) < 1.0
        middle += float(np.median(residuals[usual])) if usual.any() else 0.0
    return float(wrap_angles(np.array((middle,)))[0])


def wrap_angles(angles: FloatArray) -> FloatArray:
    """Angles wrapped to [−π, π)."""
    return np.asarray((angles + np.pi) % (2.0 * np.pi) - np.pi)


def heading_unit(compass: Compass, t: FloatArray, gyro_angles: FloatArray) -> tuple[float, float]:
    """Factor 57.3 or 1/57.3 of headings in a wrong unit, else 1; its ln likelihood ratio over the right unit.

    By differences of successive headings, modulo a turn; ``gyro_angles`` (n,) rad, at times ``t`` (n,).
    """
    is_finite = np.isfinite(compass.headings)
    times, headings = compass.t[is_finite], compass.headings[is_finite]
    steps = wrap_angles(np.diff(headings))
    gyro_steps = np.diff(np.interp(times, t, gyro_angles))
    is_usable = (
        (np.diff(times) < LONGEST_GAP)
        & (np.abs(gyro_steps) > _LEAST_STEP_TURN)
        & (np.abs(gyro_steps) < _MOST_STEP_TURN)
    )
    is_usable &= (times[1:] <= t[-1]) & (times[:-1] >= t[0])
    if is_usable.sum() < _LEAST_STEPS:
        return 1.0, 0.0
    logs = {}
    for factor in (1.0, -1.0, _DEGREES, -_DEGREES, 1.0 / _DEGREES, -1.0 / _DEGREES):
        variance = _STEP_NOISE**2 + (factor * (0.002 + 0.05 * gyro_steps[is_usable])) ** 2
        logs[factor] = float(
            log_mixture_density(
                wrap_angles(steps[is_usable] - factor * gyro_steps[is_usable]), variance, 2.0 * np.pi
            ).sum()
        )
    best = max(logs, key=lambda factor: logs[factor])
    if abs(best) < 1.0 and not _is_correlated(np.unwrap(headings), best * np.interp(times, t, gyro_angles)):
        return 1.0, 0.0
    return abs(best), logs[best] - max(logs[1.0], logs[-1.0])


def _is_correlated(headings: FloatArray, gyro_angles: FloatArray) -> bool:
    """Whether small changes of headings follow the turn; those of constant headings do not."""
    y, x = headings - headings.mean(), gyro_angles - gyro_angles.mean()
    of_x, of_y, both = float(x @ x), float(y @ y), float(x @ y)
    return both > _CORRELATION * np.sqrt(of_x * of_y) and 0.5 < both / max(of_x, 1e-12) < 2.0
