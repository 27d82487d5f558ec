# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Intervals of constant state, and their display as rows of bars over time."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from trackslip_common.arrays import FloatArray

LONGEST_STEP_S = 1.0  # between two estimates; beyond it nothing is known


class StateInterval(NamedTuple):
    """An interval of constant state."""

    start: float  # s from the bag's first message
    stop: float
    state: int  # number within its enumeration
    text: str = ""

    def shift(self, by_s: float) -> "StateInterval":
        """The same interval, later by ``by_s``."""
        return self._replace(start=self.start + by_s, stop=self.stop + by_s)


class Style(NamedTuple):
    """Style of a state."""

    colour: str
    label: str  # legend text


class Bar(NamedTuple):
    """An interval with its style."""

    interval: StateInterval
    style: Style


@dataclass(frozen=True)
class Strip:
    """One plot with a row of bars for each name."""

    title: str
    rows: dict[str, list[Bar]]  # from top to bottom


def bars(intervals: Iterable[StateInterval], styles: Mapping[int, Style]) -> list[Bar]:
    """Intervals with the styles of their states."""
    return [Bar(interval, styles[interval.state]) for interval in intervals]


def state_intervals(times: FloatArray, states: NDArray[Any]) -> list[StateInterval]:
    """Intervals of (n,) states at rising times; each lasts to the next, a gap or the end."""
    if not len(times):
        return []
    is_gap = np.diff(times) > LONGEST_STEP_S
    ends = np.flatnonzero((np.diff(states) != 0) | is_gap)
    begins = np.concatenate(((0,), ends + 1))
    stops = np.append(times[np.where(is_gap[ends], ends, ends + 1)], times[-1])
    return [
        StateInterval(float(a), float(b), int(s))
        for a, b, s in zip(times[begins], stops, states[begins], strict=True)
    ]


def total_duration(intervals: Iterable[StateInterval], state: int) -> float:
    """Total duration of the intervals of a state, s."""
    return sum(interval.stop - interval.start for interval in intervals if interval.state == state)
