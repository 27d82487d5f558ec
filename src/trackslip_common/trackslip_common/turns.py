# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Makes angles of joints continuous that wrap after each whole turn.

Such an angle lies within one turn, from 0 on or from half a turn below 0, and jumps by nearly a whole turn.
An angle that was ever outside both ranges is continuous, and stays unchanged; so does a jump that the
measured speed explains.
"""

import math
from typing import NamedTuple

import numpy as np

from trackslip_common.arrays import FloatArray, IntArray

_RANGE_TOLERANCE = 0.002  # of a turn, tolerance of the range for rounding
_FIRST_WRAP = 0.75  # of a turn: least wrap of an angle that has not wrapped before
_LATER_WRAP = 0.5  # of a turn: least wrap of an angle that has
_GAP_S = 1.0  # s after which the first jump of an angle may be any motion


class _Reading(NamedTuple):
    stamp_ns: int
    angle: float


class TurnCounter:
    """Counts the turns of one joint."""

    def __init__(self, turn: float = math.tau) -> None:
        self._turn = turn  # in the angle's unit
        self._turns = 0
        self._low, self._high = math.inf, -math.inf
        self._has_wrapped = False
        self._last: _Reading | None = None

    def unwrap(self, stamp_ns: int, angle: float, speed: float = math.nan) -> float:
        """The angle without its wraps; a value that is not finite is returned as it is, and ignored.

        ``speed``: in units of the angle per second; nan: unknown.
        """
        if not math.isfinite(angle):
            return angle
        last, self._last = self._last, _Reading(stamp_ns, angle)
        self._low, self._high = min(self._low, angle), max(self._high, angle)
        if last is not None and is_within_turn(self._low, self._high, self._turn):
            seconds = max(0, stamp_ns - last.stamp_ns) * 1e-9
            if self._is_wrap(angle - last.angle, seconds, speed):
                self._has_wrapped = True
                self._turns += 1 if angle < last.angle else -1
        return angle + self._turns * self._turn if self._turns else angle

    def _is_wrap(self, step: float, seconds: float, speed: float) -> bool:
        """Whether a step of the angle is a wrap after a whole turn."""
        if abs(step) < self._turn * (_LATER_WRAP if self._has_wrapped else _FIRST_WRAP):
            return False
        if seconds > _GAP_S and not self._has_wrapped:
            return False
        moved = speed * seconds
        rest = step - math.copysign(self._turn, step)
        return not abs(step - moved) <= abs(rest - moved)  # a wrap if the speed is nan


def is_within_turn(low: float, high: float, turn: float) -> bool:
    """Whether a range of angles lies within one turn, as for an angle that wraps."""
    slack = _RANGE_TOLERANCE * turn
    return (low >= -slack and high <= turn + slack) or (
        low >= -turn / 2.0 - slack and high <= turn / 2.0 + slack
    )


def unwrap_angles(
    stamps_ns: IntArray, angles: FloatArray, speeds: FloatArray | None = None, turn: float = math.tau
) -> FloatArray:
    """(n,) angles of one joint without wraps; a continuous angle is returned as it is."""
    finite = angles[np.isfinite(angles)]
    if not finite.size or not is_within_turn(float(finite.min()), float(finite.max()), turn):
        return angles
    if not (np.abs(np.diff(finite)) >= _FIRST_WRAP * turn).any():
        return angles
    counter = TurnCounter(turn)
    known_speeds = np.full(len(angles), np.nan) if speeds is None else speeds
    rows = zip(stamps_ns.tolist(), angles.tolist(), known_speeds.tolist(), strict=True)
    return np.array([counter.unwrap(*row) for row in rows])
