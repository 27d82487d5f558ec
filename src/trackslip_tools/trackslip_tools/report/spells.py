# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Stretches of time in which something stayed as it was, and how they are drawn: rows of bars over time."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from trackslip_common.arrays import FloatArray


class Spell(NamedTuple):
    """One stretch of time."""

    start: float  # s from the bag's first message
    stop: float
    state: int  # of the condition's own numbers
    text: str = ""

    def shifted(self, by_s: float) -> "Spell":
        """The same, so much later."""
        return self._replace(start=self.start + by_s, stop=self.stop + by_s)


class Look(NamedTuple):
    """How a state is drawn."""

    colour: str
    word: str  # for the legend


class Bar(NamedTuple):
    """A spell as it is drawn."""

    spell: Spell
    look: Look


@dataclass(frozen=True)
class Strip:
    """One plot: a row of bars for each name."""

    title: str
    rows: dict[str, list[Bar]]  # from above


def bars(found: Iterable[Spell], looks: Mapping[int, Look]) -> list[Bar]:
    """Spells with the look of their states."""
    return [Bar(spell, looks[spell.state]) for spell in found]


def spells(times: FloatArray, states: NDArray[Any]) -> list[Spell]:
    """Of (n,) rising times and whole numbers; a spell lasts until the next begins, the last until the end."""
    if not len(times):
        return []
    begins = np.concatenate(((0,), np.flatnonzero(np.diff(states)) + 1))
    starts = times[begins]
    stops = np.append(starts[1:], times[-1])
    return [Spell(float(a), float(b), int(s)) for a, b, s in zip(starts, stops, states[begins], strict=True)]


def total_duration(found: Iterable[Spell], state: int) -> float:
    """Seconds that the spells of a state last together."""
    return sum(spell.stop - spell.start for spell in found if spell.state == state)
