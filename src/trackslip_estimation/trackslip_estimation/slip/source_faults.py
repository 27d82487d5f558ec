# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Faults of sources: the assumption of a branch, and the likelihood of measurements under it; compiled."""

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
from trackslip_estimation.slip.source_offsets import pose_source_number

if TYPE_CHECKING:
    from trackslip_estimation.slip.config import Config
    from trackslip_estimation.slip.records import MeasurementRecord, State, Update

_GATED = int(Outcome.GATED)
_LOG_TWO_PI = math.log(2.0 * math.pi)
_AREA = 1e4  # m², of an unknown position


class SourceFault(IntEnum):
    """Fault that a branch assumes of a source."""

    HEALTHY = 0
    OFFSET = 1
    REPEATS = 2
    SCATTERS = 3
    IGNORED = 4  # for one measurement
    FAILED = 5  # sprockets, gyros or odometry do not measure the motion
    STAYS = 6  # fixes jitter about a constant position
    HEADING_OFF = 7  # headings or swing angles have a constant offset; positions are correct
    HEADING_WANDERS = 8  # headings or swing angles have an offset that walks
    WANDERS = 9  # positions drift with a nearly constant velocity; none is used
    HEADING_REPEATS = 10  # headings of fixes are constant; none is used
    COUNTS_HALF = 11  # sprockets measure half of the motion
    COUNTS_BACKWARDS = 12  # sprockets measure the opposite motion
    LEFT_FAILED = 13  # the left sprocket does not measure the motion; the right one does
    RIGHT_FAILED = 14


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
    IS_WANDERING,
    IS_HEADING_REPEATING,
    IS_COUNTING_HALF,
    IS_COUNTING_BACKWARDS,
    IS_LEFT_FAILED,
    IS_RIGHT_FAILED,
) = map(int, SourceFault)


@compiled
def has_fault(state: State, source: int) -> bool:
    """Whether a branch assumes a fault of a source, of its headings or of anything else."""
    return bool(state.fault[source] != IS_HEALTHY or state.heading_fault[source] != IS_HEALTHY)


@compiled
def is_trusted(state: State, source: int, kind: int) -> bool:
    """Whether a measurement is free of faults: a position is, where only headings have an offset."""
    if kind == POSE:
        return bool(state.fault[source] == IS_HEALTHY)
    return not has_fault(state, source)


@compiled
def is_same_fault(state: State, source: int) -> bool:
    """Whether one fault of a source affects its positions and its headings."""
    affects_both = state.fault[source] != IS_HEALTHY and state.heading_fault[source] != IS_HEALTHY
    return bool(affects_both and state.fault_ns[source] == state.heading_fault_ns[source])


@compiled
def is_displacement_measured(fault: int) -> bool:
    """Whether positions with the fault measure displacements: free of it, or with a constant offset."""
    return fault in (IS_HEALTHY, IS_OFFSET)


@compiled
def is_failed(fault: int) -> bool:
    """Whether a unit does not measure the motion, or only a part of it."""
    return bool(fault == IS_FAILED or is_partly_failed(fault))


@compiled
def is_partly_failed(fault: int) -> bool:
    """Whether sprockets measure the motion to a factor, or only one of them measures it."""
    return fault >= IS_COUNTING_HALF


@compiled
def is_one_failed(fault: int) -> bool:
    """Whether only one of the sprockets measures the motion."""
    return fault >= IS_LEFT_FAILED


@compiled
def count_factor(fault: int) -> float:
    """True over measured speed of sprockets that miscount."""
    return 2.0 if fault == IS_COUNTING_HALF else -1.0


@compiled
def has_no_fault(state: State) -> bool:
    """Whether a branch assumes no fault of any source or unit."""
    return bool((state.fault == IS_HEALTHY).all() and (state.heading_fault == IS_HEALTHY).all())


