# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Faults of sources: what a branch assumes of each, and how likely its measurements are then; compiled."""

from __future__ import annotations

import math
from enum import IntEnum
from typing import TYPE_CHECKING

from trackslip_common.arrays import FloatArray
from trackslip_common.compiled import compiled
from trackslip_estimation.kalman.update import Observation
from trackslip_estimation.slip.measurements import Outcome
from trackslip_estimation.slip.models.model import YAW, X, Y
from trackslip_estimation.slip.records import POSE, VELOCITY
from trackslip_estimation.slip.source_offsets import number_of

if TYPE_CHECKING:
    from trackslip_estimation.slip.config import Config
    from trackslip_estimation.slip.records import MeasurementRecord, State, Update

_GATED = int(Outcome.GATED)
_LOG_TURN = math.log(2.0 * math.pi)
_AREA = 1e4  # m², of a place of which nothing is known


class SourceFault(IntEnum):
    """What a branch assumes of a source."""

    HEALTHY = 0
    OFFSET = 1
    REPEATS = 2
    SCATTERS = 3
    IGNORED = 4  # for one measurement
    FAILED = 5  # of the sprockets, or of all gyros: they do not show the motion
    STAYS = 6  # where it was, and jitters on
    HEADING_OFF = 7  # its headings, or swing angles, are off, not its places
    HEADING_WANDERS = 8  # the same, by something else at any time
    MISCOUNTS = 9  # of the sprockets: they show the motion but for a factor
    WANDERS = 10  # its places go off evenly, and none is used


(
    IS_HEALTHY,
    IS_OFFSET,
    IS_REPEATING,
    IS_SCATTERING,
    IS_IGNORED,
    IS_FAILED,
    IS_STAYING,
    IS_HEADING_OFF,
    IS_HEADING_WANDERING,
    IS_MISCOUNTING,
    IS_WANDERING,
) = map(int, SourceFault)


@compiled
def is_heading_off(fault: int) -> bool:
    """Whether a source is assumed to show headings, or swing angles, that are off."""
    return fault in (IS_HEADING_OFF, IS_HEADING_WANDERING)


@compiled
def is_trusted(fault: int, kind: int) -> bool:
    """Whether a measurement of a source is taken for sound; places are, though headings of theirs are off."""
    return fault == IS_HEALTHY or (kind == POSE and is_heading_off(fault))


@compiled
def is_failed(fault: int) -> bool:
    """Whether a unit is assumed not to show the motion, or but for a factor."""
    return fault in (IS_FAILED, IS_MISCOUNTING)


@compiled
def has_failed_unit(state: State) -> bool:
    """Whether sprockets, gyros or an odometry are assumed not to show the motion."""
    return bool(((state.fault == IS_FAILED) | (state.fault == IS_MISCOUNTING)).any())


@compiled
def wanders(state: State, source: int, c: Config) -> bool:
    """Whether a source is off by what wanders, so that nothing contradicts it as the fault ends."""
    fault = state.fault[source]
    is_velocity = number_of(source, c) < 0
    return bool(fault in (IS_WANDERING, IS_HEADING_WANDERING) or (fault == IS_OFFSET and is_velocity))


@compiled
def propagate_faults(state: State, dt: float, c: Config) -> None:
    """Headings that wander, and velocities that are off, are so by something else dt later."""
    P = state.covariance
    for source in range(state.fault.size):
        if state.fault[source] == IS_HEADING_WANDERING:
            own = c.yaw_offsets[source]
            P[own, own] += c.events.heading_walk**2 * dt
        elif state.fault[source] == IS_OFFSET and number_of(source, c) < 0:
            for own in (c.offsets[source], c.offsets[source] + 1):
                P[own, own] += c.events.velocity_walk**2 * dt


@compiled
def reach(squared: float) -> float:
    """Standard deviation of a place of which nothing is known but that it may be ``squared`` m² away, m."""
    return math.sqrt(max(_AREA / (2.0 * math.pi), squared))


