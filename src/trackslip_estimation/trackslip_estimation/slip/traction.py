# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Traction that both tracks lost or found again, seen in fixes; compiled.

    w_k   way of the tracks, without slip, from the last fix inside its gate to refused fix k    (2,), m
    c_k   place of C by that fix: c_k = a + λ w_k                                               (2,), m
    λ     1 − i₀                                                                                1

A machine that digs itself in goes on turning its tracks, and its fixes stay where they are: no rigid motion
takes the way that was predicted to them (``alignment``), but another slip does. Several must agree on it, the
last one inside its gate among them, for which c is the estimate. Then C is on that line, and i₀ is what it
shows. The heading stays as it was.

Tracks that lose their grip by and by are followed too late: fixes err to the same side, each by no more than
its gate allows. When the mean of such a run is more than it should be, i₀ may have changed as it began, by
what explains it, −δ/w:

    ν       innovation of its last fix along the heading                            m
    δ       ν, and what the fixes before it in the run have moved the place         m
    w       way of the tracks, without slip, since the last fix before the run      m
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from trackslip_common.compiled import compiled
from trackslip_estimation.slip.models.dispatch import has_velocity_errors
from trackslip_estimation.slip.models.model import SIZE, YAW, X, Y
from trackslip_estimation.slip.models.speed import COMMON_SLIP
from trackslip_estimation.slip.models.swing import may_swing
from trackslip_estimation.slip.motion import Motion

FloatArray = NDArray[np.float64]

FEWEST = 3  # fixes that show anything by agreeing
PATH_ERROR = 0.05  # of the way driven
_LEAST, _MOST = -0.5, 1.5  # λ on any ground: a machine may slide ahead of its tracks, or back against them
_STDDEV = 0.15  # of a λ that is believed
_STANDING = int(Motion.STANDING)
_RUN = 4  # fixes of one that shows anything
_SURPRISE = 4.5  # standard deviations of its mean; 4 come by chance once in 100 drives of a minute
_CHI2_RATIO, _CHI2_SPARE = 1.6, 12.0  # χ² of fixes that agree: at most ratio · dof + spare


class SharedSlip(NamedTuple):
    """The least-squares line through the c_k over the w_k."""

    share: float  # λ
    variance: float  # of it
    of_place: float  # variance of the mean of the c_k along one axis, m²
    place: tuple[float, float]  # that mean, m
    way: tuple[float, float]  # mean of the w_k, m
    agrees: bool


@compiled
def agree(chi2: float, dof: float) -> bool:
    """Whether fixes do that are so far from what is fitted to them."""
    return chi2 <= _CHI2_RATIO * dof + _CHI2_SPARE


@compiled
def follow_tracks(state: Any, dt: float, c: Any) -> None:
    """What the tracks go in ``dt`` s."""
    state.ran += c.rolling_radius * (abs(state.speeds.left) + abs(state.speeds.right)) / 2.0 * dt
    gone = c.rolling_radius * (state.speeds.left + state.speeds.right) / 2.0 * dt
    if gone != 0.0:
        state.rolled += gone
        heading = state.mean[YAW]
        state.way[0] += gone * math.cos(heading)
        state.way[1] += gone * math.sin(heading)


@compiled
def shared_slip(refused: Any, count: int, anchor: Any, anchored: bool) -> SharedSlip:
    """By ``count`` refused fixes; ``anchored``: and by ``anchor``, c (2,) where w = 0."""
    n = count + 1.0 if anchored else float(count)
    c_x, c_y = (anchor[0] / n, anchor[1] / n) if anchored else (0.0, 0.0)
    w_x = w_y = of_fix = 0.0
    for fix in refused[:count]:
        c_x, c_y = c_x + fix.centre_x / n, c_y + fix.centre_y / n
        w_x, w_y = w_x + fix.way_x / n, w_y + fix.way_y / n
        of_fix += fix.variance / count
    along = spread = square = 0.0
    for k in range(count + 1 if anchored else count):
        if k < count:
            a_x, a_y, b_x, b_y = refused[k].way_x, refused[k].way_y, refused[k].centre_x, refused[k].centre_y
        else:
            a_x, a_y, b_x, b_y = 0.0, 0.0, anchor[0], anchor[1]
        a_x, a_y, b_x, b_y = a_x - w_x, a_y - w_y, b_x - c_x, b_y - c_y
        along += a_x * b_x + a_y * b_y
        spread += a_x * a_x + a_y * a_y
        square += b_x * b_x + b_y * b_y
    share = along / max(spread, 1e-12)
    variance = of_fix + PATH_ERROR**2 * spread / n
    agrees = agree((square - share * along) / variance, 2.0 * n - 3.0)
    return SharedSlip(share, variance / max(spread, 1e-12), of_fix / n, (c_x, c_y), (w_x, w_y), agrees)


