# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""From the raw position of an encoder that goes round to a continuous position and a velocity.

    n      raw position                                        steps
    M      steps after which it is what it was                 steps
    q      one step at the sprocket (negative: other sense)    rad
    T      time between readings                               s
    N      readings in the velocity window                     1

The velocity is the slope of a least-squares line through the last N positions over the *sender's* time, so
the jitter of arrival times need not enter. Quantisation (uniform, q²/12 per reading) gives it the variance
q²/(N (N² − 1) T²), averaged over speeds. It is the velocity of the middle of the window, (N − 1) T/2 before
the stamp. Distance is conserved: the velocities summed over a run give it.

After a silence in which the encoder may have turned by M/2 or more, it was turned by that one of the
distances n + k M that is nearest to the silence times the mean of the velocities before and after it. Where
that is not sure (it fits worse than M/4, or the silence was so long that the mean may be off by 3/4 M),
nobody knows: one reading has no position, and the next goes on from there. Nothing is invented,
or lost silently.
"""

import math
from collections import deque
from enum import Enum
from typing import NamedTuple

_NS_PER_S = 1e9


class EncoderEvent(Enum):
    """Why a reading gave no motion; or, BROKEN, a velocity only."""

    STARTED = "first reading"
    RESTARTED = "restarted after silence"  # long enough for half a turn of the encoder
    JUMP = "jump"  # further than the sprocket can have turned
    SIMULTANEOUS = "no time since the last"
    BROKEN = "turned unseen"  # the position before it is not continued


class Motion(NamedTuple):
    """One sprocket; positive drives forward."""

    position: float  # rad, continuous; nan where what was turned is unknown
    velocity: float  # rad/s


class _Silence(NamedTuple):
    """What is to be found out about a silence, once the velocity after it is known."""

    elapsed_ns: int
    velocity: float  # before it, steps/ns
    turned: float  # steps in it, but for whole M


class SprocketEncoder:
    """Unwraps one encoder.

    Args:
        rad_per_step: q.
        steps_per_wrap: M.
        max_speed: fastest the sprocket can turn, rad/s; it bounds what one reading can move.
        window: readings N in the velocity fit, at least 2.
    """

    def __init__(self, rad_per_step: float, steps_per_wrap: float, max_speed: float, window: int) -> None:
        self._rad_per_step = rad_per_step
        self._wrap = steps_per_wrap
        self._steps_per_ns = max_speed / abs(rad_per_step) / _NS_PER_S
        self._raw: float | None = None  # the last raw position used
        self._unwrapped = 0.0
        self._now = 0  # ns since the start
        self._silent = 0  # ns since the last reading used
        self._velocity: float | None = None  # steps/ns
        self._silence: _Silence | None = None
        self._broken = False
        self._jumped = False
        self._history: deque[tuple[int, float]] = deque(maxlen=window)  # (time, unwrapped)

    def update(self, raw: float, elapsed_ns: int) -> Motion | EncoderEvent:
        """One reading, ``elapsed_ns`` of the sender after the previous one given here."""
        self._now += elapsed_ns
        self._silent += elapsed_ns
        if self._raw is None:
            self._unwrapped = raw
            return self._restart(raw, EncoderEvent.STARTED)
        if self._silent <= 0:
            return EncoderEvent.SIMULTANEOUS
        half = self._wrap / 2
        moved = (raw - self._raw + half) % self._wrap - half
        reach = self._steps_per_ns * self._silent + 1.0  # one step of quantisation
        if reach >= half:
            return self._begin_again(raw, moved)
        if abs(moved) > reach:
            self._jumped = True
            return EncoderEvent.JUMP
        self._unwrapped += moved
        self._commit(raw)
        self._velocity = self._slope()
        if self._silence is not None:
            self._bridge(self._silence)
        return self._motion(self._velocity)

    def _motion(self, velocity: float) -> Motion:
        position = math.nan if self._broken else self._unwrapped * self._rad_per_step
        self._broken = False
        return Motion(position, velocity * _NS_PER_S * self._rad_per_step)

    def _begin_again(self, raw: float, moved: float) -> EncoderEvent:
        """After a long silence: what was turned in it shows with the next reading."""
        is_certain = self._velocity is not None and self._silence is None and not self._jumped
        if is_certain and self._velocity is not None:
            self._silence = _Silence(self._silent, self._velocity, moved)
        else:
            self._silence, self._broken = None, True
        self._unwrapped += moved
        return self._restart(raw, EncoderEvent.RESTARTED)

    def _bridge(self, silence: _Silence) -> None:
        """Choose the whole turns of a silence by the velocities around it."""
        assert self._velocity is not None
        self._silence = None
        expected = 0.5 * (silence.velocity + self._velocity) * silence.elapsed_ns
        turns = round((expected - silence.turned) / self._wrap)
        residual = abs(silence.turned + turns * self._wrap - expected)
        tolerance = 0.5 * self._steps_per_ns * silence.elapsed_ns  # mean speeds further off are no machine's
        if residual > self._wrap / 4 or tolerance > 0.75 * self._wrap:
            self._broken = True
            return
        self._unwrapped += turns * self._wrap
        self._history = deque(
            ((time, unwrapped + turns * self._wrap) for time, unwrapped in self._history),
            self._history.maxlen,
        )

    def _restart(self, raw: float, event: EncoderEvent) -> EncoderEvent:
        self._history.clear()
        self._velocity = None
        self._commit(raw)
        return event

    def _commit(self, raw: float) -> None:
        self._raw = raw
        self._silent = 0
        self._jumped = False
        self._history.append((self._now, self._unwrapped))

    def _slope(self) -> float:
        """Of the least-squares line through the window, steps/ns."""
        n, now, newest = len(self._history), self._now, self._unwrapped
        x_sum = xx_sum = 0
        y_sum = xy_sum = 0.0  # from the newest reading: exact for whole steps
        for time, unwrapped in self._history:
            x, y = time - now, unwrapped - newest
            x_sum += x
            y_sum += y
            xx_sum += x * x
            xy_sum += x * y
        return (n * xy_sum - x_sum * y_sum) / (n * xx_sum - x_sum * x_sum)
