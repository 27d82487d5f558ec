# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The order in which the live estimator processed its inputs, restored while a bag is read.

The live estimator's journal (``measurement_reports``) has one line for each input, in that order. A line is
followed once everything is read that was logged up to ``HORIZON_NS`` later; an input that no line has named
by then was not processed live and is left out. A source that the journal does not know (another bag's, a
remapped one) is merged in by log time; without a journal, log time orders all.
"""

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trackslip_tools.replay.arrivals import ARRIVAL, IS_COMMAND, Rows

IntArray = NDArray[np.int64]

HORIZON_NS = 60_000_000_000  # of log time between an input and its line; a repair by DDS takes 5 s at most

LINE = np.dtype(
    [("log_time_ns", np.int64), ("sequence", np.int64), ("source", np.int64), ("stamp_ns", np.int64)]
)
"""One line of the journal; ``source`` is a number."""


@dataclass
class JournalCounts:
    """What the journal states, and what the bag lacks."""

    lines: int = 0
    lost_lines: int = 0  # missing in the journal, those before its first line included
    lost_inputs: int = 0  # that the journal names and the bag lacks
    last_sprockets_ns: int | None = None  # latest stamp of sprockets in it


class LiveOrder:
    """Puts arrivals into live order.

    Args:
        journaled: numbers of the sources that the journal knows anywhere; empty without a journal.
        commands: numbers of the sources of which the bag holds nothing but their line.
        sprockets: number of the sprockets.
    """

    def __init__(self, journaled: Collection[int], commands: Collection[int], sprockets: int) -> None:
        self.counts = JournalCounts()
        self._journaled = np.array(sorted(journaled), dtype=np.int64)
        self._commands = np.array(sorted(commands), dtype=np.int64)
        self._sprockets = sprockets
        self._rows, self._lines = np.empty(0, ARRIVAL), np.empty(0, LINE)
        self._expected = 0  # sequence number of the next line

    def push(self, rows: Rows, lines: Rows, until_ns: int) -> Rows:
        """More arrivals and lines, all that were logged before ``until_ns``; those in order by now."""
        self._count(lines)
        if not self._journaled.size:
            return rows
        self._rows = np.concatenate((self._rows, rows))
        self._lines = np.concatenate((self._lines, lines))
        return self._follow(until_ns - HORIZON_NS)

    def finish(self) -> Rows:
        """The rest, when all was read."""
        return self._follow(np.iinfo(np.int64).max)

    def _count(self, lines: Rows) -> None:
        for sequence in lines["sequence"].tolist():
            self.counts.lost_lines += max(sequence - self._expected, 0)
            self._expected = sequence + 1
        self.counts.lines += len(lines)
        stamps_ns = lines["stamp_ns"][lines["source"] == self._sprockets]
        if stamps_ns.size:
            before = self.counts.last_sprockets_ns
            newest = int(stamps_ns.max())
            self.counts.last_sprockets_ns = newest if before is None else max(before, newest)

    def _follow(self, limit_ns: int) -> Rows:
        """The lines logged before ``limit_ns``, and of unknown sources what was."""
        rows, following = self._rows, self._lines["log_time_ns"] < limit_ns
        lines = self._lines[following]
        named = _named(rows, lines)
        is_command = np.isin(lines["source"], self._commands)
        self.counts.lost_inputs += int(((named < 0) & ~is_command).sum())
        is_other = ~np.isin(rows["source"], self._journaled) & (rows["log_time_ns"] < limit_ns)
        others = np.flatnonzero(is_other)
        before = np.searchsorted(lines["log_time_ns"], rows["log_time_ns"][others])  # the line they precede
        there = np.flatnonzero((named >= 0) | is_command)
        found = np.concatenate((rows[others], _processed(rows, lines[there], named[there])))
        order = np.lexsort((np.repeat((0, 1), (others.size, there.size)), np.concatenate((before, there))))
        left = ~is_other
        left[named[named >= 0]] = False
        oldest_ns = limit_ns - HORIZON_NS if limit_ns > 0 else limit_ns
        self._rows = rows[left & (rows["log_time_ns"] >= oldest_ns)]
        self._lines = self._lines[~following]
        return found[order]


def _processed(rows: Rows, lines: Rows, named: IntArray) -> Rows:
    """The rows that the lines name, and commands made of the lines that name none."""
    found = np.zeros(len(lines), ARRIVAL)
    is_row = named >= 0
    found[is_row] = rows[named[is_row]]
    commands = np.zeros(int((~is_row).sum()), ARRIVAL)
    commands["kind"] = IS_COMMAND
    for name in ("source", "stamp_ns", "log_time_ns"):
        commands[name] = lines[name][~is_row]
    found[~is_row] = commands
    return found


def _named(rows: Rows, lines: Rows) -> IntArray:
    """(n,) the row that each line names, −1 where there is none.

    Of several with one source and stamp the first line names the first row, and so on. A manual pose without
    a stamp has in its line that of its use.
    """
    sources, stamps_ns = (np.concatenate((rows[n], lines[n])) for n in ("source", "stamp_ns"))
    order = np.lexsort((stamps_ns, sources))  # within a key: rows, then lines, both in order
    sources, stamps_ns = sources[order], stamps_ns[order]
    begins = np.ones(order.size, np.bool_)
    begins[1:] = (np.diff(sources) != 0) | (np.diff(stamps_ns) != 0)
    key, first = np.cumsum(begins) - 1, np.flatnonzero(begins)
    is_line = order >= len(rows)
    count = np.bincount(key[~is_line], minlength=first.size)  # rows of each key
    at = np.flatnonzero(is_line)
    number = at - first[key[at]] - count[key[at]]  # of the line within its key
    matched = number < count[key[at]]
    found = np.full(len(lines), -1)
    found[order[at[matched]] - len(rows)] = order[first[key[at[matched]]] + number[matched]]
    unstamped = np.setdiff1d(np.flatnonzero(rows["stamp_ns"] == 0), found)
    for source in np.unique(rows["source"][unstamped]):
        own = unstamped[rows["source"][unstamped] == source]
        unnamed = np.flatnonzero((found < 0) & (lines["source"] == source))[: own.size]
        found[unnamed] = own[: unnamed.size]
    return found
