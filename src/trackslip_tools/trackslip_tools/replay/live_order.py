# SPDX-License-Identifier: Apache-2.0
"""The order in which the live estimator processed its inputs, restored while a bag is read.

The live estimator's journal (``measurement_reports``) has one line for each input, in that order. A line is
followed once everything is read that was logged up to ``HORIZON_NS`` later; an input that no line has named
by then was not processed live and is left out. A source that the journal does not know (another bag's, a
remapped one) is merged in by log time; without a journal, log time orders all.
"""

from collections import defaultdict, deque
from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trackslip_tools.replay.arrivals import ARRIVAL, Kind, Rows

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
        self._commands, self._sprockets = frozenset(commands), sprockets
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
        rows = self._rows
        is_known = np.isin(rows["source"], self._journaled)
        others = deque(np.flatnonzero(~is_known & (rows["log_time_ns"] < limit_ns)).tolist())
        log_times_ns = rows["log_time_ns"].tolist()
        shelf = _by_key(rows, is_known)
        following = self._lines["log_time_ns"] < limit_ns
        order: list[int] = []  # rows; a command is −1 less the number of its line
        for k, line in enumerate(self._lines[following].tolist()):
            logged_ns, _, source, stamp_ns = line
            while others and log_times_ns[others[0]] <= logged_ns:
                order.append(others.popleft())
            if source in self._commands:
                order.append(-1 - k)
            elif waiting := shelf.get((source, stamp_ns)):
                order.append(waiting.popleft())
            else:
                self.counts.lost_inputs += 1
        order += others
        found = self._chosen(np.array(order, dtype=np.int64))
        kept = np.ones(len(rows), np.bool_)
        kept[[k for k in order if k >= 0]] = False
        oldest_ns = limit_ns - HORIZON_NS if limit_ns > 0 else limit_ns
        self._rows = rows[kept & (rows["log_time_ns"] >= oldest_ns)]
        self._lines = self._lines[~following]
        return found

    def _chosen(self, order: NDArray[np.int64]) -> Rows:
        """Rows, and commands made of their lines."""
        found = np.zeros(len(order), ARRIVAL)
        is_row = order >= 0
        found[is_row] = self._rows[order[is_row]]
        lines = self._lines[-1 - order[~is_row]]
        commands = np.zeros(len(lines), ARRIVAL)
        commands["kind"] = Kind.COMMAND
        for name in ("source", "stamp_ns", "log_time_ns"):
            commands[name] = lines[name]
        found[~is_row] = commands
        return found


def _by_key(rows: Rows, chosen: NDArray[np.bool_]) -> dict[tuple[int, int], deque[int]]:
    """(source, stamp) → rows that have it, in order."""
    shelf: dict[tuple[int, int], deque[int]] = defaultdict(deque)
    numbers = np.flatnonzero(chosen).tolist()
    keys = zip(rows["source"][chosen].tolist(), rows["stamp_ns"][chosen].tolist(), strict=True)
    for number, key in zip(numbers, keys, strict=True):
        shelf[key].append(number)
    return shelf
