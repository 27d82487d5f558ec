# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Finds the parts of a bag in which a replay can be compared with live estimates, from the live journal.

A state depends on all measurements since the start of the estimator. A part therefore begins with an estimate
of a run whose measurements the bag has from the start. A part ends before the first measurement that was used
live and is missing in the bag, before lost lines of the journal, at a restart of the estimator, or with the
bag. Measurements that the estimator discarded before its first estimate may be missing.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from trackslip_common.arrays import BoolArray, IntArray, Rows
from trackslip_estimation.slip.measurements import Outcome

LINE = np.dtype(
    [
        ("log_time_ns", np.int64),
        ("sequence", np.int64),
        ("source", np.int64),
        ("stamp_ns", np.int64),
        ("outcome", np.int64),
    ]
)
"""One line of the journal; ``source`` is a number."""

OUT_OF_ORDER = -1
"""Marker instead of a count of missing lines: the line number goes back without a start of a run."""

_NEVER_USED = (Outcome.DUPLICATE, Outcome.INVALID, Outcome.FROZEN)
_USED_OF_SPROCKETS_ALONE = (Outcome.TOO_LATE, Outcome.WAITING, Outcome.AHEAD)  # sprockets are the clock
_WITHOUT_ESTIMATE = (*_NEVER_USED, *_USED_OF_SPROCKETS_ALONE)  # possible without estimate
_IN_LINE = (Outcome.ACCEPTED, Outcome.JUMPED, Outcome.RESTARTED)  # sprocket outcomes with estimates
_KEPT_SAMPLES = 3  # sprocket samples before its first estimate on which an estimate may depend


@dataclass
class ComparablePart:
    """One part; stamps are those of its sprocket samples, None without any."""

    begin_log_ns: int
    end_log_ns: int
    first_ns: int | None = None
    last_ns: int | None = None

    def contains(self, stamps_ns: IntArray) -> BoolArray:
        """(n,) whether each stamp lies in the part."""
        if self.first_ns is None or self.last_ns is None:
            return np.zeros(len(stamps_ns), np.bool_)
        return (stamps_ns >= self.first_ns) & (stamps_ns <= self.last_ns)

    def extend(self, lines: Rows, sprockets: int) -> None:
        """Add lines of the journal to the part; ``sprockets``: number of the sprocket source."""
        self.end_log_ns = int(lines["log_time_ns"][-1])
        in_line = (lines["source"] == sprockets) & np.isin(lines["outcome"], _IN_LINE)
        stamps_ns = lines["stamp_ns"][in_line]
        if stamps_ns.size:
            first_ns, last_ns = int(stamps_ns.min()), int(stamps_ns.max())
            self.first_ns = first_ns if self.first_ns is None else min(self.first_ns, first_ns)
            self.last_ns = last_ns if self.last_ns is None else max(self.last_ns, last_ns)


class Break(NamedTuple):
    """Why nothing can be compared from a log time on."""

    log_time_ns: int
    why: str


@dataclass
class Comparability:
    """The comparable parts of a journal, and the reasons for the breaks between them."""

    parts: list[ComparablePart] = field(default_factory=list)
    breaks: list[Break] = field(default_factory=list)

    def comparable_start(self) -> tuple[bool, int | None]:
        """Whether the beginning of the bag can be compared, and up to which stamp; None: to the bag's end."""
        if not self.parts and not self.breaks:
            return True, None
        first = self.parts[0] if self.parts else None
        if first is None or any(one.log_time_ns <= first.begin_log_ns for one in self.breaks):
            return False, None
        return True, first.last_ns if self.breaks or len(self.parts) > 1 else None