@compiled
def along_heading(state: Any, v: FloatArray) -> float:
    """Of a vector (2,) of the site frame."""
    return float(math.cos(state.mean[YAW]) * v[X] + math.sin(state.mean[YAW]) * v[Y])


@compiled
def variance_along(state: Any, M: FloatArray) -> float:
    """Of a vector of the site frame with covariance M (2, 2), along the heading."""
    cos, sin = math.cos(state.mean[YAW]), math.sin(state.mean[YAW])
    return float(cos * cos * M[X, X] + cos * sin * (M[X, Y] + M[Y, X]) + sin * sin * M[Y, Y])


@compiled
def goes_on(run: Any, along: float) -> bool:
    """Whether a fix whose innovation is ``along`` the heading errs to the same side as those before it."""
    return bool(run.count > 0 and along * run.sum > 0.0)


@compiled
def changed_slip(
    state: Any, source: int, shown: tuple[float, FloatArray, FloatArray], c: Any
) -> tuple[float, float]:
    """ν and −δ/w, where a run with this fix is too far to one side to be believed; else nothing.

    ``shown``: ν, the covariance of the place as predicted, and R with what the fix shares with others. A
    machine that stands shows no slip.
    """
    if not has_velocity_errors(c) or may_swing(state, source, c):
        return 0.0, 0.0
    run, (along, predicted, R) = state.runs[source], shown
    stands = state.motion.motion == _STANDING or state.coasting
    if stands or not goes_on(run, along):
        run.count, run.sum, run.pulled, run.begin = 0, 0.0, 0.0, run.end
    run.end = state.rolled
    if stands:
        return 0.0, 0.0
    run.count += 1
    run.sum += along
    variance = variance_along(state, predicted) + variance_along(state, R) / run.count
    if run.count < _RUN or (run.sum / run.count) ** 2 <= _SURPRISE**2 * variance:
        return 0.0, 0.0
    moved, way = run.pulled + along, run.end - run.begin
    run.count = 0
    return along, -moved / way if abs(way) > abs(moved) / _MOST else 0.0


@compiled
def widen_slip(state: Any, P: FloatArray, changed: tuple[float, float]) -> None:
    """P with a change of i₀ that may be, and of the place with it: ``changed_slip``."""
    of_place, of_slip = changed
    at = (X, Y, COMMON_SLIP)
    by = (math.cos(state.mean[YAW]) * of_place, math.sin(state.mean[YAW]) * of_place, of_slip)
    for i in range(3):
        for j in range(3):
            P[at[i], at[j]] += by[i] * by[j]


@compiled
def find_slip(state: Any) -> bool:
    """Take i₀ and the place from the refused fixes; whether they show enough."""
    for anchored in (True, False):
        if anchored and not state.anchored:
            continue
        if state.refused_count + anchored < FEWEST:
            return False
        found = shared_slip(state.refused, state.refused_count, state.anchor, anchored)
        if found.agrees and _LEAST <= found.share <= _MOST and found.variance <= _STDDEV**2:
            _apply(state, found)
            return True
    return False


@compiled
def _apply(state: Any, found: SharedSlip) -> None:
    """C on the line and i₀ by it, with their covariance."""
    x, P = state.mean, state.covariance
    on_x, on_y = state.way[0] - found.way[0], state.way[1] - found.way[1]
    x[X], x[Y] = found.place[0] + found.share * on_x, found.place[1] + found.share * on_y
    x[COMMON_SLIP] = 1.0 - found.share
    by, at = (on_x, on_y, -1.0), (X, Y, COMMON_SLIP)
    for i in range(3):
        for j in range(SIZE):
            P[at[i], j] = P[j, at[i]] = 0.0
    for i in range(3):
        for j in range(3):
            P[at[i], at[j]] = by[i] * by[j] * found.variance
    P[X, X] += found.of_place
    P[Y, Y] += found.of_place
