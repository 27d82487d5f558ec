# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The pose found again from fixes that were refused, or at first where the start has no heading; compiled.

    p_k, z_k   place of the sensor as predicted, and as its fix has it    (2,), m
    ψ, σ_ψ     rotation about the centroids that takes p_k to z_k         rad
    s          track error (``adaptation``)                               1

No refused fix is believed for its own sake, nor because its source insists. Several are that agree with each
other over the way driven between them: one rigid motion takes what was predicted to what they say, within
their noise and what the tracks err by over that way, and the way is long enough to fix ψ. Then the pose moves
so, with the covariance of that fit. If it turns, what had been learned while the heading was wrong is as at
the start; else heading and all that was learned stay. Fixes of the newest motion count: where they do not
agree, the oldest is dropped. On a slope a machine may slide and not go where it looks: where the fixes show
its heading, or a compass does, they turn nothing there, and k is open.

As long as no heading is known, fixes inside their gate hold the place, and each metre driven since the last
of them doubts it; nothing of that turns the machine.

A machine that stands shows no such way. There fixes that agree are believed once their source has insisted
for some timeouts: the place moves to them.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from trackslip_common.compiled import compiled
from trackslip_estimation.kalman.linear_algebra import wrap
from trackslip_estimation.slip.models.dispatch import has_velocity_errors
from trackslip_estimation.slip.models.model import DOWNHILL, FIX_DELAY, GYRO_SCALE, SIZE, SWING, YAW, X, Y
from trackslip_estimation.slip.models.speed import COMMON_SLIP, ROTATION_OFFSET, SECOND
from trackslip_estimation.slip.traction import FEWEST, PATH_ERROR, agree, find_slip

FloatArray = NDArray[np.float64]

CAPACITY = 16  # refused fixes that are remembered
UNKNOWN_HEADING = 1.0  # rad, standard deviation beyond which there is none
_DIRECTION_DOUBT = 1.5  # of the way squared, along it: E(1 − cos φ)², any direction φ being as likely
_SHIFT_ERROR = 0.1  # of the way between the fixes and the pose
_SIGNIFICANT = 3.0  # standard deviations of a rotation
GENTLE, _STEEP = 0.05, 0.1  # sines of slopes
_INSISTS = 3  # timeouts without a fix inside its gate, after which fixes that agree at rest are believed


class RigidMotion(NamedTuple):
    """What takes predicted places to fixes."""

    rotation: float  # ψ, rad
    stddev: float  # σ_ψ, rad
    chi2: float
    origin: tuple[float, float]  # centroid of the predicted places
    target: tuple[float, float]  # centroid of the fixes
    variance: float  # of a fix along one axis, m²


@compiled
def keep_refused(
    state: Any, predicted: tuple[float, float], fix: tuple[float, float], variance: float
) -> None:
    """Remember a refused fix, for older ones if there is no room; ``variance`` is along one axis."""
    if state.refused_count == CAPACITY and state.aligning:
        thin(state)
    elif state.refused_count == CAPACITY:
        drop_oldest(state)
    refused = state.refused[state.refused_count]
    refused.predicted_x, refused.predicted_y = predicted
    refused.x, refused.y = fix
    refused.variance = variance
    refused.centre_x = fix[0] - predicted[0] + state.mean[X]
    refused.centre_y = fix[1] - predicted[1] + state.mean[Y]
    refused.way_x, refused.way_y, refused.stamp_ns = state.way[0], state.way[1], state.stamp_ns
    state.refused_count += 1


@compiled
def forget_refused(state: Any, anchored: bool) -> None:
    """A way begins here; ``anchored``: with a fix that was believed."""
    state.refused_count, state.anchored = 0, anchored
    state.way[:], state.anchor[:] = 0.0, state.mean[:YAW]


@compiled
def forget_fixes(state: Any, anchored: bool) -> None:
    """The place is no longer what fixes made it: none of them counts with the next as a stand or a run."""
    forget_refused(state, anchored)
    for k in range(len(state.runs)):
        state.stands[k].count = state.runs[k].count = 0
        state.runs[k].end = state.rolled


@compiled
def lose_heading(state: Any) -> None:
    """Begin to align where the heading has become too uncertain to be one."""
    if not state.aligning and state.covariance[YAW, YAW] > UNKNOWN_HEADING**2:
        state.aligning = True
        forget_fixes(state, False)


