# SPDX-License-Identifier: Apache-2.0
"""Whether the clock goes on as it should: told from stamps and counts alone, so that a replay finds the same.

The sprocket samples are the clock of the estimate. One of them that steps out of line is a bad stamp; many in
a row that agree with each other are another time.

A step back into the history leaves stamps that look like late data. But late data tell the same story as
what is there already, while samples stamped anew tell of positions that the sprockets had elsewhere in it.
"""

from dataclasses import dataclass
from enum import Enum, auto


class Course(Enum):
    """Where a stamp lies."""

    IN_LINE = auto()
    AHEAD = auto()  # further ahead than the gap, and not (yet) confirmed
    BEHIND = auto()  # before the history, and not (yet) confirmed
    BACK = auto()  # the clock has gone back: all begins anew


@dataclass
class _Row:
    """Samples in a row that are out of line in the same way and agree with each other."""

    count: int = 0
    last_ns: int = 0

    def add(self, stamp_ns: int, gap_ns: int, counts: bool = True) -> int:
        """How many count by now; a sample that does not follow on the last one begins anew."""
        follows = 0 < stamp_ns - self.last_ns <= gap_ns
        self.count, self.last_ns = (self.count if follows else 0) + counts, stamp_ns
        return self.count


class Continuity:
    """Judges stamps as they come."""

    def __init__(self, gap_ns: int, confirmations: int) -> None:
        self._gap_ns = gap_ns
        self._confirmations = confirmations
        self._ahead, self._behind, self._late = _Row(), _Row(), _Row()
        self.head_ns: int | None = None  # newest sprocket stamp in line

    def sprockets(self, stamp_ns: int, oldest_ns: int | None, contradicts: bool = False) -> Course:
        """A sprocket sample.

        ``oldest_ns``: older ones have no place in the history, if there is one; ``contradicts``: its
        positions are not those that the sprockets had then.
        """
        floors = [] if oldest_ns is None else [oldest_ns]
        if self.head_ns is not None:
            floors.append(self.head_ns - self._gap_ns)
        if floors and stamp_ns < max(floors):
            self._ahead = _Row()
            confirmed = self._behind.add(stamp_ns, self._gap_ns) >= self._confirmations
            return Course.BACK if confirmed else Course.BEHIND
        self._behind = _Row()
        if self.head_ns is None or stamp_ns > self.head_ns:
            self._late = _Row()
        elif self._late.add(stamp_ns, self._gap_ns, contradicts) >= self._confirmations:
            return Course.BACK
        far = self.other(stamp_ns) is Course.AHEAD
        if far and self._ahead.add(stamp_ns, self._gap_ns) < self._confirmations:
            return Course.AHEAD
        self._ahead = _Row()
        self.head_ns = stamp_ns if self.head_ns is None else max(self.head_ns, stamp_ns)
        return Course.IN_LINE

    def other(self, stamp_ns: int) -> Course:
        """A sample of any other source: it confirms nothing."""
        far = self.head_ns is not None and stamp_ns > self.head_ns + self._gap_ns
        return Course.AHEAD if far else Course.IN_LINE
