# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Measurements that are weighed under one branch of the bank: evidence, noise and update; compiled.

    z, R   measurement, its noise as it is used                          (m,), (m, m)
    x, P   state in the coordinates of the measurement: its place is that of the sensor, its stamp error ago,
           with the source's offset
    ν, S   innovation and its covariance                                 (m,), (m, m)
    p      share of the source's measurements that are outliers          1

A measurement has two explanations inside a branch: it is sound, with a likelihood of Student's t over the
noise-factor masses, or it is an outlier of any size. The more likely one decides whether it is used: that is
the gate. ``update.evidence`` is the log of that likelihood, by which the bank weighs the branch. As tracks
start, or turn back, fixes do not correct their delay: the soil under them gives way first, which looks alike.
Fixes of a coarse receiver have its offset in them (``correlated_errors``); a large innovation
inflates that first. While the receiver errs to one side, they do not correct the bias of a gyro.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trackslip_common.compiled import compiled, inlined
from trackslip_estimation.kalman import ekf
from trackslip_estimation.kalman.linear_algebra import log_determinant, root, weighted_square, wrap
from trackslip_estimation.slip.adaptation import (
    density_of_fix,
    density_of_one,
    learn_from_fix,
    learn_from_speed,
    repeats,
    shared_error,
)
from trackslip_estimation.slip.correlated_errors import is_coarse, surprise
from trackslip_estimation.slip.events import (
    AREA,
    IS_IGNORED,
    IS_OFFSET,
    IS_REPEATING,
    IS_SCATTERING,
    IS_SOUND,
)
from trackslip_estimation.slip.levers import stamp_shift, to_delayed, to_sensor
from trackslip_estimation.slip.measurements import Outcome
from trackslip_estimation.slip.models.dispatch import has_velocity_errors
from trackslip_estimation.slip.models.model import FIX_DELAY, GYRO_BIAS, YAW, X, Y
from trackslip_estimation.slip.models.shear import starts
from trackslip_estimation.slip.motion import Motion
from trackslip_estimation.slip.observation import observed
from trackslip_estimation.slip.odometry_errors import by_track_error
from trackslip_estimation.slip.own_errors import (
    inflate_offset,
    is_correlated,
    is_new,
    lasting_share,
    learn_jitter,
    number_of,
    prepare_offset,
    spread_of,
    to_offset,
    to_shown_yaw,
)
from trackslip_estimation.slip.stands import count_fix, stands_still

FloatArray = NDArray[np.float64]

_GATED, _STANDING = int(Outcome.GATED), int(Motion.STANDING)
_LONGEST_WAY = 5.0  # s between fixes that show what tracks err by
_LOG_TURN = math.log(2.0 * math.pi)
_SIZES = (
    7.0  # ln of the largest over the smallest error of an outlier: any size is as likely, by its logarithm
)
_SHARE_MEMORY = 0.05  # of a measurement in the share of outliers
_OUTLIER_SHARE, _SOUND_SHARE = 0.5, 0.002  # that one measurement shows
_SAME = 1e-3  # m, standard deviation of a fix that repeats the one before


@compiled
def log_density_of_any_size(squared: float) -> float:
    """ln of the density of a place (2,) that errs by ``squared`` m², any logarithm of which is as likely."""
    return -math.log(2.0 * math.pi * _SIZES * squared)