@compiled
def thin(state: Any) -> None:
    """Forget every second refused fix: as long as no heading is known, the way from the start counts."""
    for k in range(CAPACITY // 2):
        state.refused[k] = state.refused[2 * k]
    state.refused_count = CAPACITY // 2


@compiled
def drop_oldest(state: Any) -> None:
    """Forget the oldest refused fix."""
    state.refused_count -= 1
    for k in range(state.refused_count):
        state.refused[k] = state.refused[k + 1]


@compiled
def rigid_motion(refused: Any, count: int, track_variance: float) -> RigidMotion:
    """The least-squares one of ``count`` refused fixes; in closed form."""
    p_x = p_y = z_x = z_y = variance = 0.0
    for k in range(count):
        p_x, p_y = p_x + refused[k].predicted_x / count, p_y + refused[k].predicted_y / count
        z_x, z_y = z_x + refused[k].x / count, z_y + refused[k].y / count
        variance += refused[k].variance / count
    along = across = spread = 0.0
    for k in range(count):
        a_x, a_y = refused[k].predicted_x - p_x, refused[k].predicted_y - p_y
        b_x, b_y = refused[k].x - z_x, refused[k].y - z_y
        along += a_x * b_x + a_y * b_y
        across += a_x * b_y - a_y * b_x
        spread += a_x * a_x + a_y * a_y
    rotation = math.atan2(across, along)
    cos, sin = math.cos(rotation), math.sin(rotation)
    path_variance = max(PATH_ERROR * PATH_ERROR, track_variance)
    chi2 = 0.0
    for k in range(count):
        a_x, a_y = refused[k].predicted_x - p_x, refused[k].predicted_y - p_y
        e_x = refused[k].x - z_x - (cos * a_x - sin * a_y)
        e_y = refused[k].y - z_y - (sin * a_x + cos * a_y)
        chi2 += (e_x * e_x + e_y * e_y) / (variance + path_variance * (a_x * a_x + a_y * a_y))
    stddev = math.sqrt((variance + path_variance * spread / count) / max(spread, 1e-12))
    stddev *= max(spread / max(math.hypot(along, across), 1e-12), 1.0)  # more, where it hardly goes
    return RigidMotion(rotation, stddev, chi2, (p_x, p_y), (z_x, z_y), variance)


@compiled
def doubt_direction(state: Any, from_x: float, from_y: float) -> None:
    """P after a step from there to a place that is known only if the heading is; across it P grows by σ_ψ."""
    P = state.covariance
    before = (from_x - state.anchor[0], from_y - state.anchor[1])
    now = (state.mean[X] - state.anchor[0], state.mean[Y] - state.anchor[1])
    for i in (X, Y):
        for j in (X, Y):
            P[i, j] += _DIRECTION_DOUBT * (now[i] * now[j] - before[i] * before[j])


@compiled
def hold_place(state: Any, shift: FloatArray, covariance: FloatArray) -> None:
    """The place, and those of the refused fixes beside it, moved by a fix: (2,), and (2, 2) after it."""
    x, P = state.mean, state.covariance
    for i in (X, Y):
        x[i] += shift[i]
        P[i, :] = P[:, i] = 0.0
    P[:YAW, :YAW] = covariance
    state.anchor[:] = x[:YAW]
    for k in range(state.refused_count):
        state.refused[k].predicted_x += shift[X]
        state.refused[k].predicted_y += shift[Y]


@compiled
def insists(state: Any, source: int, stamp_ns: int, c: Any) -> bool:
    """Whether a source has had no fix inside its gate for so long that it is believed at rest."""
    return bool(stamp_ns - state.consistent_ns[source] > _INSISTS * c.timeouts_ns[source])


@compiled
def compass_agrees(state: Any, stamp_ns: int, c: Any) -> bool:
    """Whether a source of headings was inside its gate lately."""
    for k in range(c.compass.size):
        heard = c.compass[k] == 1 and state.heard_ns[k] >= state.consistent_ns[k]
        if heard and stamp_ns - state.consistent_ns[k] <= c.timeouts_ns[k]:
            return True
    return False


@compiled
def realign(state: Any, at_rest: bool, heading_shown: bool, c: Any) -> bool:
    """Move the pose by what the newest refused fixes that agree show; whether they show enough.

    ``at_rest``: whether they may do so over no way driven.
    """
    while True:
        count = state.refused_count
        found = rigid_motion(state.refused, count, state.adaptation.track_variance)
        if count >= FEWEST and agree(found.chi2, 2.0 * count - 3.0):
            if found.stddev < c.adaptation.alignment_stddev:
                _follow(state, found, heading_shown, c)
            elif at_rest and not state.aligning:
                _shift(state, found)
            else:
                return False
            break
        if has_velocity_errors(c) and not state.aligning and find_slip(state):
            break
        if count < FEWEST:
            return False
        drop_oldest(state)
    state.aligning = False
    forget_fixes(state, True)
    return True


@compiled
def _follow(state: Any, found: RigidMotion, heading_shown: bool, c: Any) -> None:
    """The pose after a rigid motion, and what else that says."""
    doubt = math.sqrt(found.stddev * found.stddev + state.covariance[YAW, YAW])
    if state.aligning:
        move_pose(state, found)
    elif abs(found.rotation) > _SIGNIFICANT * doubt and heading_shown and is_steep(state):
        _shift(state, found)
        _open_slide(state, found)
    elif abs(found.rotation) > _SIGNIFICANT * doubt:
        move_pose(state, found)
        _forget(state, c)
    else:
        _shift(state, found)
    if c.swings:  # what sits above may have turned, instead
        state.covariance[SWING, SWING] += found.rotation**2


@compiled
def is_steep(state: Any) -> bool:
    """Whether the ground is so steep that a machine may slide on it."""
    level = state.attitude.level
    return bool(level.tilted == 1 and level.downhill_x**2 + level.downhill_y**2 > _STEEP**2)


@compiled
def _open_slide(state: Any, by: RigidMotion) -> None:
    """P with k as large as makes the way of the rotated one."""
    across = max(abs(state.attitude.level.downhill_y), GENTLE)
    state.covariance[DOWNHILL, DOWNHILL] += (math.sin(by.rotation) / across) ** 2


@compiled
def move_pose(state: Any, by: RigidMotion) -> None:
    """The pose after a rigid motion, with the covariance of its fit."""
    x, P = state.mean, state.covariance
    cos, sin = math.cos(by.rotation), math.sin(by.rotation)
    from_x, from_y = x[X] - by.origin[0], x[Y] - by.origin[1]
    east, north = cos * from_x - sin * from_y, sin * from_x + cos * from_y
    x[X], x[Y], x[YAW] = by.target[0] + east, by.target[1] + north, wrap(x[YAW] + by.rotation)
    for i in range(YAW + 1):
        for j in range(SIZE):
            P[i, j] = P[j, i] = 0.0
    turned = by.stddev * by.stddev
    shifted = by.variance / state.refused_count + _SHIFT_ERROR**2 * (east * east + north * north)
    P[X, X], P[Y, Y], P[YAW, YAW] = shifted + turned * north**2, shifted + turned * east**2, turned
    P[X, Y] = P[Y, X] = -turned * east * north
    P[X, YAW] = P[YAW, X] = -turned * north
    P[Y, YAW] = P[YAW, Y] = turned * east


@compiled
def _shift(state: Any, by: RigidMotion) -> None:
    """The place after a motion that turns nothing; heading and all that was learned stay."""
    x, P = state.mean, state.covariance
    from_x, from_y = x[X] - by.origin[0], x[Y] - by.origin[1]
    x[X], x[Y] = by.target[0] + from_x, by.target[1] + from_y
    for i in (X, Y):
        for j in range(SIZE):
            P[i, j] = P[j, i] = 0.0
    shifted = by.variance / state.refused_count + _SHIFT_ERROR**2 * (from_x * from_x + from_y * from_y)
    P[X, X] = P[Y, Y] = shifted


@compiled
def _forget(state: Any, c: Any) -> None:
    """What fixes teach through the pose counts for no more than at the start; the gyro taught κ and b_g."""
    x, P = state.mean, state.covariance
    for q in (GYRO_SCALE, FIX_DELAY, SECOND, COMMON_SLIP, ROTATION_OFFSET):
        if has_velocity_errors(c) and P[q, q] < c.prior_variance[q]:
            for j in range(SIZE):
                P[q, j] = P[j, q] = 0.0
            x[q], P[q, q] = c.prior_mean[q], c.prior_variance[q]
