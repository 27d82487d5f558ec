# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Gate and update with the odometry of a laser or a camera; compiled.

    z, R    mean velocity of C over T along the machine's axes, mean yaw rate (``increments``)
    T       time between two poses of the source                                            s
    s_o     by how much its lengths err: a state of each source                             1
    m       velocity errors (``speed``)                                                     m/s, rad/s
    D       variance of the mean of m over T that m at its end leaves open                  (3,)
    C       covariance of the pose with that                                                (n, 3)
    f       factor of R (``adaptation``)                                                    1

Where a source believes to be drifts, and is never used; what it moved between two poses is. It is held
against what the filter predicted meanwhile. That errs by the slow states, and by the mean of m: in part as m
does at the end of T. The rest has moved the pose too: by C the update takes that back, so that a way that the
tracks slipped and a camera has not seen was not driven. A fix since the first pose has done so already; then
there is no C.

Odometry and tracks show nothing of s_o, which fixes do: it stays as it was (Schmidt). Inside the gate an
increment is used in full; with less weight where only the largest track error explains it; beyond it is
refused, until the source has insisted for long enough (``gate``). Where increments of a second or two agree
that both tracks slip more or less than what is known allows, they run on other ground: i₀ is open again.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trackslip_common.compiled import compiled, inlined
from trackslip_estimation.kalman.ekf import correct_shared
from trackslip_estimation.kalman.linear_algebra import log_determinant, root, sandwich, weighted_square, wrap
from trackslip_estimation.slip.adaptation import learn_from_fix, learn_from_speed
from trackslip_estimation.slip.increments import increment, variances_stated
from trackslip_estimation.slip.measurements import Outcome
from trackslip_estimation.slip.models import speed
from trackslip_estimation.slip.models.dispatch import body_jacobian, body_twist, has_velocity_errors
from trackslip_estimation.slip.models.model import YAW, X, Y
from trackslip_estimation.slip.models.speed import COMMON_SLIP, SPEED_ERROR, YAW_RATE_ERROR
from trackslip_estimation.slip.motion import Motion
from trackslip_estimation.slip.odometry_errors import (
    add_count_rounding,
    by_track_error,
    shared_with_pose,
    unseen_errors,
)
from trackslip_estimation.slip.update import width_of
from trackslip_estimation.slip.usable import FASTEST, FASTEST_TURN

FloatArray = NDArray[np.float64]

_GATED, _BEGUN, _STANDING = int(Outcome.GATED), int(Outcome.BEGUN), int(Motion.STANDING)
_LATE = 2.0  # s of increments that agree on other ground
_SLOWEST = 0.02  # m/s of the tracks, below which nothing is said of slip
_SIGNIFICANT = 3.0  # standard deviations of a slip that differs


@compiled
def _agree_on_nothing(before: Any) -> None:
    before.slip_weight = before.slip_sum = before.slip_way = 0.0
    before.slip_ns = before.stamp_ns


@compiled
def begin_odometry(state: Any) -> None:
    """At the start of the estimate."""
    state.driven[:], state.moved[:], state.fixed_ns = 0.0, 0.0, state.stamp_ns
    for k in range(state.odometry.size):
        state.odometry[k].known = False
        _agree_on_nothing(state.odometry[k])


@compiled
def follow_motion(state: Any, dt: float, c: Any) -> None:
    """What is predicted to move in the next ``dt`` s, before it does."""
    if c.odometries == 0:
        return
    left, right, x = state.speeds.left, state.speeds.right, state.mean.copy()
    if has_velocity_errors(c):
        share = speed.persistence(dt, state.motion.motion, c)[1]
        x[SPEED_ERROR] *= share
        x[YAW_RATE_ERROR] *= share
    v_x, v_y, rate = body_twist(x, left, right, state, c)
    state.driven[0] += left * dt
    state.driven[1] += right * dt
    state.moved[0] += v_x * dt
    state.moved[1] += v_y * dt
    state.moved[2] += rate * dt


