# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Progress of a recorder: each topic at its first message, and the counts."""

import sys
import textwrap
import time
from collections.abc import Callable

from trackslip_bags.writer import BagWriter
from trackslip_common.console import clear_line

_PERIOD = 60.0  # s between lines without a terminal
_WIDTH = 64  # characters of topic names per line of the log


class RecordProgress:
    """On a terminal one line that is updated, else one line per minute in the log."""

    def __init__(self, bag: BagWriter, log: Callable[[str], object]) -> None:
        self._bag, self._log = bag, log
        self._began_s = self._shown_s = time.monotonic()
        self._topics: set[str] = set()

    def show(self, minutes_left: float | None) -> None:
        """Show the current state; ``minutes_left`` until the disk is full, if known."""
        counts = {topic: count for topic, count in self._bag.counts.items() if count}
        if new := sorted(counts.keys() - self._topics):
            self._topics.update(new)
            clear_line()
            for names in textwrap.wrap(", ".join(new), _WIDTH, break_long_words=False):
                self._log(f"writing {names}")
        now_s = time.monotonic()
        is_terminal = sys.stderr.isatty()
        if not is_terminal and now_s - self._shown_s < _PERIOD:
            return
        self._shown_s = now_s
        line = self._line(counts, now_s - self._began_s, minutes_left)
        if is_terminal:
            print(f"\r\x1b[K{line}", end="", file=sys.stderr, flush=True)
        else:
            self._log(line)

    def _line(self, counts: dict[str, int], seconds: float, minutes_left: float | None) -> str:
        size = sum(file.stat().st_size for file in self._bag.path.glob("*.mcap")) / 1e6
        line = f"{seconds:.0f} s, {sum(counts.values())} messages of {len(counts)} topics, {size:.1f} MB"
        return line if minutes_left is None else f"{line}, disk full in {minutes_left:.0f} min"
