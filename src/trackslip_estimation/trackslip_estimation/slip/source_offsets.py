# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""States of single sources, from number ``SENSOR_ERRORS`` on: position, velocity and yaw offsets; compiled.

The bias of the first gyro is a state of the model. Each further gyro has one of its own here.

The offset of a pose source is the time-correlated error of its positions. A receiver with correlated errors
always has one: b of ``correlated_errors``, with the prior variance g R of the point masses. Any other offset,
as that of velocities, is zero until an event opens it.

The yaw offset of a heading source is the misalignment of its sensor, that of a swing encoder the error of
``offset``. An event opens it.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from trackslip_common.arrays import FloatArray
from trackslip_common.compiled import compiled
from trackslip_estimation.kalman.linear_algebra import wrap
from trackslip_estimation.kalman.single_state import (
    add_state,
    decay_state,
    replace_prior_variance,
    replace_state,
)
from trackslip_estimation.slip.correlated_errors import PRECISE, is_same_quality, quality_of
from trackslip_estimation.slip.models.model import SENSOR_ERRORS, YAW, X, Y

if TYPE_CHECKING:
    from trackslip_estimation.slip.config import Config
    from trackslip_estimation.slip.correlated_errors import FixErrors
    from trackslip_estimation.slip.records import Offset, Prior, State, Update


@compiled
def pose_source_number(source: int, c: Config) -> int:
    """Number of a source among the pose sources, whose offsets come first; −1: no pose source."""
    number = (c.offsets[source] - SENSOR_ERRORS) // 2
    return number if 0 <= number < c.poses else -1


@compiled
def latest_pose_source(state: State, c: Config) -> int:
    """The pose source that was consistent most recently; 0 without pose sources."""
    latest = -1
    for k in range(c.offsets.size):
        if pose_source_number(k, c) >= 0 and (
            latest < 0 or state.consistent_ns[k] > state.consistent_ns[latest]
        ):
            latest = k
    return max(latest, 0)


@compiled
def error_model(offset: Offset, c: Config) -> FixErrors:
    """Error model of the quality of the latest fix."""
    return offset.errors[quality_of(offset.stddev, c)]


@compiled
def has_position_dependent_errors(source: int, c: Config) -> bool:
    """Whether errors of a source depend on its position, as those of a laser, and not on time."""
    return bool(c.standing_share[source] > 0.0)


@compiled
def has_mostly_correlated_errors(state: State, source: int, c: Config) -> bool:
    """Whether the correlated errors of a source exceed its white errors."""
    number = pose_source_number(source, c)
    if number < 0:
        return False
    offset = state.offsets[number]
    errors, is_precise = error_model(offset, c), quality_of(offset.stddev, c) == PRECISE
    return bool(offset.variance > 0.0 and not is_precise and errors.g > errors.f)


@compiled
def time_correlated_share(state: State, source: int, c: Config) -> float:
    """Share of the variance of a source that is time-correlated, or may be until it was observed."""
    number = pose_source_number(source, c)
    if number < 0 or has_position_dependent_errors(source, c):
        return 0.0
    errors = error_model(state.offsets[number], c)
    if errors.g > 0.0:
        return float(errors.g / (errors.g + errors.f))
    least = 1.0 - errors.f if _are_observed(errors, c) else 1.0  # stated variance less the white errors
    return float(min(max(least, 0.0), c.receivers.most_correlated))


@compiled
def _are_observed(errors: FixErrors, c: Config) -> bool:
    """Whether fixes were observed for several correlation times."""
    return bool(errors.observed >= c.receivers.observed * errors.time)


@compiled
def is_unobserved_receiver(state: State, source: int, c: Config) -> bool:
    """Whether a source with correlated errors was not observed for several correlation times."""
    offset = state.offsets[pose_source_number(source, c)]
    return has_mostly_correlated_errors(state, source, c) and not _are_observed(error_model(offset, c), c)


@compiled
def has_correlated_errors(state: State, source: int, stddev: float, c: Config) -> bool:
    """Whether fixes of a source with this stated standard deviation, m, have correlated errors."""
    number = pose_source_number(source, c)
    return bool(number >= 0 and state.offsets[number].errors[quality_of(stddev, c)].g > 0.0)


