# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Continuous position and velocity from the raw position of an encoder that wraps.

    n      raw position                                        steps
    M      steps until the raw position repeats                steps
    q      one step at the sprocket (negative: reversed)       rad
    T      time between readings                               s
    N      readings in the velocity window                     1

The velocity is the slope of a least-squares line through the last N positions over the *sender's* time, so
jitter of arrival times does not enter. Quantisation (uniform, q²/12 per reading) gives it the variance
q²/(N (N² − 1) T²), averaged over speeds. The velocity is that of the middle of the window, (N − 1) T/2 before
the stamp. Distance is conserved: the integral of the velocity over a run equals it.

After a silence in which the encoder may turn by M/2 or more, the distance is n + k M with k unknown. The
distance nearest to the silence times the mean of the velocities before and after is chosen. If the residual
exceeds M/4, or the mean may be wrong by 3/4 M over the silence, the distance is unknown: one reading has no
position (DISTANCE_UNKNOWN), and the next continues from there.
"""

import math
from collections import deque
from enum import Enum
from typing import NamedTuple

from trackslip_common.units import NS_PER_S


class EncoderEvent(Enum):
    """Reason why a reading gave no motion; DISTANCE_UNKNOWN: a velocity without a position."""

    STARTED = "first reading"
    RESTARTED = "restarted after silence"  # of a length that allows half a turn of the encoder
    JUMP = "jump"  # further than the sprocket can turn
    SIMULTANEOUS = "same time as the last reading"
    DISTANCE_UNKNOWN = "turned unseen"  # the distance from the previous position is unknown


class Motion(NamedTuple):
    """Motion of one sprocket; positive drives forward."""

    position: float  # rad, continuous; nan if the distance turned is unknown
    velocity: float  # rad/s


class _Silence(NamedTuple):
    """A silence whose whole turns are found once the velocity after it is known."""

    elapsed_ns: int
    velocity: float  # before it, steps/ns
    turned: float  # steps turned in it, modulo M


class SprocketEncoder:
    """Unwraps one encoder, and fits its velocity.

    Args:
        rad_per_step: q.
        steps_per_wrap: M.
        max_speed: highest speed of the sprocket, rad/s; limits the steps between readings.
        window: readings N in the velocity fit, at least 2.
    """

    def __init__(self, rad_per_step: float, steps_per_wrap: float, max_speed: float, window: int) -> None:
        self._rad_per_step = rad_per_step
        self._wrap = steps_per_wrap
        self._steps_per_ns = max_speed / abs(rad_per_step) / NS_PER_S
        self._raw: float | None = None  # the last raw position used
        self._unwrapped = 0.0
        self._now_ns = 0  # ns since the start
        self._silent_ns = 0  # ns since the last reading used
        self._velocity: float | None = None  # steps/ns
        self._silence: _Silence | None = None
        self._is_distance_unknown = False
        self._has_jumped = False
        self._history: deque[tuple[int, float]] = deque(maxlen=window)  # (time, unwrapped)

    def update(self, raw: float, elapsed_ns: int) -> Motion | EncoderEvent:
        """The motion after a reading, taken ``elapsed_ns`` of the sender's time after the previous one."""
        self._now_ns += elapsed_ns
        self._silent_ns += elapsed_ns
        if self._raw is None:
            self._unwrapped = raw
            return self._restart(raw, EncoderEvent.STARTED)
        if self._silent_ns <= 0:
            return EncoderEvent.SIMULTANEOUS
        half = self._wrap / 2
        moved = (raw - self._raw + half) % self._wrap - half
        reach = self._steps_per_ns * self._silent_ns + 1.0  # one step of quantisation
        if reach >= half:
            return self._restart_after_silence(raw, moved)
        if abs(moved) > reach:
            self._has_jumped = True
            return EncoderEvent.JUMP
        self._unwrapped += moved
        self._store_reading(raw)
        self._velocity = self._slope()
        if self._silence is not None:
            self._resolve_silence(self._silence)
        return self._motion(self._velocity)

    def _motion(self, velocity: float) -> Motion:
        position = math.nan if self._is_distance_unknown else self._unwrapped * self._rad_per_step
        self._is_distance_unknown = False
        return Motion(position, velocity * NS_PER_S * self._rad_per_step)

    def _restart_after_silence(self, raw: float, moved: float) -> EncoderEvent:
        """Restart after a long silence; the next reading resolves the distance turned in it."""
        if self._velocity is not None and self._silence is None and not self._has_jumped:
            self._silence = _Silence(self._silent_ns, self._velocity, moved)
        else:
            self._silence, self._is_distance_unknown = None, True
        self._unwrapped += moved
        return self._restart(raw, EncoderEvent.RESTARTED)

    def _resolve_silence(self, silence: _Silence) -> None:
        """Choose the whole turns of a silence from the velocities before and after it."""
        assert self._velocity is not None
        self._silence = None
        expected = 0.5 * (silence.velocity + self._velocity) * silence.elapsed_ns
        turns = round((expected - silence.turned) / self._wrap)
        residual = abs(silence.turned + turns * self._wrap - expected)
        tolerance = 0.5 * self._steps_per_ns * silence.elapsed_ns  # bound on the error of ``expected``
        if residual > self._wrap / 4 or tolerance > 0.75 * self._wrap:
            self._is_distance_unknown = True
            return
        self._unwrapped += turns * self._wrap
        self._history = deque(
            ((time, unwrapped + turns * self._wrap) for time, unwrapped in self._history),
            self._history.maxlen,
        )

    def _restart(self, raw: float, event: EncoderEvent) -> EncoderEvent:
        self._history.clear()
        self._velocity = None
        self._store_reading(raw)
        return event

    def _store_reading(self, raw: float) -> None:
        self._raw = raw
        self._silent_ns = 0
        self._has_jumped = False
        self._history.append((self._now_ns, self._unwrapped))

    def _slope(self) -> float:
        """Slope of the least-squares line through the window, steps/ns."""
        n, now, newest = len(self._history), self._now_ns, self._unwrapped
        x_sum = xx_sum = 0
        y_sum = xy_sum = 0.0  # relative to the newest reading: exact for whole steps
        for time, unwrapped in self._history:
            x, y = time - now, unwrapped - newest
            x_sum += x
            y_sum += y
            xx_sum += x * x
            xy_sum += x * y
        return (n * xy_sum - x_sum * y_sum) / (n * xx_sum - x_sum * x_sum)