class JournalRuns:
    """Assigns the lines of a journal to runs of the estimator and to comparable parts.

    Args:
        comparability: receives the parts and breaks.
        sources: names of the sources, by number.
        sprockets: number of the sprocket source.
    """

    def __init__(self, comparability: Comparability, sources: Sequence[str], sprockets: int) -> None:
        self._comparability, self._sources, self._sprockets = comparability, sources, sprockets
        self._part: ComparablePart | None = None  # part of the next line
        self._awaits_estimate = False  # whether the run has no estimate yet
        self._samples, self._required_samples = 0, 0  # sprocket samples since the last loss
        self._loss_reason = ""  # reason of the last loss

    def assign_parts(
        self, lines: Rows, missing: BoolArray, lost: IntArray, starts: Mapping[int, str]
    ) -> IntArray:
        """(n,) number of the part of each line, from 1 on; 0: outside all parts.

        Args:
            lines: (n,) LINE.
            missing: (n,) whether the bag lacks the measurement.
            lost: (n,) number of lines missing before it, or ``OUT_OF_ORDER``.
            starts: index of the first line of each run → why that start cannot be repeated, empty if it can.
                The first line of all is one of them.
        """
        numbers, used, at = np.zeros(len(lines), np.int64), missing & self._is_used(lines), 0
        interrupted = used | (lost != 0)
        interrupted[list(starts)] = True
        for k in np.flatnonzero(interrupted).tolist():
            self._extend_part(lines[at:k], numbers[at:k])
            if k in starts:
                self._begin_run(lines[k], int(lost[k]), starts[k])
            elif lost[k]:
                self._end_part(lines[k], _gap_reason(int(lost[k])))
            if used[k]:
                self._skip_missing(lines[k])
            at = k + 1 if used[k] else k
        self._extend_part(lines[at:], numbers[at:])
        return numbers

    def _extend_part(self, lines: Rows, numbers: IntArray) -> None:
        """Assign lines without losses to the current part; starts a part at the first estimate of a run."""
        begin = 0
        if self._awaits_estimate:
            has_estimate = ~np.isin(lines["outcome"], _WITHOUT_ESTIMATE)
            begin = int(np.argmax(has_estimate)) if has_estimate.any() else len(lines)
            self._samples += int((lines["source"][:begin] == self._sprockets).sum())
            if begin < len(lines):
                self._begin_part(lines[begin])
        if self._part is not None and begin < len(lines):
            numbers[begin:] = len(self._comparability.parts)
            self._part.extend(lines[begin:], self._sprockets)

    def _begin_run(self, line: np.void, lost: int, unknown: str) -> None:
        """Begin a run after ``lost`` missing lines; ``unknown``: why its start cannot be repeated."""
        self._part, self._awaits_estimate = None, not unknown
        self._samples, self._required_samples = 0, _KEPT_SAMPLES if lost else 0
        self._loss_reason = (
            f"the bag lacks the first {lost} measurements of the estimator's run" if lost else ""
        )
        if unknown:
            self._add_break(line, unknown)

    def _begin_part(self, line: np.void) -> None:
        """Begin a part at the first estimate of a run, if enough sprocket samples precede it."""
        self._awaits_estimate, log_time_ns = False, int(line["log_time_ns"])
        if self._samples >= self._required_samples:
            self._part = ComparablePart(log_time_ns, log_time_ns)
            self._comparability.parts.append(self._part)
        else:
            self._add_break(line, self._loss_reason)

    def _skip_missing(self, line: np.void) -> None:
        """End the part at a line whose measurement was used live and is missing."""
        source = self._sources[line["source"]]
        self._end_part(line, f"the bag lacks a measurement of {source} that was used live")
        if self._awaits_estimate and line["outcome"] not in _WITHOUT_ESTIMATE:
            self._begin_part(line)

    def _end_part(self, line: np.void, why: str) -> None:
        """End the part: a line before this one, or the measurement of this one, is missing."""
        if self._part is not None:
            self._add_break(line, why)
        self._part, self._loss_reason = None, self._loss_reason or why
        self._samples, self._required_samples = 0, _KEPT_SAMPLES

    def _add_break(self, line: np.void, why: str) -> None:
        self._comparability.breaks.append(Break(int(line["log_time_ns"]), why))

    def _is_used(self, lines: Rows) -> BoolArray:
        """(n,) whether the live estimate may depend on the measurement."""
        others = (lines["source"] != self._sprockets) & np.isin(lines["outcome"], _USED_OF_SPROCKETS_ALONE)
        return np.asarray(~np.isin(lines["outcome"], _NEVER_USED) & ~others)


def _gap_reason(lost: int) -> str:
    """Reason of a break before a line that follows ``lost`` missing lines."""
    if lost == OUT_OF_ORDER:
        return "the bag merges recordings of several runs: the journal's lines are out of order"
    return f"the bag lacks {lost} lines of the live estimator's journal"