@inlined
def use_odometry(state: Any, measurement: Any, c: Any, update: Any) -> None:
    """See the top of the module; arguments as in ``update``."""
    source = measurement.source
    before = state.odometry[c.odometry_number[source]]
    T = (measurement.stamp_ns - before.stamp_ns) * 1e-9
    if before.known and before.frame == measurement.frame and before.coasting == state.coasting:
        if c.odometry_gap[source] >= T:
            z, stated = increment(before, measurement, T, c), variances_stated(before, measurement, T, c)
            if max(abs(z[0]), abs(z[1])) < FASTEST and abs(z[2]) < FASTEST_TURN:
                _use(state, (z, np.diag(stated), T), measurement, c, update)
            else:
                update.outcome = _GATED
        else:
            update.outcome = _BEGUN
    else:
        update.outcome = _BEGUN
    before.known, before.coasting, before.stamp_ns = True, state.coasting, measurement.stamp_ns
    before.frame, before.place[:], before.turn[:] = measurement.frame, measurement.value, measurement.turn
    before.noise[:], before.driven[:], before.moved[:] = measurement.noise, state.driven, state.moved
    before.errors[0] = state.covariance[SPEED_ERROR, SPEED_ERROR]
    before.errors[1] = state.covariance[YAW_RATE_ERROR, YAW_RATE_ERROR]


@compiled
def _use(
    state: Any, measured: tuple[FloatArray, FloatArray, float], measurement: Any, c: Any, update: Any
) -> None:
    """Gate and update; ``measured`` are z, R (3, 3) as stated, and T."""
    (z, stated, T), source = measured, measurement.source
    limit, factors = c.gate_limits[3], state.adaptation.fix_factors
    before = state.odometry[c.odometry_number[source]]
    left, right = (state.driven[0] - before.driven[0]) / T, (state.driven[1] - before.driven[1]) / T
    share, open_ = unseen_errors(state, before, (left, right, T), c)
    h, H = _expected(state, before, (left, right, T), (source, share), c)
    D = np.diag(open_)
    add_count_rounding(state, (left, right, T), c, D)
    innovation = z - h
    if has_velocity_errors(c) and not state.coasting:
        of_errors = H[0, SPEED_ERROR] ** 2 * state.covariance[SPEED_ERROR, SPEED_ERROR] + D[0, 0]
        own = factors[source] * stated[0, 0] + of_errors * max(2.0 * c.velocity_errors.time / T, 1.0)
        _weigh_slip(state, before, (innovation[0], c.rolling_radius * (left + right) / 2.0, T), (H, own), c)
        update.prior_covariance[:] = state.covariance
    predicted = sandwich(H, state.covariance[:]) + D
    update.dof, update.gate = 3, limit * width_of(state, measurement, c)
    shown = innovation, predicted, stated
    surprise = _least_surprise(state, source, shown, (left, right, T), update.gate, c)
    R = factors[source] * stated
    S = predicted + R
    L = root(S)
    update.nis, update.log_determinant = weighted_square(L, innovation), log_determinant(L)
    if surprise > update.gate:
        update.outcome = _GATED
        return
    if surprise > limit:
        update.prior_covariance[SPEED_ERROR, SPEED_ERROR] += innovation[0] ** 2
        update.prior_covariance[YAW_RATE_ERROR, YAW_RATE_ERROR] += innovation[2] ** 2
        state.covariance[:] = update.prior_covariance
    elif update.nis > limit:
        R = R + (update.nis / limit - 1.0) * S
    C = shared_with_pose(state, before.stamp_ns, T, open_)
    correct_shared(state.mean[:], state.covariance[:], (innovation, R + D), H, C, c.own_errors[source])
    state.mean[YAW] = wrap(state.mean[YAW])
    state.consistent_ns[source] = measurement.stamp_ns


