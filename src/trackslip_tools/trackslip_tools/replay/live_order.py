# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Restores the order in which the live estimator processed its inputs, while a bag is read.

The live estimator's journal (``measurement_reports``) has one line for each input, in that order. A line is
processed once all messages with log times up to ``HORIZON_NS`` later are read. An input that no line names by
then was not processed live and is left out. A source that is missing in the journal (from another bag, or
remapped) is merged by log time. Without a journal, all inputs are ordered by log time.

A restart of the line numbers marks a restart of the estimator. A row of ``IS_START`` then comes first, with
the parameters that were published since the line before. A bag may merge several recordings of one run: the
first copy of a line counts. Lines of several simultaneous runs have no order.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from trackslip_common.arrays import BoolArray, IntArray, Rows
from trackslip_estimation.slip.measurements import RELOAD
from trackslip_tools.replay.arrivals import ARRIVAL, IS_COMMAND, IS_RELOAD, IS_START
from trackslip_tools.replay.comparable import LINE, OUT_OF_ORDER, Comparability, ComparablePart, JournalRuns

HORIZON_NS = 60_000_000_000  # largest log time between an input and its line; DDS repairs within 5 s
_MAX_COPY_DELAY_NS = 5_000_000_000  # log time from a line to its copy in another recording of the run
_MAX_RECENT_LINES = 10_000  # lines in which copies are sought: ten times what a machine logs in that time
_MAX_PARAMETER_DELAY_NS = 5_000_000_000  # largest delay of a run's parameters after its first line, log time
_END_NS, _NO_LINE = np.iinfo(np.int64).max, np.iinfo(np.int64).max
_NO_PARAMETERS = "the bag lacks the parameters of the estimator that was started again"


@dataclass
class JournalCounts:
    """Counts of the lines of the journal and of lines and inputs that the bag lacks."""

    lines: int = 0
    lost_lines: int = 0  # missing in the journal, including those before its first line
    disordered_lines: int = 0  # lines whose numbers go back without a start of a run
    lost_inputs: int = 0  # inputs that the journal names and the bag lacks
    last_sprockets_ns: int | None = None  # latest stamp of sprockets in the journal
    comparable: Comparability = field(default_factory=Comparability)  # up to the last processed line

    @property
    def parts(self) -> list[ComparablePart]:
        """Parts that can be compared with live estimates; empty without a journal: the whole bag can."""
        return self.comparable.parts or ([ComparablePart(0, 0)] if self.lines else [])