@inlined
def use_pose(state: Any, measurement: Any, c: Any, update: Any) -> None:
    """Weigh a pose, and update with it; arguments as in ``update``."""
    source = measurement.source
    z, stated = observed(measurement, state, c)
    m, fault = z.size, state.fault[source]
    coarse, has_offset = (
        is_coarse(stated),
        prepare_offset(state, update, source, stated, fault == IS_OFFSET, c),
    )
    stddev = spread_of(stated)
    if has_offset and not coarse:
        stated = without_offset(state, source, stated, c)
    x, P, shift = state.mean[: c.size].copy(), state.covariance.copy(), stamp_shift(state, source, c)
    to_sensor(x, P, state.attitude.level, source, 1.0, c)
    to_delayed(x, P, shift, 1.0)
    to_shown_yaw(x, P, source, 1.0, c)
    update.stated, update.coarse = stddev, 1 if coarse else 0
    for axis in (X, Y):
        update.shown[axis] = z[axis] - x[axis] + state.mean[axis]
    elapsed = (measurement.stamp_ns - state.last_ns[source]) * 1e-9
    if not coarse and c.standing_share[source] == 0.0:
        offset = state.offsets[number_of(source, c)]
        learn_jitter(offset, update.shown, state.way, elapsed, stddev * stddev)
    known = repeats(measurement.stamp_ns - state.consistent_ns[source], c.repeat_times[source])
    if has_offset or fault == IS_OFFSET:
        to_offset(x, P, source, 1.0, c)
    innovation = _innovation(z, x)
    again = _compare_with_last(state, measurement, z, update)
    density = _density_of_outlier(innovation, P, stated, m)
    if fault == IS_REPEATING:
        _weigh_repeat(again, m, c, update)
        return
    if fault == IS_SCATTERING:
        update.evidence, update.outcome = -math.log(AREA) - (_LOG_TURN if m > YAW else 0.0), _GATED
        return
    R, used, alone = weigh(
        state, measurement, innovation, P[:m, :m].copy(), stated, coarse, density, c, update
    )
    _whiten(state, innovation, P, R, update)
    if not used:
        return
    if state.adaptation.elapsed > _LONGEST_WAY and fault == IS_SOUND and update.nis <= update.gate:
        _learn_track_error(state, innovation, P[:YAW, :YAW] + R[:YAW, :YAW], elapsed, c)
    if coarse and is_correlated(state, source, c):
        share = surprise(update.nis, m)
        inflate_offset(state, P, source, share * (np.diag(P)[:YAW] + np.diag(R)[:YAW]), c)
    R = inflated(innovation, P[:m, :m], R, c.gate_limits[m])
    R *= min(known, shared_error(P[:m, :m], R))
    count_fix(state, source, alone, R, c)
    ekf.correct_keeping(x, P, innovation, (np.eye(m, x.size), R), _not_taught(state, source, coarse, c))
    if has_offset or fault == IS_OFFSET:
        to_offset(x, P, source, -1.0, c)
    if fault == IS_OFFSET:
        update.outcome = _GATED
    to_shown_yaw(x, P, source, -1.0, c)
    to_delayed(x, P, shift, -1.0)
    x[YAW] = wrap(x[YAW])
    to_sensor(x, P, state.attitude.level, source, -1.0, c)
    state.mean[: c.size], state.covariance[:] = x, P


@compiled
def _learn_track_error(state: Any, innovation: FloatArray, S: FloatArray, elapsed: float, c: Any) -> None:
    """Fixes show what tracks err by aside, where no gyro does; ``elapsed``: s since the last one."""
    if not has_velocity_errors(c) or state.coasting or not 0.0 < elapsed <= _LONGEST_WAY:
        return
    cos, sin = math.cos(state.mean[YAW]), math.sin(state.mean[YAW])
    aside = (cos * innovation[Y] - sin * innovation[X]) / elapsed
    variance = (sin * sin * S[X, X] - 2.0 * cos * sin * S[X, Y] + cos * cos * S[Y, Y]) / elapsed**2
    left, right = state.speeds.left, state.speeds.right
    _, sideways, turning = by_track_error(state, (left, right, elapsed), c)
    way = c.rolling_radius * (left + right) / 2.0 * elapsed
    by_tracks = sideways + way * way * turning / 3.0
    stands = state.motion.motion == _STANDING
    learn_from_speed(state.adaptation, (aside, variance, by_tracks), stands, c)


@compiled
def _not_taught(state: Any, source: int, coarse: bool, c: Any) -> int:
    """State that a fix leaves as it is; −1: none."""
    if coarse and is_new(state, source, c):
        return GYRO_BIAS
    return FIX_DELAY if has_velocity_errors(c) and starts(state, c) else -1


@compiled
def weigh(
    state: Any,
    measurement: Any,
    innovation: FloatArray,
    predicted: FloatArray,
    stated: FloatArray,
    coarse: bool,
    density_of_outlier: float,
    c: Any,
    update: Any,
) -> tuple[FloatArray, bool, bool]:
    """R (m, m) of a measurement, whether it is used, and whether it counts alone; fills in ``update``.

    ``predicted``, ``stated``: covariance of the prediction, and R as its source states it, (m, m).
    ``coarse``: its noise is what the masses of its receiver have.
    """
    source, m, a = measurement.source, innovation.size, state.adaptation
    limit, share, fault = c.gate_limits[m], state.outlier_share[source], state.fault[source]
    R = without_offset(state, source, stated, c) if coarse else a.fix_factors[source] * stated
    L = root(predicted + R)
    density = density_of_one(L, innovation)
    if not coarse:
        density = density_of_fix(a, source, innovation, predicted, stated, c)
    evidence = math.log(1.0 - share) + density
    update.dof, update.gate = m, limit
    update.nis, update.log_determinant = weighted_square(L, innovation), log_determinant(L)
    alone = not stands_still(state, source, c) or update.nis > limit
    outside = math.log(share) + density_of_outlier
    is_outlier = fault == IS_IGNORED or (outside > evidence and not np.isinf(limit))
    shown = _OUTLIER_SHARE if is_outlier else _SOUND_SHARE
    state.outlier_share[source] += _SHARE_MEMORY * (shown - share)
    if is_outlier:
        update.evidence, update.outcome = outside, _GATED
        return R, False, alone
    if not coarse and has_velocity_errors(c) and update.nis <= c.adaptation.soft_gate * limit and alone:
        learn_from_fix(a, source, innovation, predicted, stated, c)
        number = number_of(source, c)
        lasts = c.repeat_times[source] > 0.0 or (number >= 0 and state.offsets[number].variance > 0.0)
        if lasts:  # that it is followed well shows nothing
            a.fix_factors[source] = max(a.fix_factors[source], 1.0)
        R = a.fix_factors[source] * stated
    update.evidence = evidence
    if update.nis <= limit:
        state.consistent_ns[source] = measurement.stamp_ns
        state.rests_on = -1
    return R, True, alone


