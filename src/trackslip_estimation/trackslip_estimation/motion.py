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

from trackslip_common.parameters import Parameters, parameter


class Motion(IntEnum):
    """State of motion; the numbers are those of ``trackslip_msgs/TrackSlip``."""

    UNKNOWN = 0
    STANDING = 1
    STRAIGHT = 2
    TURNING = 3


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

    @property
    def slips_move(self) -> bool:
        """The jump hypothesis: whether the slips may be moving now."""
        return self.changing or self.motion is not Motion.STRAIGHT


def classify(
    state: MotionState, left_speed: float, right_speed: float, dt: float, limits: MotionParameters
) -> MotionState:
    """The state of motion after ``dt`` seconds with these mean sprocket speeds (rad/s)."""
    if dt <= 0.0:
        return state
    if state.motion is Motion.UNKNOWN:
        left, right, left_mean, right_mean = left_speed, right_speed, left_speed, right_speed
    else:
        fast = -math.expm1(-dt / limits.smoothing_time)
        slow = -math.expm1(-dt / limits.memory_time)
        left = state.left + fast * (left_speed - state.left)
        right = state.right + fast * (right_speed - state.right)
        left_mean = state.left_mean + slow * (left_speed - state.left_mean)
        right_mean = state.right_mean + slow * (right_speed - state.right_mean)

    def exceeds(value: float, limit: float, already: bool) -> bool:
        return value > (limits.hysteresis * limit if already else limit)

    fastest, mean = max(abs(left), abs(right)), (abs(left) + abs(right)) / 2.0
    moves = exceeds(fastest, limits.standing_speed, state.motion in (Motion.STRAIGHT, Motion.TURNING))
    turns = exceeds(abs(right - left), limits.turning_ratio * mean, state.motion is Motion.TURNING)
    departure = max(abs(left - left_mean), abs(right - right_mean))
    changing = exceeds(departure, limits.change_ratio * max(mean, limits.standing_speed), state.changing)
    motion = Motion.STANDING if not moves else Motion.TURNING if turns else Motion.STRAIGHT
    return MotionState(motion, changing, left, right, left_mean, right_mean)