@compiled
def has_failed_unit(state: State) -> bool:
    """Whether a branch assumes that sprockets, gyros or an odometry have failed."""
    return bool(((state.fault == IS_FAILED) | (state.fault >= IS_COUNTING_HALF)).any())


@compiled
def has_staying_fixes(state: State) -> bool:
    """Whether a branch assumes that the machine moves on while fixes jitter about one position."""
    return bool((state.fault == IS_STAYING).any())


@compiled
def are_sources_consistent(state: State) -> bool:
    """Whether the latest measurement of each source without a fault agreed with the branch."""
    for source in range(state.fault.size):
        latest_ns = max(state.weighed_ns[source], state.received_ns[source])
        if not has_fault(state, source) and latest_ns > state.consistent_ns[source]:
            return False
    return True


@compiled
def has_wandering_offset(state: State, source: int, c: Config) -> bool:
    """Whether the offset of a source walks, so that no measurement contradicts it when the fault ends."""
    fault = state.fault[source]
    is_velocity = pose_source_number(source, c) < 0
    return bool(fault == IS_WANDERING or (fault == IS_OFFSET and is_velocity))


@compiled
def has_wandering_heading(state: State, source: int) -> bool:
    """Whether the angles of a source have an offset that walks."""
    return bool(state.heading_fault[source] == IS_HEADING_WANDERING)


@compiled
def has_hidden_heading_fault(state: State, source: int) -> bool:
    """Whether the angles of a source have a fault of which no measurement shows the end."""
    return bool(has_wandering_heading(state, source) or has_repeated_heading(state, source))


@compiled
def has_repeated_heading(state: State, source: int) -> bool:
    """Whether the headings of the fixes of a source repeat one heading."""
    return bool(state.heading_fault[source] == IS_HEADING_REPEATING)


@compiled
def propagate_faults(state: State, dt: float, c: Config) -> None:
    """Add process noise of ``dt`` s to offsets that walk: of headings, swing angles and velocities."""
    P = state.covariance
    for source in range(state.fault.size):
        if has_wandering_heading(state, source):
            index = c.yaw_offsets[source]
            walk = c.events.swing_walk if c.measures_swing[source] == 1 else c.events.heading_walk
            P[index, index] += walk**2 * dt
        if state.fault[source] == IS_OFFSET and pose_source_number(source, c) < 0:
            for index in (c.offsets[source], c.offsets[source] + 1):
                P[index, index] += c.events.velocity_walk**2 * dt


@compiled
def unknown_position_stddev(squared: float) -> float:
    """Standard deviation, m, of an unknown position that is ``squared`` m² away, or within ``_AREA``."""
    return math.sqrt(max(_AREA / (2.0 * math.pi), squared))


@compiled
def log_density_of_any_size(squared: float, c: Config) -> float:
    """ln of the density of a position error (2,) of ``squared`` m², uniform in the logarithm of its size."""
    return -math.log(2.0 * math.pi * c.bank.outlier_sizes * squared)


@compiled
def log_density_of_outlier(m: MeasurementRecord, o: Observation, predicted: FloatArray, c: Config) -> float:
    """ln of the density of an outlier: any angle; a position or velocity error of at least the usual size."""
    if m.kind not in (POSE, VELOCITY):
        return -_LOG_TWO_PI
    squared, expected = 0.0, 0.0
    for axis in range(min(o.innovation.size, YAW)):
        squared += o.innovation[axis] ** 2
        expected += predicted[axis, axis] + o.noise[axis, axis]
    if o.innovation.size == 1:
        return -math.log(2.0 * c.bank.outlier_sizes * math.sqrt(max(squared, expected)))
    return log_density_of_any_size(max(squared, expected), c) + _log_density_of_heading(m, o, predicted, c)


