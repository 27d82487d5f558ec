# SPDX-License-Identifier: Apache-2.0
"""Standing, straight or turning: told from the sprockets alone, with hysteresis.

The thesis' jump hypothesis (3.22) rests on it: slips hold still while both tracks run at similar
and steady speeds, and move while the speeds differ or change.

    ω_L, ω_R   sprocket speeds, low-passed             rad/s
    ω̄          mean of |ω_L| and |ω_R|                  rad/s
"""

import math
from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

from trackslip_common.compiled import compiled
from trackslip_common.parameters import Parameters, parameter

_SIGNIFICANT = 2.5  # standard deviations of rounding


class Motion(IntEnum):
    """State of motion; the numbers are those of ``trackslip_msgs/TrackSlip``."""

    UNKNOWN = 0
    STANDING = 1
    STRAIGHT = 2
    TURNING = 3


_MOTIONS = tuple(Motion)
_UNKNOWN, _STANDING, _STRAIGHT, _TURNING = map(int, Motion)


@dataclass(frozen=True, kw_only=True)
class MotionParameters(Parameters):
    """Limits between the states of motion."""

    standing_speed: float = parameter("sprocket speed below which a track stands", unit="rad/s", gt=0.0)
    turning_ratio: float = parameter("|ω_R − ω_L| over the mean speed above which it turns", gt=0.0, le=2.0)
    change_ratio: float = parameter("departure from the recent mean speed that counts as a change", gt=0.0)
    hysteresis: float = parameter("share of a limit at which a state is left again", gt=0.0, le=1.0)
    smoothing_time: float = parameter("time constant of the speeds", unit="s", gt=0.0)
    memory_time: float = parameter("time constant of the recent mean speed", unit="s", gt=0.0)


class Speeds(NamedTuple):
    """Mean sprocket speeds over the stretch between two samples."""

    left: float  # rad/s
    right: float  # rad/s
    stretch: float  # s between the two samples; 0 where there was but one
    differenced: bool  # from positions, which were rounded to counts; else measured as speeds


STANDSTILL = Speeds(0.0, 0.0, 0.0, differenced=False)


class MotionState(NamedTuple):
    """What the classifier remembers; immutable, so that a filter can keep it in its history."""

    motion: Motion = Motion.UNKNOWN
    changing: bool = True
    left: float = 0.0  # rad/s, low-passed
    right: float = 0.0
    left_mean: float = 0.0  # rad/s, low-passed further
    right_mean: float = 0.0
    departure: float = 0.0  # rad/s, the largest of the present speeds from those; 0 if rounding explains it

    @property
    def slips_move(self) -> bool:
        """The jump hypothesis: whether the slips may be moving now."""
        return self.changing or self.motion is not Motion.STRAIGHT


def classify(
    state: MotionState, speeds: Speeds, dt: float, limits: MotionParameters, resolution: float = 0.0
) -> MotionState:
    """The state of motion after ``dt`` seconds with these mean sprocket speeds.

    ``resolution`` is the angle of a count, rad.
    """
    motion, changing, *remembered = classified(
        int(state.motion),
        *state[1:],
        *speeds,
        dt,
        resolution,
        limits.standing_speed,
        limits.turning_ratio,
        limits.change_ratio,
        limits.hysteresis,
        limits.smoothing_time,
        limits.memory_time,
    )
    return MotionState(_MOTIONS[motion], changing, *remembered)


@compiled
def classified(
    motion: int,
    changing: bool,
    left: float,
    right: float,
    left_mean: float,
    right_mean: float,
    departure: float,
    left_speed: float,
    right_speed: float,
    stretch: float,
    differenced: bool,
    dt: float,
    resolution: float,
    standing_speed: float,
    turning_ratio: float,
    change_ratio: float,
    hysteresis: float,
    smoothing_time: float,
    memory_time: float,
) -> tuple[int, bool, float, float, float, float, float]:
    """The fields of the next ``MotionState``, from its last, those of ``Speeds``, of ``MotionParameters``."""
    if dt <= 0.0:
        return motion, changing, left, right, left_mean, right_mean, departure
    if motion == _UNKNOWN:
        left, right, left_mean, right_mean = left_speed, right_speed, left_speed, right_speed
    else:
        fast = -math.expm1(-dt / smoothing_time)
        slow = -math.expm1(-dt / memory_time)
        left += fast * (left_speed - left)
        right += fast * (right_speed - right)
        left_mean += slow * (left_speed - left_mean)
        right_mean += slow * (right_speed - right_mean)
    fastest, mean = max(abs(left), abs(right)), (abs(left) + abs(right)) / 2.0
    moved, turned = motion in (_STRAIGHT, _TURNING), motion == _TURNING
    moves = fastest > standing_speed * (hysteresis if moved else 1.0)
    turns = abs(right - left) > turning_ratio * mean * (hysteresis if turned else 1.0)
    smooth = max(abs(left - left_mean), abs(right - right_mean))
    changing = smooth > change_ratio * max(mean, standing_speed) * (hysteresis if changing else 1.0)
    motion = _STANDING if not moves else _TURNING if turns else _STRAIGHT
    lately = max(abs(left_speed - left), abs(right_speed - right))
    departure = max(lately, abs(left_speed - left_mean), abs(right_speed - right_mean))
    if differenced and stretch > 0.0 and departure <= _SIGNIFICANT * _rounding(stretch, resolution):
        departure = 0.0
    return motion, changing, left, right, left_mean, right_mean, departure


def smoothed(speeds: Speeds, state: MotionState, limits: MotionParameters, resolution: float = 0.0) -> Speeds:
    """What a gyro is compared with: no rounding of counts passes for a turn, or for a change of speed.

    Low-passed, where rounding explains how the speeds depart from their mean; alike, where it explains their
    difference.
    """
    now = steadied(*speeds, state.left, state.right, state.departure, resolution, limits.smoothing_time)
    return Speeds(*now, speeds.differenced)


@compiled
def steadied(
    left: float,
    right: float,
    stretch: float,
    differenced: bool,
    smooth_left: float,
    smooth_right: float,
    departure: float,
    resolution: float,
    smoothing_time: float,
) -> tuple[float, float, float]:
    """Left, right and stretch of ``smoothed``."""
    if not differenced or stretch <= 0.0:
        return left, right, stretch
    if departure == 0.0 and stretch < smoothing_time:
        left, right, stretch = smooth_left, smooth_right, math.sqrt(2.0) * smoothing_time
    if abs(right - left) <= math.sqrt(2.0) * _SIGNIFICANT * _rounding(stretch, resolution):
        left = right = (left + right) / 2.0
    return left, right, stretch


@compiled
def _rounding(stretch: float, resolution: float) -> float:
    """Standard deviation of a speed that is differenced from two rounded counts, rad/s."""
    return resolution / math.sqrt(6.0) / stretch