@inlined
def _least_surprise(
    state: Any,
    source: int,
    shown: tuple[FloatArray, FloatArray, FloatArray],
    drive: tuple[float, float, float],
    gate: float,
    c: Any,
) -> float:
    """NIS with the largest track error that may be; inside ``gate``, errors and noise are learned from it.

    ``shown``: the innovation, its covariance without R, and R as stated.
    """
    (innovation, predicted, stated), a = shown, state.adaptation
    S, by_tracks = predicted + a.fix_factors[source] * stated, np.zeros(3)
    most = S.copy()
    if has_velocity_errors(c) and not state.coasting:
        by_tracks[:] = by_track_error(state, drive, c)
        lacking = c.adaptation.track_variances[-1] - a.track_variance
        for k in range(3):
            most[k, k] += lacking * by_tracks[k]
    surprise = weighted_square(root(most), innovation)
    if has_velocity_errors(c) and surprise <= gate:
        stands = state.motion.motion == _STANDING
        learn_from_speed(a, (innovation[0], S[0, 0], by_tracks[0]), stands, c)
        if weighted_square(root(S), innovation) <= c.gate_limits[3]:
            learn_from_fix(a, source, innovation, predicted, stated, c)
    return surprise


@compiled
def _weigh_slip(
    state: Any, before: Any, shown: tuple[float, float, float], expected: tuple[FloatArray, float], c: Any
) -> None:
    """i₀ is open again where increments of late agree on another one, and with it the way that they tell of.

    ``shown``: innovation and mean speed of the tracks, m/s, and T; ``expected``: H, and the variance of what
    is another one in each increment.
    """
    (innovation, track, T), (H, own) = shown, expected
    x, P = state.mean[:], state.covariance[:]
    if abs(track) < max(_SLOWEST, abs(innovation)):  # no ground does that
        return
    slow = H[:1].copy()
    slow[0, SPEED_ERROR] = slow[0, YAW_RATE_ERROR] = 0.0
    known = sandwich(slow, P)[0, 0]
    kept = math.exp(-T / _LATE)
    before.slip_weight = kept * before.slip_weight + track * track / own
    before.slip_sum = kept * before.slip_sum - track * innovation / own
    before.slip_way += track * T
    off, variance = before.slip_sum / before.slip_weight, 1.0 / before.slip_weight + known / (track * track)
    if off * off <= variance:
        before.slip_way, before.slip_ns = 0.0, before.stamp_ns
    elif off * off > _SIGNIFICANT**2 * variance:
        way = before.slip_way if state.fixed_ns < before.slip_ns else 0.0
        by = np.zeros(P.shape[0])
        by[COMMON_SLIP], by[X], by[Y] = off, -off * way * math.cos(x[YAW]), -off * way * math.sin(x[YAW])
        P += np.outer(by, by)
        _agree_on_nothing(before)


@compiled
def _expected(
    state: Any, before: Any, drive: tuple[float, float, float], of: tuple[int, tuple[float, float]], c: Any
) -> tuple[FloatArray, FloatArray]:
    """h (3,) and H (3, n).

    ``drive``: mean sprocket speeds over T, rad/s, and T. ``of``: number of the source, and by how much the
    means of both velocity errors err as they do now.
    """
    (left, right, T), (source, share) = drive, of
    own, h = c.own_errors[source], (state.moved - before.moved) / T
    scale = 1.0 + (state.mean[own] if own >= 0 else 0.0)
    H = body_jacobian(state.mean[:], left, right, state, c)
    for i in range(3):
        if has_velocity_errors(c):
            H[i, SPEED_ERROR] *= share[0]
            H[i, YAW_RATE_ERROR] *= share[1]
        if i < YAW:
            for j in range(state.mean.size):
                H[i, j] *= scale
            if own >= 0:
                H[i, own] = h[i]
            h[i] *= scale
    return h, H
