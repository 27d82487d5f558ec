# SPDX-License-Identifier: Apache-2.0
"""Counts by reason: what was rejected is never silent."""

from collections import Counter
from enum import Enum


class Tally:
    """How often each (source, reason) has occurred, since the start and since the last look."""

    def __init__(self) -> None:
        self.total: Counter[tuple[str, str]] = Counter()
        self._seen: Counter[tuple[str, str]] = Counter()

    def add(self, source: str, reason: Enum, count: int = 1) -> None:
        """Count one or more occurrences; a reason reads as its text, or as its name where it is a number."""
        text = reason.value if isinstance(reason.value, str) else reason.name.lower()
        self.total[source, text] += count

    def since_last_look(self) -> dict[tuple[str, str], int]:
        """What has come since the previous call; for diagnostics that report news."""
        news = dict(self.total - self._seen)
        self._seen = self.total.copy()
        return news

    def by_source(self) -> dict[str, dict[str, int]]:
        """{source: {reason: n}}, as the summaries print it."""
        nested: dict[str, dict[str, int]] = {}
        for (source, reason), count in sorted(self.total.items()):
            nested.setdefault(source, {})[reason] = count
        return nested
