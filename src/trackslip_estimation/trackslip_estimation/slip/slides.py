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
from typing import Any, NamedTuple

from trackslip_common.compiled import compiled
from trackslip_estimation.slip.alignment import GENTLE, forget_fixes, is_steep
from trackslip_estimation.slip.models.dispatch import has_velocity_errors
from trackslip_estimation.slip.models.model import DOWNHILL, SIZE, YAW, X, Y
from trackslip_estimation.slip.models.speed import COMMON_SLIP
from trackslip_estimation.slip.tilt import follow_ground
from trackslip_estimation.slip.traction import agree

_FEWEST = 4  # fixes that show a line by lying on it
_SIGNIFICANT = 3.0  # standard deviations of a drift
_DOWNHILL = 0.5  # cosine of its direction against straight down, at least
_SLOWEST = 0.05  # m/s, of tracks whose slip anything can show
_MOST = 1.0  # standard deviation of i₀, at most


class Drift(NamedTuple):
    """The least-squares line through the e_k over the t_k; times are before the last fix."""

    begin: float  # t of the first fix, s
    velocity: tuple[float, float]  # d, m/s
    end: tuple[float, float]  # e on the line at the last fix, m
    stddev: float  # of d along one axis, m/s
    chi2: float
    variance: float  # of a fix along one axis, m²


@compiled
def find_slide(state: Any, c: Any) -> bool:
    """Whether the refused fixes show one; then the place is theirs, and nothing is turned."""
    count = state.refused_count
    if count < _FEWEST or state.aligning or not is_steep(state):
        return False
    found = _drift(state.refused, count)
    speed = math.hypot(found.velocity[0], found.velocity[1])
    known = speed > _SIGNIFICANT * found.stddev
    if not (known and agree(found.chi2, 2.0 * count - 4.0) and _leads_down(state, found.velocity, speed)):
        return False
    follow_ground(state, found.end[0], found.end[1])
    _follow(state, found.end, found.variance + (speed * found.begin) ** 2)
    if has_velocity_errors(c):
        _open(state, found.velocity, c)
    forget_fixes(state, True)
    return True


@compiled
def _drift(refused: Any, count: int) -> Drift:
    """Of ``count`` refused fixes; in closed form."""
    last_ns, middle, variance = refused[count - 1].stamp_ns, 0.0, 0.0
    e_x = e_y = 0.0
    for k in range(count):
        middle += (refused[k].stamp_ns - last_ns) * 1e-9 / count
        e_x += (refused[k].x - refused[k].predicted_x) / count
        e_y += (refused[k].y - refused[k].predicted_y) / count
        variance += refused[k].variance / count
    spread = by_x = by_y = square = 0.0
    for k in range(count):
        t = (refused[k].stamp_ns - last_ns) * 1e-9 - middle
        x, y = refused[k].x - refused[k].predicted_x - e_x, refused[k].y - refused[k].predicted_y - e_y
        spread, square = spread + t * t, square + x * x + y * y
        by_x, by_y = by_x + t * x, by_y + t * y
    spread = max(spread, 1e-12)
    v_x, v_y = by_x / spread, by_y / spread
    chi2 = (square - (by_x * by_x + by_y * by_y) / spread) / variance
    begin = (refused[0].stamp_ns - last_ns) * 1e-9
    end = e_x - v_x * middle, e_y - v_y * middle
    return Drift(begin, (v_x, v_y), end, math.sqrt(variance / spread), chi2, variance)


@compiled
def _leads_down(state: Any, drift: tuple[float, float], speed: float) -> bool:
    """Whether a drift goes downhill."""
    (east, north), level = drift, state.attitude.level
    cos, sin = math.cos(state.mean[YAW]), math.sin(state.mean[YAW])
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
def _open(state: Any, drift: tuple[float, float], c: Any) -> None:
    """P with k and i₀ as large as would make the drift."""
    (east, north), P = drift, state.covariance
    cos, sin = math.cos(state.mean[YAW]), math.sin(state.mean[YAW])
    U = max(c.rolling_radius * abs(state.speeds.left + state.speeds.right) / 2.0, _SLOWEST)
    across = max(abs(state.attitude.level.downhill_y), GENTLE)
    P[DOWNHILL, DOWNHILL] += ((cos * north - sin * east) / (U * across)) ** 2
    P[COMMON_SLIP, COMMON_SLIP] += min(((cos * east + sin * north) / U) ** 2, _MOST**2)