@compiled
def prepare_offset(
    state: State, update: Update, prior: Prior, source: int, R: FloatArray, is_open: bool, c: Config
) -> None:
    """Set the prior variance of the offset of a source before its next fix, of covariance R.

    A change of quality (ambiguities fixed, floating, code only) resets the offset. Else the prior variance
    becomes that of the point masses; white errors have none. An offset that an event opened stays.
    """
    offset, first = state.offsets[pose_source_number(source, c)], c.offsets[source]
    stddev = position_stddev(R)
    if is_open:
        offset.stddev = stddev
        return
    changes_quality = offset.stddev > 0.0 and not is_same_quality(stddev, offset.stddev, c)
    target = offset.errors[quality_of(stddev, c)].g * stddev * stddev
    if changes_quality or (target > 0.0) != (offset.variance > 0.0):
        update.reset_states |= 3 << first
        is_new = target > 0.0 and not changes_quality and offset.stddev > 0.0
        _reset_offset(state.mean, state.covariance, first, target)
        _reset_offset(prior.mean, prior.covariance, first, target)
        if is_new:  # so far the position contained it
            to_measured_position(state.mean, state.covariance, source, -1.0, c)
            to_measured_position(prior.mean, prior.covariance, source, -1.0, c)
    elif target > 0.0:
        for i in (first, first + 1):
            replace_prior_variance(state.mean, state.covariance, i, offset.variance, target)
    offset.variance, offset.stddev = target, stddev


@compiled
def position_stddev(R: FloatArray) -> float:
    """Standard deviation of a position of covariance R, by axis, m."""
    return math.sqrt((R[X, X] + R[Y, Y]) / 2.0)


@compiled
def _reset_offset(x: FloatArray, P: FloatArray, first: int, variance: float) -> None:
    for i in (first, first + 1):
        replace_state(x, P, i, 0.0, variance)


@compiled
def offset_persistence(state: State, number: int, dt: float, c: Config) -> float:
    """Persistence of an offset over dt, e^(−dt/τ)."""
    offset = state.offsets[number]
    return math.exp(-dt / error_model(offset, c).time) if offset.variance > 0.0 else 1.0


@compiled
def propagate_offsets(state: State, dt: float, c: Config) -> None:
    """Propagate the offsets of receivers over dt.

    An offset of precise fixes that an event opened has the process noise of their errors only.
    """
    x, P = state.mean, state.covariance
    for number in range(c.poses):
        offset, first = state.offsets[number], SENSOR_ERRORS + 2 * number
        if offset.variance > 0.0:
            share = offset_persistence(state, number, dt, c)
            for k in (first, first + 1):
                decay_state(x, P, k, share, offset.variance)
        elif offset.errors[PRECISE].g > 0.0 and 0.0 < offset.stddev <= c.receivers.precise:
            errors = offset.errors[PRECISE]
            share = math.exp(-dt / errors.time)
            for k in (first, first + 1):
                P[k, k] += (1.0 - share * share) * errors.g * offset.stddev**2


@compiled
def set_offset_transition(F: FloatArray, state: State, dt: float, c: Config) -> None:
    """Multiply the offset rows of the transition F (n, n) by their persistence."""
    for number in range(c.poses):
        for k in (SENSOR_ERRORS + 2 * number, SENSOR_ERRORS + 2 * number + 1):
            F[k, k] *= offset_persistence(state, number, dt, c)


@compiled
def inflate_offset(state: State, P: FloatArray, source: int, inflation: FloatArray, c: Config) -> None:
    """Inflate the offset of a source in P by ``inflation`` (2,), m², up to ``largest_inflation``."""
    first, offset = c.offsets[source], state.offsets[pose_source_number(source, c)]
    largest = c.receivers.largest_inflation * offset.variance
    for axis in (X, Y):
        k = first + axis
        P[k, k] += max(min(inflation[axis], largest - P[k, k]), 0.0)


@compiled
def to_sensor_heading(x: FloatArray, P: FloatArray, source: int, sign: float, c: Config) -> None:
    """Transform the heading into that of a source with a yaw offset (1), or back (−1); in place."""
    index = c.yaw_offsets[source]
    if index >= 0:
        x[YAW] = wrap(x[YAW] + sign * x[index])
        add_state(P, YAW, index, sign)


@compiled
def prior_offset_variance(state: State, source: int, c: Config) -> float:
    """Prior variance of an offset after its event ends: that of the receiver."""
    offset = state.offsets[pose_source_number(source, c)]
    return float(error_model(offset, c).g * offset.stddev**2)


@compiled
def begin_offset(state: State, source: int, c: Config) -> None:
    """Correlate initial position and offset by the time-correlated error of the first fix."""
    x, P, offset = state.mean, state.covariance, state.offsets[pose_source_number(source, c)]
    R = P[: Y + 1, : Y + 1].copy()
    stddev = position_stddev(R)
    errors = offset.errors[quality_of(stddev, c)]
    if errors.g == 0.0:
        return
    offset.stddev = stddev
    offset.variance = errors.g * stddev**2
    _reset_offset(x, P, c.offsets[source], offset.variance)
    P[: Y + 1, : Y + 1] = errors.f * R
    to_measured_position(x, P, source, -1.0, c)


@compiled
def to_measured_position(x: FloatArray, P: FloatArray, source: int, sign: float, c: Config) -> None:
    """Transform the position into that measured by a source with an offset (1), or back (−1); in place."""
    first = c.offsets[source]
    for axis in (X, Y):
        x[axis] += sign * x[first + axis]
        add_state(P, axis, first + axis, sign)
