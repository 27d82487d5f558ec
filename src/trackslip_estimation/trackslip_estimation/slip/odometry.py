# SPDX-License-Identifier: Apache-2.0
"""Gate and update with the odometry of a laser or a camera; compiled.

    z, R    mean velocity of C over T along the machine's axes, mean yaw rate (``increments``)
    T       time between two poses of the source                                            s
    s_o     by how much its lengths err: a state of each source                             1
    m       velocity errors (``speed``)                                                     m/s, rad/s
    D       variance of z that m at the end of T leaves open                                (3,)
    C       covariance of the pose with it                                                  (n, 3)
    f       factor of R (``adaptation``)                                                    1

Where a source believes to be drifts, and is never used; what it moved between two poses is. The motion model
says as much of the sprockets' mean speeds over T; m at its end tells of its mean. What it leaves open has
moved the pose too: by C the update takes that back, so that a way that the tracks slipped and a camera has
not seen was not driven. A fix since the first pose has done so already; then there is no C.

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
from trackslip_estimation.kalman.linear_algebra import (
    joseph,
    log_determinant,
    root,
    sandwich,
    solve,
    times,
    weighted_square,
    wrap,
)
from trackslip_estimation.slip.adaptation import learn_from_fix, learn_from_speed
from trackslip_estimation.slip.increments import increment, variances_stated
from trackslip_estimation.slip.measurements import Outcome
from trackslip_estimation.slip.models import speed
from trackslip_estimation.slip.models.dispatch import body_jacobian, body_twist, has_velocity_errors
from trackslip_estimation.slip.models.model import YAW, X, Y
from trackslip_estimation.slip.models.speed import COMMON_SLIP, SPEED_ERROR, YAW_RATE_ERROR
from trackslip_estimation.slip.motion import Motion, rounding
from trackslip_estimation.slip.update import width_of

FloatArray = NDArray[np.float64]

_GATED, _BEGUN, _STANDING = int(Outcome.GATED), int(Outcome.BEGUN), int(Motion.STANDING)
_LATE = 2.0  # s of increments that agree on other ground
_SLOWEST = 0.02  # m/s of the tracks, below which nothing is said of slip
_LASTS = 1.0  # s for which an unknown speed lasts, as in ``coasting``


@compiled
def _agree_on_nothing(before: Any) -> None:
    before.slip_weight = before.slip_sum = before.slip_way = 0.0


@compiled
def begin_odometry(state: Any) -> None:
    """At the start of the estimate."""
    state.driven[:], state.fixed_ns = 0.0, state.stamp_ns
    for k in range(state.odometry.size):
        state.odometry[k].known = False
        _agree_on_nothing(state.odometry[k])


@inlined
def use_odometry(state: Any, measurement: Any, c: Any, update: Any) -> None:
    """See the top of the module; arguments as in ``update``."""
    source = measurement.source
    before = state.odometry[c.odometry_number[source]]
    T = (measurement.stamp_ns - before.stamp_ns) * 1e-9
    if before.known and before.frame == measurement.frame and before.coasting == state.coasting:
        if T <= c.odometry_gap[source]:
            z, stated = increment(before, measurement, T, c), variances_stated(before, measurement, T, c)
            _use(state, (z, np.diag(stated), T), measurement, c, update)
        else:
            update.outcome = _BEGUN
    else:
        update.outcome = _BEGUN
    before.known, before.coasting, before.stamp_ns = True, state.coasting, measurement.stamp_ns
    before.frame, before.place[:], before.turn[:] = measurement.frame, measurement.value, measurement.turn
    before.noise[:], before.driven[:] = measurement.noise, state.driven


@compiled
def _use(
    state: Any, measured: tuple[FloatArray, FloatArray, float], measurement: Any, c: Any, update: Any
) -> None:
    """Gate and update; ``measured`` are z, R (3, 3) as stated, and T."""
    (z, stated, T), source, a = measured, measurement.source, state.adaptation
    limit, factors = c.gate_limits[3], a.fix_factors
    before = state.odometry[c.odometry_number[source]]
    left, right = (state.driven[0] - before.driven[0]) / T, (state.driven[1] - before.driven[1]) / T
    h, H = _expected(state, (left, right, T), source, c)
    open_, D = _left_open(state, (left, right, T), c), np.zeros((3, 3))
    for k in range(3):
        D[k, k] = open_[k]
    _add_rounding(state, (left, right, T), source, c, D)
    innovation = z - h
    if has_velocity_errors(c) and not state.coasting:
        of_errors = H[0, SPEED_ERROR] ** 2 * state.covariance[SPEED_ERROR, SPEED_ERROR] + D[0, 0]
        own = factors[source] * stated[0, 0] + of_errors * max(2.0 * c.velocity_errors.time / T, 1.0)
        _weigh_slip(state, before, (innovation[0], c.rolling_radius * (left + right) / 2.0, T), (H, own), c)
    predicted = sandwich(H, state.covariance) + D
    S = predicted + factors[source] * stated
    update.dof, update.gate = 3, limit * width_of(state, measurement, c)
    most, by_tracks = S.copy(), np.zeros(3)
    if has_velocity_errors(c) and not state.coasting:
        share = speed.persistence(T, state.motion.motion, c)[1]
        by_tracks[:] = _by_tracks(state, (left, right, T), share, c)
        lacking = c.adaptation.track_variances[-1] - a.track_variance
        for k in range(3):
            most[k, k] += lacking * by_tracks[k]
    surprise = weighted_square(root(most), innovation)
    if has_velocity_errors(c) and surprise <= update.gate:
        stands = state.motion.motion == _STANDING
        learn_from_speed(a, (innovation[0], S[0, 0], by_tracks[0]), stands, c)
        if weighted_square(root(S), innovation) <= limit:
            learn_from_fix(a, source, innovation, predicted, stated, c)
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
    C = _shared(state, before.stamp_ns, T, open_)
    _correct(state, (innovation, R + D), H, C, c.own_errors[source])
    state.consistent_ns[source] = measurement.stamp_ns


@compiled
def _weigh_slip(
    state: Any, before: Any, shown: tuple[float, float, float], expected: tuple[FloatArray, float], c: Any
) -> None:
    """i₀ is open again where increments of late agree on another one, and with it the way that they tell of.

    ``shown``: innovation and mean speed of the tracks, m/s, and T; ``expected``: H, and the variance of what
    is another one in each increment.
    """
    (innovation, track, T), (H, own) = shown, expected
    x, P = state.mean, state.covariance
    if abs(track) < _SLOWEST:
        return
    slow = H[:1].copy()
    slow[0, SPEED_ERROR] = slow[0, YAW_RATE_ERROR] = 0.0
    known = sandwich(slow, P)[0, 0]
    kept = math.exp(-T / _LATE)
    before.slip_weight = kept * before.slip_weight + track * track / own
    before.slip_sum = kept * before.slip_sum - track * innovation / own
    before.slip_way = kept * before.slip_way + track * T
    off = before.slip_sum / before.slip_weight
    if off * off > c.gate_limits[1] * (1.0 / before.slip_weight + known / (track * track)):
        way = before.slip_way if state.fixed_ns < before.stamp_ns - round(_LATE * 1e9) else 0.0
        by = np.zeros(P.shape[0])
        by[COMMON_SLIP], by[X], by[Y] = off, -off * way * math.cos(x[YAW]), -off * way * math.sin(x[YAW])
        P += np.outer(by, by)
        _agree_on_nothing(before)


@compiled
def _expected(
    state: Any, drive: tuple[float, float, float], source: int, c: Any
) -> tuple[FloatArray, FloatArray]:
    """h (3,) and H (3, n); ``drive``: mean sprocket speeds over T, rad/s, and T."""
    (left, right, T), x, share = drive, state.mean.copy(), 1.0
    if has_velocity_errors(c):
        share = 0.0 if state.coasting else speed.persistence(T, state.motion.motion, c)[1]
        x[SPEED_ERROR] *= share
        x[YAW_RATE_ERROR] *= 1.0 if state.coasting else share
    v_x, v_y, rate = body_twist(x, left, right, state, c)
    H, own = body_jacobian(x, left, right, state, c), c.own_errors[source]
    if has_velocity_errors(c):
        for i in range(3):
            H[i, SPEED_ERROR] *= share
            H[i, YAW_RATE_ERROR] *= 1.0 if state.coasting else share
    scale = 1.0 + (x[own] if own >= 0 else 0.0)
    for j in range(x.size):
        H[0, j] *= scale
        H[1, j] *= scale
    if own >= 0:
        H[0, own], H[1, own] = v_x, v_y
    return np.array((scale * v_x, scale * v_y, rate)), H


@compiled
def _left_open(state: Any, drive: tuple[float, float, float], c: Any) -> FloatArray:
    """D. Where the sprockets are silent the machine may go as fast as it can."""
    (left, right, T), found = drive, np.zeros(3)
    if state.coasting:
        found[0] = found[1] = 2.0 * _LASTS * c.speed_limit**2 / T
        return found
    if has_velocity_errors(c):
        variances = speed.error_variances(state.mean, state.covariance, state, c)
        of_mean = speed.error_growth(T, state.motion.motion, c)[0]
        found[0], found[2] = of_mean * variances[0], of_mean * variances[1]
        found[1] = state.adaptation.track_variance * _sideways(left, right, T, c)
    return found


@compiled
def _sideways(left: float, right: float, T: float, c: Any) -> float:
    """Variance of the mean of v_y over T, by the tracks for a track error of 1 (``speed``), (m/s)²."""
    squares: float = c.rolling_radius**2 * (left * left + right * right)
    return float(c.adaptation.sideways**2 * squares / 4.0 * 2.0 * c.velocity_errors.time / T)


@compiled
def _by_tracks(state: Any, drive: tuple[float, float, float], share: float, c: Any) -> FloatArray:
    """(3,) what of S is the tracks', for a track error of 1."""
    left, right, T = drive
    a, of_mean = state.adaptation, speed.error_growth(T, state.motion.motion, c)[0]
    U = speed.track_exposure(state, c)
    ahead = c.adaptation.forward**2 / 4.0 * (share**2 * a.speed_exposure + of_mean * U)
    return np.array((ahead, _sideways(left, right, T, c), of_mean * U / c.tread**2))