@compiled
def _log_density_of_heading(m: MeasurementRecord, o: Observation, predicted: FloatArray, c: Config) -> float:
    """ln of the density of the heading of a fix with a wrong position; 0 of a fix without heading.

    The heading is uniform. A heading of two antennas, independent of the position, is as likely correct.
    """
    if o.innovation.size <= YAW:
        return 0.0
    if c.yaw_offsets[m.source] < 0:
        return -_LOG_TWO_PI
    S = predicted[YAW, YAW] + o.noise[YAW, YAW]
    correct = math.exp(-(o.innovation[YAW] ** 2) / (2.0 * S)) / math.sqrt(2.0 * math.pi * S)
    return math.log((correct + 1.0 / (2.0 * math.pi)) / 2.0)


@compiled
def log_density_of_scatter(m: MeasurementRecord, o: Observation, predicted: FloatArray, c: Config) -> float:
    """ln of the density of a measurement of a source that scatters: any position, angle or speed.

    Positions are uniform within ``_AREA``, and of any size of error beyond it.
    """
    if m.kind == VELOCITY:
        return -math.log(math.pi * c.unknown_speed**2 if o.innovation.size > 1 else 2.0 * c.unknown_speed)
    if m.kind != POSE:
        return -_LOG_TWO_PI
    squared = o.innovation[X] ** 2 + o.innovation[Y] ** 2
    of_position = log_density_of_any_size(squared, c) if squared > _AREA else -math.log(_AREA)
    return of_position + _log_density_of_heading(m, o, predicted, c)


@compiled
def is_repeated(update: Update, c: Config) -> bool:
    """Whether a measurement equals the previous one, a fix to the rounding of a map projection."""
    return bool(update.squared_repeat_distance <= c.gate_limits[YAW] * c.bank.repeat_stddev**2)


@compiled
def is_heading_repeated(update: Update, c: Config) -> bool:
    """Whether the heading of a fix equals the previous one."""
    return bool(update.squared_repeat_angle <= c.gate_limits[1] * c.bank.repeat_stddev**2)


@compiled
def can_be_repetition(update: Update, c: Config) -> bool:
    """Whether a fix differs from the previous one by no more than the stated noise of both."""
    return bool(update.squared_repeat_distance <= 2.0 * c.gate_limits[YAW] * update.stated**2)


@compiled
def log_density_of_repeat(squared: float, variance: float, rows: int, c: Config) -> float:
    """ln of the density of a repetition off by ``squared`` in all, of ``variance`` each; heavy-tailed."""
    limit, nis = c.gate_limits[rows], squared / variance
    weighted = nis if nis <= limit else 2.0 * math.sqrt(limit * nis) - limit
    return -(weighted + rows * (math.log(variance) + _LOG_TWO_PI)) / 2.0


@compiled
def weigh_repeat(kind: int, o: Observation, is_staying: bool, c: Config, update: Update) -> None:
    """Set the evidence of a source that repeats its measurement, or stays, from the distance to where it was.

    A source that stays and jitters cannot be distinguished from a machine that is stuck. Such a fix is
    *tied*: it gets the likelihood of the most probable branch that may use it (``bank.rows``). Angles with
    few digits often repeat while they change slowly. So their density is that of the stated noise. Positions
    and velocities of a moving sensor do not repeat.
    """
    m, stddev, unused = o.innovation.size, math.sqrt(2.0 * o.noise[0, 0]), 0.0
    if kind == POSE:
        unused = _LOG_TWO_PI if m > YAW else 0.0
        m, stddev = YAW, math.sqrt(2.0) * update.stated if is_staying else c.bank.repeat_stddev
        update.tied = int(is_staying and can_be_repetition(update, c))
    elif kind == VELOCITY:
        stddev = c.bank.repeat_stddev
    limit = c.gate_limits[m]
    update.dof, update.gate, update.nis = m, limit, update.squared_repeat_distance / stddev**2
    update.evidence = log_density_of_repeat(update.squared_repeat_distance, stddev**2, m, c) - unused
    update.outcome = _GATED
