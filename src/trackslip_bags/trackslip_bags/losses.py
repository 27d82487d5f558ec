# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Which messages never came: publishers number theirs, and a recorder sees the gaps."""

from collections import Counter


class Losses:
    """Lost messages of each topic. A publisher's first message may have any number: it is older than we."""

    def __init__(self) -> None:
        self.total: Counter[str] = Counter()
        self._next: dict[tuple[str, bytes], int] = {}
        self._new: Counter[str] = Counter()

    def see(self, topic: str, publisher: bytes, number: int) -> None:
        """A message came, with the running number that its publisher gave it."""
        gap = number - self._next.get((topic, publisher), number)
        self._next[topic, publisher] = number + 1
        self.add(topic, gap)

    def add(self, topic: str, count: int) -> None:
        """So many are lost; a publisher may also send again what it keeps for late comers."""
        if count > 0:
            self.total[topic] += count
            self._new[topic] += count

    def news(self) -> str:
        """What was lost since this was last asked, in words; empty where nothing was."""
        text = ", ".join(f"{count} messages of {topic}" for topic, count in sorted(self._new.items()))
        self._new.clear()
        return text
