# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""State of motion from the sprocket speeds: standing, straight or turning, with hysteresis.

The jump hypothesis (3.22) depends on it: slips are constant while both tracks run at similar and steady
speeds, and change while the speeds differ or change.

    ω_L, ω_R   sprocket speeds, low-passed             rad/s
    ω̄          mean of |ω_L| and |ω_R|                  rad/s

``SPEEDS`` and ``MOTION`` are the records of compiled code; ``Speeds`` and ``MotionState`` are the same for
Python.
"""

import math
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np

from trackslip_common.compiled import compiled
from trackslip_common.parameters import Parameters, parameter
from trackslip_common.record_types import Record, RecordT, Table, dtype_of, make_table

_SIGNIFICANT = 2.5  # standard deviations of a speed


class Motion(IntEnum):
    """State of motion; the numbers are those of ``trackslip_msgs/TrackSlip``."""

    UNKNOWN = 0
    STANDING = 1
    STRAIGHT = 2
    TURNING = 3


class SpeedsRecord(Record):
    """``Speeds`` in compiled code."""

    left: float
    right: float
    variance: float
    angle_variance: float


SPEEDS = dtype_of(SpeedsRecord)


class MotionRecord(Record):
    """``MotionState`` in compiled code."""

    motion: int
    changing: bool
    left: float
    right: float
    left_mean: float
    right_mean: float
    departure: float


MOTION = dtype_of(MotionRecord)


class LimitsRecord(Record):
    """``MotionParameters`` in compiled code."""

    standing_speed: float
    turning_ratio: float
    change_ratio: float
    hysteresis: float
    smoothing_time: float
    memory_time: float


LIMITS = dtype_of(LimitsRecord)

_UNKNOWN, _STANDING, _STRAIGHT, _TURNING = map(int, Motion)


@dataclass(frozen=True, kw_only=True)
class MotionParameters(Parameters):
    """Limits between the states of motion."""

    standing_speed: float = parameter(
        "sprocket speed below which a track is at standstill", unit="rad/s", gt=0.0
    )
    turning_ratio: float = parameter("|ω_R − ω_L| over the mean speed above which it turns", gt=0.0, le=2.0)
    change_ratio: float = parameter("departure from the recent mean speed that counts as a change", gt=0.0)
    hysteresis: float = parameter("share of a limit at which a state is left again", gt=0.0, le=1.0)
    smoothing_time: float = parameter("time constant of the speeds", unit="s", gt=0.0)
    memory_time: float = parameter("time constant of the recent mean speed", unit="s", gt=0.0)


class Speeds(NamedTuple):
    """Mean sprocket speeds over the interval between two samples."""

    left: float  # rad/s
    right: float  # rad/s
    variance: float = 0.0  # of each, by the rounding of counts, (rad/s)²
    angle_variance: float = 0.0  # of each angle, by the same, rad²


class MotionState(NamedTuple):
    """State of the classifier; immutable, so that a filter can keep it in its history."""

    motion: Motion = Motion.UNKNOWN
    changing: bool = True
    left: float = 0.0  # rad/s, low-passed
    right: float = 0.0
    left_mean: float = 0.0  # rad/s, low-passed further
    right_mean: float = 0.0
    departure: float = 0.0  # rad/s, largest difference of the current speeds from these

    @property
    def are_slips_changing(self) -> bool:
        """The jump hypothesis: whether the slips may be moving now."""
        return self.changing or self.motion is not Motion.STRAIGHT


def classify(state: MotionState, speeds: Speeds, dt: float, limits: MotionParameters) -> MotionState:
    """The state of motion after ``dt`` seconds with these mean sprocket speeds."""
    motion = _make_record(MotionRecord, MOTION, state)
    update_motion(motion[0], _make_record(SpeedsRecord, SPEEDS, speeds)[0], dt, limits_record(limits)[0])
    code, changing, *remembered = motion.item(0)
    return MotionState(Motion(code), bool(changing), *remembered)


def smoothed_speeds(speeds: Speeds, state: MotionState, limits: MotionParameters) -> Speeds:
    """``steady_speeds`` for Python."""
    now, motion = _make_record(SpeedsRecord, SPEEDS, speeds)[0], _make_record(MotionRecord, MOTION, state)[0]
    left, right, variance = steady_speeds(now, motion, limits_record(limits)[0])
    return speeds._replace(left=left, right=right, variance=variance)


def limits_record(limits: MotionParameters) -> Table[LimitsRecord]:
    """(1,) of ``LIMITS``."""
    return _make_record(LimitsRecord, LIMITS, tuple(getattr(limits, name) for name in LIMITS.names or ()))


def _make_record(
    declared: type[RecordT], dtype: np.dtype[np.void], fields: tuple[Any, ...]
) -> Table[RecordT]:
    """(1,) of ``declared``."""
    table = make_table(declared, dtype, 1)
    table[:] = np.array([tuple(fields)], dtype)
    return table


@compiled
def reset_motion(state: MotionRecord) -> None:
    """Reset the record ``state`` of ``MOTION`` to unknown motion."""
    state.motion, state.changing = _UNKNOWN, True
    state.left = state.right = state.left_mean = state.right_mean = state.departure = 0.0


@compiled
def update_motion(state: MotionRecord, speeds: SpeedsRecord, dt: float, limits: LimitsRecord) -> None:
    """Update the record ``state`` of ``MOTION`` by mean ``speeds`` over ``dt`` s."""
    if dt <= 0.0:
        return
    if state.motion == _UNKNOWN:
        state.left = state.left_mean = speeds.left
        state.right = state.right_mean = speeds.right
    else:
        fast = -math.expm1(-dt / limits.smoothing_time)
        slow = -math.expm1(-dt / limits.memory_time)
        state.left += fast * (speeds.left - state.left)
        state.right += fast * (speeds.right - state.right)
        state.left_mean += slow * (speeds.left - state.left_mean)
        state.right_mean += slow * (speeds.right - state.right_mean)
    left, right = state.left, state.right
    fastest, mean = max(abs(left), abs(right)), (abs(left) + abs(right)) / 2.0
    was_moving, was_turning = state.motion in (_STRAIGHT, _TURNING), state.motion == _TURNING
    is_moving = fastest > limits.standing_speed * (limits.hysteresis if was_moving else 1.0)
    is_turning = abs(right - left) > limits.turning_ratio * mean * (limits.hysteresis if was_turning else 1.0)
    change = max(abs(left - state.left_mean), abs(right - state.right_mean))
    hysteresis = limits.hysteresis if state.changing else 1.0
    state.changing = change > limits.change_ratio * max(mean, limits.standing_speed) * hysteresis
    state.motion = _STANDING if not is_moving else _TURNING if is_turning else _STRAIGHT
    from_smoothed = max(abs(speeds.left - left), abs(speeds.right - right))
    state.departure = max(
        from_smoothed, abs(speeds.left - state.left_mean), abs(speeds.right - state.right_mean)
    )


@compiled
def is_explained_by_rounding(departure: float, speeds: SpeedsRecord) -> bool:
    """Whether the quantisation of counts explains a ``departure`` of ``speeds``, rad/s."""
    return bool(departure**2 <= _SIGNIFICANT**2 * speeds.variance)


@compiled
def rounding_variance(time: float, speeds: SpeedsRecord) -> float:
    """Variance of a mean speed over ``time`` s by the quantisation of the angles at its ends, (rad/s)²."""
    return min(2.0 * speeds.angle_variance / (time * time), speeds.variance)


@compiled
def steady_speeds(
    speeds: SpeedsRecord, motion: MotionRecord, limits: LimitsRecord
) -> tuple[float, float, float]:
    """Left and right speed without quantisation, rad/s, and the variance of each.

    Published and observed twist and slips use these speeds, and so does the Jacobian of a gyro. They are
    low-passed where quantisation explains their departure from the mean, and equal where it explains their
    difference: quantisation does not appear as a turn or a change of speed.
    """
    left, right, variance = speeds.left, speeds.right, speeds.variance
    if variance == 0.0:
        return left, right, variance
    if is_explained_by_rounding(motion.departure, speeds):
        left, right = motion.left, motion.right
        variance = rounding_variance(math.sqrt(2.0) * limits.smoothing_time, speeds)
    if (right - left) ** 2 <= 2.0 * _SIGNIFICANT**2 * variance:
        left = right = (left + right) / 2.0
    return left, right, variance