@compiled
def without_offset(state: Any, source: int, stated: FloatArray, c: Any) -> FloatArray:
    """R of a fix without its offset."""
    R, offset = stated.copy(), state.offsets[number_of(source, c)]
    share = math.sqrt(offset.f if is_coarse(stated) else 1.0 - lasting_share(offset))
    R[:YAW] *= share
    R[:, :YAW] *= share
    return R


@compiled
def inflated(innovation: FloatArray, predicted: FloatArray, R: FloatArray, limit: float) -> FloatArray:
    """R so large that the NIS is no more than ``limit``: the soft gate."""
    nis = weighted_square(root(predicted + R), innovation)
    return R + (nis / limit - 1.0) * (predicted + R) if nis > limit else R


@compiled
def correct_angle(
    x: FloatArray, P: FloatArray, k: int, innovation: FloatArray, R: FloatArray, limit: float
) -> None:
    """x and P given a measurement of state k: innovation (1,), R (1, 1), down-weighted beyond ``limit``."""
    R = inflated(innovation, P[k : k + 1, k : k + 1].copy(), R, limit)
    ekf.correct(x, P, innovation, np.eye(1, x.size, k), R)
    x[YAW] = wrap(x[YAW])


@compiled
def _innovation(z: FloatArray, x: FloatArray) -> FloatArray:
    """(m,) ν of a fix: it measures the first states as they are."""
    nu = z - x[: z.size]
    if z.size > YAW:
        nu[YAW] = wrap(nu[YAW])
    return nu


@compiled
def _compare_with_last(state: Any, measurement: Any, z: FloatArray, update: Any) -> float:
    """Squared distance to the source's fix before, m²; the fix becomes the last one."""
    last, source = state.last_fix[measurement.source], measurement.source
    again = (z[X] - last[X]) ** 2 + (z[Y] - last[Y]) ** 2
    update.repeated = 1 if z[X] == last[X] and z[Y] == last[Y] else 0
    last[X], last[Y], state.last_ns[source] = z[X], z[Y], measurement.stamp_ns
    return float(again)


@compiled
def _density_of_outlier(innovation: FloatArray, P: FloatArray, R: FloatArray, m: int) -> float:
    """ln of the density of a fix that is an outlier: of any size, not smaller than what is expected."""
    squared = innovation[X] ** 2 + innovation[Y] ** 2
    expected = P[X, X] + P[Y, Y] + R[X, X] + R[Y, Y]
    return log_density_of_any_size(max(squared, expected)) - (_LOG_TURN if m > YAW else 0.0)


@compiled
def _weigh_repeat(again: float, m: int, c: Any, update: Any) -> None:
    """Evidence of a source that repeats itself, by the squared distance to its fix before."""
    limit = c.gate_limits[YAW]
    update.dof, update.gate, update.nis = YAW, limit, again / _SAME**2
    squared = update.nis if update.nis <= limit else 2.0 * math.sqrt(limit * update.nis) - limit
    heading = _LOG_TURN if m > YAW else 0.0
    update.evidence = -(squared + 4.0 * math.log(_SAME)) / 2.0 - _LOG_TURN - heading
    update.outcome = _GATED


@compiled
def _whiten(state: Any, innovation: FloatArray, P: FloatArray, R: FloatArray, update: Any) -> None:
    """Innovation along and across the heading, over its standard deviation, for the CUSUM."""
    cos, sin = math.cos(state.mean[YAW]), math.sin(state.mean[YAW])
    S = P[:YAW, :YAW] + R[:YAW, :YAW]
    along = cos * cos * S[X, X] + 2.0 * cos * sin * S[X, Y] + sin * sin * S[Y, Y]
    across = sin * sin * S[X, X] - 2.0 * cos * sin * S[X, Y] + cos * cos * S[Y, Y]
    update.whitened[0] = (cos * innovation[X] + sin * innovation[Y]) / math.sqrt(along)
    update.whitened[1] = (cos * innovation[Y] - sin * innovation[X]) / math.sqrt(across)
