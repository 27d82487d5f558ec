# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Intervals of constant state, and their display as rows of bars over time."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from trackslip_common.arrays import FloatArray


class Spell(NamedTuple):
    """An interval of constant state."""

    start: float  # s from the bag's first message
    stop: float
    state: int  # number within its enumeration
    text: str = ""

    def shifted(self, by_s: float) -> "Spell":
        """The same interval, later by ``by_s``."""
        return self._replace(start=self.start + by_s, stop=self.stop + by_s)


class Look(NamedTuple):
    """Style of a state."""

    colour: str
    word: str  # legend text


class Bar(NamedTuple):
    """An interval with its style."""

    spell: Spell
    look: Look


@dataclass(frozen=True)
class Strip:
    """One plot with a row of bars for each name."""

    title: str
    rows: dict[str, list[Bar]]  # from top to bottom


def bars(found: Iterable[Spell], looks: Mapping[int, Look]) -> list[Bar]:
    """Intervals with the styles of their states."""
    return [Bar(spell, looks[spell.state]) for spell in found]


def spells(times: FloatArray, states: NDArray[Any]) -> list[Spell]:
    """Intervals of (n,) states at rising times; each lasts to the start of the next, the last to the end."""
    if not len(times):
        return []
    begins = np.concatenate(((0,), np.flatnonzero(np.diff(states)) + 1))
    starts = times[begins]
    stops = np.append(starts[1:], times[-1])
    return [Spell(float(a), float(b), int(s)) for a, b, s in zip(starts, stops, states[begins], strict=True)]


def total_duration(found: Iterable[Spell], state: int) -> float:
    """Total duration of the intervals of a state, s."""
    return sum(spell.stop - spell.start for spell in found if spell.state == state)
