# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Counts of events by source and reason, so that no rejection is silent."""

from collections import Counter
from enum import Enum
from threading import Lock


class Tally:
    """Counts of each (source, reason), since the start and since the last report.

    One thread may count while another reads.
    """

    def __init__(self) -> None:
        self._total: Counter[tuple[str, str]] = Counter()
        self._seen: Counter[tuple[str, str]] = Counter()
        self._details: dict[tuple[str, str], str] = {}
        self._lock = Lock()

    def add(self, source: str, reason: Enum, count: int = 1, detail: str = "") -> None:
        """Count occurrences; the text of a reason is its value, or its name if the value is a number.

        ``detail``: of the latest occurrence, such as "10 fields, 9 expected".
        """
        if not count:
            return
        text = reason.value if isinstance(reason.value, str) else reason.name.lower()
        with self._lock:
            self._total[source, text] += count
            if detail:
                self._details[source, text] = detail

    def detail_or_reason(self, key: tuple[str, str]) -> str:
        """The latest detail of a (source, reason); without one, the reason."""
        with self._lock:
            return self._details.get(key, key[1])

    @property
    def total(self) -> Counter[tuple[str, str]]:
        """Counts since the start; a copy."""
        with self._lock:
            return self._total.copy()

    def new_counts(self) -> dict[tuple[str, str], int]:
        """Counts since the previous call, for diagnostics."""
        total = self.total
        new = dict(total - self._seen)
        self._seen = total
        return new

    def values(self) -> dict[str, object]:
        """{"source: reason": count since the start}, sorted, for diagnostics."""
        return {f"{source}: {reason}": count for (source, reason), count in sorted(self.total.items())}

    def by_source(self) -> dict[str, dict[str, int]]:
        """{source: {reason: n}}, for summaries."""
        nested: dict[str, dict[str, int]] = {}
        for (source, reason), count in sorted(self.total.items()):
            nested.setdefault(source, {})[reason] = count
        return nested

    def __getstate__(self) -> dict[str, Counter[tuple[str, str]]]:
        """State without the lock, as tallies are sent to other processes."""
        return {"_total": self.total, "_seen": self._seen}

    def __setstate__(self, state: dict[str, Counter[tuple[str, str]]]) -> None:
        self._total, self._seen, self._lock = state["_total"], state["_seen"], Lock()
        self._details = {}
