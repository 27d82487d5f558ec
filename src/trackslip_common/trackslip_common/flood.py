# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Limits the message rate of each topic of a node; messages beyond the limit are dropped."""

import time
from collections import Counter
from collections.abc import Callable

MOST = 1200.0  # messages of a topic per second: more than sprockets of a bag played at ten times its speed
BURST = 2400.0  # messages at once, after the processor was busy


class FloodGuard:
    """A token bucket for each topic; counts what was dropped."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._room: dict[str, tuple[float, float]] = {}  # by topic: tokens, and their time in s
        self._reported: dict[str, int] = {}
        self.dropped: Counter[str] = Counter()  # by topic, without zeros

    def lets_pass(self, topic: str) -> bool:
        """Take a token of the topic; returns whether there was one, so that the message may pass."""
        now_s = self._clock()
        room, at_s = self._room.get(topic, (BURST, now_s))
        room = min(BURST, room + MOST * (now_s - at_s))
        passes = room >= 1.0
        self._room[topic] = (room - passes, now_s)
        if not passes:
            self.dropped[topic] += 1
        return passes

    def news(self) -> dict[str, int]:
        """Messages dropped since the previous call, by topic."""
        before, self._reported = self._reported, dict(self.dropped)
        return {topic: n for topic, count in self._reported.items() if (n := count - before.get(topic, 0))}
