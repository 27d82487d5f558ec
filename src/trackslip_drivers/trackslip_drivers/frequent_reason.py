# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Selects which of several reasons of rejections a driver reports."""

import math
from collections.abc import Mapping

from trackslip_drivers.stamping import StampEvent

STAMP_EVENTS = frozenset((StampEvent.SHIFTED.value, StampEvent.CLOCK_JUMPED.value))

Key = tuple[str, str]  # source, reason

_MEAN_TIME = 3.0  # s, in which the weight of a count falls to 1/e
_REPLACING_RATIO = 3.0  # of the weights of a reason and the one that it replaces


class FrequentReason:
    """The most frequent reason of the latest seconds.

    Another reason replaces it only if it is clearly more frequent: noise on a line is one state, and not a
    new one each second. Any reason replaces an event that rejects nothing, one of ``events``.
    """

    def __init__(self, events: frozenset[str] = STAMP_EVENTS) -> None:
        self._events = events
        self._key: Key = ("", "")
        self._weights: dict[Key, float] = {}
        self._updated_s = -math.inf

    def update(self, counts: Mapping[Key, int], now_s: float) -> Key:
        """The reason after these counts since the previous update; there is at least one count."""
        decay = math.exp((self._updated_s - now_s) / _MEAN_TIME)
        decayed = {key: decay * weight for key, weight in self._weights.items()}
        self._weights = decayed | {key: decayed.get(key, 0.0) + count for key, count in counts.items()}
        self._updated_s = now_s
        best = max(self._weights, key=lambda key: self._weights[key])
        own_weight = 0.0 if self._key[1] in self._events else self._weights.get(self._key, 0.0)
        if _REPLACING_RATIO * own_weight <= self._weights[best]:
            self._key = best
        return self._key
