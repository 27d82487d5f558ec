# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Limits the message rate of each topic of a node; messages beyond the limit are dropped."""

import time
from collections import Counter
from collections.abc import Callable

# messages of a topic per second: more than sprockets of a bag played at ten times its speed
MAX_RATE = 1200.0
MAX_BURST = 2400.0  # messages at once, after the processor was busy


class RateLimiter:
    """A token bucket for each topic; counts what was dropped."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._tokens: dict[str, tuple[float, float]] = {}  # by topic: tokens, and their time in s
        self._reported: dict[str, int] = {}
        self.dropped: Counter[str] = Counter()  # by topic, without zeros

    def accept_message(self, topic: str) -> bool:
        """Take a token of the topic; returns whether there was one, so that the message may pass."""
        now_s = self._clock()
        tokens, at_s = self._tokens.get(topic, (MAX_BURST, now_s))
        tokens = min(MAX_BURST, tokens + MAX_RATE * (now_s - at_s))
        is_accepted = tokens >= 1.0
        self._tokens[topic] = (tokens - is_accepted, now_s)
        if not is_accepted:
            self.dropped[topic] += 1
        return is_accepted

    def new_drops(self) -> dict[str, int]:
        """Messages dropped since the previous call, by topic."""
        before, self._reported = self._reported, dict(self.dropped)
        return {topic: n for topic, count in self._reported.items() if (n := count - before.get(topic, 0))}