class LiveOrder:
    """Reorders arrivals from log order to the order of live processing.

    Args:
        sources: names of the sources, by number.
        journaled: numbers of the sources with a line anywhere in the journal; empty without a journal.
        commands: numbers of the commands, which the bag holds only as lines of the journal.
        sprockets: number of the sprocket source.
        unknown: by ``start`` of a row of ``IS_RELOAD``, why a run cannot begin with these parameters.
    """

    def __init__(
        self,
        sources: Sequence[str],
        journaled: Collection[int],
        commands: Collection[int],
        sprockets: int,
        unknown: Sequence[str] = (),
    ) -> None:
        self.counts = JournalCounts()
        self._journaled = np.array(sorted(journaled), dtype=np.int64)
        self._commands = np.array(sorted(commands), dtype=np.int64)
        self._sources, self._sprockets, self._unknown = sources, sprockets, unknown
        self._runs = JournalRuns(self.counts.comparable, sources, sprockets)
        self._rows, self._lines = np.empty(0, ARRIVAL), np.empty(0, LINE)
        self._recent = np.empty(0, LINE)  # recent lines, with which new ones are compared to find copies
        self._numbered = False  # whether lines have numbers
        self._last_sequence, self._last_line_ns, self._part = _NO_LINE, 0, 0  # of the last processed line

    def push(self, rows: Rows, lines: Rows, until_ns: int) -> Rows:
        """Arrivals that are now in live order, after adding arrivals and lines logged before ``until_ns``."""
        lines = self._remove_copies(lines)
        self._count_lines(lines)
        if not self._journaled.size:
            rows["part"] = 1
            return rows[~_repeats_parameters(rows)]
        self._rows = np.concatenate((self._rows, rows))
        self._lines = np.concatenate((self._lines, lines))
        return self._order_until(until_ns - HORIZON_NS)

    def finish(self) -> Rows:
        """The remaining arrivals in live order; called after the last ``push``."""
        return self._order_until(_END_NS)

    def _count_lines(self, lines: Rows) -> None:
        self.counts.lines += len(lines)
        stamps_ns = lines["stamp_ns"][lines["source"] == self._sprockets]
        if stamps_ns.size:
            before = self.counts.last_sprockets_ns
            newest = int(stamps_ns.max())
            self.counts.last_sprockets_ns = newest if before is None else max(before, newest)

    def _remove_copies(self, lines: Rows) -> Rows:
        """The lines without those that repeat a line logged up to ``_MAX_COPY_DELAY_NS`` earlier."""
        self._numbered |= bool((lines["sequence"] > 0).any())
        known = np.concatenate((self._recent, lines))
        if self._numbered and not (np.diff(known["sequence"]) > 0).all():
            names = ("log_time_ns", "outcome", "stamp_ns", "source", "sequence")
            order = np.lexsort([known[name] for name in names])
            steps = [np.diff(known[name][order]) for name in names]
            is_copy = np.zeros(len(known), np.bool_)
            is_copy[order[1:]] = (steps[0] <= _MAX_COPY_DELAY_NS) & ~np.any(steps[1:], axis=0)
            lines, known = lines[~is_copy[len(self._recent) :]], known[~is_copy]
        if len(known):
            oldest_ns = int(known["log_time_ns"].max()) - _MAX_COPY_DELAY_NS
            self._recent = known[known["log_time_ns"] >= oldest_ns][-_MAX_RECENT_LINES:]
        return lines

    def _order_until(self, limit_ns: int) -> Rows:
        """Arrivals named by lines logged before ``limit_ns``, merged with those of sources without lines."""
        rows, is_due = self._rows, self._lines["log_time_ns"] < limit_ns
        lines = self._lines[is_due]
        starts = self._find_starts(lines)
        lost = _count_missing_lines(lines["sequence"], self._last_sequence, [start.line for start in starts])
        self.counts.lost_lines += int(lost[lost > 0].sum())
        self.counts.disordered_lines += int((lost < 0).sum())
        is_free = ~_repeats_parameters(rows)
        is_free[[start.row for start in starts if start.row >= 0]] = False
        named = _match_rows(rows, lines, np.flatnonzero(is_free))
        is_command = np.isin(lines["source"], self._commands)
        missing = (named < 0) & ~is_command
        self.counts.lost_inputs += int(missing.sum())
        missing &= lines["source"] >= 0  # source −1: no input under the parameters of the replay
        parts = self._runs.assign_parts(lines, missing, lost, {start.line: start.unknown for start in starts})
        if len(lines):
            self._last_sequence = int(lines["sequence"][-1])
            self._last_line_ns = int(lines["log_time_ns"][-1])
        merged = np.flatnonzero(is_free & self._is_due_by_log_time(rows, limit_ns))
        before = np.searchsorted(lines["log_time_ns"], rows["log_time_ns"][merged])  # the line they precede
        processed = np.flatnonzero((named >= 0) | is_command)
        restarts = [start for start in starts if start.is_restart]
        processed_rows = _processed_rows(rows, lines[processed], named[processed])
        ordered = np.concatenate((rows[merged], _start_rows(rows, lines, restarts), processed_rows))
        places = np.concatenate((before, [start.line for start in restarts], processed)).astype(np.int64)
        order = np.lexsort((np.repeat((0, 1, 2), (merged.size, len(restarts), processed.size)), places))
        numbers = np.append(parts, parts[-1] if len(parts) else self._part)
        ordered["part"], self._part = numbers[places], int(numbers[-1])
        is_waiting = is_free.copy()
        is_waiting[merged] = is_waiting[named[named >= 0]] = False
        is_waiting |= _repeats_parameters(rows) & self._may_begin_run(rows)
        self._rows = rows[is_waiting & ~self._is_too_old(rows, limit_ns)]
        self._lines = self._lines[~is_due]
        return ordered[order]

    def _find_starts(self, lines: Rows) -> list["_Start"]:
        """Starts of runs: lines whose number goes back, after new parameters or to number 0.

        The first run of all has the parameters of the bag.
        """
        starts = []
        reloads = np.flatnonzero(self._rows["kind"] == IS_RELOAD)
        before = np.append(self._last_sequence, lines["sequence"])[:-1]
        for k in np.flatnonzero(lines["sequence"] <= before).tolist():
            after_ns = int(lines["log_time_ns"][k - 1]) if k else self._last_line_ns
            is_first = k == 0 and self._last_sequence == _NO_LINE
            row = self._parameters_row(reloads, lines[k], after_ns, is_first=is_first)
            if row >= 0:
                starts.append(_Start(k, row, self._unknown[self._rows["start"][row]], is_restart=True))
            elif is_first or before[k] > 0 == lines["sequence"][k]:  # lines without numbers start no run
                starts.append(_Start(k, -1, "" if is_first else _NO_PARAMETERS, is_restart=not is_first))
        return starts

    def _parameters_row(self, reloads: IntArray, line: np.void, after_ns: int, *, is_first: bool) -> int:
        """Row of the parameters with which the run of this line begins; −1: none."""
        logged_ns, at_ns = self._rows["log_time_ns"], line["log_time_ns"]
        candidates = reloads[logged_ns[reloads] > after_ns]
        earlier, later = candidates[logged_ns[candidates] <= at_ns], candidates[logged_ns[candidates] > at_ns]
        if self._sources[line["source"]] == RELOAD:
            earlier = earlier[:-1]  # the line itself names the last one
        if earlier.size:
            return int(earlier[-1])
        later = later[logged_ns[later] <= at_ns + _MAX_PARAMETER_DELAY_NS]
        return int(later[0]) if later.size and not is_first else -1

    def _is_due_by_log_time(self, rows: Rows, limit_ns: int) -> BoolArray:
        """(n,) whether a row of a source without journal lines is due for merging by log time."""
        is_due = ~np.isin(rows["source"], self._journaled) & (rows["log_time_ns"] < limit_ns)
        return np.asarray(is_due if limit_ns == _END_NS else is_due & ~self._may_begin_run(rows))

    def _is_too_old(self, rows: Rows, limit_ns: int) -> BoolArray:
        """(n,) whether a row is too old to be named by any later line."""
        oldest_ns = limit_ns - HORIZON_NS if limit_ns > 0 else limit_ns
        return np.asarray((rows["log_time_ns"] < oldest_ns) & ~self._may_begin_run(rows))

    def _may_begin_run(self, rows: Rows) -> BoolArray:
        """(n,) whether a row holds parameters of a run whose first line may still come."""
        return np.asarray((rows["kind"] == IS_RELOAD) & (rows["log_time_ns"] > self._last_line_ns))


