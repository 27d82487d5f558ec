# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""A machine that slides down a slope: fixes that were refused, and drift from what was predicted; compiled.

    e_k, t_k   a refused fix less where its sensor was predicted, and its time     (2,), m; s
    e = e₀ + d t   the least-squares line through them, d the drift                m/s
    U          mean speed of the tracks                                            m/s

Fixes of a slide agree with no rigid motion of what was predicted, and so would be refused for as long as it
lasts. On ground so steep that a machine may slide, and where its heading is shown by something else, they are
believed once they lie on a line whose drift leads downhill. The place moves there, and is doubted by what the
drift makes of the time that they took; k and i₀ are open by as much as the drift would want of both.
"""

import math
from typing import Any

import numpy as np

from trackslip_common.compiled import compiled
from trackslip_estimation.slip.alignment import GENTLE, forget_fixes, is_steep
from trackslip_estimation.slip.models.dispatch import has_velocity_errors
from trackslip_estimation.slip.models.model import DOWNHILL, SIZE, YAW, X, Y
from trackslip_estimation.slip.models.speed import COMMON_SLIP
from trackslip_estimation.slip.traction import agree

_FEWEST = 4  # fixes that show a line by lying on it
_SIGNIFICANT = 3.0  # standard deviations of a drift
_DOWNHILL = 0.5  # cosine of its direction against straight down, at least
_SLOWEST = 0.05  # m/s, of tracks whose slip anything can show
_MOST = 1.0  # standard deviation of i₀, at most


@compiled
def find_slide(state: Any, c: Any) -> bool:
    """Whether the refused fixes show one; then the place is theirs, and nothing is turned."""
    count, refused = state.refused_count, state.refused
    if count < _FEWEST or state.aligning or not is_steep(state):
        return False
    t, e = np.empty(count), np.empty((count, 2))
    variance = 0.0
    for k in range(count):
        t[k] = (refused[k].stamp_ns - refused[count - 1].stamp_ns) * 1e-9
        e[k, 0] = refused[k].x - refused[k].predicted_x
        e[k, 1] = refused[k].y - refused[k].predicted_y
        variance += refused[k].variance / count
    middle, spread = t.mean(), 0.0
    centre = (e[:, 0].mean(), e[:, 1].mean())
    drift = np.zeros(2)
    for k in range(count):
        spread += (t[k] - middle) ** 2
        for i in range(2):
            drift[i] += (t[k] - middle) * (e[k, i] - centre[i])
    if spread <= 0.0:
        return False
    drift /= spread
    chi2 = 0.0
    for k in range(count):
        for i in range(2):
            chi2 += (e[k, i] - centre[i] - drift[i] * (t[k] - middle)) ** 2 / variance
    speed = math.hypot(drift[0], drift[1])
    known = speed * speed * spread > _SIGNIFICANT**2 * variance
    if not (known and agree(chi2, 2.0 * count - 4.0) and _leads_down(state, drift[0], drift[1], speed)):
        return False
    _follow(
        state, (centre[0] - drift[0] * middle, centre[1] - drift[1] * middle), variance + (speed * t[0]) ** 2
    )
    if has_velocity_errors(c):
        _open(state, drift[0], drift[1], c)
    forget_fixes(state, True)
    return True


@compiled
def _leads_down(state: Any, east: float, north: float, speed: float) -> bool:
    """Whether a drift goes downhill."""
    level, cos, sin = state.attitude.level, math.cos(state.mean[YAW]), math.sin(state.mean[YAW])
    down_x, down_y = level.downhill_x, level.downhill_y
    along = (cos * down_x - sin * down_y) * east + (sin * down_x + cos * down_y) * north
    return bool(along >= _DOWNHILL * speed * math.hypot(down_x, down_y))


@compiled
def _follow(state: Any, shift: tuple[float, float], variance: float) -> None:
    """The place moved, with a variance of its own."""
    x, P = state.mean, state.covariance
    x[X] += shift[0]
    x[Y] += shift[1]
    for i in (X, Y):
        for j in range(SIZE):
            P[i, j] = P[j, i] = 0.0
        P[i, i] = variance


@compiled
def _open(state: Any, east: float, north: float, c: Any) -> None:
    """P with k and i₀ as large as would make the drift."""
    P, cos, sin = state.covariance, math.cos(state.mean[YAW]), math.sin(state.mean[YAW])
    U = max(c.rolling_radius * abs(state.speeds.left + state.speeds.right) / 2.0, _SLOWEST)
    across = max(abs(state.attitude.level.downhill_y), GENTLE)
    P[DOWNHILL, DOWNHILL] += ((cos * north - sin * east) / (U * across)) ** 2
    P[COMMON_SLIP, COMMON_SLIP] += min(((cos * east + sin * north) / U) ** 2, _MOST**2)
