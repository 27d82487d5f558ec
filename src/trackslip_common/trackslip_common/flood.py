# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""How many messages of a topic a node has time for; what a publisher run wild sends beyond is dropped."""

import time
from collections import Counter
from collections.abc import Callable

MOST = 1200.0  # messages of a topic in a second: sprockets of a bag played at ten times its speed, and more
BURST = 2400.0  # at once: what has gathered while the processor was busy


class FloodGuard:
    """A token bucket for each topic; counts what was dropped."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._room: dict[str, tuple[float, float]] = {}  # by topic: messages that there is time for, as of s
        self._reported: dict[str, int] = {}
        self.dropped: Counter[str] = Counter()  # by topic; none where nothing was

    def lets_pass(self, topic: str) -> bool:
        """Whether there is time for one more message of the topic now."""
        now_s = self._clock()
        room, at_s = self._room.get(topic, (BURST, now_s))
        room = min(BURST, room + MOST * (now_s - at_s))
        passes = room >= 1.0
        self._room[topic] = (room - passes, now_s)
        if not passes:
            self.dropped[topic] += 1
        return passes

    def news(self) -> dict[str, int]:
        """Messages dropped since the last look, by topic."""
        before, self._reported = self._reported, dict(self.dropped)
        return {topic: n for topic, count in self._reported.items() if (n := count - before.get(topic, 0))}