class _Start(NamedTuple):
    """Start of a run of the estimator."""

    line: int
    row: int  # row of its parameters; −1: none
    unknown: str  # why the start cannot be repeated; empty if it can
    is_restart: bool  # whether the estimator has to be created again


def _count_missing_lines(sequences: IntArray, last: int, starts: Sequence[int]) -> IntArray:
    """(n,) number of lines missing before each line, by their numbers; ``last``: number of the line before.

    ``OUT_OF_ORDER`` where the number goes back and no run starts. Lines without numbers (0) never go back.
    """
    before = np.append(last, sequences)[:-1]
    lost: IntArray = sequences - before - 1
    lost[sequences <= before] = OUT_OF_ORDER
    lost[sequences == 0] = 0
    lost[list(starts)] = sequences[list(starts)]
    return lost


def _repeats_parameters(rows: Rows) -> BoolArray:
    """(n,) whether a row repeats the parameters before it; a run may still begin with such a row."""
    return np.asarray((rows["kind"] == IS_RELOAD) & (rows["reload"] < 0))


def _start_rows(rows: Rows, lines: Rows, starts: Sequence[_Start]) -> Rows:
    """(n,) ARRIVAL of ``IS_START``, one for each start."""
    start_rows = np.zeros(len(starts), ARRIVAL)
    start_rows["kind"] = IS_START
    for row, start in zip(start_rows, starts, strict=True):
        row["log_time_ns"] = lines["log_time_ns"][start.line]
        row["start"] = rows["start"][start.row] if start.row >= 0 else -1
    return start_rows


def _processed_rows(rows: Rows, lines: Rows, named: IntArray) -> Rows:
    """(n,) ARRIVAL of the lines: the rows that they name; a command where a line names none."""
    processed = np.zeros(len(lines), ARRIVAL)
    is_row = named >= 0
    processed[is_row] = rows[named[is_row]]
    commands = np.zeros(int((~is_row).sum()), ARRIVAL)
    commands["kind"] = IS_COMMAND
    for name in ("source", "stamp_ns", "log_time_ns"):
        commands[name] = lines[name][~is_row]
    processed[~is_row] = commands
    return processed


def _match_rows(rows: Rows, lines: Rows, free: IntArray) -> IntArray:
    """(n,) row that each line names, among those whose numbers are ``free`` (k,); −1: none.

    Among rows and lines of one source and stamp, the first line names the first row, and so on. The line of a
    manual pose without a stamp has the stamp at which the pose was used.
    """
    keys = {name: rows[name][free] for name in ("source", "stamp_ns")}
    sources, stamps_ns = (np.concatenate((column, lines[name])) for name, column in keys.items())
    order = np.lexsort((stamps_ns, sources))  # by key; within a key: rows, then lines, both in order
    sources, stamps_ns = sources[order], stamps_ns[order]
    begins = np.ones(order.size, np.bool_)
    begins[1:] = (np.diff(sources) != 0) | (np.diff(stamps_ns) != 0)
    key, first = np.cumsum(begins) - 1, np.flatnonzero(begins)
    is_line = order >= free.size
    count = np.bincount(key[~is_line], minlength=first.size)  # rows of each key
    at = np.flatnonzero(is_line)
    number = at - first[key[at]] - count[key[at]]  # number of the line within its key
    matched = number < count[key[at]]
    matches = np.full(len(lines), -1)
    matches[order[at[matched]] - free.size] = order[first[key[at[matched]]] + number[matched]]
    unstamped = np.setdiff1d(np.flatnonzero(keys["stamp_ns"] == 0), matches)
    for source in np.unique(keys["source"][unstamped]):
        unmatched = unstamped[keys["source"][unstamped] == source]
        unnamed = np.flatnonzero((matches < 0) & (lines["source"] == source))[: unmatched.size]
        matches[unnamed] = unmatched[: unnamed.size]
    return np.asarray(np.append(free, -1)[matches])
