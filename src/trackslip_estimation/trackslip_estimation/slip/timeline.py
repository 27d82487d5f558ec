# SPDX-License-Identifier: Apache-2.0
"""Measurements in the order of their stamps, each with the state of the filter after it.

Late data are put in their place and what comes after them is done again, so that the state is a
function of the *set* of measurements, whatever the order in which they came. A state is *settled*
once it is older than the window: nothing that may still come can change it.
"""

from bisect import bisect_left, bisect_right
from collections.abc import Callable
from typing import Generic, TypeVar

from trackslip_estimation.slip.measurements import KINDS, Measurement, Outcome

State = TypeVar("State")
Key = tuple[int, int, str]

_RANK = {kind: rank for rank, kind in enumerate(KINDS)}


def key_of(measurement: Measurement) -> Key:
    """The one order of all measurements: stamp, then kind, then source."""
    return measurement.stamp_ns, _RANK[type(measurement)], measurement.source


class Timeline(Generic[State]):
    """A window of measurements and states; ``step`` computes the state after one more measurement."""

    def __init__(
        self, window_ns: int, start: State, first: Measurement, step: Callable[[State, Measurement], State]
    ) -> None:
        """``start`` is the state after ``first``, which is not stepped through."""
        self._window_ns = window_ns
        self._step = step
        self._first = key_of(first)
        self._keys: list[Key] = [(first.stamp_ns, -1, "")]
        self._measurements: list[Measurement | None] = [None]
        self._states: list[State] = [start]

    @property
    def newest(self) -> State:
        """The state after the measurement with the newest stamp."""
        return self._states[-1]

    @property
    def oldest_ns(self) -> int:
        """Measurements before this stamp come too late: the start, or what is settled."""
        return max(self._keys[0][0], self._keys[-1][0] - self._window_ns)

    @property
    def states(self) -> list[State]:
        """Those in the window, the oldest first."""
        return list(self._states)

    def refusal(self, measurement: Measurement) -> Outcome | None:
        """Why the measurement has no place here, or None."""
        key = key_of(measurement)
        if key < self._keys[0] or measurement.stamp_ns < self.oldest_ns:
            return Outcome.TOO_LATE
        at = bisect_left(self._keys, key)
        known = key == self._first or self._keys[at : at + 1] == [key]
        return Outcome.DUPLICATE if known else None

    def insert(self, measurement: Measurement, redo_from_ns: int | None = None) -> State:
        """Put it in its place, do again what follows, and return the state right after it.

        ``redo_from_ns``: do again also what has a later stamp than this (an input that was
        extrapolated there is now known).
        """
        key = key_of(measurement)
        at = bisect_left(self._keys, key)
        self._keys.insert(at, key)
        self._measurements.insert(at, measurement)
        self._states.insert(at, self._states[at - 1])
        first = at
        if redo_from_ns is not None:
            first = min(at, max(bisect_right(self._keys, (redo_from_ns, len(_RANK), "")), 1))
        for index in range(first, len(self._keys)):
            entry = self._measurements[index]
            assert entry is not None
            self._states[index] = self._step(self._states[index - 1], entry)
        state = self._states[at]
        self._trim()
        return state

    def _trim(self) -> None:
        """Let settled states go, but for the one that the window stands on."""
        horizon = self._keys[-1][0] - self._window_ns
        settled = bisect_left(self._keys, (horizon, -1, "")) - 1
        if settled > 0:
            del self._keys[:settled], self._measurements[:settled], self._states[:settled]
