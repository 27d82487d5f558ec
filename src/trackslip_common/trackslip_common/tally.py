# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Counts by reason: what was rejected is never silent."""

from collections import Counter
from enum import Enum
from threading import Lock


class Tally:
    """How often each (source, reason) has occurred, since the start and since the last look.

    One thread may count while another reads.
    """

    def __init__(self) -> None:
        self._total: Counter[tuple[str, str]] = Counter()
        self._seen: Counter[tuple[str, str]] = Counter()
        self._details: dict[tuple[str, str], str] = {}
        self._lock = Lock()

    def add(self, source: str, reason: Enum, count: int = 1, detail: str = "") -> None:
        """Count occurrences; a reason reads as its text, or as its name where it is a number.

        ``detail``: of the latest one, such as "10 fields, 9 expected".
        """
        if not count:
            return
        text = reason.value if isinstance(reason.value, str) else reason.name.lower()
        with self._lock:
            self._total[source, text] += count
            if detail:
                self._details[source, text] = detail

    def words(self, key: tuple[str, str]) -> str:
        """The latest detail of a (source, reason), or the reason where it has none."""
        with self._lock:
            return self._details.get(key, key[1])

    @property
    def total(self) -> Counter[tuple[str, str]]:
        """Since the start; a copy."""
        with self._lock:
            return self._total.copy()

    def since_last_look(self) -> dict[tuple[str, str], int]:
        """What has come since the previous call; for diagnostics that report news."""
        total = self.total
        news = dict(total - self._seen)
        self._seen = total
        return news

    def by_source(self) -> dict[str, dict[str, int]]:
        """{source: {reason: n}}, as the summaries print it."""
        nested: dict[str, dict[str, int]] = {}
        for (source, reason), count in sorted(self.total.items()):
            nested.setdefault(source, {})[reason] = count
        return nested

    def __getstate__(self) -> dict[str, Counter[tuple[str, str]]]:
        """Without the lock: tallies travel to other processes."""
        return {"_total": self.total, "_seen": self._seen}

    def __setstate__(self, state: dict[str, Counter[tuple[str, str]]]) -> None:
        self._total, self._seen, self._lock = state["_total"], state["_seen"], Lock()
        self._details = {}