@compiled
def log_density_of_any_size(squared: float, c: Config) -> float:
    """ln of the density of a place (2,) that errs by ``squared`` m², any logarithm of which is as likely."""
    return -math.log(2.0 * math.pi * c.bank.outlier_sizes * squared)


@compiled
def density_of_outlier(m: MeasurementRecord, o: Observation, predicted: FloatArray, c: Config) -> float:
    """ln of the density of an outlier: any angle, or a place or a velocity off by no less than expected."""
    if m.kind not in (POSE, VELOCITY):
        return -_LOG_TURN
    squared, expected = 0.0, 0.0
    for axis in range(min(o.innovation.size, YAW)):
        squared += o.innovation[axis] ** 2
        expected += predicted[axis, axis] + o.noise[axis, axis]
    if o.innovation.size == 1:
        return -math.log(2.0 * c.bank.outlier_sizes * math.sqrt(max(squared, expected)))
    return log_density_of_any_size(max(squared, expected), c) + _density_of_heading(m, o, predicted, c)


@compiled
def _density_of_heading(m: MeasurementRecord, o: Observation, predicted: FloatArray, c: Config) -> float:
    """ln of the density of the heading of a fix whose place is wrong, if it has one.

    It is any; that of two antennas, which is found apart from the place, is as likely right.
    """
    if o.innovation.size <= YAW:
        return 0.0
    if c.yaw_offsets[m.source] < 0:
        return -_LOG_TURN
    S = predicted[YAW, YAW] + o.noise[YAW, YAW]
    right = math.exp(-(o.innovation[YAW] ** 2) / (2.0 * S)) / math.sqrt(2.0 * math.pi * S)
    return math.log((right + 1.0 / (2.0 * math.pi)) / 2.0)


@compiled
def density_of_scatter(m: MeasurementRecord, o: Observation, predicted: FloatArray, c: Config) -> float:
    """ln of the density of a measurement of a source that scatters: any place, angle or speed.

    Places are those of an area; farther ones err by any size.
    """
    if m.kind == VELOCITY:
        return -math.log(math.pi * c.unknown_speed**2 if o.innovation.size > 1 else 2.0 * c.unknown_speed)
    if m.kind != POSE:
        return -_LOG_TURN
    squared = o.innovation[X] ** 2 + o.innovation[Y] ** 2
    place = log_density_of_any_size(squared, c) if squared > _AREA else -math.log(_AREA)
    return place + _density_of_heading(m, o, predicted, c)


@compiled
def is_repeated(update: Update, c: Config) -> bool:
    """Whether a fix is the one before, but for the rounding of a map projection."""
    return bool(update.squared_repeat_distance <= c.gate_limits[YAW] * c.bank.repeat_stddev**2)


@compiled
def may_repeat(update: Update, c: Config) -> bool:
    """Whether a fix differs from the one before by no more than the noise that both state."""
    return bool(update.squared_repeat_distance <= 2.0 * c.gate_limits[YAW] * update.stated**2)


@compiled
def weigh_repeat(m: int, stays: bool, c: Config, update: Update) -> None:
    """Evidence of a source that repeats itself, or ``stays`` where it was, by the distance to its fix before.

    No fix tells a source that stays, and jitters on, from a machine that is stuck: such a fix is *tied*, as
    likely as in the most probable branch that may use it (``bank.rows``).
    """
    limit, stddev = c.gate_limits[YAW], c.bank.repeat_stddev
    if stays:
        update.tied, stddev = int(may_repeat(update, c)), math.sqrt(2.0) * update.stated
    update.dof, update.gate, update.nis = YAW, limit, update.squared_repeat_distance / stddev**2
    squared = update.nis if update.nis <= limit else 2.0 * math.sqrt(limit * update.nis) - limit
    heading = _LOG_TURN if m > YAW else 0.0
    update.evidence = -(squared + 4.0 * math.log(stddev)) / 2.0 - _LOG_TURN - heading
    update.outcome = _GATED