@compiled
def _add_rounding(state: Any, drive: tuple[float, float, float], source: int, c: Any, D: FloatArray) -> None:
    """What the rounding of the counts adds to the expected means."""
    if not state.speeds.differenced or c.encoder_resolution == 0.0:
        return
    left, right, T = drive
    e = rounding(T, c.encoder_resolution)
    by_left = _expected(state, (left + e, right, T), source, c)[0]
    by_left -= _expected(state, (left - e, right, T), source, c)[0]
    by_right = _expected(state, (left, right + e, T), source, c)[0]
    by_right -= _expected(state, (left, right - e, T), source, c)[0]
    D += (np.outer(by_left, by_left) + np.outer(by_right, by_right)) / 4.0


@compiled
def _shared(state: Any, since_ns: int, T: float, open_: FloatArray) -> FloatArray:
    """C: the pose has moved by T times what ``open_`` (3,) are the variances of; none where a fix came since.

    A gyro may have shown what the yaw rate leaves open: that has none.
    """
    C = np.zeros((state.mean.size, 3))
    if state.fixed_ns <= since_ns:
        cos, sin = math.cos(state.mean[YAW]), math.sin(state.mean[YAW])
        C[X, 0], C[Y, 0] = cos * T * open_[0], sin * T * open_[0]
        C[X, 1], C[Y, 1] = -sin * T * open_[1], cos * T * open_[1]
    return C


@compiled
def _correct(
    state: Any, given: tuple[FloatArray, FloatArray], H: FloatArray, C: FloatArray, own: int
) -> None:
    """Kalman update with an innovation (3,) and R (3, 3), whose errors have the covariance C with the state's.

    K = (P Hᵀ + C) S⁻¹,  P ← (I − K H) P (I − K H)ᵀ + K R Kᵀ − C Kᵀ − K Cᵀ, for H C = 0: H has no pose.
    """
    (innovation, R), x, P = given, state.mean, state.covariance
    PHt = times(P, np.ascontiguousarray(H.T)) + C
    S = sandwich(H, P) + R
    K = np.ascontiguousarray(solve(root(S), np.ascontiguousarray(PHt.T)).T)
    if own >= 0:
        K[own] = 0.0
    after = joseph(P, K, H, R)
    by_C = times(C, np.ascontiguousarray(K.T))
    x += times(K, innovation.copy().reshape((3, 1)))[:, 0]
    x[YAW] = wrap(x[YAW])
    for i in range(x.size):
        for j in range(x.size):
            P[i, j] = after[i, j] - by_C[i, j] - by_C[j, i]
